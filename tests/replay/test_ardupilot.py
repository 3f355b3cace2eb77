"""ArduPilot with the agent of uros: a client written from public sources, and an agent process.

No ArduPilot runs here: support/ardupilot.py has its behaviour, support/autopilot.py the C library
under it, and test_c_library.py compares the latter with recorded bytes.
"""

import struct
import time

import pytest
from support import autopilot
from support.airfield import Place, Places
from support.ardupilot import ArduPilot, dds_type, profiles
from support.autopilot import RELIABLE, TRANSIENT_LOCAL

from uros.middleware.base import Service
from uros.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

SENSOR_DATA = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
transports = pytest.mark.parametrize("transport", ["udp", "serial"])
forms = pytest.mark.parametrize("by_reference", [True, False], ids=["4.5", "4.6"])


@pytest.fixture(scope="module")
def references(tmp_path_factory):
    file = tmp_path_factory.mktemp("ardupilot") / "dds_xrce_profile.xml"
    file.write_text(profiles())
    return file


@pytest.fixture(scope="module")
def places(shared_ground, references):
    with Places(shared_ground.domain, "-r", references) as running:
        yield running


@pytest.fixture
def own_place(transport, own_domain_id, references):
    """An agent for one test, in a domain of its own."""
    with Place(transport, own_domain_id, "-r", references) as running:
        yield running


def ros_type(name, kind):
    package, name = name.split("/")
    return [f"{package}/{kind}/{name}"]


def see(ground, vehicle):
    """Wait until the graph has the vehicle's node with exactly its topics and services."""
    wanted = (
        {f"/{row[0]}": ros_type(row[1], "msg") for row in vehicle.topics if row[2]},
        {f"/{row[0]}": ros_type(row[1], "msg") for row in vehicle.topics if not row[2]},
        {f"/{name}": ros_type(kind, "srv") for name, kind in vehicle.services},
    )

    def endpoints():
        node = ground.graph.node(vehicle.node)
        return node and (node.publishers, node.subscribers, node.service_servers)

    vehicle.until(lambda: endpoints() == wanted, lambda: (endpoints(), wanted))
    assert ground.graph.nodes().count(vehicle.node) == 1


@transports
@forms
def test_all_entities_belong_to_the_vehicles_node(place, ground, by_reference):
    vehicle = place.fly(ArduPilot, ground, by_reference=by_reference)
    see(ground, vehicle)
    for topic, _, publishes, (flags, depth), _ in vehicle.topics:
        find = ground.graph.publishers if publishes else ground.graph.subscriptions
        (info,) = find(f"/{topic}")
        reliable = flags & RELIABLE
        latched = flags & TRANSIENT_LOCAL
        assert (info.qos.reliability, info.qos.durability, info.qos.depth) == (
            ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
            depth,
        ), topic


def test_a_missing_references_file_is_reported_and_binary_works(own_domain_id, own_ground):
    with Place("udp", own_domain_id) as place:
        vehicle = ArduPilot(place.link(), by_reference=True)
        vehicle.find_agent()
        vehicle.open()
        assert vehicle.all_status(vehicle.create_participant()) != [autopilot.OK]
        line = place.agent.wait_for("participant refused")
        assert "participant_profile" in line and "--refs FILE" in line
        see(own_ground, place.fly(ArduPilot, own_ground))


# --- data ----------------------------------------------------------------------------------------


def sample(number, size=80):
    return struct.pack("<I", number) + bytes(size - 4)


def meet(ground, vehicle, topic, kind):
    """Subscribe and publish until a sample arrives; the list of samples."""
    ground.listen(f"rt/{topic}", dds_type(kind), SENSOR_DATA)
    samples = ground.samples[f"rt/{topic}"]
    for _ in range(100):
        vehicle.publish(topic, sample(0xFFFF))
        if autopilot.wait(lambda: samples, vehicle.session, ground, seconds=0.1):
            return samples
    raise AssertionError(f"{topic} does not come through")


