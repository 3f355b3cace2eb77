"""UDP transport of a board through an ESP8266 or ESP32 with Espressif's AT firmware, on a UART.

    uart = UART(1, 115200, tx=Pin(4), rx=Pin(5), rxbuf=2048, timeout=0)
    transport = Esp8266Transport(uart, "network", "password", "192.168.1.10")

Runs on MicroPython. The UART's receive buffer (``rxbuf``) must hold what the agent sends while the
program does something else: otherwise bytes are lost, and the transport cannot tell which.
"""

import errno

from ..ticks import sleep_ms, ticks_add, ticks_diff, ticks_ms
from .at_modem import ERROR, OK, ModemTransport

try:
    from typing import Any, Final, Iterator

    from ..wire.cdr import Buffer
except ImportError:  # MicroPython
    pass

_CHUNK: Final = 256
_ENDS: Final = (OK, ERROR, b"FAIL", b"SEND OK", b"SEND FAIL")
_PROMPT: Final = b">"
_COMES: Final = b"+IPD,"
# Longest datagram; more than any firmware passes at once, so a larger length is noise.
_LONGEST: Final = 8192
# Longest gap within a datagram; after it bytes of the datagram are lost.
_GAP_MS: Final = 100

_QUICK_MS: Final = 1000  # for commands that only set something
_AT_MS: Final = 300
_WAKE: Final = 8  # attempts; a modem that was just switched on needs a second
_JOIN_MS: Final = 20000  # the firmware itself gives up after 15 s
_LINK_MS: Final = 10000
_SEND_MS: Final = 3000
_FAILS: Final = 3  # consecutive datagrams that the modem fails to send

_WHY_NOT: Final = {
    b"1": "the access point does not answer in time: is the password right, and it in reach?",
    b"2": "the password is wrong",
    b"3": "there is no such access point: check the name, and that it is in reach on 2.4 GHz",
    b"4": "the access point refuses",
}


