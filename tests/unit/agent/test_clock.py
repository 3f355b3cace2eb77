"""The agent's clock, and what jumps of any clock do to sessions."""

import time

import pytest
from hypothesis import given
from hypothesis import strategies as st
from unit.agent.helpers import (
    READER,
    WRITER,
    Board,
    get_info,
    publisher_entities,
    read_data,
    sub,
    subscriber_entities,
    write_data,
)
from unit.agent.test_server import running

from uros.agent.clock import MAX_STEP, Clock
from uros.ticks import TIME_MASK, ticks_diff
from uros.wire import ids

DAY = 86_400.0


class Time:
    """Stands for time.monotonic in all modules."""

    def __init__(self, monkeypatch):
        self.ahead = 0.0
        real = time.monotonic
        monkeypatch.setattr(time, "monotonic", lambda: real() + self.ahead)


@given(st.lists(st.floats(-1e9, 1e9), max_size=30))
def test_readings_never_go_backwards_and_stay_within_the_tick_range(steps):
    now = [1e6]
    clock = Clock(lambda: now[0])
    before = clock.ticks()
    for step in steps:
        now[0] += step
        after = clock.ticks()
        assert 0 <= after <= TIME_MASK
        assert 0 <= ticks_diff(after, before) <= MAX_STEP + 1
        before = after


def test_short_times_are_measured_exactly():
    now = [0.0]
    clock = Clock(lambda: now[0])
    start = clock.ticks()
    for _ in range(100):
        now[0] += 1000.0
        clock.ticks()
    assert ticks_diff(clock.ticks(), start) == 100_000_000


@pytest.mark.parametrize("days", [0.05, 3, 7, 12.4, 13, 400])
def test_a_process_that_was_stopped_for_days_goes_on(monkeypatch, days):
    """After a stop of the agent or its machine, heartbeats are sent at once, not a week later."""
    clock = Time(monkeypatch)
    with running() as server:
        client = server.client(3)
        writer, reader = (
            client.writer("a", "rt/a", "a::msg::dds_::A_"),
            client.reader("a", "rt/a", "a::msg::dds_::A_"),
        )
        client.read(reader)
        take, messages = client.take, []
        client.take = messages.append
        client._put(
            ids.WRITE_DATA, b"\0\1" + writer.to_bytes(2, "big") + b"lost", ids.STREAM_RELIABLE, 1
        )
        client.until(lambda: any(item[4] == ids.DATA for item in messages), "no sample")
        clock.ahead += days * DAY
        server.server._wake.set()
        messages.clear()
        client.until(lambda: any(item[4] == ids.HEARTBEAT for item in messages), "no heartbeat")
        client.take = take
        assert client.sample(reader) == b"lost"
        assert client.ping() == 1
        assert "internal error" not in server.said.getvalue()


def test_the_wall_clock_may_jump(desk):
    """The wall clock is used for time stamps alone: sessions, heartbeats and log are unaffected."""
    board = Board(desk)
    board.ask(*publisher_entities(), *subscriber_entities()[2:])
    board.send(read_data(READER))
    real = time.time_ns
    for jump in (0, 10**18, -(10**18), -real() - 10**9):
        desk.agent.clock.time_ns = lambda jump=jump: real() + jump
        desk.wait(1000)
        board.send(write_data(WRITER, b"x"))
        board.settle()
        assert board.samples() == [b"x"]
        board.send(sub(ids.TIMESTAMP, bytes(8)), stream=0)
        board.send(get_info(), stream=0)
        assert len(board.payloads(ids.INFO)) == 1
    assert "internal error" not in desk.log()


@pytest.mark.parametrize("start", [TIME_MASK - 2000, TIME_MASK - 150, TIME_MASK])
def test_ticks_wrap_in_the_middle_of_a_conversation(desk, start):
    desk.clock = start
    board = Board(desk)
    board.ask(*publisher_entities(), *subscriber_entities()[2:])
    board.send(read_data(READER))
    for number in range(40):
        board.send(write_data(WRITER, bytes([number])))
        board.settle()
        assert board.samples() == [bytes([number])]
        desk.clock = (desk.clock + 100) & TIME_MASK
        for client in desk.agent.clients.values():
            client.poll(desk.clock)
