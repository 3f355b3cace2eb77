"""What a domain uses of the network, by the environment and by the interfaces that there are."""

import socket

import pytest

from uros.addresses import LOOPBACK, MULTICAST, RUNNING, UP, Interface
from uros.middleware import user_data
from uros.middleware.base import MiddlewareError
from uros.middleware.rtps import network
from uros.middleware.rtps.locators import UDPV4, UDPV6, Locator
from uros.middleware.rtps.network import announced, read_settings, stays_local
from uros.middleware.rtps.parameters import ParticipantData
from uros.middleware.rtps.spdp import ParticipantAnnouncer

LO = Interface("lo", 1, UP | RUNNING | LOOPBACK, "127.0.0.1", ("::1",))
ETH = Interface("eth0", 2, UP | RUNNING | MULTICAST, "10.0.0.1", ("fe80::1", "fd00::1"))
WLAN = Interface("wlan0", 3, UP | RUNNING | MULTICAST, "10.0.1.1")
VPN = Interface("wg0", 4, UP | RUNNING, "10.8.0.1")
UNPLUGGED = Interface("eth1", 5, UP | MULTICAST, "10.0.2.1")
ALL = [LO, ETH, WLAN, VPN, UNPLUGGED]


def settings(reach="", uri="", peers="", domain=0, **more):
    environment = {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": reach, "CYCLONEDDS_URI": uri, "ROS_STATIC_PEERS": peers,
        **more,
    }  # fmt: skip
    return read_settings(environment, domain)


def interface(attributes):
    return f"<General><Interfaces><NetworkInterface {attributes}/></Interfaces></General>"


def named(found):
    return [one.name for one in found]


# --- the discovery range ------------------------------------------------------------------------


def test_off_uses_nothing():
    assert settings("OFF", peers="10.0.0.9") == network.NetworkSettings(is_off=True)


def test_subnet_uses_multicast_on_every_interface_and_ipv4():
    found = settings()
    assert found.multicast and found.kinds == (UDPV4,) and found.peers == ()
    assert named(found.usable(ALL)) == ["eth0", "wlan0", "wg0"]
    assert [found.allows_multicast(one) for one in (LO, ETH, WLAN, VPN)] == [
        True,
        True,
        True,
        False,
    ]


def test_loopback_is_announced_only_where_it_is_alone():
    assert named(settings().usable([LO, UNPLUGGED])) == ["lo"]


@pytest.mark.parametrize("environment", [{"reach": "LOCALHOST"}, {"ROS_LOCALHOST_ONLY": "1"}])
def test_localhost_sends_no_multicast_and_looks_at_the_first_32_participants(environment):
    found = settings(**environment)
    assert found.stays_local and not found.multicast
    assert found.peers == tuple(
        Locator(UDPV4, 7410 + 2 * index, "127.0.0.1") for index in range(32)
    )
    assert named(found.usable(ALL)) == ["lo"]


def test_localhost_with_a_static_peer_reaches_that_peer_too():
    """As rmw_fastrtps and rmw_cyclonedds do."""
    found = settings("LOCALHOST", peers="10.0.0.9;127.0.0.1")
    assert not found.stays_local and not found.multicast
    assert {place.address for place in found.peers} == {"127.0.0.1", "10.0.0.9"}
    assert named(found.usable(ALL)) == ["eth0", "wlan0", "wg0"]
    assert settings("LOCALHOST", peers="127.0.0.2;localhost").stays_local


def test_ipv6_on_loopback_needs_no_multicast():
    """Linux does not carry multicast of IPv6 on loopback."""
    found = settings(uri=interface('name="::1"'))
    assert found.stays_local and found.kinds == (UDPV4, UDPV6)
    assert {place.address for place in found.peers} == {"127.0.0.1", "::1"}


def test_localhost_only_excludes_static_peers():
    assert settings(ROS_LOCALHOST_ONLY="1", peers="10.0.0.9").stays_local


def test_system_default_leaves_peers_to_cyclones_configuration():
    uri = '<Discovery><Peers><Peer Address="10.0.0.8"/></Peers></Discovery>'
    found = settings("SYSTEM_DEFAULT", uri, peers="10.0.0.9")
    assert found.multicast and {place.address for place in found.peers} == {"10.0.0.8"}


def test_a_range_that_does_not_exist_is_refused():
    with pytest.raises(MiddlewareError, match="'NEAR' does not exist"):
        settings("NEAR")


