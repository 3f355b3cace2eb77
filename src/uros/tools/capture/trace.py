"""``uros trace``: print the messages between boards and agent, one line each.

They come from a capture, or from the status socket of an agent that runs on this machine.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Final, TextIO

from ...agent.objects.kinds import key_label
from ...printable import printable, unguarded
from ...wire import ids
from ..common import AGENT_HELP, agent_choice
from ..errors import ToolError
from .recordings import parser_for, read
from .records import Parser, Record, create_client_payload

if TYPE_CHECKING:
    from collections.abc import Callable

# How often a file that grows is read again, in seconds.
_POLL: Final = 0.2
_CHUNK: Final = 256 * 1024
# Times below this one count from the beginning of a recording, not from 1970.
_SINCE_1970: Final = 100_000_000.0
_FAR: Final = 100_000_000_000.0  # the year 5138: no system's calendar ends before
_DIM, _CLIENT, _AGENT, _TROUBLE, _OFF = (
    "\033[2m", "\033[36m", "\033[32m", "\033[1;31m", "\033[0m"
)  # fmt: skip


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros trace``."""
    parser.add_argument(
        "file", metavar="FILE", nargs="?",
        help="a capture of 'uros agent --capture' or of Wireshark (default: trace an agent that"
        " runs on this machine)",
    )  # fmt: skip
    parser.add_argument(
        "--client", metavar="KEY|N", type=_client,
        help="show one client only: its key, such as 0x4B0CBE99, or its number in the trace",
    )  # fmt: skip
    parser.add_argument(
        "--time", choices=("absolute", "relative", "delta"), default="relative",
        help="show the time of day, seconds since the first message (default), or since the"
        " previous one",
    )  # fmt: skip
    parser.add_argument("--hex", action="store_true", help="show the bytes of each message")
    parser.add_argument(
        "--json", action="store_true", help="print one JSON object for each message"
    )
    parser.add_argument(
        "--follow", action="store_true", help="keep reading as FILE grows, until Ctrl-C"
    )
    parser.add_argument(
        "--agent", metavar="PID|CONFIG", type=agent_choice,
        help=f"which agent, if several run on this machine: {AGENT_HELP}",
    )  # fmt: skip


def _client(text: str) -> int | str:
    """Parse a client's number, or its key as the trace prints it."""
    try:
        if text[:2].lower() == "0x" and 0 <= int(text, 16) <= 0xFFFFFFFF:
            return key_label(int(text, 16))
        if text.isdecimal() and len(text) < 10:
            return int(text)
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"{text!r} is neither a key, such as 0x4B0CBE99, nor a number")


def run(args: argparse.Namespace) -> int:
    """Print messages until the end of the capture, or until Ctrl-C.

    Raises:
        ToolError: The capture cannot be read, or the agent does not answer.
    """
    if args.file is None:
        if args.follow:
            raise ToolError("--follow needs a FILE; the trace of a running agent always follows")
        records = _live(args.agent)
    elif args.agent is not None:
        raise ToolError("--agent traces a running agent: leave FILE out")
    elif args.follow:
        records = follow(args.file)
    else:
        records = read(args.file, lambda text: print(printable(text), file=sys.stderr))
    colours = sys.stdout.isatty() and not os.environ.get("NO_COLOR")
    out = unguarded(sys.stdout) if colours else sys.stdout
    printer = Printer(out, args.client, args.time, args.hex, args.json, colours)
    live = args.file is None or args.follow
    try:
        for record in records:
            printer.show(record)
            if live:
                sys.stdout.flush()
    except KeyboardInterrupt:
        return 0
    if not printer.shown:
        printer.explain_nothing(args.file or "the agent")
    return 0


def _live(choice: int | str | None) -> Iterator[Record]:
    from ..agent.running_agents import find_agent, stream
    from .recordings import TextParser

    parser = TextParser("the agent's answer")
    for chunk in stream(find_agent(choice), "trace"):
        yield from parser.feed(chunk)


def follow(path: str, pause: Callable[[], None] = lambda: time.sleep(_POLL)) -> Iterator[Record]:
    """Yield the records of a file, and without end those that are added to it.

    When the agent begins a new file of that name, the rest of the old one comes first.

    Args:
        path: The capture.
        pause: Waits before the file is read again.

    Raises:
        ToolError: The file cannot be read.
    """
    while True:
        parser: Parser | None = None
        try:
            file = open(path, "rb", buffering=0)
        except OSError as error:
            raise ToolError(f"{path} cannot be read: {error.strerror or error}") from error
        with file:
            ended = False
            while True:
                chunk = file.read(_CHUNK)
                if chunk:
                    parser = parser or parser_for(chunk, path)
                    yield from parser.feed(chunk)
                    continue
                if ended:
                    break
                ended = _replaced(path, file.fileno())
                if not ended:
                    pause()


def _replaced(path: str, fileno: int) -> bool:
    """Whether the name stands for another file now, or the file was truncated."""
    here = os.fstat(fileno)
    try:
        there = os.stat(path)
    except OSError:
        return False  # the new file is not there yet
    same = (here.st_dev, here.st_ino) == (there.st_dev, there.st_ino)
    return not same or os.lseek(fileno, 0, os.SEEK_CUR) > here.st_size


