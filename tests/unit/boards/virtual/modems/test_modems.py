"""The modelled modems, by what they say to commands.

The ESP8266's words are those of Espressif's command reference and its examples. The GS2200's
transfers are put together by hand after Sony's driver in NuttX.
"""

import pytest

from uros.boards.virtual.modems.esp8266 import Esp8266
from uros.boards.virtual.modems.gs2200 import Gs2200
from uros.boards.virtual.modems.radio_network import Air, HostAir


class Time:
    now = 0

    def __call__(self):
        return self.now


@pytest.fixture
def air():
    return Air({"espressif": "1234567890"}, ("192.168.3.102",))


def said(modem, command=b""):
    if command:
        assert modem.write(command + b"\r\n") == len(command) + 2
    return modem.read(10_000) or b""


def ready(air, **options):
    modem = Esp8266(air, Time(), **options)
    said(modem, b"ATE0")
    said(modem, b"AT+CWMODE=1")
    return modem


def linked(air, **options):
    modem = ready(air, **options)
    said(modem, b'AT+CWJAP="espressif","1234567890"')
    said(modem, b'AT+CIPSTART="UDP","192.168.3.102",8080')
    return modem


def test_echo_is_on_until_it_is_turned_off(air):
    modem = Esp8266(air, Time())
    assert said(modem, b"AT") == b"AT\r\n\r\nOK\r\n"
    assert said(modem, b"ATE0") == b"ATE0\r\n\r\nOK\r\n"
    assert said(modem, b"AT") == b"\r\nOK\r\n"
    assert said(modem, b"AT+NONSENSE") == b"\r\nERROR\r\n"


def test_joining_as_in_the_reference(air):
    modem = ready(air)
    assert said(modem, b"AT+CWJAP?") == b"No AP\r\n\r\nOK\r\n"
    assert said(modem, b'AT+CWJAP="espressif","1234567890"') == (
        b"WIFI CONNECTED\r\nWIFI GOT IP\r\n\r\nOK\r\n"
    )
    assert said(modem, b"AT+CWJAP?").startswith(b'+CWJAP:"espressif",')


@pytest.mark.parametrize(("dialect", "word"), [("esp-at", b"ERROR"), ("nonos", b"FAIL")])
def test_joining_that_fails_says_why(air, dialect, word):
    modem = ready(air, dialect=dialect)
    assert said(modem, b'AT+CWJAP="espressif","no"') == b"+CWJAP:2\r\n\r\n" + word + b"\r\n"
    assert said(modem, b'AT+CWJAP="other","no"') == b"+CWJAP:3\r\n\r\n" + word + b"\r\n"


def test_joining_takes_time_and_others_hear_that_it_is_busy(air):
    time = Time()
    modem = Esp8266(air, time, join_ms=100)
    for command in (b"ATE0", b"AT+CWMODE=1", b'AT+CWJAP="espressif","1234567890"'):
        modem.read(1000)
        said(modem, command)
    assert said(modem, b"AT") == b"busy p...\r\n"
    time.now = 100
    assert said(modem).endswith(b"\r\nOK\r\n")


def test_a_link_and_datagrams_both_ways(air):
    modem = ready(air)
    assert said(modem, b'AT+CIPSTART="UDP","192.168.3.102",8080') == b"no ip\r\n\r\nERROR\r\n"
    said(modem, b'AT+CWJAP="espressif","1234567890"')
    assert said(modem, b'AT+CIPSTART="UDP","elsewhere",8080') == b"DNS Fail\r\n\r\nERROR\r\n"
    start = b'AT+CIPSTART="UDP","192.168.3.102",8080,1112,0'
    assert said(modem, start) == b"CONNECT\r\n\r\nOK\r\n"
    assert said(modem, start) == b"ALREADY CONNECTED\r\n\r\nERROR\r\n"
    assert air.links[-1].where == ("192.168.3.102", 8080, 1112)
    assert said(modem, b"AT+CIPSEND=4") == b"\r\nOK\r\n\r\n>"
    modem.write(b"te")
    assert said(modem) == b""
    modem.write(b"st")
    assert said(modem) == b"\r\nRecv 4 bytes\r\n\r\nSEND OK\r\n"
    assert air.links[-1].sent == [b"test"]
    air.links[-1].come.append(b"back")
    assert said(modem) == b"\r\n+IPD,4:back"


