"""Tests of uros board deploy and its parts, with MicroPython's real REPL on the serial line."""

import io
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import pytest
from mpy.repl import ReplBoard
from uros.interfaces.std_msgs.msg import Int32

from uros.agent.agent import Agent
from uros.agent.log import Log
from uros.agent.server import Server
from uros.agent.transports.serial import SerialServer
from uros.boards.deploy.deploy import (
    NOTE,
    STAGE,
    DeployError,
    Device,
    Plan,
    carry_out,
    check,
    check_room,
    look,
    make_plan,
)
from uros.boards.deploy.raw_repl import LineLost, NoRepl, Raised, RawRepl
from uros.host.direct import Direct
from uros.host.node import Node
from uros.middleware.memory import Bus, MemoryMiddleware
from uros.tools import cli
from uros.transport.serial_host import device_port

MAIN = b"import hw, part\nprint('part', part.NUMBER)\nwhile True:\n    hw.wait()\n"
FILES = {
    "main.py": MAIN,
    "part.py": b"NUMBER = 1\n",
    "lib/deep/data.bin": bytes(range(256)) * 9,
    "lib/empty.txt": b"",
}


@pytest.fixture
def board() -> Iterator[ReplBoard]:
    with ReplBoard() as repl_board:
        yield repl_board


@pytest.fixture
def connect() -> Iterator[Callable[..., RawRepl]]:
    """Return a function that opens a board's serial device and enters the raw REPL."""
    ports = []

    def open_(board: ReplBoard, fresh: bool = True) -> RawRepl:
        ports.append(device_port(board.path))
        ports[-1].open()
        repl = RawRepl(ports[-1])
        repl.enter(fresh=fresh)
        return repl

    yield open_
    for port in ports:
        port.close()


def put(repl: RawRepl, files: Mapping[str, bytes], **options: bool) -> Plan:
    device = look(repl)
    check(device, files)
    plan = make_plan(repl, device, files, options.pop("clean", False))
    check_room(device, plan, files)
    if plan.changes:
        carry_out(repl, device, plan, files, **options)
    return plan


def files_on(repl: RawRepl) -> dict[str, bytes]:
    """Return the files of a board by path."""
    look(repl)
    text = repl.run(
        "print(repr([(p, open(_r + p, 'rb').read()) for p in _tree('/flash') if p[-1] != '/']))"
    )
    return dict(eval(text))


def folders(repl: RawRepl) -> set[str]:
    look(repl)
    return set(eval(repl.run("print(repr([p for p in _tree('/flash') if p[-1] == '/']))")))


# --- the raw REPL -----------------------------------------------------------------------


@pytest.mark.parametrize("paste", ["1", "0", "old"])
def test_code_runs_with_and_without_raw_paste_mode(
    paste: str, connect: Callable[..., RawRepl]
) -> None:
    with ReplBoard(paste) as board:
        repl = connect(board)
        for _ in range(2):
            assert repl.run(f"x = {'a' * 5000!r}\nprint(len(x))").strip() == "5000"
            with pytest.raises(Raised) as raised:
                repl.run("1 / 0")
            assert raised.value.last == "ZeroDivisionError: divide by zero"
            with pytest.raises(Raised, match="SyntaxError"):
                repl.run("def (")
        assert repl.run("print('~')").strip() == "~"


def test_a_program_that_runs_is_ended_and_its_memory_freed(
    board: ReplBoard, connect: Callable[..., RawRepl]
) -> None:
    repl = connect(board)
    put(repl, FILES)
    repl.leave(restart=True)
    assert repl._try_until(b"part 1\r\n", 10)[0]
    repl.enter()
    with pytest.raises(Raised, match="NameError"):
        repl.run("part")


def test_a_program_that_ignores_ctrl_c_is_reported(
    board: ReplBoard, connect: Callable[..., RawRepl]
) -> None:
    repl = connect(board)
    put(repl, {"main.py": b"import hw\nprint('deaf')\nwhile True:\n    hw.wait_deaf()\n"})
    repl.leave(restart=True)
    assert repl._try_until(b"deaf", 10)[0]
    warnings = []
    with pytest.raises(NoRepl):
        repl.enter(3, waiting=lambda: warnings.append(1))
    assert warnings == [1]


