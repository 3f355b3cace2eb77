"""A virtual board as a process: hardware, firmware and the hand that plants faults.

``python -m uros.boards.engine OPTIONS`` is what `uros.boards.running` starts; OPTIONS is a JSON
object with the fields of `Options`. Commands come in as JSON lines::

    {"do": "happen", "spec": "sht3x:nack"}   answered by an event "happened"
    {"do": "reset"}                          the board's reset button
    {"do": "heap"}                           answered by an event "heap" (engine micropython)

and events go out the same way::

    {"event": "ready", "path": …, "happenings": […]}  the line has its name; the program starts
    {"event": "usb", "state": …, "error": …} what became of it
    {"event": "console", "line": …}          what the program printed
    {"event": "read", "address": …, "ns": …} an I2C read has ended, by the monotonic clock; told
                                             when the program next waits
    {"event": "happened", "spec": …, "error": …, "still": […]}
                                             what else is wrong with that part, still
    {"event": "part", "name": …, "shows": …} what is to be seen of a part has changed
    {"event": "heap", "used": …, "peak": …, "base": …}
    {"event": "reset"}                       the program starts anew
    {"event": "ended", "traceback": …}       the program is over; the board stays
    {"event": "failed", "error": …}          nothing runs; the process ends with status 1

The end of the commands is the end of the process: a parent that ends, however it does, leaves
nothing behind.
"""

from __future__ import annotations

import json
import os
import re
import signal
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any, Final

from ..interfaces import InterfaceError, add_folder
from . import engine_cpython
from .board import FaultError, VirtualBoard
from .build import BuildError, build
from .catalog import BoardError
from .clock import BoardClock
from .engine_host import BoardHost, Reset
from .engine_micropython import MicroPythonEngine, NoMicroPython, find
from .parts import Part
from .plugs import PlugError
from .usb import ATTACHED

_MOST_READS: Final = 64
_TRACEBACK_LINES: Final = 200  # held back until its last one comes
_LOOK_SECONDS: Final = 0.2


@dataclass(frozen=True)
class Options:
    """What to run, and how. ``program`` is the firmware's folder; ``form`` the one of `build`;
    ``reads`` whether events tell of I2C reads; ``measure`` whether the peak of the heap is;
    ``plugs`` what is plugged into the board; ``interfaces`` folders of definitions; ``happen``
    what happens before the program starts; ``speed`` that of the board's time; ``agent`` where the
    agent is that the program looks for in its network, a host and a port; ``address`` the board's
    own on this host."""

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


class Once:
    """Lets the traceback of a fault of one field through once: a program that goes on meets it at
    each turn of its timer."""

    _FAULT: Final = re.compile(r"\w+Error: \w+/(?:msg|srv|action)/\w+(?:[.\w]*:| has no field \w+)")

    def __init__(self) -> None:
        self._held: list[str] = []  # of a traceback whose last line is to come
        self._seen: set[str] = set()

    def pass_on(self, line: str) -> list[str]:
        """The lines to show, now that this one is there."""
        inside = line.startswith("  ") and self._held
        if line.startswith("Traceback (most") or inside:
            return [] if self._hold(line) else self.flush()
        fault = self._FAULT.match(line)
        if fault and self._held:
            if fault[0] in self._seen:
                self._held.clear()
                return []
            self._seen.add(fault[0])
        return [*self.flush(), line]

    def _hold(self, line: str) -> bool:
        self._held.append(line)
        return len(self._held) < _TRACEBACK_LINES

    def flush(self) -> list[str]:
        """What is held back."""
        held, self._held = self._held, []
        return held