@pytest.mark.parametrize("size", [b"0", b"8193", b"x", b""])
def test_a_datagram_of_no_size(air, size):
    assert said(linked(air), b"AT+CIPSEND=" + size) == b"\r\nERROR\r\n"


def test_what_is_lost(air):
    modem = linked(air)
    modem.lose_link()
    assert said(modem) == b"CLOSED\r\n"
    assert said(modem, b"AT+CIPSEND=4") == b"link is not valid\r\n\r\nERROR\r\n"
    modem = linked(air)
    modem.lose_network()
    assert said(modem) == b"CLOSED\r\nWIFI DISCONNECT\r\n"
    modem = linked(air)
    modem.reset()
    assert said(modem).endswith(b"\r\nready\r\n") and modem.link is None
    assert said(modem, b"AT") == b"AT\r\n\r\nOK\r\n"


# --- the GS2200 -------------------------------------------------------------------------------


def get(modem, count):
    into = bytearray(count)
    modem.readinto(into, 0xF5)
    return bytes(into)


def give(modem, text):
    """A write as the driver does it."""
    size = len(text)
    check = (1 + size) & 0xFF ^ 0xFF
    modem.write(bytes((0xA5, 1, 0, 0, 0, size, 0, check)))
    assert modem.value() == 1
    answer = get(modem, 8)
    assert answer == bytes((0xA5, 0x11, 0, 0, 0, size, 0, (0x11 + size) & 0xFF ^ 0xFF))
    modem.write(bytes((0xA5, 3, 0, 0, 0, size, 0, (3 + size) & 0xFF ^ 0xFF)))
    modem.write(text)


def take(modem):
    """A read as the driver does it."""
    assert modem.value() == 1
    modem.write(bytes.fromhex("a502000000dc0516"[:14]) + bytes(((2 + 0xDC + 5) & 0xFF ^ 0xFF,)))
    answer = get(modem, 8)
    assert answer[:2] == b"\xa5\x12"
    size = answer[5] | answer[6] << 8
    assert get(modem, 8)[:2] == b"\xa5\x15"
    return get(modem, size)


def test_transfers_commands_and_bulk_data():
    air = Air({"robots": "secret99"})
    modem = Gs2200(air, Time())
    assert modem.value() == 0
    give(modem, b"AT\r\n")
    assert take(modem) == b"AT\r\n\r\nOK\r\n" and modem.value() == 0
    for command in (b"ATE0", b"AT+BDATA=1", b"AT+WPAPSK=robots,secret99", b"AT+WA=robots"):
        give(modem, command + b"\r\n")
        assert take(modem).endswith(b"\r\nOK\r\n")
    give(modem, b"AT+NCUDP=192.168.1.10,8888,10001\r\n")
    assert take(modem) == b"CONNECT 0\r\n\r\nOK\r\n"
    give(modem, b"\x1bZ00005Hello")
    assert air.links[0].sent == [b"Hello"] and modem.value() == 0
    air.links[0].come.append(b"back")
    assert take(modem) == b"\x1bZ00004back"


def test_a_request_with_a_wrong_checksum_is_forgotten():
    modem = Gs2200(Air({}), Time())
    modem.write(bytes((0xA5, 1, 0, 0, 0, 4, 0, 0)))
    assert modem.value() == 0 and modem.broken == 1


def test_the_hosts_own_network():
    import socket

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.bind(("127.0.0.1", 0))
        peer.settimeout(10)
        air = HostAir({})
        link = air.link("127.0.0.1", peer.getsockname()[1], 10001)
        assert link.recv() is None and link.send(b"there")
        data, address = peer.recvfrom(100)
        peer.sendto(b"back", address)
        while (came := link.recv()) is None:
            pass
        assert (data, came) == (b"there", b"back")
        air.close()
        assert link.closed
