"""Clients of a lost line are deleted within ten seconds, unless they come back."""

import os
from contextlib import ExitStack

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.agent import RunningAgent, running_agent, serving
from support.client import XrceClient
from support.waiting import eventually
from unit.agent.helpers import (
    KEY,
    Board,
    Desk,
    Place,
    create_client,
    get_info,
    message,
    parse,
    publisher_entities,
)
from unit.agent.persistence.test_session_store import World, publisher
from unit.agent.transports.test_serial import Device

from uros.agent.persistence.journal import open_journal
from uros.agent.persistence.session_store import SessionStore
from uros.agent.policy import line_loss as module
from uros.agent.transports import line as line_module
from uros.agent.transports.serial import SerialServer
from uros.wire import ids

TYPE = "std_msgs::msg::dds_::Int32_"
MOST = 10_000  # milliseconds, from the loss on
ALIVE = message([get_info()], 0)


class Lines(Place):
    """Each peer is on a line of its own, which can be away."""

    def __init__(self):
        super().__init__()
        self.away = set()

    def is_away(self, peer):
        return peer in self.away


@pytest.fixture
def desk():
    made = Desk()
    made.place = Lines()
    yield made
    made.close()


def unplug(desk, *peers):
    desk.place.away.update(peers)
    desk.agent.line_loss.lost(desk.place)


def questions(sent, peer=1):
    return [parse(it)[1][0][0] for to, it in sent if to == peer].count(ids.GET_INFO)


def test_who_does_not_come_back_leaves_within_ten_seconds_with_all_it_made(desk):
    Board(desk, 1).ask(*publisher_entities())
    Board(desk, 2, 2).ask(*publisher_entities())
    unplug(desk, 1)
    desk.wait(5000)
    assert set(desk.agent.clients) == {KEY, 2}
    assert not questions(desk.wait(MOST - 5000))  # nobody would hear them
    assert set(desk.agent.clients) == {2}
    assert len(desk.middleware.bus.nodes) == 1
    assert "address: peer 1, not back within 7 s: deleted" in desk.log()
    assert not desk.agent.line_loss._missing and not desk.agent.line_loss._checking


@pytest.mark.parametrize("after", [500, 3000, 6900])
def test_a_line_that_comes_back_has_its_clients_asked_and_who_answers_stays(desk, after):
    Board(desk, 1)
    unplug(desk, 1)
    desk.wait(after)
    desk.place.away.clear()
    sent = desk.wait(1000)
    assert questions(sent) == 1
    desk.hear(ALIVE, 1)
    assert not questions(desk.wait(20_000))
    assert KEY in desk.agent.clients and not desk.agent.line_loss._missing


@pytest.mark.parametrize("after", [0, 500, 3000, 6900])
def test_a_line_that_comes_back_without_the_board_is_no_board(desk, after):
    Board(desk, 1)
    unplug(desk, 1)
    desk.wait(after)
    desk.place.away.clear()
    assert questions(desk.wait(MOST - after)) >= module.PROBES
    assert KEY not in desk.agent.clients


def test_a_board_that_begins_anew_on_its_line_stays(desk):
    Board(desk, 1)
    unplug(desk, 1)
    desk.wait(2000)
    desk.place.away.clear()
    desk.hear(create_client(), 1)
    desk.wait(MOST)
    assert KEY in desk.agent.clients


def test_a_board_that_was_plugged_in_elsewhere_stays(desk):
    Board(desk, 1)
    unplug(desk, 1)
    desk.hear(create_client(), 2)
    desk.wait(MOST)
    assert desk.agent.place(KEY) == (desk.place, 2)


def test_a_board_that_says_goodbye_meanwhile_is_gone_and_nothing_is_left(desk):
    Board(desk, 1)
    unplug(desk, 1)
    desk.agent.delete_client(KEY)
    Board(desk, 2)  # another one with its key
    desk.wait(MOST)
    assert KEY in desk.agent.clients and not desk.agent.line_loss._missing


def test_a_line_that_goes_again_and_again_does_not_keep_its_board(desk):
    Board(desk, 1)
    for _ in range(9):
        unplug(desk, 1)
        desk.wait(500)
        desk.place.away.clear()
        desk.wait(500)
    desk.wait(500)
    assert KEY not in desk.agent.clients


def test_in_a_process_that_was_stopped_nobody_was_missed(desk):
    Board(desk, 1)
    unplug(desk, 1)
    desk.clock += 60_000  # no timer fired
    desk.wait(0)
    desk.place.away.clear()
    desk.wait(1000)
    desk.hear(ALIVE, 1)
    desk.wait(MOST)
    assert KEY in desk.agent.clients


def test_the_promise():
    assert module.CHECKS + module.PROBES < 10


