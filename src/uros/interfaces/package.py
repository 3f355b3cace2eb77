"""Writes generated classes as modules for a board. Host only."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from . import registry
from .board_walk import calls, is_doubles
from .errors import InterfaceError
from .generate import CANCEL_GOAL, GOAL_STATUS, Parts, generate, generate_together, module_name
from .layout import INLINE_LEAVES, leaves
from .parse import Action, Message
from .registry import Definition

_INIT: Final = '''\
"""Names load their types on first use."""


def __getattr__(name):
    from uros.interfaces.runtime import pick

    return pick(__name__, name)
'''


def write_package(names: Iterable[str], out_dir: str | os.PathLike[str]) -> list[Path]:
    """Write modules for the named messages, services and actions and for their nested types.

    With ``out_dir`` on the board's path, ``from std_msgs.msg import Int32`` loads only Int32 and
    the types that Int32 nests. The modules need ``uros.interfaces.runtime`` beside them. Other
    files in ``out_dir`` stay as they are.

    Returns:
        The paths written, sorted.
    """
    root = Path(out_dir)
    texts = module_texts(names)
    for name, text in texts.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return sorted(root / name for name in texts)


def module_texts(names: Iterable[str]) -> dict[str, str]:
    """Return the text of each file that `write_package` writes, by its path below the folder."""
    texts: dict[str, str] = {}
    owners: dict[str, str] = {}
    for definition in _wanted(names):
        package, kind, plain = definition.type_name.split("/")
        path = f"{package}/{kind}/{module_name(plain)}.py"
        if owners.setdefault(path, definition.type_name) != definition.type_name:
            raise InterfaceError(
                f"{definition.type_name} and {owners[path]} differ only in case; rename one"
            )
        texts[f"{package}/__init__.py"] = ""
        texts[f"{package}/{kind}/__init__.py"] = _INIT
        texts[path] = generate(definition)
    return texts


def modules(
    names: Iterable[str],
    lean: bool = False,
    reused: bool = True,
    checked: bool = False,
) -> dict[str, str]:
    """Return the source of one module for each ``package.msg`` (srv, action), by its full name.

    The modules hold the named types and their nested types only. The builder of a board's file
    system (`uros.boards.builder.file_system`) uses this form, since it knows all types that the
    program needs. ``lean``, ``reused`` and ``checked`` are those of `generate.Parts`.
    """
    together: dict[str, dict[str, Definition]] = {}
    names = list(names)
    wanted = _wanted(names)
    for definition in wanted:
        package, kind, _ = definition.type_name.split("/")
        together.setdefault(f"{package}.{kind}", {})[definition.type_name] = definition
    named = {registry.file_type(registry.normalize(name)) for name in names}
    parts = _parts(wanted, named, lean)._replace(reused=reused, checked=checked)
    return {name: generate_together(_inner_first(types), parts) for name, types in together.items()}


def _parts(wanted: list[Definition], named: set[str], lean: bool) -> Parts:
    """Find out what the classes can do without; see `generate.Parts`."""
    messages = [definition for definition in wanted if isinstance(definition, Message)]
    inner = {message.type_name for message in messages if lean} - named
    if any(isinstance(definition, Action) for definition in wanted):
        inner.discard(GOAL_STATUS)
    times: dict[str, int] = {}
    elements: set[str] = set()
    outer = [definition for definition in wanted if definition.type_name not in inner]
    open_ = [part for definition in outer for part in definition.parts]
    while open_:
        for name, element in calls(open_.pop()):
            nested = registry.message(name)
            if element or leaves(nested) > INLINE_LEAVES:
                elements.add(name)
            if name not in times:
                open_.append(nested)
            times[name] = times.get(name, 0) + 1
    once = {name for name, count in times.items() if count == 1} & inner - elements
    alike = sorted(
        message.type_name
        for message in messages
        if message.type_name in inner and is_doubles(message) and len(message.fields) == 3
        if not message.constants and not any(field.default for field in message.fields)
    )
    return Parts(
        frozenset(inner), frozenset(times.keys() - (once if lean else set())),
        frozenset(elements), frozenset(once), lean, alike=alike[-1] if alike else "",
    )  # fmt: skip


def _inner_first(types: dict[str, Definition]) -> list[Definition]:
    """Return the types of one module, each after the types that it nests."""
    ordered: dict[str, Definition] = {}

    def place(definition: Definition) -> None:
        for part in definition.parts:
            for name in part.nested:
                if name in types:
                    place(types[name])
        ordered.setdefault(definition.type_name, definition)

    for name in sorted(types):
        place(types[name])
    return list(ordered.values())


def _wanted(names: Iterable[str]) -> list[Definition]:
    """Return the definitions in the files of the named types, and those that they nest."""
    wanted: dict[str, Definition] = {}
    open_ = [registry.file_type(registry.normalize(name)) for name in names]
    while open_:
        definition = registry.definition(open_.pop())
        if definition.type_name in wanted:
            continue
        wanted[definition.type_name] = definition
        if isinstance(definition, Action):
            open_ += [CANCEL_GOAL, GOAL_STATUS]
        for part in definition.parts:
            open_ += [registry.file_type(nested) for nested in registry.closure(part)]
    return list(wanted.values())
