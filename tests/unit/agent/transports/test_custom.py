"""Custom transports at the agent's end: users' code that waits, fails and lies; the docs' own."""

import os
import queue
import re
import subprocess
import sys
import threading
import time
from contextlib import contextmanager

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.agent import RunningAgent, running_agent, serving
from support.client import XrceClient
from support.custom import Stream
from support.lines import SECONDS
from support.paths import ROOT
from support.waiting import eventually
from unit.agent.helpers import get_info, message
from unit.agent.transports.faults import Bystanders, wait_for

from uros.agent.transports import custom as module
from uros.agent.transports import worker
from uros.agent.transports.base import TransportError
from uros.agent.transports.custom import CustomServer, CustomTransport, load
from uros.wire import ids
from uros.wire.framing import frame, frame_size

PING = message([get_info()], 0, 0, 0x80)


def framed(payload, source=1, destination=0):
    out = bytearray(frame_size(payload))
    return bytes(out[: frame(payload, source, destination, out)])


class Scripted(CustomTransport):
    """``items`` are what read gives: what is an exception is raised, what can be called is."""

    def __init__(self):
        self.items = queue.Queue()
        self.written = queue.Queue()
        self.calls = []
        self.changed = threading.Event()

    def open(self):
        self.calls.append("open")

    def close(self):
        self.calls.append("close")

    def read(self, timeout):
        assert timeout == worker.POLL
        try:
            it = self.items.get(timeout=timeout)
        except queue.Empty:
            return None
        if callable(it) and not isinstance(it, type):
            it = it()
        if isinstance(it, BaseException):
            raise it
        return it

    def write(self, data, peer):
        assert type(data) is bytes
        self.written.put((data, peer))


@contextmanager
def agent_with(line):
    """An agent on a custom line and on UDP, where others notice nothing."""
    running = RunningAgent("udp", "memory", 0, 4)
    running.custom = CustomServer(line)
    running.server.transports.append(running.custom)
    with serving(running):
        yield running


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(module, "RETRY", 0.01)


def answered(line, data=PING, peer=None):
    """The agent still takes messages from this line, and answers to where they came from."""
    while not line.written.empty():
        line.written.get()
    line.items.put(data if peer is None else (data, peer))
    answer, where = line.written.get(timeout=SECONDS)
    assert answer[4] == ids.INFO and where == peer


class Mute(BaseException):
    """Whoever asks what it is, or whether it is, has trouble."""

    def __str__(self):
        raise SystemExit

    __repr__ = __bool__ = __str__


class Odd:
    def __hash__(self):
        return 1

    def __eq__(self, other):
        raise ValueError("equal?")


# --- what read gives --------------------------------------------------------------------------


def test_one_board_and_boards_with_names():
    line = Scripted()
    with agent_with(line) as agent:
        answered(line)
        answered(line, bytearray(PING), "a")
        answered(line, memoryview(PING), ("b", 7))
        line.items.put((b"", "a"))
        line.items.put(b"")
        answered(line, PING, 0)
        assert "running..." in agent.said.getvalue()
    assert line.calls == ["open", "close"]


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ("text", "Scripted .*TypeError: read.. returned str, not bytes"),
        (3, "returned int"),
        ((PING,), "returned tuple"),
        ((PING, 1, 2), "returned tuple"),
        ((None, 1), "returned tuple"),
        ((PING, []), "unhashable"),
        (OSError(5, "off"), r"OSError: \[Errno 5\] off \(test_custom.py:"),
        (SystemExit(3), "SystemExit: 3"),
        (KeyboardInterrupt(), "KeyboardInterrupt"),
        (StopIteration(), "StopIteration"),
        (RecursionError("\n\x1b[2J"), r"RecursionError: \\n\\x1b\[2J"),
        pytest.param(lambda: Mute(), r"Mute \(test_custom.py:", id="mute"),
        pytest.param((PING, Odd()), r"ValueError: equal\? \(test_custom.py:", id="odd"),
    ],
    ids=str,
)
def test_what_is_wrong_with_it_closes_and_opens_the_line_again(wrong, said):
    line = Scripted()
    with agent_with(line) as agent:
        others = Bystanders(agent)
        line.items.put(wrong)
        wait_for(agent.said.getvalue, "the transport failed")
        answered(line)
        others.check()
        assert re.search(said, agent.said.getvalue()), agent.said.getvalue()
        assert "it is opened again in 0.01 s" in agent.said.getvalue()
    assert line.calls == ["open", "close"] * 2


def test_messages_that_are_none(monkeypatch):
    monkeypatch.setattr(module, "MAX_MESSAGE", 1000)
    line = Scripted()
    with agent_with(line) as agent:
        for _ in range(5):
            line.items.put(bytes(1001))
        answered(line)
        assert agent.custom.malformed == 5
        assert agent.said.getvalue().count("message refused") == 3
        assert "Then framed = True" in agent.said.getvalue()


