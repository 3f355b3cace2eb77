"""The command line: finds the verb, imports its module, runs it, reports errors.

A verb's module has ``add_arguments(parser)`` and ``run(args) -> exit status``. It is imported
only when its verb is used, so that ``uros --help`` stays cheap.

Exit status: 0 success, 1 an error that the user can fix, 2 a wrong command line or environment
variable, 130 interrupted, 141 the reader of the output has closed it. An error is one line on
standard error.
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
from ..host.stop_signals import stop_signals
from ..printable import guarded, printable
from .parser import Parser


class Verb(NamedTuple):
    """A command that a module implements.

    Attributes:
        help: What the command does.
        module: The module below ``uros.tools``.
        ros_args: Whether ``--ros-args`` is accepted and ignored.
        words: The commands that the module itself takes.
    """

    help: str
    module: str
    ros_args: bool = False
    words: tuple[str, ...] = ()


class Group(NamedTuple):
    """A command that has commands of its own.

    Attributes:
        help: What its commands do.
        members: The commands by name.
        option: An option of some commands that is accepted before their name too.
    """

    help: str
    members: Mapping[str, Verb | Group]
    option: str = ""


_AGENT: Final = Verb(
    "serve micro-ROS boards", "agent.command", ros_args=True, words=("status", "check", "ament")
)
_ROOT: Final = Group(
    "micro-ROS in Python: the agent and the tools",
    {
        "agent": _AGENT,
        "demo": Verb("run a virtual board, an agent and a ROS 2 subscriber", "demo"),
        "topic": Group(
            "list, print and publish topics",
            {
                "bw": Verb("print the bandwidth that topics use", "topic.bw"),
                "delay": Verb("print how old messages are, by their header", "topic.delay"),
                "echo": Verb("print messages of a topic", "topic.echo"),
                "find": Verb("list topics of a type", "topic.find"),
                "hz": Verb("print the average publishing rate of topics", "topic.hz"),
                "info": Verb("print information about a topic", "topic.info"),
                "list": Verb("list topics", "topic.list"),
                "pub": Verb("publish messages to a topic", "topic.pub"),
                "type": Verb("print the type of a topic", "topic.type"),
            },
            "--include-hidden-topics",
        ),
        "node": Group(
            "list nodes and print information about them",
            {
                "list": Verb("list nodes", "node.list"),
                "info": Verb("print information about a node", "node.info"),
            },
        ),
        "bag": Group(
            "record topics into bags and play them",
            {
                "convert": Verb("write bags with other settings", "bag.convert"),
                "info": Verb("print information about a bag", "bag.info"),
                "play": Verb("publish the messages of a bag", "bag.play"),
                "record": Verb("record topics into a bag", "bag.record"),
                "recover": Verb("finish a bag whose recording was cut off", "bag.recover"),
                "reindex": Verb("write metadata.yaml of a bag from its files", "bag.reindex"),
            },
        ),
        "image": Group(
            "show and save images of a topic",
            {
                "view": Verb("show the images of a topic live in a browser", "image.view"),
                "save": Verb("save the images of a topic to files", "image.save"),
            },
        ),
        "plot": Verb("plot numbers of topics in the terminal", "plot.command"),
        "pid": Verb("tune the wheel controllers of a rover, with a live plot", "rover.pid"),
        "calibrate": Verb(
            "calibrate a rover's wheel radii and track by driving squares", "rover.calibrate"
        ),
        "service": Group(
            "list and call services",
            {
                "list": Verb("list services", "service.list"),
                "info": Verb("print information about a service", "service.info"),
                "type": Verb("print the type of a service", "service.type"),
                "find": Verb("list services of a type", "service.find"),
                "call": Verb("call a service", "service.call"),
                "echo": Verb("print the requests and responses of a service", "service.echo"),
            },
            "--include-hidden-services",
        ),
        "action": Group(
            "list actions, and send goals",
            {
                "list": Verb("list actions", "action.list"),
                "info": Verb("print information about an action", "action.info"),
                "type": Verb("print the type of an action", "action.type"),
                "find": Verb("list actions of a type", "action.find"),
                "send_goal": Verb("send a goal, and print its result", "action.send_goal"),
                "echo": Verb("print the messages of an action", "action.echo"),
            },
        ),
        "lifecycle": Group(
            "print and change the states of nodes with a life cycle",
            {
                "get": Verb("print the states of nodes", "lifecycle.get"),
                "list": Verb("list the transitions of a node", "lifecycle.list"),
                "nodes": Verb("list nodes with a life cycle", "lifecycle.nodes"),
                "set": Verb("trigger a transition of a node", "lifecycle.set"),
            },
        ),
        "param": Group(
            "print and set parameters of nodes",
            {
                "delete": Verb("delete a parameter", "param.delete"),
                "describe": Verb("print type and constraints of parameters", "param.describe"),
                "dump": Verb("print all parameters of a node as a file", "param.dump"),
                "get": Verb("print the value of a parameter", "param.get"),
                "list": Verb("list parameters", "param.list"),
                "load": Verb("set parameters from a file", "param.load"),
                "set": Verb("set parameters", "param.set"),
            },
        ),
        "tf": Group(
            "print transforms between coordinate frames",
            {
                "echo": Verb("print the transform between two frames", "tf.echo"),
                "tree": Verb("print the tree of frames", "tf.tree"),
            },
        ),
        "run": Verb("run an example node of uros", "run.command"),
        "interface": Group(
            "show message, service and action types, and build them for boards",
            {
                "list": Verb("list interface types", "interface.list"),
                "packages": Verb("list packages with interface types", "interface.packages"),
                "package": Verb("list the interface types of a package", "interface.package"),
                "show": Verb("print the definition of an interface type", "interface.show"),
                "proto": Verb("print a prototype of a message as YAML", "interface.proto"),
                "build": Verb("build modules of interface types for a board", "interface.build"),
            },
        ),
        "trace": Verb("print the messages between boards and agent", "capture.trace"),
        "replay": Verb("play a capture to an agent and compare its answers", "capture.replay"),
        "board": Group(
            "run virtual boards; build and deploy programs for real ones",
            {
                "list": Verb("list boards", "board.list"),
                "new": Verb("begin a program: main.py, README and test", "board.new"),
                "run": Verb("run virtual boards with their firmware", "board.run"),
                "build": Verb("build a program for a board", "board.build"),
                "index": Verb("build a package index for MicroPython's mip", "board.index"),
                "deploy": Verb("deploy a program to a board and show its console", "board.deploy"),
                "console": Verb("show the console of a real board", "board.console"),
                "stubs": Verb("write type stubs for editors", "board.stubs"),
            },
        ),
        "fleet": Verb("run the virtual boards that a file lists", "fleet"),
        "doctor": Verb("check why boards and ROS 2 nodes do not communicate", "doctor.command"),
        "multicast": Group(
            "send and receive UDP multicast datagrams",
            {
                "receive": Verb("wait for one UDP multicast datagram", "multicast.receive"),
                "send": Verb("send one UDP multicast datagram", "multicast.send"),
                "test": Verb(
                    "send and receive on each network interface of this machine",
                    "multicast.test",
                ),
            },
        ),
        "completion": Verb(
            "print what completes commands in bash, zsh or fish", "completion.command"
        ),
    },
)

# Commands of ros2 that uros does not have, and what there is in their place.
_ORDINARY: Final = "boards are ordinary nodes for 'ros2 {}' of ROS 2"
_ROS2: Final[Mapping[str, str]] = {
    "component": _ORDINARY,
    "daemon": "there is no daemon to start or stop: each command discovers the domain itself",
    "extension_points": "uros has no plug-ins, which 'ros2 {}' of ROS 2 lists",
    "extensions": "uros has no plug-ins, which 'ros2 {}' of ROS 2 lists",
    "launch": _ORDINARY,
    "pkg": "uros makes no ROS packages: 'uros board new' begins a program for a board, 'uros"
    " interface packages' lists packages with types, and the rest is 'ros2 {}' of ROS 2",
    "security": "boards are secured by TLS, an option of 'uros agent'; keystores of DDS are for"
    " 'ros2 {}' of ROS 2",
    "test": "uros has no launch tests, which 'ros2 {}' of ROS 2 runs; 'uros board new' begins a"
    " program with a test",
    "wtf": "uros doctor does that",
}

# The most commands one level down that are named for an unknown one.
_MOST_BELOW: Final = 3

_INTERRUPTED: Final = 130
_BROKEN_PIPE: Final = 141


def commands() -> Group:
    """Return the commands of ``uros``."""
    return _ROOT


def main(argv: list[str] | None = None) -> int:
    """Run ``uros``.

    Args:
        argv: The arguments after the command's name; those of the process by default.

    Returns:
        The exit status.
    """
    arguments = sys.argv[1:] if argv is None else argv
    return _guard(lambda: _run_group("uros", _ROOT, arguments))


def agent_main(argv: list[str] | None = None) -> int:
    """Run ``uros agent`` as ``MicroXRCEAgent`` or ``micro_ros_agent``."""
    arguments = sys.argv[1:] if argv is None else argv
    return _guard(lambda: _run_verb(os.path.basename(sys.argv[0]), _AGENT, arguments))


def _run_group(prog: str, group: Group, argv: list[str]) -> int:
    option = group.option if group.option and argv[:1] == [group.option] else ""
    if option:
        argv = argv[1:]
    if argv and argv[0] in group.members:
        name, rest = argv[0], argv[1:]
        member = group.members[name]
        if isinstance(member, Verb):
            return _run_verb(f"{prog} {name}", member, rest, option)
        return _run_group(f"{prog} {name}", member, rest)
    width = max(map(len, group.members)) + 2
    parser = Parser(
        prog=prog,
        usage=f"{prog} COMMAND ...",
        description=group.help,
        epilog="\n".join(
            [
                "commands:",
                *[f"  {name:<{width}}{member.help}" for name, member in group.members.items()],
                "",
                f"'{prog} COMMAND --help' shows the options of a command.",
            ]
        ),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    if group is _ROOT:
        parser.add_argument("--version", action="version", version=f"uros {__version__}")
    if group.option:
        parser.add_argument(
            group.option, action="store_true", help="for the commands that have this option"
        )
    if argv and not argv[0].startswith("-"):
        from .errors import did_you_mean

        hint = _elsewhere(group, argv[0]) or _below(group, argv[0])
        hint = hint or did_you_mean(argv[0], group.members)
        hint = hint or f" (commands: {', '.join(group.members)})"
        parser.error(f"there is no command {argv[0]!r}{hint}")
    parser.parse_args(argv)
    parser.print_help()
    return 0


def _elsewhere(group: Group, name: str) -> str:
    """Return what there is in place of a command of ros2 that uros does not have, or nothing."""
    if group is not _ROOT or name not in _ROS2:
        return ""
    return f"; {_ROS2[name].format(name)}"


def _below(group: Group, name: str) -> str:
    """Return which commands of this name there are one level down, or nothing."""
    if group is not _ROOT:
        return ""
    found = [
        f"'uros {word} {name}'"
        for word, member in group.members.items()
        if name in (member.words if isinstance(member, Verb) else member.members)
    ]
    more = " or others" * (len(found) > _MOST_BELOW)
    return f"; did you mean {' or '.join(found[:_MOST_BELOW])}{more}?" if found else ""


def _run_verb(prog: str, verb: Verb, argv: list[str], option: str = "") -> int:
    """Run a verb; ``option`` was given before its name, and counts if the verb has it."""
    module = import_module(f"uros.tools.{verb.module}")
    parser = Parser(prog=prog, description=verb.help)
    module.add_arguments(parser)
    if option and parser.has(option):
        argv = [option, *argv]
    args = parser.parse_args(without_ros_args(argv) if verb.ros_args else argv)
    status: int = module.run(args)
    return status


def without_ros_args(argv: list[str]) -> list[str]:
    """Return ``argv`` without ``--ros-args … [--]``, which ``ros2 run`` and launch files add."""
    remaining = []
    within = False
    for word in argv:
        if within:
            within = word != "--"
        elif word == "--ros-args":
            within = True
        else:
            remaining.append(word)
    return remaining


def _complete_streams() -> None:
    """Open /dev/null for standard streams that are closed (``>&-``).

    Otherwise the next socket would become standard output.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            descriptor = os.open(os.devnull, os.O_RDWR)  # the lowest that is free
            setattr(sys, name, open(descriptor, mode, encoding="utf-8", closefd=False))


def _guard(run: Callable[[], int]) -> int:
    """Run a command with guarded output; return its exit status."""
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
            with stop_signals():
                status = run()
        except SystemExit as stop:  # argparse, after its error message
            status = stop.code if isinstance(stop.code, int) else int(stop.code is not None)
        sys.stdout.flush()
        return status
    except KeyboardInterrupt:
        return _INTERRUPTED
    except BrokenPipeError:
        # Python flushes once more at exit, and would report the error again.
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
        return 2 if isinstance(error, _wrong_settings()) else 1


def _user_errors() -> tuple[type[Exception], ...]:
    from ..bag.errors import BagError
    from ..interfaces.errors import InterfaceError
    from ..middleware.base import MiddlewareError
    from .errors import ToolError

    return ToolError, MiddlewareError, InterfaceError, BagError


def _wrong_settings() -> tuple[type[Exception], ...]:
    """Return the errors of what the user has given with the command, as options and variables."""
    from ..middleware.environment import VariableError
    from .errors import UsageError

    return UsageError, VariableError


if __name__ == "__main__":
    sys.exit(main())
