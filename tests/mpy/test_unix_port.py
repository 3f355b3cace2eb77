"""Tests on MicroPython's unix port: boards by TCP and TLS, and the portable tests."""

import os
import shutil
import subprocess
import textwrap
from collections import defaultdict
from pathlib import Path

import pytest
from mpy.harness import ROOT, portable_sources, portable_tests, shared_sources, type_sources
from mpy.unix_port import UnixBoard, command
from support.agent import RunningAgent, serving
from support.certificates import Authority
from support.variants import slow_except

from uros.agent.transports.base import ServerTransport
from uros.agent.transports.certificates import Certificates
from uros.agent.transports.tcp import TcpServer
from uros.agent.transports.tls import TlsServer
from uros.agent.transports.udp import UdpServer
from uros.boards.builder.file_system import build

TRANSPORTS = {
    "udp": """
        from uros.transport.udp import UdpTransport
        TRANSPORT = UdpTransport("127.0.0.1", PORT)
        """,
    "tcp": """
        from uros.transport.tcp import TcpTransport
        TRANSPORT = TcpTransport("127.0.0.1", PORT)
        """,
    "tls": """
        from uros.transport.tls import TlsTransport
        TRANSPORT = TlsTransport("127.0.0.1", PORT, ca="ca.pem", name="localhost")
        """,
}
PROGRAM = """
    from std_msgs.msg import Int32
    from uros.client import AGENT_CONNECTED, Node

    node = Node("unix", TRANSPORT, key=7, ping_ms=100, silence_ms=2000, wait_ms=50)
    numbers = node.create_publisher(Int32, "numbers", 10)
    number = Int32()
    last_reason = ""

    def state(code):
        print("connected" if code == AGENT_CONNECTED else "not connected")

    def publish():
        if node.state == AGENT_CONNECTED:
            number.data += 1
            numbers.publish(number)

    node.on_state = state
    node.create_timer(0.02, publish)
    node.create_subscription(Int32, "numbers", lambda message: print("heard", message.data), 100)
    while True:
        node.spin_once(0.05)
        if node.connection.reason != last_reason:
            last_reason = node.connection.reason
            print("reason:", last_reason)
    """
# Portable tests that each run of the group has here; the others are slow ones.
QUICK = ("portable_float64",)


def server(kind: str, folder: Path, port: int = 0) -> ServerTransport:
    """Return the agent's end; certificates are issued once in a folder."""
    if kind == "udp":
        return UdpServer(port, "127.0.0.1")
    if kind == "tcp":
        return TcpServer(port, "127.0.0.1")
    if not (folder / "agent.pem").exists():
        Authority(folder).agent()
    return TlsServer(
        port, "127.0.0.1", Certificates(str(folder / "agent.pem"), str(folder / "agent.key"))
    )


def board_files(folder: Path, kind: str, port: int, ca: Path | None) -> Path:
    """Build a program with all passes; return the folder with the board's files."""
    program = folder / "program"
    program.mkdir()
    (program / "main.py").write_text("import app\n")
    (program / "app.py").write_text(
        f"PORT = {port}\n" + textwrap.dedent(TRANSPORTS[kind]) + textwrap.dedent(PROGRAM)
    )
    if ca is not None:
        shutil.copy(ca, program / "ca.pem")
    build(program, folder / "out", "mpy")
    return folder / "out"


@pytest.mark.parametrize("kind", slow_except(TRANSPORTS, "tls"))
def test_a_board_connects_and_finds_the_agents_successor(kind: str, tmp_path: Path) -> None:
    command()  # skips
    first = RunningAgent(server(kind, tmp_path), "memory", 0, 4)
    with serving(first):
        port = first.transport.port
        files = board_files(tmp_path, kind, port, tmp_path / "ca.pem" if kind == "tls" else None)
        board = UnixBoard(files)
        board.wait("connected")
        board.wait("heard 20")
    with board:
        board.wait("not connected")
        with serving(RunningAgent(server(kind, tmp_path, port), "memory", 0, 4)):
            board.wait("connected")
            board.wait("heard")


def test_an_agent_with_a_certificate_of_another_authority_is_refused(tmp_path: Path) -> None:
    command()  # skips
    other = Authority(tmp_path / "other")
    agent = RunningAgent(server("tls", tmp_path), "memory", 0, 4)
    with serving(agent):
        files = board_files(tmp_path, "tls", agent.transport.port, Path(other.ca))
        with UnixBoard(files) as board:
            assert "the agent's certificate is refused" in board.wait("reason: ")


def _by_file() -> list:
    functions = defaultdict(list)
    for file, function in portable_tests():
        functions[file].append(function)
    return [
        pytest.param(
            file,
            names,
            id=file.relative_to(ROOT / "tests" / "unit").as_posix(),
            marks=() if file.stem in QUICK else pytest.mark.slow,
        )
        for file, names in functions.items()
    ]


@pytest.mark.parametrize(("file", "functions"), _by_file())
def test_portable(file: Path, functions: list[str], tmp_path: Path) -> None:
    micropython = command("main.py")
    sources = {**portable_sources(), **shared_sources(), **type_sources(file)}
    sources[file.name] = file.read_text(encoding="utf-8")
    calls = "".join(f"tests.{function}()\nprint({function!r})\n" for function in functions)
    sources["main.py"] = f"import {file.stem} as tests\n{calls}"
    for path, text in sources.items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(text, encoding="utf-8")
    done = subprocess.run(
        micropython, cwd=tmp_path, env=dict(os.environ, MICROPYPATH=f"{tmp_path}:.frozen"),
        capture_output=True, text=True, timeout=200,
    )  # fmt: skip
    printed = [line for line in done.stdout.splitlines() if line in functions]
    assert done.returncode == 0, done.stdout + done.stderr
    assert printed == functions
