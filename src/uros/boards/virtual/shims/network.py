# mypy: disable-error-code="no-any-return"
"""MicroPython's ``network`` on a board with a radio: a station and an access point.

Numbers are those of an ESP32.
"""

import _board  # type: ignore[import-not-found]

STA_IF = 0
AP_IF = 1
STAT_IDLE = 1000
STAT_CONNECTING = 1001
STAT_GOT_IP = 1010
STAT_NO_AP_FOUND = 201
STAT_WRONG_PASSWORD = 202
_STATUS = (STAT_IDLE, STAT_CONNECTING, STAT_WRONG_PASSWORD, STAT_NO_AP_FOUND, STAT_GOT_IP)

try:
    _board.number(_board.WLAN_STATUS)
except OSError:  # firmware for boards without a radio lacks this module
    _why = _board.call(_board.ADVICE, bytes((_board.WLAN_STATUS,))).decode()
    raise ImportError("no module named 'network': " + _why)  # noqa: B904

_hostname = "mpy-virtual"


def hostname(name: str | None = None) -> str:
    """Return the board's host name, or set it."""
    global _hostname
    if name is not None:
        _hostname = name
    return _hostname


class WLAN:
    """The WLAN radio, as a station or as an access point."""

    IF_STA = STA_IF
    IF_AP = AP_IF
    SEC_OPEN = 0
    SEC_WPA2 = 3

    def __init__(self, interface: int = STA_IF) -> None:
        if interface not in (STA_IF, AP_IF):
            raise ValueError("interface is STA_IF or AP_IF")
        self._ap = interface == AP_IF
        self._active = False
        self._settings: dict[str, object] = {}
        self._address = "192.168.4.1" if self._ap else "0.0.0.0"

    def active(self, is_active: bool | None = None) -> bool:
        """Return whether the interface is active, or switch it."""
        if is_active is not None:
            self._active = bool(is_active)
            if self._ap:
                self._serve()
        return self._active

    def _serve(self) -> None:
        """Start or stop the access point with the current settings."""
        if not self._active:
            _board.call(_board.WLAN_STOP)
            return
        ssid = str(self._settings.get("ssid", "ESP_D0WDQ6"))
        key = str(self._settings.get("key", ""))
        if self._settings.get("security", 3 if key else 0) == 0:
            key = ""
        octets = ssid.encode() + b"\0" + key.encode() + b"\0" + self._address.encode()
        _board.call(_board.WLAN_START, octets)

    def config(self, name: str = "", **settings: object) -> object:
        """Return a setting by its name, or change settings."""
        if name:
            return self._settings[name]
        known = ("reconnects", "pm", "txpower", "ssid", "key", "security", "channel", "hidden")
        if any([key not in known for key in settings]):
            raise ValueError("unknown config param")
        self._settings.update(settings)
        if self._ap and self._active:
            self._serve()
        return None

    def ifconfig(self, addresses: "tuple[str, str, str, str] | None" = None) -> object:
        """Return (address, netmask, gateway, DNS), or set the address."""
        if addresses is None:
            return (self._address, "255.255.255.0", self._address, "0.0.0.0")
        self._address = addresses[0]
        if self._ap and self._active:
            self._serve()
        return None

    def connect(self, ssid: str, key: str = "") -> None:
        """Start to join an access point."""
        if not self._active:
            raise OSError("Wifi Not Started")
        _board.call(_board.WLAN_CONNECT, ssid.encode() + b"\0" + key.encode())

    def disconnect(self) -> None:
        """Leave the access point."""
        _board.call(_board.WLAN_LEAVE)

    def status(self, param: str = "") -> "int | list[tuple[bytes]]":
        """Return the status, or the stations of an access point.

        The reason of a failed join is reported only where ``reconnects`` is limited.
        """
        if param == "stations":
            return [(b"\2\0\0\0\0\1",)] * _board.number(_board.WLAN_GUESTS)
        status = _STATUS[_board.number(_board.WLAN_STATUS)]
        if status < STAT_IDLE and self._settings.get("reconnects", -1) == -1:
            return STAT_CONNECTING
        return status

    def isconnected(self) -> bool:
        """Return whether it has joined an access point; as one, whether a station has joined."""
        if self._ap:
            return bool(_board.number(_board.WLAN_GUESTS))
        return self.status() == STAT_GOT_IP
