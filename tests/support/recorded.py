"""A board that repeats what a real one sent to its agent in a recording.

A recording is a text file, one JSON line for each datagram (UDP) or each chunk read (serial,
TCP)::

    {"t": seconds since the first, "from": "client" or "agent", "client": 0, "hex": "8000…"}

:class:`RecordedBoard` replays the client's side of a recording to a running agent: bytes as
recorded, each message after the answers that preceded it in the recording, and no earlier than its
recorded time. Only its ACKNACKs and HEARTBEATs are new, since they depend on the loss of the
present link. It uses neither sockets nor the clock; :class:`UdpBoard` provides both, in a thread.
"""

from __future__ import annotations

import json
import select
import socket
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from uros.middleware.wakeup_fd import WakeupFd
from uros.ticks import TIME_MASK, ticks_add, ticks_diff
from uros.wire import ids
from uros.wire.cdr import Reader
from uros.wire.errors import DecodeError
from uros.wire.header import MessageWriter, pull_header, pull_subheader
from uros.wire.session import pull_acknack, pull_heartbeat, push_acknack, push_heartbeat
from uros.wire.streams import ReliableIn, ReliableOut

# A request outside of streams is repeated after this time without an answer.
RETRY_MS: Final = 500
# An agent that sends nothing for this time, while an answer is due, has lost the session: restart.
SILENT_MS: Final = 3000
# The limit for closing the session.
CLOSE_MS: Final = 2000
_LARGEST: Final = 65536
_SENT: Final = (ids.WRITE_DATA, ids.FRAGMENT)
_ANSWERS: Final = (ids.STATUS_AGENT, ids.STATUS, ids.INFO, ids.TIMESTAMP_REPLY, ids.DATA)


class RecordingError(ValueError):
    """A file that is not a recording, or lacks the requested client; the text has the reason."""


@dataclass(frozen=True)
class Record:
    """One line of a recording."""

    time: float
    from_client: bool
    client: int
    data: bytes


def load(path: str | Path) -> list[Record]:
    """The records of a file in order. Raises RecordingError, which names file and line."""
    records = []
    try:
        with open(path, encoding="utf-8") as file:
            for number, line in enumerate(file, 1):
                try:
                    fields = json.loads(line)
                    records.append(
                        Record(
                            float(fields["t"]),
                            {"client": True, "agent": False}[fields["from"]],
                            int(fields["client"]),
                            bytes.fromhex(fields["hex"]),
                        )
                    )
                except (ValueError, KeyError, TypeError) as error:
                    raise RecordingError(f"{path}:{number}: not a record ({error!r})") from error
    except (OSError, UnicodeDecodeError) as error:
        raise RecordingError(f"{path}: {error}") from error
    return records


def submessages(message: bytes) -> list[tuple[int, int, bytes]]:
    """``(kind, flags, payload)`` of each submessage. Raises DecodeError."""
    end = len(message)
    at = pull_header(message, end)[4]
    out = []
    while at + 4 <= end:
        kind, flags, start, stop = pull_subheader(message, at, end)
        out.append((kind, flags, message[start:stop]))
        at = stop + (-stop & 3)
    return out


def is_acknowledgement(message: bytes) -> bool:
    """Whether a message has only ACKNACKs and HEARTBEATs, whose number is up to each end."""
    return all(kind in (ids.ACKNACK, ids.HEARTBEAT) for kind, _, _ in submessages(message))


@dataclass(frozen=True)
class _Step:
    """One message of the board.

    ``waits`` has what must have arrived before it: for stream 0 the number of answers outside of
    streams, for each reliable stream the number of its messages.
    """

    at: int  # milliseconds from the first
    message: bytes
    stream: int
    waits: tuple[tuple[int, int], ...]
    publishes: bool
    open: bool  # a fragment that is not its sample's last


def _steps(records: list[Record], client: int) -> list[_Step]:
    steps = []
    arrived: dict[int, int] = {}
    for record in records:
        if record.client != client:
            continue
        stream = pull_header(record.data, len(record.data))[1]
        if is_acknowledgement(record.data):
            continue
        if not record.from_client:
            arrived[stream] = arrived.get(stream, 0) + 1
            continue
        parts = submessages(record.data)
        kind, flags, _ = parts[-1]
        steps.append(
            _Step(
                round(record.time * 1000),
                record.data,
                stream,
                tuple(
                    (number, n)
                    for number, n in arrived.items()
                    if not 0 < number < ids.STREAM_RELIABLE
                ),
                all(part[0] in _SENT for part in parts),
                kind == ids.FRAGMENT and not flags & ids.FLAG_LAST_FRAGMENT,
            )
        )
    return steps


