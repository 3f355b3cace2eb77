"""State files and boards of earlier versions go on with the agent of this one; and back."""

import gzip
import json
import struct
from pathlib import Path
from types import SimpleNamespace

import pytest
from support.paths import ROOT
from unit.agent.helpers import Desk, Place, parse

from uros.agent.persistence import journal
from uros.agent.persistence.journal import JournalError, open_journal
from uros.agent.persistence.records import ClientInfo
from uros.agent.persistence.session_store import SessionStore
from uros.middleware.memory import Bus, MemoryMiddleware
from uros.qos import QoSProfile
from uros.wire import ids

VERSIONS = sorted((ROOT / "tests" / "kept").glob("[0-9]*"))
TYPE = "std_msgs::msg::dds_::Int32_"


class UdpPlace(Place):
    """The transport of the recorded agent, without a socket."""

    name = "UDPv4Agent"

    def label(self):
        return "port 18888"

    def address(self, peer):
        return f"{peer[0]}:{peer[1]}"


class World:
    """An agent, and a node that receives what boards publish on /count."""

    def __init__(self, state=None):
        bus = Bus()
        self.far = MemoryMiddleware(bus)
        node = self.far.create_node(0, "/", "far")
        self.reader = node.create_reader("rt/count", TYPE, QoSProfile(depth=1000), lambda: None)
        self.desk = Desk(bus)
        self.desk.place = UdpPlace()
        self.store = None
        if state is not None:
            self.store = SessionStore(open_journal(str(state)), self.desk.agent.log)
            self.store.open(
                SimpleNamespace(
                    agent=self.desk.agent, transports=[self.desk.place], wake_at=self.desk.wake_at
                )
            )

    def replay(self, lines):
        """Let the boards say what they said; return what the agent sends."""
        sent = self.desk.settle()
        for line in lines:
            if line["from"] == "client":
                host, _, port = line["address"].rpartition(":")
                sent += self.desk.hear(bytes.fromhex(line["hex"]), (host, int(port)))
        return sent

    def counts(self):
        return [struct.unpack_from("<i", sample, 4)[0] for sample in self.reader.take(1000)]

    def close(self):
        self.desk.close()
        self.far.close()


@pytest.fixture
def world():
    worlds = []

    def make(*args):
        worlds.append(World(*args))
        return worlds[-1]

    yield make
    for each in worlds:
        each.close()


def recorded(version, name):
    return [json.loads(line) for line in (version / name).read_text().splitlines()]


def state_of(version, tmp_path):
    path = tmp_path / "state"
    path.write_bytes(gzip.decompress((version / "state.gz").read_bytes()))
    return path


def counts_of(lines):
    """The numbers that the boards of a recording publish, found without the agent."""
    found = []
    for line in lines:
        if line["from"] == "client":
            for kind, _, payload in parse(bytes.fromhex(line["hex"]))[1]:
                if kind == ids.WRITE_DATA and len(payload) == 8 and payload[2:4] == WRITER:
                    found.append(struct.unpack_from("<i", payload, 4)[0])
    return list(dict.fromkeys(found))


# The object id of the datawriter of /count in the recordings.
WRITER = b"\x00\x05"


def test_there_are_recordings():
    assert [version.name for version in VERSIONS] == ["0.1.0"]


@pytest.mark.parametrize("version", VERSIONS, ids=lambda version: version.name)
def test_sessions_of_a_kept_file_go_on_and_the_boards_notice_nothing(version, tmp_path, world):
    lines = recorded(version, "after.jsonl")
    one = world(state_of(version, tmp_path))
    assert one.desk.log().count("session restored") == 2
    sent = one.replay(lines)
    wanted = counts_of(lines)
    assert len(wanted) > 20 and one.counts() == wanted
    assert "warning" not in one.desk.log() and "error" not in one.desk.log()
    # The other board got the samples and the first one a request; nobody was told to start anew.
    kinds = {(peer[1], kind) for peer, message in sent for kind, _, _ in parse(message)[1]}
    assert {kind for _, kind in kinds} >= {ids.DATA, ids.ACKNACK}
    assert len({port for port, kind in kinds if kind == ids.DATA}) == 2
    assert not [kind for _, kind in kinds if kind == ids.STATUS_AGENT]


@pytest.mark.parametrize("version", VERSIONS, ids=lambda version: version.name)
def test_boards_of_an_earlier_version_start_a_session(version, world):
    lines = recorded(version, "before.jsonl")
    one = world()
    sent = one.replay(lines)

    def statuses(messages):
        return {
            (peer, bytes(payload))
            for peer, message in messages
            for kind, _, payload in parse(message)[1]
            if kind in (ids.STATUS, ids.STATUS_AGENT)
        }

    answers = []
    for line in lines:
        if line["from"] == "agent":
            host, _, port = line["address"].rpartition(":")
            answers.append(((host, int(port)), bytes.fromhex(line["hex"])))
    assert statuses(sent) == statuses(answers) and len(statuses(sent)) > 10
    assert one.counts() == counts_of(lines)


# --- back, and forth ---------------------------------------------------------------------------


@pytest.mark.parametrize("version", VERSIONS[-1:], ids=lambda version: version.name)
def test_what_this_version_writes_is_what_that_one_reads(version, tmp_path, world):
    """An older agent refuses records and fields that it does not know: they need a new number."""
    path = state_of(version, tmp_path)
    kept = open_journal(str(path))
    before = kept.read()
    kept.close(False)
    one = world(path)
    one.replay(recorded(version, "after.jsonl"))
    one.store.close()
    now = open_journal(str(path))
    after = now.read()
    now.close(False)

    def letters(content):
        return {payload[:1] for _, _, payload in content.records}

    def fields(content):
        return [
            set(json.loads(payload[1:])) for _, _, payload in content.records if payload[:1] == b"C"
        ]

    assert len(after.slots) == len(before.slots) == 2 and after.trusted
    assert letters(after) <= set(b"CODREMLBNTFZ"[i : i + 1] for i in range(12))
    assert all(each == fields(before)[0] for each in fields(after)) and fields(after)
    heads = [content.split(b"\n")[:2] for content in (path.read_bytes(), original(version))]
    assert heads[0][0] == heads[1][0] == b"uros state 1"
    assert set(json.loads(heads[0][1])) == set(json.loads(heads[1][1])) == {"boot", "clean"}
    assert set(ClientInfo.__dataclass_fields__) == fields(before)[0]


def original(version):
    return gzip.decompress((version / "state.gz").read_bytes())


@pytest.mark.parametrize(
    ("number", "said"),
    [
        (b"2", "a newer uros wrote it (format 2, this one has 1)"),
        (b"10", "a newer uros wrote it (format 10, this one has 1)"),
        (b"0", "it is of another version of uros ('0')"),
        (b"x", "it is of another version of uros ('x')"),
    ],
)
def test_a_file_of_an_unknown_version_is_refused_by_name_and_nothing_is_lost(
    number, said, tmp_path
):
    path = state_of(VERSIONS[-1], tmp_path)
    content = path.read_bytes().replace(b"uros state 1\n", b"uros state " + number + b"\n", 1)
    path.write_bytes(content)
    with pytest.raises(JournalError) as refused:
        open_journal(str(path))
    assert str(refused.value).startswith(f"--state {path}: ") and said in str(refused.value)
    assert path.read_bytes() == content
    assert sorted(Path(tmp_path).iterdir()) == [path]


def test_the_number_of_the_format_is_the_one_of_the_newest_recording():
    head = original(VERSIONS[-1]).split(b"\n")[0]
    assert head == journal._MAGIC + journal._VERSION
