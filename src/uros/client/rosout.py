"""Logging of a node to the console and to ``/rosout``.

``node.get_logger()`` returns the node's :class:`Logger`, as in rclpy. From then on exceptions of
callbacks are logged, too. Logging never waits: the first eight lines logged without an agent are
sent later with their original time. Of a burst, twenty lines a second are sent. Dropped lines are
counted and their number is logged.
"""

import sys

from ..qos import DurabilityPolicy, QoSProfile
from ..ticks import ticks_add, ticks_diff
from .dynamic_messages import Shape
from .latched_publisher import create_latched

try:
    from typing import Any, Callable, Final
except ImportError:  # MicroPython
    pass

try:
    from sys import print_exception  # type: ignore[attr-defined]
except ImportError:  # CPython
    from traceback import print_exception

try:
    from io import StringIO
except ImportError:  # a MicroPython without it
    StringIO = None  # type: ignore[assignment, misc]

UNSET: Final = 0
DEBUG: Final = 10
INFO: Final = 20
WARN: Final = 30
ERROR: Final = 40
FATAL: Final = 50
_NAMES: Final = "DEBUG INFO WARN ERROR FATAL"

# Most lines kept while there is no agent.
_QUEUE: Final = 8
# With an agent one line each _EACH_MS is sent, and bursts of _AT_ONCE lines.
_EACH_MS: Final = 50
_AT_ONCE: Final = 32
# Characters of a line sent to /rosout; the console gets all of it.
_LONGEST: Final = 1024
# Most texts remembered for "once" and the other options. The limit prevents this attack: texts that
# never repeat.
_FILTERS: Final = 32
# Most loggers with a level of their own. The limit prevents this attack: ever new names.
_LEVELS: Final = 32
_LIFESPAN_MS: Final = 10000


class LoggingSeverity:
    """Severities, with the numbers of rcl_interfaces/msg/Log."""

    UNSET = UNSET
    DEBUG = DEBUG
    INFO = INFO
    WARN = WARN
    ERROR = ERROR
    FATAL = FATAL


class Logger:
    """Named logger of a node.

    A logger without a level uses that of its parent, the topmost one INFO. Loggers with the same
    name share their level. The logging methods return whether the line was logged. Their options
    are rclpy's ``once``, ``skip_first`` and ``throttle_duration_sec``. An option applies to all
    calls whose texts differ only in digits, since a board does not know the line of the caller.
    """

    def __init__(self, name: str, log: "Rosout") -> None:
        self.name = name
        self._log = log

    def get_child(self, name: str) -> "Logger":
        """Return the logger ``<this one's name>.<name>``.

        Raises:
            ValueError: The name is empty.
        """
        if not name:
            raise ValueError("a child logger has a name")
        return Logger(self.name + "." + name, self._log)

    def named(self, name: str) -> "Logger":
        """Return the logger with this full name."""
        return Logger(name, self._log)

    def levels(self) -> "dict[str, int]":
        """Return the levels that were set, by full names."""
        return self._log.levels

    def set_level(self, level: int) -> None:
        """Set the level: UNSET (0), DEBUG (10), INFO (20), WARN (30), ERROR (40) or FATAL (50).

        Raises:
            ValueError: The level is another number, or 32 loggers have a level already.
        """
        if level % 10 or not UNSET <= level <= FATAL:
            raise ValueError("%r is no level; give 0, 10, 20, 30, 40 or 50" % (level,))
        levels = self._log.levels
        if self.name not in levels and len(levels) >= _LEVELS:
            raise ValueError("levels of %d loggers are set already" % _LEVELS)
        levels[self.name] = level

    def get_effective_level(self) -> int:
        """Return the level of this logger or of its nearest parent that has one, otherwise INFO."""
        name = self.name
        while name:
            level = self._log.levels.get(name, UNSET)
            if level:
                return level
            name = name[: max(0, name.rfind("."))]
        return INFO

    def is_enabled_for(self, severity: int) -> bool:
        """Return whether lines of this severity are logged."""
        return severity >= self.get_effective_level()

    def log(self, message: "Any", severity: int, **options: "Any") -> bool:
        """Log a line with this severity; return whether it was logged."""
        if not self.is_enabled_for(severity):
            return False
        message = str(message)
        if options and not self._log.passes(self.name, message, severity, **options):
            return False
        self._log.write(self.name, message, severity)
        return True

    def debug(self, message: "Any", **options: "Any") -> bool:
        """Log a line with severity DEBUG."""
        return self.log(message, DEBUG, **options)

    def info(self, message: "Any", **options: "Any") -> bool:
        """Log a line with severity INFO."""
        return self.log(message, INFO, **options)

    def warning(self, message: "Any", **options: "Any") -> bool:
        """Log a line with severity WARN."""
        return self.log(message, WARN, **options)

    def warn(self, message: "Any", **options: "Any") -> bool:
        """Log a line with severity WARN."""
        return self.log(message, WARN, **options)

    def error(self, message: "Any", **options: "Any") -> bool:
        """Log a line with severity ERROR."""
        return self.log(message, ERROR, **options)

    def fatal(self, message: "Any", **options: "Any") -> bool:
        """Log a line with severity FATAL."""
        return self.log(message, FATAL, **options)


