"""The sockets of a domain, on loopback, with interfaces that the test gives."""

import errno
import socket
import sys

import pytest

from uros.addresses import LOOPBACK, RUNNING, UP, Interface
from uros.middleware.base import MiddlewareError
from uros.middleware.rtps import ip_sockets, locators, udp
from uros.middleware.rtps.locators import UDPV4, UDPV6, Locator
from uros.middleware.rtps.network import NetworkSettings, read_settings
from uros.middleware.rtps.udp import SCAN_PERIOD, DomainSockets

LO = Interface("lo", 1, UP | RUNNING | LOOPBACK, "127.0.0.1", ("::1",))
LOCAL = NetworkSettings(stays_local=True, multicast=False)


class Opened:
    """Sockets that are closed at the end, on interfaces that may change."""

    def __init__(self):
        self.all = []
        self.interfaces = [LO]

    def __call__(self, domain, settings=LOCAL, now=0.0, change_socket=lambda: None):
        made = DomainSockets(
            domain, settings, now, lambda: list(self.interfaces), change_socket
        )  # fmt: skip
        self.all.append(made)
        return made


@pytest.fixture
def opened():
    made = Opened()
    yield made
    for each in made.all:
        each.close()


def received(sockets):
    """What has come to all descriptors."""
    return [
        (bytes(data), source)
        for fileno in sockets.filenos()
        for data, source in sockets.receive(fileno)
    ]


def port_of(domain, index):
    return locators.metatraffic_port(domain, index)


# --- ports ---------------------------------------------------------------------------------------


def test_samples_have_a_port_of_their_own_next_to_that_of_discovery(opened, own_domain_id):
    sockets = opened(own_domain_id)
    assert sockets.data == [Locator(UDPV4, port_of(own_domain_id, 0) + 1, "127.0.0.1")]
    for data, place in ((b"sample", sockets.data[0]), (b"discovery", sockets.unicast[0])):
        sockets.send(data, place)
    assert [data for data, _ in received(sockets)] == [b"discovery", b"sample"]


def test_an_index_whose_port_for_samples_is_taken_is_passed_over(opened, own_domain_id):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", port_of(own_domain_id, 0) + 1))
        assert opened(own_domain_id).unicast[0].port == port_of(own_domain_id, 1)


# --- the participant index ------------------------------------------------------------------------


