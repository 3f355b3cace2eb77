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
    events = []
    with running_agent("udp", "memory") as agent:
        agent.agent.message_hooks.append(events.append)
        line = agent.line()
        client = XrceClient(line, 0xCAFE)
        line.send(b"nonsense of a stranger")
        client.open()
        assert client.ping() == 1
    assert [(event.direction, event.key) for event in events] == [
        (CLIENT, 0), (CLIENT, 0), (AGENT, 0xCAFE), (CLIENT, 0xCAFE), (AGENT, 0xCAFE),
    ]  # fmt: skip
    assert events[0].message == b"nonsense of a stranger"
    assert {event.transport for event in events} == {agent.transport}
    assert len({event.transport.address(event.peer) for event in events}) == 1
    assert sorted(event.now for event in events) == [event.now for event in events]


def test_hooks_get_the_received_bytes_though_the_agent_writes_into_its_buffer():
    events = []
    with running_agent("udp", "memory") as agent:
        client = XrceClient(agent.line(), 0xCAFE)
        client.open()
        writer = client.writer("n", "rt/x", "a::msg::dds_::B_")
        agent.agent.message_hooks.append(events.append)
        client.write(writer, b"\1\2\3\4")
        client.ping()
    (sent,) = [event.message for event in events if event.message[4] == ids.WRITE_DATA]
    assert sent[10:12] == writer.to_bytes(2, "big") and sent[12:] == b"\1\2\3\4"


@pytest.fixture
def log_stream():
    return io.StringIO()


def test_a_hook_that_raises_is_logged_once_and_removed(log_stream):
    message_hooks = MessageHooks(Log(4, log_stream), Clock())
    events = []

    def broken(event):
        raise ZeroDivisionError("a slip")

    message_hooks.append(broken)
    message_hooks.append(events.append)
    for _ in range(3):
        message_hooks(MemoryServer(), 1, CLIENT, b"12345", 3, 0)
    assert (
        log_stream.getvalue().count("ZeroDivisionError: a slip; this message hook is removed") == 1
    )
    assert [message_event.message for message_event in events] == [b"123"] * 3


def test_a_hook_may_remove_itself(log_stream):
    message_hooks = MessageHooks(Log(4, log_stream), Clock())
    events = []

    def once(event):
        events.append(event)
        message_hooks.discard(once)

    message_hooks.append(once)
    for _ in range(2):
        message_hooks(MemoryServer(), 1, CLIENT, b"1", 1, 0)
    assert len(events) == 1 and not message_hooks


@pytest.mark.parametrize(("level", "lines"), [(4, 0), (5, 1), (6, 2)])
def test_messages_in_the_log_at_each_level(log_stream, level, lines):
    message_hooks = MessageHooks(Log(level, log_stream), Clock())
    assert bool(message_hooks) == (lines > 0)
    ping = message([get_info()], 0, 0)
    message_hooks(MemoryServer(), 1, CLIENT, ping, len(ping), 0xCAFE)
    logged = log_stream.getvalue().splitlines()
    assert len(logged) == lines
    assert [
        line for line in logged if line.endswith(" | 0x81: GET_INFO #50 agent activity")
    ] == logged[:-1]
    if lines:
        assert "recv_message             | [==>> MEMORY <<==]" in logged[-1]
        about = "client_key: 0x0000CAFE, len: 16"
        assert logged[-1].endswith(
            about if level == 5 else f"{about}, data: {ping.hex(' ').upper()}"
        )
