"""Random messages, and the same messages as rosbags objects: rosbags is the oracle of the codec."""

import random
import string
from functools import cache
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from uros.interfaces import load, registry
from uros.interfaces.generate import attribute_name
from uros.interfaces.parse import INTEGERS, Message, Service, Type

_DTYPES = {"bool": "bool", "byte": "int8", "char": "uint8"}  # rosbags takes byte as signed
_LETTERS = string.ascii_letters + "äß漢😀 _/"


@cache
def store() -> Any:
    """rosbags' types, with the sections of our services added as messages."""
    made = get_typestore(Stores.ROS2_KILTED)
    for name in registry.packaged_types():
        found = registry.definition(name)
        if isinstance(found, Service):
            for part in (found.request, found.response):
                made.register(get_types_from_msg(text_of(part), oracle_name(part)))
    return made


def text_of(message: Message) -> str:
    """A definition as .msg text without constants and defaults, for rosbags."""
    return "".join(f"{str(f.type).replace('/msg/', '/')} {f.name}\n" for f in message.fields) or (
        "uint8 structure_needs_at_least_one_member\n"
    )


def oracle_name(message: Message) -> str:
    """The name under which rosbags knows the structure."""
    return f"{message.package}/msg/{message.name}"


def messages() -> list[str]:
    """The names of all packaged structures: messages, and requests and responses."""
    names = []
    for name in registry.packaged_types():
        found = registry.definition(name)
        if isinstance(found, Service):
            names += [found.request.type_name, found.response.type_name]
        else:
            names.append(name)
    return names


def scalar(type_: Type, rng: random.Random) -> Any:
    name = type_.name
    if name == "bool":
        return rng.random() < 0.5
    if name in INTEGERS:
        low, high = INTEGERS[name]
        return rng.choice([low, high, 0, rng.randint(low, high)])
    if name == "float32":
        return float(np.float32(rng.uniform(-1e6, 1e6)))
    if name == "float64":
        return rng.choice([0.0, -0.0, float("inf"), rng.uniform(-1e9, 1e9)])
    if name in ("string", "wstring"):
        text = "".join(rng.choice(_LETTERS) for _ in range(rng.randint(0, 9)))
        while type_.string_bound and len(text.encode()) > type_.string_bound:
            text = text[:-1]
        return text
    return message(name, rng)


def value(type_: Type, rng: random.Random) -> Any:
    if not type_.array:
        return scalar(type_, rng)
    count = type_.size if type_.array == "fixed" else rng.randint(0, type_.size or 4)
    items = [scalar(type_.element, rng) for _ in range(count)]
    return bytes(items) if type_.name in ("uint8", "byte", "char") else items


def message(name: str, rng: random.Random) -> Any:
    """A message of our class with random values in every field."""
    fields = registry.message(name).fields
    return load(name)(**{attribute_name(f.name): value(f.type, rng) for f in fields})


def as_oracle(msg: Any) -> Any:
    """The same message as a rosbags object."""
    definition = registry.message(msg._TYPE)
    values = [_oracle(f.type, getattr(msg, attribute_name(f.name))) for f in definition.fields]
    return store().types[oracle_name(definition)](*(values or [0]))


def _oracle(type_: Type, found: Any) -> Any:
    if type_.array and type_.primitive and type_.name != "string":
        if type_.name == "byte":
            found = [_oracle(type_.element, item) for item in found]
        return np.array(list(found), dtype=_DTYPES.get(type_.name, type_.name))
    if type_.array:
        return [_oracle(type_.element, item) for item in found]
    if type_.name == "byte":
        return found - 256 if found > 127 else found
    return found if type_.primitive else as_oracle(found)