def test_off_opens_no_socket(opened, own_domain_id, monkeypatch):
    def sockets_are_off(*_):
        raise AssertionError("a socket was opened")

    monkeypatch.setattr(ip_sockets.socket, "socket", sockets_are_off)
    sockets = opened(own_domain_id, read_settings({"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}, 0))
    assert sockets.filenos() == [] and sockets.scan_at is None
    assert sockets.send(b"x", Locator(UDPV4, 7400, "127.0.0.1")) and not sockets.send_errors


def test_the_lowest_free_index_is_taken(opened, own_domain_id):
    first, second = opened(own_domain_id), opened(own_domain_id)
    assert first.unicast == [Locator(UDPV4, port_of(own_domain_id, 0), "127.0.0.1")]
    assert second.unicast == [Locator(UDPV4, port_of(own_domain_id, 1), "127.0.0.1")]
    first.close()
    assert opened(own_domain_id).unicast == first.unicast


def test_a_port_that_others_would_share_is_taken_all_the_same(opened, own_domain_id):
    """Fast DDS opens its port with SO_REUSEADDR: ours does not, so the port is seen as taken."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        other.bind(("0.0.0.0", port_of(own_domain_id, 0)))
        assert opened(own_domain_id).unicast[0].port == port_of(own_domain_id, 1)


def test_only_the_multicast_port_is_shared(opened, own_domain_id):
    settings = NetworkSettings(stays_local=True)
    for number in range(2):
        sockets = opened(own_domain_id, settings)
        assert sockets.multicast == [
            Locator(UDPV4, locators.multicast_port(own_domain_id), "239.255.0.1")
        ]
        shared = [
            sock.getsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR)
            for sock in sockets._sockets[UDPV4].sockets
        ]
        assert shared == [0, 1, 0] and sockets.unicast[0].port == port_of(own_domain_id, number)


def test_localhost_opens_no_multicast_socket(opened, own_domain_id):
    sockets = opened(own_domain_id, read_settings({"ROS_LOCALHOST_ONLY": "1"}, own_domain_id))
    assert len(sockets.filenos()) == 2 and sockets.multicast == []
    assert Locator(UDPV4, port_of(own_domain_id, 31), "127.0.0.1") in sockets.peers


def test_an_index_that_others_do_not_look_for_is_told(opened, own_domain_id, monkeypatch):
    assert opened(own_domain_id).notices == []
    monkeypatch.setattr(udp.network, "PROBED", 1)
    (notice,) = opened(own_domain_id).notices
    assert "this is participant 1" in notice and "use another domain" in notice


def test_the_index_of_the_configuration(opened, own_domain_id):
    fixed = NetworkSettings(stays_local=True, multicast=False, index=7)
    assert opened(own_domain_id, fixed).unicast[0].port == port_of(own_domain_id, 7)
    again = opened(own_domain_id, fixed)
    assert "the participant index 7 of CYCLONEDDS_URI is taken, so 0 is used" in again.notices[0]
    assert again.unicast[0].port == port_of(own_domain_id, 0)
    none = NetworkSettings(stays_local=True, multicast=False, index=-1)
    free = {opened(own_domain_id, none).unicast[0].port for _ in range(2)}
    assert len(free) == 2 and 0 not in free


@pytest.mark.parametrize("index", [120, 125, 30_000])
def test_an_index_whose_port_is_that_of_another_domain_is_refused(opened, own_domain_id, index):
    assert port_of(40, 125) == port_of(41, 0)
    with pytest.raises(MiddlewareError, match=f"ParticipantIndex {index}.* 0 to 119, or auto"):
        opened(own_domain_id, NetworkSettings(stays_local=True, index=index))


def test_an_index_beyond_the_last_port_is_refused(opened):
    """The last domain has fewer ports."""
    with pytest.raises(MiddlewareError, match="ParticipantIndex 119.*domain 232.* 0 to 62, or"):
        opened(232, NetworkSettings(stays_local=True, multicast=False, index=119))


class TakenOnIpv6:
    """Sockets whose port is taken on IPv6, as often as the test says."""

    def __init__(self, times):
        self.times = times

    def __call__(self, kind, port, data_port, stays_local):
        if kind == UDPV6 and self.times:
            self.times -= 1
            raise OSError(errno.EADDRINUSE, "taken")
        return ip_sockets.IpSockets(kind, port, data_port, stays_local)


def test_any_free_port_is_one_that_is_free_on_both_versions_of_ip(
    opened, own_domain_id, monkeypatch
):
    monkeypatch.setattr(udp, "IpSockets", TakenOnIpv6(1))
    settings = NetworkSettings(
        kinds=(UDPV4, UDPV6), stays_local=True, multicast=False, index=-1
    )  # fmt: skip
    sockets = opened(own_domain_id, settings)
    assert len(sockets.filenos()) == 4 and len({place.port for place in sockets.unicast}) == 1
    assert len({place.port for place in sockets.data}) == 1
    monkeypatch.setattr(udp, "IpSockets", TakenOnIpv6(1000))
    with pytest.raises(MiddlewareError, match="no port that is free on IPv4 and IPv6"):
        opened(own_domain_id, settings)


def test_a_domain_without_a_free_index_is_an_error(opened, own_domain_id, monkeypatch):
    monkeypatch.setattr(udp, "MAX_INDEX", 0)
    opened(own_domain_id)
    with pytest.raises(MiddlewareError, match="no free participant index.*another domain"):
        opened(own_domain_id)


def test_a_multicast_port_that_is_not_shared_is_an_error(opened, own_domain_id):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("", locators.multicast_port(own_domain_id)))
        with pytest.raises(MiddlewareError, match="is in use by a program that does not share it"):
            opened(own_domain_id, NetworkSettings(stays_local=True))


# --- interfaces ---------------------------------------------------------------------------------


def test_interfaces_are_looked_at_again(opened, own_domain_id):
    settings = NetworkSettings(multicast=False)
    sockets = opened(own_domain_id, settings, now=100.0)
    assert sockets.scan_at == 100.0 + SCAN_PERIOD
    assert not sockets.scan(103.0) and sockets.scan_at == 103.0 + SCAN_PERIOD
    opened.interfaces = [LO, Interface("eth0", 2, UP | RUNNING, "10.0.0.1")]
    assert sockets.scan(106.0)
    assert [place.address for place in sockets.unicast] == ["10.0.0.1"]
    opened.interfaces = [LO]
    assert sockets.scan(109.0)
    assert [place.address for place in sockets.unicast] == ["127.0.0.1"]


def test_interfaces_that_cannot_be_listed_now_stay_as_they_are(opened, own_domain_id):
    sockets = opened(own_domain_id)
    before = sockets.unicast

    def no_descriptor():
        raise OSError(errno.EMFILE, "Too many open files")

    sockets._list_interfaces = no_descriptor
    assert not sockets.scan(3.0) and sockets.unicast == before
    assert sockets.scan_at == 3.0 + SCAN_PERIOD


def test_an_interface_without_multicast_is_tried_again(opened, own_domain_id, monkeypatch):
    refused = [errno.ENODEV]
    set_option = ip_sockets._set

    def refuse(sock, level, option, value):
        if option == socket.IP_ADD_MEMBERSHIP and refused:
            return False
        return set_option(sock, level, option, value)

    monkeypatch.setattr(ip_sockets, "_set", refuse)
    sockets = opened(own_domain_id, NetworkSettings(stays_local=True))
    assert sockets.multicast == []
    refused.clear()
    assert sockets.scan(3.0) and len(sockets.multicast) == 1


def test_a_chosen_interface_that_is_not_there_is_told(opened, own_domain_id):
    uri = '<General><Interfaces><NetworkInterface name="eth77"/></Interfaces></General>'
    settings = read_settings({"CYCLONEDDS_URI": uri}, own_domain_id)
    (notice,) = opened(own_domain_id, settings).notices
    assert "asks for the interface eth77, which is not up" in notice and "there are lo" in notice


@pytest.mark.parametrize("attributes", ['name="en0"', 'address="10.9.9.9"'])
def test_a_chosen_interface_on_a_system_that_lists_none_is_told_with_the_remedy(
    opened, own_domain_id, monkeypatch, attributes
):
    monkeypatch.setattr(udp.sys, "platform", "darwin")
    monkeypatch.setattr(udp.addresses, "own_address", lambda towards: "10.0.0.7")
    opened.interfaces = []
    uri = f"<General><Interfaces><NetworkInterface {attributes}/></Interfaces></General>"
    uri += "<General><AllowMulticast>false</AllowMulticast></General>"
    settings = read_settings({"CYCLONEDDS_URI": uri}, own_domain_id)
    (notice,) = opened(own_domain_id, settings).notices
    assert "knows 10.0.0.7, 127.0.0.1 alone: give one of these addresses" in notice
    settings = read_settings({"CYCLONEDDS_URI": uri.replace("en0", "10.0.0.7")}, own_domain_id)
    if "en0" in uri:
        sockets = opened(own_domain_id, settings)
        assert not sockets.notices and sockets.unicast[0].address == "10.0.0.7"


# --- datagrams ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "kinds, address", [((UDPV4,), "127.0.0.1"), ((UDPV6,), "::1"), ((UDPV4, UDPV6), "::1")]
)
def test_datagrams_of_both_versions_of_ip(opened, own_domain_id, kinds, address):
    settings = NetworkSettings(kinds=kinds, stays_local=True, multicast=False)
    one, other = opened(own_domain_id, settings), opened(own_domain_id, settings)
    (place,) = [place for place in other.unicast if place.address == address]
    assert one.send(b"hello", place)
    assert [(bytes(data), source) for data, source in received(other)] == [(b"hello", address)]


def test_announcements_by_multicast_come_back(opened, own_domain_id):
    settings = NetworkSettings(stays_local=True)
    one, other = opened(own_domain_id, settings), opened(own_domain_id, settings)
    (group,) = one.multicast
    assert one.send(b"here", group)
    assert [bytes(data) for data, _ in received(other)] == [b"here"]
    assert not one.send_errors


@pytest.mark.skipif(sys.platform != "linux", reason="others deliver only joined groups anyway")
def test_announcements_come_from_joined_interfaces_alone(opened, own_domain_id):
    """Linux gives a socket what any other one has joined, too."""
    one = opened(own_domain_id, NetworkSettings(stays_local=True))
    opened.interfaces = [Interface("eth0", 2, UP, "10.0.0.1")]  # without a carrier
    other = opened(own_domain_id, NetworkSettings(stays_local=True))
    (group,) = one.multicast
    assert one.send(b"here", group)
    assert [bytes(data) for data, _ in received(one)] == [b"here"]
    assert not received(other) and not other.multicast


def test_what_cannot_be_sent_is_counted(opened, own_domain_id):
    sockets = opened(own_domain_id)
    assert sockets.send(b"x", Locator(UDPV4, 7410, "10.0.0.9"))  # the socket is on loopback
    assert sockets.send(b"x", Locator(UDPV6, 7410, "fd00::9"))  # there is no socket of IPv6
    assert sum(sockets.send_errors.values()) == 2
    assert sockets.send_errors[errno.EAFNOSUPPORT] == 1


class Faulty:
    """A socket that does not send."""

    def __init__(self, fault):
        self.fault = fault

    def sendto(self, datagram, address):
        raise self.fault

    def close(self):
        pass


@pytest.mark.parametrize("number", [errno.ENETUNREACH, errno.ENODEV, errno.EADDRNOTAVAIL])
def test_an_address_that_no_interface_reaches_is_told_once(opened, own_domain_id, number):
    sockets = opened(own_domain_id)
    sockets._sockets[UDPV4]._unicast.close()
    sockets._sockets[UDPV4]._unicast = Faulty(OSError(number, "no"))
    assert sockets.send(b"x", Locator(UDPV4, 7410, "10.0.0.9"))
    assert sockets.send_errors == {number: 1}
    assert sockets.unreachable == {"10.0.0.9"}


def test_buffers_are_as_large_as_the_system_allows(opened, own_domain_id):
    sock = opened(own_domain_id)._sockets[UDPV4].sockets[0]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        for option in (socket.SO_RCVBUF, socket.SO_SNDBUF):
            other.setsockopt(socket.SOL_SOCKET, option, 1024 * 1024)
            wanted = other.getsockopt(socket.SOL_SOCKET, option)
            assert sock.getsockopt(socket.SOL_SOCKET, option) >= wanted


def test_a_machine_without_ipv6_is_named(opened, own_domain_id, monkeypatch):
    real = socket.socket

    def without(family, kind):
        if family == socket.AF_INET6:
            raise OSError(errno.EAFNOSUPPORT, "Address family not supported by protocol")
        return real(family, kind)

    monkeypatch.setattr(ip_sockets.socket, "socket", without)
    settings = NetworkSettings(kinds=(UDPV4, UDPV6), stays_local=True, multicast=False)
    with pytest.raises(MiddlewareError, match="has no IPv6.*turn it on"):
        opened(own_domain_id, settings)


# --- a host that does not take what it is sent ----------------------------------------------------


class Full:
    """A socket without room for datagrams."""

    def __init__(self, sock):
        self._sock = sock

    def __getattr__(self, name):
        return getattr(self._sock, name)

    def sendto(self, datagram, to):
        raise BlockingIOError(errno.EAGAIN, "full")


def full(sockets):
    """The sockets of IPv4, whose common buffer is full."""
    each = sockets._sockets[UDPV4]
    each._unicast = Full(each._unicast)
    return each


class Listener:
    """A host on loopback with an address of its own."""

    def __init__(self, address):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind((address, 0))
        self.socket.settimeout(5.0)
        self.place = Locator(UDPV4, self.socket.getsockname()[1], address)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.socket.close()


def test_hosts_do_not_wait_for_one_that_has_filled_the_buffer(opened, own_domain_id):
    sockets = opened(own_domain_id)
    each = full(sockets)
    with Listener("127.0.0.2") as slow, Listener("127.0.0.3") as healthy:
        assert sockets.send(b"one", slow.place) and sockets.send(b"two", healthy.place)
        each._own[slow.place.address] = Full(each._own[slow.place.address])
        assert not sockets.send(b"three", slow.place)
        assert sockets.send(b"four", healthy.place)
        assert [healthy.socket.recv(9) for _ in range(2)] == [b"two", b"four"]
        assert slow.socket.recv(9) == b"one"


def test_a_buffer_of_its_own_sends_from_our_port_and_receives_nothing(opened, own_domain_id):
    sockets = opened(own_domain_id)
    full(sockets)
    port = port_of(own_domain_id, 0)
    with Listener("127.0.0.2") as host:
        assert sockets.send(b"out", host.place)
        _, source = host.socket.recvfrom(9)
        assert source[1] == port
        host.socket.sendto(b"back", source)
        assert received(sockets) == [(b"back", "127.0.0.2")]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        with pytest.raises(OSError, match="in use"):
            other.bind(("127.0.0.1", port))


def test_buffers_of_hosts_are_limited(opened, own_domain_id, monkeypatch):
    monkeypatch.setattr(ip_sockets, "_MAX_OWN", 2)
    sockets = opened(own_domain_id)
    each = full(sockets)
    for number in range(2, 6):
        with Listener(f"127.0.0.{number}") as host:
            assert sockets.send(b"x", host.place) and host.socket.recv(9) == b"x"
    assert list(each._own) == ["127.0.0.4", "127.0.0.5"]
    gone = list(each._own.values())
    sockets.close()
    assert [sock.fileno() for sock in gone] == [-1, -1]


def test_a_buffer_whose_address_of_ours_is_gone_is_left(opened, own_domain_id):
    sockets = opened(own_domain_id)
    common = sockets._sockets[UDPV4]._unicast
    each = full(sockets)
    with Listener("127.0.0.2") as host:
        assert sockets.send(b"one", host.place)
        each._own["127.0.0.2"].close()  # an error other than of a full buffer
        each._unicast = common
        assert sockets.send(b"two", host.place) and not sockets.send_errors
        assert [host.socket.recv(9) for _ in range(2)] == [b"one", b"two"]
    assert not each._own


def test_datagrams_wait_where_no_further_socket_can_be_opened(opened, own_domain_id, monkeypatch):
    """Nothing is lost for us then; those to a group wait, too."""
    sockets = opened(own_domain_id, NetworkSettings(stays_local=True))
    each = full(sockets)

    def none(*_):
        raise OSError(errno.EMFILE, "no descriptor is free")

    monkeypatch.setattr(ip_sockets.socket, "socket", none)
    assert not sockets.send(b"x", Locator(UDPV4, 9, "127.0.0.2"))
    assert not sockets.send(b"x", sockets.multicast[0])
    assert not each._own and not sockets.send_errors


# --- interfaces that change -----------------------------------------------------------------------


def test_interfaces_are_looked_at_soon_after_the_system_tells_of_a_change(opened, own_domain_id):
    """Attack and accident: a link that comes and goes without end."""
    ours, system = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    ours.setblocking(False)
    fileno = ours.fileno()
    with system:
        sockets = opened(own_domain_id, NetworkSettings(), 10.0, lambda: ours)
        assert sockets.scan_at == 10.0 + udp.SCAN_PERIOD and fileno in sockets.filenos()
        for _ in range(5):
            system.send(b"a change")
        assert not list(sockets.receive(fileno))
        assert sockets.scan_at == 10.0 + udp._SCAN_PAUSE
        with pytest.raises(BlockingIOError):
            ours.recv(100)
        sockets.close()
        assert ours.fileno() == -1 and fileno not in sockets.filenos()


def test_without_the_network_no_changes_are_waited_for(opened, own_domain_id):
    def none():
        raise AssertionError("loopback does not change")

    assert len(opened(own_domain_id, LOCAL, 0.0, none).filenos()) == 2


def test_the_two_interfaces_of_a_system_that_lists_none_are_told_apart():
    found = udp._one_interface()
    assert len({one.index for one in found}) == len(found)
