"""``uros bag record``: record topics into a bag."""

from __future__ import annotations

import argparse
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Final, Literal

from ..common import join, positive_int, remedy, topic_name, unsigned_int
from ..ending import StopSignals
from ..errors import ToolError, UsageError
from .arguments import add_storage
from .options import add_running, add_selection, key_values, selected

if TYPE_CHECKING:
    from ...bag.writer import BagWriter
    from ...host.network import Network
    from .recorder import Recorder
    from .status_line import StatusLine
    from .writer_thread import WriterThread

_CACHE: Final = 100 << 20
_POLLING_MS: Final = 100
_KEYS_SECONDS: Final = 0.1
# Seconds for discovery, after which topics that were asked for and are not there are told.
_MISSING_SECONDS: Final = 2.0
_NODE: Final = "rosbag2_recorder"
_SNAPSHOT_KEY: Final = "s"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros bag record``."""
    parser.add_argument(
        "further_topics", metavar="TOPIC", type=topic_name, nargs="*", help="topics to record"
    )
    parser.add_argument(
        "-o", "--output", metavar="FOLDER",
        help="folder of the bag, which must not exist (default: rosbag2_ and the time)",
    )  # fmt: skip
    _add_storage(parser)
    group = parser.add_argument_group("topics, services and actions")
    group.add_argument(
        "-a", "--all", action="store_true",
        help="record all topics, and the events of all services and actions",
    )  # fmt: skip
    for kind in ("topics", "services", "actions"):
        group.add_argument(f"--all-{kind}", action="store_true", help=f"record all {kind}")
    add_selection(parser, "record")
    parser.add_argument(
        "--topic-types", metavar="TYPE", nargs="+", default=[],
        help="record the topics of these types",
    )  # fmt: skip
    parser.add_argument(
        "--exclude-topic-types", metavar="TYPE", nargs="+", default=[],
        help="do not record the topics of these types",
    )  # fmt: skip
    _add_discovery(parser)
    parser.add_argument("--start-paused", action="store_true", help="record after SPACE only")
    parser.add_argument(
        "--use-sim-time", action="store_true",
        help="use the time of /clock; nothing is recorded before its first message",
    )  # fmt: skip
    parser.add_argument(
        "--snapshot-mode", action="store_true",
        help="keep the last messages, and write them with the key s or at SIGUSR1 only",
    )  # fmt: skip
    parser.add_argument(
        "--node-name", metavar="NAME", default=_NODE, help=f"name of the node (default: {_NODE})"
    )
    parser.add_argument(
        "--custom-data", metavar="KEY=VALUE", nargs="*", default=[],
        help="store these pairs in the bag's metadata",
    )  # fmt: skip
    add_running(parser)


def _add_storage(parser: argparse.ArgumentParser) -> None:
    add_storage(parser, "mcap")
    group = parser.add_argument_group("storage")
    group.add_argument(
        "-b", "--max-bag-size", metavar="BYTES", type=unsigned_int, default=0,
        help="begin another file when one has this size (default: 0, never)",
    )  # fmt: skip
    group.add_argument(
        "-d", "--max-bag-duration", metavar="S", type=unsigned_int, default=0,
        help="begin another file after so many seconds (default: 0, never)",
    )  # fmt: skip
    group.add_argument(
        "--max-cache-size", metavar="BYTES", type=unsigned_int, default=_CACHE,
        help="most octets of messages that wait for the disk or for a snapshot, 0 for none"
        f" (default: {_CACHE})",
    )  # fmt: skip
    group.add_argument(
        "--compression-mode", choices=("none", "file", "message"), default="none",
        help="compress what is written (default: none)",
    )  # fmt: skip
    group.add_argument(
        "--compression-format", choices=("zstd", "lz4"),
        help="with --compression-mode: the format (default: zstd)",
    )  # fmt: skip
    for ignored in ("--compression-queue-size", "--compression-threads"):
        group.add_argument(ignored, type=unsigned_int, help=argparse.SUPPRESS)
    group.add_argument("--compression-threads-priority", type=int, help=argparse.SUPPRESS)
    group.add_argument(
        "-f", "--serialization-format", choices=("cdr",), default="cdr", help=argparse.SUPPRESS
    )


def _add_discovery(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("discovery")
    group.add_argument(
        "--include-hidden-topics", action="store_true",
        help="record hidden topics too: those with a part that begins with _",
    )  # fmt: skip
    group.add_argument(
        "--include-unpublished-topics", action="store_true",
        help="record topics without a publisher too",
    )  # fmt: skip
    group.add_argument(
        "--ignore-leaf-topics", action="store_true", help="ignore topics without a subscription"
    )
    group.add_argument(
        "--no-discovery", action="store_true",
        help="record only topics that are there at the beginning",
    )  # fmt: skip
    group.add_argument(
        "-p", "--polling-interval", metavar="MS", type=positive_int, default=_POLLING_MS,
        help=f"milliseconds between two looks for new topics (default: {_POLLING_MS})",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Record until Ctrl-C or SIGTERM.

    Raises:
        BagError, ToolError: The bag cannot be written, such as on a full disk.
    """
    from .message_cache import MessageCache
    from .qos_choice import read_overrides
    from .recorder import Recorder
    from .status_line import StatusLine
    from .writer_thread import WriterThread

    _check(args)
    every = tuple(args.all or one for one in (args.all_topics, args.all_services, args.all_actions))
    selection = selected(args, args.further_topics, every)
    if selection.is_empty:
        raise UsageError(
            "nothing to record: give topics, or one of --all, --all-topics, --all-services,"
            " --all-actions, --services, --actions, --topic-types and --regex"
        )
    folder = Path(args.output or datetime.now().strftime("rosbag2_%Y_%m_%d-%H_%M_%S"))
    overrides = read_overrides(args.qos_profile_overrides_path)
    console = StatusLine()
    with StopSignals() as stop, join(args, node_name=args.node_name) as network:
        writer = _create(folder, args)
        cache = MessageCache(args.max_cache_size, args.snapshot_mode)
        thread = WriterThread(writer, cache)
        try:
            recorder = Recorder(
                network, selection, cache, console, overrides,
                unpublished=args.include_unpublished_topics,
                ignore_leaves=args.ignore_leaf_topics,
                use_sim_time=args.use_sim_time,
            )  # fmt: skip
            recorder.paused = args.start_paused
            console.say(f"Recording into {folder}")
            session = _Session(args, network, recorder, thread, console, cache.snapshot)
            session.run(stop)
            recorder.close()
        finally:
            console.clear()
            thread.close()
    return _summary(folder, thread, cache.dropped, console)


