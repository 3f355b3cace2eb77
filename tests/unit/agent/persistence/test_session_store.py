"""Sessions that survive a kill of the agent at any write, with clients that never reset."""

import os
import struct
import time
from collections import deque
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.examples import examples
from support.stubborn import StubbornClient
from unit.agent import helpers
from unit.agent.helpers import Desk

from uros.agent.log import Log
from uros.agent.objects import client as agent_client
from uros.agent.objects.kinds import key_label
from uros.agent.observability import snapshot
from uros.agent.persistence import journal, restore
from uros.agent.persistence import session_store as module
from uros.agent.persistence import write_cursor as module_of_cursors
from uros.agent.persistence.journal import Journal, open_journal
from uros.agent.persistence.session_store import SessionStore
from uros.agent.policy.admission import Admission, make_admission
from uros.agent.session.session import Session
from uros.middleware.base import MiddlewareError
from uros.middleware.memory import Bus, MemoryMiddleware, MemoryWriter
from uros.qos import DurabilityPolicy, QoSProfile
from uros.wire import data, entities, ids
from uros.wire.cdr import Reader, Writer

TYPE = helpers.INT32


class Killed(BaseException):
    """Stands for SIGKILL: no handler catches it."""


class World:
    """A bus with a remote node, and agents that start and end.

    ``deaths``: the numbers of the calls that write or send, before which the agent is killed.
    """

    def __init__(self, path, deaths=(), monkeypatch=None):
        self.path = str(path)
        self.bus = Bus()
        self.clock = 1000
        self.deaths = deque(sorted(deaths))
        self.calls = 0
        self.killed = 0
        self.clients = {}
        self.far = MemoryMiddleware(self.bus)
        self.node = self.far.create_node(0, "/", "far")
        self.desk = None
        self.admission = None
        self.start()

    def start(self):
        self.desk = LastingDesk(self)
        return self.desk

    def kill(self):
        """End the agent as by SIGKILL: nothing more is written, and discovery reports its end."""
        desk, self.desk = self.desk, None
        self.killed += 1
        self.clock = desk.clock
        os.close(desk.session_store._journal._fd)
        desk.middleware.close()
        return self

    def stop(self):
        """End the agent as by SIGTERM."""
        desk, self.desk = self.desk, None
        self.clock = desk.clock
        desk.session_store.close()
        desk.middleware.close()

    def restart(self):
        return self.kill().start()

    def step(self):
        """Count a call that writes or sends; raise Killed where the agent shall die."""
        self.calls += 1
        if self.deaths and self.calls >= self.deaths[0]:
            self.deaths.popleft()
            raise Killed

    def send(self, peer, message):
        try:
            self.desk.hear(message, peer)
        except Killed:
            self.restart()
            # Messages that the killed agent has sent still arrive.

    def wait(self, milliseconds):
        try:
            self.desk.wait(milliseconds)
        except Killed:
            self.restart()
        self.clock = self.desk.clock

    def close(self):
        if self.desk is not None:
            self.kill()
        self.far.close()


class LastingDesk(Desk):
    """A desk whose agent keeps its sessions in a file."""

    def __init__(self, world):
        super().__init__(world.bus, admission=world.admission)
        self.world = world
        self.clock = world.clock
        self.place.send = self.sent_to
        file = open_journal(world.path)
        self.session_store = SessionStore(file, self.agent.log)
        for name in ("append", "write_slot", "rewrite"):
            setattr(file, name, self.mortal(getattr(file, name)))
        try:  # it may be killed while it starts
            self.session_store.open(
                SimpleNamespace(agent=self.agent, transports=[self.place], wake_at=self.wake_at)
            )
            self.settle()
        except Killed:
            os.close(file._fd)
            self.middleware.close()
            self.__init__(world)

    def mortal(self, call):
        def counted(*args):
            self.world.step()
            return call(*args)

        return counted

    def sent_to(self, peer, message):
        self.world.step()
        if peer in self.world.clients:
            self.world.clients[peer].inbox.append(bytes(message))

    def settle(self):
        self.middleware.dispatch()
        while self.agent.attended:
            sessions = list(self.agent.attended)
            self.agent.attended.clear()
            self.session_store.keep(sessions)
            for session in sessions:
                session.finish()
                self.agent.flush(session)
        return []


class Client(StubbornClient):
    """A client that never resets its session, connected to the agents of a world."""

    def __init__(self, world, key=0xA1, session_id=0x81):
        self.world = world
        self.peer = key
        world.clients[key] = self
        self.inbox = deque()
        super().__init__(None, key, session_id)

    def _connect(self, port):
        pass

    def _send(self, message):
        self.world.send(self.peer, message)

    def _receive(self, seconds):
        if not self.inbox:
            self.world.wait(20)
        return self.inbox.popleft() if self.inbox else None

    def _now(self):
        return self.world.clock / 1000

    def turns(self, count=30):
        for _ in range(count):
            self.turn(0.02)


@pytest.fixture
def world(tmp_path):
    world = World(tmp_path / "state")
    yield world
    world.close()


def far_reader(world, topic="rt/up"):
    reader = world.node.create_reader(topic, TYPE, QoSProfile(depth=10_000), lambda: None)
    return lambda: [struct.unpack_from("<I", sample, 4)[0] for sample in reader.take(10_000)]


def publisher(world, topic="rt/up", key=0xA1, **more):
    client = Client(world, key)
    client.topic(topic, TYPE)
    client.writer(**more)
    return client


def number(value, size=4):
    return struct.pack("<I", value) + bytes(size - 4)


def settled(client):
    client.until(lambda: not client._out, "not everything is acknowledged")


# --- what comes back ------------------------------------------------------------------------


def test_a_client_goes_on_publishing(world):
    far_samples = far_reader(world)
    client = publisher(world)
    for value in range(5):
        client.write(0x15, number(value))
    settled(client)
    world.restart()
    for value in range(5, 10):
        client.write(0x15, number(value))
    settled(client)
    assert far_samples() == list(range(10))
    assert "session restored" in world.desk.log()


