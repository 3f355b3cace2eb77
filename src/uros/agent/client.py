"""One client: its session, its objects, and the rules of creating them.

Creating an object whose id exists (XRCE 7.8.3, table 7):

=========  ===========  ==========================================
REUSE      REPLACE      outcome
=========  ===========  ==========================================
no         no           ERR_ALREADY_EXISTS
no         yes          the old one is deleted, the new one made
yes        no           OK_MATCHED if equal, else ERR_MISMATCH
yes        yes          OK_MATCHED if equal, else replaced
=========  ===========  ==========================================

Equal means the same specification, in whichever format it came. An object
outlives its parent as a number, as with the C++ agent, so that a client may
delete in any order; its endpoint does not outlive the participant. An object
that lost its endpoint so is made anew where it would be reused.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from typing import Protocol

from ..middleware.base import Middleware, MiddlewareError, Node, Writer
from ..wire import data, entities, ids
from ..wire import session as messages
from ..wire.cdr import Reader
from ..wire.errors import DecodeError
from ..wire.streams import ticks_diff
from . import representation
from .delivery import Delivery
from .endpoint import ReaderEndpoint, ReplierEndpoint, RequesterEndpoint
from .log import INFO, TRACE, WARNING, Log, RateLimit
from .profiles import ProfileError, References
from .representation import (
    EndpointSpec,
    GroupSpec,
    ParticipantSpec,
    Spec,
    TopicSpec,
    UnknownReference,
)
from .session import Session

Endpoint = ReaderEndpoint | RequesterEndpoint | ReplierEndpoint | Writer

# The domain that asks for the agent's own (XRCE_DOMAIN_ID_OVERRIDE).
DOMAIN_FROM_AGENT = 255
# Attack: a client that creates all 65536 objects its ids can name.
MAX_OBJECTS = 4096
# Attack: one client takes the places of all on the network, which holds some thousand
# nodes at most, or starts all 233 domains.
MAX_PARTICIPANTS = 32

# Topics, requests and replies of ROS 2 (design.ros2.org, "Topic and Service name mapping").
_ROS_PREFIXES = ("rt/", "rq/", "rr/")

_KIND_NAMES = {
    ids.KIND_PARTICIPANT: "participant",
    ids.KIND_TOPIC: "topic",
    ids.KIND_PUBLISHER: "publisher",
    ids.KIND_SUBSCRIBER: "subscriber",
    ids.KIND_DATAWRITER: "datawriter",
    ids.KIND_DATAREADER: "datareader",
    ids.KIND_REQUESTER: "requester",
    ids.KIND_REPLIER: "replier",
}
_WITH_NODE = (
    ids.KIND_PARTICIPANT,
    ids.KIND_DATAWRITER,
    ids.KIND_DATAREADER,
    ids.KIND_REQUESTER,
    ids.KIND_REPLIER,
)
_PARENT_KINDS = {
    ids.KIND_DATAWRITER: ids.KIND_PUBLISHER,
    ids.KIND_DATAREADER: ids.KIND_SUBSCRIBER,
}


class Surroundings(Protocol):
    """What a client needs of the agent it belongs to."""

    log: Log
    faults: RateLimit
    middleware: Middleware
    references: References
    domain_of_agent: int
    domain_override: int | None

    def delete_client(self, key: int) -> bool:
        """Forget a client; whether there was one."""

    def attend(self, session: Session) -> None:
        """The session has something to send, or a new deadline."""

    def now(self) -> int:
        """Milliseconds modulo 2^30."""


@dataclass(eq=False)
class XrceObject:
    """An object of the client; ``node`` on participants and on what has an ``endpoint``."""

    object_id: int
    parent: int
    spec: Spec
    node: Node | None = None
    endpoint: Endpoint | None = None
    delivery: Delivery | None = None

    @property
    def kind(self) -> int:
        return self.object_id & 0x0F

    @property
    def orphaned(self) -> bool:
        """Whether its participant, and its endpoint with it, was deleted."""
        return self.node is None and self.kind in _WITH_NODE


class _TooMany(Exception):
    """More objects than one client may have."""


def object_label(object_id: int) -> str:
    """As in the C++ agent's log: number and kind, ``0x000(5)``."""
    return f"0x{object_id >> 4:03X}({object_id & 15})"


