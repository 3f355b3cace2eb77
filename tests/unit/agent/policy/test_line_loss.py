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
MOST = 10_000  # milliseconds after the loss
ALIVE = message([get_info()], 0)


class Lines(Place):
    """A transport with a line for each peer; lines can be lost."""

    def __init__(self):
        super().__init__()
        self.away = set()

    def is_away(self, peer):
        return peer in self.away


@pytest.fixture
def desk():
    desk = Desk()
    desk.place = Lines()
    yield desk
    desk.close()


def unplug(desk, *peers):
    desk.place.away.update(peers)
    desk.agent.line_loss.lost(desk.place)


def questions(sent, peer=1):
    return [parse(datagram)[1][0][0] for to, datagram in sent if to == peer].count(ids.GET_INFO)


def test_a_client_of_a_lost_line_is_deleted_with_its_objects_within_ten_seconds(desk):
    Board(desk, 1).ask(*publisher_entities())
    Board(desk, 2, 2).ask(*publisher_entities())
    unplug(desk, 1)
    desk.wait(5000)
    assert set(desk.agent.clients) == {KEY, 2}
    assert not questions(desk.wait(MOST - 5000))  # no answer would be received
    assert set(desk.agent.clients) == {2}
    assert len(desk.middleware.bus.nodes) == 1
    assert "address: peer 1, not back within 7 s: deleted" in desk.log()
    assert not desk.agent.line_loss._missing and not desk.agent.line_loss._checking


@pytest.mark.parametrize("after", [500, 3000, 6900])
def test_clients_are_probed_when_their_line_comes_back_and_stay_if_they_answer(desk, after):
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
def test_a_client_that_does_not_answer_after_its_line_came_back_is_deleted(desk, after):
    Board(desk, 1)
    unplug(desk, 1)
    desk.wait(after)
    desk.place.away.clear()
    assert questions(desk.wait(MOST - after)) >= module.PROBES
    assert KEY not in desk.agent.clients


def test_a_board_that_resets_on_its_line_stays(desk):
    Board(desk, 1)
    unplug(desk, 1)
    desk.wait(2000)
    desk.place.away.clear()
    desk.hear(create_client(), 1)
    desk.wait(MOST)
    assert KEY in desk.agent.clients


def test_a_board_that_was_plugged_in_at_another_line_stays(desk):
    Board(desk, 1)
    unplug(desk, 1)
    desk.hear(create_client(), 2)
    desk.wait(MOST)
    assert desk.agent.place(KEY) == (desk.place, 2)


def test_a_board_that_closes_its_session_meanwhile_leaves_no_probe(desk):
    Board(desk, 1)
    unplug(desk, 1)
    desk.agent.delete_client(KEY)
    Board(desk, 2)  # another client with its key
    desk.wait(MOST)
    assert KEY in desk.agent.clients and not desk.agent.line_loss._missing


def test_a_line_that_is_lost_repeatedly_does_not_keep_its_client(desk):
    Board(desk, 1)
    for _ in range(9):
        unplug(desk, 1)
        desk.wait(500)
        desk.place.away.clear()
        desk.wait(500)
    desk.wait(500)
    assert KEY not in desk.agent.clients


def test_time_in_which_the_process_was_stopped_does_not_count(desk):
    Board(desk, 1)
    unplug(desk, 1)
    desk.clock += 60_000  # no timer fired
    desk.wait(0)
    desk.place.away.clear()
    desk.wait(1000)
    desk.hear(ALIVE, 1)
    desk.wait(MOST)
    assert KEY in desk.agent.clients


def test_clients_are_deleted_in_less_than_ten_seconds():
    assert module.CHECKS + module.PROBES < 10


