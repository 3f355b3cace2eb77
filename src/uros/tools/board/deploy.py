"""``uros board deploy``: deploy a program to a real board and show its console."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from ...printable import printable, unguarded
from ..errors import ToolError
from .board_option import add_board_option, chosen_board
from .build import add_build, add_secrets, build_files, program_folder, read_secrets
from .console import add_port, add_seconds, open_port, show

if TYPE_CHECKING:
    from ...boards.deploy.deploy import Device, Plan
    from ...boards.deploy.raw_repl import NoRepl, RawRepl
    from ...transport.serial_host import OpenPort

_EPILOG: Final = """\
Builds the program as 'uros board build' does, and copies the files that differ over the console
of a board with MicroPython. All new files are copied and compared before an old one is replaced.
Then the program starts, and its console is shown until Ctrl-C.

examples:

  uros board deploy ra6m5_sensor_node --port /dev/ttyUSB0 --mpy
  uros board deploy my_program --port /dev/ttyACM0 --board pico_w
  uros board deploy my_program --port COM3 --no-console
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros board deploy``."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = _EPILOG
    parser.add_argument(
        "program", metavar="FOLDER",
        help="folder with a main.py, a folder that 'uros board build' has written, or a name of"
        " 'uros board list'",
    )  # fmt: skip
    add_port(parser)
    add_board_option(parser)
    add_build(parser)
    add_secrets(parser)
    parser.add_argument(
        "--clean", action="store_true",
        help="remove all other files from the board",
    )  # fmt: skip
    parser.add_argument(
        "--in-place", action="store_true",
        help="remove old files first, if the board has no room for both",
    )  # fmt: skip
    parser.add_argument(
        "--no-reset", dest="reset", action="store_false",
        help="do not start the program and show no console: leave the board at its prompt",
    )  # fmt: skip
    parser.add_argument(
        "--no-console", dest="console", action="store_false", help="exit when the program starts"
    )
    add_seconds(parser)
    parser.add_argument(
        "--json", action="store_true", help="print one JSON object, and show no console"
    )


def run(args: argparse.Namespace) -> int:
    """Build, copy and start a program, and show its console.

    Raises:
        InterfaceError: A definition is wrong.
        ToolError: The program cannot be built or copied, or the board does not answer.
    """
    from ...boards.deploy.deploy import DeployError
    from ...boards.deploy.raw_repl import NoRepl, RawRepl, ReplError

    board = chosen_board(args)
    folder = _folder(args)
    files = _files(args, folder)
    port = open_port(args, f"uros board deploy {args.program}")
    try:
        repl = RawRepl(port)
        try:
            repl.enter(waiting=_ask_for_reset)
            done = _deploy(repl, args, files, board.port if board else "")
        except NoRepl as error:
            raise ToolError(f"{args.port}: {_silence(args, error)}") from error
        except (DeployError, ReplError) as error:
            raise ToolError(f"{args.port}: {_remedied(error)}") from error
        if args.json:
            print(json.dumps(done))
        elif args.console and args.reset:
            _show(port, args)
    finally:
        port.close()
    return 0


def _show(port: OpenPort, args: argparse.Namespace) -> None:
    show(port, args.port, args.seconds)


def _folder(args: argparse.Namespace) -> Path:
    """Return the folder of the program, or of its build. Raises ToolError."""
    from ...boards.builder.output import is_built

    return Path(args.program) if is_built(Path(args.program)) else program_folder(args.program)


def _files(args: argparse.Namespace, folder: Path) -> dict[str, bytes]:
    """Return the files for the board. Raises ToolError and InterfaceError."""
    from ...boards.builder import secrets_file
    from ...boards.builder.output import is_built

    if is_built(folder):
        files = _read(folder)
    else:
        with tempfile.TemporaryDirectory(prefix="uros-") as scratch:
            out = Path(scratch, "files")
            build_files(args, folder, out)
            files = _read(out)
    secrets = read_secrets(args, folder)
    if secrets is not None:
        files[secrets_file.FILE] = secrets
    return files


def _read(folder: Path) -> dict[str, bytes]:
    from ...boards.deploy.frozen import is_manifest
    from ...boards.deploy.mip import MANIFEST

    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
        and not path.name.startswith(".")
        and path != folder / MANIFEST
        and not is_manifest(path)
    }


def _deploy(
    repl: RawRepl, args: argparse.Namespace, files: dict[str, bytes], wanted: str
) -> dict[str, Any]:
    from ...boards.deploy.deploy import carry_out, check, check_room, look, make_plan

    device = look(repl)
    say = (lambda text: None) if args.json else _say
    say(f"{args.port}: {device.machine or device.platform}, MicroPython {device.version}")
    _check_port(device, args, wanted)
    check(device, files)
    _check_secrets(repl, args, files)
    plan = make_plan(repl, device, files, args.clean)
    if not args.in_place:
        check_room(device, plan, files)
    if plan.changes:
        progress = _Progress(not args.json)
        carry_out(repl, device, plan, files, progress, args.in_place)
        progress.end()
    say(_summary(plan, files))
    repl.leave(restart=args.reset)
    return {
        "port": args.port, "machine": device.machine, "platform": device.platform,
        "version": device.version, "root": device.root, "free": device.free,
        "copied": plan.write, "kept": plan.keep, "removed": plan.remove,
        "bytes": sum(len(files[path]) for path in plan.write), "started": args.reset,
    }  # fmt: skip


