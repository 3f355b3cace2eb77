"""Every recorded conversation, played into our agent over the transport it was recorded on.

In each stream our answers must be those of the recorded agent: order, kind, request, object,
status, data. See support.replay for what is not compared and why.
"""

import pytest
from support import recorded
from support.agent import running_agent
from support.client import XrceClient
from support.replay import CAPTURES, Mismatch, Replay, messages

from uros.wire import ids

NAMES = sorted(path.stem for path in CAPTURES.glob("*.jsonl"))

# What others published when the capture was made: topic and type.
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
    """The READ_DATA in a capture that stop a delivery: (client, request id, object id)."""
    return [
        (client, *(int.from_bytes(payload[at : at + 2], "big") for at in (0, 2)))
        for client, message in messages(replay.name, replay.records, True)
        for kind, _, payload in recorded.submessages(message)
        if kind == ids.READ_DATA and payload[7] and payload[8:10] == b"\0\0"
    ]


def test_all_captures_are_here():
    assert len(NAMES) == 17


@pytest.mark.parametrize("middleware", ["dds", "memory"])
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
        # The recorded agent leaves a cancelled READ_DATA unanswered, and its client waits for
        # a second. Ours says so, where it disturbs no number of a reliable stream.
        assert [str(it).partition(": ")[2] for it in replay.best_effort] == [
            f"STATUS request {request}, object 0x{thing:04X}, OK/0"
            for _, request, thing in cancels(replay)
        ]
        assert sum(len(it) for it in replay.got.values()) > 0


def test_a_capture_that_differs_is_told_with_both_sides(own_domain_id, monkeypatch):
    """The comparison itself: an agent whose STATUS is another is found out."""
    from uros.wire import session

    push_status = session.push_status

    def other(w, request_id, object_id, status, implementation=0):
        push_status(w, request_id, object_id, ids.STATUS_OK_MATCHED, implementation)

    monkeypatch.setattr(session, "push_status", other)
    with running_agent("udp", "memory", own_domain_id) as agent:
        with pytest.raises(Mismatch) as failed:
            Replay("publish_reliable", agent.line).run()
    said = str(failed.value)
    assert "- client 0 stream 0x80 no. 0: STATUS request 10, object 0x0011, OK/0" in said
    assert "+ client 0 stream 0x80 no. 0: STATUS request 10, object 0x0011, OK_MATCHED/0" in said
