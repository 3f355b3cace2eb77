"""Parses the representation in a CREATE, of any format, into one form."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, Protocol

from ...middleware.base import Service
from ...qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, from_flags
from ...wire import entities, ids
from ...wire.cdr import Reader
from ...wire.errors import DecodeError
from . import application, xml_profiles

# How deep the bases of QoS profiles may be nested: a profile may name itself as its base.
MAX_BASES: Final = 8

NO_FILTERS: Final = "content filters are not supported: filter on the client"


class UnknownReference(Exception):
    """A reference to a profile or an object that does not exist."""


class Lookup(Protocol):
    """Finds references: among the client's objects, then in the agent's files."""

    def find(self, tag: str, name: str) -> xml_profiles.Profile | None:
        """Return the profile of that kind and name; a type's has its ``type_name`` only."""


@dataclass(frozen=True)
class ParticipantSpec:
    """A participant; ``name`` is ``namespace/name`` or a plain name, None if it has none."""

    domain: int
    name: str | None
    localhost_only: bool = False


@dataclass(frozen=True)
class TopicSpec:
    """A topic by its DDS names."""

    name: str
    type_name: str


@dataclass(frozen=True)
class GroupSpec:
    """A publisher or a subscriber."""

    partitions: tuple[str, ...] = ()


@dataclass(frozen=True)
class EndpointSpec:
    """A datawriter or a datareader, on a topic object or on a topic by name."""

    topic_id: int | None
    topic: TopicSpec | None
    qos: QoSProfile = field(default_factory=QoSProfile)


@dataclass(frozen=True)
class ServiceSpec:
    """A requester or a replier."""

    request_topic: str
    request_type: str
    reply_topic: str
    reply_type: str

    def service(self) -> Service:
        """Return the service as the middleware takes it."""
        return Service(self.request_topic, self.request_type, self.reply_topic, self.reply_type)


@dataclass(frozen=True)
class TypeSpec:
    """Types that topics can name by reference."""

    names: frozenset[str]


@dataclass(frozen=True)
class QosProfileSpec:
    """QoS profiles that entities can have as their base, by name."""

    named: dict[str, xml_profiles.Profile]


@dataclass(frozen=True)
class ApplicationSpec:
    """Entities that are created and deleted as one, parents first."""

    items: tuple[application.Item, ...]


Spec = (
    ParticipantSpec
    | TopicSpec
    | GroupSpec
    | EndpointSpec
    | ServiceSpec
    | TypeSpec
    | QosProfileSpec
    | ApplicationSpec
)


def default_writer_qos() -> QoSProfile:
    """Return the QoS of a datawriter without any: Fast DDS's default, as with the C++ agent."""
    return QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def default_reader_qos() -> QoSProfile:
    """Return the QoS of a datareader without any: Fast DDS's default, as with the C++ agent."""
    return QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


def parse(
    kind: int,
    form: int,
    content: str | bytes,
    parent: int,
    little: bool,
    references: Lookup,
    any_name: bool = False,
) -> Spec:
    """Return the specification of one object.

    Args:
        kind: The kind of the object.
        form: The format: BY_REFERENCE, AS_XML_STRING or IN_BINARY.
        content: The representation.
        parent: The parent's object id; the domain of a participant.
        little: Whether a binary representation is little endian.
        references: Finds profiles and types by name.
        any_name: Whether other text is a name, as with :mod:`uros.middleware.ced`.

    Raises:
        DecodeError: The content has no meaning for the kind.
        ProfileError: The XML cannot be used.
        UnknownReference: It refers to what nobody has defined.
    """
    if any_name and isinstance(content, str):
        try:
            return parse(kind, form, content, parent, little, references)
        except (DecodeError, xml_profiles.ProfileError, UnknownReference):
            if kind not in _NAMED:
                raise
        return _from_name(kind, content, parent)
    if form == ids.IN_BINARY:
        assert isinstance(content, bytes)
        r = Reader(content, 0, len(content), little)
        return _from_binary(kind, r, parent, references)
    assert isinstance(content, str)
    if form == ids.BY_REFERENCE:
        stored_profile = references.find(_TAGS.get(kind, ""), content)
        if stored_profile is None:
            raise UnknownReference(
                f"no profile {content!r} of a {_TAGS.get(kind, 'kind')} is known:"
                " give the agent a file that defines it (--refs FILE)"
            )
        if kind == ids.KIND_TYPE:
            return TypeSpec(frozenset((content,)))
        if kind == ids.KIND_QOS_PROFILE:
            return QosProfileSpec({content: stored_profile})
        return from_profile(kind, stored_profile, parent, references)
    if kind == ids.KIND_TYPE:
        return TypeSpec(xml_profiles.parse_types(content))
    if kind == ids.KIND_QOS_PROFILE:
        return QosProfileSpec(xml_profiles.parse_qos_profiles(content))
    if not content.strip():
        return from_profile(kind, xml_profiles.Profile(), parent, references)
    profile = xml_profiles.parse_xml(_TAGS.get(kind, ""), content)
    return from_profile(kind, profile, parent, references)


