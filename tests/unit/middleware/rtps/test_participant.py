"""Participants on a simulated network: discovery, data, farewells, and what strangers may do."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.rtps_network import (
    BEST_EFFORT,
    GROUP,
    LATCHED,
    Inbox,
    Network,
    Stranger,
    announcement,
    cdr,
    pair,
    prefix,
    writer_of,
)

from uros.middleware.qos_matching import Mismatch
from uros.middleware.rtps import ids, outbox, parameters, participant, submessages
from uros.middleware.rtps.locators import UDPV4, Locator
from uros.middleware.rtps.parameters import ParticipantData
from uros.qos import HistoryPolicy, QoSProfile


@pytest.fixture
def network():
    return Network()


# --- discovery ------------------------------------------------------------------------------------


def test_participants_find_each_other_at_once_and_keep_each_other(network):
    one, two = network.add(1), network.add(2)
    network.carry()
    assert set(one.remotes) == {prefix(2)} and set(two.remotes) == {prefix(1)}
    network.step(1.0, 100)
    assert one.remotes and two.remotes


def test_participants_of_other_domains_and_tags_are_not_for_us(network):
    one = network.add(1)
    network.add(2, domain=5)
    network.step(0.2, 10)
    assert not one.remotes
    stranger = ParticipantData(prefix(3) + ids.ENTITY_PARTICIPANT, domain=0, domain_tag="lab")
    network.inject("10.0.0.3", announcement(stranger), one)
    assert not one.remotes


@pytest.mark.parametrize("loss", [0.0, 0.3])
@pytest.mark.parametrize("writer_first", [True, False])
def test_endpoints_match_and_samples_arrive(loss, writer_first):
    network = Network(loss)
    one, two = network.add(1), network.add(2)
    if writer_first:
        writer = writer_of(network, one)
        network.step(count=5)
        inbox = Inbox(network, two)
    else:
        inbox = Inbox(network, two)
        network.step(count=5)
        writer = writer_of(network, one)
    network.until(lambda: writer.matched() and inbox.reader.state.writers)
    for number in range(20):
        assert writer.write(cdr(number), 0, network.now)
        network.step()
    network.until(lambda: len(inbox.samples) >= 20)
    assert inbox.samples == [cdr(number) for number in range(20)]


def test_a_large_sample_arrives_over_a_link_that_loses(network):
    one, two = pair(network)
    writer, inbox = writer_of(network, one), Inbox(network, two)
    network.until(writer.matched)
    network.loss = 0.1
    writer.write(cdr(1, 200_000), 0, network.now)
    network.until(lambda: inbox.samples)
    assert inbox.samples == [cdr(1, 200_000)]
    assert all(len(datagram) <= outbox.MESSAGE_SIZE for _, datagram, _ in network.log)


def test_samples_of_one_turn_share_messages(network):
    one, two = pair(network)
    writer, inbox = writer_of(network, one), Inbox(network, two)
    network.until(writer.matched)
    network.step(0.3, 10)
    network.log.clear()
    for number in range(10):
        writer.write(cdr(number), 0, network.now)
    network.carry()
    assert len(network.sent("10.0.0.1")) == 1 and len(inbox.samples) == 10


def test_readers_of_one_participant_get_a_sample_in_one_datagram(network):
    one, two = pair(network)
    writer = writer_of(network, one, qos=BEST_EFFORT)
    inboxes = [Inbox(network, two, qos=BEST_EFFORT) for _ in range(5)]
    network.until(lambda: writer.matched() == 5)
    network.step(0.3, 10)
    network.log.clear()
    writer.write(cdr(1), 0, network.now)
    network.carry()
    assert len(network.sent("10.0.0.1")) == 1
    assert [inbox.samples for inbox in inboxes] == [[cdr(1)]] * 5


def test_a_late_reader_gets_what_a_transient_local_writer_kept(network):
    one, two = pair(network)
    writer = writer_of(network, one, qos=LATCHED)
    for number in range(5):
        writer.write(cdr(number), 0, network.now)
    network.step(0.5)
    inbox = Inbox(network, two, qos=LATCHED)
    network.until(lambda: len(inbox.samples) == 3)
    assert inbox.samples == [cdr(2), cdr(3), cdr(4)]


def test_what_does_not_match_is_named(network):
    one, two = pair(network)
    named = []
    one.on_mismatch = lambda ours, theirs, why: named.append([item.policy for item in why])
    writer = writer_of(network, one, qos=BEST_EFFORT)
    Inbox(network, two)
    Inbox(network, two, type_name="other::msg::dds_::Type_")
    Inbox(network, two, topic="rt/other")
    network.step(0.2, 20)
    assert writer.matched() == 0 and named == [["reliability"]]


@pytest.mark.parametrize(
    ("is_writer", "representations", "offered", "requested"),
    [
        (False, (ids.XCDR2,), "XCDR1", "XCDR2"),
        (False, (1, ids.XCDR2, 7), "XCDR1", "XML, XCDR2, 7"),
        (False, tuple(range(1, 17)), "XCDR1", "XML, XCDR2, 3, 4 and 12 more"),
        (True, (ids.XCDR2,), "XCDR2", "XCDR1"),
        (True, (ids.XCDR2, ids.XCDR1), "XCDR2", "XCDR1"),  # a writer writes in its first one
        (True, (7,), "7", "XCDR1"),
    ],
)
def test_endpoints_without_a_common_representation_do_not_match(
    network, is_writer, representations, offered, requested
):
    one = network.add(1)
    named = []
    one.on_mismatch = lambda ours, theirs, why: named.extend(why)
    ours = Inbox(network, one).reader if is_writer else writer_of(network, one)
    remote = Stranger(network, one)
    remote.announce()
    guid = remote.endpoint("rt/chatter", is_writer, representations=representations)
    assert guid not in (ours.state.writers if is_writer else ours.state.readers)
    assert named == [Mismatch("data representation", offered, requested)]


@pytest.mark.parametrize(
    ("is_writer", "representations"),
    [(False, (ids.XCDR2, ids.XCDR1)), (True, (ids.XCDR1, ids.XCDR2)), (True, ())],
)
def test_endpoints_with_a_common_representation_match(network, is_writer, representations):
    one = network.add(1)
    ours = Inbox(network, one).reader if is_writer else writer_of(network, one)
    remote = Stranger(network, one)
    remote.announce()
    guid = remote.endpoint("rt/chatter", is_writer, representations=representations)
    assert guid in (ours.state.writers if is_writer else ours.state.readers)


@pytest.mark.parametrize("qos", [QoSProfile(), LATCHED])
def test_deleted_endpoints_are_gone_at_the_other_side(network, qos):
    one, two = pair(network)
    writer, inbox = writer_of(network, one, qos=qos), Inbox(network, two, qos=qos)
    network.until(lambda: writer.matched() and inbox.reader.state.writers)
    events = []
    two.on_endpoint = lambda data, is_there: events.append((data.guid, is_there))
    one.delete(writer, network.now, 0)
    one.delete(writer, network.now, 0)
    network.until(lambda: not inbox.reader.state.writers)
    assert events == [(writer.data.guid, False)]
    two.delete(inbox.reader, network.now, 0)
    network.step(0.2, 10)
    # What was deleted is not announced to those that come later.
    late = network.add(3)
    network.until(lambda: len(late.remotes) == 2)
    network.step(0.2, 10)
    assert not any(remote.endpoints for remote in late.remotes.values())


def test_a_farewell_ends_everything_at_once(network):
    one, two = pair(network)
    writer, inbox = writer_of(network, one), Inbox(network, two)
    network.until(writer.matched)
    gone = []
    one.on_participant = lambda data, is_there: gone.append((data.guid, is_there))
    two.close()
    two.close()
    network.carry()
    assert not one.remotes and writer.matched() == 0
    assert gone == [(two.guid, False)] and inbox.samples == []


def test_a_participant_that_falls_silent_is_gone_after_its_lease(network):
    one, two = pair(network)
    writer = writer_of(network, one)
    Inbox(network, two)
    network.until(writer.matched)
    del network.members["10.0.0.2"]
    network.step(1.0, 19)
    assert one.remotes
    network.step(1.0, 5)
    assert not one.remotes and writer.matched() == 0


def test_a_participant_that_is_killed_and_comes_back_is_another(network):
    one, _ = pair(network)
    writer = writer_of(network, one)
    del network.members["10.0.0.2"]
    again = network.add(7, address="10.0.0.2")
    inbox = Inbox(network, again)
    network.until(writer.matched)
    writer.write(cdr(1), 0, network.now)
    network.until(lambda: inbox.samples)


def test_entity_ids_are_those_of_topics_without_keys(network):
    one = network.add(1)
    writer, inbox = writer_of(network, one), Inbox(network, one)
    assert writer.data.guid[-1] == 0x03 and inbox.reader.data.guid[-1] == 0x04
    assert writer.data.guid[:2] == ids.VENDOR not in (b"\x01\x0f", b"\x01\x10", b"\0\0")


# --- strangers ------------------------------------------------------------------------------------


def sent_to(network, member):
    """The addresses that a participant sends to from now on."""
    network.log.clear()
    network.step(0.2, 10)
    source = next(address for address, known in network.members.items() if known is member)
    return {place.address for sender, _, place in network.log if sender == source} - {GROUP.address}


def test_nothing_is_sent_to_an_address_that_was_not_heard(network):
    """A participant that names the address of a third host makes nobody send there."""
    one = network.add(1)
    stranger = Stranger(network, one, said="192.0.2.99")
    stranger.announce()
    stranger.endpoint("rt/chatter", False, places=[Locator(UDPV4, 9999, "192.0.2.99")])
    writer = writer_of(network, one)
    assert writer.matched() == 1
    writer.write(cdr(1), 0, network.now)
    assert sent_to(network, one) == {"10.0.0.66"}


def test_a_participant_that_has_not_answered_gets_no_more_octets_than_came(network):
    """A forged announcement must not make a flood at the address that it names."""
    one = network.add(1)
    for _ in range(200):
        writer_of(network, one)
    network.carry()
    network.log.clear()
    stranger = Stranger(network, one)
    stranger.announce()
    (remote,) = one.remotes.values()
    network.step(0.1, 180)
    octets = sum(len(datagram) for _, datagram, place in network.log if place != GROUP)
    assert 0 < octets <= remote.received < 1000
    acknack = submessages.encode_acknack(
        ids.PUBLICATIONS_READER, ids.PUBLICATIONS_WRITER, 1, range(1, 201), 1
    )
    stranger.send(acknack)
    stranger.send(submessages.encode_info_dst(prefix(2)), acknack)
    assert not remote.is_proven
    stranger.send(submessages.encode_info_dst(prefix(1)), acknack)
    assert remote.is_proven
    network.log.clear()
    network.step(0.1, 5)
    assert sum(len(datagram) for _, datagram, place in network.log if place != GROUP) > 10_000


def test_a_participant_that_missed_our_answer_gets_another_one(network):
    """Fast DDS announces itself a moment before it handles what comes."""
    one = network.add(1)
    stranger = Stranger(network, one)

    def answers():
        """How often it announced itself to the stranger alone."""
        network.carry()
        return sum(
            isinstance(submessage, submessages.Data) and submessage.writer == ids.SPDP_WRITER
            for _, datagram, place in network.log
            if place.address == stranger.address
            for submessage in submessages.read(memoryview(datagram))
        )

    stranger.announce(user_data=bytes(200))
    assert answers() == 1
    network.now += 0.01
    stranger.announce(user_data=bytes(200))
    assert answers() == 1  # two that have not answered do not announce themselves in turn
    network.now += 0.1
    stranger.announce(user_data=bytes(200))
    assert answers() == 2
    acknack = submessages.encode_acknack(ids.PUBLICATIONS_READER, ids.PUBLICATIONS_WRITER, 1, (), 1)
    stranger.send(submessages.encode_info_dst(prefix(1)), acknack)
    network.now += 0.1
    stranger.announce(user_data=bytes(200))
    assert answers() == 2


def test_a_farewell_from_another_address_does_not_count(network):
    one, two = pair(network)
    farewell = announcement(
        ParticipantData(two.guid), parameters.write_farewell_qos(two.guid), True,
        parameters.write_key(two.guid),
    )  # fmt: skip
    network.inject("10.0.0.66", farewell, one)
    assert one.remotes
    network.inject("10.0.0.2", farewell, one)
    assert not one.remotes


def test_an_announcement_from_another_address_changes_nothing(network):
    """Somebody else with the GUID of a participant."""
    one, two = pair(network)
    thief = ParticipantData(
        two.guid, domain=0, lease_ms=1,
        metatraffic_unicast=[Locator(UDPV4, 7410, "10.0.0.66")],
    )  # fmt: skip
    before = one.remotes[prefix(2)].data
    network.inject("10.0.0.66", announcement(thief), one)
    assert one.remotes[prefix(2)].data is before
    assert "10.0.0.66" not in one.remotes[prefix(2)].heard


def test_data_from_another_address_is_not_taken(network):
    one, two = pair(network)
    writer, inbox = writer_of(network, one, qos=BEST_EFFORT), Inbox(network, two, qos=BEST_EFFORT)
    network.until(writer.matched)
    entity = writer.data.guid[12:]
    forged = submessages.header(prefix(1)) + submessages.encode_data(bytes(4), entity, 9, cdr(9))
    network.inject("10.0.0.66", forged, two)
    assert not inbox.samples
    network.inject("10.0.0.1", forged, two)
    assert inbox.samples == [cdr(9)]


def test_nobody_speaks_for_others(network):
    one = network.add(1)
    other = ParticipantData(prefix(50) + ids.ENTITY_PARTICIPANT, domain=0)
    datagram = submessages.header(prefix(66)) + announcement(other)[20:]
    network.inject("10.0.0.66", datagram, one)
    assert not one.remotes
    stranger = Stranger(network, one)
    stranger.announce()
    stranger.endpoint("rt/chatter", False, guid=prefix(50) + b"\0\0\1\4")
    assert not one.remotes[stranger.prefix].endpoints


def test_what_comes_from_an_unknown_participant_is_dropped(network):
    one = network.add(1)
    inbox = Inbox(network, one)
    stranger = Stranger(network, one)
    stranger.endpoint("rt/chatter", True)
    stranger.send(submessages.encode_data(bytes(4), b"\0\0\1\3", 1, cdr(1)))
    assert not one.remotes and not inbox.samples


def test_participants_and_endpoints_have_a_limit(network, monkeypatch):
    monkeypatch.setattr(participant, "MAX_PARTICIPANTS", 5)
    monkeypatch.setattr(participant, "MAX_ENDPOINTS", 10)
    one = network.add(1)
    strangers = [Stranger(network, one, number) for number in range(60, 70)]
    for stranger in strangers:
        stranger.announce()
    assert len(one.remotes) == 5
    for _ in range(20):
        strangers[0].endpoint("rt/chatter", False)
    assert len(one.remotes[strangers[0].prefix].endpoints) == 10


def test_a_lease_without_end_has_one(network):
    one = network.add(1)
    stranger = Stranger(network, one)
    stranger.announce(lease_ms=None)
    (remote,) = one.remotes.values()
    assert remote.expires <= network.now + 600


def test_a_participant_at_an_address_it_does_not_announce_is_reached_where_it_was_heard(network):
    """Behind a translation of addresses."""
    one = network.add(1)
    stranger = Stranger(network, one, said="172.17.0.2")
    stranger.announce()
    assert sent_to(network, one) == {"10.0.0.66"}


def test_another_destination_is_not_for_us(network):
    one = network.add(1)
    inbox = Inbox(network, one, qos=BEST_EFFORT)
    stranger = Stranger(network, one)
    stranger.announce()
    guid = stranger.endpoint("rt/chatter", True)
    data = submessages.encode_data(bytes(4), guid[12:], 1, cdr(1))
    stranger.send(submessages.encode_info_dst(prefix(9)), data)
    assert not inbox.samples
    stranger.send(submessages.encode_info_dst(prefix(9)), submessages.encode_info_dst(bytes(12)),
                  data)  # fmt: skip
    assert inbox.samples == [cdr(1)]


def test_an_endpoint_that_becomes_another_one_matches_as_that(network):
    one = network.add(1)
    inboxes = [Inbox(network, one, topic=topic, qos=BEST_EFFORT) for topic in ("rt/a", "rt/b")]
    writer = writer_of(network, one, topic="rt/b")
    stranger = Stranger(network, one)
    stranger.announce()
    guid = stranger.endpoint("rt/a", True)
    data = submessages.encode_data(bytes(4), guid[12:], 1, cdr(1))
    stranger.send(data)
    assert [len(inbox.samples) for inbox in inboxes] == [1, 0]
    stranger.endpoint("rt/b", True, guid=guid)
    stranger.send(data)
    assert [len(inbox.samples) for inbox in inboxes] == [1, 1]
    assert not inboxes[0].reader.state.writers and len(inboxes[1].reader.state.writers) == 1
    stranger.send(submessages.encode_heartbeat(bytes(4), ids.SUBSCRIPTIONS_WRITER, 3, 2, 1))
    stranger.endpoint("rt/b", False, guid=guid)
    assert not inboxes[1].reader.state.writers and set(writer.state.readers) == {guid}


@given(st.lists(st.binary(max_size=120), max_size=20), st.booleans())
def test_any_datagram_leaves_a_participant_that_works(datagrams, known):
    network = Network()
    one, two = pair(network)
    writer, inbox = writer_of(network, one), Inbox(network, two)
    network.until(writer.matched)
    head = submessages.header(prefix(1) if known else prefix(66))
    for body in datagrams:
        network.inject("10.0.0.1", head + body, two)
        network.inject("10.0.0.66", body, two)
    network.carry()
    count = len(inbox.samples)
    writer.write(cdr(7), 0, network.now)
    network.until(lambda: len(inbox.samples) > count)
    assert inbox.samples[-1] == cdr(7)


def test_keep_all_waits_for_a_reader_that_is_slow(network):
    one, two = pair(network)
    qos = QoSProfile(history=HistoryPolicy.KEEP_ALL)
    writer, inbox = writer_of(network, one, qos=qos), Inbox(network, two, qos=qos)
    network.until(writer.matched)
    network.loss = 1.0
    count = 0
    while writer.write(cdr(count), 0, network.now):
        count += 1
    assert count == 5000
    network.loss = 0.0
    network.until(lambda: len(inbox.samples) == 5000)
    assert writer.write(cdr(count), 0, network.now)