class Rosout:
    """Output of a node's loggers, to the console and to ``/rosout``.

    ``console`` gets each line, or is None; ``levels`` are the levels set, by name; ``left_out``
    counts the lines not sent to ``/rosout``.
    """

    def __init__(self, node: "Any") -> None:
        self.console: "Callable[[str], object] | None" = print
        self.levels: "dict[str, int]" = {}
        self.left_out = 0
        self._node = node
        space = node.get_namespace()[1:].replace("/", ".")
        self.logger = Logger(space + "." + node.name if space else node.name, self)
        self._queue: "list[Any]" = []  # (ticks, name, text, severity)
        self._reported = 0  # part of left_out that was logged
        self._free = node.clock.ms()  # for the rate limit: each line sent adds 50 ms
        self._filters: "list[list[Any]]" = []  # text, last time, skipped, logged
        qos = QoSProfile(
            1000, durability=DurabilityPolicy.TRANSIENT_LOCAL, lifespan_ms=_LIFESPAN_MS
        )
        shape = Shape("rcl_interfaces/msg/Log", "iIBssssI")
        self._publisher = create_latched(node, shape, "/rosout", qos)
        self._publisher.on_connected = self._send_queue
        if node.executor.report is print_exception:
            node.executor.report = self.report

    def passes(
        self, name: str, message: str, severity: int, throttle_duration_sec: float = 0,
        skip_first: bool = False, once: bool = False,
    ) -> bool:  # fmt: skip
        """Return whether the options let the line pass, and remember this call."""
        text = "%d%s:" % (severity, name)
        for char in message:
            if not "0" <= char <= "9":
                text += char
        now = self._node.clock.ms()
        known = [entry for entry in self._filters if entry[0] == text]
        if known:
            entry = known[0]
        else:
            entry = [text, None, False, False]
            self._filters.append(entry)
            if len(self._filters) > _FILTERS:
                self._filters.pop(0)
        if throttle_duration_sec:
            if entry[1] is not None and ticks_diff(now, entry[1]) < throttle_duration_sec * 1000:
                return False
            entry[1] = now
        if skip_first and not entry[2]:
            entry[2] = True
            return False
        if once and entry[3]:
            return False
        entry[3] = True
        return True

    def write(self, name: str, message: str, severity: int) -> None:
        """Write a line to the console, and send or keep it for ``/rosout``."""
        if self.console is not None:
            seconds, nanoseconds = self._node.clock.now()
            self.console(
                "[%s] [%d.%09d] [%s]: %s"
                % (
                    _NAMES.split(" ")[min(max(severity // 10, 1), 5) - 1],
                    seconds, nanoseconds, name, message,
                )
            )  # fmt: skip
        now = self._node.clock.ms()
        if self._publisher.created and self._queue:
            self._send_queue()
        if not self._publisher.created or self._queue:
            if len(self._queue) < _QUEUE:
                self._queue.append((now, name, message, severity))
            else:
                self.left_out += 1
            return
        if ticks_diff(now, self._free) >= 0:
            self._free = now
        if ticks_diff(self._free, now) > _AT_ONCE * _EACH_MS:
            self.left_out += 1
            return
        self._report_left_out(now)
        if not self._send(now, name, message, severity):
            self.left_out += 1

    def _send_queue(self) -> bool:
        now = self._node.clock.ms()
        while self._queue:
            if not self._send(*self._queue[0]):
                return False
            self._queue.pop(0)
        self._report_left_out(now)
        return True

    def _report_left_out(self, now: int) -> None:
        count = self.left_out - self._reported
        if count and self._send(now, self.logger.name, "%d lines were left out" % count, WARN):
            self._reported = self.left_out

    def _send(self, when: int, name: str, message: str, severity: int) -> bool:
        """Publish a line logged at the ticks ``when``; return whether it was sent.

        It raises nothing, since the exception would be logged.
        """
        clock = self._node.clock
        try:
            seconds, nanoseconds = clock.now()
            ms = ticks_diff(clock.ms(), when)
            seconds -= ms // 1000
            nanoseconds -= ms % 1000 * 1000000
            if nanoseconds < 0:
                seconds -= 1
                nanoseconds += 1000000000
            self._free = ticks_add(self._free, _EACH_MS)
            return self._publisher.publish(
                self._publisher.type(
                    [max(0, seconds), nanoseconds, severity, name, message[:_LONGEST], "", "", 0]
                )
            )
        except Exception:  # a text that UTF-8 cannot encode, or no memory
            return False

    def report(self, error: Exception) -> None:
        """Log the exception of a callback with its traceback; for the executor."""
        text = repr(error)
        if StringIO is not None:
            out = StringIO()
            if sys.implementation.name == "micropython":
                print_exception(error, out)
            else:
                print_exception(error, file=out)
            text = out.getvalue().strip()
        self.logger.error("a callback raised:\n" + text)
