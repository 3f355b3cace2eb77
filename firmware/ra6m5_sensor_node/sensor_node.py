"""The node: the schedule of the sensors, and the publishing of their values.

main.py imports names of uros from here: each module that its text names costs a board a quarter of
a kilobyte.
"""

import time

from sensor_msgs.msg import RelativeHumidity, Temperature
from std_msgs.msg import String, UInt16

from uros.client import AGENT_AVAILABLE, AGENT_CONNECTED
from uros.client import Node as Node
from uros.drivers import SensorError, reason
from uros.drivers.bus import Bus as Bus
from uros.drivers.mcp9600 import MCP9600
from uros.drivers.port import open_port as open_port
from uros.drivers.sht3x import SHT3x
from uros.drivers.vcnl4010 import VCNL4010
from uros.qos import DurabilityPolicy, QoSProfile
from uros.transport.serial import StreamTransport as StreamTransport

try:
    from typing import Any
except ImportError:
    pass

NAME = "ra6m5_sensor_node"
PERIOD_S = 1.0
WAIT_S = 0.02  # measurement time of the SHT3x, and polling period of the VCNL4010
LIGHT_FIRST = 5  # first poll of the VCNL4010, in these waits: 100 ms
LIGHT_LAST = 20  # last poll, in these waits: after 400 ms it has failed
REMIND_MS = 10000  # a sensor that goes on failing is reported again

LOOKING, CREATING, RUNNING = 7, 8, 9
SENSORS_FAILED = 100


class Crumbs:
    """The progress of the program, for the console (``crumbs.error``) and for a debugger.

    ``step``: 1 I2C, 2 USB, 3 messages, 4 node, 5 publishers, 6 timers, 7 searching the agent,
    8 creating entities, 9 running; 100 no sensor can be read; 999 a step failed, and is retried.
    ``code``: the result of the last check: 0, an errno, 10 out of memory, else 1. ``check``: its
    number. ``error``: the text of the last error, also of a sensor.
    """

    def __init__(self) -> None:
        self.step = 0
        self.code = 0
        self.check = 0
        self.error = ""


crumbs = Crumbs()


class Sensor:
    """Reports when a sensor begins to fail, every 10 s while it fails, and when it works again.

    ``report(text)`` returns whether the text was sent; if not, it is sent at the next reading.
    """

    def __init__(self, name: str, report: "Any") -> None:
        self.name = name
        self.measuring = False
        self.failing = False
        self._report = report
        self._told = False
        self._again = 0  # time of the next reminder

    def failed(self, error: Exception) -> None:
        self.measuring = False
        self.failing = True
        crumbs.error = "%s read failed: %s" % (self.name, reason(error))
        now = time.ticks_ms()
        if not self._told or time.ticks_diff(now, self._again) >= 0:
            if self._report(crumbs.error):
                self._told = True
                self._again = time.ticks_add(now, REMIND_MS)

    def fine(self) -> None:
        self.measuring = False
        self.failing = False
        if self._told and self._report(self.name + " read again"):
            self._told = False

    def new_listeners(self) -> None:
        """Report a current fault again, since the listeners are new."""
        self._told = False


