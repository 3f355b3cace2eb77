"""Finds the agents that run with a configuration file: what they have open is no fault of it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import cached_property

from ...doctor.process import Process, can_look, folder, uros_agents
from ...errors import ToolError


class OwnAgents:
    """The agents that run with one configuration file.

    Args:
        path: The file.
    """

    def __init__(self, path: str) -> None:
        self._path = os.path.realpath(path)

    def has(self, holders: Sequence[Process] | None) -> bool:
        """Return whether one of the agents has what is in use.

        Args:
            holders: The processes that have it, as far as permissions allow; None if the system
                does not tell. Without any, it is taken for a running agent's.
        """
        if not holders:
            return bool(self._pids)
        return any(holder.pid in self._pids for holder in holders)

    @cached_property
    def _pids(self) -> set[int]:
        """The process ids: by the command lines of all users, or of this user's status sockets."""
        if can_look():
            return {agent.pid for agent in uros_agents() if _config_of(agent) == self._path}
        from ..running_agents import ask, find_agents

        found = set()
        for agent in find_agents():
            try:
                config = ask(agent, "status").get("config")
            except ToolError:  # it has ended, or hangs
                continue
            if isinstance(config, str) and os.path.realpath(config) == self._path:
                found.add(agent.pid)
        return found


def _config_of(agent: Process) -> str:
    """Return the path of ``--config``; "" without it, or if it cannot be told."""
    path = ""
    for at, word in enumerate(agent.command):
        option, given, value = word.partition("=")
        if option == "--config":
            path = value if given else "".join(agent.command[at + 1 : at + 2])
    if not path:
        return ""
    path = os.path.join(folder(agent.pid), path)
    return os.path.realpath(path) if os.path.isabs(path) else ""
