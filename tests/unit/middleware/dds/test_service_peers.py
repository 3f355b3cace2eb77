"""Services exchange nothing with endpoints that do not use the header of rmw_cyclonedds."""

import select
import time

import pytest

from uros.middleware.base import MiddlewareError, Service
from uros.middleware.dds import cyclone
from uros.middleware.dds.middleware import DdsMiddleware
from uros.middleware.guid import FAST_DDS
from uros.middleware.services.form import CLIENT_ID, SERVICE_ID, uses_request_header
from uros.middleware.user_data import PROBE_READER
from uros.qos import QoSProfile, services_profile

SERVICE = Service(
    "rq/addRequest", "pkg::srv::dds_::Add_Request_", "rr/addReply", "pkg::srv::dds_::Add_Response_"
)
BODY = bytes.fromhex("000100000a0b0c0d")
CLIENT = QoSProfile(user_data=b"clientid=1.10.2;")
SERVER = QoSProfile(user_data=b"serviceid=1.10.3;")
CYCLONE = b"\x01\x10" + bytes(14)
DISPOSED = 32  # DDS_NOT_ALIVE_DISPOSED_INSTANCE_STATE


@pytest.fixture
def middleware(own_domain_id):
    dds = DdsMiddleware()
    dds.notices = []
    dds.on_notice = dds.notices.append
    yield dds
    dds.close()


@pytest.fixture
def node(middleware, own_domain_id):
    return middleware.create_node(own_domain_id, "/", "node")


def nothing():
    pass


def until(middleware, done, seconds=10):
    deadline = time.monotonic() + seconds
    while not done():
        seconds_left = deadline - time.monotonic()
        assert seconds_left > 0, "it does not come"
        if select.select([middleware.fileno()], [], [], min(seconds_left, 0.1))[0]:
            middleware.dispatch()
        middleware.dispatch_local()


def collect(middleware, endpoint, count):
    samples = []

    def enough():
        samples.extend(endpoint.take(10))
        return len(samples) >= count

    until(middleware, enough)
    return samples


@pytest.mark.parametrize(
    "guid, user_data, role, expected",
    [
        (CYCLONE, b"serviceid=1.2;typehash=x;", SERVICE_ID, True),
        (CYCLONE, b"clientid=1.2;", CLIENT_ID, True),
        (CYCLONE, b"clientid=1.2;", SERVICE_ID, False),
        (CYCLONE, b"", SERVICE_ID, False),
        (FAST_DDS + bytes(14), b"", CLIENT_ID, False),
        (
            FAST_DDS + bytes(14),
            b"clientid=1.2;serviceid=1.2;",
            CLIENT_ID,
            False,
        ),
        (b"\x01\x01" + bytes(14), b"", SERVICE_ID, False),
    ],
)
def test_which_endpoints_use_the_header(guid, user_data, role, expected):
    assert uses_request_header(guid, user_data, role) is expected


def test_a_request_is_not_written_if_a_server_has_no_known_form(node, middleware):
    requester = node.create_requester(SERVICE, services_profile(), nothing)
    foreign = node.create_reader(SERVICE.request_topic, SERVICE.request_type, QoSProfile(), nothing)
    assert requester.refusal().startswith("/add is not called")
    with pytest.raises(MiddlewareError, match="another form of services"):
        requester.request(BODY)
    # Nor if another server exists that would understand the request.
    replier = node.create_replier(SERVICE, services_profile(), nothing)
    with pytest.raises(MiddlewareError, match="use the middleware auto or rtps"):
        requester.request(BODY)
    assert not foreign.take(10) and not replier.take(10)
    foreign.close()
    assert requester.refusal() == ""
    assert requester.request(BODY) == 1
    assert collect(middleware, replier, 1)[0][2] == BODY


def test_a_probe_reader_is_no_server(node):
    requester = node.create_requester(SERVICE, services_profile(), nothing)
    qos = QoSProfile(user_data=PROBE_READER)
    node.create_reader(SERVICE.request_topic, SERVICE.request_type, qos, nothing)
    assert requester.refusal() == ""


