"""Run a virtual board from Python: its firmware and hardware in a process of their own.

::

    with RunningBoard("ra6m5_sensor_node", happen=["sht3x:nack"]) as board:
        board.wait_usb("configured")
        …                               # an agent on board.path
        board.happen("usb:unplug")
        board.wait("some words")        # until the program prints them

The board is plugged in and switched on when ``with`` is entered, and gone without a trace when it
is left, or when this process ends.
"""

from __future__ import annotations

import json
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from ..hardware.board import FaultError
from ..models.catalog import BOARDS, BoardError, BoardSpec

START_SECONDS: Final = 30.0
WAIT_SECONDS: Final = 30.0
_END_SECONDS: Final = 5.0


class StartError(RuntimeError):
    """The board does not start; the text says why and what to do."""


class BoardGone(RuntimeError):
    """The board's process has ended by itself."""


class Heap(NamedTuple):
    """Octets in use on MicroPython's heap. What is reported is without the shims and MicroPython's
    own, which are ``base``.
    """

    used: int
    peak: int
    base: int


def firmware_folder(spec: BoardSpec) -> Path:
    """Where a board's program is: in the clone, or in the installed package. Raises BoardError."""
    boards = Path(__file__).resolve().parents[2]
    for folder in (boards.parents[2] / "firmware", boards / "firmware"):
        if (folder / spec.firmware / "main.py").is_file():
            return folder / spec.firmware
    raise BoardError(f"the firmware of {spec.name} is not installed; give the folder of a main.py")


