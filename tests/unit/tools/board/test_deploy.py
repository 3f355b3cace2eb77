"""uros board deploy, console, index and list --ports: what is said where there is no board."""

import os
import re
import subprocess
import sys
import termios
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from uros.boards.deploy.console import ConsoleText
from uros.tools import cli
from uros.tools.board import console
from uros.wire.framing import frame, frame_size


@pytest.fixture
def program(tmp_path: Path) -> str:
    folder = tmp_path / "blinker"
    folder.mkdir()
    (folder / "main.py").write_text("print('blinks')\n")
    return str(folder)


@pytest.fixture
def line() -> Iterator[tuple[int, str]]:
    """A line with nobody on it; the board's end, and the device."""
    master, slave = os.openpty()
    tty.setraw(slave)
    yield master, os.ttyname(slave)
    os.close(slave)
    os.close(master)


@pytest.fixture
def fail(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Runs a command that is to fail; what it says."""

    def run(*arguments: str) -> str:
        assert cli.main(["board", *arguments]) == 1
        return capsys.readouterr().err

    return run


def test_help_is_cheap() -> None:
    probe = (
        "import sys\nfrom uros.tools import cli\n"
        "assert cli.main(['board', 'deploy', '--help']) == 0\n"
        "print({'uros.boards', 'uros.interfaces', 'uros.middleware', 'ctypes', 'serial'}"
        " & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True)
    *text, heavy = done.stdout.splitlines()
    assert text[0].startswith("usage: uros board deploy") and heavy == "set()"


@pytest.mark.parametrize("verb", [["deploy"], ["build"]])
@pytest.mark.parametrize(
    ("board", "reason"),
    [
        ("uno", "2 kB of RAM"), ("mega2560", "8 kB of RAM"), ("Arduino MEGA", "8 kB of RAM"),
        ("due", "no port for its SAM3X8E"), ("spresense", "no port for its CXD5602"),
    ],
)  # fmt: skip
def test_boards_that_cannot_run_uros_are_rejected_with_the_reason(
    verb: list[str], board: str, reason: str, program: str, tmp_path: Path, fail: Callable[..., str]
) -> None:
    more = [str(tmp_path / "out")] if verb == ["build"] else ["--port", "/dev/none"]
    said = fail(*verb, program, *more, "--board", board)
    assert reason in said and "cannot run this" in said and "Pico" in said
    assert not (tmp_path / "out").exists()


def test_an_unknown_board_has_a_suggestion(program: str, fail: Callable[..., str]) -> None:
    assert "did you mean 'pico_w'" in fail("deploy", program, "--board", "pico_ww")


def test_real_boards_are_listed_with_the_reason_of_a_missing_port(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert cli.main(["board", "list", "--ports"]) == 0
    out = capsys.readouterr().out
    for word in ("renesas-ra", "esp32", "rp2", "stm32", "hackerboard", "2 kB of RAM", "CXD5602"):
        assert word in out


def test_without_a_port_the_ports_are_listed(
    program: str, fail: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from uros.tools.doctor import serial

    monkeypatch.setattr(serial, "ports", lambda: ["/dev/ttyACM3", "/dev/ttyUSB1"])
    said = fail("deploy", program)
    assert "there are /dev/ttyACM3, /dev/ttyUSB1" in said
    assert f"uros board deploy {program} ... --port /dev/ttyACM3" in said
    monkeypatch.setattr(serial, "ports", list)
    assert "there is no serial port: plug the board in" in fail("deploy", program)


def test_a_missing_port(program: str, fail: Callable[..., str]) -> None:
    port = "/dev/ttyACM77"
    assert f"uros: {port} does not exist" in fail("deploy", program, "--port", port)


def test_a_file_is_no_port(program: str, tmp_path: Path, fail: Callable[..., str]) -> None:
    (tmp_path / "file").touch()
    assert "is a file, not a serial device" in fail(
        "deploy", program, "--port", str(tmp_path / "file")
    )


def test_a_port_in_use_names_the_agent(
    program: str, line: tuple[int, str], fail: Callable[..., str]
) -> None:
    holder = subprocess.Popen(
        [sys.executable, "-m", "uros", "agent", "serial", "--dev", line[1], "-m", "memory",
         "--stop-at-eof"],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        assert holder.stdout is not None
        for text in holder.stdout:
            if "running" in text:
                break
        said = fail("deploy", program, "--port", line[1])
        assert str(holder.pid) in said and "agent" in said
    finally:
        holder.kill()
        holder.communicate()


@pytest.mark.parametrize(
    ("sent", "said"),
    [
        (b"", "nothing answers: the board has no MicroPython"),
        (b"Arduino sketch: 21 degrees\r\n" * 3, "but text ('Arduino sketch: 21 degrees')"),
        (b"\x93\xfe\x81" * 30, "bytes that are no text: another baud rate"),
        ("frame", "XRCE frames come: a micro-ROS program has this line"),
    ],
)
def test_data_in_place_of_a_prompt_is_classified(
    sent: bytes | str,
    said: str,
    program: str,
    line: tuple[int, str],
    fail: Callable[..., str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from uros.boards.deploy import raw_repl

    data = framed(b"\x80\x00\x00\x00hello") * 3 if isinstance(sent, str) else sent
    monkeypatch.setattr(raw_repl.RawRepl.enter, "__defaults__", (0.1, True, None))
    written = termios.tcflush
    # Opening drops what came before, so the board speaks right after that.
    monkeypatch.setattr(
        termios, "tcflush", lambda fd, which: (written(fd, which), os.write(line[0], data))
    )
    assert said in fail("deploy", program, "--port", line[1])


def framed(payload: bytes) -> bytes:
    out = bytearray(frame_size(payload))
    return bytes(out[: frame(payload, 1, 0, out)])


# --- the console ------------------------------------------------------------------------


class Script:
    """A port that gives what it is told to, an error where that is one, and nothing after."""

    def __init__(self, *steps: bytes | OSError) -> None:
        self.steps = list(steps)
        self.opened = 0
        self.sent = b""

    def open(self) -> None:
        self.opened += 1

    def close(self) -> None: ...

    def wait(self, timeout_ms: int) -> None: ...

    def read(self, size: int) -> bytes | None:
        if not self.steps:
            raise KeyboardInterrupt
        step = self.steps.pop(0)
        if isinstance(step, OSError):
            raise step
        return step

    def write(self, data: bytes | bytearray | memoryview) -> int:
        self.sent += bytes(data)
        return len(data)


def test_the_console_continues_after_a_reconnection(capsys: pytest.CaptureFixture[str]) -> None:
    port = Script(b"before\r\n", OSError(5, "gone"), b"after ~", b"", b"\r\n")
    console.show(port, "/dev/ttyX", None)
    done = capsys.readouterr()
    assert done.out == "before\nafter ~\n\n" and port.opened == 1
    assert "the line is lost (gone)" in done.err and "/dev/ttyX is back" in done.err


def test_the_console_counts_frames_and_suggests_an_agent(
    capsys: pytest.CaptureFixture[str],
) -> None:
    console.show(Script(b"a" + framed(b"12345678") * 2 + b"b"), "/dev/ttyX", None)
    done = capsys.readouterr()
    assert done.out == "ab\n"
    assert "2 XRCE frames were not printed" in done.err
    assert "uros agent serial --dev /dev/ttyX" in done.err


def test_keys_go_to_the_board_and_some_leave(line: tuple[int, str]) -> None:
    keys, typed = os.pipe()
    try:
        port = Script(b"", b"", b"", b"")
        text = ConsoleText()
        os.write(typed, b"print(1)\r\x18")
        with pytest.raises(KeyboardInterrupt):
            console._carry(port, "x", text, keys, None)
        assert port.sent == b"print(1)\r\x03"
        for leave in (b"\x03", b"\x1d"):
            os.write(typed, leave)
            console._carry(Script(b"", b""), "x", text, keys, None)
    finally:
        os.close(keys)
        os.close(typed)


@pytest.mark.slow
def test_an_index_is_written_and_the_next_step_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "mip"
    assert cli.main(["board", "index", str(out), "--py"]) == 0
    said, progress = capsys.readouterr()
    assert f"mip install --index {out} uros" in said and "uros-parameters" in said
    assert re.match(r"0 of \d{3} packages\n", progress)
    assert (out / "package" / "py" / "sensor_msgs" / "msg" / "Imu" / "latest.json").is_file()
    assert not (out / "package" / "6").exists()


def test_a_module_of_the_boards_firmware_can_be_named(
    tmp_path: Path, fail: Callable[..., str], capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "own"
    folder.mkdir()
    (folder / "main.py").write_text("import ulab\n")
    out = str(tmp_path / "out")
    assert "(--provided ulab)" in fail("build", str(folder), out)
    assert cli.main(["board", "build", str(folder), out, "--provided", "ulab", "--mip"]) == 0
    said = capsys.readouterr().out
    assert f"mpremote connect PORT mip install --target . {out}/package.json" in said
    assert (tmp_path / "out" / "package.json").is_file()