@pytest.mark.parametrize(
    "environment, local",
    [
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}, True),
        ({"ROS_LOCALHOST_ONLY": "1"}, True),
        ({"ROS_LOCALHOST_ONLY": "1", "CYCLONEDDS_URI": interface('name="eth0"')}, False),
        ({"CYCLONEDDS_URI": interface('address="127.0.0.1"')}, True),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_STATIC_PEERS": "10.0.0.9"}, False),
        ({}, False),
    ],
)
def test_what_stays_on_this_machine(environment, local):
    assert stays_local(environment, 0) is local


# --- peers --------------------------------------------------------------------------------------


def test_a_peer_with_a_port_is_one_place():
    uri = (
        '<Discovery><Peers><Peer Address="10.0.0.9:7411"/><Peer Address="[::1]:9"/>'
        '<Peer Address="[fd00::9]"/></Peers></Discovery><General><Transport>udp6</Transport>'
        "</General>"
    )
    found = settings(uri=uri, peers="::1")
    assert Locator(UDPV6, 9, "::1") in found.peers
    assert Locator(UDPV6, 7410, "fd00::9") in found.peers
    assert len(found.peers) == 1 + 32 + 32  # IPv4 is not used
    assert settings(peers="10.0.0.9:7411").peers == (Locator(UDPV4, 7411, "10.0.0.9"),)


def answers(monkeypatch, **hosts):
    """Names and their addresses."""

    def getaddrinfo(host, port, family, kind):
        if host not in hosts:
            raise socket.gaierror(-2, "Name or service not known")
        return [
            (socket.AF_INET6 if ":" in address else socket.AF_INET, kind, 17, "",
             (address, 0, 0, scope) if ":" in address else (address, 0))
            for address, scope in hosts[host]
        ]  # fmt: skip

    monkeypatch.setattr(socket, "getaddrinfo", getaddrinfo)


def test_each_address_of_a_name_is_a_peer(monkeypatch):
    answers(monkeypatch, robot=[("10.0.0.9", 0), ("10.0.1.9", 0), ("fd00::9", 0)])
    found = settings(peers="robot")
    assert found.kinds == (UDPV4,)
    assert {place.address for place in found.peers} == {"10.0.0.9", "10.0.1.9"}
    assert {place.port for place in found.peers} == set(range(7410, 7474, 2))


def test_a_peer_with_ipv6_alone_turns_ipv6_on(monkeypatch):
    answers(monkeypatch, robot=[("fe80::9%eth0", 2), ("fd00::9", 0)])
    found = settings(peers="robot")
    assert found.kinds == (UDPV4, UDPV6)
    assert {place.address for place in found.peers} == {"fe80::9%2", "fd00::9"}


def test_a_peer_that_cannot_be_found_is_named(monkeypatch):
    answers(monkeypatch)
    (notice,) = settings(peers="robot").notices
    assert "'robot' has no address" in notice and "ROS_STATIC_PEERS" in notice


def test_no_place_is_beyond_the_last_port():
    uri = "<Discovery><MaxAutoParticipantIndex>119</MaxAutoParticipantIndex></Discovery>"
    found = settings("LOCALHOST", uri, domain=232)
    assert max(place.port for place in found.peers) == 65534
    assert len(settings("LOCALHOST", uri).peers) == 120


# --- Cyclone's configuration --------------------------------------------------------------------


@pytest.mark.parametrize(
    "attributes, chosen",
    [
        ('name="wlan0"', ["wlan0"]),
        ('address="10.0.0.1"', ["eth0"]),
        ('address="fd00::1"', ["eth0"]),
        ('autodetermine="true"', ["eth0", "wlan0", "wg0"]),
        ('name="eth1"', []),
        ('name="lo"', ["lo"]),
    ],
)
def test_interfaces_that_the_user_chooses(attributes, chosen):
    found = settings(uri=interface(attributes))
    assert named(found.usable(ALL)) == chosen
    assert found.stays_local is (chosen == ["lo"])
    assert found.kinds == ((UDPV4, UDPV6) if "fd00" in attributes else (UDPV4,))


def test_a_chosen_interface_replaces_loopback_in_the_range_localhost():
    found = settings("LOCALHOST", interface('name="eth0"'))
    assert not found.multicast and not found.stays_local
    assert named(found.usable(ALL)) == ["eth0"]


