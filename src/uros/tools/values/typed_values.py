"""The positional arguments TYPE and VALUES, of which either may be left out, and ``--stdin``."""

from __future__ import annotations

import argparse
import re
import sys
from typing import Any, Final

from ..errors import ToolError
from . import plain

_TYPE: Final = re.compile(r"[A-Za-z]\w*(/\w+)?/[A-Za-z]\w*|\w+(::\w+)+")


def add_type_and_values(parser: argparse.ArgumentParser, example: str, what: str) -> None:
    parser.add_argument(
        "type", metavar="TYPE", nargs="?", help=f"its type, such as {example} (default: what the"
        f" {what} has that is there)",
    )  # fmt: skip
    parser.add_argument(
        "values",
        metavar="VALUES",
        nargs="?",
        help="its fields in YAML, such as 'data: 1' or '{x: 1.5, name: left}'; the others have"
        " what the definition says, or zeros",
    )
    parser.add_argument("--stdin", action="store_true", help="read VALUES from standard input")


def type_and_text(args: argparse.Namespace) -> tuple[str | None, str]:
    """The type, None where it was left out, and the text of the values. Raises ToolError."""
    type_name, text = args.type, args.values
    if type_name is not None and text is None and not _TYPE.fullmatch(type_name):
        if "/" in type_name and not re.search(r"[:{}\[\]\s]", type_name):
            raise ToolError(f"{type_name!r} is no name of a type, as std_msgs/msg/String is")
        type_name, text = None, type_name
    if args.stdin:
        if text is not None:
            raise ToolError("give either VALUES or --stdin")
        try:
            text = sys.stdin.buffer.read().decode()
        except UnicodeDecodeError as error:
            raise ToolError(f"standard input is not UTF-8: {error.reason}") from error
    return type_name, text or ""


def load_message(type_name: str) -> Any:
    """The class of a message. Raises InterfaceError, or ToolError for another kind."""
    from ...interfaces import load

    found = load(type_name)
    if not plain.is_message(found):
        raise ToolError(f"{type_name} is no message; topics carry messages")
    return found


def load_service(type_name: str) -> Any:
    """The class of a service, which has Request and Response; ``std_srvs/Trigger`` too."""
    from ...interfaces import load

    package, _, name = type_name.partition("/")
    found = load(type_name if not name or "/" in name else f"{package}/srv/{name}")
    if not hasattr(found, "Request"):
        raise ToolError(f"{type_name} is no service, as std_srvs/srv/Trigger is")
    return found
