"""Boards for benchmarks: minimal clients.

Written on ``uros.wire`` alone. One :class:`Board` is one UDP socket and one
session with one datawriter, and on request a datareader of the same topic.
"""

from __future__ import annotations

import ctypes
import select
import socket
import struct
import time
from collections.abc import Callable, Sequence

from relay import TOPIC, TYPE

from uros.wire import data, entities, ids, session
from uros.wire.cdr import Reader, Writer
from uros.wire.header import MessageWriter

PARTICIPANT, TOPIC_ID, PUBLISHER, SUBSCRIBER = 0x0011, 0x0012, 0x0013, 0x0014
WRITER, READER, READ_TOPIC_ID = 0x0015, 0x0016, 0x0022

# The two drives: how many seconds a sender may be ahead of its rate before it waits. BURST sends
# bursts, of ten samples at 20,000 a second; EVEN sends one by one, as many boards together do.
DRIVES = {"even": 0.0, "burst": 0.0005}
EVEN, BURST = DRIVES.values()
_PR_SET_TIMERSLACK = 29


def wait_exactly() -> None:
    """Let this thread's sleeps end on time, not up to 50 µs later as Linux does by default."""
    ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)


def text(size: int) -> bytes:
    """A std_msgs/String of ``size`` bytes as CDR without encapsulation."""
    return struct.pack("<I", size - 4) + b"x" * (size - 5) + b"\0"


def binary(push: Callable[..., object], *arguments: object, **options: object) -> bytes:
    """The binary representation of an object."""
    w = Writer(bytearray(512))
    push(w, *arguments, **options)
    return bytes(w.buf[: w.offset])


