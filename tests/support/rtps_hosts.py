"""Scenarios with the rtps middleware on several hosts; see tests/unit/.../test_interfaces.py."""

import os
from concurrent.futures import ThreadPoolExecutor

from support.networks import Host, Machines
from support.paths import ROOT
from support.peer import RosPeer
from uros.middleware.dds.middleware import DdsMiddleware
from uros.middleware.rtps import udp
from uros.middleware.rtps.locators import UDPV6
from uros.middleware.rtps.middleware import RtpsMiddleware
from uros.middleware.rtps.network import NetworkSettings
from uros.qos import QoSProfile

DOMAIN = 71
TYPE = "std_msgs::msg::dds_::String_"
UDP6 = "<General><Transport>udp6</Transport></General>"


def cdr(number):
    return b"\0\1\0\0" + number.to_bytes(4, "little")


class Station:
    """A host with a middleware and a node, which writes one topic and reads another."""

    def __init__(self, host, name, writes, reads, kind=RtpsMiddleware, uri="", reach="SUBNET",
                 peers=""):  # fmt: skip
        os.environ.update(
            CYCLONEDDS_URI=uri, ROS_AUTOMATIC_DISCOVERY_RANGE=reach, ROS_STATIC_PEERS=peers
        )
        self.host = host
        self.samples = []
        self.notices = []
        with host:
            self.middleware = kind()
            self.middleware.on_notice = self.notices.append
            node = self.middleware.create_node(DOMAIN, "/", name)
            self.writer = node.create_writer(writes, TYPE, QoSProfile())
            self.reader = node.create_reader(reads, TYPE, QoSProfile(), self.take)

    def take(self):
        self.samples += self.reader.take(100)

    @property
    def domain(self):
        return self.middleware._domains[DOMAIN]

    @property
    def sockets(self):
        return self.domain._sockets

    def announced(self):
        return {place.host for place in self.sockets.unicast}

    def announced_by(self, other):
        """The addresses that another one announces, as known here."""
        remote = self.domain.participant.remotes.get(other.domain.participant.guid[:12])
        return set() if remote is None else {p.host for p in remote.data.metatraffic_unicast}

    def write(self, sample):
        with self.host:
            assert self.writer.write(sample)
            self.middleware.flush()


def two(kind=RtpsMiddleware, links=(), scan_period=0.2, **more):
    udp.SCAN_PERIOD = scan_period
    a, b = Host(), Host()
    for number, (left, right) in enumerate(links):
        link(a, b, number, left, right)
    one = Station(a, "one", "rt/a", "rt/b", **more)
    other = Station(b, "other", "rt/b", "rt/a", kind, **more)
    return one, other, Machines((a, one.middleware), (b, other.middleware))


def link(a, b, number, left, right):
    a.plug(f"net{number}", b, f"net{number}")
    for host, address in ((a, left), (b, right)):
        if address:
            with host:
                host.ip(f"addr add {address} dev net{number}")


def talk(one, other, machines, number):
    """Samples arrive both ways."""
    machines.until(lambda: one.writer.matched() and other.writer.matched())
    one.write(cdr(number))
    other.write(cdr(number))
    machines.until(lambda: cdr(number) in other.samples and cdr(number) in one.samples)


def each_interface_carries_announcements():
    """Two peers on two networks that are not connected; they do not announce themselves."""
    a, b, c = Host(), Host(), Host()
    a.plug("left", b, "net0")
    a.plug("right", c, "net0")
    for host, name, address in (
        (a, "left", "10.9.1.1/24"), (a, "right", "10.9.2.1/24"),
        (b, "net0", "10.9.1.2/24"), (c, "net0", "10.9.2.2/24"),
    ):  # fmt: skip
        with host:
            host.ip(f"addr add {address} dev {name}")
    listeners = []
    for host in (b, c):
        with host:
            listeners.append(udp.DomainSockets(DOMAIN, NetworkSettings(), 0.0))
    one = Station(a, "one", "rt/a", "rt/b")
    machines = Machines((a, one.middleware))
    assert one.announced() == {"10.9.1.1", "10.9.2.1"}
    for listener, source in zip(listeners, ("10.9.1.1", "10.9.2.1"), strict=True):
        heard = set()
        machines.until(
            lambda listener=listener, heard=heard: heard.update(
                address for fileno in listener.filenos() for _, address in listener.receive(fileno)
            ) or heard
        )  # fmt: skip
        assert heard == {source}


