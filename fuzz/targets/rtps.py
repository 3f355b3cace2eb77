"""An RTPS participant among others: any datagrams, from strangers and in others' names.

Three participants of uros are on a simulated network: ours, a friend in whose name the input may
speak, and a witness that is left alone. Records; the operation's low three bits are the kind, the
next two the address:

====  ====================================================================
0     a datagram, unchanged
1     submessages of a stranger, after a header with its prefix
2     submessages in the name of the friend
3     a time passes, in milliseconds
4     the friend writes this sample
5     our participant writes this sample
6     a stranger announces itself
7     an endpoint of the stranger is discovered: the body has its number and its kind
====  ====================================================================

After each record every datagram of ours must be valid RTPS, small, and for an address that was
heard; what is held must be within its limit. In the end the witness and ours must exchange
samples.
"""

import json
import struct
from collections.abc import Iterator
from pathlib import Path
from random import Random

from uros.middleware.rtps import ids, parameters, submessages
from uros.middleware.rtps.locators import UDPV4, Locator
from uros.middleware.rtps.parameters import EndpointData, ParticipantData
from uros.middleware.rtps.participant import MAX_HELD, MESSAGE_SIZE, Participant
from uros.middleware.rtps.reader import Sample
from uros.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from . import records
from .world import must

OPS = tuple(range(0x20))
GROUP = Locator(UDPV4, 7400, "239.255.0.1")
OURS, FRIEND, WITNESS = "10.0.0.1", "10.0.0.2", "10.0.0.3"
ADDRESSES = ("10.0.0.66", FRIEND, "10.0.0.67", OURS)
STRANGER = ids.VENDOR + bytes(9) + b"\x66"
TYPE = "std_msgs::msg::dds_::String_"
PROFILES = (
    QoSProfile(),
    QoSProfile(reliability=ReliabilityPolicy.BEST_EFFORT),
    QoSProfile(depth=3, durability=DurabilityPolicy.TRANSIENT_LOCAL),
)
VECTORS = Path(__file__).parents[2] / "tests" / "unit" / "middleware" / "rtps" / "vectors.json"
_MAX_SENT = 2_000_000  # octets of ours in one input


class Network:
    """The participants, and what is on its way between them."""

    def __init__(self) -> None:
        self.now = 100.0
        self.samples: dict[str, list[bytes | None]] = {}
        self.sent = 0
        self.members = {address: self._join(address) for address in (OURS, FRIEND, WITNESS)}
        self.writers = {
            address: [self._writer(address, topic) for topic in range(len(PROFILES))]
            for address in self.members
        }
        for _ in range(20):
            self.carry()
            self.now += 0.05

    def _join(self, address: str) -> Participant:
        prefix = ids.VENDOR + bytes(9) + address[-1:].encode()
        place = Locator(UDPV4, 7410, address)
        member = Participant(prefix, 0, [place], [GROUP], [], b"enclave=/;", self.now)
        samples = self.samples[address] = []

        def deliver(sample: Sample) -> bool:
            samples.append(sample.payload)
            return True

        for topic, qos in enumerate(PROFILES):
            member.create_reader(f"rt/{topic}", TYPE, qos, deliver, self.now, 0)
        return member

    def _writer(self, address: str, topic: int):  # type: ignore[no-untyped-def]
        member = self.members[address]
        return member.create_writer(f"rt/{topic}", TYPE, PROFILES[topic], self.now, 0)

    def carry(self) -> None:
        for _ in range(20):
            sent: list[tuple[str, bytes, Locator]] = []
            for address, member in self.members.items():
                member.poll(self.now)
                sent += [(address, *item) for item in member.take_datagrams()]
            if not sent:
                return
            for source, datagram, place in sent:
                if source == OURS:
                    self._check(datagram, place)
                for address, member in self.members.items():
                    if place in (GROUP, Locator(UDPV4, 7410, address)):
                        member.receive(memoryview(datagram), source, self.now)

    def _check(self, datagram: bytes, place: Locator) -> None:
        ours = self.members[OURS]
        must(len(datagram) <= MESSAGE_SIZE, "a datagram beyond the message size")
        list(submessages.read(memoryview(datagram)))
        heard = {address for remote in ours.remotes.values() for address in remote.heard}
        must(place == GROUP or place.address in heard, f"a datagram to {place}")
        self.sent += len(datagram)
        must(self.sent < _MAX_SENT, "a flood of our own")

    def check(self) -> None:
        ours = self.members[OURS]
        must(0 <= ours._budget.used <= MAX_HELD, "what is held is beyond its limit")
        for reader in ours.readers.values():
            for proxy in reader.state.writers.values():
                must(proxy.held_octets >= 0 and len(proxy.incomplete) <= 8, "held samples")
                must(proxy.expected is None or proxy.expected > 0, "a number that cannot be")
        for writer in ours.writers.values():
            for proxy in writer.state.readers.values():
                must(proxy.acked <= writer.state.last, "more is acknowledged than was written")


