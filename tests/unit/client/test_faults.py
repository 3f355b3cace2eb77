"""The client and our agent when the agent dies at any instant, and on a line that damages.

portable_faults.py has a scripted agent, on both Pythons; test_wire.py a line that loses.
"""

import heapq

import pytest
from support.wire import Wire
from uros.interfaces.sensor_msgs.msg import Imu, Temperature
from uros.interfaces.std_msgs.msg import Int32, String, UInt8MultiArray
from uros.interfaces.std_srvs.srv import Trigger

from uros.client import AGENT_CONNECTED
from uros.qos import HistoryPolicy, QoSProfile
from uros.wire import ids
from uros.wire.framing import Deframer, frame, frame_size

KEEP_ALL = QoSProfile(history=HistoryPolicy.KEEP_ALL)


def picture(number):
    return bytes((number * 31 + i * 7 + (i >> 8)) & 0xFF for i in range(1500))


class MortalWire(Wire):
    """Its first agent dies when so many datagrams have been put on the wire, by either end."""

    def __init__(self, alive):
        self.alive = alive
        super().__init__()

    def carry(self, datagram, arrive):
        self.alive -= 1
        if self.alive == 0:  # not within what it is doing now: a signal comes between two calls
            self._order += 1
            heapq.heappush(self._events, (self.clock.t, self._order, self._die, b""))
        super().carry(datagram, arrive)

    def _die(self, _):
        self.kill_agent()


class Pair:
    """A board that talks and serves, and one that listens and asks."""

    def __init__(self, wire):
        self.wire = wire
        self.talker = wire.node("talker", silence_ms=1000)
        self.listener = wire.node("listener", silence_ms=1000)
        for node in wire.nodes:
            node.connection.log = lambda text: None
        self.numbers = self.talker.create_publisher(Int32, "numbers", 10)
        self.pictures = self.talker.create_publisher(UInt8MultiArray, "pictures", 10)
        self.talker.create_service(Trigger, "go", self.go)
        self.heard, self.seen, self.answers = [], [], []
        self.listener.create_subscription(
            Int32, "numbers", lambda it: self.heard.append(it.data), KEEP_ALL
        )
        self.listener.create_subscription(
            UInt8MultiArray, "pictures", lambda it: self.seen.append(bytes(it.data)), KEEP_ALL
        )
        self.client = self.listener.create_client(Trigger, "go")

    def go(self, request, response):
        response.success = True
        response.message = "gone"
        return response

    def act(self, number):
        self.numbers.publish(Int32(data=number))
        self.pictures.publish(UInt8MultiArray(data=picture(number)))
        future = self.client.call_async(Trigger.Request())
        future.add_done_callback(
            lambda it: self.answers.append(it.exception() or it.result().message)
        )

    def works(self):
        self.wire.connect()
        del self.heard[:], self.seen[:], self.answers[:]
        self.act(5)
        self.wire.until(lambda: self.heard and self.seen and self.answers, 5000, vars(self))
        assert self.heard == [5] and self.seen == [picture(5)] and self.answers == ["gone"]
        assert all(node.executor.failed == 0 for node in self.wire.nodes)


def lived(alive, restart_ms):
    """Whether the agent died on the way."""
    with MortalWire(alive) as wire:
        pair = Pair(wire)
        number = 0
        while wire.alive > 0 and number < 8:
            wire.run(60)
            if all(node.state == AGENT_CONNECTED for node in wire.nodes):
                pair.act(number)
                number += 1
        wire.run(restart_ms)
        if wire.agent is not None:
            return False
        wire.start_agent()
        pair.works()
        return True


# Each of them has every fourth instant, of three hundred or so.
@pytest.mark.parametrize("first", [1, 2, 3, 4])
@pytest.mark.parametrize("restart_ms", [1, 3000])
def test_an_agent_that_dies_after_any_datagram_is_followed_by_another(first, restart_ms):
    alive = first
    while lived(alive, restart_ms):
        alive += 4
    assert alive > 150, alive


@pytest.mark.parametrize("seed", range(10))
def test_what_was_said_in_a_session_that_is_over_disturbs_no_other(seed):
    """Each session has another id: datagrams of the last one come seconds late, in any order,
    and are counted."""
    ghosts = []
    with MortalWire(200) as wire:
        carry = wire.carry

        def record(datagram, arrive):
            if datagram[4] != ids.CREATE_CLIENT:  # that would be a session of its own
                ghosts.append((datagram, arrive))
            carry(datagram, arrive)

        wire.carry = record
        pair = Pair(wire)
        wire.connect()
        for number in range(20, 60):
            pair.act(number)
            wire.run(30)
            if wire.agent is None:
                break
        del wire.carry
        wire.run(2000)
        wire.start_agent()
        wire.connect()
        before = [it.connection.connections for it in wire.nodes]
        dropped = sum(it.connection.dropped for it in wire.nodes)
        pair.works()
        wire.random.seed(seed)
        wire.random.shuffle(ghosts)
        for number, (datagram, arrive) in enumerate(ghosts):
            arrive(datagram)
            if number % 10 == 0:
                wire.run(10)
        wire.run(1000)
        assert pair.heard == [5] and pair.seen == [picture(5)] and pair.answers == ["gone"]
        pair.works()
        assert before == [it.connection.connections for it in wire.nodes]
        assert sum(it.connection.dropped for it in wire.nodes) > dropped + 50


