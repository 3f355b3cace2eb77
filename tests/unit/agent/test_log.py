"""Log lines in the columns of the C++ agent, and their rate limit."""

import errno
import io
import json
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from support.waiting import eventually as wait_until

from uros.agent import log as module
from uros.agent.log import Log, RateLimit
from uros.printable import is_printable, printable

LINE = re.compile(
    r"\[(\d+\.\d{6})\] (critical|error   |warning |info    |debug   |trace   ) \| (.{18}) \| "
    r"(.{24}) \| (.{30}) \|(?: (.*))?"
)


def lines(level, *calls):
    out = io.StringIO()
    log = Log(level, out)
    for call in calls:
        log(*call)
    return out.getvalue().splitlines()


def test_the_columns():
    about = "client_key: 0x4B0CBE99, topic_id: 0x000(2), participant_id: 0x000(1)"
    (line,) = lines(4, (4, "ProxyClient", "create_topic", "topic created", about))
    # as the C++ agent prints it, except the time
    assert line[line.index("]") :] == (
        "] info     | ProxyClient        | create_topic             | topic created          "
        "        | client_key: 0x4B0CBE99, topic_id: 0x000(2), participant_id: 0x000(1)"
    )
    match = LINE.fullmatch(line)
    assert match and match[6] == about


def test_the_time_is_in_seconds_since_1970(monkeypatch):
    monkeypatch.setattr(time, "time_ns", lambda: 1_763_750_000_000_042_999)
    assert lines(4, (4, "a", "b", "c", ""))[0].startswith("[1763750000.000042] ")


@pytest.mark.parametrize("level", range(7))
def test_levels(level):
    names = ["critical", "error", "warning", "info", "debug", "trace"]
    level_lines = lines(level, *[(number + 1, "p", "f", "w", "about") for number in range(6)])
    assert [LINE.fullmatch(line)[2].strip() for line in level_lines] == names[:level]


def test_shortcuts():
    out = io.StringIO()
    log = Log(6, out)
    for name in ("info", "warning", "error", "debug"):
        getattr(log, name)("p", "f", name, "about")
    matches = [LINE.fullmatch(line) for line in out.getvalue().splitlines()]
    assert [item[2].strip() for item in matches] == [item[5].strip() for item in matches]


def test_text_of_clients_is_escaped_and_stays_on_its_line():
    (line,) = lines(4, (4, "p", "f", "w", "rt/\x1b[31m\nfake [1.0] error \u202e\u00e9\udc80"))
    assert line.endswith(r"rt/\x1b[31m\nfake [1.0] error \u202e\xe9\udc80")


# --- JSON ---------------------------------------------------------------------------------------

HOSTILE = [
    "rt/\x1b[31m\nfake", '", "level": "critical', "\\", "\u202e\u200b", "\ud800", "{}", "\r\0\x7f",
    "client_key: 0x00000001, x", "Müller 温度",
]  # fmt: skip


def objects(level, *calls):
    out = io.StringIO()
    log = Log(level, out, as_json=True)
    for call in calls:
        log(*call)
    assert out.getvalue().isascii()
    return [json.loads(line) for line in out.getvalue().splitlines()]


def test_a_line_as_json_has_these_keys_in_this_order(monkeypatch):
    monkeypatch.setattr(time, "time_ns", lambda: 1_763_750_000_000_042_999)
    about = "client_key: 0x4B0CBE99, topic_id: 0x000(2)"
    one, two = objects(4, (4, "ProxyClient", "create_topic", "topic created", about), (2, *"abc"))
    assert list(one.items()) == [
        ("time", "2025-11-21T18:33:20.000042Z"), ("level", "info"), ("part", "ProxyClient"),
        ("function", "create_topic"), ("event", "topic created"), ("client_key", "0x4B0CBE99"),
        ("about", about),
    ]  # fmt: skip
    assert list(two) == ["time", "level", "part", "function", "event", "about"]
    assert (two["level"], two["about"]) == ("error", "")


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_name_forges_neither_line_nor_key_in_json_and_moves_no_terminal(name):
    (line,) = objects(4, (4, "p", "f", "refused", f"address: 1.2.3.4, topic: {name}"))
    assert (line["level"], line["event"]) == ("info", "refused") and "client_key" not in line
    assert line["about"] == f"address: 1.2.3.4, topic: {printable(name)}"
    (line,) = objects(4, (4, "p", "f", name))
    assert line["event"] == printable(name) and is_printable(line["event"])


