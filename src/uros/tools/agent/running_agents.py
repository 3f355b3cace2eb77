"""Finds the agents that run on this machine and queries them over their status sockets.

The other end is :mod:`uros.agent.observability.status_socket`.
"""

from __future__ import annotations

import json
import os
import socket
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any, Final, NamedTuple

from ..errors import ToolError

# How long an agent may take for an answer, or for the next part of one, in seconds.
PATIENCE: Final = 5.0
# The most bytes of an answer, because a socket that is not an agent's may send one that never ends.
MAX_ANSWER: Final = 256 * 1024 * 1024


class RunningAgent(NamedTuple):
    """An agent that can be asked."""

    pid: int
    path: Path

    def __str__(self) -> str:
        return f"the agent with pid {self.pid}"


def find_agents() -> list[RunningAgent]:
    """Return the agents of this user that accept connections, sorted by process id."""
    from ...agent.observability.status_socket import folders, sockets

    found: dict[int, RunningAgent] = {}
    for folder in folders():
        for pid, path in sockets(folder).items():
            agent = RunningAgent(pid, path)
            try:
                _connect(agent).close()
            except ToolError:  # the agent has ended
                continue
            found.setdefault(pid, agent)
    return [found[pid] for pid in sorted(found)]


def find_agent(choice: int | str | None = None) -> RunningAgent:
    """Return the chosen agent, or the only one.

    Args:
        choice: The process id of the agent, or the name of its configuration file.

    Raises:
        ToolError: There is no such agent, or there are several.
    """
    agents = chosen_agents(choice)
    if len(agents) > 1:
        pids = ", ".join(str(agent.pid) for agent in agents)
        raise ToolError(
            f"{len(agents)} agents run here: give --agent PID of one ({pids}); 'uros agent status'"
            " shows what each serves"
        )
    return agents[0]


def chosen_agents(choice: int | str | None = None) -> list[RunningAgent]:
    """Return the chosen agents, or all agents if ``choice`` is None; at least one.

    Args:
        choice: The process id of an agent, or the name of a configuration file, which several
            agents may have.

    Raises:
        ToolError: There is no such agent, or none at all.
    """
    agents = find_agents()
    if not agents:
        raise ToolError(
            "no uros agent runs here under this user: start one, such as"
            " 'uros agent udp4 --port 8888', or run this as the agent's user (an agent with"
            " --no-inspection, or in another container, cannot be asked)"
        )
    if choice is None:
        return agents
    if isinstance(choice, str):
        return _configured_by(agents, choice)
    for agent in agents:
        if agent.pid == choice:
            return [agent]
    pids = ", ".join(str(agent.pid) for agent in agents)
    raise ToolError(
        f"there is no agent with pid {choice}, but {pids}; 'uros agent status' shows what each"
        " serves"
    )


def _configured_by(agents: list[RunningAgent], name: str) -> list[RunningAgent]:
    """Return the agents whose configuration file has a name.

    Raises:
        ToolError: There is none.
    """
    found, files, errors = [], [], []
    for agent in agents:
        try:
            config = ask(agent, "status").get("config")
        except ToolError as error:
            errors.append(str(error))
            continue
        if config and is_named(config, name):
            found.append(agent)
        elif config:
            files.append(str(config))
    if found:
        return found
    others = f", but {', '.join(files)}" if files else ""
    raise ToolError(
        "; ".join([f"no agent runs here with the configuration file {name!r}{others}", *errors])
    )


def is_named(config: str, name: str) -> bool:
    """Return whether a name stands for a configuration file.

    Args:
        config: The absolute path of the file.
        name: A path, or the file's name, with or without its suffix.
    """
    path = Path(config)
    return name in (path.name, path.stem) or os.path.abspath(name) == config


def ask(agent: RunningAgent, question: str) -> dict[str, Any]:
    """Return the answer to a question that has a one-line answer, such as ``status``.

    Raises:
        ToolError: The agent has ended, does not answer, or does not know the question.
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
            raise ToolError(f"{agent} sends an endless answer: is this socket an agent's?")
    raise ToolError(f"{agent} has ended")


def stream(agent: RunningAgent, question: str, patience: float | None = None) -> Iterator[bytes]:
    """Yield the parts of an answer, such as the one to ``trace``, until the agent ends.

    Args:
        agent: The agent.
        question: What to ask.
        patience: How many seconds the next part may take; None waits without limit.

    Raises:
        ToolError: The agent does not answer, or does not know the question.
    """
    with closing(_connect(agent)) as sock:
        sock.settimeout(patience)
        try:
            try:
                sock.sendall(json.dumps({"ask": question}).encode() + b"\n")
            except ConnectionError:
                pass  # the agent has sent the reason before it closed
            while chunk := sock.recv(65536):
                if chunk.startswith(b'{"error":'):
                    _understood(agent, chunk.partition(b"\n")[0])
                yield chunk
        except TimeoutError:
            raise ToolError(
                f"{agent} has not answered for {patience:g} s: is it stopped or busy?"
            ) from None
        except ConnectionError:
            return


def _understood(agent: RunningAgent, line: bytes) -> dict[str, Any]:
    try:
        answer = json.loads(line)
    except (ValueError, RecursionError):
        answer = None
    if not isinstance(answer, dict):
        raise ToolError(f"{agent} sent a malformed answer: is it of another version of uros?")
    if "error" in answer:
        raise ToolError(f"{agent} answers: {answer['error']}")
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
