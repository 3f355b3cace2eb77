"""The node and its entities, with a scripted agent. Also runs on MicroPython."""

from support.board import (
    KEY,
    Ask,
    Blob,
    FakeAgent,
    FakeClock,
    Number,
    built,
    number_bytes,
    pattern,
)
from support.services import raised

from uros import qos
from uros.client import (
    AGENT_AVAILABLE,
    AGENT_CONNECTED,
    AGENT_DISCONNECTED,
    WAITING_AGENT,
    Node,
)
from uros.client.executor import ALWAYS
from uros.client.node import board_key
from uros.wire import ids, session
from uros.wire.cdr import Reader
from uros.wire.entities import (
    pull_binary_endpoint,
    pull_binary_participant,
    pull_binary_service,
    pull_binary_topic,
    pull_create,
)


class Bench:
    """A node and its scripted agent."""

    def __init__(self, name="node", namespace="", domain_id=0, connect=True, **options):
        self.clock = FakeClock()
        self.agent = FakeAgent(self.clock)
        self.node = Node(name, self.agent, namespace, domain_id, KEY, clock=self.clock, **options)
        self.states = []
        self.node.on_state = self.states.append
        self.node.connection.log = self.fail_at_log
        if connect:
            self.until(AGENT_CONNECTED)

    def fail_at_log(self, text):
        raise AssertionError(text)

    def run(self, ms=10):
        end = self.clock.t + ms * 1000
        while self.clock.t < end:
            self.node.spin_once((end - self.clock.t) / 1000000)

    def until(self, state):
        for _ in range(1000):
            if self.node.state == state:
                return
            self.node.spin_once(0.01)
        raise AssertionError((state, self.states))

    def lose(self):
        """Lose the agent; another one starts."""
        self.agent.silent = True
        self.until(WAITING_AGENT)
        self.agent.silent = False
        self.agent.forget()

    def created(self):
        """Return (object id, parent, values) of each CREATE."""
        out = []
        for _, payload in self.agent.creations:
            values = pull_create(Reader(payload, 0, len(payload), True))
            _, object_id, kind, form, content, parent = values
            assert form == ids.IN_BINARY
            r = Reader(content, 0, len(content), True)
            if kind == ids.KIND_PARTICIPANT:
                content = pull_binary_participant(r)
            elif kind == ids.KIND_TOPIC:
                content = pull_binary_topic(r)
            elif kind in (ids.KIND_DATAWRITER, ids.KIND_DATAREADER):
                content = pull_binary_endpoint(r, kind == ids.KIND_DATAREADER)
            elif kind in (ids.KIND_REQUESTER, ids.KIND_REPLIER):
                content = pull_binary_service(r)
            else:
                content = ()
            out.append((object_id, parent, content))
        return out


def quiet(bench, call):
    """Call ``call()`` and return the exceptions of callbacks."""
    errors = []
    bench.node.executor.report = errors.append
    call()
    return errors


# --- names ------------------------------------------------------------------------------------


def test_names_are_resolved() -> None:
    for namespace, given, full in (
        ("", "topic", "/topic"),
        ("", "a/b", "/a/b"),
        ("", "/a/b", "/a/b"),
        ("", "~/topic", "/node/topic"),
        ("", "~", "/node"),
        ("ns", "topic", "/ns/topic"),
        ("/ns", "topic", "/ns/topic"),
        ("/ns/", "topic", "/ns/topic"),
        ("/a/b", "c", "/a/b/c"),
        ("/a/b", "/c", "/c"),
        ("/a/b", "~/c", "/a/b/node/c"),
    ):
        bench = Bench("node", namespace, connect=False)
        assert bench.node.resolve(given) == full, (namespace, given)
        assert bench.node.create_publisher(Number, given).name == full
    assert Bench(connect=False).node.get_namespace() == "/"
    node = Bench("node", "/a/b/", connect=False).node
    assert (node.get_name(), node.get_namespace()) == ("node", "/a/b")
    assert node.get_fully_qualified_name() == "/a/b/node"


def test_bad_names_are_refused_with_the_rule() -> None:
    node = Bench(connect=False).node
    for name, rule in (
        ("", "1 to 200"),
        ("x" * 201, "1 to 200"),
        ("a//b", "parts that begin"),
        ("a/", "parts that begin"),
        ("//a", "parts that begin"),
        ("/", "1 to 200"),
        ("1a", "parts that begin"),
        ("a/1b", "parts that begin"),
        ("a__b", "parts that begin"),
        ("a-b", "letters, digits and _"),
        ("a b", "letters, digits and _"),
        ("käfer", "letters, digits and _"),
        ("a~", "letters, digits and _"),
        ("~a", ""),
        ("~//a", ""),
        ("~/a/", ""),
        ("\u212a", "letters, digits and _"),  # KELVIN SIGN, whose small letter is k
        ("\u0130", "letters, digits and _"),
        ("\u0660", "letters, digits and _"),  # ARABIC-INDIC DIGIT ZERO
    ):
        for create in (
            lambda name: node.create_publisher(Number, name),
            lambda name: node.create_subscription(Number, name, print),
            lambda name: node.create_service(Ask, name, print),
            lambda name: node.create_client(Ask, name),
        ):
            text = raised(ValueError, create, name)
            assert rule in text and "topic" in text, (name, text)
    assert len(node.executor.handles) == 0
    for name in ("", "a/b", "1", "a-b", "\u212a"):
        assert "node" in raised(ValueError, lambda wrong: Bench(wrong, connect=False), name)
    for name in ("a//b", "1", "a-b"):
        assert "namespace" in raised(
            ValueError, lambda wrong: Bench("n", wrong, connect=False), name
        )
    for name in ("a", "_a", "a_b", "A9", "_hidden/x", "a/b/c/d"):
        node.create_publisher(Number, name)


