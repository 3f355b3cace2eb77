"""The network under a board's transports, on simulated ports. Also runs on MicroPython."""

import sys

from support.modem import FakeTime, os_error

from uros.transport import wlan as wlan_module
from uros.transport.wlan import AccessPoint, Over, Station, Wired


class Esp32:
    """``network`` of the ESP32 port, as far as stations use it, after its documentation."""

    STA_IF, AP_IF = 0, 1
    STAT_IDLE, STAT_CONNECTING, STAT_GOT_IP = 1000, 1001, 1010
    STAT_NO_AP_FOUND, STAT_WRONG_PASSWORD, STAT_BEACON_TIMEOUT = 201, 202, 200
    STAT_ASSOC_FAIL, STAT_HANDSHAKE_TIMEOUT = 203, 204
    AUTH_OPEN, AUTH_WPA2_PSK = 0, 3

    def __init__(self):
        self.interfaces = []
        self.names = []

    def hostname(self, name):
        self.names.append(name)

    def WLAN(self, interface):  # noqa: N802
        self.interfaces.append(FakeWlan(self, interface))
        return self.interfaces[-1]


class Rp2(Esp32):
    STAT_IDLE, STAT_CONNECTING, STAT_GOT_IP = 0, 1, 3
    STAT_NO_AP_FOUND, STAT_WRONG_PASSWORD = -2, -3
    STAT_CONNECT_FAIL = -1
    STAT_BEACON_TIMEOUT = STAT_ASSOC_FAIL = STAT_HANDSHAKE_TIMEOUT = None
    AUTH_OPEN = AUTH_WPA2_PSK = None


class FakeWlan:
    def __init__(self, port, interface):
        self.port = port
        self.interface = interface
        self.up = False
        self.now = port.STAT_IDLE
        self.joined = False
        self.calls = []
        self.settings = {}
        self.addresses = None

    def ifconfig(self, addresses):
        assert self.up, "esp32 drops the addresses when it starts"
        self.addresses = addresses

    def active(self, up=None):
        if up is None:
            return self.up
        self.up = up

    def config(self, **settings):
        if "reconnects" in settings and isinstance(self.port, Rp2):
            raise ValueError("unknown config param")
        self.settings.update(settings)

    def connect(self, *arguments):
        assert self.up
        self.calls.append(arguments)
        self.now = self.port.STAT_CONNECTING

    def disconnect(self):
        self.calls.append("leave")

    def isconnected(self):
        return self.joined

    def status(self):
        return self.now


class Below:
    """A transport that records its calls."""

    mtu = 512

    def __init__(self):
        self.calls = []

    def open(self):
        self.calls.append("open")

    def close(self):
        self.calls.append("close")

    def send(self, message):
        self.calls.append(message)

    def receive(self, timeout_ms):
        self.calls.append(timeout_ms)
        return b"come"


class Network:
    """A context in which ``network`` is this port, and the clock stands still."""

    def __init__(self, port):
        self.port = port

    def __enter__(self):
        self.time = FakeTime()
        self.time.__enter__()
        self.was = sys.modules.get("network")
        sys.modules["network"] = self.port
        self.ticks = wlan_module.ticks_ms
        wlan_module.ticks_ms = self.time.ticks_ms
        return self.port

    def __exit__(self, *_):
        wlan_module.ticks_ms = self.ticks
        if self.was is None:
            del sys.modules["network"]
        else:
            sys.modules["network"] = self.was
        self.time.__exit__()


def test_a_station_joins_without_waiting() -> None:
    for kind in (Esp32, Rp2):
        with Network(kind()) as port:
            below = Below()
            transport = Over(Station("robots", "secret99", hostname="arm"), below)
            wlan = port.interfaces[0]
            assert wlan.interface == port.STA_IF and transport.mtu == 512
            for _ in range(3):
                assert "joining robots" in os_error(transport.open)
            assert wlan.calls == ["leave", ("robots", "secret99")] and port.names == ["arm"]
            assert below.calls == []
            wlan.joined = True
            transport.open()
            transport.send(b"go")
            assert transport.receive(7) == b"come"
            transport.close()
            transport.open()
            assert below.calls == ["open", b"go", 7, "close", "open"]
            assert len(wlan.calls) == 2  # it stays in its network
            assert wlan.settings == ({"reconnects": 1} if kind is Esp32 else {})


