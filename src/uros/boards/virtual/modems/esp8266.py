"""An ESP8266 with Espressif's AT firmware, on the other end of a UART: commands and what it says.

As far as a UDP client in station mode goes, after Espressif's command reference. Two dialects:
``"esp-at"`` is the firmware from 2.0 on, ``"nonos"`` the older one. Runs on MicroPython too.
"""

try:
    from collections.abc import Callable
    from typing import Any, Final
except ImportError:  # MicroPython
    pass

from .modem import Modem

_EMPTY: Final = b""
_BUSY: Final = b"busy p...\r\n"
_MOST: Final = 8192  # octets of one datagram to be sent
_LONGEST_LINE: Final = 256


class Esp8266(Modem):
    """The modem, switched on. ``read`` and ``write`` are the board's end of the UART.

    ``join_ms``, ``answer_ms`` and ``send_ms`` are how long it takes for what.

    Faults: ``dead`` says nothing and hears nothing; ``deaf`` hears no commands; ``busy`` is always
    busy; ``full`` gets rid of no datagram; ``stuck`` answers no CIPSEND; ``no_ip`` joins without
    DHCP.
    """

    def __init__(
        self, air: "Any", ms: "Callable[[], int]", dialect: str = "esp-at", join_ms: int = 0,
        answer_ms: int = 0, send_ms: int = 0,
    ) -> None:  # fmt: skip
        super().__init__(air, ms)
        self.dialect = dialect
        self.join_ms = join_ms
        self.answer_ms = answer_ms
        self.send_ms = send_ms
        self._station = False
        self._heard = bytearray()
        self._want = 0  # octets of a datagram that is still to come
        self._datagram = bytearray()
        self._busy = _EMPTY  # what it says to whoever disturbs it now
        self._out = bytearray()

    # --- the board's end ----------------------------------------------------------------------

    def read(self, size: int) -> "bytes | None":
        """What the modem says, as far as it has come."""
        self._work()
        if not self._out:
            return None
        some = bytes(self._out[:size])
        self._out = self._out[size:]
        return some

    def any(self) -> int:
        """How much there is to read."""
        self._work()
        return len(self._out)

    def write(self, data: "Any") -> int:
        """What the board says."""
        if "dead" not in self.faults:
            for octet in bytes(data):
                self._hear(octet)
        return len(data)

    # --- what happens to it -------------------------------------------------------------------

    def say(self, text: bytes) -> None:
        """Of its own accord."""
        if "dead" not in self.faults:
            self._out.extend(text)

    def reset(self) -> None:
        """Its power was gone for a moment. The loader talks at another baud rate, then it is
        ready, and nowhere.
        """
        self._forget()
        self._station = False
        self._heard = bytearray()
        self._want = 0
        self._busy = _EMPTY
        self._out = bytearray()
        self.say(b"\x00\x8c\xfe>\xe0l\x0c\x1c\r\x00\nready\x00l\r\n\r\nready\r\n")

    def lose_network(self) -> None:
        """The access point is switched off."""
        if self.joined:
            self.joined = ""
            if self._drop_link():
                self.say(b"CLOSED\r\n")
            self.say(b"WIFI DISCONNECT\r\n")

    def chat(self) -> None:
        """Lines that nobody has asked for, and noise."""
        self.say(b"\r\nWIFI GOT IP\r\n+STA_CONNECTED:\x00\xfe\r\n\r\n+TIME_UPDATED\r\n")

    def lose_link(self) -> None:
        """The link alone is gone."""
        if self._drop_link():
            self.say(b"CLOSED\r\n")

    # --- inside -------------------------------------------------------------------------------

    def _work(self) -> None:
        """What is due, and what has come from the network."""
        self._do_due()
        while self.link is not None:
            data = self.link.recv()
            if data is None:
                return
            self.say(b"\r\n+IPD," + str(len(data)).encode() + b":" + data)

    def _hear(self, octet: int) -> None:
        if self._want:
            self._datagram.append(octet)
            self._want -= 1
            if not self._want:
                self._send()
            return
        if self._echo and not self._busy:
            self.say(bytes((octet,)))
        if octet != 10:
            if len(self._heard) < _LONGEST_LINE:
                self._heard.append(octet)
            return
        line = bytes(self._heard)
        self._heard = bytearray()
        if self._busy or "busy" in self.faults:
            self.say(self._busy or _BUSY)
        elif line.endswith(b"\r"):
            try:
                self._command(line[:-1])
            except (ValueError, IndexError):  # arguments that are none
                self._answer(b"\r\nERROR\r\n")

    def _answer(self, text: bytes) -> None:
        self._busy = _BUSY
        self._after(self.answer_ms, lambda: self._done(text))

    def _done(self, text: bytes) -> None:
        self._busy = _EMPTY
        self.say(text)

    def _command(self, line: bytes) -> None:
        if not line or "deaf" in self.faults:
            return
        self.lines.append(line)
        name, equals, rest = line.partition(b"=")
        ok = b"\r\nOK\r\n"
        if name in (b"AT", b"AT+CIPMUX", b"AT+CWDHCP"):
            self._answer(ok)
        elif name in (b"ATE0", b"ATE1"):
            self._echo = name == b"ATE1"
            self._answer(ok)
        elif name == b"AT+CIPDINFO" and self.dialect == "esp-at":
            self._answer(ok)
        elif name == b"AT+CWMODE" and rest == b"1":
            self._station = True
            self._answer(ok)
        elif name == b"AT+CWJAP?":
            said = b"No AP\r\n"
            if self.joined:
                said = b"+CWJAP:" + _quoted(self.joined) + b',"02:00:00:00:00:01",6,-51\r\n'
            self._answer(said + ok)
        elif name == b"AT+CWJAP" and equals and self._station:
            self._join(_texts(rest))
        elif name == b"AT+CIPCLOSE":
            self._answer(b"CLOSED\r\n" + ok if self._drop_link() else b"\r\nERROR\r\n")
        elif name == b"AT+CIPSTART" and equals:
            self._start(_texts(rest))
        elif name == b"AT+CIPSEND" and equals:
            self._begin(rest)
        else:
            self._answer(b"\r\nERROR\r\n")

    def _join(self, texts: "list[str]") -> None:
        ssid, password = texts[0], texts[1]
        if self.joined:
            self.joined = ""
            self._drop_link()
            self.say(b"WIFI DISCONNECT\r\n")
        self._busy = _BUSY

        def end() -> None:
            self._busy = _EMPTY
            code = 0
            if ssid not in self.air.networks:
                code = 3
            elif self.air.networks[ssid] != password:
                code = 2
            if code:
                word = b"ERROR" if self.dialect == "esp-at" else b"FAIL"
                self.say(b"+CWJAP:" + str(code).encode() + b"\r\n\r\n" + word + b"\r\n")
                return
            self.joined = ssid
            self.say(b"WIFI CONNECTED\r\n")
            if "no_ip" not in self.faults:
                self.say(b"WIFI GOT IP\r\n")
            self.say(b"\r\nOK\r\n")

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
            self.link = self.air.link(texts[1], int(texts[2]), local_port)
            if self.link is None:
                self._answer(b"DNS Fail\r\n\r\nERROR\r\n")
            else:
                self._answer(b"CONNECT\r\n\r\nOK\r\n")

    def _begin(self, rest: bytes) -> None:
        if "stuck" in self.faults:
            return
        if self.link is None:
            self._answer(b"link is not valid\r\n\r\nERROR\r\n")
        elif not rest.isdigit() or not 0 < int(rest) <= _MOST:
            self._answer(b"\r\nERROR\r\n")
        else:
            prompt = b"\r\nOK\r\n\r\n>" if self.dialect == "esp-at" else b"\r\nOK\r\n> "
            self._answer(prompt)
            self._datagram = bytearray()
            self._want = int(rest)

    def _send(self) -> None:
        data = bytes(self._datagram)
        self.say(b"\r\nRecv " + str(len(data)).encode() + b" bytes\r\n")
        self._busy = b"busy s...\r\n"

        def end() -> None:
            self._busy = _EMPTY
            if self.link is None:
                self.say(b"\r\nERROR\r\n" if self.dialect == "esp-at" else b"\r\nSEND FAIL\r\n")
            elif "full" in self.faults or not self.link.send(data):
                self.say(b"\r\nSEND FAIL\r\n")
            else:
                self.say(b"\r\nSEND OK\r\n")

        self._after(self.send_ms, end)


def _texts(rest: bytes) -> "list[str]":
    """The arguments of a command, without their quotes and backslashes."""
    out: list[bytearray] = [bytearray()]
    quoted = False
    escaped = False
    for octet in rest:
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
    return [bytes(it).decode() for it in out]


def _quoted(text: str) -> bytes:
    for char in ("\\", '"', ","):
        text = text.replace(char, "\\" + char)
    return b'"' + text.encode() + b'"'