class RecordedBoard:
    """One client of a recording; see the module.

    With ``endless`` it repeats its recorded samples with the same intervals until :meth:`finish`;
    then it closes the session as recorded. The caller passes datagrams to :meth:`receive`, sends
    those of :meth:`outgoing`, and calls it again at :meth:`next_deadline`; ``now`` is integer
    milliseconds modulo 2^30. :attr:`done` is set at the end, :attr:`published` counts samples.
    """

    def __init__(self, records: list[Record], client: int = 0, endless: bool = False) -> None:
        try:
            self._steps = _steps(records, client)
        except DecodeError as error:
            raise RecordingError(f"not a recording of datagrams: {error}") from error
        if not self._steps:
            raise RecordingError(f"there is no client {client} in the recording")
        sent = [i for i, step in enumerate(self._steps) if step.publishes]
        if endless and not sent:
            raise RecordingError(f"client {client} publishes nothing in the recording")
        self._endless = endless
        self._first, self._last = (sent[0], sent[-1]) if sent else (0, -1)
        gaps = [self._gap(i) for i in sent[1:]]
        self._pause = max(gaps, default=1000)  # from the last sample to the first again
        self.done = False
        self.published = 0
        self._finishing: int | None = None
        self._restart(None)

    def _restart(self, now: int | None) -> None:
        """Start again, as after a reset of the board."""
        self._next = 0
        self._due = now  # the earliest time of the next step
        self._heard = now
        self._out: dict[int, ReliableOut] = {}
        self._in: dict[int, ReliableIn] = {}
        self._numbers: dict[int, int] = {}  # of best-effort streams
        self._answers = 0
        self._unanswered: tuple[bytes, int] | None = None  # message, time of sending
        self._acks: set[int] = set()
        self._queue: list[bytes] = []

    def _gap(self, index: int) -> int:
        return self._steps[index].at - self._steps[index - 1].at

    def finish(self, now: int) -> None:
        """Publish no more, and close the session."""
        if self._finishing is None:
            self._finishing = ticks_add(now, CLOSE_MS)
            self._due = now
            if not self._answers:
                self.done = True  # no session to close

    # --- receiving ---------------------------------------------------------------

    def receive(self, datagram: bytes, now: int) -> None:
        """Process a message of the agent; drop one that cannot be decoded."""
        try:
            parts = submessages(datagram)
            _, stream, number, _, start = pull_header(datagram, len(datagram))
            self._heard = now
            if stream >= ids.STREAM_RELIABLE:
                self._acks.add(stream)
                incoming = self._in.setdefault(stream, ReliableIn())
                if incoming.receive(number, datagram[start:]):
                    while incoming.pop() is not None:
                        pass
                return
            for kind, flags, payload in parts:
                self._take(kind, Reader(payload, 0, len(payload), bool(flags & 1)), now)
                if not stream and kind in _ANSWERS:
                    self._answers += 1
                    self._unanswered = None
        except DecodeError:
            pass

    def _take(self, kind: int, r: Reader, now: int) -> None:
        if kind == ids.ACKNACK:
            first, missing, stream = pull_acknack(r)
            if stream in self._out:
                self._queue.extend(self._out[stream].acknack(first, missing, now))
        elif kind == ids.HEARTBEAT:
            first, last, stream = pull_heartbeat(r)
            incoming = self._in.setdefault(stream, ReliableIn())
            incoming.heartbeat(first, last, now)
            self._acks.add(stream)

    # --- sending -----------------------------------------------------------------

    def outgoing(self, now: int) -> list[bytes]:
        """The messages to send now."""
        if self._due is None or self._heard is None:
            self._due = self._heard = now
        if self._finishing is not None and ticks_diff(now, self._finishing) >= 0:
            self.done = True
        while not self.done and self._ready(now):
            self._play(now)
        waits = self._waits_for_agent()
        if waits and ticks_diff(now, self._heard) >= SILENT_MS and self._finishing is None:
            if self._next >= len(self._steps):
                self.done = True  # all is sent; no acknowledgement comes
            else:
                self._restart(now)
                return self.outgoing(now)
        if self._unanswered is not None:
            message, at = self._unanswered
            if waits and ticks_diff(now, at) >= RETRY_MS:
                self._queue.append(message)
                self._unanswered = message, now
        for stream, out in self._out.items():
            due = out.heartbeat(now)
            if due is not None:
                w = self._message(ids.HEARTBEAT)
                push_heartbeat(w, due[0], due[1], stream)
                self._queue.append(w.finish())
        for stream in sorted(self._acks):
            w = self._message(ids.ACKNACK)
            push_acknack(w, *self._in[stream].acknack(), stream)
            self._queue.append(w.finish())
        self._acks.clear()
        queue, self._queue = self._queue, []
        return queue

    def next_deadline(self, now: int) -> int | None:
        """When :meth:`outgoing` has the next message by time; None: only after :meth:`receive`."""
        if self.done or self._due is None or self._heard is None:
            return None
        times = [out.deadline for out in self._out.values() if out.deadline is not None]
        if self._waits_for_agent():
            if self._unanswered is not None:
                times.append(ticks_add(self._unanswered[1], RETRY_MS))
            times.append(ticks_add(self._heard, SILENT_MS))
        else:
            times.append(self._due)
        if self._finishing is not None:
            times.append(self._finishing)
        return min(times, key=lambda at: ticks_diff(at, now))

    def _message(self, kind: int) -> MessageWriter:
        """A message outside of streams, in the recording's session."""
        message = next((s.message for s in self._steps if s.stream), self._steps[-1].message)
        session, _, _, key, _ = pull_header(message, len(message))
        w = MessageWriter(bytearray(32), session, ids.STREAM_NONE, 0, key or 0)
        w.begin(kind)
        return w

    def _waits_for_agent(self) -> bool:
        """Whether the next step must wait for the agent."""
        if self._next >= len(self._steps):
            return self._unanswered is not None or any(len(out) for out in self._out.values())
        step = self._steps[self._next]
        for stream, count in step.waits:
            incoming = self._in.get(stream)
            arrived = (incoming.next if incoming else 0) if stream else self._answers
            if arrived < count:
                return True
        out = self._out.get(step.stream)
        return out is not None and out.available() == 0

    def _ready(self, now: int) -> bool:
        assert self._due is not None
        if self._waits_for_agent():
            return False
        if self._next >= len(self._steps):
            self.done = True
            return False
        return ticks_diff(now, self._due) >= 0

    def _play(self, now: int) -> None:
        """Send the next step and choose the one after it."""
        step = self._steps[self._next]
        self._heard = now  # an answer is due from now on
        message = bytearray(step.message)
        if step.stream >= ids.STREAM_RELIABLE:
            out = self._out.setdefault(step.stream, ReliableOut())
            message[2:4] = out.next.to_bytes(2, "little")
            out.put(bytes(message))
            self._queue.extend(out.take(now))
        else:
            if step.stream:
                number = self._numbers.get(step.stream, 0)
                message[2:4] = number.to_bytes(2, "little")
                self._numbers[step.stream] = (number + 1) & 0xFFFF
            else:
                self._unanswered = step.message, now
            self._queue.append(bytes(message))
        if step.publishes and not step.open:
            self.published += 1
        gap = 0
        publishing = self._first <= self._next <= self._last
        if publishing and not step.open and self._finishing is not None:
            self._next = self._last + 1
        elif self._next == self._last and self._endless:
            self._next = self._first
            gap = self._pause
        else:
            self._next += 1
            if self._finishing is None and self._next < len(self._steps):
                gap = self._gap(self._next)
        assert self._due is not None
        # A late answer delays the following messages; their intervals stay the same.
        late = ticks_diff(now, self._due) > gap
        self._due = ticks_add(now if late else self._due, gap)


