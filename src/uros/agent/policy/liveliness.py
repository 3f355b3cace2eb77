"""Liveliness: silent clients are probed, and deleted when they do not answer.

A silent client may still be there: a subscriber may have nothing to send for hours. So a client
that was silent for a tenth of the dead time (at most 30 s) is probed
(:meth:`uros.agent.session.session.Session.probe`), and again after as long, until it is heard or
the dead time is over. It is deleted only after several unanswered probes. Time in which the agent
itself did not check (a stopped process, a clock that jumps) does not count: it may have missed the
answers.

A client may ask for a period of its own ("hard liveliness", its property ``uxr_hl``, in
milliseconds): it is probed after each period of silence, and deleted after the third probe.

All clients are checked once a second; there is no work for each message, and no timer for each
client.
"""

from __future__ import annotations

from typing import Final

from ...ticks import TIME_MASK, ticks_diff
from ..context import AgentContext, ClientState
from ..objects.kinds import key_label

# Default and maximum of the dead time: how long a client may be silent, in seconds.
DEAD_TIME: Final = 300.0
MAX_DEAD_TIME: Final = 86_400.0
# Probes before a client is deleted.
PROBES: Final = 3
# The longest silence before the first probe, and between two.
_PATIENCE_MS: Final = 30_000
CHECK_MS: Final = 1000
# The property of hard liveliness, and its limits; a C client can ask for 1 to 999999.
HARD: Final = "uxr_hl"
MIN_HARD_MS: Final = 100
MAX_HARD_MS: Final = 3_600_000
# The most clients that are probed, or deleted, in one check, because all are silent at once when a
# network fails. The next check follows after a pause in which other clients are served.
MAX_PROBED: Final = 64
MAX_DELETED: Final = 16
_REST_MS: Final = 20
# A client that does not answer a probe for so long is told to be silent.
ANSWER_MS: Final = 2000


class _Silence:
    """The silence of one client; times are those of ``Liveliness._time``."""

    __slots__ = ("probed_at", "heard", "probes", "since")

    def __init__(self, heard: int, since: int) -> None:
        self.heard = heard  # Session.heard when it began; it changes with each message
        self.since = since
        self.probes = 0
        self.probed_at = 0


