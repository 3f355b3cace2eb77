"""The file of ``--state``: an agent that starts with any file restores the valid part, reports the
damaged part, and serves.

With 0x01 in the first byte, the rest of the input is the file. Else the input is records of which
the file is composed; the operation is the kind:

====  ====================================================================
0     a record of the journal: its number and its payload
1     a record of the journal with the next number: its payload
2     bytes of the journal, unchanged
3     a slot: streams after its head, for the records before it
4     a slot, unchanged but sealed
5     the first line of the file after its version
====  ====================================================================

With 0x02 the boot id is that of the machine, so the agent may trust the file.
"""

import json
import os
import time
import zlib
from collections.abc import Iterator
from random import Random
from types import SimpleNamespace

from uros.agent.persistence import records as keeping
from uros.agent.persistence.journal import (
    SLOT_SIZE,
    SLOTS,
    JournalError,
    open_journal,
    record,
    seal,
)
from uros.agent.persistence.records import SLOT_HEAD, ClientInfo, ClientRecords, Incoming, Outgoing
from uros.agent.persistence.session_store import SessionStore
from uros.wire import entities, ids

from . import records
from .datagrams import RELIABLE, captured, key_of
from .world import WITNESS_KEY, World, built, message, must, submessage
from .xml import scratch

OPS = tuple(range(6))
_SLOTS_AT = 4096
_JOURNAL_AT = _SLOTS_AT + SLOTS * SLOT_SIZE


def _boot() -> str:
    try:
        with open("/proc/sys/kernel/random/boot_id", encoding="ascii") as file:
            return file.read(64).strip()
    except OSError:
        return ""


def _head(line: bytes) -> bytes:
    text = b"uros state 1\n" + line + b"\n%08x\n" % zlib.crc32(line)
    return text[: _SLOTS_AT - 1].ljust(_SLOTS_AT - 1) + b"\n"


def compose(data: bytes) -> dict[int, bytes]:
    """The parts of the file by their offsets."""
    options = data[0] if data else 0
    if options & 1:
        return {0: data[1:]}
    line = json.dumps({"boot": _boot() if options & 2 else "", "clean": bool(options & 4)})
    parts = {0: _head(line.encode())}
    journal = bytearray()
    serial, number, slots = 1, 0, 0
    key = 0
    for op, body in records.unpack(data[1:]):
        kind = op % 6
        if kind in (0, 1):
            if kind == 0 and body:
                number, body = body[0], body[1:]
            else:
                number += 1
            journal += record(serial, number, body)
            if body[:1] == b"C":
                try:
                    key = int(json.loads(body[1:])["key"]) & 0xFFFFFFFF
                except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
                    key = 0
        elif kind == 2:
            journal += body
        elif kind in (3, 4):
            slot = bytearray(SLOT_SIZE)
            if kind == 3:
                SLOT_HEAD.pack_into(slot, 0, 0, serial, number, key)
                slot[SLOT_HEAD.size :] = body[: SLOT_SIZE - SLOT_HEAD.size].ljust(
                    SLOT_SIZE - SLOT_HEAD.size, b"\0"
                )
                serial, number = serial + 1, 0
            else:
                slot[4:] = body[: SLOT_SIZE - 4].ljust(SLOT_SIZE - 4, b"\0")
            seal(slot)
            parts[_SLOTS_AT + slots * SLOT_SIZE] = bytes(slot)
            slots += 1
        else:
            parts[0] = _head(body)
    parts[_JOURNAL_AT] = bytes(journal)
    return parts


def one_input(data: bytes) -> None:
    path = scratch().with_name(f"state-{os.getpid()}")
    with open(path, "wb") as file:
        for at, part in compose(data).items():
            file.seek(at)
            file.write(part)
    try:
        _start(str(path))
    finally:
        for name in (path, *path.parent.glob(path.name + ".*")):
            name.unlink(missing_ok=True)


def _start(path: str) -> None:
    try:
        file = open_journal(path)
    except JournalError as error:
        must(path in str(error), "the file is not named")
        return
    world = World()
    store = SessionStore(file, world.agent.log)
    server = SimpleNamespace(
        agent=world.agent, transports=[world.place], wake_at=world.wake_at, now=world.now
    )
    world.place.lasting = True
    try:
        store.open(server)  # type: ignore[arg-type]
        _go_on(world)
    finally:
        store.close()
    # The file that it has written is valid.
    again = open_journal(path)
    content = again.read()
    must(not content.damaged, f"its own file is damaged: {content.damaged}")
    by_serial: dict[int, dict[int, bytes]] = {}
    for serial, number, payload in content.records:
        by_serial.setdefault(serial, {})[number] = payload
    for slot in content.slots.values():
        _, serial, _, _ = SLOT_HEAD.unpack_from(slot)
        ClientRecords.parse(slot, by_serial.get(serial, {}))
    again.close(True)
    if WITNESS_KEY not in world.agent.clients:
        world.tampered = True  # the file has another client with this key
    world.close()


