"""PX4 and ArduPilot on links with loss, duplicates and delay, at an agent that allows one key.

The vehicles share no code with uros (see support/autopilot.py), so the tests detect an error that
both ends of uros would make alike. The four octets of the key differ.
"""

import struct

import pytest
from support import autopilot
from support.airfield import Place
from support.ardupilot import ArduPilot, dds_type
from support.autopilot import RELIABLE, TRANSIENT_LOCAL
from support.px4 import PUBLICATIONS, SUBSCRIPTIONS, Px4, counter, type_name
from support.px4 import sample as px4_sample
from support.rough_link import RoughLink

from uros.middleware.base import Service
from uros.qos import QoSProfile, ReliabilityPolicy

KEY, OTHER = 0x12345678, 0x78563412
ALL = QoSProfile(depth=1000)
BEST_EFFORT = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
seeds = pytest.mark.parametrize("seed", [1, 2, 3])


@pytest.fixture(scope="module")
def field(shared_ground):
    with Place("udp", shared_ground.domain, "--allow-key", f"0x{KEY:08X}") as running:
        yield running


def fly(field, ground, kind, seed, **options):
    """A vehicle with the allowed key; the test makes its link lossy after it has connected."""
    link = RoughLink(field.link(), seed)
    link.calm = True
    vehicle = kind(link, **options)
    vehicle.session.key = KEY
    vehicle.others = (ground,)
    vehicle.connect()
    return vehicle, link


def land(vehicle, link, ground):
    link.calm = True
    vehicle.land()
    link.close()
    ground.wait_for_empty_graph()


def sample(number, size=80):
    return struct.pack("<I", number) + bytes((number * 7 + i) & 0xFF for i in range(size - 4))


def numbers(samples):
    return [struct.unpack_from("<I", octets)[0] for octets in samples]


def reliable_topic(vehicle):
    return next(
        row[:2]
        for row in vehicle.topics
        if row[2] and row[3][0] & RELIABLE and not row[3][0] & TRANSIENT_LOCAL
    )


@seeds
def test_reliable_samples_arrive_once_and_in_order(field, ground, seed):
    vehicle, link = fly(field, ground, ArduPilot, seed)
    topic, kind = reliable_topic(vehicle)
    ground.listen(f"rt/{topic}", dds_type(kind), ALL)
    samples = ground.samples[f"rt/{topic}"]
    for _ in range(100):
        vehicle.publish(topic, sample(0))
        if autopilot.wait(lambda: samples, vehicle.session, ground, seconds=0.1):
            break
    vehicle.settle()
    link.calm = False
    for number in range(1, 201):
        # Some samples are sent in fragments.
        size = 1200 if number % 10 == 9 else 80
        vehicle.until(lambda n=number, s=size: vehicle.publish(topic, sample(n, s)))
    vehicle.until(lambda: 200 in numbers(samples), lambda: numbers(samples))
    vehicle.settle()
    # Number 0 is from before: one of them may have been late.
    assert [octets for octets in samples if numbers([octets]) != [0]] == [
        sample(number, 1200 if number % 10 == 9 else 80) for number in range(1, 201)
    ]
    assert all(count >= 3 for count in link.counts.values()), link.counts
    land(vehicle, link, ground)


@seeds
def test_reliable_commands_arrive_whole_and_in_order(field, ground, seed):
    vehicle, link = fly(field, ground, ArduPilot, seed)
    write = ground.writer("rt/ap/tf", dds_type("tf2_msgs/TFMessage"), QoSProfile(depth=10))
    samples = vehicle.session.samples[vehicle.reader("ap/tf")]
    while not samples:  # until the endpoints have matched
        write(sample(0))
        autopilot.wait(lambda: samples, vehicle.session, ground, seconds=0.2)
    link.calm = False
    for number in range(1, 60):
        write(sample(number, 1200 if number % 3 else 80))
        vehicle.until(lambda n=number: n in numbers(samples), "a sample is missing")
    assert [number for number in numbers(samples) if number] == list(range(1, 60))
    for octets in samples:
        (number,) = numbers([octets])
        assert octets == sample(number, 1200 if number % 3 else 80)
    assert link.counts["lost"] >= 20, link.counts
    land(vehicle, link, ground)


@seeds
def test_each_service_call_gets_its_own_reply(field, ground, seed):
    vehicle, link = fly(field, ground, ArduPilot, seed)
    name, kind = vehicle.services[0]
    request_type, reply_type = (
        dds_type(kind, "srv", suffix) for suffix in ("_Request", "_Response")
    )
    call, replies = ground.caller(
        Service(f"rq/{name}Request", request_type, f"rr/{name}Reply", reply_type)
    )
    replier = vehicle.replier(name)
    requests = vehicle.session.samples[replier]
    while not requests:  # until the endpoints have matched
        call(bytes(4))
        autopilot.wait(lambda: requests, vehicle.session, ground, seconds=0.2)
    requests.clear()
    link.calm = False
    for number in range(1, 21):
        request_number = call(bytes((number, 0, 0, 0)))
        vehicle.until(
            lambda n=number: any(octets[24] == n for octets in requests), "no request comes"
        )
        (request,) = [octets for octets in requests if octets[24] == number]
        requests.clear()
        reply = bytes((number, 1, 2, 3))
        answer = request[:24] + reply
        vehicle.until(lambda octets=answer: vehicle.session.write_reliable(replier, octets))
        vehicle.until(lambda a=request_number, r=reply: (a, r) in replies, "no answer comes")
    assert [reply[1][0] for reply in replies if reply[1][1] == 1] == list(range(1, 21))
    land(vehicle, link, ground)


@seeds
def test_best_effort_samples_are_never_old_or_duplicated(field, ground, seed):
    vehicle, link = fly(field, ground, Px4, seed)
    name, into = PUBLICATIONS[0], SUBSCRIPTIONS[0]
    topic = vehicle.topic(name, "out")
    ground.listen(topic, type_name(name), BEST_EFFORT)
    write = ground.writer(vehicle.topic(into, "in"), type_name(into), QoSProfile(depth=10))
    out, received = ground.samples[topic], []
    vehicle.session.on_data = lambda thing, payload: received.append(counter(payload))
    for number in range(100):  # until the endpoints have matched
        vehicle.publish(name, px4_sample(number))
        write(px4_sample(number))
        if autopilot.wait(lambda: out and received, vehicle.session, ground, seconds=0.1):
            break
    link.calm = False
    for number in range(100, 400):
        vehicle.publish(name, px4_sample(number))
        write(px4_sample(number))
        autopilot.wait(lambda: False, vehicle.session, ground, seconds=0.001)
    link.calm = True
    vehicle.until(lambda: 399 in received or write(px4_sample(399)))
    vehicle.until(lambda: counter(out[-1]) == 399 or vehicle.publish(name, px4_sample(399)))
    published = [counter(octets) for octets in out]
    assert sorted(set(published[:-1])) == published[:-1] and len(published) > 150
    assert sorted(set(received[:-1])) == received[:-1] and len(received) > 150
    assert all(count >= 10 for count in link.counts.values()), link.counts
    land(vehicle, link, ground)


def test_a_key_that_is_not_allowed_is_refused(field, ground):
    """The key with its octets reversed is refused, and the log names it."""
    vehicle = Px4(field.link(), key=OTHER)
    vehicle.find_agent()
    vehicle.session.create_client()
    vehicle.until(lambda: vehicle.session.agent_status is not None)
    assert vehicle.session.agent_status != autopilot.OK
    assert field.agent.wait_for(f"0x{OTHER:08X}")
    vehicle.session.link.close()