def test_lost_lines_are_json_too(tmp_path, monkeypatch):
    real, room = os.write, [0]

    def write(fd, data):
        if fd == log._fd and not room[0]:
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(fd, data)

    with (tmp_path / "log").open("w") as stream:
        log = Log(4, stream, as_json=True)
        monkeypatch.setattr(os, "write", write)
        log.info("p", "f", "lost")
        wait_until(lambda: log._untaken == 1)
        room[0] = 1
        log.info("p", "f", "kept")
        log.close()
    first, second = map(json.loads, (tmp_path / "log").read_text().splitlines())
    assert (first["event"], first["level"]) == ("lines lost", "warning")
    assert first["about"] == "1 lines of the log were lost: No space left on device"
    assert second["event"] == "kept"


def test_a_broken_pipe_turns_the_log_off():
    class Closed(io.StringIO):
        def write(self, text):
            raise BrokenPipeError(errno.EPIPE, "Broken pipe")

    log = Log(6, Closed())
    log.info("p", "f", "w")
    assert log.level == 0
    assert log.trouble() == "lines of the log are lost: Broken pipe"


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EFBIG])
def test_a_full_disk_loses_lines_and_logging_goes_on(number, tmp_path, monkeypatch):
    """The disk takes half of a line, then nothing, then everything again."""
    room, real = [1000], os.write

    def write(fd, data):
        if fd != stream.fileno():
            return real(fd, data)
        if not room[0]:
            raise OSError(number, os.strerror(number))
        done = real(fd, data[: room[0]])
        room[0] -= done
        return done

    path = tmp_path / "log"
    monkeypatch.setattr(module.os, "write", write)
    with open(path, "w") as stream:
        log = Log(4, stream)
        for i in range(40):
            log.info("p", "f", "w", f"first {i}")
        wait_until(lambda: log._untaken)
        wait_until(log._waiting.empty)
        wait_until(lambda: log._put == log._taken)
        lost = log._untaken
        assert log.trouble() == f"lines of the log are lost: {os.strerror(number)}"
        room[0] = 100_000
        for i in range(3):
            log.info("p", "f", "w", f"then {i}")
        log.close()
        assert log._untaken == 0 and log.trouble() == ""
    *first, torn, notice, a, b, c = path.read_text().splitlines()
    assert [LINE.fullmatch(item)[6] for item in first] == [f"first {i}" for i in range(40 - lost)]
    assert not LINE.fullmatch(torn)
    assert notice == f"({lost} lines of the log were lost: {os.strerror(number)})"
    assert [LINE.fullmatch(item)[6] for item in (a, b, c)] == ["then 0", "then 1", "then 2"]


@pytest.fixture
def full(tmp_path, monkeypatch):
    """Yield (log, room, path): a JSON log on a disk with room for so many bytes."""
    room, real = [0], os.write

    def write(fd, data):
        if fd != log._fd:
            return real(fd, data)
        if not room[0]:
            raise OSError(errno.ENOSPC, "No space left on device")
        done = real(fd, data[: room[0]])
        room[0] -= done
        return done

    monkeypatch.setattr(module, "_RETRY_SECONDS", 0.01)
    path = tmp_path / "log"
    with path.open("w") as stream:
        log = Log(4, stream, as_json=True)
        monkeypatch.setattr(module.os, "write", write)
        yield log, room, path
        log.close()


