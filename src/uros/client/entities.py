"""Publisher, subscription, service and client: what a node has on the ROS network.

Each knows how to create its objects at an agent (``create``), so that a connection can do it again
in every session. They work on anything that has a connection's ``add``, ``create``, ``listen``,
``write`` and ``remove``: a session with an agent, or on a host a middleware.
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
# What a reliable stream had to wait for comes at once, whatever the depth: two windows of it.
_BURST: Final = 32
_RING: Final = WINDOW - 1
# Where the ids of a sample's message are, and the sample.
_IDS: Final = 8
_SAMPLE: Final = 12


class Entity:
    """``name`` is the full ROS name, ``type`` a generated class, ``qos`` a depth or a QoSProfile;
    ``created``: this session's agent was asked for all of it.

    One that ``listens`` has ``on_data(buf, start, stop, little)``, for bytes from the agent.
    """

    # The object kinds that the entity consists of, in the order of their creation.
    kinds = ()  # type: tuple[int, ...]
    listens = False  # whether samples come to it

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

            # Without an agent all of DDS applies.
            self.flags = to_flags(qos, self.kinds[-1] if node.connection.has_agent else 0)
            self.depth = qos.depth
        self.connection: "Any" = node.connection
        self.number: int = self.connection.add(self)

    def object_id(self, kind: int) -> int:
        """The id of one of its objects."""
        return self.number << 4 | kind

    def destroy(self) -> None:
        """Take it off the network, now and in sessions to come."""
        self.created = False
        self.node.forget(self)
        object_ids: "tuple[int, ...]" = ()
        for kind in self.kinds:
            object_ids += (self.object_id(kind),)
        self.connection.remove(self, object_ids)

    def on_lost(self) -> None:
        """The session has ended."""
        self.created = False

    def on_refused(self, request_id: int) -> bool:
        """Return whether it made this request, which the agent refuses."""
        return False

    def create(self, connection: "Any", step: int) -> bool:
        """Make the request of this number, from 0 on, of those that create it: an object each,
        and behind them what has its samples sent. Whether it was the last.
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
        """A topic, a publisher or subscriber, and the writer or reader in it."""
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
    """Sends messages. ``published`` were handed to the session, ``dropped`` were not."""

    kinds = (ids.KIND_TOPIC, ids.KIND_PUBLISHER, ids.KIND_DATAWRITER)

    def __init__(self, node: "Any", name: str, type: "Any", qos: "Any") -> None:
        self.published = 0
        self.dropped = 0
        super().__init__(node, name, type, qos)
        # The type whose messages publish() puts straight into a buffer of the session: none with
        # best effort, and none without an agent.
        self._direct = type if self.flags & ids.QOS_RELIABLE and node.connection.has_agent else None
        # Of a board's classes the codec itself, without what words its errors.
        self._pack: "Any" = getattr(type, "_pack", None) or getattr(type, "pack_into", None)
        number = self.object_id(ids.KIND_DATAWRITER)
        self._id = (number & 0xFF) << 8 | number >> 8  # its octets in the order of the wire

    def publish(self, message: "Any") -> bool:
        """Send a message; never waits. False: no connection, or no room; it is dropped.

        Raises TypeError for a message of another type, what packing raises for a field that does
        not fit, and EncodeError for a message that could never be sent.
        """
        if message.__class__ is self._direct and self.created:
            # What a session's write does, for a sample that goes out at once, in a buffer that is
            # there: a board spends most of its time here.
            session = self.connection
            free = session.free
            buf = session.stack[free]
            if buf is not None:
                try:
                    size = self._pack(message, buf, _SAMPLE, _SAMPLE)
                except Exception:  # the message is at fault, or only longer than this buffer
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
    """An entity with a callback for what has come, oldest first: a handle of an executor.

    ``lost`` counts what was dropped because callbacks were too slow, ``malformed`` what could not
    be read as the type.
    """

    listens = True

    def __init__(self, node: "Any", name: str, type: "Any", qos: "Any") -> None:
        self.invocation = ON_NEW_DATA
        self.lost = 0
        self.malformed = 0
        self._queue: "list[Any]" = []
        super().__init__(node, name, type, qos)

    def is_ready(self, now: int) -> bool:
        return bool(self._queue)

    def next_deadline(self) -> "int | None":
        return None

    def overfull(self) -> bool:
        return len(self._queue) > self.depth

    def _read(self, type: "Any", buf: "Buffer", start: int, stop: int, little: bool) -> "Any":
        """The message in these bytes, or None. What stands behind it is no fault: Fast DDS sends
        some where sequences of doubles at the end are empty.
        """
        try:
            return type.unpack_from(buf, start, start, stop, little)[0]
        except ValueError as error:
            fault = error
        self.malformed += 1
        if self.malformed == 1:
            # Also where the sender has a wrong definition for ever: once. The rest is counted.
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
    """``callback(message)``; with ALWAYS, ``callback(None)`` in rounds without a new one."""

    kinds = (ids.KIND_TOPIC, ids.KIND_SUBSCRIBER, ids.KIND_DATAREADER)

    def __init__(
        self, node: "Any", name: str, type: "Any", qos: "Any", callback: "Callable[[Any], object]"
    ) -> None:
        self.callback = callback
        super().__init__(node, name, type, qos)

    def on_data(self, buf: "Buffer", start: int, stop: int, little: bool) -> None:
        message = self._read(self.type, buf, start, stop, little)
        if message is not None:
            self._keep(message)

    def execute(self, new: bool) -> None:
        self.callback(self._queue.pop(0) if new else None)


