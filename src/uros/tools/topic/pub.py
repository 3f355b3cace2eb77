"""``uros topic pub``: publish messages to a topic."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from ..common import (
    add_common,
    add_node_name,
    add_topic,
    discover,
    join,
    positive_float,
    remedy,
    unsigned_int,
)
from ..errors import ToolError, UsageError, did_you_mean
from ..graph_types import only_type
from ..sim_time import TOPIC, add_use_sim_time, clock
from ..values.fill import Filled
from ..values.plain import constructed
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
_CAUGHT_UP: Final = 100_000_000  # ns
_NO_ROOM: Final = 0.005


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros topic pub``."""
    add_topic(parser)
    add_type_and_values(parser, "std_msgs/msg/String", "topic")
    parser.add_argument(
        "--yaml-file", metavar="FILE",
        help="publish the messages of a file, such as the output of 'uros topic echo -f', one after"
        " the other",
    )  # fmt: skip
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
    add_node_name(parser)
    add_use_sim_time(parser)
    add_qos_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Publish messages.

    Raises:
        ToolError: The values do not fit the type, or no subscription matched in time.
    """
    if args.yaml_file is not None and (args.values is not None or args.stdin):
        raise UsageError("give either VALUES, --stdin or --yaml-file")
    times = 1 if args.once else args.times
    wanted = args.wait_matching_subscriptions
    if wanted is None:
        wanted = int(times > 0)
    if not wanted and args.max_wait_time_secs is not None:
        raise ToolError("--max-wait-time-secs goes with -w, --once or --times")
    type_name, text = type_and_text(args)
    if args.yaml_file is not None:
        if text:  # the type was left out, so that VALUES stood in its place
            raise UsageError("give either VALUES or --yaml-file")
        text = _file(args.yaml_file)
    qos = choose(args)
    try:
        with join(
            args, node_name=args.node_name or ""
        ) as network:  # which makes --interfaces known
            message_class = load_message(type_name or _type_there(network, args), network)
            messages = _messages(message_class, text, args.yaml_file)
            writer = _join_topic(network, args.topic, message_class, qos)
            mismatches = _Mismatches(network, args.topic, message_class._TYPE, qos)
            if wanted:
                _wait(network, writer, wanted, args.max_wait_time_secs, mismatches)
            if args.yaml_file is not None:
                times = min(times or len(messages), len(messages))
            _publish(network, writer, messages, args, times, mismatches)
    except KeyboardInterrupt:
        return 0  # the usual end
    return 0


def _file(path: str) -> str:
    try:
        return Path(path).read_text("utf-8")
    except UnicodeDecodeError as error:
        raise ToolError(f"{path} is not UTF-8: {error.reason}") from error
    except (OSError, ValueError) as error:
        raise ToolError(f"{path} cannot be read: {getattr(error, 'strerror', error)}") from error


def _messages(message_class: Any, text: str, file: str | None) -> list[Filled]:
    """Return what is published: the messages of a file, or one again and again."""
    if file is None:
        return [Filled(message_class, text)]
    try:
        messages = Filled.each(message_class, text)
    except ToolError as error:
        raise ToolError(f"{file}: {error}") from error
    if not messages:
        raise ToolError(f"{file} has no message")
    return messages


def _type_there(network: Network, args: argparse.Namespace) -> str:
    discover(network, args)
    return only_type("topic pub", args.topic, topic_types(network, args.topic))


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
    messages: list[Filled],
    args: argparse.Namespace,
    times: int,
    mismatches: _Mismatches,
) -> None:
    from ...interfaces.codec import to_cdr

    pace = _Pace(network, args)
    _say("publisher: beginning loop")
    count = 0
    said = ""
    while True:
        filled = messages[count % len(messages)]
        filled.stamp(pace.now())
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
        pace.wait()
        if time.monotonic() - mismatches.looked >= _SAY_AGAIN:
            mismatches.tell()
            said = _suggest_topics(network, args.topic, False, said)


class _Pace:
    """The time of the messages, and of the pauses between them: the system's, or that of /clock.

    With ``--use-sim-time`` it waits for the first time on /clock.
    """

    def __init__(self, network: Network, args: argparse.Namespace) -> None:
        self.now = clock(network, args)
        self._network = network
        self._is_sim_time = args.use_sim_time
        self._period = round(1e9 / args.rate)
        if self._is_sim_time and not network.spin(lambda: self.now() > 0, _SAY_AGAIN):
            warn(f"no time has come on {TOPIC} yet; waiting for it")
            network.spin(lambda: self.now() > 0)
        self._due = self._time()

    def _time(self) -> int:
        return self.now() if self._is_sim_time else time.monotonic_ns()

    def wait(self) -> None:
        """Wait until the next message is due."""
        now = self._time()
        self._due += self._period
        if self._is_sim_time:
            # A time that jumps is that of one message, as of a timer in ROS 2.
            missed = max(0, (now - self._due) // self._period + 1)
            self._due = min(self._due + missed * self._period, now + self._period)
            first = self._due - self._period
            self._network.spin(lambda: not first <= self.now() < self._due)
        else:
            # Neither messages that were missed are caught up on, nor a time that went back.
            self._due = min(max(self._due, now - _CAUGHT_UP), now + self._period)
            self._network.spin(lambda: False, max(0.0, (self._due - now) / 1e9))


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
