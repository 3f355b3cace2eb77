"""The thread that writes a recording, so that a slow disk does not delay the network."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from ...bag.errors import BagError
from ...bag.metadata import TopicMetadata
from .message_cache import MessageCache, Recorded

if TYPE_CHECKING:
    from ...bag.writer import BagWriter

# Seconds between two looks at the cache. Messages are written many at a time, since each change of
# threads costs about as much as writing a message.
_PERIOD: Final = 0.1
# Seconds after which what was written is given to the operating system. A process that is killed
# loses what came since: less than a second, with the time that writing takes.
_FLUSH_PERIOD: Final = 0.5


class WriterThread:
    """Writes what a cache has, until :meth:`close`.

    Args:
        writer: The bag, which the thread alone uses from now on.
        cache: The messages.
        clock: Returns seconds.

    Attributes:
        written: The messages that were written.
        octets: Their octets, without those of the file's format.
        lost: The messages that were not written, or are not readable, because of ``error``.
        error: Why the thread has ended early, or None.
    """

    def __init__(
        self,
        writer: BagWriter,
        cache: MessageCache,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._writer = writer
        self._cache = cache
        self._clock = clock
        self._ids: dict[str, int] = {}
        self._flushed_at = clock()
        self._unflushed = 0
        self._split = threading.Event()
        self.written = 0
        self.octets = 0
        self.lost = 0
        self.error: Exception | None = None
        self._thread = threading.Thread(target=self._run, name="uros bag writer", daemon=True)
        self._thread.start()

    @property
    def is_alive(self) -> bool:
        """Whether it has neither failed nor been closed."""
        return self._thread.is_alive()

    def split(self) -> None:
        """Have the next messages written into another file."""
        self._split.set()

    def _run(self) -> None:
        closed = False
        while not closed:
            batch, closed = self._cache.take(_PERIOD)
            done = 0
            try:
                if self._split.is_set():
                    self._split.clear()
                    self._writer.split()
                for entry in batch:
                    self._write(entry)
                    done += 1
                if closed or self._clock() - self._flushed_at >= _FLUSH_PERIOD:
                    self._flush()
            except (BagError, OSError) as error:
                self.error = error
                self.lost = self._unflushed + sum(isinstance(e, Recorded) for e in batch[done:])
                self.written -= self._unflushed
                self._cache.close()
                self.lost += sum(isinstance(e, Recorded) for e in self._cache.take(0.0)[0])
                break
        try:
            self._writer.close()
        except (BagError, OSError) as error:
            self.error = self.error or error

    def _write(self, entry: Recorded | TopicMetadata) -> None:
        if isinstance(entry, TopicMetadata):
            self._ids[entry.name] = self._writer.add_topic(entry)
            return
        self._writer.write(self._ids[entry.topic.name], entry.cdr, entry.received_ns, entry.sent_ns)
        self._unflushed += 1
        self.written += 1
        self.octets += len(entry.cdr)

    def _flush(self) -> None:
        self._flushed_at = self._clock()
        if self._unflushed:
            self._writer.flush()
            self._unflushed = 0

    def close(self) -> None:
        """Write what the cache has, close the bag and end the thread. Idempotent."""
        self._cache.close()
        self._thread.join()
