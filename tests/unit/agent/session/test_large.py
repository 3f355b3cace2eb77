"""Submessages around and over 64 kB, in fragments as C clients make them, both ways.

Their length does not fit the 16-bit field. A C client writes its low 16 bits and pads the
submessage to 4 bytes (uxr_prepare_stream_to_write_submessage), or writes 0 without padding
(uxr_prepare_output_stream_fragmented). Either way the sample must arrive unchanged, to the byte.
"""

import pytest
from unit.agent.helpers import (
    PARTICIPANT,
    READER,
    REPLIER,
    REQUESTER,
    TOPIC,
    WRITER,
    Board,
    Desk,
    create,
    fragment,
    participant,
    publisher_entities,
    read_data,
    service,
    subscriber_entities,
    write_data,
)
from unit.agent.test_server import TYPE, running

from uros.qos import QoSProfile
from uros.wire import ids

OK = ids.STATUS_OK
# Sizes of a submessage without its header.
SIZES = [*range(65_531, 65_541), 70_000, 131_071, 131_072, 131_073, 131_076, 1 << 20]


def pattern(size):
    return bytes(i * 31 + (i >> 8) & 0xFF for i in range(size))


def as_c_clients(submessage, continuous=False):
    """Return the bytes of a submessage as a C client puts them into fragments."""
    kind, flags, payload = submessage
    length_field = 0 if continuous and len(payload) > 0xFFFF else len(payload) & 0xFFFF
    padding = b"" if continuous else b"\xee" * (-len(payload) % 4)
    return bytes((kind, flags)) + length_field.to_bytes(2, "little") + payload + padding


def send(board, raw, size=1000):
    for start in range(0, len(raw), size):
        board.send(fragment(raw[start : start + size], start + size >= len(raw)))


@pytest.mark.parametrize("continuous", [False, True], ids=["truncated", "zero"])
@pytest.mark.parametrize("size", SIZES)
def test_samples_in_and_out_to_the_byte(size, continuous):
    desk = Desk()
    first, second = Board(desk, 1, 0x11), Board(desk, 2, 0x22, mtu=4096)
    assert first.ask(*publisher_entities()) == [OK] * 4
    assert second.ask(*subscriber_entities()) == [OK] * 4
    second.send(read_data(READER))
    sample = pattern(size - 4)
    send(first, as_c_clients(write_data(WRITER, sample), continuous))
    second.settle()
    (received,) = second.samples()
    assert len(received) == len(sample)
    assert received == sample
    assert "error" not in desk.log()
    desk.close()


@pytest.mark.parametrize("size", SIZES)
def test_requests_and_replies_to_the_byte(size):
    desk = Desk()
    server, asker = Board(desk, 1, 0x11, mtu=4096), Board(desk, 2, 0x22, mtu=4096)
    server.ask(participant(), service(REPLIER))
    asker.ask(participant(), service(REQUESTER))
    server.send(read_data(REPLIER, request=3))
    asker.send(read_data(REQUESTER, request=4))
    body = pattern(size - 4)
    send(asker, as_c_clients(write_data(REQUESTER, body, request=0x1234)))
    server.settle()
    (request,) = server.payloads(ids.DATA)
    assert request[28:] == body
    answer = pattern(size - 28)
    send(server, as_c_clients(write_data(REPLIER, request[4:28] + answer)))
    asker.settle()
    (reply,) = asker.payloads(ids.DATA)
    assert reply[4:8] == bytes.fromhex("1234 0017")
    assert reply[8:] == answer
    desk.close()


@pytest.mark.parametrize("size", range(65_531, 65_541))
def test_a_submessage_behind_the_last_fragment_is_handled_on_its_own(size):
    """The last fragment of a C client may share its message with the next submessage."""
    desk = Desk()
    board = Board(desk)
    board.ask(*publisher_entities())
    node = desk.middleware.create_node(0, "/", "ear")
    reader = node.create_reader(
        "rt/chatter", "std_msgs::msg::dds_::Int32_", QoSProfile(), lambda: None
    )
    raw = as_c_clients(write_data(WRITER, pattern(size - 4)))
    parts = [raw[i : i + 1000] for i in range(0, len(raw), 1000)]
    for part in parts[:-1]:
        board.send(fragment(part))
    board.send(fragment(parts[-1], last=True), write_data(WRITER, b"behind"))
    samples = [item[4:] for item in reader.take(10)]
    assert samples == [pattern(size - 4), b"behind"]
    desk.close()


@pytest.mark.parametrize("size", [65_531, 65_535, 65_536, 65_540])
def test_creations_of_64_kilobytes(size):
    """XML of up to 65,535 characters is accepted; the length field of its CREATE is ignored."""
    desk = Desk()
    board = Board(desk)
    board.ask(participant())
    xml = "<dds><topic><name>rt/x</name><dataType>T</dataType></topic></dds>"
    bare = len(create(TOPIC, ids.AS_XML, xml, PARTICIPANT)[2])
    submessage = create(TOPIC, ids.AS_XML, xml + " " * (size - bare), PARTICIPANT)
    assert len(submessage[2]) == size
    send(board, as_c_clients(submessage))
    assert board.statuses() == [OK], desk.log()
    desk.close()


@pytest.mark.parametrize("length_field", [4464, 5000, 65_535])
def test_a_length_that_fits_no_c_client_is_dropped_as_two_messages(length_field):
    """No C client writes such a length: the fragments belong to two messages."""
    desk = Desk()
    first, second = Board(desk, 1, 0x11), Board(desk, 2, 0x22)
    first.ask(*publisher_entities())
    second.ask(*subscriber_entities())
    second.send(read_data(READER))
    kind, flags, payload = write_data(WRITER, pattern(70_010))
    send(first, bytes((kind, flags)) + length_field.to_bytes(2, "little") + payload)
    second.settle()
    assert second.samples() == [] and "message given up" in desk.log()
    desk.close()


@pytest.mark.parametrize("transport", ["udp", "tcp"])
@pytest.mark.parametrize("mtu", [512, 60_000])
def test_large_samples_over_real_transports(transport, mtu):
    with running() as server:
        client = server.client(1, transport, mtu=mtu)
        writer, reader = client.writer("a", "rt/a", TYPE), client.reader("a", "rt/a", TYPE)
        client.read(reader)
        sizes = [65_531, 65_535, 65_536, 65_540, 131_072, 1 << 20]
        for size in sizes:
            sample = pattern(size)
            client.write(writer, sample)
            assert client.sample(reader) == sample
        assert "error" not in server.said.getvalue()


@pytest.mark.parametrize("size", [1000, 65_516, 65_520])
def test_fragments_carry_one_submessage(size):
    """The last fragment of a C client 2.0 is filled up with earlier content of its buffer."""
    desk = Desk()
    board = Board(desk)
    board.ask(*publisher_entities())
    node = desk.middleware.create_node(0, "/", "ear")
    reader = node.create_reader(
        "rt/chatter", "std_msgs::msg::dds_::Int32_", QoSProfile(), lambda: None
    )
    sample = pattern(size - 4)
    raw = b"".join(as_c_clients(write_data(WRITER, item)) for item in (sample, b"old!"))
    send(board, raw.ljust(len(raw) + -len(raw) % 1000, b"\xee"))
    assert [item[4:] for item in reader.take(10)] == [sample]
    desk.close()
