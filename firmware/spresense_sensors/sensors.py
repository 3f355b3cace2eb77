"""The schedule of the measurements, and their messages.

Covariances follow from the tolerances of the datasheets, taken as two sigma or more; 0 is unknown,
-1 is not measured. README.md has the source of each.
"""

from sensor_msgs.msg import (
    BatteryState,
    CameraInfo,
    Illuminance,
    Imu,
    MagneticField,
    NavSatFix,
    Range,
    RelativeHumidity,
    Temperature,
    TimeReference,
)

from uros.client import AGENT_CONNECTED
from uros.drivers import SensorError, reason
from uros.drivers.bh1750 import BH1750
from uros.drivers.lis3mdl import LIS3MDL
from uros.drivers.max17048 import MAX17048
from uros.drivers.mpu6050 import MPU6050
from uros.drivers.nmea import NMEA
from uros.drivers.sht3x import SHT3x
from uros.drivers.tfluna import FIELD_OF_VIEW, MAX_RANGE, MIN_RANGE, TFLuna

try:
    from typing import Any
except ImportError:
    pass

NAN = float("nan")
POLL_S = 0.05  # period at which the GNSS receiver is read
SILENT = 60  # polls without a sentence until a fault is reported: 3 s

# Variances, from the datasheets.
TURN = 0.015  # (rad/s)²: an offset of up to 20 degrees a second
ACCELERATION = 0.1  # (m/s²)²: an offset of up to 0.08 g
FIELD = 1.1e-9  # T²: an offset of up to 1 gauss without calibration
LIGHT = 0.01  # times the square of the illuminance: 20 %
CELSIUS = 0.02  # °C²: 0.3
HUMIDITY = 1e-4  # 2 %
NEAR, FAR = 9e-4, 1e-4  # m², 6 cm up to 3 m; times the square of the distance, 2 %


def diagonal(row: "Any", variance: float) -> None:
    row[0] = row[4] = row[8] = variance


class Sender:
    """Publishes only while connected: the node then has the agent's time for its stamps."""

    def __init__(self, node: "Any") -> None:
        self._node = node
        self._stamp = node.clock.stamp

    def send(self, publisher: "Any", message: "Any") -> None:
        if self._node.state == AGENT_CONNECTED:
            publisher.publish(message)


class Watched:
    """Logs once when a sensor begins to fail, and once when it works again."""

    def __init__(self, node: "Any", name: str) -> None:
        self._log = node.get_logger()
        self._name = name
        self._failing = False

    def failed(self, why: str) -> None:
        if not self._failing:
            self._log.error("%s: %s" % (self._name, why))
        self._failing = True

    def fine(self) -> None:
        if self._failing:
            self._log.info("%s: it is back" % self._name)
        self._failing = False


class Sensor(Watched):
    """Starts a driver every ``period`` seconds, reads it after its measurement, and publishes.

    A failed measurement is repeated at the next period; other sensors are not affected.
    """

    def __init__(
        self, node: "Any", name: str, driver: "Any", period: float, publish: "Any"
    ) -> None:
        super().__init__(node, name)
        self._driver = driver
        self._publish = publish
        self._wait = node.create_timer(driver.wait_ms / 1000, self._read, False)
        node.create_timer(period, self._start)

    def _start(self) -> None:
        if not self._wait.is_canceled():
            return
        try:
            self._driver.start()
        except (OSError, SensorError) as error:
            self.failed(reason(error))
        else:
            self._wait.reset()

    def _read(self) -> None:
        try:
            if self._driver.read() is False:
                return  # not ready: the timer reads it again
        except (OSError, SensorError) as error:
            self._wait.cancel()
            self.failed(reason(error))
            return
        self._wait.cancel()
        self._publish()
        self.fine()


