"""What a writer answers, submessage by submessage."""

import itertools
import random
import tracemalloc

import pytest

from uros.middleware.rtps import parameters, submessages
from uros.middleware.rtps.kinds import AckNack, Data, DataFrag, Gap, Heartbeat, NackFrag
from uros.middleware.rtps.reader import StatefulReader
from uros.middleware.rtps.reassembly import OctetBudget
from uros.middleware.rtps.writer import StatefulWriter

PREFIX = b"\x01\x75" + bytes(10)
WRITER = PREFIX + b"\0\0\1\3"
READERS = [b"\x01\x0f" + bytes(9) + bytes([number]) + b"\0\0\1\4" for number in (1, 2)]
FORMS = b"\0\1\0\0body", b"\0\1\0\0headbody"


def writer_with(readers, **options):
    """A writer whose readers have acknowledged nothing, and counters for their acknowledgements."""
    options = {"reliable": True, "transient_local": False, "depth": None} | options
    writer = StatefulWriter(WRITER, fragment_size=100, **options)
    for guid in readers:
        writer.match(guid, True, False, 0.0)
        ask(writer, guid, 1)
    return writer


_counts = itertools.count(1)


def ask(writer, guid, base, missing=()):
    """Have a reader acknowledge all below ``base`` and ask for some."""
    acknack = AckNack(guid[12:], WRITER[12:], base, tuple(missing), next(_counts), True)
    writer.on_acknack(guid, acknack, 0.0)


def sent(packets, guid=None):
    """The submessages for a reader, or for all."""
    return [
        submessage
        for packet in packets
        if packet.reader in (None, guid)
        for submessage in submessages.read(memoryview(bytes(20) + packet.submessages))
    ]


def write(writer, payload=FORMS[0], **options):
    return writer.write(payload, 0, 0.0, **options)


def numbers(gaps):
    """The numbers that gaps leave out."""
    return {
        number
        for gap in gaps
        if isinstance(gap, Gap)
        for number in (*range(gap.start, gap.base), *gap.irrelevant)
    }


def test_the_heartbeat_of_an_empty_history_has_first_1_and_last_0():
    writer = StatefulWriter(WRITER, True, False, None, 100)
    (heartbeat,) = sent(writer.match(READERS[0], True, False, 0.0), READERS[0])
    assert isinstance(heartbeat, Heartbeat) and (heartbeat.first, heartbeat.last) == (1, 0)


def test_the_heartbeat_of_a_history_that_became_empty_begins_behind_the_last():
    writer = writer_with(READERS[:1])
    write(writer)
    ask(writer, READERS[0], 2)
    (heartbeat,) = sent(writer.match(READERS[1], True, False, 0.0), READERS[1])
    assert (heartbeat.first, heartbeat.last) == (2, 1)


def test_samples_from_before_the_match_are_answered_by_gaps_on_a_volatile_writer():
    writer = writer_with(READERS[:1])
    for _ in range(5):
        write(writer)
    writer.match(READERS[1], True, True, 0.0)
    ask(writer, READERS[1], 1, range(1, 6))
    answers = sent(writer.poll(0.0), READERS[1])
    assert numbers(answers) == {1, 2, 3, 4, 5}
    assert not any(isinstance(answer, Data) for answer in answers)


def test_samples_that_keep_last_has_dropped_are_answered_by_gaps():
    writer = writer_with(READERS[:1], depth=2)
    for _ in range(5):
        write(writer)
    ask(writer, READERS[0], 1, range(1, 6))
    answers = sent(writer.poll(0.0), READERS[0])
    assert numbers(answers) == {1, 2, 3}
    assert [answer.number for answer in answers if isinstance(answer, Data)] == [4, 5]


def test_a_late_reader_costs_what_is_in_the_history_not_what_was_ever_written():
    """One key stays, another one has had a million samples: as endpoints that come and go."""
    writer = writer_with([], transient_local=True)
    write(writer)
    writer.last = 1_000_000
    write(writer)
    tracemalloc.start()
    try:
        writer.match(READERS[0], True, True, 0.0)
        ask(writer, READERS[0], 1)
        answer = sent(writer.poll(0.0), READERS[0])
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert [each.number for each in answer if isinstance(each, Data)] == [1, 1_000_001]
    (gap,) = [each for each in answer if isinstance(each, Gap)]
    assert (gap.start, gap.base, gap.irrelevant) == (2, 1_000_001, ())
    assert peak < 100_000


def test_a_late_reader_waits_for_no_number_that_is_not_in_the_history():
    """Whatever is left of a history, and in however many polls it is sent."""
    chance = random.Random(3)
    for _ in range(200):
        writer = writer_with([], transient_local=True)
        kept = set()
        for _ in range(chance.randrange(1, 40)):
            writer.last += chance.choice([0, 0, 1, 3, 300])
            write(writer, bytes(chance.choice([8, 90, 4000])))
            kept.add(writer.last)
        writer.match(READERS[0], True, True, 0.0)
        ask(writer, READERS[0], 1)
        answer, now = [], 0.0
        while writer.readers[READERS[0]].resend_at is not None:
            answer += sent(writer.poll(now), READERS[0])
            now += 0.1
        got = {each.number for each in answer if isinstance(each, (Data, DataFrag))}
        assert got == kept
        assert numbers(answer) | got >= set(range(min(kept), max(kept) + 1))
        assert not numbers(answer) & got


