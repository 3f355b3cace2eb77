"""``--diagnostics``: the state of boards on ``/diagnostics``, for ROS tools (REP-107).

A node of the agent publishes a status for itself and one for each board. A message has at most
:data:`GROUP` of them, so that it fits a UDP datagram, and the messages of a period are spread over
it: so many boards at once would delay others, and overflow the queues of subscribers. Beyond
:data:`MAX_RATE` statuses a second, the period becomes longer.

Statuses are made in the server's thread, in slices. An error of the middleware is logged, and the
node is created anew in the next period; boards are not affected.
"""

from __future__ import annotations

import platform
from collections import Counter
from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from ...middleware.base import MiddlewareError, Node, Writer
from ...printable import printable
from ...qos import QoSProfile
from ..log import RateLimit
from ..objects.client import ProxyClient
from ..objects.kinds import key_label
from ..transports.base import INFO, WARNING
from . import snapshot
from .diagnostic_array import TYPE, DiagnosticArray, Status
from .health import agent_status, board_status, left_status

if TYPE_CHECKING:
    from ..server import Server

TOPIC: Final = "rt/diagnostics"
NODE: Final = "uros_agent"
# As diagnostic_updater: tools take a status for stale after five seconds.
PERIOD: Final = 1.0
# Stands for the agent among the keys of clients, none of which is 0.
_AGENT_KEY: Final = 0
# Statuses in a message, of about 900 octets each.
GROUP: Final = 20
# The part of a period over which its messages are spread; in the rest the last of them is finished.
_SPREAD: Final = 0.8
# The most statuses a second, because each takes some 0.08 ms.
MAX_RATE: Final = 1500
# A board that left is told for so many seconds, and so many of these boards at most, because a
# client may leave and come back with another key.
LEFT_SECONDS: Final = 60.0
MAX_LEFT: Final = 200
# A board that was sending so many messages a second is probed after so many seconds of silence,
# fewer than those of a rate; others are probed by :mod:`~uros.agent.policy.liveliness` alone.
_TALKING_RATE: Final = 0.5
_ASK_SECONDS: Final = 3.0
# The time from one log line about a failing middleware to the next, in seconds.
_FAULT_SECONDS: Final = 60.0
# How long a new board may take to create its node, whose name is in that of its status. In seconds.
_NAMING_SECONDS: Final = 2.0


class _Board:
    """A board that was told.

    Attributes:
        born: When its client was created, which identifies it.
        name: The name of its status, which stays the same as long as it is connected.
        message: The message of its last status.
        left_at: When it was found to have left; None: it is there.
    """

    __slots__ = ("born", "left_at", "message", "name")

    def __init__(self, born: float, name: str) -> None:
        self.born = born
        self.name = name
        self.message = ""
        self.left_at: float | None = None