def test_the_participants_name_is_that_of_micro_ros() -> None:
    for namespace, name in (  # recorded: rclc_int32_publisher, rclc_temperature_humidity
        ("", "weather"), ("/", "weather"), ("garden", "/garden/weather"),
        ("/garden/back", "/garden/back/weather"),
    ):  # fmt: skip
        bench = Bench("weather", namespace, 42)
        assert bench.created() == [(0x01, 42, (name, None))]


def test_the_default_key_has_32_bits() -> None:
    assert 0 < board_key("a") <= 0xFFFFFFFF
    clock = FakeClock()
    node = Node("node", FakeAgent(clock), clock=clock)
    assert 0 < node.connection.key <= 0xFFFFFFFF


# --- publishers -------------------------------------------------------------------------------


def test_a_publishers_objects_and_samples() -> None:
    bench = Bench("node", "ns", connect=False)
    first = bench.node.create_publisher(Number, "one", 5)
    two = bench.node.create_publisher(Number, "/two")
    assert not first.publish(Number(1)) and first.dropped == 1
    bench.until(AGENT_CONNECTED)
    number = "test_msgs::msg::dds_::Number_"
    none = (None, None, None, None)
    assert bench.created() == [
        (0x01, 0, ("/ns/node", None)),
        (0x02, 0x01, ("rt/ns/one", number)),
        (0x03, 0x01, ()),
        (0x05, 0x03, (0x02, (3, 5, None) + none)),
        (0x12, 0x01, ("rt/two", number)),
        (0x13, 0x01, ()),
        (0x15, 0x13, (0x12, (3, 10, None) + none)),
    ]
    assert first.publish(Number(1)) and two.publish(Number(2)) and first.publish(Number(3))
    assert bench.agent.samples == [
        (0x05, number_bytes(1)), (0x15, number_bytes(2)), (0x05, number_bytes(3)),
    ]  # fmt: skip
    assert (first.published, first.dropped, two.published) == (2, 1, 1)


def test_a_publisher_follows_its_profile() -> None:
    bench = Bench(connect=False)
    profile = qos.sensor_data_profile()
    profile.deadline_ms = 100
    profile.lifespan_ms = 200
    quick = bench.node.create_publisher(Number, "quick", profile)
    latched = qos.QoSProfile(depth=1, durability=qos.DurabilityPolicy.TRANSIENT_LOCAL)
    bench.node.create_publisher(Number, "latched", latched)
    bench.until(AGENT_CONNECTED)
    endpoints = [
        creation[2][1][:4]
        for creation in bench.created()
        if creation[0] & 15 == ids.KIND_DATAWRITER
    ]
    assert endpoints == [
        (ids.QOS_KEEP_LAST, 5, 100, 200),
        (ids.QOS_RELIABLE | ids.QOS_KEEP_LAST | ids.QOS_TRANSIENT_LOCAL, 1, None, None),
    ]
    before = len(bench.agent.sent)
    assert quick.publish(Number(1))
    assert bench.agent.sent[before][1] == ids.STREAM_BEST_EFFORT
    assert bench.node.connection.held() == 0


def test_publishing_without_room_is_counted() -> None:
    bench = Bench(connect=False, limit=2000)
    publisher = bench.node.create_publisher(Blob, "topic")
    bench.until(AGENT_CONNECTED)
    bench.agent.silent = True
    results = [publisher.publish(Blob(bytes(88))) for _ in range(30)]
    assert results == [True] * 20 + [False] * 10
    assert (publisher.published, publisher.dropped) == (20, 10)
    bench.until(WAITING_AGENT)
    assert bench.node.connection.unconfirmed == 20
    assert not publisher.publish(Blob())


def test_a_publisher_works_across_the_wrap_of_numbers_and_request_ids() -> None:
    for start in (65490, 65520, 65535):
        bench = Bench(connect=False)
        publishers = [bench.node.create_publisher(Number, "topic%d" % i, 10) for i in range(2)]
        bench.until(AGENT_CONNECTED)
        bench.run(300)
        session = bench.node.connection
        assert session.next == session.acked == bench.agent.into.next
        # As after about 65500 messages, ten minutes at 100 Hz.
        session.next = session.acked = bench.agent.into.next = start
        bench.agent.into.announced = start - 1
        session.request_id = start
        before = len(bench.agent.sent)
        for i in range(200):
            # Acknowledged after every five samples: the window is never full.
            assert publishers[i % 2].publish(Number(i))
            if i % 5 == 4:
                bench.run(10)
        sent = [
            datagram for datagram in bench.agent.sent[before:] if datagram[1] == ids.STREAM_RELIABLE
        ]
        assert bench.agent.samples == [(5 + 16 * (i % 2), number_bytes(i)) for i in range(200)]
        assert [datagram[2] | datagram[3] << 8 for datagram in sent] == [
            start + i & 0xFFFF for i in range(200)
        ]
        # Ids below 10 are reserved.
        due = list(range(start, 65536)) + list(range(10, 1000))
        assert [datagram[8] << 8 | datagram[9] for datagram in sent] == due[:200]
        assert session.held() == 0 and bench.node.connection.connections == 1


def test_the_fast_path_of_publish_writes_ids_of_two_octets() -> None:
    bench = Bench(connect=False)
    publishers = [bench.node.create_publisher(Number, "topic%d" % i, 10) for i in range(20)]
    bench.until(AGENT_CONNECTED)
    for turn in range(2):
        bench.agent.samples.clear()
        for i in range(20):
            assert publishers[i].publish(Number(i))
            bench.run(10)
        assert bench.agent.samples == [(i << 4 | 5, number_bytes(i)) for i in range(20)], turn


