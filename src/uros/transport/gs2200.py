"""UDP transport of a board through a GainSpan GS2200 on SPI, the modem of Spresense's Wi-Fi board.

    spi = SPI(1, baudrate=4000000, polarity=0, phase=1)
    transport = Gs2200Transport(spi, Pin("D27", Pin.IN), "network", "password", "192.168.1.10")

Runs on MicroPython. The modem sets a pin, its GPIO37, when it has output. Each transfer is
requested by a header of eight bytes and granted by another::

    A5 class 00 00 00 length(2) checksum      class 01 11 03: write request, granted, data
                                                    02 12 15: read request, granted, data
                                                       13 14: not now

After these headers follow commands and their answers, as text, and datagrams in escape sequences::

    ESC Z cid length(4 digits) data                           both ways
    ESC y cid address ' ' port TAB length(4 digits) data      from the modem, with the sender
    ESC F                                                     there is no such link
"""

import errno

from ..ticks import sleep_ms, ticks_add, ticks_diff, ticks_ms, ticks_us
from .at_modem import ERROR, OK, ModemTransport

try:
    from typing import Any, Final, Iterator

    from ..wire.cdr import Buffer
except ImportError:  # MicroPython
    pass

_START: Final = 0xA5
_IDLE: Final = 0xF5
_WRITE: Final = 0x01
_READ: Final = 0x02
_DATA_OUT: Final = 0x03
_MAY_WRITE: Final = 0x11
_MAY_READ: Final = 0x12
_NOT_NOW: Final = (0x13, 0x14)
_MOST: Final = 1500  # bytes in one transfer
_CHUNK: Final = 128
# Wait before reading an answer: the pin can still be high from before the request.
_ANSWER_US: Final = 100
_NOT_NOW_MS: Final = 10
_READY_MS: Final = 2000

_ESC: Final = 0x1B
_FAILED: Final = b"\x1bF"
# States of the parser: text, behind ESC, the sequence's head up to its length, its sender.
_TEXT: Final = 0
_LETTER: Final = 1
_HEAD: Final = 2
_SENDER: Final = 3
_DIGITS: Final = 5  # the link's letter and four digits

_QUICK_MS: Final = 2000
_AT_MS: Final = 500
_WAKE: Final = 6
_KEY_MS: Final = 20000  # the modem computes the network's key
_JOIN_MS: Final = 30000
_FAILS: Final = 3


