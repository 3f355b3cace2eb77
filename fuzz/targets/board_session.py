"""A board's node that gets any messages at any time, while it publishes and calls services.

The first byte has the MTU (bits 0 and 1) and whether the node has parameters and actions too (bit
2). The records follow; the low three bits of the operation are the kind:

====  ====================================================================
0     a datagram as it is
1     submessages in the next message of the reliable stream
2     submessages on the best-effort stream, or with 0x20 outside of streams
3     a sample: the first byte chooses the entity; with 0x20 in fragments
4     a time, in milliseconds
5     an action of the program: ``op >> 3`` is its number
6     a change of the agent or the line: ``op >> 3`` is its number
7     a message of the reliable stream arrives before lost ones with lower numbers
====  ====================================================================

With 0x40 the board does not spin before the next record. spin_once must raise no exception, and
with a correct agent the node must get a session again, in which everything works.
"""

from collections.abc import Iterator
from random import Random
from typing import Any

from support.board import KEY, FakeAgent, FakeClock, message, number_bytes
from uros.interfaces.action_msgs.srv import CancelGoal
from uros.interfaces.example_interfaces.action import Fibonacci
from uros.interfaces.example_interfaces.srv import AddTwoInts
from uros.interfaces.rcl_interfaces.msg import Parameter, ParameterValue
from uros.interfaces.rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from uros.interfaces.sensor_msgs.msg import JointState
from uros.interfaces.std_msgs.msg import Header, Int32, String

from uros.client import AGENT_CONNECTED, Node
from uros.client.action_client import ActionClient
from uros.client.action_server import ActionServer
from uros.interfaces.codec import to_cdr
from uros.wire import ids, session
from uros.wire.errors import EncodeError

from . import records, submessages
from .world import built, must, submessage

RAW, RELIABLE, OTHER, SAMPLE, TIME, PROGRAM, AGENT, EARLY = range(8)
OPS = tuple(range(0x80))
SKIP, LATER = 0x20, 0x40
_MTUS = (512, 128, 63, 2048)
_LIMIT = 8192
_MAX_MS = 20_000
_MAX_TURNS = 3000  # spin_once calls without progress of time; more would be endless


