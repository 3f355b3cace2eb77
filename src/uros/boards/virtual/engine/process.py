"""A virtual board as a process: hardware, firmware and fault injection.

`uros.boards.virtual.engine.runner` starts ``python -m uros.boards.virtual.engine.process OPTIONS``;
OPTIONS is a JSON object with the fields of `Options`. Commands are JSON lines on stdin::

    {"do": "happen", "spec": "sht3x:nack"}   answered by an event "happened"
    {"do": "reset"}                          the board's reset button
    {"do": "heap"}                           answered by an event "heap" (engine micropython)

Events are JSON lines on stdout::

    {"event": "ready", "path": …, "happenings": […], "faults": […], "baud": …}
                                             the serial line exists, and has this baud rate until a
                                             program sets another; the program starts
    {"event": "baud", "board": …, "line": …} the UART behind the serial line and the program that
                                             has the line open use these different baud rates
    {"event": "line", "open": …}             whether a program on the host has the serial line open,
                                             at the start and when it changes; on Linux alone
    {"event": "usb", "state": …, "error": …} the state of the USB line has changed
    {"event": "console", "line": …}          a line that the program printed
    {"event": "read", "address": …, "ns": …} the end of an I2C read, by the monotonic clock; sent
                                             when the program next waits
    {"event": "happened", "spec": …, "error": …, "faults": […]}
                                             the active faults after a command "happen"
    {"event": "part", "name": …, "shows": …} the visible state of a part has changed
    {"event": "heap", "used": …, "peak": …, "base": …}
    {"event": "reset", "cause": …}           the program starts anew; why, by reset_cause()
    {"event": "asleep", "ms": …}             the program has called machine.deepsleep; 0: for ever
    {"event": "ended", "traceback": …}       the program has ended; the board stays
    {"event": "failed", "error": …}          the start has failed; the process ends with status 1

The process ends at the end of stdin, so it does not outlive its parent.
"""

from __future__ import annotations

import errno
import json
import os
import signal
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any, Final

from ....interfaces import InterfaceError, add_folder
from ...builder import secrets_file
from ...builder.errors import BuildError
from ...builder.file_system import build
from ..hardware.board import FaultError, VirtualBoard
from ..hardware.clock import BoardClock
from ..hardware.parts import Part
from ..hardware.peripherals import PeripheralError
from ..hardware.resets import HARD, WATCHDOG
from ..hardware.usb import ATTACHED, TELLS_OPEN
from ..models.catalog import BoardError
from ..models.catalog import find as find_board
from . import cpython
from .advice import module_advice
from .console import Console
from .cores import Mail
from .micropython import MicroPythonEngine, NoMicroPython, find
from .syscalls import BoardHost, Reset

_MOST_READS: Final = 64
_POLL_SECONDS: Final = 0.2
_SHORTEST_SECONDS: Final = 0.001  # of a poll that waits for the watchdog
_STOP_SECONDS: Final = 2.0


@dataclass(frozen=True)
class Options:
    """What to run, and how.

    Attributes:
        program: The firmware's folder.
        board: The name of the board's model.
        engine: "cpython" or "micropython".
        form: The form of the files on the board (see `uros.boards.builder.file_system.build`).
        link: Where the link to the USB line is created; None chooses a place.
        seed: Seed of all random values of the board.
        happen: Faults and actions before the program starts.
        reads: Whether I2C reads are sent as events.
        measure: Whether the peak of the heap is measured.
        plugs: Peripherals that are attached to the board.
        provided: Further modules that the board has, and whose import is no error of the build.
        interfaces: Folders of interface definitions.
        speed: The speed of the board's time; 1.0 is real time.
        agent: Host and port of the agent that the program looks for in its network.
        address: The board's own address on this host, "" for any.
        secrets: The file of the program's module ``secrets``; None: secrets.py in its folder, if
            there is one.
    """

    program: str
    board: str
    engine: str = "cpython"
    form: str = "py"
    link: str | None = None
    seed: int = 0
    happen: list[str] = field(default_factory=list)
    reads: bool = False
    measure: bool = False
    plugs: list[str] = field(default_factory=list)
    provided: list[str] = field(default_factory=list)
    interfaces: list[str] = field(default_factory=list)
    speed: float = 1.0
    agent: tuple[str, int] = ("127.0.0.1", 8888)
    address: str = ""
    secrets: str | None = None


