"""RIHS01 type hashes, as ROS 2 announces them (REP 2011, type description JSON, SHA-256).

``python -m uros.interfaces.typehash`` rewrites ``hashes.txt``, the table of the packaged types.
"""

from __future__ import annotations

import hashlib
import json
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from . import distro, registry
from .errors import InterfaceError
from .parse import Action, Field, Message, Service, Type

_TABLE: Final = Path(__file__).parent / "hashes.txt"
_IDS: Final = {
    "int8": 2,
    "uint8": 3,
    "char": 3,
    "int16": 4,
    "uint16": 5,
    "int32": 6,
    "uint32": 7,
    "int64": 8,
    "uint64": 9,
    "float32": 10,
    "float64": 11,
    "bool": 15,
    "byte": 16,
    "string": 17,
    "wstring": 18,
}
_NESTED_ID: Final = 1
_BOUNDED_STRING: Final = 4  # string 17 → bounded string 21, wstring 18 → 22
_ARRAY_IDS: Final = {"": 0, "fixed": 48, "bounded": 96, "unbounded": 144}

EMPTY_MEMBER: Final = Field(Type("uint8"), "structure_needs_at_least_one_member")
"""The member of an empty structure in IDL, and so in its hash."""


def type_hash(definition: Message | Service | Action) -> str:
    """Return the ``RIHS01_…`` of a message, service or action, or of a part of the latter two."""
    root, *members = _structures(definition)
    known = {member.type_name: member for member in members}
    for member in members or [root]:
        outer = Message(
            member.package,
            member.kind,
            member.name,
            tuple(f for f in member.fields if f.type.name not in known),
            source=member.source,
        )
        known.update(registry.closure(outer))
    text = json.dumps(
        {
            "type_description": _describe(root),
            "referenced_type_descriptions": [_describe(known[name]) for name in sorted(known)],
        }
    )
    return "RIHS01_" + hashlib.sha256(text.encode()).hexdigest()


def _structures(definition: Message | Service | Action) -> list[Message]:
    """Return the definition as the structure that its hash describes, then its own structures."""
    if isinstance(definition, Message):
        return [definition]
    if isinstance(definition, Service):
        members = [*definition.parts, definition.event]
        names = ["request_message", "response_message", "event_message"]
        return [_structure(definition, names, members), *members]
    send_goal, get_result = _structures(definition.send_goal), _structures(definition.get_result)
    members = [definition.goal, definition.result, definition.feedback]
    members += [send_goal[0], get_result[0], definition.feedback_message]
    names = ["goal", "result", "feedback"]
    names += ["send_goal_service", "get_result_service", "feedback_message"]
    return [_structure(definition, names, members), *members, *send_goal[1:], *get_result[1:]]


def _structure(whole: Service | Action, names: list[str], members: list[Message]) -> Message:
    package, kind, name = whole.type_name.split("/")
    fields = (Field(Type(m.type_name), member) for member, m in zip(names, members))
    return Message(package, kind, name, tuple(fields))


def known_hash(ros_type_name: str) -> str | None:
    """Return the hash of a type by name, or None if unknown.

    It is None too where the chosen distribution of ROS 2 has no hashes. The hashes of packaged
    types are looked up in a table; those of `add_folder` and of AMENT_PREFIX_PATH are computed
    once. Takes every spelling that `uros.interfaces.load` takes.
    """
    try:
        if not distro.has_hashes():
            return None
        name = ros_type_name.replace("::dds_::", "::").replace("::", "/").rstrip("_")
        if not registry.is_added(name) and (digest := _table().get(name)) is not None:
            # No hash of a packaged type changed between distributions, but types were added.
            absent = distro.missing(registry.file_type(name), distro.chosen())
            return None if absent else digest
        name = registry.normalize(ros_type_name)
        if not registry.exists(name):
            return None
        return _hash_once(registry.definition(name))
    except InterfaceError:
        return None


def is_known(ros_type_name: str) -> bool:
    """Whether a definition of a type is known, by its name in every spelling."""
    name = ros_type_name.replace("::dds_::", "::").replace("::", "/").rstrip("_")
    if name in _table():
        return True
    try:
        return registry.exists(registry.normalize(ros_type_name))
    except InterfaceError:
        return False


def hash_of(definition: Message | Service | Action) -> str:
    """Return the hash for a class; "" if the chosen distribution of ROS 2 has no hashes."""
    return type_hash(definition) if distro.has_hashes() else ""


@lru_cache(maxsize=4096)
def _hash_once(definition: Message | Service | Action) -> str:
    return type_hash(definition)


@lru_cache(maxsize=1)
def _table() -> dict[str, str]:
    lines = _TABLE.read_text(encoding="ascii").splitlines()
    return dict(line.split(" ", 1) for line in lines)


def table_text() -> str:
    """Return the text of ``hashes.txt``: a line ``name hash`` for each packaged type."""
    rows: dict[str, str] = {}
    for name in registry.packaged_types():
        definition = registry.definition(name)
        parts: list[registry.Definition] = [definition, *definition.parts]
        if isinstance(definition, Action):
            parts += [definition.send_goal, definition.get_result]
        rows.update((part.type_name, type_hash(part)) for part in parts)
    return "".join(f"{name} {rows[name]}\n" for name in sorted(rows))


def _describe(message: Message) -> dict[str, Any]:
    fields = message.fields or (EMPTY_MEMBER,)
    return {
        "type_name": message.type_name,
        "fields": [{"name": f.name, "type": _describe_type(f.type)} for f in fields],
    }


def _describe_type(type_: Type) -> dict[str, Any]:
    identity = _IDS[type_.name] if type_.primitive else _NESTED_ID
    if type_.string_bound:
        identity += _BOUNDED_STRING
    return {
        "type_id": identity + _ARRAY_IDS[type_.array],
        "capacity": type_.size,
        "string_capacity": type_.string_bound,
        "nested_type_name": "" if type_.primitive else type_.name,
    }


if __name__ == "__main__":
    distro.use(distro.NEWEST)
    _TABLE.write_text(table_text(), encoding="ascii")
