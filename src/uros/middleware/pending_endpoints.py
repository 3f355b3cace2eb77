"""Ends of services that are asked for before they can be made.

Each stands in for one that a node will make later, and passes everything on from then. Until then
it has received nothing and has no room.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Generic, Protocol, TypeVar

from ..qos import QoSProfile
from .base import Bytes, MiddlewareError, Node, OnReady, Replier, Requester, Service

_End = TypeVar("_End", Requester, Replier)


class Maker(Protocol):
    """The node that an end stands in."""

    def end_of(self, late: Late[_End], error: MiddlewareError | None = None) -> _End: ...
    def dropped(self, late: Late[_End]) -> None: ...


class Late(Generic[_End]):
    """``service`` is what it is an end of."""

    __slots__ = ("_closed", "_end", "_failure", "_node", "_on_ready", "_qos", "service")

    def __init__(self, node: Maker, service: Service, qos: QoSProfile, on_ready: OnReady) -> None:
        self.service = service
        self._node = node
        self._qos = qos
        self._on_ready = on_ready
        self._end: _End | None = None
        self._failure: MiddlewareError | None = None
        self._closed = False

    @abstractmethod
    def made_by(self, node: Node) -> _End:
        """The end itself, where that node makes it."""

    def arrive(self, error: MiddlewareError | None) -> None:
        """Its time has come; ``error`` is why it cannot be what was waited for. Raises
        MiddlewareError where it cannot be at all; whoever writes to it hears the same then.
        """
        if self._closed:
            return
        try:
            self._end = self._node.end_of(self, error)
        except MiddlewareError as failure:
            self._failure = failure
            raise

    def close(self) -> None:
        if self._end is not None:
            self._end.close()
        elif not self._closed:
            self._node.dropped(self)
        self._closed = True

    def _there(self) -> _End | None:
        if self._failure is not None:
            raise self._failure
        return self._end


class LateRequester(Late[Requester], Requester):
    __slots__ = ()

    def made_by(self, node: Node) -> Requester:
        return node.create_requester(self.service, self._qos, self._on_ready)

    def request(self, cdr: Bytes) -> int | None:
        end = self._there()
        return None if end is None else end.request(cdr)

    def take(self, limit: int) -> list[tuple[int, bytes]]:
        return [] if self._end is None else self._end.take(limit)

    def refusal(self) -> str:
        return "" if self._end is None else self._end.refusal()

    def again(self) -> None:
        if self._end is not None:
            self._end.again()

    def arrived(self, limit: int) -> list[int]:
        return [] if self._end is None else self._end.arrived(limit)


class LateReplier(Late[Replier], Replier):
    __slots__ = ()

    def made_by(self, node: Node) -> Replier:
        return node.create_replier(self.service, self._qos, self._on_ready)

    def take(self, limit: int) -> list[tuple[bytes, int, bytes]]:
        return [] if self._end is None else self._end.take(limit)

    def arrived(self, limit: int) -> list[int]:
        return [] if self._end is None else self._end.arrived(limit)

    def reply(self, guid: bytes, sequence: int, cdr: Bytes) -> bool:
        end = self._there()
        # Nobody can have asked it before it was there.
        return True if end is None else end.reply(guid, sequence, cdr)