class UdpBoard:
    """Runs a board in a thread, with an agent's UDP port; a context manager."""

    def __init__(self, board: RecordedBoard, address: tuple[str, int]) -> None:
        self.board = board
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect(address)
        self._socket.setblocking(False)
        self._wake = WakeupFd()
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name="recorded-board", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def join(self, timeout: float | None = None) -> bool:
        """Wait for the end of a board that is not endless; whether it has ended."""
        self._thread.join(timeout)
        return not self._thread.is_alive()

    def stop(self) -> None:
        """Close the session and end the thread. Idempotent."""
        self._stopping = True
        self._wake.set()
        if self._thread.ident is not None:
            self._thread.join()
        self._wake.close()
        self._socket.close()

    def __enter__(self) -> UdpBoard:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _run(self) -> None:
        board, fileno, wake = self.board, self._socket.fileno(), self._wake.fileno()
        while True:
            now = int(time.monotonic() * 1000) & TIME_MASK
            if self._stopping:
                board.finish(now)
            for message in board.outgoing(now):
                try:
                    self._socket.send(message)
                except OSError:
                    pass  # no agent listens yet
            if board.done:
                return
            deadline = board.next_deadline(now)
            wait = None if deadline is None else max(0, ticks_diff(deadline, now)) / 1000
            ready = select.select([fileno, wake], [], [], wait)[0]
            if wake in ready:
                self._wake.clear()
            if fileno in ready:
                self._drain()

    def _drain(self) -> None:
        while True:
            try:
                datagram = self._socket.recv(_LARGEST)
            except BlockingIOError:
                return
            except OSError:
                continue  # the port is closed: no agent listens
            self.board.receive(datagram, int(time.monotonic() * 1000) & TIME_MASK)