class Esp8266Transport(ModemTransport):
    """UDP transport through an ESP8266 or ESP32; see :class:`~.at_modem.ModemTransport`.

    The dialogue with the modem never blocks. A modem that is still in its network does not join
    again. A modem that another program left in the middle of a datagram is recovered by filling up
    that datagram, which the agent drops.

    Args:
        uart: Reads and writes without waiting, as MicroPython's UART with ``timeout=0``, and may
            have ``wait(timeout_ms)``, ``open()`` and ``close()``.
        ssid: The network's name, 1 to 32 bytes.
        password: The network's password.
        host: The agent's host.
        port: The agent's port.
        mtu: The largest message, up to 1460 bytes.
        room: Bytes of the send queue.
        local_port: The board's port, 0 for any.
        setup: Commands to send before joining, such as ``AT+CWDHCP=1,1``.
    """

    def __init__(
        self, uart: "Any", ssid: str, password: str, host: str, port: int = 8888,
        mtu: int = 512, room: int = 2048, local_port: int = 0, setup: "tuple[str, ...]" = (),
    ) -> None:  # fmt: skip
        if not 0 < mtu <= 1460:
            raise ValueError("mtu must be 1 to 1460: what one datagram of the modem holds")
        if not 0 < len(ssid.encode()) <= 32:
            raise ValueError("a network's name has 1 to 32 bytes")
        super().__init__(mtu, room)
        self.port = uart
        self._ssid = ssid
        self._password = password
        self._agent = (host, port, local_port)
        self._setup = setup
        self._last = 0  # when bytes were last received
        self._fails = 0

    def _open(self) -> None:
        self._fails = 0
        if hasattr(self.port, "open"):
            self.port.open()

    def _close(self) -> None:
        # Not during a command: then the next open closes the link.
        if self.linked and not self._to and not self._gone:
            try:
                self.port.write(b"AT+CIPCLOSE\r\n")
            except OSError:
                pass
        if hasattr(self.port, "close"):
            self.port.close()

    def _wait(self, ms: int) -> None:
        if hasattr(self.port, "wait"):
            # Short waits during a dialogue, which has timeouts, and while messages are queued.
            self.port.wait(ms if self.linked and not self._to else min(ms, 10))
        else:
            sleep_ms(1)

    # --- receiving ----------------------------------------------------------------------------

    def _read(self) -> bool:
        data = self.port.read(_CHUNK)
        now = ticks_ms()
        if not data:
            if self._left and ticks_diff(now, self._last) >= _GAP_MS:
                self._left = 0
                self.malformed += 1
            return False
        self._last = now
        self.feed(data)
        return True

    def feed(self, data: bytes) -> None:
        """Parse the modem's output, in pieces of any size."""
        at = 0
        while at < len(data):
            if self._left:
                at = self._data(data, at)
                continue
            char = data[at]
            at += 1
            if char == 0x3A:  # the colon behind a datagram's length
                size = self._length_of(bytes(self._line[: self._length]))
                if size:
                    self._length = 0
                    self._datagram(size)
                    continue
            elif not self._length:
                if char == 0x20:
                    continue
                if char == 0x3E:  # the prompt has no line end
                    self._ended(_PROMPT)
                    continue
            self._text(char)

    def _length_of(self, line: bytes) -> int:
        """Return the length of the datagram behind a line like ``+IPD,12``; 0 for other lines."""
        at = line.rfind(_COMES)
        if at < 0:
            return 0
        number = line[at + len(_COMES) :]
        size = 0
        for char in number:
            if not 0x30 <= char <= 0x39 or size > _LONGEST:
                return 0
            size = size * 10 + char - 0x30
        if size > _LONGEST:
            self.malformed += 1
            return 0
        return size

    def _ends(self, line: bytes) -> bool:
        return line in _ENDS or line.startswith(b"busy")

    def _event(self, line: bytes) -> bool:
        if line == b"ready":
            if self._awake:
                self._gone = "the modem has started anew: it may have too little current (300 mA)"
        elif self.linked and line == b"CLOSED":
            self._gone = "the modem has closed the link"
        elif self.linked and line == b"WIFI DISCONNECT":
            self._gone = "the modem has lost the network " + self._ssid
        else:
            return line.startswith(b"WIFI ")
        return True

    # --- the dialogue -------------------------------------------------------------------------

    def _put(self, data: "Buffer") -> "Any":
        view = memoryview(data)
        at = 0
        while at < len(view):
            at += self.port.write(view[at:]) or 0
            if at < len(view):
                yield

    def _wake(self) -> "Iterator[None]":
        """Repeat ``AT`` until the modem accepts commands."""
        for turn in range(_WAKE):
            if (yield from self._ask("AT", _AT_MS)):
                # Discard output of an earlier command.
                yield from self._settle(_AT_MS if turn else 20)
                return
            if turn == 0:
                # It may wait for the rest of a datagram. As commands, empty lines have no effect.
                yield from self._put(b"\r\n" * (self.mtu // 2 + 1))
                yield from self._settle(_AT_MS)
        raise OSError(
            errno.ENODEV,
            "the modem does not answer: check its power, that TX and RX are crossed, and its baud"
            " rate",
        )

    def _join(self) -> "Iterator[None]":
        host, port, local_port = self._agent
        yield from self._wake()
        self._awake = True
        yield from self._ask("ATE0", _QUICK_MS)
        yield from self._ask("AT+CIPCLOSE", _QUICK_MS)  # an ERROR without a link is ignored
        for command in ("AT+CWMODE=1", "AT+CIPMUX=0") + self._setup:
            if not (yield from self._ask(command, _QUICK_MS)):
                raise OSError(errno.EIO, "the modem refuses " + command)
        yield from self._ask("AT+CIPDINFO=0", _QUICK_MS)  # unknown to old firmware
        ssid = _quoted(self._ssid)
        yield from self._ask("AT+CWJAP?", _QUICK_MS)
        if not self._info.startswith(b"+CWJAP:" + ssid.encode()):
            command = "AT+CWJAP=%s,%s" % (ssid, _quoted(self._password))
            if not (yield from self._ask(command, _JOIN_MS)):
                why = "the modem does not say why"
                if self._info.startswith(b"+CWJAP:"):
                    why = _WHY_NOT.get(self._info[7:], why)
                raise OSError(
                    errno.EHOSTUNREACH, "the modem cannot join %s: %s" % (self._ssid, why)
                )
        command = 'AT+CIPSTART="UDP","%s",%d' % (host, port)
        if local_port:
            command += ",%d,0" % local_port
        if not (yield from self._ask(command, _LINK_MS)):
            why = "is it an address, and does the network have it?"
            if self._info == b"no ip":
                why = "the network has given the modem no address"
            raise OSError(
                errno.EHOSTUNREACH, "the modem finds no way to %s, port %d: %s" % (host, port, why)
            )

    def _send_first(self, size: int) -> "Iterator[None]":
        answer = yield from self._ask("AT+CIPSEND=%d" % size, _QUICK_MS, _PROMPT)
        if answer is None:
            yield from self._wake()  # a byte was lost in one of the directions
            self.dropped += 1
            return
        if not answer:
            raise OSError(errno.ENOTCONN, "the modem has no link to the agent any more")
        yield from self._put(self._first(size))
        end = ticks_add(ticks_ms(), _SEND_MS)
        while True:
            answer = yield from self._answer(end)
            if not answer.startswith(b"busy"):
                break
        if answer == b"SEND OK":
            self._fails = 0
            return
        self.dropped += 1
        if not answer:
            self.mute += 1
            yield from self._wake()
        self._fails += 1
        if answer == ERROR or self._fails == _FAILS:
            raise OSError(errno.EIO, "the modem gets rid of nothing: is it out of reach?")


def _quoted(text: str) -> str:
    """Return a text as the firmware expects it, with a backslash before special characters."""
    for char in ("\\", '"', ","):
        text = text.replace(char, "\\" + char)
    return '"%s"' % text
