"""An RTPS participant among others: any datagrams in any state, by strangers and in others' names.

Three participants of uros are on a simulated network: ours, a friend in whose name the input may
speak, and a witness that is left alone. All have endpoints that match: reliable, best effort,
transient local, and those of a service. Records; the operation's low four bits are the kind, the
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
8     a datagram of the friend to us, with changes: the body has which one, and places and values
9     a datagram of ours with changes comes back, in the name of the friend
10    the friend writes a sample of so many octets, of whose datagrams these are lost
11    the stranger acknowledges: from now on it may get more octets than came from it
12    an endpoint of ours is deleted and created again
13    the friend is killed and comes back, under its GUID or another
14    a request or reply of the friend, whose inline QoS is the body
15    a time passes, in minutes, without a turn of ours
====  ====================================================================

After each record every datagram of ours must be valid RTPS, small, and for an address that was
heard, and strangers that have proven nothing have got no more octets than came from them. The
participants must come to rest, with a deadline of ours in the near future. All accounts must agree
with what they count, and be within their limits. In the end the witness and ours must exchange
samples.
"""

import json
import struct
from collections.abc import Iterator
from pathlib import Path
from random import Random

from uros.middleware.rtps import ids, parameters, submessages
from uros.middleware.rtps.locators import UDPV4, Locator
from uros.middleware.rtps.outbox import MESSAGE_SIZE
from uros.middleware.rtps.parameters import EndpointData, ParticipantData
from uros.middleware.rtps.participant import MAX_HELD, MAX_KNOWN, Participant
from uros.middleware.rtps.reader import MAX_AHEAD, Sample
from uros.middleware.rtps.reassembly import MAX_INCOMPLETE
from uros.middleware.rtps.remote import cost
from uros.middleware.rtps.services import _Parser
from uros.middleware.services.form import CLIENT_ID, SERVICE_ID
from uros.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from . import records
from .world import must

OPS = tuple(range(0x40))
GROUP = Locator(UDPV4, 7400, "239.255.0.1")
OURS, FRIEND, WITNESS = "10.0.0.1", "10.0.0.2", "10.0.0.3"
STRANGERS = ("10.0.0.66", "10.0.0.67")
ADDRESSES = (STRANGERS[0], FRIEND, STRANGERS[1], OURS)
STRANGER = ids.VENDOR + bytes(9) + b"\x66"
TYPE = "std_msgs::msg::dds_::String_"
PROFILES = (
    QoSProfile(),
    QoSProfile(reliability=ReliabilityPolicy.BEST_EFFORT),
    QoSProfile(depth=3, durability=DurabilityPolicy.TRANSIENT_LOCAL),
    QoSProfile(user_data=CLIENT_ID + b"00.00;" + SERVICE_ID + b"00.00;"),
)
SERVICE = len(PROFILES) - 1  # the topic of requests and replies
VECTORS = Path(__file__).parents[2] / "tests" / "unit" / "middleware" / "rtps" / "vectors.json"
_MAX_SENT = 2_000_000  # octets of ours in one input