def test_enter_times_out_on_a_line_that_never_stops_sending(board: ReplBoard) -> None:
    class Chatter:
        def open(self) -> None: ...
        def close(self) -> None: ...
        def wait(self, timeout_ms: int) -> None: ...

        def read(self, size: int) -> bytes:
            return b"21.5 C\r\n"

        def write(self, data: bytes | bytearray | memoryview) -> int:
            return len(data)

    with pytest.raises(NoRepl) as error:
        RawRepl(Chatter()).enter(0.2)
    assert b"21.5 C" in error.value.heard


# --- copying ----------------------------------------------------------------------------


def test_only_changed_files_are_copied_and_obsolete_ones_removed(
    board: ReplBoard, connect: Callable[..., RawRepl]
) -> None:
    repl = connect(board)
    repl.run("f = open('calibration.txt', 'w'); f.write('3'); f.close()")
    reports = []
    device = look(repl)
    plan = make_plan(repl, device, FILES)
    carry_out(repl, device, plan, FILES, lambda *progress: reports.append(progress))
    files = files_on(repl)
    assert files.pop(NOTE).decode().split("\n") == sorted(FILES)
    assert files == {**FILES, "calibration.txt": b"3"}
    size = sum(map(len, FILES.values()))
    assert reports[-1] == ("main.py", size, size)

    assert not put(repl, FILES).changes

    changed = {"main.py": MAIN, "part.py": b"NUMBER = 2\n"}
    plan = put(repl, changed)
    assert (plan.write, plan.keep) == (["part.py"], ["main.py"])
    files = files_on(repl)
    assert files.pop(NOTE) and files == {**changed, "calibration.txt": b"3"}
    assert folders(repl) == set()

    put(repl, changed, clean=True)
    files = files_on(repl)
    assert files.pop(NOTE) and files == changed
    repl.leave(restart=True)
    assert repl._try_until(b"part 2\r\n", 10)[0]


def test_in_place_replaces_the_files(board: ReplBoard, connect: Callable[..., RawRepl]) -> None:
    repl = connect(board)
    put(repl, FILES)
    put(repl, {**FILES, "part.py": b"NUMBER = 3\n"}, in_place=True)
    files = files_on(repl)
    assert files.pop(NOTE) and files == {**FILES, "part.py": b"NUMBER = 3\n"}


def test_a_cable_that_is_pulled_in_the_middle_leaves_the_old_files(
    board: ReplBoard, connect: Callable[..., RawRepl]
) -> None:
    repl = connect(board)
    put(repl, FILES)
    new = {"main.py": b"print('new')\n", "part.py": os.urandom(9000), "lib/more.py": b"A = 1\n"}
    device = look(repl)
    plan = make_plan(repl, device, new)

    def pull(path: str, done: int, size: int) -> None:
        if done > size // 2:
            board.cut_after = 100

    with pytest.raises(LineLost):
        carry_out(repl, device, plan, new, pull)
    board.plug()
    repl = connect(board)
    assert STAGE + "/" in folders(repl)
    files = files_on(repl)
    assert {path: data for path, data in files.items() if not path.startswith(STAGE)} == {
        **FILES, NOTE: files[NOTE],
    }  # fmt: skip
    put(repl, new)
    files = files_on(repl)
    assert files.pop(NOTE) and files == new
    assert folders(repl) == {"lib/"}


def test_a_damaged_file_is_detected_before_anything_changes(
    board: ReplBoard, connect: Callable[..., RawRepl]
) -> None:
    repl = connect(board)
    put(repl, FILES)
    new = {**FILES, "part.py": b"NUMBER = 4\n"}
    device = look(repl)
    plan = make_plan(repl, device, new)
    repl.run("def _b(data):\n return b'damaged'")
    with pytest.raises(DeployError, match="part.py arrived damaged, and nothing was changed"):
        carry_out(repl, device, plan, new)
    assert files_on(repl)["part.py"] == FILES["part.py"]


