"""DDS names as ROS names: every text is a name or raises MiddlewareError."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uros.middleware import ros_names
from uros.middleware.base import MiddlewareError, Service
from uros.middleware.ros_names import TypeName
from uros.middleware.services import names

BASE = "std_srvs::srv::dds_::Trigger_"


def service(request="rq/xRequest", request_type=BASE + "Request_", reply="rr/xReply",
            reply_type=BASE + "Response_"):  # fmt: skip
    return Service(request, request_type, reply, reply_type)


@pytest.mark.parametrize(
    ("topic", "name"),
    [("rt/chatter", "/chatter"), ("rt/a/b_1/_c", "/a/b_1/_c"), ("rt/rt/x", "/rt/x")],
)
def test_topics(topic, name):
    assert ros_names.topic_name(topic) == name


@pytest.mark.parametrize(
    "topic",
    ["", "rt", "rt/", "chatter", "/chatter", "rq/chatter", "rt//x", "rt/1x", "rt/x/", "rt/a-b",
     "rt/~", "rt/{node}", "rt/x\n", "rt/é", "rt/" + "x" * 300],
)  # fmt: skip
def test_names_that_are_no_topic_of_ros(topic):
    with pytest.raises(MiddlewareError, match="is no ROS topic .rt/….*-m dds") as error:
        ros_names.topic_name(topic)
    assert len(str(error.value)) < 500


def test_services():
    service_names = service("rq/arm/homeRequest", reply="rr/arm/homeReply")
    assert names.service_name(service_names) == "/arm/home"
    assert names.service_type(service_names) == TypeName("std_srvs", "srv", "Trigger")
    assert str(names.service_type(service_names)) == "std_srvs/srv/Trigger"


@pytest.mark.parametrize(
    "service_topics",
    [
        service(request="rq/x"), service(request="rqRequest"), service(request="rt/xRequest"),
        service(reply="rr/yReply"), service(reply="rr/xRequest"), service(request="rq/Request"),
    ],
)  # fmt: skip
def test_topics_that_are_of_no_service(service_topics):
    with pytest.raises(MiddlewareError, match="is no ROS topic|are not of one service"):
        names.service_name(service_topics)


@pytest.mark.parametrize(
    "service_types",
    [
        service(request_type=BASE), service(reply_type=BASE),
        service(reply_type=BASE + "Request_"),
        service(reply_type="std_srvs::srv::dds_::SetBool_Response_"),
        service(request_type="std_srvs::msg::dds_::Trigger_Request_",
                reply_type="std_srvs::msg::dds_::Trigger_Response_"),
    ],
)  # fmt: skip
def test_types_that_are_of_no_service(service_types):
    with pytest.raises(MiddlewareError, match="are not of one ROS service"):
        names.service_type(service_types)


@pytest.mark.parametrize(
    ("type_name", "expected"),
    [
        ("std_msgs::msg::dds_::String_", ("std_msgs", "msg", "String")),
        ("a1::action::dds_::Go_FeedbackMessage_", ("a1", "action", "Go_FeedbackMessage")),
    ],
)
def test_types(type_name, expected):
    assert ros_names.message_type(type_name) == expected


@pytest.mark.parametrize(
    "type_name",
    ["", "String", "std_msgs/msg/String", "std_msgs::msg::String_", "std_msgs::msg::dds_::String",
     "os.path::msg::dds_::X_", "../x::msg::dds_::X_", "std_msgs::idl::dds_::X_",
     "x::msg::dds_::__class___", "a::msg::dds_::" + "X" * 300 + "_"],
)  # fmt: skip
def test_names_that_are_no_type_of_ros(type_name):
    with pytest.raises(MiddlewareError, match="is no ROS type") as error:
        ros_names.message_type(type_name)
    assert len(str(error.value)) < 500


@given(st.text(), st.sampled_from(["", "rt/", "rq/", "rr/"]), st.sampled_from(["", "Request"]))
def test_any_text_is_a_topic_or_refused(text, prefix, suffix):
    topic = prefix + text + suffix
    try:
        name = ros_names.topic_name(topic)
    except MiddlewareError:
        return
    assert "rt" + name == topic
    assert all(part.isidentifier() and part.isascii() for part in name[1:].split("/"))


@given(
    st.text() | st.from_regex(r"[a-z_.:]+::(msg|srv|action)::dds_::\w+_"),
    st.sampled_from(["", "Request_", "Response_"]),
)
def test_any_text_is_a_type_or_refused(text, suffix):
    try:
        type_name = ros_names.message_type(text + suffix)
    except MiddlewareError:
        return
    assert f"{type_name.package}::{type_name.kind}::dds_::{type_name.name}_" == text + suffix
    assert all(part.isidentifier() and part.isascii() for part in type_name)
