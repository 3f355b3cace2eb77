"""XML from outside: representations of every kind, as clients send them, and files of references.

The first byte chooses the use of the document: a CREATE of a kind, or a file.
"""

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from random import Random

from uros.agent.objects import representation
from uros.agent.objects.kinds import KIND_NAMES
from uros.agent.objects.representation import ApplicationSpec, EndpointSpec, UnknownReference
from uros.agent.objects.xml_profiles import MAX_XML, ProfileError, References
from uros.wire import entities, ids
from uros.wire.cdr import Writer
from uros.wire.errors import DecodeError

from . import records
from .datagrams import key_of
from .world import World, built, create_client, must, submessage

KINDS = tuple(KIND_NAMES)
_FILE = 0x80  # in the first byte: a file of references
_folder: list[tempfile.TemporaryDirectory[str]] = []


def scratch() -> Path:
    """A file for inputs, removed at the end of the process."""
    if not _folder:
        _folder.append(tempfile.TemporaryDirectory(prefix="uros-fuzz-"))
    return Path(_folder[0].name, f"input-{os.getpid()}")


def _spec_is_sane(spec: object) -> None:
    if isinstance(spec, EndpointSpec):
        qos = spec.qos
        must(0 <= qos.depth <= 0x7FFFFFFF, f"a depth of {qos.depth}")
        must(len(qos.user_data) <= MAX_XML, "user data")
    if isinstance(spec, ApplicationSpec):
        must(len(spec.items) <= 1024, "items")
        for at, item in enumerate(spec.items):
            must(item.kind == ids.KIND_PARTICIPANT or item.parent < at, "a parent that comes after")


def _parse(kind: int, content: str, references: References) -> None:
    try:
        spec = representation.parse(kind, ids.AS_XML, content, 0x11, True, references)
    except (ProfileError, DecodeError, UnknownReference) as error:
        must(0 < len(str(error)) < 2 * MAX_XML, "a text for people")
        return
    _spec_is_sane(spec)


def one_input(data: bytes) -> None:
    references = References()
    use, text = data[0] if data else 0, data[1:]
    if use & _FILE:
        path = scratch()
        path.write_bytes(text)
        try:
            count = references.load(path)
        except ProfileError as error:
            must(str(path) in str(error), "the file is not named")
            return
        must(count > 0, "a file without profiles is taken")
        for (tag, name), profile in references._profiles.items():
            for kind, known in representation._TAGS.items():
                if known == tag:
                    try:
                        _spec_is_sane(
                            representation.parse(
                                kind, ids.BY_REFERENCE, name, 0x11, True, references
                            )
                        )
                    except (ProfileError, DecodeError, UnknownReference):
                        pass
            must(profile is not None, "a profile that is none")
        return
    content = text.decode("utf-8", "replace").replace("\0", " ")
    kind = KINDS[use % len(KINDS)]
    _parse(kind, content, references)
    if len(text) <= 0xF000:
        _create(kind, content.encode()[:0xF000].decode("utf-8", "ignore"))


def _create(kind: int, content: str) -> None:
    """CREATE with the document at an agent, under a participant, a publisher or a subscriber."""
    world = World()
    key = key_of(1)
    world.receive(1, create_client(key, 0x81))
    parents = b"".join(
        submessage(
            ids.CREATE, built(entities.push_create, 1, object_id, ids.IN_BINARY, body, parent)
        )
        for object_id, body, parent in (
            (0x011, built(entities.push_binary_participant, "n", None), 0),
            (0x012, built(entities.push_binary_topic, "rt/a", "T"), 0x011),
            (0x013, built(entities.push_binary_group, None, None), 0x011),
            (0x014, built(entities.push_binary_group, None, None), 0x011),
        )
    )
    world.receive(1, b"\x81\x80\0\0" + parents)
    parent = {ids.KIND_DATAWRITER: 0x013, ids.KIND_DATAREADER: 0x014}.get(kind, 0x011)
    payload = bytearray(len(content.encode()) + 64)
    w = Writer(payload)
    entities.push_create(w, 2, 0x100 | kind, ids.AS_XML, content, parent)
    body = submessage(ids.CREATE, bytes(payload[: w.offset]))
    if len(body) > 0xFFF0:
        return
    answers = world.receive(1, b"\x81\x80\1\0" + body)
    must(any(answer[4] == ids.STATUS for _, answer in answers), "a CREATE without an answer")
    world.check()
    world.close()