@given(st.lists(st.tuples(st.sampled_from("lbhcw"), st.integers(1, 3)), max_size=60))
def test_any_sequence_of_losses_and_connections_keeps_the_clients_of_present_lines(steps):
    """l: line lost, b: line back, h: heard, c: CREATE_CLIENT, w: time passes."""
    desk = Desk()
    desk.place = Lines()
    for step, peer in steps:
        if step == "l":
            unplug(desk, peer)
        elif step == "b":
            desk.place.away.discard(peer)
        elif step == "w":
            desk.wait(900 * peer)
        elif peer not in desk.place.away:
            desk.hear(ALIVE if step == "h" else create_client(peer), peer)
    alive = [peer for peer in (1, 2, 3) if peer not in desk.place.away]
    for peer in alive:
        desk.hear(create_client(peer), peer)
    unplug(desk, *desk.place.away)
    desk.wait(MOST)
    assert set(desk.agent.clients) == set(alive)
    desk.close()


# --- restored --------------------------------------------------------------------------------


@pytest.mark.parametrize("comes", [False, True])
def test_a_restored_client_whose_line_is_missing_is_deleted_likewise(tmp_path, monkeypatch, comes):
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
    """Close the board's end of its line, as by unplugging it."""
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
def test_the_node_of_a_board_leaves_the_graph_when_its_line_is_lost(quick, kind):
    with running_agent(kind, "memory") as running:
        client = XrceClient(running.line(0), 0x11)
        assert client.open() == ids.STATUS_OK
        client.writer("n", "rt/a", TYPE)
        assert len(running.middleware.bus.nodes) == 1
        hang_up(running, client.line)
        eventually(lambda: not running.agent.clients)
        eventually(lambda: not running.middleware.bus.nodes)
        running.lines.clear()


def test_a_program_opens_the_pseudo_terminal_again_and_goes_on(quick, monkeypatch):
    monkeypatch.setattr(module, "CHECKS", 1_000_000)
    with running_agent("pseudoterminal", "memory") as running:
        client = XrceClient(running.line(0), 0x11)
        assert client.open() == ids.STATUS_OK
        writer, reader = client.writer("n", "rt/a", TYPE), client.reader("n", "rt/a", TYPE)
        client.read(reader)
        device = running.transport.device
        for turn in range(3):
            os.close(running._slave)
            eventually(lambda: running.transport.is_away(1))
            running._slave = os.open(device, os.O_RDWR | os.O_NOCTTY)
            running._terminal._fd = running._slave
            client.write(writer, bytes([turn]) * 4)
            assert client.sample(reader) == bytes([turn]) * 4
        assert running.transport.device == device
        eventually(lambda: not running.agent.line_loss._missing)


def test_a_board_that_is_plugged_in_again_in_time_is_probed_and_stays(quick, monkeypatch, tmp_path):
    monkeypatch.setattr(module, "CHECKS", 1_000_000)
    device = Device(tmp_path)
    line = device.plug()
    with running_agent(SerialServer(str(device.link)), "memory") as running:
        client = XrceClient(line, 0x11)
        assert client.open() == ids.STATUS_OK
        client.participant("n")
        device.unplug()
        eventually(lambda: running.agent.line_loss._missing)
        client.line = device.plug()
        client.until(lambda: not running.agent.line_loss._missing, "it is not asked")
        assert running.agent.clients[0x11].objects
    device.unplug()


def test_a_restored_client_of_a_missing_device_is_deleted(quick, tmp_path):
    device, path = Device(tmp_path), str(tmp_path / "state")
    line = device.plug()
    for plugged_in in (True, False):
        with ExitStack() as stack:
            running = RunningAgent(SerialServer(str(device.link)), "memory", 0, 4)
            running.server.attachments.append(SessionStore(open_journal(path), running.agent.log))
            stack.enter_context(serving(running))
            if plugged_in:
                client = XrceClient(line, 0x11)
                assert client.open() == ids.STATUS_OK
                client.participant("n")
            else:
                assert "session restored" in running.said.getvalue()
                eventually(lambda agent=running.agent: not agent.clients)
                assert "line is gone" in running.said.getvalue()
        if plugged_in:
            device.unplug()
