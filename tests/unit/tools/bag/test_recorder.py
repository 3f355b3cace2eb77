import pytest
from support.bag_network import HASH, STRING, Network

from uros.bag.metadata import TopicMetadata
from uros.interfaces import load
from uros.interfaces.codec import to_cdr
from uros.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from uros.tools.bag.message_cache import MessageCache, Recorded
from uros.tools.bag.recorder import CLOCK, Recorder
from uros.tools.bag.selection import Names, Selection

ALL = Selection(Names(every=True))
BEST_EFFORT = ReliabilityPolicy.BEST_EFFORT
LATCHED = DurabilityPolicy.TRANSIENT_LOCAL


class Console:
    def __init__(self):
        self.said = []
        self.warned = []

    def say(self, text):
        self.said.append(text)

    def warn(self, text):
        self.warned.append(text)


@pytest.fixture
def network():
    return Network()


@pytest.fixture
def console():
    return Console()


@pytest.fixture
def cache():
    return MessageCache(1 << 20)


@pytest.fixture
def start(network, cache, console):
    def make(selection=ALL, overrides=None, **options):
        return Recorder(network, selection, cache, console, overrides or {}, **options)

    return make


def entries(cache, kind):
    return [entry for entry in cache.take(0.0)[0] if isinstance(entry, kind)]


def test_a_topic_is_recorded_with_what_is_known_of_it(network, cache, console, start):
    network.publish("/chatter", QoSProfile(7), type_hash="RIHS01_00")
    recorder = start()
    recorder.discover()
    network.send("/chatter", b"\0\1\0\0abc", at=50, sent=40)
    network.send("/chatter", b"\0\1\0\0", at=51, sent=0)
    topic, *messages = cache.take(0.0)[0]
    assert (topic.name, topic.type_name, topic.type_hash) == ("/chatter", STRING, "RIHS01_00")
    assert topic.offered_qos == [QoSProfile(7)] and topic.definition == "string data\n"
    assert messages == [
        Recorded(topic, b"\0\1\0\0abc", 50, 40),
        Recorded(topic, b"\0\1\0\0", 51, 51),
    ]
    assert (recorder.topics, recorder.received, recorder.octets) == (1, 2, 11)
    assert console.said == ["Subscribed to topic '/chatter'"] and not console.warned


def test_a_type_without_definition_is_recorded_too(network, cache, start):
    network.publish("/x", QoSProfile(), types=["my_msgs/msg/Unknown"])
    start().discover()
    (topic,) = entries(cache, TopicMetadata)
    assert (topic.type_name, topic.type_hash, topic.definition) == ("my_msgs/msg/Unknown", "", "")


def test_topics_that_appear_later_are_recorded_once(network, cache, start):
    recorder = start(Selection(Names(included=frozenset(["/later"]))))
    network.publish("/chatter", QoSProfile())
    recorder.discover()
    assert network.log == [] and recorder.missing() == ["/later"]
    network.publish("/later", QoSProfile())
    recorder.discover()
    recorder.discover()
    assert [topic for topic, _ in network.log] == ["/later"] and recorder.missing() == []


@pytest.mark.parametrize(
    "profiles, reliable, transient",
    [
        ([QoSProfile()], True, False),
        ([QoSProfile(1, BEST_EFFORT)], False, False),
        ([QoSProfile(1, durability=LATCHED)], True, True),
        ([QoSProfile(), QoSProfile(1, BEST_EFFORT)], False, False),
    ],
)
def test_the_subscription_adapts(network, console, start, profiles, reliable, transient):
    network.publish("/x", *profiles)
    start().discover()
    ((_, qos),) = network.log
    assert (qos.reliable, qos.transient_local) == (reliable, transient)
    assert bool(console.warned) == (len(profiles) > 1)


def test_a_publisher_that_does_not_match_has_the_topic_subscribed_anew(network, cache, start):
    recorder = start()
    network.publish("/x", QoSProfile(1, durability=LATCHED))
    recorder.discover()
    network.publish("/x", QoSProfile(1, durability=LATCHED), QoSProfile(5, BEST_EFFORT))
    recorder.discover()
    network.publish("/x", *[QoSProfile(1, durability=LATCHED)] * 3, QoSProfile(5, BEST_EFFORT))
    recorder.discover()
    first, ended, second = network.log
    assert first[1].transient_local and ended == ("/x", None)
    assert not second[1].reliable and not second[1].transient_local
    (topic,) = entries(cache, TopicMetadata)
    assert topic.offered_qos == [QoSProfile(1, durability=LATCHED), QoSProfile(5, BEST_EFFORT)]


def test_an_override_is_used_as_it_is(network, start):
    mine = QoSProfile(3)
    network.publish("/x", QoSProfile(1, BEST_EFFORT))
    recorder = start(overrides={"/x": mine})
    recorder.discover()
    network.publish("/x", QoSProfile(1, BEST_EFFORT), QoSProfile(1, BEST_EFFORT))
    recorder.discover()
    assert network.log == [("/x", mine)]


def test_a_topic_without_publisher_waits_for_one(network, start):
    network.publish("/x")
    recorder = start()
    recorder.discover()
    assert network.log == []
    network.publish("/x", QoSProfile())
    recorder.discover()
    assert len(network.log) == 1


def test_unpublished_topics_on_request_adapt_to_the_first_publisher(network, start):
    network.publish("/x")
    recorder = start(unpublished=True)
    recorder.discover()
    network.publish("/x", QoSProfile(1, durability=LATCHED))
    recorder.discover()
    first, ended, second = network.log
    assert not first[1].transient_local and second[1].transient_local


