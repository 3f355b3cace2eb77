"""Recorded conversations (tests/captures): the codecs decode and encode every octet."""

import json
from collections import Counter
from pathlib import Path

import pytest
from support.conversation import check, decode
from support.portable import framed

from uros.wire import ids
from uros.wire.framing import Deframer, LengthDeframer
from uros.wire.header import pull_subheader
from uros.wire.streams import BestEffortIn, Fragments, ReliableIn, split

CAPTURES = Path(__file__).resolve().parents[2] / "captures"
FILES = sorted(CAPTURES.glob("*.jsonl"))


class TcpMessages:
    """A LengthDeframer and the octets that it was fed."""

    def __init__(self) -> None:
        self.feed = LengthDeframer().feed

    def again(self, message: bytes) -> bytes:
        return len(message).to_bytes(2, "little") + message


class SerialMessages:
    """A Deframer and the octets that it was fed."""

    def __init__(self, sender: int) -> None:
        self.deframer = Deframer(1 - sender)
        self.sender = sender

    def feed(self, chunk: bytes) -> list[bytes]:
        messages = self.deframer.feed(chunk)
        assert not messages or self.deframer.source == self.sender
        assert not self.deframer.skipped and not self.deframer.foreign
        return messages

    def again(self, message: bytes) -> bytes:
        return framed(message, self.sender, 1 - self.sender)


def conversation(file: Path) -> list[tuple[str, int, bytes]]:
    """Yield (sender, client, message) for each message; check the framing."""
    lines = [json.loads(line) for line in file.read_text().splitlines()]
    if not file.stem.startswith(("serial_", "tcp_")):
        return [(line["from"], line["client"], bytes.fromhex(line["hex"])) for line in lines]
    out = []
    for sender in ("client", "agent"):
        ours: TcpMessages | SerialMessages
        if file.stem.startswith("tcp_"):
            ours = TcpMessages()
        else:
            ours = SerialMessages(1 if sender == "client" else 0)
        raw = again = b""
        for line in lines:
            if line["from"] == sender:
                chunk = bytes.fromhex(line["hex"])
                raw += chunk
                for message in ours.feed(chunk):
                    again += ours.again(message)
                    out.append((sender, line["client"], message))
        assert again == raw
    return out


def test_all_captures_are_here() -> None:
    assert len(FILES) == 17
    assert sum(len(conversation(file)) for file in FILES) == 801


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_every_message_is_decoded_and_encoded_again(file: Path) -> None:
    for _, _, message in conversation(file):
        check(message)


def test_captures_contain_every_kind_of_submessage() -> None:
    kinds = Counter()
    for file in FILES:
        for sender, _, message in conversation(file):
            kinds.update((sender, kind) for kind, _, _ in check(message)[1])
    assert kinds.keys() == {
        ("client", ids.CREATE_CLIENT),
        ("agent", ids.STATUS_AGENT),
        ("client", ids.CREATE),
        ("client", ids.DELETE),
        ("agent", ids.STATUS),
        ("client", ids.GET_INFO),
        ("agent", ids.INFO),
        ("client", ids.WRITE_DATA),
        ("client", ids.READ_DATA),
        ("agent", ids.DATA),
        ("client", ids.ACKNACK),
        ("agent", ids.ACKNACK),
        ("client", ids.HEARTBEAT),
        ("agent", ids.HEARTBEAT),
        ("client", ids.FRAGMENT),
        ("client", ids.TIMESTAMP),
        ("agent", ids.TIMESTAMP_REPLY),
    }


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_streams_deliver_what_the_real_peers_acknowledged(file: Path) -> None:
    """Each recorded stream is fed into ours: messages are new or repeated, and the ends agree."""
    streams: dict[tuple[str, int, int], ReliableIn] = {}
    best_effort: dict[tuple[str, int, int], BestEffortIn] = {}
    acknowledged: dict[tuple[str, int, int], int] = {}
    for sender, client, message in conversation(file):
        (_, stream_id, sequence, _), submessages = check(message)
        key = (sender, client, stream_id)
        if stream_id >= ids.STREAM_RELIABLE:
            stream = streams.setdefault(key, ReliableIn())
            assert stream.receive(sequence, message) or sequence != stream.next
            assert stream.pop() is None  # nothing was reordered on the way
        elif stream_id:
            assert best_effort.setdefault(key, BestEffortIn()).accept(sequence, 0)
        for kind, _, values in submessages:
            receiver = ("agent" if sender == "client" else "client", client)
            if kind == ids.ACKNACK:
                first, missing, acked_stream = values
                acknowledged[(*receiver, acked_stream)] = first
                assert missing == 0
            elif kind == ids.HEARTBEAT and (sender, client, values[2]) in streams:
                assert not streams[(sender, client, values[2])].heartbeat(*values[:2], 0)
    for key, first in acknowledged.items():
        assert streams[key].acknack()[1] == 0
        # The last message may have crossed the last acknowledgement.
        assert (streams[key].next - first) & 0xFFFF <= 1, key


def test_the_fragments_of_an_image() -> None:
    fragments = Fragments()
    parts: list[bytes] = []
    images = 0
    for sender, _, message in conversation(CAPTURES / "rclc_image.jsonl"):
        for kind, flags, values in check(message)[1]:
            if kind != ids.FRAGMENT:
                continue
            assert sender == "client"
            parts.append(values[0])
            whole = fragments.add(values[0], bool(flags & ids.FLAG_LAST_FRAGMENT))
            if whole is None:
                continue
            inner, inner_flags, start, stop = pull_subheader(whole, 0, len(whole))
            assert inner == ids.WRITE_DATA and stop == len(whole)
            _, object_id, sample = decode(inner, inner_flags, bytes(whole[start:stop]))
            assert object_id == 0x05
            # header.stamp, frame_id, format, then the image to the end
            assert b"jpeg\x00" in sample[:40]
            assert len(sample) > 15_000
            # Our fragments would be cut at the same places.
            cuts = split(len(whole), len(parts[0]))
            assert [bytes(whole[a:b]) for a, b, _ in cuts] == parts
            assert [flags for _, _, flags in cuts] == [1] * (len(parts) - 1) + [3]
            parts.clear()
            images += 1
    assert images == 3 and not parts
