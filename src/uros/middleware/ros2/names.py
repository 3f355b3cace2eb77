"""Names as DDS has them, in ROS's form.

Clients send names that are mangled already: ``rt/chatter``, ``rq/addRequest``,
``std_msgs::msg::dds_::String_``. rclpy wants them plain, and mangles them itself.
"""

from __future__ import annotations

import re
from typing import Final, NamedTuple

from ..base import MiddlewareError, Service

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
    """``/chatter`` for ``rt/chatter``. Raises MiddlewareError for what is no ROS topic."""
    return _plain(topic, "rt", "")


def service_name(service: Service) -> str:
    """The name that both topics of a service have. Raises MiddlewareError."""
    name = _plain(service.request_topic, "rq", "Request")
    if _plain(service.reply_topic, "rr", "Reply") != name:
        raise MiddlewareError(
            f"{service.request_topic!r} and {service.reply_topic!r} are not of one service"
        )
    return name


def _plain(topic: str, prefix: str, suffix: str) -> str:
    name = topic[len(prefix) : len(topic) - len(suffix)]
    if (
        len(topic) > _MAX_LENGTH
        or topic != prefix + name + suffix
        or _NAME.fullmatch(name) is None
    ):
        shown = topic if len(topic) <= _MAX_LENGTH else topic[:_MAX_LENGTH] + "…"
        raise MiddlewareError(
            f"{shown!r} is no ROS topic ({prefix}/…{suffix}), and the ros2 middleware carries"
            " nothing else: start the agent with -m dds"
        )
    return name


def message_type(type_name: str) -> TypeName:
    """The ROS type of a DDS type name. Raises MiddlewareError for what is none."""
    found = _TYPE.fullmatch(type_name) if len(type_name) <= _MAX_LENGTH else None
    if found is None:
        raise MiddlewareError(
            f"{type_name[:_MAX_LENGTH]!r} is no ROS type (package::msg::dds_::Name_), and the ros2"
            " middleware carries nothing else: start the agent with -m dds"
        )
    return TypeName(*found.groups())


def service_type(service: Service) -> TypeName:
    """The ROS type that requests and replies of a service are of. Raises MiddlewareError."""
    request, reply = message_type(service.request_type), message_type(service.reply_type)
    name = request.name.removesuffix("_Request")
    if (
        name == request.name
        or reply != request._replace(name=name + "_Response")
        or request.kind == "msg"
    ):
        raise MiddlewareError(
            f"{service.request_type} and {service.reply_type} are not of one ROS service"
        )
    return request._replace(name=name)