class SerialWire(Wire):
    """Each datagram crosses in a frame, of which bytes are changed, lost or added."""

    def __init__(self, seed, damaged, **more):
        self.damaged = damaged
        self.damages = self.lost_by_it = 0
        super().__init__(seed, **more)

    def carry(self, datagram, arrive):
        line = bytearray(frame_size(datagram))
        del line[frame(datagram, 1, 0, line) :]
        if self.random.random() < self.damaged:
            self.damages += 1
            for _ in range(self.random.randint(1, 4)):
                at = self.random.randrange(len(line))
                what = self.random.randrange(3)
                if what == 0:
                    line[at] ^= 1 << self.random.randrange(8)
                elif what == 1:
                    del line[at]
                else:
                    line.insert(at, self.random.randrange(256))
        messages = Deframer(0).feed(line)
        self.lost_by_it += not messages
        for message in messages:
            super().carry(message, arrive)


@pytest.mark.parametrize("seed", range(8))
def test_reliable_samples_arrive_complete_and_in_order_on_a_line_that_damages(seed):
    with SerialWire(seed, 0.3, twice=0.1, late_ms=20.0) as wire:
        talker, listener = wire.node("talker"), wire.node("listener")
        numbers = talker.create_publisher(Int32, "numbers", 10)
        pictures = talker.create_publisher(UInt8MultiArray, "pictures", 10)
        heard, seen, sent = [], [], [0]
        listener.create_subscription(Int32, "numbers", lambda it: heard.append(it.data), KEEP_ALL)
        listener.create_subscription(
            UInt8MultiArray, "pictures", lambda it: seen.append(bytes(it.data)), KEEP_ALL
        )
        wire.connect()

        def publish():
            if sent[0] < 80 and numbers.publish(Int32(data=sent[0])):
                if sent[0] % 10 == 0:
                    assert pictures.publish(UInt8MultiArray(data=picture(sent[0])))
                sent[0] += 1

        talker.create_timer(0.02, publish)
        wire.until(lambda: len(heard) >= 80 and len(seen) >= 8, 120000, (heard, len(seen)))
        wire.run(1000)
        assert heard == list(range(80)) and seen == [picture(i) for i in range(0, 80, 10)]
        assert wire.damages > 50 and wire.lost_by_it > 50
        assert all(it.connection.connections == 1 for it in wire.nodes)


def test_reliable_publishing_is_pipelined():
    """A round trip takes a window of samples along."""
    with Wire(1, way_ms=50.0) as wire:
        talker, listener = wire.node("talker"), wire.node("listener")
        publisher = talker.create_publisher(Int32, "numbers", 10)
        heard = []
        listener.create_subscription(
            Int32, "numbers", lambda it: heard.append((it.data, wire.clock.t)), KEEP_ALL
        )
        wire.connect()
        start = wire.clock.t
        for i in range(160):
            assert publisher.publish(Int32(data=i))
        assert wire.clock.t == start
        wire.until(lambda: len(heard) >= 160)
        assert [it[0] for it in heard] == list(range(160))
        took = (heard[-1][1] - start) / 100_000  # round trips
        assert 9 <= took <= 12, took


def test_a_type_that_is_another_on_the_other_side():
    """The agent knows names of types and no contents: a Temperature is read as an Imu."""
    with Wire(1) as wire:
        talker, listener = wire.node("talker"), wire.node("listener")
        heard = []

        class Impostor(Temperature):
            _TYPE = Imu._TYPE
            _DDS_TYPE = Imu._DDS_TYPE

        class Text(Int32):
            _TYPE = String._TYPE
            _DDS_TYPE = String._DDS_TYPE

        publishers = (
            (talker.create_publisher(Impostor, "imu", 10), Impostor(temperature=1.0)),
            (talker.create_publisher(Text, "text", 10), Text(data=2**31 - 1)),
            (talker.create_publisher(Int32, "number", 10), Int32(data=7)),
        )
        subscriptions = [
            listener.create_subscription(cls, name, heard.append, 10)
            for cls, name in ((Imu, "imu"), (String, "text"), (Int32, "number"))
        ]
        wire.connect()
        for publisher, message in publishers:
            assert publisher.publish(message)
        wire.run(500)
        assert [it.malformed for it in subscriptions] == [1, 1, 0]
        assert heard == [Int32(data=7)] and listener.state == AGENT_CONNECTED