class Network:
    """The participants, and what is on its way between them."""

    def __init__(self) -> None:
        self.now = 100.0
        self.samples: dict[str, list[bytes | None]] = {}
        self.sent = 0
        self.lost: set[int] = (
            set()
        )  # the numbers of the friend's next datagrams to us that get lost
        self.friends: list[bytes] = []  # the last datagrams from the friend to us
        self.ours: list[bytes] = []  # the last datagrams of ours
        self.injected = 0  # octets that were injected, and octets of ours to strangers
        self.answered = 0
        self.heard: set[str] = set()  # addresses that ours has heard from, and that have answered
        self.proven: set[str] = set()
        self.starts = 0
        self.members = {address: self._join(address) for address in (OURS, FRIEND, WITNESS)}
        self.writers = {
            address: [self._writer(address, topic) for topic in range(len(PROFILES))]
            for address in self.members
        }
        for _ in range(20):
            self.carry()
            self.now += 0.05

    def _join(self, address: str, start: int = 0) -> Participant:
        prefix = ids.VENDOR + bytes(8) + bytes([start]) + address[-1:].encode()
        place = Locator(UDPV4, 7410, address)
        member = Participant(prefix, 0, [place], [GROUP], [], b"enclave=/;", self.now)
        samples = self.samples[address] = []

        def deliver(sample: Sample) -> bool:
            samples.append(sample.payload)
            del samples[:-50]
            return True

        def serve(sample: Sample) -> bool:
            for role in (CLIENT_ID, SERVICE_ID):
                parser = _Parser(_Domain(member), role)  # type: ignore[arg-type]
                parsed = parser.parse(sample)
                if parsed is not None and address == OURS:
                    identity, number, payload = parsed
                    related = parameters.write_related_identity(identity, number)
                    writer = self.writers[OURS][SERVICE]
                    writer.write(payload, 0, self.now, related, frozenset([identity]))
            return True

        for topic, qos in enumerate(PROFILES):
            accept = serve if topic == SERVICE else deliver
            member.create_reader(f"rt/{topic}", TYPE, qos, accept, self.now, 0)
        return member

    def restart_friend(self, is_same: bool) -> None:
        if not is_same:
            self.starts = (self.starts + 1) % 256
        self.members[FRIEND] = self._join(FRIEND, self.starts)
        self.writers[FRIEND] = [self._writer(FRIEND, topic) for topic in range(len(PROFILES))]

    def renew(self, topic: int) -> None:
        """Delete and create our writer and reader of a topic."""
        ours = self.members[OURS]
        ours.delete(self.writers[OURS][topic], self.now, 0)
        self.writers[OURS][topic] = self._writer(OURS, topic)

    def inject(self, datagram: bytes, address: str) -> None:
        """Give a datagram to our participant."""
        ours = self.members[OURS]
        self.injected += len(datagram)
        ours.receive(memoryview(datagram), address, self.now)

    def _writer(self, address: str, topic: int):  # type: ignore[no-untyped-def]
        member = self.members[address]
        return member.create_writer(f"rt/{topic}", TYPE, PROFILES[topic], self.now, 0)

    def carry(self) -> None:
        for _ in range(60):
            sent: list[tuple[str, bytes, Locator]] = []
            for remote in self.members[OURS].remotes.values():
                self.heard.update(remote.heard)
                self.proven.update(remote.heard if remote.is_proven else ())
            for address, member in self.members.items():
                member.poll(self.now)
                sent += [(address, *item) for item in member.take_datagrams()]
            if not sent:
                deadline = self.members[OURS].next_deadline()
                must(deadline is not None, "a participant that is never polled again")
                must(self.now < deadline <= self.now + 10, f"a deadline in {deadline - self.now} s")
                return
            for source, datagram, place in sent:
                if source == OURS:
                    self._check(datagram, place)
                for address, member in self.members.items():
                    if place in (GROUP, Locator(UDPV4, 7410, address)):
                        if source == FRIEND and address == OURS and self._is_lost(datagram):
                            continue
                        member.receive(memoryview(datagram), source, self.now)
        must(False, "participants that come to no rest")

    def _is_lost(self, datagram: bytes) -> bool:
        """Note a datagram of the friend to us; whether it gets lost."""
        self.friends = [*self.friends[-15:], datagram]
        is_lost = 0 in self.lost
        self.lost = {number - 1 for number in self.lost if number}
        return is_lost

    def _check(self, datagram: bytes, place: Locator) -> None:
        must(len(datagram) <= MESSAGE_SIZE, "a datagram beyond the message size")
        list(submessages.read(memoryview(datagram)))
        must(place == GROUP or place.address in self.heard, f"a datagram to {place}")
        self.sent += len(datagram)
        must(self.sent < _MAX_SENT, "a flood of our own")
        self.ours = [*self.ours[-15:], datagram]
        if place.address in STRANGERS:
            self.answered += 0 if place.address in self.proven else len(datagram)
            must(self.answered <= self.injected, "more octets to strangers than from them")

    def check(self) -> None:
        ours = self.members[OURS]
        held = 0
        for reader in ours.readers.values():
            for proxy in reader.state.writers.values():
                must(len(proxy.incomplete) <= MAX_INCOMPLETE, "incomplete samples")
                must(len(proxy.held) <= MAX_AHEAD, "held samples")
                must(proxy.expected is None or proxy.expected > 0, "a number that cannot be")
                held += proxy.held_octets
                held += sum(sample._held for sample in proxy.incomplete.values())
        must(held == ours._budget.used <= MAX_HELD, "the account of what is held")
        known = 0
        for remote in ours.remotes.values():
            known += cost(remote.data) + sum(map(cost, remote.endpoints.values()))
        must(known == ours._known.used <= MAX_KNOWN, "the account of what is known")
        for writer in ours.writers.values():
            state = writer.state
            octets = sum(change.octets for change in state._history.values())
            must(octets == state._octets, "the account of a history")
            for proxy in state.readers.values():
                must(proxy.acked <= state.last, "more is acknowledged than was written")
                must(len(proxy.requested) <= 5000, "requests")
        must(not ours._outbox._pending, "packets that are left")


class _Domain:
    """What a parser of requests and replies uses of a domain."""

    def __init__(self, participant: Participant) -> None:
        self.participant = participant


def _edited(datagrams: list[bytes], body: bytes) -> bytes:
    """One of the datagrams with changes: two octets of place and one of value each."""
    if not datagrams or not body:
        return b""
    out = bytearray(datagrams[body[0] % len(datagrams)])
    for at in range(1, len(body) - 2, 3):
        out[(body[at] | body[at + 1] << 8) % len(out)] = body[at + 2]
    return bytes(out)


def _named(datagram: bytes, prefix: bytes) -> bytes:
    """A datagram in the name of another participant."""
    return datagram[:8] + prefix + datagram[20:]


