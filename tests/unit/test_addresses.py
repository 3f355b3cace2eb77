"""The addresses of this machine, compared with what sockets report."""

import socket

import pytest

from uros import addresses

TABLE = """\
00000000000000000000000000000001 01 80 10 80       lo
fe8000000000000000fc00fffe000001 04 40 20 80     eth0
20010db8000000000000000000000003 04 40 00 01     eth0
20010db8000000000000000000000004 04 40 00 20     eth0
20010db8000000000000000000000005 04 40 00 c0     eth0
20010db8000000000000000000000002 04 40 00 80     eth0
fe8000000000000000fc00fffe000002 05 40 20 80    wlan0
20010db8000000000000000000000009 06 40 00 01    wlan1
"""


@pytest.fixture
def table(tmp_path, monkeypatch):
    file = tmp_path / "if_inet6"
    file.write_text(TABLE)
    monkeypatch.setattr(addresses, "_IF_INET6", str(file))
    return file


def test_loopback_is_listed():
    assert addresses.ipv4_by_interface()["lo"] == "127.0.0.1"
    assert addresses.ipv6_of("lo") == "::1"


def test_every_listed_address_can_be_bound():
    by_interface = addresses.ipv4_by_interface()
    for ip in by_interface.values():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            sock.bind((ip, 0))
    for name in by_interface:
        address = addresses.ipv6_of(name)
        if address is not None:
            with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as sock:
                sock.bind((address, 0))


def test_the_permanent_address_of_an_interface_is_listed(table):
    assert addresses.ipv6_of("eth0") == "2001:db8::2"


def test_a_temporary_address_is_listed_if_there_is_no_other(table):
    assert addresses.ipv6_of("wlan1") == "2001:db8::9"


def test_a_link_local_address_is_not_listed(table):
    assert addresses.ipv6_of("wlan0") is None
    assert addresses.ipv6_of("eth9") is None


def test_a_machine_without_ipv6(tmp_path, monkeypatch):
    monkeypatch.setattr(addresses, "_IF_INET6", str(tmp_path / "none"))
    monkeypatch.setattr(addresses, "_FAR_AWAY", ("fe80::1", 9))  # there is no route to it
    assert addresses.ipv6_of("lo") is None
    assert addresses.ipv6_of(None) is None


def test_the_interface_towards_the_internet(monkeypatch):
    monkeypatch.setattr(addresses, "_FAR_AWAY", ("::1", 9))
    assert addresses.ipv6_of(None) == "::1"


def test_the_own_address_towards_a_peer():
    assert addresses.own_address(("127.0.0.1", 9)) == "127.0.0.1"
    assert addresses.own_address(("::1", 9)) == "::1"
    assert addresses.own_address(("255.255.255.255", 9)) is None


@pytest.mark.parametrize("address", ["fe80::1", "fe80::1%eth0", "febf::"])
def test_addresses_that_are_valid_on_a_link_only(address):
    assert addresses.is_link_local(address)


@pytest.mark.parametrize("address", ["192.168.0.1", "fec0::1", "fd00::2", "::1", "2001:fe80::1"])
def test_addresses_that_are_valid_beyond_a_link(address):
    assert not addresses.is_link_local(address)


def test_interfaces_that_are_up():
    loopback = next(one for one in addresses.interfaces() if one.is_loopback)
    assert loopback.address == "127.0.0.1" and loopback.flags & addresses.UP
    assert socket.if_indextoname(loopback.index) == loopback.name
