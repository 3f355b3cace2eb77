"""PX4 with the agent of uros: a client written from public sources, and an agent process.

No PX4 runs here. support/px4.py follows PX4's sources, and builds its bytes without code of uros;
test_c_library.py compares them with bytes of the real library. The ROS node is a participant of
its own in this process.
"""

import time
from collections import Counter

import pytest
from support import autopilot, px4
from support.airfield import Place, Places
from support.px4 import PUBLICATIONS, SUBSCRIPTIONS, Px4, counter, sample, type_name

from uros.middleware.base import Service
from uros.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from uros.wire import ids

NODE = "/px4_micro_xrce_dds"
SENSOR_DATA = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
RELIABLE = QoSProfile(depth=10)
transports = pytest.mark.parametrize("transport", ["udp", "serial"])


@pytest.fixture(scope="module")
def places(shared_ground):
    with Places(shared_ground.domain) as running:
        yield running


@pytest.fixture
def own_place(transport, own_domain_id):
    """An agent for one test, in a domain of its own."""
    with Place(transport, own_domain_id) as running:
        yield running


@pytest.fixture
def udp(places, ground):
    yield places["udp"]
    places["udp"].land()
    ground.wait_for_empty_graph()


# --- the ROS graph -------------------------------------------------------------------------


def expected(vehicle, topics, direction):
    """``{ROS topic: [ROS type]}``"""
    return {
        vehicle.topic(name, direction)[2:]: [type_name(name).replace("::dds_::", "/")[:-1]
                                             .replace("::", "/")]
        for name in topics
    }  # fmt: skip


def see(ground, vehicle, name, publishers, subscribers, services):
    """Wait until the graph has the vehicle's node with exactly these endpoints."""

    def endpoints():
        node = ground.graph.node(name)
        return node and (node.publishers, node.subscribers, node.service_servers)

    wanted = (publishers, subscribers, services)
    vehicle.others = (ground,)
    vehicle.until(lambda: endpoints() == wanted, lambda: (endpoints(), wanted))
    assert ground.graph.nodes().count(name) == 1


@transports
@pytest.mark.parametrize("release", ["1.14", "1.15", "1.16"])
def test_all_topics_belong_to_the_vehicles_node(place, ground, release):
    vehicle = place.fly(Px4, ground, release=release)
    for number, name in enumerate(PUBLICATIONS):
        vehicle.publish(name, sample(number))
    assert len(PUBLICATIONS) >= 50
    service = {"/fmu/vehicle_command": ["px4_msgs/srv/VehicleCommand"]}
    see(
        ground,
        vehicle,
        NODE,
        expected(vehicle, PUBLICATIONS, "out"),
        expected(vehicle, SUBSCRIPTIONS, "in"),
        service if release >= "1.15" else {},
    )
    for name in PUBLICATIONS:
        (info,) = ground.graph.publishers(vehicle.topic(name, "out")[2:])
        assert (info.qos.reliability, info.qos.durability) == (
            ReliabilityPolicy.BEST_EFFORT,
            DurabilityPolicy.TRANSIENT_LOCAL,
        )
        assert (info.qos.depth, info.node_name) == (1, NODE[1:])
    for name in SUBSCRIPTIONS:
        (info,) = ground.graph.subscriptions(vehicle.topic(name, "in")[2:])
        assert (info.qos.reliability, info.qos.durability, info.qos.depth) == (
            ReliabilityPolicy.BEST_EFFORT,
            DurabilityPolicy.VOLATILE,
            2 * px4.QUEUE,
        )
    if release >= "1.16":
        assert ground.graph.publishers("/fmu/out/vehicle_status_v1")
        assert not ground.graph.publishers("/fmu/out/vehicle_status")


def test_vehicles_with_namespaces_are_nodes_of_their_own(udp, ground):
    vehicles = [
        udp.fly(Px4, ground, key=2 + index, namespace=f"px4_{1 + index}") for index in range(2)
    ]
    for number, vehicle in enumerate(vehicles, 1):
        see(
            ground,
            vehicle,
            f"/px4_{number}/px4_micro_xrce_dds",
            expected(vehicle, PUBLICATIONS, "out"),
            expected(vehicle, SUBSCRIPTIONS, "in"),
            {f"/px4_{number}/fmu/vehicle_command": ["px4_msgs/srv/VehicleCommand"]},
        )
    assert f"/px4_{number}/fmu/out/vehicle_odometry" in ground.graph.topics()


