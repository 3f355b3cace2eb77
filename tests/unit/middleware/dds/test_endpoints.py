"""Services as rmw_cyclonedds has them, byte for byte, and samples of either byte order.

rmw_cyclonedds itself is not available here: the vectors are written by hand from its public
definition. After the encapsulation header come the client's id (8 bytes) and the sequence number
(64 bits, signed), both in the sample's byte order, then the body.
"""

import os
import select
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import pytest

from uros.interfaces import known_hash, load
from uros.interfaces.codec import to_cdr
from uros.middleware.base import MiddlewareError, Service
from uros.middleware.dds import cyclone
from uros.middleware.dds.middleware import DdsMiddleware
from uros.middleware.user_data import type_hash
from uros.qos import HistoryPolicy, QoSProfile

SERVICE = Service(
    "rq/addRequest", "pkg::srv::dds_::Add_Request_", "rr/addReply", "pkg::srv::dds_::Add_Response_"
)
REQUEST = bytes.fromhex("00010000" "1122334455667788" "0500000000000000" "0a0b0c0d")  # fmt: skip
REQUEST_BIG = bytes.fromhex(
    "00000000" "8877665544332211" "0000000000000005" "0d0c0b0a"
)  # fmt: skip
REPLY = bytes.fromhex("00010000" "1122334455667788" "0500000000000000" "01020304")  # fmt: skip
CLIENT = bytes.fromhex("1122334455667788")
# The user data that rmw_cyclonedds announces with a client's endpoints, and with a server's.
A_CLIENT = QoSProfile(user_data=b"clientid=1.10.c3.db.e8.19.d2.40.b9.0.6b.2c.0.0.0.1;")
A_SERVER = QoSProfile(user_data=b"serviceid=1.10.c3.db.e8.19.d2.40.b9.0.6b.2c.0.0.0.2;")


@pytest.fixture
def middleware(own_domain_id):
    dds = DdsMiddleware()
    yield dds
    dds.close()


@pytest.fixture
def node(middleware, own_domain_id):
    return middleware.create_node(own_domain_id, "/", "node")


def take(middleware, endpoint, seconds=10):
    """Wait for the first sample of an endpoint."""
    deadline = time.monotonic() + seconds
    while True:
        middleware.dispatch_local()
        samples = endpoint.take(1)
        if samples:
            return samples[0]
        seconds_left = deadline - time.monotonic()
        assert seconds_left > 0, "nothing comes"
        if select.select([middleware.fileno()], [], [], min(seconds_left, 0.1))[0]:
            middleware.dispatch()


def nothing():
    pass


def test_a_request_of_a_foreign_client_is_understood_and_answered(middleware, node):
    replier = node.create_replier(SERVICE, QoSProfile(), nothing)
    replies = node.create_reader(SERVICE.reply_topic, SERVICE.reply_type, A_CLIENT, nothing)
    foreign = node.create_writer(SERVICE.request_topic, SERVICE.request_type, A_CLIENT)
    foreign.write(REQUEST)
    guid, sequence, body = take(middleware, replier)
    assert (guid[:8], guid[8:], sequence) == (CLIENT, bytes(8), 5)
    assert body == bytes.fromhex("00010000" "0a0b0c0d")  # fmt: skip
    assert replier.reply(guid, sequence, bytes.fromhex("0001000001020304"))
    assert take(middleware, replies) == REPLY


def test_a_big_endian_request_is_the_same_request(middleware, node, monkeypatch):
    """Cyclone's binding cannot write one, so it is handed to the replier from below."""
    replier = node.create_replier(SERVICE, QoSProfile(), nothing)
    foreign = node.create_writer(SERVICE.request_topic, SERVICE.request_type, A_CLIENT)
    info = SimpleNamespace(publication_handle=cyclone.instance_handle(foreign.entity))
    monkeypatch.setattr(cyclone, "take", lambda entity, limit: [(REQUEST_BIG, info)])
    guid, sequence, body = replier.take(1)[0]
    assert (guid[:8], sequence) == (CLIENT, 5)
    assert body == bytes.fromhex("00000000" "0d0c0b0a")  # fmt: skip


def test_a_request_of_ours_is_as_defined_and_its_reply_understood(middleware, node):
    requester = node.create_requester(SERVICE, QoSProfile(), nothing)
    requests = node.create_reader(SERVICE.request_topic, SERVICE.request_type, A_SERVER, nothing)
    assert requester.request(bytes.fromhex("000100000a0b0c0d")) == 1
    assert requester.request(bytes.fromhex("000100000a0b0c0d")) == 2
    first, second = take(middleware, requests), take(middleware, requests)
    client = first[4:12]
    assert client != bytes(8)
    for number, sample in ((1, first), (2, second)):
        assert sample == b"".join(
            (
                bytes.fromhex("00010000"),
                client,
                number.to_bytes(8, "little"),
                bytes.fromhex("0a0b0c0d"),
            )
        )
    foreign = node.create_writer(SERVICE.reply_topic, SERVICE.reply_type, A_SERVER)
    foreign.write(REPLY)  # addressed to another client
    foreign.write(second[:4] + client + second[12:20] + bytes.fromhex("01020304"))
    assert take(middleware, requester) == (2, bytes.fromhex("0001000001020304"))


def test_big_endian_service_bodies_are_refused(node):
    requester = node.create_requester(SERVICE, QoSProfile(), nothing)
    with pytest.raises(MiddlewareError, match="big-endian"):
        requester.request(bytes.fromhex("000000000a0b0c0d"))


