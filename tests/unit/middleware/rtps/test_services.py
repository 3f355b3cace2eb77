"""The two endpoints of a service client or server, and the identities that they exchange."""

import struct

import pytest
from support.rtps_pair import Pair

from uros.middleware.base import MiddlewareError, Service
from uros.middleware.guid import FAST_DDS
from uros.middleware.rtps import ids, parameters, services, submessages
from uros.middleware.rtps.kinds import Data
from uros.middleware.rtps.parameters import EndpointData, ParticipantData
from uros.middleware.rtps.remote import RemoteParticipant
from uros.qos import QoSProfile

TRIGGER = Service(
    "rq/serviceRequest", "std_srvs::srv::dds_::Trigger_Request_",
    "rr/serviceReply", "std_srvs::srv::dds_::Trigger_Response_",
)  # fmt: skip
REQUEST, REPLY = b"\0\1\0\0\1\0\0\0", b"\0\1\0\0\2\0\0\0"
PREFIX = FAST_DDS + bytes(9) + b"\7"
READER = PREFIX + b"\0\0\1\4"
UNKNOWN = -1 << 32


@pytest.fixture
def pair(own_domain_id):
    made = Pair(own_domain_id)
    yield made
    made.close()


def requester_of(pair):
    return pair.nodes[0].create_requester(TRIGGER, QoSProfile(), lambda: None)


def replier_of(pair):
    return pair.nodes[1].create_replier(TRIGGER, QoSProfile(), lambda: None)


# --- two endpoints that are one -------------------------------------------------------------------


def announced(pair, index):
    """The endpoints of services that a participant of ours announces."""
    participant = pair.domains[index].participant
    topics = TRIGGER.request_topic, TRIGGER.reply_topic
    endpoints = (*participant.writers.values(), *participant.readers.values())
    return [endpoint for endpoint in endpoints if endpoint.data.topic in topics]


@pytest.mark.parametrize(
    ("create", "index", "fails"),
    [(requester_of, 0, "create_writer"), (replier_of, 1, "create_reader")],
)
def test_of_a_service_whose_second_endpoint_fails_none_is_left(
    pair, monkeypatch, create, index, fails
):
    """One orphan hides a service of rmw_fastrtps from everybody."""

    def fail(*_):
        raise ValueError("no memory")

    monkeypatch.setattr(pair.domains[index].participant, fails, fail)
    with pytest.raises(ValueError, match="no memory"):
        create(pair)
    assert not announced(pair, index) and not pair.nodes[index]._endpoints


@pytest.mark.parametrize("index", [0, 1])
def test_both_endpoints_come_and_go_together_with_one_id(pair, index):
    made = (requester_of, replier_of)[index](pair)
    domain = pair.domains[index]
    first, second = announced(pair, index)
    assert first.data.qos.user_data == second.data.qos.user_data
    role = (b"clientid=", b"serviceid=")[index]
    assert first.data.qos.user_data.count(role) == 1
    other = (requester_of, replier_of)[index](pair)
    assert len({endpoint.data.qos.user_data for endpoint in announced(pair, index)}) == 2
    deleted = []
    delete = domain.participant.delete
    domain.participant.delete = lambda endpoint, *rest: (
        deleted.append(endpoint),
        delete(endpoint, *rest),
    )
    made.close()
    made.close()
    assert [endpoint.data.is_writer for endpoint in deleted] == [True, False]
    assert set(deleted) == {first, second}
    other.close()
    assert not announced(pair, index)


def test_a_server_announces_its_writer_first(pair):
    created = []
    participant = pair.domains[1].participant
    for name in ("create_writer", "create_reader"):
        create = getattr(participant, name)
        setattr(
            participant, name,
            lambda *args, create=create, name=name: created.append(name) or create(*args),
        )  # fmt: skip
    replier_of(pair)
    assert created == ["create_writer", "create_reader"]


def test_each_participant_has_a_prefix_of_its_own(pair):
    prefixes = {domain.participant.guid[:12] for domain in pair.domains}
    assert len(prefixes) == 2 and all(prefix[:2] == ids.VENDOR for prefix in prefixes)