def _go_on(world: World) -> None:
    """Restored clients publish and receive; time advances."""
    world.settle()
    world.witness()
    world.check()
    for session in [client.session for client in list(world.agent.clients.values())]:
        place = world.agent._places.get(session.key)
        if place is None or session.key == WITNESS_KEY:
            continue
        number = (session.last_received(0x80) + 1) & 0xFFFF
        write = submessage(ids.WRITE_DATA, b"\0\1\0\x15\7\0\0\0")
        world.receive(place[1], message(session.session_id, 0x80, number, session.key, write))
    world.publish(0, b"\5\0\0\0")
    world.step(1500)
    world.check()


# --- valid inputs ---------------------------------------------------------------------


def _client_records(number: int) -> ClientRecords:
    """Records of a client with a datawriter and a datareader, with messages in flight."""
    info = ClientInfo(key_of(number), 0x81, 512, "FuzzAgent ", number, [("uxr_hl", "500")])
    client_records = ClientRecords(info)
    for object_id, kind, content, parent in (
        (0x011, 1, built(entities.push_binary_participant, "kept", None), 0),
        (0x012, 2, built(entities.push_binary_topic, "rt/chatter", "T"), 0x011),
        (0x013, 3, built(entities.push_binary_group, None, None), 0x011),
        (0x014, 4, built(entities.push_binary_group, None, None), 0x011),
        (0x015, 5, built(entities.push_binary_endpoint, 0x012, ids.QOS_RELIABLE, 5), 0x013),
    ):
        client_records.objects[object_id] = ids.IN_BINARY, content, kind, parent, True
    client_records.matched[0x015] = 1
    client_records.latched[0x015] = b"\0\1\0\0\1\0\0\0"
    client_records.reads[0x016] = 7, 0x80, (5, 10, 100, 0)
    client_records.best_effort[1] = 5
    client_records.outgoing[0x80] = Outgoing(3, 4, 5, {3: b"\x81\x80\3\0", 4: b"\x81\x80\4\0"})
    client_records.incoming[0x80] = Incoming(9, bytearray(b"half a message"), False)
    return client_records


def _records(client_records: ClientRecords) -> list[records.Record]:
    slot, journal, _ = client_records.encode(1)
    from uros.agent.persistence.journal import records_in

    steps: list[records.Record] = [(1, payload) for _, _, payload in records_in(bytes(journal))]
    return [*steps, (3, bytes(slot[SLOT_HEAD.size :]))]


def seeds() -> Iterator[tuple[str, bytes]]:
    bare = ClientRecords(ClientInfo(key_of(2), 0x81, 256, "FuzzAgent ", 2))
    where = "SerialAgent /dev/ttyUSB0"
    asleep = ClientRecords(ClientInfo(key_of(3), 0x81, 256, where, 1, [], time.time()))
    yield "one", b"\x06" + records.pack(_records(_client_records(1)))
    yield (
        "several",
        b"\x02" + records.pack([*_records(_client_records(1)), *_records(bare), *_records(asleep)]),
    )
    yield "old", b"\0" + records.pack(_records(bare))
    yield "bytes", b"\x01uros state 1\n{}\n00000000\n"
    yield "other", b"\x01\x7fELF"


_material: list[records.Record] = []


def mutate(data: bytes, random: Random, mutate_bytes: records.MutateBytes) -> bytes:
    if not _material:
        for number in (1, 2):
            _material.extend(_records(_client_records(number)))
        _material.extend([(1, b"Z"), (1, keeping.id_payload(b"D", 0x015)), (2, b"\xf5uR1")])
        _material.append((1, keeping.number_payload(b"N", 0x80, 7)))
        _material.append((5, b'{"clean": true}'))
        for _, messages in captured():
            for op, datagram in messages:
                if datagram[1] >= 0x80 and op >> 2 in (0, RELIABLE):
                    _material.append((1, keeping.number_payload(b"T", 0x80, 1, datagram)))
                    break

    def change(op: int, body: bytes) -> bytes:
        if op % 6 in (0, 1) and b"{" in body[:2] and random.random() < 0.6:
            # The record stays JSON, with one other value.
            at = random.randrange(len(body))
            word = random.choice((b"0", b"-1", b"null", b"[]", b"1e9", b'"x"', b"true", b"9" * 20))
            return body[:at] + word + body[at + 1 :]
        return body[:1] + mutate_bytes(body[1:]) if random.random() < 0.7 else mutate_bytes(body)

    head = data[:1] or b"\x02"
    if random.random() < 0.05:
        head = bytes((random.choice((0, 1, 2, 2, 4, 6)),))
    if head[0] & 1:
        return head + mutate_bytes(data[1:])
    return head + records.mutate(data[1:], random, OPS, _material, change)
