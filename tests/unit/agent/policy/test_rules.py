"""Rules for clients: their syntax, which clients they match, what they do."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uros import names
from uros.agent.policy.rules import (
    GLOBAL,
    NOTHING,
    ConfigError,
    NameRefused,
    Rule,
    Rules,
    Settings,
    parse_rule,
)
from uros.middleware.base import Service
from uros.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

FILE = """
[[client]]
node = "turtle_*"
namespace = "hall"
domain = 7

[[client]]
key = ["0x4B0CBE99", 3]
address = "192.168.1.0/24"
remap = { "/cmd_vel" = "/turtle1/cmd_vel", image = "camera/image" }
max_rate = 100
max_size = 65536

[client.qos."/odom*"]
reliability = "best_effort"
durability = "transient_local"
history = "keep_all"
depth = 3
deadline_ms = 100
"""


def load_rules(text, tmp_path):
    path = tmp_path / "control.toml"
    path.write_text(text)
    rules = Rules()
    return rules, rules.load(path)


def test_a_file_of_rules(tmp_path):
    rules, count = load_rules(FILE, tmp_path)
    assert count == 2
    nothing = rules.settings(1, "10.0.0.1:7", "/other")
    assert nothing.domain is None and nothing.topic("rt/cmd_vel") == "rt/cmd_vel"
    assert nothing.node("/", "other") == ("/", "other")
    hall = rules.settings(1, "10.0.0.1:7", "/turtle_2")
    assert hall.domain == 7
    assert hall.node("/", "turtle_2") == ("/hall", "turtle_2")
    assert hall.node("/a/b", "turtle_2") == ("/hall/a/b", "turtle_2")
    assert hall.topic("rt/cmd_vel") == "rt/hall/cmd_vel"
    settings = rules.settings(0x4B0CBE99, "192.168.1.77:2018", "/turtle_2")
    assert settings.topic("rt/cmd_vel") == "rt/turtle1/cmd_vel"
    assert settings.topic("rt/image") == "rt/camera/image"
    assert settings.topic("rt/other") == "rt/hall/other"
    assert settings.max_size == 65536 and settings.max_rate == 100.0


def test_global_topics_get_no_namespace():
    settings = Settings([parse_rule({"namespace": "/r1", "remap": {"/tf": "/r1/tf"}})])
    for name in GLOBAL - {"/tf"}:
        assert settings.name(name) == name
    assert settings.name("/tf") == "/r1/tf"  # where a rule names it


def test_services_are_renamed_as_a_pair():
    settings = Settings([parse_rule({"namespace": "/r1", "remap": {"go": "run"}})])
    go = settings.service(Service("rq/goRequest", "a", "rr/goReply", "b"))
    assert (go.request_topic, go.reply_topic) == ("rq/runRequest", "rr/runReply")
    assert (go.request_type, go.reply_type) == ("a", "b")
    renamed = settings.service(Service("rq/n/setRequest", "a", "rr/n/setReply", "b"))
    assert (renamed.request_topic, renamed.reply_topic) == (
        "rq/r1/n/setRequest",
        "rr/r1/n/setReply",
    )


def test_topics_that_are_not_of_ros_are_unchanged_without_a_namespace():
    for rules in ({"remap": {"Square": "/other"}}, {"max_rate": 1}, {"namespace": "/"}):
        settings = Settings([parse_rule(rules)])
        assert settings.topic("Square") == "Square"
        plain = settings.service(Service("go_Request", "a", "go_Reply", "b"))
        assert (plain.request_topic, plain.reply_topic) == ("go_Request", "go_Reply")


def test_names_that_are_invalid_in_ros_are_refused_in_a_namespace():
    settings = Settings([parse_rule({"namespace": "/r1"})])
    for name in ("Square", "ros_discovery_info", "go_Request", "rtx/a", "rt", "", "/rt/a"):
        with pytest.raises(NameRefused, match="is no name of ROS .*into the namespace /r1"):
            settings.topic(name)
    with pytest.raises(NameRefused):
        settings.service(Service("rq/goRequest", "a", "go_Reply", "b"))


def test_rules_apply_to_every_prefix_of_ros():
    settings = Settings([parse_rule({"namespace": "/jail", "remap": {"/go": "/run"}})])
    for before, after in {
        "rq/addRequest": "rq/jail/addRequest",
        "rr/addReply": "rr/jail/addReply",
        "rq/goRequest": "rq/runRequest",
        "rr/goReply": "rr/runReply",
        "rq/add": "rq/jail/add",  # is no service, and stays in the namespace nonetheless
        "rq/addReply": "rq/jail/addReply",
        "rt/arm/_action/feedback": "rt/jail/arm/_action/feedback",
        "rq/arm/_action/send_goalRequest": "rq/jail/arm/_action/send_goalRequest",
        "rq/node/set_parametersRequest": "rq/jail/node/set_parametersRequest",
        "rs/a": "rs/jail/a",
        "rp/a": "rp/jail/a",
        "ra/a": "ra/jail/a",
        "rt/tf": "rt/tf",
        "rq/tfRequest": "rq/jail/tfRequest",  # a service of that name does get the namespace
        "ra/clock": "ra/jail/clock",
    }.items():
        assert settings.topic(before) == after


def test_names_that_ros_refuses_are_refused_with_rules_and_without():
    for settings in (NOTHING, Settings([parse_rule({"namespace": "/jail"})])):
        for name in (
            "rt/../x", "rt/a/../x", "rt//x", "rt/x/", "rt/", "rt/1x", "rt/a/1", "rt/~/x", "rt/~x",
            "rt/a b", "rt/{node}", "rt/a-b", "rt/a.b", "rt/é", "rt/a\n", "rq/Request", "rr/Reply",
            "rq/../goRequest", "ra/..", "rp/1", "rs//a", f"rt/{'x' * 247}", "rq/a/Request",
        ):  # fmt: skip
            with pytest.raises(NameRefused, match="refused by the rules of ROS: it |a part of it"):
                settings.topic(name)
    assert NOTHING.topic(f"rt/{'x' * 246}") == f"rt/{'x' * 246}"
    assert NOTHING.topic("rt/a__b/_c") == "rt/a__b/_c"  # rmw lets these pass
    with pytest.raises(NameRefused, match="by the agent's rules: it has 252 characters"):
        Settings([parse_rule({"namespace": "/jail"})]).topic(f"rt/{'x' * 246}")
    for name in ("", "x" * 256):
        with pytest.raises(NameRefused, match="and DDS has 1 to 255"):
            NOTHING.topic(name)


def test_nodes_have_the_lengths_of_ros():
    jail = Settings([parse_rule({"namespace": "/jail"})])
    assert jail.node("/" + "n" * 239, "x" * 255) == ("/jail/" + "n" * 239, "x" * 255)
    for namespace, name in (("/" + "n" * 240, "x"), ("/", "x" * 256)):
        with pytest.raises(NameRefused, match="are the most"):
            jail.node(namespace, name)


_PIECES = st.sampled_from(
    ["rt", "rq", "rr", "ra", "/", "..", "~", "jail", "tf", "go", "Request", "Reply", "_", "1", "{}"]
)


@given(st.one_of(st.lists(_PIECES, max_size=8).map("".join), st.text(max_size=20)))
def test_no_name_leads_out_of_a_namespace(dds_name):
    settings = Settings([parse_rule({"namespace": "/jail", "remap": {"/go": "/run"}})])
    try:
        prefix, name, _ = names.split_dds(settings.topic(dds_name))
    except NameRefused as error:
        assert str(error).isprintable()
        return
    assert not names.fault(name)
    assert name.startswith("/jail/") or name == "/run" or (prefix == "rt" and name in GLOBAL)


def test_qos_rules_for_one_topic_of_a_service_and_for_names_that_are_not_of_ros():
    qos_of = {"/go": {"depth": 3}, "/jail/a": {"depth": 4}}
    rules = [parse_rule({"namespace": "/jail", "qos": qos_of})]
    for name, depth in {"rq/goRequest": 3, "rr/goReply": 3, "rq/aRequest": 4, "rt/b": 10}.items():
        qos = QoSProfile()
        Settings(rules).apply(qos, name)
        assert qos.depth == depth
    qos = QoSProfile()
    Settings([parse_rule({"qos": {"*": {"depth": 5}}})]).apply(qos, "Square")
    assert qos.depth == 5


def test_qos_of_a_topic_by_either_of_its_names(tmp_path):
    rules = [
        parse_rule({"remap": {"odom": "position"}}),
        parse_rule(
            {
                "qos": {
                    "/odom": {"reliability": "best_effort", "depth": 3},
                    "/pos*": {"durability": "transient_local", "history": "keep_all"},
                    "/other": {"deadline_ms": 5},
                }
            }
        ),
    ]
    qos = QoSProfile()
    Settings(rules).apply(qos, "rt/odom")
    assert qos == QoSProfile(
        3, ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.TRANSIENT_LOCAL, HistoryPolicy.KEEP_ALL
    )
    untouched = QoSProfile()
    Settings(rules).apply(untouched, "rt/third")
    assert untouched == QoSProfile()


@pytest.mark.parametrize(
    "address, pattern, matches",
    [
        ("192.168.1.5:2018", "192.168.1.0/24", True),
        ("192.168.2.5:2018", "192.168.1.0/24", False),
        ("192.168.1.5:2018", "192.168.1.5", True),
        ("[fd00::7]:2018", "fd00::/8", True),
        ("[fd00::7]:2018", "192.168.1.0/24", False),
        ("/dev/ttyACM0 (1)", "/dev/ttyACM*", True),
        ("/dev/ttyACM0 (1)", "/dev/ttyACM0", True),
        ("/dev/ttyACM0 (2)", "/dev/ttyACM0 (1)", False),
        ("192.168.1.5:2018", "*:2018", True),
        ("board-7", "fd00::/8", False),
    ],
)
def test_addresses(address, pattern, matches):
    assert Rule(addresses=(pattern,)).matches(1, address, "/n") is matches


def test_a_rate_is_a_token_bucket():
    now = [0.0]
    limiter = Settings([Rule(max_rate=100.0)], lambda: now[0]).limiter
    assert [limiter.admits() for _ in range(26)] == [True] * 25 + [False]
    now[0] += 0.01
    assert limiter.admits() and not limiter.admits()
    now[0] += (
        60.0  # the bucket holds the messages of a quarter of a second, however long the pause was
    )
    assert [limiter.admits() for _ in range(26)] == [True] * 25 + [False]


def test_a_rate_below_one_message_a_second():
    now = [0.0]
    limiter = Settings([Rule(max_rate=0.1)], lambda: now[0]).limiter
    assert limiter.admits() and not limiter.admits()
    now[0] += 10.0
    assert limiter.admits() and not limiter.admits()


def test_the_limiter_of_a_writer():
    written, refused, now = [], [], [0.0]

    def write(sample):
        written.append(bytes(sample))
        return True

    limiter = Settings([Rule(max_rate=4.0, max_size=4)], lambda: now[0]).limiter

    def limited(sample):
        return limiter.write(memoryview(sample), write, refused.append)

    assert limited(b"1234") is True
    assert limited(b"12345") is True  # dropped, as it would exceed the limit later too
    assert limited(b"more") is False
    now[0] += 0.25
    assert limited(b"more") is True
    assert written == [b"1234", b"more"]
    assert refused == ["5 bytes are over max_size 4"]


def test_a_sample_that_the_middleware_refuses_costs_no_token():
    answers = [False, False, True]
    limiter = Settings([Rule(max_rate=1.0)], lambda: 0.0).limiter
    assert [
        limiter.write(memoryview(b"x"), lambda sample: answers.pop(0), print) for _ in range(4)
    ] == [False, False, True, False]


def test_without_limits_there_is_no_limiter():
    assert Settings([Rule(domain=3)]).limiter is None


@pytest.mark.parametrize(
    "text, message",
    [
        ("[[client]]\nname = 'x'", "a rule has no 'name'"),
        ("[[client]]\nnamspace = 'x'", "did you mean 'namespace'?"),
        ("[client]\ndomain = 1", "two brackets"),
        ("", "there is no [[client]] table"),
        ("[[clients]]\ndomain = 1", "did you mean 'client'?"),
        ("[[client]]\nkey = 1", "it does nothing"),
        ("[[client]]\ndomain = 1\n[[client]]\ndomain = 233", "number 2: domain is 233"),
        ("[[client]]\ndomain = true", "domain is True, not a whole number from 0 to 232"),
        ("[[client]]\nkey = 'abc'\ndomain = 1", "0x4B0CBE99"),
        ("[[client]]\nnamespace = '1x'", "'1x' is no ROS name"),
        (f"[[client]]\nnamespace = '/{'n' * 245}'", "has 246 characters, and 245 are the most"),
        ("[[client]]\nnamespace = 5", "5 is no ROS name"),
        ("[[client]]\nremap = 5", "remap is 5, not a table"),
        ("[[client]]\nremap = { a = 'b c' }", "'b c' is no ROS name"),
        ("[[client]]\naddress = '10.0.0.0/33'\ndomain = 1", "'10.0.0.0/33', which is no network"),
        ("[[client]]\nmax_rate = 0", "max_rate is 0"),
        ("[[client]]\nmax_rate = inf", "max_rate is inf"),
        ("[[client]]\nmax_size = 0", "max_size is 0"),
        ("[[client]]\nqos.'/x'.depth = 0", "depth is 0, not a whole number from 1"),
        ("[[client]]\nqos.'/x'.reliability = 'good'", "is 'good', not reliable or best_effort"),
        ("[[client]]\nqos.'/x'.relibility = 'reliable'", "did you mean 'reliability'?"),
        ("[[client]\n", "no TOML"),
        ("a = [" + "[" * 5000, "no TOML"),
        (f"[[client]]\ndomain = {'9' * 5000}", "no TOML"),
        (f"[[client]]\ndomain = 0x{'f' * 5000}", "domain is a very long number, not a whole"),
        (f"[[client]]\nnode = 'n'\nnamespace = '/{'-' * 5000}'", "-... is no ROS name"),
    ],
)  # fmt: skip
def test_errors_in_a_file_are_named(text, message, tmp_path):
    with pytest.raises(ConfigError, match="control.toml: ") as caught:
        load_rules(text, tmp_path)
    assert message in str(caught.value)


def test_a_file_that_cannot_be_read(tmp_path):
    with pytest.raises(ConfigError, match="No such file"):
        Rules().load(tmp_path / "none.toml")
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(ConfigError, match="no TOML"):
        Rules().load(tmp_path / "bytes.toml")
    (tmp_path / "large.toml").write_bytes(b"#" * (1 << 21))
    with pytest.raises(ConfigError, match="over 1048576 bytes"):
        Rules().load(tmp_path / "large.toml")
    with pytest.raises(ConfigError, match="over 1048576 bytes"):
        Rules().load("/dev/zero")


_ANY = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["/a", "depth", "reliability", ""]), inner, max_size=3)
    ),
    max_leaves=6,
)
_WORDS = ["key", "address", "node", "domain", "namespace", "remap", "qos", "max_rate", "max_size"]


@given(st.dictionaries(st.sampled_from([*_WORDS, "x"]), _ANY, max_size=5))
def test_any_table_is_a_rule_or_is_refused(table):
    try:
        rule = parse_rule(table)
    except ConfigError:
        return
    settings = Settings([rule])
    assert rule.matches(1, "10.0.0.1:7", "/n") in (True, False)
    settings.apply(QoSProfile(), "rt/a")
    assert settings.topic("rt/a").startswith("rt/")
