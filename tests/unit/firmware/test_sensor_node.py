"""firmware/ra6m5_sensor_node: messages and their times, with virtual sensors and a fake node."""

import errno

import pytest
from unit.firmware.loader import load

from uros.client import AGENT_AVAILABLE, AGENT_CONNECTED, AGENT_DISCONNECTED, WAITING_AGENT
from uros.client.executor import Executor, Timer
from uros.qos import QoSProfile

PERIOD = 1_000_000
SAMPLES = {
    "/sensors/room_temp",
    "/sensors/humidity",
    "/sensors/thermocouple_hot",
    "/sensors/thermocouple_cold",
    "/sensors/proximity",
    "/sensors/ambient_light",
}
DIAGNOSTIC = "/sensors/diagnostic"
INITIALIZED = "ra6m5_sensor_node initialized"


class Clock:
    def __init__(self, clock):
        self.clock = clock

    def ms(self):
        return self.clock.ticks_us() // 1000

    def stamp(self, stamp):
        us = self.clock.ticks_us()
        stamp.sec, stamp.nanosec = us // 1_000_000, us % 1_000_000 * 1000


class Publisher:
    def __init__(self, node, type, topic, qos):
        self.node, self.type, self.topic, self.qos = node, type, topic, qos

    def publish(self, message):
        assert type(message) is self.type
        assert self.node.state == AGENT_CONNECTED, "no message may be published without an agent"
        if self.node.full:
            return False
        buf = bytearray(message.cdr_size())
        message.pack_into(buf, 0, 0)  # it can be packed; later changes have no effect
        copy, _ = self.type.unpack_from(buf, 0, 0, len(buf))
        self.node.sent.append((self.node.clock.clock.ticks_us(), self.topic, copy))
        return True


class Node:
    def __init__(self, clock, name, transport):
        self.name, self.transport = name, transport
        self.clock = Clock(clock)
        self.executor = Executor()
        self.state = WAITING_AGENT
        self.on_state = None
        self.full = False
        self.sent = []
        self.publishers = []

    def create_publisher(self, type, topic, qos):
        self.publishers.append(Publisher(self, type, topic, qos))
        return self.publishers[-1]

    def create_timer(self, period, callback):
        self.executor.add(Timer(period, callback, self.clock))
        return self.executor.handles[-1]

    def spin_once(self, timeout_sec):
        wait = self.executor.wait(self.clock.ms(), int(timeout_sec * 1000))
        self.clock.clock.advance(wait * 1000)
        self.executor.execute(self.clock.ms())

    def enter(self, *states):
        for state in states:
            self.state = state
            self.on_state(state)


class Running:
    """The program, started."""

    def __init__(self, program):
        self.program = program
        self.main = program.main
        self.crumbs = program.main.crumbs
        self.printed = []
        program.main.print = lambda *words: self.printed.append(" ".join(map(str, words)))
        program.main.Node = lambda name, transport: Node(program.clock, name, transport)

    def start(self):
        self.main.start()
        self.node = self.main.program.node
        return self

    def connect(self):
        self.node.enter(AGENT_AVAILABLE, AGENT_CONNECTED)
        return self

    def run(self, seconds):
        """Run for ``seconds`` of the board's time; return (µs, topic, message) of each message."""
        first = len(self.node.sent)
        end = self.program.clock.ticks_us() + int(seconds * 1e6)
        while self.program.clock.ticks_us() < end:
            self.main.step()
        assert self.node.executor.failed == 0
        return self.node.sent[first:]

    def happen(self, spec):
        self.program.board.happen(spec)

    def lines(self, seconds):
        return [m.data for _, topic, m in self.run(seconds) if topic == DIAGNOSTIC]


def by_topic(sent):
    out = {}
    for at, topic, message in sent:
        out.setdefault(topic, []).append((at, message))
    return out


@pytest.fixture
def new():
    """The loaded program with a recording node, not started."""
    with load("ra6m5_sensor_node") as program:
        yield Running(program)