class _SecondCore:
    """The second core: an interpreter in a thread of its own, which the program starts."""

    def __init__(self, process: BoardProcess) -> None:
        self.mail = Mail()
        self._process = process
        self._lock = threading.Lock()  # of the engine
        self._host: BoardHost | None = None
        self._engine: MicroPythonEngine | None = None
        self._thread: threading.Thread | None = None

    def start(self, root: Path, name: str) -> None:
        """Run a module of the file system ``root`` on the second core.

        Raises:
            OSError: The second core runs already (EBUSY).
        """
        if self._thread is not None:
            raise OSError(errno.EBUSY, "the second core runs already")
        console = Console(lambda line: self._process.send("console", line=line))

        def ended(traceback: str) -> None:
            console.forget()  # the last error is shown in full
            console.print(traceback)

        host = self._host = BoardHost(
            self._process.board, console.print, ended, lambda *_: None, lambda _: None,
            mail=self.mail,
        )  # fmt: skip

        def run() -> None:
            try:
                if self._process.options.engine == "cpython":
                    cpython.run_core(root, host, name)
                else:
                    self._run_micropython(root, host, name)
            except Reset:
                pass

        self._thread = threading.Thread(target=run, name="second core", daemon=True)
        self._thread.start()

    def _run_micropython(self, root: Path, host: BoardHost, name: str) -> None:
        with self._lock:
            if self._host is not host:
                return  # stopped before the engine was created
            engine = self._engine = MicroPythonEngine(root, host, core=name)
        try:
            engine.run()
        finally:
            with self._lock:
                self._engine = None
                engine.close()

    def stop(self) -> None:
        """End the program of the second core, as a reset does."""
        thread, self._thread = self._thread, None
        if thread is None or self._host is None:
            return
        self._host.stop()
        with self._lock:
            self._host = None
        self.kill()
        # A thread that computes without a system call no longer affects the board.
        thread.join(_STOP_SECONDS)

    def kill(self) -> None:
        """End the process of the second core, if it has one."""
        with self._lock:
            if self._engine is not None:
                self._engine.stop()


