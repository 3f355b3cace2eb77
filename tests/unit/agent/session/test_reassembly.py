"""A C client gives a long message up half-way and goes straight on with the next one.

``C`` writes fragments as the C client's library does, by its sources (``write_access.c``,
``output_reliable_stream.c``), and shares no code with ``uros``. ``replay/test_loss.py`` has a
conversation of the real one.
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


class C:
    """Fragments of a reliable stream. ``capacity``: octets of each message of its history."""

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
        """``at_most``: it gives up after so many."""
        parts = [whole[at : at + self.block] for at in range(0, len(whole), self.block)]
        if full:
            parts[-1] = parts[-1].ljust(self.block, b"\xee")
        for index, part in enumerate(parts[:at_most]):
            self.send(LAST if index == len(parts) - 1 else 0, part)

    def buffered(self, sample, writer=WRITER):
        """uxr_prepare_output_stream, which never gives up."""
        size = 4 + len(sample)
        self.fragments(self.head(size, writer) + sample + b"\xee" * (-size % 4))

    def continuous(self, sample, writer=WRITER, at_most=None):
        """uxr_prepare_output_stream_fragmented, from 2.1 on."""
        size = 4 + len(sample)
        self.fragments(self.head(size if size <= 0xFFFF else 0, writer) + sample, at_most)

    def continuous_2_0(self, sample, writer=WRITER, at_most=None):
        """The same in 2.0: no length 0, and the last fragment is a whole one."""
        self.fragments(self.head(4 + len(sample), writer) + sample, at_most, full=True)

    def small(self, sample, writer=WRITER):
        """The same with a sample that fits one message: a single fragment, and a whole one."""
        whole = self.head(4 + len(sample), writer) + sample
        assert len(whole) <= self.block
        self.send(LAST, whole.ljust(self.block, b"\xee"))


def picture(size, seed=1):
    """Octets in which no header of a WRITE_DATA stands."""
    return bytes((number * 7 + seed) % 251 | 8 for number in range(size))


@pytest.fixture
def talk():
    return Talk()


SIZES = [505, 1000, 1001, 1002, 1003, 5000, 20_000, 65_529, 65_530, 65_531, 65_532, 65_533,
         65_536, 66_000, 70_001, 131_068, 131_072, 200_003]  # fmt: skip


@pytest.mark.parametrize("form", ["buffered", "continuous", "continuous_2_0"])
@pytest.mark.parametrize("capacity", [128, 300, 510, 512, 2048])
def test_every_good_message_of_a_c_client_is_taken(talk, form, capacity):
    client = C(talk, capacity)
    for size in SIZES:
        talk.written.clear()
        sample = picture(size)
        getattr(client, form)(sample)
        (got,) = talk.samples()
        assert got[:size] == sample
        if (4 + size) & 0xFFFF:
            assert got == sample
        # Else its length is 0, and what fills its last fragment cannot be told from the sample.
    assert not talk.handler.faults and talk.session.given_up == 0


@settings(max_examples=examples(300), deadline=None)
@given(
    st.sampled_from(["buffered", "continuous", "continuous_2_0", "small"]),
    st.integers(16, 600).map(lambda item: item * 4),
    st.integers(0, 140_000),
    st.binary(min_size=1, max_size=40),
)
def test_no_good_message_is_taken_for_two(form, capacity, size, pattern):
    talk = Talk()
    client = C(talk, capacity)
    if form == "small":
        size = 1 + size % (client.block - 8)
    else:
        size = max(size, client.block)
    sample = (pattern * (size // len(pattern) + 1))[:size]
    getattr(client, form)(sample)
    (got,) = talk.samples()
    assert got[:size] == sample and talk.session.given_up == 0


@pytest.mark.parametrize("second", ["buffered", "continuous"])
@pytest.mark.parametrize("kept", [1, 2, 5])
@pytest.mark.parametrize(
    ("a", "b"),
    [(20_000, 20_000), (20_000, 900), (3000, 60_000), (50_000, 40_000), (100_000, 100_000),
     (100_000, 3000), (3000, 100_000), (65_600, 65_536), (20_000, 20_001)],
)  # fmt: skip
def test_a_message_given_up_straight_before_the_next_is_dropped_alone(talk, a, b, kept, second):
    client = C(talk)
    client.buffered(b"before" * 200)
    client.continuous(picture(a, 1), at_most=kept)
    getattr(client, second)(picture(b, 2))
    client.buffered(b"after" * 200)
    before, got, after = talk.samples()
    assert got[:b] == picture(b, 2) and len(got) - b < 4
    assert (before, after) == (b"before" * 200, b"after" * 200)
    assert [what for what, _ in talk.handler.faults] == ["message given up"]
    assert talk.session.given_up == 1


def test_two_given_up_one_after_the_other(talk):
    client = C(talk)
    client.continuous(picture(20_000, 1), at_most=3)
    client.continuous(picture(100_000, 2), at_most=4)
    client.continuous(picture(20_000, 3))
    assert talk.samples() == [picture(20_000, 3)]


@pytest.mark.parametrize("request_id", [0xFE, 0x7FFE, 0xFFFE])
def test_the_numbers_of_requests_carry_and_come_round(talk, request_id):
    client = C(talk, request=request_id)
    client.continuous(picture(20_000, 1), at_most=3)
    client.request &= 0xFFFF
    if request_id == 0xFFFE:
        client.request = 9  # as the library, which keeps 0 to 9 for itself
    client.continuous(picture(20_000, 2))
    assert talk.samples() == [picture(20_000, 2)]


@pytest.mark.parametrize("more", range(1, 9))
@pytest.mark.parametrize("size", [20_000, 100_000])
def test_the_beginning_of_a_header_at_the_very_end(talk, size, more):
    client = C(talk)
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
    client = C(talk)
    client.continuous(picture(20_000, 1), at_most=3)
    client.continuous(picture(5000, 2), OTHER)
    assert talk.samples() == [picture(5000, 2)]


@pytest.mark.parametrize("thing", [0x0017, 0x0018])
def test_the_next_message_is_a_services(talk, thing):
    client = C(talk)
    client.continuous(picture(20_000, 1), at_most=3)
    client.buffered(picture(5000, 2), thing)
    ((kind, _, _, payload),) = talk.handler.seen
    assert kind == 7 and payload[2:] == struct.pack(">H", thing) + picture(5000, 2)


def test_a_client_of_2_0_that_gives_up(talk):
    client = C(talk)
    client.continuous_2_0(picture(20_000, 1), at_most=3)
    client.continuous_2_0(picture(20_000, 2))
    assert talk.samples() == [picture(20_000, 2)]
    assert talk.session.given_up == 1


def test_what_cannot_be_found_is_dropped_and_never_passed_on_as_one(talk):
    """The next one is no WRITE_DATA: both are lost, and the one behind them is not."""
    client = C(talk)
    client.continuous(picture(20_000, 1), at_most=3)
    create = struct.pack("<BBH", 1, 1, 3000) + bytes(3000)
    client.fragments(create)
    assert not talk.written and not talk.handler.seen
    assert [what for what, _ in talk.handler.faults] == ["message given up"]
    client.continuous(picture(20_000, 2))
    assert talk.samples() == [picture(20_000, 2)]
    assert talk.session.given_up == 1


def test_octets_that_look_like_a_header_do_not_cut_a_picture(talk):
    """Where a fragment begins, a WRITE_DATA of an earlier request, of no writer, of no length."""
    client = C(talk)
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
def test_a_message_that_is_as_long_as_it_says_is_never_cut(talk, size):
    """Whatever stands in it, such as the fragments of another capture."""
    client = C(talk)
    sample = bytearray(picture(size))
    at = 3 * client.block - 8
    rest = struct.pack("<BBH", 7, 1, (size - at - 4) & 0xFFFF) + struct.pack(">HH", 12, WRITER)
    sample[at : at + 8] = rest
    client.buffered(bytes(sample))
    assert talk.samples() == [bytes(sample)]
    assert talk.session.given_up == 0


def test_a_message_of_headers_alone_costs_a_bounded_look(talk, monkeypatch):
    looked = []
    after = reassembly.sequence_after
    monkeypatch.setattr(
        reassembly, "sequence_after", lambda a, b: looked.append(a) is None and after(a, b)
    )
    head = struct.pack("<BBH", 7, 1, 0) + struct.pack(">HH", 9, WRITER)
    client = C(talk, OFFSET + HEAD + len(head))
    client.fragments(head * 20_000)
    assert len(talk.written) == 1 and 0 < len(looked) <= reassembly._LOOKS


def test_a_message_that_was_given_up_at_another_agent(talk):
    """As long as the first fragment was are those that come now, but for the last."""
    client = C(talk)
    client.continuous(picture(20_000, 1), at_most=2)
    talk.session._in[0x80].first_fragment = 0
    client.continuous(picture(20_000, 2))
    assert talk.samples() == [picture(20_000, 2)]
    assert talk.session.given_up == 1


def test_a_message_whose_beginning_another_agent_had(talk):
    """The length of its first fragment is not known after a restart of the agent."""
    client = C(talk)
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
def test_what_may_stand_behind_a_message_of_a_c_client(size, extra, first, last, good):
    """Padding, and behind a last fragment as long as the first what fills it."""
    if extra < 0 and size > 0xFFFF:
        extra &= 0xFFFF
    whole = bytearray(struct.pack("<BBH", 7, 1, (size - extra) & 0xFFFF) + bytes(size))
    assert reassembly.fits(whole, 0, first, last) is good
    assert reassembly.surplus(whole) == extra & 0xFFFF
