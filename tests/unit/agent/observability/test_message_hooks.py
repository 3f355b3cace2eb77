"""Message hooks: they get all messages in order, and a failing hook harms nobody."""

import io

import pytest
from support.agent import running_agent
from support.client import XrceClient
from unit.agent.helpers import get_info, message

from uros.agent.clock import Clock
from uros.agent.log import Log
from uros.agent.observability.message_hooks import AGENT, CLIENT, MessageHooks
from uros.agent.transports.memory import MemoryServer
from uros.wire import ids


def test_hooks_get_messages_of_unknown_clients_of_sessions_and_answers_in_order():
    heard = []
    with running_agent("udp", "memory") as agent:
        agent.agent.message_hooks.append(heard.append)
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
        agent.agent.message_hooks.append(heard.append)
        client.write(writer, b"\1\2\3\4")
        client.ping()
    (sent,) = [it.message for it in heard if it.message[4] == ids.WRITE_DATA]
    assert sent[10:12] == writer.to_bytes(2, "big") and sent[12:] == b"\1\2\3\4"


@pytest.fixture
def said():
    return io.StringIO()


def test_a_hook_that_raises_is_logged_once_and_removed(said):
    message_hooks = MessageHooks(Log(4, said), Clock())
    heard = []

    def broken(event):
        raise ZeroDivisionError("a slip")

    message_hooks.append(broken)
    message_hooks.append(heard.append)
    for _ in range(3):
        message_hooks(MemoryServer(), 1, CLIENT, b"12345", 3, 0)
    assert said.getvalue().count("ZeroDivisionError: a slip; this message hook is removed") == 1
    assert [it.message for it in heard] == [b"123"] * 3


def test_a_hook_may_remove_itself(said):
    message_hooks = MessageHooks(Log(4, said), Clock())
    heard = []

    def once(event):
        heard.append(event)
        message_hooks.discard(once)

    message_hooks.append(once)
    for _ in range(2):
        message_hooks(MemoryServer(), 1, CLIENT, b"1", 1, 0)
    assert len(heard) == 1 and not message_hooks


@pytest.mark.parametrize(("level", "lines"), [(4, 0), (5, 1), (6, 2)])
def test_what_the_levels_of_the_log_show(said, level, lines):
    message_hooks = MessageHooks(Log(level, said), Clock())
    assert bool(message_hooks) == (lines > 0)
    ping = message([get_info()], 0, 0)
    message_hooks(MemoryServer(), 1, CLIENT, ping, len(ping), 0xCAFE)
    got = said.getvalue().splitlines()
    assert len(got) == lines
    assert [it for it in got if it.endswith(" | 0x81: GET_INFO #50 agent activity")] == got[:-1]
    if lines:
        assert "recv_message             | [==>> MEMORY <<==]" in got[-1]
        about = "client_key: 0x0000CAFE, len: 16"
        assert got[-1].endswith(about if level == 5 else f"{about}, data: {ping.hex(' ').upper()}")
