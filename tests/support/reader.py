"""A reader who follows a page: saves its files, runs its commands and programs, compares output.

Commands that run until Ctrl-C are of two sorts. Those that show something (``uros topic hz``) are
interrupted after their first line, or after the lines that the page shows. Those that serve (an
agent, a board, a program with ``spin()``) run until the section of the page ends.
"""

import ast
import os
import queue
import re
import shlex
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import ExitStack
from pathlib import Path

from support.agent import running_agent
from support.pages import Block
from support.paths import ROOT
from uros.boards.virtual.engine.runner import RunningBoard

SECONDS = 120.0  # generous: a busy machine, and discovery
PORTS = ("8888", "8889", "9100", "8000", "10001")
FREE = {
    "node": "node = uros.Node('reader')",
    "transport": "transport = StreamTransport(uart)",
    "uart": "uart = UART(2, 115200, tx=17, rx=16, timeout=0)",
}
AGENT = "uros agent (?!status|check|ament)"
NETWORKS = {
    "network",
    "socket",
    *[f"uros.transport.{n}" for n in ("udp", "tcp", "wlan", "discovery")],
}
BOARD_IMPORTS = ("machine", "network", "pyb", "uros.client", "uros.transport", "uros.drivers")


class Wrong(AssertionError):
    """A block of a page does not do what the page says."""


class Process:
    """A command that runs until it is interrupted; ``said`` has the lines so far."""

    def __init__(self, words: str, folder: Path, environment: dict[str, str]) -> None:
        self.words = words
        self.said: list[str] = []
        self._new: queue.Queue[str | None] = queue.Queue()
        self.popen = subprocess.Popen(
            ["bash", "-c", f"exec {words}"], cwd=folder, env=environment, text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            start_new_session=True,
        )  # fmt: skip
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        assert self.popen.stdout
        with self.popen.stdout as lines:
            for line in lines:
                self.said.append(line.rstrip("\n"))
                self._new.put(line)
        self._new.put(None)

    def wait_line(self, seconds: float) -> bool:
        """Wait for another line; False if there is none, or the command has ended."""
        try:
            return self._new.get(timeout=seconds) is not None
        except queue.Empty:
            return False

    def type(self, text: str) -> None:
        """Type a line."""
        assert self.popen.stdin
        self.popen.stdin.write(text + "\n")
        self.popen.stdin.flush()

    def end(self) -> None:
        """Press Ctrl-C. Raises Wrong if the command had failed, or does not end."""
        if self.popen.poll() is None:
            os.killpg(self.popen.pid, signal.SIGINT)
        try:
            status = self.popen.wait(SECONDS)
        except subprocess.TimeoutExpired:
            os.killpg(self.popen.pid, signal.SIGKILL)
            status = self.popen.wait()
        self._thread.join(SECONDS)
        assert self.popen.stdin
        self.popen.stdin.close()
        if status == -signal.SIGKILL:
            raise Wrong(f"{self.words}: does not end after Ctrl-C")
        if status not in (0, 130, -signal.SIGINT):
            raise Wrong(f"{self.words}: exit status {status}\n" + "\n".join(self.said[-30:]))


