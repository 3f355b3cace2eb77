"""``uros replay``: play a capture's boards to an agent and compare its answers.

A board's message is sent once every answer recorded before it has come, and not earlier than in the
capture (``--fast``: at once). Acknowledgements and heartbeats are generated here, because they
depend on the messages that get lost now. See :mod:`.script` for what is compared.
"""

from __future__ import annotations

import argparse
import select
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from typing import Final

from ...printable import printable
from ...ticks import TIME_MASK, ticks_diff
from ...wire import ids
from ...wire import session as messages
from ...wire.cdr import Reader
from ...wire.data import REQUEST_SIZE, SAMPLE_IDENTITY_SIZE
from ...wire.errors import DecodeError
from ...wire.header import MessageWriter, pull_header
from ...wire.streams import ReliableIn, ReliableOut
from ..common import positive_float
from ..errors import ToolError
from .connections import Connection, Connections
from .recordings import read
from .records import create_client_payload
from .script import Answer, AnswerReader, List, Script, Step, script, submessages

_PATIENCE: Final = 3.0
# The request id of pings, by which their answers are recognized.
_PING_REQUEST: Final = 0x7777
_MAX_DIFFERENCES: Final = 10  # that are printed
_PING_PERIOD: Final = 0.5
# Longer than an agent handles one burst of messages, in seconds.
_BURST: Final = 0.02


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros replay``."""
    parser.add_argument(
        "file", metavar="FILE", help="a capture: pcapng, or text of 'uros agent --capture'"
    )
    parser.add_argument(
        "agent", metavar="AGENT",
        help="address of the agent, such as udp4://127.0.0.1:8888, tcp4://..., udp6://[::1]:8888 or"
        " serial:///dev/ttyUSB0?baudrate=115200; start a fresh agent for it",
    )  # fmt: skip
    parser.add_argument(
        "--fast", action="store_true", help="do not wait for the times of the capture"
    )
    parser.add_argument(
        "--no-data", action="store_true",
        help="do not compare samples; those that other nodes published do not come again",
    )  # fmt: skip
    parser.add_argument(
        "--patience", type=positive_float, default=_PATIENCE, metavar="S",
        help=f"seconds to wait for an answer (default: {_PATIENCE:.0f})",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Play the capture and print the comparison.

    Returns:
        0 if all answers are as recorded, else 1.

    Raises:
        ToolError: The capture cannot be played, or no agent answers.
    """
    found = script(read(args.file, _say), not args.no_data)
    for client, why in found.left_out.items():
        _say(f"client {client} ({found.names[client]}) is left out: {why}")
    if not any(isinstance(turn, Step) for turn in found.turns):
        raise ToolError(f"{args.file} has nothing to play: no board opens a session in it")
    player = Player(found, Connections(args.agent), args.fast, args.patience, not args.no_data)
    try:
        player.play()
    except KeyboardInterrupt:
        _say("interrupted: the table shows what was played so far")
        player.report(sys.stdout.write)
        return 130
    finally:
        player.close()
    return 0 if player.report(sys.stdout.write) else 1


def _say(text: str) -> None:
    print(printable(text), file=sys.stderr)


class _Board:
    """One client: its connection, its streams, and the answers that it got."""

    def __init__(self, client: int, connection: Connection, data: bool) -> None:
        self.connection = connection
        self.answers = AnswerReader(client, data)
        self.out: dict[int, ReliableOut] = {}
        self.session = 0x81
        self.key = 0
        self.sent = 0
        self.pinged = False

    def open(self, message: bytes) -> None:
        """Begin the session that this CREATE_CLIENT opens."""
        self.out.clear()
        self.answers.reset()
        at = 4 if message[0] else 8
        r = Reader(message, at + 4, len(message))
        try:
            _, _, _, self.key, self.session, _, _ = messages.pull_create_client(r)
        except DecodeError:
            pass  # it is played all the same: the agent refuses it


