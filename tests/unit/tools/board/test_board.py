"""uros board list and run, as a person uses them."""

import json
import os
import re
import select
import signal
import subprocess
import sys
import time

import pytest
from support.paths import ROOT
from support.signals import default_signals
from support.variants import slow_except

from uros.boards.virtual.engine import micropython
from uros.boards.virtual.models.catalog import BOARDS
from uros.tools import cli

# Something of each board's own.
OF = {
    **dict.fromkeys(BOARDS, "led0:dead"),
    **dict.fromkeys((name for name in BOARDS if name.startswith("esp32")), "22 LED"),
    "ra6m5_sensor_node": "sht3x:crc",
    "ra6m5_usb_text": "P414 I2C2 SDA",
    "esp32_button_led": "button:tap",
    "esp32_wifi_publisher": "wlan:lost",
    "spresense_publisher_wifi": "gs2200:lost",
    "sprturtlebot": "rover:place",
    "sprturtlebot_pid": "wlan:lost",
}
COMMAND = [sys.executable, "-m", "uros", "board"]


class Running:
    """The command as a process, read line by line."""

    def __init__(self, *arguments, **options):
        with default_signals():
            self.process = subprocess.Popen(
                [*COMMAND, "run", *map(str, arguments)],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                text=True, bufsize=1, **options,
            )  # fmt: skip

    def type(self, line):
        self.process.stdin.write(line + "\n")

    def until(self, text):
        """The lines up to one with this text."""
        seen = []
        while not seen or text not in seen[-1]:
            line = self.process.stdout.readline()
            assert line, f"no {text!r} in {seen}; {self.process.stderr.read()}"
            seen.append(line.rstrip("\n"))
        return seen

    def close_input(self):
        self.process.stdin.close()
        self.process.stdin = None


@pytest.fixture
def run():
    """Starts commands, and ends them after the test."""
    started = []

    def start(*arguments, **options):
        started.append(Running(*arguments, **options))
        return started[-1]

    yield start
    for running in started:
        running.process.kill()
        running.process.communicate()


def program(folder, text):
    (folder / "main.py").write_text(text)
    return folder


LOOP = """
import sys, time, usb.device
from machine import I2C
from usb.device.cdc import CDCInterface
cdc = CDCInterface(timeout=0)
usb.device.get().init(cdc)
print("started")
last = None
while True:
    cdc.is_open()
    try:
        I2C(2).readfrom(0x13, 1)
        now = "fine"
    except OSError as error:
        now = str(error)
    if now != last:
        print("bus", now)
    last = now
    time.sleep_ms(2)
"""


