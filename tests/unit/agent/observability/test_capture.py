"""Captures: file content, two files of limited size, full and slow disks, a killed agent."""

import errno
import io
import json
import os
import re
import resource
import select
import signal
import subprocess
import sys
import time

import pytest
from support.agent import running_agent
from support.client import XrceClient
from support.lines import SECONDS, UdpLine
from support.recorded import load as load_recorded
from support.tshark import packets
from support.waiting import eventually
from unit.agent.helpers import get_info, message

from uros.agent.clock import Clock
from uros.agent.log import Log
from uros.agent.observability import capture as captures
from uros.agent.observability.capture import Capture, CaptureError, is_capture
from uros.agent.observability.message_hooks import AGENT, CLIENT, MessageHooks
from uros.agent.observability.pcapng import MAX_PAYLOAD
from uros.agent.transports.base import ServerTransport
from uros.agent.transports.memory import MemoryServer
from uros.agent.transports.udp import UdpServer
from uros.tools.capture.recordings import read

PING = message([get_info()], 0, 0)
HUGE = 10**9


class Named(ServerTransport):
    """A transport whose peers are their own addresses."""

    name = "TestAgent"
    kind = "TEST"

    def open(self, host): ...

    def send(self, peer, datagram): ...

    def address(self, peer):
        return peer

    def close(self): ...


class Desk:
    """A capture without an agent."""

    def __init__(self, path, limit=HUGE):
        self.said = io.StringIO()
        self.message_hooks = MessageHooks(Log(4, self.said), Clock())
        self.path = str(path)
        self.capture = Capture(self.path, limit, Log(4, self.said), self.message_hooks)

    def say(self, data=PING, peer="1.2.3.4:5", transport=None, direction=CLIENT, key=0):
        self.message_hooks(transport or Named(), peer, direction, data, len(data), key)

    def close(self):
        self.capture.close()
        return self.said.getvalue()


# --- what is written ----------------------------------------------------------------------------


def test_text_captures_have_the_lines_of_recordings_and_more_fields(tmp_path):
    path = tmp_path / "one.jsonl"
    desk = Desk(path)
    board, memory_server = Named(), MemoryServer()
    desk.say(transport=board, peer="/dev/ttyACM0 (1)", key=0x4B0CBE99)
    desk.say(b"answer", transport=board, peer="/dev/ttyACM0 (1)", direction=AGENT)
    desk.say(transport=memory_server, peer=7)
    assert "capture closed" in desk.close()
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    assert [list(fields) for fields in lines] == [
        ["t", "from", "client", "transport", "address", "key", "hex"],
        ["t", "from", "client", "transport", "address", "hex"],
        ["t", "from", "client", "transport", "address", "hex"],
    ]
    assert lines[0]["key"] == "0x4B0CBE99" and lines[0]["hex"] == PING.hex()
    assert [fields["from"] for fields in lines] == ["client", "agent", "client"]
    assert [fields["client"] for fields in lines] == [0, 0, 1]
    assert [fields["address"] for fields in lines] == ["/dev/ttyACM0 (1)"] * 2 + ["memory:7"]
    assert abs(lines[0]["t"] - time.time()) < 60
    # The player of recorded conversations reads the file unchanged.
    assert [fields.data for fields in load_recorded(path)] == [PING, b"answer", PING]


@pytest.mark.parametrize("name", ["it.jsonl", "it.pcapng"])
def test_a_capture_is_readable_by_its_owner_alone(name, tmp_path):
    """With any umask, and for both files."""
    before = os.umask(0)
    try:
        desk = Desk(tmp_path / name, limit=1)
        for _ in range(3):
            desk.say()
        desk.close()
        Desk(tmp_path / name).close()
    finally:
        os.umask(before)
    modes = {path.name: path.stat().st_mode & 0o777 for path in tmp_path.iterdir()}
    assert modes == {name: 0o600, f"{name}.1": 0o600}


