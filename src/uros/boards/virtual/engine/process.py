"""A virtual board as a process: hardware, firmware and the hand that plants faults.

``python -m uros.boards.virtual.engine.process OPTIONS`` is what
`uros.boards.virtual.engine.runner` starts; OPTIONS is a JSON
object with the fields of `Options`. Commands come in as JSON lines::

    {"do": "happen", "spec": "sht3x:nack"}   answered by an event "happened"
    {"do": "reset"}                          the board's reset button
    {"do": "heap"}                           answered by an event "heap" (engine micropython)

and events go out the same way::

    {"event": "ready", "path": …, "happenings": […], "faults": […]}
                                             the line has its name; the program starts
    {"event": "usb", "state": …, "error": …} what became of it
    {"event": "console", "line": …}          what the program printed
    {"event": "read", "address": …, "ns": …} an I2C read has ended, by the monotonic clock; told
                                             when the program next waits
    {"event": "happened", "spec": …, "error": …, "faults": […]}
                                             all faults that the board has now
    {"event": "part", "name": …, "shows": …} what is to be seen of a part has changed
    {"event": "heap", "used": …, "peak": …, "base": …}
    {"event": "reset"}                       the program starts anew
    {"event": "ended", "traceback": …}       the program is over; the board stays
    {"event": "failed", "error": …}          nothing runs; the process ends with status 1

The end of the commands is the end of the process: a parent that ends, however it does, leaves
nothing behind.
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
from ...builder.errors import BuildError
from ...builder.file_system import build
from ..hardware.board import FaultError, VirtualBoard
from ..hardware.clock import BoardClock
from ..hardware.parts import Part
from ..hardware.peripherals import PlugError
from ..hardware.usb import ATTACHED
from ..models.catalog import BoardError
from ..models.catalog import find as find_board
from . import cpython
from .console import Console
from .cores import Mail
from .micropython import MicroPythonEngine, NoMicroPython, find
from .syscalls import BoardHost, Reset

_MOST_READS: Final = 64
_LOOK_SECONDS: Final = 0.2
_STOP_SECONDS: Final = 2.0


@dataclass(frozen=True)
class Options:
    """What to run, and how. ``program`` is the firmware's folder; ``form`` the one of `build`;
    ``reads`` whether events tell of I2C reads; ``measure`` whether the peak of the heap is;
    ``plugs`` what is plugged into the board; ``interfaces`` folders of definitions; ``happen``
    what happens before the program starts; ``speed`` that of the board's time; ``agent`` where the
    agent is that the program looks for in its network, a host and a port; ``address`` the board's
    own on this host.
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
    interfaces: list[str] = field(default_factory=list)
    speed: float = 1.0
    agent: tuple[str, int] = ("127.0.0.1", 8888)
    address: str = ""


class _SecondCore:
    """The second core: an interpreter of its own, in a thread, once the program starts it."""

    def __init__(self, process: BoardProcess) -> None:
        self.mail = Mail()
        self._process = process
        self._lock = threading.Lock()  # of the engine
        self._host: BoardHost | None = None
        self._engine: MicroPythonEngine | None = None
        self._thread: threading.Thread | None = None

    def start(self, root: Path, name: str) -> None:
        """Raises OSError where it runs."""
        if self._thread is not None:
            raise OSError(errno.EBUSY, "the second core runs already")
        console = Console(lambda line: self._process.send("console", line=line))

        def ended(traceback: str) -> None:
            console.flush()
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
                return  # stopped before it began
            engine = self._engine = MicroPythonEngine(root, host, core=name)
        try:
            engine.run()
        finally:
            with self._lock:
                self._engine = None
                engine.close()

    def stop(self) -> None:
        """End its program, as a reset does."""
        thread, self._thread = self._thread, None
        if thread is None or self._host is None:
            return
        self._host.stop()
        with self._lock:
            self._host = None
        self.kill()
        # One that computes for ever without an operation touches nothing of the board any more.
        thread.join(_STOP_SECONDS)

    def kill(self) -> None:
        """End its process, where it has one."""
        with self._lock:
            if self._engine is not None:
                self._engine.stop()


