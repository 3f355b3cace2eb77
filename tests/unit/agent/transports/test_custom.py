"""Custom transports: users' code that blocks, fails or returns wrong types; the docs' examples."""

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
    """read() returns ``items`` in order; exceptions are raised and functions are called."""

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
            item = self.items.get(timeout=timeout)
        except queue.Empty:
            return None
        if callable(item) and not isinstance(item, type):
            item = item()
        if isinstance(item, BaseException):
            raise item
        return item

    def write(self, data, peer):
        assert type(data) is bytes
        self.written.put((data, peer))


@contextmanager
def agent_with(line):
    """Run an agent on a custom line and on UDP; clients on UDP must not be affected."""
    running = RunningAgent("udp", "memory", 0, 4)
    running.custom = CustomServer(line)
    running.server.transports.append(running.custom)
    with serving(running):
        yield running


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(module, "RETRY", 0.01)


def answered(line, data=PING, peer=None):
    """Test that the agent answers a message of this line to its source."""
    while not line.written.empty():
        line.written.get()
    line.items.put(data if peer is None else (data, peer))
    answer, where = line.written.get(timeout=SECONDS)
    assert answer[4] == ids.INFO and where == peer


class Mute(BaseException):
    """An exception whose text and truth value cannot be computed."""

    def __str__(self):
        raise SystemExit

    __repr__ = __bool__ = __str__


class Odd:
    def __hash__(self):
        return 1

    def __eq__(self, other_object):
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
    ("wrong", "message"),
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
def test_a_wrong_return_value_of_read_closes_and_reopens_the_line(wrong, message):
    line = Scripted()
    with agent_with(line) as agent:
        bystanders = Bystanders(agent)
        line.items.put(wrong)
        wait_for(agent.said.getvalue, "the transport failed")
        answered(line)
        bystanders.check()
        assert re.search(message, agent.said.getvalue()), agent.said.getvalue()
        assert "it is opened again in 0.01 s" in agent.said.getvalue()
    assert line.calls == ["open", "close"] * 2


def test_invalid_messages_are_dropped(monkeypatch):
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


def test_a_line_that_does_not_open_is_retried_with_growing_pauses(monkeypatch):
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
        bystanders = Bystanders(agent)
        wait_for(agent.said.getvalue, "opened again in 8 s", 2)
        bystanders.check()
        del line.open
        answered(line)
        line.items.put(OSError("again"))
        wait_for(agent.said.getvalue, "OSError: again")
        answered(line)
        assert "ConnectionError: no modem" in agent.said.getvalue()
    waits = [pause for pause in pauses if pause >= 0.01]
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


def test_a_write_that_blocks_delays_no_other_client_and_its_queue_is_bounded(monkeypatch):
    monkeypatch.setattr(worker, "MAX_UNSENT", 2000)
    line, go, inside = Scripted(), threading.Event(), threading.Event()
    write = line.write

    def wait(data, peer):
        inside.set()
        assert go.wait(SECONDS)
        write(data, peer)

    line.write = wait
    with agent_with(line) as agent:
        bystanders = Bystanders(agent)
        line.items.put(PING)
        assert inside.wait(SECONDS)
        for _ in range(100):
            line.items.put(PING)
        line.items.put(
            bytes(1 << 16)
        )  # too long; when it is logged, all messages before it are handled
        wait_for(agent.said.getvalue, "message refused")
        assert "message dropped" in agent.said.getvalue()
        bystanders.check()
        assert "write() is too slow" in agent.said.getvalue()
        go.set()
        answered(line)
        dropped = agent.custom.dropped
        assert 50 < dropped < 100
        bystanders.check()


