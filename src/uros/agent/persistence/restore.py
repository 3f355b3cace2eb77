"""``--state``: what the file has of clients is brought back when an agent starts.

Each is made again by the code that serves CREATE. Messages to a client that it has not
acknowledged are in the file as they were, fragments too, and are sent again when it asks; it never
sees a gap or another message in their place.

A restored DDS writer has no readers until they are discovered, and who was there would miss what
is written before. So it has "no room" until as many have matched as there were, or for
``HOLD_SECONDS``; a reliable stream waits for that.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from ..context import AgentContext, ClientState, CreateClientRequest
from ..log import Log
from ..objects.endpoints import WriterEndpoint
from ..objects.kinds import key_label, object_label
from ..transports.base import ServerTransport
from .journal import StateFile
from .records import SLOT_HEAD, About, Kept, Unsound
from .write_cursor import Entry

# How long a restored writer waits for the readers it had.
HOLD_SECONDS: Final = 5.0


def sound_clients(file: StateFile, log: Log) -> list[Kept]:
    """Those of whom nothing is missing in the file; the log tells about the others."""
    content = file.read()
    by_serial: dict[int, dict[int, bytes]] = {}
    for serial, number, payload in content.records:
        by_serial.setdefault(serial, {})[number] = payload
    kept, damaged = [], list(content.damaged)
    for slot in content.slots.values():
        _, serial, _, key = SLOT_HEAD.unpack_from(slot)
        try:
            kept.append(Kept.of(slot, by_serial.get(serial, {})))
        except Unsound as error:
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
    if kept and not content.trusted:
        log.warning(
            "State", "open", "state too old",
            f"file: {file.path}, clients: {len(kept)}, the machine was switched off"
            " without the agent being stopped: boards start anew",
        )  # fmt: skip
        return []
    return kept


def restore(
    kept: Kept, agent: AgentContext, transport: ServerTransport,
    enter: Callable[[ClientState, Kept], Entry | None], log: Log,
) -> Entry | None:  # fmt: skip
    """The client goes on at the agent, where it talked from before. ``enter`` finds it a place in
    the file. None: it stays away, and the log tells why.
    """
    about = kept.about
    assert about is not None
    who = f"client_key: {key_label(about.key)}"
    try:
        who += f", address: {transport.address(about.peer)}"
        why = _refusal(agent, transport, about)
    except Exception:  # attack: a file whose addresses are none
        why = f"{about.peer!a:.80} is no address of its transport"
    if why:
        log.info("State", "open", "session not restored", f"{who}, {why}")
        return None
    about.asleep_since = 0.0
    try:
        client = _resume(kept, about, agent, transport)
        entry = enter(client, kept)
        if entry is None:
            return None
        _make_objects(entry, agent, log)
        entry.resume()
    except Exception as error:  # the others come back
        agent.failed(error)
        agent.delete_client(about.key)
        return None
    client.session.nudge()
    agent.attend(client.session)
    log.info("State", "open", "session restored", f"{who}, objects: {len(client.objects)}")
    return entry


def _refusal(agent: AgentContext, transport: ServerTransport, about: About) -> str:
    """Why the client may not come back; "": it may."""
    admission = agent.admission
    if not admission.admits(about.key, transport.host_of(about.peer)):
        return "it may not come in any more (see --allow-key, --allow-net)"
    if len(agent.clients) >= admission.max_clients:
        return f"over {admission.max_clients} clients (see --max-clients)"
    return ""


def _resume(
    kept: Kept, about: About, agent: AgentContext, transport: ServerTransport
) -> ClientState:
    """Its session, with the streams as far as they were."""
    request = CreateClientRequest(about.session_id, about.mtu, about.properties)
    client = agent.resume(about.key, transport, about.peer, request)
    client.session.resume(
        {number: (it.next, it.fragments, it.skip) for number, it in kept.incoming.items()},
        {number: (it.acked, it.sent, it.next, it.held) for number, it in kept.outgoing.items()},
        kept.best_effort,
        agent.now(),
    )
    return client


def _make_objects(entry: Entry, agent: AgentContext, log: Log) -> None:
    """Its objects, the last samples of its writers, and what it wants to read."""
    client, kept = entry.client, entry.kept
    for object_id, what in list(kept.objects.items()):
        try:
            client.recreate(object_id, *what)
        except Exception as error:
            kept.deleted(object_id)
            log.warning(
                "State", "open", "object not restored",
                f"client_key: {key_label(client.key)}, object_id: {object_label(object_id)},"
                f" {error}",
            )  # fmt: skip
    monotonic = agent.clock.monotonic
    entry.hold_until = monotonic() + HOLD_SECONDS
    for object_id, thing in list(client.objects.items()):
        endpoint = thing.endpoint
        if not isinstance(endpoint, WriterEndpoint):
            continue
        latched = kept.latched.get(object_id)
        if latched:
            endpoint.republish(latched)
        entry.watch_samples(thing, agent.attend)
        readers = kept.matched.get(object_id, 0)
        if readers:
            endpoint.set_gate(_open_with(readers, entry.hold_until, monotonic))
    for object_id, reading in list(kept.reads.items()):
        if client.read(object_id, *reading):
            entry.note_limits(object_id, reading)
        else:
            del kept.reads[object_id]


def _open_with(
    readers: int, until: float, monotonic: Callable[[], float]
) -> Callable[[int], bool]:
    """A gate that opens when so many readers have matched, or at ``until``."""
    return lambda matched: matched >= readers or monotonic() >= until
