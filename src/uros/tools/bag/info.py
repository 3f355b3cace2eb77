"""``uros bag info``: print information about a bag."""

from __future__ import annotations

import argparse
import struct
from collections import defaultdict
from collections.abc import Iterable
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from ...printable import printable
from ..listing import add_json, print_json
from ..waiting import warn
from .arguments import add_bag

if TYPE_CHECKING:
    from ...bag.metadata import BagMetadata
    from ...bag.reader import BagReader

_WIDTH: Final = 19
_SERVICE_WIDTH: Final = 21
_EVENTS: Final = "/_service_event"
_EVENT_TYPE: Final = "_Event"
_MONTHS: Final = "Jan Feb Mar Apr May Jun Jul Aug Sep Oct Nov Dec".split()
_UNITS: Final = ("B", "KiB", "MiB", "GiB", "TiB")
# service_msgs/msg/ServiceEventInfo in CDR, behind the encapsulation header: type of the event,
# stamp, the client's id, sequence number.
_EVENT: Final = "B3xiI16s4xq"
_REQUESTS: Final = (0, 1)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros bag info``."""
    add_bag(parser)
    parser.add_argument(
        "-t", "--topic-name", action="store_true", help="print the names of the topics only"
    )
    parser.add_argument(
        "-v", "--verbose", action="store_true",
        help="print the size of each topic, and the requests and responses of services",
    )  # fmt: skip
    parser.add_argument(
        "--sort", choices=("name", "type", "count"), default="name",
        help="order of the topics (default: name)",
    )  # fmt: skip
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Print the metadata of a bag."""
    from ...bag.reader import BagReader

    reader = BagReader(args.bag_path, args.storage)
    # A single file was opened just now, and -v reads all messages: both fail if it is damaged.
    if not args.verbose and Path(args.bag_path).is_dir():
        warn_of_damage(reader)
    if args.topic_name and args.verbose:
        warn("-t has no effect beside -v")
    if args.topic_name and not args.verbose:
        rows = sorted_rows(topic_rows(reader.metadata), args.sort)
        if args.json:
            print_json([{"name": printable(row.name)} for row in rows])
            return 0
        for row in rows:
            print(printable(row.name))
        return 0
    of_bag = reader.metadata, bag_size(args.bag_path), args.sort, contents(reader, args)
    if args.json:
        print_json(document(*of_bag))
    else:
        print(describe(*of_bag))
    return 0


class Row(NamedTuple):
    """A topic or a service with its number of messages."""

    name: str
    type_name: str
    messages: int
    form: str


class Contents:
    """What only the messages tell.

    Attributes:
        sizes: Bytes of messages by topic.
        requests: Requests by topic of service events: client and sequence number.
        responses: Responses, likewise.
    """

    def __init__(self) -> None:
        self.sizes: dict[str, int] = defaultdict(int)
        self.requests: dict[str, set[tuple[bytes, int]]] = defaultdict(set)
        self.responses: dict[str, set[tuple[bytes, int]]] = defaultdict(set)

    def add(self, topic: str, cdr: bytes) -> None:
        """Take a message."""
        self.sizes[topic] += len(cdr)
        if not topic.endswith(_EVENTS):
            return
        form = ("<" if cdr[1:2] in (b"\1", b"\7") else ">") + _EVENT
        if len(cdr) >= 4 + struct.calcsize(form):
            kind, _, _, client, sequence = struct.unpack_from(form, cdr, 4)
            calls = self.requests if kind in _REQUESTS else self.responses
            calls[topic].add((client, sequence))


def warn_of_damage(reader: BagReader) -> None:
    """Name the files that cannot be read, on standard error: metadata.yaml does not tell.

    Files that are compressed as a whole are not unpacked for this.
    """
    from ...bag.errors import BagError
    from ...bag.reader import open_reader
    from ...bag.storage import PACKED_SUFFIX

    for path in reader.files:
        if path.name.lower().endswith(PACKED_SUFFIX):
            continue
        try:
            open_reader(path, reader.metadata.storage).close()
        except BagError as error:
            warn(" ".join(str(error).split()))


def contents(reader: BagReader, args: argparse.Namespace) -> Contents | None:
    """Return what the messages tell, with ``-v``."""
    if not args.verbose:
        return None
    found = Contents()
    for message in reader.messages():
        found.add(message.topic, message.cdr)
    return found


def bag_size(path: str) -> int:
    """Return the size of a bag in bytes: of all files of its folder, or of the file."""
    if not Path(path).is_dir():
        return Path(path).stat().st_size
    return sum(file.stat().st_size for file in Path(path).iterdir() if file.is_file())


def topic_rows(metadata: BagMetadata) -> list[Row]:
    """Return the topics that are no events of services."""
    return [row for row in _rows(metadata) if not _is_service(row)]