def test_a_write_that_blocks_for_ever_is_ended_by_close(monkeypatch):
    monkeypatch.setattr(worker, "LEAVE", 0.1)
    line, closed, inside = Scripted(), threading.Event(), threading.Event()

    def wait(data, peer):
        inside.set()
        assert closed.wait(SECONDS)
        raise OSError("closed")

    line.write = wait
    line.close = lambda: (line.calls.append("close"), closed.set())
    with agent_with(line) as agent:
        line.items.put(PING)
        assert inside.wait(SECONDS)
        line.items.put(OSError("the modem is off"))
        wait_for(agent.said.getvalue, "the modem is off")
        del line.write
        answered(line)
        assert line.calls == ["open", "close", "open"]


def test_a_write_that_close_does_not_end_is_logged_and_never_started_twice(monkeypatch):
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


def test_a_read_that_exceeds_its_timeout_does_not_block_the_agent(monkeypatch):
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


def test_a_read_that_returns_nothing_at_once_does_not_spin():
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
        bystanders = Bystanders(agent)
        line.read = read
        line.items.put((PING, 0))  # ends a call of the replaced read
        eventually(lambda: reads[0] > 0)
        for _ in range(20):
            bystanders.check()
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
        first, second = framed(PING, 1), framed(PING, 2)
        line.items.put(first + second)  # each frame has its own source, in one piece
        assert [line.written.get(timeout=SECONDS)[0][2] for _ in range(2)] == [1, 2]
        assert "Scripted" in agent.said.getvalue()


def test_a_long_piece_of_a_stream():
    line = ScriptedStream()
    with agent_with(line) as agent:
        line.items.put(b"\x7e" * 1_000_000 + framed(PING))
        Bystanders(agent).check()
        assert line.written.get(timeout=SECONDS)[0].startswith(b"\x7e\0\1")


def test_a_stream_is_handled_in_small_pieces_of_any_read():
    stream_bytes = bytes(range(256)) * 50
    line = Scripted()
    line.read = lambda _: (stream_bytes, 7)
    pieces = module._Checked(line, True)
    out = b""
    while len(out) < len(stream_bytes):
        data, peer = pieces.read(0.1)
        assert len(data) <= 4096 and peer == 7
        out += data
    assert out == stream_bytes


def test_the_number_of_peers_is_limited(monkeypatch):
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
        client = XrceClient(agent.line(), 7)
        assert client.open() == ids.STATUS_OK
        agent._custom.socket.close()  # while the line is in use
        wait_for(agent.said.getvalue, "the transport failed")
        wait_for(agent.said.getvalue, "running...", 2)
        assert client.ping() == 1 and len(agent.agent.clients) == 1


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
    ("spec", "text", "message"),
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
def test_errors_in_a_name_are_explained(folder, spec, text, message):
    (folder / "broken.py").write_text(text)
    with pytest.raises(TransportError) as caught:
        load(spec, ["a"])
    assert re.search(message, caught.value.strerror), caught.value.strerror


@pytest.mark.parametrize("missing", ["open", "close", "read", "write"])
def test_a_class_without_a_required_method(missing):
    calls = {
        name: lambda *_: None for name in ("open", "close", "read", "write") if name != missing
    }
    with pytest.raises(TransportError, match=rf"Modem has no {missing}\(\): a transport has"):
        CustomServer(type("Modem", (), calls)())


@pytest.mark.parametrize("name", ["framed", "read"])
def test_a_class_whose_attributes_fail(name):
    def fail(self):
        raise ValueError("not yet")

    line = type("Modem", (CustomTransport,), {name: property(fail)})()
    with pytest.raises(TransportError, match=r"Modem raised ValueError: not yet \(test_custom"):
        CustomServer(line)


def test_the_base_class_names_the_missing_method():
    with agent_with(CustomTransport()) as agent:
        wait_for(agent.said.getvalue, "NotImplementedError")


# --- the docs ---------------------------------------------------------------------------------


def examples():
    """Return the files of the page by their names."""
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
                lines = [board.stdout.readline() for _ in range(3)]
                assert all(re.fullmatch(r"heard \d+\n", line) for line in lines), (
                    agent.said.getvalue()
                )
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
