"""The ROS 2 node of a board's program."""

from ..ticks import ticks_add, ticks_diff, ticks_us
from ..wire import ids
from ..wire.entities import push_binary_participant
from .connection import AGENT_AVAILABLE, Connection
from .entities import Client, Publisher, Service, Subscription
from .executor import Executor, Timer

try:
    from typing import Any, Callable, Final

    from .clock import Clock
    from .entities import Future
    from .parameter import Parameter
    from .parameters import ParameterServer
    from .protocols import NodeConnection, Transport
    from .rosout import Logger, Rosout
except ImportError:  # MicroPython
    pass

_LONGEST_MS: Final = 0x1FFFFFFF
_SERVE_MS: Final = 20
_LONGEST_NAME: Final = 200


class Node:
    """ROS 2 node of a board.

    Names follow rclpy, the executor's rules rclc. No method waits for the agent unless its
    description says so. Other ``options`` are those of :class:`~uros.client.connection.Connection`.

    Args:
        name: The node's name.
        transport: The board's transport (``uros.transport``), or the ``connection`` of another
            node, to share its session.
        namespace: The node's namespace; empty for the root.
        domain_id: The ROS domain.
        key: The client key, 32 bits. By default it is derived from the board's unique id and the
            name, so that the agent recognizes the board after a reset.
        executor: The executor of another node, to spin both nodes together. By default a new one.
        remap: A :class:`~uros.client.remap.Remap`.
        watchdog: A ``machine.WDT``, or another object with ``feed()``. Spinning feeds it, at least
            four times a second and after each callback. So a callback that takes longer than its
            timeout resets the board, and so does a program that no longer spins.
    """

    kinds = (ids.KIND_PARTICIPANT,)
    # Classes of connections, which nodes share; any other object is a transport.
    _connections: "tuple[type, ...]" = (Connection,)
    # Created at first use.
    _rosout: "Rosout | None" = None
    _parameters: "ParameterServer | None" = None

    def __init__(
        self,
        name: str,
        transport: "Transport | NodeConnection",
        namespace: str = "",
        domain_id: int = 0,
        key: "int | None" = None,
        executor: "Executor | None" = None,
        remap: "Any" = None,
        watchdog: "Any" = None,
        **options: "Any",
    ) -> None:
        self._remap = remap
        if remap is not None:
            name, namespace = remap.node(name, namespace)
        self.name = check_name(name, "a node's name", 0)
        space = namespace.strip("/")
        self.namespace = "/" + (check_name(space, "a namespace") if space else "")
        self.domain_id = domain_id
        if executor is None:
            executor = Executor()
            executor.between = self._serve
        if watchdog is not None:
            executor.watchdog = watchdog
        self.executor = executor
        line: "Any" = transport
        self._owner = not isinstance(line, self._connections)
        if self._owner:
            if not hasattr(transport, "mtu"):
                raise TypeError("%r is no transport, as UdpTransport(host, port) is" % transport)
            connection: "NodeConnection" = Connection(
                line, board_key(name) if key is None else key, **options
            )
        else:
            connection = line
        self.connection = connection
        # Ticks and epoch time: ``node.clock.stamp(message.header.stamp)``.
        self.clock: "Clock" = self.connection.clock
        self._entities: "list[Any]" = []  # entities, timers and guard conditions
        self._more = False  # whether the last round called a callback
        self._pumped = self.clock.ms()
        self.object_id = self.connection.add(self) << 4 | ids.KIND_PARTICIPANT

    # --- methods that the connection calls ---------------------------------------------------

    def create(self, connection: "Any", step: int) -> bool:
        """Send CREATE of the participant; return True: it is the only request."""
        name = self.name if self.namespace == "/" else self.namespace + "/" + self.name
        connection.create(self, self.object_id, self.domain_id, push_binary_participant, name, None)
        return True

    def on_lost(self) -> None:
        """Handle the end of the session; a node keeps no state of it."""

    # --- methods of rclpy's Node --------------------------------------------------------------

    def get_name(self) -> str:
        """Return the node's name."""
        return self.name

    def get_namespace(self) -> str:
        """Return the namespace, ``"/"`` for the root."""
        return self.namespace

    def get_fully_qualified_name(self) -> str:
        """Return the namespace and the name."""
        return self.resolve(self.name)

    def create_publisher(self, msg_type: "Any", topic: str, qos_profile: "Any" = 10) -> Publisher:
        """Create a publisher; ``qos_profile`` is a depth (reliable, volatile) or a QoSProfile."""
        publisher = Publisher(self, self.resolve_topic_name(topic), msg_type, qos_profile)
        self._entities.append(publisher)
        return publisher

    def create_subscription(
        self, msg_type: "Any", topic: str, callback: "Callable[[Any], object]",
        qos_profile: "Any" = 10,
    ) -> Subscription:  # fmt: skip
        """Create a subscription; ``callback(message)`` is called for each message."""
        name = self.resolve_topic_name(topic)
        subscription = Subscription(self, name, msg_type, qos_profile, callback)
        self._add(subscription)
        return subscription

    def create_service(
        self, srv_type: "Any", srv_name: str, callback: "Callable[[Any, Any], Any]",
        qos_profile: "Any" = 10,
    ) -> Service:  # fmt: skip
        """Create a service; ``callback(request, response)`` returns the response.

        Of ``qos_profile`` only the reliability has an effect: whether requests and replies are best
        effort between the board and the agent.
        """
        name = self.resolve_topic_name(srv_name, True)
        service = Service(self, name, srv_type, qos_profile, callback)
        self._add(service)
        return service

    def create_client(self, srv_type: "Any", srv_name: str, qos_profile: "Any" = 10) -> Client:
        """Create a client of a service."""
        client = Client(self, self.resolve_topic_name(srv_name, True), srv_type, qos_profile)
        self._add(client)
        return client

    def create_timer(
        self, timer_period_sec: float, callback: "Callable[[], object]", autostart: bool = True
    ) -> Timer:
        """Create a timer with a period in seconds."""
        timer = Timer(timer_period_sec, callback, self.clock, autostart)
        self.executor.add(timer)
        self._entities.append(timer)
        return timer

    def destroy_timer(self, timer: Timer) -> None:
        """Remove a timer."""
        self.forget(timer)

    # Each of these methods imports its module at first use.

    def get_logger(self) -> "Logger":
        """Return the node's logger, for the console and ``/rosout``; see uros.client.rosout."""
        log = self._rosout
        if log is None:
            from .rosout import Rosout

            log = self._rosout = Rosout(self)
        return log.logger

    # See uros.client.parameters.

    def _parameter_server(self) -> "Any":
        server = self._parameters
        if server is None:
            from .parameters import ParameterServer

            server = ParameterServer(self)
        return server

    def declare_parameter(
        self, name: str, value: "Any" = None, descriptor: "Any" = None,
        ignore_override: bool = False,
    ) -> "Parameter":  # fmt: skip
        """Declare a parameter; see :meth:`.ParameterServer.declare_parameter`."""
        server: "ParameterServer" = self._parameter_server()
        return server.declare_parameter(name, value, descriptor, ignore_override)

    def declare_parameters(
        self, namespace: str, parameters: "Any", ignore_override: bool = False
    ) -> "list[Parameter]":
        """Declare several parameters; see :meth:`.ParameterServer.declare_parameters`."""
        server: "ParameterServer" = self._parameter_server()
        return server.declare_parameters(namespace, parameters, ignore_override)

    def undeclare_parameter(self, name: str) -> None:
        """Remove a parameter."""
        self._parameter_server().undeclare_parameter(name)

    def has_parameter(self, name: str) -> bool:
        """Return whether a parameter is declared."""
        return self._parameter_server().has_parameter(name)  # type: ignore[no-any-return]

    def get_parameter(self, name: str) -> "Parameter":
        """Return a parameter."""
        return self._parameter_server().get_parameter(name)  # type: ignore[no-any-return]

    def get_parameters(self, names: "list[str]") -> "list[Parameter]":
        """Return several parameters."""
        return self._parameter_server().get_parameters(names)  # type: ignore[no-any-return]

    def get_parameter_or(
        self, name: str, alternative_value: "Parameter | None" = None
    ) -> "Parameter":
        """Return a parameter, or the alternative if it has no value."""
        server: "ParameterServer" = self._parameter_server()
        return server.get_parameter_or(name, alternative_value)

    def get_parameters_by_prefix(self, prefix: str) -> "dict[str, Parameter]":
        """Return the parameters named ``prefix`` and a dot and more, by the rest of the name."""
        server: "ParameterServer" = self._parameter_server()
        return server.get_parameters_by_prefix(prefix)

    def get_parameter_type(self, name: str) -> "Any":
        """Return the type of a parameter."""
        return self._parameter_server().get_parameter_type(name)

    def get_parameter_types(self, names: "list[str]") -> "list[Any]":
        """Return the types of several parameters."""
        return self._parameter_server().get_parameter_types(names)  # type: ignore[no-any-return]

    def set_parameters(self, parameter_list: "list[Parameter]") -> "list[Any]":
        """Set parameters one by one; return a result for each."""
        return self._parameter_server().set_parameters(parameter_list)  # type: ignore[no-any-return]

    def set_parameters_atomically(self, parameter_list: "list[Parameter]") -> "Any":
        """Set all of the parameters or none; return the result."""
        return self._parameter_server().set_parameters_atomically(parameter_list)

    def describe_parameter(self, name: str) -> "Any":
        """Return the descriptor of a parameter."""
        return self._parameter_server().describe_parameter(name)

    def describe_parameters(self, names: "list[str]") -> "list[Any]":
        """Return the descriptors of several parameters."""
        return self._parameter_server().describe_parameters(names)  # type: ignore[no-any-return]

    def list_parameters(self, prefixes: "list[str]", depth: int) -> "Any":
        """Return names and prefixes; see :meth:`.ParameterServer.list_parameters`."""
        return self._parameter_server().list_parameters(prefixes, depth)

    def set_descriptor(
        self, name: str, descriptor: "Any", alternative_value: "Any" = None
    ) -> "Any":
        """Replace the descriptor of a parameter; see :meth:`.ParameterServer.set_descriptor`."""
        return self._parameter_server().set_descriptor(name, descriptor, alternative_value)

    def add_pre_set_parameters_callback(self, callback: "Callable[[Any], Any]") -> None:
        """Add a callback that may replace the parameters to set."""
        self._parameter_server().add_pre_set_parameters_callback(callback)

    def add_on_set_parameters_callback(self, callback: "Callable[[Any], Any]") -> None:
        """Add a callback that accepts or refuses the parameters to set."""
        self._parameter_server().add_on_set_parameters_callback(callback)

    def add_post_set_parameters_callback(self, callback: "Callable[[Any], Any]") -> None:
        """Add a callback that gets the parameters that were set."""
        self._parameter_server().add_post_set_parameters_callback(callback)

    def remove_pre_set_parameters_callback(self, callback: "Callable[[Any], Any]") -> None:
        """Remove a callback added by :meth:`add_pre_set_parameters_callback`."""
        self._parameter_server().remove_pre_set_parameters_callback(callback)

    def remove_on_set_parameters_callback(self, callback: "Callable[[Any], Any]") -> None:
        """Remove a callback added by :meth:`add_on_set_parameters_callback`."""
        self._parameter_server().remove_on_set_parameters_callback(callback)

    def remove_post_set_parameters_callback(self, callback: "Callable[[Any], Any]") -> None:
        """Remove a callback added by :meth:`add_post_set_parameters_callback`."""
        self._parameter_server().remove_post_set_parameters_callback(callback)

    def destroy_publisher(self, publisher: Publisher) -> None:
        """Destroy a publisher."""
        publisher.destroy()

    def destroy_subscription(self, subscription: Subscription) -> None:
        """Destroy a subscription."""
        subscription.destroy()

    def destroy_service(self, service: Service) -> None:
        """Destroy a service."""
        service.destroy()

    def destroy_client(self, client: Client) -> None:
        """Destroy a client; its pending requests fail."""
        client.destroy()

    def create_guard_condition(self, callback: "Callable[[], object]") -> "Any":
        """Create a guard condition: its ``trigger()`` causes a call of ``callback``."""
        from .guard_condition import GuardCondition

        guard = GuardCondition(callback, self.clock)
        self.executor.add(guard)
        self._entities.append(guard)
        return guard

    def destroy_guard_condition(self, guard: "Any") -> None:
        """Remove a guard condition."""
        self.forget(guard)

    def destroy_node(self) -> None:
        """Delete the session and close the transport.

        A node that shares the connection of another one deletes its own objects only.
        """
        for entity in reversed(list(self._entities)):
            if self._owner or entity.kinds is None:
                self.forget(entity)
            else:
                entity.destroy()
        if self._owner:
            self.executor.between = None
            self.connection.close()
        else:
            self.connection.remove(self, (self.object_id,))

    # --- connection state, names and spinning -------------------------------------------------

    @property
    def state(self) -> int:
        """WAITING_AGENT, AGENT_AVAILABLE, AGENT_CONNECTED or AGENT_DISCONNECTED."""
        return self.connection.state

    @property
    def on_state(self) -> "Callable[[int], object] | None":
        """Callback that is called with each new state."""
        return self.connection.on_state

    @on_state.setter
    def on_state(self, callback: "Callable[[int], object] | None") -> None:
        self.connection.on_state = callback

    def resolve(self, name: str) -> str:
        """Return the full name of an absolute, relative or private (``~/x``) name."""
        if name.startswith("/"):
            return name
        space = "" if self.namespace == "/" else self.namespace
        if name == "~" or name.startswith("~/"):
            return space + "/" + self.name + name[1:]
        return space + "/" + name

    def resolve_topic_name(self, topic: str, service: bool = False) -> str:
        """Return the full name of a topic, or with ``service`` of a service, after remapping.

        Raises:
            ValueError: The name breaks a rule of ROS, which the message states.
        """
        full = self.resolve(topic)
        if self._remap is not None:
            full = self._remap.name(self, topic, service)
        check_name(full[1:], "a topic's or service's name")
        return full

    def resolve_service_name(self, service: str) -> str:
        """Return the full name of a service, as :meth:`resolve_topic_name` does for a topic."""
        return self.resolve_topic_name(service, True)

    def _add(self, entity: "Any") -> None:
        try:
            self.executor.add(entity)
        except ValueError:
            self.connection.remove(entity, ())  # no entity without a handle
            raise
        self._entities.append(entity)

    def forget(self, entity: "Any") -> None:
        """Remove an entity that is being destroyed from the executor."""
        if entity in self._entities:
            self._entities.remove(entity)
        self.executor.remove(entity)

    def spin_once(self, timeout_sec: "float | None" = None) -> bool:
        """Run one round of callbacks and wait for work at most ``timeout_sec``.

        While entities are being created it returns after each received message, so that the program
        can collect garbage.

        Args:
            timeout_sec: Seconds; None waits without limit.

        Returns:
            Whether a callback was called.
        """
        executor = self.executor
        end = None
        if timeout_sec is not None:
            end = ticks_add(self.clock.ms(), min(int(timeout_sec * 1000), _LONGEST_MS))
        while True:
            now = self.clock.ms()
            if not (self._more and executor.overfull()):
                wait = executor.wait(now)
                if end is not None:
                    wait = min(wait, ticks_diff(end, now))
                self._pumped = now
                self.connection.pump(max(0, wait))
                now = self.clock.ms()
            self._more = executor.execute(now) > 0
            if (
                self._more
                or self.connection.state == AGENT_AVAILABLE
                or (end is not None and ticks_diff(now, end) >= 0)
            ):
                return self._more

    def _serve(self) -> None:
        """Serve the session between callbacks, so that slow ones do not starve it."""
        now = self.clock.ms()
        if ticks_diff(now, self._pumped) >= _SERVE_MS:
            self._pumped = now
            self.connection.pump(-1 if self.executor.overfull() else 0)

    def spin_some(self, timeout_sec: float = 0.0) -> int:
        """Wait for work at most ``timeout_sec``, then run rounds while there is work and time.

        Returns:
            The number of rounds.
        """
        end = ticks_add(self.clock.ms(), min(int(timeout_sec * 1000), _LONGEST_MS))
        rounds = 0
        left = ticks_diff(end, self.clock.ms())
        while self.spin_once(0 if rounds else max(0, left) / 1000):
            rounds += 1
            left = ticks_diff(end, self.clock.ms())
            if left <= 0:
                break
        return rounds

    def spin(self) -> None:
        """Spin for ever."""
        while True:
            self.spin_once()

    def spin_until_future_complete(
        self, future: "Future", timeout_sec: "float | None" = 10.0
    ) -> bool:
        """Spin until the future is done or the time (None: no limit) is up; return whether done."""
        end = ticks_add(self.clock.ms(), min(int((timeout_sec or 0) * 1000), _LONGEST_MS))
        left = timeout_sec
        while not future.done() and (left is None or left > 0):
            self.spin_once(left)
            if left is not None:
                left = ticks_diff(end, self.clock.ms()) / 1000
        return future.done()


def check_name(name: str, subject: str, slashes: int = 1) -> str:
    """Return the name if ROS allows it.

    Args:
        name: The name, without a leading slash.
        subject: What is named, for the message.
        slashes: Whether slashes are allowed.

    Raises:
        ValueError: The name breaks a rule of ROS, which the message states.
    """
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
        raise ValueError("%r: %s %s" % (name, subject, fault))
    return name


def board_key(name: str) -> int:
    """Return a client key made of the board's unique id and the node's name, or a random one."""
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
