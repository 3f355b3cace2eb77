"""The command line: finds the verb, imports its module, runs it, reports errors.

A verb's module has ``add_arguments(parser)`` and ``run(args) -> exit status``. It is imported
only when its verb is used, so that ``uros --help`` costs nothing.

Exit status: 0 done, 1 an error that the user can do something about (one line on standard error),
2 a wrong command line, 130 interrupted, 141 nobody reads the output any more.
"""

from __future__ import annotations

import argparse
import errno
import os
import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Final, NamedTuple

from .. import __version__
from ..printable import guarded, printable


class Verb(NamedTuple):
    help: str
    module: str
    ros_args: bool = False  # whether ``--ros-args`` is tolerated


class Group(NamedTuple):
    help: str
    members: Mapping[str, Verb | Group]


_AGENT: Final = Verb("serve micro-ROS boards", "agent.command", ros_args=True)
_ROOT: Final = Group(
    "micro-ROS in Python: the agent and the tools.",
    {
        "agent": _AGENT,
        "demo": Verb("run a virtual board through the agent", "demo"),
        "topic": Group(
            "look at the topics of a ROS 2 network, and publish on them",
            {
                "list": Verb("list the topics", "topic.list"),
                "info": Verb("show who publishes and subscribes to a topic", "topic.info"),
                "echo": Verb("print the messages of a topic", "topic.echo"),
                "hz": Verb("print the rate of a topic", "topic.hz"),
                "pub": Verb("publish messages on a topic", "topic.pub"),
            },
        ),
        "node": Group(
            "look at the nodes of a ROS 2 network",
            {
                "list": Verb("list the nodes", "node.list"),
                "info": Verb("show what a node publishes, subscribes to and serves", "node.info"),
            },
        ),
        "image": Group(
            "look at the pictures of a topic, keep them",
            {
                "view": Verb("show the pictures of a topic live in a browser", "image.view"),
                "save": Verb("write the pictures of a topic to files", "image.save"),
            },
        ),
        "pid": Verb("tune the wheels of a rover, with a live plot in a browser", "rover.pid"),
        "calibrate": Verb(
            "find a rover's wheel radii and track from driven squares", "rover.calibrate"
        ),
        "service": Group(
            "look at the services of a ROS 2 network, and call them",
            {
                "list": Verb("list the services", "service.list"),
                "type": Verb("print the type of a service", "service.type"),
                "find": Verb("list the services of a type", "service.find"),
                "call": Verb("call a service", "service.call"),
            },
        ),
        "run": Verb("run one of the nodes that come with uros", "run.command"),
        "interface": Group(
            "look at the types of messages, services and actions, write them for boards",
            {
                "list": Verb("list the types", "interface.list"),
                "packages": Verb("list the packages that have types", "interface.packages"),
                "package": Verb("list the types of a package", "interface.package"),
                "show": Verb("show the definition of a type", "interface.show"),
                "proto": Verb("print a message as YAML, to be filled in", "interface.proto"),
                "build": Verb("write modules of types for a board", "interface.build"),
            },
        ),
        "trace": Verb("show what boards and agent say to each other", "capture.trace"),
        "replay": Verb(
            "play a capture's boards to an agent, compare its answers", "capture.replay"
        ),
        "board": Group(
            "run virtual boards, build programs for real ones",
            {
                "list": Verb("list the virtual boards", "board.list"),
                "run": Verb("run virtual boards with their firmware", "board.run"),
                "build": Verb("write the files that a board's program needs", "board.build"),
                "index": Verb("write a package index for MicroPython's mip", "board.index"),
                "deploy": Verb("put a program on a real board, show its console", "board.deploy"),
                "console": Verb("show what a real board prints", "board.console"),
            },
        ),
        "fleet": Verb("run the virtual boards of a file", "fleet"),
        "doctor": Verb("find out why boards and ROS 2 do not meet", "doctor.command"),
    },
)

_INTERRUPTED: Final = 130
_BROKEN_PIPE: Final = 141


def main(argv: list[str] | None = None) -> int:
    """``uros``. ``argv`` is what follows the command's name; the result is the exit status."""
    arguments = sys.argv[1:] if argv is None else argv
    return _guard(lambda: _run_group("uros", _ROOT, arguments))


