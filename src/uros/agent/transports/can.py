"""CAN FD at the agent's end, over python-can: SocketCAN, and other adapters of python-can.

The frames are those of :mod:`uros.transport.can`. A peer is the identifier of its frames; answers
have the same one. An interface that is missing, down or unplugged is opened again and again, as
serial devices are.
"""

from __future__ import annotations

import errno
import os
import socket
from collections import deque
from pathlib import Path
from typing import Any, Final

from ...transport.can import MTU, can_frame
from .base import ERROR, INFO, MAX_BURST, WARNING, Host, ServerTransport, TransportError
from .fault_counter import FaultCounter
from .worker import Worker

# The time between two tries to open an interface, in seconds.
RETRY: Final = 0.5
# A bus has a short queue in the kernel (10 frames by default), and no event when it has room again.
# Sending is tried at this interval, in seconds, and less often while nothing is sent.
_AGAIN: Final = 0.002
_AGAIN_MOST: Final = 0.1
# A bus that takes no frame for so long is logged, and waiting frames are dropped, in seconds.
_STUCK: Final = 1.0
# Frames that wait for the bus; further messages are lost.
MAX_UNSENT: Final = 4096
# How long a driver may block on a frame, in seconds.
_SEND: Final = 0.5

# Errors of a send that may succeed later.
_FULL: Final = (None, errno.ENOBUFS, errno.EAGAIN, errno.EWOULDBLOCK)
CHANNEL_GONE: Final = (errno.ENETDOWN, errno.ENODEV, errno.ENXIO, errno.EBADF)
# Bits of a SocketCAN error frame's identifier.
_BUS_OFF: Final = 0x40
_RESTARTED: Final = 0x100
_CLASSIC_MTU: Final = "16"