def test_lost_lines_are_told_without_another_line(full):
    log, room, path = full
    log.info("p", "f", "lost")
    wait_until(log.trouble)
    room[0] = 10_000
    wait_until(lambda: not log.trouble())
    (notice,) = map(json.loads, path.read_text().splitlines())
    assert notice["about"] == "1 lines of the log were lost: No space left on device"


def test_a_disk_that_fills_between_two_lines_leaves_no_empty_line(full):
    log, room, path = full
    log.info("p", "f", "first")
    wait_until(log.trouble)
    room[0] = len(log._lost_lines(1, "No space left on device")) + 40
    wait_until(lambda: not log.trouble())
    log.info("p", "f", "torn")
    wait_until(log.trouble)
    room[0] = 1  # for the end of the torn line
    wait_until(lambda: not room[0])
    room[0] = 10_000
    wait_until(lambda: not log.trouble())
    first, torn, last = path.read_text().splitlines()
    assert len(torn) == 40 and json.loads(first)["event"] == json.loads(last)["event"]


def test_a_reader_that_has_gone_ends_the_log(tmp_path):
    reading, writing = os.pipe()
    with open(writing, "w") as stream:
        log = Log(4, stream)
        os.close(reading)
        log.info("p", "f", "w")
        wait_until(lambda: log.level == 0)
        log.close()


def test_a_stream_that_does_not_block_has_all_lines():
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    with open(writing, "w") as stream, open(reading) as reader:
        log = Log(4, stream)
        for i in range(3000):  # more than a pipe holds
            log.info("p", "f", "w", str(i))
        texts = [LINE.fullmatch(reader.readline().rstrip("\n"))[6] for _ in range(3000)]
        assert texts == [str(i) for i in range(3000)]
        log.close()


def test_colours_on_a_terminal_only():
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    out = Terminal()
    Log(4, out).info("p", "f", "w")
    assert "\033[32minfo    \033[0m |" in out.getvalue()


@pytest.fixture
def clock(monkeypatch):
    class Clock:
        now = 100.0

    monkeypatch.setattr(time, "monotonic", lambda: Clock.now)
    return Clock


def test_rate_limit_counts_suppressed_lines(clock):
    limit = RateLimit(1.0)
    assert limit.admit("a") == 1
    assert [limit.admit("a") for _ in range(7)] == [0] * 7
    assert limit.admit("b") == 1
    clock.now += 1.0
    assert limit.admit("a") == 8
    clock.now += 1.0
    assert limit.admit("a") == 1


def test_rate_limit_with_a_burst_logs_a_repeated_fault_each_minute_and_after_a_pause_at_once(
    clock,
):
    limit = RateLimit(60.0, 4)
    logged = []
    for at in range(1, 1001):
        clock.now += 1.0
        if count := limit.admit("fault"):
            logged.append((at, count))
    assert logged[:4] == [(1, 1), (2, 1), (3, 1), (4, 1)]
    assert len(logged) < 25 and sum(count for _, count in logged) > 940
    clock.now += 1e6
    assert limit.admit("fault") and limit.admit("fault") == 1


def test_rate_limit_keeps_kinds_apart(clock):
    limit = RateLimit(60.0)
    assert limit.admit("one") == 1 and not limit.admit("one")
    assert limit.admit("other") == 1


def test_rate_limit_of_all_kinds_counts_suppressed_lines_of_a_known_kind(clock):
    limit = RateLimit(1.0, 2)
    assert limit.admit("known") == 1
    for number in range(module.MAX_LINES):
        limit.admit(f"kind {number}")
    assert limit.admit("known") == 0
    clock.now += 1.0
    assert limit.admit("known") == 2


def test_rate_limit_of_all_kinds(clock):
    limit = RateLimit(1.0)
    assert sum(bool(limit.admit(f"kind {i}")) for i in range(10_000)) == module.MAX_LINES
    clock.now += 1.0
    assert limit.admit("another") == 1


