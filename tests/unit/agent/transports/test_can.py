"""CAN FD of the agent: frames as bytes, buses that fail, hostile frames."""

import errno
import sys
import time

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.agent import running_agent
from support.can import ERROR, EXTENDED, FDF, FRAME, REMOTE, KernelCan
from support.client import XrceClient
from support.lines import SECONDS
from unit.agent.helpers import get_info, message
from unit.agent.transports.faults import Bystanders, wait_for

from uros.agent.clock import Clock
from uros.agent.transports import can as module
from uros.agent.transports.base import TransportError
from uros.agent.transports.can import CanServer
from uros.transport.can_host import CanPort
from uros.wire import ids

PING = message([get_info()], 0, 0, 0x80)


class Host:
    """A server that only records the calls of the transport."""

    clock = Clock()

    def __init__(self):
        self.notes = []
        self.calls = []
        self.watched = {}
        self.received = []

    def now(self):
        return 0

    def unmatched(self, transport, peer, buf, view, length):
        assert len(buf) == len(view) == length
        self.received.append((peer, bytes(buf)))

    def watch(self, fileno, ready, writing=False):
        self.watched[fileno] = ready

    def unwatch(self, fileno):
        del self.watched[fileno]

    def note(self, level, part, function, event, about):
        self.notes.append(f"{event}: {about}")

    def wake_at(self, seconds, call):
        self.calls.append((seconds, call))

    def due(self):
        """Make the scheduled calls; return their delays."""
        calls, self.calls = self.calls, []
        for _, call in calls:
            call()
        return [seconds for seconds, _ in calls]


@pytest.fixture
def host():
    return Host()


@pytest.fixture
def server(host):
    """A CAN transport of the agent on SocketCAN of python-can."""
    can_server = KernelCan()
    can_server.open(host)
    yield can_server
    can_server.close()
    assert host.watched == {}


def ready(host):
    for call in list(host.watched.values()):
        call()


def sent(server, size=100):
    server.bus.settimeout(SECONDS)
    return server.bus.recv(size)


# --- bytes ------------------------------------------------------------------------------------


def test_the_kernels_frames(server, host):
    """By hand, from struct canfd_frame and what the C sources do with it (can_transport_posix.c
    of the client, CanAgentLinux.cpp of the agent): identifier with the EFF flag, frame length,
    flags, two reserved bytes, 64 bytes of data, of which the first is the message's length.
    """
    # The client's frame length is not padded where no controller has sent it (vcan).
    frame = "01000080 05 00 0000" + "0480000000" + "00" * 59
    server.bus.send(bytes.fromhex(frame))
    # On the wire it comes as 12 bytes; FDF (04), as kernels since 6.1 put it; BRS (01) may be.
    frame = "efcdab9f 0c 05 0000" + "0801020304050607 08" + "00" * 55
    server.bus.send(bytes.fromhex(frame))
    ready(host)
    assert host.received == [
        (1, bytes.fromhex("80000000")),
        (0x1FABCDEF, bytes.fromhex("0102030405060708")),
    ]
    server.send(0x1FABCDEF, bytes.fromhex("0102030405060708"))
    # The C agent's frame, except two things that do not appear on the wire: it has 9 bytes where
    # the controller sends 12, and leaves FDF to the kernel.
    assert sent(server) == bytes.fromhex("efcdab9f 0c 04 00 0c 08 0102030405060708" + "00" * 55)
    server.send(1, bytes(range(63)))
    assert sent(server) == bytes.fromhex("01000080 40 04 00 40 3f") + bytes(range(63))


def test_a_ping_from_frame_to_frame():
    with running_agent("socketcan", "memory") as agent:
        line = agent.line()
        line.send(PING)
        answer = line.receive(time.monotonic() + SECONDS)
        assert answer[4] == ids.INFO and len(answer) <= 63


def test_the_second_bit_rate_is_used_on_request(host):
    can_server = KernelCan()
    can_server._switch = True
    can_server.open(host)
    can_server.send(1, b"abc")
    assert sent(can_server)[5] == FDF | 1
    can_server.close()


