"""``uros tf tree``: print the tree of frames."""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Mapping
from typing import Final

from ...printable import printable
from ..common import add_common, join, positive_float
from ..empty import explain_empty_list
from ..waiting import warn
from .frames import FrameTree, Link
from .listener import MIDDLEWARE, Listener

_SECONDS: Final = 5.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros tf tree``."""
    add_common(parser)
    parser.add_argument(
        "-t", "--wait-time", metavar="S", type=positive_float, default=_SECONDS,
        help=f"seconds to listen before the tree is printed (default: {_SECONDS:g})",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Print the frames below their parents: broadcaster, rate and age of each.

    Returns:
        1 if the frames are no tree, or transforms were refused; else 0.
    """
    with join(args, MIDDLEWARE) as network:
        listener = Listener(network)
        network.spin(lambda: False, args.wait_time)
        nodes = listener.broadcasters()
        if not listener.tree.frames():
            explain_empty_list(network)
            warn(f"no transforms came on /tf and /tf_static within {args.wait_time:g} s")
    for line in drawn(listener.tree, nodes, time.time_ns()):
        print(line)
    found = list(faults(listener.tree, nodes))
    for text in found:
        warn(text)
    return int(bool(found))


def drawn(tree: FrameTree, nodes: Mapping[bytes, str], now_ns: int) -> list[str]:
    """Return the lines of the tree.

    Args:
        tree: The frames.
        nodes: Names of the broadcasters by the GUID of the writer.
        now_ns: The time, for the ages.
    """
    rows = [row for root in tree.roots() for row in _rows(tree, root, nodes, now_ns)]
    for loop in tree.loops():  # has no root
        rows.append((printable(f"loop: {' -> '.join([*loop, loop[0]])}"), ""))
    width = max((len(head) for head, tail in rows if tail), default=0)
    return [f"{head:<{width}}  {tail}" if tail else head for head, tail in rows]


def _rows(
    tree: FrameTree, root: str, nodes: Mapping[bytes, str], now_ns: int
) -> Iterator[tuple[str, str]]:
    """Yield each frame from a root down: its place in the drawing, and what is said of it."""
    pending = [(root, "", "")]
    while pending:
        frame, branch, indent = pending.pop()
        link = tree.link(frame)
        yield f"{branch}{printable(frame)}", _said(link, nodes, now_ns) if link else ""
        below = [(child, f"{indent}├── ", f"{indent}│   ") for child in tree.children(frame)]
        if below:
            below[-1] = (below[-1][0], f"{indent}└── ", f"{indent}    ")
        pending += reversed(below)


def _said(link: Link, nodes: Mapping[bytes, str], now_ns: int) -> str:
    """Return broadcaster, rate and age of a link."""
    node = nodes.get(link.writer, "unknown node")
    if link.is_static:
        return f"{node}  static"
    rate = "one transform" if link.rate is None else f"{link.rate:.1f} Hz"
    age = (now_ns - link.history[-1].stamp_ns) / 1e9
    return f"{node}  {rate}  {age:.3f} s old"


def faults(tree: FrameTree, nodes: Mapping[bytes, str]) -> Iterator[str]:
    """Yield what is wrong with the frames, and what to do about it."""
    for child, links in tree.two_parents():
        parents = " and ".join(
            f"{link.parent} (from {nodes.get(link.writer, 'unknown node')})" for link in links
        )
        yield f"the frame {child} has several parents: {parents}; let one node place it"
    for loop in tree.loops():
        yield f"the frames {', '.join(loop)} are a loop of parents; one of them needs another one"
    for child, why in tree.refused.items():
        yield f"transforms{f' of {child!r}' if child else ''} are not used: {why}"
