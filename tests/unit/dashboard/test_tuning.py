"""The conversation with a rover, over real sockets."""

import socket

import pytest
from support.waiting import eventually

from uros.dashboard.tuning import HISTORY, Tuning
from uros.drivers.pid_line import PidLine

DOCUMENT = "200,30,5,200,30,5,1.0,0"


@pytest.fixture
def tuning():
    made = Tuning("127.0.0.1", 0)
    yield made
    made.close()


@pytest.fixture
def connect(tuning):
    open_ones = []

    def make(buffer=None):
        rover = socket.socket()
        if buffer:
            rover.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer)
        rover.connect(("127.0.0.1", tuning.port))
        rover.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        rover.settimeout(10)
        open_ones.append(rover)
        notes = sum("connected: " in it["text"] for it in tuning.snapshot()["notes"])
        eventually(lambda: said(tuning, "connected: ") > notes or tuning.snapshot()["rover"])
        return rover

    yield make
    for rover in open_ones:
        rover.close()


def said(tuning, text):
    return sum(text in it["text"] for it in tuning.snapshot()["notes"])


def samples(tuning, count):
    """The samples, when there are so many."""
    eventually(lambda: tuning.snapshot()["count"] >= count, lambda: str(tuning.snapshot()))
    return tuning.snapshot()["samples"]


def test_what_the_rover_tells(tuning, connect):
    assert tuning.snapshot()["rover"] == ""
    rover = connect()
    rover.sendall(b"12,-3\n15,-4,300,290\n")
    assert samples(tuning, 2) == [(12, -3), (15, -4, 300, 290)]
    assert tuning.snapshot()["rover"] == "127.0.0.1"


def test_a_message_without_line_end_is_whole_after_a_pause(tuning, connect):
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
    assert said(tuning, "sent 200,30") == 1


def test_what_cannot_be_sent_is_said(tuning, connect):
    with pytest.raises(ValueError, match="no rover is connected: let it connect to port"):
        tuning.send(DOCUMENT)
    rover = connect()
    with pytest.raises(ValueError, match="3 values instead of 8"):
        tuning.send("1,2,3")
    tuning.send(DOCUMENT)
    assert rover.recv(100).startswith(b"200,30")  # and nothing of the other


def test_nonsense_is_told_and_the_connection_lives(tuning, connect):
    rover = connect()
    rover.sendall(b"hello\n\xff\xfe\n1,2\n# flat battery\n")
    assert samples(tuning, 1) == [(1, 2)]
    eventually(lambda: said(tuning, "flat battery"))
    assert said(tuning, "left out what the rover sent: hello is no whole number") == 1
    assert tuning.snapshot()["left_out"] == 2
    tuning.send(DOCUMENT)
    assert rover.recv(100)


def test_a_flood_of_nonsense_is_told_of_in_few_lines(tuning, connect):
    rover = connect()
    rover.sendall(b"x\n" * 20000 + b"1,2\n")
    assert samples(tuning, 1) == [(1, 2)]
    assert tuning.snapshot()["left_out"] == 20000
    assert said(tuning, "left out") < 40


def test_no_more_is_kept_than_is_plotted(tuning, connect):
    rover = connect()
    rover.sendall(b"".join(b"%d,0\n" % it for it in range(250)))
    kept = samples(tuning, 250)
    assert [it[0] for it in kept] == list(range(250 - HISTORY, 250))


def test_a_rover_that_leaves_may_come_again(tuning, connect):
    rover = connect()
    rover.sendall(b"1,2")
    rover.close()
    eventually(lambda: said(tuning, "closed the connection"))
    assert samples(tuning, 1) == [(1, 2)]  # the end is an end, too
    with pytest.raises(ValueError, match="no rover"):
        tuning.send(DOCUMENT)
    connect().sendall(b"3,4\n")
    assert samples(tuning, 2) == [(3, 4)]


def test_the_newest_rover_has_the_place(tuning, connect):
    """One that was reset has closed nothing."""
    old = connect()
    old.sendall(b"1,2,3\n7,")
    samples(tuning, 1)
    new = connect()
    eventually(lambda: said(tuning, "in place of the rover before"))
    assert old.recv(10) == b""
    new.sendall(b"3,4\n")
    assert samples(tuning, 2) == [(3, 4)]
    tuning.send(DOCUMENT)
    assert new.recv(100)


def test_a_rover_that_reads_nothing_does_not_hold_the_page(tuning, connect, monkeypatch):
    monkeypatch.setattr("uros.dashboard.tuning._SEND_SECONDS", 0.05)
    connect(4096)
    tuning._rover.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 65536)
    with pytest.raises(ValueError, match="the rover takes nothing"):
        for _ in range(1_000_000):
            tuning.send(DOCUMENT)
    eventually(lambda: tuning.snapshot()["rover"] == "")  # half a line is out


def test_news_are_waited_for(tuning, connect):
    before = tuning.snapshot()["version"]
    rover = connect()
    rover.sendall(b"1,2\n")
    while not (now := tuning.snapshot(before, 10))["samples"]:
        assert now["version"] > before
        before = now["version"]


def test_the_terminal_sees_each_note_once(tuning, connect):
    connect()
    eventually(lambda: said(tuning, "connected"))
    seen, fresh = tuning.notes_since(0, 10)
    assert fresh == ["connected: 127.0.0.1"]
    assert tuning.notes_since(seen, 0.01) == (seen, [])
    tuning.send(DOCUMENT)
    assert tuning.notes_since(seen, 10) == (seen + 1, ["sent 200,30,5,200,30,5,1,0"])


def test_a_port_that_is_taken(tuning):
    with pytest.raises(OSError):
        Tuning("127.0.0.1", tuning.port)
