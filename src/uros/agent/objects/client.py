"""One client: its session, its objects, and the rules for creating them.

Creating an object whose id exists (XRCE 7.8.3, table 7):

=========  ===========  ==========================================
REUSE      REPLACE      outcome
=========  ===========  ==========================================
no         no           ERR_ALREADY_EXISTS
no         yes          the old one is deleted, the new one created
yes        no           OK_MATCHED if equal, else ERR_MISMATCH
yes        yes          OK_MATCHED if equal, else replaced
=========  ===========  ==========================================

Equal means the same specification, in whichever format it came. An object
stays known after its parent is deleted, as with the C++ agent, so that a client
may delete in any order; its endpoint is closed with the participant. An object
without its endpoint is created again if it would be reused.

Types and QoS profiles are only stored, for references by name. An application is
created and deleted with all entities it lists.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Final

from ...middleware.base import MiddlewareError
from ...ticks import ticks_add, ticks_diff
from ...wire import data, entities, ids
from ...wire import session as messages
from ...wire.cdr import Reader
from ...wire.errors import DecodeError
from ..context import AgentContext
from ..log import INFO, TRACE, WARNING
from ..policy.limits import TooMany
from ..policy.memory_budget import CLIENT_BYTES, OBJECT_BYTES
from ..policy.rules import NameRefused
from ..session.delivery import Delivery
from ..session.session import Session
from . import representation
from .endpoints import (
    ReaderEndpoint,
    ReadingEndpoint,
    ReplierEndpoint,
    RequesterEndpoint,
    WriterEndpoint,
)
from .factory import ObjectFactory
from .kinds import KIND_NAMES, key_label, object_label, parent_id
from .object_info import send_info
from .object_table import Known, Taken, XrceObject, broken, check_room
from .representation import UnknownReference
from .ros_graph import GraphEndpoint
from .xml_profiles import ProfileError

# The most refused objects of a client that are remembered, and the characters of a reason, because
# a client may ask for any number of objects with names of any length.
_MAX_REFUSED: Final = 16
_MAX_WHY: Final = 200
# Milliseconds for which samples wait for a client that has created its session again.
HOLD_MS: Final = 2000


class ProxyClient:
    """A client of the agent; see the module.

    Args:
        agent: The agent.
        key: The client key.
        session_id: The id of its session.
        mtu: The longest message, in octets, that it can take.
        certificate: The name in its certificate, see ServerTransport.certificate_of.
    """

    def __init__(
        self, agent: AgentContext, key: int, session_id: int, mtu: int,
        certificate: str | None = None,
    ) -> None:  # fmt: skip
        self.key = key
        self.certificate = certificate
        self.session = Session(key, session_id, mtu, self, agent.budget, agent.limits.message)
        self.objects: dict[int, XrceObject] = {}
        self.born = agent.clock.monotonic()
        # The client's own time minus ours, in seconds, when its last TIMESTAMP came.
        self.clock_offset: float | None = None
        # Session.heard when the client was restored after a restart of the agent; None for one
        # that has created its session since.
        self.resumed_at: int | None = None
        # Why the objects that it wanted and does not have were refused, by their ids.
        self.refused: dict[int, str] = {}
        self._agent = agent
        self._known = Known(self.objects, agent.references)
        self._factory = ObjectFactory(agent, self.objects, self._known)
        self._kept = 0  # bytes of all representations
        self._paced: set[XrceObject] = set()  # whose deliveries wait for their time
        self._time_budget = agent.time_budget.for_client()

    # --- what the session reports ---------------------------------------------

    def submessage(self, kind: int, flags: int, stream: int, payload: memoryview) -> bool:
        """Handle one submessage; see :class:`~uros.agent.session.handler.Handler`."""
        r = Reader(payload, 0, len(payload), bool(flags & ids.FLAG_LITTLE_ENDIAN))
        if kind == ids.WRITE_DATA:
            return self._write_data(flags, stream, payload)
        if kind == ids.READ_DATA:
            self._read_data(r)
        elif kind in (ids.CREATE, ids.DELETE):
            # Deleting a client is never deferred: its objects are closed in slices.
            if not self._time_budget.start() and not _deletes_client(kind, payload):
                return False
            try:
                if kind == ids.CREATE:
                    self._create(r, flags, stream)
                else:
                    self._delete(r, stream)
            finally:
                self._time_budget.charge()
        elif kind == ids.GET_INFO:
            self._get_info(r, stream)
        elif kind == ids.TIMESTAMP:
            self._timestamp(r)
        elif kind == ids.INFO or (kind == ids.CREATE_CLIENT and not payload):
            # The answer to a probe: the session has noted already that the client is there. C
            # clients omit its submessage header and send zeros.
            pass
        else:
            raise DecodeError(f"submessage {kind} is not for an agent")
        return True

    def room(self, stream: int) -> None:
        """Continue the deliveries on a stream that can take messages again."""
        now = self._agent.now()
        for obj in self.objects.values():
            if obj.delivery is not None and obj.delivery.stream_id == stream:
                self._pump(obj, now)

    def begin_anew(self, now: int) -> None:
        """Reset the streams for a client that has created its session again; its objects stay.

        A board that was reset knows no objects yet, and would drop samples: they wait until it
        asks for them again. One that only lost its session may never ask, and gets them after
        :data:`HOLD_MS`.
        """
        for obj in self.objects.values():
            if obj.delivery is not None:
                obj.delivery.hold(ticks_add(now, HOLD_MS))
                self._paced.add(obj)
        self.session.reset()

    def fault(self, event: str, about: str) -> None:
        """Log that the client broke the protocol, within the rate limit for faults."""
        times = self._agent.faults.times(f"{self.key:08X} {event}")
        if times is not None:
            self.log(WARNING, "Session", "receive", event, f"{about}{times}")

    def many_fragments(self, size: int, count: int) -> None:
        """Log that the client gets long messages, and what it needs for them."""
        self.log(
            INFO, "Session", "send", "large message",
            f"{size} bytes in {count} fragments (a C client needs a history that holds them:"
            " RMW_UXRCE_STREAM_HISTORY)",
        )  # fmt: skip

    def held(self) -> int:
        """Return the bytes held for it; see :mod:`~uros.agent.policy.memory_budget`."""
        own = CLIENT_BYTES + self._kept + OBJECT_BYTES * len(self.objects)
        unread = sum(
            obj.endpoint.unread for obj in self.objects.values() if obj.endpoint is not None
        )
        return own + unread + self.session.held()

    def heard(self) -> int:
        """Return when its last message came, in milliseconds modulo 2^30."""
        return self.session.heard

    def next_deadline(self) -> int | None:
        """Return when :meth:`poll` has something to do, or None."""
        deadline = self.session.next_deadline()
        for obj in self._paced:
            at = None if obj.delivery is None else obj.delivery.next_deadline()
            if at is not None and (deadline is None or ticks_diff(at, deadline) < 0):
                deadline = at
        return deadline

    def poll(self, now: int) -> None:
        """Send what is due by time: heartbeats, retransmissions, deliveries."""
        self.session.poll(now)
        paced, self._paced = self._paced, set()
        for obj in paced:
            self._pump(obj, now)

    def close(self) -> None:
        """Delete all objects, endpoints before participants."""
        for obj in reversed(list(self.objects.values())):
            self.close_object(obj)
        self.objects.clear()
        self.session.writers.clear()
        self.session.end()

    # --- CREATE and DELETE -----------------------------------------------------

    def _create(self, r: Reader, flags: int, stream: int) -> None:
        request_id, object_id, kind, form, content, parent = entities.pull_create(r)
        try:
            status = self._create_object(object_id, kind, form, content, parent, r.little, flags)
        except UnknownReference as error:
            status = ids.STATUS_ERR_UNKNOWN_REFERENCE
            self._refused(kind, object_id, str(error), status)
        except NameRefused as error:
            status = ids.STATUS_ERR_DENIED
            self._refused(kind, object_id, str(error), status)
        except (DecodeError, ProfileError) as error:
            status = ids.STATUS_ERR_INVALID_DATA
            self._refused(kind, object_id, f"{error}{_hint(str(error))}", status)
        except TooMany as error:
            status = ids.STATUS_ERR_RESOURCES
            self._refused(kind, object_id, str(error), status)
        except Taken as error:
            status = ids.STATUS_ERR_ALREADY_EXISTS
            self._refused(kind, object_id, str(error), status)
        except MiddlewareError as error:
            status = ids.STATUS_ERR_DDS_ERROR
            self._refused(kind, object_id, str(error), status)
        except Exception as error:  # the client must get an answer
            status = ids.STATUS_ERR_DDS_ERROR
            self._agent.failed(error)
        self._status(request_id, object_id, status, stream)

    def _refused(self, kind: int, object_id: int, why: str, status: int) -> None:
        agent, rule = self._agent, ids.status_name(status).lower().removeprefix("err_")
        about = f"{object_label(object_id)}: {why}"
        address, now = agent.address(self.key), agent.clock.monotonic()
        agent.refusals.count("request", rule, address, about, now, self.key)
        if object_id not in self.objects and len(self.refused) < _MAX_REFUSED:
            self.refused[object_id] = why[:_MAX_WHY]
        times = self._agent.faults.times(f"{self.key:08X} {object_id:04X} {why[:80]}")
        if times is None:
            return  # a board may try again and again, as fast as it can
        name = KIND_NAMES.get(kind, f"kind {kind}")
        self.log(
            WARNING, "ProxyClient", f"create_{name}", f"{name} refused",
            f"object_id: {object_label(object_id)}, {why}{times}",
        )  # fmt: skip

    def _create_object(
        self,
        object_id: int,
        kind: int,
        form: int,
        content: str | bytes,
        parent: int,
        little: bool,
        flags: int,
    ) -> int:
        if kind not in KIND_NAMES:
            raise DecodeError(f"objects of kind {kind} cannot be created")
        spec = representation.parse(
            kind, form, content, parent, little, self._known, self._agent.middleware.any_name
        )
        obj = XrceObject(
            object_id, parent_id(kind, parent), spec, representation=(form, content, parent)
        )
        old = self.objects.get(object_id)
        if old is not None:
            reuse, replace = flags & ids.FLAG_REUSE, flags & ids.FLAG_REPLACE
            if not reuse and not replace:
                return ids.STATUS_ERR_ALREADY_EXISTS
            if reuse and not broken(old, self.objects):
                if old.spec == spec and old.parent == obj.parent:
                    return ids.STATUS_OK_MATCHED
                if not replace:
                    return ids.STATUS_ERR_MISMATCH
            self._forget(old)
        limits = self._agent.limits
        check_room(self.objects, [kind], limits)
        if self._kept + obj.kept > limits.representations:
            raise TooMany(f"over {limits.representations} bytes of representations")
        if not self._agent.budget.admit(OBJECT_BYTES + obj.kept):
            raise TooMany("the memory for all clients is used up (see --max-memory)")
        about = self._factory.create(self, obj)
        self.objects[object_id] = obj
        self.refused.pop(object_id, None)
        self._kept += obj.kept
        if self._agent.session_store is not None:
            self._agent.session_store.created(self, obj, (form, content, kind, parent, little))
        name = KIND_NAMES[kind]
        self.log(
            INFO, "ProxyClient", f"create_{name}", f"{name} created",
            f"{name}_id: {object_label(object_id)}{about}",
        )  # fmt: skip
        return ids.STATUS_OK

    def on_too_large(self, object_id: int) -> Callable[[str], None]:
        """Return the callback for messages that exceed ``max_size`` of the rules."""
        return lambda why: self.fault("message too large", f"{object_label(object_id)}, {why}")

    def on_ready(self, obj: XrceObject) -> Callable[[], None]:
        """Return the callback for samples that wait in the object's endpoint."""

        def ready() -> None:
            endpoint = obj.endpoint
            backlog = endpoint.backlog if isinstance(endpoint, ReadingEndpoint) else None
            if backlog is not None:
                backlog.empty = False
            if obj.delivery is not None:
                self._pump(obj, self._agent.now())
                self._agent.attend(self.session)
            if backlog is not None and not backlog.empty and backlog.check():
                self._agent.wake_at(0.0, ready)  # after the other clients were served

        return ready

    def on_refusal(self, obj: XrceObject) -> Callable[[list[int], str], None]:
        """Return the callback for requests that nobody will answer.

        It answers them with a STATUS. C clients ignore a STATUS that they do not wait for; the C++
        agent sends none.
        """

        def refused(request_ids: list[int], why: str) -> None:
            self.fault("request refused", f"{object_label(obj.object_id)}, {why}")
            for request_id in request_ids:
                self._status(
                    request_id, obj.object_id, ids.STATUS_ERR_DDS_ERROR, ids.STREAM_RELIABLE
                )
            self._agent.attend(self.session)

        return refused

    def on_dropped(self, obj: XrceObject) -> Callable[[str], None]:
        """Return the callback for samples that are dropped because too many wait."""
        return lambda why: self.fault("samples dropped", f"{object_label(obj.object_id)}, {why}")

    def _delete(self, r: Reader, stream: int) -> None:
        request_id, object_id = messages.pull_request(r)
        if object_id & 0x0F == ids.KIND_CLIENT:
            existed = self._agent.delete_client(self.key)
            status = ids.STATUS_OK if existed else ids.STATUS_ERR_UNKNOWN_REFERENCE
            self.session.answer(
                ids.STATUS, ids.STREAM_NONE, self._agent.now(),
                lambda w: messages.push_status(w, request_id, object_id, status),
            )  # fmt: skip
            return
        self.refused.pop(object_id, None)  # the client no longer wants it
        obj = self.objects.get(object_id)
        if obj is None:
            status = ids.STATUS_ERR_UNKNOWN_REFERENCE
        else:
            status = ids.STATUS_OK
            self._forget(obj)
            self.log(
                INFO + 1, "ProxyClient", "delete_object", "object deleted",
                f"object_id: 0x{object_id:04X}",
            )  # fmt: skip
        self._status(request_id, object_id, status, stream)

    def recreate(
        self, object_id: int, form: int, content: str | bytes, kind: int, parent: int, little: bool
    ) -> None:
        """Create an object again that existed before the agent was restarted.

        Args:
            object_id: Its id.
            form: The format of its representation.
            content: The representation.
            kind: Its kind.
            parent: Its parent's id; the domain of a participant.
            little: Whether a binary representation is little endian.

        Errors are those of :meth:`.factory.ObjectFactory.create`.
        """
        self._create_object(object_id, kind, form, content, parent, little, 0)

    def _forget(self, obj: XrceObject) -> None:
        if self._agent.session_store is not None:
            self._agent.session_store.deleted(self, obj.object_id)
        self.close_object(obj)
        self._kept -= obj.kept
        del self.objects[obj.object_id]

    def close_object(self, obj: XrceObject) -> None:
        """Close the object's endpoint or node, and the parts of an application; it stays known."""
        for part in reversed(obj.parts):
            if self.objects.get(part.object_id) is part:
                self._forget(part)
        obj.parts = []
        obj.delivery = None
        self.session.writers.pop(obj.object_id, None)
        if obj.endpoint is not None:
            if obj.endpoint.unread:
                self._agent.budget.freed = True
            self._agent.close_queue.add(obj.endpoint.close)
            obj.endpoint = None
        node, obj.node = obj.node, None
        if node is not None and obj.kind == ids.KIND_PARTICIPANT:
            for child in self.objects.values():
                if child.node is node:
                    self.close_object(child)
            self._agent.close_queue.add(node.close)

    # --- data ------------------------------------------------------------------

    def _write_data(self, flags: int, stream: int, payload: memoryview) -> bool:
        """Handle requests, replies, and samples that the session's hot path did not take."""
        if len(payload) < data.REQUEST_SIZE:
            raise DecodeError(f"WRITE_DATA of {len(payload)} bytes")
        object_id = payload[2] << 8 | payload[3]
        if flags & ids.FORMAT_MASK:
            reason = (
                f"data format 0x{flags & ids.FORMAT_MASK:02X} is not supported: send FORMAT_DATA"
            )
            self.fault("unsupported WRITE_DATA", f"{object_label(object_id)}, {reason}")
            request_id = payload[0] << 8 | payload[1]
            self._status(request_id, object_id, ids.STATUS_ERR_INVALID_DATA, stream)
            return True
        obj = self.objects.get(object_id)
        if obj is not None and isinstance(obj.endpoint, (RequesterEndpoint, ReplierEndpoint)):
            write, limiter = partial(obj.endpoint.write, flags), obj.settings.limiter
            try:
                if limiter is None:
                    return write(payload)
                return limiter.write(payload, write, self.on_too_large(object_id))
            except MiddlewareError as error:
                self.fault("middleware error", str(error))
                return True
        if object_id in self.session.writers:
            raise DecodeError(f"WRITE_DATA of {len(payload)} bytes, without a sample")
        self.fault("unknown object", f"WRITE_DATA to {object_label(object_id)}")
        return True

    def _read_data(self, r: Reader) -> None:
        request_id, object_id, stream_id, data_format, content_filter, control = (
            data.pull_read_data(r)
        )
        obj = self.objects.get(object_id)
        status = ids.STATUS_OK
        if obj is None or obj.endpoint is None or isinstance(obj.endpoint, WriterEndpoint):
            status = ids.STATUS_ERR_UNKNOWN_REFERENCE
        elif content_filter or data_format & ids.FORMAT_MASK:
            status = ids.STATUS_ERR_INVALID_DATA
            self.fault(
                "unsupported READ_DATA",
                "content filters and formats other than FORMAT_DATA are not supported",
            )
        if status != ids.STATUS_OK:
            self._status(request_id, object_id, status, ids.STREAM_RELIABLE)
            return
        assert obj is not None
        assert obj.endpoint is not None and not isinstance(obj.endpoint, WriterEndpoint)
        if control is not None and control[0] == 0:
            obj.delivery = None
            if self._agent.session_store is not None:
                self._agent.session_store.reading(self, object_id, None)
            # C clients wait a second for this answer, which the C++ agent never sends. It goes out
            # on a best-effort stream, so that the reliable one has the C++ agent's sequence
            # numbers.
            self._status(request_id, object_id, ids.STATUS_OK, ids.STREAM_BEST_EFFORT)
            return
        self._deliver(obj, obj.endpoint, request_id, stream_id, control)

    def _deliver(
        self,
        obj: XrceObject,
        source: ReaderEndpoint | RequesterEndpoint | ReplierEndpoint | GraphEndpoint,
        request_id: int,
        stream_id: int,
        control: tuple[int, int, int, int] | None,
    ) -> None:
        now = self._agent.now()
        if isinstance(source, GraphEndpoint):
            source.anew()
        obj.delivery = Delivery(
            self.session, source, request_id, obj.object_id, stream_id, control, now
        )
        if self._agent.session_store is not None:
            reading = request_id, stream_id, control
            self._agent.session_store.reading(self, obj.object_id, reading)
        self._pump(obj, now)

    def read(
        self, object_id: int, request_id: int, stream_id: int,
        control: tuple[int, int, int, int] | None,
    ) -> bool:  # fmt: skip
        """Continue a READ_DATA from before the restart; return whether its object exists."""
        obj = self.objects.get(object_id)
        if obj is None or obj.endpoint is None or isinstance(obj.endpoint, WriterEndpoint):
            return False
        self._deliver(obj, obj.endpoint, request_id, stream_id, control)
        return True

    def _pump(self, obj: XrceObject, now: int) -> None:
        delivery = obj.delivery
        if delivery is None:
            return
        try:
            is_finished = delivery.pump(now)
        except (DecodeError, MiddlewareError) as error:
            # The middleware calls all clients one after the other. An error must not reach it,
            # because the others would not be called.
            obj.delivery = None
            self.fault("delivery ended", f"{object_label(obj.object_id)}, {error}")
            return
        except Exception as error:  # likewise
            obj.delivery = None
            self._agent.failed(error)
            return
        if is_finished:
            obj.delivery = None
        elif delivery.next_deadline() is not None:
            self._paced.add(obj)

    # --- the rest --------------------------------------------------------------

    def _get_info(self, r: Reader, stream: int) -> None:
        request_id, object_id, mask = messages.pull_get_info(r)
        if object_id != ids.OBJECT_AGENT:
            send_info(
                self.session, self.objects.get(object_id), request_id, object_id, mask, stream,
                self._agent.now(),
            )  # fmt: skip
            return
        # The same for any mask, as with the C++ agent: eProsima's clients ping with it.
        self.session.answer(
            ids.INFO, ids.STREAM_NONE, self._agent.now(),
            lambda w: messages.push_info(w, request_id, object_id, ids.STATUS_OK, 1, []),
        )  # fmt: skip

    def _timestamp(self, r: Reader) -> None:
        clock = self._agent.clock
        received = clock.wall_clock()
        originate = messages.pull_timestamp(r)
        self.clock_offset = (
            originate[0] - received[0] + (originate[1] - received[1]) / 1_000_000_000
        )
        self.session.answer(
            ids.TIMESTAMP_REPLY, ids.STREAM_NONE, self._agent.now(),
            lambda w: messages.push_timestamp_reply(
                w, clock.wall_clock(), received, originate
            ),
        )  # fmt: skip

    def _status(self, request_id: int, object_id: int, status: int, stream: int) -> None:
        """Answer on the built-in stream of the same kind as the request's, as the C++ agent."""
        reliable = stream >= ids.STREAM_RELIABLE
        self.session.answer(
            ids.STATUS, ids.STREAM_RELIABLE if reliable else ids.STREAM_BEST_EFFORT,
            self._agent.now(),
            lambda w: messages.push_status(w, request_id, object_id, status),
        )  # fmt: skip

    def log(self, level: int, part: str, function: str, event: str, about: str) -> None:
        """Log a line about this client."""
        if level <= self._agent.log.level <= TRACE:
            self._agent.log(
                level, part, function, event, f"client_key: {key_label(self.key)}, {about}"
            )


def _deletes_client(kind: int, payload: memoryview) -> bool:
    return kind == ids.DELETE and len(payload) >= 4 and payload[3] & 0x0F == ids.KIND_CLIENT


def _hint(error: str) -> str:
    """Return the remedy for text that a C client has cut to the size of its buffer."""
    if error.startswith("truncated") or "unclosed" in error:
        return " (did the client cut it? shorten its names, or raise RMW_UXRCE_REF_BUFFER_LENGTH)"
    return ""
