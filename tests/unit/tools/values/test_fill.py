import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uros.interfaces import load
from uros.interfaces.codec import to_cdr
from uros.tools.errors import ToolError
from uros.tools.values import plain
from uros.tools.values.fill import Filled
from uros.tools.values.yaml_text import dump


def filled(type_name, text):
    return Filled(load(type_name), text).message


@pytest.mark.parametrize(
    "text, value",
    [
        ("data: 0", False), ("data: 1", True), ("{data: true}", True), ("data: no", False),
        ("data: 'true'", True), ("data: OFF", False),
    ],
)  # fmt: skip
def test_bool(text, value):
    assert filled("std_msgs/Bool", text).data is value


@pytest.mark.parametrize(
    "type_name, text, value",
    [
        ("Int32", "data: 1", 1),
        ("Int32", "data: '1'", 1),
        ("Int32", "data: 2.0", 2),
        ("Int64", "data: -9223372036854775808", -(2**63)),
        ("UInt8", "data: 0xff", 255),
        ("Byte", "data: 7", 7),
        ("Byte", "data: 'a'", 97),
        ("Byte", "data: '7'", 55),
        ("Float64", "data: 1", 1.0),
        ("Float64", "data: 1e-3", 0.001),
        ("Float64", "data: .inf", math.inf),
        ("Float32", "data: -1.5", -1.5),
        ("String", "data: Hello World", "Hello World"),
        ("String", "data: 007", "007"),
        ("String", "data: yes", "yes"),
        ("String", "data: 1.0", "1.0"),
        ("String", "data: ''", ""),
        ("String", "data:", ""),
        ("String", "data: |\n  two\n  lines", "two\nlines"),
        ("String", "data: two\n  lines", "two lines"),
        ("UInt8MultiArray", "data: [1, 2]", [1, 2]),
        ("Float32MultiArray", "data: [1, .5]", [1.0, 0.5]),
    ],
)
def test_scalars(type_name, text, value):
    data = filled(f"std_msgs/{type_name}", text).data
    assert data == value and type(data) is type(value)


def test_nested_fields_and_defaults():
    twist = filled("geometry_msgs/Twist", "{linear: {x: 0.2}}")
    assert (twist.linear.x, twist.linear.y, twist.angular.z) == (0.2, 0.0, 0.0)
    assert filled("geometry_msgs/Quaternion", "").w == 1.0  # the definition's default
    array = filled("std_msgs/Int8MultiArray", "{layout: {dim: [{label: a, size: 3}, {}]}}")
    assert [(dimension.label, dimension.size) for dimension in array.layout.dim] == [
        ("a", 3),
        ("", 0),
    ]


