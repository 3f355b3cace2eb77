"""Reading captures: text, pcapng of ours and of others, and files that are neither."""

import json
import shutil
import subprocess

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.replay import CAPTURES
from support.replay import load as load_recorded
from support.replay import messages as recorded_messages
from unit.agent.helpers import create_client, get_info, message

from uros.agent.observability.jsonl import JsonLinesEncoder
from uros.agent.observability.message_hooks import AGENT, CLIENT, MessageEvent
from uros.agent.observability.pcapng import PcapngEncoder
from uros.agent.transports.udp import UdpServer
from uros.tools.capture.pcapng import PcapngParser
from uros.tools.capture.recordings import MAX_LINE, TextParser, parser_for, read
from uros.tools.capture.records import Record, RecordingError

PING = message([get_info()], 0, 0)
NAMES = sorted(path.stem for path in CAPTURES.glob("*.jsonl"))
UDP = UdpServer(8888, "192.0.2.1")


def event(data=PING, direction=CLIENT, port=2018, now=1_763_750_000_123_456, key=0x4B0CBE99):
    return MessageEvent(UDP, ("192.0.2.7", port), direction, data, now, key)


def captured(form, count=3):
    made = form()
    return b"".join(
        made.encode(event(PING + bytes(i), (CLIENT, AGENT)[i % 2], 2018 + i), 5 * (i == 1))
        for i in range(count)
    )


@pytest.mark.parametrize("form", [JsonLinesEncoder, PcapngEncoder])
def test_captures_of_the_agent_are_read(form):
    head = captured(form)
    assert parser_for(head, "it").feed(head) == [
        Record(
            1_763_750_000.123456, i != 1, i, "UDPv4Agent", f"192.0.2.7:{2018 + i}", 0x4B0CBE99,
            PING + bytes(i), 5 * (i == 1),
        )
        for i in range(3)
    ]  # fmt: skip


@pytest.mark.parametrize("form", [JsonLinesEncoder, PcapngEncoder])
@given(st.data())
def test_pieces_of_any_size_give_the_same_records(form, data):
    whole = captured(form)
    parser = parser_for(whole, "it")
    found, at = [], 0
    while at < len(whole):
        size = data.draw(st.integers(1, len(whole)))
        found += parser.feed(whole[at : at + size])
        at += size
    assert found == parser_for(whole, "it").feed(whole)
    assert parser.rest() == 0


@pytest.mark.parametrize("name", NAMES)
def test_recordings_of_other_agents_are_taken_out_of_their_frames(name):
    records = list(read(CAPTURES / f"{name}.jsonl"))
    for from_client in (True, False):
        expected = list(recorded_messages(name, load_recorded(name), from_client))
        assert [
            (record.client, record.message)
            for record in records
            if record.from_client == from_client
        ] == (expected)
    kind = "SERIAL" if name.startswith("serial") else "TCP" if name.startswith("tcp") else "UDP"
    assert {record.transport for record in records} == {kind}


@pytest.mark.parametrize("form", [JsonLinesEncoder, PcapngEncoder])
def test_a_truncated_end_is_reported(form, tmp_path):
    path = tmp_path / "it"
    path.write_bytes(captured(form)[:-3])
    told = []
    assert len(list(read(path, told.append))) == 2
    (text,) = told
    assert "are not a whole message and are left out" in text


def test_a_new_section_has_its_own_interfaces():
    whole = captured(PcapngEncoder) + captured(PcapngEncoder)
    assert len(PcapngParser("it").feed(whole)) == 6


# --- of others ----------------------------------------------------------------------------------


