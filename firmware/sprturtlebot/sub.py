"""The sub core: motors, encoders, speeds and odometry.

It communicates with the main core by mailboxes only, and runs apart from it (see cores.py): `start`
once and then `step` in a loop, or `run`.
"""

import time

import config
from machine import PWM, Pin
from mail import COMMAND, NOTE, ODOMETRY, POWER, Mailbox

from uros.control.chassis import Chassis
from uros.control.pid import Pid
from uros.drivers.drv8835 import DRV8835

try:
    from typing import Any
except ImportError:
    pass

PERIOD_MS = 20
PWM_HZ = 20000


def _motor(inputs: "tuple[int, int]") -> DRV8835:
    return DRV8835(PWM(Pin(inputs[0]), freq=PWM_HZ), PWM(Pin(inputs[1]), freq=PWM_HZ))


class SubCore:
    """Controls the wheels by messages of the main core.

    ``inbox`` carries POWER (bool), COMMAND (v in m/s, w in rad/s; None cancels the previous one)
    and ODOMETRY (a request); ``outbox`` carries ODOMETRY (see `_answer`) and NOTE, a text for the
    log.
    """

    def __init__(self, inbox: Mailbox, outbox: Mailbox) -> None:
        self._inbox = inbox
        self._outbox = outbox
        self._fault = ""
        self.chassis = Chassis(
            Pin(config.MOTOR_POWER, Pin.OUT, value=0),
            _motor(config.RIGHT),
            _motor(config.LEFT),
            Pin(config.RIGHT_ENCODER, Pin.IN),
            Pin(config.LEFT_ENCODER, Pin.IN),
            Pid(**config.RIGHT_PID),
            Pid(**config.LEFT_PID),
            time.ticks_us,
            config.RIGHT_RADIUS,
            config.LEFT_RADIUS,
            config.D,
            fastest=config.FASTEST,
        )

    def step(self) -> None:
        """Read the mailbox and run one control step; called every 20 ms."""
        inbox = self._inbox
        is_odometry_requested = False
        number = inbox.receive()
        while number:
            if number == POWER:
                if inbox.value != self.chassis.drive.powered:
                    self.chassis.power(inbox.value)
            elif number == COMMAND and inbox.value is not None:
                self._command(inbox.value[0], inbox.value[1])
            elif number == ODOMETRY:
                is_odometry_requested = True
            number = inbox.receive()
        self.chassis.step()
        if self.chassis.drive.fault != self._fault:
            self._fault = self.chassis.drive.fault
            self._outbox.send(NOTE, self._fault or "both wheels turn again")
        if is_odometry_requested:
            self._outbox.send(ODOMETRY, self._answer())

    def _command(self, v: float, w: float) -> None:
        drive = self.chassis.drive
        if drive.command(v, w):
            if v and drive.v != v or w and drive.w != w:
                text = "%.2f m/s with %.2f rad/s is too fast: it drives %.2f with %.2f"
                self._outbox.send(NOTE, text % (v, w, drive.v, drive.w))
        elif not drive.powered:
            self._outbox.send(NOTE, "cmd_vel is ignored, the motors are off: see motor_power")
        elif v - v != 0 or w - w != 0:
            self._outbox.send(NOTE, "cmd_vel is ignored: it is no number")

    def _answer(self) -> "Any":
        """Return x, y, the quaternion's z and w, v, w, and the covariances of pose and twist."""
        odometry = self.chassis.odometry
        pose = [0.0] * 36
        twist = [0.0] * 36
        odometry.pose_covariance(pose)
        odometry.twist_covariance(twist)
        return (
            odometry.x,
            odometry.y,
            odometry.qz,
            odometry.qw,
            odometry.v,
            odometry.w,
            pose,
            twist,
        )


_core: "Any" = None
_due = 0


def start(inbox: "Any", outbox: "Any") -> None:
    """Create the sub core with its mailboxes."""
    global _core, _due
    _core = SubCore(inbox, outbox)
    _due = time.ticks_ms()


def step() -> None:
    """Wait for the next control step and run it; any error switches the motors off."""
    global _due
    wait = time.ticks_diff(_due, time.ticks_ms())
    if wait > 0:
        time.sleep_ms(wait)
    # A late step is not caught up on.
    _due = time.ticks_add(_due if wait > -PERIOD_MS else time.ticks_ms(), PERIOD_MS)
    try:
        _core.step()
    except BaseException:
        _core.chassis.power(False)
        raise


def run(inbox: "Any", outbox: "Any") -> None:
    """Run the sub core in this thread."""
    start(inbox, outbox)
    while True:
        step()