class Board:
    """See the module."""

    def __init__(
        self,
        port: int,
        key: int,
        topic: str = TOPIC,
        reads: str = "",
        reliable: bool = False,
    ) -> None:
        """``reads``: the topic of its datareader; ``reliable``: the datawriter is so, KEEP_ALL."""
        self.key = key
        self._qos = ids.QOS_RELIABLE if reliable else ids.QOS_KEEP_LAST
        self.sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.sock.connect(("127.0.0.1", port))
        self.sequence = 0  # reliable stream
        self.acked = 0
        started = time.perf_counter()
        self._create_session()
        self._create_entities(topic, reads)
        self.set_up = time.perf_counter() - started

    def _receive(self, timeout: float = 5.0) -> bytes:
        poll = select.poll()  # select() knows 1,024 descriptors
        poll.register(self.sock, select.POLLIN)
        if not poll.poll(timeout * 1000):
            raise TimeoutError("the agent does not answer")
        return self.sock.recv(65536)

    def _create_session(self) -> None:
        w = MessageWriter(bytearray(64), ids.SESSION_NONE_WITHOUT_KEY, 0, 0)
        w.begin(ids.CREATE_CLIENT)
        session.push_create_client(w, self.key, 0x81, 1400)
        self.sock.send(w.finish())
        answer = self._receive()
        if answer[4] != ids.STATUS_AGENT or answer[8] != ids.STATUS_OK:
            raise RuntimeError(f"no session: {answer.hex()}")

    def _create_entities(self, topic: str, reads: str) -> None:
        endpoint = entities.push_binary_endpoint
        wanted = [
            (PARTICIPANT, binary(entities.push_binary_participant, f"board_{self.key}", None), 0),
            (TOPIC_ID, binary(entities.push_binary_topic, topic, TYPE), PARTICIPANT),
            (PUBLISHER, binary(entities.push_binary_group, None, None), PARTICIPANT),
            (WRITER, binary(endpoint, TOPIC_ID, self._qos, 64), PUBLISHER),
        ]
        if reads:
            read_id = TOPIC_ID
            if reads != topic:
                read_id = READ_TOPIC_ID
                wanted.append(
                    (read_id, binary(entities.push_binary_topic, reads, TYPE), PARTICIPANT)
                )
            wanted += [
                (SUBSCRIBER, binary(entities.push_binary_group, None, None), PARTICIPANT),
                (READER, binary(endpoint, read_id, ids.QOS_KEEP_LAST, 64, reader=True), SUBSCRIBER),
            ]
        self._create(wanted, READER if reads else 0)

    def _create(self, wanted: Sequence[tuple[int, bytes, int]], reader: int) -> None:
        """Create objects, (id, representation, parent) each; ``reader`` reads from then on."""
        for number, (object_id, content, parent) in enumerate(wanted):
            w = self._message(1024)
            w.begin(ids.CREATE, ids.FLAG_LITTLE_ENDIAN | ids.FLAG_REPLACE)
            entities.push_create(w, number + 10, object_id, ids.IN_BINARY, content, parent)
            self.sock.send(w.finish())
        if reader:
            w = self._message(64)
            w.begin(ids.READ_DATA)
            control = (ids.MAX_SAMPLES_UNLIMITED, 0, 0, 0)
            data.push_read_data(w, 40, reader, ids.STREAM_BEST_EFFORT, control=control)
            self.sock.send(w.finish())
        answers = 0
        while answers < len(wanted):
            message = self._receive(30.0)
            if message[4] == ids.STATUS:
                _, object_id, status, _ = session.pull_status(Reader(message, 8, len(message)))
                if status != ids.STATUS_OK:
                    raise RuntimeError(f"object {object_id:04X}: {ids.status_name(status)}")
                answers += 1
        self._acknack(answers)

    def _message(self, size: int) -> MessageWriter:
        w = MessageWriter(bytearray(size), 0x81, ids.STREAM_RELIABLE, self.sequence)
        self.sequence = (self.sequence + 1) & 0xFFFF
        return w

    def _acknack(self, first: int) -> None:
        w = MessageWriter(bytearray(32), 0x81, 0, 0)
        w.begin(ids.ACKNACK)
        session.push_acknack(w, first, 0, ids.STREAM_RELIABLE)
        self.sock.send(w.finish())

    def sample(self, payload: bytes, reliable: bool = False, writer: int = WRITER) -> bytearray:
        """A datagram with one WRITE_DATA; bytes 2 and 3 are for its sequence number."""
        stream = ids.STREAM_RELIABLE if reliable else ids.STREAM_BEST_EFFORT
        head = bytearray((0x81, stream, 0, 0, ids.WRITE_DATA, 1))
        head += struct.pack("<H", len(payload) + 4) + struct.pack(">HH", 50, writer)
        return head + payload

    def send_reliable(self, count: int, rate: float, payload: bytes) -> float:
        """Send samples on the reliable stream until the last one is acknowledged; the seconds.

        The window is 16 messages; within it, samples are sent evenly.
        """
        wait_exactly()
        datagram = self.sample(payload, True)
        send, recv = self.sock.send, self.sock.recv
        self.sock.setblocking(False)
        self.acked = self.sequence
        started = time.perf_counter()
        sent, heartbeat = 0, started
        while sent < count or self.acked != self.sequence:
            now = time.perf_counter()
            allowed = count if not rate else min(count, int((now - started) * rate) + 1)
            while sent < allowed and (self.sequence - self.acked) & 0xFFFF < 16:
                datagram[2], datagram[3] = self.sequence & 0xFF, self.sequence >> 8
                send(datagram)
                self.sequence = (self.sequence + 1) & 0xFFFF
                sent += 1
            try:
                message = recv(2048)
                if message[4] == ids.ACKNACK:
                    self.acked = message[8] | message[9] << 8
                    heartbeat = now
            except BlockingIOError:
                if now - heartbeat > 0.1 and self.acked != self.sequence:
                    self._heartbeat()
                    heartbeat = now
                elif (self.sequence - self.acked) & 0xFFFF >= 16 or sent >= count:
                    select.select([self.sock], [], [], 0.1)
                elif sent >= allowed:
                    select.select([self.sock], [], [], max(0.0, started + sent / rate - now))
        self.sock.setblocking(True)
        return time.perf_counter() - started

    def _heartbeat(self) -> None:
        w = MessageWriter(bytearray(32), 0x81, 0, 0)
        w.begin(ids.HEARTBEAT)
        session.push_heartbeat(w, self.acked, (self.sequence - 1) & 0xFFFF, ids.STREAM_RELIABLE)
        self.sock.send(w.finish())