class Client:
    """See the module."""

    def __init__(self, agent: Surroundings, key: int, session_id: int, mtu: int) -> None:
        self.key = key
        self.session = Session(key, session_id, mtu, self)
        self.objects: dict[int, XrceObject] = {}
        self.closed = False
        self._agent = agent

    # --- what the session reports ---------------------------------------------

    def submessage(self, kind: int, flags: int, stream: int, payload: memoryview) -> bool:
        """See :class:`~uros.agent.session.Handler`."""
        if self.closed:
            return True  # it said goodbye in the same message: nothing may be made after
        r = Reader(payload, 0, len(payload), bool(flags & ids.FLAG_LITTLE_ENDIAN))
        if kind == ids.WRITE_DATA:
            return self._write_data(flags, payload)
        if kind == ids.READ_DATA:
            self._read_data(r)
        elif kind == ids.CREATE:
            self._create(r, flags, stream)
        elif kind == ids.DELETE:
            self._delete(r, stream)
        elif kind == ids.GET_INFO:
            self._get_info(r)
        elif kind == ids.TIMESTAMP:
            self._timestamp(r)
        elif kind == ids.INFO:
            pass  # the answer to a probe: being heard is all it is for
        else:
            raise DecodeError(f"submessage {kind} is not for an agent")
        return True

    def room(self, stream: int) -> None:
        now = self._agent.now()
        for thing in self.objects.values():
            if thing.delivery is not None and thing.delivery.stream_id == stream:
                self._pump(thing, now)

    def fault(self, what: str, about: str) -> None:
        times = self._agent.faults.times(f"{self.key:08X} {what}")
        if times is not None:
            self._log(WARNING, "Session", "receive", what, f"{about}{times}")

    def next_deadline(self) -> int | None:
        """When :meth:`poll` has something to do, or None."""
        deadline = self.session.next_deadline()
        for thing in self.objects.values():
            if thing.delivery is not None:
                at = thing.delivery.next_deadline()
                if at is not None and (deadline is None or ticks_diff(at, deadline) < 0):
                    deadline = at
        return deadline

    def poll(self, now: int) -> None:
        """Do what is due."""
        self.session.poll(now)
        for thing in self.objects.values():
            if thing.delivery is not None and thing.delivery.next_deadline() is not None:
                self._pump(thing, now)

    def close(self) -> None:
        """Delete all objects, endpoints before participants."""
        self.closed = True
        for thing in reversed(list(self.objects.values())):
            self._close_object(thing)
        self.objects.clear()
        self.session.writers.clear()

    # --- CREATE and DELETE -----------------------------------------------------

    def _create(self, r: Reader, flags: int, stream: int) -> None:
        request_id, object_id, kind, form, content, parent = entities.pull_create(r)
        try:
            status = self._create_object(
                object_id, kind, form, content, parent, r.little, flags
            )
        except UnknownReference as error:
            status = ids.STATUS_ERR_UNKNOWN_REFERENCE
            self._refused(kind, object_id, str(error))
        except (DecodeError, ProfileError) as error:
            status = ids.STATUS_ERR_INVALID_DATA
            self._refused(kind, object_id, str(error))
        except _TooMany as error:
            status = ids.STATUS_ERR_RESOURCES
            self._refused(kind, object_id, str(error))
        except MiddlewareError as error:
            status = ids.STATUS_ERR_DDS_ERROR
            self._refused(kind, object_id, str(error))
        self._status(request_id, object_id, status, stream)

    def _refused(self, kind: int, object_id: int, why: str) -> None:
        name = _KIND_NAMES.get(kind, f"kind {kind}")
        self._log(
            WARNING, "ProxyClient", f"create_{name}", f"{name} refused",
            f"object_id: {object_label(object_id)}, {why}",
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
        if kind not in _KIND_NAMES:
            raise DecodeError(f"objects of kind {kind} cannot be created")
        spec = representation.parse(
            kind, form, content, parent, little, self._agent.references
        )
        old = self.objects.get(object_id)
        if old is not None:
            reuse, replace = flags & ids.FLAG_REUSE, flags & ids.FLAG_REPLACE
            if not reuse and not replace:
                return ids.STATUS_ERR_ALREADY_EXISTS
            if reuse and not old.orphaned:
                if old.spec == spec and old.parent == self._parent_id(kind, parent):
                    return ids.STATUS_OK_MATCHED
                if not replace:
                    return ids.STATUS_ERR_MISMATCH
            self._close_object(old)
            del self.objects[object_id]
        elif len(self.objects) >= MAX_OBJECTS:
            raise _TooMany(f"over {MAX_OBJECTS} objects")
        elif kind == ids.KIND_PARTICIPANT and MAX_PARTICIPANTS <= sum(
            it.kind == kind for it in self.objects.values()
        ):
            raise _TooMany(f"over {MAX_PARTICIPANTS} participants")
        thing = XrceObject(object_id, self._parent_id(kind, parent), spec)
        about = self._make(thing)
        self.objects[object_id] = thing
        name = _KIND_NAMES[kind]
        self._log(
            INFO, "ProxyClient", f"create_{name}", f"{name} created",
            f"{name}_id: {object_label(object_id)}{about}",
        )  # fmt: skip
        return ids.STATUS_OK

    def _parent_id(self, kind: int, parent: int) -> int:
        if kind == ids.KIND_PARTICIPANT:
            return 0
        return (parent & 0xFFF0) | _PARENT_KINDS.get(kind, ids.KIND_PARTICIPANT)

    def _make(self, thing: XrceObject) -> str:
        """Bring the object to life; what the log says of it besides its id."""
        spec = thing.spec
        if isinstance(spec, ParticipantSpec):
            domain = self._domain(spec)
            thing.node = self._make_node(spec, domain)
            return f", domain_id: {domain}"
        parent = self.objects.get(thing.parent)
        if parent is None:
            raise UnknownReference(
                f"its {_KIND_NAMES[thing.parent & 15]} {object_label(thing.parent)} does not exist"
            )
        about = f", {_KIND_NAMES[parent.kind]}_id: {object_label(parent.object_id)}"
        if isinstance(spec, TopicSpec) and not spec.name.startswith(_ROS_PREFIXES):
            self._log(
                INFO, "ProxyClient", "create_topic", "not a ROS topic",
                f"topic: {spec.name}, ROS 2 nodes see names that begin with rt/ only",
            )  # fmt: skip
        if isinstance(spec, (TopicSpec, GroupSpec)):
            return about
        node = self._node_of(parent)
        if isinstance(spec, EndpointSpec):
            thing.endpoint = self._make_endpoint(thing, spec, parent, node)
        elif thing.kind == ids.KIND_REQUESTER:
            thing.endpoint = RequesterEndpoint(
                node, spec, thing.object_id, self._on_ready(thing)
            )
        else:
            thing.endpoint = ReplierEndpoint(node, spec, self._on_ready(thing))
        thing.node = node
        return about

    def _domain(self, spec: ParticipantSpec) -> int:
        if self._agent.domain_override is not None:
            return self._agent.domain_override
        return self._agent.domain_of_agent if spec.domain == DOMAIN_FROM_AGENT else spec.domain

    def _make_node(self, spec: ParticipantSpec, domain: int) -> Node:
        namespace, name = node_name(spec.name)
        return self._agent.middleware.create_node(domain, namespace, name, spec.localhost_only)

    def _node_of(self, thing: XrceObject) -> Node:
        participant = thing
        if thing.kind != ids.KIND_PARTICIPANT:
            found = self.objects.get(thing.parent)
            if found is None:
                raise UnknownReference(
                    f"its participant {object_label(thing.parent)} does not exist"
                )
            participant = found
        assert participant.node is not None
        return participant.node

    def _make_endpoint(
        self, thing: XrceObject, spec: EndpointSpec, group: XrceObject, node: Node
    ) -> Endpoint:
        topic = self._topic(spec)
        qos = copy(spec.qos)
        if isinstance(group.spec, GroupSpec) and group.spec.partitions and not qos.partitions:
            qos.partitions = group.spec.partitions
        if thing.kind == ids.KIND_DATAREADER:
            return ReaderEndpoint(node, topic.name, topic.type_name, qos, self._on_ready(thing))
        writer = node.create_writer(topic.name, topic.type_name, qos)
        self.session.writers[thing.object_id] = writer.write
        return writer

    def _topic(self, spec: EndpointSpec) -> TopicSpec:
        if spec.topic_id is not None:
            topic_id = (spec.topic_id & 0xFFF0) | ids.KIND_TOPIC
            found = self.objects.get(topic_id)
            if found is None or not isinstance(found.spec, TopicSpec):
                raise UnknownReference(f"its topic {object_label(topic_id)} does not exist")
            return found.spec
        assert spec.topic is not None
        for thing in self.objects.values():
            if isinstance(thing.spec, TopicSpec) and thing.spec.name == spec.topic.name:
                return thing.spec
        if not spec.topic.type_name:
            raise UnknownReference(f"the type of topic {spec.topic.name!r} is not known")
        return spec.topic

    def _on_ready(self, thing: XrceObject) -> Callable[[], None]:
        def ready() -> None:
            if thing.delivery is not None:
                self._pump(thing, self._agent.now())
                self._agent.attend(self.session)

        return ready

    def _delete(self, r: Reader, stream: int) -> None:
        request_id, object_id = messages.pull_request(r)
        if object_id & 0x0F == ids.KIND_CLIENT:
            known = self._agent.delete_client(self.key)
            status = ids.STATUS_OK if known else ids.STATUS_ERR_UNKNOWN_REFERENCE
            self.session.answer(
                ids.STATUS, ids.STREAM_NONE, self._agent.now(),
                lambda w: messages.push_status(w, request_id, object_id, status),
            )  # fmt: skip
            return
        thing = self.objects.pop(object_id, None)
        if thing is None:
            status = ids.STATUS_ERR_UNKNOWN_REFERENCE
        else:
            status = ids.STATUS_OK
            self._close_object(thing)
            self._log(
                INFO + 1, "ProxyClient", "delete_object", "object deleted",
                f"object_id: 0x{object_id:04X}",
            )  # fmt: skip
        self._status(request_id, object_id, status, stream)

    def _close_object(self, thing: XrceObject) -> None:
        thing.delivery = None
        self.session.writers.pop(thing.object_id, None)
        if thing.endpoint is not None:
            thing.endpoint.close()
            thing.endpoint = None
        node, thing.node = thing.node, None
        if node is not None and thing.kind == ids.KIND_PARTICIPANT:
            for child in self.objects.values():
                if child.node is node:
                    self._close_object(child)
            node.close()

    # --- data ------------------------------------------------------------------

    def _write_data(self, flags: int, payload: memoryview) -> bool:
        """Requests, replies, and what the session's hot path did not take."""
        if len(payload) < data.REQUEST_SIZE:
            raise DecodeError(f"WRITE_DATA of {len(payload)} bytes")
        if flags & ids.FORMAT_MASK:
            raise DecodeError(f"data format 0x{flags & ids.FORMAT_MASK:02X} is not supported")
        object_id = payload[2] << 8 | payload[3]
        thing = self.objects.get(object_id)
        if thing is not None and isinstance(thing.endpoint, (RequesterEndpoint, ReplierEndpoint)):
            try:
                return thing.endpoint.write(flags, payload)
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
        now = self._agent.now()
        thing = self.objects.get(object_id)
        status = ids.STATUS_OK
        if thing is None or thing.endpoint is None or isinstance(thing.endpoint, Writer):
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
        assert thing is not None
        assert thing.endpoint is not None and not isinstance(thing.endpoint, Writer)
        if control is not None and control[0] == 0:
            thing.delivery = None
            # C clients wait a second for this and the C++ agent never sends it;
            # best effort, so that the numbers of the reliable stream stay as there.
            self._status(request_id, object_id, ids.STATUS_OK, ids.STREAM_BEST_EFFORT)
            return
        thing.delivery = Delivery(
            self.session, thing.endpoint, request_id, object_id, stream_id, control, now
        )
        self._pump(thing, now)

    def _pump(self, thing: XrceObject, now: int) -> None:
        delivery = thing.delivery
        if delivery is None:
            return
        try:
            delivery.pump(now)
        except (DecodeError, MiddlewareError) as error:
            # The middleware calls us for all clients in turn: theirs must not fail with ours.
            thing.delivery = None
            self.fault("delivery ended", f"{object_label(thing.object_id)}, {error}")
            return
        if delivery.finished(now):
            thing.delivery = None

    # --- the rest --------------------------------------------------------------

    def _get_info(self, r: Reader) -> None:
        request_id, object_id, _ = messages.pull_get_info(r)
        self.session.answer(
            ids.INFO, ids.STREAM_NONE, self._agent.now(),
            lambda w: messages.push_info(w, request_id, object_id, ids.STATUS_OK, 1, []),
        )  # fmt: skip

    def _timestamp(self, r: Reader) -> None:
        received = divmod(time.time_ns(), 1_000_000_000)
        originate = messages.pull_timestamp(r)
        self.session.answer(
            ids.TIMESTAMP_REPLY, ids.STREAM_NONE, self._agent.now(),
            lambda w: messages.push_timestamp_reply(
                w, divmod(time.time_ns(), 1_000_000_000), received, originate
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

    def _log(self, level: int, part: str, function: str, what: str, about: str) -> None:
        if level <= self._agent.log.level <= TRACE:
            self._agent.log(
                level, part, function, what, f"client_key: 0x{self.key:08X}, {about}"
            )


_BAD_IN_NAME = re.compile(r"[^A-Za-z0-9_]")


def node_name(given: str | None) -> tuple[str, str]:
    """``(namespace, name)`` of the ROS node a participant's name stands for.

    micro-ROS gives ``namespace/name``; characters that ROS names cannot have
    become underscores, and no name at all becomes ``xrce_client``.
    """
    parts = [part for part in (given or "").split("/") if part]
    clean = []
    for part in parts or ["xrce_client"]:
        word = _BAD_IN_NAME.sub("_", part)
        clean.append("_" + word if word[0].isdigit() else word)
    return "/" + "/".join(clean[:-1]), clean[-1]