# --- identities -----------------------------------------------------------------------------------


def identity(guid, number, little=True):
    return guid + struct.pack("<iI" if little else ">iI", number >> 32, number & 0xFFFFFFFF)


def test_a_related_identity_is_written_under_both_numbers():
    body = identity(READER, 2**32 + 5)
    assert len(body) == 24
    assert parameters.write_related_identity(READER, 2**32 + 5) == (
        b"\x83\0\x18\0" + body + b"\x0f\x80\x18\0" + body + b"\1\0\0\0"
    )


@pytest.mark.parametrize("pids", [(0x0083,), (0x800F,), (0x0083, 0x800F)])
@pytest.mark.parametrize("little", [True, False])
@pytest.mark.parametrize("number", [UNKNOWN, 7, 2**33])
def test_a_related_identity_is_read_under_either_number(pids, little, number):
    mark = "<" if little else ">"
    raw = b"".join(
        struct.pack(mark + "HH", pid, 24) + identity(READER, number, little) for pid in pids
    )
    raw += struct.pack(mark + "HH", 1, 0)
    assert parameters.read_inline_qos(raw, little).related == (READER, number)


def spy(pair, index, topic):
    """The DATA of our writer of a topic from now on."""
    found = []
    domain = pair.domains[index]
    send = domain._sockets.send

    def sent(datagram, place):
        for one in submessages.read(memoryview(datagram)):
            writer = getattr(one, "writer", None)
            known = domain.participant.writers.get(writer)
            if isinstance(one, Data) and known is not None and known.data.topic == topic:
                found.append(one)
        return send(datagram, place)

    domain._sockets.send = sent
    return found


def as_fast_dds(monkeypatch):
    """Have both sides take each other for implementations that want inline QoS."""
    monkeypatch.setattr(services, "uses_request_header", lambda guid, user_data, role: False)


def test_a_request_names_the_reply_reader_and_its_reply_the_number_of_the_request(
    pair, monkeypatch
):
    as_fast_dds(monkeypatch)
    requester, replier = requester_of(pair), replier_of(pair)
    writer, reader = requester.endpoints
    pair.until(lambda: requester.servers() and replier.endpoints[0].matched())
    requests = spy(pair, 0, TRIGGER.request_topic)
    replies = spy(pair, 1, TRIGGER.reply_topic)
    for expected in (1, 2):
        assert requester.request(REQUEST) == expected
        taken = []
        pair.until(lambda taken=taken: taken.extend(replier.take(1)) or taken)
        ((guid, number, payload),) = taken
        assert (guid, number, payload) == (reader.guid, requests[-1].number, REQUEST)
        assert number == expected
        assert replier.reply(guid, number, REPLY)
        taken = []
        pair.until(lambda taken=taken: taken.extend(requester.take(1)) or taken)
        assert taken == [(expected, REPLY)]
    for data, wanted in ((requests[0], (reader.guid, UNKNOWN)), (replies[0], (reader.guid, 1))):
        raw = dict(parameters.parameters(data.inline_qos, True))
        assert raw[0x0083] == raw[0x800F] == identity(*wanted)


def test_a_client_accepts_its_readers_and_its_writers_guid(pair, monkeypatch):
    """Some servers answer with the GUID of the request's writer."""
    as_fast_dds(monkeypatch)
    requester, replier = requester_of(pair), replier_of(pair)
    pair.until(lambda: requester.servers() and replier.endpoints[0].matched())
    for number, endpoint in enumerate(requester.endpoints, 1):
        assert replier.reply(endpoint.guid, number, REPLY)
    assert replier.reply(READER, 3, REPLY)  # of another client
    taken = []
    pair.until(lambda: taken.extend(requester.take(5)) or len(taken) == 2)
    assert taken == [(1, REPLY), (2, REPLY)]


# --- replies that wait ----------------------------------------------------------------------------


