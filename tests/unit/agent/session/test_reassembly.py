"""A C client abandons a long message half-way and goes on with the next one.

``CClient`` writes fragments as the C client's library does, by its sources (``write_access.c``,
``output_reliable_stream.c``), and shares no code with ``uros``. ``replay/test_loss.py`` has a
conversation of the real library.
"""

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.examples import examples
from unit.agent.session.test_session import OTHER, WRITER, Talk

from uros.agent.session import reassembly

LAST = 2
OFFSET = 4  # of the message header
HEAD = 4


class CClient:
    """Sends fragments on a reliable stream; ``capacity``: octets of each message of its history."""

    def __init__(self, talk, capacity=512, request=10):
        self.talk = talk
        self.block = capacity - OFFSET - HEAD
        self.request = request
        self.number = 0

    def head(self, length, writer):
        self.request += 1
        return struct.pack("<BBH", 7, 1, length & 0xFFFF) + struct.pack(">HH", self.request, writer)

    def send(self, flags, part):
        datagram = struct.pack("<BBHBBH", 0x81, 0x80, self.number, 13, 1 | flags, len(part)) + part
        self.number = (self.number + 1) & 0xFFFF
        self.talk.raw(datagram)

    def fragments(self, whole, at_most=None, full=False):
        """Send a message in fragments; abandon it after ``at_most`` of them."""
        parts = [whole[at : at + self.block] for at in range(0, len(whole), self.block)]
        if full:
            parts[-1] = parts[-1].ljust(self.block, b"\xee")
        for index, part in enumerate(parts[:at_most]):
            self.send(LAST if index == len(parts) - 1 else 0, part)

    def buffered(self, sample, writer=WRITER):
        """Send as uxr_prepare_output_stream does, which never abandons a message."""
        size = 4 + len(sample)
        self.fragments(self.head(size, writer) + sample + b"\xee" * (-size % 4))

    def continuous(self, sample, writer=WRITER, at_most=None):
        """Send as uxr_prepare_output_stream_fragmented does since 2.1."""
        size = 4 + len(sample)
        self.fragments(self.head(size if size <= 0xFFFF else 0, writer) + sample, at_most)

    def continuous_2_0(self, sample, writer=WRITER, at_most=None):
        """Send as in 2.0: no length 0, and the last fragment is filled up."""
        self.fragments(self.head(4 + len(sample), writer) + sample, at_most, full=True)

    def small(self, sample, writer=WRITER):
        """Send a sample that fits one message as in 2.0: a single fragment, filled up."""
        whole = self.head(4 + len(sample), writer) + sample
        assert len(whole) <= self.block
        self.send(LAST, whole.ljust(self.block, b"\xee"))


def picture(size, seed=1):
    """Return octets that contain no header of a WRITE_DATA."""
    return bytes((number * 7 + seed) % 251 | 8 for number in range(size))


@pytest.fixture
def talk():
    return Talk()


SIZES = [505, 1000, 1001, 1002, 1003, 5000, 20_000, 65_529, 65_530, 65_531, 65_532, 65_533,
         65_536, 66_000, 70_001, 131_068, 131_072, 200_003]  # fmt: skip


@pytest.mark.parametrize("form", ["buffered", "continuous", "continuous_2_0"])
@pytest.mark.parametrize("capacity", [128, 300, 510, 512, 2048])
def test_every_good_message_of_a_c_client_is_taken(talk, form, capacity):
    client = CClient(talk, capacity)
    for size in SIZES:
        talk.written.clear()
        sample = picture(size)
        getattr(client, form)(sample)
        (received,) = talk.samples()
        assert received[:size] == sample
        if (4 + size) & 0xFFFF:
            assert received == sample
        # Otherwise its length is 0, so the filler of its last fragment looks like the sample's end.
    assert not talk.handler.faults and talk.session.given_up == 0


