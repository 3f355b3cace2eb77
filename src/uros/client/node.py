"""The node: what a program on a board holds in its hand."""

from ..ticks import ticks_us
from ..wire import ids
from ..wire.entities import push_binary_participant
from ..wire.streams import ticks_add, ticks_diff
from .connection import AGENT_AVAILABLE, Connection
from .entities import Client, Publisher, Service, Subscription
from .executor import Executor, Timer

try:
    from typing import Any, Callable, Final, Iterator

    from .clock import Clock
    from .connection import Transport
    from .entities import Future
except ImportError:  # MicroPython
    pass

_LONGEST_MS: Final = 0x1FFFFFFF
_LONGEST_NAME: Final = 200


class Node:
    """A ROS 2 node. Names follow rclpy, the executor's rules rclc; nothing ever waits for the
    agent but what says so.

    ``transport`` is the board's line (``uros.transport``), or the ``connection`` of another node
    to share its session. ``key`` is the client key, of 32 bits: the default is made of the board's
    own id, so that an agent knows a board again after a reset. Other ``options`` are those of
    :class:`~uros.client.connection.Connection`.
    """

    kinds = (ids.KIND_PARTICIPANT,)

    def __init__(
        self,
        name: str,
        transport: "Transport | Connection",
        namespace: str = "",
        domain_id: int = 0,
        key: "int | None" = None,
        **options: "Any",
    ) -> None:
        self.name = check_name(name, "a node's name", 0)
        space = namespace.strip("/")
        self.namespace = "/" + (check_name(space, "a namespace") if space else "")
        self.domain_id = domain_id
        self.executor = Executor()
        self.connection: "Any" = transport
        self._owner = False
        if not hasattr(transport, "pump"):
            self._owner = True
            self.connection = Connection(
                transport, board_key(name) if key is None else key, **options
            )
        # Ticks, and the time since 1970: ``node.clock.stamp(message.header.stamp)``.
        self.clock: "Clock" = self.connection.clock
        self._entities: "list[Any]" = []
        self._more = False  # the last round had something to do
        self.object_id = self.connection.add(self) << 4 | ids.KIND_PARTICIPANT

    # --- what a connection asks of its entities ---------------------------------------------

    def create(self, connection: "Any") -> "Iterator[None]":
        name = self.name if self.namespace == "/" else self.namespace + "/" + self.name
        connection.create(
            self, self.object_id, self.domain_id, push_binary_participant, name, None
        )
        yield

    def on_lost(self) -> None:
        """The session has ended: there is nothing to keep."""

    # --- as rclpy has it ----------------------------------------------------------------------

    def get_name(self) -> str:
        return self.name

    def get_namespace(self) -> str:
        """``"/"`` for the root."""
        return self.namespace

    def get_fully_qualified_name(self) -> str:
        return self.resolve(self.name)

    def create_publisher(self, msg_type: "Any", topic: str, qos_profile: "Any" = 10) -> Publisher:
        """``qos_profile`` is a depth (reliable, volatile), or a QoSProfile."""
        publisher = Publisher(self, self._topic(topic, msg_type), msg_type, qos_profile)
        self._entities.append(publisher)
        return publisher

    def create_subscription(
        self, msg_type: "Any", topic: str, callback: "Callable[[Any], object]",
        qos_profile: "Any" = 10,
    ) -> Subscription:  # fmt: skip
        name = self._topic(topic, msg_type)
        subscription = Subscription(self, name, msg_type, qos_profile, callback)
        self._add(subscription)
        return subscription

    def create_service(
        self, srv_type: "Any", srv_name: str, callback: "Callable[[Any, Any], Any]"
    ) -> Service:
        name = self._topic(srv_name, srv_type.Request)
        service = Service(self, name, srv_type, 10, callback)
        self._add(service)
        return service

    def create_client(self, srv_type: "Any", srv_name: str) -> Client:
        client = Client(self, self._topic(srv_name, srv_type.Request), srv_type, 10)
        self._add(client)
        return client

    def create_timer(self, timer_period_sec: float, callback: "Callable[[], object]") -> Timer:
        timer = Timer(timer_period_sec, callback, self.clock)
        self.executor.add(timer)
        return timer

    def destroy_timer(self, timer: Timer) -> None:
        self.executor.remove(timer)

    def destroy_node(self) -> None:
        """Take leave of the agent and close the transport; where those are another node's,
        delete what is ours."""
        if self._owner:
            for entity in list(self._entities):
                self.forget(entity)
            self.connection.close()
        else:
            for entity in reversed(list(self._entities)):
                entity.destroy()
            self.connection.remove(self, (self.object_id,))

    # --- the rest ---------------------------------------------------------------------------

    @property
    def state(self) -> int:
        """WAITING_AGENT, AGENT_AVAILABLE, AGENT_CONNECTED or AGENT_DISCONNECTED."""
        state: int = self.connection.state
        return state

    @property
    def on_state(self) -> "Callable[[int], object] | None":
        """Called with each new state."""
        return self.connection.on_state  # type: ignore[no-any-return]

    @on_state.setter
    def on_state(self, callback: "Callable[[int], object] | None") -> None:
        self.connection.on_state = callback

    def resolve(self, name: str) -> str:
        """The full name of ``name``: absolute, relative to the namespace, or private (``~/x``)."""
        if name.startswith("/"):
            return name
        space = "" if self.namespace == "/" else self.namespace
        if name == "~" or name.startswith("~/"):
            return space + "/" + self.name + name[1:]
        return space + "/" + name

    def _topic(self, name: str, type: "Any") -> str:
        full = self.resolve(name)
        check_name(full[1:], "a topic's or service's name")
        return full

    def _add(self, entity: "Any") -> None:
        try:
            self.executor.add(entity)
        except ValueError:
            self.connection.remove(entity, ())  # not half of it
            raise
        self._entities.append(entity)

    def forget(self, entity: "Any") -> None:
        """The entity is being destroyed: it is called back no more."""
        self._entities.remove(entity)
        self.executor.remove(entity)

    def spin_once(self, timeout_sec: "float | None" = None) -> bool:
        """Run one round of callbacks, waiting for something to do at most so long (None: for
        ever); whether there was one. While entities are created it returns every time that
        something has come: what that leaves behind in memory can then be collected."""
        executor = self.executor
        end = None
        if timeout_sec is not None:
            end = ticks_add(self.clock.ms(), min(int(timeout_sec * 1000), _LONGEST_MS))
        while True:
            now = self.clock.ms()
            if not (self._more and self._overfull()):
                wait = 0
                if not self._more:
                    wait = executor.wait(now)
                    if end is not None:
                        wait = min(wait, ticks_diff(end, now))
                self.connection.pump(max(0, wait))
                now = self.clock.ms()
            self._more = executor.execute(now) > 0
            if (
                self._more
                or self.connection.state == AGENT_AVAILABLE
                or (end is not None and ticks_diff(now, end) >= 0)
            ):
                return self._more

    def _overfull(self) -> bool:
        return any([entity.overfull() for entity in self._entities])

    def spin(self) -> None:
        """Spin for ever."""
        while True:
            self.spin_once()

    def spin_until_future_complete(self, future: "Future", timeout_sec: float = 10.0) -> bool:
        """Spin until the future is done, or the time is up; whether it is done."""
        end = ticks_add(self.clock.ms(), int(timeout_sec * 1000))
        while not future.done() and ticks_diff(end, self.clock.ms()) > 0:
            self.spin_once(ticks_diff(end, self.clock.ms()) / 1000)
        return future.done()


