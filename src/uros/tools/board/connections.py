"""Which virtual boards are connected to an agent, as the running agents report."""

from __future__ import annotations

import os
import threading
from pathlib import Path
from typing import Any, Final

from ..errors import ToolError

_PERIOD_SECONDS: Final = 1.0

Client = dict[str, Any]


class Connections:
    """Asks agents for their clients once a second, in a thread: an agent may answer late.

    Args:
        pid: The process id of the agent to ask; None asks all agents of this user.
        port: The UDP port at which boards with Wi-Fi look for an agent that is not named.
    """

    def __init__(self, pid: int | None, port: int) -> None:
        self._pid = pid
        self._port = port
        self._lines: dict[str, Client] = {}  # by the real path of their serial line
        self._hosts: dict[str, Client] = {}  # by their IP address
        self._closed = threading.Event()
        threading.Thread(target=self._poll, name="connections", daemon=True).start()

    def client(self, path: Path, address: str) -> Client | None:
        """Return what an agent reports of a board; None if no agent has it.

        Args:
            path: The board's USB line.
            address: Its own IP address on this host, "" if it has none.
        """
        found = self._lines.get(os.path.realpath(path))
        return self._hosts.get(address) if found is None else found

    def close(self) -> None:
        """Stop asking. Idempotent."""
        self._closed.set()

    def _poll(self) -> None:
        while not self._closed.is_set():
            self._ask()
            self._closed.wait(_PERIOD_SECONDS)

    def _ask(self) -> None:
        from ..agent.running_agents import ask, find_agent, find_agents

        lines: dict[str, Client] = {}
        hosts: dict[str, Client] = {}
        try:
            agents = find_agents() if self._pid is None else [find_agent(self._pid)]
        except ToolError:
            agents = []
        for agent in agents:
            try:
                snapshot = ask(agent, "status")
            except ToolError:
                continue
            labels = [transport["label"] for transport in snapshot["transports"]]
            has_port = self._pid is not None or f"port {self._port}" in labels
            for client in snapshot["clients"]:
                # A serial line is followed by the board's address on it: "/dev/ttyACM0 (1)".
                line, is_line, _ = client["address"].rpartition(" (")
                host, _, port = client["address"].rpartition(":")
                if is_line:
                    lines[os.path.realpath(line)] = client
                elif has_port and port.isdecimal():
                    hosts[host] = client
        self._lines, self._hosts = lines, hosts
