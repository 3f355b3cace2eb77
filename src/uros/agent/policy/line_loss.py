"""Line loss: clients of a lost line are deleted unless they come back soon.

Silence alone does not show that a client has left (:mod:`.liveliness`), but an unplugged serial
line does: the ROS graph must show within ten seconds that its board has left. It may come back in
that time, on this line or on another one. So each client of a lost line is checked once a second,
and probed when its line is open again. Any message from the client ends the checks. A client that
sent none within :data:`CHECKS` checks is deleted with its objects; if its line came back late, it
is probed twice before that.

Checks are counted instead of seconds, because a process that is stopped, or a machine that sleeps,
cannot receive answers. TCP is not affected, because a session ends with its connection.
"""

from __future__ import annotations

from typing import Any, Final

from ...ticks import ticks_add
from ..context import AgentContext, ClientState
from ..objects.kinds import key_label
from ..transports.base import ServerTransport

# Checks, one a second, in which a client can come back; and probes before it is deleted. If a line
# comes back at the last check there are two more checks, still within ten seconds of the loss.
CHECKS: Final = 7
PROBES: Final = 2
_CHECK_SECONDS: Final = 1.0


class _Missing:
    """A client whose line was lost."""

    __slots__ = ("probes", "heard", "checks", "place")

    def __init__(self, heard: int, place: tuple[ServerTransport, Any]) -> None:
        self.heard = heard  # Session.heard at the loss; another value means that it sent something
        self.place = place
        self.checks = 0
        self.probes = 0


class LineLossMonitor:
    """Watches the clients of lost lines."""

    def __init__(self, agent: AgentContext) -> None:
        self._agent = agent
        self._missing: dict[ClientState, _Missing] = {}
        self._checking = False

    def lost(self, transport: ServerTransport) -> None:
        """Watch the clients of a transport that lost a line."""
        for key, client in self._agent.clients.items():
            if self._agent.place(key)[0] is transport:
                self.watch(client)

    def watch(self, client: ClientState) -> None:
        """Watch a client, if its line is lost."""
        transport, peer = place = self._agent.place(client.key)
        lost = self._missing.get(client)
        if not transport.is_away(peer) or (lost is not None and not self._is_back(client, lost)):
            return
        now = self._agent.now()
        if client.session.heard == now:
            client.session.heard = ticks_add(now, -1)  # a message in this millisecond must differ
        self._missing[client] = _Missing(client.session.heard, place)
        if not self._checking:
            self._checking = True
            self._agent.wake_at(_CHECK_SECONDS, self._check)

    def _check(self) -> None:
        agent = self._agent
        try:
            for client, missing in list(self._missing.items()):
                if self._is_back(client, missing):
                    del self._missing[client]
                    continue
                transport, peer = missing.place
                missing.checks += 1
                away = transport.is_away(peer)
                if missing.checks >= CHECKS and (away or missing.probes >= PROBES):
                    del self._missing[client]
                    self._delete(client, missing.checks)
                elif not away:
                    missing.probes += 1
                    client.session.probe()
                    agent.attend(client.session)
        finally:
            self._checking = bool(self._missing)
            if self._checking:
                agent.wake_at(_CHECK_SECONDS, self._check)

    def _is_back(self, client: ClientState, missing: _Missing) -> bool:
        agent = self._agent
        return (
            agent.clients.get(client.key) is not client
            or client.session.heard != missing.heard
            or agent.place(client.key) != missing.place
        )

    def _delete(self, client: ClientState, checks: int) -> None:
        agent = self._agent
        agent.log.warning(
            "Root", "check_lines", "line is gone",
            f"client_key: {key_label(client.key)}, address: {agent.address(client.key)},"
            f" not back within {checks} s: deleted (it starts anew when it comes back)",
        )  # fmt: skip
        agent.delete_client(client.key)
