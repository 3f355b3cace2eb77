"""The snapshots of the agents that run on this machine."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from .finding import Finding, unknown

Snapshot = dict[str, Any]


class Agents:
    """Those that can be asked, or the one with a pid. ``looks`` are what they said, each time that
    they were asked.
    """

    def __init__(
        self,
        pid: int | None = None,
        find: Callable[[], list[Any]] | None = None,
        ask: Callable[[Any], Snapshot] | None = None,
    ) -> None:
        self.looks: list[list[Snapshot]] = []
        self.failed: list[Finding] = []
        self._pid = pid
        self._find = find or _find
        self._ask = ask or _ask

    @property
    def now(self) -> list[Snapshot]:
        """The last look."""
        return self.looks[-1] if self.looks else []

    @property
    def pids(self) -> set[int]:
        return {int(it["pid"]) for it in self.now if isinstance(it.get("pid"), int)}

    def look(self) -> None:
        """Ask them all once. Who does not answer is a finding in ``failed``."""
        found: list[Snapshot] = []
        self.failed = []
        try:
            agents = self._find()
        except OSError as error:
            agents = []
            self.failed.append(unknown("agents", f"agents cannot be looked for: {error}"))
        for agent in agents:
            try:
                snapshot = self._ask(agent)
            except (OSError, ValueError, RuntimeError) as error:
                self.failed.append(unknown("agents", f"{agent}: {error}"))
                continue
            if self._pid is None or snapshot.get("pid") == self._pid:
                found.append(snapshot)
        if self._pid is not None and not found:
            self.failed.append(
                unknown(
                    "agents",
                    f"there is no agent of uros with pid {self._pid}",
                    "see which there are: uros agent status",
                )
            )
        self.looks.append(found)

    def nodes(self) -> list[tuple[str, int]]:
        """The boards' nodes by full name, each with its domain."""
        return [
            (str(node.get("name")), int(node.get("domain", 0)))
            for it in self.now
            if it.get("middleware") not in ("memory", "ced")
            for client in it.get("clients", [])
            for node in client.get("nodes", [])
        ]


def _find() -> list[Any]:
    from ..agent.running_agents import find_agents

    return list(find_agents())


def _ask(agent: Any) -> Snapshot:
    from ..agent.running_agents import ask

    snapshot: Snapshot = ask(agent, "status")
    return snapshot