@pytest.mark.parametrize("error", [ZeroDivisionError, SystemExit])
def test_a_peer_that_cannot_be_shown(error):
    class Peer:
        def __str__(self):
            raise error

    line, peer = Scripted(), Peer()
    with agent_with(line) as agent:
        line.items.put((bytes(70000), peer))
        answered(line, PING, peer)
        wait_for(agent.said.getvalue, "Scripted Peer, 70000 bytes")


# --- calls that wait or fail ------------------------------------------------------------------


def test_a_line_that_does_not_open_is_tried_less_and_less_often(monkeypatch):
    line, pauses = Scripted(), []

    def fail():
        line.calls.append("open")
        raise ConnectionError("no modem")

    line.open = fail
    with agent_with(line) as agent:
        wake_at = agent.server.wake_at

        def at_once(seconds, call):
            pauses.append(seconds)
            wake_at(0, call)

        monkeypatch.setattr(agent.server, "wake_at", at_once)
        others = Bystanders(agent)
        wait_for(agent.said.getvalue, "opened again in 8 s", 2)
        others.check()
        del line.open
        answered(line)
        line.items.put(OSError("again"))
        wait_for(agent.said.getvalue, "OSError: again")
        answered(line)
        assert "ConnectionError: no modem" in agent.said.getvalue()
    waits = [it for it in pauses if it >= 0.01]
    assert max(waits) == 8.0 and waits[-1] == 0.01


def test_a_close_that_fails():
    line = Scripted()

    def close():
        line.calls.append("close")
        raise OSError("it does not close")

    line.close = close
    with agent_with(line) as agent:
        line.items.put(OSError("the first"))
        wait_for(agent.said.getvalue, "OSError: the first")
        answered(line)


def test_a_write_that_fails():
    line = Scripted()
    write = line.write

    def fail(data, peer):
        line.write = write
        raise OSError("no carrier")

    line.write = fail
    with agent_with(line) as agent:
        line.items.put(PING)
        wait_for(agent.said.getvalue, "OSError: no carrier")
        answered(line)
        assert line.calls[:3] == ["open", "close", "open"]


def test_a_write_that_waits_holds_nobody_up_and_its_queue_has_an_end(monkeypatch):
    monkeypatch.setattr(worker, "MAX_UNSENT", 2000)
    line, go, inside = Scripted(), threading.Event(), threading.Event()
    write = line.write

    def wait(data, peer):
        inside.set()
        assert go.wait(SECONDS)
        write(data, peer)

    line.write = wait
    with agent_with(line) as agent:
        others = Bystanders(agent)
        line.items.put(PING)
        assert inside.wait(SECONDS)
        for _ in range(100):
            line.items.put(PING)
        line.items.put(bytes(1 << 16))  # too long; when that is said, all before it are handled
        wait_for(agent.said.getvalue, "message refused")
        assert "message dropped" in agent.said.getvalue()
        others.check()
        assert "write() is too slow" in agent.said.getvalue()
        go.set()
        answered(line)
        dropped = agent.custom.dropped
        assert 50 < dropped < 100
        others.check()


def test_a_write_that_waits_for_ever_is_ended_by_close(monkeypatch):
    monkeypatch.setattr(worker, "LEAVE", 0.1)
    line, gone, inside = Scripted(), threading.Event(), threading.Event()

    def wait(data, peer):
        inside.set()
        assert gone.wait(SECONDS)
        raise OSError("closed")

    line.write = wait
    line.close = lambda: (line.calls.append("close"), gone.set())
    with agent_with(line) as agent:
        line.items.put(PING)
        assert inside.wait(SECONDS)
        line.items.put(OSError("the modem is off"))
        wait_for(agent.said.getvalue, "the modem is off")
        del line.write
        answered(line)
        assert line.calls == ["open", "close", "open"]


def test_a_write_that_not_even_close_ends_is_told_about_and_never_doubled(monkeypatch):
    monkeypatch.setattr(worker, "LEAVE", 0.1)
    line, go, inside = Scripted(), threading.Event(), threading.Event()

    def wait(data, peer):
        inside.set()
        assert go.wait(SECONDS)

    line.write = wait
    with agent_with(line) as agent:
        line.items.put(PING)
        assert inside.wait(SECONDS)
        line.items.put(OSError("the modem is off"))
        opened = threading.Event()
        line.open = opened.set
        wait_for(agent.said.getvalue, "write() does not return")
        assert not opened.wait(0.1)
        del line.write
        go.set()
        answered(line)
        assert opened.is_set()