def test_a_waiting_client_is_notified_of_a_foreign_server(node, middleware):
    refusals = []
    requester = node.create_requester(
        SERVICE, services_profile(), lambda: refusals.append(requester.refusal())
    )
    assert requester.request(BODY) == 1  # no server exists
    node.create_reader(SERVICE.request_topic, SERVICE.request_type, QoSProfile(), nothing)
    until(middleware, lambda: any(refusals))
    requester.close()
    assert requester.refusal() == ""


def test_a_request_of_a_client_with_no_known_form_is_not_taken(node, middleware):
    replier = node.create_replier(SERVICE, services_profile(), nothing)
    wrong = node.create_writer(SERVICE.request_topic, SERVICE.request_type, QoSProfile())
    right = node.create_writer(SERVICE.request_topic, SERVICE.request_type, CLIENT)
    request = BODY[:4] + bytes(8) + (7).to_bytes(8, "little") + b"abcd"
    for _ in range(3):
        wrong.write(request)
    right.write(request)
    assert [item[1:] for item in collect(middleware, replier, 1)] == [(7, BODY[:4] + b"abcd")]
    (notice,) = middleware.notices
    assert notice.startswith("a client of /add gets no answer")


def test_a_reply_of_a_server_with_no_known_form_is_not_taken(node, middleware):
    requester = node.create_requester(SERVICE, services_profile(), nothing)
    requests = node.create_reader(SERVICE.request_topic, SERVICE.request_type, SERVER, nothing)
    requester.request(BODY)
    request = collect(middleware, requests, 1)[0]
    wrong = node.create_writer(SERVICE.reply_topic, SERVICE.reply_type, QoSProfile())
    right = node.create_writer(SERVICE.reply_topic, SERVICE.reply_type, SERVER)
    wrong.write(request[:20] + b"bad!")
    right.write(request[:20] + b"good")
    assert collect(middleware, requester, 1) == [(1, BODY[:4] + b"good")]


def test_requests_and_replies_are_written_as_disposed_data_that_only_cyclone_reads(
    node, middleware
):
    """Fast DDS does not take such requests, whatever it has discovered; with the real Fast DDS:
    tests/interop/test_service_forms.py."""
    requester = node.create_requester(SERVICE, services_profile(), nothing)
    replier = node.create_replier(SERVICE, services_profile(), nothing)
    requests = node.create_reader(SERVICE.request_topic, SERVICE.request_type, SERVER, nothing)
    replies = node.create_reader(SERVICE.reply_topic, SERVICE.reply_type, CLIENT, nothing)
    for number in range(1, 6):  # several requests in one burst stay several
        assert requester.request(BODY) == number
    requests_taken = collect(middleware, replier, 5)
    assert [item[1] for item in requests_taken] == [1, 2, 3, 4, 5]
    for guid, sequence, body in requests_taken:
        replier.reply(guid, sequence, body)
    assert [item[0] for item in collect(middleware, requester, 5)] == [1, 2, 3, 4, 5]
    for spy in (requests, replies):
        states = [info.instance_state for _, info in cyclone.take(spy.entity, 10)]
        assert states == [DISPOSED] * 5


def test_replies_to_other_requesters_take_a_limited_part_of_a_turn(node, middleware, monkeypatch):
    """Attack: replies to other requesters, as fast as they can be sent."""
    requester = node.create_requester(SERVICE, services_profile(), nothing)
    reply_writer = node.create_writer(SERVICE.reply_topic, SERVICE.reply_type, SERVER)
    sample = BODY[:4] + bytes(16) + b"none"
    take_count = 0
    take = cyclone.take

    def endless(entity, limit):
        nonlocal take_count
        take_count += 1
        reply_writer.write(sample)
        return take(entity, limit)

    monkeypatch.setattr(cyclone, "take", endless)
    assert requester.take(10) == []
    assert take_count <= 8


def test_samples_left_for_the_next_turn_are_announced_again(node, middleware):
    calls = []
    requester = node.create_requester(SERVICE, services_profile(), lambda: calls.append(1))
    middleware.dispatch_local()
    requester.take(1)
    calls.clear()
    requester.again()
    assert not calls
    middleware.dispatch_local()
    assert calls == [1]
