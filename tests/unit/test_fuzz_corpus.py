"""Each input of the fuzzers' corpus runs through its harness, in plain Python, without a finding.

The fuzzers themselves are ``make fuzz``; here only their harnesses run. Faults planted by
monkeypatch show that the harnesses detect them.
"""

import importlib
import subprocess
import sys
from pathlib import Path
from random import Random

import pytest
from support.examples import examples

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "fuzz"))

from targets import TARGETS, records, world  # noqa: E402

CORPUS = ROOT / "fuzz" / "corpus"
MAX_CORPUS = 300_000


def target(name):
    return importlib.import_module(f"targets.{name}")


@pytest.mark.parametrize("name", TARGETS)
def test_the_corpus_has_no_findings(name: str) -> None:
    files = sorted((CORPUS / name).iterdir())
    assert files
    for file in files:
        try:
            target(name).one_input(file.read_bytes())
        except BaseException as error:
            raise AssertionError(f"fuzz/run.py {name} --replay {file}") from error


@pytest.mark.parametrize("name", TARGETS)
def test_valid_inputs_have_no_findings(name: str) -> None:
    for _, data in target(name).seeds():
        target(name).one_input(data)


@pytest.mark.parametrize("name", TARGETS)
def test_mutated_inputs_have_no_findings(name: str) -> None:
    """Some inputs, the same in each run: they test the harness, not uros."""
    chance = Random(name)
    seeds = [data for _, data in target(name).seeds()]

    def mutate_bytes(part: bytes) -> bytes:
        edited = bytearray(part or b"\0")
        edited[chance.randrange(len(edited))] = chance.randrange(256)
        return bytes(edited)

    for _ in range(examples(60)):
        data = chance.choice(seeds)
        for _ in range(3):
            data = target(name).mutate(data, chance, mutate_bytes)
        target(name).one_input(data)


def test_the_corpus_is_small() -> None:
    sizes = [file.stat().st_size for file in CORPUS.rglob("*") if file.is_file()]
    assert sum(sizes) < MAX_CORPUS


def test_every_target_has_a_corpus_and_every_corpus_a_target() -> None:
    assert {folder.name for folder in CORPUS.iterdir()} == set(TARGETS)


def test_records_are_unpacked_as_packed() -> None:
    some = [(0, b""), (255, b"abc"), (7, bytes(65535))]
    assert list(records.unpack(records.pack(some))) == some
    assert list(records.unpack(b"\1\xff\xff" + b"cut")) == [(1, b"cut")]
    assert not list(records.unpack(b"\1\2"))


# --- planted faults are found -----------------------------------------------------------------


def seed_of(name: str, seed: str) -> bytes:
    return dict(target(name).seeds())[seed]


def test_an_exception_is_a_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    from uros.agent.session.session import Session

    def broken(*_):
        raise ZeroDivisionError

    monkeypatch.setattr(Session, "_acknack", broken)
    with pytest.raises(ZeroDivisionError):
        target("datagrams").one_input(seed_of("datagrams", "subscribe_reliable"))


def test_a_limit_that_does_not_hold_is_a_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    from uros.wire.streams import ReliableIn

    create = ReliableIn.__init__
    monkeypatch.setattr(ReliableIn, "__init__", lambda self, depth=16: create(self, 1000))
    bare = target("datagrams")
    gaps = [(bare.RELIABLE << 2, b"")]
    gaps += [(0, b"\x81\x80" + n.to_bytes(2, "little") + b"\x0b\1\0\0") for n in range(2, 40)]
    with pytest.raises(world.Finding, match="early messages"):
        bare.one_input(b"\0" + records.pack(gaps))


def test_another_client_that_is_harmed_is_a_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    from uros.agent.agent import Agent

    def gone(self, transport, peer):
        for key in list(self.clients):
            self.delete_client(key)

    monkeypatch.setattr(Agent, "gone", gone)
    with pytest.raises(world.Finding):
        target("datagrams").one_input(seed_of("datagrams", "again"))


def test_an_internal_error_in_the_log_is_a_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    from uros.agent.objects.factory import ObjectFactory

    def broken(*_):
        raise ZeroDivisionError

    monkeypatch.setattr(ObjectFactory, "_create_endpoint", broken)
    with pytest.raises(world.Finding, match="internal error"):
        target("datagrams").one_input(seed_of("datagrams", "publisher"))


def test_lost_frames_are_a_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    from uros.wire.framing import Deframer

    feed = Deframer.feed
    noise = []

    def deaf(self, data):
        """Drop all data after noise."""
        noise.extend([data] if b"ESP" in data else [])
        return feed(self, b"" if noise else data)

    monkeypatch.setattr(Deframer, "feed", deaf)
    with pytest.raises(world.Finding):
        target("serial").one_input(seed_of("serial", "publish_reliable"))


