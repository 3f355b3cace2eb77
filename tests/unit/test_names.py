import pytest

from uros import names


@pytest.mark.parametrize(
    "ros, dds",
    [("/chatter", "rt/chatter"), ("/lab/arm/joint_states", "rt/lab/arm/joint_states")],
)
def test_topics(ros, dds):
    assert names.topic_from_dds(dds) == ros
    assert names.topic_to_dds(ros) == dds
    assert names.topic_to_dds(ros[1:]) == dds


@pytest.mark.parametrize("dds", ["chatter", "ros_discovery_info", "rq/goRequest", "rtx/y", ""])
def test_names_that_are_no_topics(dds):
    assert names.topic_from_dds(dds) is None


@pytest.mark.parametrize(
    "dds, parts",
    [
        ("rt/a/b", ("rt", "/a/b", "")),
        ("rq/goRequest", ("rq", "/go", "Request")),
        ("rr/goReply", ("rr", "/go", "Reply")),
        ("rq/goReply", ("rq", "/goReply", "")),
        ("rq/Request", ("rq", "/", "Request")),
        ("ra/x", ("ra", "/x", "")),
        ("rt/", ("rt", "/", "")),
        ("rt", None),
        ("rtx/y", None),
        ("/rt/a", None),
        ("", None),
    ],
)
def test_prefix_name_and_suffix(dds, parts):
    assert names.split_dds(dds) == parts


@pytest.mark.parametrize(
    "name, why",
    [
        ("/a/b_1/_c", ""),
        ("", "begin"),
        ("a", "begin"),
        ("/", "ends"),
        ("/a/", "ends"),
        ("/a-b", "'-'"),
        ("/~/a", "'~'"),
        ("/..", "'.'"),
        ("/a//b", "two slashes"),
        ("/a/1b", "digit"),
        ("/" + "a" * 246, ""),
        ("/" + "a" * 247, "247 are the most"),
    ],
)
def test_why_ros_refuses_a_name(name, why):
    assert why in names.fault(name)
    assert bool(why) == bool(names.fault(name))


def test_services():
    assert names.service_from_request("rq/lab/goRequest") == "/lab/go"
    assert names.service_from_reply("rr/lab/goReply") == "/lab/go"
    assert names.service_from_request("rr/lab/goReply") is None
    assert names.service_from_reply("rq/lab/goRequest") is None
    assert names.service_from_request("rq/lab/go") is None


@pytest.mark.parametrize(
    "dds, ros",
    [
        ("std_msgs::msg::dds_::String_", "std_msgs/msg/String"),
        ("std_srvs::srv::dds_::Empty_Request_", "std_srvs/srv/Empty_Request"),
        ("a::b::c::dds_::T_", "a/b/c/T"),
        ("HelloWorld", "HelloWorld"),
        ("std_msgs::msg::String", "std_msgs::msg::String"),
    ],
)
def test_types_from_dds(dds, ros):
    assert names.type_from_dds(dds) == ros


@pytest.mark.parametrize(
    "ros, dds",
    [
        ("std_msgs/msg/String", "std_msgs::msg::dds_::String_"),
        ("std_msgs/String", "std_msgs::msg::dds_::String_"),
        ("std_srvs/srv/Empty_Request", "std_srvs::srv::dds_::Empty_Request_"),
        ("HelloWorld", "HelloWorld"),
        ("my::Type", "my::Type"),
    ],
)
def test_types_to_dds(ros, dds):
    assert names.type_to_dds(ros) == dds


def test_service_types():
    assert (
        names.service_type_from_dds("std_srvs::srv::dds_::Empty_Request_") == "std_srvs/srv/Empty"
    )
    assert names.service_type_from_dds("std_srvs::srv::dds_::Empty_Response_") == (
        "std_srvs/srv/Empty"
    )


def test_hidden_and_valid():
    assert names.is_hidden("/_uros_1") and names.is_hidden("/fib/_action/feedback")
    assert not names.is_hidden("/a_b/c_")
    assert names.is_hidden_node("/lab/_x") and not names.is_hidden_node("/_lab/x")
    assert names.is_valid("/a/b_1")
    for bad in ("/", "a", "/a/", "/a//b", "/1a", "/a b", "/a__b", "/ä", "/~x", ""):
        assert not names.is_valid(bad), bad


def test_node_names():
    assert names.join("/", "talker") == "/talker"
    assert names.join("/lab", "talker") == "/lab/talker"
    assert names.absolute("x") == names.absolute("/x") == "/x"
