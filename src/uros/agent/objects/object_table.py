"""The record of a client's object, the limits on objects, and the lookup of references."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from ...middleware.base import Node
from ...wire import ids
from ..policy.limits import Limits, TooMany
from ..policy.rules import NOTHING, Settings
from ..session.delivery import Delivery
from .endpoints import ReaderEndpoint, ReplierEndpoint, RequesterEndpoint, WriterEndpoint
from .kinds import WITH_NODE
from .representation import QosProfileSpec, Spec, TypeSpec
from .ros_graph import GraphEndpoint
from .xml_profiles import Profile, References

Endpoint = ReaderEndpoint | RequesterEndpoint | ReplierEndpoint | GraphEndpoint | WriterEndpoint

# The number of an application's first entity that has none of its own: beyond what 12 bits name.
UNNAMED: Final = 0x1000


def check_room(objects: Mapping[int, XrceObject], kinds: list[int], limits: Limits) -> None:
    """Check that a client with these objects may have more.

    Args:
        objects: The client's objects.
        kinds: The kinds of the objects to create.
        limits: The limits of a client.

    Raises:
        TooMany: It may not.
    """
    if len(objects) + len(kinds) > limits.objects:
        raise TooMany(f"over {limits.objects} objects (see --max-objects)")
    new = kinds.count(ids.KIND_PARTICIPANT)
    if new and limits.participants < new + sum(
        existing.kind == ids.KIND_PARTICIPANT for existing in objects.values()
    ):
        raise TooMany(f"over {limits.participants} participants")


def broken(obj: XrceObject, objects: Mapping[int, XrceObject]) -> bool:
    """Return whether the object's endpoint, or one of its parts, was deleted."""
    return obj.orphaned or any(
        objects.get(part.object_id) is not part or part.orphaned for part in obj.parts
    )


@dataclass(eq=False)
class XrceObject:
    """An object of the client; participants and objects with an ``endpoint`` have a ``node``."""

    object_id: int
    parent: int
    spec: Spec
    node: Node | None = None
    endpoint: Endpoint | None = None
    delivery: Delivery | None = None
    settings: Settings = NOTHING  # its participant's
    # What CREATE said: format, content, parent or domain. None: an application's part.
    representation: tuple[int, str | bytes, int] | None = None
    parts: list[XrceObject] = field(default_factory=list)  # of an application
    # What an endpoint is on the network: (topic, type); a participant: (node, domain).
    named: tuple[str, str] = ("", "")

    @property
    def kind(self) -> int:
        """The object's kind: the low four bits of its id."""
        return self.object_id & 0x0F

    @property
    def orphaned(self) -> bool:
        """Whether its participant, and its endpoint with it, was deleted."""
        return self.node is None and self.kind in WITH_NODE

    @property
    def kept(self) -> int:
        """The bytes of the representation that are kept."""
        return len(self.representation[1]) if self.representation is not None else 0


class Taken(Exception):
    """The object id of an application's entity is in use."""


class Known:
    """Finds what a client refers to by name: in its own objects, then in the agent's files."""

    def __init__(self, objects: Mapping[int, XrceObject], references: References) -> None:
        self._objects = objects
        self._references = references

    def find(self, tag: str, name: str) -> Profile | None:
        """Return the profile; see :class:`~uros.agent.objects.representation.Lookup`."""
        if tag == "type":
            for obj in self._objects.values():
                if isinstance(obj.spec, TypeSpec) and name in obj.spec.names:
                    return Profile(type_name=name)
        elif tag == "qos_profile":
            for obj in self._objects.values():
                if isinstance(obj.spec, QosProfileSpec) and name in obj.spec.named:
                    return obj.spec.named[name]
        return self._references.find(tag, name)


_BAD_IN_NAME = re.compile(r"[^A-Za-z0-9_]")


def node_name(text: str | None) -> tuple[str, str]:
    """Return the namespace and name of the ROS node for a participant's name.

    micro-ROS sends ``namespace/name``. Characters that ROS names cannot have
    become underscores; without a name the node is ``xrce_client``.
    """
    parts = [part for part in (text or "").split("/") if part]
    clean = []
    for part in parts or ["xrce_client"]:
        word = _BAD_IN_NAME.sub("_", part)
        clean.append("_" + word if word[0].isdigit() else word)
    return "/" + "/".join(clean[:-1]), clean[-1]