def an_interface_that_appears_is_used():
    one, other, machines = two()
    assert one.announced() == {"127.0.0.1"}
    for _ in range(5):
        machines.turn()
    link(one.host, other.host, 0, "10.9.1.1/24", "10.9.1.2/24")
    talk(one, other, machines, 1)
    assert one.announced() == {"10.9.1.1"}
    link(one.host, other.host, 1, "10.9.2.1/24", "10.9.2.2/24")
    machines.until(lambda: other.announced_by(one) == {"10.9.1.1", "10.9.2.1"})
    talk(one, other, machines, 2)


def an_interface_that_vanishes_is_left():
    """The peer is reached over the other link; without any link nothing is raised."""
    links = [("10.9.1.1/24", "10.9.1.2/24"), ("10.9.2.1/24", "10.9.2.2/24")]
    one, other, machines = two(links=links)
    talk(one, other, machines, 1)
    remotes = one.domain.participant.remotes
    machines.until(lambda: all(len(remote.heard) == 2 for remote in remotes.values()))
    before = list(remotes.values())
    with one.host:
        one.host.ip("link del net0")
    talk(one, other, machines, 2)
    machines.until(lambda: one.announced() == other.announced_by(one) == {"10.9.2.1"})
    assert list(remotes.values()) == before  # it was not lost meanwhile
    with one.host:
        one.host.ip("link del net1")
    one.write(cdr(3))
    machines.until(lambda: one.announced() == {"127.0.0.1"})
    assert sum(one.sockets.send_errors.values()) > 0
    link(one.host, other.host, 0, "10.9.1.1/24", "10.9.1.2/24")
    machines.until(lambda: one.announced_by(other) == {"10.9.1.2"})
    machines.until(lambda: other.announced_by(one) == {"10.9.1.1"})
    talk(one, other, machines, 4)


def a_network_that_is_away_for_a_moment_changes_nothing():
    """As a Wi-Fi that comes back with the same address: nobody is lost, nothing is lost."""
    one, other, machines = two(links=[("10.9.1.1/24", "10.9.1.2/24")])
    talk(one, other, machines, 1)
    (before,) = one.domain.participant.remotes.values()
    with one.host:
        one.host.ip("link set net0 down")
    machines.until(lambda: one.announced() == {"127.0.0.1"})
    one.write(cdr(2))
    other.write(cdr(2))
    for _ in range(10):
        machines.turn()
    with one.host:
        one.host.ip("link set net0 up")
    machines.until(lambda: cdr(2) in other.samples and cdr(2) in one.samples)
    assert list(one.domain.participant.remotes.values()) == [before]


def a_link_that_goes_at_either_end_is_left_at_once():
    """Without a look at the interfaces now and then: the system tells of the change."""
    links = [("10.9.1.1/24", "10.9.1.2/24"), ("10.9.2.1/24", "10.9.2.2/24")]
    one, other, machines = two(links=links, scan_period=1000.0)
    talk(one, other, machines, 1)
    for number, station in enumerate((one, other), 2):
        with station.host:
            station.host.ip("link set net0 down")
        machines.until(lambda: one.announced_by(other) == {"10.9.2.2"} == {*other.announced()})
        machines.until(lambda: other.announced_by(one) == {"10.9.2.1"} == {*one.announced()})
        talk(one, other, machines, number)
        with station.host:
            station.host.ip("link set net0 up")
        machines.until(lambda: len(one.announced_by(other)) == len(other.announced_by(one)) == 2)
    talk(one, other, machines, 4)


def an_address_of_ours_that_vanishes_is_left():
    """The peer still announces its own address in that network, which is not reached any more."""
    links = [("10.9.1.1/24", "10.9.1.2/24"), ("10.9.2.1/24", "10.9.2.2/24")]
    one, other, machines = two(links=links)
    talk(one, other, machines, 1)
    (remote,) = one.domain.participant.remotes.values()
    machines.until(lambda: set(remote.heard) == {"10.9.1.2", "10.9.2.2"})
    with one.host:
        one.host.ip("addr del 10.9.1.1/24 dev net0")
    talk(one, other, machines, 2)
    assert one.announced_by(other) == {"10.9.1.2", "10.9.2.2"}
    assert remote in one.domain.participant.remotes.values()


def an_address_that_changes_is_followed():
    """At the end of the lease: until then another address with this GUID is another host."""
    one, other, machines = two(links=[("10.9.1.1/24", "10.9.1.2/24")])
    talk(one, other, machines, 1)
    with one.host:
        one.host.ip("addr flush dev net0")
        one.host.ip("addr add 10.9.1.7/24 dev net0")
    machines.until(lambda: other.announced_by(one) == {"10.9.1.7"})
    talk(one, other, machines, 2)