@given(st.lists(st.tuples(st.sampled_from("lbhcw"), st.integers(1, 3)), max_size=60))
def test_whatever_lines_and_boards_do(steps):
    """l: line lost, b: line back, h: heard, c: CREATE_CLIENT, w: time passes."""
    desk = Desk()
    desk.place = Lines()
    for what, peer in steps:
        if what == "l":
            unplug(desk, peer)
        elif what == "b":
            desk.place.away.discard(peer)
        elif what == "w":
            desk.wait(900 * peer)
        elif peer not in desk.place.away:
            desk.hear(ALIVE if what == "h" else create_client(peer), peer)
    alive = [peer for peer in (1, 2, 3) if peer not in desk.place.away]
    for peer in alive:
        desk.hear(create_client(peer), peer)
    unplug(desk, *desk.place.away)
    desk.wait(MOST)
    assert set(desk.agent.clients) == set(alive)
    desk.close()


# --- restored --------------------------------------------------------------------------------


@pytest.mark.parametrize("comes", [False, True])
def test_a_restored_board_whose_line_is_not_there_leaves_likewise(tmp_path, monkeypatch, comes):
    world = World(tmp_path / "state")
    publisher(world).turns()
    away = [True]
    monkeypatch.setattr(Place, "is_away", lambda self, peer: away[0], raising=False)
    desk = world.restart()
    assert 0xA1 in desk.agent.clients
    if comes:
        desk.wait(3000)
        away[0] = False
        world.clients[0xA1].turns()
    desk.wait(MOST)
    assert (0xA1 in desk.agent.clients) == comes
    world.close()


# --- over real lines -------------------------------------------------------------------------


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr(module, "_CHECK_SECONDS", 0.02)
    monkeypatch.setattr(line_module, "RETRY", 0.01)


def hang_up(running, line):
    """The board's end of its line is closed, as by unplugging it."""
    if running._ends is None:
        if running.kind == "serial":
            os.close(running._master)
            running._master = -1
        elif running.kind == "pseudoterminal":
            os.close(running._slave)
            running._slave = -1
        else:
            line.close()
        return
    ends = running._ends
    if running.kind == "socket":
        ends.listener.close()
    fd = ends.fds[1] if running.kind in ("multiserial", "pyserial") else ends.fds[-1]
    ends.fds.remove(fd)
    os.close(fd)


@pytest.mark.parametrize(
    "kind",
    ["serial", "multiserial", "pyserial", "socket", "rfcomm", "pseudoterminal", "tcp", "tls"],
)
def test_a_board_leaves_the_graph_when_its_line_is_gone(quick, kind):
    with running_agent(kind, "memory") as running:
        one = XrceClient(running.line(0), 0x11)
        assert one.open() == ids.STATUS_OK
        one.writer("n", "rt/a", TYPE)
        assert len(running.middleware.bus.nodes) == 1
        hang_up(running, one.line)
        eventually(lambda: not running.agent.clients)
        eventually(lambda: not running.middleware.bus.nodes)
        running.lines.clear()


def test_a_program_opens_the_pseudo_terminal_again_and_goes_on(quick, monkeypatch):
    monkeypatch.setattr(module, "CHECKS", 1_000_000)
    with running_agent("pseudoterminal", "memory") as running:
        one = XrceClient(running.line(0), 0x11)
        assert one.open() == ids.STATUS_OK
        writer, reader = one.writer("n", "rt/a", TYPE), one.reader("n", "rt/a", TYPE)
        one.read(reader)
        device = running.transport.device
        for turn in range(3):
            os.close(running._slave)
            eventually(lambda: running.transport.is_away(1))
            running._slave = os.open(device, os.O_RDWR | os.O_NOCTTY)
            running._terminal._fd = running._slave
            one.write(writer, bytes([turn]) * 4)
            assert one.sample(reader) == bytes([turn]) * 4
        assert running.transport.device == device
        eventually(lambda: not running.agent.line_loss._missing)


def test_a_board_that_is_plugged_in_again_in_time_stays_and_is_asked(quick, monkeypatch, tmp_path):
    monkeypatch.setattr(module, "CHECKS", 1_000_000)
    device = Device(tmp_path)
    line = device.plug()
    with running_agent(SerialServer(str(device.link)), "memory") as running:
        one = XrceClient(line, 0x11)
        assert one.open() == ids.STATUS_OK
        one.participant("n")
        device.unplug()
        eventually(lambda: running.agent.line_loss._missing)
        one.line = device.plug()
        one.until(lambda: not running.agent.line_loss._missing, "it is not asked")
        assert running.agent.clients[0x11].objects
    device.unplug()


def test_a_restored_board_of_a_device_that_is_away_leaves(quick, tmp_path):
    device, path = Device(tmp_path), str(tmp_path / "state")
    line = device.plug()
    for there in (True, False):
        with ExitStack() as stack:
            running = RunningAgent(SerialServer(str(device.link)), "memory", 0, 4)
            running.server.attachments.append(SessionStore(open_journal(path), running.agent.log))
            stack.enter_context(serving(running))
            if there:
                one = XrceClient(line, 0x11)
                assert one.open() == ids.STATUS_OK
                one.participant("n")
            else:
                assert "session restored" in running.said.getvalue()
                eventually(lambda agent=running.agent: not agent.clients)
                assert "line is gone" in running.said.getvalue()
        if there:
            device.unplug()
