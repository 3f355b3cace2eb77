# mypy: disable-error-code="no-any-return"
"""MicroPython's ``network`` on a board with a radio: a station, with the numbers of an ESP32."""

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
except OSError:  # such boards are built without it
    raise ImportError("no module named 'network'")  # noqa: B904

_hostname = "mpy-virtual"


def hostname(name: str | None = None) -> str:
    global _hostname
    if name is not None:
        _hostname = name
    return _hostname


class WLAN:
    def __init__(self, interface: int = STA_IF) -> None:
        if interface != STA_IF:
            raise ValueError("this board is no access point")
        self._active = False
        self._settings: dict[str, object] = {}

    def active(self, is_active: bool | None = None) -> bool:
        if is_active is not None:
            self._active = is_active
        return self._active

    def config(self, name: str = "", **settings: object) -> object:
        if name:
            return self._settings[name]
        if any([it not in ("reconnects", "pm", "txpower") for it in settings]):
            raise ValueError("unknown config param")
        self._settings.update(settings)
        return None

    def connect(self, ssid: str, key: str = "") -> None:
        if not self._active:
            raise OSError("Wifi Not Started")
        _board.call(_board.WLAN_CONNECT, ssid.encode() + b"\0" + key.encode())

    def disconnect(self) -> None:
        _board.call(_board.WLAN_LEAVE)

    def status(self) -> int:
        """What keeps it from joining is told only where ``reconnects`` has an end."""
        status = _STATUS[_board.number(_board.WLAN_STATUS)]
        if status < STAT_IDLE and self._settings.get("reconnects", -1) == -1:
            return STAT_CONNECTING
        return status

    def isconnected(self) -> bool:
        return self.status() == STAT_GOT_IP