class Peer:
    """A participant of Fast DDS, as discovery tells of it."""

    def __init__(self, participant):
        self.participant = participant
        data = ParticipantData(PREFIX + ids.ENTITY_PARTICIPANT)
        self.remote = participant.remotes[PREFIX] = RemoteParticipant(data, 0.0)
        participant._known.take(10**6, PREFIX)

    def announce(self, type_name=TRIGGER.reply_type):
        data = EndpointData(READER, False, TRIGGER.reply_topic, type_name, QoSProfile())
        self.participant._on_endpoint(
            services.Sample(
                parameters.write_endpoint(data), PREFIX + ids.SUBSCRIPTIONS_WRITER, 1, None, False
            ),
            False,
        )

    def withdraw(self):
        self.participant._on_endpoint(
            services.Sample(
                parameters.write_key(READER), PREFIX + ids.SUBSCRIPTIONS_WRITER, 2,
                parameters.read_inline_qos(parameters.write_farewell_qos(READER), True), True,
            ),
            False,
        )  # fmt: skip


def waiting(replier):
    return [(guid, number) for guid, number, *_ in replier._waiting]


def test_a_reply_waits_until_its_reader_matches(pair):
    replier = replier_of(pair)
    peer = Peer(pair.domains[1].participant)
    state = replier.endpoints[0].local.state
    assert replier.reply(READER, 1, REPLY) and replier.reply(READER, 2, REPLY)
    assert waiting(replier) == [(READER, 1), (READER, 2)] and not state.last
    peer.announce()
    assert not waiting(replier) and state.last == 2
    assert replier.reply(READER, 3, REPLY) and state.last == 3


@pytest.mark.parametrize("leaves", ["reader", "participant"])
def test_a_reply_is_dropped_when_its_reader_or_its_participant_leaves(pair, leaves):
    replier = replier_of(pair)
    peer = Peer(pair.domains[1].participant)
    other = PREFIX[:11] + b"\x08" + READER[12:]
    if leaves == "reader":  # known, but of another type: it does not match
        peer.announce("other")
    assert replier.reply(READER, 1, REPLY) and replier.reply(other, 1, REPLY)
    if leaves == "reader":
        peer.withdraw()
    else:
        peer.participant._forget(peer.remote)
    assert waiting(replier) == [(other, 1)]


def test_a_reply_that_has_waited_too_long_is_not_sent(pair, monkeypatch):
    replier = replier_of(pair)
    peer = Peer(pair.domains[1].participant)
    monkeypatch.setattr(services, "_PATIENCE", -1.0)
    assert replier.reply(READER, 1, REPLY)
    monkeypatch.setattr(services, "_PATIENCE", 10.0)
    assert replier.reply(READER, 2, REPLY) and waiting(replier) == [(READER, 2)]
    monkeypatch.setattr(services, "_PATIENCE", -1.0)
    assert replier.reply(READER, 3, REPLY)
    peer.announce()
    assert not waiting(replier) and replier.endpoints[0].local.state.last == 1  # the second


def test_a_big_endian_request_is_refused_where_a_server_wants_the_header(pair):
    requester = pair.nodes[0].create_requester(TRIGGER, QoSProfile(), lambda: None)
    big = b"\0\0\0\0" + bytes(4)
    assert requester.request(big) == 1
    pair.nodes[1].create_replier(TRIGGER, QoSProfile(), lambda: None)
    pair.until(requester.servers)
    with pytest.raises(MiddlewareError, match="big-endian"):
        requester.request(big)


def test_replies_that_wait_are_limited_in_number_octets_and_time(pair, monkeypatch):
    replier = replier_of(pair)
    for number in range(services.MAX_WAITING + 10):
        assert replier.reply(READER, number, REPLY)
    assert len(waiting(replier)) == services.MAX_WAITING
    assert replier.reply(READER, 1000, bytes(services._MAX_WAITING_OCTETS - 1))
    assert waiting(replier)[-1] == (READER, 1000) and len(waiting(replier)) == 1
    monkeypatch.setattr(services, "_PATIENCE", -1.0)
    assert replier.reply(READER, 1001, b"")
    replier._on_match(bytes(16))
    assert waiting(replier) == [(READER, 1000)]
