"""Cyclone's configuration in ``CYCLONEDDS_URI``: XML, or files of it, and what uros reads of it.

Cyclone itself reads all of it (``dds``). ``rtps`` reads which network it uses, where it
looks for others, and how large a datagram may be (:func:`read_settings`), so that one setting
serves both, and names what it leaves out.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from string import ascii_letters
from typing import Final
from xml.etree import ElementTree

from .base import MiddlewareError

NAME: Final = "CYCLONEDDS_URI"
_UNITS: Final = {
    "b": 1, "kb": 1 << 10, "kib": 1 << 10, "mb": 1 << 20, "mib": 1 << 20, "gb": 1 << 30,
    "gib": 1 << 30,
}  # fmt: skip
# A comment, a processing instruction, CDATA, or a tag, whose values may contain angle brackets.
_MARKUP: Final = re.compile(
    r"""<!--.*?-->|<\?.*?\?>|<!\[CDATA\[.*?\]\]>|<(?:[^<>"']|"[^"]*"|'[^']*')*>""", re.DOTALL
)
_TRUE: Final = ("true", "1", "yes")


def parts(uri: str) -> list[str]:
    """Return what CYCLONEDDS_URI lists, separated by commas: XML, and the names of files.

    Elements without a file between them are one part, and so is XML that does not end.
    """
    found: list[str] = []
    begin = -1  # of the XML that has not ended
    place = depth = 0
    while True:
        sign = uri.find("<", place)
        if depth == 0:
            names = _names(uri[place:] if sign < 0 else uri[place:sign])
            if begin >= 0 and (names or sign < 0):
                found.append(uri[begin:place])
                begin = -1
            found += names
            if sign < 0:
                return found
            begin = sign if begin < 0 else begin
        markup = _MARKUP.match(uri, sign) if sign >= 0 else None
        depth += _opened(markup.group()) if markup else 0
        if markup is None or depth < 0:
            return [*found, uri[begin:]]
        place = markup.end()


def _opened(markup: str) -> int:
    """How many more elements are open behind a tag, a comment or other markup."""
    if markup.startswith("</"):
        return -1
    return 0 if markup.startswith(("<!", "<?")) or markup.endswith("/>") else 1


def _names(text: str) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()]


def text_of(part: str) -> str:
    """Return the XML of a part: the part itself, or the file that it names.

    Raises:
        OSError: The file cannot be read.
    """
    if part.startswith("<"):
        return part
    return Path(part.removeprefix("file://")).read_text("utf-8", "replace")


def parse(text: str) -> ElementTree.Element:
    """Parse XML, which may be a fragment: Cyclone accepts several elements without a root.

    No entity is expanded: they are defined in a document type alone, which must not stand inside an
    element, and here all stands in one.

    Raises:
        ValueError: It is not well-formed, or has a document type.
    """
    stripped = text.strip()
    if stripped.startswith("<?"):
        stripped = stripped.partition("?>")[2]
    try:
        return ElementTree.fromstring(f"<uri>{stripped}</uri>")
    except ElementTree.ParseError as error:
        raise ValueError(str(error)) from error


def local_name(name: str) -> str:
    """Return the name of an element or attribute without its namespace, in lower case."""
    return _shown(name).lower()


@dataclass(frozen=True)
class InterfaceChoice:
    """An interface that the configuration names.

    Attributes:
        name: Its name or one of its addresses; empty for the ones that are chosen automatically.
        multicast: Whether multicast is used on it; None: if it can.
    """

    name: str
    multicast: bool | None = None


@dataclass
class CycloneSettings:
    """What rtps reads of Cyclone's configuration.

    Attributes:
        interfaces: The interfaces that it names; empty: not configured.
        peers: Peers, each an address or name, with or without a port.
        multicast: Whether participants announce themselves by multicast; None: not configured.
        index: The participant index: a number, ``"auto"``, ``"none"`` or None (not configured).
        max_index: The highest index that is looked for at peers; None: not configured.
        ipv6: Whether UDP over IPv6 replaces IPv4; None: not configured.
        max_message: The most octets of a datagram; None: not configured.
        unknown: Elements and attributes that are not read.
    """

    interfaces: list[InterfaceChoice] = field(default_factory=list)
    peers: list[str] = field(default_factory=list)
    multicast: bool | None = None
    index: int | str | None = None
    max_index: int | None = None
    ipv6: bool | None = None
    max_message: int | None = None
    unknown: list[str] = field(default_factory=list)


def read_settings(uri: str, domain: int) -> CycloneSettings:
    """Read the configuration of a domain.

    Of what is configured twice, the last one counts; interfaces and peers add up.

    Args:
        uri: The value of CYCLONEDDS_URI.
        domain: The domain; elements ``Domain`` with the Id of another one are left out.

    Raises:
        MiddlewareError: A file cannot be read, the XML is not valid, or a value is none.
    """
    settings = CycloneSettings()
    for part in parts(uri):
        try:
            root = parse(text_of(part))
        except OSError as error:
            raise MiddlewareError(
                f"{NAME} names {part}, which cannot be read: {error.strerror}; unset {NAME}, or"
                " name a file that is there"
            ) from error
        except ValueError as error:
            raise MiddlewareError(
                f"{NAME} is not valid XML: {error}; unset {NAME}, or correct the XML"
            ) from error
        for element in _sections(root, domain):
            _read_section(settings, element)
    settings.unknown = list(dict.fromkeys(settings.unknown))
    return settings


