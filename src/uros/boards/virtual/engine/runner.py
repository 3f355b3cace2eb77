"""Runs a virtual board from Python, in a process of its own.

::

    with RunningBoard("ra6m5_sensor_node", happen=["sht3x:nack"]) as board:
        board.wait_usb("configured")
        …                               # an agent on board.path
        board.happen("usb:unplug")
        board.wait("some words")        # until the program prints them

Entering ``with`` connects the board and switches it on. Leaving it, or the end of this process,
ends the board's process and removes its files.
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
from typing import IO, Any, Final, NamedTuple

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
    """Octets in use on MicroPython's heap.

    Attributes:
        used: In use after a collection, without ``base``.
        peak: The highest use at the end of a step since the last request, without ``base``; 0
            unless it is measured. The engine collects between two steps alone, so it includes all
            garbage of a step.
        base: What the shims and MicroPython itself take.
    """

    used: int
    peak: int
    base: int


def firmware_folder(spec: BoardSpec) -> Path:
    """Return the folder of a board's program, in the clone or in the installed package.

    Raises:
        BoardError: The program is not installed.
    """
    boards = Path(__file__).resolve().parents[2]
    for folder in (boards.parents[2] / "firmware", boards / "firmware"):
        if (folder / spec.firmware / "main.py").is_file():
            return folder / spec.firmware
    raise BoardError(f"the firmware of {spec.name} is not installed; give the folder of a main.py")


class RunningBoard:
    """A running virtual board; a context manager.

    Methods that wait raise TimeoutError, and BoardGone when the board's process has ended.

    Args:
        firmware: A name in `BOARDS`, or a folder with a main.py; with a folder, ``board`` names the
            hardware.
        board: The name of the hardware; by default that of ``firmware``.
        engine: "cpython" or "micropython".
        form: The form of the files on the board (see `uros.boards.builder.file_system.build`).
        happen: Faults and actions before the program starts (see
            `uros.boards.virtual.hardware.board`).
        link: Where the link to the USB line is created; by default a new name.
        seed: Seed of all random values of the board.
        reads: Whether the ends of I2C reads are put into the queue ``reads``.
        on_read: Called with address and time in ns for each I2C read that has ended, from another
            thread, in place of the queue ``reads``.
        on_event: Called with each other event of `uros.boards.virtual.engine.process`, from the
            same thread; ``console`` stays empty then.
        measure: Whether the peak of the heap is measured.
        plugs: Peripherals that are attached to the board (see
            `uros.boards.virtual.hardware.peripherals`).
        provided: Modules that the program imports and the builder does not know; the program's own
            folder or the virtual board must have them when it runs.
        interfaces: Folders of interface definitions that the program may import besides (see
            `uros.interfaces.add_folder`).
        speed: How many times faster than real time the board and its environment run. The agent
            runs in real time, so stamps are wrong unless this is 1.0.
        agent: Host and port of the agent that the program looks for in its network.
        address: The board's own address on this host, such as 127.0.0.7; "" for any.
        secrets: The file of the program's module ``secrets``; by default secrets.py in its folder,
            if there is one.

    Attributes:
        path: The USB line.
        baud: The baud rate that the board's program has on this line by default.
        happenings: All faults and actions of the board.
        console: A queue of the lines that the program prints.
        reads: A queue of the I2C reads that have ended: address, and time in ns of the monotonic
            clock.
        usb: The state of the USB line; see :meth:`wait_usb`.
        usb_error: Why the host refused the USB device; "" if it did not.

    Raises:
        BoardError: There is no such board, or its program is not installed.
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
        provided: Sequence[str] = (),
        interfaces: Sequence[str | Path] = (),
        speed: float = 1.0,
        agent: tuple[str, int] = ("127.0.0.1", 8888),
        address: str = "",
        secrets: str | Path | None = None,
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
            "secrets": None if secrets is None else str(Path(secrets).absolute()),
            "plugs": list(plugs), "provided": list(provided),
            "interfaces": [str(Path(name).absolute()) for name in interfaces],
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
        self._asleep = False
        self._heaps: list[Heap] = []  # the answers to "heap"
        self._errors: list[str] = []  # the answers to "happen"; "" is success
        self._shows: dict[str, list[str]] = {}
        self.path = Path()
        self.baud = 0
        self.happenings: list[str] = []
        self.console: queue.Queue[str] = queue.Queue()
        self.reads: queue.Queue[tuple[int, int]] = queue.Queue()
        self.usb = "detached"
        self.usb_error = ""

    # --- beginning and end --------------------------------------------------------------

    def start(self) -> None:
        """Start the board's process; return when the board is ready.

        Raises:
            StartError: The board does not start, or was not ready within 30 s.
        """
        self._process = subprocess.Popen(
            [sys.executable, "-m", "uros.boards.virtual.engine.process", json.dumps(self._options)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C reaches this process alone, which ends the board
        )  # fmt: skip
        assert self._process.stdout is not None
        self._reader = threading.Thread(
            target=self._listen, args=(self._process.stdout,), name="board", daemon=True
        )
        self._reader.start()
        try:
            self._until(lambda: self.path != Path(), START_SECONDS, "the board to start")
        except BaseException as error:
            self.stop()
            if isinstance(error, BoardGone):
                raise StartError(self._failure or "the board's process has ended") from None
            if isinstance(error, TimeoutError):
                raise StartError(
                    f"{error}: is this machine busy? Run fewer programs or boards, and try again"
                ) from None
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

    # --- commands -----------------------------------------------------------------------

    def happen(self, spec: str) -> None:
        """Inject or clear a fault, or do an action of the user; it is done when this returns.

        Args:
            spec: A fault, such as "sht3x:nack", "sht3x:off" or "usb:unplug", or an action, such as
                "button:press".

        Raises:
            FaultError: There is no such fault or action.
        """
        self._errors.clear()
        self._command(do="happen", spec=spec)
        self._until(lambda: bool(self._errors), WAIT_SECONDS, "an answer")
        if self._errors[0]:
            raise FaultError(self._errors[0])

    def press(self, command: str, **fields: str) -> None:
        """Send a command without waiting for its event.

        Args:
            command: "reset", "heap" or "happen".
            fields: The fields of the command: ``spec`` of "happen".
        """
        self._command(do=command, **fields)

    def reset(self, timeout: float = WAIT_SECONDS) -> None:
        """Press the reset button, and wait until the program starts anew."""
        before = self._resets
        self._command(do="reset")
        self._until(lambda: self._resets > before, timeout, "the reset")

    def heap(self, timeout: float = WAIT_SECONDS) -> Heap:
        """Return the use of MicroPython's heap after a collection.

        A program whose main.py has ``start()`` and ``step()`` is measured between two steps, any
        other program at its end.
        """
        self._heaps.clear()
        self._command(do="heap")
        self._until(lambda: bool(self._heaps), timeout, "the heap")
        return self._heaps[0]

    # --- state --------------------------------------------------------------------------

    @property
    def ended(self) -> bool:
        """Whether the program or the board's process has ended."""
        return self._gone or self._traceback is not None

    @property
    def resets(self) -> int:
        """How many times the program has started anew."""
        return self._resets

    def wait(self, text: str, timeout: float = WAIT_SECONDS) -> str:
        """Wait for a line of the console that contains ``text``, and return it.

        Lines before it are dropped; TimeoutError and BoardGone show them.
        """
        lines: list[str] = []
        end = time.monotonic() + timeout
        while True:
            try:
                line = self.console.get(timeout=max(0.0, min(0.1, end - time.monotonic())))
            except queue.Empty:
                if self._gone and self.console.empty():
                    raise BoardGone(_no_line(text, lines, "the board has ended")) from None
                if time.monotonic() >= end:
                    raise TimeoutError(_no_line(text, lines, f"in {timeout:g} s")) from None
                continue
            if text in line:
                return line
            lines.append(line)

    def wait_usb(self, state: str, timeout: float = WAIT_SECONDS) -> None:
        """Wait until USB is "detached", "attached", "configured" or "suspended".

        Raises:
            StartError: The host has refused the USB device, or there can be no line.
            TimeoutError: It is not within ``timeout`` seconds.
        """
        needs_line = state not in ("detached", "attached")

        def is_refused() -> bool:
            return needs_line and self.usb == "attached" and bool(self.usb_error)

        self._until(lambda: self.usb == state or is_refused(), timeout, f"USB to be {state}")
        if is_refused():
            raise StartError(f"the board's USB: {self.usb_error}")

    def shows(self, part: str) -> str:
        """Return the visible state of a part, such as "on" of an LED; "" if it has none."""
        with self._changed:
            return self._shows.get(part, [""])[-1]

    def shown(self, part: str) -> list[str]:
        """Return all visible states of a part from the start on, in order."""
        with self._changed:
            return list(self._shows.get(part, ()))

    def wait_shows(self, part: str, state: str, timeout: float = WAIT_SECONDS) -> None:
        """Wait until the visible state of a part is ``state``."""
        self._until(lambda: self._shows.get(part, [""])[-1] == state, timeout, f"{part} {state}")

    def wait_asleep(self, timeout: float = WAIT_SECONDS) -> None:
        """Wait until the program has called ``machine.deepsleep``, and sleeps."""
        self._until(lambda: self._asleep, timeout, "the board to sleep")

    def wait_end(self, timeout: float = WAIT_SECONDS) -> str:
        """Wait for the end of the program; return its traceback, or ""."""
        self._until(lambda: self._traceback is not None, timeout, "the program to end")
        return self._traceback or ""

    def _until(self, done: Callable[[], bool], timeout: float, condition: str) -> None:
        with self._changed:
            self._changed.wait_for(lambda: done() or self._gone, timeout)
            if not done():
                if self._gone:
                    raise BoardGone(f"the board has ended; it was to wait for {condition}")
                raise TimeoutError(f"waited {timeout:g} s for {condition}")

    def _command(self, **command: str) -> None:
        if self._process is None or self._process.stdin is None:
            raise BoardGone("the board is not running")
        try:
            self._process.stdin.write(json.dumps(command).encode() + b"\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            raise BoardGone("the board has ended") from None

    def _listen(self, events: IO[bytes]) -> None:
        for line in events:
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
            self.baud = event["baud"]
            self.path = Path(event["path"])
        elif kind == "usb":
            self.usb, self.usb_error = event["state"], event["error"]
        elif kind == "happened":
            self._errors.append(event["error"])
        elif kind == "part":
            self._shows.setdefault(event["name"], []).append(event["shows"])
        elif kind == "asleep":
            self._asleep = True
        elif kind == "reset":
            self._asleep = False
            self._resets += 1
            self._traceback = None
        elif kind == "ended":
            self._traceback = event["traceback"]
        elif kind == "failed":
            self._failure = event["error"]
        elif kind == "heap":
            base = event["base"]
            self._heaps.append(Heap(event["used"] - base, max(0, event["peak"] - base), base))


def _no_line(text: str, lines: list[str], reason: str) -> str:
    """Return the error text of a wait that did not find its line."""
    return "\n".join([f"no line with {text!r} ({reason}); the console said:", *lines])
