"""Asking the agents that run on this machine: who they are, what they say.

The other end is :mod:`uros.agent.observability.status_socket`.
"""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any, Final, NamedTuple

from ..errors import ToolError

# How long an agent may take for an answer, or for the next part of one, in seconds.
PATIENCE: Final = 5.0
# A slip, or somebody else's socket: an answer that never ends.
MAX_ANSWER: Final = 256 * 1024 * 1024


class RunningAgent(NamedTuple):
    """One that can be asked."""

    pid: int
    path: Path

    def __str__(self) -> str:
        return f"the agent with pid {self.pid}"


def find_agents() -> list[RunningAgent]:
    """The agents of this user that listen now, by pid."""
    from ...agent.observability.status_socket import folders, sockets

    found: dict[int, RunningAgent] = {}
    for folder in folders():
        for pid, path in sockets(folder).items():
            agent = RunningAgent(pid, path)
            try:
                _connect(agent).close()
            except ToolError:  # it has ended
                continue
            found.setdefault(pid, agent)
    return [found[pid] for pid in sorted(found)]


def find_agent(pid: int | None = None) -> RunningAgent:
    """The agent with this pid, or the only one. Raises ToolError that tells what to do."""
    agents = find_agents()
    pids = ", ".join(str(it.pid) for it in agents)
    if not agents:
        raise ToolError(
            "no agent of uros runs here under this user: start one, such as"
            " 'uros agent udp4 --port 8888', or ask as the user that it runs under (one with"
            " --no-inspection cannot be asked, nor can one in another container)"
        )
    if pid is None:
        if len(agents) > 1:
            raise ToolError(f"{len(agents)} agents run here: choose one with --agent ({pids})")
        return agents[0]
    for agent in agents:
        if agent.pid == pid:
            return agent
    raise ToolError(f"there is no agent with pid {pid} to ask; there is {pids}")


def ask(agent: RunningAgent, question: str) -> dict[str, Any]:
    """The answer to a question that has one line of answer, such as ``status``.

    Raises ToolError where the agent has ended, does not answer or does not understand.
    """
    parts: list[bytes] = []
    size = 0
    for chunk in stream(agent, question, PATIENCE):
        line, end, _ = chunk.partition(b"\n")
        parts.append(line)
        if end:
            return _understood(agent, b"".join(parts))
        size += len(line)
        if size > MAX_ANSWER:
            raise ToolError(f"{agent} answers without end: is it an agent?")
    raise ToolError(f"{agent} has ended")


def stream(agent: RunningAgent, question: str, patience: float | None = None) -> Iterator[bytes]:
    """An answer as it comes, such as that to ``trace``, until the agent ends.

    ``patience``: how many seconds the next part may take; None waits for it for ever.
    """
    with closing(_connect(agent)) as sock:
        sock.settimeout(patience)
        try:
            try:
                sock.sendall(json.dumps({"ask": question}).encode() + b"\n")
            except ConnectionError:
                pass  # it has said why before it closed
            while chunk := sock.recv(65536):
                if chunk.startswith(b'{"error":'):
                    _understood(agent, chunk.partition(b"\n")[0])
                yield chunk
        except TimeoutError:
            raise ToolError(
                f"{agent} has not answered for {patience:g} s: is it stopped, or busy?"
            ) from None
        except ConnectionError:
            return


def _understood(agent: RunningAgent, line: bytes) -> dict[str, Any]:
    try:
        answer = json.loads(line)
    except (ValueError, RecursionError):
        answer = None
    if not isinstance(answer, dict):
        raise ToolError(f"{agent} says what is not understood: is it of another version of uros?")
    if "error" in answer:
        raise ToolError(f"{agent} says: {answer['error']}")
    return answer


def _connect(agent: RunningAgent) -> socket.socket:
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        sock.settimeout(PATIENCE)
        sock.connect(str(agent.path))
    except OSError as error:
        sock.close()
        raise ToolError(f"{agent} cannot be asked: {error.strerror or error}") from error
    return sock
