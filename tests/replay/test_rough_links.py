"""PX4 and ArduPilot on links that lose, double and delay, under an agent that lets in one key.

The vehicles share no code with uros (see support/autopilot.py): what both ends of ours would
misunderstand in the same way, they do not. The key has four octets that differ.
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
    """A vehicle with that key, whose link gets rough when it has connected."""
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
    ground.see_them_gone()


def sample(number, size=80):
    return struct.pack("<I", number) + bytes((number * 7 + it) & 0xFF for it in range(size - 4))


def numbers(samples):
    return [struct.unpack_from("<I", it)[0] for it in samples]


def reliable_topic(vehicle):
    return next(
        it[:2]
        for it in vehicle.topics
        if it[2] and it[3][0] & RELIABLE and not it[3][0] & TRANSIENT_LOCAL
    )


@seeds
def test_what_is_published_reliably_arrives_once_and_in_order(field, ground, seed):
    vehicle, link = fly(field, ground, ArduPilot, seed)
    topic, kind = reliable_topic(vehicle)
    ground.listen(f"rt/{topic}", dds_type(kind), ALL)
    came = ground.samples[f"rt/{topic}"]
    for _ in range(100):
        vehicle.publish(topic, sample(0))
        if autopilot.wait(lambda: came, vehicle.session, ground, seconds=0.1):
            break
    vehicle.settle()
    vehicle.until(lambda: len(came) > 0)
    came.clear()
    link.calm = False
    for number in range(200):
        # Of several messages each time, some in fragments.
        size = 1200 if number % 10 == 9 else 80
        vehicle.until(lambda n=number, s=size: vehicle.publish(topic, sample(n, s)))
    vehicle.until(lambda: len(came) >= 200, lambda: numbers(came))
    vehicle.settle()
    assert came == [sample(it, 1200 if it % 10 == 9 else 80) for it in range(200)]
    assert all(it >= 3 for it in link.counts.values()), link.counts
    land(vehicle, link, ground)


@seeds
def test_what_is_sent_to_it_reliably_comes_whole_and_in_order(field, ground, seed):
    vehicle, link = fly(field, ground, ArduPilot, seed)
    write = ground.writer("rt/ap/tf", dds_type("tf2_msgs/TFMessage"), QoSProfile(depth=10))
    came = vehicle.session.samples[vehicle.reader("ap/tf")]
    while not came:  # until discovery is through
        write(sample(0))
        autopilot.wait(lambda: came, vehicle.session, ground, seconds=0.2)
    link.calm = False
    for number in range(1, 60):
        write(sample(number, 1200 if number % 3 else 80))
        vehicle.until(lambda n=number: n in numbers(came), "a sample is missing")
    assert [it for it in numbers(came) if it] == list(range(1, 60))
    for it in came:
        (number,) = numbers([it])
        assert it == sample(number, 1200 if number % 3 else 80)
    assert link.counts["lost"] >= 20, link.counts
    land(vehicle, link, ground)


@seeds
def test_each_call_of_its_services_has_its_own_answer(field, ground, seed):
    vehicle, link = fly(field, ground, ArduPilot, seed)
    name, kind = vehicle.services[0]
    request_type, reply_type = (dds_type(kind, "srv", it) for it in ("_Request", "_Response"))
    call, replies = ground.caller(
        Service(f"rq/{name}Request", request_type, f"rr/{name}Reply", reply_type)
    )
    replier = vehicle.replier(name)
    requests = vehicle.session.samples[replier]
    while not requests:  # until discovery is through
        call(bytes(4))
        autopilot.wait(lambda: requests, vehicle.session, ground, seconds=0.2)
    requests.clear()
    link.calm = False
    for number in range(1, 21):
        asked = call(bytes((number, 0, 0, 0)))
        vehicle.until(lambda n=number: any(it[24] == n for it in requests), "no request comes")
        (request,) = [it for it in requests if it[24] == number]
        requests.clear()
        reply = bytes((number, 1, 2, 3))
        answer = request[:24] + reply
        vehicle.until(lambda it=answer: vehicle.session.write_reliable(replier, it))
        vehicle.until(lambda a=asked, r=reply: (a, r) in replies, "no answer comes")
    assert [it[1][0] for it in replies if it[1][1] == 1] == list(range(1, 21))
    land(vehicle, link, ground)


@seeds
def test_best_effort_is_never_old_or_double_either_way(field, ground, seed):
    vehicle, link = fly(field, ground, Px4, seed)
    name, into = PUBLICATIONS[0], SUBSCRIPTIONS[0]
    topic = vehicle.topic(name, "out")
    ground.listen(topic, type_name(name), BEST_EFFORT)
    write = ground.writer(vehicle.topic(into, "in"), type_name(into), QoSProfile(depth=10))
    out, came = ground.samples[topic], []
    vehicle.session.on_data = lambda thing, payload: came.append(counter(payload))
    for number in range(100):  # until discovery is through
        vehicle.publish(name, px4_sample(number))
        write(px4_sample(number))
        if autopilot.wait(lambda: out and came, vehicle.session, ground, seconds=0.1):
            break
    link.calm = False
    for number in range(100, 400):
        vehicle.publish(name, px4_sample(number))
        write(px4_sample(number))
        autopilot.wait(lambda: False, vehicle.session, ground, seconds=0.001)
    link.calm = True
    vehicle.until(lambda: 399 in came or write(px4_sample(399)))
    vehicle.until(lambda: counter(out[-1]) == 399 or vehicle.publish(name, px4_sample(399)))
    got = [counter(it) for it in out]
    assert sorted(set(got[:-1])) == got[:-1] and len(got) > 150
    assert sorted(set(came[:-1])) == came[:-1] and len(came) > 150
    assert all(it >= 10 for it in link.counts.values()), link.counts
    land(vehicle, link, ground)


def test_another_key_is_not_let_in(field, ground):
    """With the same octets the other way round."""
    vehicle = Px4(field.link(), key=OTHER)
    vehicle.find_agent()
    vehicle.session.greet()
    vehicle.until(lambda: vehicle.session.agent_status is not None)
    assert vehicle.session.agent_status != autopilot.OK
    assert field.agent.wait_for(f"0x{OTHER:08X}")
    vehicle.session.link.close()
