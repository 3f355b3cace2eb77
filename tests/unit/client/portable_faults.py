"""Faults between a node and its agent. Also runs on MicroPython.

The agent is scripted; the line loses, repeats, delays and damages datagrams by a seed. The tests
in test_faults.py have the real agent.
"""

import sys

from support.board import KEY, Ask, FakeAgent, FakeClock, Number, built, message, number_bytes
from support.chance import Chance

from uros.client import (
    AGENT_AVAILABLE,
    AGENT_CONNECTED,
    AGENT_DISCONNECTED,
    WAITING_AGENT,
    Node,
)
from uros.wire import ids, session
from uros.wire.framing import Deframer, frame, frame_size
from uros.wire.streams import HEARTBEAT_MS

IDENTITY = bytes(range(24))
# Each datagram on CPython; on MicroPython as WebAssembly that would take minutes.
STEP = 1 if sys.implementation.name == "cpython" else 7


class LossyAgent(FakeAgent):
    """The scripted agent at the end of a bad line; all chances are in percent.

    With ``damaged`` datagrams are sent in serial frames, of which some bytes are changed, removed
    or added; the CRC of the frames rejects damaged ones.
    """

    def __init__(self, clock, seed=0, lost=0, twice=0, late_ms=0, damaged=0):
        self.chance = Chance(seed)
        self.lost = lost
        self.twice = twice
        self.late_ms = late_ms
        self.damaged = damaged
        self.uplink = []  # (due, number, datagram) on the way to the agent
        self.count = {"lost": 0, "twice": 0, "damaged": 0}
        self.deframers = (Deframer(0), Deframer(1))
        self.beat_at = None
        super().__init__(clock)

    def carry(self, datagram, direction):
        """Return (delay in microseconds, datagram) of each datagram that arrives."""
        copies = 1
        if self.chance.hit(self.lost):
            self.count["lost"] += 1
            return []
        if self.chance.hit(self.twice):
            self.count["twice"] += 1
            copies = 2
        out = []
        for _ in range(copies):
            late = self.chance.below(self.late_ms * 1000 + 1)
            for arriving in self.frames(datagram, direction):
                out.append((late, arriving))
        return out

    def frames(self, datagram, direction):
        if not self.damaged:
            return [datagram]
        buf = bytearray(frame_size(datagram))
        size = frame(datagram, 1 - direction, direction, buf)
        line = list(buf[:size])
        if self.chance.hit(self.damaged):
            self.count["damaged"] += 1
            for _ in range(1 + self.chance.below(3)):
                at = self.chance.below(len(line))
                damage = self.chance.below(3)
                if damage == 0:
                    line[at] ^= 1 << self.chance.below(8)
                elif damage == 1 and len(line) > 1:
                    del line[at]
                else:
                    line.insert(at, self.chance.below(256))
        return self.deframers[direction].feed(bytes(line))

    def send(self, message, size):
        assert self.is_open
        message = bytes(memoryview(message)[:size])
        self.sent.append(message)
        for late, datagram in self.carry(message, 0):
            self.posted += 1
            self.uplink.append((self.clock.t + late, self.posted, datagram))

    def post(self, message):
        for late, datagram in self.carry(message, 1):
            self.posted += 1
            self.inbox.append((self.clock.t + late, self.posted, datagram))

    def receive(self, timeout_ms):
        end = self.clock.t + timeout_ms * 1000
        while True:
            self.uplink.sort()
            while self.uplink and self.uplink[0][0] <= self.clock.t:
                datagram = self.uplink.pop(0)[2]
                if not self.silent:
                    self.hear(datagram)
            self.beat_at = None
            if not self.silent and self.session_id:
                self.beat()
            self.inbox.sort()
            if self.inbox and self.inbox[0][0] <= self.clock.t:
                return self.inbox.pop(0)[2]
            if self.clock.t >= end:
                return None
            at = end
            for queue in (self.uplink, self.inbox):
                if queue:
                    at = min(at, queue[0][0])
            if self.beat_at is not None:
                at = min(at, self.beat_at)
            self.clock.t = at

    def beat(self):
        """Send a HEARTBEAT every HEARTBEAT_MS while messages are not acknowledged."""
        beat = self.out.heartbeat(self.clock.ms())
        if beat:
            payload = built(session.push_heartbeat, beat[0], beat[1], ids.STREAM_RELIABLE)
            self.answer(ids.HEARTBEAT, payload)
        if len(self.out):
            self.beat_at = self.clock.t + HEARTBEAT_MS * 1000


