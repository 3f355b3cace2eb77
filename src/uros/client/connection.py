"""State machine of a board's connection to its agent: transport, session, creation of entities.

::

    WAITING_AGENT ── ping answered ──> AGENT_AVAILABLE ── all created ──> AGENT_CONNECTED
          ^                                   │ refused, or silent              │ silent
          └──────────────── AGENT_DISCONNECTED <────────────────────────────────┘

* WAITING_AGENT: the transport is opened, and the agent pinged every ``wait_ms``.
* AGENT_AVAILABLE: a new session; its entities are created and the time is asked for.
* AGENT_CONNECTED: samples are exchanged. The agent is pinged ``ping_ms`` after its last message
  other than an answer to a ping, and then every ``ping_ms``. It is lost when it sends nothing for
  ``silence_ms`` from the first unanswered ping on, or does not know the session any more.
* AGENT_DISCONNECTED lasts for one step: the transport is closed, nothing waits for the agent.
"""

from ..ticks import TIME_MASK, ticks_add, ticks_diff
from ..wire import ids
from ..wire.errors import WireError
from .clock import Clock
from .session import DELETE_CLIENT_REQUEST, Session

try:
    from typing import Any, Callable, Final

    from ..wire.cdr import Buffer
    from .protocols import Transport
except ImportError:  # MicroPython
    pass

WAITING_AGENT: Final = 0
AGENT_AVAILABLE: Final = 1
AGENT_CONNECTED: Final = 2
AGENT_DISCONNECTED: Final = 3

# Most datagrams received in one pump, before callbacks run.
_BURST: Final = 16
# Number of replies for the first synchronization, which uses the one with the shortest round trip;
# later ones must be about as fast.
_FIRST_TIMES: Final = 3
# Time until the first retry of a TIMESTAMP. It is doubled at each retry, for slow links.
_TIME_RETRY_MS: Final = 100
# Longest time until a retry, and the time until each one after the first synchronization.
_TIME_AGAIN_MS: Final = 2000
# Time from one synchronization to the next.
_TIME_PERIOD_MS: Final = 30000
# A reply whose round trip is longer by _QUICK_US than the best one is rejected. Each rejection
# raises the limit by _LESS_CHOOSY_US, because the link may have become slower permanently.
_QUICK_US: Final = 3000
_LESS_CHOOSY_US: Final = 300
_CREATE_FLAGS: Final = ids.FLAG_LITTLE_ENDIAN | ids.FLAG_REUSE | ids.FLAG_REPLACE
# An agent that knows our key at another address probes that address for half a second before it
# answers. A client that gave up earlier and reopened its transport would come from a new address,
# start the probe again, and never be answered.
_TAKEOVER_MS: Final = 1000
# Most unanswered requests until all entities are created. eProsima's agent drops a STATUS while 15
# of its messages are not acknowledged, and reads our ACKNACK only after the requests before it, so
# the limit is half of 15. Later a STATUS may be dropped because of a busy topic, but nothing waits
# for it then.
_UNANSWERED: Final = 7


