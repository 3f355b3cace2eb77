"""Any datagrams from the line: no exception is raised, and valid messages still work."""

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
    st.builds(lambda *values: built(session.push_acknack, *values), numbers, numbers, streams),
    st.builds(lambda *values: built(session.push_heartbeat, *values), numbers, numbers, streams),
    st.builds(
        lambda *values: built(session.push_status, *values), numbers, numbers, st.integers(0, 255)
    ),
)
plausible = st.builds(
    message, kinds, payloads, streams, numbers, st.sampled_from([0x80, 0x81, 0x82]),
    st.integers(0, 255),
)  # fmt: skip
datagrams = st.lists(st.one_of(plausible, st.binary(max_size=40)), max_size=30)


def check(recorder):
    """Check the invariants of a session."""
    assert recorder.in_flight() <= 16
    numbers = [(recorder.acked + i) & 15 for i in range(recorder.in_flight())]
    waiting = sum(map(len, recorder.waiting))
    assert recorder.size() == sum(recorder._size(recorder.slots[i]) for i in numbers) + waiting
    assert len(recorder._in.waiting) < 16
    assert recorder._fragments.pending <= recorder.limit


@EXAMPLES
@given(datagrams)
def test_a_session_survives_any_datagrams(received):
    recorder = Recorder(KEY, 128, 2000)
    for now, datagram in enumerate(received):
        recorder.receive(datagram, now)
        recorder.write(5, String(data="x" * (now * 17 % 300)), b"", True)
        recorder.tick(now * 40)
        check(recorder)
    assert all(len(datagram) <= 128 for datagram in recorder.sent)


@EXAMPLES
@given(datagrams)
def test_a_node_survives_any_datagrams_and_works(received):
    clock = FakeClock()
    agent = FakeAgent(clock)
    node = Node("node", agent, key=KEY, clock=clock)
    node.connection.log = lambda text: None
    heard, answers = [], []
    publisher = node.create_publisher(Int32, "topic")
    node.create_subscription(Int32, "topic", lambda message: heard.append(message.data))
    node.create_service(Trigger, "service", lambda request, response: response)
    client = node.create_client(Trigger, "client")

    def spin(ms):
        end = clock.t + ms * 1000
        while clock.t < end:
            node.spin_once((end - clock.t) / 1000000)
            check(node.connection)

    spin(100)
    assert node.state == AGENT_CONNECTED
    for datagram in received:
        agent.post(datagram)
        client.call_async(Trigger.Request()).add_done_callback(answers.append)
    spin(2000)
    # The datagrams may have ended or corrupted its session; with another agent it works again.
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
