"""Logical execution time, and rounds in fixed periods: for control loops that must be the same
every time.

::

    LetExecutor(node)
    Period(node, 0.01).spin()

With a :class:`LetExecutor` what a round reads is what was there when it began, and what it sends
leaves when it has ended: however long callbacks take, none hears what another has said in the same
round, here or by way of the network. With a :class:`Period` it leaves at the end of the period. On
a host without an agent samples leave at once.
"""

from .executor import Executor, Timer

try:
    from typing import Any
except ImportError:  # MicroPython
    pass


class _Cork:
    """A transport, and before it what a round has sent. Messages outside of streams pass: they
    are the session's own, and wait for no deadline.
    """

    def __init__(self, line: "Any", limit: int) -> None:
        self.mtu = line.mtu
        self.holding = False
        self._line = line
        self._limit = limit
        self._size = 0
        self._messages: "list[bytes]" = []
        self.open = line.open
        self.receive = line.receive

    def close(self) -> None:
        self._drop()
        self._line.close()

    def _drop(self) -> None:
        self._messages = []
        self._size = 0

    def send(self, message: "Any", size: int) -> None:
        if not self.holding or message[1] == 0:
            self._line.send(message, size)
        elif self._size + size <= self._limit:  # else it is lost, as on any line that is full
            self._size += size
            self._messages.append(bytes(memoryview(message)[:size]))

    def release(self) -> None:
        messages = self._messages
        self._drop()
        self.holding = False
        for message in messages:
            self._line.send(message, len(message))


class LetExecutor(Executor):
    """Takes the place of ``node.executor``, with all handles, and its trigger.

    Inputs are as they were when the round began: a sample that comes while it runs waits for the
    next one. In a round nothing is sent, so a callback cannot wait for an answer; it can ask, and
    hear it in a later round. At most the connection's ``limit`` of bytes is held.
    """

    def __init__(self, node: "Any") -> None:
        old = node.executor
        super().__init__(old.max_handles)
        self.handles = old.handles
        self.trigger = old.trigger
        self.between = old.between
        self.report = old.report
        self.failed = old.failed
        self.until_deadline = False  # a Period releases
        self._depth = 0
        self._cork: "Any" = None
        if node.connection.has_agent:
            session: "Any" = node.connection
            self._cork = session.transport
            if not isinstance(self._cork, _Cork):
                self._cork = _Cork(session.transport, session.limit)
                session.transport = self._cork
        node.executor = self

    def execute(self, now: int) -> int:
        """As Executor's; what callbacks send is held."""
        self._depth += 1
        if self._cork is not None:
            self._cork.holding = True
        try:
            return super().execute(now)
        finally:
            self._depth -= 1
            if not self._depth and not self.until_deadline:
                self.release()

    def release(self) -> None:
        """Send what the round has left."""
        if self._cork is not None:
            try:
                self._cork.release()
            except OSError:  # the line is gone, as the session's next message finds
                pass


class Period:
    """One round of callbacks at the start and every ``seconds`` from then on, without drift.

    What comes meanwhile is taken, and the session served, but called back in the next round.
    ``overruns`` counts periods that were left out because a round took longer than one.
    """

    def __init__(self, node: "Any", seconds: float) -> None:
        self._node = node
        self._timer = Timer(seconds, self._end, node.clock, False)

    @property
    def overruns(self) -> int:
        return self._timer.missed

    def _end(self) -> None:
        executor = self._node.executor
        if isinstance(executor, LetExecutor):
            executor.release()

    def spin_once(self) -> int:
        """One round, now, and the rest of its period; how many callbacks ran."""
        node = self._node
        timer = self._timer
        if timer.is_canceled():
            timer.reset()
            node.connection.pump(0)
        if isinstance(node.executor, LetExecutor):
            node.executor.until_deadline = True
        count: int = node.executor.execute(node.clock.ms())
        while not timer.is_ready():
            left = timer.time_until_next_call() or 0
            node.connection.pump(max(0, min(left // 1000000, 1000)))
        timer.execute(True)
        return count

    def spin(self) -> None:
        """For ever."""
        while True:
            self.spin_once()


def spin_period(node: "Any", seconds: float) -> None:
    """Spin a node for ever, one round each period: rclc's rclc_executor_spin_period."""
    Period(node, seconds).spin()