def test_a_file_that_shadows_a_deployed_one_is_refused(
    board: ReplBoard, connect: Callable[..., RawRepl]
) -> None:
    repl = connect(board)
    repl.run("import os; os.mkdir('part'); open('part/x.py', 'w').close()")
    with pytest.raises(DeployError, match="part/ is on the board"):
        put(repl, FILES)
    put(repl, FILES, clean=True)
    repl.run("open('module.py', 'w').close()")
    bytecode = {"module.mpy": bytes((ord("M"), 6, 0, 31))}
    with pytest.raises(DeployError, match="module.py is on the board"):
        put(repl, bytecode)


def test_deployed_modules_of_the_other_form_are_removed(
    board: ReplBoard, connect: Callable[..., RawRepl]
) -> None:
    repl = connect(board)
    put(repl, {"main.py": b"", "kit/a.py": b"", "b.py": b""})
    put(repl, {"main.py": b"", "kit.mpy": b"M\6\0\37", "b.mpy": b"M\6\0\37"})
    files = files_on(repl)
    assert set(files) == {"main.py", "kit.mpy", "b.mpy", NOTE} and folders(repl) == set()


def test_a_firmware_without_sha256_is_compared_octet_by_octet(
    board: ReplBoard, connect: Callable[..., RawRepl]
) -> None:
    repl = connect(board)
    device = look(repl)
    repl.run("_s = None")
    device = Device(**{**vars(device), "hashes": False})
    carry_out(repl, device, make_plan(repl, device, FILES), FILES)
    plan = make_plan(repl, device, FILES)
    assert not plan.write and sorted(plan.keep) == sorted(FILES)


DEVICE = Device("micropython", "1.27.0", "rp2", "Pico", 6, "/", 4096, 40960, True)


def test_bytecode_of_another_version_is_refused() -> None:
    files = {"a.mpy": b"M\6\0\37", "main.py": b""}
    check(DEVICE, files)
    for mpy, has in ((5, "version 5"), (None, "none")):
        old = Device(**{**vars(DEVICE), "version": "1.12.0", "mpy": mpy})
        with pytest.raises(DeployError, match=f"1.12.0 on the board reads {has}: flash"):
            check(old, files)
        check(old, {"main.py": b""})
    with pytest.raises(DeployError, match="runs circuitpython"):
        check(Device(**{**vars(DEVICE), "name": "circuitpython"}), files)


def test_too_little_space_is_refused_with_the_numbers() -> None:
    files = {"a.bin": bytes(40000)}
    plan = Plan(write=["a.bin"])
    with pytest.raises(DeployError, match="has 40960 bytes free, and the new files need about"):
        check_room(DEVICE, plan, files)
    check_room(Device(**{**vars(DEVICE), "free": 90000}), plan, files)
    check_room(Device(**{**vars(DEVICE), "free": None}), plan, files)


# --- the command ------------------------------------------------------------------------


@pytest.fixture
def program(tmp_path: Path) -> Path:
    folder = tmp_path / "blinker"
    folder.mkdir()
    (folder / "main.py").write_text(
        "try:\n    import hw\nexcept ImportError:\n    pass\nfrom uros.wire.framing import frame\n"
        "out = bytearray(30)\nn = frame(b'12345678', 1, 0, out)\n"
        "print('blinks ~', bytes(out[5:n - 2]))\n"
        "while True:\n    hw.wait()\n"
    )
    return folder


def run(*arguments: object, **options: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "uros", "board", *map(str, arguments)]
    return subprocess.run(
        command, capture_output=True, text=True, timeout=50, stdin=subprocess.DEVNULL
    )


def test_machine_code_for_another_processor_is_named_before_anything_is_copied(
    board: ReplBoard, program: Path, connect: Callable[..., RawRepl]
) -> None:
    (program / "fast.mpy").write_bytes(b"M\6\x2b\37" + bytes(20))
    process = run("deploy", program, "--port", board.path)
    assert process.returncode == 1
    assert "fast.mpy has machine code for xtensawin, and MicroPython 1.27" in process.stderr
    assert files_on(connect(board)) == {}


