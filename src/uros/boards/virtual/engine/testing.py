"""A virtual board with an agent and a node, all of one test's own: for tests of programs.

::

    with board_with_agent("greenhouse", "esp32_publisher") as (board, node):
        node.create_subscription(Int32, "/greenhouse/count", counts.append, 10)
        node.spin_until(lambda: len(counts) >= 2, "two counts")

The board is a process; agent and node are in the process of the test, on a ROS network that holds
nothing else. So tests need no free ROS domain, run beside each other and beside other ROS nodes,
and no discovery takes time. What this leaves out is DDS: start ``uros agent`` for that.
"""

from __future__ import annotations

import io
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Final

from ....agent.agent import Agent
from ....agent.log import INFO, Log
from ....agent.server import Server
from ....agent.transports.base import ServerTransport
from ....agent.transports.serial import SerialServer
from ....agent.transports.udp import UdpServer
from ....host.direct import Direct
from ....host.node import Node
from ....middleware.memory import Bus, MemoryMiddleware
from ..models.catalog import find
from .runner import RunningBoard

WAIT_SECONDS: Final = 60.0
_ROUND_SECONDS: Final = 0.05


class TestNode(Node):
    """The host node of a test; its ``agent_log()`` returns what the agent has logged."""

    __test__ = False  # pytest takes no class of this name for tests

    agent_log: Callable[[], str]

    def spin_until(
        self, done: Callable[[], object], what: str, timeout: float = WAIT_SECONDS
    ) -> None:
        """Spin until ``done()`` is true.

        Args:
            done: The condition.
            what: What is waited for, for the error.
            timeout: Seconds.

        Raises:
            TimeoutError: The time is up; the text has the agent's log.
        """
        end = time.monotonic() + timeout
        while not done():
            if time.monotonic() >= end:
                raise TimeoutError(
                    f"waited {timeout:g} s for {what}; the agent said:\n{self.agent_log()}"
                )
            self.spin_once(_ROUND_SECONDS)


@contextmanager
def board_with_agent(
    program: str | Path,
    board: str,
    engine: str = "cpython",
    **options: Any,
) -> Iterator[tuple[RunningBoard, TestNode]]:
    """Run a program on a virtual board, an agent for it, and a node; yield board and node.

    A board whose model names the agent's address in its network gets an agent by UDP, on a free
    port of loopback, in place of that address; any other board gets one on its line.

    Args:
        program: The folder of a main.py.
        board: The hardware, a name of ``uros board list``.
        engine: "cpython" or "micropython".
        options: Further options of `RunningBoard`.

    Raises:
        BoardError: There is no such board.
        StartError: The board does not start, for example since the program cannot be built.
    """
    bus = Bus()
    log = io.StringIO()
    agent = Agent(MemoryMiddleware(bus), Log(INFO, log), domain_override=0)
    with ExitStack() as stack:
        if find(board).agent:
            udp = UdpServer(0, "127.0.0.1")
            stack.enter_context(_serving(agent, udp))
            options["agent"] = "127.0.0.1", udp.port
        running = RunningBoard(program, board, engine, **options)
        stack.enter_context(running)
        if "agent" not in options:
            stack.enter_context(_serving(agent, SerialServer(str(running.path))))
        node = TestNode("test", Direct(MemoryMiddleware(bus)))
        stack.callback(node.destroy_node)
        node.agent_log = log.getvalue
        yield running, node


@contextmanager
def _serving(agent: Agent, transport: ServerTransport) -> Iterator[None]:
    """Run the agent's server in a thread until the end of the block; raise what ended it before."""
    server = Server(agent, [transport])
    errors: list[BaseException] = []

    def serve() -> None:
        try:
            server.run()
        except BaseException as error:
            errors.append(error)

    thread = threading.Thread(target=serve, name="agent", daemon=True)
    thread.start()
    try:
        if server.ready.wait(WAIT_SECONDS) and not errors:
            yield
    finally:
        server.stop()
        thread.join(WAIT_SECONDS)
    if errors:
        raise errors[0]
