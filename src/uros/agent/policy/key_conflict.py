"""Duplicate client keys: the incumbent wins if it answers a probe.

A claimant is a client that uses the key of another one, the incumbent, from another address. It
may be the board itself, after a reset or on another network; another board with the same firmware
and key; or an attacker. So the agent sends the incumbent up to three probes. Meanwhile the claimant
gets no answer (C clients repeat CREATE_CLIENT each second). Any message of the incumbent within
half a second refuses the claimant; otherwise the claimant takes over.

The key of a client that showed a certificate goes only to a claimant with the same certificate,
even if the incumbent answers no probe: for others the key is free when the incumbent has deleted
its session, or was deleted for its silence. A claimant inherits the objects of the incumbent only
if transport, certificate and rules are the same (:meth:`uros.agent.agent.Agent.take_over`).

After an incumbent has answered, it is not probed again for :data:`DEFENDED_MS`, and claimants are
refused at once. So a flood of claimants costs the incumbent only a few small messages. Without
that pause it could also cost the session: on a lossy network, all three probes of some round would
be lost.
"""

from __future__ import annotations

from typing import Any, Final

from ...ticks import ticks_add, ticks_diff
from ..context import AgentContext, ClientState, CreateClientRequest
from ..objects.kinds import key_label
from ..transports.base import ServerTransport
from .admission import KEY_IN_USE

# How long the incumbent has to answer each probe, in milliseconds.
WAIT_MS: Final = (150, 150, 200)
# How long an incumbent that answered is not probed again, in milliseconds.
DEFENDED_MS: Final = 5000
# The most keys that are probed at a time, because there may be claimants for all clients at once.
# Claimants for other keys get no answer and repeat their request.
MAX_PROBES: Final = 256


class _TakeoverProbe:
    """One key with its incumbent and its claimant.

    ``request`` is None if the claimant continues the session instead of creating one.
    """

    __slots__ = ("claimant", "due", "heard", "incumbent", "probes", "request")

    def __init__(
        self,
        incumbent: ClientState,
        claimant: tuple[ServerTransport, Any],
        request: CreateClientRequest | None,
        now: int,
    ) -> None:
        self.incumbent = incumbent
        self.claimant = claimant
        self.request = request
        self.probes = 0  # the number sent so far
        self.due = now
        if incumbent.session.heard == now:
            # A message that comes in this same millisecond must change `heard`, too.
            incumbent.session.heard = ticks_add(now, -1)
        self.heard = incumbent.session.heard


class KeyConflicts:
    """Decides which of two clients with one key the agent serves."""

    def __init__(self, agent: AgentContext) -> None:
        self._agent = agent
        self._probes: dict[int, _TakeoverProbe] = {}
        self._defended: dict[int, int] = {}  # when the incumbent answered, by key

    def challenge(
        self, incumbent: ClientState, transport: ServerTransport, peer: Any,
        request: CreateClientRequest | None,
    ) -> None:  # fmt: skip
        """Handle a message with the incumbent's key from another address.

        Args:
            incumbent: The client that has the key.
            transport: The claimant's transport.
            peer: The claimant's address there.
            request: Its CREATE_CLIENT; None if it continues the session.
        """
        key, now = incumbent.key, self._agent.now()
        if incumbent.certificate not in (None, transport.certificate_of(peer)):
            self._refuse(incumbent, transport, peer, request)
            return
        probe = self._probes.get(key)
        if probe is not None:
            if probe.claimant[0] is transport and probe.claimant[1] == peer:
                probe.request = request or probe.request
            self._check(key, probe)
            return
        since = self._defended.get(key)
        if since is not None and 0 <= ticks_diff(now, since) < DEFENDED_MS:
            self._refuse(incumbent, transport, peer, request)
        elif len(self._probes) < MAX_PROBES:
            probe = _TakeoverProbe(incumbent, (transport, peer), request, now)
            self._probes[key] = probe
            self._check(key, probe)

    def gone(self, transport: ServerTransport, peer: Any) -> None:
        """Drop the claims of a peer whose connection is closed."""
        for key, probe in list(self._probes.items()):
            if probe.claimant[0] is transport and probe.claimant[1] == peer:
                del self._probes[key]

    def _check(self, key: int, probe: _TakeoverProbe) -> None:
        """Send a probe or decide, if it is time."""
        if self._probes.get(key) is not probe:
            return
        agent, incumbent, now = self._agent, probe.incumbent, self._agent.now()
        current = agent.clients.get(key)
        if current is not incumbent:  # the incumbent has left meanwhile
            del self._probes[key]
            place, request = probe.claimant, probe.request
            if request is not None and current is not None and agent.place(key) != place:
                self.challenge(current, *place, request)  # another claimant came first
            elif request is not None:
                agent.take_over(key, *place, request)
        elif incumbent.session.heard != probe.heard:
            del self._probes[key]
            if len(self._defended) >= MAX_PROBES:
                self._defended.clear()
            self._defended[key] = now
            self._refuse(incumbent, *probe.claimant, probe.request)
        elif ticks_diff(now, probe.due) < 0:
            return
        elif probe.probes < len(WAIT_MS):
            # One probe a check, whatever the clock says: there must be time for an answer.
            wait = WAIT_MS[probe.probes]
            probe.probes += 1
            probe.due = ticks_add(now, wait)
            incumbent.session.probe()
            agent.attend(incumbent.session)
            # One millisecond more, since a timer may fire up to a millisecond early.
            agent.wake_at((wait + 1) / 1000, lambda: self._check(key, probe))
        else:
            del self._probes[key]
            agent.take_over(key, *probe.claimant, probe.request)

    def _refuse(
        self, incumbent: ClientState, transport: ServerTransport, peer: Any,
        request: CreateClientRequest | None,
    ) -> None:  # fmt: skip
        agent, key, address = self._agent, incumbent.key, transport.address(peer)
        why = "answers"
        if incumbent.certificate not in (None, transport.certificate_of(peer)):
            why = "showed a certificate, and the key is reserved for that certificate"
        agent.refusals.note(key, KEY_IN_USE, address, agent.clock.monotonic())
        times = agent.faults.times(f"{KEY_IN_USE} {key:08X}")
        if times is not None:
            agent.log.warning(
                "Root", "create_client", KEY_IN_USE,
                f"client_key: {key_label(key)}, refused at {address}: the client at"
                f" {agent.address(key)} {why} (give each board a key of its own){times}",
            )  # fmt: skip
        if request is not None:
            agent.deny(key, transport, peer, request)