def one_input(data: bytes) -> None:
    network = Network()
    ours = network.members[OURS]
    count = 0
    for op, body in records.unpack(data):
        kind, address = op & 7, ADDRESSES[op >> 3 & 3]
        if kind == 0:
            ours.receive(memoryview(body), address, network.now)
        elif kind in (1, 2):
            prefix = STRANGER if kind == 1 else ids.VENDOR + bytes(9) + b"2"
            datagram = submessages.header(prefix) + body
            ours.receive(memoryview(datagram), address, network.now)
        elif kind == 3:
            network.now += (int.from_bytes(body[:2], "little") % 30_000) / 1000
        elif kind in (4, 5):
            writers = network.writers[FRIEND if kind == 4 else OURS]
            writer = writers[(op >> 3 & 3) % len(writers)]
            writer.write(b"\0\1\0\0" + body, 0, network.now)
        elif kind == 6:
            place = Locator(UDPV4, 7410, address)
            stranger = ParticipantData(
                STRANGER + ids.ENTITY_PARTICIPANT, ids.VENDOR, domain=0, builtin=0x3F,
                metatraffic_unicast=[place], default_unicast=[place],
            )  # fmt: skip
            payload = parameters.write_participant(stranger)
            announced = submessages.encode_data(ids.SPDP_READER, ids.SPDP_WRITER, 1, payload)
            ours.receive(memoryview(submessages.header(STRANGER) + announced), address, network.now)
        else:
            count += 1
            number, form = (body[0], body[1]) if len(body) > 1 else (1, 0)
            _discover(network, count, number, form, address)
        network.carry()
        network.check()
    _finish(network)


def _discover(network: Network, count: int, number: int, form: int, address: str) -> None:
    is_writer = bool(form & 1)
    guid = STRANGER + bytes((0, 0, number, 3 if is_writer else 4))
    topic = form >> 1 & 3
    data = EndpointData(guid, is_writer, f"rt/{topic % 3}", TYPE, PROFILES[topic % 3])
    entity = ids.PUBLICATIONS_WRITER if is_writer else ids.SUBSCRIPTIONS_WRITER
    datagram = (
        submessages.header(STRANGER)
        + submessages.encode_heartbeat(bytes(4), entity, count, count, count)
        + submessages.encode_data(bytes(4), entity, count, parameters.write_endpoint(data))
    )
    network.members[OURS].receive(memoryview(datagram), address, network.now)


def _finish(network: Network) -> None:
    """The witness and ours exchange samples, whatever became of the others."""
    payloads = [b"\0\1\0\0" + struct.pack("<I", 0xD0D0) + bytes(size) for size in (8, 5000)]
    network.sent = 0
    for source, target in ((OURS, WITNESS), (WITNESS, OURS)):
        for step in range(400):
            if step % 40 == 0:  # those from before a match are lost
                for payload in payloads:
                    network.writers[source][0].write(payload, 0, network.now)
            network.carry()
            network.now += 0.05
            if all(payload in network.samples[target] for payload in payloads):
                break
        else:
            must(False, f"{target} does not hear {source}")
    for member in network.members.values():
        member.close()
    must(network.members[OURS]._budget.used == 0, "octets are held after the end")


def _captured() -> Iterator[tuple[str, bytes]]:
    for number, vector in enumerate(json.loads(VECTORS.read_text("utf-8"))):
        datagram = bytes.fromhex(vector["datagram"])
        if len(datagram) < 1000:
            yield f"{vector['source'].split()[0].lower()}_{number}", datagram


def _talk() -> list[records.Record]:
    reader, writer = b"\0\0\1\x04", b"\0\0\1\x03"
    data = submessages.encode_data(bytes(4), b"\0\0\5\3", 1, b"\0\1\0\0abcd")
    return [
        (6, b""),
        (7, b"\5\1"),
        (7, b"\6\0"),
        (1, submessages.encode_heartbeat(bytes(4), b"\0\0\5\3", 1, 3, 1)),
        (1, data),
        (1, submessages.encode_data_frag(bytes(4), b"\0\0\5\3", 2, 1, 100, 150, bytes(100))),
        (1, submessages.encode_data_frag(bytes(4), b"\0\0\5\3", 2, 2, 100, 150, bytes(50))),
        (1, submessages.encode_gap(bytes(4), b"\0\0\5\3", 3, 4, [5])),
        (1, submessages.encode_heartbeat_frag(bytes(4), b"\0\0\5\3", 6, 2, 1)),
        (5, b"hello"),
        (5, bytes(3000)),
        (1, submessages.encode_acknack(b"\0\0\6\4", writer, 1, [1, 2], 1)),
        (1, submessages.encode_nack_frag(b"\0\0\6\4", writer, 2, [1, 3], 1)),
        (3, b"\x64\0"),
        (4, b"from a friend"),
        (2, submessages.encode_acknack(reader, writer, 1, [], 5)),
        (2, submessages.encode_heartbeat(bytes(4), writer, 1, 9, 50)),
        (3, b"\xff\x50"),
    ]


def seeds() -> Iterator[tuple[str, bytes]]:
    yield "talk", records.pack(_talk())
    captured = list(_captured())
    for at in range(0, len(captured), 12):
        part = captured[at : at + 12]
        yield part[0][0], records.pack([(0, datagram) for _, datagram in part])


def mutate(data: bytes, random: Random, mutate_bytes: records.MutateBytes) -> bytes:
    material = [*_talk(), *((0, datagram) for _, datagram in _MATERIAL)]

    def change(op: int, body: bytes) -> bytes:
        return mutate_bytes(body)

    return records.mutate(data, random, OPS, material, change)


_MATERIAL = list(_captured())
