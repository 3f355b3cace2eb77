"""``uros topic echo``: print messages of a topic."""

from __future__ import annotations

import argparse
import sys
import time
from typing import TYPE_CHECKING, Any, Final

from ..common import add_common, add_topic, discover, join, positive_float, unsigned_int
from ..errors import ToolError
from ..values import plain
from ..values.qos_subscribe import add_qos_arguments, choose
from ..values.yaml_text import Value, dump
from ..waiting import topic_types, warn

if TYPE_CHECKING:
    from ...host.network import Network, Received

_TRUNCATE: Final = 128
_END: Final = "---\n"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros topic echo``."""
    add_topic(parser)
    parser.add_argument(
        "type",
        metavar="TYPE",
        nargs="?",
        help="type of the messages, such as std_msgs/msg/String (default: the topic's type)",
    )
    add_common(parser)
    add_qos_arguments(parser)
    parser.add_argument("--once", action="store_true", help="exit after the first message")
    parser.add_argument(
        "--timeout",
        metavar="S",
        type=positive_float,
        help="exit after so many seconds; exit status 1 if no message came",
    )
    parser.add_argument(
        "--field", metavar="F", help="print only this field, such as pose.pose.position"
    )
    parser.add_argument(
        "--csv", action="store_true", help="print each message as a line of comma-separated values"
    )
    parser.add_argument(
        "--raw", action="store_true", help="print the serialized message; needs no type"
    )
    parser.add_argument("--no-arr", action="store_true", help="do not print arrays")
    parser.add_argument("--no-str", action="store_true", help="do not print strings")
    parser.add_argument(
        "-f", "--full-length", action="store_true", help="do not cut long arrays and strings"
    )
    parser.add_argument(
        "-l",
        "--truncate-length",
        metavar="N",
        type=unsigned_int,
        default=_TRUNCATE,
        help=f"cut arrays and strings to this length (default: {_TRUNCATE})",
    )
    parser.add_argument(
        "--flow-style", action="store_true", help="print arrays in brackets on one line"
    )
    parser.add_argument(
        "-i",
        "--include-message-info",
        action="store_true",
        help="print when each message was sent and received too",
    )
    parser.add_argument("--no-lost-messages", action="store_true", help=argparse.SUPPRESS)


def run(args: argparse.Namespace) -> int:
    """Print messages until ``--once``, ``--timeout`` or Ctrl-C.

    Raises:
        ToolError: The topic has several types, or nothing came in time.
    """
    printer = Printer(args)
    try:
        with join(args) as network:
            _listen(network, args, printer)
    except KeyboardInterrupt:
        return 0  # the usual end
    if args.timeout is not None and not printer.count:
        raise ToolError(
            f"no message came on {args.topic} in domain {network.domain} within {args.timeout:g} s;"
            f" check the publishers: uros topic info -v {args.topic}"
        )
    return 0


def _listen(network: Network, args: argparse.Namespace, printer: Printer) -> None:
    message: Any = None
    if args.type is not None and not args.raw:
        message = _load(args.type)
    discover(network, args)
    deadline = None if args.timeout is None else time.monotonic() + args.timeout
    if args.type is None:
        type_name = _only_type(args.topic, topic_types(network, args.topic, deadline))
        message = None if args.raw else _load(type_name)
    else:
        type_name = args.type if message is None else message._TYPE
        present = network.graph.topics().get(args.topic, [type_name])
        if type_name not in present:
            warn(f"{args.topic} has the type {' and '.join(present)}: no message will come")
    offered = [publisher.qos for publisher in network.graph.publishers(args.topic)]
    qos, notes = choose(args, offered)
    for note in notes:
        warn(note)
    network.listen(args.topic, type_name, qos, lambda got: printer.show(got, message))
    left = None if deadline is None else max(0.0, deadline - time.monotonic())
    network.spin(lambda: printer.done, left)


def _only_type(topic: str, types: list[str]) -> str:
    if len(types) > 1:
        raise ToolError(
            f"{topic} has several types: {', '.join(types)}; give one: uros topic echo {topic} TYPE"
        )
    return types[0]


def _load(type_name: str) -> Any:
    from ...interfaces import load

    found = load(type_name)
    if not plain.is_message(found):
        raise ToolError(f"{type_name} is not a message; topics carry messages")
    return found


class Printer:
    """Prints messages as the options say, and counts them."""

    def __init__(self, args: argparse.Namespace) -> None:
        self._args = args
        self._path = None if args.field is None else [s for s in args.field.split(".") if s]
        if self._path == []:
            raise ToolError(f"--field {args.field!r} names no field")
        self._show = plain.Show(
            None if args.full_length else args.truncate_length, args.no_arr, args.no_str
        )
        self.count = 0
        self.unread = 0
        self._say_at = 1

    @property
    def done(self) -> bool:
        """Whether ``--once`` is satisfied."""
        return bool(self._args.once and self.count)

    def show(self, received: Received, message_class: Any) -> None:
        """Print a sample; with ``message_class`` None, its bytes."""
        if self.done:
            return
        info: dict[str, Value] = {
            "source_timestamp": received.source_ns,
            "received_timestamp": received.received_ns,
            "publication_sequence_number": None,  # Cyclone does not provide them
            "reception_sequence_number": None,
        }
        if message_class is None:
            text = self._single(str(received.cdr), info)
        else:
            from ...interfaces import InterfaceError, codec

            try:
                message = codec.from_cdr(message_class, received.cdr)
            except InterfaceError as error:
                self._unread(error)
                return
            text = self._text(message, info)
        sys.stdout.write(text)
        sys.stdout.flush()
        self.count += 1

    def _unread(self, error: Exception) -> None:
        """Warn at the first unreadable message, then each time at ten times as many."""
        self.unread += 1
        if self.unread == self._say_at:
            self._say_at *= 10
            warn(
                f"{self.unread} message{'s' if self.unread > 1 else ''} could not be read: {error};"
                " is this the publisher's definition? --raw prints the bytes"
            )

    def _text(self, message: Any, info: dict[str, Value]) -> str:
        value, kind = message, ""
        if self._path is not None:
            try:
                value, kind = plain.select(message, self._path)
            except plain.FieldError as error:
                raise ToolError(f"--field {self._args.field}: {error}") from error
        if kind:
            return self._single(plain.text(value, kind), info)
        with_info = self._args.include_message_info
        if self._args.csv:
            first = "".join(f"{'' if one is None else one}," for one in info.values())
            return f"{first if with_info else ''}{plain.csv(value, self._show)}\n"
        first = dump(dict(sorted(info.items()))) + _END if with_info else ""
        return first + dump(plain.plain(value, self._show), self._args.flow_style) + _END

    def _single(self, text: str, info: dict[str, Value]) -> str:
        if self._args.include_message_info:
            text = f"---Got new message, message info:---\n{info}\n---Message data:---\n{text}"
        return f"{text}\n{_END}"
