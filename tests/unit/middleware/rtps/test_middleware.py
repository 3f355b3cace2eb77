"""The rtps middleware on loopback: two of them, as two processes would be."""

import select
import time

import pytest
from support.rtps_pair import Pair

from uros.middleware import open_middleware
from uros.middleware.base import MiddlewareError
from uros.middleware.rtps import endpoints, ids, locators, network, submessages
from uros.middleware.rtps.locators import UDPV4, Locator
from uros.middleware.rtps.middleware import RtpsMiddleware
from uros.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy

TYPE = "std_msgs::msg::dds_::UInt8MultiArray_"


@pytest.fixture
def pair(own_domain_id):
    made = Pair(own_domain_id)
    yield made
    made.close()


def cdr(size):
    return b"\0\1\0\0" + bytes(8) + size.to_bytes(4, "little") + bytes(range(256)) * (size // 256)


def has_answered(writer):
    """Whether a reader has acknowledged something, and so is sent samples at once."""
    readers = writer.local.state.readers.values()
    return readers and all(proxy.waits_until is None for proxy in readers)


def test_a_large_sample_is_sent_in_slices_and_arrives(pair):
    """Between the slices the data plane serves boards."""
    reader = pair.nodes[1].create_reader("rt/big", TYPE, QoSProfile(), lambda: None)
    writer = pair.nodes[0].create_writer("rt/big", TYPE, QoSProfile())
    pair.until(lambda: has_answered(writer))
    sent = []
    send = pair.domains[0]._sockets.send
    pair.domains[0]._sockets.send = lambda datagram, place: (
        sent.append(len(datagram)), send(datagram, place)
    )  # fmt: skip
    sample = cdr(4 * 1024 * 1024)
    assert writer.write(sample)
    assert 60_000 < sum(sent) < 70_000
    samples = []
    pair.until(lambda: samples.extend(reader.take(1)) or samples)
    assert samples == [sample] and not pair.domains[0]._backlog


def test_best_effort_samples_of_64_kilobytes_arrive_whole(pair):
    qos = QoSProfile(reliability=ReliabilityPolicy.BEST_EFFORT)
    reader = pair.nodes[1].create_reader("rt/big", TYPE, qos, lambda: None)
    writer = pair.nodes[0].create_writer("rt/big", TYPE, qos)
    pair.until(writer.matched)
    for _ in range(20):
        assert writer.write(cdr(60_000 // 256 * 256))
        samples = []
        pair.until(lambda samples=samples: samples.extend(reader.take(1)) or samples)
        assert samples == [cdr(60_000 // 256 * 256)]


def test_samples_do_not_wait_behind_the_announcements_of_a_crowd(pair, monkeypatch):
    """A thousand datagrams of discovery take many turns; a sample that comes last is in the second.

    In the first, what announces its writer could be among those that are left.
    """
    reader = pair.nodes[1].create_reader("rt/a", TYPE, QoSProfile(), lambda: None)
    writer = pair.nodes[0].create_writer("rt/a", TYPE, QoSProfile())
    pair.until(writer.matched)
    assert writer.write(cdr(100))
    pair.until(lambda: reader.take(1))
    handled = []
    target = pair.domains[1]
    receive = target.participant.receive
    monkeypatch.setattr(
        target.participant, "receive",
        lambda datagram, *more: (handled.append(len(datagram)), receive(datagram, *more)),
    )  # fmt: skip
    (place,) = target._sockets.unicast
    for _ in range(1000):
        assert pair.domains[0]._sockets.send(submessages.header(ids.NO_PREFIX), place)
    assert writer.write(cdr(100))
    pair.middlewares[1].dispatch()
    assert not reader.take(1)
    pair.middlewares[1].dispatch()
    assert reader.take(1) == [cdr(100)] and 1 < len(handled) < 200


@pytest.mark.cyclone
@pytest.mark.parametrize("reader_first", [True, False])
def test_a_reader_of_cyclone_gets_each_sample_from_the_match_on(own_domain_id, reader_first):
    """It begins after the first heartbeat: no sample may come before that."""
    from uros.middleware.dds.middleware import DdsMiddleware

    pair = Pair(own_domain_id, DdsMiddleware)
    try:
        if reader_first:
            reader = pair.nodes[1].create_reader("rt/a", TYPE, QoSProfile(), lambda: None)
            pair.until(lambda: reader.guid in pair.graphs[0].endpoints)
            writer = pair.nodes[0].create_writer("rt/a", TYPE, QoSProfile())
        else:
            writer = pair.nodes[0].create_writer("rt/a", TYPE, QoSProfile())
            pair.until(lambda: writer.guid in pair.graphs[1].endpoints)
            reader = pair.nodes[1].create_reader("rt/a", TYPE, QoSProfile(), lambda: None)
        pair.until(writer.matched)
        sent = [cdr(256 * number) for number in range(1, 6)]
        for sample in sent:
            assert writer.write(sample)
        samples = []
        pair.until(lambda: samples.extend(reader.take(10)) or len(samples) >= 5)
        assert samples == sent
    finally:
        pair.close()


@pytest.mark.parametrize("remote", [True, False])
def test_samples_that_wait_beyond_their_lifespan_are_not_taken(pair, remote):
    """Those of another process, and of this one."""
    taken = []
    reader = pair.nodes[1].create_reader("rt/a", TYPE, QoSProfile(), lambda: taken.append(1))
    node = pair.nodes[0 if remote else 1]
    lasting = node.create_writer("rt/a", TYPE, QoSProfile(lifespan_ms=3_600_000))
    # Longer than the first exchange with a reader takes, for which a writer's samples wait.
    short = node.create_writer("rt/a", TYPE, QoSProfile(lifespan_ms=500))
    pair.until(lambda: lasting.matched() and short.matched())
    pair.until(lambda: len(reader.local.state.writers) == (2 if remote else 0))
    for writer in (short, lasting):
        assert writer.write(cdr(256))
        pair.until(lambda: taken)
        taken.clear()
        reader.is_announced = False
    over = time.monotonic() + 0.5
    pair.until(lambda: time.monotonic() > over and len(reader.arrived(10)) == 2)
    assert reader.take(1) == [cdr(256)] and not reader.take(1)


def test_nodes_do_not_write_on_topics_of_the_middleware(pair):
    for topic in ("ros_discovery_info", "DCPSParticipant"):
        with pytest.raises(MiddlewareError, match="nodes do not write on"):
            pair.nodes[0].create_writer(topic, TYPE, QoSProfile())


def test_a_mismatch_is_reported_once_with_the_policy(pair):
    notices = []
    pair.middlewares[0].on_notice = notices.append
    qos = QoSProfile(reliability=ReliabilityPolicy.BEST_EFFORT)
    for _ in range(2):
        writer = pair.nodes[0].create_writer("rt/a", TYPE, qos)
        reader = pair.nodes[1].create_reader("rt/a", TYPE, QoSProfile(), lambda: None)
        known = pair.domains[0].endpoints
        pair.until(lambda reader=reader, known=known: reader.guid in known())
        assert not writer.matched()
    assert len(notices) == 1
    assert "reliability (best_effort offered, reliable requested)" in notices[0]


@pytest.mark.parametrize("value", ["OFF", "LOCALHOST"])
def test_a_client_that_stays_on_this_machine_is_admitted_only_there(
    value, monkeypatch, own_domain_id
):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", value)
    middleware = open_middleware("rtps")
    middleware.create_node(own_domain_id, "/", "node", localhost_only=True)
    assert bool(middleware._domains[own_domain_id].filenos()) == (value == "LOCALHOST")
    middleware.close()
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    monkeypatch.delenv("CYCLONEDDS_URI")  # it chooses loopback
    middleware = open_middleware("rtps")
    with pytest.raises(MiddlewareError, match="open to the network"):
        middleware.create_node(own_domain_id, "/", "node", localhost_only=True)
    middleware.close()


def test_datagrams_wait_while_the_system_has_no_room(pair):
    """A full send buffer loses nothing and changes no order."""
    reader = pair.nodes[1].create_reader("rt/a", TYPE, QoSProfile(), lambda: None)
    writer = pair.nodes[0].create_writer("rt/a", TYPE, QoSProfile())
    pair.until(writer.matched)
    sockets = pair.domains[0]._sockets
    send, refused, sent = sockets.send, [], []

    def send_every_other_time(datagram, place):
        if len(refused) <= len(sent):
            refused.append(datagram)
            return False
        sent.append(datagram)
        return send(datagram, place)

    sockets.send = send_every_other_time
    wanted = [cdr(256 * number) for number in range(1, 6)]
    for sample in wanted:
        assert writer.write(sample)
    samples = []
    pair.until(lambda: samples.extend(reader.take(10)) or len(samples) == 5)
    assert samples == wanted
    assert all(datagram in sent for datagram in refused[:5]) and not sockets.send_errors


def test_a_broken_configuration_of_cyclone_is_an_error(monkeypatch, own_domain_id):
    monkeypatch.setenv("CYCLONEDDS_URI", "<nix")
    middleware = open_middleware("rtps")
    with pytest.raises(MiddlewareError, match="CYCLONEDDS_URI is not valid XML"):
        middleware.create_node(own_domain_id, "/", "node")
    middleware.close()


def test_the_configuration_of_cyclone_chooses_interfaces_peers_and_index(
    monkeypatch, own_domain_id
):
    uri = (
        '<General><Interfaces><NetworkInterface name="lo"/></Interfaces>'
        "<AllowMulticast>false</AllowMulticast></General><Tracing/>"
        '<Discovery><ParticipantIndex>5</ParticipantIndex><Peers><Peer Address="127.0.0.1:7"/>'
        "</Peers></Discovery>"
    )
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    monkeypatch.setenv("CYCLONEDDS_URI", uri)
    middleware = open_middleware("rtps")
    notices = []
    middleware.on_notice = notices.append
    middleware.create_node(own_domain_id, "/", "node", localhost_only=True)
    sockets = middleware._domains[own_domain_id]._sockets
    port = locators.metatraffic_port(own_domain_id, 5)
    assert sockets.unicast == [Locator(UDPV4, port, "127.0.0.1")]
    assert Locator(UDPV4, 7, "127.0.0.1") in sockets.peers and not sockets.multicast
    assert [text for text in notices if "leaves out Tracing" in text]
    middleware.close()


@pytest.mark.parametrize(
    ("configured", "least", "most"), [("default", 1300, 1400), ("8kB", 8000, 8192)]
)
def test_messages_have_the_configured_size(monkeypatch, own_domain_id, configured, least, most):
    uri = f"<General><MaxMessageSize>{configured}</MaxMessageSize></General>"
    monkeypatch.setenv("CYCLONEDDS_URI", uri)
    pair = Pair(own_domain_id)
    taken = []
    reader = pair.nodes[1].create_reader(
        "rt/large", TYPE, QoSProfile(), lambda: taken.extend(reader.take(10))
    )
    writer = pair.nodes[0].create_writer("rt/large", TYPE, QoSProfile())
    pair.until(lambda: has_answered(writer))
    sockets, sizes = pair.domains[0]._sockets, []
    send = sockets.send
    monkeypatch.setattr(
        sockets,
        "send",
        lambda datagram, place: sizes.append(len(datagram)) or send(datagram, place),
    )
    sample = b"\0\1\0\0" + bytes(30_000)
    writer.write(sample)
    pair.until(lambda: taken)
    assert taken == [sample] and least <= max(sizes) <= most
    pair.close()


@pytest.mark.parametrize("reliable", [True, False])
def test_a_reader_of_this_process_that_keeps_all_has_a_limit(own_domain_id, monkeypatch, reliable):
    """A reliable writer that keeps all waits for room; another one loses samples."""
    monkeypatch.setattr(endpoints, "MAX_PAST", 10)
    middleware = RtpsMiddleware()
    node = middleware.create_node(own_domain_id, "/", "node")
    qos = QoSProfile(history=HistoryPolicy.KEEP_ALL)
    if not reliable:
        qos.reliability = ReliabilityPolicy.BEST_EFFORT
    reader = node.create_reader("rt/kept", TYPE, qos, lambda: None)
    writer = node.create_writer("rt/kept", TYPE, qos)
    assert [writer.write(b"\0\1\0\0" + bytes([n])) for n in range(12)] == [
        n < 10 or not reliable for n in range(12)
    ]
    assert [sample[4] for sample in reader.take(100)] == list(range(10))
    assert writer.write(b"\0\1\0\0\x63") and reader.take(100) == [b"\0\1\0\0\x63"]
    middleware.close()


def test_peers_are_looked_up_once_for_many_nodes_that_stay_local(own_domain_id, monkeypatch):
    looked_up = []
    look_up = network.socket.getaddrinfo
    monkeypatch.setattr(
        network.socket, "getaddrinfo",
        lambda host, *args: looked_up.append(host) or look_up("127.0.0.1", *args),
    )  # fmt: skip
    monkeypatch.delenv("ROS_LOCALHOST_ONLY", raising=False)
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_STATIC_PEERS", "robot")
    middleware = RtpsMiddleware()
    for number in range(5):
        middleware.create_node(own_domain_id, "/", f"node{number}", localhost_only=True)
    assert looked_up.count("robot") == 2  # for the check, and when the domain is joined
    middleware.close()


def is_readable(middleware):
    return bool(select.select([middleware.fileno()], [], [], 0)[0])


def test_what_a_dispatch_receives_does_not_wake_the_next_one(pair):
    taken = []
    reader = pair.nodes[1].create_reader(
        "rt/wake", TYPE, QoSProfile(), lambda: taken.extend(reader.take(10))
    )
    writer = pair.nodes[0].create_writer("rt/wake", TYPE, QoSProfile())
    pair.until(lambda: has_answered(writer))
    wakeup, pair.middlewares[1]._wakeup = pair.middlewares[1]._wakeup, None
    writer.write(cdr(256))
    pair.until(lambda: taken)
    pair.middlewares[1]._wakeup = wakeup


def test_a_reader_that_asks_for_another_turn_gets_it_beside_others(pair):
    calls = []

    def ready(name):
        calls.append(name)
        if calls.count(name) < 3:
            readers[name].again()

    readers = {
        name: pair.nodes[0].create_reader(
            f"rt/{name}", TYPE, QoSProfile(), lambda name=name: ready(name)
        )
        for name in ("one", "two")
    }
    middleware = pair.middlewares[0]
    for reader in readers.values():
        reader.again()
    while is_readable(middleware):
        middleware.dispatch()
    assert sorted(calls) == ["one"] * 3 + ["two"] * 3