def test_the_fast_path_of_publish_is_for_reliable_messages_of_its_own_type() -> None:
    class Other(Number):
        _TYPE = "test_msgs/msg/Other"

    bench = Bench(connect=False)
    publisher = bench.node.create_publisher(Number, "topic", 10)
    loose = bench.node.create_publisher(
        Number, "loose", qos.QoSProfile(1, reliability=qos.ReliabilityPolicy.BEST_EFFORT)
    )
    bench.until(AGENT_CONNECTED)
    for _ in range(3):  # from the second sample on there is a buffer
        assert publisher.publish(Number(1))
        bench.run(10)
        sent = len(bench.agent.sent)
        raised(TypeError, publisher.publish, Other(1))
        assert len(bench.agent.sent) == sent
        assert loose.publish(Number(2))
        assert bench.agent.sent[-1][1] == ids.STREAM_BEST_EFFORT


def test_a_publisher_created_while_connected_sends_nothing_before_its_datawriter() -> None:
    bench = Bench()
    publisher = bench.node.create_publisher(Number, "topic", 0)
    assert not publisher.publish(Number(1)) and publisher.dropped == 1
    bench.run(10)
    assert publisher.publish(Number(2)) and bench.agent.samples == [(5, number_bytes(2))]


def test_malformed_samples_are_reported_once_and_a_full_queue_is_not_overfull() -> None:
    bench, heard = subscribed(depth=2)
    errors = []
    bench.node.executor.report = errors.append
    for _ in range(3):
        bench.agent.sample(0x06, b"abc")
    bench.run()
    subscription = bench.node._entities[-1]
    assert subscription.malformed == 3 and len(errors) == 1
    for size in (1, 2, 3):
        subscription._queue.append(Number(size))
        assert subscription.overfull() == (size > 2)


def test_the_fast_path_of_publish_sends_the_same_bytes() -> None:
    for start in (0, 9, 10, 255, 256, 32767, 32768, 65519, 65534, 65535):
        sent = []
        for short in (False, True):
            bench = Bench(connect=False)
            publisher = bench.node.create_publisher(Number, "topic", 10)
            bench.until(AGENT_CONNECTED)
            bench.run(300)
            session = bench.node.connection
            session.next = session.acked = bench.agent.into.next = start
            bench.agent.into.announced = start - 1 & 0xFFFF
            session.request_id = start or 10
            publisher.publish(Number(-1))
            bench.run(10)
            before = len(bench.agent.sent)
            for i in range(12):
                assert (session.stack[session.free] is not None) == (i < 1)
                if short and i:
                    session.stack = session._idle
                    session.free = 1
                    session._idle[1] = bytearray(64)
                elif not short:
                    publisher._direct = None
                assert publisher.publish(Number(1000000007 * i))
            sent.append(bench.agent.sent[before:])
            assert session.next == start + 13 & 0xFFFF and publisher.published == 13
            bench.run(10)
            assert session.held() == 0 and len(bench.agent.samples) == 13
        assert sent[0] == sent[1], start


def test_publish_refuses_other_types_and_too_large_messages() -> None:
    bench = Bench(connect=False)
    publisher = bench.node.create_publisher(Blob, "topic")
    for connected in (False, True):
        if connected:
            bench.until(AGENT_CONNECTED)
        for wrong in (Number(1), 5, None, "text"):
            text = raised(TypeError, publisher.publish, wrong)
            assert "/topic" in text and "Blob" in text, text
    assert "40012" in raised(ValueError, publisher.publish, Blob(bytes(40000)))
    assert bench.agent.samples == [] and publisher.published == 0


def test_a_large_sample_arrives_whole() -> None:
    bench = Bench(connect=False, limit=100000)
    publisher = bench.node.create_publisher(Blob, "image")
    bench.until(AGENT_CONNECTED)
    del bench.agent.sent[:]
    assert publisher.publish(Blob(pattern(70000)))
    bench.run(100)
    octets = b""
    for datagram in bench.agent.sent:
        if datagram[4] == ids.FRAGMENT:
            octets += datagram[8:]
    assert octets[8:] == pattern(70000) and bench.node.connection.held() == 0


# --- subscriptions ----------------------------------------------------------------------------


def subscribed(depth=10, **options):
    bench = Bench(connect=False, **options)
    heard = []
    bench.subscription = bench.node.create_subscription(
        Number, "topic", lambda message: heard.append(message.value), depth
    )
    bench.until(AGENT_CONNECTED)
    return bench, heard


def test_a_subscriptions_objects_and_samples() -> None:
    bench, heard = subscribed()
    assert bench.created()[1:] == [
        (0x02, 0x01, ("rt/topic", "test_msgs::msg::dds_::Number_")),
        (0x04, 0x01, ()),
        (0x06, 0x04, (0x02, (3, 10, None, None, None, None, None))),
    ]
    assert bench.agent.requests[-1] == (ids.READ_DATA, 0x06)
    for i in range(40):
        bench.agent.sample(0x06, number_bytes(i))
    bench.run()
    assert heard == list(range(40)) and bench.subscription.lost == 0


def test_a_subscription_reads_on_the_stream_of_its_profile() -> None:
    for profile, stream in ((qos.sensor_data_profile(), 0x01), (10, 0x80)):
        bench, _ = subscribed(profile)
        reads = [datagram for datagram in bench.agent.sent if datagram[4] == ids.READ_DATA]
        assert reads[0][10:13] == bytes((0x00, 0x06, stream))


def test_big_endian_samples_are_read() -> None:
    bench, heard = subscribed()
    bench.agent.reliable(ids.DATA, b"\0\x0e\0\x06\0\0\0\x07", 0)
    bench.run()
    assert heard == [7]