def describe(metadata: BagMetadata, size: int, sort: str, found: Contents | None) -> str:
    """Return what ros2 prints about a bag.

    Args:
        metadata: The metadata.
        size: The bag's size in bytes.
        sort: ``name``, ``type`` or ``count``.
        found: What the messages tell; None without ``-v``.
    """
    services = [row for row in _rows(metadata) if _is_service(row)]
    start, end = metadata.starting_time_ns, metadata.end_time_ns
    topics = [
        f"Topic: {printable(row.name)} | Type: {printable(row.type_name)} | "
        f"Count: {row.messages} | "
        + (f"Size Contribution: {format_size(found.sizes[row.name])} | " if found else "")
        + f"Serialization Format: {row.form}"
        for row in sorted_rows(topic_rows(metadata), sort)
    ]
    lines = [
        "",
        f"Files:             {_list([printable(file.path) for file in metadata.files], _WIDTH)}",
        f"Bag size:          {format_size(size)}",
        f"Storage id:        {printable(metadata.storage)}",
        f"ROS Distro:        {printable(metadata.ros_distro) or 'unknown'}",
        f"Duration:          {format_seconds(metadata.duration_ns)}s",
        f"Start:             {format_time(start)}",
        f"End:               {format_time(end)}",
        f"Messages:          {metadata.message_count - sum(row.messages for row in services)}",
        f"Topic information: {_list(topics, _WIDTH)}",
        f"Service:           {len(services)}",
        f"Service information: {_list(_service_lines(services, sort, found), _SERVICE_WIDTH)}",
    ]
    return "\n".join(lines)


def document(metadata: BagMetadata, size: int, sort: str, found: Contents | None) -> dict[str, Any]:
    """Return what `describe` prints, for JSON: sizes in bytes, times in ns (None if unknown).

    Args:
        metadata: The metadata.
        size: The bag's size in bytes.
        sort: ``name``, ``type`` or ``count``.
        found: What the messages tell; None without ``-v``.
    """
    from ...bag.metadata import NO_TIME

    topics, services = [], []
    for row in sorted_rows(_rows(metadata), sort):
        more: dict[str, Any] = {"serialization_format": row.form}
        if found is not None:
            more["size"] = found.sizes[row.name]
        name, kind = printable(row.name), printable(row.type_name)
        if not _is_service(row):
            topics.append({"name": name, "type": kind, "count": row.messages, **more})
            continue
        if found is not None:
            more["requests"] = len(found.requests[row.name])
            more["responses"] = len(found.responses[row.name])
        name, kind = name.removesuffix(_EVENTS), kind.removesuffix(_EVENT_TYPE)
        services.append({"name": name, "type": kind, "events": row.messages, **more})
    has_times = metadata.starting_time_ns != NO_TIME
    return {
        "files": [printable(file.path) for file in metadata.files],
        "size": size,
        "storage": printable(metadata.storage),
        "ros_distro": printable(metadata.ros_distro) or None,
        "duration": metadata.duration_ns,
        "start": metadata.starting_time_ns if has_times else None,
        "end": metadata.end_time_ns if has_times else None,
        "messages": metadata.message_count - sum(service["events"] for service in services),
        "topics": topics,
        "services": services,
    }


def sorted_rows(rows: Iterable[Row], sort: str) -> list[Row]:
    """Return the rows in the order of ``--sort``, and of equal ones by name."""
    ordered = sorted(rows)
    if sort == "type":
        ordered.sort(key=lambda row: row.type_name)
    elif sort == "count":
        ordered.sort(key=lambda row: row.messages)
    return ordered


def format_size(size: int) -> str:
    """Return a size as ros2 prints it: ``512 B``, ``1.5 KiB``."""
    value, unit = float(size), 0
    while value >= 1024 and unit < len(_UNITS) - 1:
        value /= 1024
        unit += 1
    return f"{value:.{1 if unit else 0}f} {_UNITS[unit]}"


def format_seconds(nanoseconds: int) -> str:
    """Return nanoseconds as seconds with nine digits behind the point."""
    return f"{nanoseconds // 10**9}.{nanoseconds % 10**9:09}"


def format_time(nanoseconds: int) -> str:
    """Return a time since 1970 as ros2 prints it, in the local time zone."""
    try:
        local = datetime.fromtimestamp(nanoseconds // 10**9)
    except (ValueError, OverflowError, OSError):  # more than this system's calendar has
        return f"({format_seconds(nanoseconds)})"
    date = f"{_MONTHS[local.month - 1]} {local.day:2} {local.year} {local:%H:%M:%S}"
    return f"{date}.{nanoseconds % 10**9:09} ({format_seconds(nanoseconds)})"


def _service_lines(services: list[Row], sort: str, found: Contents | None) -> list[str]:
    lines = []
    for row in sorted_rows(services, sort):
        name = printable(row.name.removesuffix(_EVENTS))
        kind = printable(row.type_name.removesuffix(_EVENT_TYPE))
        line = f"Service: {name} | Type: {kind} | "
        if found is None:
            line += f"Event Count: {row.messages} | "
        else:
            line += f"Request Count: {len(found.requests[row.name])} | "
            line += f"Response Count: {len(found.responses[row.name])} | "
            line += f"Size Contribution: {format_size(found.sizes[row.name])} | "
        lines.append(f"{line}Serialization Format: {row.form}")
    return lines


def _rows(metadata: BagMetadata) -> list[Row]:
    return [
        Row(topic.name, topic.type_name, count, printable(topic.serialization_format))
        for topic, count in metadata.topics
    ]


def _is_service(row: Row) -> bool:
    return row.name.endswith(_EVENTS) and row.type_name.endswith(_EVENT_TYPE)


def _list(lines: list[str], width: int) -> str:
    return ("\n" + " " * width).join(lines)
