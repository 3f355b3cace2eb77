"""Noise on the network of :mod:`support.ten_boards`: one function for each kind."""

import itertools
import json
import os
import select
import socket
import sys
import threading
import time

from support import wifi
from support.networks import Host
from support.ten_boards import (
    BEST_EFFORT,
    DOMAIN,
    PORT,
    TOPICS,
    TYPE,
    Loop,
    Program,
    String,
    measure,
)
from uros.client import AGENT_CONNECTED, Node
from uros.middleware.rtps import ids, locators, parameters, submessages
from uros.middleware.rtps.locators import UDPV4, Locator
from uros.middleware.rtps.parameters import EndpointData, ParticipantData
from uros.middleware.rtps.participant import Participant
from uros.qos import QoSProfile
from uros.transport.udp import UdpTransport

PARTICIPANTS, ENDPOINTS = 60, 3000
STAY = 1.0


def _hosts():
    """The agent's host and the reader's, with a link."""
    agent, reader = Host(), Host()
    agent.plug("net0", reader, "net0")
    for host, address in ((agent, "10.9.1.1/24"), (reader, "10.9.1.2/24")):
        with host:
            host.ip(f"addr add {address} dev net0")
    return agent, reader


# What the noise's processes are started with.
_PRIORITY = []


def run(scenario, seconds, *arguments, is_idle=False):
    """Run a scenario of this module; with ``is_idle``, noise gets what time of processors is left.

    It is that of other machines, so it must not take processors away where time is measured.
    """
    if is_idle:
        _PRIORITY[:] = ["chrt", "-i", "0"]
    globals()[scenario](seconds, *arguments)


def _noise(host, function, *arguments):
    """Start a function of this module on a host, and publish until it is ready.

    Returns:
        A function with the stack and the boards of :func:`measure`.
    """

    def start(stack, boards):
        given = ", ".join(map(repr, arguments))
        code = f"import {__name__} as noise; noise.{function}({given})"
        program = Program(host, *_PRIORITY, sys.executable, "-c", code)
        stack.callback(program.kill)
        boards.until(lambda: program.is_ready)
        return program.finish

    return start


def none(seconds):
    """No noise."""
    measure(*_hosts(), seconds, lambda stack, boards: lambda: None)


# --- many participants ----------------------------------------------------------------------------


class Member:
    """A participant with a socket, which talks to the agent and the reader alone."""

    def __init__(self, own, others, user_data=b"enclave=/;"):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setblocking(False)
        self.socket.bind((own, 0))
        self.place = Locator(UDPV4, self.socket.getsockname()[1], own)
        port = locators.metatraffic_port(DOMAIN, 0)
        self.peers = [Locator(UDPV4, port, other) for other in others]
        self.participant = Participant(
            ids.VENDOR + os.urandom(10), DOMAIN, [self.place], [], self.peers, user_data,
            time.monotonic(),
        )  # fmt: skip

    def turn(self):
        """Receive and send what there is."""
        now = time.monotonic()
        for _ in range(50):
            try:
                octets, source = self.socket.recvfrom(65536)
            except BlockingIOError:
                break
            self.participant.receive(memoryview(octets), source[0], now)
        self.participant.poll(now)
        self.send()

    def send(self):
        for datagram, place in self.participant.take_datagrams():
            try:
                self.socket.sendto(datagram, (place.address, place.port))
            except BlockingIOError:
                pass

    def acknowledged(self):
        """How many announcements of endpoints all peers have."""
        writers = [
            self.participant.writers[one]
            for one in (ids.PUBLICATIONS_WRITER, ids.SUBSCRIPTIONS_WRITER)
        ]
        if any(len(writer.state.readers) < len(self.peers) for writer in writers):
            return 0
        return sum(
            min(proxy.acked for proxy in writer.state.readers.values()) for writer in writers
        )

    def close(self):
        self.participant.close()
        self.send()
        self.socket.close()


def _has_input_ended(seconds=0.0):
    """Whether the noise is to end; waits for that for some seconds."""
    return bool(select.select([0], [], [], seconds)[0])


def crowd_of(own, others):
    """60 participants with 3,000 endpoints come at once, are known, go at once, and so on."""
    print("ready", flush=True)
    times = []
    while not _has_input_ended():
        start = time.monotonic()
        members = [Member(own, others) for _ in range(PARTICIPANTS)]
        for number in range(ENDPOINTS):
            participant = members[number % PARTICIPANTS].participant
            topic, now = f"rt/crowd_{number // 2}", time.monotonic()
            if number % 2:
                participant.create_writer(topic, TYPE, QoSProfile(), now, time.time_ns())
            else:
                participant.create_reader(topic, TYPE, QoSProfile(), bool, now, time.time_ns())
        while not (times and _has_input_ended()):
            for member in members:
                member.turn()
            if sum(member.acknowledged() for member in members) == ENDPOINTS:
                times.append(time.monotonic() - start)
                break
        rest = time.monotonic() + STAY
        while time.monotonic() < rest and not _has_input_ended(0.02):
            for member in members:
                member.turn()
        for member in members:
            member.close()
    print(json.dumps({"times": times}))


