"""The file of a fleet, several boards in one session, and the table above what they say."""

import os
import pty
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from support.signals import default_signals
from support.variants import slow_except

from uros.boards.virtual.engine import runner
from uros.tools import cli
from uros.tools.board.screen import Row, Screen, layout
from uros.tools.board.simulation import Plan, Simulation, titles
from uros.tools.errors import ToolError
from uros.tools.fleet import read

PRINTS = "import time\nprint('hello')\nwhile True:\n    time.sleep_ms(10)\n"


def written(folder, text):
    file = folder / "hall.toml"
    file.write_text(text)
    return file


def test_boards_of_a_file(tmp_path):
    plans = read(
        written(
            tmp_path,
            """
            engine = "micropython"
            speed = 2

            [[board]]
            run = "esp32_publisher"
            count = 2
            namespace = "/cell"
            seed = 7
            happen = ["usb:unplug"]

            [[board]]
            run = "esp32_publisher"
            engine = "cpython"
            firmware = "mine"
            link = "/tmp/line"
            plug = ["wlan"]
            interfaces = ["my_msgs"]
            namespace = "/hall/left"
            """,
        )
    )
    first, second, third = plans
    assert [plan.title for plan in plans] == [
        "esp32_publisher", "esp32_publisher#2", "esp32_publisher#3",
    ]  # fmt: skip
    assert (first.seed, second.seed, third.seed) == (7, 8, 0)
    assert (first.namespace, second.namespace) == ("/cell1", "/cell2")
    assert first.engine == second.engine == "micropython" and third.engine == "cpython"
    assert first.speed == third.speed == 2.0 and first.happen == ["usb:unplug"]
    assert third.firmware == str(tmp_path / "mine") and third.link == "/tmp/line"
    assert third.interfaces == [str(tmp_path / "my_msgs")] and third.plugs == ["wlan"]
    assert third.namespace == "/hall/left" and first.firmware is None


ONE = '[[board]]\nrun = "esp32_publisher"\n'


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "it has no boards: begin each one with a line [[board]]"),
        ("board = 3", "it has no boards"),
        ("board", "not a TOML file"),
        ('agent = 1\n[[board]]\nrun = "x"', "there is no 'agent' (there are engine"),
        ("[[board]]\nseed = 1", 'board 1: "run" is missing, such as run = "'),
        (ONE + '[[board]]\nrun = "esp32_publishr"', "board 2: there is no board 'esp32_publishr'"),
        (ONE + "cont = 2", "there is no 'cont'; did you mean 'count'?"),
        (ONE + "count = 0", "count must be 1 or more, not 0"),
        (ONE + "count = 1000000000", "more than 200 boards"),
        (ONE + "count = true", "count takes a whole number, not True"),
        (ONE + 'seed = "x"', "seed takes a whole number, not 'x'"),
        (ONE + 'plug = "wlan"', "plug takes a list of texts, not 'wlan'"),
        (ONE + "happen = [1]", "happen takes a list of texts"),
        (ONE + "speed = 0", "speed must be more than 0"),
        (ONE + "speed = nan", "speed must be more than 0"),
        (ONE + 'engine = "pypy"', "engine must be one of cpython, micropython, not 'pypy'"),
        (ONE + 'count = 2\nlink = "x"', "2 boards cannot have one link"),
        (ONE + 'namespace = "a b"', "'a b' is not a namespace"),
    ],
)
def test_errors_of_a_file(tmp_path, text, words):
    with pytest.raises(ToolError) as caught:
        read(written(tmp_path, text))
    assert words in str(caught.value) and "hall.toml" in str(caught.value)


def test_a_file_that_cannot_be_read(tmp_path, capsys):
    assert cli.main(["fleet", str(tmp_path / "none.toml")]) == 1
    assert "none.toml: No such file" in capsys.readouterr().err
    (tmp_path / "x.toml").write_bytes(b"\xff\xfe")
    assert cli.main(["fleet", str(tmp_path / "x.toml")]) == 1
    assert "not a TOML file" in capsys.readouterr().err


def test_namespaces_without_an_agent_are_rejected(tmp_path, capsys):
    file = written(tmp_path, ONE + 'namespace = "/left"')
    assert cli.main(["fleet", str(file), "--no-agent"]) == 1
    assert "namespaces need the agent" in capsys.readouterr().err