def test_a_client_that_sends_no_heartbeats_goes_on_publishing(world):
    """After the restart, the agent's first request for unacknowledged messages is lost."""
    far_samples = far_reader(world)
    client = publisher(world)
    client.without_heartbeats = True
    settled(client)
    client._send = lambda message: None
    for value in range(16):
        client.write(0x15, number(value))
    del client._send
    world.restart()
    client.inbox.clear()
    settled(client)
    assert far_samples() == list(range(16))


def test_the_first_fragments_of_a_message_are_kept(world):
    far_samples = far_reader(world)
    client = publisher(world)
    whole = StubbornClient.write
    sent = []
    client._send = sent.append
    whole(client, 0x15, number(7, 1400))
    del client._send
    for message in sent[:2]:
        world.send(client.peer, message)
    client.until(lambda: client.acknowledged >= client.acknowledged, "")
    client.turns(5)
    assert len(client._out) == len(sent) - 2 > 0  # the first two are acknowledged, and freed
    world.restart()
    settled(client)
    assert far_samples() == [7]


def test_stalled_messages_are_sent_again_by_the_client(world, monkeypatch):
    far_samples = far_reader(world)
    client = publisher(world)
    with monkeypatch.context() as patch:
        patch.setattr(MemoryWriter, "write", lambda self, cdr: False)
        world.restart()  # endpoints keep a reference to the method
        client.write(0x15, number(1))
        client.write(0x15, number(2, 1400))
        client.turns(5)
        world.wait(1500)
        world.restart()
        client.turns(5)
        assert len(client._out) == 4 and far_samples() == []
    world.restart()
    settled(client)
    assert far_samples() == [1, 2]


def test_samples_written_before_a_stall_are_not_delivered_twice(world, monkeypatch):
    """A writer or a service without room for seconds, as a restored one: samples that were written
    to other topics before have reached their readers, though they are not acknowledged."""
    far_samples, held_samples = far_reader(world), far_reader(world, "rt/held")
    client = publisher(world)
    client.create(0x32, 0x11, helpers_topic, "rt/held", TYPE)
    client.create(0x35, 0x13, helpers_endpoint, 0x32, ids.QOS_RELIABLE, 10)
    settled(client)
    write, full = MemoryWriter.write, {"rt/up", "rt/held"}
    monkeypatch.setattr(
        MemoryWriter, "write", lambda self, cdr: self._key[1] not in full and write(self, cdr)
    )
    world.restart()  # endpoints keep a reference to the method
    for value in range(3):
        client.write(0x15, number(value))
    for value in range(3):
        client.write(0x35, number(value, 1400 if value else 4))
    client.turns(5)
    full.remove("rt/up")
    client.turns(5)
    assert far_samples() == [0, 1, 2] and len(client._out) == 3 + 1 + 2 * 3  # not acknowledged
    for _ in range(2):
        world.restart()
        client.turns(5)
    assert far_samples() == [] and held_samples() == []
    full.clear()
    client.write(0x15, number(7))
    settled(client)
    assert far_samples() == [7] and held_samples() == [0, 1, 2]


@pytest.mark.parametrize("rewritten", [False, True], ids=["journal", "rewritten"])
def test_a_message_behind_one_that_was_given_up_is_stalled(world, monkeypatch, rewritten):
    """Its last fragment comes again; the fragments before it are in the file."""
    far_samples = far_reader(world)
    client = publisher(world)

    def fragments(whole, at_most):
        parts = [whole[at : at + 400] for at in range(0, len(whole), 400)]
        for part in parts[:at_most]:
            client.put(ids.FRAGMENT, part, 3 if part is parts[-1] else 1)

    def whole(value):
        sample = number(value, 1400)
        head = struct.pack("<BBHHBB", ids.WRITE_DATA, 1, 4 + len(sample), value, 0, 0x15)
        return head + sample

    with monkeypatch.context() as patch:
        patch.setattr(MemoryWriter, "write", lambda self, cdr: False)
        world.restart()  # endpoints keep a reference to the method
        fragments(whole(1 << 8), 2)
        client.turns(5)
        fragments(whole(2 << 8), 4)
        client.turns(5)
        assert len(client._out) == 1 and far_samples() == []
        if rewritten:
            assert world.desk.session_store._rewrite()
    world.restart()
    settled(client)
    assert far_samples() == [2 << 8]


def test_messages_to_a_client_are_sent_again_as_they_were(world):
    client = Client(world)
    client.topic("rt/down", TYPE)
    client.reader()
    client.turns()
    writer = world.node.create_writer("rt/down", TYPE, QoSProfile(depth=100))
    for value in range(6):
        writer.write(b"\0\1\0\0" + number(value, 1200 if value == 3 else 4))
    # All fragments of the large message but the last are lost in transit.
    world.desk.settle()
    client.inbox = deque(message for message in client.inbox if len(message) < 480)
    world.restart()
    client.until(lambda: len(client.samples) == 6, "samples are missing")
    assert [struct.unpack_from("<I", message)[0] for message in client.samples] == list(range(6))
    writer.write(b"\0\1\0\0" + number(6))
    client.until(lambda: len(client.samples) == 7, "it does not go on")


def subscriber(world, topic="rt/down"):
    """Return a client that reads a topic, and the remote writer of the topic."""
    client = Client(world)
    client.topic(topic, TYPE)
    client.reader()
    client.turns()
    return client, world.node.create_writer(topic, TYPE, QoSProfile(depth=100))


@pytest.mark.parametrize("acknowledged", [0, 3])
@pytest.mark.parametrize("flying", [1, 2, 5])
@pytest.mark.parametrize("rewritten", [False, True], ids=["journal", "rewritten"])
def test_all_messages_in_transit_at_the_kill_are_sent_again(world, acknowledged, flying, rewritten):
    """The first message without acknowledgement is sent again too, even if no other is lost."""
    client, writer = subscriber(world)
    for value in range(acknowledged):
        writer.write(b"\0\1\0\0" + number(value))
    world.desk.settle()
    client.turns(5)
    assert len(client.samples) == acknowledged
    for value in range(acknowledged, acknowledged + flying):
        writer.write(b"\0\1\0\0" + number(value))
    world.desk.settle()
    assert len(client.inbox) == flying
    client.inbox.clear()
    if rewritten:
        assert world.desk.session_store._rewrite()
    world.restart()
    client.turns()
    assert [struct.unpack_from("<I", sample)[0] for sample in client.samples] == list(
        range(acknowledged + flying)
    )