class Scenario:
    """A node with an entity of each kind, and the samples received at both ends."""

    def __init__(self, agent, **options):
        self.agent = agent
        self.clock = agent.clock
        options.setdefault("silence_ms", 2000)
        self.node = Node("node", agent, key=KEY, clock=self.clock, **options)
        self.node.connection.log = lambda text: None
        self.states = []
        self.errors = []
        self.node.executor.report = self.errors.append
        self.node.on_state = self.states.append
        self.heard = []
        self.answers = []
        self.publisher = self.node.create_publisher(Number, "out")  # 0x05
        self.node.create_subscription(  # 0x16
            Number, "in", lambda message: self.heard.append(message.value), 100
        )
        self.node.create_service(Ask, "ask", self.double)  # 0x08
        self.client = self.node.create_client(Ask, "other")  # 0x07

    def double(self, request, response):
        response.value = 2 * request.value
        return response

    def run(self, ms):
        end = self.clock.t + ms * 1000
        while self.clock.t < end:
            self.node.spin_once(max(0.001, (end - self.clock.t) / 1000000))

    def until(self, done, ms=60000):
        end = self.clock.t + ms * 1000
        while not done():
            assert self.clock.t < end, (self.node.state, self.states, self.node.connection.reason)
            self.node.spin_once(0.01)

    def connect(self):
        self.until(lambda: self.node.state == AGENT_CONNECTED)

    def works(self):
        """Check one sample, one request and one call in each direction with a healthy agent."""
        agent = self.agent
        del self.heard[:]
        self.connect()
        assert len(agent.creations) == 9, len(agent.creations)
        before = len(agent.samples)
        assert self.publisher.publish(Number(1))
        agent.sample(0x16, number_bytes(2))
        agent.sample(0x08, IDENTITY + number_bytes(4))
        future = self.client.call_async(Ask.Request(6))
        self.run(300)
        sent = agent.samples[before:]
        assert (0x05, number_bytes(1)) in sent
        assert (0x08, IDENTITY + number_bytes(8)) in sent
        assert (0x07, number_bytes(6)) in sent
        number = [
            datagram[8:10]
            for datagram in agent.sent
            if datagram[4] == ids.WRITE_DATA and datagram[11] == 0x07
        ][-1]
        agent.sample(0x07, number + b"\0\7" + number_bytes(9))
        self.run(300)
        assert self.heard == [2], self.heard
        assert future.done() and future.result().value == 9
        assert self.node.state == AGENT_CONNECTED and self.errors == []


def lossy(seed, **line):
    return Scenario(LossyAgent(FakeClock(), seed, **line), silence_ms=20000)


# --- a bad line ---------------------------------------------------------------------------------


def chat(seed):
    """Exchange sixty samples in each direction at the same time."""
    scenario = lossy(seed, lost=30, twice=20, late_ms=30, damaged=15)
    scenario.connect()
    sent = [0]

    def publish():
        if sent[0] < 60 and scenario.publisher.publish(Number(sent[0])):
            scenario.agent.sample(0x16, number_bytes(1000 + sent[0]))
            sent[0] += 1

    scenario.node.create_timer(0.02, publish)
    scenario.until(lambda: len(scenario.agent.samples) >= 60 and len(scenario.heard) >= 60)
    scenario.run(2000)
    return scenario


def test_reliable_samples_arrive_complete_and_in_order_both_ways() -> None:
    for seed in range(6):
        scenario = chat(seed)
        numbers = [int.from_bytes(sample[1], "little") for sample in scenario.agent.samples]
        assert numbers == list(range(60)), (seed, numbers)
        assert scenario.heard == list(range(1000, 1060)), (seed, scenario.heard)
        assert scenario.node.connection.connections == 1 and scenario.node.state == AGENT_CONNECTED
        assert scenario.errors == []
        count = scenario.agent.count
        assert count["lost"] > 50 and count["twice"] > 20 and count["damaged"] > 20, count


