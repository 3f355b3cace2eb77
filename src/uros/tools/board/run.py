"""``uros board run``"""

from __future__ import annotations

import argparse
import sys
from typing import Final

from ..agent.options.transports import port
from ..common import add_engine, add_interfaces, know_distro, positive_float
from ..errors import ToolError
from .list import check_name
from .simulation import AGENT_PORT, Plan, Simulation, titles

_EPILOG: Final = """\
The firmware is the one for the real board, unchanged. The USB line is a pseudo-terminal: an
agent, or a serial console, opens it like /dev/ttyACM0. Boards whose program talks to an agent
get one, in the domain ROS_DOMAIN_ID; --no-agent leaves it out.

While a board runs, each line of input is a command; with several boards, the board's name and a
space go before it where it is not clear which one is meant:

  button:tap     do that; 'uros board list NAME' tells what can be done
  sht3x:nack     make that go wrong; so does the list
  sht3x:off      mend it; all:off mends everything
  usb:unplug     pull the cable; usb:plug puts it in again
  reset          press the reset button
  heap           what is in use on the heap (engine micropython)
  quit           as Ctrl-C

examples:

  uros board run esp32_button_led
  uros board run sprturtlebot spresense_camera
  uros board run ra6m5_sensor_node --no-agent --link /tmp/board --fault sht3x:crc
  uros board run ra6m5_sensor_node --firmware my_program --plug esp8266:uart=1
  uros board run ra6m5_sensor_node --firmware my_program --interfaces my_msgs
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = _EPILOG
    parser.add_argument("boards", metavar="NAME", nargs="+", help="see 'uros board list'")
    add_engine(parser)
    parser.add_argument(
        "--firmware", metavar="DIR", help="another program for the board: a folder with a main.py"
    )
    add_interfaces(parser)
    parser.add_argument(
        "--fault", metavar="SPEC", action="append", default=[],
        help="what happens at the start, such as sht3x:nack; may be repeated",
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
    add_agent(parser)
    parser.add_argument(
        "--speed", type=positive_float, default=1.0, metavar="X",
        help="let the time of the boards and their world go X times as fast; what they stamp is"
        " wrong then",
    )  # fmt: skip
    parser.add_argument(
        "--seconds", type=positive_float, metavar="S",
        help="end after so long; exit status 1 if the program has ended with an error by then"
        " (default: until Ctrl-C)",
    )  # fmt: skip
    parser.add_argument(
        "--seed", type=int, default=0, metavar="N",
        help="other parts, another room and another board id; of several boards the first one's"
    )  # fmt: skip


def add_agent(parser: argparse.ArgumentParser) -> None:
    """``--agent``, ``--no-agent`` and ``--agent-port``."""
    parser.add_argument(
        "--agent", action=argparse.BooleanOptionalAction, default=None,
        help="run an agent for the boards, or do not (default: if a program talks to one)",
    )  # fmt: skip
    parser.add_argument(
        "--agent-port", type=port, default=AGENT_PORT, metavar="N",
        help=f"where boards with Wi-Fi find the agent, at 127.0.0.1 (default: {AGENT_PORT})",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Run until Ctrl-C or the end of the time; the exit status. Raises ToolError."""
    if sys.platform == "win32":
        raise ToolError("virtual boards need pseudo-terminals: use Linux, macOS or WSL")
    know_distro(args)
    for name in args.boards:
        check_name(name)
    if len(args.boards) > 1:
        for option in ("firmware", "link"):
            if getattr(args, option) is not None:
                raise ToolError(f"--{option} is for one board; 'uros fleet' takes one of each")
    plans = [
        Plan(
            title, name, args.firmware, args.engine, args.seed + index, args.fault, args.plug,
            args.interfaces, args.link, args.speed,
        )
        for index, (title, name) in enumerate(zip(titles(args.boards), args.boards, strict=True))
    ]  # fmt: skip
    return Simulation(plans, args.agent, args.agent_port, args.seconds).run()