class Typed:
    """A command with a pipe for its input."""

    def __init__(self, *arguments, **options):
        with default_signals():
            self.process = subprocess.Popen(
                [sys.executable, "-m", "uros", *map(str, arguments)],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                text=True, bufsize=1, **options,
            )  # fmt: skip

    def until(self, text):
        seen = []
        while not seen or text not in seen[-1]:
            line = self.process.stdout.readline()
            assert line, f"no {text!r} in {seen}"
            seen.append(line.rstrip("\n"))
        return seen

    def type(self, line):
        self.process.stdin.write(line + "\n")


@pytest.fixture
def program(tmp_path):
    folder = tmp_path / "hello"
    folder.mkdir()
    (folder / "main.py").write_text(PRINTS)
    return folder


def test_several_boards_are_distinguished_by_title(tmp_path, program):
    board = '[[board]]\nrun = "{}"\nfirmware = "hello"\n'
    names = ("esp32_publisher", "esp32_publisher", "esp32_button_led")
    file = written(tmp_path, "".join(map(board.format, names)))
    fleet = Typed("fleet", file)
    try:
        seen = fleet.until("commands, one a line: ")
        assert "esp32_publisher#2: esp32_publisher runs on cpython" in "\n".join(seen)
        assert "next, in another terminal: cat " in "\n".join(seen)  # none talks to an agent
        fleet.type("button:press")
        seen = fleet.until("esp32_button_led: button pressed")
        assert "esp32_button_led: done: button:press" in seen
        fleet.type("esp32_publisher#2 error_led:dead")
        fleet.until("esp32_publisher#2: done: error_led:dead")
        fleet.type("button:broken")
        fleet.type("button:stuck")
        fleet.until("done: button:stuck; other faults of this part: button:broken")
        fleet.type("all:off")
        missing = {f"{name}: done: all:off" for name in (*names[1:], "esp32_publisher#2")}
        while missing:
            missing -= set(fleet.until("done: all:off"))
        fleet.type("knob:turn=3")
        fleet.until("a space before the command: esp32_publisher, esp32_publisher#2")
        fleet.type("esp32_publisher reset")
        fleet.until("esp32_publisher: reset: the program starts again")
        fleet.until("esp32_publisher: hello")
        fleet.type("quit")
        assert fleet.process.wait(20) == 0
    finally:
        fleet.process.kill()
        fleet.process.communicate()


class Slow:
    """A board whose start takes until another one starts too, and the last one's until one runs."""

    together = threading.Barrier(2, timeout=60)
    one_runs = threading.Event()
    happenings = ("usb:unplug",)
    usb = "detached"
    baud = 115200
    fails = ""

    def __init__(self, firmware, *args, seed, **options):
        self.path = Path("/dev/null")
        self.seed = seed

    def start(self):
        if self.seed < 2:
            self.together.wait()
        elif not self.one_runs.wait(60):
            raise AssertionError("nothing was printed while the last board started")
        if self.fails:
            raise runner.StartError(self.fails)

    def stop(self):
        pass


@pytest.mark.parametrize("fails", ["", "start"])
def test_boards_start_together_and_each_is_printed_at_once(fails, monkeypatch, capsys):
    said = []

    def say(self, text):
        said.append(text)
        if "#2: esp32_publisher runs on cpython" in text:
            Slow.one_runs.set()

    Slow.one_runs.clear()
    Slow.together.reset()
    monkeypatch.setattr(Slow, "fails", fails)
    monkeypatch.setattr(runner, "RunningBoard", Slow)
    monkeypatch.setattr(Screen, "say", say)
    monkeypatch.setattr(os, "cpu_count", lambda: 3)
    names = titles(["esp32_publisher"] * 3)
    plans = [Plan(name, "esp32_publisher", seed=seed) for seed, name in enumerate(names)]
    if fails:
        Slow.one_runs.set()
        with pytest.raises(ToolError, match=fails):
            Simulation(plans, False, seconds=0.01).run()
        return
    assert Simulation(plans, False, seconds=0.01).run() == 0
    assert said[0] == "board: starting 3 boards"
    starts = [line.partition(": esp32_publisher runs on cpython; its USB")[0] for line in said[1:4]]
    assert sorted(starts) == sorted(names) and starts.index(names[1]) < starts.index(names[2])


