"""XML representations and reference files: Fast DDS's profile XML, as far as it
says something a board can mean.

Both come from outside, so nothing clever is left on: no document type, no
entities, a limit on size, depth and number of elements.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from ..qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

# Attack: XML that is huge, deep or full of elements.
MAX_XML = 64 * 1024
MAX_REFERENCES_FILE = 4 * 1024 * 1024
MAX_DEPTH = 32
MAX_ELEMENTS = 20_000
# Attack: a number that does not fit the 32 bits it has in DDS.
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
)


class ProfileError(ValueError):
    """XML that is broken, too much, or does not say what is needed."""


@dataclass
class Profile:
    """What one profile says; None and empty where it says nothing."""

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

    def apply(self, qos: QoSProfile) -> None:
        """Set what the profile says on a QoS profile that holds the defaults."""
        for key, value in self.qos.items():
            setattr(qos, key, value)


class References:
    """Profiles by kind and name, from files given to the agent."""

    def __init__(self) -> None:
        self._profiles: dict[tuple[str, str], Profile] = {}

    def load(self, path: str | Path) -> int:
        """Add the profiles of a file; how many. Raises ProfileError naming the file."""
        try:
            text = Path(path).read_text("utf-8")
        except OSError as error:
            raise ProfileError(f"{path}: {error.strerror}") from error
        except UnicodeDecodeError as error:
            raise ProfileError(f"{path}: {error}") from error
        try:
            root = _document(text, MAX_REFERENCES_FILE)
            found = {}
            for element in root.iter():
                name = element.get("profile_name")
                if element.tag in _TAGS and name:
                    found[element.tag, name] = _profile(element)
        except ProfileError as error:
            raise ProfileError(f"{path}: {error}") from error
        if not found:
            raise ProfileError(f"{path}: no profiles in it (elements with a profile_name)")
        self._profiles.update(found)
        return len(found)

    def find(self, tag: str, name: str) -> Profile | None:
        return self._profiles.get((tag, name))


def parse_xml(tag: str, text: str) -> Profile:
    """The profile in an XML representation of the kind ``tag``."""
    root = _document(text, MAX_XML)
    element = root if root.tag == tag else root.find(f".//{tag}")
    if element is None:
        raise ProfileError(f"there is no <{tag}> in it")
    return _profile(element)


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
        raise error if isinstance(error, ProfileError) else ProfileError(
            f"broken XML: {error}"
        ) from error
    return root


def _refuse(*_: object) -> None:
    raise ProfileError("document types and entities are not accepted")


def _text(element: Element, *paths: str) -> str | None:
    for path in paths:
        found = element.find(path)
        if found is not None and found.text and found.text.strip():
            return found.text.strip()
    return None


def _profile(element: Element) -> Profile:
    tag = element.tag
    profile = Profile()
    if tag == "participant":
        profile.name = _text(element, "rtps/name")
        profile.localhost_only = _only_loopback(element)
        return profile
    if tag == "topic":
        profile.topic_name = _text(element, "name")
        profile.type_name = _text(element, "dataType")
        return profile
    if tag in ("requester", "replier"):
        profile.service_name = element.get("service_name")
        profile.request_type = element.get("request_type")
        profile.reply_type = element.get("reply_type")
        profile.request_topic = _text(element, "request_topic_name")
        profile.reply_topic = _text(element, "reply_topic_name")
        return profile
    profile.topic_name = _text(element, "topic/name")
    profile.type_name = _text(element, "topic/dataType")
    profile.partitions = tuple(
        name.text.strip()
        for name in element.iter("name")
        if name.text and tag in ("publisher", "subscriber")
    )
    _qos(element, profile.qos)
    return profile


def _only_loopback(participant: Element) -> bool:
    """Whether every interface the profile allows is loopback (PX4's LocalHostOnly)."""
    allowed = [
        address.text.strip()
        for white_list in participant.iter("interfaceWhiteList")
        for address in white_list
        if address.text
    ]
    if allowed:
        return all(address.startswith("127.") or address == "localhost" for address in allowed)
    transports = [it.text.strip() for it in participant.iter("transport_id") if it.text]
    return any("localhost" in name.lower() for name in transports)


_RELIABILITY = {
    "RELIABLE": ReliabilityPolicy.RELIABLE,
    "BEST_EFFORT": ReliabilityPolicy.BEST_EFFORT,
}
_DURABILITY = {
    "VOLATILE": DurabilityPolicy.VOLATILE,
    "TRANSIENT_LOCAL": DurabilityPolicy.TRANSIENT_LOCAL,
    "TRANSIENT": DurabilityPolicy.TRANSIENT,
    "PERSISTENT": DurabilityPolicy.PERSISTENT,
}
_HISTORY = {"KEEP_LAST": HistoryPolicy.KEEP_LAST, "KEEP_ALL": HistoryPolicy.KEEP_ALL}


def _qos(element: Element, out: dict[str, object]) -> None:
    for key, path, values in (
        ("reliability", "qos/reliability/kind", _RELIABILITY),
        ("durability", "qos/durability/kind", _DURABILITY),
        ("history", "topic/historyQos/kind", _HISTORY),
    ):
        word = _text(element, path)
        if word is not None:
            if word not in values:
                raise ProfileError(f"<{path}> is {word!r}, not one of {', '.join(values)}")
            out[key] = values[word]
    depth = _text(element, "topic/historyQos/depth")
    if depth is not None:
        out["depth"] = _number(depth, "depth")
    for key, path in (
        ("deadline_ms", "qos/deadline/period"),
        ("lifespan_ms", "qos/lifespan/duration"),
        ("separation_ms", "qos/timeBasedFilter/minimum_separation"),
        ("liveliness_lease_ms", "qos/liveliness/lease_duration"),
    ):
        period = element.find(path)
        if period is not None:
            milliseconds = _milliseconds(period)
            if milliseconds:
                out[key] = milliseconds
    if _text(element, "qos/ownership/kind") == "EXCLUSIVE":
        out["ownership_exclusive"] = True
    strength = _text(element, "qos/ownershipStrength/value")
    if strength is not None:
        out["ownership_strength"] = _number(strength, "ownershipStrength")
    names = [it.text.strip() for it in element.iterfind("qos/partition/names/name") if it.text]
    if names:
        out["partitions"] = tuple(names)


def _milliseconds(period: Element) -> int | None:
    """None for an infinite period."""
    seconds, nanoseconds = _text(period, "sec") or "0", _text(period, "nanosec") or "0"
    if "INFIN" in seconds or "INFIN" in nanoseconds or (period.text and "INFIN" in period.text):
        return None
    return _number(seconds, "sec") * 1000 + _number(nanoseconds, "nanosec") // 1_000_000


def _number(text: str, what: str) -> int:
    if not re.fullmatch(r"[0-9]{1,10}", text) or int(text) > MAX_NUMBER:
        raise ProfileError(f"<{what}> is {text!r}, not a number")
    return int(text)
