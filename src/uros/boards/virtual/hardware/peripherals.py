"""Peripherals that can be attached to a virtual board: a modem on a UART or SPI bus, or a radio.

    esp8266:uart=1
    gs2200:spi=1,ready=P115,cs=P301
    wlan

Each takes ``ssid`` and ``password`` of the only access point in range (default: ``robots`` and
``secret99``). The network behind the access point is the host's own.
"""

from __future__ import annotations

import errno
import random
import socket
from collections.abc import Callable
from typing import ClassVar, Final, NamedTuple, Protocol

from ..modems.esp8266 import Esp8266
from ..modems.gs2200 import Gs2200
from ..modems.radio_network import HostRadioNetwork, RadioNetwork
from .clock import BoardClock
from .parts import Part
from .pins import Pin

SSID: Final = "robots"
PASSWORD: Final = "secret99"
_JOIN_MS: Final = 300
_GUEST_MS: Final = 500
_BITS: Final = 10  # of an octet on a UART
_TXBUF: Final = 256
# A UART reads a rate that is so far off, in percent; beyond, it reads bits wrong.
_TOLERANCE: Final = 3
# The period at which a wait polls a line that cannot tell when there is something to read.
_POLL_US: Final = 1_000
# machine.SPI's polarity and phase, as one number.
_MODE_1: Final = 1


class PeripheralError(ValueError):
    """There is no such peripheral, or no such place for it; the text lists the known ones."""


class Modem(Protocol):
    """The device on a UART."""

    def read(self, size: int) -> bytes | None:
        """Return at most ``size`` octets from the device; None if there are none."""
        ...

    def write(self, data: bytes) -> int:
        """Send octets to the device; return how many it took."""
        ...


class Cable(Modem, Protocol):
    """A device whose baud rate may change while the board runs."""

    @property
    def baud(self) -> int:
        """Its baud rate; 0 if no program has set one."""

    def any(self) -> int:
        """Return how many octets there are to read."""

    def wait(self, seconds: float) -> object:
        """Wait until there may be octets to read, for so many seconds of the host at most."""


class UartPins(NamedTuple):
    """The pins of a UART by their names."""

    tx: str
    rx: str

    def __str__(self) -> str:
        return f"tx={self.tx}, rx={self.rx}"


