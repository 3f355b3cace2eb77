"""One rclpy context, which is one domain, and the thread that waits in its wait set.

rcl's wait set is level-triggered: an entity with something to take is ready again and again. So the
thread waits only for entities from which something was taken since their ``on_ready`` was called,
and sleeps until the data plane has dispatched what it found. A guard condition makes it leave the
wait set when an entity in it must be destroyed.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

from ..base import MiddlewareError, OnReady
from ..wakeup_fd import WakeupFd
from . import rcl


class EntityListener:
    """An entity that is waited for.

    Attributes:
        entity: rclpy's entity.
        kind: ``subscription``, ``client`` or ``service``.
        on_ready: Called when something has arrived, and again only when :attr:`taken` is set.
        taken: Whether something was taken since the last call.
        paused: Whether it is left out of the wait set until something is taken.
    """

    __slots__ = ("entity", "kind", "on_ready", "paused", "taken")

    def __init__(self, entity: Any, kind: str, on_ready: OnReady) -> None:
        self.entity = entity
        self.kind = kind
        self.on_ready = on_ready
        self.taken = True
        self.paused = False


class RosDomain:
    """A domain. The data plane's thread calls all methods except those of the waiting thread.

    Attributes:
        context: rclpy's context.
    """

    def __init__(self, domain: int, wakeup: WakeupFd) -> None:
        self.context = rcl.open_context(domain)
        self._wakeup = wakeup
        self._turn = threading.Condition()
        # The condition guards these:
        self._listeners: dict[int, EntityListener] = {}  # by the address of the entity
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

    def watch(self, listener: EntityListener) -> None:
        """Wait for an entity from now on."""
        with self._turn:
            self._listeners[listener.entity.pointer] = listener
            self._interrupt()
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="uros-ros2", daemon=True)
            self._thread.start()

    def destroy(self, listener: EntityListener) -> None:
        """Wait for an entity no more, and take it off the network."""
        with self.held():
            self._listeners.pop(listener.entity.pointer, None)
            listener.entity.destroy_when_not_in_use()

    def resume(self, listener: EntityListener) -> None:
        """Wait again for an entity that was paused."""
        with self._turn:
            listener.paused = False
            self._interrupt()

    def _interrupt(self) -> None:
        """Have the thread collect its entities again; called with the condition held."""
        if self._waiting:
            self._guard.trigger_guard_condition()

    @contextmanager
    def held(self) -> Iterator[None]:
        """Keep the thread out of the wait set, so that its entities may be destroyed."""
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
            self._wakeup.set()

    def _wait(self) -> bool:
        """Wait once; return False when the domain is closed."""
        with self._turn:
            while (self._held or self._ready) and not self._closed:
                self._turn.wait()
            if self._closed:
                return False
            chosen = [listener for listener in self._listeners.values() if not listener.paused]
            self._waiting = True
        ready = self._ready_of(chosen)
        with self._turn:
            self._waiting = False
            self._ready = ready
            self._turn.notify_all()
        if ready:
            self._wakeup.set()
        return True

    def _ready_of(self, chosen: list[EntityListener]) -> list[int]:
        """Sleep until something arrives; return the addresses of the entities that are ready."""
        kinds = ("subscription", "client", "service")
        counts = [sum(entity_listener.kind == kind for entity_listener in chosen) for kind in kinds]
        handle = self.context.handle
        with ExitStack() as used:
            used.enter_context(handle)
            waitset = self._rcl.WaitSet(counts[0], 1, 0, counts[1], counts[2], 0, handle)
            used.callback(waitset.destroy_when_not_in_use)
            waitset.clear_entities()
            waitset.add_guard_condition(self._guard)
            for listener in chosen:
                getattr(waitset, "add_" + listener.kind)(listener.entity)
            waitset.wait(-1)  # without the GIL
            ready: list[int] = []
            for kind, count in zip(kinds, counts, strict=True):
                if count:
                    ready += waitset.get_ready_entities(kind)
            return ready

    # --- the data plane's part ----------------------------------------------------

    def dispatch(self) -> Exception | None:
        """Call ``on_ready`` of all entities that are ready.

        Returns:
            What one of them raised, once all were called; None if none did.
        """
        with self._turn:
            failure, self._failure = self._failure, None
            ready = self._ready
        failed: Exception | None = failure and MiddlewareError(
            f"ROS 2 delivers nothing more ({failure}): start the agent again"
        )
        for address in ready:
            listener = self._listeners.get(address)
            if listener is None or listener.paused:
                continue
            if listener.taken:
                listener.taken = False
                try:
                    listener.on_ready()
                except Exception as error:
                    failed = error
            if not listener.taken:
                listener.paused = True
        with self._turn:
            self._ready = []
            self._turn.notify_all()
        return failed

    def close(self) -> None:
        """Destroy the remaining entities, and leave the network."""
        with self._turn:
            self._closed = True
            self._interrupt()
            self._turn.notify_all()
        if self._thread is not None:
            self._thread.join()
        for listener in self._listeners.values():
            listener.entity.destroy_when_not_in_use()
        self._listeners.clear()
        self._guard.destroy_when_not_in_use()
        self.context.try_shutdown()
        self.context.destroy()