def _check_port(device: Device, args: argparse.Namespace, wanted: str) -> None:
    from ...boards.deploy.known_boards import PLATFORMS

    port = PLATFORMS.get(device.platform, device.platform)
    if wanted and port != wanted:
        raise ToolError(
            f"{args.port}: {args.board} has MicroPython for {wanted}, and this board's is for"
            f" {port} ({device.machine}): plug the other board in, or correct --board or --port"
        )


def _check_secrets(repl: RawRepl, args: argparse.Namespace, files: dict[str, bytes]) -> None:
    """Raise ToolError if the program imports secrets that the board has not and does not get."""
    from ...boards.builder.secrets_file import FILE, first_import
    from ...boards.deploy.deploy import has_secrets

    place = first_import(_folder(args))
    if place and FILE not in files and (args.clean or not has_secrets(repl)):
        raise ToolError(
            f"{args.port}: {place} imports secrets, and the board has no {FILE}"
            f"{' after --clean' * args.clean}: give --secrets FILE, which then stays on the board"
        )


def _summary(plan: Plan, files: dict[str, bytes]) -> str:
    size = sum(len(files[path]) for path in plan.write)
    parts = []
    if plan.write:
        parts.append(f"{_count(plan.write)} copied and compared ({size} bytes)")
    if plan.keep:
        parts.append(f"{_count(plan.keep)} there already")
    if plan.remove:
        parts.append(f"{_count(plan.remove)} removed")
    return ", ".join(parts)


def _count(paths: list[str]) -> str:
    return f"{len(paths)} file{'s' * (len(paths) > 1)}"


def _say(text: str) -> None:
    print(printable(text), flush=True)


def _ask_for_reset() -> None:
    print(
        "uros: the board does not answer yet; press its reset button now", file=sys.stderr,
        flush=True,
    )  # fmt: skip


class _Progress:
    """Prints progress: on a terminal in one line, else a line for each file."""

    def __init__(self, visible: bool) -> None:
        self._visible = visible
        self._live = visible and sys.stdout.isatty()
        self._last = ""

    def __call__(self, path: str, done: int, size: int) -> None:
        if self._live:
            line = f"{100 * done // max(size, 1):3} %  {printable(path)}"
            self._draw(f"\r{line:{len(self._last)}}")
            self._last = line
        elif self._visible and path != self._last:
            self._last = path
            print(f"  {path}", flush=True)

    def end(self) -> None:
        if self._live and self._last:
            self._draw("\r" + " " * len(self._last) + "\r")

    def _draw(self, text: str) -> None:
        print(text, end="", file=unguarded(sys.stdout), flush=True)


def _silence(args: argparse.Namespace, error: NoRepl) -> str:
    """Return why there is no prompt, by the data that came instead."""
    from ..doctor.serial import NOISE, SOUND, TEXT, judge

    heard = judge(error.heard)
    if heard.kind == SOUND:
        return (
            "no MicroPython prompt, but XRCE frames come: a micro-ROS program has this line. If its"
            " console is another port, give that one; else press the board's reset button while"
            " this tries again"
        )
    if heard.kind == TEXT:
        return (
            f"no MicroPython prompt, but text ({heard.sample!r}): a program that Ctrl-C does not"
            " end, or firmware that is not MicroPython. Press the board's reset button while this"
            " tries again, or flash MicroPython: docs/ports.md"
        )
    if heard.kind == NOISE:
        return (
            f"no MicroPython prompt, but {heard.size} bytes that are no text: another baud rate"
            " (--baudrate), or firmware that is not MicroPython: docs/ports.md"
        )
    return (
        "nothing answers: the board has no MicroPython (docs/ports.md says how to flash it), or its"
        " console is another port, or a program keeps it from answering: press its reset button"
        " while this tries again"
    )


def _remedied(error: Exception) -> str:
    from ...boards.deploy.raw_repl import LineLost, Raised, WrongAnswer

    if isinstance(error, WrongAnswer):
        return (
            f"{error}: this is not how MicroPython answers. What the board had is as it was. Press"
            " its reset button and repeat the command; if it stays so, see docs/ports.md for"
            " firmware, or give --baudrate"
        )
    if isinstance(error, LineLost):
        return (
            f"{error}. What the board had is as it was, unless it was about to start: plug it in"
            " again, and repeat the command"
        )
    if isinstance(error, Raised):
        return f"the board raised {error.last}: press its reset button, and repeat the command"
    return str(error)
