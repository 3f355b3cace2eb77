"""The positional arguments TYPE and VALUES, either of which is optional, and ``--stdin``."""

from __future__ import annotations

import argparse
import re
import shlex
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

from ..errors import ToolError, UsageError
from . import plain

if TYPE_CHECKING:
    from ...host.network import Network

_TYPE: Final = re.compile(r"[A-Za-z]\w*(/\w+)?/[A-Za-z]\w*|\w+(::\w+)+")


def add_type_and_values(parser: argparse.ArgumentParser, example: str, what: str) -> None:
    """Declare ``type``, ``values`` and ``--stdin``.

    Args:
        parser: Where to declare them.
        example: A type, for the help.
        what: What has the type: ``topic``, ``service`` or ``action``.
    """
    parser.add_argument(
        "type", metavar="TYPE", nargs="?",
        help=f"type, such as {example} (default: the type of the existing {what})",
    )  # fmt: skip
    parser.add_argument(
        "values",
        metavar="VALUES",
        nargs="?",
        help="fields in YAML, such as 'data: 1' or '{x: 1.5, name: left}'; other fields have their"
        " default or zero",
    )
    parser.add_argument("--stdin", action="store_true", help="read VALUES from standard input")


def type_and_text(args: argparse.Namespace) -> tuple[str | None, str]:
    """Return the type, None if it was left out, and the text of the values.

    Raises:
        ToolError: The arguments are contradictory or malformed.
        UsageError: VALUES are not in quotes.
    """
    type_name, text = args.type, args.values
    hint = in_quotes(args) if text is not None else ""
    if hint and _is_yaml(type_name):
        raise UsageError(f"{type_name!r} is not the name of a type; {hint}")
    if type_name is not None and text is None and not _TYPE.fullmatch(type_name):
        if "/" in type_name and not re.search(r"[:{}\[\]\s]", type_name):
            raise ToolError(f"{type_name!r} is not the name of a type, such as std_msgs/msg/String")
        type_name, text = None, type_name
    if args.stdin:
        if text is not None:
            raise ToolError("give either VALUES or --stdin")
        try:
            text = sys.stdin.buffer.read().decode()
        except UnicodeDecodeError as error:
            raise ToolError(f"standard input is not UTF-8: {error.reason}") from error
    return type_name, text or ""


def in_quotes(args: argparse.Namespace, unknown: Sequence[str] = ()) -> str:
    """Return how to write VALUES that the shell has split, for want of quotes; "" for others.

    Args:
        args: The command line.
        unknown: The words that no argument has taken.
    """
    words = [word for word in (args.type, args.values) if word]
    if len(words) > 1 and not _is_yaml(words[0]):
        del words[0]
    if not words or not _is_yaml(words[0]) or " " in words[0]:
        return ""
    if any(word.startswith("--") for word in unknown):
        return "put VALUES in quotes"
    return f"put VALUES in quotes: {shlex.quote(' '.join([*words, *unknown]))}"


def _is_yaml(word: str) -> bool:
    return not _TYPE.fullmatch(word) and (word.startswith("{") or ":" in word)


def load_message(type_name: str, network: Network | None = None) -> Any:
    """Return the class of a message.

    Args:
        type_name: The type.
        network: The domain, whose nodes are asked for a definition that no folder has.

    Raises:
        InterfaceError: The type is unknown.
        ToolError: The type is not a message.
    """
    from ...interfaces import load

    if network is not None:
        from ..type_lookup import know_type

        know_type(network, type_name)
    found = load(type_name)
    if not plain.is_message(found):
        raise ToolError(f"{type_name} is not a message; topics carry messages")
    return found


def load_service(type_name: str) -> Any:
    """Return the class of a service, also for ``std_srvs/Trigger``.

    Raises:
        InterfaceError: The type is unknown.
        ToolError: The type is not a service.
    """
    found = _load(type_name, "srv")
    if not hasattr(found, "Request"):
        raise ToolError(f"{type_name} is not a service, such as std_srvs/srv/Trigger")
    return found


def load_action(type_name: str) -> Any:
    """Return the class of an action, also for ``test_msgs/Fibonacci``.

    Raises:
        InterfaceError: The type is unknown.
        ToolError: The type is not an action.
    """
    found = _load(type_name, "action")
    if not hasattr(found, "Goal"):
        raise ToolError(f"{type_name} is not an action, such as test_msgs/action/Fibonacci")
    return found


def _load(type_name: str, kind: str) -> Any:
    from ...interfaces import load

    package, _, name = type_name.partition("/")
    return load(type_name if not name or "/" in name else f"{package}/{kind}/{name}")