@pytest.mark.parametrize("verb", ["list", "run"])
def test_help_is_cheap(verb):
    probe = (
        "import sys\nfrom uros.tools import cli\n"
        f"assert cli.main(['board', '{verb}', '--help']) == 0\n"
        "print({'uros.boards', 'uros.interfaces', 'uros.middleware', 'ctypes'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True)
    *text, heavy = done.stdout.splitlines()
    assert text[0].startswith(f"usage: uros board {verb}") and heavy == "set()"


def test_list(capsys):
    assert cli.main(["board", "list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 100
    for spec in BOARDS.values():
        (at,) = [number for number, line in enumerate(lines) if line.split()[:1] == [spec.name]]
        assert lines[at].endswith(spec.text)
        heading = next(line for line in reversed(lines[:at]) if line[:1] not in (" ", ""))
        assert heading == f"{spec.mcu}:"
    assert "uros board run" in lines[-1]


@pytest.mark.parametrize("name", BOARDS)
def test_list_one(capsys, name):
    assert cli.main(["board", "list", name]) == 0
    out = capsys.readouterr().out
    assert os.path.join("firmware", BOARDS[name].firmware) in out
    words = [BOARDS[name].mcu, *BOARDS[name].ports, "usb:unplug", "usb:plug", "LED", OF[name]]
    if name.startswith("esp32"):
        words.append("UARTs     UART(2) at tx=17, rx=16 (its USB line)\n")
    for word in words:
        assert word in out


@pytest.mark.parametrize("verb", ["list", "run"])
@pytest.mark.parametrize(
    ("name", "words"),
    [("ra6m5_sensor_nod", "did you mean 'ra6m5_sensor_node'?"), ("x", "there are ra6m5_s")],
)
def test_unknown_names(capsys, verb, name, words):
    assert cli.main(["board", verb, name]) == 1
    error = capsys.readouterr().err
    assert error.startswith(f"uros: there is no board '{name}'") and words in error


def test_a_board_prints_its_state_and_executes_commands(run, tmp_path):
    link = tmp_path / "tty"
    board = run(
        "ra6m5_sensor_node", "--firmware", program(tmp_path, LOOP), "--link", link,
        "--fault", "vcnl4010:absent",
    )  # fmt: skip
    first = board.until("bus")
    assert first[0] == f"board: ra6m5_sensor_node runs on cpython; its USB line is {link}"
    assert first[1] == f"board: next, in another terminal: cat {link}"
    assert first[2].startswith("board: commands, one a line: usb:unplug; or reset")
    assert {"board: USB attached", "started"} <= set(first)
    assert first[-1] == "bus [Errno 19] ENODEV"
    board.type("vcnl4010:off")
    assert "board: done: vcnl4010:off" in board.until("bus fine")
    board.type("")
    board.type("vcnl4010:sulking")
    assert board.until("sulking")[-1].startswith("board: there is no vcnl4010:sulking; there are")
    board.type("heap")
    board.until("board: heap needs the engine micropython")
    board.type("usb:unplug")
    board.until("board: USB detached")
    board.type("usb:plug")
    board.until("board: USB configured")
    assert link.is_symlink()
    board.type("reset")
    assert "board: reset: the program starts again" in board.until("started")
    board.close_input()  # no more commands is no reason to end
    board.until("bus fine")
    board.process.send_signal(signal.SIGINT)
    assert board.process.wait(10) == 0
    assert board.process.stderr.read() == ""
    assert not link.is_symlink()


@pytest.mark.parametrize(("text", "status"), [("print('a')\n", 0), ("1 / 0\n", 1)])
def test_a_program_that_ends(run, tmp_path, text, status):
    board = run("ra6m5_sensor_node", "--firmware", program(tmp_path, text), "--seconds", "1")
    board.until("the program has ended")
    assert board.process.wait(20) == status


OWN_TYPE = """
from board_run_msgs.msg import Level

level = Level(height=1.5)
print("level", level.height)
"""


def test_a_program_with_custom_types(run, tmp_path):
    file = tmp_path / "board_run_msgs" / "msg" / "Level.msg"
    file.parent.mkdir(parents=True)
    file.write_text("float32 height\n")
    folder = tmp_path / "firmware"
    folder.mkdir()
    program(folder, OWN_TYPE)
    options = ["ra6m5_sensor_node", "--firmware", "firmware", "--seconds", "9"]
    where = {"cwd": tmp_path, "env": dict(os.environ, PYTHONPATH=str(ROOT / "src"))}
    refused = run(*options, **where)
    _, error = refused.process.communicate(timeout=30)
    assert refused.process.returncode == 1 and "by --interfaces DIR" in error
    board = run(*options, "--interfaces", "board_run_msgs", **where)
    assert board.until("level")[-1] == "level 1.5"
    board.type("reset")
    assert "board: reset: the program starts again" in board.until("level 1.5")


@pytest.mark.skipif(not hasattr(os, "pidfd_open"), reason="not on this platform: needs pidfd_open")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_no_process_or_folder_is_left_after_any_end(run, tmp_path, number):
    link = tmp_path / "tty"
    board = run("ra6m5_sensor_node", "--firmware", program(tmp_path, LOOP), "--link", link)
    board.until("USB configured")
    with open(f"/proc/{board.process.pid}/task/{board.process.pid}/children") as file:
        child = os.pidfd_open(int(file.read().split()[0]))
    board.process.send_signal(number)
    board.process.wait(10)
    assert select.select([child], [], [], 10)[0]
    os.close(child)
    assert not link.is_symlink()


def test_a_board_with_its_agent(run, own_domain_id):
    board = run("ra6m5_sensor_node", env=dict(os.environ, ROS_DOMAIN_ID=str(own_domain_id)))
    assert board.until("Ctrl-C")[-1] == (
        f"board: an agent runs too, in domain {own_domain_id}; Ctrl-C ends everything"
    )
    command = board.until("next")[-1].partition("another terminal: ")[2]
    assert command == f"uros topic list -t --domain {own_domain_id}"
    assert f"domain_id: {own_domain_id}" in board.until("domain overridden")[-1]
    for _ in range(7):
        board.until("datawriter created")
    board.process.send_signal(signal.SIGINT)
    lines = board.until("server stopped")
    assert not [line for line in lines if "device lost" in line]  # the end is no loss
    assert board.process.wait(10) == 0


@pytest.mark.skipif(not os.path.exists("/proc"), reason="not on this platform: needs /proc")
@pytest.mark.parametrize(
    "moment",
    slow_except(["", "USB line", "USB configured", "server stopped"], "", "server stopped"),
)
def test_ctrl_c_pressed_twice_leaves_nothing_behind(run, own_domain_id, tmp_path, moment):
    """At the start, while the board or the agent starts, and while they end."""
    mark = str(tmp_path)
    board = run("esp32_publisher", env=dict(
        os.environ, ROS_DOMAIN_ID=str(own_domain_id), TMPDIR=mark
    ))  # fmt: skip
    if moment == "server stopped":
        board.until("datawriter created")
        board.process.send_signal(signal.SIGINT)
    if moment:
        board.until(moment)
    else:
        while len(with_tmpdir(mark)) < 2:  # the board's process begins
            assert board.process.poll() is None
    board.process.send_signal(signal.SIGINT)
    board.process.send_signal(signal.SIGINT)
    _, error = board.process.communicate(timeout=60)
    # SIGINT itself, if the interpreter is at its end already.
    assert board.process.returncode in (0, 130, -signal.SIGINT) and error == ""
    end = time.monotonic() + 60
    while with_tmpdir(mark):
        assert time.monotonic() < end, "processes are left"
        time.sleep(0.05)
    assert os.listdir(mark) == []


def with_tmpdir(folder):
    """The processes with this TMPDIR."""
    found = []
    for number in filter(str.isdecimal, os.listdir("/proc")):
        try:
            with open(f"/proc/{number}/environ", "rb") as file:
                if f"TMPDIR={folder}\0".encode() in file.read():
                    found.append(int(number))
        except OSError:
            continue
    return found


RATE = """
from machine import UART
from uros.client import Node
from uros.transport.serial import StreamTransport
from std_msgs.msg import Int32
node = Node("rate", StreamTransport(UART(2, 9600, timeout=0)))
publisher = node.create_publisher(Int32, "rate", 10)
node.spin()
"""


def test_another_baud_rate_is_named_and_its_remedy_works(run, own_domain_id, tmp_path):
    options = ["esp32_publisher", "--firmware", program(tmp_path, RATE)]
    env = dict(os.environ, ROS_DOMAIN_ID=str(own_domain_id))
    wrong = run(*options, env=env)
    assert wrong.until("9600 baud")[-1] == (
        "board: its UART has 9600 baud, and the program at the other end of its line 115200: both"
        " receive noise; run the board with --baudrate 9600, or UART(..., 115200) in the board's"
        " program"
    )
    right = run(*options, "--baudrate", "9600", env=env)
    assert "baudrate: 9600" in right.until("running...")[-1]
    right.until("datawriter created")


def test_the_agent_gets_the_baud_rate_of_each_board(run, own_domain_id):
    boards = run(
        "spresense_camera", "esp32_publisher", "spresense_publisher",
        env=dict(os.environ, ROS_DOMAIN_ID=str(own_domain_id)),
    )  # fmt: skip
    devices = {}
    for _ in range(3):
        line = boards.until("running...")[-1]
        device, baud = re.search(r"dev: \S+/(\w+), baudrate: (\d+)", line).groups()
        devices[device] = int(baud)
    assert devices == {
        "spresense_camera": 921600, "esp32_publisher": 115200, "spresense_publisher": 115200,
    }  # fmt: skip
    alone = run("spresense_camera", "--no-agent")
    assert " --baudrate 921600" in alone.until("next")[-1]


def test_a_module_that_the_board_brings(run, tmp_path):
    """The option that the builder's error recommends."""
    options = ["ra6m5_sensor_node", "--firmware", program(tmp_path, "import my_driver\n")]
    _, error = run(*options).process.communicate(timeout=60)
    assert "name it as provided (--provided my_driver)" in error
    board = run(*options, "--provided", "my_driver", "--seconds", "9")
    board.until("no module named 'my_driver'")
    assert "my_driver.py beside main.py" in board.until("a virtual board")[-1]


@pytest.mark.parametrize(("domain", "words"), [("0", ""), ("82", " --domain 82")])
def test_the_sensor_node_needs_an_agent(run, domain, words):
    board = run("ra6m5_sensor_node", "--no-agent", env=dict(os.environ, ROS_DOMAIN_ID=domain))
    path = board.until("USB line")[0].rsplit(" ", 1)[1]
    assert board.until("next")[-1].endswith(f": uros agent serial --dev {path}{words}")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--fault", "sht3x:sulking"], "there is no sht3x:sulking"),
        (["--firmware", "/nowhere"], "folder '/nowhere'; give the folder of a main.py"),
        (
            ["--firmware", "esp32_publishr"],
            "there is no board or folder 'esp32_publishr'; did you mean 'esp32_publisher'",
        ),
        (["--link", __file__], "left alone"),
        (["--interfaces", "/nowhere"], "/nowhere: no such folder; give a folder that holds .msg"),
        (["--engine", "micropython"], "npm install"),
    ],
)
def test_boards_that_cannot_run_have_an_error_of_one_line(run, tmp_path, arguments, words):
    board = run(
        "ra6m5_sensor_node", *arguments, env=dict(os.environ, UROS_MICROPYTHON=str(tmp_path))
    )
    out, error = board.process.communicate(timeout=30)
    assert board.process.returncode == 1 and out == ""
    assert error.startswith("uros: ") and error.count("\n") == 1 and words in error


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("countr", "there is no board or folder 'countr'; did you mean 'counter'?"),
        ("./{}/countr", "folder './{}/countr'; did you mean '{}/counter'?"),
        ("{}/empty", "empty: there is no main.py in it, which a board starts"),
        ("counter/main.py", "main.py is a file: give the folder of a main.py, such as counter"),
        ("xyz", "there is no board or folder 'xyz' (boards: ra6m5_sensor_node, "),
    ],
)
def test_a_misspelt_program_is_the_only_line_and_says_what_was_meant(
    tmp_path, monkeypatch, capsys, name, words
):
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    here = tmp_path / "here"
    for folder in (here, here / "more"):
        touch(folder / "counter" / "main.py")
        (folder / "empty").mkdir()
    monkeypatch.chdir(here)
    arguments = ["--firmware", name.format("more"), "--no-agent"]
    assert cli.main(["board", "run", "ra6m5_sensor_node", *arguments]) == 1
    out, error = capsys.readouterr()
    assert out == "" and error.count("\n") == 1 and words.format("more", "more") in error