def _sections(root: ElementTree.Element, domain: int) -> Iterator[ElementTree.Element]:
    """Yield the elements below ``Domain``; the elements around it may be left out."""
    for element in root:
        name = local_name(element.tag)
        if name == "cyclonedds":
            yield from _sections(element, domain)
        elif name == "domain":
            wanted = element.get("Id", element.get("id", "any")).strip().lower()
            if wanted in ("any", str(domain)):
                yield from _sections(element, domain)
        else:
            yield element


def _read_section(settings: CycloneSettings, section: ElementTree.Element) -> None:
    name = local_name(section.tag)
    if name not in ("general", "discovery"):
        settings.unknown.append(_shown(section.tag))
        return
    for element in section:
        child = local_name(element.tag)
        value = (element.text or "").strip()
        if name == "general" and child == "interfaces":
            for each in element:
                _read_interface(settings, each)
        elif name == "general" and child == "networkinterfaceaddress":
            settings.interfaces += [
                InterfaceChoice("" if one.strip().lower() == "auto" else one.strip())
                for one in value.split(",")
                if one.strip()
            ]
        elif name == "general" and child == "allowmulticast":
            # A list of spdp, asm, ssm. This middleware sends announcements alone by multicast.
            kinds = {kind.strip().lower() for kind in value.split(",")}
            settings.multicast = bool(kinds & {"spdp", "default", *_TRUE})
        elif name == "general" and child == "transport" and value.lower() in ("udp", "udp6"):
            settings.ipv6 = value.lower() == "udp6"
        elif name == "general" and child == "useipv6":
            settings.ipv6 = value.lower() in _TRUE
        elif name == "general" and child == "maxmessagesize":
            settings.max_message = _octets(_shown(element.tag), value)
        elif name == "discovery" and child == "peers":
            _read_peers(settings, element)
        elif name == "discovery" and child == "participantindex":
            settings.index = _index(_shown(element.tag), value)
        elif name == "discovery" and child == "maxautoparticipantindex":
            settings.max_index = _number(_shown(element.tag), value)
        elif value.lower() != "default":
            settings.unknown.append(_shown(element.tag))


def _read_peers(settings: CycloneSettings, element: ElementTree.Element) -> None:
    _name_attributes(settings, element, ())
    for each in element:
        if local_name(each.tag) != "peer":
            settings.unknown.append(_shown(each.tag))
            continue
        _name_attributes(settings, each, ("address",))
        for key, value in each.attrib.items():
            if local_name(key) == "address" and value.strip():
                settings.peers.append(value.strip())


def _name_attributes(
    settings: CycloneSettings, element: ElementTree.Element, read: tuple[str, ...]
) -> None:
    """Name the attributes of an element that are not read."""
    settings.unknown += [
        f"{_shown(element.tag)} {_shown(key)}"
        for key, value in element.attrib.items()
        if local_name(key) not in read and value.strip().lower() != "default"
    ]


def _read_interface(settings: CycloneSettings, element: ElementTree.Element) -> None:
    if local_name(element.tag) != "networkinterface":
        settings.unknown.append(_shown(element.tag))
        return
    _name_attributes(settings, element, ("name", "address", "multicast", "autodetermine"))
    name, multicast = "", None
    for key, value in element.attrib.items():
        attribute, text = local_name(key), value.strip()
        if attribute in ("name", "address"):
            name = text
        elif attribute == "multicast" and text.lower() != "default":
            multicast = text.lower() in _TRUE
    settings.interfaces.append(InterfaceChoice(name, multicast))


def _shown(name: str) -> str:
    return name.rpartition("}")[2]


def _index(tag: str, value: str) -> int | str | None:
    text = value.lower()
    if text == "default":
        return None
    return text if text in ("auto", "none") else _number(tag, value)


def _octets(tag: str, value: str) -> int | None:
    """Read a size as Cyclone has it: a number with a unit, such as ``1400 B`` or ``8 kB``."""
    if value.lower() == "default":
        return None
    digits = value.rstrip(ascii_letters)
    unit = value[len(digits) :].lower()
    digits = digits.strip()
    if unit not in _UNITS or not (digits.isascii() and digits.isdecimal()):
        raise MiddlewareError(f"{NAME}: {tag} {value!r} is no size; write it as 1400 B")
    return int(digits) * _UNITS[unit]


def _number(tag: str, value: str) -> int:
    if not value.isascii() or not value.isdecimal():
        raise MiddlewareError(
            f"{NAME}: {tag} {value!r} is no number; correct it, or leave {tag} out"
        )
    return int(value)