def test_unacknowledged_messages_count_towards_the_memory_budget_after_a_restart(world):
    """Otherwise unacknowledged messages would be missing in the memory budget and in the limit of
    its answers, and acknowledging them would make the client's account negative."""
    client, writer = subscriber(world)
    settled(client)
    for value in range(4):
        writer.write(b"\0\1\0\0" + number(value, 300))
    world.desk.settle()
    sent = []
    client._send = sent.append
    client.write(0x15, number(1, 1400))
    del client._send
    world.send(client.peer, sent[0])
    client.inbox.clear()

    def held_bytes():
        (session,) = [client_proxy.session for client_proxy in world.desk.agent.clients.values()]
        return session.held(), session._out[0x80].size, session.queues()

    before = held_bytes()
    assert before[1] > 4 * 300 and before[2][0] == 4 and before[2][3] > 400
    world.restart()
    assert held_bytes() == before
    assert world.desk.agent.budget.count()[0][0] >= before[0]
    client.turns()
    assert len(client.samples) == 4
    assert held_bytes()[1] == 0


def test_best_effort_streams_go_on_both_ways(world):
    far_samples = far_reader(world)
    client = publisher(world)
    client.reader(ids.STREAM_BEST_EFFORT)
    client.turns()
    client.write_best_effort(0x15, number(0))
    client.turns(5)
    client._best_effort_out = 0x9000  # far beyond the numbers that a new stream would accept
    world.restart()
    client.write_best_effort(0x15, number(1))
    client.write_best_effort(0x15, number(2))
    client.turns()
    assert far_samples() == [0, 1, 2]
    (session,) = [sample.session for sample in world.desk.agent.clients.values()]
    assert session.lost == 0  # it does not count losses of before the restart
    numbers = [struct.unpack_from("<I", sample)[0] for sample in client.samples]
    assert numbers == [0, 1, 2]  # its own reader: the client accepts the agent's numbers


def test_deleted_objects_stay_deleted_after_a_restart(world):
    client = publisher(world)
    helpers_delete(client, 0x15)
    world.restart()
    (proxy,) = world.desk.agent.clients.values()
    assert sorted(proxy.objects) == [0x11, 0x12, 0x13]
    client.create(0x15, 0x13, helpers_endpoint, 0x12, ids.QOS_RELIABLE, 10)
    far_samples = far_reader(world)
    client.write(0x15, number(1))
    settled(client)
    assert far_samples() == [1]


def helpers_delete(client, object_id):
    from uros.wire import session

    client.request(ids.DELETE, session.push_request, object_id)


def helpers_endpoint(w, *values):
    from uros.wire import entities

    entities.push_binary_endpoint(w, *values)


def test_the_state_tells_whether_a_client_was_heard_since_the_restart(world):
    client = publisher(world)

    def heard():
        (proxy,) = world.desk.agent.clients.values()
        server = SimpleNamespace(agent=world.desk.agent)
        return snapshot.board(server, proxy, snapshot.Rates({}))["heard_since_restart"]

    assert heard()
    world.restart()
    world.wait(5000)
    assert not heard()
    client.write(0x15, number(1))
    assert heard()


def test_a_client_that_closed_its_session_is_not_restored(world):
    client = publisher(world)
    world.desk.agent.delete_client(client.key)
    world.restart()
    assert not world.desk.agent.clients


def test_a_client_that_was_reset_is_restored_with_its_new_numbers(world):
    far_samples = far_reader(world)
    client = publisher(world)
    client.write(0x15, number(1))
    settled(client)
    again = Client(world)  # the same key and address: its objects stay
    world.restart()
    again.write(0x15, number(2))
    settled(again)
    assert far_samples() == [1, 2]


def test_a_session_with_its_key_in_the_header_goes_on_at_another_address(world):
    far_samples = far_reader(world)
    client = Client(world, session_id=0x01)
    client.topic("rt/up", TYPE)
    client.writer()
    world.clients[0xA2] = client
    world.desk.agent.take_over(client.key, world.desk.place, 0xA2, None)
    world.restart()
    assert world.desk.agent.place(client.key)[1] == 0xA2
    client.peer = 0xA2
    client.write(0x15, number(1))
    settled(client)
    assert far_samples() == [1]


@pytest.mark.parametrize("lasting", [False, True])
def test_a_restored_session_does_not_move_to_another_transport(world, lasting):
    """Nor does a board with a certificate get it: that board begins with its own rules."""
    publisher(world).turns()
    desk = world.restart()
    desk.agent.rules.add({"address": "peer 9", "namespace": "/left"})
    assert desk.agent.clients[0xA1].objects
    place, other_place = desk.place, helpers.Place()
    other_place.lasting, other_place.name = lasting, "OtherAgent"
    other_place.certificate_of = lambda peer: "left"
    desk.place = other_place
    desk.hear(helpers.create_client(0xA1), 9)
    desk.wait(1000)
    client = desk.agent.clients[0xA1]
    assert desk.agent.place(0xA1) == (other_place, 9)
    assert client.certificate == "left" and not client.objects
    assert not place.sessions and not desk.middleware.bus.writers
    desk = world.restart()
    assert not desk.agent.clients
    assert (0xA1 in desk.session_store._asleep) == lasting
    assert not desk.middleware.bus.writers


def test_a_restored_session_gets_the_current_rules(world, monkeypatch):
    publisher(world).turns()
    init = Desk.__init__

    def ruled(self, *args, **more):
        init(self, *args, **more)
        self.agent.rules.add({"namespace": "/jail"})

    monkeypatch.setattr(Desk, "__init__", ruled)
    world.restart()
    assert {key[1] for key, writers in world.bus.writers.items() if writers} == {"rt/jail/up"}