class Reader:
    """Follows the blocks of a page in a folder of its own.

    Args:
        folder: The folder where commands run.
        domain: The ROS domain.
        engine: The interpreter of virtual boards that the page's commands start, "" for theirs.
    """

    def __init__(self, folder: Path, domain: int, engine: str = "") -> None:
        self.folder = folder
        self.domain = domain
        self.engine = engine
        self.replaced = {port: str(_free_port()) for port in PORTS}
        for path in ("/tmp/", "/etc/", "/var/lib/"):
            self.replaced[path] = f"{folder}/"
        runtime = folder / ".run"  # of this test alone: `uros agent status` looks there
        runtime.mkdir(mode=0o700)
        path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
        self.environment = dict(
            os.environ, PATH=path, ROS_DOMAIN_ID=str(domain), XDG_RUNTIME_DIR=str(runtime),
            TMPDIR=str(runtime), COLUMNS="80", PYTHONUNBUFFERED="1", PYTHONPATH=str(ROOT / "tests"),
        )  # fmt: skip
        self.serving: list[Process] = []
        self.section = ""
        self.earlier: list[Block] = []  # Python blocks of this section

    def close(self) -> None:
        """End all that runs."""
        serving, self.serving = self.serving[::-1], []
        try:
            while serving:
                serving.pop(0).end()
        finally:
            for process in serving:
                os.killpg(process.popen.pid, signal.SIGKILL)

    def follow(self, blocks: list[Block]) -> None:
        """Do what the blocks say. Raises Wrong, with the line of the page."""
        try:
            for number, block in enumerate(blocks):
                after = blocks[number + 1] if number + 1 < len(blocks) else None
                expected = after.text if after is not None and after.kind == "output" else ""
                expected = block.marker("prints") or expected
                try:
                    self._follow(block, expected)
                except (Wrong, TimeoutError, OSError, RuntimeError) as error:
                    raise Wrong(f"line {block.line}: {error}") from error
        finally:
            self.close()

    def _follow(self, block: Block, expected: str) -> None:
        if block.section != self.section:
            self.close()
            self.section, self.earlier = block.section, []
        for name, value in block.markers:
            if name == "device":
                self._plug_in(*[part.strip() for part in value.split("=")])
        is_output = block.kind in ("output", "example") and block.marker("file") is None
        if is_output or block.marker("not run") is not None:
            return
        for name, value in block.markers:
            if name in ("setup", "beside"):
                self._shell(self._here(value), "")
        if block.kind == "type":
            self.serving[-1].type(block.text)
            return
        text = self._text(block)
        if (name := block.marker("file")) is not None:
            path = self.folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        elif block.kind == "shell":
            self._shell(text, expected)
        else:
            if (given := block.marker("given")) is not None:
                text = f"{given}\n{text}"
            if (steps := block.marker("after")) is not None:
                text = self._text(self.earlier[-int(steps)]) + text
            self.earlier.append(block)
            self._python(block, text, expected)

    def _text(self, block: Block) -> str:
        text = block.text
        for name, value in block.markers:
            if name == "replace":
                parts = value.replace("\\n", "\n").partition("->")
                old, new = parts[0].strip(" "), parts[2].strip(" ")
                if old not in text:
                    raise Wrong(f"nothing to replace: {old}")
                text = text.replace(old, new)
        return self._here(text)

    def _here(self, text: str) -> str:
        """Return a text with the ports, devices and folders of this test."""
        for old, new in self.replaced.items():
            text = re.sub(rf"(?<!\w){re.escape(old)}", new, text)
        # Nothing is sent to other machines, whose addresses the page has as examples.
        return re.sub(r"\b192\.168\.\d+\.\d+\b", "127.0.0.1", text)

    def _plug_in(self, path: str, board: str) -> None:
        """Have a virtual board at a serial device of the page."""
        link = self.folder / Path(path).name
        self.replaced[path] = str(link)
        process = self._start(f"uros board run {board} --no-agent --link {link}")
        self._wait(process, lambda: link.exists())

    # --- commands -----------------------------------------------------------------------------

    def _shell(self, text: str, expected: str) -> None:
        waiting: list[str] = []  # finite commands since the last one that serves
        for words in shlex_lines(text):
            if not serves(words, self.folder):
                waiting.append(words)
                continue
            self._run(waiting, "")
            waiting = []
            process = self._start(self._with_options(words))
            self._wait(process, lambda process=process: ready(process))
        self._run(waiting, expected)

    def _run(self, commands: list[str], expected: str) -> None:
        """Run finite commands until all succeed and the expected lines were printed."""
        deadline = time.monotonic() + SECONDS
        while True:
            done, printed = self._try(commands, expected)
            if done:
                return
            if time.monotonic() > deadline:
                break
        printed += [process.said for process in self.serving if expected]
        heard = "\n".join(line for lines in printed for line in lines[-30:])
        what = f"expected:\n{expected}" if expected else "a command failed"
        raise Wrong(f"{'; '.join(commands)}\n{what}\nbut it printed:\n{heard}")

    def _with_options(self, words: str) -> str:
        """Return a command with the options that the test needs: the engine, the test's domain."""
        if self.engine and words.startswith("uros board run "):
            return f"{words} --engine {self.engine}"
        if re.match(AGENT, words) and "--domain" not in words:
            return f"{words} --domain {self.domain}"
        return words

    def _try(self, commands: list[str], expected: str) -> tuple[bool, list[list[str]]]:
        """Run commands once; return whether all went well, and what each printed."""
        printed, statuses = [], []
        for words in commands:
            if shows(words):
                process = Process(words, self.folder, self.environment)
                enough = time.monotonic() + SECONDS / 4
                while time.monotonic() < enough and process.popen.poll() is None:
                    got_one = process.wait_line(1.0) or bool(process.said)
                    if got_one and (not expected or matches(expected, process.said)):
                        break
                statuses.append(0 if process.said else 1)
                process.end()
                printed.append(process.said)
            else:
                done = subprocess.run(
                    ["bash", "-c", words], cwd=self.folder, env=self.environment, text=True,
                    stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                    timeout=SECONDS,
                )  # fmt: skip
                statuses.append(done.returncode)
                printed.append(done.stdout.splitlines())
        everything = [line for lines in printed for line in lines]
        seen = [everything, *[process.said for process in self.serving]]
        well = not any(statuses) and (not expected or any(matches(expected, said) for said in seen))
        if not well:
            for process in self.serving:  # gives the others time to print
                process.wait_line(0.2)
        return well, printed

    def _start(self, words: str) -> Process:
        process = Process(words, self.folder, self.environment)
        self.serving.append(process)
        return process

    def _wait(self, process: Process, done) -> None:
        deadline = time.monotonic() + SECONDS
        while not done():
            if process.popen.poll() is not None or time.monotonic() > deadline:
                raise Wrong(f"{process.words}: does not start\n" + "\n".join(process.said))
            process.wait_line(0.2)

    # --- programs -----------------------------------------------------------------------------

    def _python(self, block: Block, text: str, expected: str) -> None:
        spec = block.marker("board")
        if spec is None and block.marker("host") is None and of_a_board(text):
            spec = board_for(text)
        if spec is not None:
            self._on_a_board(text, spec.split(), expected)
            return
        missing = free_names(text) & {"node"}
        prelude = "import uros\n" + "".join(FREE[name] + "\n" for name in sorted(missing))
        file = self.folder / "block.py"
        file.write_text((prelude if missing else "") + text)
        done = subprocess.run(
            [sys.executable, "-m", "support.bounded", str(file)],
            cwd=self.folder, env=self.environment, text=True, timeout=SECONDS,
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )  # fmt: skip
        if done.returncode or (expected and not matches(expected, done.stdout.splitlines())):
            raise Wrong(f"exit status {done.returncode}, printed:\n{done.stdout}")

    def _on_a_board(self, text: str, spec: list[str], expected: str) -> None:
        """Run a program, or a part of one, on a virtual board in MicroPython."""
        name, *plugs = spec
        folder = self.folder / "block"
        folder.mkdir(exist_ok=True)
        (folder / "main.py").write_text(for_a_board(text))
        said: list[str] = []
        with ExitStack() as stack:
            board = stack.enter_context(RunningBoard(folder, name, "micropython", plugs=plugs))
            stack.enter_context(running_agent("serial", "memory", device=board.path))
            while "the block has run" not in said:
                try:
                    said.append(board.console.get(timeout=SECONDS))
                except queue.Empty:
                    raise Wrong("the block does not end; printed:\n" + "\n".join(said)) from None
                if re.match(r"\w*(Error|Exception)\b", said[-1]):
                    raise Wrong("on the board:\n" + "\n".join(said))
        if expected and not matches(expected, said):
            raise Wrong("the board printed:\n" + "\n".join(said))


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def shlex_lines(text: str) -> list[str]:
    """Return the commands of a block: joined lines, without comments."""
    commands = []
    for line in text.replace("\\\n", " ").splitlines():
        words = shlex.split(line, comments=True)
        if words:
            commands.append(re.sub(r"\s+#.*$", "", line).strip())
    return commands


