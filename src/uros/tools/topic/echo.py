"""``uros topic echo``: print messages of a topic."""

from __future__ import annotations

import argparse
import time
from typing import TYPE_CHECKING, Any, Final

from ...printable import printable
from ..common import (
    add_common,
    add_node_name,
    add_topic,
    discover,
    join,
    positive_float,
)
from ..errors import ToolError, UsageError
from ..graph_types import only_type
from ..sim_time import add_use_sim_time
from ..values import plain
from ..values.expression import Expression
from ..values.message_reader import MessageReader
from ..values.qos_subscribe import add_qos_arguments, choose
from ..values.show_options import add_show_arguments, chosen_show
from ..values.typed_values import load_message
from ..values.yaml_text import Value, dump
from ..waiting import topic_types, warn
from .lost import LostReport
from .output import Output

if TYPE_CHECKING:
    from ...host.network import Network, Received

_END: Final = "---\n"
_WRITE_AGAIN: Final = 0.01  # seconds after which a slow reader of the output may have room
_TELL: Final = 1.0
_TO_END: Final = 1.0  # seconds that it has to take the rest after Ctrl-C


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
        "--field", metavar="F", action="append",
        help="print only this field, such as pose.pose.position, poses[0].position or ranges[2:5];"
        " may be repeated",
    )  # fmt: skip
    parser.add_argument(
        "--filter", metavar="EXPR",
        help="print only messages m for which this expression is true, such as 'm.data > 3'; with"
        " one --field, m is that field",
    )  # fmt: skip
    parser.add_argument(
        "--raw", action="store_true", help="print the serialized message; needs no type"
    )
    add_show_arguments(parser)
    parser.add_argument(
        "-i",
        "--include-message-info",
        action="store_true",
        help="print when each message was sent and received too",
    )
    parser.add_argument(
        "--no-lost-messages", action="store_true", help="do not tell how many messages were lost"
    )
    parser.add_argument("--lost-messages", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument(
        "-c", "--clear", action="store_true",
        help="clear the screen of the terminal before each message",
    )  # fmt: skip
    add_node_name(parser)
    add_use_sim_time(parser, used=False)


def run(args: argparse.Namespace) -> int:
    """Print messages until ``--once``, ``--timeout`` or Ctrl-C.

    Raises:
        UsageError: A field or the filter cannot be read.
        ToolError: The topic has several types, or nothing came in time.
    """
    printer = Printer(args)
    try:
        with join(args, node_name=args.node_name or "") as network:
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
        message = load_message(args.type, network)
    discover(network, args)
    deadline = None if args.timeout is None else time.monotonic() + args.timeout
    if args.type is None:
        type_name = only_type("topic echo", args.topic, topic_types(network, args.topic, deadline))
        message = None if args.raw else load_message(type_name, network)
    else:
        type_name = args.type if message is None else message._TYPE
        present = network.graph.topics().get(args.topic, [type_name])
        if type_name not in present:
            warn(f"{args.topic} has the type {' and '.join(present)}: no message will come")
    printer.expect(message)
    offered = [publisher.qos for publisher in network.graph.publishers(args.topic)]
    qos, notes = choose(args, offered)
    for note in notes:
        warn(note)
    network.listen(args.topic, type_name, qos, printer.show)
    lost = None if args.no_lost_messages else LostReport(network)
    to_end: float | None = None
    try:
        while not printer.done and (deadline is None or time.monotonic() < deadline):
            seconds = _WRITE_AGAIN if printer.output.waiting else _TELL
            if deadline is not None:
                seconds = min(seconds, max(0.0, deadline - time.monotonic()))
            network.spin(printer.flush, seconds)
            if lost:
                lost.tell(printer.skipped)
    except KeyboardInterrupt:
        to_end = _TO_END
        raise
    finally:
        printer.output.flush(to_end)
        if lost:
            lost.tell(printer.skipped, last=True)


class Printer:
    """Prints messages as the options say, and counts them."""

    def __init__(self, args: argparse.Namespace) -> None:
        self._args = args
        self._paths = [_path(text) for text in args.field or ()]
        self._filter = None if args.filter is None else Expression(args.filter)
        self._show = chosen_show(args)
        self._reader: MessageReader | None = None
        self.output = Output()
        self.count = 0
        self.skipped = 0

    def expect(self, message_class: Any) -> None:
        """Set the class of the messages; None to print their bytes.

        Raises:
            ToolError: The class does not have a field of ``--field`` or ``--filter``.
            UsageError: There are options that need a class.
        """
        if message_class is None:
            if self._paths or self._filter:
                raise UsageError("--raw prints whole messages: leave out --field and --filter")
            return
        self._reader = MessageReader(message_class)
        if self._filter is not None and len(self._paths) != 1:
            self._filter.check(message_class)

    @property
    def done(self) -> bool:
        """Whether ``--once`` is satisfied."""
        return bool(self._args.once and self.count)

    def flush(self) -> bool:
        """Write what the reader of the output has room for; return `done`."""
        self.output.flush()
        return self.done

    def show(self, received: Received) -> None:
        """Print a sample.

        Raises:
            ToolError: It does not have a field, or the filter fails on it.
        """
        if self.done:
            return
        if self.output.full:
            self.skipped += 1
            return
        if self._reader is None:
            text = self._single(str(received.cdr), received)
        else:
            message = self._reader.read(received.cdr)
            if message is None:
                return
            values = self._values(message)
            if self._filter is not None:
                subject = values[0][0] if len(self._paths) == 1 else message
                if not self._filter.accepts(subject):
                    return
            text = self._text(values, received)
        self.output.write(text, self._args.clear)
        self.count += 1

    def _values(self, message: Any) -> list[tuple[Any, str]]:
        """Return the values to print, and the type of each ("" for a message)."""
        try:
            return [plain.select(message, path) for path in self._paths] or [(message, "")]
        except plain.FieldError as error:
            raise ToolError(f"--field {' '.join(self._args.field)}: {error}") from error

    def _text(self, values: list[tuple[Any, str]], received: Received) -> str:
        with_info = self._args.include_message_info
        if self._args.csv and not (len(values) == 1 and values[0][1]):
            cells = [
                printable(plain.text(value, kind)) if kind else plain.csv(value, self._show)
                for value, kind in values
            ]
            if with_info:
                cells[:0] = ["" if one is None else str(one) for one in _info(received).values()]
            return ",".join(cells) + "\n"
        texts = []
        for value, kind in values:
            if kind:
                texts.append(self._single(plain.text(value, kind), received))
                continue
            if with_info:
                texts.append(dump(dict(sorted(_info(received).items()))) + _END)
            texts.append(dump(plain.plain(value, self._show), self._args.flow_style) + _END)
        return "".join(texts)

    def _single(self, text: str, received: Received) -> str:
        if self._args.include_message_info:
            info = _info(received)
            text = f"---Got new message, message info:---\n{info}\n---Message data:---\n{text}"
        return f"{text}\n{_END}"


def _path(text: str) -> plain.FieldPath:
    try:
        return plain.parse_path(text)
    except ValueError as error:
        raise UsageError(f"--field {text!r}: {error}") from error


def _info(received: Received) -> dict[str, Value]:
    return {
        "source_timestamp": received.source_ns,
        "received_timestamp": received.received_ns,
        "publication_sequence_number": None,  # Cyclone does not provide them
        "reception_sequence_number": None,
    }
