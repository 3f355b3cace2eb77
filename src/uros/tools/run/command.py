"""``uros run``: run an example node of uros."""

from __future__ import annotations

import argparse
import contextlib
import io
import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TextIO

from ...host.stop_signals import Terminated
from ..common import domain
from ..errors import ToolError, UsageError, did_you_mean

if TYPE_CHECKING:
    from ...client.remap import Remap
    from ...host.direct import Direct


class Program(NamedTuple):
    """An example node.

    Attributes:
        help: What it does.
        module: Its module below ``uros.tools.run``.
        node: Its class.
    """

    help: str
    module: str
    node: str


PROGRAMS: Final = {
    "talker": Program("publishes Hello World on chatter, once a second", "talker", "Talker"),
    "listener": Program("prints what is said on chatter", "listener", "Listener"),
    "trigger_service": Program(
        "serves srv_trigger_py (std_srvs/Trigger)", "trigger_service", "TriggerService"
    ),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros run``."""
    parser.add_argument(
        "name", metavar="NAME", nargs="?", help=f"node to run: {', '.join(PROGRAMS)}"
    )
    # As in 'ros2 run PACKAGE EXECUTABLE', which the error names.
    parser.add_argument("executable", nargs="?", help=argparse.SUPPRESS)
    parser.add_argument("--list", action="store_true", help="list the nodes and their modules")
    parser.add_argument(
        "--domain", type=domain, metavar="N", help="ROS domain (default: ROS_DOMAIN_ID, or 0)"
    )
    parser.add_argument(
        "-r", "--remap", metavar="OLD:=NEW", action="append", default=[],
        help="remap a name: chatter:=/news, __node:=other, __ns:=/lab; may be repeated",
    )  # fmt: skip
    parser.add_argument("--ros-args", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument(
        "-m", "--middleware", choices=("auto", "dds", "rtps", "ros2"), default="auto",
        help="middleware, as with 'uros agent' (default: auto)",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Run a node until Ctrl-C.

    Raises:
        ToolError: There is no such node, or a remap rule is malformed.
        UsageError: A package and an executable are given.
    """
    if args.list:
        for name, program in PROGRAMS.items():
            print(f"{name:<17}{program.help} (uros.tools.run.{program.module})")
        return 0
    if args.executable is not None:
        raise UsageError(
            f"uros run has example nodes, one at a time ({', '.join(PROGRAMS)}); nodes of ROS"
            " packages are run by 'ros2 run' of ROS 2"
        )
    if args.name not in PROGRAMS:
        what = "name a node to run" if args.name is None else f"there is no node {args.name!r}"
        hint = "" if args.name is None else did_you_mean(args.name, PROGRAMS)
        raise ToolError(f"{what}{hint} (nodes: {', '.join(PROGRAMS)})")
    program = PROGRAMS[args.name]
    remap = _remap(args.remap)
    make: Any = getattr(import_module(f"uros.tools.run.{program.module}"), program.node)
    options: dict[str, Any] = {"domain_id": args.domain, "remap": remap}
    if args.middleware != "auto":
        options["transport"] = _connection(args.middleware, args.domain)
    lines = _Lines(sys.stdout)
    try:
        with contextlib.redirect_stdout(lines):
            node = make(**options)
            try:
                while not lines.ended:
                    node.spin_once()
            finally:
                node.destroy_node()
    except (KeyboardInterrupt, Terminated):
        pass  # the usual ends
    if lines.ended:
        raise BrokenPipeError
    return 0


class _Lines(io.TextIOBase):
    """Standard output of a node, flushed after each write.

    A closed reader sets ``ended``: an error would be logged, which fails again.
    """

    def __init__(self, out: TextIO) -> None:
        self.ended = False
        self._out = out

    def write(self, text: str) -> int:
        try:
            if not self.ended:
                self._out.write(text)
                self._out.flush()
        except BrokenPipeError:
            self.ended = True
        return len(text)


def _connection(middleware: str, domain: int | None) -> Direct:
    """Return the ``transport`` of a host's node on a middleware; None: ROS_DOMAIN_ID's domain."""
    from ...host.direct import Direct
    from ...middleware import open_middleware
    from ...middleware.environment import environment_domain

    return Direct(open_middleware(middleware), environment_domain() if domain is None else domain)


def _remap(rules: list[str]) -> Remap | None:
    from ...client.remap import Remap

    try:
        return Remap(*rules) if rules else None
    except ValueError as error:
        raise ToolError(f"--remap: {error}") from error
