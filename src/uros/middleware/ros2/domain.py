"""One rclpy context, which is one domain, and the thread that waits in its wait set.

rcl's waiting is by level: what has something to take is ready again and again. So the thread waits
only for those who took since they were last told, sleeps until the data plane has dispatched what
it found, and is taken out of the wait set by a guard condition whenever something in it must go.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

from ..base import MiddlewareError, OnReady
from ..wakeup_fd import Wake
from . import rcl


class Watched:
    """What is waited for: an entity of one ``kind`` (``subscription``, ``client``, ``service``).

    ``on_ready`` is called when something came, and again only when ``taken`` is set; ``paused``
    says that it is left out of the wait set until then.
    """

    __slots__ = ("entity", "kind", "on_ready", "paused", "taken")

    def __init__(self, entity: Any, kind: str, on_ready: OnReady) -> None:
        self.entity = entity
        self.kind = kind
        self.on_ready = on_ready
        self.taken = True
        self.paused = False


class RosDomain:
    """See the module. All but the thread's own part is for the data plane's thread."""

    def __init__(self, domain: int, wake: Wake) -> None:
        self.context = rcl.open_context(domain)
        self._wake = wake
        self._turn = threading.Condition()
        # Under the condition:
        self._watched: dict[int, Watched] = {}  # by the address of the entity
        self._ready: list[int] = []
        self._waiting = False
        self._held = False
        self._closed = False
        self._failure: Exception | None = None
        with rcl.refused("a guard condition"), self.context.handle:
            self._rcl = rcl.load()
            self._guard = self._rcl.GuardCondition(self.context.handle)
        self._thread: threading.Thread | None = None

    # --- what is waited for -----------------------------------------------------

    def watch(self, watched: Watched) -> None:
        """Wait for an entity from now on."""
        with self._turn:
            self._watched[watched.entity.pointer] = watched
            self._interrupt()
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="uros-ros2", daemon=True)
            self._thread.start()

    def destroy(self, watched: Watched) -> None:
        """Wait for it no more, and take it off the network."""
        with self.held():
            self._watched.pop(watched.entity.pointer, None)
            watched.entity.destroy_when_not_in_use()

    def resume(self, watched: Watched) -> None:
        """Wait again for one that was left out."""
        with self._turn:
            watched.paused = False
            self._interrupt()

    def _interrupt(self) -> None:
        """With the condition: have the thread look at what it waits for."""
        if self._waiting:
            self._guard.trigger_guard_condition()

    @contextmanager
    def held(self) -> Iterator[None]:
        """The thread stays out of the wait set, where all that is in use must not go."""
        with self._turn:
            self._held = True
            self._interrupt()
            while self._waiting:
                self._turn.wait()
            try:
                yield
            finally:
                self._held = False
                self._turn.notify_all()

    # --- the thread -------------------------------------------------------------

    def _run(self) -> None:
        try:
            while self._wait():
                pass
        except Exception as error:  # the context is gone, or rcl out of memory
            with self._turn:
                self._failure = error
                self._waiting = False
                self._turn.notify_all()
            self._wake.set()

    def _wait(self) -> bool:
        """Wait once. False: there is nothing more to wait for."""
        with self._turn:
            while (self._held or self._ready) and not self._closed:
                self._turn.wait()
            if self._closed:
                return False
            chosen = [it for it in self._watched.values() if not it.paused]
            self._waiting = True
        ready = self._ready_of(chosen)
        with self._turn:
            self._waiting = False
            self._ready = ready
            self._turn.notify_all()
        if ready:
            self._wake.set()
        return True

    def _ready_of(self, chosen: list[Watched]) -> list[int]:
        """Sleep until something came; what it came to, by address."""
        kinds = ("subscription", "client", "service")
        counts = [sum(it.kind == kind for it in chosen) for kind in kinds]
        handle = self.context.handle
        with ExitStack() as used:
            used.enter_context(handle)
            waitset = self._rcl.WaitSet(counts[0], 1, 0, counts[1], counts[2], 0, handle)
            used.callback(waitset.destroy_when_not_in_use)
            waitset.clear_entities()
            waitset.add_guard_condition(self._guard)
            for it in chosen:
                getattr(waitset, "add_" + it.kind)(it.entity)
            waitset.wait(-1)  # without the GIL
            ready: list[int] = []
            for kind, count in zip(kinds, counts, strict=True):
                if count:
                    ready += waitset.get_ready_entities(kind)
            return ready

    # --- the data plane's part ----------------------------------------------------

    def has_news(self) -> bool:
        """Whether :meth:`dispatch` has work."""
        return bool(self._ready) or self._failure is not None

    def dispatch(self) -> Exception | None:
        """Call ``on_ready`` of all that is ready. What goes wrong there is returned: others must
        hear of theirs first.
        """
        with self._turn:
            failure, self._failure = self._failure, None
            ready = self._ready
        failed: Exception | None = failure and MiddlewareError(
            f"ROS 2 delivers nothing more ({failure}): start the agent again"
        )
        for address in ready:
            watched = self._watched.get(address)
            if watched is None or watched.paused:
                continue
            if watched.taken:
                watched.taken = False
                try:
                    watched.on_ready()
                except Exception as error:
                    failed = error
            if not watched.taken:
                watched.paused = True  # until somebody takes
        with self._turn:
            self._ready = []
            self._turn.notify_all()
        return failed

    def close(self) -> None:
        """Destroy what is still there, and leave the network."""
        with self._turn:
            self._closed = True
            self._interrupt()
            self._turn.notify_all()
        if self._thread is not None:
            self._thread.join()
        for watched in self._watched.values():
            watched.entity.destroy_when_not_in_use()
        self._watched.clear()
        self._guard.destroy_when_not_in_use()
        self.context.try_shutdown()
        self.context.destroy()