def test_a_board_that_does_not_start_prints_no_table(monkeypatch, capsys):
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setattr(Slow, "fails", "there is no usb:unplg")
    monkeypatch.setattr(runner, "RunningBoard", Slow)
    Slow.one_runs.set()
    with pytest.raises(ToolError, match="there is no usb:unplg"):
        Simulation([Plan("one", "esp32_publisher", seed=2)], False, seconds=0.01).run()
    assert capsys.readouterr().out == ""


def test_options_of_one_board(capsys):
    assert cli.main(["board", "run", "esp32_publisher", "esp32_publisher", "--link", "x"]) == 1
    assert "--link is for one board; 'uros fleet'" in capsys.readouterr().err


def test_an_agent_that_ends_ends_the_session(tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("", 0))
        port = taken.getsockname()[1]
        one = Typed("board", "run", "esp32_wifi_publisher", "--agent-port", port)
        try:
            one.until(f"port {port} is in use")
            one.until("its log above has the reason; --agent-port chooses its UDP port")
            assert one.process.wait(20) == 1
        finally:
            one.process.kill()
            one.process.communicate()


@pytest.mark.parametrize("number", slow_except([signal.SIGTERM, signal.SIGHUP], signal.SIGTERM))
def test_no_folder_is_left_after_a_signal(tmp_path, program, number):
    (program / "main.py").write_text("import uros.client\n" + PRINTS)
    text = '[[board]]\nrun = "esp32_wifi_publisher"\nfirmware = "hello"\nnamespace = "/left"\n'
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    fleet = Typed(
        "fleet", written(tmp_path, text), "--agent-port", 0,
        env=dict(os.environ, TMPDIR=str(scratch)),
        preexec_fn=lambda: signal.signal(number, signal.SIG_DFL),
    )  # fmt: skip
    try:
        fleet.until("commands, one a line: ")
        assert any(path.name.startswith("uros-rules-") for path in scratch.iterdir())
        fleet.process.send_signal(number)
        assert fleet.process.wait(20) == 128 + number
        assert not list(scratch.iterdir())
    finally:
        fleet.process.kill()
        fleet.process.communicate()


def test_a_row_is_cut_and_the_text_below_is_wrapped():
    table = [Row(["BOARD", "NODE"]), Row(["left", "-"], ["led on, button pressed", ""])]
    assert layout(table, 80) == ["BOARD  NODE", "left   -", "  led on, button pressed"]
    assert layout(table, 8) == ["BOARD  …", "left   -", "  led on, button", "  pressed"]


def test_the_table_of_a_terminal(program):
    """Drawn at its top, while lines go on below; the terminal is whole again afterwards."""
    pid, fd = pty.fork()
    if not pid:
        os.environ.update(TERM="xterm", COLUMNS="100", LINES="30")
        command = ["-m", "uros", "board", "run", "esp32_button_led", "--firmware", str(program)]
        command += ["--fault", "knob:open"]
        os.execv(sys.executable, [sys.executable, *command])
    text = b""
    try:
        typed = False
        end = time.monotonic() + 30
        while b"button pressed" not in text and time.monotonic() < end:
            text += os.read(fd, 65536)
            if not typed and b"hello" in text:
                typed = True
                os.write(fd, b"button:press\nled:dead\n")
        while b"led:dead\x1b" not in text and time.monotonic() < end:
            text += os.read(fd, 65536)
        os.kill(pid, signal.SIGINT)
        while b"\033[r" not in text and time.monotonic() < end:
            text += os.read(fd, 65536)
    finally:
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        os.close(fd)
    shown = text.decode()
    assert re.search(r"BOARD +PROGRAM +USB +NODE +IN/S +OUT/S", shown)
    assert re.search(r"esp32_button_led +runs +configured +- +- +-", shown), shown[-3000:]
    assert re.search(r"  knob 50 %, led off, button pressed", shown)
    assert re.search(r"faults: knob:open\b", shown)  # from the start on
    assert re.search(r"button pressed, faults: knob:open led:dead", shown), shown[-3000:]
    assert shown.index("BOARD ") < shown.index("its USB line is")  # which is not wiped away
    assert "\033[5;30r" in shown  # three lines and a rule above what scrolls