class CanServer(ServerTransport):
    """A CAN FD bus.

    Attributes:
        malformed: Frames that are empty or shorter than their length field.
        foreign: Frames without an extended identifier or without data.
        dropped: Messages that could not be sent.

    Args:
        device: The interface, such as can0, or a channel of python-can's ``interface``.
        interface: The interface type of python-can.
        bitrate_switch: Send the data of a frame at the second bit rate; the C++ agent does not.
        options: Passed to python-can, such as the bit rates of an adapter without SocketCAN.
    """

    name = "CanAgent"
    kind = "CAN"
    mtu = MTU

    def __init__(
        self,
        device: str,
        interface: str = "socketcan",
        bitrate_switch: bool = False,
        **options: Any,
    ) -> None:
        super().__init__()
        self._device = device
        self._interface = interface
        self._switch = bitrate_switch
        self._options = options
        self._malformed = FaultCounter()
        self._dropped = FaultCounter()
        self.foreign = 0
        self._can: Any = None
        self._bus: Any = None
        self._fd = -1
        self._worker: Worker | None = None
        self._host: Host | None = None
        self._unsent: deque[Any] = deque()
        self._waited = 0.0  # how long the bus has taken nothing, about
        self._waiting = False  # for room
        self._stuck = False
        self._closed = False
        self._said = ""
        self._off = False

    @property
    def malformed(self) -> int:
        """Malformed frames so far."""
        return self._malformed.count

    @property
    def dropped(self) -> int:
        """Messages dropped so far."""
        return self._dropped.count

    def label(self) -> str:
        """Return what it listens on, as text."""
        return self._device

    def counters(self) -> dict[str, int]:
        """Return the counters."""
        names = ("malformed", "foreign", "dropped")
        return {**super().counters(), **{name: getattr(self, name) for name in names}}

    def is_waiting(self) -> bool:
        """Return whether the bus is not open."""
        return self._bus is None

    # --- reconnection --------------------------------------------------------------------

    def open(self, host: Host) -> None:
        """Open and start watching; raises TransportError."""
        self._host = host
        self._can = python_can()
        self._try(True)

    def _try(self, first: bool = False) -> None:
        if self._closed or self._bus is not None:
            return
        bus = None
        try:
            bus = self._make()
            waiting = bus.recv(0)  # fails if the interface is down
        except Exception as error:  # drivers raise what they like
            if bus is not None:
                self._shut(bus)
            text = self._trouble(error)
            if first and self._for_good(error):
                raise TransportError(_number(error), text) from error
            self._wait(error, text)
            return
        self._opened(bus)
        if waiting is not None:
            self._take(waiting)

    def _make(self) -> Any:
        kernel = self._interface == "socketcan"
        if kernel:
            check_socketcan(self._device)
        # Boards use extended identifiers. The kernel keeps the others from us.
        options = {
            "fd": True, "can_filters": [{"can_id": 0, "can_mask": 0, "extended": True}],
        } | self._options  # fmt: skip
        return self._can.Bus(
            channel=self._device, interface=self._interface, ignore_config=kernel, **options
        )

    def _for_good(self, error: Exception) -> bool:
        """Return whether trying again cannot help."""
        return (
            isinstance(error, (NotImplementedError, TypeError))
            or _number(error) in (errno.EAFNOSUPPORT, errno.EPROTONOSUPPORT)
        )  # fmt: skip

    def _opened(self, bus: Any) -> None:
        host = self._host
        assert host is not None
        self._bus = bus
        self._said = ""
        self._off = self._stuck = False
        try:
            self._fd = bus.fileno()
        except NotImplementedError:
            self._fd = -1
        if self._fd >= 0:
            host.watch(self._fd, self._drain)
        else:
            line = _BusLine(self, bus)
            line.worker = self._worker = Worker(
                host, self.name, line, lambda: None, self._take, self._ended
            )
        host.note(
            INFO, self.name, "init", "running...",
            f"device: {self._device}, interface: {self._interface}",
        )  # fmt: skip
        if self._interface == "socketcan" and _mtu(self._device) == _CLASSIC_MTU:
            host.note(
                WARNING, self.name, "init", "not in CAN FD mode",
                f"device: {self._device}, it does not take CAN FD frames: sudo ip link set"
                f" {self._device} down; {_up(self._device)}",
            )  # fmt: skip

    def _wait(self, error: BaseException, text: str) -> None:
        """Log a new reason once, and try again."""
        assert self._host is not None
        if text != self._said:
            self._said = text
            level = INFO if _number(error) in CHANNEL_GONE else ERROR
            event = "waiting for device" if level == INFO else "open device error"
            self._host.note(level, self.name, "init", event, f"device: {self._device}, {text}")
        self._host.wake_at(RETRY, self._try)

    def _lost(self, error: BaseException | None) -> None:
        """Note that the bus was lost, and try to open it again."""
        self._drop_bus()
        if self._closed or self._host is None:
            return
        self._host.note(
            WARNING, self.name, "receive", "device lost",
            f"device: {self._device}, {self._trouble(error)}; waiting for it to come back",
        )  # fmt: skip
        self._host.wake_at(RETRY, self._try)

    def _ended(self, error: BaseException | None) -> None:
        self._worker = None  # which has shut the bus down
        self._bus = None
        self._lost(error)

    def _drop_bus(self) -> None:
        bus, self._bus = self._bus, None
        self._unsent.clear()
        if self._fd >= 0:
            assert self._host is not None
            self._host.unwatch(self._fd)
            self._fd = -1
        if self._worker is not None:
            self._worker.stop()
            self._worker = None
        elif bus is not None:
            self._shut(bus)

    def _shut(self, bus: Any) -> None:
        try:
            bus.shutdown()
        except Exception:  # the bus may be lost already
            pass

    def _trouble(self, error: BaseException | None) -> str:
        """Explain an error, with its remedy."""
        number = _number(error)
        if self._interface == "socketcan":
            if number in (errno.ENODEV, errno.ENXIO):
                return (
                    "there is no such interface: plug the adapter in, see what there is:"
                    f" ip link; then: {_up(self._device)}"
                )
            if number == errno.ENETDOWN:
                return f"the interface is down: {_up(self._device)}"
            if number in (errno.EAFNOSUPPORT, errno.EPROTONOSUPPORT):
                return (
                    "this system has no SocketCAN: on Linux, sudo modprobe can_raw; elsewhere,"
                    " name another interface of python-can"
                )
        if isinstance(error, NotImplementedError):
            return f"{error}: see python-can's list of interfaces, and install what it needs"
        return f"errno: {number}, {error}" if number else f"{type(error).__name__}: {error}"

    # --- receiving -------------------------------------------------------------------------

    def _drain(self) -> None:
        for _ in range(MAX_BURST):
            bus = self._bus
            if bus is None:
                return
            try:
                message = bus.recv(0)
            except Exception as error:  # drivers raise what they like
                self._lost(error)
                return
            if message is None:
                return
            self._take(message)

    def _take(self, message: Any) -> None:
        host = self._host
        assert host is not None
        if message.is_error_frame:
            self._error_frame(message.arbitration_id)
            return
        if not message.is_extended_id or message.is_remote_frame:
            self.foreign += 1
            return
        data = message.data
        size = data[0] if data else 0
        # A length beyond the frame is refused. It makes the C++ agent crash.
        if not 0 < size < len(data):
            if self._malformed.add():
                host.note(
                    WARNING, self.name, "receive", "malformed frame",
                    f"{self.address(message.arbitration_id)}, {len(data)} bytes that say to hold"
                    f" {size}, malformed: {self.malformed} (a program that does not speak"
                    " micro-ROS on this bus?)",
                )  # fmt: skip
            return
        buf = bytearray(data[1 : size + 1])
        self.deliver(host, message.arbitration_id, buf, memoryview(buf), size, host.now())

    def _error_frame(self, error_class: int) -> None:
        if self._interface != "socketcan":
            return
        assert self._host is not None
        if error_class & _BUS_OFF and not self._off:
            self._off = True
            self._host.note(
                WARNING, self.name, "receive", "bus off",
                f"device: {self._device}, too many errors: check wiring, termination and bit rates;"
                f" to come back: sudo ip link set {self._device} type can restart, or have it"
                " done each time: restart-ms 100",
            )  # fmt: skip
        elif error_class & _RESTARTED and self._off:
            self._off = False
            self._host.note(INFO, self.name, "receive", "bus on again", f"device: {self._device}")

    # --- sending ---------------------------------------------------------------------------

    def send(self, peer: int, datagram: bytes) -> None:
        """Send one message; it is lost if it cannot be sent."""
        if self._bus is None:
            return
        if len(datagram) > MTU:
            self.drop(f"{len(datagram)} bytes for {self.address(peer)}: its MTU must be {MTU}")
        elif self._worker is not None:
            if not self._worker.send(datagram, peer):
                self.drop("the driver takes nothing")
        elif len(self._unsent) >= MAX_UNSENT:
            self.drop("the bus takes nothing")
        else:
            self._unsent.append(self.message(peer, datagram))
            if len(self._unsent) == 1:
                self._push()

    def message(self, peer: int, datagram: bytes) -> Any:
        """Return a message of python-can."""
        return self._can.Message(
            arbitration_id=peer, is_extended_id=True, is_fd=True, bitrate_switch=self._switch,
            data=can_frame(datagram), check=False,
        )  # fmt: skip

    def drop(self, why: str) -> None:
        """Count and log a lost message."""
        if self._dropped.add():
            assert self._host is not None
            self._host.note(
                WARNING, self.name, "send", "message dropped",
                f"device: {self._device}, {why}, dropped: {self.dropped}",
            )  # fmt: skip

    def _push(self) -> None:
        """Send as many frames as the bus takes now."""
        while self._unsent and self._bus is not None:
            try:
                self._bus.send(self._unsent[0], timeout=0)
            except Exception as error:  # drivers raise what they like
                number = _number(error)
                if number in CHANNEL_GONE:
                    self._lost(error)
                    return
                if number in _FULL:
                    self._wait_for_room()
                    return
                if number == errno.EINVAL:
                    self.drop(f"not in CAN FD mode: {_up(self._device)}")
                else:
                    self.drop(str(error))
            else:
                self._waited = 0.0
                self._stuck = False
            self._unsent.popleft()

    def _wait_for_room(self) -> None:
        if self._waiting:
            return
        assert self._host is not None
        delay = min(max(_AGAIN, self._waited), _AGAIN_MOST)
        self._waited += delay
        if self._waited >= _STUCK:
            self._give_up()
        self._waiting = True
        self._host.wake_at(delay, self._room)

    def _room(self) -> None:
        self._waiting = False
        self._push()

    def _give_up(self) -> None:
        """Drop old frames; one stays, to notice when the bus takes frames again."""
        while len(self._unsent) > 1:
            self._unsent.pop()
            self._dropped.add()
        if not self._stuck:
            self._stuck = True
            assert self._host is not None
            self._host.note(
                WARNING, self.name, "send", "the bus takes nothing",
                f"device: {self._device}, is another node on it, with the same bit rates, to"
                f" acknowledge? See: ip -details -statistics link show {self._device}",
            )  # fmt: skip

    def address(self, peer: int) -> str:
        """Return the peer as text."""
        return f"{self._device} (0x{peer:08X})"

    def close(self) -> None:
        """Close everything; idempotent."""
        self._closed = True
        self._drop_bus()


