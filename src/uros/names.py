"""ROS names and the DDS names that stand for them on the network.

A topic ``/chatter`` is ``rt/chatter``; a service ``/go`` is a pair of topics, ``rq/goRequest`` and
``rr/goReply``; a type ``std_msgs/msg/String`` is ``std_msgs::msg::dds_::String_``. Each function
from DDS gives None for a name that is none of its kind. The prefixes ``rs``, ``rp`` and ``ra`` are
reserved by the same design, and names behind them follow the same rules.
"""

from __future__ import annotations

import re
from typing import Final

HIDDEN_PREFIX: Final = "_"
_TOKEN: Final = r"[A-Za-z_][A-Za-z0-9_]*"
_FULL_NAME: Final = re.compile(f"(?:/{_TOKEN})+")
_NOT_IN_NAMES: Final = re.compile(r"[^A-Za-z0-9_/]")
# What stands in front of a ROS name in DDS, and what may stand behind it.
_PARTS_OF_DDS: Final = {"rt": "", "rq": "Request", "rr": "Reply", "rs": "", "rp": "", "ra": ""}
# rmw's limits: DDS has 255 characters, of which 8 are for prefixes and suffixes; a namespace leaves
# room for the shortest topic (rmw/validate_full_topic_name.h, rmw/validate_namespace.h).
MAX_NAME: Final = 247
MAX_NAMESPACE: Final = MAX_NAME - 2
MAX_NODE_NAME: Final = 255
MAX_DDS_NAME: Final = 255
_DDS_TYPE: Final = re.compile(r"(.+)::dds_::([^:]+)_")
_ROS_TYPE: Final = re.compile(f"({_TOKEN})(?:/({_TOKEN}))?/({_TOKEN})")


def absolute(name: str) -> str:
    """The name from the root on: users may leave the first slash away."""
    return name if name.startswith("/") else "/" + name


def is_valid(name: str) -> bool:
    """Whether an absolute topic, service or node name follows the rules of ROS."""
    return _FULL_NAME.fullmatch(name) is not None and "__" not in name


def fault(name: str, most: int = MAX_NAME) -> str:
    """Why ROS refuses the fully qualified name of a topic or service, or of a namespace.

    The rules are those of ``rmw_validate_full_topic_name``, which holds for every node of ROS; the
    repeated underscores that :func:`is_valid` refuses too pass there.

    Args:
        name: From the root on. ``~`` and ``{}`` belong to names that are not expanded yet.
        most: The longest name, in characters.

    Returns:
        The reason, or "" for a name that is valid.
    """
    if not name.startswith("/"):
        return "it does not begin with a slash"
    if name.endswith("/"):
        return "it ends with a slash, where a part of the name is missing"
    bad = _NOT_IN_NAMES.search(name)
    if bad is not None:
        return f"it has {bad[0]!a}, where letters, digits and _ between slashes are allowed"
    if "//" in name:
        return "it has two slashes in a row"
    if any(part[0].isdigit() for part in name[1:].split("/")):
        return "a part of it begins with a digit"
    if len(name) > most:
        return f"it has {len(name)} characters, and {most} are the most"
    return ""


def is_hidden(name: str) -> bool:
    """Whether some part of the name begins with an underscore."""
    return any(part.startswith(HIDDEN_PREFIX) for part in name.split("/"))


def is_hidden_node(full_name: str) -> bool:
    """Whether the name of a node begins with an underscore. As in ROS, its namespace may."""
    return full_name.rpartition("/")[2].startswith(HIDDEN_PREFIX)


def join(namespace: str, name: str) -> str:
    """A node's full name: ``/`` and ``talker`` give ``/talker``."""
    return f"{namespace.rstrip('/')}/{name}"


def split_dds(dds_name: str) -> tuple[str, str, str] | None:
    """``rq/goRequest`` → ``("rq", "/go", "Request")``: prefix, ROS name, suffix.

    The suffix is "" where the name does not end with its prefix's. None: no prefix of ROS is in
    front. Whether the name in the middle is valid is for :func:`fault` to say.
    """
    prefix, rest = dds_name[:2], dds_name[2:]
    suffix = _PARTS_OF_DDS.get(prefix)
    if suffix is None or not rest.startswith("/"):
        return None
    if suffix and rest.endswith(suffix):
        return prefix, rest[: -len(suffix)], suffix
    return prefix, rest, ""


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
