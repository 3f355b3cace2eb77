"""The session store (``--state``): sessions that survive a restart of the agent.

A client that never checks whether its agent was restarted must be able to continue its session. So
everything that an acknowledgement or an answer confirms is in the state file before that message is
sent. After each burst the server calls :meth:`SessionStore.keep` for the sessions that changed,
between the middleware's flush and sending. Objects and messages of a client go into the journal,
the state of its streams into its slot (:mod:`.journal`, :mod:`.records`).

When an agent starts with the file, its clients are restored (:mod:`.restore`); those whose
transport the agent does not have stay in the file, asleep.

The agent continues whatever happens to the file. A slot shows which records could not be written,
so that such a client creates a new session after a restart instead of one with wrong sequence
numbers.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import Any, Final

from ...wire.streams import ReliableOut
from ..context import ClientState, ServerContext
from ..log import Log
from ..objects.endpoints import WriterEndpoint
from ..objects.kinds import key_label
from ..objects.object_table import XrceObject
from ..session.session import Session
from ..transports.base import ServerTransport
from .journal import SLOT_SIZE, SLOTS, Journal, record, seal
from .records import (
    SLOT_HEAD,
    SLOT_IN,
    SLOT_OUT,
    ClientInfo,
    ClientRecords,
    Reading,
    Representation,
    can_be_kept,
    fragments_payload,
    id_payload,
    latched_payload,
    matched_payload,
    number_payload,
    object_payload,
    reading_payload,
)
from .restore import read_clients, restore
from .write_cursor import InboundCursor, OutboundCursor, WriteCursor

# How long a client whose transport the agent does not have stays in the file, in seconds.
ASLEEP_SECONDS: Final = 86_400.0
# A journal of over this many bytes, and over twice its size when it was last rewritten, is
# rewritten.
JOURNAL_SIZE: Final = 4 * 1024 * 1024
TICK_SECONDS: Final = 1.0
# Ticks at which a restored client is asked to retransmit, as the first request may be lost.
RETRANSMIT_REQUESTS: Final = 5
# Every so many ticks it is checked whether the file was removed and whether it can be written
# again.
_LOOK: Final = 10
# Datawriters whose readers are counted at a tick; a count takes 2 µs.
_COUNTED: Final = 1000
# Sequence numbers of a best-effort stream that are reserved at a time: a client accepts any gap.
_RESERVE: Final = 1024


class SessionStore:
    """Writes all sessions of an agent to a state file; an attachment of the server.

    Args:
        journal: The open state file.
        log: The agent's log.
    """

    def __init__(self, journal: Journal, log: Log) -> None:
        self._journal = journal
        self._log = log
        self._server: ServerContext | None = None
        self._cursors: dict[int, WriteCursor] = {}
        self._asleep: dict[int, tuple[int, ClientRecords]] = {}  # by key; and the slot
        self._free = deque(range(SLOTS))
        self._serial = 0
        self._pending = bytearray()  # encoded records that are not written yet
        self._changed: list[WriteCursor] = []
        self._limit = JOURNAL_SIZE
        self._failing = False
        self._restoring = False
        self._ticks = 0
        self._retransmits: dict[int, int] = {}  # by key: requests left
        self._turns: deque[int] = deque()  # keys whose datawriters' readers are to be counted

    # --- from start to end ----------------------------------------------------------

    def open(self, server: ServerContext) -> None:
        """Restore the clients of the file."""
        self._server = server
        records = read_clients(self._journal, self._log)
        server.agent.session_store = self
        self._restoring = True
        for each in records:
            self._restore(each)
        self._restoring = False
        if not self._rewrite(sync=True):
            self._fail(lost=True)  # its content will soon be outdated
        server.wake_at(TICK_SECONDS, self._tick)

    def close(self) -> None:
        """Write the current state and close the file."""
        if self._server is None:
            self._journal.close(False)
            return
        agent, self._server = self._server.agent, None
        try:
            self.keep(list(agent.attended))
        finally:  # before the clients are deleted, which must stay in the file
            agent.session_store = None
            self._journal.close(not self._failing)

    def trouble(self) -> str:
        """Return why sessions are not kept now; "" if they are."""
        if not self._failing:
            return ""
        return f"sessions are not kept in {self._journal.path}: {self._journal.error}"

    # --- restored and sleeping clients ------------------------------------------------

    def _restore(self, records: ClientRecords) -> None:
        info = records.info
        assert info is not None and self._server is not None
        named = (each for each in self._server.transports if _name(each) == info.transport)
        transport = next(named, None)
        if transport is None:
            self._fall_asleep(records)
            return
        cursor = restore(records, self._server.agent, transport, self._enter, self._log)
        if cursor is not None:
            self._retransmits[info.key] = RETRANSMIT_REQUESTS

    def _fall_asleep(self, records: ClientRecords) -> None:
        info = records.info
        assert info is not None
        info.asleep_since = info.asleep_since or self._unix_time()
        if info.key in self._asleep or not self._free or self._too_old(info):
            return
        self._asleep[info.key] = self._free.popleft(), records
        self._log.info(
            "State", "open", "session kept asleep",
            f"client_key: {key_label(info.key)}, this agent has no {info.transport}",
        )  # fmt: skip

    def _too_old(self, info: ClientInfo) -> bool:
        return abs(self._unix_time() - info.asleep_since) > ASLEEP_SECONDS

    def _unix_time(self) -> float:
        assert self._server is not None
        return self._server.agent.clock.time_ns() / 1e9

    # --- events of the agent ----------------------------------------------------------

    def placed(
        self, client: ClientState, transport: ServerTransport, peer: Any,
        properties: list[tuple[str, str]] | None,
    ) -> None:  # fmt: skip
        """Record a client that is new, was reset or has another address.

        It is in the file when this returns.

        Args:
            client: The client.
            transport: Its transport.
            peer: Its address there.
            properties: Those of its CREATE_CLIENT; None if there was none.
        """
        if self._restoring:
            return
        key, session = client.key, client.session
        cursor = self._cursors.get(key)
        if cursor is not None and cursor.client is not client:
            self.forget(key)
            cursor = None
        self._drop_asleep(key)
        if not transport.lasting or not can_be_kept(peer):
            self.forget(key)  # its session ends with its connection
            self._commit()
            return
        if properties is None:
            info_before = cursor.records.info if cursor is not None else None
            properties = info_before.properties if info_before is not None else []
        info = ClientInfo(key, session.session_id, session.mtu, _name(transport), peer, properties)
        if cursor is None:
            cursor = self._enter(client, ClientRecords())
            if cursor is None:
                return
        cursor.records.info = info
        self._add(cursor, info.payload())
        self._renew(cursor)
        # The state of the client's streams is not written here: a message counts as received only
        # when its samples have been passed on.
        self._seal(cursor)
        self._commit()

    def _enter(self, client: ClientState, records: ClientRecords) -> WriteCursor | None:
        if not self._free and self._asleep:
            self._drop_asleep(next(iter(self._asleep)))
        if not self._free:
            return None  # cannot happen: the agent admits no more clients than there are slots
        self._serial += 1
        cursor = WriteCursor(client, records, self._serial, self._free.popleft())
        self._cursors[client.key] = cursor
        return cursor

    def _drop_asleep(self, key: int) -> None:
        """Remove a sleeping client from the file."""
        index, _ = self._asleep.pop(key, (-1, None))
        if index >= 0:
            self._free.append(index)
            self._journal.write_slot(index, bytes(SLOT_SIZE))

    def forget(self, key: int) -> None:
        """Remove a client that was deleted."""
        cursor = self._cursors.pop(key, None)
        if cursor is None:
            return
        cursor.slot[:] = bytes(SLOT_SIZE)
        cursor.index, index = -1, cursor.index
        if not self._journal.write_slot(index, cursor.slot):
            self._fail(lost=True)
        self._free.append(index)

    def created(self, client: ClientState, obj: XrceObject, representation: Representation) -> None:
        """Record an object that was created by this representation."""
        cursor = self._cursor(client)
        if cursor is not None:
            assert self._server is not None
            cursor.records.objects[obj.object_id] = representation
            self._add(cursor, object_payload(obj.object_id, representation))
            for each in (obj, *obj.parts):
                cursor.watch_samples(each, self._server.agent.attend)

    def deleted(self, client: ClientState, object_id: int) -> None:
        """Record that an object, or a part of one, was deleted."""
        cursor = self._cursor(client)
        if cursor is not None and object_id in cursor.records.objects:
            self._add(cursor, id_payload(b"D", object_id))
        if cursor is not None:
            cursor.records.deleted(object_id)

    def reading(self, client: ClientState, object_id: int, reading: Reading | None) -> None:
        """Record a READ_DATA of an object; None: its end."""
        cursor = self._cursor(client)
        if cursor is None:
            return
        cursor.limited.discard(object_id)
        if reading is None:
            if cursor.records.reads.pop(object_id, None) is not None:
                self._add(cursor, id_payload(b"E", object_id))
            return
        cursor.records.reads[object_id] = reading
        self._add(cursor, reading_payload(object_id, reading))
        cursor.note_limits(object_id, reading)

    def _cursor(self, client: ClientState) -> WriteCursor | None:
        cursor = self._cursors.get(client.key) if not self._restoring else None
        return cursor if cursor is not None and cursor.client is client else None

    # --- writing ------------------------------------------------------------------------

    def keep(self, sessions: Iterable[Session]) -> None:
        """Write the state that these sessions are about to acknowledge or send."""
        cursors = self._cursors
        for session in sessions:
            cursor = cursors.get(session.key)
            if cursor is not None and cursor.client.session is session:
                self._collect(cursor, session)
        if self._changed or self._pending:
            self._commit()
            size = self._journal.journal_size
            if size > self._limit and not self._failing and not self._rewrite():
                self._limit = size + JOURNAL_SIZE  # the old file stays valid

    def _add(self, cursor: WriteCursor, payload: bytes) -> None:
        cursor.count += 1
        cursor.changed = True
        if not self._failing:
            self._pending += record(cursor.serial, cursor.count, payload)

    def _collect(self, cursor: WriteCursor, session: Session) -> None:
        incoming, outgoing, best_effort = session.streams()
        if incoming is not cursor.incoming:
            self._renew(cursor)
        slot = cursor.slot
        changed = cursor.changed
        for stream_id, stream in incoming.items():
            inbound = cursor.inbound_cursors.get(stream_id) or cursor.inbound(stream_id)
            number = stream.stream.next
            if stream.stalled:
                # A stalled message is not acknowledged, and the client retransmits it as a whole:
                # the number written is that of the message before. Fragments are written only
                # once, however long the message stays stalled.
                if not inbound.is_whole(stream.fragments):
                    continue
                number = (number - 1) & 0xFFFF
            if number != inbound.next:
                inbound.next = number
                whole, skip = stream.fragments.export()
                if whole or inbound.pending or skip or inbound.skip:
                    self._keep_fragments(cursor, stream_id, inbound)
                inbound.whole = whole
                SLOT_IN.pack_into(
                    slot, inbound.at, stream_id, 1 | inbound.skip << 1, number, inbound.pending
                )
                changed = True
        for stream_id, out in outgoing.items():
            outbound = cursor.outbound_cursors.get(stream_id) or cursor.outbound(stream_id)
            if out.next != outbound.next or out.sent != outbound.sent:
                if out.next != outbound.next:
                    self._keep_messages(cursor, stream_id, out, outbound)
                outbound.sent = out.sent
                SLOT_OUT.pack_into(slot, outbound.at, stream_id, 1, out.acked, out.sent)
                changed = True
        if best_effort:
            self._reserve(cursor, best_effort)
        if cursor.limited:
            self._keep_limits(cursor)
        while cursor.news:
            object_id = cursor.news.pop()
            if object_id in cursor.records.latched:
                self._add(cursor, latched_payload(object_id, cursor.records.latched[object_id]))
        if changed or cursor.changed:
            self._seal(cursor)

    def _renew(self, cursor: WriteCursor) -> None:
        """Record that the session's streams were reset, if they were."""
        if cursor.client.session.streams()[0] is not cursor.incoming:
            self._add(cursor, b"Z")
            cursor.records.best_effort = {}
            cursor.start_streams()

    def _seal(self, cursor: WriteCursor) -> None:
        cursor.changed = False
        SLOT_HEAD.pack_into(cursor.slot, 0, 0, cursor.serial, cursor.count, cursor.client.key)
        seal(cursor.slot)
        self._changed.append(cursor)

    def _keep_fragments(self, cursor: WriteCursor, stream_id: int, inbound: InboundCursor) -> None:
        whole, skip = cursor.incoming[stream_id].fragments.export()
        size = len(whole)
        if size:
            start = inbound.pending if whole is inbound.whole and size >= inbound.pending else 0
            if size > start:
                self._add(cursor, fragments_payload(stream_id, start, whole[start:]))
        inbound.whole, inbound.pending, inbound.skip = whole, size, skip

    def _keep_messages(
        self, cursor: WriteCursor, stream_id: int, out: ReliableOut, outbound: OutboundCursor
    ) -> None:
        gap = False
        _, _, after, messages = out.export(outbound.next)
        while outbound.next != after:
            message = messages.get(outbound.next)
            gap = message is None
            if message is not None:
                self._add(cursor, number_payload(b"T", stream_id, outbound.next, message))
            outbound.next = (outbound.next + 1) & 0xFFFF
        if gap:  # the last message was acknowledged before it was written
            self._add(cursor, number_payload(b"N", stream_id, outbound.next))

    def _reserve(self, cursor: WriteCursor, best_effort: dict[int, int]) -> None:
        reserved = cursor.records.best_effort
        for stream_id, number in best_effort.items():
            until = reserved.get(stream_id)
            if until is None or (until - number) & 0xFFFF > 0x7FFF:
                reserved[stream_id] = until = (number + _RESERVE) & 0xFFFF
                self._add(cursor, number_payload(b"B", stream_id, until))

    def _keep_limits(self, cursor: WriteCursor) -> None:
        """Record how many samples are left of READ_DATA with a limit."""
        for object_id in list(cursor.limited):
            obj = cursor.client.objects.get(object_id)
            reading = cursor.records.reads.get(object_id)
            delivery = obj.delivery if obj is not None else None
            if delivery is None or reading is None:
                cursor.limited.discard(object_id)
                if cursor.records.reads.pop(object_id, None) is not None:
                    self._add(cursor, id_payload(b"E", object_id))
                continue
            remaining = delivery.remaining
            request_id, stream_id, control = reading
            if remaining is not None and remaining != (control or (1,))[0]:
                control = (remaining, *(control or (1, 0, 0, 0))[1:])
                cursor.records.reads[object_id] = request_id, stream_id, control
                self._add(cursor, reading_payload(object_id, (request_id, stream_id, control)))

    def _commit(self) -> None:
        """Write the pending records, then the slots that make them valid."""
        if self._pending:
            if not self._journal.append(self._pending):
                self._fail()
            self._pending = bytearray()
        for cursor in self._changed:
            if cursor.index >= 0 and not self._journal.write_slot(cursor.index, cursor.slot):
                self._fail(lost=True)
        self._changed.clear()

    def _fail(self, lost: bool = False) -> None:
        """Handle a failed write; ``lost``: slots in the file are outdated."""
        if lost:
            # Outdated sequence numbers would harm a client; without a file it creates a new
            # session.
            self._journal.clear()
        if self._failing:
            return
        self._failing = True
        self._log.warning(
            "State", "write", "state not kept",
            f"file: {self._journal.path}, {self._journal.error} (boards are served; until it works"
            f" again, which is tried every {_LOOK} s, sessions do not survive a restart of the"
            " agent: free some space, or choose another path)",
        )  # fmt: skip

    def _rewrite(self, sync: bool = False) -> bool:
        """Rewrite the file without obsolete records."""
        slots: dict[int, bytes | bytearray] = {}
        journal = []
        counts = []
        for cursor in self._cursors.values():
            cursor.fill()
            slot, encoded, count = cursor.records.encode(cursor.serial)
            cursor.records.incoming, cursor.records.outgoing = {}, {}
            # `fill` has added the streams in the order of the cursor, so the offsets in the new
            # slot are those that the cursor knows.
            slots[cursor.index] = slot
            journal.append(bytes(encoded))
            counts.append((cursor, count, slot))
        for index, records in self._asleep.values():
            self._serial += 1
            slot, encoded, _ = records.encode(self._serial)
            slots[index] = slot
            journal.append(bytes(encoded))
        if not self._journal.rewrite(slots, journal, sync):
            return False
        for cursor, count, slot in counts:
            cursor.count, cursor.slot = count, slot
            cursor.changed = False
        self._pending = bytearray()
        self._changed.clear()
        self._limit = max(JOURNAL_SIZE, 2 * self._journal.journal_size)
        if self._failing:
            self._failing = False
            self._log.info("State", "write", "state kept again", f"file: {self._journal.path}")
        return True

    # --- time -----------------------------------------------------------------------------

    def _tick(self) -> None:
        server = self._server
        if server is None:
            return
        try:
            self._count_readers()
            self._request_retransmits()
            agent = server.agent
            agent.middleware.flush()  # samples are passed on before they count
            self.keep(list(agent.attended))
            self._ticks += 1
            if self._ticks % _LOOK == 0:
                self._check_file()
        finally:
            server.wake_at(TICK_SECONDS, self._tick)

    def _request_retransmits(self) -> None:
        """Ask restored clients to retransmit again: a request may have been lost."""
        for key, attempts in list(self._retransmits.items()):
            cursor = self._cursors.get(key)
            if cursor is None or not attempts or self._server is None:
                del self._retransmits[key]
                continue
            self._retransmits[key] = attempts - 1
            cursor.client.session.request_retransmit()
            self._server.agent.attend(cursor.client.session)

    def _check_file(self) -> None:
        for key, (_, records) in list(self._asleep.items()):
            if records.info is not None and self._too_old(records.info):
                self._drop_asleep(key)
        if self._failing:
            self._rewrite()
            return
        missing = self._journal.missing()
        if missing is not None:
            self._log.warning(
                "State", "write", "state file changed",
                f"file: {self._journal.path}, {missing} (it is written again; do not touch it)",
            )  # fmt: skip
            if not self._rewrite():
                self._fail()

    def _count_readers(self) -> None:
        """Count the readers of datawriters, some datawriters at a time."""
        if not self._turns:
            self._turns.extend(self._cursors)
        if self._server is None:
            return
        budget, now = _COUNTED, self._server.agent.clock.monotonic()
        while self._turns and budget > 0:
            cursor = self._cursors.get(self._turns.popleft())
            if cursor is None or now < cursor.hold_until:
                continue
            for object_id, obj in cursor.client.objects.items():
                if not isinstance(obj.endpoint, WriterEndpoint) or object_id > 0xFFFF:
                    continue
                budget -= 1
                readers = obj.endpoint.matched()
                if readers != cursor.records.matched.get(object_id, 0):
                    cursor.records.matched[object_id] = readers
                    self._add(cursor, matched_payload(object_id, readers))
            if cursor.changed:
                self._server.agent.attend(cursor.client.session)


def _name(transport: ServerTransport) -> str:
    """Return the name of a transport in the file; "" if sessions end with their connections."""
    return f"{transport.name} {transport.label()}" if transport.lasting else ""