class RunningBoard:
    """A board that runs; a context manager.

    ``firmware`` is a name in `BOARDS`, or a folder with a main.py; then ``board`` names the
    hardware. ``link`` is where the USB line is to be found, by default a name of its own.
    ``on_read(address, ns)`` is called for each I2C read that has ended, from another thread;
    without it, they come into the queue ``reads`` if ``reads`` is true. ``on_event`` gets all else
    that `uros.boards.virtual.engine.process` tells, from that thread too. ``measure`` finds the
    peak of the heap.
    ``plugs`` are plugged into the board; see `uros.boards.virtual.hardware.peripherals`.
    ``interfaces`` are folders of
    definitions that the program's imports may mean besides; see `uros.interfaces.add_folder`.
    ``happen`` is what happens before the program starts; see `uros.boards.virtual.hardware.board`.
    ``speed`` is how
    many times faster than ours the board's time goes, and that of everything around it; the agent's
    does not, so stamps are wrong then. ``agent`` is where the agent is that the program looks for
    in its network, ``address`` the board's own on this host, such as 127.0.0.7 (default: any).

    ``happenings`` are all that can be made to happen. ``console`` is a queue of the lines that the
    program prints, without ``on_event``. Waits raise TimeoutError, and BoardGone when there is
    nothing to wait for any more.
    """

    def __init__(
        self,
        firmware: str | Path,
        board: str | None = None,
        engine: str = "cpython",
        *,
        form: str = "py",
        happen: Sequence[str] = (),
        link: str | Path | None = None,
        seed: int = 0,
        reads: bool = False,
        on_read: Callable[[int, int], None] | None = None,
        on_event: Callable[[dict[str, Any]], object] | None = None,
        measure: bool = False,
        plugs: Sequence[str] = (),
        interfaces: Sequence[str | Path] = (),
        speed: float = 1.0,
        agent: tuple[str, int] = ("127.0.0.1", 8888),
        address: str = "",
    ) -> None:
        if isinstance(firmware, str) and firmware in BOARDS:
            board = board or firmware
            program = firmware_folder(BOARDS[firmware])
        else:
            program = Path(firmware)
        if board is None or board not in BOARDS:
            raise BoardError(
                f"there is no board {board or firmware}; there are {', '.join(BOARDS)}"
            )
        self._options = {
            "program": str(program.absolute()), "board": board, "engine": engine, "form": form,
            "link": None if link is None else str(Path(link).absolute()), "seed": seed,
            "happen": list(happen), "speed": speed, "agent": list(agent),
            "address": address, "reads": reads or on_read is not None, "measure": measure,
            "plugs": list(plugs), "interfaces": [str(Path(it).absolute()) for it in interfaces],
        }  # fmt: skip
        self._on_read = on_read
        self._on_event = on_event
        self._process: subprocess.Popen[bytes] | None = None
        self._reader: threading.Thread | None = None
        self._changed = threading.Condition()
        self._gone = False
        self._failure = ""
        self._traceback: str | None = None
        self._resets = 0
        self._heaps: list[Heap] = []  # the answers to heap
        self._refused: list[str] = []  # the answers to what is to happen
        self._shows: dict[str, list[str]] = {}
        self.path = Path()
        self.happenings: list[str] = []
        self.console: queue.Queue[str] = queue.Queue()
        self.reads: queue.Queue[tuple[int, int]] = queue.Queue()
        self.usb = "detached"
        self.usb_error = ""

    # --- beginning and end --------------------------------------------------------------

    def start(self) -> None:
        """Switch it on. Raises StartError."""
        self._process = subprocess.Popen(
            [sys.executable, "-m", "uros.boards.virtual.engine.process", json.dumps(self._options)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C is for us; the board ends with us
        )  # fmt: skip
        self._reader = threading.Thread(target=self._listen, name="board", daemon=True)
        self._reader.start()
        try:
            self._until(lambda: self.path != Path(), START_SECONDS, "the board to start")
        except BaseException as error:
            self.stop()
            if isinstance(error, BoardGone):
                raise StartError(self._failure or "the board's process has ended") from None
            raise

    def stop(self) -> None:
        """Switch the board off; idempotent."""
        process = self._process
        if process is None or self._reader is None:
            return
        self._process = None
        assert process.stdin is not None and process.stdout is not None
        try:
            process.stdin.close()
        except BrokenPipeError:
            pass
        try:
            process.wait(_END_SECONDS)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        self._reader.join()
        process.stdout.close()

    def __enter__(self) -> RunningBoard:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    # --- what can be done to it ---------------------------------------------------------

    def happen(self, spec: str) -> None:
        """Plant or heal a fault, such as "sht3x:nack", "sht3x:off" or "usb:unplug", or do something
        by hand, such as "button:press"; it is done when this returns. Raises FaultError.
        """
        self._refused.clear()
        self._command(do="happen", spec=spec)
        self._until(lambda: bool(self._refused), WAIT_SECONDS, "an answer")
        if self._refused[0]:
            raise FaultError(self._refused[0])

    def press(self, what: str, **more: str) -> None:
        """Ask for "reset", "heap" or "happen" (and its ``spec``) without waiting for it: an event
        will tell.
        """
        self._command(do=what, **more)

    def reset(self, timeout: float = WAIT_SECONDS) -> None:
        """Press the reset button."""
        before = self._resets
        self._command(do="reset")
        self._until(lambda: self._resets > before, timeout, "the reset")

    def heap(self, timeout: float = WAIT_SECONDS) -> Heap:
        """What lives on the heap of MicroPython after a collection; see the engine for programs
        that can be asked while they run. ``peak`` is 0 unless it is measured.
        """
        self._heaps.clear()
        self._command(do="heap")
        self._until(lambda: bool(self._heaps), timeout, "the heap")
        return self._heaps[0]

    # --- what it does -------------------------------------------------------------------

    @property
    def ended(self) -> bool:
        """Whether the program is over, or the whole board gone."""
        return self._gone or self._traceback is not None

    @property
    def resets(self) -> int:
        """How often the program has started anew."""
        return self._resets

    def wait(self, text: str, timeout: float = WAIT_SECONDS) -> str:
        """Wait for a line of the console with this text, and return it. Lines before it are
        dropped; TimeoutError and BoardGone show them.
        """
        seen: list[str] = []
        end = time.monotonic() + timeout
        while True:
            try:
                line = self.console.get(timeout=max(0.0, min(0.1, end - time.monotonic())))
            except queue.Empty:
                if self._gone and self.console.empty():
                    raise BoardGone(_without(text, seen, "the board has ended")) from None
                if time.monotonic() >= end:
                    raise TimeoutError(_without(text, seen, f"in {timeout:g} s")) from None
                continue
            if text in line:
                return line
            seen.append(line)

    def wait_usb(self, state: str, timeout: float = WAIT_SECONDS) -> None:
        """Wait until the line is "detached", "attached", "configured" or "suspended"."""
        self._until(lambda: self.usb == state, timeout, f"USB to be {state}")

    def shows(self, part: str) -> str:
        """What is to be seen of a part, such as "on" of an LED; "" for nothing."""
        with self._changed:
            return self._shows.get(part, [""])[-1]

    def shown(self, part: str) -> list[str]:
        """All that was to be seen of it, one after the other, from the start on."""
        with self._changed:
            return list(self._shows.get(part, ()))

    def wait_shows(self, part: str, what: str, timeout: float = WAIT_SECONDS) -> None:
        """Wait until a part shows this; at once if it does."""
        self._until(lambda: self._shows.get(part, [""])[-1] == what, timeout, f"{part} {what}")

    def wait_end(self, timeout: float = WAIT_SECONDS) -> str:
        """Wait for the end of the program; returns its traceback, or ""."""
        self._until(lambda: self._traceback is not None, timeout, "the program to end")
        return self._traceback or ""

    def _until(self, done: Callable[[], bool], timeout: float, what: str) -> None:
        with self._changed:
            self._changed.wait_for(lambda: done() or self._gone, timeout)
            if not done():
                if self._gone:
                    raise BoardGone(f"the board has ended; it was to wait for {what}")
                raise TimeoutError(f"waited {timeout:g} s for {what}")

    def _command(self, **command: str) -> None:
        if self._process is None or self._process.stdin is None:
            raise BoardGone("the board is not running")
        try:
            self._process.stdin.write(json.dumps(command).encode() + b"\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            raise BoardGone("the board has ended") from None

    def _listen(self) -> None:
        assert self._process is not None and self._process.stdout is not None
        for line in self._process.stdout:
            event = json.loads(line)
            kind = event["event"]
            if kind == "console" and self._on_event is None:
                self.console.put(event["line"])
            elif kind == "read":
                if self._on_read is not None:
                    self._on_read(event["address"], event["ns"])
                else:
                    self.reads.put((event["address"], event["ns"]))
            else:
                with self._changed:
                    self._note(kind, event)
                    self._changed.notify_all()
                if self._on_event is not None:
                    self._on_event(event)
        with self._changed:
            self._gone = True
            self._changed.notify_all()
        if self._on_event is not None:
            self._on_event({"event": "gone"})

    def _note(self, kind: str, event: dict[str, Any]) -> None:
        if kind == "ready":
            self.happenings = event["happenings"]
            self.path = Path(event["path"])
        elif kind == "usb":
            self.usb, self.usb_error = event["state"], event["error"]
        elif kind == "happened":
            self._refused.append(event["error"])
        elif kind == "part":
            self._shows.setdefault(event["name"], []).append(event["shows"])
        elif kind == "reset":
            self._resets += 1
            self._traceback = None
        elif kind == "ended":
            self._traceback = event["traceback"]
        elif kind == "failed":
            self._failure = event["error"]
        elif kind == "heap":
            base = event["base"]
            self._heaps.append(Heap(event["used"] - base, max(0, event["peak"] - base), base))


def _without(text: str, seen: list[str], why: str) -> str:
    """What a wait has to say that did not find its line."""
    return "\n".join([f"no line with {text!r} ({why}); the console said:", *seen])