class Player:
    """Plays a script to an agent; see the module.

    Args:
        play: What to play and to expect.
        connections: Connects the boards to the agent.
        fast: Whether to ignore the times of the capture.
        patience: Seconds to wait for an answer.
        data: Whether samples are compared.
    """

    def __init__(
        self, play: Script, connections: Connections, fast: bool, patience: float, data: bool
    ) -> None:
        self._turns = play.turns
        self._names = play.names
        self._connections = connections
        self._fast = fast
        self._patience = patience
        self._data = data
        self._boards: dict[int, _Board] = {}
        self.expected: dict[tuple[int, List], list[Answer]] = defaultdict(list)
        self.got: dict[tuple[int, List], list[Answer]] = defaultdict(list)
        for turn in self._turns:
            if isinstance(turn, Answer):
                self.expected[turn.client, turn.list].append(turn)
        self._due: dict[tuple[int, List], int] = defaultdict(int)
        self._given_up: set[tuple[int, List]] = set()
        self._callers: dict[bytes, bytes] = {}  # of services: recorded → today's

    def play(self) -> None:
        """Play the whole script, then wait for the answers that are on their way.

        Raises:
            ToolError: No agent answers, or it no longer does.
        """
        started: float | None = None
        for turn in self._turns:
            if isinstance(turn, Answer):
                self._due[turn.client, turn.list] += 1
                continue
            board = self._board(turn.client)
            if started is None:
                started = time.monotonic()
            self._await_answers()
            while not self._fast and (left := started + turn.time - time.monotonic()) > 0:
                self._pump(left)
            self._send(board, turn)
        self._await_answers()
        self._ping_all()

    def close(self) -> None:
        """Close all connections."""
        for board in self._boards.values():
            board.connection.close()

    def _board(self, client: int) -> _Board:
        found = self._boards.get(client)
        if found is None:
            found = _Board(client, self._connections.connect(client), self._data)
            first = not self._boards
            self._boards[client] = found
            if first:
                self._await_agent(found)
        return found

    # --- sending ------------------------------------------------------------------------

    def _await_agent(self, board: _Board) -> None:
        """Ping until the agent answers. Raises ToolError."""
        deadline = time.monotonic() + self._patience
        while not board.pinged:
            if time.monotonic() > deadline:
                raise ToolError(
                    f"no agent answers at {self._connections.where}: start one ('uros agent'), or"
                    " correct the address"
                )
            self._ping(board)
            self._wait_for(lambda: board.pinged, _PING_PERIOD)

    def _ping(self, board: _Board) -> None:
        w = MessageWriter(bytearray(64), ids.SESSION_NONE_WITHOUT_KEY, ids.STREAM_NONE, 0)
        w.begin(ids.GET_INFO)
        messages.push_get_info(w, _PING_REQUEST, ids.OBJECT_AGENT, ids.INFO_ACTIVITY)
        board.pinged = False
        board.connection.send(w.finish())

    def _ping_all(self) -> None:
        """Wait until the agent has answered everything.

        A ping is answered before the sessions answer the burst that it came in. So each board
        pings twice: the second answer comes after that burst's answers.
        """
        for client, board in 2 * list(self._boards.items()):
            self._ping(board)
            if not self._wait_for(lambda board=board: board.pinged, self._patience):  # type: ignore[misc]
                raise ToolError(f"the agent no longer answers client {client}: has it ended?")
            self._wait_for(lambda: False, _BURST)

    def _send(self, board: _Board, step: Step) -> None:
        message = bytearray(step.message)
        board.sent += 1
        if create_client_payload(step.message) is not None:
            board.open(step.message)
        self._put_callers(message)
        if step.stream < ids.STREAM_RELIABLE:
            board.connection.send(bytes(message))
            return
        out = board.out.setdefault(step.stream, ReliableOut())
        if not self._wait_for(lambda: out.available() > 0, self._patience):
            raise ToolError(
                f"the agent does not acknowledge what client {step.client} sends:"
                f" {self._why_lacks_samples(step.client)}"
            )
        message[2:4] = out.next.to_bytes(2, "little")
        out.put(bytes(message))
        for ready in out.take(_now()):
            board.connection.send(ready)

    def _why_lacks_samples(self, client: int) -> str:
        for (whose, _), answers in self.got.items():
            for answer in answers if whose == client else ():
                if answer.kind == ids.STATUS_AGENT and answer.payload[:1] != b"\0":
                    return (
                        f"it refused the session ({answer}); where the board itself is connected to"
                        " it, its key is in use: replay to an agent that was just started"
                    )
        return "it stalls, or has lost the session"

    def _put_callers(self, message: bytearray) -> None:
        """Address a service's reply to the request that was received now."""
        try:
            at = pull_header(message, len(message))[4]
            parts = submessages(bytes(message), at)
        except DecodeError:
            return
        for kind, _, payload in parts:
            at += 4
            if kind == ids.WRITE_DATA and payload[3:4] and payload[3] & 0x0F == ids.KIND_REPLIER:
                start = at + REQUEST_SIZE
                stop = start + SAMPLE_IDENTITY_SIZE
                ours = self._callers.get(bytes(message[start:stop]))
                if ours is not None:
                    message[start:stop] = ours
            at += len(payload) + (-len(payload) & 3)

    # --- waiting and receiving ----------------------------------------------------------------

    def _await_answers(self) -> None:
        """Wait for the answers recorded up to here. One that is late is not waited for again."""

        def missing() -> list[tuple[int, List]]:
            return [
                key
                for key, count in self._due.items()
                if len(self.got[key]) < count and key not in self._given_up
            ]

        if not self._wait_for(lambda: not missing(), self._patience):
            self._given_up.update(missing())

    def _wait_for(self, done: Callable[[], bool], seconds: float) -> bool:
        deadline = time.monotonic() + seconds
        while not done():
            left = deadline - time.monotonic()
            if left <= 0:
                return False
            self._pump(left)
        return True

    def _pump(self, seconds: float) -> None:
        """Receive for at most ``seconds``, and send the heartbeats that are due."""
        boards = self._boards.values()
        now = _now()
        deadlines = [
            ticks_diff(out.deadline, now) / 1000
            for board in boards
            for out in board.out.values()
            if out.deadline is not None
        ]
        has_messages = any(board.connection.has_messages() for board in boards)
        wait = 0.0 if has_messages else max(0.0, min([seconds, *deadlines]))
        ready = select.select([board.connection for board in boards], [], [], wait)[0]
        for board in boards:
            if board.connection in ready or board.connection.has_messages():
                for message in board.connection.read():
                    self._receive(board, message)
        now = _now()
        for board in boards:
            for stream, out in board.out.items():
                due = out.heartbeat(now)
                if due is not None:
                    w = MessageWriter(bytearray(32), board.session, 0, 0, board.key)
                    w.begin(ids.HEARTBEAT)
                    messages.push_heartbeat(w, due[0], due[1], stream)
                    board.connection.send(w.finish())

    def _receive(self, board: _Board, message: bytes) -> None:
        try:
            _, stream, _, _, at = pull_header(message, len(message))
            if stream < ids.STREAM_RELIABLE:
                for kind, flags, payload in submessages(message, at):
                    r = Reader(payload, 0, len(payload), bool(flags & ids.FLAG_LITTLE_ENDIAN))
                    if kind == ids.ACKNACK:
                        self._acknacked(board, r)
                    elif kind == ids.HEARTBEAT:
                        self._heartbeat(board, r)
                    elif kind == ids.INFO and messages.pull_request(r)[0] == _PING_REQUEST:
                        board.pinged = True
                        return
            answers = board.answers.read(message)
        except DecodeError:
            return
        if stream >= ids.STREAM_RELIABLE:
            self._acknowledge(board, stream)
        for answer in answers:
            self._take(answer)

    def _take(self, answer: Answer) -> None:
        key = answer.client, answer.list
        got, expected = self.got[key], self.expected.get(key, [])
        if len(got) < len(expected) and answer.identity:
            self._callers.setdefault(expected[len(got)].identity, answer.identity)
        got.append(answer)

    def _acknacked(self, board: _Board, r: Reader) -> None:
        first, missing, stream = messages.pull_acknack(r)
        if stream in board.out:
            for lost in board.out[stream].acknack(first, missing, _now()):
                board.connection.send(lost)

    def _heartbeat(self, board: _Board, r: Reader) -> None:
        first, last, stream = messages.pull_heartbeat(r)
        if stream < ids.STREAM_RELIABLE:
            return
        board.answers.reliable.setdefault(stream, ReliableIn()).heartbeat(first, last, _now())
        self._acknowledge(board, stream)

    def _acknowledge(self, board: _Board, stream: int) -> None:
        first, missing = board.answers.reliable[stream].acknack()
        board.connection.send(
            messages.acknack_message(board.session, board.key, first, missing, stream)
        )

    # --- the report ---------------------------------------------------------------------------

    def report(self, write: Callable[[str], object]) -> bool:
        """Print the table and the first differences.

        Args:
            write: Takes the text.

        Returns:
            Whether all answers are as recorded.
        """
        from ...agent.objects.kinds import key_label
        from ...agent.observability.format import escape

        head = ("client", "sent", "answers", "as recorded", "differ", "missing", "more")
        rows: list[tuple[str, ...]] = [head]
        parts: list[str] = []
        same = True
        for client, board in sorted(self._boards.items()):
            name = f"{client} {key_label(board.key)} {escape(self._names[client])}"
            equal = differ = missing = more = 0
            keys = {key for key in (*self.expected, *self.got) if key[0] == client}
            for key in sorted(keys):
                expected, got = self.expected.get(key, []), self.got.get(key, [])
                pairs = [a.same == b.same for a, b in zip(expected, got, strict=False)]
                equal += sum(pairs)
                differ += len(pairs) - sum(pairs)
                missing += max(0, len(expected) - len(got))
                more += max(0, len(got) - len(expected))
                parts.extend(_difference(key, expected, got, pairs))
            same = same and not (differ or missing or more)
            answers = equal + differ + missing
            rows.append((name, *map(str, (board.sent, answers, equal, differ, missing, more))))
        widths = [max(len(row[i]) for row in rows) for i in range(len(head))]
        for row in rows:
            cells = [row[0].ljust(widths[0])]
            cells += [cell.rjust(w) for cell, w in zip(row[1:], widths[1:], strict=True)]
            write("  ".join(cells) + "\n")
        for text in parts[:_MAX_DIFFERENCES]:
            write(text)
        if len(parts) > _MAX_DIFFERENCES:
            write(f"and {len(parts) - _MAX_DIFFERENCES} lists more that differ\n")
        write("the answers are as recorded\n" if same else "the answers differ\n")
        if self._lacks_samples():
            write(
                "(samples that other nodes published do not come again; --no-data leaves samples"
                " out)\n"
            )
        return same

    def _lacks_samples(self) -> bool:
        """Whether a datareader that has samples in the capture got none now."""
        return any(key[1][0] == "data" and not self.got.get(key) for key in self.expected)


def _difference(
    key: tuple[int, List], expected: list[Answer], got: list[Answer], pairs: list[bool]
) -> list[str]:
    """Return the first difference of two lists of answers as text, or nothing."""
    from ...agent.observability.format import object_name, stream_name

    at = pairs.index(False) if False in pairs else len(pairs)
    if at == len(expected) == len(got):
        return []
    client, (what, which) = key
    where = f"samples of {object_name(which)}" if what == "data" else f"stream {stream_name(which)}"
    lines = [f"client {client}, {where}, answer {at + 1}:"]
    for sign, side in (("recorded", expected), ("now", got)):
        said = str(side[at]) if at < len(side) else "(nothing)"
        lines.append(f"  {sign:<9} {said}")
    return ["\n".join(lines) + "\n"]


def _now() -> int:
    return int(time.monotonic() * 1000) & TIME_MASK
