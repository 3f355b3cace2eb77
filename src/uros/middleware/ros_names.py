"""Names and types as DDS has them, in ROS's form.

XRCE clients send names that are mangled already: ``rt/chatter``, ``rq/addRequest``,
``std_msgs::msg::dds_::String_``. rclpy takes them plain, and mangles them itself.
"""

from __future__ import annotations

import re
from typing import Final, NamedTuple

from .base import MiddlewareError

# Substitutions ("{node}", "~") are not for names that come from boards.
_NAME: Final = re.compile(r"(?:/[A-Za-z_][A-Za-z0-9_]*)+")
_TYPE: Final = re.compile(r"([a-z][a-z0-9_]*)::(msg|srv|action)::dds_::([A-Z][A-Za-z0-9_]*)_")
# Attack: rcl copies and checks names at length.
_MAX_LENGTH: Final = 250


class TypeName(NamedTuple):
    """``package/kind/name``, as ROS writes the type."""

    package: str
    kind: str
    name: str

    def __str__(self) -> str:
        return "/".join(self)


def topic_name(topic: str) -> str:
    """Return ``/chatter`` for ``rt/chatter``.

    Raises:
        MiddlewareError: It is no ROS topic.
    """
    return demangle(topic, "rt", "")


def demangle(topic: str, prefix: str, suffix: str) -> str:
    """Return the ROS name in a DDS topic name with this prefix and suffix.

    Raises:
        MiddlewareError: The topic has no such form.
    """
    name = topic[len(prefix) : len(topic) - len(suffix)]
    if len(topic) > _MAX_LENGTH or topic != prefix + name + suffix or _NAME.fullmatch(name) is None:
        shown = topic if len(topic) <= _MAX_LENGTH else topic[:_MAX_LENGTH] + "…"
        raise MiddlewareError(
            f"{shown!r} is no ROS topic ({prefix}/…{suffix}), and the ros2 middleware carries"
            " nothing else: start the agent with -m dds"
        )
    return name


def message_type(type_name: str) -> TypeName:
    """Return the ROS type of a DDS type name.

    Raises:
        MiddlewareError: It is no ROS type.
    """
    match = _TYPE.fullmatch(type_name) if len(type_name) <= _MAX_LENGTH else None
    if match is None:
        raise MiddlewareError(
            f"{type_name[:_MAX_LENGTH]!r} is no ROS type (package::msg::dds_::Name_), and the ros2"
            " middleware carries nothing else: start the agent with -m dds"
        )
    return TypeName(*match.groups())
