"""``uros board run``"""

from __future__ import annotations

import argparse
import os
import queue
import shlex
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from .agent_process import AgentProcess
from .board_list import check_name
from .common import add_engine, add_interfaces, positive_float
from .errors import ToolError

if TYPE_CHECKING:
    from ..boards.running import RunningBoard

_EPILOG: Final = """\
The firmware is the one for the real board, unchanged. The USB line is a pseudo-terminal: an
agent, or a serial console, opens it like /dev/ttyACM0.

While the board runs, each line of input is a command:

  sht3x:nack     make that go wrong; 'uros board list NAME' tells what can
  sht3x:off      mend it; all:off mends everything
  usb:unplug     pull the cable; usb:plug puts it in again
  reset          press the reset button
  heap           what is in use on the heap (engine micropython)

examples:

  uros board run ra6m5_sensor_node --agent
  uros board run ra6m5_sensor_node --link /tmp/board --fault sht3x:crc
  uros board run ra6m5_sensor_node --firmware my_program --plug esp8266:uart=1
  uros board run ra6m5_sensor_node --firmware my_program --interfaces my_msgs
"""


_COMMANDS: Final = (
    "type what goes wrong, one a line: sht3x:nack, all:off, usb:unplug; or reset, heap"
    " ('uros board list NAME' has all)"
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = _EPILOG
    parser.add_argument("board", metavar="NAME", help="see 'uros board list'")
    add_engine(parser)
    parser.add_argument(
        "--firmware", metavar="DIR", help="another program for the board: a folder with a main.py"
    )
    add_interfaces(parser)
    parser.add_argument(
        "--fault", metavar="SPEC", action="append", default=[],
        help="begin with a fault, such as sht3x:nack; may be repeated",
    )  # fmt: skip
    parser.add_argument(
        "--plug", metavar="SPEC", action="append", default=[],
        help="plug in a modem or a radio, such as esp8266:uart=1; may be repeated",
    )  # fmt: skip
    parser.add_argument(
        "--link",
        metavar="PATH",
        help="where the USB line is to be found (default: a name of its own)",
    )
    parser.add_argument(
        "--agent",
        action="store_true",
        help="also run an agent on the line, in domain ROS_DOMAIN_ID",
    )
    parser.add_argument(
        "--seconds", type=positive_float, metavar="S",
        help="end after so long; exit status 1 if the program has ended with an error by then"
        " (default: until Ctrl-C)",
    )  # fmt: skip
    parser.add_argument(
        "--seed", type=int, default=0, metavar="N", help="another room and another board id"
    )


def run(args: argparse.Namespace) -> int:
    """Run until Ctrl-C or the end of the time; the exit status. Raises ToolError."""
    if sys.platform == "win32":
        raise ToolError("virtual boards need pseudo-terminals: use Linux, macOS or WSL")
    from ..boards.board import BoardError
    from ..boards.running import RunningBoard, StartError

    check_name(args.board)
    events: queue.Queue[dict[str, Any]] = queue.Queue()
    try:
        board = RunningBoard(
            args.firmware or args.board, args.board, args.engine,
            faults=args.fault, link=args.link, seed=args.seed, on_event=events.put,
            plugs=args.plug, interfaces=args.interfaces,
        )  # fmt: skip
        with board:
            return _Session(board, args, events).run()
    except (StartError, BoardError) as error:
        raise ToolError(str(error)) from error
    except KeyboardInterrupt:
        print()
        return 0


class _Session:
    """What goes on between a running board and a person."""

    def __init__(
        self, board: RunningBoard, args: argparse.Namespace, events: queue.Queue[dict[str, Any]]
    ) -> None:
        self._board = board
        self._args = args
        self._events = events
        self._agent: AgentProcess | None = None
        self._failed = False

    def run(self) -> int:
        args = self._args
        end = None if args.seconds is None else time.monotonic() + args.seconds
        self._say(f"{args.board} runs on {args.engine}; its USB line is {self._board.path}")
        self._say(self._next_step())
        self._say(_COMMANDS)
        threading.Thread(target=_read_input, args=(self._events,), daemon=True).start()
        try:
            while end is None or time.monotonic() < end:
                try:
                    left = None if end is None else max(0.0, end - time.monotonic())
                    self._on_event(self._events.get(timeout=left))
                except queue.Empty:
                    break
        finally:
            if self._agent is not None:
                self._agent.close()
        return int(self._failed)

    def _say(self, text: str) -> None:
        print(f"board: {text}", flush=True)

    def _next_step(self) -> str:
        path = shlex.quote(str(self._board.path))
        if self._args.agent:
            return "the agent comes as soon as USB is configured; Ctrl-C ends both"
        if _talks_to_agent(self._args):
            return f"next, in another terminal: uros agent serial --dev {path}"
        return f"next, in another terminal: cat {path}"

    def _on_event(self, event: dict[str, Any]) -> None:
        kind = event["event"]
        if kind == "console":
            print(event["line"], flush=True)
        elif kind == "usb":
            error = f" ({event['error']})" if event["error"] else ""
            self._say(f"USB {event['state']}{error}")
            if event["state"] == "configured" and self._args.agent:
                from ..middleware.base import environment_domain

                if self._agent is None or self._agent.ended:
                    self._agent = AgentProcess(self._board.path, environment_domain())
        elif kind == "reset":
            self._failed = False
            self._say("reset: the program starts anew")
        elif kind == "ended":
            self._failed = bool(event["traceback"])
            self._say("the program has ended; Ctrl-C switches the board off")
        elif kind == "fault":
            self._say(event["error"] or f"done: {event['spec']}")
        elif kind == "heap":
            self._say(f"heap: {event['used'] - event['base']} bytes in use by the program")
        elif kind == "input":
            self._obey(event["line"])
        elif kind == "gone":
            raise ToolError("the board's process has ended")

    def _obey(self, line: str) -> None:
        if line == "reset":
            self._board.press("reset")
        elif line in ("help", "?"):
            self._say(_COMMANDS)
        elif line == "heap":
            if self._args.engine != "micropython":
                self._say("only the engine micropython knows its heap")
            else:
                self._board.press("heap")
        elif line:
            self._board.press("fault", spec=line)


def _talks_to_agent(args: argparse.Namespace) -> bool:
    """Whether the program is a ROS node, as far as its imports tell."""
    from ..boards.board import BOARDS
    from ..boards.running import firmware_folder

    folder = Path(args.firmware) if args.firmware else firmware_folder(BOARDS[args.board])
    return any("uros.client" in it.read_text(encoding="utf-8") for it in folder.rglob("*.py"))


def _read_input(events: queue.Queue[dict[str, Any]]) -> None:
    """Lines of standard input, as events. Not through sys.stdin, whose lock a thread that reads
    would keep at exit."""
    try:
        if os.isatty(0) and os.tcgetpgrp(0) != os.getpgrp():
            return  # reading in the background would stop us
        rest = b""
        while chunk := os.read(0, 4096):
            *lines, rest = (rest + chunk).split(b"\n")
            for line in lines:
                text = line.decode("utf-8", "replace").strip()
                events.put({"event": "input", "line": text})
    except OSError:
        pass  # closed
