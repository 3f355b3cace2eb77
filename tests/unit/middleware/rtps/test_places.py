"""Where participants are sent to: IPv6, several addresses, and locators that change."""

import pytest
from support.rtps_network import (
    BEST_EFFORT,
    Inbox,
    Network,
    Stranger,
    announcement,
    cdr,
    prefix,
    writer_of,
)

from uros.middleware.rtps import ids, locators, parameters, submessages
from uros.middleware.rtps.locators import UDPV4, UDPV6, Locator
from uros.middleware.rtps.parameters import ParticipantData
from uros.middleware.rtps.participant import Participant
from uros.middleware.rtps.remote import RemoteParticipant


def v4(address, port=7410):
    return Locator(UDPV4, port, address)


def v6(address, port=7410):
    return Locator(UDPV6, port, address)


class Hosts(Network):
    """Participants with any addresses, which know each other as peers; there is no multicast."""

    def join(self, number, places, peers=()):
        member = Participant(prefix(number), 0, places, [], list(peers), b"", self.now)
        for place in places:
            self.members[place.address] = member
        return member

    def carry(self):
        """Datagrams of a host come from its first address of their version of IP."""
        for _ in range(100):
            sent = []
            for member in dict.fromkeys(self.members.values()):
                member.poll(self.now)
                own = [address for address, known in self.members.items() if known is member]
                for datagram, place in member.take_datagrams():
                    source = [a for a in own if (":" in a) == (place.kind == UDPV6)]
                    if source:
                        sent.append((source[0], datagram, place))
            self.log += sent
            if not sent:
                return
            for source, datagram, place in sent:
                if place.address in self.members:
                    target = self.members[place.address]
                    target.receive(memoryview(datagram), source, self.now)
        raise AssertionError("they do not stop talking")


@pytest.fixture
def network():
    return Network()


@pytest.fixture
def hosts():
    return Hosts()


def remote_of(heard):
    remote = RemoteParticipant(ParticipantData(prefix(9) + ids.ENTITY_PARTICIPANT), 0.0)
    for address in heard:
        remote.hear(address)
    return remote


@pytest.mark.parametrize(
    "heard, announced, place",
    [
        (["10.0.0.9"], [v6("fd00::9"), v4("10.0.0.9")], v4("10.0.0.9")),
        (["fd00::9"], [v4("10.0.0.9"), v6("fd00::9", 7412)], v6("fd00::9", 7412)),
        # Behind a translation of addresses: the port of a locator of the same version.
        (["fd00::1"], [v4("10.0.0.9", 1), v6("fd00::9", 2)], v6("fd00::1", 2)),
        (["10.0.0.1"], [v6("fd00::9", 2), v4("172.17.0.9", 1)], v4("10.0.0.1", 1)),
        (["fd00::1"], [v4("10.0.0.9")], None),
        # A link-local address is announced without the interface here.
        (["fe80::9%3"], [v6("fd00::9", 1), v6("fe80::9", 2)], v6("fe80::9%3", 2)),
        (["::1"], [v6("::1")], v6("::1")),
        ([], [v4("10.0.0.9")], None),
        (["10.0.0.9"], [v4("239.255.0.1"), v4("10.0.0.9")], v4("10.0.0.9")),
        (["fd00::9"], [v6("ff02::1"), v6("fd00::9")], v6("fd00::9")),
    ],
)
def test_places(heard, announced, place):
    assert remote_of(heard).place(announced) == place


def test_a_link_local_address_on_another_link_is_another_host():
    remote = remote_of(["fe80::9%3"])
    assert remote.is_from("fe80::9%3") and not remote.is_from("fe80::9%4")
    remote.data.metatraffic_unicast.append(v6("fe80::9"))
    assert remote.is_from("fe80::9%4") and "fe80::9%4" not in remote.heard


@pytest.mark.parametrize(
    "places", [(v6("fd00::1"), v6("fd00::2")), (v6("fe80::1%2"), v6("fe80::2%2"))]
)
def test_participants_of_ipv6_exchange_samples(hosts, places):
    one = hosts.join(1, [places[0]], [places[1]])
    two = hosts.join(2, [places[1]])
    writer, inbox = writer_of(hosts, one), Inbox(hosts, two)
    hosts.until(writer.matched)
    writer.write(cdr(1), 0, hosts.now)
    hosts.until(lambda: inbox.samples == [cdr(1)])