def touch(file):
    file.parent.mkdir(parents=True, exist_ok=True)
    file.touch(0o755)
    return file


@pytest.fixture
def elsewhere(tmp_path, monkeypatch):
    """A current folder without MicroPython, and uros installed somewhere else."""
    monkeypatch.delenv("UROS_MICROPYTHON", raising=False)
    package = tmp_path / "lib" / "python" / "uros"
    monkeypatch.setattr(micropython, "_HERE", package / "boards")
    folder = tmp_path / "work"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


def make_clone(folder):
    touch(folder / "scripts" / "env.py")
    (folder / "src" / "uros").mkdir(parents=True)


def test_micropython_of_a_clone_that_is_the_current_folder(elsewhere):
    made = elsewhere / "build" / "micropython"
    module = touch(made.joinpath("node_modules", *micropython.PACKAGE.split("/"), "x"))
    module = touch(module.with_name("micropython.mjs"))
    node = touch(made / "node")
    assert micropython.find() == (node, module)


NPM = "npm install @micropython/micropython-webassembly-pyscript@1.27.0 --prefix "
SCRIPT = "python3 scripts/env.py micropython"


@pytest.mark.parametrize(
    ("named", "clone", "words"),
    [
        ("", False, f"{NPM}~/micropython && export UROS_MICROPYTHON=~/micropython"),
        ("", True, f"work/build/micropython; install it with: {SCRIPT}"),
        ("my place", False, f"{NPM}'my place' (UROS_MICROPYTHON names that folder)"),
        ("my place", True, f"names that folder), or unset UROS_MICROPYTHON and: {SCRIPT}"),
    ],
)
def test_the_installation_of_micropython(elsewhere, monkeypatch, named, clone, words):
    if named:
        monkeypatch.setenv("UROS_MICROPYTHON", named)
    if clone:
        make_clone(elsewhere)
    with pytest.raises(micropython.NoMicroPython) as error:
        micropython.find()
    text = str(error.value)
    assert words in text and "lib" + os.sep not in text
    pins = json.loads((ROOT / "tests" / "mpy" / "package.json").read_text())["dependencies"]
    assert pins == {micropython.PACKAGE: micropython.VERSION}