@settings(max_examples=examples(300), deadline=None)
@given(
    st.sampled_from(["buffered", "continuous", "continuous_2_0", "small"]),
    st.integers(16, 600).map(lambda item: item * 4),
    st.integers(0, 140_000),
    st.binary(min_size=1, max_size=40),
)
def test_no_complete_message_is_split_into_two(form, capacity, size, pattern):
    talk = Talk()
    client = CClient(talk, capacity)
    if form == "small":
        size = 1 + size % (client.block - 8)
    else:
        size = max(size, client.block)
    sample = (pattern * (size // len(pattern) + 1))[:size]
    getattr(client, form)(sample)
    (received,) = talk.samples()
    assert received[:size] == sample and talk.session.given_up == 0


@pytest.mark.parametrize("second", ["buffered", "continuous"])
@pytest.mark.parametrize("sent_count", [1, 2, 5])
@pytest.mark.parametrize(
    ("a", "b"),
    [(20_000, 20_000), (20_000, 900), (3000, 60_000), (50_000, 40_000), (100_000, 100_000),
     (100_000, 3000), (3000, 100_000), (65_600, 65_536), (20_000, 20_001)],
)  # fmt: skip
def test_a_message_abandoned_directly_before_the_next_is_dropped_alone(
    talk, a, b, sent_count, second
):
    client = CClient(talk)
    client.buffered(b"before" * 200)
    client.continuous(picture(a, 1), at_most=sent_count)
    getattr(client, second)(picture(b, 2))
    client.buffered(b"after" * 200)
    before, received, after = talk.samples()
    assert received[:b] == picture(b, 2) and len(received) - b < 4
    assert (before, after) == (b"before" * 200, b"after" * 200)
    assert [text for text, _ in talk.handler.faults] == ["message given up"]
    assert talk.session.given_up == 1


def test_two_abandoned_messages_one_after_the_other(talk):
    client = CClient(talk)
    client.continuous(picture(20_000, 1), at_most=3)
    client.continuous(picture(100_000, 2), at_most=4)
    client.continuous(picture(20_000, 3))
    assert talk.samples() == [picture(20_000, 3)]


@pytest.mark.parametrize("request_id", [0xFE, 0x7FFE, 0xFFFE])
def test_request_numbers_carry_and_wrap(talk, request_id):
    client = CClient(talk, request=request_id)
    client.continuous(picture(20_000, 1), at_most=3)
    client.request &= 0xFFFF
    if request_id == 0xFFFE:
        client.request = 9  # as the library, which reserves 0 to 9
    client.continuous(picture(20_000, 2))
    assert talk.samples() == [picture(20_000, 2)]


@pytest.mark.parametrize("more", range(1, 9))
@pytest.mark.parametrize("size", [20_000, 100_000])
def test_the_beginning_of_a_header_at_the_very_end(talk, size, more):
    client = CClient(talk)
    whole = 8 + size + (-(8 + size)) % client.block + more
    sample = bytearray(picture(whole - 8))
    head = struct.pack("<BBH", 7, 1, 0) + struct.pack(">HH", 12, WRITER)
    sample[-more:] = head[:more]
    client.continuous(bytes(sample))
    assert talk.samples() == [bytes(sample)]
    client.continuous(picture(5000, 1), at_most=1)
    client.fragments(bytes(sample))
    assert talk.session.given_up == 1


def test_the_next_message_is_another_writers(talk):
    talk.session.writers[OTHER] = talk.write
    client = CClient(talk)
    client.continuous(picture(20_000, 1), at_most=3)
    client.continuous(picture(5000, 2), OTHER)
    assert talk.samples() == [picture(5000, 2)]


@pytest.mark.parametrize("object_id", [0x0017, 0x0018])
def test_the_next_message_is_a_services(talk, object_id):
    client = CClient(talk)
    client.continuous(picture(20_000, 1), at_most=3)
    client.buffered(picture(5000, 2), object_id)
    ((kind, _, _, payload),) = talk.handler.submessages
    assert kind == 7 and payload[2:] == struct.pack(">H", object_id) + picture(5000, 2)


def test_a_client_of_2_0_that_abandons_a_message(talk):
    client = CClient(talk)
    client.continuous_2_0(picture(20_000, 1), at_most=3)
    client.continuous_2_0(picture(20_000, 2))
    assert talk.samples() == [picture(20_000, 2)]
    assert talk.session.given_up == 1


def test_messages_whose_border_is_not_found_are_dropped_and_never_delivered_as_one(talk):
    """The next message is no WRITE_DATA: both are lost, and the message behind them is not."""
    client = CClient(talk)
    client.continuous(picture(20_000, 1), at_most=3)
    create = struct.pack("<BBH", 1, 1, 3000) + bytes(3000)
    client.fragments(create)
    assert not talk.written and not talk.handler.submessages
    assert [text for text, _ in talk.handler.faults] == ["message given up"]
    client.continuous(picture(20_000, 2))
    assert talk.samples() == [picture(20_000, 2)]
    assert talk.session.given_up == 1


def test_octets_that_look_like_a_header_do_not_split_a_message(talk):
    """A fragment begins with a WRITE_DATA of an earlier request, unknown writer or wrong length."""
    client = CClient(talk)
    sample = bytearray(picture(100_000))
    for index, head in enumerate(
        (
            struct.pack("<BBH", 7, 1, 0) + struct.pack(">HH", 3, WRITER),
            struct.pack("<BBH", 7, 1, 0) + struct.pack(">HH", 12, OTHER),
            struct.pack("<BBH", 7, 1, 77) + struct.pack(">HH", 12, WRITER),
            struct.pack("<BBH", 7, 0, 0) + struct.pack(">HH", 12, WRITER),
        ),
        2,
    ):
        sample[index * client.block - 8 : index * client.block] = head
    client.continuous(bytes(sample))
    assert talk.samples() == [bytes(sample)]
    assert not talk.handler.faults


@pytest.mark.parametrize("size", [20_000, 65_532 + 20_000])
def test_a_message_of_its_announced_length_is_never_split(talk, size):
    """A sample may contain anything, such as fragments of another capture."""
    client = CClient(talk)
    sample = bytearray(picture(size))
    at = 3 * client.block - 8
    rest = struct.pack("<BBH", 7, 1, (size - at - 4) & 0xFFFF) + struct.pack(">HH", 12, WRITER)
    sample[at : at + 8] = rest
    client.buffered(bytes(sample))
    assert talk.samples() == [bytes(sample)]
    assert talk.session.given_up == 0


def test_the_search_in_a_message_of_headers_alone_is_bounded(talk, monkeypatch):
    looked = []
    after = reassembly.sequence_after
    monkeypatch.setattr(
        reassembly, "sequence_after", lambda a, b: looked.append(a) is None and after(a, b)
    )
    head = struct.pack("<BBH", 7, 1, 0) + struct.pack(">HH", 9, WRITER)
    client = CClient(talk, OFFSET + HEAD + len(head))
    client.fragments(head * 20_000)
    assert len(talk.written) == 1 and 0 < len(looked) <= reassembly._LOOKS


def test_a_message_that_was_abandoned_before_the_agent_restarted(talk):
    """The fragments that follow are as long as the first one was, but for the last."""
    client = CClient(talk)
    client.continuous(picture(20_000, 1), at_most=2)
    talk.session._in[0x80].first_fragment = 0
    client.continuous(picture(20_000, 2))
    assert talk.samples() == [picture(20_000, 2)]
    assert talk.session.given_up == 1


def test_a_message_whose_beginning_was_restored(talk):
    """The length of its first fragment is not known after a restart of the agent."""
    client = CClient(talk)
    client.continuous(picture(20_000), at_most=2)
    talk.session._in[0x80].first_fragment = 0
    whole = client.head(4 + 20_000, WRITER) + picture(20_000)
    for at in range(2 * client.block, len(whole), client.block):
        part = whole[at : at + client.block]
        client.send(LAST if at + client.block >= len(whole) else 0, part)
    assert talk.samples() == [picture(20_000)]
    assert not talk.handler.faults


@pytest.mark.parametrize(
    ("extra", "first", "last", "good"),
    [
        (0, 500, 100, True), (3, 500, 100, True), (4, 500, 100, False), (99, 500, 100, False),
        (4, 500, 500, True), (499, 500, 500, True), (500, 500, 500, False),
        (4, 0, 500, True), (499, 0, 500, True), (500, 0, 500, False), (4, 100, 500, False),
        (-1, 500, 500, False),
    ],
)  # fmt: skip
@pytest.mark.parametrize("size", [2000, 70_000])
def test_octets_that_a_c_client_may_append_to_a_message(size, extra, first, last, good):
    """Test padding, and the filler of a last fragment that is as long as the first."""
    if extra < 0 and size > 0xFFFF:
        extra &= 0xFFFF
    whole = bytearray(struct.pack("<BBH", 7, 1, (size - extra) & 0xFFFF) + bytes(size))
    assert reassembly.fits(whole, 0, first, last) is good
    assert reassembly.surplus(whole) == extra & 0xFFFF
