"""Writes generated classes as modules for a board. Host only."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from . import registry
from .errors import InterfaceError
from .generate import generate, generate_together, module_name
from .parse import Action, Message, Service

_INIT: Final = '''\
"""Names load their types on first use."""


def __getattr__(name):
    from uros.interfaces.runtime import pick

    return pick(__name__, name)
'''


def write_package(names: Iterable[str], out_dir: str | os.PathLike[str]) -> list[Path]:
    """Write modules for the named messages and services and for all that they nest.

    With ``out_dir`` on the board's path, ``from std_msgs.msg import Int32`` loads Int32 and what it
    nests, nothing else. The modules need ``uros.interfaces.runtime`` beside them. Returns the paths
    written, sorted; other files in ``out_dir`` are left alone.
    """
    root = Path(out_dir)
    texts: dict[Path, str] = {}
    owners: dict[Path, str] = {}
    for definition in _wanted(names):
        package, kind, plain = definition.type_name.split("/")
        path = root / package / kind / (module_name(plain) + ".py")
        if owners.setdefault(path, definition.type_name) != definition.type_name:
            raise InterfaceError(
                f"{definition.type_name} and {owners[path]} differ only in case; rename one"
            )
        texts[root / package / "__init__.py"] = ""
        texts[root / package / kind / "__init__.py"] = _INIT
        texts[path] = generate(definition)
    for path, text in texts.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return sorted(texts)


def modules(names: Iterable[str]) -> dict[str, str]:
    """The sources of one module for each ``package.msg`` and ``package.srv``, by its full name.

    They hold the named types and all that these nest, and nothing else. A board's file system gets
    them this way (`uros.boards.build`): all types that its program needs are known there.
    """
    together: dict[str, dict[str, Message | Service]] = {}
    for definition in _wanted(names):
        package, kind, _ = definition.type_name.split("/")
        together.setdefault(f"{package}.{kind}", {})[definition.type_name] = definition
    return {name: generate_together(_inner_first(types)) for name, types in together.items()}


def _inner_first(types: dict[str, Message | Service]) -> list[Message | Service]:
    """The types of one module, each behind those that it nests."""
    ordered: dict[str, Message | Service] = {}

    def place(definition: Message | Service) -> None:
        for part in _parts(definition):
            for name in part.nested:
                if name in types:
                    place(types[name])
        ordered.setdefault(definition.type_name, definition)

    for name in sorted(types):
        place(types[name])
    return list(ordered.values())


def _parts(definition: Message | Service) -> list[Message]:
    if isinstance(definition, Message):
        return [definition]
    return [definition.request, definition.response]


def _wanted(names: Iterable[str]) -> list[Message | Service]:
    wanted: dict[str, Message | Service] = {}
    for name in names:
        definition = registry.definition(registry.normalize(name))
        if isinstance(definition, Message) and definition.kind == "srv":
            definition = registry.definition(definition.type_name.rpartition("_")[0])
        if isinstance(definition, Action) or "/action/" in definition.type_name:
            raise InterfaceError(f"{name} is an action; only messages and services are written")
        wanted[definition.type_name] = definition
        for part in _parts(definition):
            wanted.update(registry.closure(part))
    return list(wanted.values())