def seeds() -> Iterator[tuple[str, bytes]]:
    from unit.agent import helpers as h

    for name, text in (("types", h.TYPES_XML), ("qos", h.QOS_XML), ("app", h.APPLICATION_XML)):
        kind = {"types": ids.KIND_TYPE, "qos": ids.KIND_QOS_PROFILE, "app": ids.KIND_APPLICATION}
        yield name, bytes((KINDS.index(kind[name]),)) + text.encode()
        yield name + "_file", bytes((_FILE,)) + text.encode()
    yield "refs", bytes((_FILE,)) + h.REFS.encode()
    yield "writer", bytes((KINDS.index(ids.KIND_DATAWRITER),)) + _WRITER.encode()
    yield (
        "reader",
        bytes((KINDS.index(ids.KIND_DATAREADER),))
        + _WRITER.replace("data_writer", "data_reader").encode(),
    )
    yield "participant", bytes((KINDS.index(ids.KIND_PARTICIPANT),)) + _PARTICIPANT.encode()
    yield "glued", bytes((KINDS.index(ids.KIND_REQUESTER),)) + _GLUED.encode()
    yield "publisher", bytes((KINDS.index(ids.KIND_PUBLISHER),)) + _PUBLISHER.encode()


_WRITER = """<dds><data_writer><topic><kind>NO_KEY</kind><name>rt/a</name><dataType>T</dataType>
<historyQos><kind>KEEP_LAST</kind><depth>5</depth></historyQos></topic>
<qos><reliability><kind>RELIABLE</kind></reliability><durability><kind>TRANSIENT_LOCAL</kind>
</durability><deadline><period><sec>1</sec><nanosec>500000000</nanosec></period></deadline>
<lifespan><duration>DURATION_INFINITY</duration></lifespan>
<liveliness><kind>AUTOMATIC</kind><lease_duration><sec>3</sec></lease_duration></liveliness>
<ownership><kind>EXCLUSIVE</kind></ownership><ownershipStrength><value>3</value></ownershipStrength>
<partition><names><name>a</name></names></partition><userData><value>1f.2a</value></userData>
</qos></data_writer></dds>"""
_PARTICIPANT = """<dds><profiles><transport_descriptors><transport_descriptor>
<transport_id>udp_localhost</transport_id><type>UDPv4</type><interfaceWhiteList>
<address>127.0.0.1</address></interfaceWhiteList></transport_descriptor></transport_descriptors>
</profiles><participant><rtps><name>px4</name><useBuiltinTransports>false</useBuiltinTransports>
<userTransports><transport_id>udp_localhost</transport_id></userTransports></rtps></participant>
</dds>"""
_GLUED = (
    '<dds><requester profile_name="p"service_name="s"request_type="A"reply_type="B">'
    "<request_topic_name>rq/sRequest</request_topic_name></requester></dds>"
)
_PUBLISHER = (
    "<dds><publisher><publisher_qos><partition><name><element>a</element></name></partition>"
    "</publisher_qos></publisher></dds>"
)

_WORDS = (
    b"<qos>", b"</qos>", b"<![CDATA[", b"]]>", b"<!DOCTYPE a [", b"&lt;", b"&#0;", b"&#x41;",
    b"<!ENTITY", b'xmlns:a="b"', b"<?xml version='1.0' encoding='utf-16'?>", b"INFINITE",
    b"4294967296", b"-1", b"99999999999999999999", b"object_id=", b"<depth>", b"</depth>",
    b"base_name=", b"<a>" * 40, b"\xef\xbb\xbf", b"\xff", b"<!--", b"-->",
)  # fmt: skip
_good: list[bytes] = []


def mutate(data: bytes, random: Random, mutate_bytes: records.MutateBytes) -> bytes:
    """Move, duplicate and delete elements; change texts and attributes; insert words."""
    head, text = data[:1] or b"\0", data[1:]
    what = random.random()
    if what < 0.1:
        return bytes((random.randrange(256),)) + text
    if what < 0.4:
        return head + mutate_bytes(text)
    if what < 0.55:
        at = random.randrange(len(text) + 1)
        return head + text[:at] + random.choice(_WORDS) + text[at:]
    parts = [b"<" + part for part in text.split(b"<")] if text else []
    if len(parts) < 3 or what < 0.6:
        if not _good:
            _good.extend(
                document.encode() for document in (_WRITER, _PARTICIPANT, _GLUED, _PUBLISHER)
            )
        return head + random.choice(_good)
    at = random.randrange(1, len(parts))
    if what < 0.7:
        del parts[at]
    elif what < 0.8:
        parts.insert(at, parts[random.randrange(1, len(parts))])
    elif what < 0.9:
        parts[at] = mutate_bytes(parts[at])
    else:
        start, stop = sorted((at, random.randrange(1, len(parts))))
        parts[at:at] = parts[start : stop + 1]
    return head + b"".join(parts)[1:]
