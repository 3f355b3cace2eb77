"""Whatever comes from the line: no exception, it is counted, and what is sound still works."""

from hypothesis import given, settings
from hypothesis import strategies as st
from support.board import KEY, FakeAgent, FakeClock, built, message, number_bytes
from support.examples import examples
from support.recorder import Recorder
from uros.interfaces.std_msgs.msg import Int32, String
from uros.interfaces.std_srvs.srv import Trigger

from uros.client import AGENT_CONNECTED, Node
from uros.wire import session

EXAMPLES = settings(max_examples=examples(400), deadline=None)

kinds = st.sampled_from(range(17))
streams = st.sampled_from([0, 0, 1, 2, 0x7F, 0x80, 0x80, 0x80, 0x81, 0xFF])
numbers = st.one_of(st.integers(0, 20), st.integers(0, 0xFFFF))
payloads = st.one_of(
    st.binary(max_size=60),
    st.builds(lambda *it: built(session.push_acknack, *it), numbers, numbers, streams),
    st.builds(lambda *it: built(session.push_heartbeat, *it), numbers, numbers, streams),
    st.builds(lambda *it: built(session.push_status, *it), numbers, numbers, st.integers(0, 255)),
)
plausible = st.builds(
    message, kinds, payloads, streams, numbers, st.sampled_from([0x80, 0x81, 0x82]),
    st.integers(0, 255),
)  # fmt: skip
datagrams = st.lists(st.one_of(plausible, st.binary(max_size=40)), max_size=30)


def check(one):
    """What must hold of a session whatever has come."""
    assert one.in_flight() <= 16
    numbers = [(one.acked + i) & 15 for i in range(one.in_flight())]
    waiting = sum(map(len, one.waiting))
    assert one.size() == sum(one._size(one.slots[i]) for i in numbers) + waiting
    assert len(one._in.waiting) < 16
    assert one._fragments.pending <= one.limit


@EXAMPLES
@given(datagrams)
def test_a_session_survives_any_datagrams(received):
    one = Recorder(KEY, 128, 2000)
    for now, it in enumerate(received):
        one.receive(it, now)
        one.write(5, String(data="x" * (now * 17 % 300)), b"", True)
        one.tick(now * 40)
        check(one)
    assert all(len(it) <= 128 for it in one.sent)


@EXAMPLES
@given(datagrams)
def test_a_node_survives_any_datagrams_and_works(received):
    clock = FakeClock()
    agent = FakeAgent(clock)
    node = Node("node", agent, key=KEY, clock=clock)
    node.connection.log = lambda text: None
    heard, answers = [], []
    publisher = node.create_publisher(Int32, "topic")
    node.create_subscription(Int32, "topic", lambda it: heard.append(it.data))
    node.create_service(Trigger, "service", lambda request, response: response)
    client = node.create_client(Trigger, "client")

    def spin(ms):
        end = clock.t + ms * 1000
        while clock.t < end:
            node.spin_once((end - clock.t) / 1000000)
            check(node.connection)

    spin(100)
    assert node.state == AGENT_CONNECTED
    for it in received:
        agent.post(it)
        client.call_async(Trigger.Request()).add_done_callback(answers.append)
    spin(2000)
    # What it was told may have ended its session, or spoilt it, as the line's or agent's end would;
    # after another agent it is as good as new.
    agent.silent = True
    spin(5000)
    agent.silent = False
    agent.forget()
    spin(3000)
    assert node.state == AGENT_CONNECTED
    del heard[:]
    agent.sample(0x16, number_bytes(7))
    assert publisher.publish(Int32(data=8))
    spin(100)
    assert heard == [7] and (0x05, number_bytes(8)) in agent.samples
    assert len(answers) == len(received)