# --- hostile frames -----------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["can", "socketcan"])
def test_a_frame_whose_length_byte_is_wrong(kind):
    """The first ends the C++ agent: length bytes up to 71 pass its check, which is of the kernel's
    struct and not of the 64 bytes of data."""
    with running_agent(kind, "memory") as agent:
        bystanders = Bystanders(agent)
        line = agent.line(3)
        count = 0
        for length in (0, 4, 63, 64, 65, 71, 72, 128, 255):
            for size in (1, 2, 4, 8, 64):
                if length < size and length:
                    continue
                line.frame(bytes([length]) + bytes(size - 1))
                count += 1
        line.frame(b"")
        line.send(PING)
        assert line.receive(time.monotonic() + SECONDS)[4] == ids.INFO
        assert agent.transport.malformed == count + 1
        bystanders.check()
        log = agent.said.getvalue()
        assert "(0x00000103)" in log and "speak micro-ROS" in log
        assert 1 <= log.count("malformed frame") <= 7


def test_frames_that_are_not_of_boards(server, host):
    for can_id in (1, REMOTE | EXTENDED | 1, REMOTE | 1):
        server.bus.send(FRAME.pack(can_id, 4, FDF, b"\3abc"))
    ready(host)
    assert host.received == [] and server.foreign == 3 and server.malformed == 0


@given(st.integers(0, 0xFFFFFFFF), st.integers(0, 255), st.integers(0, 255), st.binary(max_size=64))
def test_any_frame(can_id, length, flags, data):
    host = Host()
    server = CanServer("can0")
    server._host = host
    if can_id & EXTENDED:
        can_id_plain = can_id & 0x1FFFFFFF
    else:
        can_id_plain = can_id & 0x7FF
    frame = can.Message(
        arbitration_id=can_id_plain, is_extended_id=bool(can_id & EXTENDED),
        is_remote_frame=bool(can_id & REMOTE), is_error_frame=bool(can_id & ERROR), is_fd=True,
        data=data, check=False,
    )  # fmt: skip
    server._take(frame)
    if host.received:
        assert host.received == [(can_id_plain, data[1 : data[0] + 1])]
        assert len(host.received[0][1]) == data[0] > 0
    else:
        assert server.foreign + server.malformed == (0 if can_id & ERROR else 1)


def test_a_message_too_large_for_a_frame_is_lost_and_logged(server, host):
    for _ in range(9):
        server.send(0x123, bytes(64))
    server.send(0x123, b"abc")
    assert sent(server)[8:12] == b"\3abc" and server.dropped == 9
    notes = [note for note in host.notes if "message dropped" in note]
    assert len(notes) == 4 and "64 bytes for can0 (0x00000123): its MTU must be 63" in notes[0]


# --- a bus that comes, goes and fails -----------------------------------------------------------


def failing(server, name, number, count=1):
    """Make the next ``count`` calls of the bus raise python-can's exception for ``number``."""
    call, remaining = getattr(server._bus, name), [count]

    def fail(*args, **options):
        if remaining[0]:
            remaining[0] -= 1
            raise can.CanOperationError("Failed", number)
        return call(*args, **options)

    setattr(server._bus, name, fail)
    return remaining


def test_an_interface_that_does_not_exist_yet(host):
    can_server = KernelCan()
    can_server.missing = OSError(errno.ENODEV, "no such interface")
    can_server.open(host)
    for _ in range(3):
        assert host.due() == [module.RETRY]
    can_server.send(1, b"nobody hears it")
    can_server.missing = OSError(errno.ENETDOWN, "down")
    host.due()
    can_server.missing = None
    host.due()
    assert host.calls == []
    missing, down, running = host.notes
    assert missing.startswith("waiting for device: device: can0, there is no such interface")
    assert "ip link set can0 up type can bitrate 500000 dbitrate 2000000 fd on" in missing
    assert "the interface is down: sudo ip link set can0 up" in down
    assert running == "running...: device: can0, interface: socketcan"
    can_server.bus.send(FRAME.pack(EXTENDED | 1, 4, FDF, b"\3abc"))
    ready(host)
    assert host.received == [(1, b"abc")]
    can_server.close()
    can_server.close()