_TAGS = {
    ids.KIND_PARTICIPANT: "participant",
    ids.KIND_TOPIC: "topic",
    ids.KIND_PUBLISHER: "publisher",
    ids.KIND_SUBSCRIBER: "subscriber",
    ids.KIND_DATAWRITER: "data_writer",
    ids.KIND_DATAREADER: "data_reader",
    ids.KIND_REQUESTER: "requester",
    ids.KIND_REPLIER: "replier",
    ids.KIND_TYPE: "type",
    ids.KIND_QOS_PROFILE: "qos_profile",
    ids.KIND_APPLICATION: "application",
}


_NAMED = (
    ids.KIND_PARTICIPANT, ids.KIND_TOPIC, ids.KIND_PUBLISHER, ids.KIND_SUBSCRIBER,
    ids.KIND_DATAWRITER, ids.KIND_DATAREADER,
)  # fmt: skip
# Samples that each topic of the C++ CED keeps for its readers.
_CED_DEPTH = 16


def _from_name(kind: int, name: str, parent: int) -> Spec:
    """Return the specification that the C++ agent's CED makes of a text."""
    if kind == ids.KIND_PARTICIPANT:
        return ParticipantSpec(parent & 0xFFFF, None)
    if kind == ids.KIND_TOPIC:
        return TopicSpec(name, "")
    if kind in (ids.KIND_PUBLISHER, ids.KIND_SUBSCRIBER):
        return GroupSpec()
    return EndpointSpec(None, TopicSpec(name, ""), QoSProfile(depth=_CED_DEPTH))


def _from_binary(kind: int, r: Reader, parent: int, references: Lookup) -> Spec:
    if kind == ids.KIND_PARTICIPANT:
        # In the specification it is a reference to a QoS profile. Profiles have nothing for
        # participants here, and all known clients send the node's name.
        name, _ = entities.pull_binary_participant(r)
        return ParticipantSpec(parent & 0xFFFF, name)
    if kind == ids.KIND_TOPIC:
        topic, type_name = entities.pull_binary_topic(r)
        if not type_name:
            type_name = _referred_type(topic, r, references)
        return TopicSpec(topic, type_name)
    if kind in (ids.KIND_PUBLISHER, ids.KIND_SUBSCRIBER):
        return GroupSpec(tuple(entities.pull_binary_group(r)[1]))
    if kind in (ids.KIND_DATAWRITER, ids.KIND_DATAREADER):
        reader = kind == ids.KIND_DATAREADER
        topic_id, fields = entities.pull_binary_endpoint(r, reader)
        if fields is None:
            qos = default_reader_qos() if reader else default_writer_qos()
            return EndpointSpec(topic_id, None, qos)
        flags, depth, deadline, lifespan, user_data, extra, content_filter = fields
        if content_filter:
            raise DecodeError(NO_FILTERS)
        qos = from_flags(flags, depth)
        qos.deadline_ms = deadline
        qos.lifespan_ms = lifespan
        qos.user_data = user_data or b""
        if reader:
            qos.separation_ms = extra
        else:
            qos.ownership_strength = extra
        return EndpointSpec(topic_id, None, qos)
    if kind in (ids.KIND_REQUESTER, ids.KIND_REPLIER):
        return _service(*entities.pull_binary_service(r))
    if kind in _TAGS:
        raise DecodeError(
            f"a {_TAGS[kind]} has no binary format: describe it by XML or by reference"
        )
    raise DecodeError(f"objects of kind {kind} cannot be created")


