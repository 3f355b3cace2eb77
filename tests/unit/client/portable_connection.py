"""The four states of a connection, and creation of its entities. Also runs on MicroPython."""

from support.board import KEY, FakeAgent, FakeClock, Number, built, message

from uros.client.connection import (
    AGENT_AVAILABLE,
    AGENT_CONNECTED,
    AGENT_DISCONNECTED,
    WAITING_AGENT,
    Connection,
)
from uros.wire import ids, session
from uros.wire.cdr import Reader
from uros.wire.entities import pull_create, push_binary_participant

CYCLE = [AGENT_DISCONNECTED, WAITING_AGENT, AGENT_AVAILABLE, AGENT_CONNECTED]


class FakeEntity:
    """An entity with the objects ``kinds``; ``data`` are its samples, ``lost`` counts sessions."""

    def __init__(self, name="entity", kinds=(ids.KIND_PARTICIPANT,), connection=None):
        self.name = name
        self.kinds = kinds
        self.data = []
        self.lost = 0
        self.number = connection.add(self) if connection else 0

    def object_ids(self):
        return tuple([self.number << 4 | kind for kind in self.kinds])

    def create(self, connection, step):
        if step == len(self.kinds):
            connection.listen(self, self.number << 4 | self.kinds[-1], True)
            return True
        object_id = self.object_ids()[step]
        connection.create(self, object_id, 0, push_binary_participant, self.name, None)
        return False

    def on_data(self, buf, start, stop, little):
        self.data.append(bytes(buf[start:stop]))

    def on_lost(self):
        self.lost += 1

    def on_refused(self, request_id):
        return False


