"""Publisher, subscription, service and client of a node.

Each has a method ``create`` for its objects at an agent, which a connection calls in every session.
An entity works with any object that has a connection's ``add``, ``create``, ``listen``, ``write``
and ``remove``: a session with an agent, or on a host the middleware.
"""

from struct import pack_into

from ..wire import ids
from ..wire.cdr import Writer
from ..wire.data import SAMPLE_IDENTITY_SIZE
from ..wire.entities import (
    push_binary_endpoint,
    push_binary_service,
    push_binary_topic,
)
from ..wire.streams import SEQUENCE_MASK, WINDOW
from .executor import ON_NEW_DATA
from .session import FIRST_REQUEST

try:
    from typing import Any, Callable, Final

    from ..wire.cdr import Buffer
except ImportError:  # MicroPython
    pass

_RELIABLE_KEEP_LAST: Final = ids.QOS_RELIABLE | ids.QOS_KEEP_LAST
# Receive queues exceed the depth by two windows, because a reliable stream delivers all messages at
# once that it held back for a missing one.
_BURST: Final = 32
_RING: Final = WINDOW - 1
# Offsets of a message's two ids, and of the sample.
_IDS: Final = 8
_SAMPLE: Final = 12


class Entity:
    """Base class of a node's publishers, subscriptions, services and clients.

    ``created`` says whether all of its objects were requested from this session's agent. A subclass
    with ``listens`` has ``on_data(buf, start, stop, little)`` for samples from the agent.

    Args:
        node: The node.
        name: The full ROS name.
        type: A generated class.
        qos: A depth or a QoSProfile.
    """

    # The object kinds that the entity consists of, in the order of their creation.
    kinds = ()  # type: tuple[int, ...]
    listens = False  # whether it receives samples

    def __init__(self, node: "Any", name: str, type: "Any", qos: "Any") -> None:
        self.node = node
        self.name = name
        self.type = type
        self.qos = qos
        self.created = False
        if isinstance(qos, int):
            if not 0 <= qos <= 0xFFFF:
                raise ValueError("a depth is 0 to 65535, not %d" % qos)
            self.flags = _RELIABLE_KEEP_LAST
            self.depth = qos
        else:
            from ..qos import to_flags

            # Without an agent no policy is limited by XRCE.
            self.flags = to_flags(qos, self.kinds[-1] if node.connection.has_agent else 0)
            self.depth = qos.depth
        self.connection: "Any" = node.connection
        self.number: int = self.connection.add(self)

    def object_id(self, kind: int) -> int:
        """Return the id of the entity's object of this kind."""
        return self.number << 4 | kind

    def destroy(self) -> None:
        """Delete the entity in this session and do not create it in later ones."""
        self.created = False
        self.node.forget(self)
        object_ids: "tuple[int, ...]" = ()
        for kind in self.kinds:
            object_ids += (self.object_id(kind),)
        self.connection.remove(self, object_ids)

    def on_lost(self) -> None:
        """Handle the end of the session."""
        self.created = False

    def on_refused(self, request_id: int) -> bool:
        """Return whether the entity made this request, which the agent refused."""
        return False

    def create(self, connection: "Any", step: int) -> bool:
        """Make request number ``step``, from 0 on, of those that create the entity.

        There is one request for each object, then READ_DATA if the entity listens.

        Returns:
            Whether it was the last request.
        """
        kinds = self.kinds
        last = len(kinds) - (not self.listens)
        if step < len(kinds):
            self._create(connection, step, self.object_id(kinds[step]))
        else:
            connection.listen(self, self.object_id(kinds[-1]), self.flags & ids.QOS_RELIABLE)
        self.created = step == last
        return self.created

    def _create(self, connection: "Any", step: int, this: int) -> None:
        """Request the topic, the publisher or subscriber, or its datawriter or datareader."""
        topic = self.object_id(ids.KIND_TOPIC)
        parent = self.node.object_id
        if step == 0:
            connection.create(
                self, this, parent, push_binary_topic, "rt" + self.name, _dds_name(self.type)
            )
        elif step == 1:
            # No name and no partitions.
            connection.create(self, this, parent, Writer.octets, b"\0\0")
        else:
            qos = self.qos
            known = not isinstance(qos, int)
            connection.create(
                self, this, self.object_id(self.kinds[1]), push_binary_endpoint, topic,
                self.flags, self.depth or None, qos.deadline_ms if known else None,
                qos.lifespan_ms if known else None, None, self.listens,
            )  # fmt: skip