def check_name(name: str, what: str, slashes: int = 1) -> str:
    """The name, if ROS allows it. Raises ValueError with the rule that it breaks."""
    fault = ""
    if not name or len(name) > _LONGEST_NAME:
        fault = "has 1 to %d characters" % _LONGEST_NAME
    elif "/" in name and not slashes:
        fault = "has no slash"
    else:
        for part in name.split("/"):
            if not part or "0" <= part[0] <= "9" or "__" in part:
                fault = "has parts that begin with a letter, without __, between single slashes"
            for char in part:
                if not (
                    "a" <= char <= "z" or "A" <= char <= "Z" or "0" <= char <= "9" or char == "_"
                ):
                    fault = "is of letters, digits and _"
    if fault:
        raise ValueError("%r: %s %s" % (name, what, fault))
    return name


def board_key(name: str) -> int:
    """A client key from the board's unique id and the node's name, or a random one."""
    try:
        from machine import unique_id  # type: ignore[import-not-found]

        seed = unique_id() + name.encode()
    except ImportError:
        try:
            from os import urandom

            seed = urandom(8)
        except ImportError:
            seed = name.encode() + ticks_us().to_bytes(4, "little")
    key = 0x811C9DC5  # FNV-1a
    for octet in seed:
        key = (key ^ octet) * 0x01000193 & 0xFFFFFFFF
    return key or 1
