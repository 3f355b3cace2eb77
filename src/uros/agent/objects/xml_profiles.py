"""Reads XML representations and reference files: the elements that matter to boards.

There are two dialects: Fast DDS's profile XML, which the C++ agent reads
(``<data_writer profile_name="…"><qos>``), and that of DDS-XML, which the XRCE
specification names (``<qos_library>``, ``<types>``, ``<application>``). Elements
that are not known are passed over.

Both come from outside, so document types and entities are refused, and size, depth
and number of elements are limited.
"""

from __future__ import annotations

import base64
import binascii
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from ...qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from ...wire.entities import MAX_PARTITIONS

# The most characters of a representation and of a file of references, the depth of nesting and the
# number of elements. They limit the memory and time that malicious XML can take.
MAX_XML = 64 * 1024
MAX_REFERENCES_FILE = 4 * 1024 * 1024
MAX_DEPTH = 32
MAX_ELEMENTS = 20_000
# The largest number: a larger one does not fit the 32 bits that it has in DDS.
MAX_NUMBER = 0x7FFFFFFF

_TAGS = (
    "participant",
    "topic",
    "publisher",
    "subscriber",
    "data_writer",
    "data_reader",
    "requester",
    "replier",
    "application",
)
# The tags of DDS-XML that mean the same as one of Fast DDS.
_ALSO = {"domain_participant": "participant"}


class ProfileError(ValueError):
    """XML that is broken, too large, or without what is needed."""


@dataclass
class Profile:
    """The content of one profile; fields without a value are None or empty."""

    name: str | None = None
    localhost_only: bool = False
    topic_name: str | None = None
    type_name: str | None = None
    partitions: tuple[str, ...] = ()
    service_name: str | None = None
    request_type: str | None = None
    reply_type: str | None = None
    request_topic: str | None = None
    reply_topic: str | None = None
    qos: dict[str, object] = field(default_factory=dict)
    # The QoS profile its own QoS stands on (base_name), and that of a QoS profile's parts.
    base: str | None = None
    content_filter: bool = False
    parts: dict[str, Profile] = field(default_factory=dict)
    # The XML of an application: what is in it is for `application.py`.
    element: Element | None = field(default=None, compare=False)

    def apply(self, qos: QoSProfile) -> None:
        """Set what the profile says on a QoS profile that holds the defaults."""
        for key, value in self.qos.items():
            setattr(qos, key, value)


class References:
    """Profiles by kind and name, from files given to the agent."""

    def __init__(self) -> None:
        self._profiles: dict[tuple[str, str], Profile] = {}

    def load(self, path: str | Path) -> int:
        """Add the profiles of a file, and return how many it has.

        Raises:
            ProfileError: The file cannot be read or used; the message names it.
        """
        try:
            with Path(path).open("rb") as file:
                # A byte more than there may be characters, at four bytes each, is too much.
                text = file.read(4 * MAX_REFERENCES_FILE + 1).decode("utf-8")
        except OSError as error:
            raise ProfileError(f"{path}: {error.strerror}") from error
        except UnicodeDecodeError as error:
            raise ProfileError(f"{path}: {error}") from error
        try:
            root = _document(text, MAX_REFERENCES_FILE)
            profiles = {}
            for element in root.iter():
                name = element.get("profile_name")
                if element.tag in _TAGS and name:
                    profiles[element.tag, name] = read_profile(element, root)
            profiles.update(
                (("qos_profile", name), profile) for name, profile in qos_profiles(root)
            )
            profiles.update((("type", name), Profile(type_name=name)) for name in _types(root))
            profiles.update(
                (("application", name), profile) for name, profile in _applications(root)
            )
        except ProfileError as error:
            raise ProfileError(f"{path}: {error}") from error
        if not profiles:
            raise ProfileError(
                f"{path}: no profiles in it (elements with a profile_name,"
                " <types>, <qos_profile>, <application>)"
            )
        self._profiles.update(profiles)
        return len(profiles)

    def find(self, tag: str, name: str) -> Profile | None:
        """Return the profile of that kind and name, or None."""
        return self._profiles.get((tag, name))


