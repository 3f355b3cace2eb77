"""The modelled modems: their responses to AT commands.

The ESP8266's responses are those of Espressif's command reference and its examples. The GS2200's
transfers are put together by hand after Sony's driver in NuttX.
"""

import pytest

from uros.boards.virtual.modems.esp8266 import Esp8266
from uros.boards.virtual.modems.gs2200 import Gs2200
from uros.boards.virtual.modems.radio_network import HostRadioNetwork, RadioNetwork


class FakeTime:
    now = 0

    def __call__(self):
        return self.now


@pytest.fixture
def network():
    return RadioNetwork({"espressif": "1234567890"}, ("192.168.3.102",))


def exchange(modem, command=b""):
    if command:
        assert modem.write(command + b"\r\n") == len(command) + 2
    return modem.read(10_000) or b""


def ready(network, **options):
    modem = Esp8266(network, FakeTime(), **options)
    exchange(modem, b"ATE0")
    exchange(modem, b"AT+CWMODE=1")
    return modem


def linked(network, **options):
    modem = ready(network, **options)
    exchange(modem, b'AT+CWJAP="espressif","1234567890"')
    exchange(modem, b'AT+CIPSTART="UDP","192.168.3.102",8080')
    return modem


def test_echo_is_on_until_it_is_turned_off(network):
    modem = Esp8266(network, FakeTime())
    assert exchange(modem, b"AT") == b"AT\r\n\r\nOK\r\n"
    assert exchange(modem, b"ATE0") == b"ATE0\r\n\r\nOK\r\n"
    assert exchange(modem, b"AT") == b"\r\nOK\r\n"
    assert exchange(modem, b"AT+NONSENSE") == b"\r\nERROR\r\n"


def test_joining_as_in_the_reference(network):
    modem = ready(network)
    assert exchange(modem, b"AT+CWJAP?") == b"No AP\r\n\r\nOK\r\n"
    assert exchange(modem, b'AT+CWJAP="espressif","1234567890"') == (
        b"WIFI CONNECTED\r\nWIFI GOT IP\r\n\r\nOK\r\n"
    )
    assert exchange(modem, b"AT+CWJAP?").startswith(b'+CWJAP:"espressif",')


@pytest.mark.parametrize(("dialect", "word"), [("esp-at", b"ERROR"), ("nonos", b"FAIL")])
def test_a_failed_join_reports_the_reason(network, dialect, word):
    modem = ready(network, dialect=dialect)
    assert exchange(modem, b'AT+CWJAP="espressif","no"') == b"+CWJAP:2\r\n\r\n" + word + b"\r\n"
    assert exchange(modem, b'AT+CWJAP="other","no"') == b"+CWJAP:3\r\n\r\n" + word + b"\r\n"


def test_commands_get_busy_while_the_modem_joins(network):
    time = FakeTime()
    modem = Esp8266(network, time, join_ms=100)
    for command in (b"ATE0", b"AT+CWMODE=1", b'AT+CWJAP="espressif","1234567890"'):
        modem.read(1000)
        exchange(modem, command)
    assert exchange(modem, b"AT") == b"busy p...\r\n"
    time.now = 100
    assert exchange(modem).endswith(b"\r\nOK\r\n")


def test_a_link_and_datagrams_both_ways(network):
    modem = ready(network)
    assert exchange(modem, b'AT+CIPSTART="UDP","192.168.3.102",8080') == b"no ip\r\n\r\nERROR\r\n"
    exchange(modem, b'AT+CWJAP="espressif","1234567890"')
    assert exchange(modem, b'AT+CIPSTART="UDP","elsewhere",8080') == b"DNS Fail\r\n\r\nERROR\r\n"
    start = b'AT+CIPSTART="UDP","192.168.3.102",8080,1112,0'
    assert exchange(modem, start) == b"CONNECT\r\n\r\nOK\r\n"
    assert exchange(modem, start) == b"ALREADY CONNECTED\r\n\r\nERROR\r\n"
    assert network.links[-1].address == ("192.168.3.102", 8080, 1112)
    assert exchange(modem, b"AT+CIPSEND=4") == b"\r\nOK\r\n\r\n>"
    modem.write(b"te")
    assert exchange(modem) == b""
    modem.write(b"st")
    assert exchange(modem) == b"\r\nRecv 4 bytes\r\n\r\nSEND OK\r\n"
    assert network.links[-1].sent == [b"test"]
    network.links[-1].incoming.append(b"back")
    assert exchange(modem) == b"\r\n+IPD,4:back"


