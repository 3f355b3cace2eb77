"""Sent transforms compared with the bytes of rosbags.

The rclpy of the tests has no tf2_msgs; rosbags encodes its own definition of tf2_msgs/TFMessage.
"""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore
from support.services import Bench

from uros.client.tf import StaticTransformBroadcaster, TransformBroadcaster, Transforms
from uros.interfaces import load
from uros.wire import ids

TransformStamped = load("geometry_msgs/msg/TransformStamped")
STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES = STORE.types

NUMBER = st.floats(allow_nan=False)
NAME = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=9)
TRANSFORMS = st.lists(
    st.tuples(
        st.integers(0, 2**31 - 1), st.integers(0, 999_999_999), NAME, NAME,
        st.tuples(NUMBER, NUMBER, NUMBER), st.tuples(NUMBER, NUMBER, NUMBER, NUMBER),
    ),
    max_size=4,
)  # fmt: skip


def transform_of(sec, nanosec, frame, child, place, turn):
    transform = TransformStamped()
    transform.header.stamp.sec, transform.header.stamp.nanosec = sec, nanosec
    transform.header.frame_id, transform.child_frame_id = frame, child
    vector, quaternion = transform.transform.translation, transform.transform.rotation
    vector.x, vector.y, vector.z = place
    quaternion.x, quaternion.y, quaternion.z, quaternion.w = turn
    return transform


def rosbags_transform_of(sec, nanosec, frame, child, place, turn):
    stamp = TYPES["builtin_interfaces/msg/Time"](sec, nanosec)
    return TYPES["geometry_msgs/msg/TransformStamped"](
        TYPES["std_msgs/msg/Header"](stamp, frame),
        child,
        TYPES["geometry_msgs/msg/Transform"](
            TYPES["geometry_msgs/msg/Vector3"](*place),
            TYPES["geometry_msgs/msg/Quaternion"](*turn),
        ),
    )


def cdr_of(transforms):
    """Return the bytes of rosbags, without the encapsulation header."""
    message = TYPES["tf2_msgs/msg/TFMessage"](
        [rosbags_transform_of(*values) for values in transforms]
    )
    return bytes(STORE.serialize_cdr(message, "tf2_msgs/msg/TFMessage"))[4:]


@given(TRANSFORMS, st.integers(0, 9))
def test_the_bytes_are_those_of_rosbags(transforms, offset):
    message = Transforms([transform_of(*values) for values in transforms])
    expected = cdr_of(transforms)
    assert message.cdr_size() == len(expected)
    buf = bytearray(b"\xaa" * (offset + len(expected) + 8))
    assert message.pack_into(buf, offset, offset) == offset + len(expected)
    assert buf[offset : offset + len(expected)] == expected
    assert buf[offset + len(expected) :] == b"\xaa" * 8


def test_the_type_names_are_those_of_the_definition():
    cls = load("tf2_msgs/msg/TFMessage")
    assert (Transforms._TYPE, Transforms._DDS_TYPE) == (cls._TYPE, cls._DDS_TYPE)


@pytest.mark.parametrize("broadcaster", [TransformBroadcaster, StaticTransformBroadcaster])
def test_generated_transforms_are_sent(broadcaster):
    values = [
        (1_700_000_000, 5, "map", "odom", (1.5, -2.5, 1e300), (0.0, 0.0, 0.0, 1.0)),
        (1_700_000_001, 999_999_999, "odom", "base_link", (0.0, 0.1, 0.2), (0.5, 0.5, 0.5, 0.5)),
    ]
    bench = Bench(connect=False)
    sender = broadcaster(bench.node)
    bench.connect()
    assert sender.sendTransform([transform_of(*transform) for transform in values])
    bench.run(50)
    writer_id = sender.publisher.object_id(ids.KIND_DATAWRITER)
    assert [bytes(octets) for number, octets in bench.agent.samples if number == writer_id] == [
        cdr_of(values)
    ]
