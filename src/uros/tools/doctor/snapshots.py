"""Collects the snapshots of the agents that run on this machine."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from .finding import Finding, unknown

Snapshot = dict[str, Any]


class Agents:
    """The agents of this machine, asked several times.

    Args:
        choice: The process id of the only agent to check, or the name of its configuration file;
            None for all.
        find: Finds the agents.
        ask: Asks one for its snapshot.

    Attributes:
        looks: The snapshots of each time.
        failed: Findings about agents that did not answer the last time.
    """

    def __init__(
        self,
        choice: int | str | None = None,
        find: Callable[[], list[Any]] | None = None,
        ask: Callable[[Any], Snapshot] | None = None,
    ) -> None:
        self.looks: list[list[Snapshot]] = []
        self.failed: list[Finding] = []
        self._choice = choice
        self._find = find or _find
        self._ask = ask or _ask

    @property
    def now(self) -> list[Snapshot]:
        """The latest snapshots."""
        return self.looks[-1] if self.looks else []

    @property
    def pids(self) -> set[int]:
        """The process ids of the agents."""
        pids = (snapshot.get("pid") for snapshot in self.now)
        return {pid for pid in pids if isinstance(pid, int)}

    def look(self) -> None:
        """Ask all agents once."""
        found: list[Snapshot] = []
        self.failed = []
        try:
            agents = self._find()
        except OSError as error:
            agents = []
            self.failed.append(unknown("agents", f"agents cannot be searched for: {error}"))
        for agent in agents:
            try:
                snapshot = self._ask(agent)
            except (OSError, ValueError, RuntimeError) as error:
                self.failed.append(unknown("agents", f"{agent}: {error}"))
                continue
            if self._is_chosen(snapshot):
                found.append(snapshot)
        if self._choice is not None and not found:
            which = "pid" if isinstance(self._choice, int) else "the configuration file"
            self.failed.append(
                unknown(
                    "agents",
                    f"there is no uros agent with {which} {self._choice}",
                    "list the agents: uros agent status",
                )
            )
        self.looks.append(found)

    def _is_chosen(self, snapshot: Snapshot) -> bool:
        from ..agent.running_agents import is_named

        if isinstance(self._choice, str):
            return is_named(snapshot.get("config") or "", self._choice)
        return self._choice is None or snapshot.get("pid") == self._choice

    def nodes(self) -> list[tuple[str, int]]:
        """Return the full names of the boards' nodes, each with its domain."""
        return [node for snapshot in self.now for node in _nodes(snapshot)]

    def domains(self) -> dict[int, set[int]]:
        """Return the domains of the boards of each agent, by its process id."""
        return {
            snapshot.get("pid", 0): {domain for _, domain in _nodes(snapshot)}
            for snapshot in self.now
        }


def _nodes(snapshot: Snapshot) -> list[tuple[str, int]]:
    if snapshot.get("middleware") in ("memory", "ced"):
        return []
    return [
        (str(node.get("name")), int(node.get("domain", 0)))
        for client in snapshot.get("clients", [])
        for node in client.get("nodes", [])
    ]


def _find() -> list[Any]:
    from ..agent.running_agents import find_agents

    return list(find_agents())


def _ask(agent: Any) -> Snapshot:
    from ..agent.running_agents import ask

    snapshot: Snapshot = ask(agent, "status")
    return snapshot