def test_a_limited_read_data_does_not_begin_anew(world):
    client = Client(world)
    client.topic("rt/down", TYPE)
    client.reader()
    from uros.wire import data

    client.request(
        ids.READ_DATA, data.push_read_data, 0x16, ids.STREAM_RELIABLE, 0, None, (5, 0, 0, 0),
        wait=False,
    )  # fmt: skip
    client.turns()
    writer = world.node.create_writer("rt/down", TYPE, QoSProfile(depth=100))
    for value in range(3):
        writer.write(b"\0\1\0\0" + number(value))
    client.turns()
    world.restart()
    for value in range(3, 9):
        writer.write(b"\0\1\0\0" + number(value))
    client.turns()
    assert [struct.unpack_from("<I", sample)[0] for sample in client.samples] == list(range(5))
    world.restart()
    client.turns()
    assert len(client.samples) == 5


def test_a_limited_read_data_counts_down_over_several_restarts(world):
    """An agent that restored the request writes the remaining number of samples as well."""
    client = Client(world)
    client.topic("rt/down", TYPE)
    client.reader()
    client.request(
        ids.READ_DATA, data.push_read_data, 0x16, ids.STREAM_RELIABLE, 0, None, (7, 0, 0, 0),
        wait=False,
    )  # fmt: skip
    client.turns()
    writer = world.node.create_writer("rt/down", TYPE, QoSProfile(depth=100))
    for value in range(12):
        if value in (2, 4, 6):
            world.restart()
        writer.write(b"\0\1\0\0" + number(value))
        world.desk.settle()
        client.turns(10)
    assert [struct.unpack_from("<I", sample)[0] for sample in client.samples] == list(range(7))


def test_the_first_message_to_a_client_is_in_transit_at_the_restart(world):
    client = Client(world)
    w = Writer(bytearray(64))
    entities.push_binary_participant(w, "first", None)
    client.request(
        ids.CREATE, entities.push_create, 0x11, ids.IN_BINARY, bytes(w.buf[: w.offset]), 0,
        wait=False,
    )  # fmt: skip
    client.inbox.clear()
    world.restart()
    client.turns()
    assert client.statuses == {1: ids.STATUS_OK}


def test_each_output_stream_is_restored_with_its_own_numbers(world):
    """Two reliable streams with different numbers, and a message in transit on each."""
    client, writer = subscriber(world)
    second_stream = 0x83
    (session,) = [output.session for output in world.desk.agent.clients.values()]
    for count in range(3):
        writer.write(b"\0\1\0\0" + number(count))
    world.desk.settle()
    client.turns(5)
    for count in range(7):
        session.send(ids.DATA, 1, second_stream, b"\0\1\0\x16" + number(count), world.desk.clock)
    session._acknack(Reader(struct.pack("<HHB", 5, 0, second_stream), 0, 5, True), world.desk.clock)
    world.desk.agent.attend(session)
    world.desk.settle()
    before = {stream: output.export()[1:] for stream, output in session._out.items()}
    assert [output[:2] for output in before.values()] == [(7, 7), (7, 7)]
    assert list(before[second_stream][2]) == [5, 6]
    for _ in range(2):  # from the journal, and from the compacted journal
        world.restart()
        (session,) = [output.session for output in world.desk.agent.clients.values()]
        assert session._out.keys() == before.keys()
        for stream, (sent, after, messages) in before.items():
            output = session._out[stream]
            assert (output.sent, output.next) == (sent, after)
            # Acknowledgements since the last message was sent are not in the file.
            restored = output.export()[3]
            assert list(restored) == list(range(output.acked, sent))
            assert messages.items() <= restored.items()


def test_replies_reach_their_requester_after_a_restart(world):
    """A board with a service gets the request before the restart and replies after it."""
    from uros.middleware.base import Service
    from uros.qos import services_profile
    from uros.wire import entities

    client = Client(world)
    client.create(0x11, 0, entities.push_binary_participant, "server", None)
    client.create(
        0x18, 0x11, entities.push_binary_service, "add", helpers.ADD_REQUEST, helpers.ADD_REPLY,
        "rq/addRequest", "rr/addReply",
    )  # fmt: skip
    client.request(
        ids.READ_DATA, data.push_read_data, 0x18, ids.STREAM_RELIABLE, 0, None, (0xFFFF, 0, 0, 0),
        wait=False,
    )  # fmt: skip
    service = Service("rq/addRequest", helpers.ADD_REQUEST, "rr/addReply", helpers.ADD_REPLY)
    client.turns()
    asker = world.node.create_requester(service, services_profile(), lambda: None)
    pending = asker.request(b"\0\1\0\0" + number(1))
    client.until(lambda: client.samples, "no request")
    world.restart()
    client.write(0x18, client.samples[0][:24] + number(2))
    settled(client)
    assert asker.take(5) == [(pending, b"\0\1\0\0" + number(2))]


# --- writers and their readers ----------------------------------------------------------------


def test_a_restored_writer_waits_for_its_matched_readers(world, monkeypatch):
    far_samples = far_reader(world)
    client = publisher(world)
    world.wait(1500)  # readers are counted once a second
    matched = MemoryWriter.matched
    monkeypatch.setattr(MemoryWriter, "matched", lambda self: 0)  # discovery takes a while
    world.restart()
    client.write(0x15, number(1))
    client.turns()
    assert far_samples() == [] and len(client._out) == 1  # stalled, not acknowledged
    monkeypatch.setattr(MemoryWriter, "matched", matched)
    settled(client)
    assert far_samples() == [1]


def test_a_restored_writer_waits_a_few_seconds_for_readers_that_have_left(world, monkeypatch):
    client = publisher(world)
    reader = world.node.create_reader("rt/up", TYPE, QoSProfile(depth=10), lambda: None)
    world.wait(1500)
    reader.close()
    now = 0.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    world.restart()
    client.write(0x15, number(1))
    client.turns()
    assert client._out
    now = restore.HOLD_SECONDS + 0.1
    settled(client)


