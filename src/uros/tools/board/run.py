"""``uros board run``: run virtual boards with their firmware."""

from __future__ import annotations

import argparse
import re
import shlex
import sys
from pathlib import Path
from typing import Final

from ..agent.options.transports import port
from ..common import add_engine, add_interfaces, know_distro, positive_float, positive_int
from ..errors import ToolError
from .build import add_provided, add_secrets
from .list import check_name
from .simulation import AGENT_PORT, Plan, Simulation, titles

# How a README, such as that of 'uros board new', says which board its program is for.
_README_COMMAND: Final = re.compile(r"^ *(?:\$ )?uros board run (\w+) --firmware\b", re.MULTILINE)

_EPILOG: Final = """\
The firmware is that of the real board, unchanged. The USB line is a pseudo-terminal: an agent or
a serial console opens it like /dev/ttyACM0. Boards whose program talks to an agent get one, in the
domain ROS_DOMAIN_ID, unless --no-agent is given.

While a board runs, each line of input is a command. With several boards, the board's name and a
space go before it if more than one board could be meant:

  button:tap     do this action; 'uros board list NAME' lists the actions
  sht3x:nack     inject this fault; the same list has the faults
  sht3x:off      clear the faults of a part; all:off clears all faults
  usb:unplug     unplug the cable; usb:plug plugs it in again
  reset          press the reset button
  heap           print the memory in use on the heap (engine micropython)
  quit           exit, as Ctrl-C does

examples:

  uros board run esp32_button_led
  uros board run sprturtlebot spresense_camera
  uros board run ra6m5_sensor_node --no-agent --link /tmp/board --fault sht3x:crc
  uros board run ra6m5_sensor_node --firmware my_program --plug esp8266:uart=1
  uros board run ra6m5_sensor_node --firmware my_program --interfaces my_msgs
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros board run``."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = _EPILOG
    parser.add_argument(
        "boards", metavar="NAME", nargs="+", help="name of a board; 'uros board list' lists them"
    )
    add_engine(parser)
    parser.add_argument(
        "--firmware",
        metavar="DIR",
        help="folder with another program (main.py), or the board whose program to run",
    )
    add_interfaces(parser)
    add_secrets(parser)
    add_provided(parser)
    parser.add_argument(
        "--fault", metavar="SPEC", action="append", default=[],
        help="action or fault at the start, such as sht3x:nack; may be repeated",
    )  # fmt: skip
    parser.add_argument(
        "--plug", metavar="SPEC", action="append", default=[],
        help="plug in a modem or radio, such as esp8266:uart=1; may be repeated",
    )  # fmt: skip
    parser.add_argument(
        "--link",
        metavar="PATH",
        help="path of the USB line (default: a temporary one)",
    )
    add_agent(parser)
    parser.add_argument(
        "--baudrate", "-b", metavar="N", type=positive_int,
        help="baud rate of the agent at a board's UART (default: that of the board's own program,"
        " 115200 or 921600); no matter for a board with its own USB",
    )  # fmt: skip
    parser.add_argument(
        "--speed", type=positive_float, default=1.0, metavar="X",
        help="run the time of the boards and their world X times as fast; stamps are wrong then",
    )  # fmt: skip
    parser.add_argument(
        "--seconds", type=positive_float, metavar="S",
        help="exit after so many seconds; exit status 1 if the program has ended with an error"
        " (default: until Ctrl-C)",
    )  # fmt: skip
    parser.add_argument(
        "--seed", type=int, default=0, metavar="N",
        help="seed of tolerances, room and board id, for the first of several boards"
    )  # fmt: skip


def add_agent(parser: argparse.ArgumentParser) -> None:
    """Declare ``--agent``, ``--no-agent`` and ``--agent-port``."""
    parser.add_argument(
        "--agent", action=argparse.BooleanOptionalAction, default=None,
        help="whether to run an agent for the boards (default: if a program talks to one)",
    )  # fmt: skip
    parser.add_argument(
        "--agent-port", type=port, default=AGENT_PORT, metavar="N",
        help=f"UDP port of the agent for boards with Wi-Fi (default: {AGENT_PORT})",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Run the boards until Ctrl-C or the end of the time.

    Raises:
        ToolError: A board cannot run, or an option is wrong.
    """
    if sys.platform == "win32":
        raise ToolError("virtual boards need pseudo-terminals: use Linux, macOS or WSL")
    know_distro(args)
    for name in args.boards:
        _refuse_program(name)
        check_name(name)
    if len(args.boards) > 1:
        for option in ("firmware", "link"):
            if getattr(args, option) is not None:
                raise ToolError(f"--{option} is for one board; 'uros fleet' has it for each")
    plans = [
        Plan(
            title, name, args.firmware, args.engine, args.seed + index, args.fault, args.plug,
            args.interfaces, args.provided, args.link, args.speed, baud=args.baudrate,
            secrets=args.secrets,
        )
        for index, (title, name) in enumerate(zip(titles(args.boards), args.boards, strict=True))
    ]  # fmt: skip
    return Simulation(plans, args.agent, args.agent_port, args.seconds).run()


def _refuse_program(name: str) -> None:
    """Refuse the folder of a program in place of a board.

    Raises:
        ToolError: It is one; the text has the command that runs it.
    """
    from ...boards.virtual.models.catalog import BOARDS

    folder = Path(name)
    if name in BOARDS or not (folder / "main.py").is_file():
        return
    board = folder.resolve().name
    if board not in BOARDS:
        board = _board_of_readme(folder)
    where = shlex.quote(name)
    if board in BOARDS:
        raise ToolError(
            f"{name} is the folder of a program: uros board run {board} --firmware {where}"
        )
    raise ToolError(
        f"{name} is the folder of a program: uros board run BOARD --firmware {where} ('uros board"
        " list' has the boards, such as esp32_publisher)"
    )


def _board_of_readme(folder: Path) -> str:
    """Return the board that a program's README names in its command, "" if it names none."""
    try:
        text = (folder / "README.md").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    command = _README_COMMAND.search(text)
    return command[1] if command else ""
