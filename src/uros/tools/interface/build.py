"""``uros interface build``: build modules of interface types for a board."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import Final

from ..common import add_interfaces, know_interfaces
from ..errors import ToolError, did_you_mean

_EPILOG: Final = """\
Each type becomes a module of its own, so a program loads only the types that it imports:

  from my_msgs.msg import Reading

examples:

  uros interface build my_msgs --for-board build/lib --mpy
  uros interface build my_msgs my_msgs/msg/Reading --for-board build/lib
  uros interface build sensor_msgs/msg/Imu std_srvs --for-board build/lib

The modules need uros on the board. 'uros board build' builds both, with only the types that a
program imports, and in less memory.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros interface build``."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = _EPILOG
    parser.add_argument(
        "what", metavar="DIR|TYPE", nargs="+",
        help="folder with .msg, .srv and .action files, or a known type or package. If types are"
        " given, only these are built from the folders",
    )  # fmt: skip
    parser.add_argument(
        "--for-board", metavar="OUT", required=True,
        help="folder to write, for a board's /lib; other files in it stay",
    )  # fmt: skip
    parser.add_argument(
        "--mpy", action="store_true",
        help="compile to bytecode, which loads faster and needs less memory (default: source)",
    )  # fmt: skip
    add_interfaces(parser)


def run(args: argparse.Namespace) -> int:
    """Build the modules and print the next step.

    Raises:
        InterfaceError: A definition is wrong.
        ToolError: A folder, type or package is unknown, or a file cannot be written.
    """
    from ...interfaces.package import module_texts

    know_interfaces(args)
    names, out = _names(args.what), Path(args.for_board)
    files = {path: text.encode() for path, text in module_texts(names).items()}
    if args.mpy:
        files = dict(_compiled(path, data.decode()) for path, data in files.items())
    try:
        _write(out, files)
    except OSError as error:
        raise ToolError(f"{error.filename or out}: {error.strerror or error}") from error
    size = sum(map(len, files.values()))
    print(f"{out}: {len(names)} type{'s' * (len(names) > 1)}, {len(files)} files, {size} bytes")
    print("\nNext, with the port of the board's console in place of PORT:\n")
    print("  mpremote connect PORT fs mkdir :/lib  # an error if it is there already")
    print(f"  mpremote connect PORT cp -r {shlex.quote(str(out))}/* :/lib/")
    return 0


def _names(what: list[str]) -> list[str]:
    """Return the types to build. Raises ToolError and InterfaceError."""
    from ...interfaces import add_folder, registry
    from .package import types_of

    folders = [name for name in what if Path(name).is_dir()]
    found = [type_name for folder in folders for type_name in add_folder(folder)]
    named: list[str] = []
    for name in what:
        if name in folders:
            continue
        if ("/" in name or "::" in name) and not name.startswith((".", "/", "~")):
            full = registry.file_type(registry.normalize(name))
            registry.definition(full)
            named.append(full)
        elif name in registry.packages():
            named += types_of(name)
        else:
            close = did_you_mean(name, registry.packages())
            remedy = (
                "; types are named like std_msgs/msg/Int32, list them with: uros interface list"
            )
            raise ToolError(f"there is no folder, type or package {name!r}{close or remedy}")
    return list(dict.fromkeys(named or found))


def _compiled(path: str, text: str) -> tuple[str, bytes]:
    from ...boards.builder.compiler import bytecode
    from ...boards.builder.errors import CompilerError

    try:
        return path.replace(".py", ".mpy"), bytecode(text, path, path)
    except CompilerError as error:
        raise ToolError(str(error)) from error


def _write(out: Path, files: dict[str, bytes]) -> None:
    """Write the files, and remove the same modules in the other form, ``.py`` or ``.mpy``.

    A board would load the source if it had both.
    """
    for name, data in files.items():
        path = out / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
        path.with_suffix(".mpy" if path.suffix == ".py" else ".py").unlink(missing_ok=True)