def test_trailing_octets_of_a_sample_are_ignored() -> None:
    """Real rclpy sends 8 arbitrary octets behind a JointState whose sequences are empty."""
    bench, heard = subscribed()
    bench.agent.sample(0x06, number_bytes(5) + b"\x0b\0\0\0\0\xbc\x14\xa5")
    bench.run()
    assert heard == [5] and not bench.subscription.malformed


def test_malformed_samples_are_counted() -> None:
    bench, heard = subscribed()
    for octets in (b"", b"abc", number_bytes(5)):
        bench.agent.sample(0x06, octets)
    bench.agent.sample(0x26, number_bytes(6))  # for no object
    bench.run()
    assert heard == [5] and bench.subscription.malformed == 2


def test_a_full_queue_drops_the_oldest_and_counts_them() -> None:
    """As during a callback that pumps for long; a spinning node stops receiving before that."""
    bench, heard = subscribed(3)
    for i in range(50):
        bench.agent.sample(0x06, number_bytes(i))
        bench.node.connection.pump(0)
    assert bench.subscription.overfull() and bench.subscription.lost == 15
    bench.run()
    assert heard == list(range(15, 50))
    assert not bench.subscription.overfull()


def test_slow_callbacks_lose_nothing_of_a_reliable_topic() -> None:
    bench, heard = subscribed(3)
    bench.subscription.callback = lambda message: (
        heard.append(message.value),
        bench.clock.sleep(5),
    )
    for i in range(100):
        bench.agent.sample(0x06, number_bytes(i))
    bench.run(2000)
    assert heard == list(range(100)) and bench.subscription.lost == 0


def test_callbacks_run_before_more_samples_are_received() -> None:
    """A datagram may have several samples: none is received while the queue is overfull."""
    bench, heard = subscribed(3)
    for i in range(50):
        datagram = b"\x81\0\0\0"
        for j in range(5):
            datagram += b"\x09\x01\x08\0\0\x0e\0\x06" + number_bytes(5 * i + j)
        bench.agent.post(datagram)
    bench.run()
    assert heard == list(range(250)) and bench.subscription.lost == 0


def test_a_subscription_with_always_is_called_without_samples() -> None:
    bench, heard = subscribed()
    bench.subscription.callback = heard.append
    bench.subscription.invocation = ALWAYS
    bench.node.create_timer(0.01, lambda: None)
    bench.run(25)
    assert heard == [None, None]
    bench.agent.sample(0x06, number_bytes(5))
    bench.run(2)
    assert heard == [None, None, Number(5)]


def test_a_callback_that_raises_loses_no_samples() -> None:
    bench, heard = subscribed()

    def callback(message):
        heard.append(message.value)
        raise RuntimeError("mine")

    bench.subscription.callback = callback
    for i in range(3):
        bench.agent.sample(0x06, number_bytes(i))
    errors = quiet(bench, lambda: bench.run())
    assert heard == [0, 1, 2] and len(errors) == 3 == bench.node.executor.failed


def test_a_destroyed_subscription_is_deleted_and_not_called() -> None:
    bench, heard = subscribed()
    bench.agent.sample(0x06, number_bytes(1))
    bench.node.connection.pump(0)
    bench.subscription.destroy()
    bench.run()
    assert heard == [] and bench.agent.requests[-3:] == [
        (ids.DELETE, 0x06), (ids.DELETE, 0x04), (ids.DELETE, 0x02),
    ]  # fmt: skip
    bench.lose()
    bench.until(AGENT_CONNECTED)
    assert [creation[0] for creation in bench.created()] == [0x01]
    again = bench.node.create_subscription(Number, "topic", print)
    assert again.number == 1  # numbers are not reused


# --- services ---------------------------------------------------------------------------------

IDENTITY = bytes(range(24))


def serving(callback, **options):
    bench = Bench(connect=False, **options)
    bench.service = bench.node.create_service(Ask, "ask", callback)
    bench.until(AGENT_CONNECTED)
    return bench


def double(request, response):
    response.value = 2 * request.value
    return response


def test_a_services_object_and_replies() -> None:
    bench = serving(double)
    assert bench.created()[1:] == [
        (0x08, 0x01, (
            "/ask", "test_msgs::srv::dds_::Ask_Request_", "test_msgs::srv::dds_::Ask_Response_",
            "rq/askRequest", "rr/askReply",
        ))
    ]  # fmt: skip
    for i in range(3):
        bench.agent.sample(0x08, IDENTITY + number_bytes(i))
    bench.run()
    assert bench.agent.samples == [(0x08, IDENTITY + number_bytes(2 * i)) for i in range(3)]


def test_malformed_requests_are_counted() -> None:
    bench = serving(double)
    for octets in (b"", IDENTITY[:23], IDENTITY, IDENTITY + b"abc"):
        bench.agent.sample(0x08, octets)
    bench.run()
    assert bench.agent.samples == [] and bench.service.malformed == 4


def test_a_reply_is_kept_while_there_is_no_room() -> None:
    bench = serving(double, limit=1000)
    publisher = bench.node.create_publisher(Blob, "blob")
    bench.run()
    asked = []
    bench.service.callback = lambda request, response: (
        asked.append(request.value), double(request, response),
    )[1]  # fmt: skip
    for i in range(3):
        bench.agent.sample(0x08, IDENTITY + number_bytes(i))
    acknowledge = bench.agent.acknowledge
    bench.agent.acknowledge = lambda: None
    while publisher.publish(Blob(bytes(8))):
        pass
    for _ in range(20):
        bench.node.spin_once(0.001)
    assert asked == [0] and len(bench.agent.samples) < 60
    bench.agent.acknowledge = acknowledge
    bench.run(500)
    assert asked == [0, 1, 2]
    answers = [sample[1] for sample in bench.agent.samples if sample[0] == 0x08]
    assert answers == [IDENTITY + number_bytes(2 * i) for i in range(3)]


