"""The waitset, the thread that sleeps in it, and the readers whose samples it reports.

The thread waits in Cyclone's waitset without the GIL. When samples arrive it notes their readers,
makes the wakeup descriptor readable and waits for a lock until the data plane has dispatched. The
data plane's thread takes the samples itself, and no Python runs in Cyclone's own threads.
"""

from __future__ import annotations

import itertools
import threading
from collections.abc import Sequence

from ..base import OnReady
from ..wakeup_fd import WakeupFd
from . import cyclone


class ReaderListener:
    """A reader, or a writer with a status to wait for, in the waitset of a :class:`Dispatcher`.

    Attributes:
        dispatcher: The dispatcher it is registered with.
        entity: The DDS entity.
        key: Its number in the waitset.
        on_ready: Called when something has arrived, and again only when :attr:`taken` is set.
        taken: Whether something was taken since the last call.
        paused: Whether it is left out of the waitset until something is taken.
        local_only: See :meth:`Dispatcher.watch_local`.

    Args:
        dispatcher: What watches it from now on.
        entity: The DDS entity.
        on_ready: What to call.
        may_be_local: Whether it is a reader that writers of this middleware may match.
    """

    __slots__ = ("dispatcher", "entity", "key", "local_only", "on_ready", "paused", "taken")

    def __init__(
        self, dispatcher: Dispatcher, entity: int, on_ready: OnReady, may_be_local: bool = False
    ) -> None:
        self.dispatcher = dispatcher
        self.entity = entity
        self.on_ready = on_ready
        self.taken = True
        self.paused = False
        self.local_only = may_be_local
        self.key = dispatcher.watch_local(self) if may_be_local else dispatcher.watch(self)


class Dispatcher:
    """Calls ``on_ready`` of the listeners that have something to take.

    All methods are for the data plane's thread; :meth:`_run` is the waiting thread's.

    Attributes:
        wakeup: Readable when :meth:`dispatch` has work.
        own_writers: Instance handles of this middleware's writers.
        noted: What :meth:`dispatch_local` has to do: readers just written to by this process, whose
            samples Cyclone has ready when the write returns, and readers with samples left over.
    """

    def __init__(self) -> None:
        self.wakeup = WakeupFd()
        self.own_writers: set[int] = set()
        self._listeners: dict[int, ReaderListener] = {}  # by key
        self.noted: dict[int, Sequence[ReaderListener]] = {}
        self._keys = itertools.count(1)
        self._waitset: cyclone.Waitset | None = None
        self._ready: list[int] = []  # set by the waiting thread
        self._resume = threading.Lock()
        self._closed = False
        self._thread: threading.Thread | None = None

    def watch(self, listener: ReaderListener) -> int:
        """Add a listener to the waitset, and return its key there."""
        if self._waitset is None:
            self._waitset = cyclone.Waitset()
            self._resume.acquire()
            self._thread = threading.Thread(target=self._run, name="uros-dds", daemon=True)
            self._thread.start()
        key = next(self._keys)
        self._listeners[key] = listener
        self._waitset.attach(listener.entity, key)
        return key

    def watch_local(self, listener: ReaderListener) -> int:
        """Add a reader that wakes the waiting thread only once writers of others match it.

        Until then only this middleware's own writers match it, and :meth:`written` reports their
        samples. The status mask is set before the reader is in the waitset: otherwise a match may
        wake the thread, and is then taken for samples.
        """
        cyclone.wake_on(listener.entity, cyclone.STATUS_SUBSCRIPTION_MATCHED)
        self._has_remote_samples(listener)
        key = self.watch(listener)
        if cyclone.has_changed(listener.entity, cyclone.STATUS_DATA_AVAILABLE):
            self.written([listener])  # the history of our transient-local writers
        return key

    def _has_remote_samples(self, listener: ReaderListener) -> bool:
        """Return whether a local reader has samples of others.

        As soon as writers of others match it, it stops being local, and samples that come later
        wake the waiting thread.
        """
        if cyclone.matched_writers(listener.entity) <= self.own_writers:
            return False
        listener.local_only = False
        cyclone.wake_on(listener.entity, cyclone.STATUS_DATA_AVAILABLE)
        return cyclone.has_changed(listener.entity, cyclone.STATUS_DATA_AVAILABLE)

    def unwatch(self, listener: ReaderListener) -> None:
        """Take a listener out of the waitset; idempotent."""
        if self._listeners.pop(listener.key, None) and self._waitset:
            self._waitset.detach(listener.entity)

    def resume(self, listener: ReaderListener) -> None:
        """Put a paused listener back into the waitset; see :meth:`dispatch`."""
        listener.paused = False
        if self._waitset and listener.key in self._listeners:
            self._waitset.attach(listener.entity, listener.key)

    def written(self, listeners: Sequence[ReaderListener], wakes: bool = True) -> None:
        """Note that this process has written to these readers.

        Args:
            listeners: The readers, which may still change.
            wakes: Whether :meth:`dispatch` is to be called for them; False where
                :meth:`dispatch_local` follows.
        """
        if wakes and not self.noted:
            self.wakeup.set()
        self.noted[id(listeners)] = listeners

    def requeue(self, listener: ReaderListener) -> None:
        """Call ``on_ready`` once more, after those of others, because samples are left."""
        if not self.noted:
            self.wakeup.set()
        self.noted[-listener.key] = [listener]

    def dispatch(self) -> None:
        """Call ``on_ready`` of all listeners that have something to take.

        A listener that takes nothing then is paused, as it would wake the thread again and again.

        Raises:
            Exception: What an ``on_ready`` raised, after all others were called.
        """
        self.wakeup.clear()
        ready, self._ready = self._ready, []
        failed = self._dispatch_written()
        for key in ready:
            listener = self._listeners.get(key)
            if listener is None or (listener.local_only and not self._has_remote_samples(listener)):
                continue
            if not listener.paused:
                failed = self._notify(listener) or failed
                if not listener.taken and key in self._listeners and self._waitset:
                    listener.paused = True
                    self._waitset.detach(listener.entity)
        if ready:
            self._resume.release()
        if failed is not None:
            raise failed

    def dispatch_local(self) -> None:
        """Do the same for what :meth:`written` and :meth:`requeue` have noted, and nothing else."""
        failed = self._dispatch_written()
        if self.noted:  # written by what was called
            self.wakeup.set()
        if failed is not None:
            raise failed

    def _dispatch_written(self) -> Exception | None:
        failed: Exception | None = None
        noted, self.noted = self.noted, {}  # what they write now is dispatched next time
        for listeners in noted.values():
            for listener in list(listeners):
                if listener.key in self._listeners:
                    failed = self._notify(listener) or failed
        return failed

    def _notify(self, listener: ReaderListener) -> Exception | None:
        """Call ``on_ready`` unless nothing was taken since; return what it raised."""
        if listener.taken:
            listener.taken = False
            try:
                listener.on_ready()
            except Exception as error:
                return error
        return None

    def _run(self) -> None:
        waitset = self._waitset
        assert waitset is not None
        while not self._closed:
            ready = waitset.wait()
            if ready:
                self._ready = ready
                self.wakeup.set()
                self._resume.acquire()  # until the data plane has dispatched

    def stop(self) -> None:
        """End the waiting thread; idempotent. The entities must still exist."""
        if self._closed:
            return
        self._closed = True
        if self._thread and self._waitset:
            self._waitset.wake()
            if self._resume.locked():
                self._resume.release()
            self._thread.join()
            self._waitset.close()

    def close(self) -> None:
        """Close the wakeup descriptor; idempotent."""
        self.wakeup.close()
