"""Tells whether an agent can serve boards now, and what is wrong with it."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from ..server import Server


class Readiness(NamedTuple):
    """Whether an agent can serve boards.

    Attributes:
        ready: Whether a board can connect: a transport admits boards, and there is memory.
        problems: What is wrong, each with the remedy; an agent may be ready with problems.
    """

    ready: bool
    problems: list[str]


def readiness(server: Server) -> Readiness:
    """Return whether the agent can serve boards; costs some microseconds."""
    agent, now = server.agent, server.clock.time_ns() / 1e9
    problems: list[str] = []
    for transport in server.transports:
        if transport.is_waiting():
            problems.append(f"{transport.label()}: the agent waits for it")
        problems += [f"{transport.label()}: {trouble}" for trouble in transport.troubles(now)]
    ready = any(transport.admits_boards(now) for transport in server.transports)
    if agent.budget.full:
        problems.append("the memory for boards is used up (see --max-memory)")
        ready = False
    if len(agent.clients) >= agent.admission.max_clients:
        problems.append("no places left for boards (see --max-clients)")
    if server.middleware_fails:
        problems.append("the middleware fails (the log has the reason)")
        ready = False
    problems += filter(None, (trouble() for trouble in server.troubles))
    return Readiness(ready, problems)