def test_an_open_network() -> None:
    with Network(Esp32()) as port:
        os_error(Station("cafe").check)
        assert port.interfaces[0].calls[-1] == ("cafe",)


def test_the_reason_of_a_failed_attempt_is_raised_and_it_is_repeated() -> None:
    reasons = (
        (Esp32, 202, "password is wrong"), (Esp32, 204, "probably wrong"),
        (Esp32, 15, "probably wrong"), (Esp32, 201, "no such access point"),
        (Esp32, 203, "refuses"), (Esp32, 200, "too far"),
        (Rp2, -3, "password is wrong"), (Rp2, -2, "no such access point"), (Rp2, -1, "refuses"),
    )  # fmt: skip
    for kind, status, text in reasons:
        with Network(kind()) as port:
            station = Station("robots", "wrong")
            os_error(station.check)
            wlan = port.interfaces[0]
            wlan.now = status
            reason = os_error(station.check)
            assert "cannot join robots" in reason and text in reason, reason
            assert "joining" in os_error(station.check)
            assert len(wlan.calls) == 4
            wlan.joined = True
            station.check()


def test_an_attempt_is_repeated_after_its_timeout() -> None:
    network = Network(Rp2())
    with network as port:
        station = Station("robots", "secret99", timeout_ms=5000)
        os_error(station.check)
        network.time.now += 4999
        assert "joining" in os_error(station.check)
        network.time.now += 1
        assert "in time" in os_error(station.check)
        assert len(port.interfaces[0].calls) == 2
        os_error(station.check)
        assert len(port.interfaces[0].calls) == 4


def test_a_lost_wlan_is_joined_again() -> None:
    with Network(Esp32()) as port:
        transport = Over(Station("robots", "secret99"), Below())
        os_error(transport.open)
        wlan = port.interfaces[0]
        wlan.joined = True
        transport.open()
        transport.close()
        wlan.joined, wlan.now = False, port.STAT_IDLE
        assert "joining" in os_error(transport.open)
        assert len(wlan.calls) == 4


def test_an_access_point() -> None:
    for kind, security in ((Esp32, 3), (Rp2, None)):
        with Network(kind()) as port:
            point = AccessPoint("robot-7", "secret99", 6)
            wlan = port.interfaces[0]
            assert wlan.interface == port.AP_IF
            assert "nobody has joined" in os_error(point.check)
            settings = {"ssid": "robot-7", "key": "secret99", "channel": 6}
            if security is not None:
                settings["security"] = security
            assert wlan.settings == settings and wlan.up
            wlan.joined = True
            point.check()
            wlan.up = False
            assert "starting" in os_error(point.check)
    with Network(Esp32()) as port:
        os_error(AccessPoint("open").check)
        assert port.interfaces[0].settings == {"ssid": "open", "security": 0}


def test_an_access_point_with_an_address_of_its_own() -> None:
    with Network(Esp32()) as port:
        point = AccessPoint("ESP32-Access-Point", "123456789", address="10.16.1.1")
        assert "nobody has joined" in os_error(point.check)
        assert port.interfaces[0].addresses == (
            "10.16.1.1",
            "255.255.255.0",
            "10.16.1.1",
            "0.0.0.0",
        )
    with Network(Esp32()) as port:
        os_error(AccessPoint("robot-7").check)
        assert port.interfaces[0].addresses is None


def test_invalid_passwords_of_an_access_point_are_refused() -> None:
    for password in ("", "short", "x" * 64):
        try:
            AccessPoint("robot-7", password)
        except ValueError as error:
            assert "8 to 63" in str(error)
        else:
            raise AssertionError(password)


def test_ethernet() -> None:
    lan = FakeWlan(Esp32(), 0)
    transport = Over(Wired(lan), Below())
    assert "cable" in os_error(transport.open) and lan.up
    lan.joined = True
    transport.open()
    assert transport.transport.calls == ["open"]
