"""Listening to messages: all of them, in order, and nobody is harmed by who listens."""

import io

import pytest
from support.agent import running_agent
from support.client import XrceClient
from unit.agent.helpers import get_info, message

from uros.agent.log import Log
from uros.agent.observability.message_hooks import AGENT, CLIENT, Taps
from uros.agent.transports.memory import MemoryServer
from uros.wire import ids


def test_strangers_sessions_and_answers_are_heard_in_order():
    heard = []
    with running_agent("udp", "memory") as agent:
        agent.agent.taps.append(heard.append)
        line = agent.line()
        client = XrceClient(line, 0xCAFE)
        line.send(b"nonsense of a stranger")
        client.open()
        assert client.ping() == 1
    assert [(it.direction, it.key) for it in heard] == [
        (CLIENT, 0), (CLIENT, 0), (AGENT, 0xCAFE), (CLIENT, 0xCAFE), (AGENT, 0xCAFE),
    ]  # fmt: skip
    assert heard[0].message == b"nonsense of a stranger"
    assert {it.transport for it in heard} == {agent.transport}
    assert len({it.transport.address(it.peer) for it in heard}) == 1
    assert sorted(it.now for it in heard) == [it.now for it in heard]


def test_what_is_heard_is_as_it_came_though_the_agent_writes_into_its_buffer():
    heard = []
    with running_agent("udp", "memory") as agent:
        client = XrceClient(agent.line(), 0xCAFE)
        client.open()
        writer = client.writer("n", "rt/x", "a::msg::dds_::B_")
        agent.agent.taps.append(heard.append)
        client.write(writer, b"\1\2\3\4")
        client.ping()
    (sent,) = [it.message for it in heard if it.message[4] == ids.WRITE_DATA]
    assert sent[10:12] == writer.to_bytes(2, "big") and sent[12:] == b"\1\2\3\4"


@pytest.fixture
def said():
    return io.StringIO()


def test_a_tap_that_fails_is_told_once_and_hears_no_more(said):
    taps = Taps(Log(4, said))
    heard = []

    def broken(passing):
        raise ZeroDivisionError("a slip")

    taps.append(broken)
    taps.append(heard.append)
    for _ in range(3):
        taps(MemoryServer(), 1, CLIENT, b"12345", 3, 0)
    assert said.getvalue().count("ZeroDivisionError: a slip; this listener hears no more") == 1
    assert [it.message for it in heard] == [b"123"] * 3


def test_a_tap_may_take_itself_out(said):
    taps = Taps(Log(4, said))
    heard = []

    def once(passing):
        heard.append(passing)
        taps.drop(once)

    taps.append(once)
    for _ in range(2):
        taps(MemoryServer(), 1, CLIENT, b"1", 1, 0)
    assert len(heard) == 1 and not taps


@pytest.mark.parametrize(("level", "lines"), [(4, 0), (5, 1), (6, 2)])
def test_what_the_levels_of_the_log_show(said, level, lines):
    taps = Taps(Log(level, said))
    assert bool(taps) == (lines > 0)
    ping = message([get_info()], 0, 0)
    taps(MemoryServer(), 1, CLIENT, ping, len(ping), 0xCAFE)
    got = said.getvalue().splitlines()
    assert len(got) == lines
    assert [it for it in got if it.endswith(" | 0x81: GET_INFO #50 agent activity")] == got[:-1]
    if lines:
        assert "recv_message             | [==>> MEMORY <<==]" in got[-1]
        about = "client_key: 0x0000CAFE, len: 16"
        assert got[-1].endswith(about if level == 5 else f"{about}, data: {ping.hex(' ').upper()}")