@pytest.mark.parametrize("name", ["it.jsonl", "it.pcapng"])
def test_control_characters_in_the_name_of_a_peer_are_escaped(name, tmp_path):
    """The name in a client's certificate is shown in this way too."""
    desk = Desk(tmp_path / name)
    desk.say(peer="192.0.2.7:1 (CN=\x1b[2J\r\n\u202eleft\udc80)")
    desk.close()
    content = (tmp_path / name).read_bytes()
    assert b"\\x1b" in content or b"\\u001b" in content
    assert b"\x1b[2J" not in content and "\u202e".encode() not in content
    assert len(list(read(tmp_path / name))) == 1


def test_pcapng_by_an_independent_reader(tmp_path):
    path = tmp_path / "one.pcapng"
    desk = Desk(path)
    udp, serial = UdpServer(8888, "192.0.2.1"), Named()
    six = UdpServer(9999, "::")
    desk.say(transport=udp, peer=("192.0.2.7", 2018), key=0x4B0CBE99)
    desk.say(b"odd", transport=udp, peer=("192.0.2.7", 2018), direction=AGENT)
    desk.say(transport=serial, peer="/dev/ttyACM0 (1)")
    desk.say(transport=serial, peer="/dev/ttyACM0 (2)", direction=AGENT)
    desk.say(transport=six, peer=("::1", 5, 0, 0))
    desk.close()
    decoded = packets(path)
    assert all(packet.checksums_good for packet in decoded)
    assert [(packet.source, packet.destination, packet.payload) for packet in decoded] == [
        (("192.0.2.7", 2018), ("192.0.2.1", 8888), PING),
        (("192.0.2.1", 8888), ("192.0.2.7", 2018), b"odd"),
        (("127.2.0.1", 8888), ("127.0.0.1", 8888), PING),
        (("127.0.0.1", 8888), ("127.2.0.2", 8888), PING),
        (("::1", 5), ("::1", 9999), PING),
    ]
    assert [packet.comment for packet in decoded] == [
        "UDPv4Agent 192.0.2.7:2018 key 0x4B0CBE99", "UDPv4Agent 192.0.2.7:2018",
        "TestAgent /dev/ttyACM0 (1)", "TestAgent /dev/ttyACM0 (2)", "UDPv6Agent [::1]:5",
    ]  # fmt: skip
    assert [packet.outbound for packet in decoded] == [False, True, False, True, False]
    names = ["UDPv4Agent"] * 2 + ["TestAgent"] * 2 + ["UDPv6Agent"]
    assert [packet.interface for packet in decoded] == names
    assert all(abs(float(packet.time) - time.time()) < 60 for packet in decoded)


@pytest.mark.parametrize("size", [0, 1, 2, 3, 4, 511, 1472, 20_001, MAX_PAYLOAD])
def test_payloads_of_any_size_have_good_checksums(tmp_path, size):
    path = tmp_path / "one.pcapng"
    desk = Desk(path)
    for fill in (b"\0", b"\xff", b"\x5a"):
        desk.say(fill * size)
    desk.close()
    assert [record.message for record in read(path)] == [
        f * size for f in (b"\0", b"\xff", b"\x5a")
    ]
    if size:  # tshark shows no payload for an empty message
        decoded = packets(path)
        assert all(record.checksums_good for record in decoded)
        assert [len(record.payload) for record in decoded] == [size] * 3


def test_a_message_too_large_for_a_packet_is_cut_with_a_comment(tmp_path):
    path = tmp_path / "one.pcapng"
    desk = Desk(path)
    desk.say(bytes(65535))
    desk.close()
    (packet,) = packets(path)
    assert len(packet.payload) == MAX_PAYLOAD
    assert packet.comment == "TestAgent 1.2.3.4:5 (cut, of 65535 bytes)"
    (record,) = read(path)
    assert record.address == "1.2.3.4:5"


# --- two files ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["one.pcapng", "one.txt"])
def test_a_full_file_is_rotated_and_two_files_are_kept(tmp_path, name):
    path = tmp_path / name
    desk = Desk(path, limit=4000)
    for number in range(200):
        desk.say(PING + number.to_bytes(4, "little"))
    desk.close()
    assert sorted(os.listdir(tmp_path)) == [name, f"{name}.1"]
    assert 0 < os.path.getsize(path) <= 4000 and os.path.getsize(f"{path}.1") <= 4000
    numbers = [
        int.from_bytes(record.message[-4:], "little")
        for part in (f"{path}.1", path)
        for record in read(part)
    ]
    assert numbers == list(range(200 - len(numbers), 200)) and len(numbers) > 20
    if name.endswith(".pcapng"):
        assert packets(path)[0].comment == "TestAgent 1.2.3.4:5"