class Uart:
    """A UART of a board, and a line with a baud rate.

    ``overruns`` counts the octets lost because the receive buffer was full. ``chosen_pins`` are the
    pins that the program uses; where they are not those of the device, nothing arrives.

    Args:
        device: The device at the other end.
        baud: Its baud rate, and that of the UART until :meth:`init`.
        clock: The board's clock.
        cable: The device again, if its baud rate may change.
        pins: The pins that the device is connected to; None if it is connected to any.
        default_pins: The pins of a program that names none; None: ``pins``.
    """

    def __init__(
        self, device: Modem, baud: int, clock: BoardClock, cable: Cable | None = None,
        pins: UartPins | None = None, default_pins: UartPins | None = None,
    ) -> None:  # fmt: skip
        self.overruns = 0
        self.pins = pins
        self._default_pins = default_pins or pins or UartPins("", "")
        self._device = device
        self._device_baud = baud
        self._cable = cable
        self._clock = clock
        self._random = random.Random(baud)
        self.init(baud, 256)

    def init(self, baud: int, rxbuf: int, tx: str = "", rx: str = "") -> None:
        """Set baud rate, receive buffer and pins.

        With another baud rate than the device's, both ends receive noise.

        Args:
            baud: The baud rate.
            rxbuf: The size of the receive buffer.
            tx: The pin to send at, "" for the default.
            rx: The pin to receive at, "" for the default.
        """
        if not 300 <= baud <= 4_000_000 or not rxbuf:
            raise ValueError(f"no UART has {baud} baud and {rxbuf} octets")
        self._baud = baud
        self._rxbuf = rxbuf
        self.chosen_pins = UartPins(tx or self._default_pins.tx, rx or self._default_pins.rx)
        self._received = bytearray()
        self._unsent = bytearray()
        self._at = self._clock.world_us()

    @property
    def sends(self) -> bool:
        """Whether the device is connected to the pin to send at."""
        return self.pins is None or self.pins.tx == self.chosen_pins.tx

    @property
    def receives(self) -> bool:
        """Whether the device is connected to the pin to receive at."""
        return self.pins is None or self.pins.rx == self.chosen_pins.rx

    def rates(self) -> tuple[int, int]:
        """Return the baud rates of the UART and of the device."""
        device = self._device_baud if self._cable is None else self._cable.baud
        return self._baud, device or self._baud

    def understood(self) -> bool:
        """Return whether the rates of both ends are close enough for data instead of noise."""
        own, device = self.rates()
        return abs(own - device) * 100 <= device * _TOLERANCE

    def _noise(self, octets: bytes) -> bytes:
        if not octets or self.understood():
            return octets
        return self._random.randbytes(len(octets))

    def _move(self) -> None:
        """Transfer what the line has carried by now."""
        count = (self._clock.world_us() - self._at) * self._baud // (_BITS * 1_000_000)
        if not count:
            return
        self._at += count * _BITS * 1_000_000 // self._baud
        if self._unsent:
            if self.sends:
                self._device.write(self._noise(bytes(self._unsent[:count])))
            del self._unsent[:count]
        octets = self._noise(self._device.read(count) or b"")
        if not self.receives:
            return
        room = self._rxbuf - len(self._received)
        self.overruns += max(0, len(octets) - room)
        self._received += octets[:room]

    def any(self) -> int:
        """Return how many octets can be read."""
        self._move()
        return len(self._received)

    def read(self, size: int) -> bytes:
        """Read at most ``size`` octets."""
        self._move()
        octets = bytes(self._received[:size])
        del self._received[:size]
        return octets

    def write(self, data: bytes) -> int:
        """Write octets; return how many fitted into the buffer."""
        self._move()
        accepted = data[: _TXBUF - len(self._unsent)]
        self._unsent += accepted
        return len(accepted)

    def under_way(self) -> int:
        """Return how many octets a `Cable` has that the line has not carried yet.

        At most as many as leave half of the receive buffer free.
        """
        if self._cable is None:
            return 0
        room = self._rxbuf // 2 - len(self._received)
        return max(0, min(room, self._cable.any()))

    def pause(self, us: int) -> None:
        """Wait for octets, or until the line has carried those under way.

        A `Cable` tells when there are any; other devices are polled.

        Args:
            us: The longest time to wait, in true microseconds.
        """
        octets = max(len(self._unsent), self.under_way())
        if octets:
            self._clock.sleep_world_us(min(us, octets * _BITS * 1_000_000 // self._baud + 1))
        elif self._cable is None:
            self._clock.sleep_world_us(min(us, _POLL_US))
        else:
            self._cable.wait(self._clock.host_seconds(us))
            self._at = self._clock.world_us()  # the octets that ended the wait begin to come now


class Spi:
    """An SPI bus of a board with one device on it, which receives only while ``selected``."""

    def __init__(self, device: Gs2200) -> None:
        self.selected = True
        self._device = device
        self._mode = -1

    def init(self, mode: int) -> None:
        """Set polarity and phase, as one number; the device answers only in mode 1."""
        self._mode = mode

    def write(self, data: bytes) -> None:
        """Write octets to the device."""
        if self.selected and self._mode == _MODE_1:
            self._device.write(data)

    def read(self, count: int, octet: int) -> bytes:
        """Read ``count`` octets while sending ``octet``; 0xFF where no device answers."""
        into = bytearray(b"\xff" * count)
        if self.selected and self._mode == _MODE_1:
            self._device.readinto(into, octet)
        return bytes(into)


class Radio:
    """The board's own radio, as ``network.WLAN`` uses it, and the sockets on it.

    One computer, this host, joins its access point 500 ms after the access point has started.
    """

    IDLE, CONNECTING, WRONG_PASSWORD, NO_AP_FOUND, GOT_IP = range(5)

    def __init__(self, network: HostRadioNetwork, ms: Callable[[], int]) -> None:
        self.faults: set[str] = set()
        self.own = ("", "")  # SSID and password of its access point
        self._started: int | None = None
        self._network = network
        self._ms = ms
        self._wanted: tuple[str, str] | None = None
        self._ready = 0
        self._sockets: dict[int, socket.socket] = {}
        self._last = 0

    def connect(self, ssid: str, password: str) -> None:
        """Start to join a network."""
        self._wanted = (ssid, password)
        self._ready = self._ms() + _JOIN_MS

    def disconnect(self) -> None:
        """Leave the network."""
        self._wanted = None

    def status(self) -> int:
        """Return the state of the connection: IDLE to GOT_IP."""
        if self._wanted is None:
            return self.IDLE
        if self._ms() < self._ready or "deaf" in self.faults:
            return self.CONNECTING
        ssid, password = self._wanted
        if ssid not in self._network.access_points or "lost" in self.faults:
            return self.NO_AP_FOUND
        return self.GOT_IP if self._network.access_points[ssid] == password else self.WRONG_PASSWORD

    def start(self, ssid: str, password: str) -> None:
        """Start the access point.

        Raises:
            ValueError: The name or the password has an invalid length.
        """
        if not 1 <= len(ssid) <= 32 or password and not 8 <= len(password) <= 63:
            raise ValueError("no access point has such a name or password")
        if self._started is None or self.own != (ssid, password):
            self._started = self._ms()
        self.own = (ssid, password)

    def stop(self) -> None:
        """Stop the access point."""
        self._started = None

    def guests(self) -> int:
        """Return the number of stations that have joined the board's access point."""
        if self._started is None or self.faults & {"lost", "alone", "deaf"}:
            return 0
        return int(self._ms() - self._started >= _GUEST_MS)

    def reset(self) -> None:
        """Handle a reset of the board: leave all networks and close all sockets."""
        self._wanted = None
        self._started = None
        for handle in list(self._sockets):
            self.close(handle)

    # --- sockets ------------------------------------------------------------------------------

    def open(self, kind: int) -> int:
        """Open a socket and return its handle.

        Raises:
            OSError: 16 sockets are open, or the host cannot open one.
        """
        if len(self._sockets) == 16:
            raise OSError(errno.ENOMEM, "a board has no room for more sockets")
        self._last = self._last % 250 + 1
        while self._last in self._sockets:
            self._last = self._last % 250 + 1
        self._sockets[self._last] = self._socket(
            socket.SOCK_DGRAM if kind == 2 else socket.SOCK_STREAM, 0
        )
        return self._last

    def _socket(self, kind: socket.SocketKind, port: int) -> socket.socket:
        sock = socket.socket(socket.AF_INET, kind)
        try:
            sock.setblocking(False)
            if self._network.address or port:
                sock.bind((self._network.address, port))
        except BaseException:
            sock.close()
            raise
        return sock

    def bind(self, handle: int, port: int) -> None:
        """Have a socket send from a port; raise OSError as :meth:`of` and the host's socket do."""
        old = self.of(handle)
        self._sockets[handle] = self._socket(old.type, port)
        old.close()

    def of(self, handle: int) -> socket.socket:
        """Return the socket of a handle.

        Raises:
            OSError: There is no such socket (EBADF), or the board is in no network (EHOSTUNREACH).
        """
        if handle not in self._sockets:
            raise OSError(errno.EBADF, "no such socket")
        if self.status() != self.GOT_IP and not self.guests():
            raise OSError(errno.EHOSTUNREACH, "the board is in no network")
        return self._sockets[handle]

    def connect_socket(self, handle: int, host: str, port: int) -> None:
        """Connect a socket; raise OSError as :meth:`of` and the host's socket do."""
        self.of(handle).connect(self._network.route(host, port))

    def fd(self, handle: int) -> int:
        """Return the host's file descriptor of a socket; -1 if there is no such socket."""
        sock = self._sockets.get(handle)
        return -1 if sock is None else sock.fileno()

    def close(self, handle: int) -> None:
        """Close a socket; one that is not open is ignored."""
        sock = self._sockets.pop(handle, None)
        if sock is not None:
            sock.close()


# Momentary faults of a modem.
_MOMENTS: Final = {
    "reset": "its power is gone for a moment, as often as this is planted",
    "closed": "its link to the agent is closed, as often as this is planted",
    "chatty": "says lines that nobody has asked for, as often as this is planted",
}


class Peripheral(Part):
    """A peripheral that is attached to a board."""

    OF: ClassVar[dict[str, dict[str, str]]] = {
        "esp8266": {
            "dead": "has no power",
            "busy": "answers every command with busy",
            "full": "gets rid of no datagram",
            "stuck": "never asks for a datagram's octets",
            "lost": "its access point is switched off",
            **_MOMENTS,
        },
        "gs2200": {
            "dead": "has no power",
            "busy": "grants no transfer",
            "lost": "its access point is switched off",
            **_MOMENTS,
        },
        "wlan": {
            "lost": "the access point is switched off; the board's own one too",
            "deaf": "hears nobody: it joins no access point, and nobody joins its own",
            "alone": "nobody joins the board's own access point",
        },
    }

    def __init__(self, name: str, device: Esp8266 | Gs2200 | Radio, network: RadioNetwork) -> None:
        super().__init__(name)
        self.FAULTS = self.OF[name]  # type: ignore[misc]
        self.device = device
        self.network = network
        self._access_points = dict(network.access_points)

    def fault(self, kind: str) -> None:
        """Inject a fault; a momentary one is over when this returns."""
        device = self.device
        if kind in _MOMENTS and not isinstance(device, Radio):
            {
                "reset": device.reset,
                "closed": device.lose_link,
                "chatty": device.send_unsolicited,
            }[kind]()
            return
        device.faults.add(kind)
        if kind == "lost":
            self.network.access_points.clear()
            if not isinstance(device, Radio):
                device.lose_network()

    def active(self, kind: str) -> bool:
        """Return whether this fault is active."""
        return kind in self.device.faults

    def heal(self) -> None:
        """Clear all faults; the access points are on again."""
        self.device.faults.clear()
        self.network.access_points.update(self._access_points)

    def shows(self) -> str:
        """Return the network that the device is in."""
        device = self.device
        if not isinstance(device, Radio):
            return f"in {device.joined}" if device.joined else "in no network"
        if device.guests():
            return f"{device.own[0]}, one computer"
        return "in a network" if device.status() == Radio.GOT_IP else "in no network"

    def reset(self) -> None:
        """Reset a radio of the board's own; a modem is not affected by a reset of the board."""
        if isinstance(self.device, Radio):
            self.device.reset()

    def close(self) -> None:
        """Close the network, and the sockets of a radio."""
        self.network.close()
        self.reset()


class Sockets(Protocol):
    """The attributes of a board that `attach` needs."""

    clock: BoardClock
    address: str
    """The board's own address on this host, "" for any."""
    routes: dict[str, tuple[str, int]]
    """Real addresses of addresses in the board's network, by ``host:port``."""
    uarts: dict[int, Uart]
    spis: dict[int, Spi]
    pins: dict[str, Pin]
    radio: Radio | None


def attach(board: Sockets, spec: str) -> Peripheral:
    """Attach the peripheral of ``spec``; the module docstring has the syntax.

    Raises:
        PeripheralError: The peripheral is unknown, or an option is missing, unknown or invalid.
    """
    name, _, arguments = spec.partition(":")
    if name not in Peripheral.OF:
        raise PeripheralError(f"there is no plug {name!r}; there are {', '.join(Peripheral.OF)}")
    options = dict(part.partition("=")[::2] for part in arguments.split(",") if part)
    access_points = {options.pop("ssid", SSID): options.pop("password", PASSWORD)}
    network = HostRadioNetwork(access_points, routes=board.routes, address=board.address)

    def ms() -> int:
        return board.clock.world_us() // 1000

    def take(option: str, of: str) -> str:
        if option not in options:
            raise PeripheralError(f"{name} is on {of}: say which, like {name}:{option}=1")
        return options.pop(option)

    peripheral: Peripheral
    if name == "esp8266":
        baud = int(options.pop("baud", "115200"))
        modem = Esp8266(network, ms, join_ms=_JOIN_MS, answer_ms=2, send_ms=1)
        board.uarts[_number(take("uart", "a UART"), spec)] = Uart(modem, baud, board.clock)
        peripheral = Peripheral(name, modem, network)
    elif name == "gs2200":
        gs2200 = Gs2200(network, ms, key_ms=_JOIN_MS, join_ms=_JOIN_MS, answer_ms=2)
        bus = board.spis[_number(take("spi", "an SPI bus"), spec)] = Spi(gs2200)
        ready = take("ready", "a pin")
        board.pins[ready] = Pin(ready, "GS2200 ready", gs2200.value)
        if "cs" in options:
            cs = options.pop("cs")

            def select(level: int) -> None:
                bus.selected = not level

            board.pins[cs] = Pin(cs, "GS2200 select", driven=select)
            bus.selected = False
        peripheral = Peripheral(name, gs2200, network)
    else:
        board.radio = Radio(network, ms)
        peripheral = Peripheral(name, board.radio, network)
    if options:
        raise PeripheralError(f"{name} has no option {', '.join(options)}: {spec}")
    return peripheral


def _number(text: str, spec: str) -> int:
    if not text.isdecimal() or int(text) > 99:
        raise PeripheralError(f"{text!r} is no number of a bus: {spec}")
    return int(text)
