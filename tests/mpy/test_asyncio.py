"""Tests of uros.client.asyncio_support in MicroPython's asyncio.

The WebAssembly build runs asyncio's tasks between two calls into it, so the tests poll until the
tasks are done. The clock is real time.
"""

import time

import pytest
from mpy.harness import MicroPython, portable_sources, shared_sources

SETUP = """
import asyncio
from support.board import KEY, Ask, FakeAgent, Number, number_bytes
from uros.client import AGENT_CONNECTED, asyncio_support
from uros.client.clock import Clock

class LiveClock(Clock):
    @property
    def t(self):
        return self.us()

    @t.setter
    def t(self, value):
        assert value - self.us() <= 1000, "the node blocks"

agent = FakeAgent(LiveClock())
node = asyncio_support.Node("node", agent, key=KEY, clock=agent.clock)
heard = []
beats = [0]
faults = []
done = []

async def until(condition):
    while not condition():
        await asyncio.sleep_ms(1)

async def beat():
    while True:
        beats[0] += 1
        await asyncio.sleep_ms(2)

async def guarded(work):
    try:
        await work
        done.append(1)
    except Exception as error:
        faults.append(repr(error))

spinning = asyncio.create_task(guarded(node.spin()))
beating = asyncio.create_task(beat())
"""


@pytest.fixture
def board(micropython: MicroPython) -> MicroPython:
    micropython.install(portable_sources())
    micropython.install(shared_sources())
    micropython.run(SETUP)
    return micropython


def wait(board: MicroPython, condition: str) -> None:
    """Poll until a condition is true on the board; the tasks run between two polls."""
    deadline = time.monotonic() + 20
    while board.run(f"print(bool({condition}))") != "True\n":
        assert time.monotonic() < deadline, board.run("print(node.state, heard, beats, faults)")
    assert board.run("print(faults)") == "[]\n"


def test_await_spin_while_other_tasks_run(board: MicroPython) -> None:
    board.run(
        "sub = node.create_subscription("
        "Number, 'topic', lambda message: heard.append(message.value))"
    )
    wait(board, "node.state == AGENT_CONNECTED")
    board.run("first = beats[0]")
    for i in range(5):
        board.run(f"agent.sample(0x06, number_bytes({i}))")
        wait(board, f"len(heard) == {i + 1}")
    wait(board, "beats[0] > first + 5")
    board.run("spinning.cancel()")
    board.run("agent.sample(0x06, number_bytes(9)); count = beats[0]")
    wait(board, "beats[0] > count + 5")
    assert board.run("print(heard)") == "[0, 1, 2, 3, 4]\n"


def test_a_call_is_awaited(board: MicroPython) -> None:
    board.run(
        """
client = node.create_client(Ask, "ask")

async def main():
    await until(lambda: node.state == AGENT_CONNECTED and client.created)
    future = client.call_async(Ask.Request(1))
    number = [message for message in agent.sent if message[4] == 7][-1][8:10]
    agent.sample(0x07, number + b"\\0\\7" + number_bytes(5))
    heard.append((await asyncio_support.result(future)).value)
    heard.append(await asyncio_support.spin_once(node, 0.02))

asyncio.create_task(guarded(main()))
"""
    )
    wait(board, "done")
    assert board.run("print(heard)") == "[5, False]\n"


def test_a_silent_agent_blocks_nobody(board: MicroPython) -> None:
    board.run("agent.silent = True; node.create_timer(0.01, lambda: heard.append(1))")
    wait(board, "len(heard) >= 10 and beats[0] >= 20")