class Bench:
    """A connection to a scripted agent; ``states`` are (milliseconds, state)."""

    def __init__(self, start_ms=1000, agent=FakeAgent, **options):
        self.clock = FakeClock(start_ms)
        self.agent = agent(self.clock)
        self.connection = Connection(self.agent, KEY, self.clock, **options)
        self.states = []
        self.lines = []
        self.start = self.clock.t
        self.connection.on_state = self.on_state
        self.connection.log = self.lines.append

    def on_state(self, state):
        self.states.append((self.now(), state))

    def now(self):
        """Return the milliseconds since the start."""
        return (self.clock.t - self.start) // 1000

    def run(self, ms):
        """Pump for ``ms`` milliseconds."""
        end = self.clock.t + ms * 1000
        while self.clock.t < end:
            self.connection.pump((end - self.clock.t + 999) // 1000)

    def until(self, state, ms=10000):
        end = self.clock.t + ms * 1000
        while self.connection.state != state:
            assert self.clock.t < end, (state, self.states)
            self.connection.pump((end - self.clock.t + 999) // 1000)

    def offset(self):
        """Return by how many microseconds the board's time is ahead of the agent's."""
        seconds, nanoseconds = self.clock.now()
        return seconds * 1000000 + nanoseconds // 1000 - self.clock.t - self.agent.epoch_us

    def pings(self, within):
        start = self.start // 1000
        return [at - start for at, in_session in self.agent.pings if in_session == within]


# --- waiting ----------------------------------------------------------------------------------


def test_a_waiting_connection_pings_every_half_second() -> None:
    bench = Bench()
    bench.agent.silent = True
    bench.run(3100)
    assert len(bench.agent.sent) == 7 and bench.agent.opened == 1
    assert set(bench.agent.sent) == {bytes.fromhex("8000000002010800000afffd02000000")}
    assert bench.states == [] and bench.connection.state == WAITING_AGENT
    assert bench.connection.write(5, Number(1), b"", True) == 0


def test_frequent_pumping_does_not_increase_the_ping_rate() -> None:
    bench = Bench()
    bench.agent.silent = True
    for _ in range(2000):
        bench.connection.pump(0)
        bench.clock.sleep(1)
    assert len(bench.agent.sent) == 4


def test_a_pump_returns_within_its_timeout() -> None:
    bench = Bench()
    bench.connection.pump(7)
    bench.agent.silent = True
    for state in (AGENT_AVAILABLE, AGENT_CONNECTED):
        bench.until(state)
        bench.agent.silent = False
        before = bench.clock.t
        bench.connection.pump(7)
        assert bench.clock.t - before <= 7000


def test_a_transport_that_does_not_open_is_retried() -> None:
    bench = Bench()
    bench.agent.fail_open = OSError(2, "no such line")
    bench.run(2200)
    assert bench.agent.opened == 5 and bench.now() == 2200
    assert bench.states == [] and "no such line" in bench.connection.reason
    bench.agent.fail_open = None
    bench.run(400)
    assert bench.connection.state == AGENT_CONNECTED


def test_the_wrap_of_ticks_has_no_effect() -> None:
    for before in (0, 1, 200, 499, 700, 2000):
        bench = Bench((1 << 30) - before)
        bench.run(3000)
        assert [state for _, state in bench.states] == [AGENT_AVAILABLE, AGENT_CONNECTED]
        bench.agent.silent = True
        bench.run(3000)
        assert [state for _, state in bench.states][2:] == CYCLE[:2], before


# --- the start of a session -------------------------------------------------------------------


def test_from_the_first_ping_to_connected() -> None:
    bench = Bench()
    entities = [FakeEntity(name, connection=bench.connection) for name in ("one", "two")]
    bench.run(1)
    assert bench.states == [(0, AGENT_AVAILABLE), (0, AGENT_CONNECTED)]
    assert bench.agent.create_clients == [(1000, 0x81)]
    assert bench.agent.requests == [
        (ids.CREATE, 0x01), (ids.READ_DATA, 0x01), (ids.CREATE, 0x11), (ids.READ_DATA, 0x11),
    ]  # fmt: skip
    assert bench.connection.connections == 1 and bench.connection.unconfirmed == 0
    assert bench.agent.times == 3 and bench.connection.clock.synchronized
    bench.agent.sample(0x11, b"abcd")
    bench.run(1)
    assert entities[0].data == [] and entities[1].data == [b"abcd"]


def test_creation_has_the_flags_and_the_order_of_the_c_client() -> None:
    bench = Bench()
    FakeEntity("name", connection=bench.connection)
    bench.run(1)
    flags, payload = bench.agent.creations[0]
    assert flags == 0x07  # little endian, reuse, replace: as captured
    r = Reader(payload, 0, len(payload), True)
    content = built(push_binary_participant, "name", None)
    assert pull_create(r) == (10, 0x01, ids.KIND_PARTICIPANT, ids.IN_BINARY, content, 0)


def test_a_lost_create_client_is_repeated() -> None:
    bench = Bench()
    bench.agent.status = None

    def outside_session(kind, flags, payload, usual=bench.agent.outside_session):
        if kind == ids.CREATE_CLIENT and bench.now() < 500:
            bench.agent.create_clients.append((bench.now(), 0))
        else:
            bench.agent.status = ids.STATUS_OK
            usual(kind, flags, payload)

    bench.agent.outside_session = outside_session
    bench.until(AGENT_CONNECTED)
    assert bench.agent.create_clients == [(0, 0), (200, 0), (400, 0), (1600, 0x81)]


def test_an_unanswered_create_client_ends_in_waiting_agent() -> None:
    bench = Bench()
    usual = bench.agent.outside_session

    def outside_session(kind, flags, payload):
        if kind == ids.GET_INFO:
            usual(kind, flags, payload)

    bench.agent.outside_session = outside_session
    bench.run(2600)
    assert bench.states == [
        (0, AGENT_AVAILABLE), (2000, AGENT_DISCONNECTED), (2000, WAITING_AGENT),
        (2500, AGENT_AVAILABLE),
    ]  # fmt: skip
    assert "silent" in bench.connection.reason
    assert bench.connection.connections == 0


def test_late_and_repeated_pongs_are_ignored() -> None:
    bench = Bench()
    bench.run(5)
    info = built(session.push_info, 10, ids.OBJECT_AGENT, 0, 0, [])
    for _ in range(3):
        bench.agent.post(message(ids.INFO, info, session_id=0x80))
    bench.run(5)
    assert [state for _, state in bench.states] == [AGENT_AVAILABLE, AGENT_CONNECTED]
    assert len(bench.agent.create_clients) == 1


def test_a_slow_line_answers_two_create_clients_and_connects() -> None:
    bench = Bench()
    entity = FakeEntity(connection=bench.connection)
    bench.agent.delay = (150000, 150000)
    bench.run(5000)
    assert [state for _, state in bench.states] == [AGENT_AVAILABLE, AGENT_CONNECTED]
    assert [session_id for _, session_id in bench.agent.create_clients] == [0x81, 0x81]
    bench.agent.sample(0x01, b"abcd")
    bench.run(500)
    assert entity.data == [b"abcd"]


def test_more_entities_than_a_window_are_created_in_order() -> None:
    bench = Bench()
    bench.agent.delay = (5000, 5000)
    entities = [FakeEntity("entity%d" % i, connection=bench.connection) for i in range(50)]
    bench.run(2000)
    assert bench.connection.state == AGENT_CONNECTED
    expected = []
    for entity in entities:
        for object_id in entity.object_ids():
            expected += [(ids.CREATE, object_id), (ids.READ_DATA, object_id)]
    assert bench.agent.requests == expected


class QueueingAgent(FakeAgent):
    """Agent that queues as eProsima's.

    It drops a STATUS while 15 of its messages are not acknowledged. Received datagrams, ACKNACKs
    included, are queued and handled every ``queue_ms``.
    """

    queue_ms = 20
    dropped = 0
    turn = 0
    queue = ()

    def send(self, message, size):
        assert self.is_open
        if self.clock.ms() - self.turn >= self.queue_ms:
            self.turn = self.clock.ms()
            queue = self.queue
            self.queue = ()
            for datagram in queue:
                self.hear(datagram)
        self.queue += (bytes(memoryview(message)[:size]),)

    def receive(self, timeout_ms):
        if self.queue and not self.inbox:
            self.clock.t = max(self.clock.t, (self.turn + self.queue_ms) * 1000)
            self.turn = self.clock.ms()
            queue = self.queue
            self.queue = ()
            for datagram in queue:
                self.hear(datagram)
        return FakeAgent.receive(self, timeout_ms)

    def reliable(self, kind, payload, flags=ids.FLAG_LITTLE_ENDIAN):
        if kind == ids.STATUS and len(self.out) >= 15:
            self.dropped += 1
        else:
            FakeAgent.reliable(self, kind, payload, flags)


def test_unanswered_requests_stay_below_the_queue_of_the_agent() -> None:
    bench = Bench()
    bench.connection.transport = bench.agent = QueueingAgent(bench.clock)
    kinds = tuple(range(1, 9))
    for i in range(6):
        FakeEntity("entity%d" % i, kinds, bench.connection)
    bench.run(2000)
    assert bench.agent.dropped == 0 and bench.connection.state == AGENT_CONNECTED
    assert bench.connection.connections == 1


def test_entities_are_created_while_the_agent_drops_every_status() -> None:
    """eProsima's agent drops each STATUS while a busy topic fills its stream."""
    bench = Bench()
    bench.until(AGENT_CONNECTED)
    bench.agent.reliable = lambda kind, payload: None
    entities = [FakeEntity("entity%d" % i, connection=bench.connection) for i in range(20)]
    bench.run(3000)
    assert [object_id for _, object_id in bench.agent.requests[::2]] == [
        entity.object_ids()[0] for entity in entities
    ]
    assert bench.connection.connections == 1


def test_many_entities_are_created_over_a_slow_line() -> None:
    bench = Bench()
    bench.agent.delay = (250000, 250000)
    entities = [FakeEntity("entity%d" % i, connection=bench.connection) for i in range(90)]
    bench.until(AGENT_CONNECTED, 20000)
    # Longer than silence_ms altogether, but each request was answered in time.
    assert bench.now() > 3000 and entities[0].lost == 0, bench.now()
    assert [state for _, state in bench.states] == [AGENT_AVAILABLE, AGENT_CONNECTED]


def test_numbers_count_up_for_each_first_kind() -> None:
    bench = Bench()
    kinds = [
        (ids.KIND_PARTICIPANT,), (ids.KIND_TOPIC, ids.KIND_DATAWRITER), (ids.KIND_REPLIER,),
        (ids.KIND_TOPIC, ids.KIND_DATAREADER), (ids.KIND_REPLIER,),
    ]  # fmt: skip
    entities = [FakeEntity("entity", kind, bench.connection) for kind in kinds]
    assert [entity.object_ids() for entity in entities] == [
        (0x01,), (0x02, 0x05), (0x08,), (0x12, 0x16), (0x18,),
    ]  # fmt: skip


# --- refusals ---------------------------------------------------------------------------------


def test_a_refused_entity_is_logged_with_its_status_and_retried_after_a_pause() -> None:
    bench = Bench()
    FakeEntity("good", connection=bench.connection)
    FakeEntity("bad", connection=bench.connection)
    bench.agent.refuse = {0x11: ids.STATUS_ERR_RESOURCES}
    bench.run(1100)
    assert [(at, state) for at, state in bench.states] == [
        (0, AGENT_AVAILABLE), (0, AGENT_DISCONNECTED), (0, WAITING_AGENT),
        (500, AGENT_AVAILABLE), (500, AGENT_DISCONNECTED), (500, WAITING_AGENT),
        (1000, AGENT_AVAILABLE), (1000, AGENT_DISCONNECTED), (1000, WAITING_AGENT),
    ]  # fmt: skip
    assert bench.lines == ["uros: the agent refuses bad: ERR_RESOURCES"] * 3
    assert bench.connection.reason == "the agent refuses bad: ERR_RESOURCES"
    assert [session_id for _, session_id in bench.agent.create_clients] == [0x81, 0x82, 0x83]
    assert bench.connection.connections == 0
    bench.agent.refuse = {}
    bench.run(500)
    assert bench.connection.state == AGENT_CONNECTED and bench.connection.connections == 1


def test_a_refused_session_is_logged() -> None:
    bench = Bench()
    bench.agent.status = ids.STATUS_ERR_INCOMPATIBLE
    bench.run(600)
    assert bench.lines == ["uros: the agent refuses the session: ERR_INCOMPATIBLE"] * 2
    assert bench.connection.state == WAITING_AGENT


def test_an_entity_longer_than_a_message_is_logged() -> None:
    bench = Bench()
    FakeEntity("x" * 600, connection=bench.connection)
    bench.run(1)
    assert bench.connection.state == WAITING_AGENT
    assert bench.connection.reason and len(bench.lines) == 1
    assert bench.connection.reason in bench.lines[0]


def test_an_existing_entity_counts_as_created() -> None:
    bench = Bench()
    FakeEntity(connection=bench.connection)
    bench.agent.refuse = {0x01: ids.STATUS_OK_MATCHED}
    bench.run(1)
    assert bench.connection.state == AGENT_CONNECTED and bench.lines == []


# --- an agent that goes away ------------------------------------------------------------------


def test_a_silent_agent_is_pinged_and_then_lost() -> None:
    bench = Bench()
    entity = FakeEntity(connection=bench.connection)
    bench.run(1)
    bench.agent.silent = True
    sent = len(bench.agent.sent)
    bench.run(2190)
    assert bench.connection.state == AGENT_CONNECTED and entity.lost == 0
    pings = [datagram for datagram in bench.agent.sent[sent:] if datagram[4] == ids.GET_INFO]
    assert set(pings) == {bytes.fromhex("8100000002010800000afffd02000000")}
    assert len(pings) == 10
    bench.run(20)
    # Two seconds from the first ping without an answer.
    assert bench.states[2:] == [(2200, AGENT_DISCONNECTED), (2200, WAITING_AGENT)]
    assert entity.lost == 1 and not bench.agent.is_open
    assert bench.connection.reason == "the agent is silent"


def test_an_agent_that_answers_is_pinged_every_ping_ms() -> None:
    for ping_ms in (200, 500, 1000):
        for way_us in (0, 1000, 40000, 90000):
            bench = Bench(ping_ms=ping_ms, silence_ms=2500)
            bench.agent.delay = (way_us, way_us)
            bench.run(20000)
            assert [state for _, state in bench.states] == [AGENT_AVAILABLE, AGENT_CONNECTED]
            pings = bench.pings(True)
            gaps = [b - a for a, b in zip(pings, pings[1:])]
            assert len(pings) > 19000 // ping_ms - 3, (ping_ms, way_us, pings)
            assert set(gaps) == {ping_ms}, (ping_ms, way_us, gaps)


def test_single_lost_pongs_do_not_end_the_session() -> None:
    # The periods of firmware/esp32_wifi_publisher.
    bench = Bench(ping_ms=1000, silence_ms=2500)
    bench.run(100)
    answers = [0]
    post = bench.agent.post

    def lossy(datagram):
        if datagram[4] == ids.INFO:
            answers[0] += 1
            if answers[0] % 3:  # two of three
                return
        post(datagram)

    bench.agent.post = lossy
    bench.run(60000)
    assert answers[0] >= 55 and bench.connection.connections == 1, bench.connection.reason
    bench.agent.post = post
    bench.run(1500)
    bench.agent.silent = True
    start = bench.now()
    bench.until(WAITING_AGENT)
    assert 2500 <= bench.now() - start <= 3500


def test_a_short_silence_ms_leaves_the_agent_time_for_a_takeover_probe() -> None:
    bench = Bench(ping_ms=20, silence_ms=300, wait_ms=20)
    post, begun = bench.agent.post, []

    def probing(datagram):
        """Answer CREATE_CLIENT after a takeover probe of 0.5 s."""
        if datagram[4] == ids.STATUS_AGENT:
            begun.append(bench.now())
            if begun[-1] - begun[0] < 500:
                return
        post(datagram)

    bench.agent.post = probing
    bench.until(AGENT_CONNECTED, 1500)
    assert bench.agent.opened == 1, (
        "the transport must still have the address that the answer is sent to"
    )
    bench.agent.silent = True
    start = bench.now()
    bench.until(WAITING_AGENT)
    assert bench.now() - start <= 340


def test_an_agent_silent_for_less_than_two_seconds_is_not_lost() -> None:
    # Whatever was received last: a pong, a sample, a TIMESTAMP_REPLY.
    for after in range(0, 460, 7):
        bench = Bench()
        FakeEntity(connection=bench.connection)
        bench.run(after)
        if after % 2:
            bench.agent.sample(0x01, b"abcd")
            bench.run(after % 40)
        if bench.connection.state != AGENT_CONNECTED:
            continue
        bench.agent.silent = True
        bench.run(1999)
        bench.agent.silent = False
        bench.agent.acknowledge()  # an agent with --state sends restored clients an ACKNACK at once
        bench.run(5000)
        assert bench.connection.connections == 1, (after, bench.states)


def test_long_callbacks_do_not_end_a_session_on_a_slow_line() -> None:
    bench = Bench()
    bench.run(10)
    bench.agent.delay = (60000, 60000)
    for _ in range(20):
        bench.clock.sleep(3000)
        for _ in range(5):
            bench.connection.pump(0)
        bench.run(130)
    assert len(bench.states) == 2, (bench.states, bench.connection.reason)


def test_an_agent_that_sends_samples_is_not_pinged() -> None:
    bench = Bench()
    FakeEntity(connection=bench.connection)
    bench.run(10)
    before = len(bench.agent.pings)
    for _ in range(100):
        bench.agent.sample(0x01, b"abcd")
        bench.run(50)
    assert len(bench.agent.pings) == before


def test_the_time_of_a_long_callback_does_not_count_as_silence() -> None:
    bench = Bench()
    bench.run(10)
    bench.agent.answer(ids.INFO, built(session.push_info, 10, ids.OBJECT_AGENT, 0, 1, []))
    bench.clock.sleep(60000)  # meanwhile a message of the agent was received
    bench.run(100)
    assert bench.connection.state == AGENT_CONNECTED
    bench.clock.sleep(60000)  # no message, but no ping was sent either
    bench.run(100)
    assert bench.connection.state == AGENT_CONNECTED, bench.connection.reason


def test_all_entities_are_created_again_at_each_agent() -> None:
    bench = Bench()
    entities = [FakeEntity(name, connection=bench.connection) for name in ("one", "two")]
    for turn in range(5):
        bench.run(700)
        assert bench.connection.state == AGENT_CONNECTED
        assert bench.agent.requests == [
            (ids.CREATE, 0x01), (ids.READ_DATA, 0x01), (ids.CREATE, 0x11), (ids.READ_DATA, 0x11),
        ]  # fmt: skip
        bench.agent.sample(0x11, bytes((turn,)))
        bench.run(1)
        bench.agent.forget()
        bench.until(WAITING_AGENT)
    assert entities[1].data == [bytes((i,)) for i in range(5)]
    assert entities[0].lost == 5 and bench.connection.connections == 5
    assert [session_id for _, session_id in bench.agent.create_clients] == [
        0x81,
        0x82,
        0x83,
        0x84,
        0x85,
    ]
    assert [state for _, state in bench.states] == (CYCLE[2:] + CYCLE[:2]) * 5


def test_an_agent_that_does_not_know_the_session_is_lost_at_once() -> None:
    bench = Bench()
    bench.run(10)
    bench.agent.answer(ids.INFO, built(session.push_info, 10, ids.OBJECT_AGENT, 0, 0, []))
    bench.run(10)
    assert bench.states[2:] == [(10, AGENT_DISCONNECTED), (10, WAITING_AGENT)]
    assert "does not know" in bench.connection.reason
    bench.run(600)
    assert bench.connection.state == AGENT_CONNECTED


def test_an_oserror_of_receive_ends_the_session() -> None:
    bench = Bench()
    entity = FakeEntity(connection=bench.connection)
    bench.run(10)
    bench.agent.fail_receive = OSError(5, "unplugged")
    bench.run(10)
    assert bench.states[2:] == [(10, AGENT_DISCONNECTED), (10, WAITING_AGENT)]
    assert "unplugged" in bench.connection.reason and entity.lost == 1
    bench.run(2000)  # open succeeds, receive fails: few retries, and no change of state
    assert len(bench.states) == 4 and bench.agent.opened <= 6, bench.states
    bench.agent.fail_receive = None
    bench.run(600)
    assert bench.connection.state == AGENT_CONNECTED


def test_an_oserror_of_send_ends_the_session() -> None:
    bench = Bench()
    bench.run(10)
    bench.agent.fail_send = OSError(5, "unplugged")
    bench.connection.write(5, Number(1), b"", True)
    bench.run(10)
    assert bench.states[2:] == [(10, AGENT_DISCONNECTED), (10, WAITING_AGENT)]
    assert "unplugged" in bench.connection.reason
    assert bench.connection.unconfirmed == 1
    bench.run(2000)
    assert len(bench.states) == 4 and bench.agent.opened <= 6, bench.states
    bench.agent.fail_send = None
    bench.run(600)
    assert bench.connection.state == AGENT_CONNECTED


def test_messages_in_flight_are_counted_and_not_sent_to_the_next_agent() -> None:
    bench = Bench()
    bench.run(10)
    bench.agent.silent = True
    for i in range(20):  # a window, and four queued messages
        assert bench.connection.write(5, Number(i), b"", True)
    bench.until(WAITING_AGENT)
    assert bench.connection.unconfirmed == 20
    bench.agent.silent = False
    bench.agent.forget()
    bench.run(3000)
    assert bench.connection.state == AGENT_CONNECTED and bench.agent.samples == []


def test_an_agent_restarts_while_entities_are_created() -> None:
    for after in range(1, 9):
        bench = Bench()
        for i in range(4):
            FakeEntity("entity%d" % i, connection=bench.connection)
        usual = bench.agent.submessage

        def submessage(kind, flags, payload, bench=bench, usual=usual, after=after):
            usual(kind, flags, payload)
            if len(bench.agent.requests) == after and len(bench.agent.create_clients) == 1:
                bench.agent.forget()

        bench.agent.submessage = submessage
        bench.run(4000)
        assert bench.connection.state == AGENT_CONNECTED, (after, bench.states)
        assert [request[1] for request in bench.agent.requests] == [1, 1, 17, 17, 33, 33, 49, 49]


# --- the agent restarts its session -----------------------------------------------------------


def test_a_late_create_client_resets_the_session_at_both_ends() -> None:
    """After a repeated, late CREATE_CLIENT the agent's streams start at 0."""
    for after_ms in (0, 5, 1000):
        bench = Bench()
        entity = FakeEntity(connection=bench.connection)
        bench.run(1)
        for i in range(after_ms // 100):
            bench.agent.sample(0x01, bytes((i,)))
            bench.run(100)
        create_client = [
            datagram for datagram in bench.agent.sent if datagram[4] == ids.CREATE_CLIENT
        ][-1]
        bench.agent.hear(create_client)
        bench.run(3000)
        assert bench.connection.state == AGENT_CONNECTED
        before = len(entity.data)
        for _ in range(3):
            bench.agent.sample(0x01, b"after")
            assert bench.connection.write(5, Number(7), b"", True)
            bench.run(300)
        assert len(entity.data) == before + 3 and len(bench.agent.samples) == 3, after_ms


def test_a_session_whose_requests_stay_unanswered_is_restarted() -> None:
    """The agent answers pings, but no CREATE."""
    bench = Bench()
    FakeEntity(connection=bench.connection)
    usual = bench.agent.submessage

    def submessage(kind, flags, payload):
        if kind != ids.CREATE or len(bench.agent.create_clients) > 1:
            usual(kind, flags, payload)

    bench.agent.submessage = submessage
    bench.run(6000)
    assert bench.connection.state == AGENT_CONNECTED, bench.states


# --- entities that come and go ----------------------------------------------------------------


def test_an_entity_added_while_connected_is_created_at_once() -> None:
    bench = Bench()
    bench.run(10)
    entity = FakeEntity("late", connection=bench.connection)
    bench.run(10)
    assert bench.agent.requests == [(ids.CREATE, 0x01), (ids.READ_DATA, 0x01)]
    assert [state for _, state in bench.states] == [AGENT_AVAILABLE, AGENT_CONNECTED]
    bench.agent.sample(0x01, b"abcd")
    bench.run(1)
    assert entity.data == [b"abcd"]
    bench.agent.forget()
    bench.until(WAITING_AGENT)
    bench.until(AGENT_CONNECTED)
    assert bench.agent.requests == [(ids.CREATE, 0x01), (ids.READ_DATA, 0x01)]


def test_an_entity_added_by_the_state_callback() -> None:
    for state in (AGENT_AVAILABLE, AGENT_CONNECTED):
        bench = Bench()
        entities = []

        def on_state(now, state=state, entities=entities, bench=bench):
            if now == state:
                entities.append(FakeEntity(connection=bench.connection))

        bench.connection.on_state = on_state
        bench.run(10)
        assert bench.agent.requests == [(ids.CREATE, 0x01), (ids.READ_DATA, 0x01)], state
        assert len(entities) == 1


def test_a_removed_entity_is_deleted_in_reverse_order_and_not_created_again() -> None:
    bench = Bench()
    kinds = (ids.KIND_TOPIC, ids.KIND_SUBSCRIBER, ids.KIND_DATAREADER)
    entity = FakeEntity("entity", kinds, bench.connection)
    second = FakeEntity("other", kinds, bench.connection)
    bench.run(10)
    del bench.agent.requests[:]
    bench.connection.remove(entity, entity.object_ids())
    bench.run(10)
    assert bench.agent.requests == [(ids.DELETE, object_id) for object_id in (0x06, 0x04, 0x02)]
    bench.agent.sample(0x06, b"abcd")
    bench.agent.sample(0x16, b"abcd")
    bench.run(1)
    assert entity.data == [] and second.data == [b"abcd"]
    bench.agent.forget()
    bench.until(WAITING_AGENT)
    bench.until(AGENT_CONNECTED)
    assert {request[1] >> 4 for request in bench.agent.requests} == {1}
    assert bench.connection.state == AGENT_CONNECTED


def test_an_entity_removed_before_its_creation_is_not_requested() -> None:
    bench = Bench()
    bench.connection.remove(FakeEntity("one", connection=bench.connection), (0x01,))
    bench.run(10)
    entity = FakeEntity("two", connection=bench.connection)
    bench.connection.remove(entity, entity.object_ids())
    bench.run(10)
    assert bench.agent.requests == [] and bench.connection.state == AGENT_CONNECTED


def test_an_entity_removed_during_its_creation_leaves_no_objects() -> None:
    """The agent refuses DELETE of unknown objects, which does not end the session."""
    three = (ids.KIND_TOPIC, ids.KIND_SUBSCRIBER, ids.KIND_DATAREADER)
    # ``before`` are the objects of the other entities, each with a READ_DATA: their requests leave
    # little of the window of 16.
    for created, before in ((0, (3, 3, 3, 3)), (1, (3, 3, 3, 2)), (2, (3, 3, 3, 1)),
                            (3, (3, 3, 2, 1)), (3, (3, 3, 3))):  # fmt: skip
        bench = Bench()
        entities = [FakeEntity("other", three[:count], bench.connection) for count in before]
        entity = FakeEntity("entity", three, bench.connection)
        entities.append(FakeEntity("last", three, bench.connection))
        objects = set()
        usual = bench.agent.submessage

        def submessage(kind, flags, payload, bench=bench, objects=objects, usual=usual):
            object_id = payload[2] << 8 | payload[3]
            if kind == ids.CREATE:
                objects.add(object_id)
            elif kind == ids.DELETE:
                bench.agent.refuse = {}
                if object_id not in objects:
                    bench.agent.refuse = {object_id: ids.STATUS_ERR_UNKNOWN_REFERENCE}
                objects.discard(object_id)
            usual(kind, flags, payload)

        bench.agent.submessage = submessage
        acknowledge = bench.agent.acknowledge
        bench.agent.acknowledge = lambda: None
        bench.run(10)
        assert len(objects & set(entity.object_ids())) == created
        bench.connection.remove(entity, entity.object_ids())
        bench.agent.acknowledge = acknowledge
        bench.agent.acknowledge()
        bench.run(1000)
        assert bench.connection.state == AGENT_CONNECTED, bench.connection.reason
        assert bench.connection.connections == 1 and bench.lines == [], bench.lines
        expected = set()
        for remaining in entities:
            expected |= set(remaining.object_ids())
        assert objects == expected, (created, objects)


# --- callbacks --------------------------------------------------------------------------------


def test_a_state_callback_that_raises_is_logged_only() -> None:
    bench = Bench()

    def on_state(state):
        raise RuntimeError("mine")

    bench.connection.on_state = on_state
    bench.run(10)
    assert bench.connection.state == AGENT_CONNECTED
    assert len(bench.lines) == 2 and "mine" in bench.lines[0]


def test_a_pump_ends_after_each_sample() -> None:
    """The callback of a sample runs before the next one is received."""
    bench = Bench()
    entity = FakeEntity(connection=bench.connection)
    bench.run(10)
    for _ in range(3):
        bench.agent.sample(0x01, b"abcd")
    for count in (1, 2, 3):
        bench.connection.pump(100)
        assert len(entity.data) == count
    assert bench.now() == 10


def test_a_pump_handles_a_limited_number_of_datagrams() -> None:
    bench = Bench()
    bench.run(10)
    for _ in range(100):
        bench.agent.post(b"\x81\0\0\0\x63\x01\0\0")
    bench.connection.pump(100)
    assert 50 < len(bench.agent.inbox) < 100 and bench.now() == 10


def test_no_datagram_of_a_burst_is_lost() -> None:
    """The scripted agent resends nothing."""
    bench = Bench()
    FakeEntity(connection=bench.connection)
    bench.run(10)
    heard = []

    def receive(datagram, now, usual=bench.connection.receive):
        heard.append(datagram[2])
        return usual(datagram, now)

    bench.connection.receive = receive
    for i in range(100):
        bench.agent.post(bytes((0x81, 0, i, 0, 0x63, 1, 0, 0)))
    bench.run(50)
    assert heard == list(range(100))


def test_datagrams_of_other_sessions_do_not_keep_an_agent_alive() -> None:
    bench = Bench()
    bench.run(10)
    bench.agent.silent = True
    for _ in range(300):
        bench.agent.post(b"\x99\0\0\0\x63\x01\0\0")
        bench.agent.post(b"?")
        bench.run(10)
    assert [state for _, state in bench.states][2:4] == CYCLE[:2]
    assert bench.connection.dropped > 100


# --- the end ----------------------------------------------------------------------------------


def test_close_deletes_the_session_and_waits_for_the_status() -> None:
    bench = Bench()
    entity = FakeEntity(connection=bench.connection)
    bench.run(10)
    bench.agent.delay = (20000, 20000)
    bench.connection.close()
    assert bench.now() == 50 and bench.agent.session_id == 0
    assert bench.states[2:] == [(50, AGENT_DISCONNECTED), (50, WAITING_AGENT)]
    assert not bench.agent.is_open and entity.lost == 1


def test_close_waits_at_most_wait_ms_and_not_for_a_failed_transport() -> None:
    for fail in (False, True):
        bench = Bench()
        bench.run(10)
        bench.agent.silent = True
        if fail:
            bench.agent.fail_receive = OSError(5, "unplugged")
        bench.connection.close()
        assert bench.now() == (10 if fail else 510)
        assert bench.connection.state == WAITING_AGENT and not bench.agent.is_open


def test_close_without_a_session_sends_nothing() -> None:
    bench = Bench()
    bench.connection.close()
    bench.connection.close()
    assert bench.now() == 0 and bench.agent.sent == [] and bench.states == []


# --- the time ---------------------------------------------------------------------------------


def test_the_clock_matches_the_agents_to_a_microsecond() -> None:
    for delay in (0, 1, 137, 900, 5000, 80000):
        bench = Bench()
        bench.agent.delay = (delay, delay)
        bench.until(AGENT_CONNECTED)
        for _ in range(20):
            bench.run(777)
            assert abs(bench.offset()) <= 1, (delay, bench.offset())


class Slow(FakeAgent):
    """Answers the first TIMESTAMP only.

    It receives the message ``left_us`` before the end of a second and answers ``inside_us`` later.
    """

    def plan(self, left_us, inside_us):
        self.delay = (300, 300)
        self.left_us = left_us
        self.inside_us = inside_us

    def submessage(self, kind, flags, payload):
        if kind != ids.TIMESTAMP:
            return super().submessage(kind, flags, payload)
        self.times += 1
        if self.times == 1:
            heard = 1700000001 * 1000000 - self.left_us
            self.epoch_us = heard - self.clock.t - 300
            self.delay = (300, 300 + self.inside_us)
            asked = session.pull_timestamp(Reader(payload, 0, len(payload), True))
            self.timestamp(heard + self.inside_us, heard, asked)
            self.delay = (300, 300)
        return None


def test_the_agents_processing_time_does_not_affect_the_clock() -> None:
    for inside_us in (3, 1200, 60000):
        for left_us in (1, 700, 50000, 999999):
            bench = Bench(agent=Slow)
            bench.agent.plan(left_us, inside_us)
            while not bench.clock.synchronized:
                assert bench.now() < 1000
                bench.connection.pump(1)
            # 300 us each way; the agent's processing time is not part of the round trip.
            assert abs(bench.offset()) <= 1, (inside_us, left_us, bench.offset())


def test_the_first_reply_with_the_shortest_round_trip_sets_the_clock() -> None:
    for ways in (
        [(9000, 1000), (100, 100), (200, 1800)],
        [(100, 100), (9000, 1000), (200, 1800)],
        [(1000, 9000), (200, 1800), (100, 100)],
    ):
        bench = Bench()
        usual = bench.agent.submessage

        def submessage(kind, flags, payload, bench=bench, ways=ways, usual=usual):
            bench.agent.delay = (0, 0)
            if kind == ids.TIMESTAMP:
                bench.agent.delay = ways[min(bench.agent.times, 2)]
            usual(kind, flags, payload)

        bench.agent.submessage = submessage
        bench.until(AGENT_CONNECTED)
        bench.run(100)  # a correction backwards runs at half speed
        assert bench.agent.times == 3 and abs(bench.offset()) <= 1, (ways, bench.offset())


def test_slow_time_replies_are_rejected_and_requested_again() -> None:
    bench = Bench()
    bench.agent.delay = (100, 100)
    bench.until(AGENT_CONNECTED)
    bench.run(29000)
    asked = bench.agent.times
    bench.agent.delay = (100, 90000)  # one way only: the clock would be off by 45 ms
    bench.run(5000)
    assert 2 <= bench.agent.times - asked <= 3
    assert abs(bench.offset()) <= 1, bench.offset()
    bench.agent.delay = (100, 100)
    bench.run(40000)
    asked = bench.agent.times
    bench.run(60000)
    assert bench.agent.times - asked == 2  # every half minute


def test_time_replies_of_a_permanently_slow_line_are_accepted_in_time() -> None:
    bench = Bench()
    bench.agent.delay = (100, 100)
    bench.until(AGENT_CONNECTED)
    bench.agent.delay = (20000, 20000)
    bench.agent.epoch_us += 300000  # its clock was set
    bench.run(900000)
    assert abs(bench.offset()) <= 1, bench.offset()


def test_a_reply_to_an_older_timestamp_is_ignored() -> None:
    bench = Bench()
    bench.agent.delay = (65000, 65000)  # longer than until the next TIMESTAMP
    bench.until(AGENT_CONNECTED)
    bench.run(3000)
    assert abs(bench.offset()) <= 1, bench.offset()


def test_unrequested_time_replies_are_ignored() -> None:
    bench = Bench()
    bench.until(AGENT_CONNECTED)
    before = bench.clock.now()
    for originate in ((0, 0), before):
        bench.agent.timestamp(5000000, 5000000, originate)
    bench.run(1)
    now = bench.clock.now()
    assert now[0] - before[0] <= 1


def test_time_never_goes_back_while_small_corrections_are_made() -> None:
    bench = Bench()
    bench.until(AGENT_CONNECTED)
    for change in (-900000, -1, -500, 400000, -77777):
        bench.agent.epoch_us += change
        last = bench.clock.now()
        for _ in range(700):
            bench.run(97)
            now = bench.clock.now()
            assert now >= last, (change, last, now)
            last = now
        assert abs(bench.offset()) <= 1, (change, bench.offset())


def test_a_large_step_of_the_agents_clock_is_followed_at_once() -> None:
    for years in (-25, 10):  # ROS's seconds end in 2038
        bench = Bench()
        bench.until(AGENT_CONNECTED)
        bench.agent.epoch_us += years * 365 * 86400 * 1000000
        bench.run(31000)
        assert abs(bench.offset()) <= 1, (years, bench.offset())


def test_the_clock_follows_another_agents_time() -> None:
    bench = Bench()
    bench.until(AGENT_CONNECTED)
    bench.agent.forget()
    bench.agent.epoch_us -= 86400 * 1000000
    bench.until(WAITING_AGENT)
    bench.until(AGENT_CONNECTED)
    assert abs(bench.offset()) <= 1, bench.offset()