def parse_xml(tag: str, text: str) -> Profile:
    """Return the profile in an XML representation.

    Args:
        tag: The element that describes the kind of object.
        text: The XML document.

    Raises:
        ProfileError: It has no such element, or cannot be used.
    """
    root = _document(text, MAX_XML)
    element = root if root.tag == tag else root.find(f".//{tag}")
    if element is None:
        raise ProfileError(f"there is no <{tag}> in it")
    return read_profile(element, root)


def parse_types(text: str) -> frozenset[str]:
    """Return the names of the types that an XML representation defines.

    Raises:
        ProfileError: It defines none, or cannot be used.
    """
    names = frozenset(_types(_document(text, MAX_XML)))
    if not names:
        raise ProfileError("there is no type in it: a <struct> with a name, or the like")
    return names


def parse_qos_profiles(text: str) -> dict[str, Profile]:
    """Return the QoS profiles of an XML representation, each by all its names.

    Raises:
        ProfileError: It has none, or cannot be used.
    """
    profiles = dict(qos_profiles(_document(text, MAX_XML)))
    if not profiles:
        raise ProfileError("there is no <qos_profile> with a name in it")
    return profiles


class _Limited(TreeBuilder):
    def __init__(self) -> None:
        super().__init__()
        self._depth = 0
        self._count = 0

    def start(self, tag: str, attributes: dict[str, str], /) -> Element:
        self._depth += 1
        self._count += 1
        if self._depth > MAX_DEPTH:
            raise ProfileError(f"XML nested deeper than {MAX_DEPTH}")
        if self._count > MAX_ELEMENTS:
            raise ProfileError(f"XML with more than {MAX_ELEMENTS} elements")
        return super().start(tag, attributes)

    def end(self, tag: str, /) -> Element:
        self._depth -= 1
        return super().end(tag)


# eProsima's own examples write a="x"b="y"; tinyxml2 takes it, expat does not.
_GLUED = re.compile(r'(\w="[^"<>]*")(?=\w)')


def _document(text: str, limit: int) -> Element:
    if len(text) > limit:
        raise ProfileError(f"XML of {len(text)} characters is over the limit of {limit}")
    builder = _Limited()
    parser = expat.ParserCreate()
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    parser.StartDoctypeDeclHandler = _refuse
    parser.EntityDeclHandler = _refuse
    parser.buffer_text = True
    try:
        parser.Parse(_GLUED.sub(r"\1 ", text), True)
        root: Element = builder.close()
    except expat.ExpatError as error:
        raise ProfileError(f"broken XML: {error}") from error
    except (AssertionError, ValueError) as error:
        raise (
            error if isinstance(error, ProfileError) else ProfileError(f"broken XML: {error}")
        ) from error
    return root


def _refuse(*_: object) -> None:
    raise ProfileError("document types and entities are not accepted")


def _text(element: Element, *paths: str) -> str | None:
    for path in paths:
        child = element.find(path)
        if child is not None and child.text and child.text.strip():
            return child.text.strip()
    return None


def read_profile(element: Element, root: Element | None = None) -> Profile:
    """Return the profile that one element of either dialect describes.

    Args:
        element: The element of the object.
        root: The document with what the element refers to by name, such as transports.

    Raises:
        ProfileError: A value is not one of those that its element can have.
    """
    tag = _ALSO.get(element.tag, element.tag)
    profile = Profile()
    if tag == "participant":
        profile.name = _text(element, "rtps/name") or element.get("name")
        profile.localhost_only = _only_loopback(element, root)
        return profile
    if tag == "topic":
        profile.topic_name = _text(element, "name") or element.get("name")
        profile.type_name = _text(element, "dataType") or element.get("register_type_ref")
        return profile
    if tag in ("requester", "replier"):
        profile.service_name = element.get("service_name")
        profile.request_type = element.get("request_type")
        profile.reply_type = element.get("reply_type")
        profile.request_topic = _text(element, "request_topic_name")
        profile.reply_topic = _text(element, "reply_topic_name")
        return profile
    if tag == "application":
        profile.element = element
        profile.name = element.get("name") or element.get("profile_name")
        return profile
    profile.topic_name = _text(element, "topic/name") or element.get("topic_ref")
    profile.type_name = _text(element, "topic/dataType")
    own = element.find(_QOS_TAGS[tag])
    profile.base = None if own is None else own.get("base_name")
    profile.content_filter = any(element.find(path) is not None for path in _FILTERS)
    _qos(element, ("qos/", _QOS_TAGS[tag] + "/"), profile.qos)
    if tag in ("publisher", "subscriber"):
        partitions = profile.qos.pop("partitions", ())
        assert isinstance(partitions, tuple)
        profile.partitions = partitions
        profile.qos.clear()
    return profile