def test_a_real_board_is_no_virtual_one(capsys):
    for verb in ("list", "run"):
        assert cli.main(["board", verb, "pico"]) == 1
        assert "'pico' is a real board ('uros board list --ports'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "readme", "rest"),
    [
        ("my-robot", None, "esp32_publisher --firmware my-robot"),  # of uros board new
        ("my robot", "  $ uros board run sprturtlebot --firmware 'my robot'\n",
         "sprturtlebot --firmware 'my robot'"),
        ("other", "uros board run nothing --firmware other\n", "BOARD --firmware other ('uros"),
        ("other", "", "BOARD --firmware other ('uros board list' has the boards"),
        ("more/esp32_subscriber", "", "esp32_subscriber --firmware more/esp32_subscriber"),
    ],
)  # fmt: skip
def test_the_folder_of_a_program_is_no_board(tmp_path, monkeypatch, capsys, name, readme, rest):
    monkeypatch.chdir(tmp_path)
    if readme is None:
        assert cli.main(["board", "new", name]) == 0
    else:
        touch(tmp_path / name / "main.py")
        if readme:
            (tmp_path / name / "README.md").write_text(readme)
    capsys.readouterr()
    assert cli.main(["board", "run", name]) == 1
    error = capsys.readouterr().err
    assert error.startswith(f"uros: {name} is the folder of a program: uros board run {rest}")


@pytest.mark.parametrize("arguments", [["--seconds", "0"], ["--engine", "pypy"], []])
def test_bad_command_lines(arguments, capsys):
    assert cli.main(["board", "run", *arguments]) == 2
    assert capsys.readouterr().err.startswith("uros board run: error: ")


def test_sleep_and_watchdog_are_told(tmp_path):
    (tmp_path / "main.py").write_text(
        "import machine\n"
        "if machine.reset_cause() == machine.PWRON_RESET:\n    machine.deepsleep(20)\n"
        "if machine.reset_cause() == machine.DEEPSLEEP_RESET:\n    machine.WDT(timeout=20)\n"
        "    while True:\n        pass\n"
        "machine.deepsleep()\n"
    )
    board = Running("esp32_publisher", "--firmware", tmp_path)
    try:
        said = board.until("until its reset button is pressed")
    finally:
        board.close_input()
        board.process.terminate()
        board.process.communicate()
    told = [line for line in said if line.startswith("board: ")]
    assert told[-4:] == [
        "board: machine.deepsleep: the board sleeps for 0.02 s",
        "board: the board wakes: the program starts again",
        "board: the watchdog has reset the board: the program starts again",
        "board: machine.deepsleep: the board sleeps until its reset button is pressed",
    ]