def test_a_read_that_does_not_keep_its_timeout_does_not_keep_the_agent(monkeypatch):
    monkeypatch.setattr(worker, "LEAVE", 0.1)
    line, go, inside = Scripted(), threading.Event(), threading.Event()

    def wait():
        inside.set()
        assert go.wait(SECONDS)

    with agent_with(line) as agent:
        line.items.put(wait)
        assert inside.wait(SECONDS)
        Bystanders(agent).check()
    assert "the transport does not end" in agent.said.getvalue()
    go.set()


def test_a_read_that_gives_nothing_at_once_does_not_take_a_processor():
    line, times = Scripted(), []

    def read(timeout):
        times.append(time.monotonic())
        return PING if len(times) == 50 else b""

    line.read = read
    with agent_with(line):
        assert line.written.get(timeout=SECONDS)
    assert times[49] - times[0] >= 0.04


def test_a_flood_waits_in_the_line_and_not_in_the_agent():
    line = Scripted()
    reads = [0]

    def read(timeout):
        reads[0] += 1
        return PING, reads[0] % 7

    with agent_with(line) as agent:
        others = Bystanders(agent)
        line.read = read
        line.items.put((PING, 0))  # ends a call of the read that was there
        eventually(lambda: reads[0] > 0)
        for _ in range(20):
            others.check()
        assert len(agent.custom._worker._come) <= worker.MAX_WAITING + 1
    assert reads[0] > 100


# --- frames -----------------------------------------------------------------------------------


class ScriptedStream(Scripted):
    framed = True


def test_frames_of_boards_and_lines():
    line = ScriptedStream()
    with agent_with(line) as agent:
        for source, peer in ((1, "a"), (2, "a"), (1, "b"), (0x7E, None)):
            data = b"Booting...\r\n" + framed(PING, source)
            line.items.put((data[:20], peer))
            line.items.put((data[20:], peer))
            answer, where = line.written.get(timeout=SECONDS)
            assert where == peer and framed(PING, 0, source)[:3] == answer[:3]
        one, two = framed(PING, 1), framed(PING, 2)
        line.items.put(one + two)  # each has its own source, in one piece
        assert [line.written.get(timeout=SECONDS)[0][2] for _ in range(2)] == [1, 2]
        assert "Scripted" in agent.said.getvalue()


def test_a_long_piece_of_a_stream():
    line = ScriptedStream()
    with agent_with(line) as agent:
        line.items.put(b"\x7e" * 3_000_000 + framed(PING))
        Bystanders(agent).check()
        assert line.written.get(timeout=SECONDS)[0].startswith(b"\x7e\0\1")


def test_a_stream_is_handled_in_small_pieces_whatever_read_gives():
    given = bytes(range(256)) * 50
    line = Scripted()
    line.read = lambda _: (given, 7)
    pieces = module._Checked(line, True)
    out = b""
    while len(out) < len(given):
        data, peer = pieces.read(0.1)
        assert len(data) <= 4096 and peer == 7
        out += data
    assert out == given


def test_peers_without_end(monkeypatch):
    monkeypatch.setattr(module, "MAX_PEERS", 4)
    line = ScriptedStream()
    with agent_with(line) as agent:
        for i in range(20):
            line.items.put((b"\x7e\1\0\xff\xff" + bytes(1000), i))
        line.items.put((framed(PING), 19))
        line.written.get(timeout=SECONDS)
        assert len(agent.custom._deframers) == 4


@given(st.lists(st.tuples(st.binary(max_size=40), st.sampled_from([None, 1, 2])), max_size=20))
def test_any_stream(chunks):
    class Host:
        now = staticmethod(lambda: 0)

        @staticmethod
        def unmatched(transport, peer, buf, view, length):
            assert len(buf) == length

    server = CustomServer(Stream())
    server._line.end()
    server._host = Host
    for chunk in chunks:
        server._received(chunk)
        assert b"".join(module._pieces(chunk[0])) == chunk[0]


def test_sessions_outlive_a_failure():
    with running_agent("custom", "memory") as agent:
        one = XrceClient(agent.line(), 7)
        assert one.open() == ids.STATUS_OK
        agent._custom.socket.close()  # under its feet
        wait_for(agent.said.getvalue, "the transport failed")
        wait_for(agent.said.getvalue, "running...", 2)
        assert one.ping() == 1 and len(agent.agent.clients) == 1


# --- naming one -------------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    before = set(sys.modules)
    yield tmp_path
    for name in set(sys.modules) - before:
        del sys.modules[name]


GOOD = """
class Line:
    def __init__(self, *arguments): self.arguments = arguments
    def open(self): pass
    def close(self): pass
    def read(self, timeout): pass
    def write(self, data, peer): pass
"""


