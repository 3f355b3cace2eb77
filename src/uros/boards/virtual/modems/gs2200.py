"""A GS2200 on an SPI bus: transfers, AT commands and responses.

Implements what a UDP client in station mode needs. The transfers and escape sequences are those
that Sony's driver in NuttX and the GS2200 library for Arduino rely on; where these two ignore a
response, such as the text of NSTAT, the model follows GainSpan's guide. Runs on MicroPython too.
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
    """The modem, powered on: the device on the SPI bus, and its pin GPIO37.

    Faults: ``dead`` never raises GPIO37; ``busy`` grants no transfer; ``late`` sends idle octets
    in place of the first response to a request.

    Args:
        network: The access points in range and the hosts behind them.
        ms: Returns the time in milliseconds.
        key_ms: How long the computation of the pre-shared key takes.
        join_ms: How long joining an access point takes.
        answer_ms: How long the response to any other command takes.
        sender: Whether each received datagram carries its sender's address.
        turn_ms: How long the response to a request for a transfer takes.
    """

    def __init__(
        self, network: "Any", ms: "Callable[[], int]", key_ms: int = 0, join_ms: int = 0,
        answer_ms: int = 0, sender: bool = False, turn_ms: int = 0,
    ) -> None:  # fmt: skip
        super().__init__(network, ms)
        self.key_ms = key_ms
        self.join_ms = join_ms
        self.answer_ms = answer_ms
        self.sender = sender
        self.turn_ms = turn_ms
        self.transfers = 0  # granted so far
        self.broken = 0  # headers received with a wrong checksum
        self._bulk = False
        self._key: tuple[str, str] | None = None
        self._head = bytearray()  # the header received so far
        self._granted = 0  # octets of data and header to receive once the response was read
        self._want = 0  # octets of these still to be received
        self._received = bytearray()
        self._answer = bytearray()  # the response to a request
        self._answer_at = 0
        self._data = bytearray()  # that follows the response
        self._out = bytearray()  # not fetched by the controller yet
        self._text = bytearray()  # the command received so far

    # --- the bus and the pin ------------------------------------------------------------------

    def value(self, level: "int | None" = None) -> int:
        """Return the level of GPIO37.

        High while the response to a request is ready, or, between transfers, while there is data
        to fetch.
        """
        self._update()
        if "dead" in self.faults:
            return 0
        if self._answer:
            return int(self._ms() >= self._answer_at)
        return int(bool(self._out) and not self._head and not self._want and not self._data)

    def write(self, data: "Any") -> None:
        """Take the octets that the controller sends."""
        for octet in bytes(data):
            self._receive(octet)

    def readinto(self, into: "Any", write: int = 0) -> None:
        """Fill ``into`` with what the modem sends; the controller sends ``write`` meanwhile."""
        if "late" in self.faults and self._answer:
            self.faults.remove("late")
            self._answer = bytearray()
            self._data = bytearray()
            self._granted = 0
            for i in range(len(into)):
                into[i] = _IDLE
            return
        for i in range(len(into)):
            receives = self._want or self._head
            into[i] = self._next_octet()
            if receives:
                self._receive(write)  # SPI is full duplex

    def _next_octet(self) -> int:
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

    # --- events and faults --------------------------------------------------------------------

    def emit(self, text: bytes) -> None:
        """Queue text for the controller to fetch."""
        self._out.extend(text)

    def reset(self) -> None:
        """Restart the modem after a loss of power."""
        self._power_up()
        self._bulk = False
        self._key = None
        self._head = bytearray()
        self._want = self._granted = 0
        self._received = bytearray()
        self._answer = bytearray()
        self._data = bytearray()
        self._out = bytearray()
        self._text = bytearray()
        self.emit(b"\r\nSerial2WiFi APP\r\n")

    def send_unsolicited(self) -> None:
        """Queue unsolicited lines, and noise."""
        self.emit(b"\r\nDHCP lease renewed\r\n\x00\xfe\r\nBeacon missed\r\n")

    def lose_link(self) -> None:
        """Close the link; the access point stays joined."""
        if self._drop_link():
            self.emit(b"\r\nDISCONNECT 0\r\n")

    def lose_network(self) -> None:
        """Leave the access point because it was switched off."""
        if self.joined:
            self.joined = ""
            self._drop_link()
            self.emit(b"\r\nDisassociation Event\r\n")

    # --- transfers ----------------------------------------------------------------------------

    def _receive(self, octet: int) -> None:
        if self._want:
            self._received.append(octet)
            self._want -= 1
            if not self._want:
                data = bytes(self._received[8:])
                self._received = bytearray()
                self._take(data)
            return
        if not self._head and octet != 0xA5:
            return
        if len(self._head) == 4 and octet == 0xA5:
            self._head = bytearray()  # the header was cut short, and a new one begins
        self._head.append(octet)
        if len(self._head) == 8:
            head, self._head = self._head, bytearray()
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
            count = min(size, len(self._out))
            if busy or not count:
                self._answer = _header(0x14, 0)
                return
            self._answer = _header(0x12, count)
            self._data = _header(0x15, count) + self._out[:count]
            self._out = self._out[count:]
            if self._out:
                self._answer[4] = 1
                self._answer[7] = self._answer[7] - 1 & 0xFF

    # --- commands -----------------------------------------------------------------------------

    def _say_after(self, ms: int, text: bytes) -> None:
        self._after(ms, lambda: self.emit(text))

    def _update(self) -> None:
        self._run_timers()
        while self.link is not None and len(self._out) < 4000:
            data = self.link.recv()
            if data is None:
                return
            size = ("0000" + str(len(data)))[-4:].encode()
            if self.sender:
                head = b"\x1by0%s %d\t" % (self.link.address[0].encode(), self.link.address[1])
                self.emit(head + size + data)
            else:
                self.emit(b"\x1bZ0" + size + data)

    def _take(self, data: bytes) -> None:
        """Handle the data of one transfer: bulk data or commands."""
        if data[:2] == b"\x1bZ":
            size = data[3:7]
            if self.link is None or data[2:3] != b"0" or not size.isdigit():
                self.emit(b"\x1bF")
            else:
                self.link.send(data[7 : 7 + int(size)])
            return
        if self._echo:
            self.emit(data)
        self._text.extend(data)
        while b"\n" in self._text:
            line, _, remainder = bytes(self._text).partition(b"\n")
            self._text = bytearray(remainder)
            try:
                self._command(line.strip())
            except (ValueError, IndexError):  # invalid arguments
                self._say_after(self.answer_ms, b"\r\nERROR: INVALID INPUT\r\n")

    def _command(self, line: bytes) -> None:
        self.commands.append(line)
        name, _, argument = line.partition(b"=")
        answer = self.answer_ms
        if name in (b"AT", b"AT+WM", b"AT+NDHCP", b"AT+WREGDOMAIN", b"AT+NCLOSEALL"):
            if name == b"AT+NCLOSEALL":
                self._drop_link()
            self._say_after(answer, _OK)
        elif name in (b"ATE0", b"ATE1"):
            self._echo = name == b"ATE1"
            self._say_after(answer, _OK)
        elif name == b"AT+BDATA":
            self._bulk = argument == b"1"
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
            ssid, _, password = argument.partition(b",")
            if 8 <= len(password) <= 63:
                self._key = (ssid.decode(), password.decode())
                self._say_after(self.key_ms, b"Computing PSK from SSID and PassPhrase...\r\n" + _OK)
            else:
                self._say_after(answer, b"\r\nERROR: INVALID INPUT\r\n")
        elif name == b"AT+WA":
            ssid_text = argument.decode()
            self._after(self.join_ms, lambda: self.emit(self._join(ssid_text)))
        elif name == b"AT+NCUDP":
            host, port, local_port = argument.decode().split(",")
            if self.joined and self._bulk:
                self.link = self.network.link(host, int(port), int(local_port))
            connected = self.link is not None
            self._say_after(answer, b"CONNECT 0\r\n" + _OK if connected else _NO_SOCKET)
        else:
            self._say_after(answer, b"\r\nERROR: INVALID INPUT\r\n")

    def _join(self, ssid: str) -> bytes:
        password = self.network.access_points.get(ssid)
        if password is None or self._key != (ssid, password):
            return _ERROR
        self.joined = ssid
        return (
            b"    IP              SubNet         Gateway   \r\n"
            b" 192.168.1.99: 255.255.255.0: 192.168.1.1\r\n" + _OK
        )


def _header(kind: int, size: int) -> bytearray:
    low, high = size & 0xFF, size >> 8
    return bytearray((0xA5, kind, 0, 0, 0, low, high, (kind + low + high) & 0xFF ^ 0xFF))