def test_bytecode_that_the_board_refuses_is_explained_on_the_console(
    board: ReplBoard, program: Path, connect: Callable[..., RawRepl]
) -> None:
    repl = connect(board)
    repl.run("f = open('old.mpy', 'wb'); f.write(b'M\\5\\0\\x1f'); f.close()")
    repl.port.close()
    (program / "main.py").write_text("import old\n")
    process = run("deploy", program, "--port", board.path, "--provided", "old", "--seconds", "1")
    assert "incompatible .mpy file" in process.stdout
    assert "uros: the bytecode on the board is of another version" in process.stderr


def test_deploy_builds_copies_starts_and_shows_the_console(board: ReplBoard, program: Path) -> None:
    process = run("deploy", program, "--port", board.path, "--seconds", "1")
    assert process.returncode == 0, process.stderr
    first, *rest = process.stdout.splitlines()
    assert first == f"{board.path}: JS with Emscripten, MicroPython 1.27.0"
    assert "  main.py" in rest and "  uros/wire/framing.py" in rest
    assert any("files copied and compared" in line for line in rest)
    assert "MPY: soft reboot" in rest
    assert "blinks ~ b'12345678'" in rest

    process = run("deploy", program, "--port", board.path, "--mpy", "--json")
    answer = json.loads(process.stdout)
    assert answer["platform"] == "webassembly" and answer["started"] is True
    assert answer["kept"] == ["main.py"] and all(path.endswith(".mpy") for path in answer["copied"])
    assert "uros/wire/framing.py" in answer["removed"]

    process = run("console", "--port", board.path, "--seconds", "1")
    assert process.returncode == 0, process.stderr


def test_a_folder_that_was_built_is_copied_as_it_is(
    board: ReplBoard, program: Path, tmp_path: Path, connect: Callable[..., RawRepl]
) -> None:
    out = tmp_path / "out"
    assert cli.main(["board", "build", str(program), str(out), "--mip"]) == 0
    assert run("deploy", out, "--port", board.path, "--no-reset").returncode == 0
    files = files_on(connect(board))
    assert files.pop(NOTE)
    assert files == {
        path.relative_to(out).as_posix(): path.read_bytes()
        for path in out.rglob("*.py")
    }  # fmt: skip


def test_a_board_of_another_port_is_refused(board: ReplBoard, program: Path) -> None:
    process = run("deploy", program, "--port", board.path, "--board", "pico-w")
    assert process.returncode == 1
    assert "pico-w has MicroPython for rp2, and this board's is for webassembly" in process.stderr


# --- secrets ----------------------------------------------------------------------------

PASSWORD = "hush-hush-42"


@pytest.fixture
def secretive(program: Path) -> Path:
    (program / "main.py").write_text(
        "import secrets\nprint('knows', len(secrets.WIFI_PASSWORD))\nwhile True:\n    hw.wait()\n"
    )
    return program


def test_secrets_are_copied_kept_by_later_deployments_and_never_printed(
    board: ReplBoard, secretive: Path, tmp_path: Path, connect: Callable[..., RawRepl]
) -> None:
    said = ""

    def files_now() -> dict[str, bytes]:
        repl = connect(board)
        files = files_on(repl)
        repl.port.close()
        return files

    def deploy(*options: object, status: int = 0) -> str:
        nonlocal said
        process = run("deploy", secretive, "--port", board.path, *options)
        said += process.stdout + process.stderr
        assert process.returncode == status, said
        return process.stdout + process.stderr

    missing = deploy("--no-console", status=1)
    assert "main.py:1 imports secrets, and the board has no secrets.py: give --secrets" in missing

    lab = tmp_path / "lab.py"
    lab.write_text(f"WIFI_PASSWORD = {PASSWORD!r}\n")
    assert "knows 12" in deploy("--secrets", lab, "--seconds", "1")
    (secretive / "more.py").write_text("A = 1\n")
    assert "knows 12" in deploy("--seconds", "1")
    answer = json.loads(deploy("--secrets", lab, "--json"))
    assert "secrets.py" in answer["kept"]

    files = files_now()
    assert files["secrets.py"] == lab.read_bytes()
    assert "secrets.py" not in files[NOTE].decode().split("\n")

    assert "no secrets.py after --clean" in deploy("--clean", "--json", status=1)
    (secretive / "main.py").write_text("print('needs none')\n")
    deploy("--clean", "--json")
    assert "secrets.py" not in files_now()
    assert PASSWORD not in said and "WIFI" not in said