class Board:
    """A node with every kind of entity, its agent and their clock."""

    def __init__(self, options: int) -> None:
        self.clock = FakeClock()
        self.agent = FakeAgent(self.clock, _MTUS[options & 3])
        self.left_ms = _MAX_MS
        self.received: list[int] = []
        self.answers: list[Any] = []
        self.sequence = 0
        node = self.node = Node("node", self.agent, key=KEY, clock=self.clock, limit=_LIMIT)
        node.connection.log = lambda text: None
        node.executor.report = self.report
        self.publisher = node.create_publisher(Int32, "topic")
        self.stamped = node.create_publisher(Header, "stamped")
        self.subscription = node.create_subscription(
            Int32, "topic", lambda message: self.received.append(message.data)
        )
        node.create_subscription(String, "words", lambda message: None)
        node.create_subscription(JointState, "joints", lambda message: None)
        node.create_service(AddTwoInts, "service", lambda request, response: response)
        self.client = node.create_client(AddTwoInts, "client")
        self.goals: Any = None
        if options & 4:
            for name, value in (("a", 1), ("b", 2.5), ("c", "text"), ("d", [1, 2]), ("e", True)):
                node.declare_parameter(name, value)
            ActionServer(node, Fibonacci, "serves", self.execute)
            self.goals = ActionClient(node, Fibonacci, "asks")
        self.spin(2000)
        must(node.state == AGENT_CONNECTED, "no session to begin with")

    @staticmethod
    def report(error: Exception) -> None:
        # Invalid samples are reported. A response that is too long is not sent.
        if type(error) is ValueError and "what came is no" in str(error):
            return
        if not isinstance(error, EncodeError):
            raise AssertionError("a callback of ours fails") from error

    @staticmethod
    def execute(goal: Any) -> Iterator[Any]:
        for _ in range(3):
            if goal.is_cancel_requested:
                goal.canceled()
                return Fibonacci.Result([])
            goal.publish_feedback(Fibonacci.Feedback([1]))
            yield 0.05
        goal.succeed()
        return Fibonacci.Result([1, 2])

    # --- time ---------------------------------------------------------------------------------

    def spin(self, ms: int) -> None:
        end = self.clock.t + ms * 1000
        turns = 0
        while True:
            before = self.clock.t
            # Rounded up to a millisecond: with less it would not wait.
            self.node.spin_once(max(0, -(-(end - self.clock.t) // 1000)) / 1000)
            self.check()
            turns = turns + 1 if self.clock.t == before else 0
            must(turns < _MAX_TURNS, "it spins and no time goes by")
            if self.clock.t >= end:
                return

    def check(self) -> None:
        connection = self.node.connection
        must(connection.in_flight() <= 16, "more messages in flight than the window has")
        in_flight = sum(
            connection._size(connection.slots[(connection.acked + i) & 15])
            for i in range(connection.in_flight())
        )
        must(
            connection.size() == in_flight + sum(map(len, connection.waiting)),
            "bytes are counted wrong",
        )
        must(len(connection._in.waiting) < 16, "early messages")
        must(connection._fragments.pending <= connection.limit, "fragments")
        must(connection.size() <= connection.limit + 16 * 600, "more waits than may")
        must(len(connection._idle) == 17 and 0 <= connection.free <= 16, "buffers")
        for entity in self.node._entities:
            must(len(getattr(entity, "_queue", ())) <= 400, "messages are kept")

    # --- the records --------------------------------------------------------------------------

    def reliable(self, body: bytes) -> None:
        """Send a message on the reliable stream, with retransmission."""
        agent = self.agent
        agent.out.put(
            bytes((agent.session_id, ids.STREAM_RELIABLE))
            + agent.out.next.to_bytes(2, "little") + body
        )  # fmt: skip
        for datagram in agent.out.take(self.clock.ms()):
            agent.post(datagram)

    def do(self, op: int, body: bytes) -> None:
        kind = op & 7
        agent = self.agent
        number = int.from_bytes(body[:2], "little")
        if kind == RAW:
            agent.post(body)
        elif kind == RELIABLE:
            self.reliable(body)
        elif kind == OTHER:
            stream = 0 if op & SKIP else ids.STREAM_BEST_EFFORT
            self.sequence += 1
            head = bytes((agent.session_id, stream)) + (self.sequence & 0xFFFF).to_bytes(
                2, "little"
            )
            agent.post(head + body)
        elif kind == SAMPLE:
            self.sample(body, bool(op & SKIP))
        elif kind == TIME:
            ms = min(number % 5000, self.left_ms)
            self.left_ms -= ms
            self.spin(ms)
        elif kind == PROGRAM:
            self.program(op >> 3 & 7, body)
        elif kind == AGENT:
            self.change(op >> 3 & 7, number)
        else:
            later = (agent.out.next + 1 + op % 16) & 0xFFFF
            head = bytes((agent.session_id, ids.STREAM_RELIABLE)) + later.to_bytes(2, "little")
            agent.post(head + body)
        if not op & LATER:
            self.spin(5)

    def sample(self, body: bytes, fragments: bool) -> None:
        known = self.node.connection._by_id
        if not known or not body:
            return
        object_id = sorted(known)[body[0] % len(known)]
        entity = known[object_id]
        octets = body[1:]
        request = 0
        pending = getattr(entity, "_pending", None)
        if pending:
            request = next(iter(pending))  # a response to a pending request
        data = built(session.push_request, request, object_id) + octets
        if not fragments:
            self.agent.reliable(ids.DATA, data)
            return
        whole = submessage(ids.DATA, data)
        for at in range(0, len(whole), 40):
            last = at + 40 >= len(whole)
            flags = ids.FLAG_LITTLE_ENDIAN | (ids.FLAG_LAST_FRAGMENT if last else 0)
            self.agent.reliable(ids.FRAGMENT, whole[at : at + 40], flags)

    def program(self, action: int, body: bytes) -> None:
        node = self.node
        if action == 0:
            self.publisher.publish(Int32(data=len(body)))
        elif action == 1:
            header = Header(frame_id="x" * min(len(body) * 9, 2000))
            self.clock.stamp(header.stamp)
            self.stamped.publish(header)
        elif action == 2:
            self.client.call_async(AddTwoInts.Request()).add_done_callback(self.answers.append)
        elif action == 3 and self.goals is not None:
            self.goals.send_goal_async(Fibonacci.Goal(order=3), lambda future: None)
        elif action == 4:
            topic = f"t{len(body) % 8}"
            subscription = node.create_subscription(Int32, topic, lambda message: None)
            if len(body) & 8:
                self.spin(3)
            node.destroy_subscription(subscription)
        elif action == 5:
            for _ in range(20):
                self.publisher.publish(Int32(data=1))
        elif action == 6:
            node.connection.end("the program wants another")
        elif self.goals is not None:
            self.goals.cancel_all_goals_async()

    def change(self, action: int, number: int) -> None:
        agent = self.agent
        if action == 0:
            agent.silent = not agent.silent
        elif action == 1:
            agent.fail_send = None if agent.fail_send else OSError(5, "no line")
        elif action == 2:
            agent.fail_receive = None if agent.fail_receive else OSError(5, "no line")
        elif action == 3:
            agent.fail_open = None if agent.fail_open else OSError(19, "no line")
        elif action == 4:
            agent.delay = (number & 0xFF) * 500, (number >> 8) * 500
        elif action == 5 and number & 1:
            # Any time of 32 bits; stamps end in 2038.
            agent.epoch_us = (number & 0xFFFE) * 65536 * 1_000_000
        elif action == 5:
            agent.status = number >> 8
        elif action == 6:
            agent.refuse = {} if agent.refuse else {number: 0x80 + (number & 7)}
        else:
            agent.forget()

    # --- the end ------------------------------------------------------------------------------

    def healed(self) -> None:
        """With a correct agent, the node publishes, receives and calls again."""
        agent = self.agent
        agent.fail_open = agent.fail_send = agent.fail_receive = None
        agent.status = ids.STATUS_OK
        agent.refuse = {}
        agent.delay = (0, 0)
        agent.silent = True
        self.spin(5000)
        agent.silent = False
        agent.forget()
        self.spin(5000)
        must(self.node.state == AGENT_CONNECTED, f"no session again: {self.node.connection.reason}")
        del self.received[:]
        agent.sample(self.subscription.object_id(ids.KIND_DATAREADER), number_bytes(7))
        must(self.publisher.publish(Int32(data=8)), "nothing can be published")
        future = self.client.call_async(AddTwoInts.Request())
        self.spin(100)
        must(self.received == [7], "it hears nothing")
        writer = self.publisher.object_id(ids.KIND_DATAWRITER)
        must((writer, number_bytes(8)) in agent.samples, "nothing is published")
        must(not future.done(), "an answer that nobody gave")
        must(all(future.done() for future in self.answers), "who asked is never answered")
        self.node.destroy_node()
        must(not agent.is_open, "the transport stays open")


def one_input(data: bytes) -> None:
    board = Board(data[0] if data else 0)
    for op, body in records.unpack(data[1:]):
        board.do(op, body)
    board.healed()


_IDENTITY = bytes(24)


def _cdr(message: Any) -> bytes:
    return to_cdr(message)[4:]


def _samples() -> list[bytes]:
    """Valid samples for the entities."""
    value = ParameterValue(type=3, double_value=1.5)
    goal = Fibonacci.Impl.SendGoalService.Request()
    cancel = CancelGoal.Request()
    result = Fibonacci.Impl.GetResultService.Request()
    requests = [
        AddTwoInts.Request(a=1, b=2), GetParameters.Request(names=["a", "b", "no"]),
        ListParameters.Request(prefixes=["a"]), goal, cancel, result,
        SetParameters.Request(parameters=[Parameter(name="b", value=value)]),
    ]  # fmt: skip
    messages = [
        Int32(data=5), String(data="words"), JointState(name=["a"], position=[1.0]),
        AddTwoInts.Response(sum=3), Fibonacci.Impl.SendGoalService.Response(accepted=True),
        CancelGoal.Response(), Fibonacci.Impl.GetResultService.Response(status=4),
        Fibonacci.Impl.FeedbackMessage(), Fibonacci.Impl.GoalStatusMessage(),
    ]  # fmt: skip
    return [_IDENTITY + _cdr(message) for message in requests] + [
        _cdr(message) for message in messages
    ]


def _bodies() -> list[bytes]:
    """Submessages that agents send."""
    time = (1_700_000_000, 5)
    return [
        submessage(ids.STATUS, built(session.push_status, 10, 0x15, 0)),
        submessage(ids.STATUS, built(session.push_status, 11, 0x15, 0x85)),
        submessage(ids.STATUS, built(session.push_status, 9, ids.OBJECT_CLIENT, 0)),
        submessage(ids.STATUS_AGENT, built(session.push_status_agent, 0)),
        submessage(ids.STATUS_AGENT, built(session.push_status_agent, 0x80)),
        submessage(ids.INFO, built(session.push_info, 10, ids.OBJECT_AGENT, 0, 0, [])),
        submessage(ids.INFO, built(session.push_info, 10, ids.OBJECT_AGENT, 0, 1, [])),
        submessage(ids.ACKNACK, built(session.push_acknack, 3, 5, 0x80)),
        submessage(ids.ACKNACK, built(session.push_acknack, 0, 0xFFFF, 0x80)),
        submessage(ids.HEARTBEAT, built(session.push_heartbeat, 0, 9, 0x80)),
        submessage(ids.HEARTBEAT, built(session.push_heartbeat, 100, 120, 0x80)),
        submessage(ids.TIMESTAMP_REPLY, built(session.push_timestamp_reply, time, time, time)),
        submessage(ids.DATA, b"\0\x0a\0\x16" + number_bytes(5)),
        submessage(ids.FRAGMENT, submessage(ids.DATA, b"\0\x0a\0\x16" + number_bytes(6)), 3),
        submessage(ids.FRAGMENT, b"\x09\1\x20\0half of it"),
    ]


_material: list[records.Record] = []
_seed_bodies: list[bytes] = []


def seeds() -> Iterator[tuple[str, bytes]]:
    samples, bodies = _samples(), _bodies()

    def ms(number: int) -> bytes:
        return number.to_bytes(2, "little")

    for options in (0, 1, 2, 7):
        steps = [(RELIABLE, body) for body in bodies] + [(OTHER | SKIP, body) for body in bodies]
        yield f"bodies_{options}", bytes((options,)) + records.pack([*steps, (TIME, ms(500))])
        yield (
            f"samples_{options}",
            bytes((options,))
            + records.pack(
                [(SAMPLE, bytes((at,)) + sample) for at, sample in enumerate(samples)]
                + [(TIME, ms(500))]
            ),
        )
        actions = [(PROGRAM | action << 3, b"five!") for action in range(8)]
        yield (
            f"program_{options}",
            bytes((options,)) + records.pack([*actions, (TIME, ms(900)), *actions]),
        )
        changes = [(AGENT | action << 3, b"\x85\0") for action in range(8)]
        yield (
            f"changes_{options}",
            bytes((options,))
            + records.pack(
                [
                    step
                    for change in changes
                    for step in (change, (TIME, ms(300)), actions[0], change)
                ]
            ),
        )
    yield (
        "raw",
        b"\0"
        + records.pack(
            [
                (RAW, message(ids.INFO, bytes(8), session_id=0x80)),
                (EARLY, bodies[0]),
                (RAW, b"\x81"),
            ]
        ),
    )
    clocks = [(AGENT | 5 << 3, ms(epoch)) for epoch in (1, 0x7FFF, 0x8001, 0xFFFF)]
    yield "clocks", b"\4" + records.pack(
        [step for clock in clocks for step in (
            clock, (PROGRAM | 6 << 3, b""), (TIME, ms(3000)), (PROGRAM | 1 << 3, b"x"),
            (SAMPLE, b"\x0b" + samples[3]), (TIME, ms(100)),
        )]
    )  # fmt: skip
    yield (
        "goals",
        b"\4"
        + records.pack(
            [(PROGRAM | 3 << 3, b""), *[(SAMPLE, bytes((n,)) + samples[11]) for n in range(24)]]
        ),
    )


def mutate(data: bytes, random: Random, mutate_bytes: records.MutateBytes) -> bytes:
    if not _material:
        _seed_bodies.extend(_bodies())
        _material.extend((RELIABLE, body) for body in _seed_bodies)
        _material.extend((OTHER | SKIP, body) for body in _seed_bodies)
        _material.extend((PROGRAM | action << 3, b"five!") for action in range(8))
        _material.extend((AGENT | action << 3, b"\x85\0") for action in range(8))
        for number in (1, 0x7FFF, 0x8001, 0xFFFF, 0x8500):
            _material.append((AGENT | 5 << 3, number.to_bytes(2, "little")))
        for number in (1, 30, 210, 1000, 2500):
            _material.append((TIME, number.to_bytes(2, "little")))
        for at in range(32):
            for sample in _samples():
                _material.append((SAMPLE | random.choice((0, 0, SKIP)), bytes((at,)) + sample))

    def change(op: int, body: bytes) -> bytes:
        if op & 7 in (RELIABLE, OTHER, EARLY):
            return submessages.change(body, random, mutate_bytes, _seed_bodies)
        if op & 7 == RAW and len(body) > 4:
            return body[:4] + submessages.change(body[4:], random, mutate_bytes, _seed_bodies)
        if op & 7 == SAMPLE and random.random() < 0.8:
            return body[:1] + mutate_bytes(body[1:])
        return mutate_bytes(body)

    head = data[:1] or b"\0"
    if random.random() < 0.1:
        head = bytes((random.randrange(8),))
    return head + records.mutate(data[1:], random, OPS, _material, change)
