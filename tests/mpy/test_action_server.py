"""Tests that a board whose only end of an action is a server executes goals, from every build.

`ActionServer` is then the only subclass of `End`, so the builder merges the two classes.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from mpy.harness import MicroPython, tree
from support.agent import RunningAgent
from uros.interfaces.test_msgs.action import Fibonacci

from uros.agent.transports.memory import MemoryServer, MemoryTransport
from uros.boards.builder.file_system import build
from uros.boards.builder.pipeline import PASSES
from uros.client import AGENT_CONNECTED, Node
from uros.client.action_client import ActionClient
from uros.client.actions import GoalStatus
from uros.client.entities import Future

MAX_TURNS = 2000

PROGRAM = """
from binascii import hexlify, unhexlify
from test_msgs.action import Fibonacci
from uros.client import Node
from uros.client.action_server import ActionServer

class Line:
    mtu = 512
    sent = []
    received = []

    def open(self):
        pass

    def close(self):
        pass

    def send(self, message, size):
        self.sent.append(hexlify(memoryview(message)[:size]).decode())

    def receive(self, timeout_ms):
        return self.received.pop(0) if self.received else None

def fibonacci(goal):
    sequence = [0, 1]
    for i in range(1, goal.request.order):
        sequence.append(sequence[i] + sequence[i - 1])
        goal.publish_feedback(Fibonacci.Feedback(sequence))
        yield None
    goal.succeed()
    return Fibonacci.Result(sequence)

line = Line()
node = Node("board", line, key=1)
server = ActionServer(node, Fibonacci, "fibonacci", fibonacci)

def turn(messages):
    line.received += [unhexlify(message) for message in messages]
    node.spin_once(0)
    print(" ".join(line.sent))
    line.sent.clear()
"""


@pytest.fixture
def lines() -> Iterator[list[MemoryTransport]]:
    """Return the lines of two boards to a running agent."""
    server = MemoryServer()
    two_lines = [server.connect(), server.connect()]
    agent = RunningAgent(server, "memory", 0, 4)
    agent.start()
    yield two_lines
    agent.close()
    for line in two_lines:
        line._socket.close()  # close() leaves it open for the next session
    assert agent.error is None


def pass_on(board: MicroPython, line: MemoryTransport) -> None:
    """Spin the board once, and pass messages on in both directions."""
    messages = []
    while (message := line.receive(0)) is not None:
        messages.append(bytes(message).hex())
    *printed, sent = board.run(f"app.turn({messages})").rstrip("\n").split("\n")
    assert not printed  # the executor prints the errors of callbacks
    for text in sent.split():
        line.send(bytes.fromhex(text), len(text) // 2)


@pytest.mark.parametrize(
    ("form", "without"),
    [
        pytest.param("mpy", [], id="all passes"),
        pytest.param("py", [], id="text", marks=pytest.mark.slow),
        *(
            pytest.param("mpy", [step.name], id=f"without {step.name}", marks=pytest.mark.slow)
            for step in PASSES
        ),
    ],
)
def test_a_lone_action_server_executes_its_goals(
    micropython: MicroPython,
    lines: list[MemoryTransport],
    tmp_path: Path,
    form: str,
    without: list[str],
) -> None:
    program = tmp_path / "program"
    program.mkdir()
    (program / "app.py").write_text(PROGRAM)
    build(program, tmp_path / "out", form, without=without)
    micropython.install(tree(tmp_path / "out"))
    micropython.run("import app")
    node = Node("host", lines[1], key=2)
    client = ActionClient(node, Fibonacci, "fibonacci")

    def until(condition: Callable[[], bool]) -> None:
        for _ in range(MAX_TURNS):
            if condition():
                return
            pass_on(micropython, lines[0])
            node.spin_once(0.01)
        raise AssertionError("the board does not answer")

    def result(future: Future) -> Any:
        until(future.done)
        return future.result()

    until(lambda: node.state == AGENT_CONNECTED)
    until(lambda: micropython.run("print(app.node.state)") == f"{AGENT_CONNECTED}\n")
    feedback: list[list[int]] = []

    def on_feedback(message: Any) -> None:
        feedback.append(list(message.feedback.sequence))

    goal = result(client.send_goal_async(Fibonacci.Goal(order=4), on_feedback))
    assert goal.accepted
    answer = result(goal.get_result_async())
    assert answer.status == GoalStatus.STATUS_SUCCEEDED
    assert list(answer.result.sequence) == [0, 1, 1, 2, 3]
    until(lambda: len(feedback) == 3)
    assert feedback[-1] == [0, 1, 1, 2, 3]
