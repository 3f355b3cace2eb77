"""`uros doctor`: ends that do not meet, with faults planted in real DDS domains on loopback."""

import shlex
import struct
import time
from types import SimpleNamespace

import pytest
from conftest import leased_domain
from hypothesis import given
from hypothesis import strategies as st
from uros.interfaces.sensor_msgs.msg import Temperature
from uros.interfaces.std_msgs.msg import Int32, String

import uros
from uros.host.network import Network
from uros.middleware.qos_matching import Mismatch, mismatches
from uros.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from uros.tools.doctor import clock
from uros.tools.doctor import graph as doctor_graph
from uros.tools.doctor import qos as doctor_qos
from uros.tools.doctor.graph import End, Picture, check_domains, check_names, check_types, ends
from uros.tools.doctor.qos import check_qos

BEST_EFFORT = ReliabilityPolicy.BEST_EFFORT
TRANSIENT_LOCAL = DurabilityPolicy.TRANSIENT_LOCAL
MANUAL = LivelinessPolicy.MANUAL_BY_TOPIC
# The nodes of the test that runs.
MADE = []


# --- QoS: the rules -------------------------------------------------------------------------------


RULES = [
    ({}, {}, []),
    ({}, {"reliability": BEST_EFFORT}, []),
    ({"reliability": BEST_EFFORT}, {}, ["reliability"]),
    ({"reliability": BEST_EFFORT}, {"reliability": BEST_EFFORT}, []),
    ({"durability": TRANSIENT_LOCAL}, {}, []),
    ({}, {"durability": TRANSIENT_LOCAL}, ["durability"]),
    ({"durability": TRANSIENT_LOCAL}, {"durability": DurabilityPolicy.TRANSIENT},
     ["durability"]),
    ({"durability": DurabilityPolicy.PERSISTENT}, {"durability": TRANSIENT_LOCAL}, []),
    ({"deadline_ms": 50}, {"deadline_ms": 50}, []),
    ({"deadline_ms": 50}, {}, []),
    ({"deadline_ms": 60}, {"deadline_ms": 50}, ["deadline"]),
    ({}, {"deadline_ms": 50}, ["deadline"]),
    ({}, {"liveliness": MANUAL}, ["liveliness"]),
    ({"liveliness": MANUAL}, {}, []),
    ({"liveliness_lease_ms": 10}, {"liveliness_lease_ms": 20}, []),
    ({"liveliness_lease_ms": 20}, {"liveliness_lease_ms": 10}, ["liveliness lease"]),
    ({}, {"liveliness_lease_ms": 10}, ["liveliness lease"]),
    ({"ownership_exclusive": True}, {}, ["ownership"]),
    ({}, {"ownership_exclusive": True}, ["ownership"]),
    ({"ownership_exclusive": True}, {"ownership_exclusive": True}, []),
    ({"partitions": ("a",)}, {}, ["partition"]),
    ({"partitions": ("",)}, {}, []),
    ({"partitions": ("a", "b")}, {"partitions": ("b",)}, []),
    ({"partitions": ("robot1",)}, {"partitions": ("robot*",)}, []),
    ({"partitions": ("robot*",)}, {"partitions": ("x", "robot1")}, []),
    ({"partitions": ("robot*",)}, {"partitions": ("rob*",)}, ["partition"]),
    ({"partitions": ("robot*",)}, {"partitions": ("robot*",)}, ["partition"]),
    ({"partitions": ("*",)}, {}, []),
    ({"lifespan_ms": 60000, "depth": 1}, {"lifespan_ms": 90000, "depth": 100}, []),
    ({"reliability": BEST_EFFORT}, {"durability": TRANSIENT_LOCAL, "deadline_ms": 5},
     ["reliability", "durability", "deadline"]),
]  # fmt: skip
HELLO = b"\0\1\0\0\6\0\0\0hello\0\0\0"


@pytest.mark.parametrize("offered, requested, policies", RULES)
def test_the_rules_of_qos(offered, requested, policies):
    found = mismatches(QoSProfile(**offered), QoSProfile(**requested))
    assert [mismatch.policy for mismatch in found] == policies
    # Whatever `--qos` is told to set, on either side, does away with the mismatch.
    for one in found:
        for side, rule in ((0, one.offer), (1, one.request)):
            if rule:
                profiles = [QoSProfile(**offered), QoSProfile(**requested)]
                apply(profiles[side], rule)
                left = [mismatch.policy for mismatch in mismatches(*profiles)]
                assert one.policy not in left, rule