def test_the_last_sample_of_a_transient_local_writer_is_restored(world):
    qos = ids.QOS_RELIABLE | ids.QOS_KEEP_LAST | ids.QOS_TRANSIENT_LOCAL
    client = publisher(world, qos=qos, depth=1)
    for value in range(3):
        client.write(0x15, number(value))
    client.write_best_effort(0x15, number(9))
    settled(client)
    world.restart()
    profile = QoSProfile(depth=5, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    late_reader = world.node.create_reader("rt/up", TYPE, profile, lambda: None)
    assert late_reader.take(5) == [b"\0\1\0\0" + number(9)]
    late_reader.close()
    # And a sample that came after the restart, after another restart.
    client.write(0x15, number(10))
    settled(client)
    world.restart()
    late_reader = world.node.create_reader("rt/up", TYPE, profile, lambda: None)
    assert late_reader.take(5) == [b"\0\1\0\0" + number(10)]


@pytest.mark.parametrize(("size", "expected"), [(0, 1), (4, 0)])
def test_a_last_sample_is_kept_up_to_a_size_limit(world, monkeypatch, size, expected):
    monkeypatch.setattr(module_of_cursors, "MAX_LATCHED", 4 + 100)  # and the encapsulation header
    qos = ids.QOS_RELIABLE | ids.QOS_KEEP_LAST | ids.QOS_TRANSIENT_LOCAL
    client = publisher(world, qos=qos, depth=1)
    client.write(0x15, number(1, 100 + size))
    settled(client)
    world.restart()
    profile = QoSProfile(depth=5, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    late_reader = world.node.create_reader("rt/up", TYPE, profile, lambda: None)
    assert len(late_reader.take(5)) == expected


def test_a_sample_over_max_size_is_not_restored_as_the_last_one(world):
    """The rules have dropped the sample: no reader got it, so a late reader must not either."""
    world.desk.agent.rules.add({"max_size": 8})
    qos = ids.QOS_RELIABLE | ids.QOS_KEEP_LAST | ids.QOS_TRANSIENT_LOCAL
    client = publisher(world, qos=qos, depth=1)
    client.write(0x15, number(1))
    client.write(0x15, number(2, 100))
    settled(client)
    assert "message too large" in world.desk.log()
    world.restart()
    profile = QoSProfile(depth=5, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    late_reader = world.node.create_reader("rt/up", TYPE, profile, lambda: None)
    assert late_reader.take(5) == [b"\0\1\0\0" + number(1)]


# --- transports ----------------------------------------------------------------------------------


def test_sessions_of_a_missing_transport_wait_for_it(world, monkeypatch):
    far_samples = far_reader(world)
    client = publisher(world)
    with monkeypatch.context() as patch:
        patch.setattr(helpers.Place, "name", "OtherAgent")
        world.restart()
        assert not world.desk.agent.clients
        assert "session kept asleep" in world.desk.log()
        world.restart()
    world.restart()
    client.write(0x15, number(1))
    settled(client)
    assert far_samples() == [1]


def test_sessions_of_a_missing_transport_expire(world, monkeypatch):
    publisher(world)
    now = 1e9
    monkeypatch.setattr(time, "time_ns", lambda: round(now * 1e9))
    with monkeypatch.context() as patch:
        patch.setattr(helpers.Place, "name", "OtherAgent")
        world.restart()
        now += module.ASLEEP_SECONDS + 1
        world.wait(11_000)
        world.restart()
        assert "asleep" not in world.desk.log()
    world.restart()
    assert not world.desk.agent.clients


@pytest.mark.parametrize("why", ["connection", "address"])
def test_sessions_that_end_with_their_connection_are_not_kept(world, monkeypatch, why):
    if why == "connection":
        monkeypatch.setattr(helpers.Place, "lasting", False)
    else:
        monkeypatch.setattr(module, "can_be_kept", lambda peer: False)
    publisher(world)
    monkeypatch.undo()
    world.restart()
    assert not world.desk.agent.clients


@pytest.mark.parametrize("by", ["key", "network"])
def test_clients_that_are_no_longer_admitted_are_not_restored(world, monkeypatch, by):
    publisher(world)
    if by == "key":
        monkeypatch.setattr(Admission, "admits_key", lambda self, key: False)
    else:
        monkeypatch.setattr(helpers.Place, "host_of", lambda self, peer: "10.0.0.1")
        monkeypatch.setattr(Admission, "admits_host", lambda self, host: host != "10.0.0.1")
    world.restart()
    assert not world.desk.agent.clients
    assert "it is not admitted any more" in world.desk.log()


@pytest.mark.parametrize(
    "lists, hosts, remaining",
    [
        (
            {"keys": ["0x11"], "networks": ["10.0.0.0/8"]},
            {0x11: "10.0.0.1", 0x12: "10.0.0.2", 0x11 + 2**8: "10.0.0.3"},
            [0x11],
        ),
        ({"networks": ["10.0.0.0/8"]}, {1: "10.0.0.1", 2: "11.0.0.1", 3: None}, [1, 3]),
    ],
)
def test_admission_lists_apply_to_restored_clients(world, monkeypatch, lists, hosts, remaining):
    monkeypatch.setattr(helpers.Place, "host_of", lambda self, peer: hosts[peer])
    for key in hosts:
        publisher(world, key=key)
    world.admission = make_admission(**lists)
    world.restart()
    assert list(world.desk.agent.clients) == remaining
    for key in hosts.keys() - remaining:
        why = "it is not admitted any more (see --allow-key, --allow-net)"
        assert f"client_key: {key_label(key)}, address: peer {key}, {why}" in world.desk.log()


@pytest.mark.parametrize("call", ["address", "host_of"])
def test_an_invalid_address_loses_its_client_alone(world, monkeypatch, call):
    for key in (0xA1, 0xA2):
        publisher(world, key=key)
    monkeypatch.setattr(
        helpers.Place, call, lambda self, peer: "10.0.0.1" if peer == 0xA2 else peer[0]
    )
    world.restart()
    assert list(world.desk.agent.clients) == [0xA2]
    assert "161 is not an address of its transport" in world.desk.log()


def test_no_more_clients_are_restored_than_the_current_limit(world, monkeypatch):
    first, second = publisher(world, key=0xA1), publisher(world, key=0xA2)
    monkeypatch.setattr(
        Admission, "max_clients", property(lambda admission: 1, lambda admission, value: None)
    )
    world.restart()
    assert list(world.desk.agent.clients) == [0xA1]
    assert "over 1 clients (see --max-clients)" in world.desk.log()
    settled(first)
    monkeypatch.undo()
    world.restart()  # the other one is no longer in the file
    assert list(world.desk.agent.clients) == [0xA1]
    assert second.key not in world.desk.agent.clients


def test_a_client_that_connects_over_another_transport_ends_the_waiting(world, monkeypatch):
    publisher(world)
    with monkeypatch.context() as patch:
        patch.setattr(helpers.Place, "name", "OtherAgent")
        world.restart()
        publisher(world)
    world.restart()
    assert not world.desk.agent.clients  # the session at the old address is gone


# --- the file fails -----------------------------------------------------------------------------


def full(monkeypatch, *names):
    """Make the disk full; return the function that frees room."""
    room = monkeypatch.context()
    patch = room.__enter__()
    for name in names:

        def fails(self, *args, **more):
            self.error = "No space left on device"
            return False

        patch.setattr(Journal, name, fails)
    return lambda: room.__exit__(None, None, None)


def revive(world):
    """Return the desk of a world whose calls are not counted, so that tests replace its methods."""
    file = world.desk.session_store._journal
    for name in ("append", "write_slot", "rewrite"):
        delattr(file, name)


def test_a_full_disk_is_logged_once_and_boards_are_served(world, monkeypatch):
    far_samples = far_reader(world)
    client = publisher(world)
    revive(world)
    give_room = full(monkeypatch, "append", "rewrite")
    helpers_delete(client, 0x15)
    client.create(0x15, 0x13, helpers_endpoint, 0x12, ids.QOS_RELIABLE, 10)
    world.wait(25_000)
    client.write(0x15, number(1))
    settled(client)
    assert far_samples() == [1]
    assert world.desk.log().count("state not kept") == 1
    assert "free some space" in world.desk.log()
    give_room()
    world.wait(10_000)
    assert "state kept again" in world.desk.log()
    world.restart()
    client.write(0x15, number(2))
    settled(client)
    assert far_samples() == [2]


def test_samples_are_kept_at_once_when_the_disk_has_room_again(world, monkeypatch):
    """They are kept at once, not only after the next check, ten seconds later."""
    far_samples = far_reader(world, "rt/later")
    client = publisher(world)
    revive(world)
    give_room = full(monkeypatch, "append", "rewrite")
    helpers_delete(client, 0x15)
    world.wait(1000)
    give_room()
    world.wait(10_000)
    assert world.desk.log().count("state kept again") == 1
    client.create(0x22, 0x11, helpers_topic, "rt/later", TYPE)
    client.create(0x25, 0x13, helpers_endpoint, 0x22, ids.QOS_RELIABLE, 10)
    world.restart()
    assert "session restored" in world.desk.log()
    client.write(0x25, number(3))
    settled(client)
    assert far_samples() == [3]


def test_a_disk_that_is_full_twice_is_logged_twice(world, monkeypatch):
    client = publisher(world)
    revive(world)
    for times in (1, 2):
        give_room = full(monkeypatch, "append", "rewrite")
        helpers_delete(client, 0x15)
        client.create(0x15, 0x13, helpers_endpoint, 0x12, ids.QOS_RELIABLE, 10)
        assert world.desk.log().count("state not kept") == times
        give_room()
        world.wait(10_000)
        assert world.desk.log().count("state kept again") == times


def test_a_client_that_changed_while_the_disk_was_full_is_not_restored(world, monkeypatch):
    client = publisher(world)
    other_client = Client(world, 0xA2)
    other_client.topic("rt/other", TYPE)
    settled(other_client)
    revive(world)
    give_room = full(monkeypatch, "append", "rewrite")
    helpers_delete(client, 0x15)  # acknowledged, but not in the journal
    give_room()
    world.restart()
    assert list(world.desk.agent.clients) == [0xA2]
    assert "client 0x000000A1 is left out: record" in world.desk.log()


def test_where_not_even_slots_can_be_written_no_outdated_file_is_left(world, monkeypatch):
    client = publisher(world)
    revive(world)
    give_room = full(monkeypatch, "append", "write_slot", "rewrite")
    client.write(0x15, number(1))
    settled(client)
    give_room()
    world.restart()
    assert not world.desk.agent.clients
    assert "damaged" not in world.desk.log()


@pytest.mark.parametrize("how", ["deleted", "truncated", "another"])
def test_a_file_that_was_removed_is_written_anew(world, tmp_path, how):
    far_samples = far_reader(world)
    client = publisher(world)
    if how == "deleted":
        os.unlink(world.path)
    elif how == "truncated":
        os.truncate(world.path, 5000)
    else:
        (tmp_path / "other").write_text("")
        os.replace(tmp_path / "other", world.path)
    world.wait(11_000)
    assert "it is written again" in world.desk.log()
    world.restart()
    client.write(0x15, number(1))
    settled(client)
    assert far_samples() == [1]


def test_a_damaged_file_is_kept_aside_and_undamaged_clients_are_restored(world):
    far_samples = far_reader(world)
    client = publisher(world)
    other_client = Client(world, 0xA2)
    other_client.topic("rt/other", TYPE)
    settled(other_client)
    world.kill()
    whole = bytearray((path := Path(world.path)).read_bytes())
    whole[whole.index(b"rt/other")] ^= 1
    path.write_bytes(whole)
    world.start()
    assert list(world.desk.agent.clients) == [0xA1]
    assert "client 0x000000A2 is left out: record" in world.desk.log()
    assert Path(world.path + ".damaged").read_bytes() == whole
    client.write(0x15, number(1))
    settled(client)
    assert far_samples() == [1]


def test_after_a_crash_of_the_machine_boards_start_anew(world, monkeypatch):
    publisher(world)
    world.kill()
    monkeypatch.setattr(journal, "_boot_id", lambda: "another")
    world.start()
    assert not world.desk.agent.clients
    assert "switched off without the agent being stopped" in world.desk.log()


def test_an_object_that_cannot_be_restored_is_left_out(world, monkeypatch):
    far_samples = far_reader(world)
    client = publisher(world)
    client.create(0x22, 0x11, helpers_topic, "rt/other", TYPE)
    recreate = agent_client.ProxyClient.recreate

    def refuse(self, object_id, *args):
        if object_id == 0x22:
            raise MiddlewareError("out of topics")
        recreate(self, object_id, *args)

    monkeypatch.setattr(agent_client.ProxyClient, "recreate", refuse)
    world.restart()
    assert "object_id: 0x002(2), out of topics" in world.desk.log()
    client.write(0x15, number(1))
    settled(client)
    assert far_samples() == [1]


def test_a_client_that_cannot_be_restored_does_not_affect_others(world, monkeypatch):
    publisher(world)
    client = publisher(world, key=0xA2)
    far_samples = far_reader(world)

    resume = Session.resume

    def fails(self, *args):
        if self.key == 0xA1:
            raise RuntimeError("whatever it is")
        resume(self, *args)

    monkeypatch.setattr(Session, "resume", fails)
    world.restart()
    monkeypatch.undo()
    client.write(0x15, number(1))
    settled(client)
    assert far_samples() == [1]
    assert list(world.desk.agent.clients) == [0xA2]
    assert "whatever it is" in world.desk.log()


def test_the_journal_is_compacted(world, monkeypatch):
    monkeypatch.setattr(module, "JOURNAL_SIZE", 5000)
    world.restart()
    client = Client(world)
    client.topic("rt/down", TYPE)
    client.reader()
    client.turns()
    writer = world.node.create_writer("rt/down", TYPE, QoSProfile(depth=100))
    sizes = []
    for value in range(300):
        writer.write(b"\0\1\0\0" + number(value, 200))
        client.turns(2)
        sizes.append(world.desk.session_store._journal.journal_size)
    assert max(sizes) < 12_000
    world.restart()
    client.until(lambda: len(client.samples) == 300, "some are missing")


# --- what seldom happens --------------------------------------------------------------------------


def test_a_file_of_an_orderly_shutdown_is_trusted_after_a_reboot(world, monkeypatch):
    far_samples = far_reader(world)
    client = publisher(world)
    client.write(0x15, number(1))
    settled(client)
    world.stop()
    monkeypatch.setattr(journal, "_boot_id", lambda: "another")
    world.start()
    client.write(0x15, number(2))
    settled(client)
    assert far_samples() == [1, 2]


def test_a_shutdown_with_a_fault_keeps_all_clients(world, monkeypatch):
    publisher(world)
    agent, store = world.desk.agent, world.desk.session_store

    def fail(*_):
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(store, "_commit", fail)
    monkeypatch.setattr(store, "_changed", [None])
    with pytest.raises(OSError, match="Input"):
        store.close()
    agent.close()  # as the server does in this case
    world.clock = world.desk.clock
    world.desk.middleware.close()
    world.start()
    assert list(world.desk.agent.clients) == [0xA1]


def test_a_session_store_that_was_never_opened_leaves_the_file_as_it_is(world):
    publisher(world)
    world.stop()
    before = Path(world.path).read_bytes()
    store = SessionStore(open_journal(world.path), Log())
    store.close()
    assert Path(world.path).read_bytes() == before
    world.start()
    assert list(world.desk.agent.clients) == [0xA1]


def test_a_disk_that_is_full_at_the_start(world, monkeypatch):
    """The file would soon be outdated; boards are restored and served."""
    far_samples = far_reader(world)
    client = publisher(world)
    world.kill()
    give_room = full(monkeypatch, "rewrite")
    world.start()
    client.write(0x15, number(1))
    settled(client)
    assert far_samples() == [1]
    assert "state not kept" in world.desk.log()
    give_room()
    world.restart()
    assert not world.desk.agent.clients  # rather than with outdated numbers


def test_a_journal_that_cannot_be_compacted_goes_on(world, monkeypatch):
    monkeypatch.setattr(module, "JOURNAL_SIZE", 3000)
    world.restart()
    client = publisher(world)
    revive(world)
    give_room = full(monkeypatch, "rewrite")
    for _ in range(20):
        helpers_delete(client, 0x15)
        client.create(0x15, 0x13, helpers_endpoint, 0x12, ids.QOS_RELIABLE, 10)
    assert world.desk.session_store._journal.journal_size > 3000
    assert "state not kept" not in world.desk.log()
    os.unlink(world.path)  # now it must be compacted
    world.wait(11_000)
    assert "state not kept" in world.desk.log()
    give_room()
    world.wait(11_000)
    far_samples = far_reader(world)
    world.restart()
    client.write(0x15, number(1))
    settled(client)
    assert far_samples() == [1]


def test_a_client_leaves_while_nothing_can_be_written(world, monkeypatch):
    publisher(world)
    revive(world)
    give_room = full(monkeypatch, "append", "write_slot", "rewrite")
    world.desk.agent.delete_client(0xA1)
    assert "state not kept" in world.desk.log()
    give_room()
    world.restart()
    assert not world.desk.agent.clients


def read_data(client, *control):
    client.request(
        ids.READ_DATA, data.push_read_data, 0x16, ids.STREAM_RELIABLE, 0, None,
        control, wait=False,
    )  # fmt: skip
    client.turns()


def test_read_data_that_was_cancelled_stays_so(world):
    client = Client(world)
    client.topic("rt/down", TYPE)
    client.reader()
    client.turns()
    read_data(client, 0, 0, 0, 0)
    read_data(client, 0, 0, 0, 0)  # there is nothing to cancel
    world.restart()
    writer = world.node.create_writer("rt/down", TYPE, QoSProfile(depth=100))
    writer.write(b"\0\1\0\0" + number(1))
    client.turns()
    assert client.samples == []


def test_read_data_of_an_object_that_cannot_be_restored_is_dropped(world, monkeypatch):
    client = Client(world)
    client.topic("rt/down", TYPE)
    client.reader()
    client.turns()
    recreate = agent_client.ProxyClient.recreate

    def refuse(self, object_id, *args):
        if object_id == 0x16:
            raise MiddlewareError("out of readers")
        recreate(self, object_id, *args)

    def keep_reads(self, object_id):
        self.objects.pop(object_id, None)

    with monkeypatch.context() as patch:
        patch.setattr(agent_client.ProxyClient, "recreate", refuse)
        patch.setattr(module.ClientRecords, "deleted", keep_reads)
        world.restart()
    (cursor,) = world.desk.session_store._cursors.values()
    assert 0x16 not in cursor.records.reads and 0x16 not in cursor.client.objects


def test_a_client_that_resets_its_session(world):
    far_samples = far_reader(world)
    client = publisher(world)
    client.write(0x15, number(1))
    settled(client)
    world.send(client.peer, bytes((0x81, 0, 0, 0, ids.RESET, 1, 0, 0)))
    client.last_acknown = client.last_sent = client.last_handled = client._announced = 0xFFFF
    world.restart()
    client.write(0x15, number(2))
    settled(client)
    assert far_samples() == [1, 2]


def test_a_client_that_has_left_gets_no_retransmission_request(world):
    publisher(world)
    world.restart()
    world.desk.agent.delete_client(0xA1)
    world.wait(3000)
    assert not world.desk.session_store._retransmits


def test_long_samples_are_not_kept_for_late_readers(world, monkeypatch):
    monkeypatch.setattr(module_of_cursors, "MAX_LATCHED", 100)
    qos = ids.QOS_RELIABLE | ids.QOS_KEEP_LAST | ids.QOS_TRANSIENT_LOCAL
    client = publisher(world, qos=qos, depth=1)
    client.write(0x15, number(1))
    client.write(0x15, number(2, 200))
    settled(client)
    world.restart()
    profile = QoSProfile(depth=5, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    late_reader = world.node.create_reader("rt/up", TYPE, profile, lambda: None)
    assert late_reader.take(5) == []  # nor the one before, which is no longer the last


def test_more_clients_than_slots(world, monkeypatch):
    """Silent clients make room; a client without a slot is served, but not kept."""
    publisher(world)
    world.kill()
    with monkeypatch.context() as patch:
        patch.setattr(helpers.Place, "name", "OtherAgent")
        world.start()
        world.desk.session_store._free.clear()
        publisher(world, key=0xA2)
        assert not world.desk.session_store._asleep
        far_samples = far_reader(world)
        client = publisher(world, key=0xA3)
        client.write(0x15, number(1))
        settled(client)
        assert far_samples() == [1]
        world.kill()
        monkeypatch.setattr(module, "SLOTS", 0)
        world.start()
        assert list(world.desk.agent.clients) == [0xA2]  # restored, though it has no slot
    world.restart()
    assert not world.desk.agent.clients


# --- killed at any moment -------------------------------------------------------------------------


@settings(max_examples=examples(60), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    steps=st.lists(st.integers(0, 5), min_size=5, max_size=30),
    deaths=st.lists(st.integers(1, 400), max_size=6, unique=True),
)
def test_killed_between_any_two_writes(tmp_path_factory, steps, deaths):
    """At any moment of a kill, no acknowledged sample is lost, and no number is behind."""
    world = World(tmp_path_factory.mktemp("world") / "state")
    try:
        far_samples = far_reader(world)
        client = Client(world)
        client.topic("rt/up", TYPE)
        client.writer(depth=1000)
        client.create(0x22, 0x11, helpers_topic, "rt/down", TYPE)
        client.create(0x14, 0x11, helpers_group, None, None)
        client.create(0x16, 0x14, helpers_reader, 0x22, ids.QOS_RELIABLE, 100)
        client.request(
            ids.READ_DATA, data.push_read_data, 0x16, ids.STREAM_RELIABLE, 0, None,
            (0xFFFF, 0, 0, 0), wait=False,
        )  # fmt: skip
        settled(client)
        down = world.node.create_writer("rt/down", TYPE, QoSProfile(depth=1000))
        world.calls = 0
        world.deaths = deque(sorted(deaths))
        written, sent_count = [], 0
        for step in [*steps, 5]:
            if step == 0 and client.room > 1:
                written.append(client.write(0x15, number(len(written))))
            elif step == 1 and client.room > 4:
                written.append(client.write(0x15, number(len(written), 1400)))
            elif step == 2:
                down.write(b"\0\1\0\0" + number(sent_count))
                sent_count += 1
            elif step == 3:
                down.write(b"\0\1\0\0" + number(sent_count, 1400))
                sent_count += 1
            elif step == 4:
                world.restart()
            elif step == 5:
                client.turns(10)
        world.deaths.clear()
        settled(client)
        values = far_samples()
        assert sorted(set(values)) == list(range(len(written)))
        before = len(client.samples)
        client.turns()
        down.write(b"\0\1\0\0" + number(sent_count))
        client.until(
            lambda: client.samples and last(client) == sent_count, "the way down is blocked"
        )
        numbers = [struct.unpack_from("<I", sample)[0] for sample in client.samples]
        assert numbers == sorted(set(numbers)), (before, numbers)
    finally:
        world.close()


def test_a_kill_before_a_burst_is_written_delivers_a_window_of_samples_twice(world, monkeypatch):
    """Samples were delivered, but neither written nor acknowledged: the client sends them again."""
    far_samples = far_reader(world)
    client = publisher(world)
    client.write(0x15, number(0))
    settled(client)
    monkeypatch.setattr(world.desk, "settle", lambda: [])  # all that follows is one burst
    for value in range(1, 17):
        assert client.room > 0
        client.write(0x15, number(value))
    assert client.room == 0  # its window is full
    world.restart()
    settled(client)
    for value in range(17, 20):
        client.write(0x15, number(value))
    settled(client)
    assert sorted(far_samples()) == sorted([*range(20), *range(1, 17)])


def last(client):
    return struct.unpack_from("<I", client.samples[-1])[0]


def helpers_topic(w, *values):
    from uros.wire import entities

    entities.push_binary_topic(w, *values)


def helpers_group(w, *values):
    from uros.wire import entities

    entities.push_binary_group(w, *values)


def helpers_reader(w, *values):
    from uros.wire import entities

    entities.push_binary_endpoint(w, *values, reader=True)