def test_both_endpoints_of_a_client_and_of_a_server_announce_one_id(node, monkeypatch):
    announcements = []
    endpoint = cyclone._endpoint

    def spy(kind, group, topic, qos, user_data, batching=False):
        announcements.append((kind, user_data.decode()))
        return endpoint(kind, group, topic, qos, user_data, batching)

    monkeypatch.setattr(cyclone, "_endpoint", spy)
    node.create_requester(SERVICE, QoSProfile(), nothing)
    node.create_replier(SERVICE, QoSProfile(), nothing)
    client, server = announcements[:2], announcements[2:]
    for ends, word in ((client, "clientid="), (server, "serviceid=")):
        assert {kind for kind, _ in ends} == {"reader", "writer"}
        ids = {text.partition(";")[0] for _, text in ends}
        assert len(ids) == 1
        (text,) = ids
        octets = text.removeprefix(word).split(".")
        assert text.startswith(word) and len(octets) == 16
        assert all(0 <= int(octet, 16) <= 255 and octet == octet.lower() for octet in octets)
    assert client[0][1] != server[0][1]


def test_user_data_has_the_hash_of_known_types_only():
    expected_hash = known_hash("sensor_msgs/msg/Temperature")
    assert (
        type_hash("sensor_msgs::msg::dds_::Temperature_") == f"typehash={expected_hash};".encode()
    )
    for name in ("HelloWorld", "pkg::msg::dds_::Unknown_", "a::b", "", "::msg::dds_::X_"):
        assert type_hash(name) == b""


def test_a_big_endian_sample_of_a_known_type_arrives_little_endian(middleware, node):
    name = "std_msgs::msg::dds_::Int32_"
    inbox = node.create_reader("rt/number", name, QoSProfile(), nothing)
    writer = node.create_writer("rt/number", name, QoSProfile())
    assert writer.write(bytes.fromhex("00000000" "0a0b0c0d"))  # fmt: skip
    message = load("std_msgs/msg/Int32")()
    message.data = 0x0A0B0C0D
    assert take(middleware, inbox) == to_cdr(message)


def test_a_big_endian_sample_of_an_unknown_type_is_refused_by_name(node):
    writer = node.create_writer("rt/x", "pkg::msg::dds_::Unknown_", QoSProfile())
    with pytest.raises(MiddlewareError, match="pkg::msg::dds_::Unknown_"):
        writer.write(bytes.fromhex("00000000" "0a0b0c0d"))  # fmt: skip


@pytest.mark.parametrize("size", range(1, 9))
def test_samples_are_padded_with_zeros_and_nothing_else(middleware, node, size, monkeypatch):
    """Length on the wire is a multiple of 4; padding must not contain memory of this process."""
    sent = []
    write = cyclone.write_aligned
    monkeypatch.setattr(
        cyclone, "write_aligned", lambda writer, cdr: sent.append(bytes(cdr)) or write(writer, cdr)
    )
    reader = node.create_reader("rt/odd", "pkg::msg::dds_::Odd_", QoSProfile(), nothing)
    writer = node.create_writer("rt/odd", "pkg::msg::dds_::Odd_", QoSProfile())
    sample = b"\x00\x01\x00\x00" + b"\x5a" * size
    writer.write(memoryview(sample))
    fill = -size % 4
    assert sent == [b"\x00\x01\x00" + bytes([fill]) + b"\x5a" * size + bytes(fill)]
    assert take(middleware, reader) == sample


@pytest.mark.parametrize("header", [b"\x00\x01\x00\x03", b"\x00\x01\x00\x07"])
def test_a_sample_that_is_shorter_than_its_padding_is_empty(header):
    assert cyclone._unpadded(header) == b"\x00\x01\x00\x00"
    assert cyclone._unpadded(header + b"a") == b"\x00\x01\x00\x00"


# --- a reader that stands still ---------------------------------------------------------------

READER = """
import select, sys
from uros.middleware.dds.middleware import DdsMiddleware
from uros.middleware.user_data import type_hash
from uros.qos import HistoryPolicy, QoSProfile
middleware = DdsMiddleware()
qos = QoSProfile(history=HistoryPolicy.KEEP_ALL)
node = middleware.create_node(int(sys.argv[1]), "/", "reader")
reader = node.create_reader("rt/a", "T", qos, lambda: None)
while not reader.take(1):
    select.select([middleware.fileno()], [], [], 0.05)
    middleware.dispatch()
print("heard", flush=True)
sys.stdin.read()
"""


def test_deleting_a_writer_does_not_wait_long_for_a_stopped_reader(node, own_domain_id):
    """Other boards would wait as well: a second for each writer, by Cyclone's default."""
    sample = bytes((0, 1, 0, 0)) + bytes(4000)
    seconds = []
    with subprocess.Popen(
        [sys.executable, "-c", READER, str(own_domain_id)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE,
    ) as process:  # fmt: skip
        try:
            deadline = time.monotonic() + 60
            while not seconds or seconds[-1] > 0.5:  # a busy machine may add to one of them
                assert len(seconds) < 10, seconds
                writer = node.create_writer("rt/a", "T", QoSProfile(history=HistoryPolicy.KEEP_ALL))
                while not select.select([process.stdout], [], [], 0.05)[0] or not writer.matched():
                    writer.write(sample)
                    assert time.monotonic() < deadline, "the reader hears nothing"
                os.kill(process.pid, signal.SIGSTOP)
                while writer.write(sample):
                    assert time.monotonic() < deadline, "the writer always has room"
                before = time.monotonic()
                writer.close()
                seconds.append(time.monotonic() - before)
                os.kill(process.pid, signal.SIGCONT)
        finally:
            process.kill()