@pytest.fixture
def board(new):
    return new.start().connect()


# Names and kinds.


def test_seven_topics(board):
    assert board.node.name == "ra6m5_sensor_node"
    types = {publisher.topic: publisher.type._TYPE for publisher in board.node.publishers}
    assert types == {
        "/sensors/room_temp": "sensor_msgs/msg/Temperature",
        "/sensors/humidity": "sensor_msgs/msg/RelativeHumidity",
        "/sensors/thermocouple_hot": "sensor_msgs/msg/Temperature",
        "/sensors/thermocouple_cold": "sensor_msgs/msg/Temperature",
        "/sensors/proximity": "std_msgs/msg/UInt16",
        "/sensors/ambient_light": "std_msgs/msg/UInt16",
        DIAGNOSTIC: "std_msgs/msg/String",
    }


def test_all_topics_are_reliable_and_diagnostics_are_transient_local(board):
    for publisher in board.node.publishers:
        if publisher.topic == DIAGNOSTIC:
            assert isinstance(publisher.qos, QoSProfile)
            assert publisher.qos.reliable and publisher.qos.transient_local
            assert publisher.qos.depth == 10
        else:
            assert publisher.qos == 10


# The cycle.


def test_each_topic_once_a_second(board):
    sent = by_topic(board.run(20.5))
    assert set(sent) == SAMPLES
    for topic, samples in sent.items():
        assert len(samples) == 20, topic
        gaps = [b[0] - a[0] for a, b in zip(samples, samples[1:], strict=False)]
        assert all(abs(gap - PERIOD) <= 20_000 for gap in gaps), (topic, gaps)


def test_the_period_does_not_drift(board):
    """A hundred cycles later a cycle still starts a whole number of seconds after the first one."""
    ticks = []
    tick = board.main.program.tick
    board.node.executor.handles[0].callback = lambda: (ticks.append(board.node.clock.ms()), tick())
    board.run(101)
    assert len(ticks) >= 100
    assert all(abs(at - ticks[0] - 1000 * n) <= 1 for n, at in enumerate(ticks))


def test_when_each_sensor_is_read(board):
    """In a cycle the thermocouple is read at once, the air after 20 ms, the light after 100 ms."""
    sent = by_topic(board.run(5.5))
    start = PERIOD  # the start of the program takes less than a millisecond
    after = {topic: (samples[0][0] - start) / 1000 for topic, samples in sent.items()}
    assert after["/sensors/thermocouple_hot"] < 5
    assert 20 <= after["/sensors/room_temp"] < 30
    assert 100 <= after["/sensors/proximity"] < 130


def test_nothing_waits(board):
    """No step takes longer than its transfers, so that USB is always served."""
    longest = 0
    for _ in range(500):
        before = board.program.clock.ticks_us()
        idle = board.node.executor.wait(board.node.clock.ms(), 100) * 1000
        board.main.step()
        longest = max(longest, board.program.clock.ticks_us() - before - idle)
    assert longest < 10_000  # about 60 bytes at 100 kHz


def test_values(board):
    room = board.program.board.room
    sent = by_topic(board.run(3))
    seconds = board.program.clock.world_us() / 1e6
    (_, temperature), (_, humidity) = sent["/sensors/room_temp"][-1], sent["/sensors/humidity"][-1]
    assert temperature.temperature == pytest.approx(room.temperature(seconds), abs=0.2)
    assert humidity.relative_humidity == pytest.approx(room.humidity(seconds), abs=0.02)
    assert 0 <= humidity.relative_humidity <= 1
    (_, hot), (_, cold) = (
        sent["/sensors/thermocouple_" + junction][-1] for junction in ("hot", "cold")
    )
    assert hot.temperature == pytest.approx(room.hot(seconds), abs=1.5)
    assert cold.temperature == pytest.approx(room.cold(seconds), abs=0.3)
    assert temperature.variance == humidity.variance == hot.variance == cold.variance == 0
    assert sent["/sensors/proximity"][-1][1].data == 65535  # closed
    lux = sent["/sensors/ambient_light"][-1][1].data * 0.25
    assert lux == pytest.approx(room.daylight(seconds), rel=0.05)