def test_damaged_frames_are_counted() -> None:
    scenario = lossy(3, damaged=30)
    scenario.connect()
    for i in range(100):
        scenario.agent.sample(0x16, number_bytes(i))
        scenario.run(5)
    scenario.until(lambda: len(scenario.heard) == 100)
    assert scenario.heard == list(range(100))
    deframer = scenario.agent.deframers[1]
    assert deframer.skipped > 100 and deframer.crc_errors > 0


# --- an agent that is gone ----------------------------------------------------------------------


class DyingAgent(LossyAgent):
    """An agent that dies after ``alive`` datagrams, counted in both directions."""

    def __init__(self, clock, alive):
        self.alive = alive
        super().__init__(clock)

    def lives(self):
        self.alive -= 1
        if self.alive == 0:
            self.silent = True
        return self.alive > 0

    def hear(self, datagram):
        if self.alive is None or self.lives():
            super().hear(datagram)

    def post(self, message):
        if self.alive is None or self.lives():
            super().post(message)


def run_with_restart(alive, restart_ms, forgets=True):
    """Let the agent die after ``alive`` datagrams and restart after ``restart_ms``.

    Returns:
        Whether it died, and the Scenario.
    """
    agent = DyingAgent(FakeClock(), alive)
    scenario = Scenario(agent)
    done = [False]

    def act():
        scenario.publisher.publish(Number(7))
        scenario.client.call_async(Ask.Request(1))
        agent.sample(0x16, number_bytes(1)) if agent.session_id else None
        agent.sample(0x08, IDENTITY + number_bytes(1)) if agent.session_id else None

    timer = scenario.node.create_timer(0.1, act)
    while not done[0] and len(agent.samples) < 8:
        scenario.node.spin_once(0.01)
        done[0] = agent.alive <= 0
    scenario.run(restart_ms)
    timer.cancel()
    agent.alive = None
    agent.silent = False
    if forgets:
        agent.forget()
    scenario.run(50)
    scenario.until(lambda: scenario.node.state == AGENT_CONNECTED and len(agent.creations) == 9)
    scenario.run(2500)  # lasting faults show within this time
    scenario.works()
    return done[0], scenario


def test_an_agent_that_dies_after_any_datagram_is_replaced() -> None:
    """The agent dies after any datagram, a new one starts 3 s later, and the node works."""
    alive = 1
    while run_with_restart(alive, 3000)[0]:
        alive += STEP
    assert alive > 60, alive


def test_an_agent_that_restarts_after_any_datagram() -> None:
    """The agent restarts after any datagram, at once and without sessions; the node works."""
    alive = 1
    while run_with_restart(alive, 1)[0]:
        alive += STEP
    assert alive > 60, alive


def test_an_agent_that_stalls_for_a_second_after_any_datagram() -> None:
    """The agent keeps its session: no message is lost, and the node does not disconnect."""
    alive = 1
    going = True
    while going:
        going, scenario = run_with_restart(alive, 1000, False)
        assert AGENT_DISCONNECTED not in scenario.states, (alive, scenario.states)
        alive += STEP
    assert alive > 60, alive


# --- wrong answers ------------------------------------------------------------------------------


class WrongAgent(FakeAgent):
    """An agent whose messages ``change(kind, payload, session id)`` changes, or drops by None."""

    change = None

    def answer(self, kind, payload, session_id=None):
        self.tell(kind, payload, session_id, super().answer)

    def reliable(self, kind, payload, flags=ids.FLAG_LITTLE_ENDIAN):
        if self.change is None:
            super().reliable(kind, payload, flags)
        else:
            changed_message = self.change(kind, payload, self.session_id)
            if changed_message is not None:
                super().reliable(changed_message[0], changed_message[1], flags)

    def tell(self, kind, payload, session_id, say):
        if self.change is not None:
            changed_message = self.change(kind, payload, session_id or self.session_id)
            if changed_message is None:
                return
            kind, payload, session_id = changed_message
        say(kind, payload, session_id)


def changed(octets, at, value):
    out = bytearray(octets)
    out[at] = value
    return bytes(out)


