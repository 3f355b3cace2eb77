"""Reads an XRCE application: an XML document with entities that are created and deleted as one.

The elements are those of DDS-XML's application; where Fast DDS's differ, those are accepted too::

    <application name="arm">
      <domain_participant name="arm/left" domain_id="0" object_id="0x0011">
        <topic name="rt/joints" register_type_ref="sensor_msgs::msg::dds_::JointState_"/>
        <publisher>
          <data_writer object_id="0x0015" topic_ref="rt/joints"/>
        </publisher>
      </domain_participant>
    </application>

``object_id`` is the 16-bit id by which the client names an entity afterwards; its lowest four bits
follow from the element. Entities that read or write must have one.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from typing import Final
from xml.etree.ElementTree import Element

from ...wire import ids
from .xml_profiles import Profile, ProfileError, read_profile

# The most entities of an application, so that one with many times the objects that a client may
# have is refused while it is read.
MAX_ITEMS: Final = 1024

_GROUPS = {"publisher": ids.KIND_PUBLISHER, "subscriber": ids.KIND_SUBSCRIBER}
_ENDPOINTS = {
    "data_writer": (ids.KIND_DATAWRITER, ids.KIND_PUBLISHER),
    "data_reader": (ids.KIND_DATAREADER, ids.KIND_SUBSCRIBER),
}
_SERVICES = {"requester": ids.KIND_REQUESTER, "replier": ids.KIND_REPLIER}
# The domain that asks for the agent's own (XRCE_DOMAIN_ID_OVERRIDE).
DOMAIN_FROM_AGENT: Final = 255


@dataclass(frozen=True)
class Item:
    """One entity; ``parent`` is its parent's index in the list, for a participant its domain."""

    kind: int
    object_id: int | None
    parent: int
    profile: Profile


def items(element: Element) -> tuple[Item, ...]:
    """Return the entities of an ``<application>``, each after its parent.

    Raises:
        ProfileError: It lists none, too many, or one that cannot be used.
    """
    entities: list[Item] = []
    for participant in element:
        if participant.tag in ("participant", "domain_participant"):
            _participant(participant, entities)
    if not entities:
        raise ProfileError("there is no <domain_participant> in the application")
    id_counts = Counter(item.object_id for item in entities if item.object_id is not None)
    for object_id, times in id_counts.items():
        if times > 1:
            raise ProfileError(f"two of its entities have the object_id 0x{object_id:04X}")
    return tuple(entities)


def _participant(element: Element, entities: list[Item]) -> None:
    domain = element.get("domain_id") or element.findtext("domainId") or str(DOMAIN_FROM_AGENT)
    number = _number(domain.strip(), "domain_id")
    at = _add(entities, element, ids.KIND_PARTICIPANT, number)
    # Topics first: an endpoint may come before its topic in the document.
    for child in element:
        if child.tag == "topic":
            _add(entities, child, ids.KIND_TOPIC, at)
    topics = {
        name: topic.profile.topic_name
        for topic, name in zip(
            (item for item in entities[at:] if item.kind == ids.KIND_TOPIC),
            (child.get("name") for child in element if child.tag == "topic"),
            strict=True,
        )
    }
    for child in element:
        if child.tag in _GROUPS:
            group = _add(entities, child, _GROUPS[child.tag], at)
            for endpoint in child:
                if endpoint.tag in _ENDPOINTS:
                    kind, of = _ENDPOINTS[endpoint.tag]
                    if of != _GROUPS[child.tag]:
                        raise ProfileError(f"a <{child.tag}> has no <{endpoint.tag}>")
                    _endpoint(entities, endpoint, kind, group, topics)
        elif child.tag in _ENDPOINTS:
            kind, of = _ENDPOINTS[child.tag]
            entities.append(Item(of, None, at, Profile()))
            _endpoint(entities, child, kind, len(entities) - 1, topics)
        elif child.tag in _SERVICES:
            _add(entities, child, _SERVICES[child.tag], at, needed=True)


def _endpoint(
    entities: list[Item],
    element: Element,
    kind: int,
    group: int,
    topics: dict[str | None, str | None],
) -> None:
    at = _add(entities, element, kind, group, needed=True)
    profile = entities[at].profile
    profile.topic_name = topics.get(profile.topic_name) or profile.topic_name


def _add(
    entities: list[Item], element: Element, kind: int, parent: int, needed: bool = False
) -> int:
    """Append one entity, and return its index."""
    if len(entities) >= MAX_ITEMS:
        raise ProfileError(f"an application of over {MAX_ITEMS} entities")
    text = element.get("object_id")
    if text is None and needed:
        raise ProfileError(
            f'a <{element.tag}> without object_id="0x0010": the client could not name it'
        )
    object_id = None
    if text is not None:
        object_id = (_number(text.strip(), "object_id") & 0xFFF0) | kind
    entities.append(Item(kind, object_id, parent, read_profile(element)))
    return len(entities) - 1


def _number(text: str, name: str) -> int:
    """Return a number of 16 bits, in decimal or with 0x before it."""
    if re.fullmatch(r"0[xX][0-9A-Fa-f]{1,4}", text):
        return int(text, 16)
    if not re.fullmatch(r"[0-9]{1,5}", text) or int(text) > 0xFFFF:
        raise ProfileError(f"{name} is {text!r}, not a number of 16 bits")
    return int(text)
