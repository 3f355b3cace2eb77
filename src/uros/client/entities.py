"""Publisher, subscription, service and client: what a node has on the ROS network.

Each knows how to create its objects at an agent (``create``), so that a connection can do it again
in every session. They work on anything that has a connection's ``add``, ``create``, ``listen``,
``write`` and ``remove``: a session with an agent, or on a host a middleware.
"""

from ..wire import ids
from ..wire.data import SAMPLE_IDENTITY_SIZE
from ..wire.entities import (
    push_binary_endpoint,
    push_binary_group,
    push_binary_service,
    push_binary_topic,
)
from .executor import ON_NEW_DATA

try:
    from typing import Any, Callable, Final, Iterator

    from ..wire.cdr import Buffer
except ImportError:  # MicroPython
    pass

_RELIABLE_KEEP_LAST: Final = ids.QOS_RELIABLE | ids.QOS_KEEP_LAST
# What a reliable stream had to wait for comes at once, whatever the depth: two windows of it.
_BURST: Final = 32


class Entity:
    """``name`` is the full ROS name, ``type`` a generated class, ``qos`` a depth or a QoSProfile;
    ``created``: this session's agent was asked for all of it."""

    # The object kinds that the entity consists of, in the order of their creation.
    kinds = ()  # type: tuple[int, ...]

    def __init__(self, node: "Any", name: str, type: "Any", qos: "Any") -> None:
        self.node = node
        self.name = name
        self.type = type
        self.qos = qos
        self.created = False
        if isinstance(qos, int):
            self.flags = _RELIABLE_KEEP_LAST
            self.depth = qos
        else:
            from ..qos import to_flags

            self.flags = to_flags(qos)
            self.depth = qos.depth
        self.number: int = node.connection.add(self)

    def object_id(self, kind: int) -> int:
        """The id of one of its objects."""
        return self.number << 4 | kind

    def destroy(self) -> None:
        """Take it off the network, now and in sessions to come."""
        self.created = False
        self.node.forget(self)
        self.node.connection.remove(self, tuple([self.object_id(kind) for kind in self.kinds]))

    def on_lost(self) -> None:
        """The session has ended."""
        self.created = False

    def on_data(self, buf: "Buffer", start: int, stop: int, little: bool) -> None:
        """Bytes from the agent for this entity."""

    def overfull(self) -> bool:
        """Whether more waits for callbacks than should."""
        return False

    def _create_endpoint(self, connection: "Any", group: int, kind: int) -> "Iterator[None]":
        topic = self.object_id(ids.KIND_TOPIC)
        connection.create(
            self, topic, self.node.object_id, push_binary_topic, "rt" + self.name,
            _dds_name(self.type),
        )  # fmt: skip
        yield
        connection.create(
            self, self.object_id(group), self.node.object_id, push_binary_group, None, None
        )
        yield
        qos = self.qos
        known = not isinstance(qos, int)
        connection.create(
            self, self.object_id(kind), self.object_id(group), push_binary_endpoint, topic,
            self.flags, self.depth, qos.deadline_ms if known else None,
            qos.lifespan_ms if known else None, None, kind == ids.KIND_DATAREADER,
        )  # fmt: skip
        yield

    def _create_service(self, connection: "Any", kind: int) -> "Iterator[None]":
        connection.create(
            self, self.object_id(kind), self.node.object_id, push_binary_service, self.name,
            _dds_name(self.type.Request), _dds_name(self.type.Response),
            "rq" + self.name + "Request", "rr" + self.name + "Reply",
        )  # fmt: skip
        yield


class Publisher(Entity):
    """Sends messages. ``published`` were handed to the session, ``dropped`` were not."""

    kinds = (ids.KIND_TOPIC, ids.KIND_PUBLISHER, ids.KIND_DATAWRITER)

    def __init__(self, node: "Any", name: str, type: "Any", qos: "Any") -> None:
        self.published = 0
        self.dropped = 0
        super().__init__(node, name, type, qos)

    def create(self, connection: "Any") -> "Iterator[None]":
        yield from self._create_endpoint(connection, ids.KIND_PUBLISHER, ids.KIND_DATAWRITER)
        self.created = True

    def publish(self, message: "Any") -> bool:
        """Send a message; never waits. False: no connection, or no room; it is dropped.

        Raises TypeError for a message of another type, what packing raises for a field that does
        not fit, and EncodeError for a message that could never be sent.
        """
        given = getattr(message, "_TYPE", type(message).__name__)
        if given != self.type._TYPE:
            raise TypeError("%s takes %s, not %s" % (self.name, self.type._TYPE, given))
        if self.created and self.node.connection.write(
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
        """The message in these bytes, or None."""
        try:
            return type.unpack_from(buf, start, start, stop, little)[0]
        except ValueError:
            self.malformed += 1
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

    def create(self, connection: "Any") -> "Iterator[None]":
        yield from self._create_endpoint(connection, ids.KIND_SUBSCRIBER, ids.KIND_DATAREADER)
        connection.listen(
            self, self.object_id(ids.KIND_DATAREADER), self.flags & ids.QOS_RELIABLE
        )
        self.created = True

    def on_data(self, buf: "Buffer", start: int, stop: int, little: bool) -> None:
        message = self._read(self.type, buf, start, stop, little)
        if message is not None:
            self._keep(message)

    def execute(self, new: bool) -> None:
        self.callback(self._queue.pop(0) if new else None)


class Service(_Receiver):
    """``callback(request, response)`` gives the response, as with rclpy."""

    kinds = (ids.KIND_REPLIER,)

    def __init__(
        self, node: "Any", name: str, type: "Any", qos: "Any",
        callback: "Callable[[Any, Any], Any]",
    ) -> None:  # fmt: skip
        self.callback = callback
        self._answer: "Any" = None  # (identity, response) that there was no room for
        super().__init__(node, name, type, qos)

    def create(self, connection: "Any") -> "Iterator[None]":
        yield from self._create_service(connection, ids.KIND_REPLIER)
        connection.listen(self, self.object_id(ids.KIND_REPLIER), True)
        self.created = True

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
            self._reply()  # there may be room now
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
        if not self.node.connection.write(
            self.object_id(ids.KIND_REPLIER), response, identity, True
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

    def __init__(self, node: "Any", name: str, type: "Any", qos: "Any") -> None:
        self._pending: "dict[int, Future]" = {}
        super().__init__(node, name, type, qos)

    def create(self, connection: "Any") -> "Iterator[None]":
        yield from self._create_service(connection, ids.KIND_REQUESTER)
        connection.listen(self, self.object_id(ids.KIND_REQUESTER), True)
        self.created = True

    def call_async(self, request: "Any") -> Future:
        """Send a request. The future fails with OSError where it cannot be sent now, and when
        the session ends before the answer."""
        future = Future()
        number = self.created and self.node.connection.write(
            self.object_id(ids.KIND_REQUESTER), request, b"", True
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
                error = OSError("%s: the agent was lost, or its answer malformed" % self.name)
            future.finish(response, error)


def _dds_name(type: "Any") -> str:
    """``std_msgs/msg/Int32`` as DDS knows it. Classes have it too, but a board keeps each text."""
    package, kind, name = type._TYPE.split("/")
    return "%s::%s::dds_::%s_" % (package, kind, name)