class Liveliness:
    """Checks the liveliness of all clients.

    Args:
        agent: The agent.
        dead_time: Seconds of silence after which a client is deleted; 0 for never, except
            clients with hard liveliness.
    """

    def __init__(self, agent: AgentContext, dead_time: float = DEAD_TIME) -> None:
        self._agent = agent
        self.dead_ms = int(dead_time * 1000)
        self._patience = min(self.dead_ms // 10, _PATIENCE_MS)
        self._silent: dict[ClientState, _Silence] = {}
        self._hard: dict[ClientState, tuple[int, _Silence]] = {}  # and the period
        self._asked: dict[ClientState, _Silence] = {}  # see ask()
        # Milliseconds in which the process was running: the time between two checks that should
        # be `_pause` apart, but no more than a second over that.
        self._time = 0
        self._pause = CHECK_MS
        self._checked_at: int | None = None
        self._next_check_all = 0

    def enroll(self, client: ClientState, properties: list[tuple[str, str]]) -> None:
        """Note the properties of a CREATE_CLIENT."""
        self._hard.pop(client, None)
        text = next((value for name, value in properties if name == HARD), None)
        if text is None:
            return
        about = f"client_key: {key_label(client.key)}"
        decimal = text.isascii() and text.isdecimal() and len(text) < 20
        if not decimal or not int(text):
            times = self._agent.faults.times(f"{client.key:08X} {HARD}")
            if times is not None:
                self._agent.log.warning(
                    "Root", "create_client", "hard liveliness ignored",
                    f"{about}, {HARD}: {text[:40]!r} is no number of milliseconds above 0{times}",
                )  # fmt: skip
            return
        period = min(max(int(text), MIN_HARD_MS), MAX_HARD_MS)
        self._hard[client] = period, _Silence(client.session.heard, self._time)
        self._agent.log.info(
            "ProxyClient", "create_client", "session hard timeout enabled",
            f"{about}, timeout: {period} ms",
        )  # fmt: skip

    def ask(self, client: ClientState) -> None:
        """Probe a silent client now, once in a silence, for :meth:`is_unanswered`.

        This does not count towards the probes before the client is deleted.
        """
        asked = self._asked.get(client)
        if asked is None or asked.heard != client.session.heard:
            self._asked[client] = asked = _Silence(client.session.heard, self._time)
            self._probe(client, asked, [1, 0])

    def is_unanswered(self, client: ClientState) -> bool:
        """Return whether a probe of the client has had no answer for :data:`ANSWER_MS`."""
        hard = self._hard.get(client)
        silences = (self._asked.get(client), self._silent.get(client), hard[1] if hard else None)
        return any(
            silence is not None
            and silence.probes > 0
            and silence.heard == client.session.heard
            and (silence.probes > 1 or self._time - silence.probed_at >= ANSWER_MS)
            for silence in silences
        )

    def check(self) -> float:
        """Probe and delete clients; return the seconds until the next check."""
        now = self._agent.now()
        if self._checked_at is not None:
            elapsed = max(0, ticks_diff(now, self._checked_at))
            self._time += min(elapsed, self._pause + 1000)
        self._checked_at = now
        quota = [MAX_PROBED, MAX_DELETED]
        for client, asked in list(self._asked.items()):
            gone = self._agent.clients.get(client.key) is not client
            if gone or asked.heard != client.session.heard:
                del self._asked[client]
        if self._hard:
            self._check_hard(quota)
        if self.dead_ms and self._time >= self._next_check_all:
            self._check_all(now, quota)
            self._next_check_all = self._time + CHECK_MS - _REST_MS
        pause = min((period // 2 for period, _ in self._hard.values()), default=CHECK_MS)
        if min(quota) <= 0:
            pause = _REST_MS
            self._next_check_all = 0
        self._pause = min(pause, CHECK_MS)
        return self._pause / 1000

    def _check_all(self, now: int, quota: list[int]) -> None:
        patience, before = self._patience, self._silent
        self._silent = after = {}
        silent = [
            client
            for client in self._agent.clients.values()
            if (now - client.session.heard) & TIME_MASK >= patience
        ]
        for client in silent:
            if client in self._hard:
                continue
            silence = before.get(client)
            if silence is None or silence.heard != client.session.heard:
                silence = _Silence(client.session.heard, self._time - patience)
            after[client] = silence
            unanswered_for = self._time - silence.probed_at
            if (
                silence.probes >= PROBES
                and self._time - silence.since >= self.dead_ms
                and unanswered_for >= min(patience, CHECK_MS)
            ):
                self._delete(client, silence, quota, "set by --dead-time SECONDS, 0: never")
            elif not silence.probes or unanswered_for >= patience:
                self._probe(client, silence, quota)

    def _check_hard(self, quota: list[int]) -> None:
        clients = self._agent.clients
        for client, (period, silence) in list(self._hard.items()):
            if clients.get(client.key) is not client:
                del self._hard[client]
            elif silence.heard != client.session.heard:
                self._hard[client] = period, _Silence(client.session.heard, self._time)
            elif self._time - max(silence.since, silence.probed_at) < period:
                continue
            elif silence.probes >= PROBES:
                self._delete(client, silence, quota, f"requested by the client: {HARD}={period}")
            else:
                self._probe(client, silence, quota)

    def _probe(self, client: ClientState, silence: _Silence, quota: list[int]) -> None:
        if quota[0] > 0:
            silence.probes += 1
            silence.probed_at = self._time
            client.session.probe()
            self._agent.attend(client.session)
        quota[0] -= 1

    def _delete(self, client: ClientState, silence: _Silence, quota: list[int], why: str) -> None:
        if quota[1] > 0:
            seconds = (self._time - silence.since) / 1000
            self._agent.log.warning(
                "Root", "check_liveliness", "client is silent",
                f"client_key: {key_label(client.key)}, address: {self._agent.address(client.key)},"
                f" no message for {seconds:.{0 if seconds >= 10 else 1}f} s,"
                f" {silence.probes} probes unanswered: deleted ({why})",
            )  # fmt: skip
            self._agent.delete_client(client.key)
        quota[1] -= 1
