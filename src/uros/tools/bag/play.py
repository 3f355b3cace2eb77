"""``uros bag play``: publish the messages of a bag."""

from __future__ import annotations

import argparse
import gc
import heapq
import math
import sys
import time
from collections.abc import Generator, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any, Final

from ..common import discover, join, positive_float, positive_int, topic_name, unsigned_int
from ..ending import StopSignals
from ..errors import ToolError, UsageError, did_you_mean
from .arguments import add_storage, existing_path
from .options import add_running, add_selection, selected
from .status_line import PERIOD, StatusLine

if TYPE_CHECKING:
    from ...bag.metadata import TopicMetadata
    from ...bag.reader import BagReader
    from ...bag.storage import BagMessage
    from ...host.network import Network
    from ...middleware.base import Writer
    from .keyboard import Keyboard
    from .player import Output, Player

_CLOCK_HZ: Final = 40.0
_QUEUE: Final = 1000
_NODE: Final = "rosbag2_player"
_KEYS_NS: Final = 50_000_000
_RATE_STEP: Final = 0.1
# Seconds until the first messages are read. Reading goes on while they are played.
_FILL_SECONDS: Final = 5.0
_FILL_TURN: Final = 0.005
# We discover a subscription before it discovers us; it would miss what is published in between.
_SETTLE: Final = 0.5
# Seconds for a reliable subscription to ask for what it has missed at the end.
_KEEP_ALIVE: Final = 0.2
# Seconds that a thread runs before another one gets its turn, in place of 0.005: the thread that
# reads the bag must not delay a message that is due.
_SWITCH_INTERVAL: Final = 0.0005


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros bag play``."""
    parser.add_argument(
        "bags", metavar="BAG", nargs="*", type=existing_path, help="folder or file of a bag"
    )
    parser.add_argument(
        "-i", "--input", metavar="BAG", action="append", default=[], type=existing_path,
        help="a bag to play together with others; may be repeated",
    )  # fmt: skip
    add_storage(parser, "what the bag says")
    add_selection(parser, "play")
    parser.add_argument(
        "-m", "--remap", metavar="OLD:=NEW", nargs="+", default=[],
        help="play topics under other names",
    )  # fmt: skip
    _add_time(parser)
    parser.add_argument(
        "--read-ahead-queue-size", metavar="N", type=positive_int, default=_QUEUE,
        help=f"messages that are read before they are due (default: {_QUEUE})",
    )  # fmt: skip
    parser.add_argument(
        "--message-order", choices=("received", "sent"), default="received",
        help="play by the time at which messages were received (default) or sent; those that wait"
        " in the queue are compared",
    )  # fmt: skip
    parser.add_argument(
        "--progress-bar-update-rate", metavar="HZ", type=finite, default=1 / PERIOD,
        help="how often the state is printed on a terminal; 0: never, below 0: at each change"
        f" (default: {1 / PERIOD:g})",
    )  # fmt: skip
    parser.add_argument(
        "--progress-bar-separation-lines", type=unsigned_int, help=argparse.SUPPRESS
    )
    parser.add_argument("--disable-loan-message", action="store_true", help=argparse.SUPPRESS)
    add_running(parser)


def _add_time(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("time")
    group.add_argument(
        "-r", "--rate", metavar="R", type=positive_float, default=1.0,
        help="play R times as fast (default: 1)",
    )  # fmt: skip
    group.add_argument("-l", "--loop", action="store_true", help="begin again at the end")
    group.add_argument("-p", "--start-paused", action="store_true", help="play after SPACE only")
    group.add_argument(
        "-d", "--delay", metavar="S", type=positive_float, default=0.0,
        help="seconds to wait before each pass",
    )  # fmt: skip
    group.add_argument(
        "--start-offset", metavar="S", type=not_negative, default=0.0,
        help="begin so many seconds after the bag's beginning",
    )  # fmt: skip
    group.add_argument(
        "--playback-duration", metavar="S", type=finite, default=-1.0,
        help="play so many seconds of the bag; below 0: all (default)",
    )  # fmt: skip
    until = group.add_mutually_exclusive_group()
    until.add_argument(
        "--playback-until-sec", metavar="S", type=finite, default=-1.0,
        help="play until this time, in seconds since 1970",
    )  # fmt: skip
    until.add_argument(
        "--playback-until-nsec", metavar="NS", type=int, default=-1,
        help="play until this time, in nanoseconds since 1970",
    )  # fmt: skip
    clock = group.add_mutually_exclusive_group()
    clock.add_argument(
        "--clock", metavar="HZ", type=positive_float, nargs="?", const=_CLOCK_HZ,
        help=f"publish the bag's time on /clock (default of HZ: {_CLOCK_HZ:g})",
    )  # fmt: skip
    clock.add_argument(
        "--clock-topics", metavar="TOPIC", type=topic_name, nargs="+", default=[],
        help="publish /clock before each message of these topics",
    )  # fmt: skip
    clock.add_argument(
        "--clock-topics-all", action="store_true", help="publish /clock before each message"
    )


def finite(text: str) -> float:
    """Parse a number that is neither infinite nor NaN."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number")
    return value


