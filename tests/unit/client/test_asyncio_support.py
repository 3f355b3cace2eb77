"""A node in asyncio of CPython; tests/mpy/test_asyncio.py tests it on MicroPython."""

import asyncio
import inspect
import time

import pytest
from support.board import KEY, Ask, FakeAgent, Number, number_bytes

from uros.client import AGENT_CONNECTED, Node, asyncio_support
from uros.client.clock import Clock


class LiveClock(Clock):
    """The clock of the scripted agent, running in real time."""

    @property
    def t(self):
        return time.monotonic_ns() // 1000

    @t.setter
    def t(self, value):
        """Fail if the transport waits: that would block all tasks."""
        assert value <= self.t + 1000, "it blocks"

    def sleep(self, ms):
        assert ms == 0, "it blocks"


@pytest.fixture
def agent():
    return FakeAgent(LiveClock())


def make(agent, cls=asyncio_support.Node, **options):
    return cls("node", agent, key=KEY, clock=agent.clock, **options)


async def until(condition):
    while not condition():
        await asyncio.sleep(0.001)


def run(coroutine):
    return asyncio.run(asyncio.wait_for(coroutine, 20))


def test_await_spin_and_other_tasks_run(agent):
    node = make(agent)
    assert inspect.iscoroutinefunction(node.spin)
    heard, beats = [], []
    node.create_subscription(Number, "topic", lambda message: heard.append(message.value))

    async def beat():
        while True:
            beats.append(time.monotonic())
            await asyncio.sleep(0.01)

    async def main():
        spinning = asyncio.create_task(node.spin())
        beating = asyncio.create_task(beat())
        await until(lambda: node.state == AGENT_CONNECTED)
        for i in range(10):
            agent.sample(0x06, number_bytes(i))
            await until(lambda i=i: len(heard) > i)
        count = len(beats)
        await until(lambda: len(beats) >= count + 10)
        for task in (spinning, beating):
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task

    run(main())
    assert heard == list(range(10))


def test_a_silent_agent_does_not_block_other_tasks(agent):
    agent.silent = True
    node = make(agent)
    calls = []
    node.create_timer(0.02, lambda: calls.append(1))

    async def main():
        spinning = asyncio.create_task(node.spin())
        await until(lambda: len(calls) >= 10)
        spinning.cancel()

    run(main())


def test_a_call_is_awaited(agent):
    node = make(agent)
    client = node.create_client(Ask, "ask")

    async def main():
        spinning = asyncio.create_task(node.spin())
        await until(lambda: node.state == AGENT_CONNECTED)
        future = client.call_async(Ask.Request(1))
        number = [datagram for datagram in agent.sent if datagram[4] == 7][-1][8:10]
        agent.sample(0x07, number + b"\0\7" + number_bytes(5))
        assert (await asyncio_support.result(future)).value == 5
        assert (await asyncio_support.result(future)).value == 5  # done already
        agent.silent = True
        future = client.call_async(Ask.Request(1))
        with pytest.raises(OSError, match="ask"):
            await asyncio_support.result(future)
        spinning.cancel()

    run(main())


def test_spin_once_waits_for_its_timeout(agent):
    node = make(agent, Node)  # any node
    calls = []

    async def main():
        while node.state != AGENT_CONNECTED:
            await asyncio_support.spin_once(node, 0.01)
        before = time.monotonic()
        assert await asyncio_support.spin_once(node, 0.05) is False
        assert 0.049 <= time.monotonic() - before
        assert await asyncio_support.spin_once(node, 0) is False
        node.create_timer(0.02, lambda: calls.append(1))
        assert await asyncio_support.spin_once(node) is True and calls == [1]

    run(main())


def test_a_node_that_is_always_ready_yields_to_other_tasks(agent):
    node = make(agent)
    guard = node.create_guard_condition(lambda: guard.trigger())
    guard.trigger()
    turns = []

    async def main():
        spinning = asyncio.create_task(asyncio_support.spin(node))
        for _ in range(100):
            turns.append(1)
            await asyncio.sleep(0)
        spinning.cancel()

    run(main())
    assert len(turns) == 100


def test_a_hosts_node_is_spun():
    from uros.interfaces.std_msgs.msg import Int32

    from uros.host.direct import Direct
    from uros.host.node import Node as HostNode
    from uros.middleware.memory import MemoryMiddleware

    direct = Direct(MemoryMiddleware())
    node = HostNode("node", direct)
    heard = []
    node.create_subscription(Int32, "topic", lambda message: heard.append(message.data))
    publisher = node.create_publisher(Int32, "topic")

    async def main():
        spinning = asyncio.create_task(asyncio_support.spin(node))
        await asyncio.sleep(0)
        assert publisher.publish(Int32(data=5))
        await until(lambda: heard)
        spinning.cancel()

    run(main())
    node.destroy_node()
    assert heard == [5]
