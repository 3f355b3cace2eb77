"""Writes generated classes as modules for a board. Host only."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from . import registry
from .errors import InterfaceError
from .generate import generate, module_name
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


def _wanted(names: Iterable[str]) -> list[Message | Service]:
    wanted: dict[str, Message | Service] = {}
    for name in names:
        definition = registry.definition(registry.normalize(name))
        if isinstance(definition, Message) and definition.kind == "srv":
            definition = registry.definition(definition.type_name.rpartition("_")[0])
        if isinstance(definition, Action) or "/action/" in definition.type_name:
            raise InterfaceError(f"{name} is an action; only messages and services are written")
        wanted[definition.type_name] = definition
        parts = [definition] if isinstance(definition, Message) else []
        if isinstance(definition, Service):
            parts = [definition.request, definition.response]
        for part in parts:
            wanted.update(registry.closure(part))
    return list(wanted.values())