def test_an_older_capture_is_kept_as_the_second_file(tmp_path):
    # An agent that systemd restarts after a crash must not overwrite what led to the crash.
    path = tmp_path / "one.txt"
    for count in (3, 2, 1):
        desk = Desk(path)
        for _ in range(count):
            desk.say()
        desk.close()
    assert sorted(os.listdir(tmp_path)) == ["one.txt", "one.txt.1"]
    assert len(list(read(path))) == 1 and len(list(read(f"{path}.1"))) == 2


def test_an_empty_capture_does_not_displace_the_second_file(tmp_path):
    path = tmp_path / "one.txt"
    for count in (3, 0, 1):
        desk = Desk(path)
        for _ in range(count):
            desk.say()
        desk.close()
    assert len(list(read(path))) == 1 and len(list(read(f"{path}.1"))) == 3


@pytest.mark.parametrize("name", ["one.pcapng", "one.pcapng.1"])
def test_a_file_that_is_no_capture_is_not_overwritten(tmp_path, name):
    (tmp_path / name).write_text("the only copy of my thesis")
    with pytest.raises(CaptureError, match=rf"{name} is there already and no capture.*remove"):
        Desk(tmp_path / "one.pcapng")
    assert (tmp_path / name).read_text() == "the only copy of my thesis"


@pytest.mark.parametrize("name", ["not/there.txt", ".", "nul\0.txt"])
def test_a_file_that_cannot_be_created(tmp_path, name):
    with pytest.raises(CaptureError, match="name a file in a folder that exists"):
        Desk(f"{tmp_path}/{name}")


def test_files_that_are_recognised_as_captures(tmp_path):
    path = tmp_path / "file"
    for content, yes in (
        (b"", True), (b"\x0a\x0d\x0d\x0a....", True), (b'{"t": 0.0, "from": "agent"', True),
        (b'{"some": "json"}', False), (b"\x7fELF", False),
    ):  # fmt: skip
        path.write_bytes(content)
        assert is_capture(path) == yes


# --- disks --------------------------------------------------------------------------------------


def test_a_full_disk_pauses_the_capture_and_not_the_agent():
    with running_agent("udp", "memory") as agent:
        capture = Capture("/dev/full", HUGE, agent.agent.log, agent.agent.message_hooks)
        client = XrceClient(agent.line(), 0xCAFE)
        client.open()
        eventually(lambda: "capture pauses" in agent.said.getvalue())
        for _ in range(20):
            assert client.ping() == 1
        assert capture.trouble() == "nothing is captured into /dev/full: No space left on device"
        capture.close()
        assert not agent.agent.message_hooks
    log = agent.said.getvalue()
    assert "No space left on device (make room, or capture to another disk" in log
    assert log.count("capture pauses") == 1
    assert re.search(r"capture closed +\| file: /dev/full, messages: 0, lost: \d+", log)


class Disk:
    """A disk that is full when the test says so; it may take a part of what is written."""

    def __init__(self, monkeypatch):
        self.room = None  # bytes; None: as many as come
        self.real = os.write
        self.real_open = os.open
        monkeypatch.setattr(captures.os, "write", self.write)
        monkeypatch.setattr(captures.os, "open", self.open)

    def write(self, file, data):
        if self.room is not None:
            if not self.room:
                raise OSError(errno.ENOSPC, "No space left on device")
            data = data[: self.room]
            self.room -= len(data)
        return self.real(file, data)

    def open(self, path, flags, *mode, **more):
        if self.room == 0 and flags & os.O_CREAT:
            raise OSError(errno.ENOSPC, "No space left on device")
        return self.real_open(path, flags, *mode, **more)


