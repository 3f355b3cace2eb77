"""An ESP8266 with Espressif's AT firmware on a UART: AT commands and responses.

Implements what a UDP client in station mode needs, after Espressif's AT command reference. Two
dialects: ``"esp-at"`` is the firmware from 2.0 on, ``"nonos"`` the older one. Runs on MicroPython
too.
"""

try:
    from collections.abc import Callable
    from typing import Any, Final
except ImportError:  # MicroPython
    pass

from .modem import Modem

_EMPTY: Final = b""
_BUSY: Final = b"busy p...\r\n"
_MOST: Final = 8192  # octets: the largest datagram that CIPSEND accepts
_LONGEST_LINE: Final = 256


class Esp8266(Modem):
    """The modem, powered on. ``read`` and ``write`` are the board's end of the UART.

    Faults: ``dead`` neither sends nor receives; ``deaf`` ignores commands; ``busy`` responds
    "busy" to every command; ``full`` fails to send any datagram; ``stuck`` does not respond to
    CIPSEND; ``no_ip`` joins an access point without getting an address by DHCP.

    Args:
        network: The access points in range and the hosts behind them.
        ms: Returns the time in milliseconds.
        dialect: ``"esp-at"`` or ``"nonos"``.
        join_ms: How long joining an access point takes.
        answer_ms: How long the response to any other command takes.
        send_ms: How long sending a datagram takes.
    """

    def __init__(
        self, network: "Any", ms: "Callable[[], int]", dialect: str = "esp-at", join_ms: int = 0,
        answer_ms: int = 0, send_ms: int = 0,
    ) -> None:  # fmt: skip
        super().__init__(network, ms)
        self.dialect = dialect
        self.join_ms = join_ms
        self.answer_ms = answer_ms
        self.send_ms = send_ms
        self._station = False
        self._line = bytearray()  # the command received so far
        self._want = 0  # octets of a datagram that are still to be received
        self._datagram = bytearray()
        self._busy = _EMPTY  # the response to a command received now; empty: it is ready
        self._out = bytearray()

    # --- the board's end ----------------------------------------------------------------------

    def read(self, size: int) -> "bytes | None":
        """Return at most ``size`` octets that the modem has sent, None when there are none."""
        self._update()
        if not self._out:
            return None
        data = bytes(self._out[:size])
        self._out = self._out[size:]
        return data

    def any(self) -> int:
        """Return how many octets there are to read."""
        self._update()
        return len(self._out)

    def write(self, data: "Any") -> int:
        """Take octets that the board sends; return how many were taken: all."""
        if "dead" not in self.faults:
            for octet in bytes(data):
                self._receive(octet)
        return len(data)

    # --- events and faults --------------------------------------------------------------------

    def emit(self, text: bytes) -> None:
        """Send text that is not the response to a command."""
        if "dead" not in self.faults:
            self._out.extend(text)

    def reset(self) -> None:
        """Restart the modem after a loss of power.

        The boot loader sends at another baud rate, which reads as noise; then the modem is ready,
        without station mode and without an access point.
        """
        self._power_up()
        self._station = False
        self._line = bytearray()
        self._want = 0
        self._busy = _EMPTY
        self._out = bytearray()
        self.emit(b"\x00\x8c\xfe>\xe0l\x0c\x1c\r\x00\nready\x00l\r\n\r\nready\r\n")

    def lose_network(self) -> None:
        """Leave the access point because it was switched off."""
        if self.joined:
            self.joined = ""
            if self._drop_link():
                self.emit(b"CLOSED\r\n")
            self.emit(b"WIFI DISCONNECT\r\n")

    def send_unsolicited(self) -> None:
        """Send unsolicited result codes, and noise."""
        self.emit(b"\r\nWIFI GOT IP\r\n+STA_CONNECTED:\x00\xfe\r\n\r\n+TIME_UPDATED\r\n")

    def lose_link(self) -> None:
        """Close the UDP link, and stay with the access point."""
        if self._drop_link():
            self.emit(b"CLOSED\r\n")

    # --- inside -------------------------------------------------------------------------------

    def _update(self) -> None:
        """Send the responses that are due, and what was received from the network."""
        self._run_timers()
        while self.link is not None:
            data = self.link.recv()
            if data is None:
                return
            self.emit(b"\r\n+IPD," + str(len(data)).encode() + b":" + data)

    def _receive(self, octet: int) -> None:
        if self._want:
            self._datagram.append(octet)
            self._want -= 1
            if not self._want:
                self._send()
            return
        if self._echo and not self._busy:
            self.emit(bytes((octet,)))
        if octet != 10:
            if len(self._line) < _LONGEST_LINE:
                self._line.append(octet)
            return
        line = bytes(self._line)
        self._line = bytearray()
        if self._busy or "busy" in self.faults:
            self.emit(self._busy or _BUSY)
        elif line.endswith(b"\r"):
            try:
                self._command(line[:-1])
            except (ValueError, IndexError):  # invalid arguments
                self._answer(b"\r\nERROR\r\n")

    def _answer(self, text: bytes) -> None:
        self._busy = _BUSY
        self._after(self.answer_ms, lambda: self._done(text))

    def _done(self, text: bytes) -> None:
        self._busy = _EMPTY
        self.emit(text)

    def _command(self, line: bytes) -> None:
        if not line or "deaf" in self.faults:
            return
        self.commands.append(line)
        name, equals, argument = line.partition(b"=")
        ok = b"\r\nOK\r\n"
        if name in (b"AT", b"AT+CIPMUX", b"AT+CWDHCP"):
            self._answer(ok)
        elif name in (b"ATE0", b"ATE1"):
            self._echo = name == b"ATE1"
            self._answer(ok)
        elif name == b"AT+CIPDINFO" and self.dialect == "esp-at":
            self._answer(ok)
        elif name == b"AT+CWMODE" and argument == b"1":
            self._station = True
            self._answer(ok)
        elif name == b"AT+CWJAP?":
            response = b"No AP\r\n"
            if self.joined:
                response = b"+CWJAP:" + _quoted(self.joined) + b',"02:00:00:00:00:01",6,-51\r\n'
            self._answer(response + ok)
        elif name == b"AT+CWJAP" and equals and self._station:
            self._join(_texts(argument))
        elif name == b"AT+CIPCLOSE":
            self._answer(b"CLOSED\r\n" + ok if self._drop_link() else b"\r\nERROR\r\n")
        elif name == b"AT+CIPSTART" and equals:
            self._start(_texts(argument))
        elif name == b"AT+CIPSEND" and equals:
            self._begin(argument)
        else:
            self._answer(b"\r\nERROR\r\n")

    def _join(self, texts: "list[str]") -> None:
        ssid, password = texts[0], texts[1]
        if self.joined:
            self.joined = ""
            self._drop_link()
            self.emit(b"WIFI DISCONNECT\r\n")
        self._busy = _BUSY

        def end() -> None:
            self._busy = _EMPTY
            code = 0
            if ssid not in self.network.access_points:
                code = 3
            elif self.network.access_points[ssid] != password:
                code = 2
            if code:
                word = b"ERROR" if self.dialect == "esp-at" else b"FAIL"
                self.emit(b"+CWJAP:" + str(code).encode() + b"\r\n\r\n" + word + b"\r\n")
                return
            self.joined = ssid
            self.emit(b"WIFI CONNECTED\r\n")
            if "no_ip" not in self.faults:
                self.emit(b"WIFI GOT IP\r\n")
            self.emit(b"\r\nOK\r\n")

        self._after(self.join_ms, end)

    def _start(self, texts: "list[str]") -> None:
        if self.link is not None:
            self._answer(b"ALREADY CONNECTED\r\n\r\nERROR\r\n")
        elif not self.joined or "no_ip" in self.faults:
            self._answer(b"no ip\r\n\r\nERROR\r\n")
        elif texts[0] != "UDP":
            self._answer(b"\r\nERROR\r\n")
        else:
            local_port = int(texts[3]) if len(texts) > 3 else 0
            self.link = self.network.link(texts[1], int(texts[2]), local_port)
            if self.link is None:
                self._answer(b"DNS Fail\r\n\r\nERROR\r\n")
            else:
                self._answer(b"CONNECT\r\n\r\nOK\r\n")

    def _begin(self, argument: bytes) -> None:
        if "stuck" in self.faults:
            return
        if self.link is None:
            self._answer(b"link is not valid\r\n\r\nERROR\r\n")
        elif not argument.isdigit() or not 0 < int(argument) <= _MOST:
            self._answer(b"\r\nERROR\r\n")
        else:
            prompt = b"\r\nOK\r\n\r\n>" if self.dialect == "esp-at" else b"\r\nOK\r\n> "
            self._answer(prompt)
            self._datagram = bytearray()
            self._want = int(argument)

    def _send(self) -> None:
        data = bytes(self._datagram)
        self.emit(b"\r\nRecv " + str(len(data)).encode() + b" bytes\r\n")
        self._busy = b"busy s...\r\n"

        def end() -> None:
            self._busy = _EMPTY
            if self.link is None:
                self.emit(b"\r\nERROR\r\n" if self.dialect == "esp-at" else b"\r\nSEND FAIL\r\n")
            elif "full" in self.faults or not self.link.send(data):
                self.emit(b"\r\nSEND FAIL\r\n")
            else:
                self.emit(b"\r\nSEND OK\r\n")

        self._after(self.send_ms, end)


def _texts(arguments: bytes) -> "list[str]":
    """Split the arguments of a command, without their quotes and backslashes."""
    out: list[bytearray] = [bytearray()]
    quoted = False
    escaped = False
    for octet in arguments:
        if escaped:
            out[-1].append(octet)
            escaped = False
        elif octet == 0x5C:
            escaped = True
        elif octet == 0x22:
            quoted = not quoted
        elif octet == 0x2C and not quoted:
            out.append(bytearray())
        else:
            out[-1].append(octet)
    return [bytes(text).decode() for text in out]


def _quoted(text: str) -> bytes:
    for char in ("\\", '"', ","):
        text = text.replace(char, "\\" + char)
    return b'"' + text.encode() + b'"'
