"""Spinning a node in a task of asyncio, on a board and on a host.

::

    from uros.client.asyncio_support import Node

    async def main():
        node = Node("talker", transport)
        asyncio.create_task(blink())
        await node.spin()

asyncio cannot wait for every kind of transport, so a spinning task polls it every ``poll_ms`` and
sleeps in between. Only the callbacks themselves block. A node must be spun by one task at a time.
"""

import asyncio

from ..ticks import ticks_add, ticks_diff
from . import node as client

try:
    from typing import Any, Final
except ImportError:  # MicroPython
    pass

POLL_MS: Final = 5
_LONGEST_MS: Final = 0x1FFFFFFF


async def _sleep(ms: int) -> None:
    if hasattr(asyncio, "sleep_ms"):  # MicroPython
        await asyncio.sleep_ms(ms)
    else:
        await asyncio.sleep(ms / 1000)


async def spin_once(
    node: "Any", timeout_sec: "float | None" = None, poll_ms: int = POLL_MS
) -> bool:
    """Spin a node once, as ``node.spin_once``, while other tasks run during the wait.

    Any node can be spun, a host's node too.
    """
    clock = node.clock
    end = 0
    if timeout_sec is not None:
        end = ticks_add(clock.ms(), min(int(timeout_sec * 1000), _LONGEST_MS))
    while True:
        if node.spin_once(0):
            await _sleep(0)
            return True
        now = clock.ms()
        wait = node.executor.wait(now, poll_ms)
        if timeout_sec is not None:
            left = ticks_diff(end, now)
            if left <= 0:
                await _sleep(0)
                return False
            wait = min(wait, left)
        await _sleep(wait)


async def spin(node: "Any", poll_ms: int = POLL_MS) -> None:
    """Spin a node for ever, or until the task is cancelled."""
    while True:
        await spin_once(node, None, poll_ms)


async def result(future: "Any") -> "Any":
    """Wait for the result of a call, while another task spins the node.

    Use: ``await result(client.call_async(request))``. An error of the call is raised.
    """
    event = asyncio.Event()
    future.add_done_callback(lambda _: event.set())
    if not future.done():
        await event.wait()
    return future.result()


class Node(client.Node):
    """A board's node whose ``spin`` is awaited."""

    async def spin(self) -> None:  # type: ignore[override]
        """Spin for ever, or until the task is cancelled."""
        await spin(self)
