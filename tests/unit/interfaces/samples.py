"""Random messages, and the same messages as rosbags objects: rosbags is the oracle of the codec."""

import random
import re
import string
from functools import cache
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from uros.interfaces import load, registry
from uros.interfaces.generate import attribute_name
from uros.interfaces.parse import INTEGERS, Message, Type

_DTYPES = {"bool": "bool", "byte": "int8", "char": "uint8"}  # rosbags takes byte as signed
_LETTERS = string.ascii_letters + "äß漢😀 _/"


@cache
def store() -> Any:
    """Return rosbags' types, with missing types and the parts of services and actions added."""
    types = get_typestore(Stores.ROS2_KILTED)
    for name in messages():
        message = registry.message(name)
        if oracle_name(message) not in types.fielddefs and not holds(message, "wstring"):
            types.register(get_types_from_msg(text_of(message), oracle_name(message)))
    return types


def text_of(message: Message) -> str:
    """Return a definition as .msg text without constants and defaults, for rosbags."""
    lines = (f"{re.sub('/(msg|action)/', '/', str(f.type))} {f.name}\n" for f in message.fields)
    return "".join(lines) or "uint8 structure_needs_at_least_one_member\n"


def holds(message: Message, primitive: str) -> bool:
    """Whether the message has a field of the type at any depth."""
    every = [message, *registry.closure(message).values()]
    return any(f.type.name == primitive for m in every for f in m.fields)


def oracle_name(message: Message) -> str:
    """Return the name of the structure in rosbags."""
    return f"{message.package}/msg/{message.name}"


def messages() -> list[str]:
    """Return the names of all packaged structures: messages, and parts of services and actions."""
    packaged = registry.packaged_types()
    return [part.type_name for name in packaged for part in registry.definition(name).parts]


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
    """Return a message of uros's class with random values in every field."""
    fields = registry.message(name).fields
    return load(name)(**{attribute_name(f.name): value(f.type, rng) for f in fields})


def as_oracle(msg: Any) -> Any:
    """Return the same message as a rosbags object."""
    definition = registry.message(msg._TYPE)
    values = [_oracle(f.type, getattr(msg, attribute_name(f.name))) for f in definition.fields]
    return store().types[oracle_name(definition)](*(values or [0]))


def _oracle(type_: Type, value: Any) -> Any:
    if type_.array and type_.primitive and type_.name != "string":
        if type_.name == "byte":
            value = [_oracle(type_.element, item) for item in value]
        return np.array(list(value), dtype=_DTYPES.get(type_.name, type_.name))
    if type_.array:
        return [_oracle(type_.element, item) for item in value]
    if type_.name == "byte":
        return value - 256 if value > 127 else value
    return value if type_.primitive else as_oracle(value)