def test_rate_limit_stays_small(clock):
    limit = RateLimit(1.0)
    for i in range(100_000):
        clock.now += 0.01
        limit.admit(f"kind {i}")
        limit.admit(f"kind {i}")
    assert len(limit._lines) < 1000 and len(limit._held) < 1000


def test_a_file_has_all_lines_once_the_log_is_closed(tmp_path):
    path = tmp_path / "log"
    with open(path, "w") as stream:
        log = Log(4, stream)
        for i in range(1000):
            log.info("p", "f", "w", str(i))
        log.close()
        log.info("p", "f", "w", "after the end")
    texts = [LINE.fullmatch(line)[6] for line in path.read_text().splitlines()]
    assert texts == [str(i) for i in range(1000)]


def test_a_pipe_without_reader_blocks_no_caller_and_lost_lines_are_counted(monkeypatch):
    monkeypatch.setattr(module, "_MAX_WAITING", 100)
    reading, writing = os.pipe()
    with open(writing, "w") as stream, open(reading) as reader:
        log = Log(4, stream)
        for i in range(5000):  # far more than a pipe holds
            log.info("p", "f", "w", f"{i} " + "x" * 500)
        assert log.trouble() == "lines of the log are lost: nobody is reading"
        numbers = []
        while "lines of the log were lost" not in (line := reader.readline()):
            numbers.append(int(LINE.fullmatch(line.rstrip("\n"))[6].split()[0]))
        assert numbers == sorted(set(numbers)) and numbers[0] == 0
        assert int(re.search(r"(\d+) lines", line)[1]) == 5000 - len(numbers)
        assert log.trouble() == ""
        log.close()


def test_a_long_name_is_shortened_in_the_log():
    (line,) = lines(4, (4, "a", "b", "c", "x" * 60_000))
    assert len(line) < 2200 and line.endswith("x... (60000 characters)")
    (line,) = lines(6, (5, "a", "b", "c", "x" * 60_000))  # messages are not shortened
    assert len(line) > 60_000


def test_lines_waiting_for_a_stopped_terminal_are_limited_in_characters_too(monkeypatch):
    monkeypatch.setattr(module, "_MAX_CHARACTERS", 100_000)
    reader, writer = os.pipe()
    with open(reader, "rb", buffering=0) as terminal, open(writer, "w") as log_stream:
        log = Log(6, log_stream)
        for _ in range(100):
            log(5, "a", "b", "c", "x" * 30_000)
        assert sum(map(len, tuple(log._waiting.queue))) < 200_000 and log._lost > 80
        output = b""
        while b"lines of the log were lost" not in output:
            output += terminal.read(65536)
        log.close()


REMOVED = """
import shutil, sys
import uros.agent.log, uros.interfaces
shutil.rmtree(sys.argv[1])
try:
    uros.interfaces.known_hash("std_msgs/msg/Int32")
except Exception as error:
    print(uros.agent.log.unexpected(error))
"""


def test_a_module_that_was_removed_is_no_fault_of_uros(tmp_path):
    """The package is removed while an agent runs, as by a package manager."""
    package = Path(module.__file__).parents[1]
    shutil.copytree(package, tmp_path / "uros", ignore=shutil.ignore_patterns("__pycache__"))
    done = subprocess.run(
        [sys.executable, "-c", REMOVED, str(tmp_path / "uros")],
        env={**os.environ, "PYTHONPATH": str(tmp_path)}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.stdout.startswith("ModuleNotFoundError: No module named 'uros."), done.stderr
    assert "uros was removed or replaced while this agent runs" in done.stdout
    assert "report" not in done.stdout


def test_other_modules_that_are_missing_are_reported():
    text = module.unexpected(ModuleNotFoundError("No module named 'xml'", name="xml"))
    assert text.endswith("(this is a fault of uros: please report it)")