def test_the_agent_uses_the_domain_of_the_vehicle(own_domain_id, own_ground):
    """Without ``--domain``, as PX4's users start the agent."""
    ground = own_ground
    with Place("udp", None) as place:
        vehicle = place.fly(Px4, ground, domain=own_domain_id)
        see(
            ground,
            vehicle,
            NODE,
            expected(vehicle, PUBLICATIONS, "out"),
            expected(vehicle, SUBSCRIPTIONS, "in"),
            {"/fmu/vehicle_command": ["px4_msgs/srv/VehicleCommand"]},
        )


def test_the_vehicle_synchronizes_with_the_agents_time(udp):
    vehicle = udp.fly(Px4)
    difference = time.monotonic() + vehicle.offset - time.time()
    assert abs(difference) < vehicle.offset_error + 0.01


# --- data -------------------------------------------------------------------------------------


def listen_to_all(ground, vehicle):
    for name in PUBLICATIONS:
        ground.listen(vehicle.topic(name, "out"), type_name(name), SENSOR_DATA)


def talk_to_all(ground, vehicle):
    """``write(name, sample)``"""
    writers = {
        name: ground.writer(vehicle.topic(name, "in"), type_name(name), RELIABLE)
        for name in SUBSCRIPTIONS
    }
    return lambda name, octets: writers[name](octets)


def meet(ground, vehicle, write):
    """Exchange a sample on every topic in each direction, then clear the received samples."""
    session = vehicle.session
    received = Counter()
    session.on_data = lambda thing, payload: received.update([thing])
    topics = [vehicle.topic(name, "out") for name in PUBLICATIONS]
    for turn in range(100):
        for name in PUBLICATIONS:
            if not ground.samples[vehicle.topic(name, "out")]:
                vehicle.publish(name, sample(turn))
        for name in SUBSCRIPTIONS:
            if not received[vehicle.readers[name]]:
                write(name, sample(turn))

        def matched():
            return all(map(ground.samples.get, topics)) and len(received) == len(SUBSCRIPTIONS)

        if autopilot.wait(matched, session, ground, seconds=0.2):
            break
    else:
        raise AssertionError("some topics do not come through")
    # A marker in each direction comes after all samples that are still in flight.
    last = PUBLICATIONS[0], SUBSCRIPTIONS[0]
    vehicle.publish(last[0], sample(0xFFFFFFFF))
    marked = []
    session.on_data = lambda thing, payload: marked.append(counter(payload))
    write(last[1], sample(0xFFFFFFFF))
    vehicle.until(
        lambda: 0xFFFFFFFF in marked and counter(ground.samples[topics[0]][-1]) == 0xFFFFFFFF
    )
    ground.samples.clear()
    ground.count = 0


