"""``--state``: sessions that outlive the agent.

A client that never looks whether its agent is still the same must be able to go on: so what it
was told, by an acknowledgement or an answer, is in the file before that leaves. After each burst
the server calls :meth:`Keeper.keep` for the sessions that something happened to, between the
middleware's flush and sending. What was made by and for a client goes into the journal, how far
its streams are into its slot (:mod:`.state`, :mod:`.kept`).

When an agent starts with the file, its clients are brought back (:mod:`.restoring`); those whose
transport it does not have are kept asleep in the file.

Whatever happens to the file, the agent goes on: what could not be written is known by its slot
to be missing, so that such a client starts anew after a restart instead of with wrong numbers.
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
from .journal import SLOT_SIZE, SLOTS, StateFile, record, seal
from .records import (
    SLOT_HEAD,
    SLOT_IN,
    SLOT_OUT,
    About,
    Kept,
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
from .restore import restore, sound_clients
from .write_cursor import Entry, From, To

# A client whose transport is not among the agent's is kept for so long.
ASLEEP_SECONDS: Final = 86_400.0
# A journal of over this, and over twice what it was when it was new, is written anew.
JOURNAL_SIZE: Final = 4 * 1024 * 1024
TICK_SECONDS: Final = 1.0
# Ticks at which a restored client is asked for what it holds, in case the first was lost.
NUDGES: Final = 5
# Every so many ticks: is the file still there, does it work again?
_LOOK: Final = 10
# Writers whose readers are counted at a tick; a count takes 2 µs.
_COUNTED: Final = 1000
# Numbers of a best-effort stream that are used up at a time: a client accepts any gap.
_RESERVE: Final = 1024


class Keeper:
    """See the module. An attachment of the server."""

    def __init__(self, file: StateFile, log: Log) -> None:
        self._file = file
        self._log = log
        self._server: ServerContext | None = None
        self._entries: dict[int, Entry] = {}
        self._asleep: dict[int, tuple[int, Kept]] = {}  # by key; and the slot
        self._free = deque(range(SLOTS))
        self._serial = 0
        self._records = bytearray()
        self._changed: list[Entry] = []
        self._limit = JOURNAL_SIZE
        self._failing = False
        self._restoring = False
        self._ticks = 0
        self._nudges: dict[int, int] = {}  # restored clients, and how often still to ask them
        self._turns: deque[int] = deque()  # keys whose writers' readers are still to be counted

    # --- from start to end ----------------------------------------------------------

    def open(self, server: ServerContext) -> None:
        """Bring back whom the file knows. See :class:`~uros.agent.server.Attachment`."""
        self._server = server
        kept = sound_clients(self._file, self._log)
        server.agent.keeper = self
        self._restoring = True
        for it in kept:
            self._restore(it)
        self._restoring = False
        if not self._rewrite(sync=True):
            self._fail(lost=True)  # what is there now will soon be behind
        server.wake_at(TICK_SECONDS, self._tick)

    def close(self) -> None:
        """What is known now is what a later agent starts with."""
        if self._server is None:
            self._file.close(False)
            return
        agent, self._server = self._server.agent, None
        try:
            self.keep(list(agent.attended))
        finally:  # else the clients that are about to be closed were forgotten here, too
            agent.keeper = None
            self._file.close(not self._failing)

    # --- who comes back, and who waits ------------------------------------------------

    def _restore(self, kept: Kept) -> None:
        about = kept.about
        assert about is not None and self._server is not None
        transport = next(
            (it for it in self._server.transports if _name(it) == about.transport), None
        )
        if transport is None:
            self._fall_asleep(kept)
            return
        entry = restore(kept, self._server.agent, transport, self._enter, self._log)
        if entry is not None:
            self._nudges[about.key] = NUDGES

    def _fall_asleep(self, kept: Kept) -> None:
        about = kept.about
        assert about is not None
        about.asleep_since = about.asleep_since or self._unix_time()
        if about.key in self._asleep or not self._free or self._too_old(about):
            return
        self._asleep[about.key] = self._free.popleft(), kept
        self._log.info(
            "State", "open", "session kept asleep",
            f"client_key: {key_label(about.key)}, this agent has no {about.transport}",
        )  # fmt: skip

    def _too_old(self, about: About) -> bool:
        return abs(self._unix_time() - about.asleep_since) > ASLEEP_SECONDS

    def _unix_time(self) -> float:
        assert self._server is not None
        return self._server.agent.clock.time_ns() / 1e9

    # --- what the agent reports -------------------------------------------------------

    def placed(
        self, client: ClientState, transport: ServerTransport, peer: Any,
        properties: list[tuple[str, str]] | None,
    ) -> None:  # fmt: skip
        """The client is new, begins anew or talks from another place; ``properties`` are those of
        its CREATE_CLIENT, if there was one. It is in the file when this returns.
        """
        if self._restoring:
            return
        key, session = client.key, client.session
        entry = self._entries.get(key)
        if entry is not None and entry.client is not client:
            self.forget(key)
            entry = None
        self._wake_up(key)
        if not transport.lasting or not can_be_kept(peer):
            self.forget(key)  # it ends with its connection
            self._commit()
            return
        if properties is None:
            known = entry.kept.about if entry is not None else None
            properties = known.properties if known is not None else []
        about = About(key, session.session_id, session.mtu, _name(transport), peer, properties)
        if entry is None:
            entry = self._enter(client, Kept())
            if entry is None:
                return
        entry.kept.about = about
        self._add(entry, about.payload())
        self._renew(entry)
        # Not how far its streams are: that counts when all it brought has left for the network.
        self._seal(entry)
        self._commit()

    def _enter(self, client: ClientState, kept: Kept) -> Entry | None:
        if not self._free and self._asleep:
            self._wake_up(next(iter(self._asleep)))
        if not self._free:
            return None  # the agent admits no more than there are slots; nobody is harmed
        self._serial += 1
        entry = Entry(client, kept, self._serial, self._free.popleft())
        self._entries[client.key] = entry
        return entry

    def _wake_up(self, key: int) -> None:
        """Nobody waits for this one's transport any more."""
        index, _ = self._asleep.pop(key, (-1, None))
        if index >= 0:
            self._free.append(index)
            self._file.write_slot(index, bytes(SLOT_SIZE))

    def forget(self, key: int) -> None:
        """The client is no more."""
        entry = self._entries.pop(key, None)
        if entry is None:
            return
        entry.slot[:] = bytes(SLOT_SIZE)
        entry.index, index = -1, entry.index
        if not self._file.write_slot(index, entry.slot):
            self._fail(lost=True)
        self._free.append(index)

    def created(
        self, client: ClientState, obj: XrceObject, what: Representation
    ) -> None:
        """An object was made, by this CREATE."""
        entry = self._entry(client)
        if entry is not None:
            assert self._server is not None
            entry.kept.objects[obj.object_id] = what
            self._add(entry, object_payload(obj.object_id, what))
            for each in (obj, *obj.parts):
                entry.watch_samples(each, self._server.agent.attend)

    def deleted(self, client: ClientState, object_id: int) -> None:
        """An object is no more; it may be a part of another one."""
        entry = self._entry(client)
        if entry is not None and object_id in entry.kept.objects:
            self._add(entry, id_payload(b"D", object_id))
        if entry is not None:
            entry.kept.deleted(object_id)

    def reading(self, client: ClientState, object_id: int, what: Reading | None) -> None:
        """READ_DATA of an object, or its end."""
        entry = self._entry(client)
        if entry is None:
            return
        entry.limited.discard(object_id)
        if what is None:
            if entry.kept.reads.pop(object_id, None) is not None:
                self._add(entry, id_payload(b"E", object_id))
            return
        entry.kept.reads[object_id] = what
        self._add(entry, reading_payload(object_id, what))
        entry.note_limits(object_id, what)

    def _entry(self, client: ClientState) -> Entry | None:
        entry = self._entries.get(client.key) if not self._restoring else None
        return entry if entry is not None and entry.client is client else None

    # --- writing ------------------------------------------------------------------------

    def keep(self, sessions: Iterable[Session]) -> None:
        """Write down what these sessions are about to tell; they acknowledge what came after it."""
        entries = self._entries
        for session in sessions:
            entry = entries.get(session.key)
            if entry is not None and entry.client.session is session:
                self._collect(entry, session)
        if self._changed or self._records:
            self._commit()
            size = self._file.journal_size
            if size > self._limit and not self._failing and not self._rewrite():
                self._limit = size + JOURNAL_SIZE  # the old one is good as it is

    def _add(self, entry: Entry, payload: bytes) -> None:
        entry.count += 1
        entry.changed = True
        if not self._failing:
            self._records += record(entry.serial, entry.count, payload)

    def _collect(self, entry: Entry, session: Session) -> None:
        incoming, outgoing, best_effort = session.streams()
        if incoming is not entry.incoming:
            self._renew(entry)
        slot = entry.slot
        changed = entry.changed
        for stream_id, stream in incoming.items():
            came = entry.streams_from.get(stream_id) or entry.stream_from(stream_id)
            number = stream.stream.next
            if stream.stalled:
                # What is stalled is not acknowledged, and comes again as a whole. What came
                # before it has been written. It may take seconds: that is not written twice.
                if not came.is_whole(stream.fragments):
                    continue
                number = (number - 1) & 0xFFFF
            if number != came.next:
                came.next = number
                if stream.fragments._whole or came.pending or stream.fragments._skip or came.skip:
                    self._keep_fragments(entry, stream_id, came)
                came.whole = stream.fragments._whole
                SLOT_IN.pack_into(
                    slot, came.at, stream_id, 1 | came.skip << 1, number, came.pending
                )
                changed = True
        for stream_id, out in outgoing.items():
            goes = entry.streams_to.get(stream_id) or entry.stream_to(stream_id)
            if out.next != goes.next or out.sent != goes.sent:
                if out.next != goes.next:
                    self._keep_messages(entry, stream_id, out, goes)
                goes.sent = out.sent
                SLOT_OUT.pack_into(slot, goes.at, stream_id, 1, out.acked, out.sent)
                changed = True
        if best_effort:
            self._reserve(entry, best_effort)
        if entry.limited:
            self._keep_limits(entry)
        while entry.news:
            object_id = entry.news.pop()
            if object_id in entry.kept.latched:
                self._add(entry, latched_payload(object_id, entry.kept.latched[object_id]))
        if changed or entry.changed:
            self._seal(entry)

    def _renew(self, entry: Entry) -> None:
        """Where the session's streams have started anew, they do so here."""
        if entry.client.session.streams()[0] is not entry.incoming:
            self._add(entry, b"Z")
            entry.kept.best_effort = {}
            entry.start_streams()

    def _seal(self, entry: Entry) -> None:
        entry.changed = False
        SLOT_HEAD.pack_into(entry.slot, 0, 0, entry.serial, entry.count, entry.client.key)
        seal(entry.slot)
        self._changed.append(entry)

    def _keep_fragments(self, entry: Entry, stream_id: int, came: From) -> None:
        fragments = entry.incoming[stream_id].fragments
        whole = fragments._whole
        size = len(whole)
        if size:
            start = came.pending if whole is came.whole and size >= came.pending else 0
            if size > start:
                self._add(entry, fragments_payload(stream_id, start, whole[start:]))
        came.whole, came.pending, came.skip = whole, size, fragments._skip

    def _keep_messages(self, entry: Entry, stream_id: int, out: ReliableOut, goes: To) -> None:
        gap = False
        while goes.next != out.next:
            message = out._held.get(goes.next)
            gap = message is None
            if message is not None:
                self._add(entry, number_payload(b"T", stream_id, goes.next, message))
            goes.next = (goes.next + 1) & 0xFFFF
        if gap:  # acknowledged before it was sent
            self._add(entry, number_payload(b"N", stream_id, goes.next))

    def _reserve(self, entry: Entry, best_effort: dict[int, int]) -> None:
        reserved = entry.kept.best_effort
        for stream_id, number in best_effort.items():
            until = reserved.get(stream_id)
            if until is None or (until - number) & 0xFFFF > 0x7FFF:
                reserved[stream_id] = until = (number + _RESERVE) & 0xFFFF
                self._add(entry, number_payload(b"B", stream_id, until))

    def _keep_limits(self, entry: Entry) -> None:
        """Of READ_DATA that ends by itself: how many samples are left."""
        for object_id in list(entry.limited):
            thing = entry.client.objects.get(object_id)
            reading = entry.kept.reads.get(object_id)
            delivery = thing.delivery if thing is not None else None
            if delivery is None or reading is None:
                entry.limited.discard(object_id)
                if entry.kept.reads.pop(object_id, None) is not None:
                    self._add(entry, id_payload(b"E", object_id))
                continue
            left = delivery.remaining
            request_id, stream_id, control = reading
            if left is not None and left != (control or (1,))[0]:
                control = (left, *(control or (1, 0, 0, 0))[1:])
                entry.kept.reads[object_id] = request_id, stream_id, control
                self._add(entry, reading_payload(object_id, (request_id, stream_id, control)))

    def _commit(self) -> None:
        """Put it into the file: the journal first, then the slots that say what counts of it."""
        if self._records:
            if not self._file.append(self._records):
                self._fail()
            self._records = bytearray()
        for entry in self._changed:
            if entry.index >= 0 and not self._file.write_slot(entry.index, entry.slot):
                self._fail(lost=True)
        self._changed.clear()

    def _fail(self, lost: bool = False) -> None:
        """Nothing more can be written. ``lost``: not even that it is so."""
        if lost:
            # Numbers that are behind what a client was told would harm it. No file does not.
            self._file.clear()
        if self._failing:
            return
        self._failing = True
        self._log.warning(
            "State", "write", "state not kept",
            f"file: {self._file.path}, {self._file.error} (boards are served; until it works"
            f" again, which is tried every {_LOOK} s, sessions do not survive a restart of the"
            " agent: make room, or choose another place)",
        )  # fmt: skip

    def _rewrite(self, sync: bool = False) -> bool:
        """Write all anew, without what is dead."""
        slots: dict[int, bytes | bytearray] = {}
        journal = []
        counts = []
        for entry in self._entries.values():
            entry.fill()
            slot, records, count = entry.kept.write(entry.serial)
            entry.kept.incoming, entry.kept.outgoing = {}, {}
            # The streams are in the slot in the order in which they came, here as there.
            slots[entry.index] = slot
            journal.append(bytes(records))
            counts.append((entry, count, slot))
        for index, kept in self._asleep.values():
            self._serial += 1
            slot, records, _ = kept.write(self._serial)
            slots[index] = slot
            journal.append(bytes(records))
        if not self._file.rewrite(slots, journal, sync):
            return False
        for entry, count, slot in counts:
            entry.count, entry.slot = count, slot
            entry.changed = False
        self._records = bytearray()
        self._changed.clear()
        self._limit = max(JOURNAL_SIZE, 2 * self._file.journal_size)
        if self._failing:
            self._failing = False
            self._log.info("State", "write", "state kept again", f"file: {self._file.path}")
        return True

    # --- time -----------------------------------------------------------------------------

    def _tick(self) -> None:
        server = self._server
        if server is None:
            return
        try:
            self._count_readers()
            self._nudge()
            agent = server.agent
            agent.middleware.flush()  # before it counts
            self.keep(list(agent.attended))
            self._ticks += 1
            if self._ticks % _LOOK == 0:
                self._look()
        finally:
            server.wake_at(TICK_SECONDS, self._tick)

    def _nudge(self) -> None:
        """Ask restored clients again: the question may have been lost."""
        for key, left in list(self._nudges.items()):
            entry = self._entries.get(key)
            if entry is None or not left or self._server is None:
                del self._nudges[key]
                continue
            self._nudges[key] = left - 1
            entry.client.session.nudge()
            self._server.agent.attend(entry.client.session)

    def _look(self) -> None:
        for key, (_, kept) in list(self._asleep.items()):
            if kept.about is not None and self._too_old(kept.about):
                self._wake_up(key)
        if self._failing:
            self._rewrite()
            return
        missing = self._file.missing()
        if missing is not None:
            self._log.warning(
                "State", "write", "state file changed",
                f"file: {self._file.path}, {missing} (it is written anew; leave it to the agent)",
            )  # fmt: skip
            if not self._rewrite():
                self._fail()

    def _count_readers(self) -> None:
        """How many readers each writer has, some writers at a time."""
        if not self._turns:
            self._turns.extend(self._entries)
        if self._server is None:
            return
        left, now = _COUNTED, self._server.agent.clock.monotonic()
        while self._turns and left > 0:
            entry = self._entries.get(self._turns.popleft())
            if entry is None or now < entry.hold_until:
                continue
            for object_id, thing in entry.client.objects.items():
                if not isinstance(thing.endpoint, WriterEndpoint) or object_id > 0xFFFF:
                    continue
                left -= 1
                readers = thing.endpoint.matched()
                if readers != entry.kept.matched.get(object_id, 0):
                    entry.kept.matched[object_id] = readers
                    self._add(entry, matched_payload(object_id, readers))
            if entry.changed:
                self._server.agent.attend(entry.client.session)


def _name(transport: ServerTransport) -> str:
    """A transport as the file names it; "" where its clients end with their connections."""
    return f"{transport.name} {transport.label()}" if transport.lasting else ""

