"""Getting rclpy ready while the data plane serves boards.

Importing rclpy and the type support of a service takes tenths of a second, and seconds from a cold
disk. So a thread does that, and only that: what it imported it hands over by name, and nodes and
their endpoints are made by the data plane as ever, since rclpy holds the GIL over these anyway.

An import holds the GIL too, wherever it loads a library. Two things keep that short: all of it is
imported by a process of its own first, which brings it from disk into memory, and rclpy's own
library, with rcl and the RMW behind it, is mapped by a call that leaves the GIL alone.
"""

from __future__ import annotations

import threading
from importlib import import_module
from typing import Final

from ..base import MiddlewareError
from ..wakeup_fd import Wake
from . import rcl, types
from .names import TypeName

_PATIENCE: Final = 5.0


class Preparation:
    """What was asked for and what is ready. All but the thread's part is for the data plane."""

    def __init__(self, wake: Wake) -> None:
        self.failure: ImportError | MiddlewareError | None = None  # why there is no rclpy
        self._wake = wake
        self._ready: set[TypeName] = set()
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()
        # Under the lock:
        self._wanted: dict[TypeName, None] = {}
        self._news: dict[TypeName, MiddlewareError | None] = {}
        self._busy = False
        self._closed = False
        self._started = False  # rclpy was imported, or not to be had; the thread's own

    def has(self, name: TypeName) -> bool:
        """Whether a service of that type can be made at once."""
        return name in self._ready

    def want(self, name: TypeName) -> None:
        """Make it ready; :meth:`news` tells when it is. Twice is once."""
        with self._lock:
            if name in self._news or self._closed:
                return
            self._wanted[name] = None
            if self._busy:
                return
            self._busy = True
        self._thread = threading.Thread(target=self._run, name="uros-rclpy", daemon=True)
        self._thread.start()

    def forget(self, name: TypeName) -> None:
        """Nobody waits for it any more."""
        with self._lock:
            self._wanted.pop(name, None)

    def has_news(self) -> bool:
        """Whether :meth:`news` has something to tell."""
        return bool(self._news)

    def news(self) -> dict[TypeName, MiddlewareError | None]:
        """What the waiting for is over since the last time, with an error where that type cannot
        be had. Where rclpy cannot, ``failure`` is set instead.
        """
        with self._lock:
            news, self._news = self._news, {}
        self._ready.update(name for name, error in news.items() if error is None)
        return news

    def close(self) -> None:
        """Begin nothing more, and wait for what has begun: an import cannot be called off."""
        with self._lock:
            self._closed = True
            self._wanted.clear()
        if self._thread is not None:
            self._thread.join(_PATIENCE)

    # --- the thread -------------------------------------------------------------

    def _run(self) -> None:
        while (name := self._next()) is not None:
            error = self._error_of(name)
            with self._lock:
                self._wanted.pop(name, None)
                self._news[name] = error
            self._wake.set()

    def _next(self) -> TypeName | None:
        with self._lock:
            name = next(iter(self._wanted), None)
            self._busy = name is not None
        return name

    def _error_of(self, name: TypeName) -> MiddlewareError | None:
        try:
            if not self._started:
                self._started = True
                rcl.prepare(*name)
                import_module(f"{__package__}.middleware")  # the data plane's next step
        except (ImportError, MiddlewareError) as error:
            self.failure = error
        except Exception as error:  # whatever comes up, those who wait must hear of it
            self.failure = MiddlewareError(f"rclpy does not start: {error!r}")
        if self.failure is None:
            try:
                types.find_service(name)
            except MiddlewareError as error:
                return error
        return None