class I2CSensors(Sender):
    """The six sensors on ``bus``, and their seven messages."""

    def __init__(self, node: "Any", bus: "Any") -> None:
        super().__init__(node)
        create = node.create_publisher

        self.imu = Imu()
        self.imu.header.frame_id = "imu"
        self.imu.orientation_covariance[0] = -1.0  # no orientation
        diagonal(self.imu.angular_velocity_covariance, TURN)
        diagonal(self.imu.linear_acceleration_covariance, ACCELERATION)
        self._pub_imu = create(Imu, "imu/data_raw", 10)
        self._imu = MPU6050(bus)
        Sensor(node, "MPU-6050", self._imu, 0.1, self._publish_imu)

        self.field = MagneticField()
        self.field.header.frame_id = "imu"
        diagonal(self.field.magnetic_field_covariance, FIELD)
        self._pub_field = create(MagneticField, "imu/mag", 10)
        self._compass = LIS3MDL(bus)
        Sensor(node, "LIS3MDL", self._compass, 0.2, self._publish_field)

        self.range = Range()
        self.range.header.frame_id = "range"
        self.range.radiation_type = 1  # INFRARED
        self.range.field_of_view = FIELD_OF_VIEW
        self.range.min_range = MIN_RANGE
        self.range.max_range = MAX_RANGE
        self._pub_range = create(Range, "range", 10)
        self._ranger = TFLuna(bus)
        Sensor(node, "TF-Luna", self._ranger, 0.2, self._publish_range)

        self.light = Illuminance()
        self.light.header.frame_id = "light"
        self._pub_light = create(Illuminance, "illuminance", 10)
        self._light = BH1750(bus)
        Sensor(node, "BH1750", self._light, 1.0, self._publish_light)

        self.temperature = Temperature(variance=CELSIUS)
        self.humidity = RelativeHumidity(variance=HUMIDITY)
        self.temperature.header.frame_id = self.humidity.header.frame_id = "air"
        self._pub_temperature = create(Temperature, "temperature", 10)
        self._pub_humidity = create(RelativeHumidity, "humidity", 10)
        self._air = SHT3x(bus)
        Sensor(node, "SHT3x", self._air, 1.0, self._publish_air)

        self.battery = battery = BatteryState(present=True, location="board")
        battery.header.frame_id = "battery"
        battery.current = battery.charge = battery.capacity = NAN
        battery.temperature = battery.design_capacity = NAN
        battery.power_supply_technology = 3  # LIPO
        self._pub_battery = create(BatteryState, "battery", 10)
        self._gauge = MAX17048(bus)
        Sensor(node, "MAX17048", self._gauge, 1.0, self._publish_battery)

    def _publish_imu(self) -> None:
        imu, message = self._imu, self.imu
        self._stamp(message.header.stamp)
        rate, acceleration = message.angular_velocity, message.linear_acceleration
        rate.x, rate.y, rate.z = imu.gx, imu.gy, imu.gz
        acceleration.x, acceleration.y, acceleration.z = imu.ax, imu.ay, imu.az
        self.send(self._pub_imu, message)

    def _publish_field(self) -> None:
        field = self.field.magnetic_field
        self._stamp(self.field.header.stamp)
        field.x, field.y, field.z = self._compass.x, self._compass.y, self._compass.z
        self.send(self._pub_field, self.field)

    def _publish_range(self) -> None:
        message, metres = self.range, self._ranger.range
        self._stamp(message.header.stamp)
        message.range = metres
        measured = MIN_RANGE <= metres <= MAX_RANGE
        message.variance = max(NEAR, FAR * metres * metres) if measured else 0.0
        self.send(self._pub_range, message)

    def _publish_light(self) -> None:
        message, lux = self.light, self._light.lux
        self._stamp(message.header.stamp)
        message.illuminance = lux
        message.variance = LIGHT * lux * lux + 1.0  # at least half a step of 1.85 lx
        self.send(self._pub_light, message)

    def _publish_air(self) -> None:
        self._stamp(self.temperature.header.stamp)
        self._stamp(self.humidity.header.stamp)
        self.temperature.temperature = self._air.temperature
        self.humidity.relative_humidity = self._air.humidity
        self.send(self._pub_temperature, self.temperature)
        self.send(self._pub_humidity, self.humidity)

    def _publish_battery(self) -> None:
        message, gauge = self.battery, self._gauge
        self._stamp(message.header.stamp)
        message.voltage = gauge.volts
        message.cell_voltage = [gauge.volts]
        message.percentage = gauge.fraction
        # CHARGING, DISCHARGING, NOT_CHARGING
        message.power_supply_status = 1 if gauge.rate > 0 else 2 if gauge.rate < 0 else 3
        self.send(self._pub_battery, message)


class Gnss(Sender):
    """A GNSS receiver on ``uart``: publishes position and time."""

    def __init__(self, node: "Any", uart: "Any") -> None:
        super().__init__(node)
        self._watched = Watched(node, "GNSS")
        self._uart = uart
        self._nmea = NMEA()
        self._sentences = 0
        self._quiet = 0  # polls without a sentence
        self._talks = False
        self._timed = False  # the stamps were taken with the agent's time
        self.fix = NavSatFix()
        self.fix.header.frame_id = "gnss"
        self.time = TimeReference(source="GNSS")
        self._pub_fix = node.create_publisher(NavSatFix, "fix", 10)
        self._pub_time = node.create_publisher(TimeReference, "time_reference", 10)
        node.create_timer(POLL_S, self._poll)

    def _poll(self) -> None:
        nmea = self._nmea
        data = self._uart.read(256)
        if data:
            if not self._talks:  # the receiver begins right after its second
                self._timed = self._stamp(self.fix.header.stamp)
                self._stamp(self.time.header.stamp)
            if nmea.feed(data):
                if self._timed:  # False if the data began before the session
                    self._publish()
                data = None  # on a slow board the data of the next second follow without a pause
        self._talks = bool(data)
        self._quiet += 1
        if nmea.sentences != self._sentences:
            self._sentences = nmea.sentences
            self._quiet = 0
            self._watched.fine()
        elif self._quiet == SILENT:
            self._watched.failed("it says nothing that can be read")

    def _publish(self) -> None:
        nmea, fix = self._nmea, self.fix
        known = nmea.status >= 0
        fix.status.status = nmea.status
        fix.status.service = nmea.service
        fix.latitude = nmea.latitude if known else NAN
        fix.longitude = nmea.longitude if known else NAN
        fix.altitude = nmea.altitude if known else NAN
        nmea.covariance(fix.position_covariance)
        fix.position_covariance_type = 1 if known else 0  # APPROXIMATED, UNKNOWN
        self.send(self._pub_fix, fix)
        if nmea.seconds:
            self.time.time_ref.sec = nmea.seconds
            self.time.time_ref.nanosec = nmea.nanosec
            self.send(self._pub_time, self.time)


class Camera(Sender):
    """Publishes the size of the camera's picture.

    The camera is not calibrated, so all other fields are 0, as the message defines it.
    """

    def __init__(self, node: "Any") -> None:
        super().__init__(node)
        self.info = CameraInfo(height=240, width=320)
        self.info.header.frame_id = "myframe"
        self._pub = node.create_publisher(CameraInfo, "camera_info", 10)
        node.create_timer(1.0, self._publish)

    def _publish(self) -> None:
        self._stamp(self.info.header.stamp)
        self.send(self._pub, self.info)