class BoardProcess:
    """The process, without its beginning: see the module."""

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
        self._reads: list[tuple[int, int]] = []  # not told yet
        self._micropython: MicroPythonEngine | None = None
        self._base: int | None = None  # the heap before the program
        self._heap_asked = False  # before there was an engine
        self._shown: dict[str, str] = {}  # of parts, as it was told
        try:
            link = None if options.link is None else Path(options.link)
            self.board = VirtualBoard(
                find_board(options.board), BoardClock(speed=options.speed), link, options.seed,
                plugs=options.plugs, agent=(options.agent[0], options.agent[1]),
                address=options.address, changed=self._tell_part,
            )  # fmt: skip
        except BaseException:
            self._folder.cleanup()
            raise

    def run(self) -> None:
        """Until the end of the commands. Raises what keeps a board from starting."""
        options, board = self.options, self.board
        for spec in options.happen:
            board.happen(spec)
        if options.engine == "micropython":
            find()
        for folder in options.interfaces:
            add_folder(folder)
        root = Path(self._folder.name) / "flash"
        # As a board has it where that is what is looked at: as bytecode, or for its memory.
        checked = options.form == "py" and not options.measure
        build(Path(options.program), root, options.form, checked=checked, provided=["second_core"])
        if options.reads:
            for bus in board.i2c.values():
                bus.on_read = self._read
        host = self._host = BoardHost(
            board, self._console.print, self._ended, self._heap, self._usb, self._tell_reads,
            self._second.mail, lambda name: self._second.start(root, name),
        )  # fmt: skip
        for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
            signal.signal(number, self._on_signal)
        signal.signal(signal.SIGUSR1, lambda *_: host.ask_reset())
        while not board.usb_inside and board.usb.state == ATTACHED:
            board.usb.wait(1.0)  # its bridge has power already
        happenings = [it.spec for it in (*board.acts(), *board.faults())]
        self._tell_parts()  # before it is ready, so that who waits for that can look
        self.send("ready", path=str(board.usb.path), happenings=happenings, faults=self._faults())
        host.usb_state()
        threading.Thread(target=self._obey, name="commands", daemon=True).start()
        threading.Thread(target=self._look, name="parts", daemon=True).start()
        while True:
            try:
                self._run_program(root, host)
                while True:
                    signal.pause()
            except Reset:
                self._console.forget()
                self._second.stop()
                host.reset()
                self.send("reset")

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
        data = json.dumps({"event": event, **fields}).encode() + b"\n"
        with self._lock:
            if self._ended_by is not None:
                return  # what follows is the noise of taking a board apart
            try:
                while data:
                    data = data[os.write(self._events, data) :]
            except BrokenPipeError:
                pass  # the commands end, too

    def _ended(self, traceback: str) -> None:
        self._tell_reads()
        if traceback:
            self._console.flush()
            self._console.print(traceback)
        self._console.flush()
        self.send("ended", traceback=traceback)

    def _read(self, address: int, ns: int) -> None:
        # Told later: whoever measures the way of a reading must not lie in that way.
        self._reads.append((address, ns))
        if len(self._reads) >= _MOST_READS:
            self._tell_reads()

    def _look(self) -> None:
        """Tell what is to be seen, also while the program computes, sleeps or is over."""
        while True:
            time.sleep(_LOOK_SECONDS)
            self.board.advance()
            self._tell_parts()
            if self._host is not None:
                self._host.usb_state()  # the program may never ask for it

    def _tell_parts(self) -> None:
        with self.board.lock:
            for part in self.board.parts:
                self._tell_part(part)

    def _tell_part(self, part: Part) -> None:
        shows = part.shows()
        if shows != self._shown.get(part.name, ""):
            self._shown[part.name] = shows
            self.send("part", name=part.name, shows=shows)

    def _tell_reads(self) -> None:
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

    def _obey(self) -> None:
        with open(self._commands, encoding="utf-8", closefd=False) as lines:
            for line in lines:
                command = json.loads(line)
                if command["do"] == "happen":
                    self._happen(command["spec"])
                elif command["do"] == "reset":
                    os.kill(os.getpid(), signal.SIGUSR1)  # the program's thread is to hear of it
                elif command["do"] == "heap":
                    self._ask_heap()
        self.end(0)

    def _ask_heap(self) -> None:
        """Now, or as soon as there is an engine to be asked."""
        with self._ending:
            if self._micropython is None:
                self._heap_asked = True
            else:
                self._micropython.ask_heap()

    def _happen(self, spec: str) -> None:
        error = ""
        try:
            self.board.happen(spec)
        except FaultError as refused:
            error = str(refused)
        faults = self._faults()
        self._tell_parts()  # as they were when it happened, for who waits for that
        self.send("happened", spec=spec, error=error, faults=faults)
        self._host.usb_state()

    def _faults(self) -> list[str]:
        return [fault.spec for fault in self.board.faults() if fault.active]

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        # Not from here: the interrupted program may hold what the end has to wait for.
        threading.Thread(target=self.end, args=(128 + number,)).start()

    def close(self) -> None:
        """Take a board apart that did not start."""
        self.board.close()
        self._folder.cleanup()

    def end(self, status: int) -> None:
        """Take it apart and end the process, in the middle of whatever it does."""
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
    """See the module."""
    options = Options(**json.loads(sys.argv[1]))
    events = os.dup(1)
    os.dup2(2, 1)  # nobody else is to write between the events
    try:
        process = BoardProcess(options, 0, events)
        try:
            process.run()
        except BaseException:
            process.close()
            raise
    except (
        BuildError, BoardError, FaultError, NoMicroPython, InterfaceError, PlugError, OSError,
    ) as error:  # fmt: skip
        text = json.dumps({"event": "failed", "error": str(error)})
        os.write(events, text.encode() + b"\n")
        sys.exit(1)


if __name__ == "__main__":
    main()