@pytest.mark.parametrize(
    "type_name, text, said",
    [
        ("std_msgs/Bool", "data: 2", "Bool.data takes true or false, 1 or 0 (bool), not 2"),
        ("std_msgs/Bool", "data: [1]", "not [1]"),
        ("std_msgs/UInt8", "data: 256", "a whole number from 0 to 255 (uint8), not 256"),
        ("std_msgs/UInt8", "data: 1.5", "not 1.5"),
        ("std_msgs/UInt8", "data: true", "not true"),
        ("std_msgs/UInt8", "data: ", "not nothing"),
        ("std_msgs/UInt8", "data: .inf", "not .inf"),
        ("std_msgs/UInt8", "{dat: 1}", "has no field 'dat'; it has data; did you mean 'data'?"),
        ("std_msgs/Float32", "data: much", "takes a number (float32), not much"),
        ("std_msgs/Float32", "data: 1e300", "a number that a float32 can hold, not 1e300"),
        ("std_msgs/String", "data: {a: 1}", "takes text (string)"),
        ("std_msgs/String", 'data: "a\\0b"', "cannot hold a NUL"),
        ("std_msgs/String", 'data: "\\ud800"', "no such character"),
        ("std_msgs/String", "just text", "the values are fields by name, such as {data: ...}"),
        ("std_msgs/String", "{data: 1", "the values are not YAML: line 1, column 9: the } is"),
        ("geometry_msgs/Twist", "linear: 1", "Twist.linear takes geometry_msgs/Vector3 in braces"),
        ("geometry_msgs/Twist", "linear: {w: 1}", "Twist.linear has no field 'w'"),
        ("std_msgs/Header", "stamp: later", "in braces (sec, nanosec), or now, not later"),
        ("geometry_msgs/PoseStamped", "header: car", "(stamp, frame_id), or auto, not car"),
        ("nav_msgs/Odometry", "pose: {covariance: [1]}", "pose.covariance takes 36 elements"),
        ("std_msgs/UInt8MultiArray", "data: abc", "takes a list in brackets (sequence<uint8>)"),
        ("std_msgs/UInt8MultiArray", "data: [1, 300]", "data[1] takes a whole number"),
        ("test_msgs/BoundedSequences", "bool_values: [1, 1, 1, 1]", "at most 3 elements, not 4"),
        ("test_msgs/Strings", "bounded_string_value: " + "x" * 23, "takes text of at most 22"),
        ("std_msgs/Empty", "a: 1", "has no field 'a'; it has none"),
        ("std_msgs/Empty", "[]", "such as {}, not []"),
    ],
)  # fmt: skip
def test_invalid_values_are_reported_with_their_field(type_name, text, said):
    with pytest.raises(ToolError) as refused:
        filled(type_name, text)
    assert said in str(refused.value)


def test_the_time_is_set_each_time():
    one = Filled(load("geometry_msgs/TwistStamped"), "{header: auto, twist: {linear: {x: 1}}}")
    for ns in (1_500_000_000, 7_000_000_001):
        one.stamp(ns)
        stamp = one.message.header.stamp
        assert stamp.sec * 10**9 + stamp.nanosec == ns
    other = Filled(load("std_msgs/Header"), "{stamp: now, frame_id: auto}")
    other.stamp(5)
    assert other.message.stamp.nanosec == 5 and other.message.frame_id == "auto"


def test_a_list_of_messages_has_a_value_for_each():
    path = Filled(load("nav_msgs/Path"), "{poses: [{header: auto}, {}, {header: {frame_id: b}}]}")
    path.stamp(3)
    assert [pose.header.stamp.nanosec for pose in path.message.poses] == [3, 0, 0]
    assert [pose.header.frame_id for pose in path.message.poses] == ["", "", "b"]


# What PyYAML writes of U+0085 is not what it reads, and topic echo prints what it writes. Bytes
# are printed as characters.
TEXT = st.text(st.characters(codec="utf-8", exclude_characters="\0\x85"), max_size=12)
FLOATS = st.floats(allow_nan=False)


@given(
    st.builds(
        load("test_msgs/UnboundedSequences"),
        bool_values=st.lists(st.booleans(), max_size=3),
        byte_values=st.lists(st.integers(0, 255).filter(lambda value: value != 0x85), max_size=3),
        float32_values=st.lists(st.floats(width=32, allow_nan=False), max_size=3),
        float64_values=st.lists(FLOATS, max_size=3),
        int8_values=st.lists(st.integers(-128, 127), max_size=3),
        uint64_values=st.lists(st.integers(0, 2**64 - 1), max_size=3),
        string_values=st.lists(TEXT, max_size=3),
    )
    | st.builds(load("test_msgs/WStrings"), wstring_value=TEXT)
    | st.builds(
        load("geometry_msgs/PointStamped"),
        point=st.builds(load("geometry_msgs/Point"), x=FLOATS, y=FLOATS, z=FLOATS),
    )
)
def test_output_of_echo_can_be_published(message):
    text = dump(plain.plain(message, plain.Show(truncate=None)))
    assert to_cdr(Filled(type(message), text).message) == to_cdr(message)
