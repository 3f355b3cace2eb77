"""The CAN FD transport on a simulated pyb.CAN. Also runs on MicroPython."""

from support.modem import os_error

from uros.transport.can import CanTransport
from uros.transport.can_pyb import PybCan


class FakeCan:
    """pyb.CAN of FD controllers, after MicroPython's documentation."""

    STOPPED, ERROR_ACTIVE, ERROR_WARNING, ERROR_PASSIVE, BUS_OFF = range(5)
    RANGE, DUAL, MASK = range(3)

    def __init__(self):
        self.now = self.ERROR_ACTIVE
        self.after_restart = self.ERROR_ACTIVE
        self.room = 3
        self.incoming = []
        self.sent = []
        self.filters = []
        self.restarts = 0

    def state(self):
        return self.now

    def restart(self):
        self.restarts += 1
        self.now = self.after_restart

    def setfilter(self, bank, mode, fifo, params, *, rtr=False, extframe=False):
        self.filters.append((bank, mode, fifo, params, extframe))

    def any(self, fifo):
        assert fifo == 0
        return bool(self.incoming)

    def recv(self, fifo, list=None, *, timeout=5000):
        assert timeout == 0 and self.incoming
        return self.incoming.pop(0)

    def send(self, data, id, *, timeout=0, rtr=False, extframe=False, fdf=False, brs=False):
        assert timeout == 0 and extframe and fdf and not rtr
        assert len(data) in (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
        if not self.room:
            raise OSError(12)
        self.room -= 1
        self.sent.append((id, bytes(data), brs))


def test_messages_are_sent_and_received_by_pyb_can() -> None:
    can = FakeCan()
    transport = CanTransport(PybCan(can, 0x201), 0x201)
    transport.open()
    assert can.filters == [(0, can.MASK, 0, (0x201, 0x1FFFFFFF), True)]
    transport.send(b"hello, agent")
    assert can.sent == [(0x201, b"\x0chello, agent\0\0\0", True)]
    can.incoming = [
        (0x201, False, False, 0, b"\2no"),
        (0x201, True, True, 0, b""),
        (0x201, True, False, 0, b"\3yes\0\0\0\0"),
    ]
    assert transport.receive(0) == b"yes" and transport.receive(0) is None
    transport.close()


def test_messages_for_a_full_controller_are_dropped_and_counted() -> None:
    can = FakeCan()
    transport = CanTransport(PybCan(can, brs=False))
    transport.open()
    assert can.filters == [(0, can.MASK, 0, (0, 0), True)]
    for _ in range(5):
        transport.send(b"x")
    assert transport.dropped == 2 and can.sent == [(1, b"\1x", False)] * 3


def test_a_bus_that_is_off_raises_and_is_restarted() -> None:
    can = FakeCan()
    transport = CanTransport(PybCan(can))
    transport.open()
    can.now, can.room = can.BUS_OFF, 0
    assert "bus is off" in os_error(transport.send, b"x")
    can.after_restart = can.BUS_OFF
    assert "bus is off" in os_error(transport.open)
    can.after_restart, can.room = can.ERROR_ACTIVE, 3
    transport.open()
    transport.send(b"x")
    assert can.sent and can.restarts == 2


def test_a_controller_without_fd_is_refused() -> None:
    class Classic:
        MASK16 = 0

    try:
        PybCan(Classic())
    except ValueError as error:
        assert "CAN FD" in str(error)
    else:
        raise AssertionError("not refused")