def _referred_type(topic: str, r: Reader, references: Lookup) -> str:
    """Return the type of a binary topic that names it by reference only."""
    r.offset = r.start
    r.string()
    reference = r.string() if r.boolean() else ""
    if not reference:
        raise DecodeError(f"the topic {topic!r} has no type")
    if references.find("type", reference) is None:
        raise UnknownReference(
            f"the type {reference!r} of topic {topic!r} is not known: create an object of kind"
            " TYPE that defines it, or give the agent a file that does (--refs FILE)"
        )
    return reference


def _service(
    name: str,
    request_type: str,
    reply_type: str,
    request_topic: str | None,
    reply_topic: str | None,
) -> ServiceSpec:
    """Derive topics without a name from the service's name, as Fast DDS does."""
    return ServiceSpec(
        request_topic or f"{name}_Request",
        request_type,
        reply_topic or f"{name}_Reply",
        reply_type,
    )


def _apply(
    tag: str, profile: xml_profiles.Profile, qos: QoSProfile, references: Lookup, depth: int = 0
) -> None:
    """Set the profile's values on ``qos``, after those of its bases."""
    if profile.base is not None:
        if depth >= MAX_BASES:
            raise xml_profiles.ProfileError(f"QoS profiles have bases more than {MAX_BASES} deep")
        base = references.find("qos_profile", profile.base)
        if base is None:
            raise UnknownReference(
                f"the QoS profile {profile.base!r} is not known: create an object of kind"
                " QOS_PROFILE that defines it, or give the agent a file that does (--refs FILE)"
            )
        _apply(tag, base, qos, references, depth + 1)
    part = profile.parts.get(tag)
    if part is not None:
        _apply(tag, part, qos, references, depth + 1)
    profile.apply(qos)


def from_profile(kind: int, profile: xml_profiles.Profile, parent: int, references: Lookup) -> Spec:
    """Return the specification of an object by its profile; see :func:`parse`."""
    if kind == ids.KIND_APPLICATION:
        if profile.element is None:
            raise xml_profiles.ProfileError("there is no <application> in it")
        return ApplicationSpec(application.items(profile.element))
    if kind == ids.KIND_PARTICIPANT:
        return ParticipantSpec(parent & 0xFFFF, profile.name, profile.localhost_only)
    if kind == ids.KIND_TOPIC:
        if not profile.topic_name or not profile.type_name:
            raise xml_profiles.ProfileError("a topic needs <name> and <dataType>")
        return TopicSpec(profile.topic_name, profile.type_name)
    if kind in (ids.KIND_PUBLISHER, ids.KIND_SUBSCRIBER):
        group = QoSProfile()
        _apply(_TAGS[kind], profile, group, references)
        return GroupSpec(profile.partitions or group.partitions)
    if kind in (ids.KIND_DATAWRITER, ids.KIND_DATAREADER):
        if not profile.topic_name:
            raise xml_profiles.ProfileError(
                "a data_writer or data_reader needs <topic> with <name>"
            )
        if profile.content_filter:
            raise xml_profiles.ProfileError(NO_FILTERS)
        reader = kind == ids.KIND_DATAREADER
        qos = default_reader_qos() if reader else default_writer_qos()
        _apply(_TAGS[kind], profile, qos, references)
        return EndpointSpec(None, TopicSpec(profile.topic_name, profile.type_name or ""), qos)
    if kind in (ids.KIND_REQUESTER, ids.KIND_REPLIER):
        if not profile.service_name or not profile.request_type or not profile.reply_type:
            raise xml_profiles.ProfileError(
                "a requester or replier needs service_name, request_type and reply_type"
            )
        return _service(
            profile.service_name,
            profile.request_type,
            profile.reply_type,
            profile.request_topic,
            profile.reply_topic,
        )
    raise DecodeError(f"objects of kind {kind} cannot be created")
