"""Restores the clients of the state file when an agent starts (``--state``).

Objects are created again by the code that serves CREATE. Messages that a client has not
acknowledged are in the file unchanged, fragments too, and are sent again when it asks for them; the
client never sees a gap or another message in their place.

A restored DDS datawriter has no matched readers until they are discovered, and those would miss
what is written before. So it accepts no samples until as many readers have matched as before, or
for :data:`HOLD_SECONDS`; a reliable stream waits for that.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from ..context import AgentContext, ClientState, CreateClientRequest
from ..log import Log
from ..objects.endpoints import WriterEndpoint
from ..objects.kinds import key_label, object_label
from ..transports.base import ServerTransport
from .journal import Journal
from .records import SLOT_HEAD, ClientInfo, ClientRecords, DamagedRecords
from .write_cursor import WriteCursor

# How long a restored datawriter waits for the readers it had, in seconds.
HOLD_SECONDS: Final = 5.0


def read_clients(file: Journal, log: Log) -> list[ClientRecords]:
    """Return the clients whose records are complete; log the others."""
    content = file.read()
    by_serial: dict[int, dict[int, bytes]] = {}
    for serial, number, payload in content.records:
        by_serial.setdefault(serial, {})[number] = payload
    records, damaged = [], list(content.damaged)
    for slot in content.slots.values():
        _, serial, _, key = SLOT_HEAD.unpack_from(slot)
        try:
            records.append(ClientRecords.parse(slot, by_serial.get(serial, {})))
        except DamagedRecords as error:
            damaged.append(f"client {key_label(key)} is left out: {error}")
    if damaged:
        aside = file.keep_aside()
        where = f"the old file is {aside}" if aside else "the old file is overwritten"
        more = f" and {len(damaged) - 5} more" if len(damaged) > 5 else ""
        log.warning(
            "State", "open", "state file damaged",
            f"file: {file.path}, {'; '.join(damaged[:5])}{more}"
            f" ({where}; boards that are left out and do not start anew must be reset)",
        )  # fmt: skip
    if records and not content.trusted:
        log.warning(
            "State", "open", "state too old",
            f"file: {file.path}, clients: {len(records)}, the machine was switched off"
            " without the agent being stopped: boards start anew",
        )  # fmt: skip
        return []
    return records


def restore(
    records: ClientRecords, agent: AgentContext, transport: ServerTransport,
    enter: Callable[[ClientState, ClientRecords], WriteCursor | None], log: Log,
) -> WriteCursor | None:  # fmt: skip
    """Restore a client at the agent, with the address that it had.

    Args:
        records: The client as the file describes it.
        agent: The agent.
        transport: The client's transport.
        enter: Allocates a slot in the file; returns None if there is none.
        log: The agent's log, which gets the reason if the client is not restored.

    Returns:
        The client's write cursor, or None if it was not restored.
    """
    info = records.info
    assert info is not None
    client_label = f"client_key: {key_label(info.key)}"
    try:
        client_label += f", address: {transport.address(info.peer)}"
        why = _refusal(agent, transport, info)
    except Exception:  # attack: a file with invalid addresses
        why = f"{info.peer!a:.80} is not an address of its transport"
    if why:
        log.info("State", "open", "session not restored", f"{client_label}, {why}")
        return None
    info.asleep_since = 0.0
    try:
        client = _resume(records, info, agent, transport)
        cursor = enter(client, records)
        if cursor is None:
            return None
        _restore_objects(cursor, agent, log)
        cursor.resume()
    except Exception as error:  # the other clients are restored
        agent.failed(error)
        agent.delete_client(info.key)
        return None
    client.session.request_retransmit()
    agent.attend(client.session)
    log.info("State", "open", "session restored", f"{client_label}, objects: {len(client.objects)}")
    return cursor


def _refusal(agent: AgentContext, transport: ServerTransport, info: ClientInfo) -> str:
    """Return why the client may not be restored; "" if it may."""
    admission = agent.admission
    if not admission.admits(info.key, transport.host_of(info.peer)):
        return "it is not admitted any more (see --allow-key, --allow-net)"
    if len(agent.clients) >= admission.max_clients:
        return f"over {admission.max_clients} clients (see --max-clients)"
    return ""


def _resume(
    records: ClientRecords, info: ClientInfo, agent: AgentContext, transport: ServerTransport
) -> ClientState:
    """Restore the session with the state of its streams."""
    request = CreateClientRequest(info.session_id, info.mtu, info.properties)
    client = agent.resume(info.key, transport, info.peer, request)
    client.session.resume(
        {
            stream_id: (stream.next, stream.fragments, stream.skip)
            for stream_id, stream in records.incoming.items()
        },
        {
            stream_id: (stream.acked, stream.sent, stream.next, stream.held)
            for stream_id, stream in records.outgoing.items()
        },
        records.best_effort,
        agent.now(),
    )
    return client


def _restore_objects(cursor: WriteCursor, agent: AgentContext, log: Log) -> None:
    """Restore the objects, the last samples of datawriters, and active READ_DATA."""
    client, records = cursor.client, cursor.records
    for object_id, representation in list(records.objects.items()):
        try:
            client.recreate(object_id, *representation)
        except Exception as error:
            records.deleted(object_id)
            log.warning(
                "State", "open", "object not restored",
                f"client_key: {key_label(client.key)}, object_id: {object_label(object_id)},"
                f" {error}",
            )  # fmt: skip
    monotonic = agent.clock.monotonic
    cursor.hold_until = monotonic() + HOLD_SECONDS
    for object_id, obj in list(client.objects.items()):
        endpoint = obj.endpoint
        if not isinstance(endpoint, WriterEndpoint):
            continue
        latched = records.latched.get(object_id)
        if latched:
            endpoint.republish(latched)
        cursor.watch_samples(obj, agent.attend)
        readers = records.matched.get(object_id, 0)
        if readers:
            endpoint.set_gate(_open_with(readers, cursor.hold_until, monotonic))
    for object_id, reading in list(records.reads.items()):
        if client.read(object_id, *reading):
            cursor.note_limits(object_id, reading)
        else:
            del records.reads[object_id]


def _open_with(readers: int, until: float, monotonic: Callable[[], float]) -> Callable[[int], bool]:
    """Return a gate that opens when so many readers have matched, or at ``until``."""
    return lambda matched: matched >= readers or monotonic() >= until