class Diagnostics:
    """Publishes the state of boards; an attachment of the server.

    Args:
        domain: The domain of its node.
        period: Seconds from one status of a board to the next.
        node: The name of its node, with which all names of statuses begin.
    """

    def __init__(self, domain: int, period: float = PERIOD, node: str = NODE) -> None:
        self._domain = domain
        self._period = period
        self._name = node
        self._host = platform.node()
        self._server: Server | None = None
        self._node: Node | None = None
        self._writer: Writer | None = None
        self._boards: dict[int, _Board] = {}
        self._unfinished = 0  # groups of the last period
        self._not_before = 0.0  # when the next period may begin
        self._marked_at: float | None = None
        # How many boards have each level, and bytes held for all, as told in the last period.
        self._levels: Counter[int] = Counter()
        self._held = 0
        # The same of this period.
        self._new_levels: Counter[int] = Counter()
        self._new_held = 0

    def open(self, server: Server) -> None:
        """Start. What fails is tried again, as the network may not be there yet."""
        self._server = server
        self._rates = snapshot.Rates(server.agent.clients)
        self._faults = RateLimit(_FAULT_SECONDS, clock=server.clock.monotonic)
        server.wake_at(0.0, self._begin)

    def close(self) -> None:
        """Leave the network. Idempotent."""
        self._server = None
        self._disconnect()

    # --- the node -----------------------------------------------------------------------

    def _connect(self, server: Server) -> Writer | None:
        """Return the writer; None if it cannot be created now."""
        if self._writer is None:
            try:
                self._node = server.agent.middleware.create_node(self._domain, "/", self._name)
                self._writer = self._node.create_writer(TOPIC, TYPE, QoSProfile(depth=10))
            except Exception as error:
                self._failed(server, error)
            else:
                server.note(
                    INFO, "Diagnostics", "init", "publishing",
                    f"topic: /diagnostics, domain_id: {self._domain}, node: /{self._name}",
                )  # fmt: skip
        return self._writer

    def _disconnect(self) -> None:
        node, self._node, self._writer = self._node, None, None
        if node is not None:
            node.close()

    def _failed(self, server: Server, error: Exception) -> None:
        if not isinstance(error, MiddlewareError):
            server.agent.failed(error)
        elif (times := self._faults.times("diagnostics")) is not None:
            server.note(
                WARNING, "Diagnostics", "publish", "middleware error",
                f"{error}{times} (tried again every {self._period:g} s)",
            )  # fmt: skip
        self._disconnect()

    def _publish(self, server: Server, cdr: bytes) -> None:
        writer = self._connect(server)
        if writer is None:
            return
        try:
            writer.write(cdr)  # without room it is lost, and the next one has newer statuses
        except Exception as error:
            self._failed(server, error)

    # --- a period -------------------------------------------------------------------------

    def _begin(self) -> None:
        """Begin a period."""
        server = self._server
        if server is None:
            return
        server.wake_at(self._period, self._begin)
        now = server.clock.monotonic()
        if self._unfinished or now < self._not_before or self._connect(server) is None:
            return
        if self._marked_at is None or now - self._marked_at >= snapshot.RATE_SECONDS:
            self._marked_at = now
            self._rates.mark(now)
        self._note_left(server, now)
        # Keys alone: an object for each board would be work for the garbage collector.
        keys = [_AGENT_KEY, *server.agent.clients]
        keys += [key for key in self._boards if key not in server.agent.clients]
        groups = [keys[start : start + GROUP] for start in range(0, len(keys), GROUP)]
        least = len(keys) / MAX_RATE
        pause = max(_SPREAD * self._period, least) / len(groups)
        self._not_before = now + least
        self._unfinished = len(groups)
        self._levels, self._held = self._new_levels, self._new_held
        self._new_levels, self._new_held = Counter(), 0
        for index, group in enumerate(groups):
            server.wake_at(index * pause, partial(self._start, server, group))

    def _start(self, server: Server, group: list[int]) -> None:
        steps = self._tell(server, group)
        snapshot.run_in_slices(server, steps, lambda: self._server is not None)

    def _tell(self, server: Server, group: list[int]) -> Iterator[None]:
        """Make the statuses of a group, one a step, and publish them."""
        try:
            array = DiagnosticArray(server.clock.time_ns())
            for key in group:
                status = self._status(server, key)
                if status is not None:
                    array.add(status)
                yield
            if array.count:
                self._publish(server, array.finish())
        finally:
            self._unfinished -= 1

    def _status(self, server: Server, key: int) -> Status | None:
        """Return the status of the agent, of a board, or of a board that has left."""
        if key == _AGENT_KEY:
            return self._agent(server)
        client = server.agent.clients.get(key)
        return self._left(server, key) if client is None else self._board(server, client)

    def _agent(self, server: Server) -> Status:
        return agent_status(
            f"{self._name}: agent", self._host, snapshot.head(server), snapshot.refused(server),
            len(server.agent.clients), self._levels, self._held,
        )  # fmt: skip

    def _board(self, server: Server, client: ProxyClient) -> Status | None:
        """Return the status of a board; None if it may still get a name."""
        entry = snapshot.board(server, client, self._rates)
        board = self._boards.get(client.key)
        if board is None or board.born != client.born:
            if not entry["nodes"] and entry["age"] < _NAMING_SECONDS:
                return None
            board = self._boards[client.key] = _Board(client.born, self._name_of(entry))
        talking = entry["received"]["rate"] >= _TALKING_RATE
        if talking and entry["heard_ago"] >= _ASK_SECONDS:
            server.agent.liveliness.ask(client)
        status = board_status(board.name, entry, server.clock.time_ns() / 1e9)
        board.message = status.message
        self._new_levels[status.level] += 1
        self._new_held += entry["held"]
        return status

    def _name_of(self, entry: dict[str, Any]) -> str:
        """Return the name of a board's status: tools take a slash at its begin for a folder."""
        name = f"{self._name}: board {entry['key']}"
        nodes = entry["nodes"]
        return f"{name} {printable(nodes[0]['name']).lstrip('/')}" if nodes else name

    # --- boards that have left ------------------------------------------------------------

    def _note_left(self, server: Server, now: float) -> None:
        """Note which boards have left, and forget those that have been told for long enough."""
        left = []
        for key, board in self._boards.items():
            if key in server.agent.clients:
                continue
            if board.left_at is None:
                board.left_at = now
            left.append((board.left_at, key))
        left.sort()
        for index, (left_at, key) in enumerate(left):
            if now - left_at > LEFT_SECONDS or index < len(left) - MAX_LEFT:
                del self._boards[key]

    def _left(self, server: Server, key: int) -> Status | None:
        """Return the status of a board that has left; None if it was never told, or just left."""
        board = self._boards.get(key)
        if board is None or board.left_at is None:
            return None
        seconds = server.clock.monotonic() - board.left_at
        return left_status(board.name, key_label(key), seconds, board.message)