def _create_called(end: "Any", connection: "Any", step: int, this: int) -> None:
    """Create either end of a service. No base class has it: that takes 150 bytes of a board."""
    connection.create(
        end, this, end.node.object_id, push_binary_service, end.name,
        _dds_name(end.type.Request), _dds_name(end.type.Response),
        "rq" + end.name + "Request", "rr" + end.name + "Reply",
    )  # fmt: skip


class Service(_Receiver):
    """``callback(request, response)`` gives the response, as with rclpy."""

    kinds = (ids.KIND_REPLIER,)
    _create = _create_called

    def __init__(
        self, node: "Any", name: str, type: "Any", qos: "Any",
        callback: "Callable[[Any, Any], Any]",
    ) -> None:  # fmt: skip
        self.callback = callback
        self._answer: "Any" = None  # (identity, response) that there was no room for
        super().__init__(node, name, type, qos)

    def on_lost(self) -> None:
        # Whoever asked has asked a session that is no more.
        self._queue.clear()
        self._answer = None
        super().on_lost()

    def on_data(self, buf: "Buffer", start: int, stop: int, little: bool) -> None:
        body = start + SAMPLE_IDENTITY_SIZE
        if body > stop:
            self.malformed += 1
            return
        request = self._read(self.type.Request, buf, body, stop, little)
        if request is not None:
            self._keep((bytes(buf[start:body]), request))

    def is_ready(self, now: int) -> bool:
        if self._answer is not None:
            try:
                self._reply()  # there may be room now
            except Exception as error:
                self.node.executor._fail(error)
        return bool(self._queue) and self._answer is None

    def execute(self, new: bool) -> None:
        if not new:  # ALWAYS means nothing without a request
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
    """What a request will come to."""

    def __init__(self) -> None:
        self._done = False
        self._result: "Any" = None
        self._error: "Exception | None" = None
        self._callbacks: "list[Callable[[Future], object]]" = []

    def done(self) -> bool:
        return self._done

    def result(self) -> "Any":
        """The response; None while there is none. Raises what the request failed with."""
        if self._error is not None:
            raise self._error
        return self._result

    def exception(self) -> "Exception | None":
        return self._error

    def add_done_callback(self, callback: "Callable[[Future], object]") -> None:
        """Call ``callback(future)`` when it is done, at once where it is."""
        if self._done:
            callback(self)
        else:
            self._callbacks.append(callback)

    def finish(self, result: "Any", error: "Exception | None" = None) -> None:
        """For the one who made it: this is what it came to."""
        self._done = True
        self._result = result
        self._error = error
        callbacks = self._callbacks
        self._callbacks = []
        for callback in callbacks:
            callback(self)


class Client(_Receiver):
    """Asks a service."""

    kinds = (ids.KIND_REQUESTER,)
    _create = _create_called

    def __init__(self, node: "Any", name: str, type: "Any", qos: "Any") -> None:
        self._pending: "dict[int, Future]" = {}
        super().__init__(node, name, type, qos)

    def call_async(self, request: "Any") -> Future:
        """Send a request. The future fails with OSError where it cannot be sent now, when the
        agent refuses it (its log says why), and when the session ends before the answer.
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
        """Wait no longer for the answer."""
        for number in list(self._pending):
            if self._pending[number] is future:
                del self._pending[number]

    def destroy(self) -> None:
        """As every entity's; requests that wait for an answer fail."""
        super().destroy()
        self.on_lost()
        while self._queue:
            self.execute(True)

    def on_refused(self, request_id: int) -> bool:
        """Fail the call of this request: it has no server. See `Entity.on_refused`."""
        future = self._pending.pop(request_id, None)
        if future is not None:
            self._queue.append((future, None))
        return future is not None

    def on_lost(self) -> None:
        pending = self._pending
        self._pending = {}
        for number in pending:
            self._queue.append((pending[number], None))
        super().on_lost()

    def on_data(self, buf: "Buffer", start: int, stop: int, little: bool) -> None:
        if stop - start < 4:
            self.malformed += 1
            return
        future = self._pending.pop(buf[start] << 8 | buf[start + 1], None)
        if future is not None:
            response = self._read(self.type.Response, buf, start + 4, stop, little)
            self._queue.append((future, response))

    def execute(self, new: bool) -> None:
        if self._queue:
            future, response = self._queue.pop(0)
            error = None
            if response is None:
                error = OSError("%s: lost, refused or malformed" % self.name)
            future.finish(response, error)


def _dds_name(type: "Any") -> str:
    """``std_msgs/msg/Int32`` as DDS knows it. Classes have it too, but a board keeps each text."""
    package, kind, name = type._TYPE.split("/")
    return "%s::%s::dds_::%s_" % (package, kind, name)