def test_a_directed_sample_is_a_gap_for_the_others_at_once():
    writer = writer_with(READERS)
    packets = write(writer, readers=frozenset(READERS[:1]))
    assert [type(answer) for answer in sent(packets, READERS[0])] == [Data]
    assert numbers(sent(packets, READERS[1])) == {1}
    ask(writer, READERS[1], 1, [1])
    answers = sent(writer.poll(0.0), READERS[1])
    assert numbers(answers) == {1} and not any(isinstance(answer, Data) for answer in answers)


@pytest.mark.parametrize("size", [4, 400])
def test_what_is_sent_again_keeps_the_form_of_its_reader(size):
    """Inline QoS for one, a header in the payload for another; whole and in fragments."""
    writer = StatefulWriter(WRITER, True, False, None, 100)
    for guid, wants_header in zip(READERS, (False, True), strict=True):
        writer.match(guid, True, False, 0.0, wants_header)
        ask(writer, guid, 1)
    related = parameters.write_related_identity(READERS[0], 7)
    forms = [form + bytes(size - 4) for form in FORMS]
    first = write(writer, forms[0], inline_qos=related, with_header=forms[1])
    for guid in READERS:
        ask(writer, guid, 1, [1])
    again = list(writer.poll(0.0))
    nack = NackFrag(READERS[1][12:], WRITER[12:], 1, (2,), 1)
    for guid in READERS:
        writer.on_nack_frag(guid, nack, 0.0)
    fragments = list(writer.poll(1.0))
    for packets in (first, again, fragments) if size > 100 else (first, again):
        for guid, form, inline_qos in zip(READERS, forms, (related, None), strict=True):
            data = [one for one in sent(packets, guid) if isinstance(one, Data | DataFrag)]
            assert data and all(one.inline_qos == inline_qos for one in data)
            assert all(one.reader == guid[12:] for one in data)
            for one in data:
                if isinstance(one, DataFrag):
                    assert one.sample_size == len(form)
                    assert bytes(one.payload) == form[100 * (one.first - 1) :][: len(one.payload)]
                else:
                    assert submessages.unpadded(bytes(one.payload)) == form


def test_counts_rise_strictly_for_each_pair():
    """Heartbeats, acknowledgements and those of fragments, over a link that loses a third."""
    link = random.Random(3)
    writer = StatefulWriter(WRITER, True, False, None, 100)
    readers = {}
    for guid in READERS:
        readers[guid] = StatefulReader(guid, True, False, lambda sample: True, OctetBudget(10**6))
        readers[guid].match(WRITER, True, 0.0)
        writer.match(guid, True, False, 0.0)
    counts = {}
    now = 0.0
    for turn in range(400):
        packets = writer.write(bytes(350), 0, now) if turn % 10 == 0 else []
        packets += writer.poll(now)
        for guid, reader in readers.items():
            for one in sent(packets, guid):
                if isinstance(one, Heartbeat):
                    counts.setdefault((guid, Heartbeat), []).append(one.counter)
                if link.random() < 0.3:
                    continue
                if isinstance(one, Heartbeat):
                    reader.on_heartbeat(WRITER, one, now)
                elif isinstance(one, DataFrag):
                    reader.on_fragments(WRITER, one, now)
                elif isinstance(one, Gap):
                    reader.on_gap(WRITER, one)
            for _, octets in reader.poll(now):
                for one in submessages.read(memoryview(bytes(20) + octets)):
                    counts.setdefault((guid, type(one)), []).append(one.counter)
                    if link.random() < 0.3:
                        continue
                    if isinstance(one, AckNack):
                        writer.on_acknack(guid, one, now)
                    else:
                        writer.on_nack_frag(guid, one, now)
        now += 0.03
    assert set(counts) == {
        (guid, kind) for guid in READERS for kind in (Heartbeat, AckNack, NackFrag)
    }
    for found in counts.values():
        assert len(found) > 10
        assert all(before < after for before, after in itertools.pairwise(found))


def test_a_big_endian_payload_is_given_out_as_it_came():
    samples = []
    reader = StatefulReader(
        READERS[0], False, False, lambda sample: bool(samples.append(sample)) or True,
        OctetBudget(10**6),
    )  # fmt: skip
    reader.match(WRITER, False, 0.0)
    reader.on_data(WRITER, 1, b"\0\0\0\0\0\0\0\5", None, True, False, 0.0)
    assert samples[0].payload == b"\0\0\0\0\0\0\0\5"


@pytest.mark.parametrize(
    "encoded",
    [
        submessages.encode_heartbeat(bytes(4), WRITER[12:], 1, 0, 1),
        submessages.encode_acknack(bytes(4), WRITER[12:], 1, [3], 1),
        submessages.encode_gap(bytes(4), WRITER[12:], 1, 3),
        submessages.encode_data(bytes(4), WRITER[12:], 1, b"\0\1\0\0abcd"),
        submessages.encode_data_frag(bytes(4), WRITER[12:], 1, 1, 100, 150, bytes(100)),
        submessages.encode_info_dst(PREFIX),
    ],
    ids=["heartbeat", "acknack", "gap", "data", "data_frag", "info_dst"],
)
def test_a_last_submessage_of_length_0_reaches_to_the_end(encoded):
    endless = encoded[:2] + b"\0\0" + encoded[4:]
    (wanted,), (found,) = (
        [repr(one).split("payload")[0] for one in submessages.read(memoryview(bytes(20) + octets))]
        for octets in (encoded, endless)
    )
    assert found == wanted
