"""Transforms as they go out, beside rosbags: there is no tf2_msgs for the rclpy that tests have.

The bytes compared with are rosbags' own, made by its definition of tf2_msgs/TFMessage.
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


def ours(sec, nanosec, frame, child, place, turn):
    it = TransformStamped()
    it.header.stamp.sec, it.header.stamp.nanosec = sec, nanosec
    it.header.frame_id, it.child_frame_id = frame, child
    vector, quaternion = it.transform.translation, it.transform.rotation
    vector.x, vector.y, vector.z = place
    quaternion.x, quaternion.y, quaternion.z, quaternion.w = turn
    return it


def theirs(sec, nanosec, frame, child, place, turn):
    stamp = TYPES["builtin_interfaces/msg/Time"](sec, nanosec)
    return TYPES["geometry_msgs/msg/TransformStamped"](
        TYPES["std_msgs/msg/Header"](stamp, frame),
        child,
        TYPES["geometry_msgs/msg/Transform"](
            TYPES["geometry_msgs/msg/Vector3"](*place),
            TYPES["geometry_msgs/msg/Quaternion"](*turn),
        ),
    )


def cdr_of(all_of_them):
    """rosbags' bytes, without the encapsulation header."""
    message = TYPES["tf2_msgs/msg/TFMessage"]([theirs(*it) for it in all_of_them])
    return bytes(STORE.serialize_cdr(message, "tf2_msgs/msg/TFMessage"))[4:]


@given(TRANSFORMS, st.integers(0, 9))
def test_the_bytes_are_rosbags(all_of_them, offset):
    message = Transforms([ours(*it) for it in all_of_them])
    expected = cdr_of(all_of_them)
    assert message.cdr_size() == len(expected)
    buf = bytearray(b"\xaa" * (offset + len(expected) + 8))
    assert message.pack_into(buf, offset, offset) == offset + len(expected)
    assert buf[offset : offset + len(expected)] == expected
    assert buf[offset + len(expected) :] == b"\xaa" * 8


def test_the_type_is_that_of_the_definition():
    cls = load("tf2_msgs/msg/TFMessage")
    assert (Transforms._TYPE, Transforms._DDS_TYPE) == (cls._TYPE, cls._DDS_TYPE)


@pytest.mark.parametrize("broadcaster", [TransformBroadcaster, StaticTransformBroadcaster])
def test_generated_transforms_are_sent(broadcaster):
    values = [
        (1_700_000_000, 5, "map", "odom", (1.5, -2.5, 1e300), (0.0, 0.0, 0.0, 1.0)),
        (1_700_000_001, 999_999_999, "odom", "base_link", (0.0, 0.1, 0.2), (0.5, 0.5, 0.5, 0.5)),
    ]
    bench = Bench(connect=False)
    one = broadcaster(bench.node)
    bench.connect()
    assert one.sendTransform([ours(*it) for it in values])
    bench.run(50)
    thing = one.publisher.object_id(ids.KIND_DATAWRITER)
    assert [bytes(it) for number, it in bench.agent.samples if number == thing] == [cdr_of(values)]
