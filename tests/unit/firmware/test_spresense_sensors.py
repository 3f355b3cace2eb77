"""firmware/spresense_sensors: stamps of the GNSS receiver's sentences."""

import sys
from types import ModuleType

import pytest
from support.board import KEY, FakeAgent, FakeClock
from support.paths import ROOT

from uros.client import Node
from uros.interfaces import load
from uros.interfaces.codec import from_cdr
from uros.wire import ids

FOLDER = ROOT / "firmware" / "spresense_sensors"
NAMES = (
    "BatteryState", "CameraInfo", "Illuminance", "Imu", "MagneticField", "NavSatFix", "Range",
    "RelativeHumidity", "Temperature", "TimeReference",
)  # fmt: skip


def line(body: str) -> bytes:
    total = 0
    for octet in body.encode():
        total ^= octet
    return b"$%s*%02X\r\n" % (body.encode(), total)


class Receiver:
    """A UART with a receiver that sends sentences without a fix every second from its start on.

    With ``slow`` they are sent so slowly that the line is never idle.
    """

    def __init__(self, clock: FakeClock, slow: bool) -> None:
        self.clock = clock
        self.start = clock.t
        self.ms = 1000 if slow else 400
        self.given = 0

    def sent(self) -> bytes:
        out = b""
        second, us = divmod(self.clock.t - self.start, 1_000_000)
        for n in range(second + 1):
            burst = line(f"GPGGA,1200{n:02d},,,,,0,00,99.9,,M,,M,,")
            burst += line(f"GPRMC,1200{n:02d},V,,,,,,,230394,,,N") + line("GPGSV,1,1,00" + "," * 40)
            share = us * len(burst) // (1000 * self.ms) if n == second else len(burst)
            out += burst[:share]
        return out

    def read(self, most: int) -> "bytes | None":
        data = self.sent()[self.given : self.given + most]
        self.given += len(data)
        return data or None


class Slow(FakeAgent):
    """An agent that answers TIMESTAMP only while ``awake``."""

    awake = False

    def submessage(self, kind, flags, payload):
        if kind != ids.TIMESTAMP or self.awake:
            super().submessage(kind, flags, payload)


@pytest.fixture
def sensors(monkeypatch):
    messages = ModuleType("sensor_msgs.msg")
    for name in NAMES:
        setattr(messages, name, load("sensor_msgs/msg/" + name))
    monkeypatch.setitem(sys.modules, "sensor_msgs", ModuleType("sensor_msgs"))
    monkeypatch.setitem(sys.modules, "sensor_msgs.msg", messages)
    monkeypatch.syspath_prepend(str(FOLDER))
    monkeypatch.delitem(sys.modules, "sensors", raising=False)
    import sensors

    yield sensors
    del sys.modules["sensors"]


@pytest.mark.parametrize("slow", [False, True])
@pytest.mark.parametrize("awake_ms", [0, 1010, 1200, 1390, 1700, 2900])
@pytest.mark.parametrize("callback_ms", [0, 30, 180])
def test_no_fix_is_stamped_before_the_time_is_known(sensors, slow, awake_ms, callback_ms):
    clock = FakeClock()
    agent = Slow(clock, mtu=512)
    node = Node("node", agent, key=KEY, clock=clock)
    gnss = sensors.Gnss(node, Receiver(clock, slow))
    node.create_timer(0.05, lambda: clock.sleep(callback_ms))  # other work of the board
    fixes = []
    end = clock.t + 12_000_000
    while clock.t < end:
        agent.awake = clock.t >= (1000 + awake_ms) * 1000
        node.spin_once(0.01)
        for object_id, octets in agent.samples:
            if object_id >> 4 == gnss._pub_fix.number:
                fix = from_cdr(load("sensor_msgs/msg/NavSatFix"), b"\0\1\0\0" + octets)
                stamp = fix.header.stamp
                fixes.append(stamp.sec * 1_000_000 + stamp.nanosec // 1000 - agent.epoch_us)
                assert fixes[-1] >= awake_ms * 1000  # after the time is known
                assert clock.t - fixes[-1] < 1_600_000, (fixes, clock.t)
        agent.samples.clear()
    assert len(fixes) > 5 and fixes == sorted(fixes)
