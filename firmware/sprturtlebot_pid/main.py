"""Tunes the wheels of SprTurtleBot with a visualiser over Wi-Fi. See README.md."""

import time

import config
from line import Line
from machine import PWM, Pin

from uros.control.autotune import AutoTune
from uros.control.chassis import Chassis
from uros.control.pid import Pid
from uros.drivers.drv8835 import DRV8835
from uros.drivers.led import Signal
from uros.drivers.pid_line import PidLine, format_sample
from uros.drivers.starting import attempt
from uros.transport.wlan import Station

PERIOD_MS = 20
PWM_HZ = 20000
TELL_TURNS = 3  # turns of 20 ms between two samples
PAUSE_TURNS = 3  # turns without data after which a line without an end is complete
BLINK_TURNS = 5

led0 = Signal(Pin(config.LED0, Pin.OUT))
tuner: "Tuner | None" = None


def motor(inputs: "tuple[int, int]") -> DRV8835:
    return DRV8835(PWM(Pin(inputs[0]), freq=PWM_HZ), PWM(Pin(inputs[1]), freq=PWM_HZ))


class Tuner:
    """The wheels, and the protocol with the visualiser."""

    def __init__(self) -> None:
        self.right_pid = Pid(**config.RIGHT_PID)
        self.left_pid = Pid(**config.LEFT_PID)
        self.chassis = Chassis(
            Pin(config.MOTOR_POWER, Pin.OUT, value=0),
            motor(config.RIGHT), motor(config.LEFT),
            Pin(config.RIGHT_ENCODER, Pin.IN), Pin(config.LEFT_ENCODER, Pin.IN),
            self.right_pid, self.left_pid, time.ticks_us,
            config.RIGHT_RADIUS, config.LEFT_RADIUS, config.D,
            fastest=config.FASTEST, timeout_ms=config.DRIVE_MS,
        )  # fmt: skip
        self.line = Line(Station(config.SSID, config.PASSWORD), config.VISUALISER, config.PORT)
        self.gains = PidLine()
        self._told = ""  # the last printed reason
        self._fault = ""
        self._wrong = 0
        self._quiet = 0
        self._turn = 0
        self._due = time.ticks_ms()

    def step(self) -> None:
        """Receive data until the next turn, 20 ms at most, then run one control step."""
        left = time.ticks_diff(self._due, time.ticks_ms())
        if left > 0:
            octets = self.line.receive(left)
            self.watch_line()
            if octets:
                self._quiet = 0
                self.read(self.gains.feed(octets))
            return
        self._due = time.ticks_add(self._due, PERIOD_MS)
        if left < -PERIOD_MS:
            self._due = time.ticks_add(time.ticks_ms(), PERIOD_MS)
        self._quiet += 1
        if self._quiet == PAUSE_TURNS:
            self.read(self.gains.flush())
        self.chassis.step()
        self.watch_wheels()
        self._turn += 1
        if self._turn % TELL_TURNS == 0:
            self.tell()
        if self._turn % BLINK_TURNS == 0:
            led0.show(self.line.connected)

    def read(self, commands: "list[tuple[float, ...]]") -> None:
        """Drive the command of the last line."""
        if self.gains.faults != self._wrong:
            self._wrong = self.gains.faults
            self.remark("left out: " + self.gains.fault)
        if commands:
            self.drive(commands[-1])

    def drive(self, values: "tuple[float, ...]") -> None:
        chassis = self.chassis
        chassis.control = drive = chassis.drive
        drive.stop()
        if not any(values[:6]):  # without gains the rover tunes itself
            chassis.control = AutoTune(chassis.right, chassis.left)
            self.remark("tuning: keep a metre in front of me free")
            return
        right = self.right_pid
        left = self.left_pid
        right.kp, right.ki, right.kd, left.kp, left.ki, left.kd, speed, rot = values
        if rot:
            is_accepted = drive.command(0.0, rot * abs(speed) / config.D)
        else:
            is_accepted = drive.command(speed, 0.0)
        if not is_accepted:
            self.remark("not driven: a wheel was stuck a moment ago, try again")

    def watch_line(self) -> None:
        """Switch the motors on with the connection, and off without it."""
        if self.line.connected != self.chassis.drive.powered:
            self.chassis.power(self.line.connected)
            self.gains = PidLine()
            self._wrong = 0
            if self.line.connected:
                print("connected to the visualiser")
        if self.line.reason != self._told:
            self._told = self.line.reason
            if self._told:
                print("no visualiser:", self._told)

    def watch_wheels(self) -> None:
        """Report a stuck wheel, and the end of tuning."""
        chassis = self.chassis
        if chassis.drive.fault != self._fault:
            self._fault = chassis.drive.fault
            self.remark(self._fault or "both wheels turn again")
        control = chassis.control
        if control is not chassis.drive and control.done:
            chassis.control = chassis.drive
            if control.fault:
                self.remark("not tuned: " + control.fault)
            else:
                control.apply(self.right_pid, self.left_pid)
                self.remark("RIGHT_PID = " + shown(self.right_pid))
                self.remark("LEFT_PID = " + shown(self.left_pid))

    def tell(self) -> None:
        """Send the torques, and as an extension the wheels' speeds and targets in mm/s."""
        chassis = self.chassis
        values = [chassis.control.right_duty, chassis.control.left_duty]
        if config.EXTENDED:
            drive = chassis.drive
            turn = drive.w * config.D
            for speed in (chassis.right.speed, chassis.left.speed, drive.v + turn, drive.v - turn):
                values.append(speed * 1000)
        self.line.send(format_sample(tuple(values)))

    def remark(self, text: str) -> None:
        """Print a text, and send it to the visualiser if it accepts extensions."""
        print(text)
        if config.EXTENDED:
            self.line.send("# " + text)


def shown(pid: Pid) -> str:
    """Format the gains as config.py has them."""
    return '{"kp": %.4g, "ki": %.4g, "kd": %.4g, "dead_zone": %.3g, "kf": %.4g, "lag": %.3g}' % (
        pid.kp, pid.ki, pid.kd, pid.dead_zone, pid.kf, pid.lag,
    )  # fmt: skip


def start() -> None:
    global tuner
    tuner = attempt(Tuner, led0)


def step() -> None:
    if tuner is None:
        start()
    else:
        tuner.step()


if __name__ == "__main__":
    start()
    while True:
        step()
