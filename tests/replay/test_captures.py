"""Replays every recorded conversation to the agent of uros over the recorded transport.

In each stream our answers must equal those of the recorded agent: order, kind, request, object,
status, data. support.replay describes what is not compared, and why.
"""

import pytest
from support import recorded
from support.agent import running_agent
from support.client import XrceClient
from support.middleware import MIDDLEWARE
from support.replay import CAPTURES, Mismatch, Replay, messages

from uros.wire import ids

NAMES = sorted(path.stem for path in CAPTURES.glob("*.jsonl"))

# Topics that nodes outside of the capture published: topic and type.
OUTSIDE = {
    "subscribe_reliable": ("HelloWorldTopic", "HelloWorld"),
    "rclc_int32_subscriber": ("rt/std_msgs_msg_Int32", "std_msgs::msg::dds_::Int32_"),
}


def transports_of(name):
    if name.startswith("serial"):
        return ("serial", "pseudoterminal")
    return ("tcp",) if name.startswith("tcp") else ("udp",)


PLAYS = [(name, transport) for name in NAMES for transport in transports_of(name)]


def cancels(replay):
    """The READ_DATA of a capture that cancel a delivery: (client, request id, object id)."""
    return [
        (client, *(int.from_bytes(payload[at : at + 2], "big") for at in (0, 2)))
        for client, message in messages(replay.name, replay.records, True)
        for kind, _, payload in recorded.submessages(message)
        if kind == ids.READ_DATA and payload[7] and payload[8:10] == b"\0\0"
    ]


def test_all_captures_are_here():
    assert len(NAMES) == 17


@pytest.mark.parametrize("middleware", [MIDDLEWARE, "memory"])
@pytest.mark.parametrize(("name", "transport"), PLAYS, ids=["-".join(play) for play in PLAYS])
def test_answers_are_those_of_the_recorded_agent(name, transport, middleware, own_domain_id):
    with running_agent(transport, middleware, own_domain_id) as agent:
        outside = None
        if name in OUTSIDE:
            publisher = XrceClient(agent.line(7), key=0x70000001)
            publisher.open()
            writer = publisher.writer("outside", *OUTSIDE[name])

            def outside(sample):
                publisher.write(writer, sample)

        replay = Replay(name, agent.line, outside)
        replay.run()
        # The recorded agent does not answer a READ_DATA that cancels, and its client waits for a
        # second. Ours answers outside of the reliable streams, whose numbers stay the same.
        assert [str(reply).partition(": ")[2] for reply in replay.best_effort] == [
            f"STATUS request {request}, object 0x{thing:04X}, OK/0"
            for _, request, thing in cancels(replay)
        ]
        assert sum(len(replies) for replies in replay.received.values()) > 0


def test_a_mismatch_shows_both_sides(own_domain_id, monkeypatch):
    """The comparison raises Mismatch for an agent with another STATUS, with both in its text."""
    from uros.wire import session

    push_status = session.push_status

    def push_matched(w, request_id, object_id, status, implementation=0):
        push_status(w, request_id, object_id, ids.STATUS_OK_MATCHED, implementation)

    monkeypatch.setattr(session, "push_status", push_matched)
    with running_agent("udp", "memory", own_domain_id) as agent:
        with pytest.raises(Mismatch) as failed:
            Replay("publish_reliable", agent.line).run()
    text = str(failed.value)
    assert "- client 0 stream 0x80 no. 0: STATUS request 10, object 0x0011, OK/0" in text
    assert "+ client 0 stream 0x80 no. 0: STATUS request 10, object 0x0011, OK_MATCHED/0" in text