def test_an_interface_that_goes_down_and_comes_back(server, host):
    for number in (errno.ENETDOWN, errno.ENODEV):
        failing(server, "recv", number)
        ready(host)
        assert "device lost: device: can0, " in host.notes[-1] and "ip link" in host.notes[-1]
        assert server._bus is None and host.watched == {}
        server.send(1, b"lost")
        assert host.due() == [module.RETRY] and "running" in host.notes[-1]
    failing(server, "send", errno.ENXIO)
    server.send(1, b"lost")
    assert "device lost" in host.notes[-1] and host.due() == [module.RETRY]
    server.send(1, b"there")
    assert sent(server)[8:14] == b"\5there"


def test_an_interface_that_is_down_from_the_start_is_logged_once(host, monkeypatch):
    """The kernel allows to bind it; the first read fails."""
    can_server = KernelCan()
    make = can_server._make

    def make_down():
        bus = make()
        can_server._bus, bus_before = bus, can_server._bus
        failing(can_server, "recv", errno.ENETDOWN)
        can_server._bus = bus_before
        return bus

    monkeypatch.setattr(can_server, "_make", make_down)
    can_server.open(host)
    for _ in range(5):
        host.due()
    assert len(host.notes) == 1 and "the interface is down" in host.notes[0]
    monkeypatch.setattr(can_server, "_make", make)
    host.due()
    assert "running" in host.notes[-1]
    can_server.close()


def test_sessions_outlive_their_bus(monkeypatch):
    monkeypatch.setattr(module, "RETRY", 0.01)
    with running_agent("socketcan", "memory") as agent:
        client = XrceClient(agent.line(), 7)
        assert client.open() == ids.STATUS_OK
        failing(agent.transport, "recv", errno.ENETDOWN, 1)
        client.line.send(PING)
        wait_for(agent.said.getvalue, "running...", 2)
        client.line.fd = agent.transport.bus.fileno()
        assert client.ping() == 1 and len(agent.agent.clients) == 1


def test_a_full_queue_of_the_kernel_keeps_the_order(server, host):
    remaining = failing(server, "send", errno.ENOBUFS, 5)
    for i in range(20):
        server.send(1, bytes([i]))
    delays = []
    while remaining[0] or host.calls:
        delays += host.due()
    assert [sent(server)[9] for _ in range(20)] == list(range(20))
    assert delays[0] == 0.002 and delays == sorted(delays) and len(delays) == 5
    assert server.dropped == 0 and len(host.notes) == 1


def test_only_one_retry_is_scheduled_at_a_time(server, host):
    for _ in range(3):
        failing(server, "send", errno.ENOBUFS, 100)
        server.send(1, b"abc")
        failing(server, "recv", errno.ENETDOWN)
        ready(host)
        server._try()
    assert len([seconds for seconds, _ in host.calls if seconds != module.RETRY]) == 1


def test_a_bus_that_accepts_no_frames_for_long(server, host):
    remaining = failing(server, "send", errno.ENOBUFS, 1000)
    for i in range(module.MAX_UNSENT + 10):
        server.send(1, bytes([i & 0xFF]))
    assert server.dropped == 10
    while not any("the bus takes nothing: " in note for note in host.notes):
        (delay,) = host.due()
        assert delay <= 0.1
    assert "is another node on it" in host.notes[-1] and "link show can0" in host.notes[-1]
    assert server.dropped == module.MAX_UNSENT + 9
    for _ in range(50):
        host.due()
    assert sum("the bus takes nothing: " in note for note in host.notes) == 1
    remaining[0] = 0
    server.send(1, b"later")
    host.due()
    assert sent(server)[8:10] == b"\1\0" and sent(server)[8:14] == b"\5later"


def test_a_bus_without_can_fd(server, host):
    failing(server, "send", errno.EINVAL)
    server.send(1, b"abc")
    assert "not in CAN FD mode" in host.notes[-1] and "fd on" in host.notes[-1]
    server.send(1, b"def")
    assert sent(server)[8:12] == b"\3def" and server.dropped == 1


def test_an_interface_in_classic_mode_is_logged(host, monkeypatch):
    monkeypatch.setattr(module, "_mtu", lambda device: "16")
    can_server = KernelCan()
    can_server.open(host)
    assert "not in CAN FD mode" in host.notes[1] and "sudo ip link set can0 down;" in host.notes[1]
    can_server.close()


def test_bus_off_and_on_again(server, host):
    for error_class in (0x40, 0x40, 0x40, 0x04, 0x100, 0x100):
        server.bus.send(FRAME.pack(ERROR | error_class, 8, 0, b""))
    ready(host)
    off, on = host.notes[1:]
    assert "bus off: device: can0" in off and "type can restart" in off and "bus on again" in on
    assert server.malformed == server.foreign == 0