def test_the_rules_are_those_of_the_dds(own_domain_id):
    """Cyclone's own judgement of the same pairs: whether a sample comes through."""
    type_name = "std_msgs::msg::dds_::String_"
    with Network(own_domain_id) as network:
        for number, (offered, requested, policies) in enumerate(RULES):
            if requested.get("durability") == DurabilityPolicy.TRANSIENT:
                continue  # ours asks for transient local then: there is no durability service
            topic = f"rt/rule{number}"
            writer = network.node.create_writer(topic, type_name, QoSProfile(**offered))
            reader = network.node.create_reader(
                topic, type_name, QoSProfile(**requested), lambda: None
            )
            assert writer.write(HELLO)
            # Within a process it is there when the write returns.
            assert bool(reader.take(1)) == (not policies), (offered, requested)


def test_long_lists_of_partitions_are_shown_in_part():
    """They come from the network, and are told to the user in one line."""
    theirs = QoSProfile(partitions=tuple(f"{number}" * 256 for number in range(10, 74)))
    (one,) = mismatches(QoSProfile(partitions=("\a" * 100, "b")), theirs)
    assert one.policy == "partition" and one.offered.endswith("…, 'b'")
    assert one.requested.startswith("'1010") and one.requested.endswith("… and 60 more")
    assert len(one.offered) < 60 and len(one.requested) < 220
    (one,) = mismatches(QoSProfile(partitions=("a", "b")), QoSProfile())
    assert (one.offered, one.requested) == ("'a', 'b'", "none")


def apply(qos, rule):
    """What the agent does with a rule of `--qos`."""
    from uros.agent.policy.rules import Rules

    name, _, value = rule.partition("=")
    control = Rules()
    control.add({"qos": {"/t": {name: int(value) if value.isdecimal() else value}}})
    control.settings(1, "here", "/n").apply(qos, "rt/t")


profiles = st.builds(
    QoSProfile,
    reliability=st.sampled_from([ReliabilityPolicy.RELIABLE, BEST_EFFORT]),
    durability=st.sampled_from([DurabilityPolicy.VOLATILE, TRANSIENT_LOCAL]),
    deadline_ms=st.sampled_from([None, 10, 20]),
    liveliness=st.sampled_from([LivelinessPolicy.AUTOMATIC, MANUAL]),
    partitions=st.sampled_from([(), ("a",), ("a", "b")]),
)


@given(profiles, profiles)
def test_every_mismatch_has_a_fix(offered, requested):
    assert mismatches(offered, offered) == []
    for one in mismatches(offered, requested):
        for boards in ((), ("/w",), ("/r",)):
            assert doctor_qos._fix("/t", "/w", "/r", one, boards)


# --- QoS: planted -------------------------------------------------------------------------------


@pytest.fixture
def domain(own_domain_id):
    return own_domain_id


@pytest.fixture
def make():
    """Nodes by name and domain, destroyed at the end."""

    def node(name, domain):
        MADE.append(uros.Node(name, domain_id=domain))
        return MADE[-1]

    yield node
    while MADE:
        MADE.pop().destroy_node()


def looking(domain, look):
    for node in MADE:  # they say in the graph what they have
        deadline = time.monotonic() + 10
        while node.connection.middleware.next_deadline() is not None:
            assert time.monotonic() < deadline
            node.spin_once(0.005)
    with Network(domain) as network:
        network.settle()
        ours = {name for name in network.graph.nodes() if name.startswith("/_uros_")}
        return look(network, ours)


def qos_in(domain, boards=()):
    return looking(
        domain, lambda network, ours: check_qos(Picture(network.graph, ours), domain, boards)
    )


@pytest.mark.parametrize(
    "offered, requested, policy, option",
    [
        ({"reliability": BEST_EFFORT}, {}, "reliability", "reliability=reliable"),
        ({}, {"durability": TRANSIENT_LOCAL}, "durability", "durability=transient_local"),
        ({"deadline_ms": 500}, {"deadline_ms": 100}, "deadline", "deadline_ms=100"),
        ({}, {"liveliness": MANUAL, "liveliness_lease_ms": 1000}, "liveliness",
         "liveliness=manual_by_topic"),
        ({"ownership_exclusive": True}, {}, "ownership", None),
        ({"partitions": ("left",)}, {"partitions": ("right",)}, "partition", None),
    ],
)  # fmt: skip
def test_a_pair_that_does_not_match(make, domain, offered, requested, policy, option):
    make("talker", domain).create_publisher(String, "/t", QoSProfile(**offered))
    make("listener", domain).create_subscription(String, "/t", print, QoSProfile(**requested))
    one = qos_in(domain, {"/talker"})[0]
    assert one.state == "problem" and f"{policy} offered" in one.what
    assert "/talker publishes on /t" in one.what and "/listener" in one.what
    if option:
        assert one.fix == f"start the agent with --qos /t:{option}"
    else:
        assert policy in one.fix and "/talker and /listener" in one.fix


