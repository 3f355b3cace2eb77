"""A GS2200 on the other end of an SPI bus: its transfers, its commands and what it says.

As far as a UDP client in station mode goes. The transfers and escape sequences are those that
Sony's driver in NuttX and the GS2200 library for Arduino rely on; where these two do not look, as
at the words of NSTAT, the model follows GainSpan's guide. Runs on MicroPython too.
"""

try:
    from collections.abc import Callable
    from typing import Any, Final
except ImportError:  # MicroPython
    pass

from .modem import Modem

_IDLE: Final = 0xF5
_OK: Final = b"\r\nOK\r\n"
_ERROR: Final = b"\r\nERROR\r\n"
_NO_SOCKET: Final = b"\r\nERROR: SOCKET FAILURE 1\r\n"


class Gs2200(Modem):
    """The modem, switched on, which is the SPI bus at the same time, and the pin of GPIO37.

    ``key_ms`` and ``join_ms`` are how long it takes for what, ``answer_ms`` for all else. With
    ``sender``, each datagram tells from whom. ``turn_ms`` is how long it takes to answer a request
    for a transfer.

    Faults: ``dead`` never raises its pin; ``busy`` grants no transfer; ``late`` gives idle octets
    where the first answer after a request should be.
    """

    def __init__(
        self, air: "Any", ms: "Callable[[], int]", key_ms: int = 0, join_ms: int = 0,
        answer_ms: int = 0, sender: bool = False, turn_ms: int = 0,
    ) -> None:  # fmt: skip
        super().__init__(air, ms)
        self.key_ms = key_ms
        self.join_ms = join_ms
        self.answer_ms = answer_ms
        self.sender = sender
        self.turn_ms = turn_ms
        self.transfers = 0  # that were granted
        self.broken = 0  # headers with a wrong checksum
        self._bulk = False
        self._key: tuple[str, str] | None = None
        self._heard = bytearray()  # of a header
        self._granted = 0  # octets of data, with their header, once the answer was read
        self._want = 0  # of these, still to come
        self._came = bytearray()
        self._answer = bytearray()  # to a request
        self._answer_at = 0
        self._data = bytearray()  # behind it
        self._said = bytearray()  # not fetched yet
        self._text = bytearray()  # a command so far

    # --- the bus and the pin ------------------------------------------------------------------

    def value(self, level: "int | None" = None) -> int:
        """GPIO37. High: an answer is there, or, while nothing else happens, something is said."""
        self._work()
        if "dead" in self.faults:
            return 0
        if self._answer:
            return int(self._ms() >= self._answer_at)
        return int(bool(self._said) and not self._heard and not self._want and not self._data)

    def write(self, data: "Any") -> None:
        """The controller sends."""
        for octet in bytes(data):
            self._hear(octet)

    def readinto(self, into: "Any", write: int = 0) -> None:
        """The controller reads, sending ``write`` meanwhile."""
        if "late" in self.faults and self._answer:
            self.faults.remove("late")
            self._answer = bytearray()
            self._data = bytearray()
            self._granted = 0
            for i in range(len(into)):
                into[i] = _IDLE
            return
        for i in range(len(into)):
            hears = self._want or self._heard
            into[i] = self._speak()
            if hears:
                self._hear(write)  # both ways at once

    def _speak(self) -> int:
        source = self._answer or self._data
        if not source:
            return _IDLE
        octet = source[0]
        if self._answer:
            self._answer = self._answer[1:]
            if not self._answer:
                self._want, self._granted = self._granted, 0
        else:
            self._data = self._data[1:]
        return octet

    # --- what happens to it -------------------------------------------------------------------

    def say(self, text: bytes) -> None:
        """Of its own accord."""
        self._said.extend(text)

    def reset(self) -> None:
        """Its power was gone for a moment."""
        self._forget()
        self._bulk = False
        self._key = None
        self._heard = bytearray()
        self._want = self._granted = 0
        self._came = bytearray()
        self._answer = bytearray()
        self._data = bytearray()
        self._said = bytearray()
        self._text = bytearray()
        self.say(b"\r\nSerial2WiFi APP\r\n")

    def chat(self) -> None:
        """Lines that nobody has asked for, and noise."""
        self.say(b"\r\nDHCP lease renewed\r\n\x00\xfe\r\nBeacon missed\r\n")

    def lose_link(self) -> None:
        """The link alone is gone."""
        if self._drop_link():
            self.say(b"\r\nDISCONNECT 0\r\n")

    def lose_network(self) -> None:
        """The access point is switched off."""
        if self.joined:
            self.joined = ""
            self._drop_link()
            self.say(b"\r\nDisassociation Event\r\n")

    # --- transfers ----------------------------------------------------------------------------

    def _hear(self, octet: int) -> None:
        if self._want:
            self._came.append(octet)
            self._want -= 1
            if not self._want:
                data = bytes(self._came[8:])
                self._came = bytearray()
                self._take(data)
            return
        if not self._heard and octet != 0xA5:
            return
        if len(self._heard) == 4 and octet == 0xA5:
            self._heard = bytearray()  # half a header, and then a new one
        self._heard.append(octet)
        if len(self._heard) == 8:
            head, self._heard = self._heard, bytearray()
            self._request(head)

    def _request(self, head: bytearray) -> None:
        total = 0
        for octet in head[1:7]:
            total += octet
        if head[7] != total & 0xFF ^ 0xFF:
            self.broken += 1
            return
        size = head[5] | head[6] << 8
        busy = "busy" in self.faults
        self._answer = bytearray()
        self._data = bytearray()
        self._granted = 0
        self._answer_at = self._ms() + self.turn_ms
        if head[1] == 1:
            self._answer = _header(0x13 if busy else 0x11, size)
            if not busy:
                self._granted = size + 8
                self.transfers += 1
        elif head[1] == 2:
            count = min(size, len(self._said))
            if busy or not count:
                self._answer = _header(0x14, 0)
                return
            self._answer = _header(0x12, count)
            self._data = _header(0x15, count) + self._said[:count]
            self._said = self._said[count:]
            if self._said:
                self._answer[4] = 1
                self._answer[7] = self._answer[7] - 1 & 0xFF

    # --- commands -----------------------------------------------------------------------------

    def _say_after(self, ms: int, text: bytes) -> None:
        self._after(ms, lambda: self.say(text))

    def _work(self) -> None:
        self._do_due()
        while self.link is not None and len(self._said) < 4000:
            data = self.link.recv()
            if data is None:
                return
            size = ("0000" + str(len(data)))[-4:].encode()
            if self.sender:
                head = b"\x1by0%s %d\t" % (self.link.where[0].encode(), self.link.where[1])
                self.say(head + size + data)
            else:
                self.say(b"\x1bZ0" + size + data)

    def _take(self, data: bytes) -> None:
        """What was written, as one transfer."""
        if data[:2] == b"\x1bZ":
            size = data[3:7]
            if self.link is None or data[2:3] != b"0" or not size.isdigit():
                self.say(b"\x1bF")
            else:
                self.link.send(data[7 : 7 + int(size)])
            return
        if self._echo:
            self.say(data)
        self._text.extend(data)
        while b"\n" in self._text:
            line, _, rest = bytes(self._text).partition(b"\n")
            self._text = bytearray(rest)
            try:
                self._command(line.strip())
            except (ValueError, IndexError):  # arguments that are none
                self._say_after(self.answer_ms, b"\r\nERROR: INVALID INPUT\r\n")

    def _command(self, line: bytes) -> None:
        self.lines.append(line)
        name, _, rest = line.partition(b"=")
        answer = self.answer_ms
        if name in (b"AT", b"AT+WM", b"AT+NDHCP", b"AT+WREGDOMAIN", b"AT+NCLOSEALL"):
            if name == b"AT+NCLOSEALL":
                self._drop_link()
            self._say_after(answer, _OK)
        elif name in (b"ATE0", b"ATE1"):
            self._echo = name == b"ATE1"
            self._say_after(answer, _OK)
        elif name == b"AT+BDATA":
            self._bulk = rest == b"1"
            self._say_after(answer, _OK)
        elif name == b"AT+NSTAT":
            state = b"WSTATE=NOT CONNECTED     MODE=NONE\r\n"
            if self.joined:
                state = b"WSTATE=CONNECTED     MODE=INFRASTRUCTURE\r\n"
                state += b'BSSID=02:00:00:00:00:01   SSID="' + self.joined.encode()
                state += b'" CHANNEL=6\r\nSECURITY=WPA2-PERSONAL  RSSI=-51\r\n'
            self._say_after(answer, b"MAC=02:00:00:00:00:07\r\n" + state + _OK)
        elif name == b"AT+WD":
            self._drop_link()
            self.joined = ""
            self._say_after(answer, _OK)
        elif name == b"AT+WPAPSK":
            ssid, _, password = rest.partition(b",")
            if 8 <= len(password) <= 63:
                self._key = (ssid.decode(), password.decode())
                self._say_after(self.key_ms, b"Computing PSK from SSID and PassPhrase...\r\n" + _OK)
            else:
                self._say_after(answer, b"\r\nERROR: INVALID INPUT\r\n")
        elif name == b"AT+WA":
            ssid_text = rest.decode()
            self._after(self.join_ms, lambda: self.say(self._join(ssid_text)))
        elif name == b"AT+NCUDP":
            host, port, local_port = rest.decode().split(",")
            if self.joined and self._bulk:
                self.link = self.air.link(host, int(port), int(local_port))
            made = self.link is not None
            self._say_after(answer, b"CONNECT 0\r\n" + _OK if made else _NO_SOCKET)
        else:
            self._say_after(answer, b"\r\nERROR: INVALID INPUT\r\n")

    def _join(self, ssid: str) -> bytes:
        if ssid not in self.air.networks or self._key != (ssid, self.air.networks[ssid]):
            return _ERROR
        self.joined = ssid
        return (
            b"    IP              SubNet         Gateway   \r\n"
            b" 192.168.1.99: 255.255.255.0: 192.168.1.1\r\n" + _OK
        )


def _header(kind: int, size: int) -> bytearray:
    low, high = size & 0xFF, size >> 8
    return bytearray((0xA5, kind, 0, 0, 0, low, high, (kind + low + high) & 0xFF ^ 0xFF))
