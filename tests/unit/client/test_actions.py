"""Actions with generated types: client and server on hosts, with asyncio, and with any bytes."""

import asyncio

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.board import KEY, FakeAgent, FakeClock
from support.examples import examples
from uros.interfaces.test_msgs.action import Fibonacci

from uros.client import AGENT_CONNECTED
from uros.client import Node as BoardNode
from uros.client.action_client import ActionClient
from uros.client.action_server import ActionServer
from uros.client.actions import CancelResponse, GoalResponse, GoalStatus
from uros.client.asyncio_support import result as result_of
from uros.client.asyncio_support import spin
from uros.host.direct import Direct
from uros.host.node import Node
from uros.middleware.memory import Bus, MemoryMiddleware
from uros.wire import ids

SECONDS = 20.0


@pytest.fixture
def nodes():
    """Two host nodes of one network."""
    bus = Bus()
    nodes = [Node(name, Direct(MemoryMiddleware(bus))) for name in ("server", "client")]
    yield nodes
    for node in nodes:
        node.destroy_node()


def until(nodes, done):
    for _ in range(10000):
        if done():
            return
        for node in nodes:
            node.spin_once(0.001)
    raise AssertionError("it takes too long")


def work(goal):
    sequence = [0, 1]
    for i in range(1, goal.request.order):
        if goal.is_cancel_requested:
            goal.canceled()
            return Fibonacci.Result(sequence)
        sequence.append(sequence[i] + sequence[i - 1] & 0x7FFFFFFF)  # an int32, of any order
        goal.publish_feedback(Fibonacci.Feedback(sequence[:50]))  # takes no longer at the end
        yield 0.002
    goal.succeed()
    return Fibonacci.Result(sequence)


def test_both_ends_on_hosts(nodes):
    ActionServer(
        nodes[0], Fibonacci, "fibonacci", work,
        goal_callback=lambda goal: GoalResponse.REJECT if goal.order < 0 else GoalResponse.ACCEPT,
        cancel_callback=lambda goal: CancelResponse.ACCEPT,
    )  # fmt: skip
    client = ActionClient(nodes[1], Fibonacci, "fibonacci")
    assert client.wait_for_server(1.0)
    heard = []
    goals = [
        client.send_goal_async(
            Fibonacci.Goal(order), lambda message: heard.append(message.feedback)
        )
        for order in (5, -1, 10000)
    ]
    until(nodes, lambda: all(goal.done() for goal in goals))
    short, refused, endless = (goal.result() for goal in goals)
    assert short.accepted and not refused.accepted and endless.accepted
    result = short.get_result_async()
    until(nodes, result.done)
    assert result.result().status == GoalStatus.STATUS_SUCCEEDED
    assert list(result.result().result.sequence) == [0, 1, 1, 2, 3, 5]
    cancel, result = endless.cancel_goal_async(), endless.get_result_async()
    until(nodes, lambda: cancel.done() and result.done())
    assert cancel.result().return_code == 0
    assert cancel.result().goals_canceling[0].goal_id == endless.goal_id
    assert result.result().status == GoalStatus.STATUS_CANCELED
    complete = [list(message.sequence) for message in heard if len(message.sequence) == 6]
    assert complete[0] == [0, 1, 1, 2, 3, 5]
    until(nodes, lambda: endless.status == GoalStatus.STATUS_CANCELED)


def test_a_late_subscription_receives_the_states(nodes):
    """The status topic is transient local on hosts, too."""
    server = ActionServer(nodes[0], Fibonacci, "fibonacci")
    client = ActionClient(nodes[1], Fibonacci, "fibonacci")
    goal = client.send_goal_async(Fibonacci.Goal(5))
    until(nodes, goal.done)
    server.goals[0].succeed(Fibonacci.Result([1]))
    states = []
    kind = Fibonacci.Impl.GoalStatusMessage
    topic = "/fibonacci/_action/status"
    nodes[1].create_subscription(kind, topic, states.append, client.states.qos)
    until(nodes, lambda: states)
    (goal_status,) = states[-1].status_list
    assert goal_status.status == GoalStatus.STATUS_SUCCEEDED
    assert goal_status.goal_info.goal_id == goal.result().goal_id
    server.destroy()
    client.destroy()


def test_a_task_of_asyncio_executes_a_goal(nodes):
    """Without an execute callback a program begins its own task for a goal."""

    async def main():
        tasks = [asyncio.create_task(spin(node)) for node in nodes]

        async def reach(goal):
            goal.execute()
            await asyncio.sleep(0.01)
            goal.publish_feedback(Fibonacci.Feedback([7]))
            goal.succeed(Fibonacci.Result([7, 8]))

        ActionServer(
            nodes[0], Fibonacci, "fibonacci",
            handle_accepted_callback=lambda goal: tasks.append(asyncio.create_task(reach(goal))),
        )  # fmt: skip
        client = ActionClient(nodes[1], Fibonacci, "fibonacci")
        goal = await result_of(client.send_goal_async(Fibonacci.Goal(5)))
        answer = await result_of(goal.get_result_async())
        for task in tasks[:2]:
            task.cancel()
        return answer

    answer = asyncio.run(asyncio.wait_for(main(), SECONDS))
    assert answer.status == GoalStatus.STATUS_SUCCEEDED and list(answer.result.sequence) == [7, 8]


# --- any bytes ------------------------------------------------------------------------


