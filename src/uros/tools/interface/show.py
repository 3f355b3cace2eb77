"""``uros interface show``: print the definition of an interface type."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING

from ..common import add_interfaces, know_interfaces

if TYPE_CHECKING:
    from ...interfaces.parse import Message
    from ...interfaces.registry import Definition


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros interface show``."""
    parser.add_argument(
        "type",
        metavar="TYPE",
        help="name of a message, service or action type, such as std_msgs/msg/Header; - reads it"
        " from standard input",
    )
    comments = parser.add_mutually_exclusive_group()
    comments.add_argument(
        "--all-comments", action="store_true", help="print the comments of nested messages too"
    )
    comments.add_argument("--no-comments", action="store_true", help="print no comments")
    add_interfaces(parser)


def run(args: argparse.Namespace) -> int:
    """Print the definition of a type."""
    from ...interfaces import registry

    know_interfaces(args)
    name = registry.normalize(sys.stdin.read().strip() if args.type == "-" else args.type)
    parts = registry.definition(name).parts
    for part in parts:
        registry.closure(part)  # raises if a nested type is missing or wrong
    if name == registry.file_type(name):
        lines = _of_file(name, not args.no_comments, args.all_comments)
    else:
        lines = (line for at, part in enumerate(parts) for line in _of_part(part, at > 0))
    for line in lines:
        print(line)
    return 0


def _of_file(name: str, comments: bool, all_comments: bool) -> Iterator[str]:
    """Yield the lines of a type's file, and below each field those of its message."""
    from ...interfaces import registry
    from ...interfaces.parse import strip_comment

    types = [{f.name: f.type for f in part.fields} for part in registry.definition(name).parts]
    for raw in _text(name).lstrip("\ufeff").splitlines():
        line = strip_comment(raw.replace("\t", " ")).strip()
        if line == "---":
            del types[0]
        if comments or line:
            yield (raw.rstrip() if comments else line)
        field = re.fullmatch(r"\S+ +(\w+)( +[^ =].*)?", line)
        if field and not (type_ := types[0][field[1]]).primitive:
            for inner in _of_file(type_.name, all_comments, all_comments):
                yield "\t" + inner


def _text(name: str) -> str:
    """Return the text that defines a type; a sourced ROS 2's if it has the same definition.

    Its comments say more than those of uros, which are its own and few.
    """
    from ...interfaces import InterfaceError, registry

    text, path = registry.source(name)
    if registry.is_added(name):
        return text
    ours = _meaning(registry.definition(name))
    for other in registry.sourced_texts(name):
        try:
            if "#" in other and _meaning(registry.parse(name, other, path)) == ours:
                return other
        except InterfaceError:
            continue
    return text


def _meaning(definition: Definition) -> list[object]:
    return [
        (
            [(constant.type, constant.name, constant.value) for constant in part.constants],
            [(str(field.type), field.name, field.default) for field in part.fields],
        )
        for part in definition.parts
    ]


def _of_part(part: Message, behind: bool) -> Iterator[str]:
    """Yield the lines of a type without a file, such as ``Name_SendGoal_Request``."""
    from ...interfaces import registry

    if behind:
        yield "---"
    for constant in part.constants:
        yield f"{constant.type} {constant.name}={constant.value!r}"
    for field in part.fields:
        default = list(field.default) if isinstance(field.default, tuple) else field.default
        yield f"{field.type} {field.name}" + (f" {default!r}" if default is not None else "")
        if field.type.primitive:
            continue
        if registry.file_type(field.type.name) == field.type.name:
            inner = _of_file(field.type.name, False, False)
        else:
            inner = _of_part(registry.message(field.type.name), False)
        for line in inner:
            yield "\t" + line
