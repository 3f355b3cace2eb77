"""``uros fleet``: run the virtual boards that a file lists, and one agent for them."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from .board.list import check_name
from .board.run import add_agent
from .board.simulation import Plan, Simulation, titles
from .common import positive_float
from .errors import ToolError, did_you_mean

_EPILOG: Final = """\
The file is TOML, with a table [[board]] for each board:

  engine = "cpython"            # of all boards without their own

  [[board]]
  run = "sprturtlebot"          # a name of 'uros board list'
  namespace = "/left"           # of its node, topics and services

  [[board]]
  run = "esp32_publisher"
  count = 3                     # three boards, in /cell1, /cell2 and /cell3
  namespace = "/cell"
  seed = 7                      # of the first of them
  happen = ["usb:unplug"]       # actions and faults at the start

'engine', 'firmware', 'plug', 'link', 'interfaces', 'provided', 'baudrate' and 'speed' are as with
'uros board run'. Paths are relative to the file's folder. Each line of input is a command, as
there.

examples:

  uros fleet hall.toml
  uros fleet hall.toml --no-agent --seconds 60
"""

_KEYS: Final[dict[str, type | tuple[type, ...]]] = {
    "run": str, "count": int, "namespace": str, "seed": int, "engine": str, "firmware": str,
    "link": str, "happen": list, "plug": list, "interfaces": list, "speed": (int, float),
    "provided": list, "baudrate": int,
}  # fmt: skip
_FOR_ALL: Final = ("engine", "speed", "interfaces")
_ENGINES: Final = ("cpython", "micropython")
_MOST: Final = 200
_WORDS: Final = {
    str: "a text", int: "a whole number", list: "a list of texts", (int, float): "a number",
}  # fmt: skip


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros fleet``."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = _EPILOG
    parser.add_argument("file", metavar="FILE", help="TOML file with the boards, see below")
    add_agent(parser)
    parser.add_argument(
        "--seconds", type=positive_float, metavar="S",
        help="exit after so many seconds (default: until Ctrl-C)",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Run the boards until Ctrl-C or the end of the time.

    Raises:
        ToolError: The file is wrong, or a board cannot run.
    """
    if sys.platform == "win32":
        raise ToolError("virtual boards need pseudo-terminals: use Linux, macOS or WSL")
    plans = read(Path(args.file))
    if args.agent is False and any(plan.namespace for plan in plans):
        raise ToolError("namespaces need the agent: leave --no-agent out, or the namespaces")
    return Simulation(plans, args.agent, args.agent_port, args.seconds).run()


def read(file: Path) -> list[Plan]:
    """Read the boards of a file.

    Raises:
        ToolError: The file cannot be read, or has a mistake.
    """
    if sys.version_info >= (3, 11):
        import tomllib
    else:
        import tomli as tomllib

    try:
        text = file.read_text(encoding="utf-8")
        whole = tomllib.loads(text)
    except OSError as error:
        raise ToolError(f"{file}: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ToolError(f"{file}: not a TOML file: {error}") from error
    boards = whole.pop("board", [])
    _check(f"{file}", whole, _FOR_ALL)
    if not isinstance(boards, list) or not boards or not all(isinstance(b, dict) for b in boards):
        raise ToolError(f"{file}: it has no boards: begin each one with a line [[board]]")
    plans: list[Plan] = []
    for number, board in enumerate(boards, 1):
        where = f"{file}: board {number}"
        _check(where, board, tuple(_KEYS))
        plans += _plans(where, file.parent, {**whole, **board})
        if len(plans) > _MOST:
            raise ToolError(f"{where}: more than {_MOST} boards")
    for plan, title in zip(plans, titles([plan.board for plan in plans]), strict=True):
        plan.title = title
    return plans


def _check(where: str, table: Mapping[str, Any], known: tuple[str, ...]) -> None:
    for key, value in table.items():
        if key not in known:
            close = did_you_mean(key, known) or f" (there are {', '.join(known)})"
            raise ToolError(f"{where}: there is no {key!r}{close}")
        kind = _KEYS[key]
        fits = isinstance(value, kind) and not isinstance(value, bool)
        if kind is list:
            fits = fits and all(isinstance(item, str) for item in value)
        if not fits:
            raise ToolError(f"{where}: {key} takes {_WORDS[kind]}, not {value!r}")


def _plans(where: str, folder: Path, board: Mapping[str, Any]) -> list[Plan]:
    if "run" not in board:
        raise ToolError(f'{where}: "run" is missing, such as run = "esp32_publisher"')
    name = board["run"]
    try:
        check_name(name)
    except ToolError as error:
        raise ToolError(f"{where}: {error}") from error
    engine, count, speed = (
        board.get("engine", "cpython"), board.get("count", 1), board.get("speed", 1.0)
    )  # fmt: skip
    if engine not in _ENGINES:
        raise ToolError(f"{where}: engine must be one of {', '.join(_ENGINES)}, not {engine!r}")
    if count < 1:
        raise ToolError(f"{where}: count must be 1 or more, not {count}")
    if not speed > 0:
        raise ToolError(f"{where}: speed must be more than 0, not {speed}")
    if count > 1 and "link" in board:
        raise ToolError(f"{where}: {count} boards cannot have one link")
    if count > _MOST:
        raise ToolError(f"{where}: more than {_MOST} boards")
    namespace = board.get("namespace", "")
    if namespace and not all(part.isidentifier() for part in namespace.strip("/").split("/")):
        raise ToolError(f'{where}: {namespace!r} is not a namespace such as "/hall/left"')
    return [
        Plan(
            name, name, _path(folder, board.get("firmware")), engine,
            board.get("seed", 0) + index, board.get("happen", ()), board.get("plug", ()),
            [str(folder / name) for name in board.get("interfaces", ())],
            board.get("provided", ()), _path(folder, board.get("link")), float(speed),
            f"{namespace}{index + 1}" if namespace and count > 1 else namespace,
            baud=board.get("baudrate"),
        )
        for index in range(count)
    ]  # fmt: skip


def _path(folder: Path, text: str | None) -> str | None:
    return None if text is None else str(folder / text)