@pytest.mark.parametrize("name", ["one.pcapng", "one.txt"])
@pytest.mark.parametrize("room", [0, 250])
def test_a_capture_goes_on_when_the_disk_has_room_again(tmp_path, name, room, monkeypatch):
    path = tmp_path / name
    disk, now = Disk(monkeypatch), [1_763_750_000_000_000_000]
    desk = Desk(path)
    monkeypatch.setattr(desk.message_hooks, "_clock", Clock(time_ns=lambda: now[0]))
    written = desk.capture

    def say(number, at):
        """A message at so many seconds; wait until it is handled."""
        now[0] = 1_763_750_000_000_000_000 + at * 1_000_000_000
        desk.say(PING + bytes([number]))
        eventually(lambda: written._taken == written._put)

    say(1, 0)
    eventually(lambda: written.written == 1)
    disk.room = room
    for number in range(2, 6):
        say(number, 1)
    eventually(lambda: written._paused)
    say(6, 7)  # tried again, in vain
    eventually(lambda: written._failed_at == now[0] // 1000)
    say(7, 8)
    disk.room = None
    say(8, 10)  # not tried: it was only 3 s ago
    say(9, 13)
    eventually(lambda: not written.trouble())
    say(10, 13)
    said = desk.close()
    assert said.count("capture pauses") == 1
    (record,) = re.findall(r"capture goes on +\| file: .*, messages not captured: (\d+)", said)
    faults = []
    records = list(read(path, faults.append))
    numbers = [record.message[-1] for record in records]
    kept = len(numbers) - 3
    assert numbers == [1, *range(2, 2 + kept), 9, 10] and not faults
    assert 0 < kept < 4 if room else not kept
    assert int(record) == 7 - kept == records[-2].lost
    assert records[-1].lost == 0


def test_a_disk_that_is_full_while_the_file_is_rotated(tmp_path, monkeypatch):
    path = tmp_path / "one.txt"
    disk, now = Disk(monkeypatch), [0]
    desk = Desk(path, 400)
    monkeypatch.setattr(desk.message_hooks, "_clock", Clock(time_ns=lambda: now[0]))
    for number in range(1, 12):
        if number == 4:
            disk.room = 0
        elif number == 8:
            disk.room = None
            now[0] = 6_000_000_000
        desk.say(bytes([number]) * 8)
        eventually(lambda: desk.capture._taken == desk.capture._put)
        if number in (4, 8):
            eventually(lambda full=number == 4: bool(desk.capture.trouble()) == full)
    said = desk.close()
    assert said.count("capture pauses") == said.count("capture goes on") == 1
    kept = [record for each in (f"{path}.1", path) for record in read(each, print)]
    assert [record.message[0] for record in kept][-3:] == [9, 10, 11]
    assert sum(record.lost for record in kept) == 4


@pytest.mark.parametrize("name", ["one.pcapng", "one.txt"])
def test_a_file_at_its_size_limit_ends_with_a_whole_message(tmp_path, name):
    """A real agent, with files that the system limits to 20 kB."""
    path = tmp_path / name
    with agent_process(path, lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (20_000,) * 2)) as (
        process, port,
    ):  # fmt: skip
        line = UdpLine(port)
        client = XrceClient(line, 0xCAFE)
        client.open()
        log = ""
        while "capture ends" not in log:
            for _ in range(50):
                assert client.ping() == 1
            if select.select([process.stdout], [], [], 0)[0]:
                log += process.stdout.readline().decode()
        assert "raise the limit on files (ulimit -f)" in log
        assert client.ping() == 1
        line.close()
    assert 19_000 < path.stat().st_size <= 20_000
    rest = []
    records = list(read(path, rest.append))
    assert not rest
    assert f"the {len(records)} messages in it are whole" in log
    if name.endswith(".pcapng"):
        assert len(packets(path)) == len(records)


@pytest.mark.parametrize("name", ["one.pcapng", "one.txt"])
def test_an_agent_that_is_killed_leaves_a_readable_file(tmp_path, name):
    path = tmp_path / name
    with agent_process(path) as (process, port):
        line = UdpLine(port)
        client = XrceClient(line, 0xCAFE)
        client.open()
        for _ in range(200):
            client.ping()
        eventually(lambda: path.stat().st_size > 200 * 2 * 20)
        process.send_signal(signal.SIGKILL)
        process.wait(SECONDS)
        line.close()
    rest = []
    records = list(read(path, rest.append))
    assert not rest and len(records) > 200
    assert len({record.address for record in records}) == 1