def _check(args: argparse.Namespace) -> None:
    """Raise UsageError if options contradict each other."""
    from ... import names

    if args.use_sim_time and args.no_discovery:
        raise UsageError("--use-sim-time needs discovery, to find /clock; leave out --no-discovery")
    if args.compression_format and args.compression_mode == "none":
        raise UsageError("--compression-format needs --compression-mode file or message")
    if args.snapshot_mode and not args.max_cache_size:
        raise UsageError("--snapshot-mode needs a --max-cache-size, which is what it keeps")
    fault = names.fault("/" + args.node_name, names.MAX_NODE_NAME)
    if fault or "/" in args.node_name:
        raise UsageError(f"--node-name {args.node_name!r}: {fault or 'a name has no slash'}")
    key_values(args.custom_data)


def _create(folder: Path, args: argparse.Namespace) -> BagWriter:
    from ...bag.writer import BagWriter

    if folder.exists() or folder.is_symlink():
        raise ToolError(f"{folder} exists already; give another one: --output FOLDER")
    compression: Literal["zstd", "lz4"] | None = None
    if args.compression_mode != "none":
        compression = args.compression_format or "zstd"
    return BagWriter(
        folder,
        args.storage,
        compression=compression,
        max_size=args.max_bag_size,
        max_duration_ns=args.max_bag_duration * 10**9,
        custom_data=key_values(args.custom_data),
    )


@contextmanager
def _on_user_signal(call: Callable[[], None]) -> Iterator[None]:
    """Call a function at SIGUSR1 for the duration of a block, where the system has it."""
    number = getattr(signal, "SIGUSR1", None)
    if number is None:
        yield
        return

    def handle(_number: int, _frame: FrameType | None) -> None:
        call()

    before = signal.signal(number, handle)
    try:
        yield
    finally:
        signal.signal(number, before)


