"""``uros topic pub``: publish messages to a topic."""

from __future__ import annotations

import argparse
import sys
import time
from typing import TYPE_CHECKING, Any, Final

from ..common import (
    add_common,
    add_topic,
    discover,
    join,
    positive_float,
    remedy,
    unsigned_int,
)
from ..errors import ToolError, did_you_mean
from ..values.fill import Filled, constructed
from ..values.qos_publish import add_qos_arguments, choose
from ..values.typed_values import add_type_and_values, load_message, type_and_text
from ..waiting import topic_types, warn

if TYPE_CHECKING:
    from ...host.network import Network
    from ...middleware.base import Writer
    from ...qos import QoSProfile

_SAY_AGAIN: Final = 1.0
# We discover a subscription before it discovers us. A best-effort or volatile one would miss what
# is published in between.
_SETTLE: Final = 0.1
_LOOKS: Final = 4
# After a stopped terminal, messages later than this are not caught up on.
_CAUGHT_UP: Final = 0.1
_NO_ROOM: Final = 0.005


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros topic pub``."""
    add_topic(parser)
    add_type_and_values(parser, "std_msgs/msg/String", "topic")
    add_common(parser)
    parser.add_argument(
        "-r", "--rate", metavar="N", type=positive_float, default=1.0,
        help="publishing rate in Hz (default: 1)",
    )  # fmt: skip
    parser.add_argument(
        "-p", "--print", metavar="N", type=unsigned_int, default=1,
        help="print only every N-th message (default: 1; 0: none)",
    )  # fmt: skip
    group = parser.add_mutually_exclusive_group()
    group.add_argument("-1", "--once", action="store_true", help="publish one message and exit")
    group.add_argument(
        "-t", "--times", metavar="N", type=unsigned_int, default=0,
        help="publish N messages and exit",
    )  # fmt: skip
    parser.add_argument(
        "-w", "--wait-matching-subscriptions", metavar="N", type=unsigned_int,
        help="wait for N matching subscriptions first (default: 1 with --once or --times, else 0)",
    )  # fmt: skip
    parser.add_argument(
        "--max-wait-time-secs", metavar="S", type=positive_float,
        help="seconds to wait for them; exit status 1 if they do not come (default: no limit)",
    )  # fmt: skip
    parser.add_argument(
        "--keep-alive", metavar="S", type=positive_float, default=0.1,
        help="seconds to stay after the last message (default: 0.1)",
    )  # fmt: skip
    add_qos_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Publish messages.

    Raises:
        ToolError: The values do not fit the type, or no subscription matched in time.
    """
    times = 1 if args.once else args.times
    wanted = args.wait_matching_subscriptions
    if wanted is None:
        wanted = int(times > 0)
    if not wanted and args.max_wait_time_secs is not None:
        raise ToolError("--max-wait-time-secs goes with -w, --once or --times")
    type_name, text = type_and_text(args)
    qos = choose(args)
    try:
        with join(args) as network:  # which makes --interfaces known
            filled = Filled(load_message(type_name), text) if type_name else None
            filled = filled or Filled(load_message(_type_there(network, args)), text)
            writer = _join_topic(network, args.topic, filled.message, qos)
            mismatches = _Mismatches(network, args.topic, filled.message._TYPE, qos)
            if wanted:
                _wait(network, writer, wanted, args.max_wait_time_secs, mismatches)
            _publish(network, writer, filled, args, times, mismatches)
    except KeyboardInterrupt:
        return 0  # the usual end
    return 0


def _type_there(network: Network, args: argparse.Namespace) -> str:
    discover(network, args)
    types = topic_types(network, args.topic)
    if len(types) > 1:
        raise ToolError(
            f"{args.topic} has several types: {', '.join(types)};"
            f" give one: uros topic pub {args.topic} TYPE"
        )
    return types[0]


