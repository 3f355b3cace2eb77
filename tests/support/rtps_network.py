"""RTPS participants on a simulated network, with a time of its own."""

import random
import struct

from uros.middleware.rtps import ids, parameters, submessages
from uros.middleware.rtps.locators import UDPV4, Locator
from uros.middleware.rtps.parameters import EndpointData, ParticipantData
from uros.middleware.rtps.participant import Participant
from uros.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

GROUP = Locator(UDPV4, 7400, "239.255.0.1")
TYPE = "std_msgs::msg::dds_::String_"
BEST_EFFORT = QoSProfile(reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=3, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def prefix(number):
    return ids.VENDOR + bytes(9) + bytes([number])


class Network:
    """Participants, each at an address of its own; ``loss`` is a rate."""

    def __init__(self, loss=0.0, seed=0):
        self.now = 100.0
        self.loss = loss
        self.random = random.Random(seed)
        self.members = {}  # by address
        self.log = []  # (source, datagram, place)

    def add(self, number, domain=0, address=None, peers=()):
        """Add a participant, with addresses of peers in place of multicast if there are any."""
        address = address or f"10.0.0.{number}"
        place = Locator(UDPV4, 7410, address)
        groups = [] if peers else [GROUP]
        places = [Locator(UDPV4, 7410, peer) for peer in peers]
        enclave = b"enclave=/;"
        member = Participant(prefix(number), domain, [place], groups, places, enclave, self.now)
        self.members[address] = member
        return member

    def inject(self, address, datagram, member):
        member.receive(memoryview(datagram), address, self.now)

    def carry(self):
        """Deliver what was sent, and what is sent because of that."""
        for _ in range(100):
            sent = []
            for address, member in self.members.items():
                member.poll(self.now)
                sent += [(address, *item) for item in member.take_datagrams()]
            self.log += sent
            if not sent:
                return
            for source, datagram, place in sent:
                for address, member in self.members.items():
                    if place in (GROUP, Locator(UDPV4, 7410, address)):
                        if self.random.random() >= self.loss:
                            member.receive(memoryview(datagram), source, self.now)
        raise AssertionError("they do not stop talking")

    def sent(self, source):
        """The datagrams of one participant in the log, without announcements to all."""
        return [item for address, item, place in self.log if address == source and place != GROUP]

    def step(self, seconds=0.05, count=1):
        for _ in range(count):
            self.carry()
            self.now += seconds

    def until(self, done, steps=600):
        for _ in range(steps):
            self.step()
            if done():
                return
        raise AssertionError("it does not happen")


def is_acknowledged(writer):
    """Whether all reliable readers of the state of a writer have everything."""
    return all(proxy.acked >= writer.last for proxy in writer.readers.values() if proxy.reliable)


class Inbox:
    def __init__(self, network, member, topic="rt/chatter", type_name=TYPE, qos=None):
        self.samples = []
        self.reader = member.create_reader(
            topic, type_name, qos or QoSProfile(), self.deliver, network.now, 0
        )

    def deliver(self, sample):
        self.samples.append(sample.payload)
        return True


def writer_of(network, member, topic="rt/chatter", type_name=TYPE, qos=None):
    return member.create_writer(topic, type_name, qos or QoSProfile(), network.now, 0)


def cdr(number, size=16):
    return b"\0\1\0\0" + struct.pack("<I", number) + bytes(size)


def pair(network):
    one, two = network.add(1), network.add(2)
    network.until(lambda: one.remotes and two.remotes)
    return one, two


def announcement(data, inline_qos=b"", is_key=False, payload=None):
    """A datagram that announces a participant."""
    payload = parameters.write_participant(data) if payload is None else payload
    encoded = submessages.encode_data(
        ids.SPDP_READER, ids.SPDP_WRITER, 1, payload, inline_qos, is_key
    )
    return submessages.header(data.guid[:12]) + encoded


def encode_heartbeat_frag(reader, writer, number, last, count):
    """A HEARTBEAT_FRAG submessage (RTPS 9.4.5.7), which writers of ours do not send."""
    body = struct.pack("<4s4siIII", reader, writer, number >> 32, number & 0xFFFFFFFF, last, count)
    return struct.pack("<BBH", ids.HEARTBEAT_FRAG, 1, len(body)) + body


class Stranger:
    """A hand-made participant at an address."""

    def __init__(self, network, target, number=66, address="10.0.0.66", said=None):
        self.network, self.target, self.address = network, target, address
        self.prefix = prefix(number)
        self.place = Locator(UDPV4, 7410, said or address)
        self.count = 0

    def announce(self, **more):
        data = ParticipantData(
            self.prefix + ids.ENTITY_PARTICIPANT, domain=0, builtin=0x3F,
            metatraffic_unicast=[self.place], default_unicast=[self.place],
        )  # fmt: skip
        for name, value in more.items():
            setattr(data, name, value)
        self.network.inject(self.address, announcement(data), self.target)

    def send(self, *parts, address=None):
        datagram = submessages.header(self.prefix) + b"".join(parts)
        self.network.inject(address or self.address, datagram, self.target)

    def endpoint(
        self, topic, is_writer, guid=None, places=(), representations=(0,), qos=None
    ):  # fmt: skip
        entity = ids.PUBLICATIONS_WRITER if is_writer else ids.SUBSCRIPTIONS_WRITER
        if not self.count:
            self.send(submessages.encode_heartbeat(bytes(4), entity, 1, 0, 1))
        self.count += 1
        guid = guid or self.prefix + bytes([0, 0, self.count, 3 if is_writer else 4])
        data = EndpointData(
            guid,
            is_writer,
            topic,
            TYPE,
            qos or QoSProfile(),
            list(places),
            representations=representations,
        )
        payload = parameters.write_endpoint(data)
        self.send(submessages.encode_data(bytes(4), entity, self.count, payload))
        return guid