def _count_up(datagram: bytearray, at: int) -> None:
    """Increment the 16-bit number at offset ``at``."""
    number = (datagram[at] | datagram[at + 1] << 8) + 1
    datagram[at] = number & 0xFF
    datagram[at + 1] = number >> 8 & 0xFF


def paced_send(
    sock: socket.socket, datagram: bytearray, at: int, count: int, rate: float, drive: float = EVEN
) -> float:
    """Send ``count`` copies with rising numbers; the seconds it took.

    ``rate`` is in messages a second, 0: as fast as possible; ``drive`` is EVEN or BURST.
    """
    wait_exactly()
    send, clock = sock.send, time.perf_counter
    started = clock()
    for number in range(count):
        send(datagram)
        _count_up(datagram, at)
        if rate:
            ahead = started + (number + 1) / rate - clock()
            if ahead > drive:
                time.sleep(ahead)
    return clock() - started


def until_answered(sock: socket.socket, datagram: bytearray, at: int) -> None:
    """Send until something as long as a sample comes back, and wait until no more comes."""

    def is_answered() -> bool:
        try:
            return len(sock.recv(65536)) >= 64
        except TimeoutError:
            return False

    sock.settimeout(0.2)
    end = time.monotonic() + 30
    answered = False
    while not answered:
        if time.monotonic() > end:
            raise TimeoutError("nothing comes back")
        sock.send(datagram)
        _count_up(datagram, at)
        answered = is_answered()
    while is_answered():
        pass


def round_trips(sock: socket.socket, datagram: bytearray, at: int, count: int) -> list[float]:
    """The round trips of single messages in microseconds, sorted."""
    out = []
    sock.settimeout(2.0)
    for _ in range(count):
        started = time.perf_counter()
        sock.send(datagram)
        _count_up(datagram, at)
        while True:
            answer = sock.recv(65536)
            if len(answer) >= 64:
                break
        out.append((time.perf_counter() - started) * 1e6)
    return sorted(out)


class Pacer:
    """Lets many boards send in turn."""

    def __init__(self, boards: list[Board], payload: bytes) -> None:
        self._boards = boards
        self._datagrams = [board.sample(payload) for board in boards]
        self._sent = 0

    def _send(self) -> None:
        index = self._sent % len(self._boards)
        datagram = self._datagrams[index]
        self._boards[index].sock.send(datagram)
        _count_up(datagram, 2)
        self._sent += 1

    def round(self) -> None:
        """Send one sample of every board, slowly enough for any reader."""
        for _ in self._boards:
            self._send()
            if not self._sent % 50:
                time.sleep(0.005)

    def run(self, rate: float, seconds: float, drive: float = EVEN) -> int:
        """Send ``rate`` samples a second of every board; the number of samples."""
        wait_exactly()
        before, started = self._sent, time.perf_counter()
        total = int(rate * seconds) * len(self._boards)
        for number in range(1, total + 1):
            self._send()
            ahead = started + number / (rate * len(self._boards)) - time.perf_counter()
            if ahead > drive:
                time.sleep(ahead)
        return self._sent - before

    def run_with_echo(self, rate: float, seconds: float) -> tuple[int, list[float]]:
        """Run boards that receive their own samples; (samples sent, sorted latencies).

        The latencies, in seconds, are those of the samples that arrived.
        """
        poll = select.poll()
        by_fd = {board.sock.fileno(): board.sock for board in self._boards}
        for fd in by_fd:
            poll.register(fd, select.POLLIN)
        started, sent_at, took = time.perf_counter(), {}, []
        before, total = self._sent, int(rate * seconds) * len(self._boards)
        end = started + seconds + 1.0
        while time.perf_counter() < end and len(took) < total:
            now = time.perf_counter()
            number = self._sent - before
            if number < total and now >= started + number / (rate * len(self._boards)):
                self._datagrams[self._sent % len(self._boards)][16:24] = b"%08d" % number
                sent_at[number] = now
                self._send()
                continue
            for fd, _ in poll.poll(1):
                answer = by_fd[fd].recv(65536)
                if answer[4] == ids.DATA:
                    took.append(time.perf_counter() - sent_at.pop(int(answer[16:24])))
        return total, sorted(took)