def serves(words: str, folder: Path) -> bool:
    """Whether a command runs until Ctrl-C and others need it meanwhile."""
    if re.match(rf"{AGENT}|uros (board run |fleet |demo)", words):
        return "--seconds" not in words
    if re.match(r"uros run (talker|listener|trigger_service)|uros bag play .*--loop", words):
        return True
    program = re.match(r"python3? ([\w/]+\.py)", words)
    return program is not None and ".spin()" in (folder / program[1]).read_text()


def shows(words: str) -> bool:
    """Whether a command shows something until Ctrl-C."""
    if re.match(r"uros topic echo ", words):
        return "--once" not in words
    if re.match(r"uros topic pub ", words):
        return not re.search(r"--once|-1|--times|-t \d", words)
    if re.match(r"uros image view|uros plot ", words):
        return True
    return bool(re.match(r"uros topic hz |uros trace(?! \S+\.pcapng)", words)) or bool(
        re.search(r" --watch | --follow\b", words + " ")
    )


def ready(process: Process) -> bool:
    """Whether a command that serves has begun to."""
    if process.words.startswith("uros agent"):
        return any("running..." in line or "pseudoterminal" in line for line in process.said)
    if process.words.startswith("uros board run"):
        return any("runs on" in line for line in process.said)
    return True


