"""Runs virtual boards and an agent for them, and executes typed commands."""

from __future__ import annotations

import os
import queue
import shlex
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from ..agent.child_process import AgentProcess
from ..ending import uninterrupted
from ..errors import ToolError
from .build import program_folder
from .connections import Connections
from .screen import Row, Screen

if TYPE_CHECKING:
    from ...boards.virtual.engine.runner import RunningBoard

AGENT_PORT: Final = 8888
_REDRAW_SECONDS: Final = 0.25
# Without a table, the state of a part is printed at most this often.
_TELL_SECONDS: Final = 1.0
_USUAL_BAUD: Final = 115_200  # the agent's default
# Log levels of the agent.
_WARNINGS: Final = 3
_INFO: Final = 4
# Causes of resets, as machine.reset_cause() numbers them, that are no reset of the user.
_CAUSES: Final = {3: "the watchdog has reset the board", 4: "the board wakes"}
_HELP: Final = (
    "commands, one a line: {example}; or reset, heap, quit ('uros board list {name}' lists all that"
    " can happen)"
)


_EXAMPLES: Final = ("button:tap", "usb:unplug")


@dataclass
class Plan:
    """A board to run. ``title`` is its name in the output; the rest are options of RunningBoard."""

    title: str
    board: str
    firmware: str | None = None
    engine: str = "cpython"
    seed: int = 0
    happen: Sequence[str] = ()
    plugs: Sequence[str] = ()
    interfaces: Sequence[str] = ()
    provided: Sequence[str] = ()
    link: str | None = None
    speed: float = 1.0
    namespace: str = ""
    secrets: str | None = None
    baud: int | None = None  # of the agent for it; None is that of the board's own program


def titles(names: Sequence[str]) -> list[str]:
    """Return a title for each board: the second board of a name is ``name#2``."""
    counts: dict[str, int] = {}
    out = []
    for name in names:
        counts[name] = counts.get(name, 0) + 1
        out.append(name if counts[name] == 1 else f"{name}#{counts[name]}")
    return out


@dataclass
class _Seat:
    """A running board and its state."""

    plan: Plan
    board: RunningBoard
    address: str  # its own IP address on this host
    talks: bool  # to an agent
    program: str = "starts"
    failed: bool = False
    line_open: bool | None = None  # by a program on this host; None: this system does not tell
    shows: dict[str, str] = field(default_factory=dict)
    told: dict[str, tuple[float, str]] = field(default_factory=dict)
    faults: list[str] = field(default_factory=list)


