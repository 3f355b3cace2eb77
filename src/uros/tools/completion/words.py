"""Finds the argument that the last word of a command line belongs to, and its candidates.

Only the module of the verb on the line is imported.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from importlib import import_module
from typing import Final

from ..cli import Group, Verb, commands
from ..parser import Parser
from . import names
from .details import Typed
from .shells import NO_FILES

Candidates = Iterable[tuple[str, str]]

# More values of an option than anybody types.
_ANY: Final = 1_000_000


def complete(words: Sequence[str]) -> list[tuple[str, str]]:
    """Return the words that may stand in place of the last one, each with a description or "".

    Args:
        words: The words behind ``uros``; the last one is being typed, and may be "".

    Returns:
        The words, and `NO_FILES` where no name of a file may stand.
    """
    *before, word = words
    return [
        pair
        for pair in _of_group(commands(), before, word)
        if pair == NO_FILES or pair[0].startswith(word)
    ]


def _of_group(group: Group, before: Sequence[str], word: str) -> Candidates:
    path = []
    given: dict[str, list[str]] = {}
    for at, name in enumerate(before):
        if name == group.option and name:
            given[name.lstrip("-").replace("-", "_")] = []
            continue
        member = group.members.get(name)
        if member is None:
            return ()
        path.append(name)
        if isinstance(member, Verb):
            parser = Parser()
            import_module(f"uros.tools.{member.module}").add_arguments(parser)
            return _of_parser(parser, before[at + 1 :], word, path, given)
        group = member
    if word.startswith("-"):
        more = ["--version"] if not path else [group.option] if group.option else []
        return [(option, "") for option in ("--help", *more)]
    return [(name, member.help) for name, member in group.members.items()]


def _of_parser(
    parser: argparse.ArgumentParser,
    before: Sequence[str],
    word: str,
    path: Sequence[str],
    given: dict[str, list[str]],
) -> Candidates:
    """Return the candidates for a word behind those of a verb; ``given`` are its options so far."""
    options = {name: action for action in parser._actions for name in action.option_strings}
    positionals = [action for action in parser._actions if not action.option_strings]
    rest = list(before)
    without_options = False
    while rest:
        first = rest.pop(0)
        if first == "--" and not without_options:
            without_options = True
        elif first.startswith("-") and not without_options:
            name, equals, value = first.partition("=")
            action = options.get(name)
            if action is None:
                continue
            values = given.setdefault(action.dest, [])
            if equals:
                values.append(value)
                continue
            most = _most(action)
            while rest and most and not rest[0].startswith("-"):
                values.append(rest.pop(0))
                most -= 1
            if most and not rest and not word.startswith("-"):
                return names.candidates(action, Typed(given, path, word))
        elif positionals:
            action = positionals[0]
            if isinstance(action, argparse._SubParsersAction):
                inner = action.choices.get(first)
                return _of_parser(inner, rest, word, [*path, first], given) if inner else ()
            given.setdefault(action.dest, []).append(first)
            if _most(action) == 1:
                del positionals[0]
    if word.startswith("-") and not without_options:
        return _of_options(options, given, path, word)
    return names.candidates(positionals[0], Typed(given, path, word)) if positionals else ()


def _of_options(
    options: dict[str, argparse.Action],
    given: dict[str, list[str]],
    path: Sequence[str],
    word: str,
) -> Candidates:
    name, equals, value = word.partition("=")
    if equals:
        action = options.get(name)
        found = names.candidates(action, Typed(given, path, value)) if action else ()
        return [(f"{name}={each}", about) for each, about in found]
    return [
        (option, (action.help or "") % {"prog": "uros", **vars(action)})
        for option, action in options.items()
        if action.help != argparse.SUPPRESS
    ]


def _most(action: argparse.Action) -> int:
    """Return how many values an argument takes at most."""
    if action.nargs is None or action.nargs == "?":
        return 1
    return action.nargs if isinstance(action.nargs, int) else _ANY