def crowd(seconds):
    """A noisy network: participants and endpoints without end."""
    agent, reader = _hosts()
    measure(
        agent, reader, seconds, _noise(reader, "crowd_of", "10.9.1.2", ["10.9.1.1", "10.9.1.2"])
    )


# --- a flood --------------------------------------------------------------------------------------


def _samples(member, topic):
    """Samples for a topic that a board reads."""
    writer = member.participant.create_writer(topic, TYPE, BEST_EFFORT, time.monotonic(), 0)
    entity = writer.data.guid[12:]

    def batch(number):
        payload = b"\0\1\0\0" + (4).to_bytes(4, "little") + b"abc\0"
        return [
            submessages.encode_data(bytes(4), entity, number + one, payload) for one in range(64)
        ]

    return batch


def _heartbeats(member, topic):
    """Heartbeats of announcements that do not exist: each wants an answer."""

    def batch(number):
        return [
            submessages.encode_heartbeat(bytes(4), ids.PUBLICATIONS_WRITER, 1, one, one)
            for one in range(number, number + 64)
        ]

    return batch


def _announcements(member, topic):
    """Announcements of endpoints that differ each time, out of order."""
    prefix = member.participant.guid[:12]

    def batch(number):
        found = []
        for one in range(number, number + 64):
            guid = prefix + (one % 4000).to_bytes(3, "big") + bytes([ids.KIND_WRITER_NO_KEY])
            data = EndpointData(guid, True, f"rt/flood_{one}", TYPE, QoSProfile())
            payload = parameters.write_endpoint(data)
            found.append(submessages.encode_data(bytes(4), ids.PUBLICATIONS_WRITER, one, payload))
        return found

    return batch


def _participants(member, topic):
    """Announcements of the participant that differ each time."""

    def batch(number):
        found = []
        for one in range(number, number + 64):
            data = ParticipantData(
                member.participant.guid, DOMAIN, metatraffic_unicast=[member.place],
                default_unicast=[member.place], builtin=0x3F, user_data=b"%d" % one,
            )  # fmt: skip
            payload = parameters.write_participant(data)
            found.append(submessages.encode_data(bytes(4), ids.SPDP_WRITER, one, payload))
        return found

    return batch


def _requests(member, topic):
    """Requests for samples of a board, again and again."""
    received = []
    reader = member.participant.create_reader(
        "rt/board_1", TYPE, QoSProfile(), lambda sample: received.append(sample) or True,
        time.monotonic(), 0,
    )  # fmt: skip
    entity = reader.data.guid[12:]

    def batch(number):
        if not received:
            return []
        writer, first = received[0].writer[12:], received[0].number
        missing = list(range(first, first + 200))
        return [
            submessages.encode_acknack(entity, writer, first, missing, one, True)
            for one in range(number, number + 64)
        ]

    return batch


FLOODS = {
    "requests": _requests,
    "samples": _samples,
    "heartbeats": _heartbeats,
    "announcements": _announcements,
    "participants": _participants,
}


def flood_of(own, other, kind):
    """One participant sends datagrams of a kind to the agent as fast as it can."""
    member = Member(own, [other])
    batch = FLOODS[kind](member, "rt/flood")
    announced = kind in ("samples", "requests")  # an endpoint
    while not member.participant.remotes or not member.acknowledged() >= announced:
        member.turn()
        if _has_input_ended(0.002):
            return
    print("ready", flush=True)
    (remote,) = member.participant.remotes.values()
    place = remote.place(
        remote.data.default_unicast if announced else remote.data.metatraffic_unicast
    )
    head = submessages.header(member.participant.guid[:12])
    number, sent = 1000, 0
    while not _has_input_ended():
        member.turn()
        for part in batch(number):
            try:
                member.socket.sendto(head + part, (place.address, place.port))
                sent += 1
            except BlockingIOError:
                break
        number += 64
    print(json.dumps({"sent": sent}))


def flood(seconds, kind):
    """One participant floods the agent, where a board reads its topic."""
    agent, reader = _hosts()

    def start(stack, boards):
        boards.subscribe("flood")
        return _noise(reader, "flood_of", "10.9.1.2", "10.9.1.1", kind)(stack, boards)

    measure(agent, reader, seconds, start)


# --- large and frequent ---------------------------------------------------------------------------


LARGE = 1_000_000