def changes():
    """Return (name, change) of each change."""
    out = []
    for status in (1, 0x80, 0x83, 0x88, 0xFF):

        def change(kind, payload, session_id, status=status):
            if kind == ids.STATUS:
                payload = changed(payload, 4, status)
            elif kind == ids.STATUS_AGENT:
                payload = changed(payload, 0, status)
            return kind, payload, session_id

        out.append(("status %d" % status, change))
    for at in (0, 1, 2, 3):

        def change(kind, payload, session_id, at=at):
            if kind in (ids.STATUS, ids.INFO, ids.DATA):
                payload = changed(payload, at, payload[at] ^ 0x55)
            return kind, payload, session_id

        out.append(("id octet %d" % at, change))
    for changed_id in (0x80, 0x82, 0xFE, 0x01):
        out.append(
            (
                "session %d" % changed_id,
                lambda kind, payload, session_id, changed_id=changed_id: (
                    kind,
                    payload,
                    changed_id,
                ),
            )
        )
    for changed_kind in range(16):

        def change(kind, payload, session_id, changed_kind=changed_kind):
            return (
                (changed_kind, payload, session_id)
                if kind != ids.INFO
                else (kind, payload, session_id)
            )

        out.append(("kind %d" % changed_kind, change))
        out.append(
            (
                "no kind %d" % changed_kind,
                lambda kind, payload, session_id, changed_kind=changed_kind: (
                    None if kind == changed_kind else (kind, payload, session_id)
                ),
            )
        )
    for cut in (0, 1, 3, 5):
        out.append(
            (
                "cut to %d" % cut,
                lambda kind, payload, session_id, cut=cut: (kind, payload[:cut], session_id),
            )
        )
    return out


def test_a_node_recovers_from_any_wrong_answer() -> None:
    """While the agent sends wrong messages nothing raises; afterwards the node works."""
    for before in (False, True):  # from the start, or after the node has connected
        for name, change in changes():
            agent = WrongAgent(FakeClock())
            scenario = Scenario(agent)
            if before:
                scenario.connect()
            agent.change = change
            for i in range(6):
                scenario.publisher.publish(Number(i))
                if agent.session_id:
                    agent.sample(0x16, number_bytes(i))
                scenario.run(700)
            agent.change = None
            assert all(
                [isinstance(error, ValueError) for error in scenario.errors]
            )  # of another definition
            del scenario.errors[:]
            if not before or scenario.node.state != AGENT_CONNECTED or agent.into.next != 0:
                # Wrong acknowledgements and numbers cannot be repaired: start another agent.
                agent.silent = True
                scenario.run(3000)
                agent.silent = False
                agent.forget()
            try:
                scenario.works()
            except AssertionError as error:
                raise AssertionError("%s, %s: %r" % (name, before, error))


def test_answers_to_other_requests_do_not_connect() -> None:
    """Only the STATUS of its own requests confirms that an entity is created."""
    agent = WrongAgent(FakeClock())
    scenario = Scenario(agent)

    def change(kind, payload, session_id):
        if kind == ids.STATUS:
            payload = changed(payload, 0, 0x77)
        return kind, payload, session_id

    agent.change = change
    scenario.run(10000)
    assert AGENT_CONNECTED not in scenario.states and AGENT_AVAILABLE in scenario.states
    assert "unanswered" in scenario.node.connection.reason


def test_datagrams_of_foreign_sessions_are_counted_and_ignored() -> None:
    scenario = Scenario(FakeAgent(FakeClock()))
    scenario.connect()
    agent = scenario.agent
    sample = built(session.push_request, 0, 0x16) + number_bytes(5)
    before = scenario.node.connection.dropped
    for session_id in (0x80, 0x82, 0x90, 0xFE, 0xFF):
        for stream in (0, 1, 0x80):
            agent.post(message(ids.DATA, sample, stream, 0, session_id))
    scenario.run(100)
    assert scenario.heard == [] and scenario.node.connection.dropped - before == 15
    scenario.works()


# --- callbacks ----------------------------------------------------------------------------------


