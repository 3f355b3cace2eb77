"""Two who say they are the same client: one came with its key from elsewhere.

It may be the board itself, after a reset or on another network; another board with the same
firmware and key; or somebody who wants to take its place. So the known place is asked for a
sign of life. While that is awaited the newcomer gets no answer (C clients ask again each
second). Whatever comes from the known place in half a second defends it, and the newcomer is
refused; else the newcomer has its place.

A place with a certificate goes to nobody who does not show the same one, however silent it is: the
client must have left, or be forgotten. And who takes a place has what the former client made only
where transport, certificate and rules are the same (:meth:`.agent.Agent.take_over`).

A place that was defended is not asked again for some seconds, in which all newcomers are
refused at once: a flood of them costs the client a few small messages and, where its network
loses some, not its session.
"""

from __future__ import annotations

from typing import Any, Final

from ...ticks import ticks_add, ticks_diff
from ..context import AgentContext, ClientState, CreateClientRequest
from ..objects.kinds import key_label
from ..transports.base import ServerTransport
from .admission import KEY_IN_USE

# The known place is asked, and given so long each time.
WAIT_MS: Final = (150, 150, 200)
# How long a defended place is safe.
DEFENDED_MS: Final = 5000
# Attack: newcomers for all clients at once. Decisions that may be awaited; others wait.
MAX_TRIALS: Final = 256


class _Trial:
    """One key, two places. ``request`` is None where the newcomer goes on with the session."""

    __slots__ = ("asked", "client", "due", "heard", "peer", "request", "transport")

    def __init__(
        self,
        client: ClientState,
        transport: ServerTransport,
        peer: Any,
        request: CreateClientRequest | None,
        now: int,
    ) -> None:
        self.client = client
        self.transport = transport
        self.peer = peer
        self.request = request
        self.asked = 0
        self.due = now
        if client.session.heard == now:
            # What comes in this same millisecond must differ.
            client.session.heard = ticks_add(now, -1)
        self.heard = client.session.heard


class Rivals:
    """See the module."""

    def __init__(self, agent: AgentContext) -> None:
        self._agent = agent
        self._trials: dict[int, _Trial] = {}
        self._defended: dict[int, int] = {}  # since when, by key

    def challenge(
        self,
        client: ClientState,
        transport: ServerTransport,
        peer: Any,
        request: CreateClientRequest | None,
    ) -> None:
        """A newcomer talks as ``client``, which is known at another place."""
        key, now = client.key, self._agent.now()
        if client.certificate not in (None, transport.certificate_of(peer)):
            self._refuse(client, transport, peer, request)
            return
        trial = self._trials.get(key)
        if trial is not None:
            if trial.transport is transport and trial.peer == peer:
                trial.request = request or trial.request
            self._look(key, trial)
            return
        since = self._defended.get(key)
        if since is not None and 0 <= ticks_diff(now, since) < DEFENDED_MS:
            self._refuse(client, transport, peer, request)
        elif len(self._trials) < MAX_TRIALS:
            trial = self._trials[key] = _Trial(client, transport, peer, request, now)
            self._look(key, trial)

    def gone(self, transport: ServerTransport, peer: Any) -> None:
        """A newcomer's connection is closed: it does not wait any more."""
        for key, trial in list(self._trials.items()):
            if trial.transport is transport and trial.peer == peer:
                del self._trials[key]

    def _look(self, key: int, trial: _Trial) -> None:
        """Ask, or decide, what is due."""
        if self._trials.get(key) is not trial:
            return
        agent, client, now = self._agent, trial.client, self._agent.now()
        resident = agent.clients.get(key)
        if resident is not client:  # it has left meanwhile
            del self._trials[key]
            place, request = (trial.transport, trial.peer), trial.request
            if request is not None and resident is not None and agent.place(key) != place:
                self.challenge(resident, *place, request)  # another one has come before it
            elif request is not None:
                agent.take_over(key, *place, request)
        elif client.session.heard != trial.heard:
            del self._trials[key]
            if len(self._defended) >= MAX_TRIALS:
                self._defended.clear()
            self._defended[key] = now
            self._refuse(client, trial.transport, trial.peer, trial.request)
        elif ticks_diff(now, trial.due) < 0:
            return
        elif trial.asked < len(WAIT_MS):
            # One question a look, whatever the clock says: there must be time for an answer.
            wait = WAIT_MS[trial.asked]
            trial.asked += 1
            trial.due = ticks_add(now, wait)
            client.session.probe()
            agent.attend(client.session)
            # One more: timers fire in the millisecond before, too.
            agent.wake_at((wait + 1) / 1000, lambda: self._look(key, trial))
        else:
            del self._trials[key]
            agent.take_over(key, trial.transport, trial.peer, trial.request)

    def _refuse(
        self,
        client: ClientState,
        transport: ServerTransport,
        peer: Any,
        request: CreateClientRequest | None,
    ) -> None:
        agent, key, address = self._agent, client.key, transport.address(peer)
        why = "answers"
        if client.certificate not in (None, transport.certificate_of(peer)):
            why = "has shown a certificate, and its place goes to no other"
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
