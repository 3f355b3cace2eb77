"""``ros_discovery_info`` of the rtps middleware: its Gids, its pace and its limits.

The format itself and the choice of the Gid size have tests of their own in ../discovery_info.
"""

import math
from functools import partial

import pytest
from support.rtps_pair import Pair

from uros.middleware import open_middleware, user_data
from uros.middleware.discovery_info import codec, intake
from uros.middleware.rtps import discovery_info
from uros.middleware.rtps.middleware import RtpsMiddleware
from uros.middleware.rtps.reader import Sample
from uros.qos import QoSProfile

TYPE = "std_msgs::msg::dds_::String_"
GUID = bytes(range(16))


def names(domain, of):
    """Names of the nodes that a domain knows of another one's participant."""
    guid = of.participant.guid
    return [node.name for node in domain.info.intake.nodes.get(guid, ())]


@pytest.mark.parametrize(("distro", "size"), [("humble", 24), ("jazzy", 16), ("", 16)])
@pytest.mark.parametrize("other", ["rtps", pytest.param("dds", marks=pytest.mark.cyclone)])
def test_the_gid_size_is_that_of_the_distribution(own_domain_id, monkeypatch, distro, size, other):
    monkeypatch.setenv("ROS_DISTRO", distro)
    pair = Pair(own_domain_id, partial(open_middleware, other))
    ours = pair.domains[0]
    guid = ours.participant.guid
    pair.until(lambda: [node.name for node in pair.graphs[1].announced.get(guid, ())] == ["node0"])
    if other == "rtps":
        assert pair.domains[1].info.intake.gid_sizes[guid] == size
    pair.close()


def test_the_gid_size_follows_ros_participants(own_domain_id, monkeypatch):
    """A participant that has an enclave and is none of uros counts as one of ROS."""
    notices = []

    def old():
        with monkeypatch.context() as patch:
            patch.setenv("ROS_DISTRO", "humble")
            middleware = RtpsMiddleware()
            patch.setattr(user_data, "PARTICIPANT", user_data.ENCLAVE + b"/;")
            middleware.create_node(own_domain_id, "/", "old")  # announces the domain's participant
        return middleware

    def new():
        middleware = RtpsMiddleware()
        middleware.on_notice = notices.append
        return middleware

    pair = Pair(own_domain_id, old, new)
    domain, old_domain = pair.domains
    guid = domain.participant.guid
    pair.until(lambda: old_domain.info.intake.gid_sizes.get(guid) == 24)
    assert any("24-byte Gids from now on" in notice for notice in notices), notices
    pair.close()


class Clock:
    """``time`` of the module, which stands still."""

    def __init__(self, monkeypatch):
        self.now = 1000.0
        monkeypatch.setattr(discovery_info, "time", self)

    def monotonic(self):
        return self.now


def test_changes_are_announced_at_most_ten_times_a_second_and_the_last_one_too(
    own_domain_id, monkeypatch
):
    clock = Clock(monkeypatch)
    encoded = []
    encode = codec.encode
    monkeypatch.setattr(codec, "encode", lambda *args: encoded.append(encode(*args)) or encoded[-1])
    middleware = RtpsMiddleware()
    node = middleware.create_node(own_domain_id, "/", "busy")
    info = middleware._domains[own_domain_id].info
    writers = []
    for _ in range(1000):  # a change each millisecond
        writers.append(node.create_writer("rt/x", TYPE, QoSProfile()))
        if len(writers) > 5:
            writers.pop(0).close()
        clock.now += 0.001
        info.tick(clock.now)
    assert 8 <= len(encoded) <= 11
    while (due := info.next_deadline()) is not None:
        clock.now = due
        info.tick(clock.now)
    (busy,) = codec.decode(encoded[-1])[1]
    assert busy.writers == [writer.guid for writer in writers]
    count = len(encoded)
    info.tick(clock.now + 3600)
    assert len(encoded) == count  # no change, no announcement
    middleware.close()


def test_a_long_list_of_nodes_is_announced_as_fast_as_others_parse_it(own_domain_id, monkeypatch):
    clock = Clock(monkeypatch)
    encoded = []
    encode = codec.encode
    monkeypatch.setattr(codec, "encode", lambda *args: encoded.append(encode(*args)) or encoded[-1])
    middleware = RtpsMiddleware()
    middleware.create_node(own_domain_id, "/", "agent")
    info = middleware._domains[own_domain_id].info
    for number in range(2000):  # a board each millisecond
        info.nodes.append(codec.NodeEntities("/", f"board_{number}", [GUID] * 2, [GUID] * 3))
        info.changed()
        clock.now += 0.001
        info.tick(clock.now)
    assert 0.5 * intake.RATE < sum(map(len, encoded[:-1])) / 2 < intake.RATE
    while (due := info.next_deadline()) is not None:
        clock.now = due
        info.tick(clock.now)
    assert len(codec.decode(encoded[-1])[1]) == 2001
    middleware.close()


def test_the_nodes_of_an_agent_with_thousands_of_boards_are_known(own_domain_id):
    pair = Pair(own_domain_id)
    ours, theirs = pair.domains
    boards = [
        codec.NodeEntities("/", f"board_{number}", [GUID] * 2, [GUID] * 3) for number in range(4095)
    ]
    theirs.info.nodes.extend(boards)
    theirs.info.changed()
    pair.until(lambda: len(names(ours, theirs)) == 1 + len(boards))
    pair.close()


def test_a_flood_of_messages_pauses_the_reader_and_the_last_one_counts(own_domain_id, monkeypatch):
    """Beyond the rate the reader is deleted; the one that is created later gets the last sample."""
    monkeypatch.setattr(intake, "BURST", 4096)
    monkeypatch.setattr(intake, "RATE", 100_000)
    pair = Pair(own_domain_id)
    ours, theirs = pair.domains
    pair.until(lambda: names(ours, theirs) == ["node1"])
    reader = ours.info._reader
    flood = [codec.NodeEntities("/flood", f"n{number}") for number in range(400)]
    theirs.info.nodes += flood
    theirs.info.changed()
    pair.until(lambda: ours.info._reader is not reader)  # paused
    theirs.info.nodes[:] = [codec.NodeEntities("/", "after")]
    theirs.info.changed()
    pair.until(lambda: names(ours, theirs) == ["after"])
    pair.close()


def test_a_message_of_a_participant_that_has_left_is_not_kept(own_domain_id):
    """Message and farewell may come in one burst."""
    pair = Pair(own_domain_id)
    ours, theirs = pair.domains
    pair.until(lambda: names(ours, theirs) == ["node1"])
    guid = theirs.participant.guid
    ours.info.intake.forget(guid)
    sample = codec.encode(guid, theirs.info.nodes, 16)
    ours.info._reader.put(Sample(sample, theirs.info._writer.guid, 99, None, False, math.inf))
    del ours.participant.remotes[guid[:12]]
    ours.info._on_ready()
    assert names(ours, theirs) == []
    pair.close()