class Simulation:
    """Runs boards until Ctrl-C, or for some time.

    Args:
        plans: The boards.
        agent: Whether to run an agent; None to run one if a program talks to an agent.
        port: The UDP port of the agent, for boards with Wi-Fi.
        seconds: How long to run; None for no limit.

    Raises:
        ToolError: There is no such program.
    """

    def __init__(
        self, plans: Sequence[Plan], agent: bool | None = None, port: int = AGENT_PORT,
        seconds: float | None = None,
    ) -> None:  # fmt: skip
        self._plans = [
            replace(plan, firmware=str(program_folder(plan.firmware))) if plan.firmware else plan
            for plan in plans
        ]
        self._seconds = seconds
        self._port = port
        self._wanted = any(map(talks_to_agent, self._plans)) if agent is None else agent
        self._events: queue.Queue[tuple[_Seat | None, dict[str, Any]]] = queue.Queue()
        self._seats: list[_Seat] = []
        self._screen = Screen()
        self._agent: AgentProcess | None = None
        self._agent_has_port = False
        self._connections: Connections | None = None
        self._rules: tempfile.TemporaryDirectory[str] | None = None

    def run(self) -> int:
        """Run the boards.

        Returns:
            1 if a program has ended with an error, else 0.

        Raises:
            ToolError: A board or the agent cannot start, or has ended.
        """
        from ...boards.virtual.engine.runner import StartError
        from ...boards.virtual.models.catalog import BoardError

        try:
            self._seats = [self._seat(index, plan) for index, plan in enumerate(self._plans)]
            self._start_boards()
            if self._wanted:
                self._start_agent()
            if self._screen.live:
                pid = None if self._agent is None else self._agent.pid
                self._connections = Connections(pid, self._port)
            self._introduce()
            threading.Thread(target=_read_input, args=(self._events,), daemon=True).start()
            self._loop()
        except (StartError, BoardError) as error:
            raise ToolError(str(error)) from error
        except KeyboardInterrupt:
            if not self._screen.live:
                print()
        finally:
            with uninterrupted():
                self._close()
        return int(any(seat.failed for seat in self._seats))

    def _seat(self, index: int, plan: Plan) -> _Seat:
        from ...boards.virtual.engine.runner import RunningBoard
        from ...boards.virtual.models.catalog import find

        # Each board has its own address, as in a real network, if the system has so many.
        address = f"127.0.0.{10 + index}" if sys.platform == "linux" and index < 240 else ""
        wanted = find(plan.board).agent.rpartition(":")[2]
        port = self._port if wanted in ("", str(AGENT_PORT)) else int(wanted)
        seat: _Seat
        board = RunningBoard(
            plan.firmware or plan.board, plan.board, plan.engine,
            happen=plan.happen, link=plan.link, seed=plan.seed, plugs=plan.plugs,
            interfaces=plan.interfaces, provided=plan.provided, speed=plan.speed,
            secrets=plan.secrets, agent=("127.0.0.1", port), address=address,
            on_event=lambda event: self._events.put((seat, event)),
        )  # fmt: skip
        seat = _Seat(plan, board, address, talks_to_agent(plan))
        return seat

    def _start_boards(self) -> None:
        """Start the boards, as many at a time as there are processors, and print each that runs.

        The table comes with the first board that runs: if none does, the error stands alone.

        Raises:
            StartError: A board does not start.
        """
        if len(self._seats) > 1:
            self._say(None, f"starting {len(self._seats)} boards")
        with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
            starts = {pool.submit(seat.board.start): seat for seat in self._seats}
            try:
                for start in as_completed(starts):
                    start.result()
                    self._started(starts[start])
            finally:
                pool.shutdown(cancel_futures=True)

    def _started(self, seat: _Seat) -> None:
        seat.program = "runs"
        line = seat.board.path
        if self._screen.live:
            self._screen.show(self._table())  # first: later lines scroll below it
        self._say(seat, f"{seat.plan.board} runs on {seat.plan.engine}; its USB line is {line}")

    # --- the agent --------------------------------------------------------------------

    def _start_agent(self) -> None:
        from ...boards.virtual.models.catalog import find
        from ...middleware.environment import environment_domain

        lines: dict[int, list[str]] = {}  # by baud rate
        for seat in self._seats:
            if not find(seat.plan.board).agent and seat.talks:
                lines.setdefault(_baud(seat), []).append(str(seat.board.path))
        arguments = []
        for baud, devices in lines.items():
            arguments += ["serial", "--dev"] if len(devices) == 1 else ["multiserial", "--devs"]
            arguments += [*devices, "--baudrate", str(baud)]
        if any(find(plan.board).agent or plan.plugs for plan in self._plans) or not lines:
            arguments += ["udp4", "--port", str(self._port)]
            self._agent_has_port = True
        # The table shows the boards; beside it only warnings are of interest.
        arguments += ["--verbose", str(_WARNINGS if self._screen.live else _INFO)]
        rules = self._write_rules()
        if rules is not None:
            arguments += ["--control", str(rules)]
        self._agent = AgentProcess(
            arguments, environment_domain(),
            lambda line: self._events.put((None, {"event": "agent", "line": line})),
        )  # fmt: skip

    def _write_rules(self) -> Path | None:
        """Write a rules file that puts the boards into their namespaces."""
        rules = [
            f"[[client]]\naddress = {address!r}\nnamespace = {seat.plan.namespace!r}\n"
            for seat in self._seats
            if seat.plan.namespace
            for address in (str(seat.board.path), seat.address)
            if address
        ]
        if not rules:
            return None
        self._rules = tempfile.TemporaryDirectory(prefix="uros-rules-")
        file = Path(self._rules.name) / "rules.toml"
        file.write_text("\n".join(rules), encoding="utf-8")
        return file

    def _check_agent(self) -> None:
        """Raise ToolError if the agent has ended. Its log has the reason."""
        if self._agent is not None and self._agent.ended:
            self._close()
            option = "; --agent-port chooses its UDP port" if self._agent_has_port else ""
            raise ToolError(f"the agent has ended; its log above has the reason{option}")

    # --- what is shown ----------------------------------------------------------------

    def _say(self, seat: _Seat | None, text: str) -> None:
        alone = len(self._seats) == 1
        name = "board" if seat is None or alone else seat.plan.title
        self._screen.say(f"{name}: {text}")

    def _introduce(self) -> None:
        from ...middleware.environment import environment_domain

        if self._wanted:
            domain = environment_domain()
            self._say(None, f"an agent runs too, in domain {domain}; Ctrl-C ends everything")
        for seat in self._seats:
            command = self._next(seat)
            if command:
                self._say(seat, f"next, in another terminal: {command}")
        if self._wanted:
            command = "uros topic list -t"
            if domain:
                command += f" --domain {domain}"
            self._say(None, f"next, in another terminal: {command}")
        self._say(None, self._help())

    def _next(self, seat: _Seat) -> str:
        """Return the command that a board needs at the other end of its line; "" for none."""
        from ...boards.virtual.models.catalog import find
        from ...middleware.environment import environment_domain
        from ..rover.pid import PORT

        path = shlex.quote(str(seat.board.path))
        wants = find(seat.plan.board).agent.rpartition(":")[2]
        if not seat.talks:
            return "uros pid" if wants == str(PORT) else f"cat {path}"
        if self._wanted:
            return ""
        how = f"udp4 --port {self._port}" if wants else f"serial --dev {path}"
        if not wants and _baud(seat) != _USUAL_BAUD:
            how += f" --baudrate {_baud(seat)}"
        domain = environment_domain()
        return f"uros agent {how}" + (f" --domain {domain}" if domain else "")

    def _help(self) -> str:
        seat = self._seats[0]
        # Other actions may need a value, or have no effect at first, such as usb:plug.
        known = seat.board.happenings
        command = next((example for example in _EXAMPLES if example in known), known[0])
        if len(self._seats) > 1:
            command = f"{seat.plan.title} {command}"
        return _HELP.format(example=command, name=seat.plan.board)

    def _table(self) -> list[Row]:
        from ..agent.status import node_name

        rows = [Row(("BOARD", "PROGRAM", "USB", "NODE", "IN/S", "OUT/S"))]
        for seat in self._seats:
            client = None
            if self._connections is not None:
                client = self._connections.client(seat.board.path, seat.address)
            node, rate_in, rate_out = self._unconnected(seat), "-", "-"
            below = []
            if client is not None:
                names = " ".join(node_name(node_info) for node_info in client["nodes"])
                node = names or "connected"
                if client["rate_over"] < client["age"]:  # else it includes the creation of objects
                    rate_in = f"{client['received']['rate']:.1f}"
                    rate_out = f"{client['sent']['rate']:.1f}"
            elif seat.talks and not self._wanted and not seat.line_open:
                below.append(f"start an agent: {self._next(seat)}")
            seen = ", ".join(f"{name} {shows}" for name, shows in seat.shows.items() if shows)
            if seat.faults:
                seen += f"{', ' * bool(seen)}faults: {' '.join(seat.faults)}"
            cells = (seat.plan.title, seat.program, seat.board.usb, node, rate_in, rate_out)
            rows.append(Row(cells, (*below, seen)))
        return rows

    def _unconnected(self, seat: _Seat) -> str:
        """Return what stands for the node of a board that no agent reports."""
        from ...boards.virtual.models.catalog import find

        if not seat.talks:
            return "-"
        if self._wanted:
            return "not connected"
        # Only an agent of this user's uros reports its boards: another one may have this board.
        if seat.line_open is None or find(seat.plan.board).agent:
            return "no agent seen"
        return "line is open" if seat.line_open else "no agent"

    # --- what happens -----------------------------------------------------------------

    def _loop(self) -> None:
        end = None if self._seconds is None else time.monotonic() + self._seconds
        drawn = 0.0
        while True:
            now = time.monotonic()
            if end is not None and now >= end:
                return
            if now - drawn >= _REDRAW_SECONDS:
                drawn = now
                self._check_agent()
                self._tell_shows(now)
                if self._screen.live:
                    self._screen.show(self._table())
            wait = _REDRAW_SECONDS if end is None else min(_REDRAW_SECONDS, end - now)
            try:
                seat, event = self._events.get(timeout=wait)
            except queue.Empty:
                continue
            self._on_event(seat, event)

    def _on_event(self, seat: _Seat | None, event: dict[str, Any]) -> None:
        kind = event["event"]
        if kind == "agent":
            self._screen.say(event["line"])
        elif kind == "input":
            self._execute(event["line"])
        elif seat is not None:
            self._on_board(seat, kind, event)

    def _on_board(self, seat: _Seat, kind: str, event: dict[str, Any]) -> None:
        if kind == "console":
            alone = len(self._seats) == 1
            line = event["line"]
            self._screen.say(line if alone else f"{seat.plan.title}: {line}")
        elif kind == "usb":
            error = f" ({event['error']})" if event["error"] else ""
            self._say(seat, f"USB {event['state']}{error}")
        elif kind == "line":
            seat.line_open = event["open"]
        elif kind == "baud":
            remedy = f"--baudrate {event['board']}"
            remedy = f"run the board with {remedy}" if self._wanted else f"use {remedy} there"
            self._say(
                seat,
                f"its UART has {event['board']} baud, and the program at the other end of its line"
                f" {event['line']}: both receive noise; {remedy}, or UART(..., {event['line']}) in"
                " the board's program",
            )
        elif kind == "ready":
            seat.faults = event["faults"]
        elif kind == "part":
            if event["name"] not in seat.shows:  # the first state is no news
                seat.told[event["name"]] = (0.0, event["shows"])
            seat.shows[event["name"]] = event["shows"]
        elif kind == "reset":
            seat.failed = False
            seat.program = "runs"
            why = _CAUSES.get(event["cause"], "reset")
            self._say(seat, f"{why}: the program starts again")
        elif kind == "asleep":
            seat.program = "asleep"
            seconds = event["ms"] / 1000
            end = f"for {seconds:g} s" if seconds else "until its reset button is pressed"
            self._say(seat, f"machine.deepsleep: the board sleeps {end}")
        elif kind == "ended":
            seat.failed = bool(event["traceback"])
            seat.program = "failed" if seat.failed else "ended"
            self._say(seat, "the program has ended; Ctrl-C switches the board off")
        elif kind == "happened":
            seat.faults = event["faults"]
            part = event["spec"].partition(":")[0] + ":"
            others = [
                fault for fault in seat.faults if fault.startswith(part) and fault != event["spec"]
            ]
            done = f"done: {event['spec']}"
            if others:
                done += f"; other faults of this part: {', '.join(others)}"
            self._say(seat, event["error"] or done)
        elif kind == "heap":
            used = event["used"] - event["base"]
            self._say(seat, f"heap: {used} bytes in use by the program")
        elif kind == "gone":
            raise ToolError(f"{seat.plan.title}: the board's process has ended")

    def _tell_shows(self, now: float) -> None:
        """Without a table, print the states of parts that have changed."""
        if self._screen.live:
            return
        for seat in self._seats:
            for name, shows in seat.shows.items():
                when, printed = seat.told[name]
                if shows != printed and now - when >= _TELL_SECONDS:
                    seat.told[name] = (now, shows)
                    self._say(seat, f"{name} {shows}")

    def _execute(self, line: str) -> None:
        if not line:
            return
        if line in ("help", "?"):
            self._say(None, self._help())
            return
        if line in ("quit", "exit"):
            raise KeyboardInterrupt
        title, _, rest = line.partition(" ")
        targets = [seat for seat in self._seats if seat.plan.title == title]
        if targets:
            line = rest.strip()
        else:
            part = line.partition(":")[0] + ":"
            having = [
                seat
                for seat in self._seats
                if any(spec.startswith(part) for spec in seat.board.happenings)
            ]
            targets = self._seats if len(self._seats) == 1 else having
        if line == "all:off":
            for seat in targets or self._seats:
                seat.board.press("happen", spec=line)
            return
        if len(targets) != 1:
            known = ", ".join(seat.plan.title for seat in self._seats)
            self._say(None, f"put the board and a space before the command: {known}")
            return
        seat = targets[0]
        if line == "heap" and seat.plan.engine != "micropython":
            self._say(seat, "heap needs the engine micropython")
        elif line in ("reset", "heap"):
            seat.board.press(line)
        else:
            seat.board.press("happen", spec=line)

    def _close(self) -> None:
        self._screen.close()
        if self._connections is not None:
            self._connections.close()
        # The agent first: it would log the end of a board as a lost device.
        agent, self._agent = self._agent, None
        if agent is not None:
            agent.close()
        for seat in self._seats:
            seat.board.stop()
        if agent is not None:
            while not self._events.empty():
                _, event = self._events.get()
                if event["event"] == "agent":
                    self._screen.say(event["line"])
        if self._rules is not None:
            self._rules.cleanup()


def _baud(seat: _Seat) -> int:
    """Return the baud rate of the agent for a board."""
    return seat.plan.baud or seat.board.baud


def talks_to_agent(plan: Plan) -> bool:
    """Return whether the program is a ROS node, by its imports."""
    from ...boards.virtual.engine.runner import firmware_folder
    from ...boards.virtual.models.catalog import find

    folder = Path(plan.firmware) if plan.firmware else firmware_folder(find(plan.board))
    return any("uros.client" in file.read_text(encoding="utf-8") for file in folder.rglob("*.py"))


def _read_input(events: queue.Queue[tuple[_Seat | None, dict[str, Any]]]) -> None:
    """Put lines of standard input into the queue.

    Not through sys.stdin: a thread that reads would hold its lock at exit.
    """
    try:
        if os.isatty(0) and os.tcgetpgrp(0) != os.getpgrp():
            return  # a background process that reads would be stopped
        rest = b""
        while chunk := os.read(0, 4096):
            *lines, rest = (rest + chunk).split(b"\n")
            for line in lines:
                text = line.decode("utf-8", "replace").strip()
                events.put((None, {"event": "input", "line": text}))
    except OSError:
        pass  # closed