class _BusLine:
    """A bus that cannot be watched by a selector, for a Worker."""

    def __init__(self, server: CanServer, bus: Any) -> None:
        self._server = server
        self._bus = bus
        self.worker: Worker | None = None

    def open(self) -> None:
        """Do nothing: it is open."""

    def read(self, timeout: float) -> Any:
        return self._bus.recv(timeout)

    def write(self, data: bytes, peer: int) -> None:
        try:
            self._bus.send(self._server.message(peer, data), timeout=_SEND)
        except Exception as error:  # such as a full queue; a lost bus is reported by reading
            text = str(error)
            if self.worker is not None:
                self.worker.post(lambda: self._server.drop(text))

    def close(self) -> None:
        self._bus.shutdown()


def python_can() -> Any:
    """Import python-can; raises TransportError if it is not installed."""
    try:
        import can
    except ImportError as error:
        raise TransportError(
            errno.ENOENT, "CAN needs python-can: python -m pip install python-can"
        ) from error
    return can


def check_socketcan(device: str) -> None:
    """Raise OSError if there is no such interface, or no SocketCAN.

    python-can would print the error each time, and leave a socket open.
    """
    if not hasattr(socket, "AF_CAN"):
        raise OSError(errno.EAFNOSUPPORT, "no SocketCAN")
    socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    try:
        socket.if_nametoindex(device)
    except (OSError, ValueError):  # or an invalid name
        raise OSError(errno.ENODEV, "no such interface") from None


def _number(error: BaseException | None) -> int | None:
    """Return the errno of an error, if it has one."""
    number = getattr(error, "error_code", None) or getattr(error, "errno", None)
    return number if isinstance(number, int) else None


def _up(device: str) -> str:
    return (
        f"sudo ip link set {device} up type can bitrate 500000 dbitrate 2000000 fd on"
    )  # fmt: skip


def _mtu(device: str) -> str:
    try:
        return Path("/sys/class/net", os.path.basename(device), "mtu").read_text().strip()
    except OSError:
        return ""