def test_multicast_may_be_forbidden_in_all_or_on_one_interface():
    found = settings(uri="<General><AllowMulticast>false</AllowMulticast></General>")
    assert not found.multicast and found.peers[0].address == "127.0.0.1"
    uri = (
        '<General><Interfaces><NetworkInterface name="eth0" multicast="false"/>'
        '<NetworkInterface name="wlan0"/></Interfaces></General>'
    )
    found = settings(uri=uri)
    assert found.multicast and not found.allows_multicast(ETH) and found.allows_multicast(WLAN)
    assert settings(uri=interface('name="wg0" multicast="true"')).allows_multicast(VPN)


def test_multicast_may_be_forbidden_on_the_interfaces_that_are_chosen_automatically():
    found = settings(uri=interface('autodetermine="true" multicast="false"'))
    assert not found.multicast and found.peers[0].address == "127.0.0.1"
    assert named(found.usable(ALL)) == ["eth0", "wlan0", "wg0"]
    uri = (
        '<General><Interfaces><NetworkInterface autodetermine="true" multicast="false"/>'
        '<NetworkInterface name="wlan0"/></Interfaces></General>'
    )
    found = settings(uri=uri)
    assert found.multicast and named(found.usable(ALL)) == ["eth0", "wlan0", "wg0"]
    assert [found.allows_multicast(one) for one in (ETH, WLAN)] == [False, True]


def test_interfaces_that_all_forbid_multicast_are_as_without_multicast():
    found = settings(uri=interface('name="eth0" multicast="false"'))
    assert not found.multicast and found.peers[0].address == "127.0.0.1"


@pytest.mark.parametrize(
    "value, index", [("auto", None), ("default", None), ("none", -1), ("0", 0), ("7", 7)]
)
def test_the_participant_index(value, index):
    uri = f"<Discovery><ParticipantIndex>{value}</ParticipantIndex></Discovery>"
    assert settings(uri=uri).index == index


@pytest.mark.parametrize(
    "xml, kinds",
    [
        ("<Transport>udp6</Transport>", (UDPV6,)),
        ("<Transport>udp</Transport>", (UDPV4,)),
        ("<UseIPv6>true</UseIPv6>", (UDPV6,)),
        ("<Transport>default</Transport>", (UDPV4,)),
    ],
)
def test_versions_of_ip(xml, kinds):
    assert settings(uri=f"<General>{xml}</General>").kinds == kinds


@pytest.mark.parametrize(
    ("configured", "octets"), [("1000B", 1000), ("65500B", 14_720), ("1B", 576), ("default", 1400)]
)
def test_the_size_of_messages_has_limits(configured, octets):
    uri = f"<General><MaxMessageSize>{configured}</MaxMessageSize></General>"
    assert settings(uri=uri).message_size == octets
    assert settings().message_size == 1400


def test_what_does_not_count_is_named_in_one_notice():
    (notice,) = settings(uri="<Tracing/><Sizing/>").notices
    assert "leaves out Tracing, Sizing" in notice
    read = ["interfaces", "Peers", "AllowMulticast", "Transport", "UseIPv6", "MaxMessageSize",
            "ParticipantIndex", "MaxAutoParticipantIndex"]  # fmt: skip
    assert all(name in notice for name in read)


# --- announced addresses ------------------------------------------------------------------------


def test_announced_addresses():
    both = (UDPV4, UDPV6)
    assert announced([ETH, WLAN], both, 7410, 1400) == [
        Locator(UDPV4, 7410, "10.0.0.1"), Locator(UDPV4, 7410, "10.0.1.1"),
        Locator(UDPV6, 7410, "fd00::1"),
    ]  # fmt: skip
    link = Interface("eth0", 2, UP | RUNNING, "", ("fe80::1",))
    assert announced([link], both, 7410, 1400) == [Locator(UDPV6, 7410, "fe80::1")]
    assert announced([], both, 7410, 1400) == [
        Locator(UDPV4, 7410, "127.0.0.1"), Locator(UDPV6, 7410, "::1")
    ]  # fmt: skip


@pytest.mark.parametrize(("message_size", "addresses"), [(1400, 16), (14_720, 16), (576, 6)])
def test_an_announcement_of_many_interfaces_fits_into_a_message(message_size, addresses):
    many = [Interface(f"v{n}", n, UP | RUNNING, f"10.1.{n}.1") for n in range(200)]
    places = announced(many, (UDPV4,), 7410, message_size)
    assert len(places) == addresses
    groups = [Locator(UDPV4, 7400, "239.255.0.1"), *[Locator(UDPV6, 7400, "ff02::1")] * 2]
    data = ParticipantData(
        bytes(16), 0, "", 0, 20_000, places, groups, places, [], user_data.PARTICIPANT
    )
    assert len(ParticipantAnnouncer(data, [], 0.0).announcement()) <= message_size