def test_a_slow_disk_loses_messages_and_their_number_is_logged(tmp_path, monkeypatch):
    """A pipe without a reader is as slow as a disk can be."""
    monkeypatch.setattr(captures, "MAX_WAITING", 100_000)
    path = tmp_path / "pipe"
    os.mkfifo(path)
    desk = Desk(path)
    logged = before = 0
    while logged < 5000 or desk.capture.lost == before:  # the last one is lost
        before = desk.capture.lost
        desk.say(logged.to_bytes(4, "little") * 25)
        logged += 1
    lost = desk.capture.lost
    assert 0 < lost < logged
    assert desk.said.getvalue().count("messages not captured") == 1
    records = []
    reading = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    content = bytearray()

    def drain():
        try:
            content.extend(os.read(reading, 1 << 20))
        except BlockingIOError:
            pass
        return content.count(b"\n") >= logged - lost

    eventually(drain)
    desk.say(b"later")
    eventually(lambda: drain() and content.count(b"\n") == logged + 1 - lost)
    os.close(reading)
    desk.close()
    records = [json.loads(line) for line in content.splitlines()]
    assert sum(record.get("lost", 0) for record in records) == lost
    assert records[-1]["lost"] > 0 and records[-1]["hex"] == b"later".hex()


@pytest.mark.parametrize("reason", [True, False])
def test_a_second_agent_on_the_same_file_is_refused_and_damages_nothing(tmp_path, reason):
    path = tmp_path / "one.pcapng"
    first = Desk(path, 2000)
    for count in (1, 100):  # before the file is replaced, and after
        if reason:
            for _ in range(count):
                first.say(bytes(50))
            eventually(lambda: first.capture.written and first.capture._put == first.capture._taken)
        with pytest.raises(CaptureError, match="another agent captures into it: end that one"):
            Desk(path)
    first.close()
    assert sorted(os.listdir(tmp_path)) == (
        ["one.pcapng", "one.pcapng.1"] if reason else [path.name]
    )
    assert is_capture(path)
    if reason:
        assert all(record.message == bytes(50) for record in read(path))
    Desk(path).close()  # now the file is free


def test_closing_waits_for_a_slow_disk_for_a_limited_time(tmp_path, monkeypatch):
    monkeypatch.setattr(captures, "_STILL", 0.05)
    path = tmp_path / "pipe"
    os.mkfifo(path)
    desk = Desk(path)
    desk.say(bytes(60_000))
    desk.say(bytes(60_000))
    assert "capture is cut off" in desk.close()
    reading = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    eventually(lambda: not (desk.capture._thread.is_alive() and drained(reading)))
    os.close(reading)


def drained(reading):
    try:
        os.read(reading, 1 << 20)
    except BlockingIOError:
        pass
    return True


def test_an_internal_error_ends_the_capture_and_is_logged(tmp_path):
    class Broken(Named):
        def address(self, peer):
            raise ZeroDivisionError("a slip")

    desk = Desk(tmp_path / "one.txt")
    desk.say(transport=Broken())
    eventually(lambda: "ZeroDivisionError: a slip; the capture ends" in desk.said.getvalue())
    desk.say()
    assert not desk.message_hooks
    desk.close()


# --- a process ----------------------------------------------------------------------------------


class agent_process:
    """Run an agent on memory that captures; yield (process, port)."""

    def __init__(self, path, before=None):
        self._args = [
            sys.executable, "-m", "uros", "agent", "udp4", "--port", "0", "-m", "memory",
            "--capture", str(path),
        ]  # fmt: skip
        self._before = before

    def __enter__(self):
        self._process = subprocess.Popen(
            self._args, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, bufsize=0,
            preexec_fn=self._before,
        )  # fmt: skip
        while b"port: " not in (line := self._process.stdout.readline()):
            assert line, "the agent has ended"
        return self._process, int(line.rpartition(b"port: ")[2])

    def __exit__(self, *_):
        self._process.kill()
        self._process.wait(SECONDS)
        self._process.stdout.close()