def test_a_pair_that_matches(make, domain):
    talker, listener = make("talker", domain), make("listener", domain)
    talker.create_publisher(String, "/t", 10)
    listener.create_subscription(String, "/t", print, QoSProfile(5, BEST_EFFORT))
    (one,) = qos_in(domain)
    assert one.state == "ok" and "the one pair" in one.what


def test_code_that_fixes_is_named_for_nodes_that_are_no_boards(make, domain):
    make("talker", domain).create_publisher(String, "/t", QoSProfile(5, BEST_EFFORT))
    make("listener", domain).create_subscription(String, "/t", print, 10)
    (one,) = qos_in(domain)
    assert one.fix == (
        "in /listener, create the subscription of /t with"
        " QoSProfile(reliability=ReliabilityPolicy.BEST_EFFORT, ...)"
    )
    (one,) = qos_in(domain, {"/listener"})
    assert one.fix == "start the agent with --qos /t:reliability=best_effort"


# --- types --------------------------------------------------------------------------------------


def types_in(domain):
    return looking(domain, lambda network, ours: check_types(Picture(network.graph, ours), domain))


def test_types_that_agree(make, domain):
    make("talker", domain).create_publisher(String, "/t", 10)
    make("listener", domain).create_subscription(String, "/t", print, 10)
    (one,) = types_in(domain)
    assert one.state == "ok"


def test_types_that_differ(make, domain):
    make("talker", domain).create_publisher(String, "/t", 10)
    make("listener", domain).create_subscription(Int32, "/t", print, 10)
    (one,) = types_in(domain)
    assert one.state == "problem" and one.what.startswith("/t has different types")
    assert "std_msgs/msg/String in /talker" in one.what
    assert "std_msgs/msg/Int32 in /listener" in one.what
    assert "-r /t:=/t_2" in one.fix and "--remap /t:=/t_2" in one.fix
    assert qos_in(domain) == []  # which is no matter of QoS


def test_two_nodes_of_one_name(make, domain):
    for _ in range(2):
        make("talker", domain).create_publisher(String, "/t", 10)
    make("listener", domain)
    (one,) = looking(
        domain, lambda network, ours: check_names(Picture(network.graph, ours), domain)
    )
    assert one.state == "note" and one.what.startswith("2 nodes in domain")
    assert "/talker" in one.what and "-r __node:=" in one.fix


def test_nodes_whose_names_differ():
    told = graph(("/t", "w", True, "my/msg/T", ""), ("/t", "r", False, "my/msg/T", ""))
    told.nodes = lambda: ["/w", "/r", "/lab/w"]
    assert check_names(Picture(told), 0) == []


def graph(*endpoints):
    """A graph of (topic, node, is_writer, type, hash)."""
    infos = [
        (topic, SimpleNamespace(node_namespace="/", node_name=node, type_name=type_name,
                                type_hash=digest, is_publisher=writer, qos=QoSProfile()))
        for topic, node, writer, type_name, digest in endpoints
    ]  # fmt: skip
    topics = {}
    for topic, info in infos:
        topics.setdefault(topic, []).append(info.type_name)
    return SimpleNamespace(
        nodes=lambda: [],
        topics=lambda: topics,
        publishers=lambda of: [info for topic, info in infos if topic == of and info.is_publisher],
        subscriptions=lambda of: [
            info for topic, info in infos if topic == of and not info.is_publisher
        ],
    )


def test_one_type_in_two_versions():
    first, second = "RIHS01_" + "a" * 64, "RIHS01_" + "b" * 64
    told = graph(("/t", "w", True, "my/msg/T", first), ("/t", "r", False, "my/msg/T", second))
    (one,) = check_types(Picture(told), 0)
    assert one.state == "problem" and "my/msg/T of /t is not the same everywhere" in one.what
    assert "/w" in one.what and "/r" in one.what and "ros2 interface show my/msg/T" in one.fix
    told = graph(("/t", "w", True, "my/msg/T", first), ("/t", "r", False, "my/msg/T", "INVALID"))
    (one,) = check_types(Picture(told), 0)
    assert one.state == "ok"