def not_negative(text: str) -> float:
    """Parse a number from 0 on."""
    value = finite(text)
    if value < 0.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of 0 or more")
    return value


def run(args: argparse.Namespace) -> int:
    """Play the bags to their end, or until Ctrl-C.

    Raises:
        BagError: A bag cannot be read.
        ToolError: The bags have nothing of what is to be played.
    """
    from ...bag.reader import BagReader

    paths = [*args.bags, *args.input]
    if not paths:
        raise UsageError("give a bag: its folder, or a file of it")
    remaps = remappings(args.remap)
    readers = [BagReader(path, args.storage) for path in paths]
    with StopSignals() as stop, join(args, node_name=_NODE) as network:
        return _Session(args, network, readers, remaps, stop).run()


@contextmanager
def _punctual() -> Iterator[None]:
    """Have messages not wait for another thread or for the garbage collector within the block."""
    interval = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH_INTERVAL)
    # What is there by now stays. To look through it would take 10 ms each time.
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
        sys.setswitchinterval(interval)


def remappings(rules: Sequence[str]) -> dict[str, str]:
    """Parse rules ``OLD:=NEW``.

    Raises:
        UsageError: A rule or a name is wrong.
    """
    names = {}
    for rule in rules:
        old, sign, new = rule.partition(":=")
        if not sign:
            raise UsageError(f"--remap {rule!r}: expected OLD:=NEW, such as /old:=/new")
        try:
            names[topic_name(old)] = topic_name(new)
        except argparse.ArgumentTypeError as error:
            raise UsageError(f"--remap {rule!r}: {error}") from error
    return names