def test_leaves_are_ignored_on_request(network, start):
    network.publish("/leaf", QoSProfile())
    network.publish("/heard", QoSProfile())
    network.readers["/heard"] = ["somebody"]
    start(ignore_leaves=True).discover()
    assert [topic for topic, _ in network.log] == ["/heard"]


@pytest.mark.parametrize(
    "topic, types, said",
    [
        ("/x", [STRING, "std_msgs/msg/Int32"], "several types: std_msgs/msg/String, std_msgs"),
        ("/x", ["std_msgs/msg/\\x1b[2J"], "is not a name"),
        ("/x\\x1b[2J", [STRING], "letters, digits and _"),
    ],
)
def test_what_no_bag_can_have_is_told_once(network, console, start, topic, types, said):
    network.publish(topic, QoSProfile(), types=types)
    recorder = start()
    recorder.discover()
    network.changed_at += 1
    recorder.discover()
    assert network.log == []
    (warning,) = console.warned
    assert said in warning


def test_nothing_is_recorded_while_paused(network, cache, start):
    network.publish("/x", QoSProfile())
    recorder = start()
    recorder.discover()
    recorder.paused = True
    network.send("/x", at=1)
    recorder.paused = False
    network.send("/x", at=2)
    assert [message.received_ns for message in entries(cache, Recorded)] == [2]
    assert recorder.received == 1


def test_simulated_time(network, cache, start):
    """Topics are subscribed to when the clock runs, so that latched messages are not missed."""
    clock = load("rosgraph_msgs/msg/Clock")()
    network.publish("/x", QoSProfile())
    network.publish(CLOCK, QoSProfile(), types=["rosgraph_msgs/msg/Clock"])
    recorder = start(Selection(Names(included=frozenset(["/x"]))), use_sim_time=True)
    recorder.discover()
    assert [topic for topic, _ in network.log] == [CLOCK]
    network.send(CLOCK, b"\0\1\0\0")  # malformed
    recorder.discover()
    assert len(network.log) == 1
    clock.clock.sec, clock.clock.nanosec = 12, 34
    network.send(CLOCK, to_cdr(clock))
    recorder.discover()
    network.send("/x", at=99, sent=98)
    (message,) = entries(cache, Recorded)
    assert (message.received_ns, message.sent_ns) == (12_000_000_034, 98)


def test_close_ends_the_subscriptions(network, start):
    network.publish("/x", QoSProfile())
    recorder = start()
    recorder.discover()
    recorder.close()
    recorder.close()
    assert network.log[1:] == [("/x", None)]


# --- types that no folder has -------------------------------------------------------------------

MINE = ["my_msgs/msg/Unknown"]
LATE = 1000.0


@pytest.fixture
def described(network):
    """A network with a node that knows a type that we do not, and publishes it on two topics."""
    network.describe("talker")
    for topic in ("/a", "/b"):
        network.publish(topic, QoSProfile(), types=MINE, type_hash=HASH)
    return network


def test_a_node_is_asked_for_the_definition_of_its_type(described, cache, console, start):
    """Meanwhile its messages are received; they follow their topic in the bag."""
    recorder = start()
    recorder.discover()
    recorder.look_up(0.0)
    described.send("/a", at=1)
    recorder.look_up(0.1)
    described.send("/b", at=2)
    assert cache.take(0.0)[0] == []
    (client,) = described.clients
    (request,) = client.requests
    assert (request.type_name, request.type_hash, request.include_type_sources) == (
        *MINE, HASH, True,
    )  # fmt: skip
    described.answer(client, "int8 a\n")
    recorder.look_up(0.2)
    assert client.closed
    entries = cache.take(0.0)[0]
    assert [(entry.name, entry.definition) for entry in entries[::2]] == [
        ("/a", "int8 a\n"), ("/b", "int8 a\n"),
    ]  # fmt: skip
    assert [message.received_ns for message in entries[1::2]] == [1, 2]
    assert console.said[-1] == "Definition of my_msgs/msg/Unknown from /talker"
    described.publish("/c", QoSProfile(), types=MINE, type_hash=HASH)
    recorder.discover()
    (topic,) = cache.take(0.0)[0]
    assert (topic.name, topic.definition) == ("/c", "int8 a\n")
    recorder.look_up(0.3)
    assert len(described.clients) == 1


def test_a_node_that_never_answers_loses_no_message(described, cache, console, start):
    recorder = start()
    recorder.discover()
    recorder.look_up(0.0)
    described.send("/a", at=1)
    recorder.look_up(LATE)
    recorder.look_up(LATE)
    topic, message, other = cache.take(0.0)[0]
    assert (topic.name, topic.definition, message.received_ns) == ("/a", "", 1)
    assert other.name == "/b"
    (warning,) = console.warned
    assert "no definition of my_msgs/msg/Unknown: no node that uses it has given it" in warning
    assert described.clients[0].closed and cache.dropped == 0


def test_close_writes_what_waits_for_a_definition(described, cache, start):
    recorder = start()
    recorder.discover()
    recorder.look_up(0.0)
    described.send("/a", at=1)
    recorder.close()
    cache.close()
    assert described.clients[0].closed
    assert [type(entry) for entry in cache.take(0.0)[0]] == [
        TopicMetadata, Recorded, TopicMetadata,
    ]  # fmt: skip


def test_nobody_is_asked_for_a_type_without_a_hash(network, cache, start):
    """Nodes before Iron announce none, and cannot be asked."""
    network.publish("/a", QoSProfile(), types=MINE)
    start().discover()
    assert [topic.name for topic in entries(cache, TopicMetadata)] == ["/a"]