def test_nothing_is_sent_to_an_ipv6_address_that_was_not_heard(hosts):
    one = hosts.join(1, [v4("10.0.0.1"), v6("fd00::1")])
    data = ParticipantData(
        prefix(66) + ids.ENTITY_PARTICIPANT, domain=0, builtin=0x3F,
        metatraffic_unicast=[v6("2001:db8::99")], default_unicast=[v6("2001:db8::99")],
    )  # fmt: skip
    one.receive(memoryview(announcement(data)), "fd00::66", hosts.now)
    hosts.step(1.0, 10)
    assert {place.address for _, _, place in hosts.log} == {"fd00::66"}
    octets = sum(len(datagram) for _, datagram, _ in hosts.log)
    assert octets <= one.remotes[prefix(66)].received


def test_a_farewell_over_ipv6_counts_only_from_the_address_that_was_heard(hosts):
    one = hosts.join(1, [v6("fe80::1%2")])
    guid = prefix(66) + ids.ENTITY_PARTICIPANT
    data = ParticipantData(guid, domain=0, metatraffic_unicast=[v6("fe80::66")])
    one.receive(memoryview(announcement(data)), "fe80::66%2", hosts.now)
    farewell = announcement(
        data, parameters.write_farewell_qos(guid), True, parameters.write_key(guid)
    )
    one.receive(memoryview(farewell), "fe80::66%3", hosts.now)
    assert one.remotes
    one.receive(memoryview(farewell), "fe80::66%2", hosts.now)
    assert not one.remotes


def test_a_participant_that_only_one_side_lists_as_its_peer_is_kept(hosts):
    """Beyond the reach of multicast, the other one hears of it alone."""
    one = hosts.join(1, [v4("10.0.0.1")], [v4("10.0.1.2")])
    two = hosts.join(2, [v4("10.0.1.2")])
    hosts.until(lambda: one.remotes and two.remotes)
    gone = []
    for member in (one, two):
        member.on_participant = lambda data, is_there: gone.append(data) if not is_there else None
    hosts.step(0.5, 200)
    assert one.remotes and two.remotes and not gone


def test_a_participant_with_a_long_announcement_answers_a_short_one_soon(hosts):
    """Not at once: an announcement may be forged, and the answer would be longer."""
    places = [v4(f"10.0.{number}.2") for number in range(6)]
    hosts.join(2, places)
    one = hosts.join(1, [v4("10.0.0.1")], places[:1])
    hosts.carry()
    assert not one.remotes
    hosts.step(0.05, 10)
    assert one.remotes


def test_other_locators_are_announced_to_all_that_were_heard(hosts):
    """They need be no peers of ours."""
    one = hosts.join(1, [v4("10.0.0.1")], [v4("10.0.0.2")])
    two = hosts.join(2, [v4("10.0.0.2")])
    hosts.until(lambda: one.remotes and two.remotes)
    hosts.step(0.1, 20)
    hosts.carry()
    places = [v4("10.0.0.2"), v4("10.0.5.2")]
    two.move(places, [], hosts.now)
    hosts.carry()
    assert one.remotes[prefix(2)].data.metatraffic_unicast == places


def test_other_locators_are_announced_at_once_with_a_new_number(hosts):
    one = hosts.join(1, [v4("10.0.0.1")], [v4("10.0.0.2")])
    two = hosts.join(2, [v4("10.0.0.2")], [v4("10.0.0.1")])
    hosts.until(lambda: one.remotes and two.remotes)
    hosts.step(1.0, 10)
    hosts.carry()
    hosts.log.clear()
    places = [v4("10.0.0.1"), v4("10.0.5.1")]
    one.move(places, [], hosts.now)
    hosts.carry()
    assert two.remotes[prefix(1)].data.metatraffic_unicast == places
    assert two.remotes[prefix(1)].data.default_unicast == places
    hosts.step(1.0, 10)
    numbers = [
        submessage.number
        for source, datagram, _ in hosts.log
        if source == "10.0.0.1"
        for submessage in submessages.read(memoryview(datagram))
        if isinstance(submessage, submessages.Data) and submessage.writer == ids.SPDP_WRITER
    ]
    assert len(numbers) > 3 and numbers == sorted(set(numbers))