@pytest.mark.parametrize(
    ("transport", "names_out", "names_in", "rate"),
    # 921,600 baud are 92 kB a second: 8 topics at 50 Hz each way, of 100 bytes.
    [("udp", 50, 28, 100), ("serial", 8, 8, 50)],
    ids=["udp", "serial"],
)
def test_a_second_of_flight_loses_no_sample(place, ground, names_out, names_in, rate):
    """Every sample arrives, in both directions; only the agent could lose one.

    Each burst is sent when it is due, but never so far ahead of the received samples that buffers
    of the system or the history of a reader (KEEP_LAST of 2 QUEUE samples) could overflow on a busy
    machine.
    """
    vehicle = place.fly(Px4, ground)
    listen_to_all(ground, vehicle)
    write = talk_to_all(ground, vehicle)
    meet(ground, vehicle, write)
    received = {}
    total = 0

    def on_data(thing, payload):
        nonlocal total
        total += 1
        received.setdefault(thing, []).append(counter(payload))

    session = vehicle.session
    session.on_data = on_data
    out, into = PUBLICATIONS[:names_out], SUBSCRIPTIONS[:names_in]
    start = time.monotonic()
    for turn in range(rate):
        due = start + turn / rate

        def on_time(turn=turn, due=due):
            return (
                time.monotonic() >= due
                and ground.count >= (turn - rate // 4) * len(out)
                and all(
                    len(received.get(vehicle.readers[name], ())) > turn - 2 * px4.QUEUE
                    for name in into
                )
            )

        while not on_time():
            left = due - time.monotonic()
            autopilot.wait(on_time, session, ground, seconds=left if left > 0 else 1.0)
            assert time.monotonic() - start < autopilot.SECONDS, "it does not come through"
        for name in out:
            vehicle.publish(name, sample(turn))
        for name in into:
            write(name, sample(turn))
    vehicle.until(
        lambda: ground.count == rate * len(out) and total == rate * len(into),
        lambda: f"{ground.count} of {rate * len(out)} out, {total} of {rate * len(into)} in",
    )
    seconds = time.monotonic() - start
    for name in out:
        samples = ground.samples[vehicle.topic(name, "out")]
        assert [counter(octets) for octets in samples] == list(range(rate)), name
        assert all(len(octets) == 100 for octets in samples)
    for name in into:
        assert received[vehicle.readers[name]] == list(range(rate)), name
    print(f"{rate * len(out)} out and {rate * len(into)} in, within {seconds:.2f} s")
    assert not place.complaints()


@transports
def test_a_message_larger_than_the_announced_mtu_is_published(place, ground):
    """PX4's buffer of the best-effort stream has 2048 bytes; the session's MTU is 512."""
    vehicle = place.fly(Px4, ground)
    topic = vehicle.topic("event", "out")
    ground.listen(topic, type_name("event"), SENSOR_DATA)
    big = sample(7, 2000)
    for _ in range(100):
        vehicle.publish("event", big)
        if autopilot.wait(lambda: ground.samples[topic], vehicle.session, ground, seconds=0.2):
            break
    assert ground.samples[topic][0] == big


def test_a_message_too_large_for_the_vehicle_is_dropped_and_logged(udp, ground):
    vehicle = udp.fly(Px4, ground)
    write = talk_to_all(ground, vehicle)
    received = []
    vehicle.session.on_data = lambda thing, payload: received.append(payload)
    for _ in range(100):
        write("obstacle_distance", sample(1, 600))
        write("vehicle_command", sample(2))
        before = len(received)
        autopilot.wait(lambda n=before: len(received) > n, vehicle.session, ground, seconds=0.2)
        if udp.agent.said("message dropped") and received:
            break
    assert {counter(octets) for octets in received} == {2}
    assert udp.agent.said("message dropped"), udp.agent.lines


@transports
def test_vehicle_command_is_answered(place, ground):
    vehicle = place.fly(Px4, ground)
    request_topic, reply_topic = vehicle.service("vehicle_command")
    call, replies = ground.caller(
        Service(
            request_topic, "px4_msgs::srv::dds_::VehicleCommand_Request_",
            reply_topic, "px4_msgs::srv::dds_::VehicleCommand_Response_",
        )
    )  # fmt: skip
    request_numbers = []  # before the endpoints have matched, requests are lost
    while not vehicle.session.samples[vehicle.replier]:
        request_numbers.append(call(sample(len(request_numbers), 84)))
        autopilot.wait(
            lambda: vehicle.session.samples[vehicle.replier], vehicle.session, ground, seconds=0.3
        )
    reply = sample(0, 24)
    request = vehicle.answer(reply)
    assert len(request) == 84
    vehicle.until(lambda: replies, "no reply comes")
    assert replies[0] == (request_numbers[counter(request)], reply)


# --- reconnecting --------------------------------------------------------------------------------


def check_flow(ground, vehicle):
    """Exchange a sample on every topic in each direction."""
    write = talk_to_all(ground, vehicle)
    listen_to_all(ground, vehicle)
    meet(ground, vehicle, write)
    return write


@transports
def test_the_vehicle_reconnects_to_a_restarted_agent(own_place, own_ground):
    place, ground = own_place, own_ground
    vehicle = place.fly(Px4, ground)
    assert vehicle.in_session()
    place.agent.kill()
    assert vehicle.lost()
    place.start()
    # Its session is unknown to the new agent, which therefore does not answer.
    vehicle.publish("vehicle_odometry", sample(1))
    assert vehicle.lost()
    vehicle.disconnect()
    vehicle.session.link = place.link()
    vehicle.connect()
    assert vehicle.in_session()
    check_flow(ground, vehicle)


@transports
def test_a_vehicle_that_reboots_is_one_node_and_receives_each_command_once(place, ground):
    """The vehicle connects again with the same key, without DELETE; on UDP from another port."""
    first = place.fly(Px4, ground)
    check_flow(ground, first)
    second = place.fly(Px4, ground)
    write = talk_to_all(ground, second)
    meet(ground, second, write)
    see(
        ground,
        second,
        NODE,
        expected(second, PUBLICATIONS, "out"),
        expected(second, SUBSCRIPTIONS, "in"),
        {"/fmu/vehicle_command": ["px4_msgs/srv/VehicleCommand"]},
    )
    commands = []
    second.session.on_data = lambda thing, payload: commands.append((thing, counter(payload)))
    for number in range(5):
        write("vehicle_command", sample(number))
    second.until(lambda: len(commands) >= 5)
    assert commands == [(second.readers["vehicle_command"], number) for number in range(5)]
    if place.transport == "udp":
        assert not first.in_session(0.2)


@pytest.mark.parametrize("transport", ["serial"])
def test_on_a_serial_line_a_new_key_replaces_the_client_before(place, ground):
    place.fly(Px4, ground, key=1)
    second = place.fly(Px4, ground, key=2, namespace="other")
    second.until(
        lambda: (
            [name for name in ground.graph.nodes() if "px4" in name]
            == ["/other/px4_micro_xrce_dds"]
        ),
        ground.graph.nodes,
    )


def test_the_first_of_two_vehicles_with_the_same_key_keeps_it(udp, ground):
    first = udp.fly(Px4, ground, key=6)
    second = Px4(udp.link(), key=6)
    second.others = ground, first.session  # it answers the takeover probe
    second.session.create_client()
    second.until(lambda: second.session.agent_status is not None, "no answer to CREATE_CLIENT")
    assert second.session.agent_status == ids.STATUS_ERR_DENIED
    assert first.in_session()
    assert ground.graph.nodes().count(NODE) == 1
    second.until(
        lambda: any(
            "client key in use" in line and "a key of its own" in line for line in udp.complaints()
        ),
        "the log has no remedy",
    )


def test_a_vehicle_that_does_not_answer_loses_its_key_to_a_new_one(udp, ground):
    first = udp.fly(Px4, ground, key=7)
    second = udp.fly(Px4, ground, key=7)
    assert second.in_session() and not first.in_session(0.2)
    assert ground.graph.nodes().count(NODE) <= 1


def test_delete_client_removes_all_entities(udp, ground):
    vehicle = udp.fly(Px4, ground)
    vehicle.until(lambda: NODE in ground.graph.nodes())
    vehicle.session.delete_client()
    vehicle.until(lambda: NODE not in ground.graph.nodes(), ground.graph.nodes)
    vehicle.until(lambda: not ground.graph.publishers("/fmu/out/vehicle_odometry"))


# --- participants ---------------------------------------------------------------------------------


REFS = """<?xml version="1.0" encoding="UTF-8"?>
<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <participant profile_name="px4_participant">
    <rtps><name>drone/px4_micro_xrce_dds</name></rtps>
  </participant>
</profiles>
"""


def test_a_custom_participant_comes_from_the_references_file(own_domain_id, own_ground, tmp_path):
    ground = own_ground
    file = tmp_path / "px4.xml"
    file.write_text(REFS)
    with Place("udp", own_domain_id, "-r", file) as place:
        vehicle = place.fly(Px4, ground, config="custom")
        vehicle.until(
            lambda: "/drone/px4_micro_xrce_dds" in ground.graph.nodes(), ground.graph.nodes
        )


def test_a_custom_participant_without_the_file_is_refused_and_the_log_has_the_remedy(udp):
    vehicle = Px4(udp.link(), config="custom")
    vehicle.find_agent()
    vehicle.open()
    assert vehicle.all_status(vehicle.create_participant()) != [autopilot.OK]
    line = udp.agent.wait_for("participant refused")
    assert "px4_participant" in line and "--refs FILE" in line


def test_a_localhost_participant_is_created_where_discovery_stays_on_localhost(udp, ground):
    vehicle = udp.fly(Px4, ground, config="localhost", namespace="here")
    vehicle.until(lambda: "/here/px4_micro_xrce_dds" in ground.graph.nodes(), ground.graph.nodes)


def test_a_localhost_participant_is_refused_on_an_open_network(own_domain_id):
    # With the loopback interface of the tests' configuration rtps would stay on this machine,
    # whatever the range is. The domain is not joined: the participant is refused before.
    environment = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "CYCLONEDDS_URI": ""}
    with Place("udp", own_domain_id, environment=environment) as place:
        vehicle = Px4(place.link(), config="localhost")
        vehicle.find_agent()
        vehicle.open()
        assert vehicle.all_status(vehicle.create_participant()) != [autopilot.OK]
        assert "ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST" in place.agent.wait_for("refused")