def test_a_pending_reply_is_not_sent_in_the_next_session() -> None:
    bench = serving(double, limit=200)
    publisher = bench.node.create_publisher(Blob, "blob")
    bench.run()
    bench.agent.sample(0x08, IDENTITY + number_bytes(1))
    bench.agent.sample(0x08, IDENTITY + number_bytes(2))
    bench.agent.acknowledge = lambda: None
    while publisher.publish(Blob(bytes(8))):
        pass
    bench.run(50)
    bench.lose()
    del bench.agent.acknowledge
    bench.until(AGENT_CONNECTED)
    bench.run(100)
    assert bench.agent.samples == []


def test_a_service_callback_that_returns_none_is_reported() -> None:
    bench = serving(lambda request, response: None)
    bench.agent.sample(0x08, IDENTITY + number_bytes(1))
    errors = quiet(bench, lambda: bench.run())
    assert len(errors) == 1 and "/ask" in str(errors[0]) and bench.agent.samples == []
    bench.service.callback = double
    bench.agent.sample(0x08, IDENTITY + number_bytes(1))
    bench.run()
    assert len(bench.agent.samples) == 1


# --- clients ----------------------------------------------------------------------------------


def calling():
    bench = Bench(connect=False)
    bench.client = bench.node.create_client(Ask, "ask")
    return bench


def answer(bench, request, value):
    bench.agent.sample(0x07, bytes((request >> 8, request & 0xFF, 0, 7)) + number_bytes(value))


def last_request(bench):
    """Return the request id of the last WRITE_DATA."""
    sent = [datagram for datagram in bench.agent.sent if datagram[4] == ids.WRITE_DATA]
    return sent[-1][8] << 8 | sent[-1][9]


def test_a_call_and_its_reply() -> None:
    bench = calling()
    bench.until(AGENT_CONNECTED)
    assert bench.created()[1][0] == 0x07
    futures, requests = [], []
    for i in range(3):
        futures.append(bench.client.call_async(Ask.Request(i)))
        requests.append(last_request(bench))
    assert [future.done() for future in futures] == [False] * 3 and futures[0].result() is None
    assert bench.agent.samples == [(0x07, number_bytes(i)) for i in range(3)]
    results = []
    for future in futures:
        future.add_done_callback(lambda future: results.append(future.result().value))
    for i in (1, 0, 2):
        answer(bench, requests[i], 10 * i)
    answer(bench, requests[1], 99)  # repeated
    answer(bench, 5, 99)  # of no request
    bench.run()
    assert results == [10, 0, 20] and [future.done() for future in futures] == [True] * 3
    futures[0].add_done_callback(lambda future: results.append("at once"))
    assert results[-1] == "at once" and futures[0].exception() is None


def test_replies_in_any_order_complete_their_own_calls() -> None:
    for order in ((1, 0), (2, 1, 0), (2, 0, 1), (3, 1, 2, 0)):
        bench = calling()
        bench.until(AGENT_CONNECTED)
        bench.node.connection.request_id = 0x3CFE  # both octets of an id matter
        futures, requests, done = [], [], []
        for i in range(len(order)):
            futures.append(bench.client.call_async(Ask.Request(i)))
            futures[i].add_done_callback(lambda future, i=i, done=done: done.append(i))
            requests.append(last_request(bench))
        for i in order:
            answer(bench, requests[i], 10 * i)
            answer(bench, requests[i], 999)  # repeated: no request is pending
            bench.run()
            assert [future.done() for future in futures] == [k in done for k in range(len(futures))]
        assert done == list(order)
        assert [future.result().value for future in futures] == [10 * i for i in range(len(order))]


def test_a_call_without_an_agent_fails_at_once() -> None:
    bench = calling()
    future = bench.client.call_async(Ask.Request(1))
    assert future.done() and isinstance(future.exception(), OSError)
    assert "/ask" in raised(OSError, future.result)


def test_calls_fail_when_the_session_is_lost() -> None:
    bench = calling()
    bench.until(AGENT_CONNECTED)
    finished = []
    futures = [bench.client.call_async(Ask.Request(i)) for i in range(3)]
    for future in futures:
        future.add_done_callback(finished.append)
    bench.lose()
    bench.run(100)
    assert finished == futures
    for future in futures:
        assert future.done() and "/ask" in raised(OSError, future.result)
    bench.until(AGENT_CONNECTED)
    future = bench.client.call_async(Ask.Request(1))
    answer(bench, last_request(bench), 7)
    bench.run()
    assert future.result() == Ask.Response(7)


def test_a_malformed_reply_fails_its_call() -> None:
    bench = calling()
    bench.until(AGENT_CONNECTED)
    future = bench.client.call_async(Ask.Request(1))
    request = last_request(bench)
    bench.agent.sample(0x07, b"abc")
    bench.agent.sample(0x07, bytes((request >> 8, request & 0xFF, 0, 7)) + b"ab")
    bench.run()
    assert bench.client.malformed == 2 and isinstance(future.exception(), OSError)


def test_a_call_refused_by_the_agent_fails_and_the_session_continues() -> None:
    bench = calling()
    bench.until(AGENT_CONNECTED)
    futures, requests = [], []
    for i in range(2):
        futures.append(bench.client.call_async(Ask.Request(i)))
        requests.append(last_request(bench))
    refused = built(session.push_status, requests[1], 0x07, ids.STATUS_ERR_DDS_ERROR)
    bench.agent.reliable(ids.STATUS, refused)
    bench.run()
    assert "refused" in raised(OSError, futures[1].result) and not futures[0].done()
    answer(bench, requests[0], 7)
    bench.run()
    assert futures[0].result() == Ask.Response(7)
    assert bench.states.count(AGENT_DISCONNECTED) == 0