def test_a_line_that_fails_while_it_takes_secrets_quotes_nothing(
    board: ReplBoard, connect: Callable[..., RawRepl], monkeypatch: pytest.MonkeyPatch
) -> None:
    repl = connect(board)
    files = {"main.py": b"", "secrets.py": f"WIFI_PASSWORD = {PASSWORD!r}\n".encode()}
    device = look(repl)
    plan = make_plan(repl, device, files)
    ran = repl.run

    def echo(code: str, seconds: float | None = None) -> str:
        if "_b(b'" in code:
            raise LineLost(f"waited 2 s for its prompt; the last was {code!r}")
        return ran(code, seconds)

    monkeypatch.setattr(repl, "run", echo)
    with pytest.raises(LineLost) as error:
        carry_out(repl, device, plan, files)
    assert str(error.value) == "the line failed while it took secrets.py"
    assert error.value.__cause__ is None and error.value.__suppress_context__


def test_a_board_without_a_file_system_is_named(
    board: ReplBoard, connect: Callable[..., RawRepl]
) -> None:
    """The port for rp2 starts without one if its flash takes none, and statvfs gives zeros."""
    repl = connect(board)
    repl.run("import os\nos.statvfs = lambda path: (0, 0, 0, 0, 0, 0, 0, 0, 0, 0)")
    with pytest.raises(DeployError, match="the board has no file system at /"):
        look(repl)


# --- one line for console and agent -------------------------------------------------------

SHARED = """
import hw
from std_msgs.msg import Int32
from uros.client import Node
from uros.drivers.console_port import ConsolePort
from uros.transport.serial import StreamTransport

class Port(ConsolePort):
    def wait(self, timeout_ms):
        hw.sleep(1)

    def write(self, data):
        hw.plain(True)
        count = super().write(data)
        hw.plain(False)
        return count

node = Node("shared", StreamTransport(Port()))
publisher = node.create_publisher(Int32, "count", 10)
count = Int32(data=0x7E037D03)  # octets that frames escape, and Ctrl-C

def tick():
    print("tick", publisher.publish(count))

node.create_timer(0.05, tick)
node.spin()
"""


def test_one_line_serves_the_agent_and_deploys_again(board: ReplBoard, program: Path) -> None:
    (program / "main.py").write_text(SHARED)

    def deploy(*options: str) -> str:
        process = run("deploy", program, "--port", board.path, "--provided", "hw", *options)
        assert process.returncode == 0, process.stderr
        return process.stdout

    for number in range(2):
        (program / "number.py").write_text(f"N = {number}\n")
        deploy("--no-console", *["--mpy"] * number)
        bus = Bus()
        server = Server(
            Agent(MemoryMiddleware(bus), Log(stream=io.StringIO()), domain_override=0),
            [SerialServer(board.path)],
        )
        thread = threading.Thread(target=server.run)
        thread.start()
        try:
            node = Node("test", Direct(MemoryMiddleware(bus)))
            counts: list[Int32] = []
            node.create_subscription(Int32, "/count", counts.append, 10)
            end = time.monotonic() + 60
            while len(counts) < 10 and time.monotonic() < end:
                node.spin_once(0.1)
            node.destroy_node()
        finally:
            server.stop()
            thread.join()
        assert {message.data for message in counts} == {0x7E037D03} and len(counts) >= 10
    assert "tick False" in deploy("--seconds", "1")  # the console shows what it prints