class _Session:
    """The event loop of a recording, with its keys and its state on the terminal."""

    def __init__(
        self,
        args: argparse.Namespace,
        network: Network,
        recorder: Recorder,
        thread: WriterThread,
        console: StatusLine,
        snapshot: Callable[[], int],
    ) -> None:
        self._args = args
        self._network = network
        self._recorder = recorder
        self._thread = thread
        self._console = console
        self._take_snapshot = snapshot
        self._wants_snapshot = False
        self._began = self._rate_at = time.monotonic()
        self._rate_count = 0
        self._rate = 0.0

    def run(self, stop: StopSignals) -> None:
        """Record until a signal or an error of the disk."""
        from .keyboard import open_keyboard

        recorder, network = self._recorder, self._network
        if self._args.no_discovery:
            network.settle()
            recorder.discover()
        told = self._args.no_discovery
        polled = 0.0
        pause = self._args.polling_interval / 1000
        with (
            open_keyboard(not self._args.disable_keyboard_controls) as keyboard,
            _on_user_signal(self._want_snapshot),
        ):
            if keyboard.is_open:
                self._console.say(self._keys_help())
            while not stop.stopped and self._thread.is_alive:
                now = time.monotonic()
                if not self._args.no_discovery and now - polled >= pause:
                    polled = now
                    recorder.discover()
                recorder.look_up(now)
                if not told and now - self._began >= _MISSING_SECONDS:
                    told = True
                    self._tell_missing()
                for key in keyboard.pressed():
                    self._on_key(key)
                if self._wants_snapshot:
                    self._wants_snapshot = False
                    self._snapshot()
                self._console.show(self._state)
                network.spin(
                    lambda: stop.stopped or self._wants_snapshot, min(pause, _KEYS_SECONDS)
                )
        network.spin(lambda: False, 0.0)  # what was taken and not delivered

    def _keys_help(self) -> str:
        snapshot = f", {_SNAPSHOT_KEY} writes a snapshot" if self._args.snapshot_mode else ""
        return f"Press SPACE to pause and resume{snapshot}, Ctrl-C to end"

    def _on_key(self, key: str) -> None:
        from .keyboard import SPACE

        if key == SPACE:
            self._recorder.paused = not self._recorder.paused
            self._console.say("Paused" if self._recorder.paused else "Resumed")
        elif key == _SNAPSHOT_KEY and self._args.snapshot_mode:
            self._snapshot()

    def _want_snapshot(self) -> None:
        self._wants_snapshot = self._args.snapshot_mode

    def _snapshot(self) -> None:
        self._console.say(f"Snapshot of {self._take_snapshot()} messages")

    def _tell_missing(self) -> None:
        for name in self._recorder.missing():
            topics = self._network.graph.topics()
            self._console.warn(
                f"{name} is recorded as soon as it appears; it is not there yet"
                f"{remedy(self._network, name, topics)}"
            )

    def _state(self) -> str:
        from .status_line import octets

        now, count = time.monotonic(), self._recorder.received
        if now - self._rate_at >= 1.0:
            self._rate = (count - self._rate_count) / (now - self._rate_at)
            self._rate_at, self._rate_count = now, count
        paused = "paused  " if self._recorder.paused else ""
        return (
            f"{paused}{now - self._began:.0f} s  {self._recorder.topics} topics"
            f"  {count} messages  {self._rate:.0f}/s  {octets(self._recorder.octets)}"
        )


def _summary(folder: Path, thread: WriterThread, dropped: int, console: StatusLine) -> int:
    from .status_line import octets

    console.say(
        f"Recorded {thread.written} messages ({octets(thread.octets)}) into {folder},"
        f" {dropped + thread.lost} dropped"
    )
    if thread.error is not None:
        raise ToolError(
            f"the recording has ended early, {dropped + thread.lost} messages are lost:"
            f" {thread.error}; 'uros bag recover {folder}' finishes what was written"
        )
    if dropped:
        console.warn(
            f"{dropped} messages were dropped, because the disk, or a node that was asked for a"
            " type, was too slow for a cache of --max-cache-size; a larger one bridges longer"
            " pauses"
        )
    return 0