# --- what DDS-XML has beside Fast DDS's profiles ------------------------------------

_QOS_TAGS = {
    "publisher": "publisher_qos",
    "subscriber": "subscriber_qos",
    "data_writer": "datawriter_qos",
    "data_reader": "datareader_qos",
}
# How readers ask for a content filter, in DDS-XML and in what vendors made of it.
_FILTERS = ("content_filter", "contentFilter", "filter", "topic/content_filter", "topic/filter")
_CONSTRUCTED = ("struct", "union", "enum", "typedef", "bitset", "bitmask", "valuetype")


def _types(element: Element, prefix: str = "", within: bool = False) -> Iterator[str]:
    """Yield the full names of the types defined in an element; modules become ``a::b::``."""
    within = within or element.tag in ("types", "type")
    for child in element:
        name = child.get("name")
        if child.tag in _CONSTRUCTED and name and within:
            yield prefix + name
        elif child.tag == "module" and name and within:
            yield from _types(child, f"{prefix}{name}::", True)
        elif child.tag != "module":
            yield from _types(child, prefix, within)


def qos_profiles(root: Element) -> Iterator[tuple[str, Profile]]:
    """Yield ``(name, profile)`` of each ``<qos_profile>``, also as ``library::name`` if in one."""
    libraries = {
        child: library.get("name") for library in root.iter("qos_library") for child in library
    }
    for element in root.iter("qos_profile"):
        name = element.get("name")
        if not name:
            continue
        profile = Profile(base=element.get("base_name"))
        for tag, qos_tag in _QOS_TAGS.items():
            part = element.find(qos_tag)
            if part is not None:
                own = profile.parts[tag] = Profile(base=part.get("base_name"))
                _qos(element, (qos_tag + "/",), own.qos)
        yield name, profile
        if libraries.get(element):
            yield f"{libraries[element]}::{name}", profile


def _applications(root: Element) -> Iterator[tuple[str, Profile]]:
    libraries = {
        child: library.get("name")
        for library in root.iter("application_library")
        for child in library
    }
    for element in root.iter("application"):
        name = element.get("name")
        if name:
            yield name, read_profile(element)
            if libraries.get(element):
                yield f"{libraries[element]}::{name}", read_profile(element)


def _only_loopback(participant: Element, root: Element | None) -> bool:
    """Return whether every interface the profile allows is loopback (PX4's LocalHostOnly)."""
    transports = [used.text.strip() for used in participant.iter("transport_id") if used.text]
    descriptors = [] if root is None else list(root.iter("transport_descriptor"))
    chosen = [
        descriptor for descriptor in descriptors if _text(descriptor, "transport_id") in transports
    ]
    allowed = [
        address.text.strip()
        for element in (participant, *chosen)
        for white_list in element.iter("interfaceWhiteList")
        for address in white_list
        if address.text
    ]
    if allowed:
        return all(address.startswith("127.") or address == "localhost" for address in allowed)
    return any("localhost" in name.lower() for name in transports)


