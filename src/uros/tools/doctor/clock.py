"""Checks clocks: the stamps of messages against this host's clock, and the clock itself."""

from __future__ import annotations

import struct
import sys
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from .finding import Finding, note, ok, problem, unknown
from .graph import EVERYWHERE, Picture, full_name

if TYPE_CHECKING:
    from ...host.network import Network, Received

# A larger offset is a fault, in seconds: it disturbs tf and the fusion of sensors.
LIMIT: Final = 0.1
# A stamp before 2001 counts from the board's start.
_NEVER_SET: Final = 1_000_000_000
# Attack: thousands of topics.
_MOST: Final = 64
_DEPTH: Final = 16
_STAMPED: Final = ("std_msgs/Header", "std_msgs/msg/Header",
                   "builtin_interfaces/Time", "builtin_interfaces/msg/Time")  # fmt: skip
_FIX: Final = (
    "in C: rmw_uros_sync_session(1000), then stamp with rmw_uros_epoch_nanos(); with uros:"
    " node.clock.stamp(message.header.stamp)"
)


def is_stamped(type_name: str) -> bool:
    """Return whether messages of the type begin with a stamp; False for an unknown type."""
    from ...interfaces import load
    from ...interfaces.errors import InterfaceError

    try:
        fields = getattr(load(type_name), "_FIELDS", None)
    except InterfaceError:
        return False
    return fields is not None and bool(fields) and fields[0][1] in _STAMPED


def stamp_of(cdr: bytes) -> tuple[int, int] | None:
    """Return the seconds and nanoseconds at the beginning of a sample, or None."""
    if len(cdr) < 12 or cdr[0] or cdr[1] > 1:
        return None
    seconds, nanoseconds = struct.unpack_from("<iI" if cdr[1] else ">iI", cdr, 4)
    return (seconds, nanoseconds) if nanoseconds < 1_000_000_000 else None


@dataclass
class Stamps:
    """The stamps of one topic.

    Attributes:
        nodes: The topic's publishers.
        count: How many stamps came.
        empty: How many of them are 0.
        unset: How many count from the start of a board.
        nearest: The smallest offset from this host's clock, in seconds, transmission included.
    """

    nodes: list[str]
    count: int = 0
    empty: int = 0
    unset: int = 0
    nearest: float | None = field(default=None)

    def add(self, cdr: bytes, received_ns: int) -> None:
        """Count the stamp of a sample that was received at ``received_ns`` (Unix time)."""
        stamp = stamp_of(cdr)
        if stamp is None:
            return
        self.count += 1
        seconds, nanoseconds = stamp
        if not seconds and not nanoseconds:
            self.empty += 1
        elif seconds < _NEVER_SET:
            self.unset += 1
        else:
            late = (received_ns - seconds * 1_000_000_000 - nanoseconds) / 1e9
            if self.nearest is None or abs(late) < abs(self.nearest):
                self.nearest = late


def judge(topic: str, stamps: Stamps, is_board: bool) -> Finding | None:
    """Return the finding about the stamps of a topic, or None if they are right."""
    who = " and ".join(stamps.nodes)
    if stamps.unset:
        return problem(
            "clock",
            f"the stamps of {topic} by {who} count from the board's start: it does not know the"
            " time",
            _FIX,
            about=topic,
            kind="no time",
        )
    if stamps.nearest is not None and abs(stamps.nearest) > LIMIT:
        way = "behind" if stamps.nearest > 0 else "ahead of"
        what = (
            f"the stamps of {topic} by {who} are {_time(abs(stamps.nearest))} {way} this host's"
            " clock"
        )
        # A node that is not a board may forward the stamps of older data.
        if is_board or stamps.nearest < 0:
            return problem("clock", what, _FIX, about=topic, kind=way)
        fix = "compare the clocks of both machines: date +%s.%N"
        return note("clock", what, fix, about=topic, kind=way)
    if stamps.count and stamps.empty == stamps.count:
        what = f"the stamps of {topic} by {who} are all 0"
        return note("clock", what, _FIX, about=topic, kind="0")
    return None


def _time(seconds: float) -> str:
    return f"{seconds * 1000:.0f} ms" if seconds < 10 else f"{seconds:.0f} s"


def check_stamps(
    network: Network,
    picture: Picture,
    seconds: float,
    boards: Collection[str] | None = None,
    say: Callable[[str], object] = lambda text: None,
) -> list[Finding]:
    """Listen to topics with stamps and judge them.

    Args:
        network: The domain.
        picture: Its graph.
        seconds: How long to listen.
        boards: Full names of boards' nodes; None if they are not known.
        say: Prints what is being done.
    """
    from ...host.matching import adapt
    from ...middleware.base import MiddlewareError
    from ...qos import QoSProfile

    if picture.writers("/clock"):
        simulated = f"time is simulated in domain {network.domain}: /clock is published"
        return [unknown("clock", simulated)]
    watched: dict[str, Stamps] = {}
    closers = []
    for topic in picture.topics:
        publishers = picture.writers(topic)
        types = {end.type_name for end in picture.ends(topic)}
        if not publishers or len(types) > 1 or topic in EVERYWHERE:
            continue
        (type_name,) = types
        if not is_stamped(type_name):
            continue
        if len(watched) == _MOST:
            break
        qos = QoSProfile(_DEPTH)
        # Volatile: samples kept for late joiners are rightly old.
        adapt(qos, [end.qos for end in publishers], keep_durability=True)
        stamps = Stamps(list(dict.fromkeys(map(full_name, publishers))))
        try:
            closers.append(network.listen(topic, type_name, qos, _adder(stamps)))
        except MiddlewareError:
            continue
        watched[topic] = stamps
    if not watched:
        return []
    say(f"listening for {seconds:g} s to topics with stamps in domain {network.domain}")
    network.spin(lambda: False, seconds)
    for close in closers:
        close()
    found = []
    for topic, stamps in watched.items():
        is_board = boards is None or any(name in boards for name in stamps.nodes)
        finding = judge(topic, stamps, is_board)
        if finding is not None:
            found.append(finding)
    heard = sum(bool(stamps.count) for stamps in watched.values())
    if not found and heard:
        what = "topic" if heard == 1 else "topics"
        return [ok("clock", f"the stamps of {heard} {what} agree with this host's clock")]
    if not heard:
        longer = max(10, round(seconds * 3))
        return [
            unknown(
                "clock",
                f"no message with a stamp came within {seconds:g} s",
                f"listen longer: uros doctor --seconds {longer}",
            )
        ]
    return found


def _adder(stamps: Stamps) -> Callable[[Received], None]:
    return lambda got: stamps.add(got.cdr, got.received_ns)


def check_host() -> Finding:
    """Check whether NTP or PTP synchronizes this host's clock, as the kernel knows."""
    if sys.platform != "linux":
        return unknown("host clock", "only Linux tells whether its clock is synchronised")
    import ctypes

    # struct timex; without a mode it only reads. 5 is TIME_ERROR: not synchronised.
    asked = ctypes.create_string_buffer(512)
    try:
        answer = ctypes.CDLL(None).adjtimex(asked)
    except (OSError, AttributeError):
        answer = -1
    if answer < 0:
        return unknown("host clock", "the kernel does not tell whether the clock is synchronised")
    if answer == 5:
        return note(
            "host clock",
            "this host's clock is not synchronised: stamps of other machines will not agree",
            "sudo timedatectl set-ntp true",
        )
    return ok("host clock", "this host's clock is synchronised")