class Connection(Session):
    """Connection of a board to its agent; all work is done in :meth:`pump`, without threads.

    ``connections`` counts the sessions that reached AGENT_CONNECTED, ``unconfirmed`` the messages
    not acknowledged when an agent was lost, ``oom_count`` the steps skipped for lack of memory,
    whose messages are lost as on a faulty link. ``reason`` says why the last agent was lost.

    Args:
        transport: See :class:`~uros.client.protocols.Transport`.
        key: The client key; two boards at one agent must not share it.
        clock: The board's clock.
        limit: Most bytes that may wait in either direction.
        ping_ms: Period of pings, see the module.
        silence_ms: Time without messages after which an agent is lost.
        wait_ms: Period of pings while no agent is known.
    """

    _best_us: "int"

    has_agent = True

    def __init__(
        self,
        transport: "Transport",
        key: int,
        clock: "Clock | None" = None,
        limit: int = 32768,
        ping_ms: int = 200,
        silence_ms: int = 2000,
        wait_ms: int = 500,
    ) -> None:
        super().__init__(transport, key, limit)
        self.clock = clock or Clock()
        self.ping_ms = ping_ms
        self.silence_ms = silence_ms
        self.wait_ms = wait_ms
        self.state = WAITING_AGENT
        self.on_state: "Callable[[int], object] | None" = None
        self.log: "Callable[[str], object]" = print
        self.connections = 0
        self.unconfirmed = 0
        self.reason = ""
        self._entities: "list[Any]" = []
        self._by_id: "dict[int, Any]" = {}
        self._numbers: "dict[int, int]" = {}
        self._todo: "list[Any]" = []  # entities not created yet in this session
        self._step_of = 0  # requests made for the first of them
        # By request id: the entity that the agent is creating, or None for a DELETE.
        self._awaited: "dict[int, Any]" = {}
        self._open = False  # the transport
        self._known = False  # the session, to the agent
        self._lost = ""
        self._next = self.clock.ms()
        # When the first ping or CREATE_CLIENT since the agent's last message was sent.
        self._asked_at = -1

    # --- entities -------------------------------------------------------------------------

    def add(self, entity: "Any") -> int:
        """Add an entity, which every session creates, in the order added.

        Args:
            entity: See :class:`~uros.client.protocols.ConnectedEntity`.

        Returns:
            The entity's number, unique among the entities with the same first kind.
        """
        number = self._numbers.get(entity.kinds[0], 0)
        self._numbers[entity.kinds[0]] = number + 1
        self._entities.append(entity)
        if self._known:
            self._todo.append(entity)
        return number

    def remove(self, entity: "Any", object_ids: "tuple[int, ...]") -> None:
        """Remove an entity: delete its objects now, the last first, and do not create it again."""
        self._entities.remove(entity)
        if entity in self._todo:
            begun = entity is self._todo[0] and self._step_of
            self._todo.remove(entity)
            if not begun:
                return
            self._step_of = 0
        for request in self._awaited:
            if self._awaited[request] is entity:
                self._awaited[request] = None
        for object_id in reversed(object_ids):
            self._by_id.pop(object_id, None)
            if self._known:
                request = self.request(ids.DELETE, ids.FLAG_LITTLE_ENDIAN, self.begin(object_id))
                self._awaited[request] = None

    def transient_local(self, depth: int) -> int:
        """Return ``depth``: the caller sets QOS_TRANSIENT_LOCAL in the entity's flags.

        That takes less of a board's memory than a QoSProfile.
        """
        return depth

    def create(
        self, entity: "Any", object_id: int, parent: int, push: "Callable[..., None]",
        *values: "Any",
    ) -> None:  # fmt: skip
        """Send CREATE of an object with its binary representation, which ``push`` writes."""
        w = self.begin(object_id)
        kind = object_id & 0x0F
        w.u8(kind)
        w.u8(ids.IN_BINARY)
        w.u32(0)
        start = w.offset  # as aligned as the representation's own first byte
        push(w, *values)
        size = w.offset - start
        w.buf[start - 4] = size & 0xFF
        w.buf[start - 3] = size >> 8
        if kind == ids.KIND_PARTICIPANT:
            w.u16(parent)
        else:
            w.be16(parent)
        self._awaited[self.request(ids.CREATE, _CREATE_FLAGS, w)] = entity

    def listen(self, entity: "Any", object_id: int, reliable: "bool | int") -> None:
        """Send READ_DATA for all samples; they are passed to ``entity.on_data``."""
        self._by_id[object_id] = entity
        w = self.begin(object_id)
        w.u8(ids.STREAM_RELIABLE if reliable else ids.STREAM_BEST_EFFORT)
        # Default data format, no content filter, and a delivery control without limits: max_samples
        # is 0xFFFF, the other limits are 0.
        w.octets(b"\0\0\1\xff\xff\0\0\0\0\0\0")
        self.request(ids.READ_DATA, ids.FLAG_LITTLE_ENDIAN, w)

    def pause_reading(self) -> None:
        """Have the agent keep all samples until the next session, which asks for them again."""
        for object_id in self._by_id:
            w = self.begin(object_id)
            w.u8(ids.STREAM_RELIABLE)
            # As in `listen`, but for no samples.
            w.octets(b"\0\0\1\0\0\0\0\0\0\0\0")
            self.request(ids.READ_DATA, ids.FLAG_LITTLE_ENDIAN, w)

    # --- handlers of the agent's messages -----------------------------------------------------

    def on_agent(self, status: int) -> None:
        """Handle STATUS_AGENT: the session was opened or refused."""
        if self._known and (self.acked or self._in.next):
            # A second STATUS_AGENT, which is not for a repeated CREATE_CLIENT: the agent has reset
            # its end of the streams.
            self._lost = "the agent began anew"
        if self.state != AGENT_AVAILABLE or self._known:
            return
        if status != ids.STATUS_OK:
            self._refused("the session", status)
            return
        self._known = True
        self._todo = list(self._entities)
        self._step_of = 0
        self._times = _FIRST_TIMES  # replies that the first synchronization still needs
        self._time_retry = _TIME_RETRY_MS
        self._next_time = self._answered = self.clock.ms()

    def on_pong(self) -> None:
        """Handle INFO outside of a session: there is an agent."""
        if self.state == WAITING_AGENT:
            self._next = self.clock.ms()
            self._asked_at = -1
            self._enter(AGENT_AVAILABLE)

    def on_unknown(self) -> None:
        """End the session: the agent does not know it."""
        self._lost = "the agent does not know this session"

    def on_status(self, request_id: int, status: int) -> None:
        """Handle the STATUS of a request."""
        if request_id == DELETE_CLIENT_REQUEST:
            self._known = False
            return
        self._answered = self.clock.ms()
        known = request_id in self._awaited
        entity = self._awaited.pop(request_id, None)
        # A refused DELETE is no fault, because the object was not there.
        if status >= ids.STATUS_ERR_DDS_ERROR and (entity is not None or not known):
            for receiver in self._by_id.values():
                if receiver.on_refused(request_id):
                    return
            self._refused(entity.name if known else "request %d" % request_id, status)

    def on_time(self, transmit: "tuple[int, ...]", receive: "tuple[int, ...]") -> None:
        """Handle TIMESTAMP_REPLY: the agent's times of sending and receiving, each (s, ns)."""
        away = (self.clock.us() - self._asked_us) & TIME_MASK
        inside = (transmit[0] - receive[0]) * 1000000 + (transmit[1] - receive[1]) // 1000
        trip = max(0, away - inside)
        first = self._times == _FIRST_TIMES
        slack = 0 if self._times else _QUICK_US
        if first or trip <= self._best_us + slack:
            self._best_us = trip
            self.clock.set(transmit[0], transmit[1] + (trip >> 1) * 1000)
        elif not self._times:
            self._best_us += _LESS_CHOOSY_US
            return  # too slow: TIMESTAMP is sent again soon
        self._answered = self._next_time = self.clock.ms()
        self._time_retry = _TIME_RETRY_MS
        if self._times:
            self._times -= 1
        if not self._times:
            self._next_time = ticks_add(self._next_time, _TIME_PERIOD_MS)

    def on_data(self, object_id: int, buf: "Buffer", start: int, stop: int, little: bool) -> None:
        """Pass a sample to its entity."""
        entity = self._by_id.get(object_id)
        if entity is not None:
            self._delivered = True
            entity.on_data(buf, start, stop, little)

    # --- the four states ----------------------------------------------------------------------

    def pump(self, timeout_ms: int) -> None:
        """Do what is due, then receive a few datagrams at most, so that callbacks can run.

        Args:
            timeout_ms: How long to wait for the first datagram; below 0 nothing is received.
        """
        try:
            self._pump(timeout_ms)
        except MemoryError:
            self.oom_count += 1

    def _pump(self, timeout_ms: int) -> None:
        now = self.clock.ms()
        self._step(now)
        if timeout_ms < 0:
            return
        wait = min(timeout_ms, self._wait(now))
        if not self._open:
            if wait > 0:
                self.clock.sleep(wait)
            return
        self._delivered = False  # whether a sample was received in this pump
        try:
            message = self.transport.receive(max(0, wait))
            count = 0
            while message is not None:
                now = self.clock.ms()
                if self.receive(message, now):
                    self._asked_at = -1
                    if self._known and message[4] != ids.INFO:
                        self._next = ticks_add(now, self.ping_ms)
                count += 1
                if self._delivered or count == _BURST:
                    break
                message = self.transport.receive(0)
            # Checked only when nothing more is waiting: during a long callback the agent's messages
            # were not read.
            if message is None and self.state != WAITING_AGENT:
                now = self.clock.ms()
                asked = self._asked_at
                if asked >= 0 and ticks_diff(now, asked) >= (
                    self.silence_ms if self._known else max(self.silence_ms, _TAKEOVER_MS)
                ):
                    self._lost = self._lost or "the agent is silent"
                elif (
                    self.state == AGENT_AVAILABLE
                    and self._known
                    and ticks_diff(now, self._answered) >= self.silence_ms
                ):
                    self._lost = self._lost or "requests stay unanswered"
        except OSError as error:
            self.on_line(error)
        self._step(self.clock.ms())

    def _wait(self, now: int) -> int:
        """Return the milliseconds until something is due."""
        wait = ticks_diff(self._next, now)
        if self._known:
            wait = min(wait, ticks_diff(self._next_time, now))
            deadline = self.deadline
            if deadline is not None:
                wait = min(wait, ticks_diff(deadline, now))
        return wait

    def _step(self, now: int) -> None:
        if self.state != WAITING_AGENT:
            if not self._lost:
                self._keep(now)
        elif not self._lost and ticks_diff(now, self._next) >= 0:
            self._next = ticks_add(now, self.wait_ms)
            if self._ensure_open():
                self.ping(False)
        if self._lost:
            self._disconnect(now)

    def _ensure_open(self) -> bool:
        if not self._open:
            try:
                self.transport.open()
            except OSError as error:
                self.reason = str(error)
                return False
            self._open = True
        return True

    def _keep(self, now: int) -> None:
        """Send the pings and requests of a session that are due."""
        if ticks_diff(now, self._next) >= 0:
            self._next = ticks_add(now, self.ping_ms)
            if self._asked_at < 0:
                self._asked_at = now
            if self._known:
                self.ping(True)
            else:
                self.create_session()
        if not self._known:
            return
        self._feed()
        if ticks_diff(now, self._next_time) >= 0:
            self._next_time = ticks_add(now, _TIME_AGAIN_MS)
            if self._times:
                self._next_time = ticks_add(now, self._time_retry)
                self._time_retry = min(2 * self._time_retry, _TIME_AGAIN_MS)
            seconds, nanoseconds = self.clock.now()
            self._asked_us = self.clock.us()
            self.ask_time(seconds, nanoseconds)
        if self.state == AGENT_AVAILABLE and not (self._todo or self._awaited or self._times):
            self.connections += 1
            self.trim()  # free the buffers of the requests
            self._awaited = {}  # a cleared dict would keep its memory
            self._enter(AGENT_CONNECTED)
        self.tick(now)

    def _feed(self) -> None:
        """Send the requests that create entities, as far as the window reaches."""
        while (
            self._todo
            and self.available()
            and (self.state == AGENT_CONNECTED or len(self._awaited) < _UNANSWERED)
        ):
            entity = self._todo[0]
            try:
                last = entity.create(self, self._step_of)
            except WireError as error:
                self._lost = "%s cannot be created: %r" % (entity.name, error)
                self.log("uros: " + self._lost)
                return
            self._step_of += 1
            if last:
                self._step_of = 0
                self._todo.pop(0)

    def _enter(self, state: int) -> None:
        self.state = state
        self.make_ready(state == AGENT_CONNECTED)
        if self.on_state:
            try:
                self.on_state(state)
            except Exception as error:
                self.log("uros: on_state raised %r" % error)

    def _refused(self, subject: str, status: int) -> None:
        self._lost = "the agent refuses %s: %s" % (subject, ids.status_name(status))
        self.log("uros: " + self._lost)

    def _disconnect(self, now: int) -> None:
        self.reason = self._lost
        was = self.state
        self.unconfirmed += self.held()
        if was == WAITING_AGENT:
            self._reset()  # no agent knows a session with this id
        else:
            self.renew()
        self._known = False
        self._todo.clear()
        self._awaited.clear()
        self._by_id.clear()
        self._open = False
        try:
            self.transport.close()
        except OSError:  # the transport has failed already
            pass
        for entity in self._entities:
            entity.on_lost()
        self._lost = ""  # last: after a MemoryError above, all of it is repeated
        # After a pause, so that an agent that refuses the session is not asked continuously.
        self._next = ticks_add(now, self.wait_ms)
        if was != WAITING_AGENT:
            self._enter(AGENT_DISCONNECTED)
            self._enter(WAITING_AGENT)

    def close(self) -> None:
        """Delete the session at the agent, waiting for its STATUS for ``wait_ms`` at most."""
        if self._known:
            end = ticks_add(self.clock.ms(), self.wait_ms)
            self.delete_session()
            try:
                while self._known and ticks_diff(end, self.clock.ms()) > 0:
                    message = self.transport.receive(ticks_diff(end, self.clock.ms()))
                    if message is not None:
                        self.receive(message, self.clock.ms())
            except (OSError, MemoryError):  # the session is ended in any case
                pass
        self._lost = "closed"
        self._disconnect(self.clock.ms())

    def end(self, reason: str) -> None:
        """End the session at the next step and begin another."""
        self._lost = self._lost or reason

    def on_line(self, error: OSError) -> None:
        """End the session: the transport raised OSError."""
        self._lost = "the line is gone: %s" % error
