"""A board's time never goes back, unless the agent's clock was set back by a second or more.

Also runs on MicroPython.
"""

import sys
from struct import pack_into, unpack_from

from support.board import KEY, FakeAgent, FakeClock
from support.chance import Chance

from uros import qos
from uros.client import AGENT_CONNECTED, Node
from uros.client.clock import STEP_US


class Drifting(FakeAgent):
    """An agent whose clock drifts by ``ppm``, with random delays below ``most_us`` each way."""

    def __init__(self, clock, chance, ppm, most_us):
        self.chance = chance
        self.ppm = ppm
        self.most_us = most_us
        self.base = self.from_us = clock.t
        super().__init__(clock)

    def at(self, t):
        """Return the agent's time at ticks ``t``, in microseconds since 1970."""
        passed = t - self.from_us
        return self.epoch_us + self.base + passed + passed * self.ppm // 1000000

    def hear(self, datagram):
        if self.most_us:
            self.delay = (self.chance.below(self.most_us), self.chance.below(self.most_us))
        super().hear(datagram)

    def timestamp(self, transmit, receive, originate):
        now = self.at(self.clock.t + self.delay[0])
        super().timestamp(now, now, originate)


def watched(seed, ppm, most_us, seconds):
    """Read a node's time often; return its largest offset in microseconds."""
    chance = Chance(seed)
    clock = FakeClock()
    agent = Drifting(clock, chance, ppm, most_us)
    node = Node("node", agent, key=KEY, clock=clock)
    for _ in range(2000):
        node.spin_once(0.005)
        if node.state == AGENT_CONNECTED:
            break
    assert node.state == AGENT_CONNECTED
    worst = 0
    last = (0, 0)
    end = clock.t + seconds * 1000000
    while clock.t < end:
        node.spin_once(0.001 + chance.below(200) / 1000)
        now = node.clock.now()
        assert now >= last, (seed, ppm, most_us, last, now)
        last = now
        off = now[0] * 1000000 + now[1] // 1000 - agent.at(clock.t)
        worst = max(worst, abs(off))
    return worst


def settled():
    """Return the clock, an agent without drift, and a synchronized node."""
    clock = FakeClock()
    agent = Drifting(clock, Chance(1), 0, 0)
    node = Node("node", agent, key=KEY, clock=clock)
    for _ in range(100):
        node.spin_once(0.01)
    return clock, agent, node


def test_the_offset_stays_below_drift_and_jitter() -> None:
    for seed in range(8 if sys.implementation.name == "cpython" else 1):
        for ppm in (-200, 0, 200):
            for most_us in (0, 2000, 50000):
                worst = watched(seed, ppm, most_us, 70)
                # The drift of 30 s, and half of the largest difference of both ways.
                assert worst <= 30 * abs(ppm) + most_us + 3000, (seed, ppm, most_us, worst)


def test_steps_of_the_agents_clock_below_a_second_never_turn_time_back() -> None:
    for step in (-STEP_US + 1, -300000, -1000, 1000, 300000, STEP_US - 1):
        clock, agent, node = settled()
        last = node.clock.now()
        agent.epoch_us += step
        for _ in range(700):
            node.spin_once(0.05)
            now = node.clock.now()
            assert now > last, (step, last, now)
            last = now
        off = last[0] * 1000000 + last[1] // 1000 - agent.at(clock.t)
        assert abs(off) <= 10, (step, off)


def test_a_step_of_a_second_or_more_is_followed_at_once_and_only_once() -> None:
    for step in (-3600000000, -STEP_US, STEP_US, 3600000000):
        clock, agent, node = settled()
        last = node.clock.now()
        agent.epoch_us += step
        back = 0
        for _ in range(700):
            node.spin_once(0.05)
            now = node.clock.now()
            back += now < last
            last = now
        assert back == (step < 0), step
        assert abs(last[0] * 1000000 + last[1] // 1000 - agent.at(clock.t)) <= 10


class Stamp:
    high = low = nanosec = 0


class Stamped:
    """A message with a stamp only."""

    _TYPE = "test_msgs/msg/Stamped"

    def __init__(self):
        self.stamp = Stamp()

    def cdr_size(self, o=0):
        return o + (-o & 3) + 8

    def pack_into(self, buf, offset, start):
        if offset + 8 > len(buf):
            raise ValueError("too short a buffer")
        pack_into("<HHI", buf, offset, self.stamp.low, self.stamp.high, self.stamp.nanosec)
        return offset + 8


class Late(Drifting):
    """An agent that ignores each TIMESTAMP before the one numbered ``first``."""

    first = 0

    def timestamp(self, transmit, receive, originate):
        if self.times >= self.first:
            super().timestamp(transmit, receive, originate)


def test_no_stamp_is_sent_before_the_time_is_known() -> None:
    for first in (1, 2, 4, 6):
        for reliable in (10, qos.QoSProfile(10, reliability=qos.ReliabilityPolicy.BEST_EFFORT)):
            clock = FakeClock()
            agent = Late(clock, Chance(first), 0, 20000)
            agent.first = first
            node = Node("node", agent, key=KEY, clock=clock)
            publisher = node.create_publisher(Stamped, "stamped", reliable)
            at_once, later = Stamped(), Stamped()
            count = [0, 0]

            def tell(publisher=publisher, stamped=at_once, clock=clock, agent=agent, count=count):
                # A message stamped and published in one callback needs no check of the result.
                known = clock.stamp(stamped.stamp)
                sent = publisher.publish(stamped)
                assert known or not sent
                count[sent] += 1

            def measure(stamped=later, clock=clock):
                stamped.known = clock.stamp(stamped.stamp)

            def publish(publisher=publisher, stamped=later):
                if stamped.known:
                    publisher.publish(stamped)

            node.create_timer(0.007, tell)
            node.create_timer(0.4, measure)
            node.create_timer(0.53, publish)
            measure()
            end = clock.t + 6000000
            while clock.t < end:
                node.spin_once(0.05)
                samples = agent.samples
                agent.samples = []
                for _, octets in samples:
                    low, high, nanosec = unpack_from("<HHI", octets, 0)
                    us = (high << 16 | low) * 1000000 + nanosec // 1000
                    assert -20000 <= agent.at(clock.t) - us < 1200000, (first, high)
            assert count[0] > 1 and count[1] > 100, (first, count)


def test_no_stamp_of_one_agents_time_is_sent_to_another() -> None:
    clock, agent, node = settled()
    publisher = node.create_publisher(Stamped, "stamped", 10)
    message = Stamped()

    def tell():
        node.clock.stamp(message.stamp)
        publisher.publish(message)

    node.create_timer(0.01, tell)
    for _ in range(5):
        agent.silent = True
        while node.state == AGENT_CONNECTED:
            node.spin_once(0.05)
        agent.silent = False
        agent.forget()
        agent.epoch_us += 3600000000
        end = clock.t + 3000000
        while clock.t < end:
            node.spin_once(0.01)
        assert len(agent.samples) > 50
        for _, octets in agent.samples:
            low, high, nanosec = unpack_from("<HHI", octets, 0)
            us = (high << 16 | low) * 1000000 + nanosec // 1000
            assert -20000 <= agent.at(clock.t) - us < 3000000
