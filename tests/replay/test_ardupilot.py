"""ArduPilot on our agent: its client, written from public sources, against the agent as users
start it.

No ArduPilot runs here: see support/ardupilot.py for what it does, support/autopilot.py for the C
library under it, and test_c_library.py for the recorded bytes that library is held against.
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
    """An agent of this test's own, in a domain of its own."""
    with Place(transport, own_domain_id, "-r", references) as running:
        yield running


def ros_type(name, kind):
    package, name = name.split("/")
    return [f"{package}/{kind}/{name}"]


def see(ground, vehicle):
    """Until the graph shows the vehicle's node with its topics and services, and nothing else."""
    wanted = (
        {f"/{it[0]}": ros_type(it[1], "msg") for it in vehicle.topics if it[2]},
        {f"/{it[0]}": ros_type(it[1], "msg") for it in vehicle.topics if not it[2]},
        {f"/{name}": ros_type(kind, "srv") for name, kind in vehicle.services},
    )

    def seen():
        node = ground.graph.node(vehicle.node)
        return node and (node.publishers, node.subscribers, node.service_servers)

    vehicle.until(lambda: seen() == wanted, lambda: (seen(), wanted))
    assert ground.graph.nodes().count(vehicle.node) == 1


@transports
@forms
def test_everything_is_there_under_the_vehicles_node(place, ground, by_reference):
    vehicle = place.fly(ArduPilot, ground, by_reference=by_reference)
    see(ground, vehicle)
    for topic, _, publishes, (flags, depth), _ in vehicle.topics:
        find = ground.graph.publishers if publishes else ground.graph.subscriptions
        (info,) = find(f"/{topic}")
        reliable = flags & RELIABLE
        kept = flags & TRANSIENT_LOCAL
        assert (info.qos.reliability, info.qos.durability, info.qos.depth) == (
            ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            DurabilityPolicy.TRANSIENT_LOCAL if kept else DurabilityPolicy.VOLATILE,
            depth,
        ), topic


def test_without_the_references_file_the_log_says_what_to_do_and_binary_works(
    own_domain_id, own_ground
):
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
    """Listen; until it comes through."""
    ground.listen(f"rt/{topic}", dds_type(kind), SENSOR_DATA)
    came = ground.samples[f"rt/{topic}"]
    for _ in range(100):
        vehicle.publish(topic, sample(0xFFFF))
        if autopilot.wait(lambda: came, vehicle.session, ground, seconds=0.1):
            return came
    raise AssertionError(f"{topic} does not come through")


@transports
def test_a_second_of_flight_comes_through_whole(place, ground):
    """All topics at the rates of the firmware, on a reliable stream eight messages deep: the
    firmware drops what finds no room there, so it is the agent's acknowledgements that decide."""
    vehicle = place.fly(ArduPilot, ground)
    periodic = [(it[0], it[4]) for it in vehicle.topics if it[4]]
    for topic, kind, publishes, _, _ in vehicle.topics:
        if publishes:
            meet(ground, vehicle, topic, kind)
    publishers = [it[0] for it in vehicle.topics if it[2]]
    for topic in publishers:  # behind all that is under way
        vehicle.until(lambda topic=topic: vehicle.publish(topic, sample(0xFFFE)))
    vehicle.until(
        lambda: all(ground.samples[f"rt/{it}"][-1][:2] == b"\xfe\xff" for it in publishers)
    )
    vehicle.settle()
    ground.samples.clear()
    session = vehicle.session
    sent = dict.fromkeys((it[0] for it in periodic), 0)
    dropped = 0
    start = time.monotonic()
    for turn in range(1000):  # the firmware's loop: one millisecond and what it takes
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
        numbers = [struct.unpack_from("<I", it)[0] for it in ground.samples[f"rt/{topic}"]]
        assert numbers == list(range(count)), topic
    print(f"{sum(sent.values())} sent, {dropped} dropped by the vehicle")
    assert not place.complaints()


@transports
@forms
def test_commands_arrive_in_fragments_where_they_are_large(place, ground, by_reference):
    vehicle = place.fly(ArduPilot, ground, by_reference=by_reference)
    write = ground.writer("rt/ap/tf", dds_type("tf2_msgs/TFMessage"), QoSProfile(depth=10))
    reader = vehicle.reader("ap/tf")
    came = vehicle.session.samples[reader]
    large = bytes(range(256)) * 6
    for _ in range(100):
        write(large)
        if autopilot.wait(lambda: came, vehicle.session, ground, seconds=0.1):
            break
    assert came[0] == large


@pytest.mark.parametrize("transport", ["udp"])
@forms
def test_services_answer(place, ground, by_reference):
    vehicle = place.fly(ArduPilot, ground, by_reference=by_reference)
    for number, (name, kind) in enumerate(vehicle.services):
        request_type, reply_type = (dds_type(kind, "srv", it) for it in ("_Request", "_Response"))
        call, replies = ground.caller(
            Service(f"rq/{name}Request", request_type, f"rr/{name}Reply", reply_type)
        )
        requests = vehicle.session.samples[vehicle.replier(name)]
        asked = []  # until discovery is through, requests meet nobody
        while not requests:
            asked.append(call(bytes((number, len(asked)))))
            autopilot.wait(lambda it=requests: it, vehicle.session, ground, seconds=0.2)
        request = requests.popleft()
        # DDS fills up to a multiple of four; deserializers do not look there.
        assert request[24] == number and len(request) <= 28, name
        reply = bytes((number, 1, 0, 0))
        assert vehicle.session.write_reliable(vehicle.replier(name), request[:24] + reply)
        vehicle.until(lambda it=replies: it, f"{name} does not answer")
        assert replies[0] == (asked[request[25]], reply), name


# --- coming and going ---------------------------------------------------------------------------


@transports
@forms
def test_the_vehicle_reconnects_to_an_agent_that_was_restarted(own_place, own_ground, by_reference):
    """It says no farewell: a ping, CREATE_CLIENT and all entities again."""
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
def test_a_session_begun_anew_at_the_same_agent_leaves_nothing_double(place, ground):
    """What happens when pings got lost on the way: same key, same session id, same address."""
    vehicle = place.fly(ArduPilot, ground)
    see(ground, vehicle)
    meet(ground, vehicle, "ap/time", "builtin_interfaces/Time")
    vehicle.open()
    vehicle.create()
    see(ground, vehicle)
    write = ground.writer("rt/ap/joy", dds_type("sensor_msgs/Joy"), QoSProfile(depth=10))
    came = vehicle.session.samples[vehicle.reader("ap/joy")]
    number = 0
    while not came:
        write(sample(number))
        number += 1
        autopilot.wait(lambda: came, vehicle.session, ground, seconds=0.1)
    write(sample(number))
    vehicle.until(lambda: struct.unpack_from("<I", came[-1])[0] == number)
    numbers = [struct.unpack_from("<I", it)[0] for it in came]
    assert numbers == list(range(numbers[0], number + 1))