def test_a_reply_to_a_removed_request_is_ignored() -> None:
    bench = calling()
    bench.until(AGENT_CONNECTED)
    future = bench.client.call_async(Ask.Request(1))
    bench.client.remove_pending_request(future)
    answer(bench, last_request(bench), 7)
    bench.run()
    assert not future.done()


def test_calls_fail_when_their_client_is_destroyed() -> None:
    bench = calling()
    bench.until(AGENT_CONNECTED)
    future = bench.client.call_async(Ask.Request(1))
    finished = []
    future.add_done_callback(finished.append)
    bench.client.destroy()
    assert finished == [future] and isinstance(future.exception(), OSError)


def test_spin_until_future_complete_waits_for_a_reply() -> None:
    bench = calling()
    bench.until(AGENT_CONNECTED)
    future = bench.client.call_async(Ask.Request(1))
    before = bench.clock.t
    assert not bench.node.spin_until_future_complete(future, 0.5)
    assert 500000 <= bench.clock.t - before < 510000
    answer(bench, last_request(bench), 7)
    assert bench.node.spin_until_future_complete(future, 0.5)
    assert bench.clock.t - before < 520000


def test_a_done_callback_that_raises_is_reported_and_others_are_called() -> None:
    bench = calling()
    bench.until(AGENT_CONNECTED)
    futures = [bench.client.call_async(Ask.Request(i)) for i in range(2)]
    finished = []
    futures[0].add_done_callback(lambda future: 1 // 0)
    futures[1].add_done_callback(finished.append)
    errors = quiet(bench, lambda: (bench.lose(), bench.run(100)))
    assert len(errors) == 1 and finished == [futures[1]] and bench.node.executor.failed == 1


# --- the node ---------------------------------------------------------------------------------


def test_entities_beyond_max_handles_are_not_created() -> None:
    bench = Bench(connect=False)
    bench.node.executor.max_handles = 1
    bench.node.create_subscription(Number, "one", print)
    for create in (
        lambda: bench.node.create_subscription(Number, "two", print),
        lambda: bench.node.create_service(Ask, "two", print),
        lambda: bench.node.create_client(Ask, "two"),
        lambda: bench.node.create_timer(1.0, print),
    ):
        assert "1 handles" in raised(ValueError, create)
    bench.node.create_publisher(Number, "three")  # a publisher is no handle
    bench.until(AGENT_CONNECTED)
    names = [creation[2][0] for creation in bench.created() if creation[0] & 15 == ids.KIND_TOPIC]
    assert names == ["rt/one", "rt/three"]
    assert [creation[0] & 15 for creation in bench.created()].count(ids.KIND_REPLIER) == 0


def test_spin_once_waits_exactly_its_timeout() -> None:
    bench = Bench()
    for seconds in (0, 0.001, 0.5, 3):
        before = bench.clock.t
        assert bench.node.spin_once(seconds) is False
        assert bench.clock.t - before == int(seconds * 1000000)
    calls = []
    bench.node.create_timer(0.05, lambda: calls.append(bench.clock.t))
    before = bench.clock.t
    assert bench.node.spin_once() is True
    assert calls == [before + 50000] and bench.clock.t == before + 50000


def test_a_timer_runs_in_every_state_of_the_connection() -> None:
    bench = Bench(connect=False)
    bench.agent.silent = True
    times = []
    start = bench.clock.t
    timer = bench.node.create_timer(0.25, lambda: times.append(bench.clock.t - start))
    bench.run(3000)
    bench.agent.silent = False
    bench.run(3000)
    bench.agent.silent = True
    bench.run(4000)
    bench.agent.fail_open = OSError(2, "no line")
    bench.run(2000)
    assert times == [250000 * (n + 1) for n in range(48)]
    assert bench.states == [
        AGENT_AVAILABLE, AGENT_CONNECTED, AGENT_DISCONNECTED, WAITING_AGENT,
    ]  # fmt: skip
    bench.node.destroy_timer(timer)
    bench.run(1000)
    assert len(times) == 48


def test_stamps_are_the_agents_time() -> None:
    class Stamp:
        high = low = nanosec = 0

    bench = Bench()
    stamp = Stamp()
    last = 0
    for _ in range(300):
        bench.run(33)
        bench.node.clock.stamp(stamp)
        assert 0 <= stamp.nanosec < 1000000000
        now = (stamp.high << 16 | stamp.low) * 1000000 + stamp.nanosec // 1000
        assert abs(now - bench.clock.t - bench.agent.epoch_us) <= 1
        assert now > last
        last = now


def test_two_nodes_share_a_session() -> None:
    bench = Bench("one", connect=False)
    second = Node("two", bench.node.connection, "ns")
    heard = []
    second.create_subscription(Number, "topic", lambda message: heard.append(message.value))
    publisher = bench.node.create_publisher(Number, "topic")
    bench.until(AGENT_CONNECTED)
    created = bench.created()
    assert [(creation[0], creation[1]) for creation in created] == [
        (0x01, 0), (0x11, 0), (0x02, 0x11), (0x04, 0x11), (0x06, 0x04),
        (0x12, 0x01), (0x13, 0x01), (0x15, 0x13),
    ]  # fmt: skip
    assert created[1][2] == ("/ns/two", None) and len(bench.agent.create_clients) == 1
    assert publisher.publish(Number(1))
    bench.agent.sample(0x06, number_bytes(5))
    bench.run(10)
    before = bench.clock.t
    second.spin_once()  # received while the first node was spinning
    assert heard == [5] and bench.clock.t == before


def test_a_destroyed_node_deletes_its_session() -> None:
    bench = Bench(connect=False)
    bench.node.create_publisher(Number, "topic")
    bench.node.create_subscription(Number, "topic", print)
    bench.until(AGENT_CONNECTED)
    bench.node.destroy_node()
    assert bench.agent.session_id == 0 and not bench.agent.is_open
    assert bench.states[-2:] == [AGENT_DISCONNECTED, WAITING_AGENT]
    assert bench.node.executor.handles == []


def test_destroying_a_node_does_not_affect_another_of_its_session() -> None:
    bench = Bench("one", connect=False)
    publisher = bench.node.create_publisher(Number, "topic")
    second = Node("two", bench.node.connection)
    second.create_publisher(Number, "other")
    bench.until(AGENT_CONNECTED)
    second.destroy_node()
    bench.run(10)
    assert bench.node.state == AGENT_CONNECTED and publisher.publish(Number(1))
    assert [request for request in bench.agent.requests if request[0] == ids.DELETE] == [
        (ids.DELETE, 0x15), (ids.DELETE, 0x13), (ids.DELETE, 0x12), (ids.DELETE, 0x11),
    ]  # fmt: skip


# --- QoS --------------------------------------------------------------------------------------


def test_profiles_that_no_agent_supports_are_refused() -> None:
    bench = Bench(connect=False)
    node = bench.node
    manual = qos.QoSProfile(liveliness=qos.LivelinessPolicy.MANUAL_BY_TOPIC)
    latched = qos.qos_profile_action_status_default
    for create, profile, text in (
        (lambda qos_profile: node.create_publisher(Number, "a", qos_profile), manual, "liveliness"),
        (lambda qos_profile: node.create_publisher(Number, "a", qos_profile), 65536, "65536"),
        (lambda qos_profile: node.create_publisher(Number, "a", qos_profile), -1, "-1"),
        (
            lambda qos_profile: node.create_subscription(Number, "a", print, qos_profile),
            manual,
            "liveliness",
        ),
        (
            lambda qos_profile: node.create_subscription(Number, "a", print, qos_profile),
            65536,
            "65536",
        ),
        (
            lambda qos_profile: node.create_service(Ask, "a", print, qos_profile),
            latched,
            "durability",
        ),
        (lambda qos_profile: node.create_client(Ask, "a", qos_profile), latched, "durability"),
    ):
        assert text in raised(ValueError, create, profile)
    assert node.executor.handles == []
    bench.until(AGENT_CONNECTED)
    assert [creation[0] for creation in bench.created()] == [0x01]


def test_the_system_default_profile_is_that_of_dds() -> None:
    bench = Bench(connect=False)
    bench.node.create_publisher(Number, "a", qos.qos_profile_system_default)
    bench.node.create_subscription(Number, "b", print, qos.qos_profile_system_default)
    bench.until(AGENT_CONNECTED)
    endpoints = [
        creation[2][1][:2] for creation in bench.created()
        if creation[0] & 15 in (ids.KIND_DATAWRITER, ids.KIND_DATAREADER)
    ]  # fmt: skip
    keep = ids.QOS_KEEP_LAST
    assert endpoints == [(keep | ids.QOS_RELIABLE, None), (keep, None)]


def test_services_use_the_stream_of_their_profile() -> None:
    quick = qos.QoSProfile(reliability=qos.ReliabilityPolicy.BEST_EFFORT)
    for profile, into, out in ((10, 0x80, 0x80), (quick, 0x01, 0x01)):
        bench = Bench(connect=False)
        bench.node.create_service(Ask, "ask", double, profile)
        client = bench.node.create_client(Ask, "ask", profile)
        bench.until(AGENT_CONNECTED)
        reads = [datagram for datagram in bench.agent.sent if datagram[4] == ids.READ_DATA]
        assert [datagram[12] for datagram in reads] == [into, into]
        del bench.agent.sent[:]
        client.call_async(Ask.Request(1))
        bench.agent.sample(0x08, IDENTITY + number_bytes(4))
        bench.run()
        writes = [datagram[1] for datagram in bench.agent.sent if datagram[4] == ids.WRITE_DATA]
        assert writes == [out, out]
        assert bench.agent.samples == [(0x07, number_bytes(1)), (0x08, IDENTITY + number_bytes(8))]


# --- spinning ---------------------------------------------------------------------------------


def test_spin_some_runs_rounds_while_there_is_work_and_time() -> None:
    bench, heard = subscribed()
    assert bench.node.spin_some() == 0
    for i in range(5):
        bench.agent.sample(0x06, number_bytes(i))
    assert bench.node.spin_some(0.1) == 5 and heard == list(range(5))
    before = bench.clock.t
    assert bench.node.spin_some(0.1) == 0
    assert bench.clock.t - before == 100000
    for i in range(5):
        bench.agent.sample(0x06, number_bytes(i))
    bench.subscription.callback = lambda message: bench.clock.sleep(40)
    before = bench.clock.t
    assert bench.node.spin_some(0.1) == 3  # the time is up
    assert bench.clock.t - before == 120000
    assert bench.node.spin_some() == 1 and bench.node.spin_some() == 1
    calls = []
    bench.node.create_timer(0.03, lambda: calls.append(bench.clock.t))
    before = bench.clock.t
    bench.node.spin_some(0.1)
    assert calls == [before + 30000 * (n + 1) for n in range(len(calls))] and calls


def test_nodes_that_share_an_executor_are_spun_together() -> None:
    bench = Bench("one", connect=False)
    second = Node("two", bench.node.connection, executor=bench.node.executor)
    heard = []
    bench.node.create_subscription(
        Number, "a", lambda message: heard.append(("one", message.value))
    )
    second.create_subscription(Number, "b", lambda message: heard.append(("two", message.value)))
    second.create_timer(0.05, lambda: heard.append("timer"))
    guard = second.create_guard_condition(lambda: heard.append("guard"))
    bench.until(AGENT_CONNECTED)
    del heard[:]
    bench.agent.sample(0x16, number_bytes(2))
    bench.agent.sample(0x06, number_bytes(1))
    bench.run(5)
    assert sorted(heard) == [("one", 1), ("two", 2)]
    del heard[:]
    guard.trigger()
    bench.run(5)
    assert heard == ["guard"]
    bench.run(50)
    assert heard[1:] == ["timer"]
    second.destroy_node()
    guard.trigger()
    bench.run(200)
    assert len(heard) == 2 and len(bench.node.executor.handles) == 1
    bench.agent.sample(0x06, number_bytes(1))
    bench.run(5)
    assert heard[2:] == [("one", 1)]


def test_a_timer_created_canceled_and_destroyed_twice() -> None:
    bench = Bench()
    calls = []
    timer = bench.node.create_timer(0.05, lambda: calls.append(1), autostart=False)
    bench.run(200)
    assert calls == []
    timer.reset()
    bench.run(60)
    assert calls == [1]
    bench.node.destroy_timer(timer)
    bench.node.destroy_timer(timer)
    bench.run(200)
    assert calls == [1] and bench.node.executor.handles == []


def test_a_guard_condition_triggered_during_a_wait_takes_effect_soon() -> None:
    bench = Bench()
    calls = []
    guard = bench.node.create_guard_condition(lambda: calls.append(bench.clock.t))
    receive = bench.agent.receive
    start = bench.clock.t

    def interrupted(timeout_ms):
        if bench.clock.t - start >= 70000 and not calls:
            guard.trigger()
        return receive(timeout_ms)

    bench.agent.receive = interrupted
    bench.node.spin_once(1.0)
    assert len(calls) == 1 and calls[0] - start <= 100000
    bench.node.destroy_guard_condition(guard)
    guard.trigger()
    assert bench.node.spin_once(0) is False


def test_a_round_of_slow_callbacks_does_not_starve_the_session() -> None:
    """Between callbacks received messages are acknowledged, and due messages are sent."""
    bench, heard = subscribed()
    counts = []

    def slow():
        counts.append(len(bench.agent.sent))
        bench.agent.sample(0x06, number_bytes(len(counts)))
        bench.clock.sleep(1000)

    timers = [bench.node.create_timer(0.1, slow) for _ in range(6)]
    bench.node.spin_once()
    for timer in timers:
        timer.cancel()
    assert len(counts) == 6 and all([b > a for a, b in zip(counts, counts[1:])]), counts
    bench.run(100)
    assert heard == [1, 2, 3, 4, 5, 6]
    assert bench.states.count(AGENT_CONNECTED) == 1 and bench.node.state == AGENT_CONNECTED


def test_long_callbacks_do_not_end_the_session() -> None:
    bench = Bench(connect=False)
    publisher = bench.node.create_publisher(Number, "topic")
    heard = []
    bench.node.create_subscription(Number, "other", lambda message: heard.append(message.value))
    bench.node.create_timer(1.0, lambda: (publisher.publish(Number(1)), bench.clock.sleep(5000)))
    bench.until(AGENT_CONNECTED)
    for i in range(10):
        bench.agent.sample(0x16, number_bytes(i))
        bench.run(6000)
    assert bench.states.count(AGENT_CONNECTED) == 1 and AGENT_DISCONNECTED not in bench.states
    assert heard == list(range(10)) and len(bench.agent.samples) >= 9


def test_a_callback_may_wait_for_a_reply() -> None:
    """It spins the node in its callback."""
    bench = calling()
    answers = []

    def ask():
        timer.cancel()
        future = bench.client.call_async(Ask.Request(1))
        answer(bench, last_request(bench), 7)
        assert bench.node.spin_until_future_complete(future, 1.0)
        answers.append(future.result().value)

    bench.until(AGENT_CONNECTED)
    timer = bench.node.create_timer(0.01, ask)
    bench.run(100)
    assert answers == [7] and bench.node.executor.failed == 0


def test_entities_are_destroyed_by_rclpys_names_too() -> None:
    bench = Bench(connect=False)
    node = bench.node
    pairs = (
        (node.destroy_publisher, node.create_publisher(Number, "a")),
        (node.destroy_subscription, node.create_subscription(Number, "b", print)),
        (node.destroy_service, node.create_service(Ask, "c", double)),
        (node.destroy_client, node.create_client(Ask, "d")),
    )
    bench.until(AGENT_CONNECTED)
    for destroy, entity in pairs:
        destroy(entity)
    bench.run(100)
    assert [request[1] for request in bench.agent.requests if request[0] == ids.DELETE] == [
        0x05, 0x03, 0x02, 0x16, 0x14, 0x12, 0x08, 0x07,
    ]  # fmt: skip
    assert node.executor.handles == []


def test_invalid_periods_and_transports_are_refused() -> None:
    bench = Bench()
    for make in (
        lambda: bench.node.create_timer("a", print),
        lambda: Node("other", "127.0.0.1"),
    ):
        try:
            make()
        except TypeError as error:
            text = str(error)
            continue
        raise AssertionError("not refused")
    assert text == "'127.0.0.1' is no transport, as UdpTransport(host, port) is"
    bench.until(AGENT_CONNECTED)  # nothing was created in part