def agent_main(argv: list[str] | None = None) -> int:
    """``MicroXRCEAgent`` and ``micro_ros_agent``: the same as ``uros agent``."""
    arguments = sys.argv[1:] if argv is None else argv
    return _guard(lambda: _run_verb(os.path.basename(sys.argv[0]), _AGENT, arguments))


def _run_group(prog: str, group: Group, argv: list[str]) -> int:
    if argv and argv[0] in group.members:
        name, rest = argv[0], argv[1:]
        member = group.members[name]
        if isinstance(member, Verb):
            return _run_verb(f"{prog} {name}", member, rest)
        return _run_group(f"{prog} {name}", member, rest)
    width = max(map(len, group.members)) + 2
    parser = argparse.ArgumentParser(
        prog=prog,
        usage=f"{prog} COMMAND ...",
        description=group.help,
        epilog="\n".join(
            [
                "commands:",
                *[f"  {name:<{width}}{member.help}" for name, member in group.members.items()],
                "",
                f"'{prog} COMMAND --help' tells more.",
            ]
        ),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    if group is _ROOT:
        parser.add_argument("--version", action="version", version=f"uros {__version__}")
    if argv and not argv[0].startswith("-"):
        from .errors import did_you_mean

        parser.error(
            f"there is no command {argv[0]!r}{did_you_mean(argv[0], group.members)}"
            f" (commands: {', '.join(group.members)})"
        )
    parser.parse_args(argv)
    parser.print_help()
    return 0


def _run_verb(prog: str, verb: Verb, argv: list[str]) -> int:
    module = import_module(f"uros.tools.{verb.module}")
    parser = argparse.ArgumentParser(prog=prog, description=verb.help)
    module.add_arguments(parser)
    args, unknown = parser.parse_known_args(without_ros_args(argv) if verb.ros_args else argv)
    if unknown:
        parser.error(f"unrecognized arguments: {' '.join(unknown)}{_close_option(parser, unknown)}")
    status: int = module.run(args)
    return status


def _close_option(parser: argparse.ArgumentParser, unknown: list[str]) -> str:
    import re

    from .errors import did_you_mean

    known = dict.fromkeys(re.findall(r"(?<!\S)--[a-z][a-z0-9-]*", parser.format_help()))
    options = [word.partition("=")[0] for word in unknown if word.startswith("--")]
    return did_you_mean(options[0], known) if options else ""


def without_ros_args(argv: list[str]) -> list[str]:
    """``argv`` without ``--ros-args … [--]``, which ``ros2 run`` and launch files append."""
    kept = []
    within = False
    for word in argv:
        if within:
            within = word != "--"
        elif word == "--ros-args":
            within = True
        else:
            kept.append(word)
    return kept


def _complete_streams() -> None:
    """Put /dev/null where we were started without standard streams (``>&-``): else the next
    socket would be standard output.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            descriptor = os.open(os.devnull, os.O_RDWR)  # the lowest that is free
            setattr(sys, name, open(descriptor, mode, encoding="utf-8", closefd=False))


def _guard(run: Callable[[], int]) -> int:
    """Run a command with guarded output; its exit status."""
    _complete_streams()
    streams = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = guarded(sys.stdout), guarded(sys.stderr)
    try:
        return _reported(run)
    finally:
        sys.stdout, sys.stderr = streams


def _reported(run: Callable[[], int]) -> int:
    try:
        try:
            status = run()
        except SystemExit as stop:  # argparse, after it has said why
            status = stop.code if isinstance(stop.code, int) else int(stop.code is not None)
        sys.stdout.flush()
        return status
    except KeyboardInterrupt:
        return _INTERRUPTED
    except BrokenPipeError:
        # Python flushes at exit once more, and would complain once more.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _BROKEN_PIPE
    except OSError as error:
        if error.errno != errno.ENOSPC:
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # likewise
        print(f"uros: the output cannot be written: {error.strerror}", file=sys.stderr)
        return 1
    except Exception as error:
        if not isinstance(error, _user_errors()):
            raise
        print(f"uros: {printable(' '.join(str(error).split()))}", file=sys.stderr)
        return 1


def _user_errors() -> tuple[type[Exception], ...]:
    from ..interfaces.errors import InterfaceError
    from ..middleware.base import MiddlewareError
    from .errors import ToolError

    return ToolError, MiddlewareError, InterfaceError


if __name__ == "__main__":
    sys.exit(main())