class Publisher(Entity):
    """Sends messages; ``published`` counts those passed to the session, ``dropped`` the others."""

    kinds = (ids.KIND_TOPIC, ids.KIND_PUBLISHER, ids.KIND_DATAWRITER)

    def __init__(self, node: "Any", name: str, type: "Any", qos: "Any") -> None:
        self.published = 0
        self.dropped = 0
        super().__init__(node, name, type, qos)
        # The type whose messages publish() packs directly into a buffer of the session; None for
        # best effort and without an agent.
        self._direct = type if self.flags & ids.QOS_RELIABLE and node.connection.has_agent else None
        # On a board the codec itself, without the wrapper that describes its errors.
        self._pack: "Any" = getattr(type, "_pack", None) or getattr(type, "pack_into", None)
        number = self.object_id(ids.KIND_DATAWRITER)
        self._id = (number & 0xFF) << 8 | number >> 8  # octets in wire order

    def publish(self, message: "Any") -> bool:
        """Send a message; never wait.

        Returns:
            False if the message was dropped: there is no connection, or the send queue is full.

        Raises:
            TypeError: The message is of another type.
            EncodeError: The message is too large to be ever sent. Packing raises for a field out of
                range.
        """
        if message.__class__ is self._direct and self.created:
            # Inlined Session.write for a sample that is sent at once in an existing buffer: a board
            # spends most of its time here.
            session = self.connection
            free = session.free
            buf = session.stack[free]
            if buf is not None:
                try:
                    size = self._pack(message, buf, _SAMPLE, _SAMPLE)
                except Exception:  # a faulty message, or one longer than this buffer
                    pass
                else:
                    number = session.next
                    request = session.request_id
                    pack_into(
                        "<6H", buf, 0, session.id | ids.STREAM_RELIABLE << 8, number,
                        ids.WRITE_DATA | ids.FLAG_LITTLE_ENDIAN << 8, size - _IDS,
                        (request & 0xFF) << 8 | request >> 8, self._id,
                    )  # fmt: skip
                    session.request_id = request + 1 & 0xFFFF or FIRST_REQUEST
                    session.free = free - 1
                    session.slots[number & _RING] = buf
                    session.next = (number + 1) & SEQUENCE_MASK
                    self.published += 1
                    try:
                        session.transport.send(buf, size)
                    except Exception as error:
                        session.unsent(error)
                    return True
        given = getattr(message, "_TYPE", type(message).__name__)
        if given != self.type._TYPE:
            raise TypeError("%s takes %s, not %s" % (self.name, self.type._TYPE, given))
        if self.created and self.connection.write(
            self.object_id(ids.KIND_DATAWRITER), message, b"", self.flags & ids.QOS_RELIABLE
        ):
            self.published += 1
            return True
        self.dropped += 1
        return False


