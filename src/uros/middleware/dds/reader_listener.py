"""A reader in the middleware's waitset, whatever it reads."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..base import OnReady

if TYPE_CHECKING:
    from .middleware import DdsMiddleware


class Watched:
    """``on_ready`` is called when something came, and again only when ``taken`` is set.

    ``key`` names it in the waitset, ``paused`` says that it is left out there until
    something is taken, ``local_only`` see
    :meth:`~uros.middleware.dds.middleware.DdsMiddleware.watch_local`.
    """

    __slots__ = ("entity", "key", "local_only", "middleware", "on_ready", "paused", "taken")

    def __init__(self, middleware: DdsMiddleware, entity: int, on_ready: OnReady) -> None:
        self.middleware = middleware
        self.entity = entity
        self.on_ready = on_ready
        self.taken = True
        self.paused = False
        self.local_only = False
        self.key = middleware.watch(self)