def test_a_driver_that_fails_in_its_own_way(monkeypatch):
    """Test over the bus in memory, which a thread reads."""
    monkeypatch.setattr(module, "RETRY", 0.01)
    with running_agent("can", "memory") as agent:
        client = XrceClient(agent.line(), 7)
        assert client.open() == ids.STATUS_OK
        bus = agent.transport._bus

        def fail(*_, **__):
            raise ZeroDivisionError("a driver's own fault")

        bus.send = fail
        client.line.send(PING)
        wait_for(agent.said.getvalue, "a driver's own fault")
        bus.recv = fail
        wait_for(agent.said.getvalue, "device lost")
        wait_for(agent.said.getvalue, "running...", 2)
        assert client.ping() == 1


# --- what cannot be opened ----------------------------------------------------------------------


def refused(server):
    host = Host()
    with pytest.raises(TransportError) as caught:
        server.open(host)
    assert host.calls == [] and host.watched == {}
    return caught.value.strerror


def test_without_python_can(monkeypatch):
    monkeypatch.setitem(sys.modules, "can", None)
    assert "python -m pip install python-can" in refused(CanServer("can0"))
    with pytest.raises(OSError, match="install python-can"):
        CanPort("can0").open()


def test_a_system_without_socketcan(monkeypatch):
    can_server = KernelCan()
    can_server.missing = OSError(errno.EAFNOSUPPORT, "Address family not supported by protocol")
    assert "modprobe can_raw" in refused(can_server)


def test_an_interface_of_python_can_that_does_not_exist():
    text = refused(CanServer("can0", "nonsense"))
    assert "nonsense" in text and "list of interfaces" in text


def test_options_that_a_driver_does_not_know():
    assert "TypeError" in refused(CanServer("x", "virtual", rx_queue_size=1, fd=1, config_context=1,
                                            ignore_config=2))  # fmt: skip


def test_errors_of_the_kernel_for_a_name():
    try:
        module.check_socketcan("no-such-can")
    except OSError as error:
        assert error.errno in (errno.ENODEV, errno.EAFNOSUPPORT)
    else:
        raise AssertionError("not refused")


# --- a board's port on a host -------------------------------------------------------------------


def test_a_port_ignores_foreign_frames_and_returns_the_others():
    port, second_bus = CanPort("uros-port", "virtual"), can.Bus("uros-port", interface="virtual")
    port.open()
    port.wait(1)
    assert port.recv() is None
    for options in ({"is_extended_id": False}, {"is_remote_frame": True}, {"is_error_frame": True}):
        second_bus.send(can.Message(arbitration_id=5, check=False, **options))
    second_bus.send(can.Message(arbitration_id=6, is_fd=True, data=b"\1x", check=False))
    payload = None
    deadline = time.monotonic() + SECONDS
    while payload is None and time.monotonic() < deadline:
        port.wait(100)
        payload = port.recv()
    assert payload[0] == 6 and bytes(payload[1]) == b"\1x"
    assert port.send(7, b"\1y") is True
    can_message = second_bus.recv(SECONDS)
    assert (
        can_message.arbitration_id == 7
        and can_message.is_extended_id
        and can_message.is_fd
        and not can_message.bitrate_switch
    )
    port.close()
    port.close()
    second_bus.shutdown()


def test_a_port_distinguishes_a_full_queue_from_a_lost_interface():
    port = CanPort("uros-port", "virtual")
    port.open()
    bus = port._bus
    port._bus = failing_bus = type("Bus", (), {})()
    for number, is_gone in ((errno.ENOBUFS, False), (None, False), (errno.ENETDOWN, True)):

        def fail(*_, **__):
            raise can.CanOperationError("Failed", number)  # noqa: B023

        failing_bus.send = failing_bus.recv = fail
        if is_gone:
            with pytest.raises(OSError):
                port.send(1, b"\1x")
        else:
            assert port.send(1, b"\1x") is False
        with pytest.raises(OSError):
            port.recv()
    port._bus = bus
    port.close()


def test_a_port_that_does_not_open():
    with pytest.raises(OSError, match="can0: "):
        CanPort("can0", "nonsense").open()
