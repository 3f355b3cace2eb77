"""``uros agent --state``: killed and started again, with clients that never notice."""

import os
import signal
import struct
import subprocess
import sys
import threading
import time

import pytest
from support.paths import ROOT
from support.ports import free_port
from support.stubborn import StubbornClient

from uros.wire import ids

SUPPORT = ROOT / "tests" / "support"
TYPE = "std_msgs::msg::dds_::UInt32_"
CLIENTS = []


class Agent:
    """``uros agent udp4 --state``, to be killed and started again."""

    def __init__(self, domain, state, port=None):
        self.port = port or free_port()
        self._command = [
            sys.executable, "-m", "uros", "agent", "udp4", "-p", str(self.port), "-m", "auto",
            "--domain", str(domain), "--state", str(state),
        ]  # fmt: skip
        self.lines = []
        self.process = None

    def start(self):
        self.process = subprocess.Popen(
            self._command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        running = threading.Event()
        threading.Thread(target=self._read, args=(self.process, running), daemon=True).start()
        assert running.wait(20), self.lines

    def _read(self, process, running):
        for line in process.stdout:
            self.lines.append(line)
            if "running..." in line:
                running.set()
        process.stdout.close()

    def kill(self, number=signal.SIGKILL):
        self.process.send_signal(number)
        return self.process.wait(20)

    def said(self, what):
        return [line for line in self.lines if what in line]


class FarEnd:
    """See support/far_end.py."""

    def __init__(self, domain, read_topic, write_topic="rt/back"):
        self.process = subprocess.Popen(
            [sys.executable, SUPPORT / "far_end.py", str(domain), read_topic, write_topic, TYPE],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert self.process.stdout.readline() == "ready\n"
        self.samples = []
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self):
        for line in self.process.stdout:
            self.samples.append(bytes.fromhex(line)[4:])

    def write(self, cdr):
        self.process.stdin.write((b"\0\1\0\0" + cdr).hex() + "\n")
        self.process.stdin.flush()

    def close(self):
        self.process.stdin.close()
        self.process.wait(20)
        self.process.stdout.close()


@pytest.fixture(autouse=True)
def _clients():
    yield
    while CLIENTS:
        CLIENTS.pop().close()


def connect(agent, key, session_id=0x81):
    CLIENTS.append(StubbornClient(agent.port, key, session_id))
    return CLIENTS[-1]


@pytest.fixture
def agent(own_domain_id, tmp_path):
    one = Agent(own_domain_id, tmp_path / "state")
    one.start()
    yield one
    one.kill()


def numbers(samples):
    return [struct.unpack_from("<I", sample)[0] for sample in samples]


def wait(done, what, clients=(), seconds=20.0):
    end = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < end, what() if callable(what) else what
        for client in clients:
            client.turn(0.005)
        if not clients:
            threading.Event().wait(0.01)


@pytest.fixture
def far_end(own_domain_id):
    ends = []

    def make(*arguments):
        ends.append(FarEnd(own_domain_id, *arguments))
        return ends[-1]

    yield make
    for end in ends:
        end.close()


class Publisher:
    """A client that counts up as fast as it may, and its reader elsewhere."""

    def __init__(self, agent, far_end, key, session_id=0x81, size=4):
        self.client = connect(agent, key, session_id)
        self.client.topic(f"rt/count_{key}", TYPE)
        self.writer = self.client.writer()
        self.far = far_end(f"rt/count_{key}", f"rt/back_{key}")
        self.size = size
        self.written = []  # the acknowledgements that each number needs
        wait(self.first_arrives, "the far end hears nothing", [self.client])

    def first_arrives(self):
        if not self.far.samples and self.client.room == 16:
            self.count_up()
        return bool(self.far.samples)

    def count_up(self):
        cdr = struct.pack("<I", len(self.written)) + bytes(self.size - 4)
        self.written.append(self.client.write(self.writer, cdr))

    def missing(self):
        """Numbers that were acknowledged after the far end heard, and that it did not hear."""
        got = numbers(self.far.samples)
        acknowledged = sum(number <= self.client.acknowledged for number in self.written)
        return sorted(set(range(got[0], acknowledged)) - set(got))


def publish(publishers, seconds, pause=0.002):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        for publisher in publishers:
            if publisher.client.room > (publisher.size + 20) // 488 + 1:
                publisher.count_up()
            while publisher.client.turn(0):
                pass
        select_pause(pause)


def select_pause(seconds):
    threading.Event().wait(seconds)


def settle(publishers):
    clients = [publisher.client for publisher in publishers]
    wait(
        lambda: all(not publisher._out for publisher in clients),
        "not everything is acknowledged",
        clients,
    )
    wait(
        lambda: all(
            numbers(publisher.far.samples)[-1] == len(publisher.written) - 1
            for publisher in publishers
        ),
        lambda: [
            (len(publisher.written), numbers(publisher.far.samples)[-3:])
            for publisher in publishers
        ],
    )


@pytest.mark.slow
def test_no_sample_is_lost_in_repeated_kills_under_load(agent, far_end):
    publishers = [
        Publisher(agent, far_end, 0xA001),
        Publisher(agent, far_end, 0xA002, session_id=0x01),
        Publisher(agent, far_end, 0xA003, size=1500),
    ]
    for pause in (0.1, 0.0, 0.05):
        publish(publishers, 0.4)
        publishers[0].client.without_heartbeats = True
        if not pause:  # and what it hears first is news
            settle(publishers)
        before = [publisher.client.acknowledged for publisher in publishers]
        agent.kill()
        publish(publishers, pause)
        agent.start()
        publish(publishers, 0.2)
        for publisher, number in zip(publishers, before, strict=True):
            publisher.client.until(
                lambda: publisher.client.acknowledged > number,  # noqa: B023
                "nothing is acknowledged any more",
            )
    publish(publishers, 0.3)
    settle(publishers)
    for publisher in publishers:
        assert len(publisher.written) > 100
        assert publisher.missing() == []
    assert len(agent.said("session restored")) == 9
    assert not agent.said("error") and not agent.said("warning")


def test_a_subscriber_continues_after_a_kill_without_losses(agent, far_end):
    client = connect(agent, 0xB001)
    client.topic("rt/back", TYPE)
    client.reader()
    far = far_end("rt/nothing", "rt/back")
    count = 0

    def more_arrive():
        nonlocal count
        # Some in fragments. The agent is killed with messages on their way.
        far.write(struct.pack("<I", count) + bytes(1200 if count % 3 == 0 else 0))
        count += 1
        return len(client.samples) > before + 20

    for _ in range(4):
        before = len(client.samples)
        wait(more_arrive, "no samples", [client])
        agent.kill()
        agent.start()
    got = numbers(client.samples)
    # What the agent before had not passed on yet went with it; nothing else is missing or doubled.
    assert got == sorted(set(got))
    assert not agent.said("error")


def test_an_orderly_restart_keeps_sessions_too(agent, far_end):
    publisher = Publisher(agent, far_end, 0xC001)
    publish([publisher], 0.2)
    assert agent.kill(signal.SIGTERM) == 0
    agent.start()
    publish([publisher], 0.2)
    settle([publisher])
    assert publisher.missing() == []


def test_a_second_agent_reports_that_the_file_is_in_use(agent, own_domain_id, tmp_path):
    command = [
        sys.executable, "-m", "uros", "agent", "udp4", "-p", "0", "-m", "memory",
        "--state", str(tmp_path / "state"),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=30)
    assert done.returncode != 0
    assert "another agent uses it: stop that agent" in done.stdout + done.stderr


def test_a_transient_local_writer_has_its_last_sample_after_a_kill(agent, far_end, own_domain_id):
    client = connect(agent, 0xD001)
    client.topic("rt/latched", TYPE)
    writer = client.writer(ids.QOS_RELIABLE | ids.QOS_KEEP_LAST | ids.QOS_TRANSIENT_LOCAL, depth=1)
    for number in range(3):
        client.write(writer, struct.pack("<I", number))
    wait(lambda: not client._out, "not acknowledged", [client])
    agent.kill()
    agent.start()
    from uros.middleware import open_middleware
    from uros.qos import DurabilityPolicy, QoSProfile

    middleware = open_middleware("auto")
    got = []
    try:
        node = middleware.create_node(own_domain_id, "/", "late")
        profile = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        reader = node.create_reader(
            "rt/latched", TYPE, profile, lambda: got.extend(reader.take(10))
        )
        wait(lambda: (middleware.dispatch(), got)[1], "no sample for the late reader")
    finally:
        middleware.close()
    assert numbers(bytes(sample)[4:] for sample in got) == [2]
    assert os.stat(agent._command[-1]).st_mode & 0o777 == 0o600