# --- domains ------------------------------------------------------------------------------------


def ends_in(*domains):
    return {
        domain: looking(domain, lambda network, ours: ends(Picture(network.graph, ours)))
        for domain in domains
    }


def test_a_talker_and_a_listener_in_different_domains(make, domain):
    with leased_domain() as other:
        make("talker", domain).create_publisher(String, "/t", 10)
        listener = make("listener", other)
        listener.create_subscription(String, "/t", print, 10)
        (one,) = check_domains(ends_in(domain, other), [("/talker", domain)], [other])
        assert one.state == "problem"
        assert f"/talker in domain {domain} publishes /t" in one.what
        assert f"/listener subscribes to it in domain {other}" in one.what
        assert one.fix == (
            f"export ROS_DOMAIN_ID={domain} before /listener starts, or start the agent with"
            f" --domain {other}"
        )
        # As the second half of the fix says:
        make("moved", other).create_publisher(String, "/t", 10)
        found = ends_in(domain, other)
        assert check_domains({other: found[other]}, [("/moved", other)], [other])[0].state == "ok"


@pytest.mark.parametrize(
    "here, there",
    [
        ([End("/rosout", "T", "/a", True)], [End("/rosout", "T", "/b", False)]),
        ([End("/t", "T", "/a", True)], [End("/t", "U", "/b", False)]),
        ([End("/t", "T", "/a", True), End("/t", "T", "/c", False)],
         [End("/t", "T", "/b", False)]),
        ([End("/t", "T", "/a", True)], [End("/t", "T", "/b", False), End("/t", "T", "/c", True)]),
        ([End("/t", "T", "/a", True)], [End("/u", "T", "/b", False)]),
    ],
)  # fmt: skip
def test_endpoints_in_different_domains_on_purpose(here, there):
    (one,) = check_domains({1: here, 2: there}, [], [1])
    assert one.state == "ok"


def test_a_subscriber_on_a_board_in_another_domain():
    here, there = [End("/cmd", "T", "/teleop", True)], [End("/cmd", "T", "/board", False)]
    (one,) = check_domains({0: here, 5: there}, [("/board", 5)], [0])
    assert "--domain 0" in one.fix and "export ROS_DOMAIN_ID=5 before /teleop" in one.fix


def test_a_board_in_a_domain_that_is_not_checked():
    (one,) = check_domains({0: [], 5: [End("/t", "T", "/b", True)]}, [("/b", 5)], [0])
    assert one.state == "problem" and "the board's node /b is in domain 5" in one.what
    assert "export ROS_DOMAIN_ID=5" in one.fix and "--domain 0" in one.fix
    (one,) = check_domains({5: [End("/t", "T", "/b", True)]}, [("/b", 5)], [5])
    assert one.state == "ok"


def test_boards_of_other_agents_in_other_domains_are_no_problem():
    found = {
        0: [],
        5: [End("/t", "T", "/b", True)],
        6: [End("/t", "T", "/c", False)],
        7: [End("/u", "T", "/d", True)],
    }
    boards = [("/b", 5), ("/c", 6), ("/d", 7)]
    agents = {41: set(), 42: {5, 6, 7}}
    findings = check_domains(found, boards, [0], agents)
    assert [one.state for one in findings] == ["note", "note"]
    assert "/b in domain 5 publishes /t" in findings[0].what
    assert findings[1].what.endswith("/d is in domain 7, and you look at domain 0 (agent 42)")
    assert "check yours alone: uros doctor --agent PID" in findings[1].fix
    # With one agent, or with --agent, the user is looking at these boards.
    only = check_domains(found, boards, [0], {42: {5, 6, 7}})
    assert [one.state for one in only] == ["problem", "problem"]
    # A topic of the user's own domain is a problem however many agents there are.
    found[0] = [End("/t", "T", "/mine", False)]
    assert "problem" in [one.state for one in check_domains(found, boards, [0], agents)]


def test_empty_domains():
    (one,) = check_domains({0: [], 3: []}, [], [3])
    assert one.state == "note" and "uros doctor --domain N" in one.fix


# --- clocks -------------------------------------------------------------------------------------