def one_input(data: bytes) -> None:
    network = Network()
    count = 0
    for op, body in records.unpack(data):
        kind, address = op & 15, ADDRESSES[op >> 4 & 3]
        if kind == 7:
            count += 1
            number, form = (body[0], body[1]) if len(body) > 1 else (1, 0)
            _discover(network, count, number, form, address)
        else:
            _play(network, kind, address, body)
        network.carry()
        network.check()
    _finish(network)


def _play(network: Network, kind: int, address: str, body: bytes) -> None:
    friend = network.members[FRIEND].guid[: ids.PREFIX_SIZE]
    if kind == 0:
        network.inject(body, address)
    elif kind in (1, 2):
        network.inject(submessages.header(STRANGER if kind == 1 else friend) + body, address)
    elif kind == 3:
        network.now += (int.from_bytes(body[:2], "little") % 30_000) / 1000
    elif kind in (4, 5):
        writers = network.writers[FRIEND if kind == 4 else OURS]
        writer = writers[ADDRESSES.index(address) % len(writers)]
        writer.write(b"\0\1\0\0" + body, 0, network.now)
    elif kind == 6:
        place = Locator(UDPV4, 7410, address)
        stranger = ParticipantData(
            STRANGER + ids.ENTITY_PARTICIPANT, domain=0, builtin=0xC3F,
            metatraffic_unicast=[place], default_unicast=[place],
        )  # fmt: skip
        payload = parameters.write_participant(stranger)
        announced = submessages.encode_data(ids.SPDP_READER, ids.SPDP_WRITER, 1, payload)
        network.inject(submessages.header(STRANGER) + announced, address)
    elif kind == 8:
        network.inject(_edited(network.friends, body), address)
    elif kind == 9:
        network.inject(_named(_edited(network.ours, body), friend), address)
    elif kind == 10:
        network.lost = set(body[2:])
        size = int.from_bytes(body[:2], "little")
        network.writers[FRIEND][0].write(b"\0\1\0\0" + bytes(size), 0, network.now)
    elif kind == 11:
        ours = network.members[OURS].guid[: ids.PREFIX_SIZE]
        acknack = submessages.encode_acknack(
            ids.PUBLICATIONS_READER, ids.PUBLICATIONS_WRITER, 1, (), body[0] if body else 1
        )
        network.inject(
            submessages.header(STRANGER) + submessages.encode_info_dst(ours) + acknack, address
        )
    elif kind == 12:
        network.renew(len(body) % len(PROFILES))
    elif kind == 13:
        network.restart_friend(bool(len(body) & 1))
    elif kind == 14:
        writer = network.writers[FRIEND][SERVICE]
        writer.write(b"\0\1\0\0" + body, 0, network.now, body)
    else:
        network.now += 60 * (body[0] if body else 1)


def _discover(network: Network, count: int, number: int, form: int, address: str) -> None:
    is_writer = bool(form & 1)
    guid = STRANGER + bytes((0, 0, number, 3 if is_writer else 4))
    topic = form >> 1 & 3
    data = EndpointData(guid, is_writer, f"rt/{topic}", TYPE, PROFILES[topic])
    entity = ids.PUBLICATIONS_WRITER if is_writer else ids.SUBSCRIPTIONS_WRITER
    datagram = (
        submessages.header(STRANGER)
        + submessages.encode_heartbeat(bytes(4), entity, count, count, count)
        + submessages.encode_data(bytes(4), entity, count, parameters.write_endpoint(data))
    )
    network.inject(datagram, address)


def _finish(network: Network) -> None:
    """The witness and ours exchange samples, whatever became of the others."""
    payloads = [b"\0\1\0\0" + struct.pack("<I", 0xD0D0) + bytes(size) for size in (8, 5000)]
    network.sent = 0
    network.lost = set()
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
    must(network.members[OURS].next_deadline() is None, "a deadline after the end")


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
        (1, struct.pack("<BBH4s4s4I", 0x13, 1, 24, b"", b"\0\0\5\3", 0, 6, 2, 1)),  # HEARTBEAT_FRAG
        (5, b"hello"),
        (5, bytes(3000)),
        (1, submessages.encode_acknack(b"\0\0\6\4", writer, 1, [1, 2], 1)),
        (1, submessages.encode_nack_frag(b"\0\0\6\4", writer, 2, [1, 3], 1)),
        (3, b"\x64\0"),
        (4, b"from a friend"),
        (2, submessages.encode_acknack(reader, writer, 1, [], 5)),
        (2, submessages.encode_heartbeat(bytes(4), writer, 1, 9, 50)),
        (3, b"\xff\x50"),
        (10, b"\x00\x40\1\3\4\7"),
        (8, b"\1\x20\0\3"),
        (9, b"\2\x30\0\x07"),
        (11, b"\2"),
        (1, submessages.encode_acknack(b"\0\0\6\4", writer, 1, range(1, 250), 9)),
        (12, b""),
        (14, parameters.write_related_identity(STRANGER + reader, 7)),
        (13, b"\0"),
        (3, b"\x00\x08"),
        (13, b""),
        (15, b"\2"),
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
