"""The client with the real agent, which dies at any instant, and on a line that damages datagrams.

portable_faults.py has a scripted agent on both Pythons, test_wire.py a line that loses datagrams.
"""

import heapq

import pytest
from support.variants import slow_except
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
    """The first agent dies after ``alive`` datagrams, counted in both directions."""

    def __init__(self, alive):
        self.alive = alive
        super().__init__()

    def carry(self, datagram, arrive):
        self.alive -= 1
        if self.alive == 0:  # as a signal: between two calls of the agent
            self._order += 1
            heapq.heappush(self._events, (self.clock.t, self._order, self._die, b""))
        super().carry(datagram, arrive)

    def _die(self, _):
        self.kill_agent()


class Pair:
    """A board with publishers and a service, and one with subscriptions and a client."""

    def __init__(self, wire):
        self.wire = wire
        self.talker = wire.node("talker", silence_ms=1000)
        self.listener = wire.node("listener", silence_ms=1000)
        for node in wire.nodes:
            node.connection.log = lambda text: None
        self.numbers = self.talker.create_publisher(Int32, "numbers", 10)
        self.pictures = self.talker.create_publisher(UInt8MultiArray, "pictures", 10)
        self.talker.create_service(Trigger, "go", self.go)
        self.heard, self.received, self.answers = [], [], []
        self.listener.create_subscription(
            Int32, "numbers", lambda message: self.heard.append(message.data), KEEP_ALL
        )
        self.listener.create_subscription(
            UInt8MultiArray,
            "pictures",
            lambda message: self.received.append(bytes(message.data)),
            KEEP_ALL,
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
            lambda future: self.answers.append(future.exception() or future.result().message)
        )

    def works(self):
        self.wire.connect()
        del self.heard[:], self.received[:], self.answers[:]
        self.act(5)
        self.wire.until(lambda: self.heard and self.received and self.answers, 5000, vars(self))
        assert self.heard == [5] and self.received == [picture(5)] and self.answers == ["gone"]
        assert all(node.executor.failed == 0 for node in self.wire.nodes)


def run_with_restart(alive, restart_ms):
    """Let the agent die after ``alive`` datagrams; return whether it died before the end."""
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


# Each parameter covers every fourth of about three hundred instants.
@pytest.mark.parametrize("first", slow_except([1, 2, 3, 4], 1))
@pytest.mark.parametrize("restart_ms", slow_except([1, 3000], 3000))
def test_an_agent_that_dies_after_any_datagram_is_replaced(first, restart_ms):
    alive = first
    while run_with_restart(alive, restart_ms):
        alive += 4
    assert alive > 150, alive


@pytest.mark.parametrize("seed", range(10))
def test_late_datagrams_of_an_earlier_session_have_no_effect(seed):
    """Datagrams of the last session arrive seconds late in any order: they are dropped, counted."""
    recorded = []
    with MortalWire(200) as wire:
        carry = wire.carry

        def record(datagram, arrive):
            if datagram[4] != ids.CREATE_CLIENT:  # it would create a session
                recorded.append((datagram, arrive))
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
        before = [node.connection.connections for node in wire.nodes]
        dropped = sum(node.connection.dropped for node in wire.nodes)
        pair.works()
        wire.random.seed(seed)
        wire.random.shuffle(recorded)
        for number, (datagram, arrive) in enumerate(recorded):
            arrive(datagram)
            if number % 10 == 0:
                wire.run(10)
        wire.run(1000)
        assert pair.heard == [5] and pair.received == [picture(5)] and pair.answers == ["gone"]
        pair.works()
        assert before == [node.connection.connections for node in wire.nodes]
        assert sum(node.connection.dropped for node in wire.nodes) > dropped + 50


class SerialWire(Wire):
    """Sends each datagram in a frame, of which bytes are changed, removed or added."""

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
                damage = self.random.randrange(3)
                if damage == 0:
                    line[at] ^= 1 << self.random.randrange(8)
                elif damage == 1:
                    del line[at]
                else:
                    line.insert(at, self.random.randrange(256))
        messages = Deframer(0).feed(line)
        self.lost_by_it += not messages
        for message in messages:
            super().carry(message, arrive)


@pytest.mark.parametrize("seed", range(8))
def test_reliable_samples_arrive_complete_and_in_order_despite_damaged_frames(seed):
    with SerialWire(seed, 0.3, twice=0.1, late_ms=20.0) as wire:
        talker, listener = wire.node("talker"), wire.node("listener")
        numbers = talker.create_publisher(Int32, "numbers", 10)
        pictures = talker.create_publisher(UInt8MultiArray, "pictures", 10)
        heard, received, sent = [], [], [0]
        listener.create_subscription(
            Int32, "numbers", lambda message: heard.append(message.data), KEEP_ALL
        )
        listener.create_subscription(
            UInt8MultiArray,
            "pictures",
            lambda message: received.append(bytes(message.data)),
            KEEP_ALL,
        )
        wire.connect()

        def publish():
            if sent[0] < 80 and numbers.publish(Int32(data=sent[0])):
                if sent[0] % 10 == 0:
                    assert pictures.publish(UInt8MultiArray(data=picture(sent[0])))
                sent[0] += 1

        talker.create_timer(0.02, publish)
        wire.until(lambda: len(heard) >= 80 and len(received) >= 8, 120000, (heard, len(received)))
        wire.run(1000)
        assert heard == list(range(80)) and received == [picture(i) for i in range(0, 80, 10)]
        assert wire.damages > 50 and wire.lost_by_it > 50
        assert all(node.connection.connections == 1 for node in wire.nodes)


def test_reliable_publishing_is_pipelined():
    """Each round trip carries a window of samples."""
    with Wire(1, way_ms=50.0) as wire:
        talker, listener = wire.node("talker"), wire.node("listener")
        publisher = talker.create_publisher(Int32, "numbers", 10)
        heard = []
        listener.create_subscription(
            Int32, "numbers", lambda message: heard.append((message.data, wire.clock.t)), KEEP_ALL
        )
        wire.connect()
        start = wire.clock.t
        for i in range(160):
            assert publisher.publish(Int32(data=i))
        assert wire.clock.t == start
        wire.until(lambda: len(heard) >= 160)
        assert [message[0] for message in heard] == list(range(160))
        took = (heard[-1][1] - start) / 100_000  # round trips
        assert 9 <= took <= 12, took


def test_samples_of_another_definition_are_counted():
    """The agent compares type names only: a Temperature is decoded as an Imu, and counted."""
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
        assert [subscription.malformed for subscription in subscriptions] == [1, 1, 0]
        assert heard == [Int32(data=7)] and listener.state == AGENT_CONNECTED
