"""The network under a board's UDP or TCP: WLAN, as station or access point, and Ethernet.

    from uros.transport.udp import UdpTransport
    from uros.transport.wlan import Over, Station

    transport = Over(Station("network", "password"), UdpTransport("192.168.1.10"))

Nothing waits: each ``open`` of the transport checks the state of the network, and raises OSError
with the reason until it is up; the node tries again. Runs on MicroPython ports that have
``network``.
"""

import errno

from ..ticks import ticks_add, ticks_diff, ticks_ms

try:
    from typing import Any, Final
except ImportError:  # MicroPython
    pass

# Failure states of a station; each MicroPython port defines some of them.
_WHY_NOT: Final = (
    ("STAT_WRONG_PASSWORD", errno.EACCES, "the password is wrong"),
    ("STAT_HANDSHAKE_TIMEOUT", errno.EACCES, "the password is probably wrong"),
    (
        "STAT_NO_AP_FOUND",
        errno.ENODEV,
        "there is no such access point: check the name, and that it is in reach and on a band that"
        " the board has",
    ),
    ("STAT_ASSOC_FAIL", errno.ECONNREFUSED, "the access point refuses"),
    ("STAT_CONNECT_FAIL", errno.ECONNREFUSED, "the access point refuses"),
    ("STAT_BEACON_TIMEOUT", errno.ETIMEDOUT, "the access point is too far away"),
)
# Status of an ESP32, without a name, when the password is wrong: the third message of the four-way
# handshake is missing.
_FOUR_WAY: Final = 15


class Over:
    """A transport on top of a network link.

    Args:
        link: A :class:`Station`, an :class:`AccessPoint`, a :class:`Wired`, or an object with
            ``check()``, which raises OSError while there is no network.
        transport: Opened once the link is up.
    """

    def __init__(self, link: "Any", transport: "Any") -> None:
        self.link = link
        self.transport = transport
        self.mtu: int = transport.mtu
        # Bound directly: a method that forwards the call would cost time for each message.
        self.send: "Any" = transport.send
        self.receive: "Any" = transport.receive

    def open(self) -> None:
        """Open the transport. Raises OSError with the reason while there is no network."""
        self.link.check()
        self.transport.open()

    def close(self) -> None:
        """Close the transport; idempotent. The board stays in its network."""
        self.transport.close()


class Station:
    """The board joins the access point ``ssid``; ``password`` is None where it has none.

    An attempt that has not succeeded within ``timeout_ms`` is repeated. ``hostname`` is the board's
    name in the network.
    """

    def __init__(
        self, ssid: str, password: "str | None" = None, timeout_ms: int = 20000,
        hostname: str = "",
    ) -> None:  # fmt: skip
        import network  # type: ignore[import-not-found]

        self._network: "Any" = network
        self.wlan: "Any" = self._network.WLAN(self._network.STA_IF)
        self._ssid = ssid
        self._password = password
        self._timeout_ms = timeout_ms
        self._hostname = hostname
        self._until: "int | None" = None  # when the current attempt is given up

    def check(self) -> None:
        """Raise OSError until the board has joined."""
        if self.wlan.isconnected():
            self._until = None
            return
        if self._until is None:
            self._begin()
            raise OSError(errno.EINPROGRESS, "joining " + self._ssid)
        status = self.wlan.status()
        for name, number, why in _WHY_NOT:
            if status == getattr(self._network, name, None):
                self._fail(number, why)
        if status == _FOUR_WAY:
            self._fail(errno.EACCES, "the password is probably wrong")
        if ticks_diff(self._until, ticks_ms()) <= 0:
            self._fail(errno.ETIMEDOUT, "there was no answer in time: is it in reach?")
        raise OSError(errno.EINPROGRESS, "joining " + self._ssid)

    def _begin(self) -> None:
        self._until = ticks_add(ticks_ms(), self._timeout_ms)
        if self._hostname:
            self._network.hostname(self._hostname)
        self.wlan.active(True)
        try:
            # Otherwise an ESP32 tries for ever and reports no reason.
            self.wlan.config(reconnects=1)
        except (ValueError, TypeError):
            pass
        try:
            self.wlan.disconnect()  # from a network that the port joined by itself
        except OSError:
            pass
        if self._password is None:
            self.wlan.connect(self._ssid)
        else:
            self.wlan.connect(self._ssid, self._password)

    def _fail(self, number: int, why: str) -> None:
        self._until = None
        raise OSError(number, "cannot join %s: %s" % (self._ssid, why))


class AccessPoint:
    """The board is an access point, which the agent's computer joins.

    Args:
        ssid: Its name.
        password: 8 to 63 characters; None for none.
        address: The board's address, in a network of 256 whose other addresses it assigns by DHCP
            from the next one on; by default usually 192.168.4.1.
    """

    def __init__(
        self, ssid: str, password: "str | None" = None, channel: "int | None" = None,
        address: "str | None" = None,
    ) -> None:  # fmt: skip
        if password is not None and not 8 <= len(password) <= 63:
            raise ValueError("an access point's password has 8 to 63 characters")
        import network

        self._network: "Any" = network
        self.wlan: "Any" = self._network.WLAN(self._network.AP_IF)
        self._ssid = ssid
        self._password = password
        self._channel = channel
        self._address = address
        self._begun = False

    def check(self) -> None:
        """Raise OSError until a station has joined the access point."""
        if not self._begun:
            settings: "dict[str, Any]" = {"ssid": self._ssid}
            if self._password is not None:
                settings["key"] = self._password
            kind = self._security()
            if kind is not None:
                settings["security"] = kind
            if self._channel is not None:
                settings["channel"] = self._channel
            self.wlan.config(**settings)
            self.wlan.active(True)
            if self._address is not None:
                self.wlan.ifconfig((self._address, "255.255.255.0", self._address, "0.0.0.0"))
            self._begun = True
        if not self.wlan.active():
            raise OSError(errno.EINPROGRESS, "the access point %s is starting" % self._ssid)
        if not self.wlan.isconnected():
            raise OSError(
                errno.EINPROGRESS, "nobody has joined the access point %s yet" % self._ssid
            )

    def _security(self) -> "Any":
        """Return the port's number for WPA2 or for an open network; None if it has no such name."""
        new, old = ("SEC_OPEN", "AUTH_OPEN")
        if self._password is not None:
            new, old = ("SEC_WPA2", "AUTH_WPA2_PSK")
        kind = getattr(self._network.WLAN, new, getattr(self._network, old, None))
        return 0 if kind is None and self._password is None else kind


class Wired:
    """Ethernet: ``lan`` is a ``network.LAN`` or ``network.WIZNET5K``, made as its board needs."""

    def __init__(self, lan: "Any") -> None:
        self.lan = lan
        self._begun = False

    def check(self) -> None:
        """Raise OSError until the cable is plugged in and there is an address."""
        if not self._begun:
            self.lan.active(True)
            self._begun = True
        if not self.lan.isconnected():
            raise OSError(
                errno.ENODEV, "no Ethernet: is the cable in, and does the network give addresses?"
            )
