"""ROS 2 node ra6m5_sensor_node: three I2C sensors, seven topics, one USB cable. See README.md."""

import errno
import time

from sensor_node import LOOKING, NAME, Bus, Node, SensorNode, StreamTransport, crumbs, open_port

try:
    from typing import Any
except ImportError:
    pass

RETRY_MS = 1000
ENUMERATION_MS = 5000
MTU = 256  # bytes; every message of this node is shorter
CHECK_FAILED = 999
OUT_OF_MEMORY = 10

program: "Any" = None  # the SensorNode, once all is built
port: "Any" = None
failed_at = 0
enumerated_by = -1  # deadline for the host to configure the board; -1 for none


def check(step: int, function: "Any", *arguments: "Any") -> "Any":
    """Call a function and return its result; record the step and an error in the crumbs."""
    crumbs.step = step
    crumbs.check += 1
    try:
        result = function(*arguments)
    except Exception as error:
        crumbs.step = CHECK_FAILED
        crumbs.code = 1
        if isinstance(error, MemoryError):
            crumbs.code = OUT_OF_MEMORY
        elif isinstance(error, OSError) and error.args:
            crumbs.code = error.args[0]
        crumbs.error = "step %d: %s %s" % (step, type(error).__name__, error)
        raise
    crumbs.code = 0
    return result


def start() -> None:
    """Build everything without waiting. After a failure step() tries again."""
    global program, port, failed_at, enumerated_by
    crumbs.check = 0
    try:
        bus = check(1, Bus, 2, "P415")
        if port is None:
            port = check(2, open_port, 0x045B, 0x2013, "Renesas", "RA6M5 Sensor Node", "000001")
            if hasattr(port, "is_open"):
                enumerated_by = time.ticks_add(time.ticks_ms(), ENUMERATION_MS)
        new = SensorNode(bus)
        check(3, new.make_messages)
        new.node = check(4, Node, NAME, StreamTransport(port, mtu=MTU))
        check(5, new.make_publishers)
        check(6, new.make_timers)
    except Exception:
        print(crumbs.error)
        failed_at = time.ticks_ms()
    else:
        program = new
        crumbs.step = LOOKING


def step() -> None:
    """Do one piece of work; waits at most 100 ms."""
    global enumerated_by
    now = time.ticks_ms()
    if program is None:
        time.sleep_ms(100)
        if time.ticks_diff(now, failed_at) >= RETRY_MS:
            start()
        return
    if enumerated_by >= 0 and time.ticks_diff(now, enumerated_by) >= 0:
        enumerated_by = -1
        if not port.is_open():
            crumbs.code = errno.ETIMEDOUT
            crumbs.error = "USB: no host has configured the board in 5 s"
            print(crumbs.error)
    program.node.spin_once(0.1)


def main() -> None:
    start()
    while True:
        step()


if __name__ == "__main__":
    main()
