"""The connection of a rover that is tuned, over real sockets."""

import socket

import pytest
from support.waiting import eventually

from uros.dashboard.tuning import HISTORY, Tuning
from uros.drivers.pid_line import PidLine

DOCUMENT = "200,30,5,200,30,5,1.0,0"


@pytest.fixture
def tuning():
    tuning = Tuning("127.0.0.1", 0)
    yield tuning
    tuning.close()


@pytest.fixture
def connect(tuning):
    rovers = []

    def make(buffer=None):
        rover = socket.socket()
        if buffer:
            rover.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer)
        rover.connect(("127.0.0.1", tuning.port))
        rover.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        rover.settimeout(10)
        rovers.append(rover)
        notes = count(tuning, "connected: ")
        eventually(lambda: count(tuning, "connected: ") > notes or tuning.snapshot()["rover"])
        return rover

    yield make
    for rover in rovers:
        rover.close()


def count(tuning, text):
    """Return the number of notes that contain a text."""
    return sum(text in note["text"] for note in tuning.snapshot()["notes"])


def samples(tuning, number):
    """Return the last samples when ``number`` samples have arrived."""
    eventually(lambda: tuning.snapshot()["count"] >= number, lambda: str(tuning.snapshot()))
    return tuning.snapshot()["samples"]


def test_samples_of_the_rover(tuning, connect):
    assert tuning.snapshot()["rover"] == ""
    rover = connect()
    rover.sendall(b"12,-3\n15,-4,300,290\n")
    assert samples(tuning, 2) == [(12, -3), (15, -4, 300, 290)]
    assert tuning.snapshot()["rover"] == "127.0.0.1"


def test_a_message_without_line_end_is_complete_after_a_pause(tuning, connect):
    rover = connect()
    rover.sendall(b"12,-3")
    assert samples(tuning, 1) == [(12, -3)]
    rover.sendall(b"15,-4")
    assert samples(tuning, 2)[1] == (15, -4)


def test_gains_reach_the_rover(tuning, connect):
    rover = connect()
    assert tuning.send(f"  {DOCUMENT}\n") == "200,30,5,200,30,5,1,0"
    line = PidLine()
    octets = rover.recv(100)
    assert octets == b"200,30,5,200,30,5,1,0\n"
    assert line.feed(octets) == [(200, 30, 5, 200, 30, 5, 1, 0)]
    assert tuning.snapshot()["sent"] == "200,30,5,200,30,5,1,0"
    assert count(tuning, "sent 200,30") == 1


def test_gains_that_cannot_be_sent_raise_the_reason(tuning, connect):
    with pytest.raises(ValueError, match="no rover is connected: let it connect to port"):
        tuning.send(DOCUMENT)
    rover = connect()
    with pytest.raises(ValueError, match="3 values instead of 8"):
        tuning.send("1,2,3")
    tuning.send(DOCUMENT)
    assert rover.recv(100).startswith(b"200,30")  # and no part of the rejected line


def test_invalid_lines_are_noted_and_the_connection_stays(tuning, connect):
    rover = connect()
    rover.sendall(b"hello\n\xff\xfe\n1,2\n# flat battery\n")
    assert samples(tuning, 1) == [(1, 2)]
    eventually(lambda: count(tuning, "flat battery"))
    assert count(tuning, "left out what the rover sent: hello is no whole number") == 1
    assert tuning.snapshot()["left_out"] == 2
    tuning.send(DOCUMENT)
    assert rover.recv(100)


def test_a_flood_of_invalid_lines_has_few_notes(tuning, connect):
    rover = connect()
    rover.sendall(b"x\n" * 20000 + b"1,2\n")
    assert samples(tuning, 1) == [(1, 2)]
    assert tuning.snapshot()["left_out"] == 20000
    assert count(tuning, "left out") < 40


def test_only_the_plotted_samples_are_stored(tuning, connect):
    rover = connect()
    rover.sendall(b"".join(b"%d,0\n" % value for value in range(250)))
    last = samples(tuning, 250)
    assert [sample[0] for sample in last] == list(range(250 - HISTORY, 250))


def test_a_rover_may_connect_again(tuning, connect):
    rover = connect()
    rover.sendall(b"1,2")
    rover.close()
    eventually(lambda: count(tuning, "closed the connection"))
    assert samples(tuning, 1) == [(1, 2)]  # the end of the connection ends a message
    with pytest.raises(ValueError, match="no rover"):
        tuning.send(DOCUMENT)
    connect().sendall(b"3,4\n")
    assert samples(tuning, 2) == [(3, 4)]


def test_a_new_rover_replaces_the_one_before(tuning, connect):
    """A rover that was reset leaves its old connection open; the new one replaces it."""
    old = connect()
    old.sendall(b"1,2,3\n7,")
    samples(tuning, 1)
    new = connect()
    eventually(lambda: count(tuning, "in place of the rover before"))
    assert old.recv(10) == b""
    new.sendall(b"3,4\n")
    assert samples(tuning, 2) == [(3, 4)]
    tuning.send(DOCUMENT)
    assert new.recv(100)


def test_a_rover_that_does_not_read_does_not_block_the_page(tuning, connect, monkeypatch):
    monkeypatch.setattr("uros.dashboard.tuning._SEND_SECONDS", 0.05)
    connect(4096)
    tuning._rover.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 65536)
    with pytest.raises(ValueError, match="the rover takes nothing"):
        for _ in range(1_000_000):
            tuning.send(DOCUMENT)
    eventually(lambda: tuning.snapshot()["rover"] == "")  # disconnected, since half a line was sent


def test_a_snapshot_waits_for_a_new_version(tuning, connect):
    before = tuning.snapshot()["version"]
    rover = connect()
    rover.sendall(b"1,2\n")
    while not (now := tuning.snapshot(before, 10))["samples"]:
        assert now["version"] > before
        before = now["version"]


def test_each_note_is_returned_once(tuning, connect):
    connect()
    eventually(lambda: count(tuning, "connected"))
    last, fresh = tuning.notes_since(0, 10)
    assert fresh == ["connected: 127.0.0.1"]
    assert tuning.notes_since(last, 0.01) == (last, [])
    tuning.send(DOCUMENT)
    assert tuning.notes_since(last, 10) == (last + 1, ["sent 200,30,5,200,30,5,1,0"])


def test_a_port_in_use(tuning):
    with pytest.raises(OSError):
        Tuning("127.0.0.1", tuning.port)
