"""Logical execution time, and rounds in fixed periods, for control loops with constant timing.

::

    LetExecutor(node)
    Period(node, 0.01).spin()

With a :class:`LetExecutor` a round reads the inputs that were there when it began, and its messages
are sent when it has ended. So however long callbacks take, none receives what another published in
the same round, neither locally nor from the network. With a :class:`Period` the messages are sent
at the end of the period. On a host without an agent samples are sent at once.
"""

from .executor import Executor, Timer

try:
    from typing import Any
except ImportError:  # MicroPython
    pass


class _Cork:
    """Transport wrapper that holds the messages a round sends.

    Messages outside of streams are passed on at once: they belong to the session and no deadline
    applies to them.
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
        elif self._size + size <= self._limit:  # otherwise it is lost, as on an overloaded link
            self._size += size
            self._messages.append(bytes(memoryview(message)[:size]))

    def release(self) -> None:
        messages = self._messages
        self._drop()
        self.holding = False
        for message in messages:
            self._line.send(message, len(message))


class LetExecutor(Executor):
    """Replaces ``node.executor`` and takes over its handles and its trigger.

    A sample that is received during a round is handled in the next one. Nothing is sent during a
    round, so a callback cannot wait for a reply; it can send a request and handle the reply in a
    later round. At most the connection's ``limit`` of bytes is held.
    """

    def __init__(self, node: "Any") -> None:
        old = node.executor
        super().__init__(old.max_handles)
        self.handles = old.handles
        self.trigger = old.trigger
        self.between = old.between
        self.watchdog = old.watchdog
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
        """Run one round and hold what its callbacks send; see :meth:`.Executor.execute`."""
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
        """Send the messages that the round has left."""
        if self._cork is not None:
            try:
                self._cork.release()
            except OSError:  # the session's next message fails, too, and ends the session
                pass


class Period:
    """Runs one round of callbacks at the start of every period of ``seconds``, without drift.

    In the rest of the period the session is served and samples are received; their callbacks are
    called in the next round. ``overruns`` counts periods skipped because a round took longer than
    one.
    """

    def __init__(self, node: "Any", seconds: float) -> None:
        self._node = node
        self._timer = Timer(seconds, self._end, node.clock, False)

    @property
    def overruns(self) -> int:
        """Number of periods skipped because a round took longer than one."""
        return self._timer.missed

    def _end(self) -> None:
        executor = self._node.executor
        if isinstance(executor, LetExecutor):
            executor.release()

    def spin_once(self) -> int:
        """Run one round now and serve the session for the rest of the period.

        Returns:
            The number of callbacks called.
        """
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
            node.executor.feed()
            # As often as `Executor.wait` lets a node with a watchdog wait.
            node.connection.pump(max(0, min(left // 1000000, 250)))
        timer.execute(True)
        return count

    def spin(self) -> None:
        """Spin for ever."""
        while True:
            self.spin_once()


def spin_period(node: "Any", seconds: float) -> None:
    """Spin a node for ever, one round each period, as rclc_executor_spin_period."""
    Period(node, seconds).spin()