class BoardProcess:
    """The process, without its beginning: see the module."""

    def __init__(self, options: Options, commands: int, events: int) -> None:
        self._options = options
        self._commands = commands
        self._events = events
        self._lock = threading.Lock()  # of the events
        self._ending = threading.Lock()  # of _micropython, and of the end
        self._ended_by: int | None = None  # the exit status
        self._folder = tempfile.TemporaryDirectory(prefix="uros-board-")
        self._unfinished = ""  # a line being printed
        self._once = Once()
        self._reads: list[tuple[int, int]] = []  # not told yet
        self._micropython: MicroPythonEngine | None = None
        self._base: int | None = None  # the heap before the program
        self._heap_asked = False  # before there was an engine
        self._shown: dict[str, str] = {}  # of parts, as it was told
        try:
            link = None if options.link is None else Path(options.link)
            self._board = VirtualBoard(
                options.board, BoardClock(speed=options.speed), link, options.seed,
                plugs=options.plugs, agent=(options.agent[0], options.agent[1]),
                address=options.address, changed=self._tell_part,
            )  # fmt: skip
        except BaseException:
            self._folder.cleanup()
            raise

    def run(self) -> None:
        """Until the end of the commands. Raises what keeps a board from starting."""
        options, board = self._options, self._board
        for spec in options.happen:
            board.happen(spec)
        if options.engine == "micropython":
            find()
        for folder in options.interfaces:
            add_folder(folder)
        root = Path(self._folder.name) / "flash"
        # As a board has it where that is what is looked at: as bytecode, or for its memory.
        checked = options.form == "py" and not options.measure
        build(Path(options.program), root, options.form, checked=checked)
        if options.reads:
            for bus in board.i2c.values():
                bus.on_read = self._read
        host = self._host = BoardHost(
            board, self._print, self._ended, self._heap, self._usb, self._tell_reads
        )
        for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
            signal.signal(number, self._on_signal)
        signal.signal(signal.SIGUSR1, lambda *_: host.ask_reset())
        while not board.usb_inside and board.usb.state == ATTACHED:
            board.usb.wait(1.0)  # its bridge has power already
        happenings = [it.spec for it in (*board.acts(), *board.faults())]
        self._send("ready", path=str(board.usb.path), happenings=happenings)
        host.usb_state()
        self._tell_parts()
        threading.Thread(target=self._obey, name="commands", daemon=True).start()
        threading.Thread(target=self._look, name="parts", daemon=True).start()
        while True:
            try:
                self._run_program(root, host)
                while True:
                    signal.pause()
            except Reset:
                self._flush()
                host.reset()
                self._send("reset")

    def _run_program(self, root: Path, host: BoardHost) -> None:
        if self._options.engine == "cpython":
            os.chdir(root)
            engine_cpython.run(root, host)
            return
        with self._ending:
            self._base = None
            engine = self._micropython = MicroPythonEngine(root, host, self._options.measure)
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

    def _send(self, event: str, **fields: Any) -> None:
        data = json.dumps({"event": event, **fields}).encode() + b"\n"
        with self._lock:
            if self._ended_by is not None:
                return  # what follows is the noise of taking a board apart
            try:
                while data:
                    data = data[os.write(self._events, data) :]
            except BrokenPipeError:
                pass  # the commands end, too

    def _print(self, text: str) -> None:
        *lines, self._unfinished = (self._unfinished + text).split("\n")
        for line in lines:
            for told in self._once.pass_on(line.rstrip("\r")):
                self._send("console", line=told)

    def _flush(self) -> None:
        if self._unfinished:
            self._print("\n")
        for line in self._once.flush():
            self._send("console", line=line)

    def _ended(self, traceback: str) -> None:
        self._tell_reads()
        if traceback:
            self._flush()
            self._print(traceback)
        self._flush()
        self._send("ended", traceback=traceback)

    def _read(self, address: int, ns: int) -> None:
        # Told later: whoever measures the way of a reading must not lie in that way.
        self._reads.append((address, ns))
        if len(self._reads) >= _MOST_READS:
            self._tell_reads()

    def _look(self) -> None:
        """Tell what is to be seen, also while the program computes, sleeps or is over."""
        while True:
            time.sleep(_LOOK_SECONDS)
            self._board.advance()
            self._tell_parts()

    def _tell_parts(self) -> None:
        with self._board.lock:
            for part in self._board.parts:
                self._tell_part(part)

    def _tell_part(self, part: Part) -> None:
        shows = part.shows()
        if shows != self._shown.get(part.name, ""):
            self._shown[part.name] = shows
            self._send("part", name=part.name, shows=shows)

    def _tell_reads(self) -> None:
        for address, ns in self._reads:
            self._send("read", address=address, ns=ns)
        self._reads.clear()

    def _usb(self, state: str) -> None:
        self._send("usb", state=state, error=self._board.usb.error)

    def _heap(self, used: int, peak: int) -> None:
        if self._base is None:
            self._base = used
            return
        self._send("heap", used=used, peak=peak, base=self._base)

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
            self._board.happen(spec)
        except FaultError as refused:
            error = str(refused)
        part = spec.partition(":")[0]
        still = [
            it.spec
            for it in self._board.faults()
            if it.active and it.spec != spec and it.spec.partition(":")[0] == part
        ]
        self._send("happened", spec=spec, error=error, still=still)
        self._tell_parts()
        self._host.usb_state()

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        # Not from here: the interrupted program may hold what the end has to wait for.
        threading.Thread(target=self.end, args=(128 + number,)).start()

    def close(self) -> None:
        """Take a board apart that did not start."""
        self._board.close()
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
        self._board.close()
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