def test_a_file_of_wireshark(tmp_path):
    """An Ethernet capture by text2pcap, with what else there is on a network."""
    assert shutil.which("text2pcap"), "there is no text2pcap: apt-get install tshark"
    hello = create_client()
    said = (
        ((hello, "10.0.0.7,10.0.0.1", "2018,9999"), (PING, "10.0.0.1,10.0.0.7", "9999,2018"))
        + ((b"else", "10.0.0.7,10.0.0.1", "2018,53"), (PING, "10.0.0.9,10.0.0.1", "77,8888"))
    )  # fmt: skip
    for number, (data, addresses, ports) in enumerate(said):
        text = tmp_path / f"{number}.txt"
        text.write_text("0000  " + data.hex(" ") + "\n")
        subprocess.run(
            ["text2pcap", "-q", "-n", "-4", addresses, "-u", ports, text, tmp_path / f"{number}.n"],
            check=True, capture_output=True,
        )  # fmt: skip
    whole = b"".join((tmp_path / f"{number}.n").read_bytes() for number in range(len(said)))
    found = parser_for(whole, "it").feed(whole)
    assert [
        (record.from_client, record.client, record.address, record.message) for record in found
    ] == [
        (True, 0, "10.0.0.7:2018", hello),
        (False, 0, "10.0.0.7:2018", PING),
        (True, 1, "10.0.0.9:77", PING),
    ]


# --- neither ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"\x7fELF....", "is not a capture: neither pcapng nor JSON lines"),
        (b"\xd4\xc3\xb2\xa1....", "older format pcap: convert it with 'editcap"),
        (b"{}\n", r"it:1 is not a line of a capture: it has no 't'"),
        (b'{"t": 1, "from": "client", "client": 0, "hex": ""}\n{"t"\n', "it:2 is not a line"),
        (b'{"t": 1, "from": "me", "client": 0, "hex": ""}\n', '"from" is neither client nor agent'),
        (b'{"t": 1, "from": "agent", "client": 0, "hex": "1"}\n', "non-hexadecimal|hex"),
        (b'{"t": NaN, "from": "agent", "client": 0, "hex": ""}\n', '"t" is nan'),
        (b"[" * 100_000 + b"\n", "neither"),
        (b'{"a":' + b"[" * 100_000 + b"\n", "it:1 is not a line of a capture: "),
        (b"{" + b" " * (MAX_LINE + 1), "it:1 is not a line of a capture: a line of over"),
        (b"\x0a\x0d\x0d\x0a" + b"\x1c\0\0\0" + b"\1\2\3\4", "a section without its magic number"),
        (captured(PcapngEncoder)[:200] + b"\0" * 64, "not a sound pcapng file"),
    ],
)
def test_errors_of_invalid_captures_name_the_place(content, says, tmp_path):
    path = tmp_path / "it"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=says):
        list(read(path))


def test_a_missing_file():
    with pytest.raises(RecordingError, match=r"not/there cannot be read: No such file"):
        list(read("not/there"))


def feed(parser, data):
    try:
        for record in parser.feed(data):
            assert isinstance(record.message, bytes) and 0 <= record.key <= 0xFFFFFFFF
    except RecordingError as error:
        assert "it" in str(error)


@given(st.binary(max_size=300))
def test_any_bytes_are_read_or_rejected(data):
    for parser in (TextParser("it"), PcapngParser("it")):
        feed(parser, data)
        feed(parser, data)


@given(st.data())
def test_captures_with_wrong_bytes_are_read_or_rejected(data):
    form = data.draw(st.sampled_from([JsonLinesEncoder, PcapngEncoder]))
    whole = bytearray(captured(form))
    for _ in range(data.draw(st.integers(1, 5))):
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    feed(TextParser("it") if form is JsonLinesEncoder else PcapngParser("it"), bytes(whole))


_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda values: (
        st.lists(values, max_size=3) | st.dictionaries(st.text(max_size=3), values, max_size=3)
    ),
    max_leaves=5,
)


@given(
    st.dictionaries(
        st.sampled_from(["t", "from", "client", "transport", "address", "key", "lost", "hex"]),
        _JSON | st.sampled_from(["client", "agent", "7e00", "0x10", 0, 1.5]),
    )
)
def test_lines_with_any_values_are_read_or_rejected(fields):
    feed(TextParser("it"), json.dumps(fields).encode() + b"\n")