def test_frames(board):
    sent = by_topic(board.run(1.5))
    frames = {t: m[0][1].header.frame_id for t, m in sent.items() if hasattr(m[0][1], "header")}
    assert frames == {
        "/sensors/room_temp": "sht3x",
        "/sensors/humidity": "sht3x",
        "/sensors/thermocouple_hot": "mcp9600",
        "/sensors/thermocouple_cold": "mcp9600",
    }


def test_stamps_are_the_times_of_the_readings(board):
    """The stamps equal the ends of the reads on the bus."""
    reads = {0x44: [], 0x67: []}
    bus = board.program.board.i2c[2]
    bus.on_read = lambda address, ns: reads.setdefault(address, []).append(ns // 1000)
    sent = by_topic(board.run(5.5))

    def stamps(topic):
        return [
            m.header.stamp.sec * 1_000_000 + m.header.stamp.nanosec // 1000 for _, m in sent[topic]
        ]

    assert stamps("/sensors/room_temp") == stamps("/sensors/humidity") == reads[0x44]
    # Hot, its status, cold.
    assert stamps("/sensors/thermocouple_hot") == reads[0x67][1::3]
    assert stamps("/sensors/thermocouple_cold") == reads[0x67][2::3]
    for topic, samples in sent.items():
        for at, message in samples:
            if hasattr(message, "header"):
                stamp = message.header.stamp
                age = at - stamp.sec * 1_000_000 - stamp.nanosec // 1000
                assert 0 <= age < 10_000, (topic, age)


def test_without_an_agent_nothing_is_published(new):
    """Sensors are read nevertheless."""
    new.start()
    assert new.run(3) == []
    new.happen("sht3x:absent")
    new.run(2)
    assert new.crumbs.error == "SHT3x read failed: no answer"
    assert new.crumbs.step == 7


# Faults.


READ_FAILS = [
    ("sht3x:nack", "SHT3x read failed: bus error"),
    ("sht3x:absent", "SHT3x read failed: no answer"),
    ("sht3x:stuck", "SHT3x read failed: bus timed out"),
    ("sht3x:stretch", "SHT3x read failed: bus timed out"),
    ("sht3x:crc", "SHT3x read failed: wrong CRC of the temperature"),
    ("mcp9600:nack", "MCP9600 read failed: bus error"),
    ("mcp9600:absent", "MCP9600 read failed: no answer"),
    ("mcp9600:stuck", "MCP9600 read failed: bus timed out"),
    ("mcp9600:stretch", "MCP9600 read failed: bus timed out"),
    ("mcp9600:open", "MCP9600 read failed: the thermocouple is out of range, or broken"),
    ("vcnl4010:nack", "VCNL4010 read failed: bus error"),
    ("vcnl4010:absent", "VCNL4010 read failed: no answer"),
    ("vcnl4010:stuck", "VCNL4010 read failed: bus timed out"),
    ("vcnl4010:stretch", "VCNL4010 read failed: bus timed out"),
]
TOPICS_OF = {
    "sht3x": {"/sensors/room_temp", "/sensors/humidity"},
    "mcp9600": {"/sensors/thermocouple_hot", "/sensors/thermocouple_cold"},
    "vcnl4010": {"/sensors/proximity", "/sensors/ambient_light"},
}


@pytest.mark.parametrize(("fault", "line"), READ_FAILS)
def test_a_failing_sensor_is_reported_and_does_not_affect_others(board, fault, line):
    name = fault.partition(":")[0]
    board.run(2.5)
    board.happen(fault)
    board.run(1)
    sent = by_topic(board.run(5))
    assert set(sent) == SAMPLES - TOPICS_OF[name]
    assert all(len(samples) in (4, 5) for samples in sent.values())
    lines = [m.data for _, topic, m in board.node.sent if topic == DIAGNOSTIC]
    assert lines == [INITIALIZED, line]
    assert board.crumbs.error == line
    assert board.crumbs.step == 9
    board.happen(name + ":off")
    sent = by_topic(board.run(3))
    back = [m.data for _, m in sent.pop(DIAGNOSTIC)]
    assert back == [line.partition(" ")[0] + " read again"]
    assert set(sent) == SAMPLES


def test_a_continuous_failure_is_reported_every_ten_seconds(board):
    board.lines(1)
    board.happen("mcp9600:absent")
    assert board.lines(31.5) == ["MCP9600 read failed: no answer"] * 4


@pytest.mark.parametrize("name", TOPICS_OF)
def test_missing_at_start_and_plugged_in_later(new, name):
    new.happen(name + ":absent")
    new.start().connect()
    first = by_topic(new.run(4.5))
    assert set(first) == SAMPLES - TOPICS_OF[name] | {DIAGNOSTIC}
    new.happen(name + ":off")
    new.run(1)
    assert set(by_topic(new.run(3))) == SAMPLES


def test_no_sensor_at_all(new):
    for name in TOPICS_OF:
        new.happen(name + ":absent")
    new.start().connect()
    assert new.lines(2.5) == [
        "SHT3x read failed: no answer",
        "VCNL4010 read failed: no answer",
        "MCP9600 read failed: no answer",
    ]
    assert new.crumbs.step == 100
    new.happen("all:off")
    new.run(2)
    assert new.crumbs.step == 9
    assert set(by_topic(new.run(2))) == SAMPLES


def test_a_shorted_bus_does_not_end_the_program(board):
    board.run(1)
    board.happen("bus:stuck")
    before = board.program.clock.ticks_us()
    board.run(5)
    assert board.crumbs.step == 100
    # Three timeouts a second, and in between the node spins.
    assert board.program.clock.ticks_us() - before < 5_500_000
    board.happen("bus:off")
    board.run(1)
    assert set(by_topic(board.run(3))) - {DIAGNOSTIC} == SAMPLES


def test_an_endless_measurement_is_reported(board):
    board.main.program.vcnl4010.read = lambda: False
    lines = board.lines(2.5)
    assert lines == ["VCNL4010 read failed: the measurement does not end"]
    assert board.main.program._wait.is_canceled()


# Loss of the agent.


def test_initialized_is_published_in_every_session(board):
    def diagnostics():
        return [m.data for _, topic, m in board.node.sent if topic == DIAGNOSTIC]

    assert diagnostics() == [INITIALIZED]
    board.run(2)
    board.node.enter(AGENT_DISCONNECTED, WAITING_AGENT)
    assert board.crumbs.step == 7
    assert board.run(2) == []
    board.node.enter(AGENT_AVAILABLE)
    assert board.crumbs.step == 8
    board.node.enter(AGENT_CONNECTED)
    assert board.crumbs.step == 9
    assert diagnostics() == [INITIALIZED] * 2


def test_a_failure_is_reported_to_each_new_agent(board):
    board.run(1)
    board.happen("sht3x:absent")
    line = "SHT3x read failed: no answer"
    assert board.lines(2) == [line]
    board.node.enter(AGENT_DISCONNECTED, WAITING_AGENT)
    board.run(2)
    board.connect()
    assert board.lines(2) == [line]
    # A failure that ends without an agent is not reported to the next one.
    board.node.enter(AGENT_DISCONNECTED, WAITING_AGENT)
    board.happen("sht3x:off")
    board.run(2)
    board.connect()
    assert board.lines(3) == []


def test_diagnostics_without_room_are_sent_later(new):
    new.start()
    new.node.full = True
    new.connect()
    new.happen("sht3x:absent")
    assert new.lines(3) == []
    new.node.full = False
    assert new.lines(1.5) == [INITIALIZED, "SHT3x read failed: no answer"]
    new.node.full = True
    new.happen("sht3x:off")
    new.lines(2)
    new.node.full = False
    assert new.lines(1.5) == ["SHT3x read again"]


# Crumbs.


def test_crumbs_of_a_good_start(new):
    assert (new.crumbs.step, new.crumbs.check) == (0, 0)
    new.start()
    assert new.crumbs.step == 7
    assert (new.crumbs.code, new.crumbs.check, new.crumbs.error) == (0, 6, "")
    assert new.printed == []


@pytest.mark.parametrize(
    ("name", "error", "code", "check", "text"),
    [
        ("Bus", ValueError("I2C(2) doesn't exist"), 1, 1, "step 1: ValueError I2C(2) doesn't"),
        ("open_port", OSError(errno.EIO), errno.EIO, 2, "step 2: OSError "),
        ("Node", MemoryError("memory allocation failed"), 10, 4, "step 4: MemoryError memory"),
    ],
)
def test_a_failed_step_is_printed_and_retried(new, name, error, code, check, text):
    real = getattr(new.main, name)

    def fails(*_, **__):
        raise error

    setattr(new.main, name, fails)
    new.main.start()
    assert new.crumbs.step == 999
    assert (new.crumbs.code, new.crumbs.check) == (code, check)
    assert new.crumbs.error.startswith(text)
    assert new.printed == [new.crumbs.error]
    before = new.program.clock.ticks_us()
    new.main.step()
    assert 100_000 <= new.program.clock.ticks_us() - before <= 101_000
    assert len(new.printed) == 1  # not retried yet
    setattr(new.main, name, real)
    while new.main.program is None:
        new.main.step()
    assert new.program.clock.ticks_us() - before < 1_300_000
    assert (new.crumbs.step, new.crumbs.code) == (7, 0)


def test_the_port_is_kept_after_a_failed_start(new):
    ports = []
    real = new.main.open_port
    new.main.open_port = lambda *a: ports.append(real(*a)) or ports[-1]
    node, new.main.Node = new.main.Node, None
    new.main.start()
    new.main.Node = node
    new.main.start()
    assert len(ports) == 1
    assert new.main.program.node.transport.port is ports[0]


# USB.


def test_a_missing_usb_host_is_reported_after_five_seconds(new):
    new.start()
    new.main.port.opened = False
    new.run(4.5)
    assert new.crumbs.error == ""
    new.run(1.5)
    assert new.crumbs.code == errno.ETIMEDOUT
    assert new.crumbs.error.startswith("USB: ")
    assert len(new.printed) == 1
    # A later host is used; the sensors were read all the time.
    new.main.port.opened = True
    new.connect()
    assert set(by_topic(new.run(1.5))) == SAMPLES


def test_a_usb_host_in_time_is_not_reported(new):
    new.start()
    new.run(7)
    assert (new.crumbs.code, new.crumbs.error, new.printed) == (0, "", [])


def test_no_wait_for_a_host_on_a_uart():
    with load("ra6m5_sensor_node", usb=False) as program:
        running = Running(program)
        running.start().connect()
        assert set(by_topic(running.run(6))) == SAMPLES
        assert running.crumbs.error == ""


def test_ticks_that_wrap():
    """2^30 ms are 12.4 days."""
    with load("ra6m5_sensor_node", offset_ms=(1 << 30) - 3000) as program:
        running = Running(program).start().connect()
        running.happen("sht3x:absent")
        assert running.lines(25) == ["SHT3x read failed: no answer"] * 3


def test_main_starts_and_steps(new):
    calls = []

    class Enough(Exception):
        pass

    def step():
        calls.append("step")
        if len(calls) > 3:
            raise Enough

    new.main.start = lambda: calls.append("start")
    new.main.step = step
    with pytest.raises(Enough):
        new.main.main()
    assert calls == ["start", "step", "step", "step"]


def test_importing_starts_nothing(new):
    assert new.main.program is None
    assert new.program.machine.opened == []
    assert new.crumbs.step == 0