@transports
def test_a_second_of_flight_loses_no_sample(place, ground):
    """All topics at the rates of the firmware, on a reliable stream eight messages deep.

    Every sent sample arrives. The firmware drops samples while the stream is full, so the number
    depends on the agent's acknowledgements.
    """
    vehicle = place.fly(ArduPilot, ground)
    periodic = [(row[0], row[4]) for row in vehicle.topics if row[4]]
    for topic, kind, publishes, _, _ in vehicle.topics:
        if publishes:
            meet(ground, vehicle, topic, kind)
    publishers = [row[0] for row in vehicle.topics if row[2]]
    for topic in publishers:  # after all samples that are in flight
        vehicle.until(lambda topic=topic: vehicle.publish(topic, sample(0xFFFE)))
    vehicle.until(
        lambda: all(ground.samples[f"rt/{topic}"][-1][:2] == b"\xfe\xff" for topic in publishers)
    )
    vehicle.settle()
    ground.samples.clear()
    session = vehicle.session
    sent = dict.fromkeys((row[0] for row in periodic), 0)
    dropped = 0
    start = time.monotonic()
    for turn in range(1000):  # the firmware's loop: one millisecond and its own time
        for topic, period in periodic:
            if turn % period == 0:
                if vehicle.publish(topic, sample(sent[topic])):
                    sent[topic] += 1
                else:
                    dropped += 1
        due = start + (turn + 1) / 1000
        autopilot.wait(lambda due=due: time.monotonic() >= due, session, ground, seconds=0.001)
    vehicle.until(
        lambda: all(len(ground.samples[f"rt/{topic}"]) == sent[topic] for topic in sent),
        lambda: {topic: (len(ground.samples[f"rt/{topic}"]), sent[topic]) for topic in sent},
    )
    for topic, count in sent.items():
        numbers = [struct.unpack_from("<I", octets)[0] for octets in ground.samples[f"rt/{topic}"]]
        assert numbers == list(range(count)), topic
    print(f"{sum(sent.values())} sent, {dropped} dropped by the vehicle")
    assert not place.complaints()


@transports
@forms
def test_large_commands_arrive_in_fragments(place, ground, by_reference):
    vehicle = place.fly(ArduPilot, ground, by_reference=by_reference)
    write = ground.writer("rt/ap/tf", dds_type("tf2_msgs/TFMessage"), QoSProfile(depth=10))
    reader = vehicle.reader("ap/tf")
    samples = vehicle.session.samples[reader]
    large = bytes(range(256)) * 6
    for _ in range(100):
        write(large)
        if autopilot.wait(lambda: samples, vehicle.session, ground, seconds=0.1):
            break
    assert samples[0] == large


@pytest.mark.parametrize("transport", ["udp"])
@forms
def test_services_answer(place, ground, by_reference):
    vehicle = place.fly(ArduPilot, ground, by_reference=by_reference)
    for number, (name, kind) in enumerate(vehicle.services):
        request_type, reply_type = (
            dds_type(kind, "srv", suffix) for suffix in ("_Request", "_Response")
        )
        call, replies = ground.caller(
            Service(f"rq/{name}Request", request_type, f"rr/{name}Reply", reply_type)
        )
        requests = vehicle.session.samples[vehicle.replier(name)]
        request_numbers = []  # before the endpoints have matched, requests are lost
        while not requests:
            request_numbers.append(call(bytes((number, len(request_numbers)))))
            autopilot.wait(lambda requests=requests: requests, vehicle.session, ground, seconds=0.2)
        request = requests.popleft()
        # DDS pads to a multiple of four; deserializers ignore the padding.
        assert request[24] == number and len(request) <= 28, name
        reply = bytes((number, 1, 0, 0))
        assert vehicle.session.write_reliable(vehicle.replier(name), request[:24] + reply)
        vehicle.until(lambda replies=replies: replies, f"{name} does not answer")
        assert replies[0] == (request_numbers[request[25]], reply), name


# --- reconnecting -------------------------------------------------------------------------------


@transports
@forms
def test_the_vehicle_reconnects_to_a_restarted_agent(own_place, own_ground, by_reference):
    """Without DELETE: the vehicle pings, and creates its client and all entities again."""
    place, ground = own_place, own_ground
    vehicle = place.fly(ArduPilot, ground, by_reference=by_reference)
    assert vehicle.in_session()
    place.agent.kill()
    assert vehicle.lost()
    place.start()
    assert vehicle.lost()
    vehicle.session.link = place.link()
    vehicle.connect()
    assert vehicle.in_session()
    meet(ground, vehicle, "ap/time", "builtin_interfaces/Time")


@transports
def test_a_new_session_at_the_same_agent_duplicates_nothing(place, ground):
    """CREATE_CLIENT with the same key, session id and address, as after lost pings.

    The graph has each entity once, and each sample arrives once.
    """
    vehicle = place.fly(ArduPilot, ground)
    see(ground, vehicle)
    meet(ground, vehicle, "ap/time", "builtin_interfaces/Time")
    vehicle.open()
    vehicle.create()
    see(ground, vehicle)
    write = ground.writer("rt/ap/joy", dds_type("sensor_msgs/Joy"), QoSProfile(depth=10))
    samples = vehicle.session.samples[vehicle.reader("ap/joy")]
    number = 0
    while not samples:
        write(sample(number))
        number += 1
        autopilot.wait(lambda: samples, vehicle.session, ground, seconds=0.1)
    write(sample(number))
    vehicle.until(lambda: struct.unpack_from("<I", samples[-1])[0] == number)
    numbers = [struct.unpack_from("<I", octets)[0] for octets in samples]
    assert numbers == list(range(numbers[0], number + 1))