def stamped_by(make, domain, seconds, count=20):
    """What the doctor says of a talker whose stamps are so many seconds off (None: unset)."""
    talker = make("talker", domain)
    publisher = talker.create_publisher(Temperature, "/temp", QoSProfile(5, BEST_EFFORT))
    message = Temperature()

    def publish():
        now = 100.5 if seconds is None else time.time() + seconds
        message.header.stamp.sec = int(now)
        message.header.stamp.nanosec = int(now % 1 * 1e9)
        publisher.publish(message)

    def look(network, ours):
        spin = network.spin

        def spin_both(done, most):
            end = time.monotonic() + most
            while time.monotonic() < end:
                publish()
                talker.spin_once(0.0)
                spin(lambda: False, 0.02)
            return False

        network.spin = spin_both
        return clock.check_stamps(network, Picture(network.graph, ours), 0.5, {"/talker"})

    return looking(domain, look)


@pytest.mark.parametrize(
    "seconds, words",
    [(-3600.0, "3600 s behind"), (0.8, "ahead of this host's clock"),
     (None, "does not know the time")],
)  # fmt: skip
def test_stamps_that_are_off(make, domain, seconds, words):
    (one,) = stamped_by(make, domain, seconds)
    assert one.state == "problem" and words in one.what
    assert "/temp by /talker" in one.what
    assert "rmw_uros_sync_session" in one.fix and "node.clock.stamp" in one.fix


def test_stamps_that_are_right(make, domain):
    (one,) = stamped_by(make, domain, 0.0)
    assert one.state == "ok" and "1 topic" in one.what


def cdr(seconds, nanoseconds, little=True):
    return bytes([0, little, 0, 0]) + struct.pack("<iI" if little else ">iI", seconds, nanoseconds)


@pytest.mark.parametrize("little", [True, False])
def test_the_stamp_at_the_beginning(little):
    assert clock.stamp_of(cdr(1700000000, 5, little)) == (1700000000, 5)
    assert clock.stamp_of(cdr(1700000000, 1_000_000_000, little)) is None


@given(st.binary(max_size=40))
def test_any_sample(data):
    stamps = clock.Stamps(["/n"])
    stamps.add(data, 1_700_000_000_000_000_000)
    clock.judge("/t", stamps, True)


def test_stamps_of_other_nodes_may_be_old():
    stamps = clock.Stamps(["/filter"])
    stamps.add(cdr(1700000000, 0), 1700000005 * 10**9)
    assert clock.judge("/t", stamps, False).state == "note"
    assert clock.judge("/t", stamps, True).state == "problem"
    none = clock.Stamps(["/n"])
    none.add(cdr(0, 0), 1700000005 * 10**9)
    assert clock.judge("/t", none, True).state == "note"


def test_which_types_are_stamped():
    assert clock.is_stamped("sensor_msgs/msg/Imu")
    assert clock.is_stamped("std_msgs/msg/Header")
    assert not clock.is_stamped("std_msgs/msg/String")
    assert not clock.is_stamped("no_such_msgs/msg/Thing")
    assert not clock.is_stamped("std_srvs/srv/Empty")


def test_the_hosts_own_clock():
    one = clock.check_host()
    assert one.state in ("ok", "note", "unknown") and (one.state != "note" or one.fix)


def test_names_of_unknown_nodes():
    unknown = SimpleNamespace(
        node_namespace="_NODE_NAMESPACE_UNKNOWN_", node_name="_NODE_NAME_UNKNOWN_"
    )
    assert "not known" in doctor_graph.full_name(unknown)


# --- text from outside ----------------------------------------------------------------------------


def test_names_are_quoted_in_commands():
    """Whoever copies the line into a shell runs uros, and nothing else."""
    evil = "/x; rm -rf ~"
    one = Mismatch("reliability", "best_effort", "reliable", "a=b", "a=c")
    fix = doctor_qos._fix(evil, "/board", "/other", one, {"/board"})
    assert shlex.split(fix)[-1] == evil + ":a=b"
    told = graph((evil, "w", True, "A", "INVALID"), (evil, "r", False, "B", "INVALID"))
    (one,) = check_types(Picture(told), 0)
    assert f"-r '{evil}:={evil}_2'" in one.fix and f"--remap '{evil}:={evil}_2'" in one.fix


def test_the_pairs_of_a_large_graph_are_limited():
    many = [("/t", f"w{n}", True, "T", "INVALID") for n in range(400)]
    many += [("/t", f"r{n}", False, "T", "INVALID") for n in range(400)]
    told = graph(*many)
    for info in told.publishers("/t"):
        info.qos = QoSProfile(5, BEST_EFFORT)
    found = check_qos(Picture(told), 0)
    assert len(found) == 34 and {finding.state for finding in found[-2:]} == {"note"}
    assert "19968 more pairs" in found[-2].what
    assert "more pairs than the 20000 looked at" in found[-1].what