def test_an_address_that_cannot_be_reached_is_left_for_another_one(hosts):
    one = hosts.join(1, [v4("10.0.0.1"), v4("10.0.5.1")], [v4("10.0.0.2")])
    two = hosts.join(2, [v4("10.0.0.2"), v4("10.0.5.2")], [v4("10.0.0.1")])
    writer, inbox = writer_of(hosts, one, qos=BEST_EFFORT), Inbox(hosts, two, qos=BEST_EFFORT)
    hosts.until(writer.matched)
    (remote,) = one.remotes.values()
    one.leave_address("10.0.0.2")
    assert list(remote.heard) == ["10.0.0.2"]  # there is no other
    remote.hear("10.0.5.2")
    one.leave_address("10.0.0.2")
    hosts.log.clear()
    writer.write(cdr(1), 0, hosts.now)
    one.flush()
    assert {place.address for _, place in one.take_datagrams()} == {"10.0.5.2"}
    assert not inbox.samples


def reply_to(*places):
    """INFO_REPLY."""
    body = len(places).to_bytes(4, "little") + b"".join(map(locators.encode, places))
    return bytes([ids.INFO_REPLY, 1]) + len(body).to_bytes(2, "little") + body


def test_answers_go_where_info_reply_asks_for_them_if_the_reader_was_heard_from_there(network):
    one = network.add(1)
    stranger = Stranger(network, one)
    stranger.announce()
    reader = stranger.endpoint("rt/chatter", False)
    writer = writer_of(network, one)
    writer.write(cdr(1), 0, network.now)
    network.step(0.2, 10)
    to_us = submessages.encode_info_dst(prefix(1))

    def answers(count, *more):
        ask = submessages.encode_acknack(reader[12:], writer.data.guid[12:], 1, [1], count)
        network.log.clear()
        stranger.send(to_us, *more, ask)
        network.step(0.05, 10)
        return {
            place
            for source, datagram, place in network.log
            if source == "10.0.0.1"
            for sent in submessages.read(memoryview(datagram))
            if isinstance(sent, submessages.Data) and sent.writer == writer.data.guid[12:]
        }

    assert answers(1) == {stranger.place}
    other_port = v4("10.0.0.66", 9999)
    assert answers(2, reply_to(other_port)) == {other_port}
    assert answers(3) == {stranger.place}  # INFO_REPLY counts for its message
    # Attack: answers to a third host. It gets none; they go to where the reader was heard.
    assert answers(4, reply_to(v4("192.0.2.9", 9999))) == {other_port}
    assert answers(5, reply_to(v4("239.255.0.1", 7400))) == {stranger.place}
    source = bytes([ids.INFO_SRC, 1, 20, 0]) + bytes(4) + b"\2\3" + ids.VENDOR + stranger.prefix
    assert answers(6, reply_to(other_port), source) == {stranger.place}


def test_where_readers_want_answers_is_forgotten_with_them(network):
    one = network.add(1)
    stranger = Stranger(network, one)
    stranger.announce()
    (remote,) = one.remotes.values()
    writer = writer_of(network, one)
    reader = stranger.endpoint("rt/chatter", False)
    unknown = stranger.prefix + b"\0\0\x55\4"
    for number, guid in enumerate((reader, unknown), 1):
        ask = submessages.encode_acknack(guid[12:], writer.data.guid[12:], 1, [], number)
        stranger.send(submessages.encode_info_dst(prefix(1)), reply_to(v4("10.0.0.66", 9)), ask)
    assert list(remote.answers_to) == [reader]
    farewell = submessages.encode_data(
        bytes(4), ids.SUBSCRIPTIONS_WRITER, 2, parameters.write_key(reader),
        parameters.write_farewell_qos(reader), True,
    )  # fmt: skip
    stranger.send(farewell)
    assert not remote.endpoints and not remote.answers_to
