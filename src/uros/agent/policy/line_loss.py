"""Clients whose line is gone leave, unless they come back soon.

Silence says nothing of a client (:mod:`.liveliness`), but a serial line that is unplugged does: the
board behind it is gone from the network, and the graph should say so within ten seconds. It may
come back in that time, with the line or on another one. So each client of a lost line is looked at
once a second, and asked for a sign of life as soon as its line is there again. Whatever comes from
it ends that; who has said nothing after :data:`LOOKS` seconds is forgotten with all it made. A line
that came back late has the time for two questions.

Looks are counted and not seconds: in a process that is stopped, or a machine that sleeps, nobody
misses a board, nor hears it. TCP is no case of this: a session ends with its connection.
"""

from __future__ import annotations

from typing import Any, Final

from ...ticks import ticks_add
from ..context import AgentContext, ClientState
from ..objects.kinds import key_label
from ..transports.base import ServerTransport

# How many looks a client has to come back, a second each; and questions before it is forgotten.
# A line that comes back at the last look makes it two more: within ten seconds of the loss.
LOOKS: Final = 7
QUESTIONS: Final = 2
_LOOK_SECONDS: Final = 1.0


class _Missing:
    """A client whose line was lost."""

    __slots__ = ("asked", "heard", "looks", "place")

    def __init__(self, heard: int, place: tuple[ServerTransport, Any]) -> None:
        self.heard = heard  # what Session.heard was; another value is a sign of life
        self.place = place
        self.looks = 0
        self.asked = 0


class LineLossMonitor:
    """See the module."""

    def __init__(self, agent: AgentContext) -> None:
        self._agent = agent
        self._missing: dict[ClientState, _Missing] = {}
        self._looking = False

    def lost(self, transport: ServerTransport) -> None:
        """A line of the transport is gone."""
        for key, client in self._agent.clients.items():
            if self._agent.place(key)[0] is transport:
                self.watch(client)

    def watch(self, client: ClientState) -> None:
        """Begin to miss the client, if its line is away."""
        transport, peer = place = self._agent.place(client.key)
        known = self._missing.get(client)
        if not transport.is_away(peer) or (known is not None and not self._is_back(client, known)):
            return
        now = self._agent.now()
        if client.session.heard == now:
            client.session.heard = ticks_add(now, -1)  # what comes now must differ
        self._missing[client] = _Missing(client.session.heard, place)
        if not self._looking:
            self._looking = True
            self._agent.wake_at(_LOOK_SECONDS, self._look)

    def _look(self) -> None:
        agent = self._agent
        try:
            for client, missing in list(self._missing.items()):
                if self._is_back(client, missing):
                    del self._missing[client]
                    continue
                transport, peer = missing.place
                missing.looks += 1
                away = transport.is_away(peer)
                if missing.looks >= LOOKS and (away or missing.asked >= QUESTIONS):
                    del self._missing[client]
                    self._forget(client, missing.looks)
                elif not away:
                    missing.asked += 1
                    client.session.probe()
                    agent.attend(client.session)
        finally:
            self._looking = bool(self._missing)
            if self._looking:
                agent.wake_at(_LOOK_SECONDS, self._look)

    def _is_back(self, client: ClientState, missing: _Missing) -> bool:
        agent = self._agent
        return (
            agent.clients.get(client.key) is not client
            or client.session.heard != missing.heard
            or agent.place(client.key) != missing.place
        )

    def _forget(self, client: ClientState, looks: int) -> None:
        agent = self._agent
        agent.log.warning(
            "Root", "check_lines", "line is gone",
            f"client_key: {key_label(client.key)}, address: {agent.address(client.key)},"
            f" not back within {looks} s: forgotten (it starts anew when it comes back)",
        )  # fmt: skip
        agent.delete_client(client.key)