class SensorNode:
    """The sensors on ``bus`` for ``node``.

    Messages, publishers and timers are built in separate steps, so that the crumbs show which one
    failed.
    """

    def __init__(self, bus: "Any") -> None:
        self.node: "Any" = None
        self.sht3x = SHT3x(bus)
        self.mcp9600 = MCP9600(bus)
        self.vcnl4010 = VCNL4010(bus)
        self.climate = Sensor("SHT3x", self.report)
        self.thermocouple = Sensor("MCP9600", self.report)
        self.light = Sensor("VCNL4010", self.report)
        self._announced = False
        self._waits = 0

    def make_messages(self) -> None:
        self.room = Temperature()
        self.humidity = RelativeHumidity()
        self.hot = Temperature()
        self.cold = Temperature()
        self.proximity = UInt16()
        self.ambient = UInt16()
        self.text = String()
        self.room.header.frame_id = self.humidity.header.frame_id = "sht3x"
        self.hot.header.frame_id = self.cold.header.frame_id = "mcp9600"

    def make_publishers(self) -> None:
        create = self.node.create_publisher
        self.pub_room = create(Temperature, "/sensors/room_temp", 10)
        self.pub_humidity = create(RelativeHumidity, "/sensors/humidity", 10)
        self.pub_hot = create(Temperature, "/sensors/thermocouple_hot", 10)
        self.pub_cold = create(Temperature, "/sensors/thermocouple_cold", 10)
        self.pub_proximity = create(UInt16, "/sensors/proximity", 10)
        self.pub_ambient = create(UInt16, "/sensors/ambient_light", 10)
        # Transient local: readers that join later get the last lines.
        latched = QoSProfile(10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.pub_text = create(String, "/sensors/diagnostic", latched)

    def make_timers(self) -> None:
        self.node.create_timer(PERIOD_S, self.tick)
        self._wait = self.node.create_timer(WAIT_S, self.waited)
        self._wait.cancel()
        self.node.on_state = self.on_state

    # Measurement.

    def tick(self) -> None:
        """Start the measurements, and read the free-running MCP9600; called once a second."""
        if not self._announced:
            self.announce()
        self._start(self.climate, self.sht3x)
        self._start(self.light, self.vcnl4010)
        self._read_thermocouple()
        self._waits = 0
        if self.climate.measuring or self.light.measuring:
            self._wait.reset()
        self.mark()

    def waited(self) -> None:
        """Read the sensors; called every 20 ms after `tick` until both are read or have failed."""
        self._waits += 1
        if self.climate.measuring:
            self._read_climate()
        if self.light.measuring and self._waits >= LIGHT_FIRST:
            self._read_light()
        if not (self.climate.measuring or self.light.measuring):
            self._wait.cancel()
            self.mark()

    def _start(self, sensor: Sensor, driver: "Any") -> None:
        try:
            driver.start()
            sensor.measuring = True
        except (OSError, SensorError) as error:
            sensor.failed(error)

    def _read_climate(self) -> None:
        try:
            self.sht3x.read()
        except (OSError, SensorError) as error:
            self.climate.failed(error)
            return
        stamp = self.room.header.stamp
        self.node.clock.stamp(stamp)
        self.humidity.header.stamp.sec = stamp.sec
        self.humidity.header.stamp.nanosec = stamp.nanosec
        self.room.temperature = self.sht3x.temperature
        self.humidity.relative_humidity = self.sht3x.humidity
        self.send(self.pub_room, self.room)
        self.send(self.pub_humidity, self.humidity)
        self.climate.fine()

    def _read_thermocouple(self) -> None:
        clock = self.node.clock
        try:
            self.hot.temperature = self.mcp9600.read_hot()
            clock.stamp(self.hot.header.stamp)
            self.cold.temperature = self.mcp9600.read_cold()
            clock.stamp(self.cold.header.stamp)
        except (OSError, SensorError) as error:
            self.thermocouple.failed(error)
            return
        self.send(self.pub_hot, self.hot)
        self.send(self.pub_cold, self.cold)
        self.thermocouple.fine()

    def _read_light(self) -> None:
        try:
            if not self.vcnl4010.read():
                if self._waits < LIGHT_LAST:
                    return
                raise SensorError("the measurement does not end")
        except (OSError, SensorError) as error:
            self.light.failed(error)
            return
        self.proximity.data = self.vcnl4010.proximity
        self.ambient.data = self.vcnl4010.ambient
        self.send(self.pub_proximity, self.proximity)
        self.send(self.pub_ambient, self.ambient)
        self.light.fine()

    # Publishing.

    def send(self, publisher: "Any", message: "Any") -> bool:
        """Publish while connected; return whether the message was accepted.

        A connected node knows the agent's time, so no stamp of another clock is published.
        """
        return bool(self.node.state == AGENT_CONNECTED and publisher.publish(message))

    def report(self, text: str) -> bool:
        """Publish a line on the diagnostic topic; return whether it was accepted."""
        self.text.data = text
        return self.send(self.pub_text, self.text)

    def announce(self) -> None:
        self._announced = self.report(NAME + " initialized")

    def on_state(self, state: int) -> None:
        self._announced = False
        if state == AGENT_CONNECTED:
            self.announce()
            for sensor in (self.climate, self.thermocouple, self.light):
                sensor.new_listeners()
        self.mark()

    def mark(self) -> None:
        if self.climate.failing and self.thermocouple.failing and self.light.failing:
            crumbs.step = SENSORS_FAILED
        elif self.node.state == AGENT_CONNECTED:
            crumbs.step = RUNNING
        else:
            crumbs.step = CREATING if self.node.state == AGENT_AVAILABLE else LOOKING