class _Session:
    """The topics of bags on a network, and the event loop of playing them."""

    def __init__(
        self,
        args: argparse.Namespace,
        network: Network,
        readers: Sequence[BagReader],
        remaps: dict[str, str],
        stop: StopSignals,
    ) -> None:
        from .player import ClockTicks
        from .qos_choice import read_overrides

        self._args = args
        self._network = network
        self._readers = readers
        self._stop = stop
        rate = args.progress_bar_update_rate
        self._console = StatusLine(max(0.0, 1 / rate) if rate else None)
        self._start_ns, self._until_ns = span(readers, args)
        self._began_ns = self._start_ns
        self._end_ns = max((reader.metadata.end_time_ns for reader in readers), default=0)
        if self._start_ns > self._end_ns:
            lasts = (self._end_ns - self._start_ns) / 1e9 + args.start_offset
            text = f"--start-offset {args.start_offset:g}: the bag ends at {lasts:.1f} s"
            self._console.warn(text)
        self._has_clock = bool(args.clock or args.clock_topics or args.clock_topics_all)
        overrides = read_overrides(args.qos_profile_overrides_path)
        self._outputs = self._create_outputs(remaps, overrides)
        self._clock_writer = self._create_clock_writer() if self._has_clock else None
        self._ticks: ClockTicks | None = None
        self._clock_topics = frozenset(args.clock_topics)

    def _create_outputs(
        self, remaps: dict[str, str], overrides: dict[str, Any]
    ) -> dict[str, Output]:
        """Create a writer for each topic that is played, by its name in the bags."""
        topics: dict[str, TopicMetadata] = {}
        for reader in self._readers:
            for topic in reader.topics:
                topics.setdefault(topic.name, topic)
        args = self._args
        some = args.topics or args.services or args.actions or args.regex
        selection = selected(args, every=(not some,) * 3)
        meant = [topic for topic in topics.values() if selection.takes(topic.name, topic.type_name)]
        unknown = [
            f"the bag has nothing of {name}{did_you_mean(name, topics)}"
            for name in selection.missing(topics)
        ]
        if not meant:
            why = unknown[0] if unknown else "no topic is selected"
            raise ToolError(f"nothing to play: {why}; 'uros bag info' lists the topics of a bag")
        for text in unknown:
            self._console.warn(text)
        outputs = {}
        for topic in meant:
            output = self._create_output(topic, remaps.get(topic.name, topic.name), overrides)
            if output is not None:
                outputs[topic.name] = output
        return outputs

    def _create_output(
        self, topic: TopicMetadata, name: str, overrides: dict[str, Any]
    ) -> Output | None:
        from ... import names
        from ...middleware.base import MiddlewareError
        from .player import Output
        from .qos_choice import offered
        from .recorder import CLOCK

        if name == CLOCK and self._has_clock:
            return None  # which would contradict ours
        fault = names.fault(name)
        if topic.serialization_format != "cdr":
            fault = (
                f"its messages are {topic.serialization_format}; 'uros bag convert' changes that"
            )
        if not fault:
            qos, differ = offered(topic.offered_qos)
            if name in overrides or topic.name in overrides:
                qos, differ = overrides.get(name) or overrides[topic.name], False
            if differ:
                self._console.warn(
                    f"the publishers of {topic.name} had different profiles: the strongest is"
                    " offered; --qos-profile-overrides-path gives another one"
                )
            try:
                return Output(
                    self._network.node.create_writer(
                        names.topic_to_dds(name), names.type_to_dds(topic.type_name), qos
                    )
                )
            except MiddlewareError as error:
                fault = str(error)
        self._console.warn(f"{name} is not played: {fault}")
        return None

    def _create_clock_writer(self) -> Writer:
        from ... import names
        from ...qos import QoSProfile, ReliabilityPolicy
        from .recorder import CLOCK, CLOCK_TYPE

        return self._network.node.create_writer(
            names.topic_to_dds(CLOCK),
            names.type_to_dds(CLOCK_TYPE),
            QoSProfile(1, ReliabilityPolicy.BEST_EFFORT),
        )

    def _publish_clock(self, bag_ns: int) -> None:
        from ...interfaces import load
        from ...interfaces.codec import to_cdr
        from .recorder import CLOCK_TYPE

        message = load(CLOCK_TYPE)()
        message.clock.sec, message.clock.nanosec = divmod(bag_ns, 10**9)
        assert self._clock_writer is not None
        self._clock_writer.write(to_cdr(message))

    def _before(self, message: BagMessage) -> None:
        if self._args.clock_topics_all or message.topic in self._clock_topics:
            self._publish_clock(message.received_ns)

    def run(self) -> int:
        """Play; return the exit status."""
        from .keyboard import open_keyboard
        from .play_clock import PlayClock
        from .player import ClockTicks

        args = self._args
        discover(self._network, args)  # subscriptions that are there get the first message too
        self._spin(_SETTLE)
        clock = PlayClock(self._start_ns, args.rate, time.monotonic_ns(), args.start_paused)
        if args.clock:
            self._ticks = ClockTicks(args.clock, self._publish_clock, time.monotonic_ns())
        with open_keyboard(not args.disable_keyboard_controls) as keyboard, _punctual():
            if keyboard.is_open:
                self._console.say(
                    "Press SPACE to pause and resume, RIGHT for the next message, UP and DOWN for"
                    " another rate, Ctrl-C to end"
                )
            while not self._stop.stopped:
                self._pass(clock, keyboard)
                if not args.loop:
                    break
        self._console.clear()
        self._spin(_KEEP_ALIVE)
        return self._summary()

    def _pass(self, clock: Any, keyboard: Keyboard) -> None:
        """Play the bags once."""
        from .player import Player
        from .read_ahead import ReadAhead, by_time_sent

        if self._args.delay:
            self._spin(self._args.delay)
        limit = self._args.read_ahead_queue_size
        messages = merged(self._readers, list(self._outputs), self._start_ns, self._until_ns)
        by_sent = self._args.message_order == "sent"
        source = ReadAhead(by_time_sent(messages, limit) if by_sent else messages, limit)
        try:
            filled_by = time.monotonic() + _FILL_SECONDS
            while not (source.is_filled or self._stop.stopped) and time.monotonic() < filled_by:
                self._spin(_FILL_TURN)
            player = Player(source, clock, self._outputs, self._before)
            first = source.first()
            if by_sent and first is not None:  # those times may be of another clock
                self._began_ns = first.received_ns
            clock.jump(self._began_ns, time.monotonic_ns())
            while not (self._stop.stopped or player.finished):
                self._turn(player, clock, keyboard)
            if source.error is not None:
                raise source.error
        finally:
            source.close()

    def _turn(self, player: Player, clock: Any, keyboard: Keyboard) -> None:
        """Publish what is due, then wait for what is due next."""
        for key in keyboard.pressed():
            self._on_key(key, player, clock)
        due = [player.turn(), time.monotonic_ns() + _KEYS_NS]
        if self._ticks is not None:
            due.append(self._ticks.turn(clock, time.monotonic_ns()))
        self._console.show(lambda: self._state(clock))
        wait_ns = min(at for at in due if at is not None) - time.monotonic_ns()
        self._spin(max(0.0, wait_ns / 1e9))

    def _spin(self, seconds: float) -> None:
        self._network.spin(lambda: self._stop.stopped, seconds)

    def _on_key(self, key: str, player: Player, clock: Any) -> None:
        from .keyboard import DOWN, RIGHT, SPACE, UP

        now = time.monotonic_ns()
        if key == SPACE and clock.paused:
            clock.resume(now)
            self._console.say("Resumed")
        elif key == SPACE:
            clock.pause(now)
            self._console.say("Paused")
        elif key == RIGHT and not player.step() and not clock.paused:
            self._console.warn("the next message is published by RIGHT only while paused")
        elif key in (UP, DOWN):
            rate = round(clock.rate + (_RATE_STEP if key == UP else -_RATE_STEP), 6)
            if clock.set_rate(rate, now):
                self._console.say(f"Rate {rate:g}")

    def _state(self, clock: Any) -> str:
        passed = (clock.time(time.monotonic_ns()) - self._began_ns) / 1e9
        published = sum(output.published for output in self._outputs.values())
        paused = "paused  " if clock.paused else ""
        return (
            f"{paused}{passed:.1f} of {(self._end_ns - self._start_ns) / 1e9:.1f} s"
            f"  {clock.rate:g}x  {published} messages"
        )

    def _summary(self) -> int:
        published = sum(output.published for output in self._outputs.values())
        dropped = {name: output.dropped for name, output in self._outputs.items() if output.dropped}
        self._console.say(f"Played {published} messages")
        for name, count in dropped.items():
            self._console.warn(
                f"{count} messages of {name} were not published: a reliable subscription did not"
                " take them in time, or they are malformed"
            )
        return 0


