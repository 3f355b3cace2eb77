"""Who is still there: silent clients are asked, and forgotten when they stay silent.

Silence alone says nothing, a subscriber may have nothing to say for hours. So a client
that was silent for a tenth of the dead time (at most 30 s) is asked for a sign of life
(:meth:`.session.Session.probe`), and again after as long, until it is heard or the dead
time is over. It is forgotten only after several unanswered questions, and time in which
the agent itself did not look (a stopped process, a clock that jumps) does not count: it
may have missed the answers.

A client may ask for the same at a pace of its own ("hard liveliness": its property
``uxr_hl``, in milliseconds): asked at each period of silence, forgotten after the third.

One look at all clients a second; nothing at each message, and no timer a client.
"""

from __future__ import annotations

from typing import Final

from ...ticks import TIME_MASK, ticks_diff
from ..context import AgentContext, ClientState
from ..objects.kinds import key_label

# Seconds that a client may be silent for, if the owner says nothing; and at most.
DEAD_TIME: Final = 300.0
MAX_DEAD_TIME: Final = 86_400.0
# Nobody is forgotten who was not asked so often.
QUESTIONS: Final = 3
# The longest silence before the first question, and between two.
_PATIENCE_MS: Final = 30_000
LOOK_MS: Final = 1000
# Of `uxr_hl`; a C client can ask for 1 to 999999.
HARD: Final = "uxr_hl"
MIN_HARD_MS: Final = 100
MAX_HARD_MS: Final = 3_600_000
# A network that fails silences all at once: so many are asked, or forgotten, at a time, and
# after a pause in which others are served the next.
MAX_ASKED: Final = 64
MAX_FORGOTTEN: Final = 16
_REST_MS: Final = 20


class _Silence:
    """Of one client. Times are of :attr:`Liveliness._time`."""

    __slots__ = ("asked_at", "heard", "questions", "since")

    def __init__(self, heard: int, since: int) -> None:
        self.heard = heard  # what Session.heard was; another value is a sign of life
        self.since = since
        self.questions = 0
        self.asked_at = 0


class Liveliness:
    """See the module. ``dead_time`` is in seconds; 0: only who asks for it is looked after."""

    def __init__(self, agent: AgentContext, dead_time: float = DEAD_TIME) -> None:
        self._agent = agent
        self.dead_ms = int(dead_time * 1000)
        self._patience = min(self.dead_ms // 10, _PATIENCE_MS)
        self._silent: dict[ClientState, _Silence] = {}
        self._hard: dict[ClientState, tuple[int, _Silence]] = {}  # and the period
        # Milliseconds in which we were awake: what elapses between two looks that should be
        # `_pause` apart, but no more than a second over that.
        self._time = 0
        self._pause = LOOK_MS
        self._looked: int | None = None
        self._next_look_at_all = 0

    def enroll(self, client: ClientState, properties: list[tuple[str, str]]) -> None:
        """The client has come, or come again, with these properties."""
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

    def look(self) -> float:
        """Ask and forget whom it is time for; seconds until the next look."""
        now = self._agent.now()
        if self._looked is not None:
            elapsed = max(0, ticks_diff(now, self._looked))
            self._time += min(elapsed, self._pause + 1000)
        self._looked = now
        left = [MAX_ASKED, MAX_FORGOTTEN]
        if self._hard:
            self._look_at_hard(left)
        if self.dead_ms and self._time >= self._next_look_at_all:
            self._look_at_all(now, left)
            self._next_look_at_all = self._time + LOOK_MS - _REST_MS
        pause = min((period // 2 for period, _ in self._hard.values()), default=LOOK_MS)
        if min(left) <= 0:
            pause = _REST_MS
            self._next_look_at_all = 0
        self._pause = min(pause, LOOK_MS)
        return self._pause / 1000

    def _look_at_all(self, now: int, left: list[int]) -> None:
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
            asked_for = self._time - silence.asked_at
            if (
                silence.questions >= QUESTIONS
                and self._time - silence.since >= self.dead_ms
                and asked_for >= min(patience, LOOK_MS)
            ):
                self._forget(client, silence, left, "changed by --dead-time SECONDS, 0: never")
            elif not silence.questions or asked_for >= patience:
                self._ask(client, silence, left)

    def _look_at_hard(self, left: list[int]) -> None:
        clients = self._agent.clients
        for client, (period, silence) in list(self._hard.items()):
            if clients.get(client.key) is not client:
                del self._hard[client]
            elif silence.heard != client.session.heard:
                self._hard[client] = period, _Silence(client.session.heard, self._time)
            elif self._time - max(silence.since, silence.asked_at) < period:
                continue
            elif silence.questions >= QUESTIONS:
                self._forget(client, silence, left, f"it asks for that by {HARD}={period}")
            else:
                self._ask(client, silence, left)

    def _ask(self, client: ClientState, silence: _Silence, left: list[int]) -> None:
        if left[0] > 0:
            silence.questions += 1
            silence.asked_at = self._time
            client.session.probe()
            self._agent.attend(client.session)
        left[0] -= 1

    def _forget(self, client: ClientState, silence: _Silence, left: list[int], why: str) -> None:
        if left[1] > 0:
            seconds = (self._time - silence.since) / 1000
            self._agent.log.warning(
                "Root", "check_liveliness", "client is silent",
                f"client_key: {key_label(client.key)}, address: {self._agent.address(client.key)},"
                f" nothing heard for {seconds:.{0 if seconds >= 10 else 1}f} s,"
                f" {silence.questions} questions unanswered: forgotten ({why})",
            )  # fmt: skip
            self._agent.delete_client(client.key)
        left[1] -= 1