def test_chunks_that_matter_are_a_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    from uros.wire.framing import LengthDeframer

    feed = LengthDeframer.feed

    def forgetful(self, data):
        out = feed(self, data)
        if len(data) == 7:
            self._buf = bytearray()
        return out

    monkeypatch.setattr(LengthDeframer, "feed", forgetful)
    with pytest.raises(world.Finding):
        target("tcp").one_input(seed_of("tcp", "publish_reliable"))


def test_a_wrong_can_frame_is_a_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    from uros.agent.transports import can

    monkeypatch.setattr(can, "can_frame", lambda message: bytearray(message).ljust(64, b"\0"))
    with pytest.raises(world.Finding):
        target("can").one_input(seed_of("can", "talk"))


def test_xml_that_raises_anything_else_is_a_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    from uros.agent.objects import xml_profiles

    monkeypatch.setattr(xml_profiles, "_number", lambda text, what: int(text))
    broken = seed_of("xml", "writer").replace(b"<depth>5", b"<depth>x")
    with pytest.raises(ValueError, match="invalid literal"):
        target("xml").one_input(broken)


def test_an_invalid_rule_is_a_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    from uros.agent.policy import rules

    monkeypatch.setattr(rules, "_namespace", lambda value: value)
    with pytest.raises(world.Finding):
        target("toml").one_input(b'[[client]]\nnamespace = "hall"')


def test_an_error_in_restoring_is_a_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    from uros.agent.persistence.session_store import SessionStore

    def restored(self, kept):
        raise ZeroDivisionError

    monkeypatch.setattr(SessionStore, "_restore", restored)
    with pytest.raises(ZeroDivisionError):
        target("state").one_input(seed_of("state", "one"))


def test_a_description_that_harms_terminals_is_a_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(target("recording"), "format_message", lambda message: "\033[2J")
    with pytest.raises(world.Finding):
        target("recording").one_input(seed_of("recording", "ping"))


def test_a_modem_that_is_not_woken_is_a_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    from uros.transport.esp8266 import Esp8266Transport

    def wake(self):
        """The modem may wait for the rest of a datagram, which is never sent."""
        if not (yield from self._ask("AT", 300)):
            raise OSError(19, "the modem does not answer")

    monkeypatch.setattr(Esp8266Transport, "_wake", wake)
    with pytest.raises(world.Finding, match="does not heal"):
        target("modems").one_input(seed_of("modems", "esp_talks"))


@pytest.mark.parametrize("seed", ["esp_floods", "gs_floods"])
def test_answers_without_end_are_a_finding(monkeypatch: pytest.MonkeyPatch, seed: str) -> None:
    from uros.transport.at_modem import ModemTransport

    monkeypatch.setattr(ModemTransport, "_ended", lambda self, line: self._answers.append(line))
    with pytest.raises(world.Finding, match="answers are kept"):
        target("modems").one_input(seed_of("modems", seed))


def test_parsers_that_differ_are_a_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    from uros.interfaces import dynamic

    monkeypatch.setattr(dynamic, "_LOWER", "a0")  # no underscores
    with pytest.raises(world.Finding, match="hosts take it"):
        target("definitions").one_input(b"\0int8 ab_c")


def test_a_message_that_does_not_come_through_is_a_finding(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from uros.interfaces.table import Table

    monkeypatch.setattr(Table, "unpack_into", lambda self, buf, o, start, end, little=True: end)
    with pytest.raises(world.Finding):
        target("definitions").one_input(seed_of("definitions", "all"))


def test_a_board_that_trusts_its_agent_is_a_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    from uros.client.session import Session

    monkeypatch.setattr("uros.client.session._LEAST", bytes(16))
    with pytest.raises(IndexError):
        target("board_session").one_input(b"\0" + records.pack([(2 | 0x20, b"\x05\1\0\0")]))
    monkeypatch.undo()
    monkeypatch.setattr(Session, "renew", lambda self: None)
    with pytest.raises(world.Finding):
        target("board_session").one_input(seed_of("board_session", "program_0"))


# --- the command ---------------------------------------------------------------------------


def test_replay_needs_no_fuzzer(tmp_path: Path) -> None:
    file = tmp_path / "input"
    file.write_bytes(seed_of("toml", "all"))
    command = [sys.executable, str(ROOT / "fuzz" / "run.py"), "toml", "--replay", str(file)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=50)
    assert done.returncode == 0, done.stderr
    assert "nothing found" in done.stdout