class _Receiver(Entity):
    """Entity with a queue of received items, oldest first; a handle of the executor.

    ``lost`` counts the items dropped because callbacks were too slow, ``malformed`` the samples
    that could not be decoded as the type.
    """

    listens = True

    def __init__(self, node: "Any", name: str, type: "Any", qos: "Any") -> None:
        self.invocation = ON_NEW_DATA
        self.lost = 0
        self.malformed = 0
        self._queue: "list[Any]" = []
        super().__init__(node, name, type, qos)

    def is_ready(self, now: int) -> bool:
        """Return whether an item is queued."""
        return bool(self._queue)

    def next_deadline(self) -> "int | None":
        """Return None: it has no deadline."""
        return None

    def overfull(self) -> bool:
        """Return whether more items are queued than the depth."""
        return len(self._queue) > self.depth

    def _read(self, type: "Any", buf: "Buffer", start: int, stop: int, little: bool) -> "Any":
        """Return the message in these bytes, or None if it is malformed.

        Trailing bytes are ignored: Fast DDS sends some if sequences of doubles at the end are
        empty.
        """
        try:
            return type.unpack_from(buf, start, start, stop, little)[0]
        except ValueError as error:
            fault = error
        self.malformed += 1
        if self.malformed == 1:
            # Reported once, since every sample of a sender with another definition fails; later
            # ones are counted only.
            self.node.executor.report(
                ValueError(
                    "%s: what came is no %s (%s): give both ends the same definition"
                    % (self.name, type._TYPE, fault)
                )
            )
        return None

    def _keep(self, item: "Any") -> None:
        if len(self._queue) >= self.depth + _BURST:
            self._queue.pop(0)
            self.lost += 1
        self._queue.append(item)


class Subscription(_Receiver):
    """Calls ``callback(message)``; with ALWAYS ``callback(None)`` in rounds without a message."""

    kinds = (ids.KIND_TOPIC, ids.KIND_SUBSCRIBER, ids.KIND_DATAREADER)

    def __init__(
        self, node: "Any", name: str, type: "Any", qos: "Any", callback: "Callable[[Any], object]"
    ) -> None:
        self.callback = callback
        super().__init__(node, name, type, qos)

    def on_data(self, buf: "Buffer", start: int, stop: int, little: bool) -> None:
        """Queue a sample."""
        message = self._read(self.type, buf, start, stop, little)
        if message is not None:
            self._keep(message)

    def execute(self, new: bool) -> None:
        """Call the callback with the oldest message, or with None if there is no new one."""
        self.callback(self._queue.pop(0) if new else None)


def _create_called(end: "Any", connection: "Any", step: int, this: int) -> None:
    """Create a client or a service; a common base class would take 150 bytes of a board."""
    connection.create(
        end, this, end.node.object_id, push_binary_service, end.name,
        _dds_name(end.type.Request), _dds_name(end.type.Response),
        "rq" + end.name + "Request", "rr" + end.name + "Reply",
    )  # fmt: skip


class Service(_Receiver):
    """Calls ``callback(request, response)`` and sends the response it returns, as rclpy does."""

    kinds = (ids.KIND_REPLIER,)
    _create = _create_called

    def __init__(
        self, node: "Any", name: str, type: "Any", qos: "Any",
        callback: "Callable[[Any, Any], Any]",
    ) -> None:  # fmt: skip
        self.callback = callback
        self._answer: "Any" = None  # (identity, response) for which the send queue was full
        super().__init__(node, name, type, qos)

    def on_lost(self) -> None:
        """Drop queued requests and the reply: the session they belong to has ended."""
        self._queue.clear()
        self._answer = None
        super().on_lost()

    def on_data(self, buf: "Buffer", start: int, stop: int, little: bool) -> None:
        """Queue a request with its identity."""
        body = start + SAMPLE_IDENTITY_SIZE
        if body > stop:
            self.malformed += 1
            return
        request = self._read(self.type.Request, buf, body, stop, little)
        if request is not None:
            self._keep((bytes(buf[start:body]), request))

    def is_ready(self, now: int) -> bool:
        """Send a reply if the queue was full before; return whether a request can be handled."""
        if self._answer is not None:
            try:
                self._reply()
            except Exception as error:
                self.node.executor._fail(error)
        return bool(self._queue) and self._answer is None

    def execute(self, new: bool) -> None:
        """Call the callback for the oldest request and send its response."""
        if not new:  # ALWAYS has no effect without a request
            return
        identity, request = self._queue.pop(0)
        response = self.callback(request, self.type.Response())
        if response is None:
            raise TypeError("the callback of %s returned no response" % self.name)
        self._answer = (identity, response)
        self._reply()

    def _reply(self) -> None:
        identity, response = self._answer
        self._answer = None
        if not self.connection.write(
            self.object_id(ids.KIND_REPLIER), response, identity, self.flags & ids.QOS_RELIABLE
        ):
            self._answer = (identity, response)


