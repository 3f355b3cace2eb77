"""Converts DDS topic and type names to ROS names.

XRCE clients send mangled names: ``rt/chatter``, ``rq/addRequest``,
``std_msgs::msg::dds_::String_``. rclpy takes ROS names, and mangles them itself.
"""

from __future__ import annotations

import re
from typing import Final, NamedTuple

from .base import MiddlewareError

# rcl expands substitutions ("{node}", "~"). They are refused in names that come from boards.
_NAME: Final = re.compile(r"(?:/[A-Za-z_][A-Za-z0-9_]*)+")
_TYPE: Final = re.compile(r"([a-z][a-z0-9_]*)::(msg|srv|action)::dds_::([A-Z][A-Za-z0-9_]*)_")
# The longest DDS name that is accepted, in characters. It limits how long rcl copies and checks the
# name of a board.
_MAX_LENGTH: Final = 250


class TypeName(NamedTuple):
    """The name of a type in its parts; as text it is ``package/kind/name``, as in ROS."""

    package: str
    kind: str
    name: str

    def __str__(self) -> str:
        return "/".join(self)


def topic_name(topic: str) -> str:
    """Return ``/chatter`` for ``rt/chatter``.

    Raises:
        MiddlewareError: The topic is not a valid ROS topic.
    """
    return demangle(topic, "rt", "")


def demangle(topic: str, prefix: str, suffix: str) -> str:
    """Return the ROS name in a DDS topic name with this prefix and suffix.

    Raises:
        MiddlewareError: The topic lacks the prefix or suffix, is too long, or has no valid ROS name
            between them.
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
        MiddlewareError: The name is too long or is not that of a ROS type.
    """
    match = _TYPE.fullmatch(type_name) if len(type_name) <= _MAX_LENGTH else None
    if match is None:
        raise MiddlewareError(
            f"{type_name[:_MAX_LENGTH]!r} is no ROS type (package::msg::dds_::Name_), and the ros2"
            " middleware carries nothing else: start the agent with -m dds"
        )
    return TypeName(*match.groups())