class Printer:
    """Prints records, and each client's address before its first.

    Args:
        out: Where to print.
        client: Key or number of the only client to show; None for all.
        times: ``absolute``, ``relative`` or ``delta``.
        dump: Whether to print the bytes too.
        as_json: Whether to print JSON objects.
        colours: Whether to colour the text.
    """

    def __init__(
        self, out: TextIO, client: int | str | None, times: str, dump: bool, as_json: bool,
        colours: bool,
    ) -> None:  # fmt: skip
        self.shown = 0
        self._out = out
        self._client = client
        self._times = times
        self._hex = dump
        self._json = as_json
        self._colours = colours
        self._first: float | None = None
        self._before = 0.0
        self._keys: dict[int, int] = {}  # by the client's number
        self._introduced: dict[int, str] = {}

    def explain_nothing(self, what: str) -> None:
        """Say why nothing was printed, and which clients there are."""
        about = f"{what} has no messages"
        if self._client is not None:
            known = [f"{number} ({key_label(key)})" for number, key in sorted(self._keys.items())]
            about = f"{what} has no messages of client {self._client}"
            about += f"; there are {', '.join(known[:20])}" if known else ""
        print(about, file=sys.stderr)

    def show(self, record: Record) -> None:
        """Print a record, if it belongs to the client to show."""
        key = self._learn(record)
        if self._first is None:
            self._first = self._before = record.time
        name = "" if key == 0 else key_label(key)
        if self._client is not None and self._client not in (record.client, name):
            return
        self.shown += 1
        if self._json:
            self._out.write(json.dumps(self._fields(record, name)) + "\n")
            return
        self._out.write(self._text(record, name))

    def _learn(self, record: Record) -> int:
        """Return the client's key if the capture or one of its messages holds it, else 0."""
        message = record.message
        key = record.key
        if message[:1] and message[0] < 0x80 and len(message) >= 8:
            key = int.from_bytes(message[4:8], "big")
        elif (payload := create_client_payload(message) or b"")[:4] == ids.COOKIE:
            key = int.from_bytes(payload[8:12], "big")
        if len(self._keys) > 65536:  # attack: a capture of addresses
            self._keys.clear()
        if key:
            self._keys[record.client] = key
        return self._keys.get(record.client, 0)

    def _time(self, at: float) -> str:
        before, self._before = self._before, at
        if self._times == "absolute" and at >= _SINCE_1970:
            whole, micro = divmod(round(min(at, _FAR) * 1e6), 1_000_000)
            stamp = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(whole))
            return f"{stamp}.{micro:06d}"
        since = before if self._times == "delta" else self._first or 0.0
        return f"{at - since:12.6f}"

    def _text(self, record: Record, name: str) -> str:
        from ...agent.observability.format import escape, format_message

        stamp = self._time(record.time)
        lines = []
        if self._introduced.get(record.client) != name:
            if len(self._introduced) > 65536:
                self._introduced.clear()
            self._introduced[record.client] = name
            where = f"{escape(record.transport)} {escape(record.address)}"
            about = f"client {record.client} {name or '(no key yet)'} is at {where}"
            lines.append(self._coloured(_DIM, f"-- {about}"))
        if record.lost:
            what = f"-- {record.lost} messages were not captured"
            lines.append(self._coloured(_TROUBLE, what))
        text = format_message(record.message)
        arrow, colour = ("->", _CLIENT) if record.from_client else ("<-", _AGENT)
        if "??" in text:
            colour = _TROUBLE
        lines.append(
            f"{self._coloured(_DIM, stamp)} {record.client:>3} {self._coloured(colour, arrow)}"
            f" {self._coloured(_TROUBLE, text) if '??' in text else text}"
        )
        if self._hex:
            lines.extend(self._coloured(_DIM, line) for line in dump(record.message))
        return "\n".join(lines) + "\n"

    def _coloured(self, colour: str, text: str) -> str:
        return f"{colour}{text}{_OFF}" if self._colours else text

    def _fields(self, record: Record, name: str) -> dict[str, Any]:
        from ...agent.observability.format import parse_message, stream_name

        found = parse_message(record.message)
        out: dict[str, Any] = {
            "t": record.time,
            "from": "client" if record.from_client else "agent",
            "client": record.client,
            "transport": record.transport,
            "address": record.address,
            "key": name or None,
            "session": None if found.session is None else f"0x{found.session:02X}",
            "stream": None if found.stream is None else stream_name(found.stream),
            "number": found.number,
            "submessages": [{"kind": part.kind, "text": part.text} for part in found.parts],
        }
        if found.error:
            out["trouble"] = found.error
        if record.lost:
            out["lost"] = record.lost
        out["hex"] = record.message.hex()
        return out


def dump(data: bytes) -> Iterator[str]:
    """Yield lines of 16 bytes each, in hexadecimal and in ASCII."""
    for at in range(0, len(data), 16):
        part = data[at : at + 16]
        letters = "".join(chr(octet) if 32 <= octet < 127 else "." for octet in part)
        yield f"{'':18}{at:04X}  {part.hex(' ').upper():<47}  {letters}"