# Words as in Fast DDS; DDS-XML writes RELIABLE_RELIABILITY_QOS.
_WORDS: dict[str, tuple[tuple[str, ...], dict[str, object]]] = {
    "reliability": (
        ("reliability/kind",),
        {"RELIABLE": ReliabilityPolicy.RELIABLE, "BEST_EFFORT": ReliabilityPolicy.BEST_EFFORT},
    ),
    "durability": (
        ("durability/kind",),
        {
            "VOLATILE": DurabilityPolicy.VOLATILE,
            "TRANSIENT_LOCAL": DurabilityPolicy.TRANSIENT_LOCAL,
            "TRANSIENT": DurabilityPolicy.TRANSIENT,
            "PERSISTENT": DurabilityPolicy.PERSISTENT,
        },
    ),
    "history": (
        ("history/kind",),
        {"KEEP_LAST": HistoryPolicy.KEEP_LAST, "KEEP_ALL": HistoryPolicy.KEEP_ALL},
    ),
    "liveliness": (
        ("liveliness/kind",),
        {
            "AUTOMATIC": LivelinessPolicy.AUTOMATIC,
            "MANUAL_BY_TOPIC": LivelinessPolicy.MANUAL_BY_TOPIC,
        },
    ),
    "ownership_exclusive": (("ownership/kind",), {"SHARED": False, "EXCLUSIVE": True}),
}
_PERIODS = {
    "deadline_ms": ("deadline/period",),
    "lifespan_ms": ("lifespan/duration",),
    "separation_ms": (
        "timeBasedFilter/minimum_separation", "time_based_filter/minimum_separation",
    ),
    "liveliness_lease_ms": ("liveliness/lease_duration",),
}  # fmt: skip
_NUMBERS = {
    "depth": ("history/depth",),
    "ownership_strength": ("ownershipStrength/value", "ownership_strength/value"),
}


def _qos(element: Element, where: tuple[str, ...], out: dict[str, object]) -> None:
    """Add the QoS in the children ``where`` of an entity's element to ``out``.

    Fast DDS has the history in the topic instead.
    """

    def child_at(*paths: str) -> Element | None:
        for path in paths:
            for start in where:
                child = element.find(start + path)
                if child is not None:
                    return child
            if path.startswith("history/"):
                child = element.find(path.replace("history/", "topic/historyQos/"))
                if child is not None:
                    return child
        return None

    for key, (paths, values) in _WORDS.items():
        child = child_at(*paths)
        if child is not None and child.text and child.text.strip():
            text = child.text.strip()
            word = re.sub("_(RELIABILITY|DURABILITY|HISTORY|LIVELINESS|OWNERSHIP)_QOS$", "", text)
            if word not in values:
                raise ProfileError(f"<{paths[0]}> is {text!r}, not one of {', '.join(values)}")
            out[key] = values[word]
    for key, paths in _NUMBERS.items():
        child = child_at(*paths)
        if child is not None and child.text and child.text.strip():
            out[key] = _number(child.text.strip(), paths[0].split("/")[1 if key == "depth" else 0])
    for key, paths in _PERIODS.items():
        period = child_at(*paths)
        if period is not None:
            milliseconds = _milliseconds(period)
            if milliseconds:
                out[key] = milliseconds
    names = [
        child.text.strip()
        for start in where
        for path in ("partition/names/name", "partition/name/element", "partition/name/name")
        for child in element.iterfind(start + path)
        if child.text
    ]
    if len(names) > MAX_PARTITIONS:
        raise ProfileError(f"{len(names)} partitions are over the limit of {MAX_PARTITIONS}")
    if names:
        out["partitions"] = tuple(names)
    data = child_at("userData/value", "user_data/value")
    if data is not None and data.text and data.text.strip():
        out["user_data"] = _octets(data.text.strip())


def _octets(text: str) -> bytes:
    """Decode user data: hex octets with dots between as in Fast DDS, or base64 as in DDS-XML."""
    if re.fullmatch(r"[0-9A-Fa-f]{1,2}(\.[0-9A-Fa-f]{1,2})*\.?", text) and (
        "." in text or len(text) <= 2
    ):
        return bytes(int(octet, 16) for octet in text.split(".") if octet)
    try:
        return base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError) as error:
        reason = f"<userData> is {text[:40]!r}, neither hex octets (1f.2a) nor base64"
        raise ProfileError(reason) from error


def _milliseconds(period: Element) -> int | None:
    """Return a period in milliseconds; None for an infinite one."""
    seconds, nanoseconds = _text(period, "sec") or "0", _text(period, "nanosec") or "0"
    if "INFIN" in seconds or "INFIN" in nanoseconds or (period.text and "INFIN" in period.text):
        return None
    return _number(seconds, "sec") * 1000 + _number(nanoseconds, "nanosec") // 1_000_000


def _number(text: str, tag: str) -> int:
    if not re.fullmatch(r"[0-9]{1,10}", text) or int(text) > MAX_NUMBER:
        raise ProfileError(f"<{tag}> is {text!r}, not a number")
    return int(text)