def matches(expected: str, said: list[str]) -> bool:
    """Whether lines have all expected lines, in order; numbers and spaces may differ."""
    lines = iter([" ".join(line.split()) for line in said])
    return all(
        any(re.fullmatch(pattern_of(row), line) for line in lines)
        for row in expected.splitlines()
        if row.strip()
    )


def pattern_of(row: str) -> str:
    """Return the pattern of an expected line; ``…`` stands for anything."""
    pattern = ""
    for part in re.split(r"(…|0x[0-9A-F]+|-?\d+(?:\.\d+)?)", " ".join(row.split())):
        if part == "…":
            pattern += ".*"
        elif part.startswith("0x"):
            pattern += "0x[0-9A-F]+"
        elif re.fullmatch(r"-?\d+(\.\d+)?", part):
            pattern += r"-?\d+(?:\.\d+)?"
        else:
            pattern += re.escape(part)
    return pattern


def modules_of(text: str) -> set[str]:
    """Return the modules that a program imports."""
    names = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom):
            names.add(node.module or "")
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    return names


def board_for(text: str) -> str:
    """Return the virtual board that has what a program imports, with its plugs."""
    names = modules_of(text)
    if "uros.drivers.port" in names:
        return "ra6m5_sensor_node"
    return "esp32_publisher wlan" if names & NETWORKS else "esp32_publisher"


def of_a_board(text: str) -> bool:
    """Whether a program is for a board, by its imports."""
    names = modules_of(text)
    if any(
        name == "uros" or name.startswith(("uros.interfaces.", "uros.boards")) for name in names
    ):
        return False
    return any(name.startswith(BOARD_IMPORTS) or name.endswith((".msg", ".srv")) for name in names)


def free_names(text: str) -> set[str]:
    """Return the names that a part of a program uses and does not define."""
    used, defined = set(), set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Name):
            (defined if isinstance(node.ctx, ast.Store) else used).add(node.id)
        elif isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            defined.add(node.name)
        elif isinstance(node, (ast.Import, ast.ImportFrom)):
            defined |= {(alias.asname or alias.name).split(".")[0] for alias in node.names}
    return used - defined


def for_a_board(text: str) -> str:
    """Return a program that says when it has run, made from a part of one."""
    missing = free_names(text)
    prelude = ""
    if "node" in missing:
        missing |= {"transport", "Node"}
    if "transport" in missing:
        prelude += "from machine import UART\n" + FREE["uart"] + "\n"
        prelude += "from uros.transport.serial import StreamTransport\n" + FREE["transport"] + "\n"
    if "Node" in missing:
        prelude += "from uros.client import Node\n"
    if "node" in missing:
        prelude += "node = Node('reader', transport)\n"
    text = re.sub(r"^node\.spin\(\)$", "", text, flags=re.M)
    if "UART(2," in prelude + text and "node = " in prelude + text:  # the line to the agent
        text += "\nwhile node.state != 2:\n    node.spin_once(0.1)\nnode.spin_some(0.2)"
    return prelude + text + "\nprint('the block has run')\n"