def span(readers: Sequence[BagReader], args: argparse.Namespace) -> tuple[int, int | None]:
    """Return the times from and until which bags are played, in ns; None without an end."""
    from ...bag.metadata import NO_TIME

    begins = [reader.metadata.starting_time_ns for reader in readers]
    start = min((begin for begin in begins if begin != NO_TIME), default=0)
    start += round(args.start_offset * 1e9)
    ends = []
    if args.playback_duration >= 0:
        ends.append(start + round(args.playback_duration * 1e9))
    if args.playback_until_sec >= 0:
        ends.append(round(args.playback_until_sec * 1e9))
    if args.playback_until_nsec >= 0:
        ends.append(args.playback_until_nsec)
    return start, max(ends, default=None)


def merged(
    readers: Sequence[BagReader], topics: Sequence[str], start_ns: int, until_ns: int | None
) -> Generator[BagMessage, None, None]:
    """Yield the messages of several bags in the order in which they were received.

    Args:
        readers: The bags.
        topics: The topics' names.
        start_ns: The time of the first message.
        until_ns: The time of the last message; None for all.
    """
    stop_ns = None if until_ns is None else until_ns + 1
    with ExitStack() as stack:
        sources = [reader.messages(topics, start_ns, stop_ns) for reader in readers]
        for source in sources:
            stack.callback(source.close)  # type: ignore[attr-defined]  # a generator's
        yield from heapq.merge(*sources, key=lambda message: message.received_ns)