class Future:
    """Result of a request that is not complete yet."""

    def __init__(self) -> None:
        self._done = False
        self._result: "Any" = None
        self._error: "Exception | None" = None
        self._callbacks: "list[Callable[[Future], object]]" = []

    def done(self) -> bool:
        """Return whether there is a result or an error."""
        return self._done

    def result(self) -> "Any":
        """Return the response, or None if not done; raise the error of a failed request."""
        if self._error is not None:
            raise self._error
        return self._result

    def exception(self) -> "Exception | None":
        """Return the error of a failed request, otherwise None."""
        return self._error

    def add_done_callback(self, callback: "Callable[[Future], object]") -> None:
        """Call ``callback(future)`` when the future is done; at once if it is."""
        if self._done:
            callback(self)
        else:
            self._callbacks.append(callback)

    def finish(self, result: "Any", error: "Exception | None" = None) -> None:
        """Set the result or the error and call the callbacks; for the creator of the future."""
        self._done = True
        self._result = result
        self._error = error
        callbacks = self._callbacks
        self._callbacks = []
        for callback in callbacks:
            callback(self)


class Client(_Receiver):
    """Calls a service."""

    kinds = (ids.KIND_REQUESTER,)
    _create = _create_called

    def __init__(self, node: "Any", name: str, type: "Any", qos: "Any") -> None:
        self._pending: "dict[int, Future]" = {}
        super().__init__(node, name, type, qos)

    def call_async(self, request: "Any") -> Future:
        """Send a request and return its future.

        The future fails with OSError if the request cannot be sent now, if the agent refuses it
        (the agent's log says why), and if the session ends before the reply.
        """
        future = Future()
        number = self.created and self.connection.write(
            self.object_id(ids.KIND_REQUESTER), request, b"", self.flags & ids.QOS_RELIABLE
        )
        if number:
            self._pending[number] = future
        else:
            future.finish(None, OSError("%s cannot be asked now" % self.name))
        return future

    def remove_pending_request(self, future: Future) -> None:
        """Stop waiting for the reply to a request."""
        for number in list(self._pending):
            if self._pending[number] is future:
                del self._pending[number]

    def destroy(self) -> None:
        """Destroy the client; pending requests fail."""
        super().destroy()
        self.on_lost()
        while self._queue:
            self.execute(True)

    def on_refused(self, request_id: int) -> bool:
        """Fail the call of this request, which has no server; see `Entity.on_refused`."""
        future = self._pending.pop(request_id, None)
        if future is not None:
            self._queue.append((future, None))
        return future is not None

    def on_lost(self) -> None:
        """Fail all pending requests."""
        pending = self._pending
        self._pending = {}
        for number in pending:
            self._queue.append((pending[number], None))
        super().on_lost()

    def on_data(self, buf: "Buffer", start: int, stop: int, little: bool) -> None:
        """Queue the reply to a pending request."""
        if stop - start < 4:
            self.malformed += 1
            return
        future = self._pending.pop(buf[start] << 8 | buf[start + 1], None)
        if future is not None:
            response = self._read(self.type.Response, buf, start + 4, stop, little)
            self._queue.append((future, response))

    def execute(self, new: bool) -> None:
        """Finish the future of the oldest reply."""
        if self._queue:
            future, response = self._queue.pop(0)
            error = None
            if response is None:
                error = OSError("%s: lost, refused or malformed" % self.name)
            future.finish(response, error)


def _dds_name(type: "Any") -> str:
    """Return the DDS type name of a type, as for ``std_msgs/msg/Int32``.

    Generated classes have this name too, but on a board each string takes memory.
    """
    package, kind, name = type._TYPE.split("/")
    return "%s::%s::dds_::%s_" % (package, kind, name)