def _join_topic(network: Network, topic: str, message: Any, qos: QoSProfile) -> Writer:
    from ... import names

    return network.node.create_writer(names.topic_to_dds(topic), message._DDS_TYPE, qos)


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def _wait(
    network: Network, writer: Writer, wanted: int, longest: float | None, mismatches: _Mismatches
) -> None:
    """Wait until ``wanted`` subscriptions match."""
    end = None if longest is None else time.monotonic() + longest
    said = ""
    while writer.matched() < wanted:
        _say(f"Waiting for at least {wanted} matching subscription(s)...")
        left = _SAY_AGAIN if end is None else min(_SAY_AGAIN, end - time.monotonic())
        if left <= 0.0:
            mismatches.tell(True)
            raise ToolError(
                f"timed out waiting for subscribers: {wanted} expected,"
                f" {writer.matched()} there; --wait-matching-subscriptions 0 publishes anyway"
            )
        network.spin(lambda: writer.matched() >= wanted, left)
        if not mismatches.tell():
            left = _SAY_AGAIN if end is None else max(0.0, end - time.monotonic())
            network.settle(min(_SAY_AGAIN, left))
        if not writer.matched():
            said = _suggest_topics(network, mismatches.topic, True, said)
    network.spin(lambda: False, _SETTLE)


def _suggest_topics(network: Network, topic: str, waiting: bool, said: str) -> str:
    """Suggest similar topics if nobody subscribes to this one.

    Args:
        network: The domain.
        topic: The topic.
        waiting: Whether a subscription is waited for; then the hint comes without a similar name.
        said: The last hint, which is not repeated.

    Returns:
        The last hint.
    """
    graph = network.graph
    if graph.subscriptions(topic):
        return said
    others = [name for name in graph.topics() if name != topic and graph.subscriptions(name)]
    text = f"nobody subscribes to {topic}{remedy(network, topic, others)}"
    if text != said and (waiting or did_you_mean(topic, others)):
        warn(text)
        return text
    return said


def _publish(
    network: Network,
    writer: Writer,
    filled: Filled,
    args: argparse.Namespace,
    times: int,
    mismatches: _Mismatches,
) -> None:
    from ...interfaces.codec import to_cdr

    _say("publisher: beginning loop")
    count = 0
    said = ""
    due = time.monotonic()
    while True:
        filled.stamp(time.time_ns())
        count += 1
        if args.print and count % args.print == 0:
            _say(f"publishing #{count}: {constructed(filled.message)}\n")
        cdr = to_cdr(filled.message)
        while not writer.write(cdr):
            network.spin(lambda: False, _NO_ROOM)
        if count == times:
            network.spin(lambda: False, args.keep_alive)
            mismatches.tell(True)
            return
        due = max(due + 1.0 / args.rate, time.monotonic() - _CAUGHT_UP)
        network.spin(lambda: False, max(0.0, due - time.monotonic()))
        if time.monotonic() - mismatches.looked >= _SAY_AGAIN:
            mismatches.tell()
            said = _suggest_topics(network, args.topic, False, said)


class _Mismatches:
    """Warns once about each subscription that does not match, and why."""

    def __init__(self, network: Network, topic: str, type_name: str, qos: QoSProfile) -> None:
        self.looked = time.monotonic()
        self._graph = network.graph
        self.topic = topic
        self._type = type_name
        self._qos = qos
        self._looks: dict[bytes, int] = {}
        self._told: set[bytes] = set()

    def tell(self, last: bool = False) -> bool:
        """Warn about new mismatches.

        Args:
            last: Whether to warn about subscriptions of unknown nodes too.

        Returns:
            False if nodes of some subscriptions are not known yet.
        """
        from ... import names
        from ...host.graph_queries import BARE_DDS, UNKNOWN_NODE
        from ...middleware.qos_matching import mismatches

        self.looked = time.monotonic()
        named = True
        for end in self._graph.subscriptions(self.topic):
            if end.gid in self._told:
                continue
            # Its node may be discovered some seconds later.
            nameless = (end.node_namespace, end.node_name) in (UNKNOWN_NODE, BARE_DDS)
            looks = self._looks[end.gid] = self._looks.get(end.gid, 0) + 1
            if nameless and looks < _LOOKS and not last:
                named = False
                continue
            self._told.add(end.gid)
            subscriber = (
                "a subscription" if nameless else names.join(end.node_namespace, end.node_name)
            )
            if end.type_name != self._type:
                warn(
                    f"{subscriber} subscribes to {self.topic} with the type {end.type_name}: it"
                    " will receive nothing"
                )
                continue
            for mismatch in mismatches(self._qos, end.qos):
                warn(
                    f"{subscriber} requests {mismatch.requested} on {self.topic}, and this offers"
                    f" {mismatch.offered}: it will receive nothing; see --qos-reliability and"
                    " --qos-durability"
                )
        return named