def test_every_callback_may_raise_without_effect_on_others() -> None:
    scenario = Scenario(FakeAgent(FakeClock()))
    agent = scenario.agent

    def fail(*arguments):
        raise RuntimeError("mine")

    scenario.connect()
    node = scenario.node
    node.create_subscription(Number, "bad", fail)  # 0x26
    node.create_service(Ask, "bad", fail)  # 0x18
    timer = node.create_timer(0.05, fail)
    guard = node.create_guard_condition(fail)
    node.on_state = fail
    scenario.run(20)
    agent.sample(0x26, number_bytes(1))
    agent.sample(0x18, IDENTITY + number_bytes(1))
    guard.trigger()
    future = scenario.client.call_async(Ask.Request(1))
    future.add_done_callback(fail)
    number = [datagram[8:10] for datagram in agent.sent if datagram[4] == ids.WRITE_DATA][-1]
    agent.sample(0x07, number + b"\0\7" + number_bytes(9))
    agent.sample(0x16, number_bytes(3))
    scenario.run(52)
    assert len(scenario.errors) == 5 == node.executor.failed, scenario.errors
    assert all([isinstance(error, RuntimeError) for error in scenario.errors])
    assert scenario.heard == [3]
    timer.cancel()
    agent.silent = True  # on_state raises in each of these
    scenario.run(4000)
    agent.silent = False
    agent.forget()
    scenario.connect()
    assert scenario.publisher.publish(Number(1)) and node.connection.connections == 2


def test_samples_lost_by_slow_callbacks_are_counted() -> None:
    """The samples are best effort: reliable ones wait at the agent."""
    scenario = Scenario(FakeAgent(FakeClock()))
    scenario.connect()
    subscription = scenario.node.create_subscription(Number, "fast", scenario.heard.append, 5)
    scenario.run(20)
    for i in range(200):
        sample = built(session.push_request, 0, 0x26) + number_bytes(i)
        scenario.agent.post(message(ids.DATA, sample, 1, i, scenario.agent.session_id))
        scenario.node.connection.pump(0)  # as a callback that spins
    scenario.run(100)
    assert [message.value for message in scenario.heard] == list(
        range(200 - len(scenario.heard), 200)
    )
    assert subscription.lost == 200 - len(scenario.heard) > 100


def test_samples_of_another_definition_are_counted() -> None:
    """Samples that cannot be decoded are counted; trailing octets of others are ignored."""
    scenario = Scenario(FakeAgent(FakeClock()))
    scenario.connect()
    subscription = scenario.node.executor.handles[0]
    for octets in (b"", b"\1", b"abc", number_bytes(5) + b"more", number_bytes(6)):
        scenario.agent.sample(0x16, octets)
    scenario.agent.sample(0x08, IDENTITY + b"x")
    scenario.run(100)
    assert scenario.heard == [5, 6] and subscription.malformed == 3
    # The first one of each entity is reported with the remedy.
    assert len(scenario.errors) == 2 and "definition" in str(scenario.errors[0])
    del scenario.errors[:]
    scenario.works()


# --- pipelining ---------------------------------------------------------------------------------


def test_reliable_publishing_takes_one_round_trip_per_window() -> None:
    agent = FakeAgent(FakeClock())
    scenario = Scenario(agent)
    scenario.connect()
    agent.delay = (0, 100000)
    start = scenario.clock.t
    for i in range(160):
        before = scenario.clock.t
        assert scenario.publisher.publish(Number(i))
        assert scenario.clock.t == before  # it never waits
    assert len(agent.samples) == 16
    scenario.until(lambda: len(agent.samples) == 160)
    assert 900000 <= scenario.clock.t - start <= 1000000  # 160 / 16 windows, the first at once
    assert [sample[1] for sample in agent.samples] == [number_bytes(i) for i in range(160)]


# --- the four states ----------------------------------------------------------------------------


def test_on_state_gets_all_four_states_in_order() -> None:
    agent = FakeAgent(FakeClock())
    agent.silent = True
    scenario = Scenario(agent)
    scenario.run(3000)
    assert scenario.states == [] and scenario.node.state == WAITING_AGENT
    for _ in range(3):
        agent.silent = False
        scenario.connect()
        agent.silent = True
        scenario.until(lambda: scenario.node.state == WAITING_AGENT)
        agent.forget()
    assert scenario.states == [
        AGENT_AVAILABLE, AGENT_CONNECTED, AGENT_DISCONNECTED, WAITING_AGENT
    ] * 3  # fmt: skip