class BoardProcess:
    """The process of a board; the module docstring has the commands and events.

    Args:
        options: What to run.
        commands: The file descriptor from which commands are read.
        events: The file descriptor to which events are written.

    Raises:
        BoardError: There is no such board.
        PeripheralError: A peripheral cannot be attached.
        OSError: The USB line cannot be created.
    """

    def __init__(self, options: Options, commands: int, events: int) -> None:
        self.options = options
        self._commands = commands
        self._events = events
        self._lock = threading.Lock()  # of the events
        self._ending = threading.Lock()  # of _micropython, and of the end
        self._ended_by: int | None = None  # the exit status
        self._folder = tempfile.TemporaryDirectory(prefix="uros-board-")
        self._console = Console(lambda line: self.send("console", line=line))
        self._second = _SecondCore(self)
        self._reads: list[tuple[int, int]] = []  # not sent yet
        self._micropython: MicroPythonEngine | None = None
        self._base: int | None = None  # the heap before the program
        self._heap_asked = False  # before the engine existed
        self._pressed: int | None = None  # the cause of a reset that no signal has delivered yet
        self._told_open: bool | None = None  # whether the serial line is open, as sent last
        self._told_baud = 0  # the board's rate that was sent last
        self._shown: dict[str, str] = {}  # the visible state of each part, as sent last
        try:
            link = None if options.link is None else Path(options.link)
            self.board = VirtualBoard(
                find_board(options.board), BoardClock(speed=options.speed), link, options.seed,
                plugs=options.plugs, agent=(options.agent[0], options.agent[1]),
                address=options.address, changed=self._send_part,
            )  # fmt: skip
        except BaseException:
            self._folder.cleanup()
            raise

    def run(self) -> None:
        """Run the board; the process ends with the commands, so this does not return.

        Raises:
            FaultError: A fault or action of the options does not exist.
            NoMicroPython: MicroPython or Node was not found.
            InterfaceError: A folder of interface definitions is invalid.
            BoardError: The host refused the board's USB bridge.
            BuildError: The program cannot be built.
            OSError: A file cannot be read or written.
        """
        options, board = self.options, self.board
        for spec in options.happen:
            board.happen(spec)
        if options.engine == "micropython":
            find()
        for folder in options.interfaces:
            add_folder(folder)
        root = Path(self._folder.name) / "flash"
        # Bytecode, and programs whose memory is measured, are built as for a real board.
        checked = options.form == "py" and not options.measure
        provided = ["second_core", *options.provided]
        build(
            Path(options.program), root, options.form, checked=checked, provided=provided,
            cached=True,
        )  # fmt: skip
        secrets = secrets_file.read_secrets(
            Path(options.program), None if options.secrets is None else Path(options.secrets)
        )
        if secrets is not None:
            (root / secrets_file.FILE).write_bytes(secrets)
        elif place := secrets_file.first_import(Path(options.program)):
            raise BuildError(
                f"{place} imports secrets: put a {secrets_file.FILE} beside main.py, or name a file"
                " (--secrets FILE)"
            )
        if options.reads:
            for bus in board.i2c.values():
                bus.on_read = self._read
        host = self._host = BoardHost(
            board, self._console.print, self._ended, self._heap, self._usb, self._send_reads,
            self._second.mail, lambda name: self._second.start(root, name),
        )  # fmt: skip
        for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
            signal.signal(number, self._on_signal)
        signal.signal(signal.SIGUSR1, lambda *_: self._on_press(host))
        while not board.usb_inside and board.usb.state == ATTACHED:
            board.usb.wait(1.0)  # the bridge chip has power before the program starts
            if board.usb.error:
                raise BoardError(f"the board's USB: {board.usb.error}")
        happenings = [happening.spec for happening in (*board.acts(), *board.faults())]
        self._send_parts()  # before "ready": a parent that waits for it may ask for their state
        self.send(
            "ready", path=str(board.usb.path), happenings=happenings, faults=self._faults(),
            baud=board.usb.baud,
        )  # fmt: skip
        host.usb_state()
        threading.Thread(target=self._read_commands, name="commands", daemon=True).start()
        threading.Thread(target=self._poll, name="parts", daemon=True).start()
        while True:
            try:
                self._run_program(root, host)
                while True:
                    signal.pause()
            except Reset as reset:
                self._start_anew(reset, host)

    def _start_anew(self, reset: Reset, host: BoardHost) -> None:
        """Reset the board; before, let it sleep until it wakes or its reset button is pressed."""
        pressed: Reset | None = reset
        while pressed is not None:
            host.begin_reset()
            self._console.forget()
            self._second.stop()
            reset, pressed = pressed, None
            try:
                host.reset(reset.cause)
                if reset.sleep_ms is not None:
                    self.send("asleep", ms=reset.sleep_ms)
                    while not reset.sleep_ms:
                        signal.pause()
                    self.board.clock.sleep_us(reset.sleep_ms * 1000)
            except Reset as button:
                pressed = button
        self.send("reset", cause=reset.cause)

    def _run_program(self, root: Path, host: BoardHost) -> None:
        if self.options.engine == "cpython":
            os.chdir(root)
            cpython.run(root, host)
            return
        with self._ending:
            self._base = None
            engine = self._micropython = MicroPythonEngine(root, host, self.options.measure)
            if self._heap_asked:
                self._heap_asked = False
                engine.ask_heap()
        try:
            engine.run()
        finally:
            with self._ending:
                self._micropython = None
                engine.close()
        self._ended("MicroPython has ended\n")

    # --- events -----------------------------------------------------------------------

    def send(self, event: str, **fields: Any) -> None:
        """Write an event; nothing is written once the process is ending."""
        data = json.dumps({"event": event, **fields}).encode() + b"\n"
        with self._lock:
            if self._ended_by is not None:
                return  # closing the board causes further events
            try:
                while data:
                    data = data[os.write(self._events, data) :]
            except BrokenPipeError:
                pass  # the parent has ended, and so do the commands

    def _ended(self, traceback: str) -> None:
        self._send_reads()
        self._console.forget()  # the last error is shown in full
        self._console.print(traceback)
        self._console.flush()
        if missing := module_advice(traceback):
            self._console.print(missing + "\n")
        self.send("ended", traceback=traceback)

    def _read(self, address: int, ns: int) -> None:
        # Sent later, so that the event does not delay the reading whose latency is measured.
        self._reads.append((address, ns))
        if len(self._reads) >= _MOST_READS:
            self._send_reads()

    def _poll(self) -> None:
        """Send the visible state, also while the program computes, sleeps or has ended."""
        while True:
            time.sleep(self._pause())
            if self._pressed is not None:
                self._interrupt()
            self._watch()
            self.board.advance()
            self._send_parts()
            if self._host is not None:
                self._host.usb_state()  # the program may never ask for the state
            self._send_line()
            self._send_baud()

    def _send_line(self) -> None:
        """Send whether a program on the host has the serial line open, if that has changed."""
        is_open = self.board.usb.is_open()
        if TELLS_OPEN and is_open != self._told_open:
            self._told_open = is_open
            self.send("line", open=is_open)

    def _send_baud(self) -> None:
        """Send once that the baud rates of both ends of the serial line differ."""
        uart = self.board.bridged
        if uart is None or uart.understood():
            self._told_baud = 0
            return
        board, line = uart.rates()
        if board != self._told_baud:  # the doctor tries many rates of the line
            self._told_baud = board
            self.send("baud", board=board, line=line)

    def _pause(self) -> float:
        """Return the seconds until the next poll, which is not later than the watchdog."""
        left = self.board.resets.left_us()
        if left is None:
            return _POLL_SECONDS
        return min(_POLL_SECONDS, self.board.clock.host_seconds(left) + _SHORTEST_SECONDS)

    def _watch(self) -> None:
        """Reset the board if its watchdog was not fed."""
        if self.board.resets.left_us() == 0:
            self.board.resets.feed()  # once: the reset takes a moment
            self._press(WATCHDOG)

    def _press(self, cause: int) -> None:
        """Reset the board; thread-safe."""
        self._pressed = cause
        self._interrupt()

    def _interrupt(self) -> None:
        """Interrupt the program's thread.

        It does not notice a signal that comes between its last step in Python and a wait of the
        operating system, so `_poll` repeats the signal.
        """
        os.kill(os.getpid(), signal.SIGUSR1)

    def _on_press(self, host: BoardHost) -> None:
        cause, self._pressed = self._pressed, None
        if cause is not None:
            host.ask_reset(cause)

    def _send_parts(self) -> None:
        with self.board.lock:
            for part in self.board.parts:
                self._send_part(part)

    def _send_part(self, part: Part) -> None:
        shows = part.shows()
        if shows != self._shown.get(part.name, ""):
            self._shown[part.name] = shows
            self.send("part", name=part.name, shows=shows)

    def _send_reads(self) -> None:
        for address, ns in self._reads:
            self.send("read", address=address, ns=ns)
        self._reads.clear()

    def _usb(self, state: str) -> None:
        self.send("usb", state=state, error=self.board.usb.error)

    def _heap(self, used: int, peak: int) -> None:
        if self._base is None:
            self._base = used
            return
        self.send("heap", used=used, peak=peak, base=self._base)

    # --- commands ---------------------------------------------------------------------

    def _read_commands(self) -> None:
        with open(self._commands, encoding="utf-8", closefd=False) as lines:
            for line in lines:
                command = json.loads(line)
                if command["do"] == "happen":
                    self._happen(command["spec"])
                elif command["do"] == "reset":
                    self._press(HARD)
                elif command["do"] == "heap":
                    self._ask_heap()
        self.end(0)

    def _ask_heap(self) -> None:
        """Request the heap in use from the engine, at once or as soon as it exists."""
        with self._ending:
            if self._micropython is None:
                self._heap_asked = True
            else:
                self._micropython.ask_heap()

    def _happen(self, spec: str) -> None:
        error = ""
        try:
            self.board.happen(spec)
        except FaultError as fault_error:
            error = str(fault_error)
        faults = self._faults()
        self._send_parts()  # before "happened": a parent that waits for it may ask for their state
        self.send("happened", spec=spec, error=error, faults=faults)
        self._host.usb_state()

    def _faults(self) -> list[str]:
        return [fault.spec for fault in self.board.faults() if fault.active]

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        # In another thread: the interrupted program may hold a lock that end() waits for.
        threading.Thread(target=self.end, args=(128 + number,)).start()

    def close(self) -> None:
        """Release the resources of a board that did not start."""
        self.board.close()
        self._folder.cleanup()

    def end(self, status: int) -> None:
        """Close the board and end the process, whatever its threads do."""
        with self._lock:
            if self._ended_by is not None:
                return
            self._ended_by = status
        with self._ending:
            if self._micropython is not None:
                self._micropython.stop()
        self._second.kill()
        self.board.close()
        self._folder.cleanup()
        os._exit(status)


def main() -> None:
    """Run a board; the module docstring has the command line."""
    options = Options(**json.loads(sys.argv[1]))
    events = os.dup(1)
    os.dup2(2, 1)  # other output must not mix with the events
    try:
        process = BoardProcess(options, 0, events)
        try:
            process.run()
        except BaseException:
            process.close()
            raise
    except (
        BuildError, BoardError, FaultError, NoMicroPython, InterfaceError, PeripheralError, OSError,
    ) as error:  # fmt: skip
        text = json.dumps({"event": "failed", "error": str(error)})
        os.write(events, text.encode() + b"\n")
        sys.exit(1)


if __name__ == "__main__":
    main()