def test_a_class_by_its_module_and_by_its_file(folder):
    (folder / "line_of_mine.py").write_text(GOOD)
    for spec in ("line_of_mine:Line", "line_of_mine.py:Line", f"{folder}/line_of_mine.py:Line"):
        assert load(spec, ["a", "1"]).arguments == ("a", "1")
    CustomServer(load("line_of_mine:Line"))


@pytest.mark.parametrize(
    ("spec", "text", "said"),
    [
        ("broken", "", "'broken' names no class: write MODULE:CLASS"),
        ("broken:", "", "names no class"),
        (":Line", "", "names no class"),
        ("broken:a b", "", "names no class"),
        ("nowhere:Line", "", "no module nowhere: give the file, as in ./nowhere.py:CLASS"),
        ("no.where:Line", "", "there is no module no.where"),
        ("nowhere.py:Line", "", "there is no file nowhere.py"),
        ("broken:Line", "import not_installed", "broken needs not_installed, which is not"),
        ("broken.py:Line", "import not_installed", "needs not_installed"),
        ("broken:Line", "x = = 1", "broken cannot be imported: SyntaxError"),
        ("broken:Line", "1/0", r"ZeroDivisionError: division by zero \(broken.py:1\)"),
        ("broken:Line", "raise SystemExit", "cannot be imported: SystemExit"),
        ("broken:Line", "raise BaseException(3)", "cannot be imported: BaseException: 3"),
        ("broken:Line", "", "broken has no class Line"),
        ("broken:Line", "Line = 3", "broken has no class Line"),
        ("broken:Line", "def Line(): pass", r"Line\('a'\) raised TypeError"),
        ("broken:Line", "def Line(a): raise OSError(a)", r"raised OSError: a \(broken.py:1\)"),
        ("broken:Line", "def Line(a): raise SystemExit", r"Line\('a'\) raised SystemExit"),
        ("broken:Line", "def Line(a): raise BaseException", r"Line\('a'\) raised BaseException"),
    ],
)
def test_what_is_wrong_with_a_name(folder, spec, text, said):
    (folder / "broken.py").write_text(text)
    with pytest.raises(TransportError) as caught:
        load(spec, ["a"])
    assert re.search(said, caught.value.strerror), caught.value.strerror


@pytest.mark.parametrize("missing", ["open", "close", "read", "write"])
def test_a_class_without_one_of_the_calls(missing):
    calls = {it: lambda *_: None for it in ("open", "close", "read", "write") if it != missing}
    with pytest.raises(TransportError, match=rf"Modem has no {missing}\(\): a transport has"):
        CustomServer(type("Modem", (), calls)())


@pytest.mark.parametrize("name", ["framed", "read"])
def test_a_class_that_fails_when_it_is_looked_at(name):
    def fail(self):
        raise ValueError("not yet")

    line = type("Modem", (CustomTransport,), {name: property(fail)})()
    with pytest.raises(TransportError, match=r"Modem raised ValueError: not yet \(test_custom"):
        CustomServer(line)


def test_the_base_class_says_what_is_missing():
    with agent_with(CustomTransport()) as agent:
        wait_for(agent.said.getvalue, "NotImplementedError")


# --- the docs ---------------------------------------------------------------------------------


def examples():
    """The files of the page, by their names."""
    text = (ROOT / "docs" / "custom_transport.md").read_text("utf-8")
    blocks = re.findall(r"```python\n# (\w+\.py)\n(.*?)```", text, re.S)
    return dict(blocks)


def test_the_example_of_the_docs_works(folder):
    for name, text in examples().items():
        (folder / name).write_text(text)
    mailbox = CustomServer(load("mailbox.py:Mailbox", [str(folder / "agent.sock")]))
    with running_agent(mailbox, "memory") as agent:
        for number in (1, 2):
            board = subprocess.Popen(
                [sys.executable, "board.py", f"board{number}.sock", str(folder / "agent.sock")],
                stdout=subprocess.PIPE, text=True, cwd=folder,
                env=os.environ | {"PYTHONPATH": str(ROOT / "src")},
            )  # fmt: skip
            try:
                heard = [board.stdout.readline() for _ in range(3)]
                assert all(re.fullmatch(r"heard \d+\n", it) for it in heard), agent.said.getvalue()
            finally:
                board.kill()
                board.communicate()


def test_the_pipes_of_the_docs_work(folder):
    (folder / "pipes.py").write_text(examples()["pipes.py"])
    paths = [str(folder / name) for name in ("to_agent", "to_board")]
    for path in paths:
        os.mkfifo(path)
    out, back = (os.open(path, os.O_RDWR) for path in paths)
    with running_agent(CustomServer(load("pipes:Pipes", paths)), "memory"):
        os.write(out, framed(PING))
        data = b""
        while len(data) < 20:
            data += os.read(back, 100)
        assert data.startswith(b"\x7e\0\1")
    os.close(out)
    os.close(back)