@pytest.mark.parametrize("size", [b"0", b"8193", b"x", b""])
def test_an_invalid_datagram_size_is_an_error(network, size):
    assert exchange(linked(network), b"AT+CIPSEND=" + size) == b"\r\nERROR\r\n"


def test_loss_of_the_link_of_the_network_and_of_power(network):
    modem = linked(network)
    modem.lose_link()
    assert exchange(modem) == b"CLOSED\r\n"
    assert exchange(modem, b"AT+CIPSEND=4") == b"link is not valid\r\n\r\nERROR\r\n"
    modem = linked(network)
    modem.lose_network()
    assert exchange(modem) == b"CLOSED\r\nWIFI DISCONNECT\r\n"
    modem = linked(network)
    modem.reset()
    assert exchange(modem).endswith(b"\r\nready\r\n") and modem.link is None
    assert exchange(modem, b"AT") == b"AT\r\n\r\nOK\r\n"


# --- the GS2200 -------------------------------------------------------------------------------


def get(modem, count):
    into = bytearray(count)
    modem.readinto(into, 0xF5)
    return bytes(into)


def send(modem, text):
    """Write in one transfer, as the driver does."""
    size = len(text)
    check = (1 + size) & 0xFF ^ 0xFF
    modem.write(bytes((0xA5, 1, 0, 0, 0, size, 0, check)))
    assert modem.value() == 1
    answer = get(modem, 8)
    assert answer == bytes((0xA5, 0x11, 0, 0, 0, size, 0, (0x11 + size) & 0xFF ^ 0xFF))
    modem.write(bytes((0xA5, 3, 0, 0, 0, size, 0, (3 + size) & 0xFF ^ 0xFF)))
    modem.write(text)


def fetch(modem):
    """Read in one transfer, as the driver does."""
    assert modem.value() == 1
    modem.write(bytes.fromhex("a502000000dc0516"[:14]) + bytes(((2 + 0xDC + 5) & 0xFF ^ 0xFF,)))
    answer = get(modem, 8)
    assert answer[:2] == b"\xa5\x12"
    size = answer[5] | answer[6] << 8
    assert get(modem, 8)[:2] == b"\xa5\x15"
    return get(modem, size)


def test_transfers_commands_and_bulk_data():
    network = RadioNetwork({"robots": "secret99"})
    modem = Gs2200(network, FakeTime())
    assert modem.value() == 0
    send(modem, b"AT\r\n")
    assert fetch(modem) == b"AT\r\n\r\nOK\r\n" and modem.value() == 0
    for command in (b"ATE0", b"AT+BDATA=1", b"AT+WPAPSK=robots,secret99", b"AT+WA=robots"):
        send(modem, command + b"\r\n")
        assert fetch(modem).endswith(b"\r\nOK\r\n")
    send(modem, b"AT+NCUDP=192.168.1.10,8888,10001\r\n")
    assert fetch(modem) == b"CONNECT 0\r\n\r\nOK\r\n"
    send(modem, b"\x1bZ00005Hello")
    assert network.links[0].sent == [b"Hello"] and modem.value() == 0
    network.links[0].incoming.append(b"back")
    assert fetch(modem) == b"\x1bZ00004back"


def test_a_request_with_a_wrong_checksum_is_ignored():
    modem = Gs2200(RadioNetwork({}), FakeTime())
    modem.write(bytes((0xA5, 1, 0, 0, 0, 4, 0, 0)))
    assert modem.value() == 0 and modem.broken == 1


def test_datagrams_over_a_socket_of_this_host():
    import socket

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.bind(("127.0.0.1", 0))
        peer.settimeout(10)
        network = HostRadioNetwork({})
        link = network.link("127.0.0.1", peer.getsockname()[1], 10001)
        assert link.recv() is None and link.send(b"there")
        data, address = peer.recvfrom(100)
        peer.sendto(b"back", address)
        while (received := link.recv()) is None:
            pass
        assert (data, received) == (b"there", b"back")
        network.close()
        assert link.closed