class Gs2200Transport(ModemTransport):
    """UDP transport through a GS2200; see :class:`~.at_modem.ModemTransport`.

    The dialogue with the modem blocks only for transfers on the bus. A modem that is still in its
    network does not join again.

    Args:
        spi: A bus in mode 1 (``polarity=0, phase=1``) with ``write`` and ``readinto``.
        ready: The pin connected to GPIO37.
        ssid: The network's name, 1 to 32 bytes.
        password: The network's password.
        host: The agent's address; the modem cannot resolve names.
        port: The agent's port.
        client_port: The board's port.
        cs: The pin that selects the modem, low during a transfer, or None if the bus does that.
        mtu: The largest message, up to 1400 bytes.
        room: Bytes of the send queue.
        setup: Commands to send before joining, such as ``AT+WREGDOMAIN=2`` (Japan).
    """

    def __init__(
        self, spi: "Any", ready: "Any", ssid: str, password: str, host: str, port: int = 8888,
        client_port: int = 10001, cs: "Any" = None, mtu: int = 512, room: int = 2048,
        setup: "tuple[str, ...]" = (),
    ) -> None:  # fmt: skip
        if not 0 < mtu <= 1400:
            raise ValueError("mtu must be 1 to 1400: what one datagram of the modem holds")
        if not 0 < len(ssid.encode()) <= 32:
            raise ValueError("a network's name has 1 to 32 bytes")
        for text in (ssid, password):
            if "," in text or '"' in text:
                raise ValueError(
                    "the modem takes no comma or quotation mark in the network's name or password"
                )
        parts = host.split(".")
        if len(parts) != 4 or not all([part.isdigit() and int(part) < 256 for part in parts]):
            raise ValueError("host must be an address like 192.168.1.10: the modem knows no names")
        super().__init__(mtu, room)
        self._spi = spi
        self._ready = ready
        self._cs = cs
        self._ssid = ssid
        self._password = password
        self._agent = (host, port, client_port)
        self._setup = setup
        self._header = bytearray(8)
        self._chunk = bytearray(_CHUNK)
        self._asked: "int | None" = None  # when a read was requested
        self._writing = False  # the pin announces the answer to a write request
        self._escape = _TEXT
        self._from_agent = False  # the datagram being received is from the agent
        self._joined = 0
        self._cid = 0
        self._fails = 0
        if cs is not None:
            cs.value(1)

    def _open(self) -> None:
        self._asked = None
        self._writing = False
        self._escape = _TEXT
        self._fails = 0

    # --- the bus ------------------------------------------------------------------------------

    def _give(self, data: "Buffer") -> None:
        if self._cs is not None:
            self._cs.value(0)
        self._spi.write(data)
        if self._cs is not None:
            self._cs.value(1)

    def _fetch(self, into: "Buffer") -> None:
        if self._cs is not None:
            self._cs.value(0)
        self._spi.readinto(into, _IDLE)
        if self._cs is not None:
            self._cs.value(1)

    def _make(self, kind: int, size: int) -> None:
        h = self._header
        h[0] = _START
        h[1] = kind
        h[2] = h[3] = h[4] = 0
        h[5] = size & 0xFF
        h[6] = size >> 8
        h[7] = (kind + h[5] + h[6]) & 0xFF ^ 0xFF

    def _answered(self) -> "tuple[int, int]":
        """Return class and length of the modem's header; class 0 if it is malformed."""
        now = ticks_us()
        while ticks_diff(ticks_us(), now) < _ANSWER_US:
            pass
        h = self._header
        self._fetch(h)
        if h[0] != _START:
            self._resynchronize()
            return 0, 0
        return h[1], h[5] | h[6] << 8

    def _resynchronize(self) -> None:
        """Read all bytes that the modem may send, and send as many idle bytes as it may expect."""
        self.malformed += 1
        for _ in range(_MOST // _CHUNK + 1):
            self._fetch(self._chunk)

    def _read(self) -> bool:
        now = ticks_ms()
        if self._asked is None:
            if self._writing or not self._ready.value():
                return False
            self._make(_READ, _MOST)
            self._give(self._header)
            self._asked = now
        if not self._ready.value():
            if ticks_diff(now, self._asked) > _READY_MS:
                self._asked = None
                self._resynchronize()
            return False
        kind, size = self._answered()
        self._asked = None
        if kind != _MAY_READ:
            return False
        if not 0 < size <= _MOST:
            self._resynchronize()
            return False
        self._fetch(self._header)
        while size:
            count = min(size, _CHUNK)
            view = memoryview(self._chunk)[:count]
            self._fetch(view)
            self.feed(bytes(view))
            size -= count
        return True

    def _put(self, data: "Buffer", more: "Buffer" = b"") -> "Any":
        size = len(data) + len(more)
        end = ticks_add(ticks_ms(), _READY_MS)
        while ticks_diff(end, ticks_ms()) > 0:
            if self._asked is not None or self._ready.value():
                yield  # the modem's output is read first
                continue
            self._make(_WRITE, size)
            self._give(memoryview(self._header)[:4])
            if self._ready.value():  # set during the header: the modem ignores half a header
                yield
                continue
            self._give(memoryview(self._header)[4:])
            self._writing = True
            while not self._ready.value() and ticks_diff(end, ticks_ms()) > 0:
                yield
            if not self._ready.value():
                self._resynchronize()
                break
            kind, granted = self._answered()
            self._writing = False
            if kind == _MAY_WRITE and granted == size:
                self._make(_DATA_OUT, size)
                self._give(self._header)
                self._give(data)
                if len(more):
                    self._give(more)
                return True
            yield from self._pause(_NOT_NOW_MS)
        self._writing = False
        return False

    # --- receiving ----------------------------------------------------------------------------

    def feed(self, data: bytes) -> None:
        """Parse the modem's output, in pieces of any size."""
        at = 0
        while at < len(data):
            if self._left:
                at = self._data(data, at)
                continue
            char = data[at]
            at += 1
            if self._escape == _TEXT:
                if char == _ESC:
                    self._escape = _LETTER
                    self._length = 0
                else:
                    self._text(char)
            elif self._escape == _LETTER:
                self._escape = _TEXT
                if char == 0x5A or char == 0x48:  # Z, H
                    self._escape = _HEAD
                elif char == 0x79:  # y
                    self._escape = _SENDER
                elif char == 0x46:  # F
                    self._ended(_FAILED)
                    if self.linked:
                        self._gone = "the modem has no link to the agent any more"
            else:
                self._line[self._length] = char
                self._length += 1
                self._in_head(char)

    def _in_head(self, char: int) -> None:
        line = self._line
        if self._escape == _SENDER:
            if char == 9:  # TAB; the length follows, so keep the link's letter only
                sender = bytes(line[1 : self._length - 1])
                self._from_agent = sender == ("%s %d" % self._agent[:2]).encode()
                self._escape = _HEAD
                self._length = 1
            elif self._length == 32:
                self._no_head()
            return
        if self._length < _DIGITS:
            if self._length == 1:
                self._from_agent = True
            return
        size = 0
        for digit in line[1:_DIGITS]:
            if not 0x30 <= digit <= 0x39:
                self._no_head()
                return
            size = size * 10 + digit - 0x30
        self._escape = _TEXT
        self._length = 0
        if size:
            if not self._from_agent or line[0] != self._cid:
                self._datagram_for_others(size)
            else:
                self._datagram(size)

    def _no_head(self) -> None:
        self._escape = _TEXT
        self._length = 0
        self.malformed += 1

    def _datagram_for_others(self, size: int) -> None:
        """Skip a datagram."""
        self._size = self.mtu + 1
        self._left = size

    def _ends(self, line: bytes) -> bool:
        return line == OK or line.startswith(ERROR) or line.startswith(b"INVALID ")

    def _event(self, line: bytes) -> bool:
        if b"WSTATE=CONNECTED" in line:
            self._joined |= 1
        if b'SSID="' + self._ssid.encode() + b'"' in line:
            self._joined |= 2
        if line.startswith(b"CONNECT ") and len(line) == 9:
            self._cid = line[8]
        elif self.linked and line.startswith(b"DISCONNECT ") and line[11] == self._cid:
            self._gone = "the modem has closed the link"
        elif line.startswith(b"Disassoc") or b"DISASSOCIATED" in line:
            if self.linked:
                self._gone = "the modem has lost the network " + self._ssid
        elif b"Serial2WiFi APP" in line or b"Reset" in line:
            if self._awake:
                self._gone = "the modem has started anew: check its power supply"
        else:
            return False
        return True

    # --- the dialogue -------------------------------------------------------------------------

    def _wake(self) -> "Iterator[None]":
        for turn in range(_WAKE):
            if (yield from self._ask("AT", _AT_MS)):
                yield from self._settle(_AT_MS if turn else 20)
                return
            if turn == 0:
                self._resynchronize()
                yield from self._settle(_AT_MS)
        raise OSError(
            errno.ENODEV,
            "the modem does not answer: check its power, the wires of SPI, and that the pin ready"
            " is its GPIO37",
        )

    def _join(self) -> "Iterator[None]":
        self._cid = self._joined = 0
        yield from self._wake()
        self._awake = True
        yield from self._ask("ATE0", _QUICK_MS)
        yield from self._ask("AT+NCLOSEALL", _QUICK_MS)
        for command in ("AT+BDATA=1",) + self._setup:
            yield from self._must(command)
        self._joined = 0
        yield from self._ask("AT+NSTAT=?", _QUICK_MS)
        if self._joined != 3:
            yield from self._ask("AT+WD", _QUICK_MS)
            yield from self._must("AT+WM=0")
            yield from self._must("AT+NDHCP=1")
            if self._password:
                command = "AT+WPAPSK=%s,%s" % (self._ssid, self._password)
                yield from self._must(command, _KEY_MS, "the password: 8 to 63 characters")
            if not (yield from self._ask("AT+WA=" + self._ssid, _JOIN_MS)):
                raise OSError(
                    errno.EHOSTUNREACH,
                    "the modem cannot join %s: is the password right, and the access point in reach"
                    " on 2.4 GHz?" % self._ssid,
                )
        answer = yield from self._ask("AT+NCUDP=%s,%d,%d" % self._agent, _QUICK_MS)
        if not answer or not self._cid:
            raise OSError(
                errno.EHOSTUNREACH, "the modem makes no link to %s, port %d" % self._agent[:2]
            )

    def _must(
        self, command: str, timeout_ms: int = _QUICK_MS, subject: str = ""
    ) -> "Iterator[None]":
        """Send a required command.

        Raises:
            OSError: The modem refuses it.
        """
        if not (yield from self._ask(command, timeout_ms)):
            raise OSError(errno.EIO, "the modem refuses " + (subject or command))

    def _send_first(self, size: int) -> "Iterator[None]":
        head = ("\x1bZ%s%04d" % (chr(self._cid), size)).encode()
        if (yield from self._put(head, self._first(size))):
            self._fails = 0
            return
        self.dropped += 1
        self.mute += 1
        self._fails += 1
        if self._fails == _FAILS:
            raise OSError(errno.EIO, "the modem takes nothing: check the wires of SPI")

    def _wait(self, ms: int) -> None:
        sleep_ms(1)