class Board:
    def __init__(self):
        self.clock = FakeClock()
        self.agent = FakeAgent(self.clock, mtu=2048)
        self.node = BoardNode("node", self.agent, key=KEY, clock=self.clock)
        self.errors = []
        self.node.executor.report = self.errors.append

    def connect(self):
        for _ in range(1000):
            if self.node.state == AGENT_CONNECTED:
                return
            self.node.spin_once(0.01)
        raise AssertionError("no connection")

    def run(self, ms):
        end = self.clock.t + ms * 1000
        while self.clock.t < end:
            self.node.spin_once((end - self.clock.t) / 1000000)


def packed(message, prefix=b""):
    buf = bytearray(message.cdr_size())
    message.pack_into(buf, 0, 0)
    return prefix + bytes(buf)


UUID = type(Fibonacci.Impl.GetResultService.Request().goal_id)
uuids = st.builds(lambda n: UUID(bytes([n] * 16)), st.integers(0, 3))
impl = Fibonacci.Impl
requests = st.one_of(
    st.builds(
        lambda uuid, order: (
            0, packed(impl.SendGoalService.Request(uuid, Fibonacci.Goal(order)))
        ),
        uuids, st.integers(-3, 9),
    ),
    st.builds(
        lambda uuid, sec, nanosec: (1, _cancel(uuid, sec, nanosec)),
        uuids, st.sampled_from([0, 0, 1, 1700000000, 2147483647]), st.sampled_from([0, 5]),
    ),
    st.builds(lambda uuid: (2, packed(impl.GetResultService.Request(uuid))), uuids),
    st.tuples(st.integers(0, 2), st.binary(max_size=60)),
    st.integers(1, 4000),  # milliseconds
    st.just("lose"),
)  # fmt: skip


def _cancel(uuid, sec, nanosec):
    request = impl.CancelGoalService.Request()
    request.goal_info.goal_id = uuid
    request.goal_info.stamp.sec = sec
    request.goal_info.stamp.nanosec = nanosec
    return packed(request)


# The states that may follow each state in status messages; lost messages skip states.
AFTER = {1: {1, 2, 3, 4, 5, 6}, 2: {2, 3, 4, 5, 6}, 3: {3, 4, 5, 6}, 4: {4}, 5: {5}, 6: {6}}


@settings(max_examples=examples(60), deadline=None)
@given(st.lists(requests, max_size=30))
def test_a_server_survives_any_requests(steps):
    board = Board()
    server = ActionServer(
        board.node, Fibonacci, "fibonacci", work,
        # Beyond 45 the Fibonacci numbers exceed 32 bits.
        goal_callback=lambda goal: 2 if 0 <= goal.order <= 45 else 1,
        cancel_callback=lambda goal: 1 if goal.request.order == 1 else 2,
        result_timeout=1, max_goals=3,
    )  # fmt: skip
    board.connect()
    for i, step in enumerate(steps):
        if step == "lose":
            board.agent.silent = True
            board.run(2500)
            board.agent.silent = False
            board.agent.forget()
            board.connect()
        elif isinstance(step, int):
            board.run(step)
        else:
            service, payload = step
            identity = bytes([i] * 24)
            board.agent.sample(service << 4 | ids.KIND_REPLIER, identity + payload)
            board.run(1)
        assert len(server.goals) <= 3
    board.run(20000)
    assert not server.goals  # all have ended and expired
    # In this session each state follows the one before, and each request has one reply.
    last, answered = {}, []
    for object_id, sample in board.agent.samples:
        if object_id == 1 << 4 | ids.KIND_DATAWRITER:
            states, _ = impl.GoalStatusMessage.unpack_from(sample, 0, 0, len(sample))
            now = {
                bytes(status.goal_info.goal_id.uuid): status.status for status in states.status_list
            }
            for uuid, status in now.items():
                assert status in AFTER[last.get(uuid, 1)], (last, now)
            last = now
        elif object_id & 0xF == ids.KIND_REPLIER:
            answered.append((object_id, sample[:24]))
    assert len(set(answered)) == len(answered)
    assert all("give both ends the same definition" in str(error) for error in board.errors), (
        board.errors
    )


samples = st.one_of(
    st.tuples(
        st.sampled_from([ids.KIND_REQUESTER, ids.KIND_DATAREADER]),
        st.integers(0, 2), st.integers(10, 60), st.binary(max_size=80),
    ),
    st.sampled_from(["send", "cancel", "result", "lose"]),
)  # fmt: skip


@settings(max_examples=examples(60), deadline=None)
@given(st.lists(samples, max_size=30))
def test_a_client_survives_any_replies(steps):
    board = Board()
    client = ActionClient(board.node, Fibonacci, "fibonacci")
    board.connect()
    handles, futures = [], []

    def accepted(future):
        if future.exception() is None:
            handles.append(future.result())

    for step in steps:
        if step == "send":
            futures.append(client.send_goal_async(Fibonacci.Goal(1), lambda message: None))
            futures[-1].add_done_callback(accepted)
        elif step == "lose":
            board.agent.silent = True
            board.run(2500)
            board.agent.silent = False
            board.agent.forget()
            assert all(future.done() for future in futures)
            board.connect()
        elif isinstance(step, str):
            for handle in handles:
                call = handle.cancel_goal_async if step == "cancel" else handle.get_result_async
                futures.append(call())
        else:
            kind, number, request, payload = step
            prefix = request.to_bytes(2, "big") + bytes(2)
            board.agent.sample(
                number << 4 | kind, (prefix if kind == ids.KIND_REQUESTER else b"") + payload
            )
        board.run(1)
    client.destroy()
    assert all(future.done() for future in futures)
    assert all("give both ends the same definition" in str(error) for error in board.errors), (
        board.errors
    )
