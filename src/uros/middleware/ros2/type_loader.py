"""A thread that imports rclpy and the types of services while the data plane serves boards.

Importing rclpy and the type support of a service takes tenths of a second, and seconds from a cold
disk. So a thread does the imports, and nothing else. It reports the types by name. The data plane
creates the nodes and their endpoints, because rclpy holds the GIL for that anyway.

An import holds the GIL too while it loads a library. Two measures keep that short: another process
imports everything first, which brings it from disk into memory, and rclpy's own library, with rcl
and the RMW that it needs, is mapped by a call that does not hold the GIL.
"""

from __future__ import annotations

import threading
from importlib import import_module
from typing import Final

from ..base import MiddlewareError
from ..ros_names import TypeName
from ..wakeup_fd import WakeupFd
from . import rcl, types

# Seconds for which closing waits for an import, which cannot be cancelled.
_PATIENCE: Final = 5.0


class TypeLoader:
    """Loads types on request. The data plane calls all methods except those of the thread.

    Attributes:
        failure: Why rclpy cannot be used, once that is known.

    Args:
        wakeup: Set when :meth:`take_results` has something.
    """

    def __init__(self, wakeup: WakeupFd) -> None:
        self.failure: ImportError | MiddlewareError | None = None
        self._wakeup = wakeup
        self._loaded: set[TypeName] = set()
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()
        # Under the lock:
        self._requested: dict[TypeName, None] = {}
        self._results: dict[TypeName, MiddlewareError | None] = {}
        self._busy = False
        self._closed = False
        self._rclpy_was_tried = False  # the thread's own

    def is_loaded(self, name: TypeName) -> bool:
        """Return whether a service of that type can be created at once."""
        return name in self._loaded

    def request(self, name: TypeName) -> None:
        """Load a type; :meth:`take_results` reports it. Idempotent."""
        with self._lock:
            if name in self._results or self._closed:
                return
            self._requested[name] = None
            if self._busy:
                return
            self._busy = True
        self._thread = threading.Thread(target=self._run, name="uros-rclpy", daemon=True)
        self._thread.start()

    def cancel(self, name: TypeName) -> None:
        """Cancel a request, unless its import has begun."""
        with self._lock:
            self._requested.pop(name, None)

    def has_results(self) -> bool:
        """Return whether :meth:`take_results` has something."""
        return bool(self._results)

    def take_results(self) -> dict[TypeName, MiddlewareError | None]:
        """Return the requests that have ended since the last call, each with its error, if any.

        If rclpy cannot be used, :attr:`failure` is set instead.
        """
        with self._lock:
            results, self._results = self._results, {}
        self._loaded.update(name for name, error in results.items() if error is None)
        return results

    def close(self) -> None:
        """Begin no further import, and wait for the one that has begun."""
        with self._lock:
            self._closed = True
            self._requested.clear()
        if self._thread is not None:
            self._thread.join(_PATIENCE)

    # --- the thread -------------------------------------------------------------

    def _run(self) -> None:
        while (name := self._next()) is not None:
            error = self._error_of(name)
            with self._lock:
                self._requested.pop(name, None)
                self._results[name] = error
            self._wakeup.set()

    def _next(self) -> TypeName | None:
        with self._lock:
            name = next(iter(self._requested), None)
            self._busy = name is not None
        return name

    def _error_of(self, name: TypeName) -> MiddlewareError | None:
        try:
            if not self._rclpy_was_tried:
                self._rclpy_was_tried = True
                rcl.prepare(*name)
                import_module(f"{__package__}.middleware")  # what the data plane imports next
        except (ImportError, MiddlewareError) as error:
            self.failure = error
        except Exception as error:  # any fault must be reported to the pending endpoints
            self.failure = MiddlewareError(f"rclpy does not start: {error!r}")
        if self.failure is None:
            try:
                types.find_service(name)
            except MiddlewareError as error:
                return error
        return None