def large_reader():
    """A node that reads 1 MB messages and 1 kHz ones of boards, and writes such messages."""
    loop = Loop("large_reader")
    qos = QoSProfile()
    counts = {"large": 0, "fast": 0, "written": 0}
    sizes = set()
    heard = set()

    def take_large():
        for cdr in large.take(10):
            counts["large"] += 1
            sizes.add(len(cdr))
            heard.add("large")
            tell()

    def take_fast():
        counts["fast"] += len(fast.take(1000))
        heard.add("fast")
        tell()

    def tell():
        if heard == {"large", "fast"}:
            heard.clear()
            heard.add("told")
            print("ready", flush=True)

    large = loop.node.create_reader("rt/large", TYPE, qos, take_large)
    fast = loop.node.create_reader("rt/fast", TYPE, qos, take_fast)
    writer = loop.node.create_writer("rt/large_in", TYPE, qos)
    text = b"x" * (LARGE - 1) + b"\0"
    cdr = b"\0\1\0\0" + len(text).to_bytes(4, "little") + text
    at = time.monotonic()
    while loop.turn(at):
        if time.monotonic() >= at:
            at += 0.25
            counts["written"] += writer.write(cdr)
    loop.middleware.close()
    print(json.dumps({**counts, "sizes": sorted(sizes)}))


def large_boards():
    """A board that sends and reads 1 MB messages, and one that sends 1,000 small ones a second."""
    counts = {"large": 0, "fast": 0, "read": 0}

    def take(message):
        counts["read"] += len(message.data) == LARGE - 1

    transport = UdpTransport("127.0.0.1", PORT, 1400)
    camera = Node("camera", transport, "", DOMAIN, 101, limit=3 * LARGE)
    large = camera.create_publisher(String, "large")
    camera.create_subscription(String, "large_in", take)
    imu = Node("imu", UdpTransport("127.0.0.1", PORT), "", DOMAIN, 102)
    fast = imu.create_publisher(String, "fast")
    while any(node.state != AGENT_CONNECTED for node in (camera, imu)):
        camera.spin_once(0.005)
        imu.spin_once(0.005)
    print("ready", flush=True)
    text = "x" * (LARGE - 1)
    next_large = next_fast = time.monotonic()
    while not _has_input_ended():
        now = time.monotonic()
        if now >= next_large:
            next_large = now + 0.5
            counts["large"] += bool(large.publish(String(data=text)))
        imu.spin_once(0)
        camera.spin_once(0)
        if now < next_fast:
            _has_input_ended(max(0.0, next_fast - time.monotonic()))
            continue
        next_fast = max(next_fast + 0.001, now - 0.1)
        counts["fast"] += bool(fast.publish(String(data="x" * 30)))
    print(json.dumps(counts))


def large(seconds):
    """Messages of 1 MB beside 1,000 small ones a second."""
    agent, reader = _hosts()

    def start(stack, boards):
        sending = _noise(agent, "large_boards")(stack, boards)
        reading = _noise(reader, "large_reader")(stack, boards)
        return lambda: {"node": reading(), "boards": sending()}

    measure(agent, reader, seconds, start)


# --- an interface that comes and goes -------------------------------------------------------------


def interface(seconds):
    """The link between the hosts that is used first comes and goes, at one end or the other."""
    agent, reader = Host(), Host()
    for number in (1, 2):
        agent.plug(f"net{number}", reader, f"net{number}")
        for host, address in ((agent, f"10.9.{number}.1/24"), (reader, f"10.9.{number}.2/24")):
            with host:
                host.ip(f"addr add {address} dev net{number}")

    def start(stack, boards):
        done = threading.Event()
        changes = []

        def change():
            for host in itertools.cycle((agent, reader)):
                done.wait(2.0)
                with host:
                    host.ip("link set net1 down")
                done.wait(2.0)
                with host:
                    host.ip("link set net1 up")
                changes.append(time.monotonic())
                if done.is_set():
                    break

        thread = threading.Thread(target=change)
        thread.start()

        def end():
            done.set()
            thread.join()
            return {"times": len(changes)}

        return end

    measure(agent, reader, seconds, start)


# --- a slow reader on Wi-Fi -----------------------------------------------------------------------


def slow_reader():
    """Reads what boards send, reliable, and counts."""
    loop = Loop("slow_reader")
    counts = dict.fromkeys((*TOPICS, "rt/large", "rt/fast"), 0)

    def listen(topic):
        def take():
            counts[topic] += len(reader.take(1000))
            if sum(counts.values()) == 1:
                print("ready", flush=True)

        reader = loop.node.create_reader(topic, TYPE, TOPICS.get(topic, QoSProfile()), take)

    for topic in counts:
        listen(topic)
    while loop.turn():
        pass
    loop.middleware.close()
    print(json.dumps(counts))


def slow(seconds, seed=1, loss=0.1, delay=0.02, rate=250_000):
    """A reader on another host, behind a link that is slower than what the boards send."""
    agent, reader = _hosts()
    far = Host()

    def start(stack, boards):
        carrier = wifi.join(
            agent, far, "wifi0", ("10.9.3.1/24", "10.9.3.2/24"), seed, loss, delay, rate
        )
        stack.callback(carrier.wait)
        stack.callback(carrier.kill)
        reading = _noise(far, "slow_reader")(stack, boards)
        sending = _noise(agent, "large_boards")(stack, boards)
        return lambda: {"boards": sending(), "reader": reading()}

    measure(agent, reader, seconds, start)
