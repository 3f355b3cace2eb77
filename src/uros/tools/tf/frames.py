"""The tree of coordinate frames that transforms make up: look-up through it, and its faults.

Frames are nodes of the tree, transforms its edges. Nothing here knows a network or a clock: times
are nanoseconds that the caller gives.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from ...similar import closest
from .transforms import IDENTITY, Transform, compose, inverse

# Transforms of a frame that are kept, to find those of a common time.
_KEPT: Final = 100
# Seconds after which a parent that is not repeated no longer counts as a second one.
_FORGOTTEN_NS: Final = 10_000_000_000
# Attack: transforms that name a new frame each.
_MOST_FRAMES: Final = 10_000


class NoTransformError(Exception):
    """There is no transform between two frames; says why."""


class Stamped(NamedTuple):
    """A transform and the time that it belongs to (Unix ns)."""

    transform: Transform
    stamp_ns: int


@dataclass
class Link:
    """What places a frame in its parent.

    Attributes:
        parent: The parent frame.
        is_static: Whether it comes from ``/tf_static``.
        writer: GUID of the writer; empty if unknown.
        history: The last transforms, the latest one at the end.
        first_ns: When the first one was received.
        last_ns: When the last one was received.
        count: How many were received.
    """

    parent: str
    is_static: bool
    writer: bytes
    first_ns: int
    last_ns: int = 0
    count: int = 0
    history: deque[Stamped] = field(default_factory=lambda: deque(maxlen=_KEPT))

    @property
    def rate(self) -> float | None:
        """Transforms a second; None if they are too few to tell."""
        seconds = (self.last_ns - self.first_ns) / 1e9
        return (self.count - 1) / seconds if self.count > 1 and seconds > 0 else None

    def at(self, stamp_ns: int) -> Transform:
        """Return the transform whose time is nearest."""
        return min(self.history, key=lambda kept: abs(kept.stamp_ns - stamp_ns)).transform


class FrameTree:
    """Frames by name, each with the link to its parent.

    Attributes:
        refused: Why transforms were refused, by the child frame.
    """

    def __init__(self) -> None:
        # By child frame: the links that were received, by parent; the last one counts.
        self._links: dict[str, dict[str, Link]] = {}
        self.refused: dict[str, str] = {}

    def add(
        self,
        parent: str,
        child: str,
        stamped: Stamped,
        received_ns: int,
        is_static: bool = False,
        writer: bytes = b"",
    ) -> None:
        """Add a transform that was received.

        Args:
            parent: The parent frame; a slash in front does not count, as in tf2.
            child: The child frame; likewise.
            stamped: The pose of the child in the parent, and its time.
            received_ns: When it was received.
            is_static: Whether it comes from ``/tf_static``.
            writer: GUID of the writer.
        """
        parent, child = parent.removeprefix("/"), child.removeprefix("/")
        if not parent or not child or parent == child:
            what = "it is its own parent" if parent == child else "the parent or the child is empty"
            self._refuse(child, what)
            return
        links = self._links.get(child)
        if links is None:
            if len(self._links) >= _MOST_FRAMES:
                self._refuse("", f"there are more than {_MOST_FRAMES} frames")
                return
            links = self._links[child] = {}
        link = links.pop(parent, None) or Link(parent, is_static, writer, received_ns)
        links[parent] = link  # at the end: the last one counts
        link.is_static, link.writer = is_static, writer
        link.last_ns = received_ns
        link.count += 1
        link.history.append(stamped)
        for old in [name for name, each in links.items() if not each.is_static]:
            if received_ns - links[old].last_ns > _FORGOTTEN_NS:
                del links[old]

    def refuse(self, child: str, why: str) -> None:
        """Note why a transform of a child frame is not used."""
        self._refuse(child.removeprefix("/"), why)

    def _refuse(self, child: str, why: str) -> None:
        if child in self.refused or len(self.refused) < _MOST_FRAMES:
            self.refused[child] = why

    def frames(self) -> list[str]:
        """Return the names of all frames, sorted."""
        parents = {parent for links in self._links.values() for parent in links}
        return sorted({*self._links, *parents})

    def link(self, child: str) -> Link | None:
        """Return what places a frame in its parent; None for a root."""
        links = self._links.get(child)
        return next(reversed(links.values())) if links else None

    def children(self, parent: str) -> list[str]:
        """Return the frames that a frame is the parent of, sorted."""
        return sorted(
            child for child in self._links if (link := self.link(child)) and link.parent == parent
        )

    def roots(self) -> list[str]:
        """Return the frames without a parent, sorted."""
        return [frame for frame in self.frames() if self.link(frame) is None]

    # --- look-up --------------------------------------------------------------------------------

    def lookup(self, source: str, target: str) -> Stamped:
        """Return the pose of ``target`` in ``source``, at the latest time that all links have.

        Args:
            source: The frame to express the pose in.
            target: The frame whose pose is wanted.

        Raises:
            NoTransformError: A frame is unknown, or the two are not connected.
        """
        source, target = source.removeprefix("/"), target.removeprefix("/")
        up, down = self._path(source), self._path(target)
        common = next((frame for frame in up if frame in down), None)
        if common is None:
            raise NoTransformError(
                f"{source!r} and {target!r} are in two trees, with the roots {up[-1]!r} and"
                f" {down[-1]!r}"
            )
        ways = up[: up.index(common)], down[: down.index(common)]
        links = [[link for frame in way if (link := self.link(frame))] for way in ways]
        moving = [link for way in links for link in way if not link.is_static]
        stamp = min((link.history[-1].stamp_ns for link in moving), default=0)
        outer, inner = (_composed(way, stamp) for way in links)
        return Stamped(compose(inverse(outer), inner), stamp)

    def _path(self, frame: str) -> list[str]:
        """Return the frames from one up to its root."""
        known = self.frames()
        if frame not in known:
            close = closest(frame, known)
            meant = f"; did you mean {' or '.join(map(repr, close))}?" if close else ""
            raise NoTransformError(f"there is no frame {frame!r}{meant}")
        path = [frame]
        while (link := self.link(path[-1])) is not None:
            if link.parent in path:
                raise NoTransformError(f"{frame!r} is in a loop of parents, with {link.parent!r}")
            path.append(link.parent)
        return path

    # --- faults ---------------------------------------------------------------------------------

    def two_parents(self) -> Iterator[tuple[str, list[Link]]]:
        """Yield the frames that several transforms place in different parents."""
        for child in sorted(self._links):
            if len(self._links[child]) > 1:
                yield child, list(self._links[child].values())

    def loops(self) -> list[list[str]]:
        """Return the loops of parents: the frames of each, beginning with the first by name."""
        found: dict[frozenset[str], list[str]] = {}
        for frame in sorted(self._links):
            path = [frame]
            while (link := self.link(path[-1])) is not None and link.parent not in path:
                path.append(link.parent)
            if link is not None:
                loop = path[path.index(link.parent) :]
                first = loop.index(min(loop))
                found.setdefault(frozenset(loop), loop[first:] + loop[:first])
        return list(found.values())


def _composed(links: list[Link], stamp_ns: int) -> Transform:
    """Return the pose of the first link's child in the last link's parent."""
    pose = IDENTITY
    for link in links:
        pose = compose(link.at(stamp_ns), pose)
    return pose
