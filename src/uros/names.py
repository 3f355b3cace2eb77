"""ROS names and the DDS names that stand for them on the network.

A topic ``/chatter`` is ``rt/chatter``; a service ``/go`` is a pair of topics, ``rq/goRequest`` and
``rr/goReply``; a type ``std_msgs/msg/String`` is ``std_msgs::msg::dds_::String_``. Each function
from DDS gives None for a name that is none of its kind.
"""

from __future__ import annotations

import re
from typing import Final

HIDDEN_PREFIX: Final = "_"
_TOKEN: Final = r"[A-Za-z_][A-Za-z0-9_]*"
_FULL_NAME: Final = re.compile(f"(?:/{_TOKEN})+")
_DDS_TYPE: Final = re.compile(r"(.+)::dds_::([^:]+)_")
_ROS_TYPE: Final = re.compile(f"({_TOKEN})(?:/({_TOKEN}))?/({_TOKEN})")


def absolute(name: str) -> str:
    """The name from the root on: users may leave the first slash away."""
    return name if name.startswith("/") else "/" + name


def is_valid(name: str) -> bool:
    """Whether an absolute topic, service or node name follows the rules of ROS."""
    return _FULL_NAME.fullmatch(name) is not None and "__" not in name


def is_hidden(name: str) -> bool:
    """Whether some part of the name begins with an underscore."""
    return any(part.startswith(HIDDEN_PREFIX) for part in name.split("/"))


def join(namespace: str, name: str) -> str:
    """A node's full name: ``/`` and ``talker`` give ``/talker``."""
    return f"{namespace.rstrip('/')}/{name}"


def topic_from_dds(dds_name: str) -> str | None:
    """``rt/chatter`` → ``/chatter``."""
    return dds_name[2:] if dds_name.startswith("rt/") else None


def topic_to_dds(name: str) -> str:
    """``/chatter`` → ``rt/chatter``."""
    return "rt" + absolute(name)


def service_from_request(dds_name: str) -> str | None:
    """``rq/goRequest`` → ``/go``."""
    return _service(dds_name, "rq/", "Request")


def service_from_reply(dds_name: str) -> str | None:
    """``rr/goReply`` → ``/go``."""
    return _service(dds_name, "rr/", "Reply")


def _service(dds_name: str, prefix: str, suffix: str) -> str | None:
    if dds_name.startswith(prefix) and dds_name.endswith(suffix):
        return dds_name[2 : -len(suffix)]
    return None


def type_from_dds(dds_type: str) -> str:
    """``std_msgs::msg::dds_::String_`` → ``std_msgs/msg/String``; others stay as they are."""
    match = _DDS_TYPE.fullmatch(dds_type)
    return f"{match[1]}::{match[2]}".replace("::", "/") if match else dds_type


def service_type_from_dds(dds_type: str) -> str:
    """``std_srvs::srv::dds_::Empty_Request_`` (or Response) → ``std_srvs/srv/Empty``."""
    return re.sub("_(Request|Response)$", "", type_from_dds(dds_type))


def type_to_dds(name: str) -> str:
    """``std_msgs/msg/String`` or ``std_msgs/String`` → ``std_msgs::msg::dds_::String_``.

    What is no ROS type name stays as it is.
    """
    match = _ROS_TYPE.fullmatch(name)
    return f"{match[1]}::{match[2] or 'msg'}::dds_::{match[3]}_" if match else name