def ipv6():
    one, other, machines = two(links=[("fd00:9::1/64", "fd00:9::2/64")], uri=UDP6)
    assert one.announced() == {"fd00:9::1"}
    talk(one, other, machines, 1)


def link_local_ipv6():
    one, other, machines = two(links=[("", "")], uri=UDP6)
    machines.until(lambda: all(address.startswith("fe80:") for address in one.announced()))
    talk(one, other, machines, 1)
    (remote,) = one.domain.participant.remotes.values()
    assert all("%" in address for address in remote.heard)


def both_versions_of_ip():
    one, other, machines = two(
        links=[("10.9.1.1/24", "10.9.1.2/24"), ("fd00:9::1/64", "fd00:9::2/64")],
        peers="fd00:9::1;fd00:9::2",
    )
    assert {"10.9.1.1", "fd00:9::1"} <= one.announced()
    talk(one, other, machines, 1)


def cyclone_over_ipv6():
    one, other, machines = two(DdsMiddleware, [("fd00:9::1/64", "fd00:9::2/64")], uri=UDP6)
    talk(one, other, machines, 1)


def cyclone_over_two_interfaces():
    links = [("10.9.1.1/24", "10.9.1.2/24"), ("10.9.2.1/24", "10.9.2.2/24")]
    one, other, machines = two(DdsMiddleware, links)
    talk(one, other, machines, 1)


def a_peer_that_only_one_side_lists_is_kept():
    """Beyond the reach of multicast, longer than the lease."""
    a, b = Host(), Host()
    link(a, b, 0, "10.9.1.1/24", "10.9.1.2/24")
    uri = "<General><AllowMulticast>false</AllowMulticast></General>"
    one = Station(a, "one", "rt/a", "rt/b", uri=uri, peers="10.9.1.2")
    other = Station(b, "other", "rt/b", "rt/a", uri=uri)
    machines = Machines((a, one.middleware), (b, other.middleware))
    talk(one, other, machines, 1)


def fast_dds(link_addresses, variables, **more):
    """A real rclpy node with rmw_fastrtps on the other host; samples go both ways."""
    a, b = Host(), Host()
    for number, (left, right) in enumerate(link_addresses):
        link(a, b, number, left, right)
    one = Station(a, "one", "rt/a", "rt/b", **more)
    os.environ.update(
        {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "ROS_STATIC_PEERS": "", **variables}
    )
    machines = Machines((a, one.middleware))
    with b:
        peer = RosPeer(ROOT / ".venv-ros" / "bin" / "python", DOMAIN)
    with ThreadPoolExecutor(1) as thread:

        def peer_does(work, *arguments, **options):
            doing = thread.submit(work, *arguments, **options)
            machines.until(doing.done)
            return doing.result()

        peer_does(peer.__enter__)
        try:
            for topic in ("/a", "/b"):
                peer_does(peer.do, "subscribe", topic=topic, type="std_msgs/msg/String")
            machines.until(one.writer.matched)
            one.write(text("hello 1"))
            assert text("hello 1") == peer_does(peer.message, "/a")
            sent = [text("there 2").hex()]
            found = peer_does(peer.do, "publish", topic="/b", type="std_msgs/msg/String", cdr=sent)
            assert found["subscribers"] == 2
            machines.until(lambda: one.samples)
            assert one.samples == [text("there 2")]
            return one
        finally:
            peer_does(peer.__exit__)


def text(value):
    """A sample; seven letters need no padding."""
    raw = value.encode() + b"\0"
    return b"\0\1\0\0" + len(raw).to_bytes(4, "little") + raw


def fast_dds_over_ipv6():
    one = fast_dds(
        [("fd00:9::1/64", "fd00:9::2/64")], {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv6"}, uri=UDP6
    )
    assert {place.kind for place in one.sockets.unicast} == {UDPV6}


def fast_dds_over_two_interfaces():
    fast_dds([("10.9.1.1/24", "10.9.1.2/24"), ("10.9.2.1/24", "10.9.2.2/24")], {})


def fast_dds_that_lists_us_as_its_peer():
    """Both have the range LOCALHOST, and one of them lists the other."""
    fast_dds(
        [("10.9.1.1/24", "10.9.1.2/24")],
        {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_STATIC_PEERS": "10.9.1.1"},
        uri="<General><AllowMulticast>false</AllowMulticast></General>",
    )


def fast_dds_that_we_list_as_our_peer():
    fast_dds(
        [("10.9.1.1/24", "10.9.1.2/24")], {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
        reach="LOCALHOST", peers="10.9.1.2",
    )  # fmt: skip
