"""Generated types, on a host and on a board: their octets are those of ROS 2.

The vectors are those of rclpy and rosbags. The tests use only what hosts and boards both have.
"""

# fmt: off
# ruff: noqa: I001
from support.portable import SINGLE_FLOATS, fits_single
from unit.interfaces import rclpy_vectors, vectors

try:
    from uros.interfaces.action_msgs.msg import GoalInfo, GoalStatus, GoalStatusArray
    from uros.interfaces.action_msgs.srv import CancelGoal
    from uros.interfaces.builtin_interfaces.msg import Duration, Time
    from uros.interfaces.geometry_msgs.msg import (
        Point, Pose, PoseArray, PoseStamped, PoseWithCovariance, Quaternion, Transform,
        TransformStamped, Twist, TwistWithCovariance, Vector3,
    )
    from uros.interfaces.lifecycle_msgs.msg import (
        State, Transition, TransitionDescription, TransitionEvent,
    )
    from uros.interfaces.lifecycle_msgs.srv import GetAvailableTransitions
    from uros.interfaces.nav_msgs.msg import Odometry, Path
    from uros.interfaces.rcl_interfaces.msg import (
        FloatingPointRange, IntegerRange, Log, Parameter, ParameterDescriptor, ParameterEvent,
        ParameterValue,
    )
    from uros.interfaces.rcl_interfaces.srv import DescribeParameters, SetParameters
    from uros.interfaces.sensor_msgs.msg import (
        BatteryState, CameraInfo, CompressedImage, Imu, JointState, LaserScan, NavSatFix,
        NavSatStatus, PointCloud2, PointField, RegionOfInterest, Temperature,
    )
    from uros.interfaces.std_msgs.msg import (
        Bool, Byte, Char, ColorRGBA, Empty, Float32MultiArray, Float64, Float64MultiArray, Header,
        Int32, Int8MultiArray, MultiArrayDimension, MultiArrayLayout, String, UInt64,
    )
    from uros.interfaces.std_srvs.srv import SetBool
    from uros.interfaces.test_msgs.action import Fibonacci, NestedMessage
    from uros.interfaces.test_msgs.msg import (
        Arrays, BasicTypes, BoundedPlainSequences, BoundedSequences, Builtins, Constants, Defaults,
        Nested, Strings, UnboundedSequences, WStrings,
    )
    from uros.interfaces.test_msgs.srv import BasicTypes as BasicTypesService
    from uros.interfaces.test_msgs.srv import Empty as EmptyService
    from uros.interfaces.unique_identifier_msgs.msg import UUID
except ImportError:  # MicroPython
    from action_msgs.msg import GoalInfo, GoalStatus, GoalStatusArray
    from action_msgs.srv import CancelGoal
    from builtin_interfaces.msg import Duration, Time
    from geometry_msgs.msg import (
        Point, Pose, PoseArray, PoseStamped, PoseWithCovariance, Quaternion, Transform,
        TransformStamped, Twist, TwistWithCovariance, Vector3,
    )
    from lifecycle_msgs.msg import State, Transition, TransitionDescription, TransitionEvent
    from lifecycle_msgs.srv import GetAvailableTransitions
    from nav_msgs.msg import Odometry, Path
    from rcl_interfaces.msg import (
        FloatingPointRange, IntegerRange, Log, Parameter, ParameterDescriptor, ParameterEvent,
        ParameterValue,
    )
    from rcl_interfaces.srv import DescribeParameters, SetParameters
    from sensor_msgs.msg import (
        BatteryState, CameraInfo, CompressedImage, Imu, JointState, LaserScan, NavSatFix,
        NavSatStatus, PointCloud2, PointField, RegionOfInterest, Temperature,
    )
    from std_msgs.msg import (
        Bool, Byte, Char, ColorRGBA, Empty, Float32MultiArray, Float64, Float64MultiArray, Header,
        Int32, Int8MultiArray, MultiArrayDimension, MultiArrayLayout, String, UInt64,
    )
    from std_srvs.srv import SetBool
    from test_msgs.action import Fibonacci, NestedMessage
    from test_msgs.msg import (
        Arrays, BasicTypes, BoundedPlainSequences, BoundedSequences, Builtins, Constants, Defaults,
        Nested, Strings, UnboundedSequences, WStrings,
    )
    from test_msgs.srv import BasicTypes as BasicTypesService
    from test_msgs.srv import Empty as EmptyService
    from unique_identifier_msgs.msg import UUID

MESSAGES = (
    GoalInfo, GoalStatus, GoalStatusArray, Duration, Time, Point, Pose, PoseArray, PoseStamped,
    PoseWithCovariance, Quaternion, Transform, TransformStamped, Twist, TwistWithCovariance,
    Vector3, State, Transition, TransitionDescription, TransitionEvent, Odometry, Path,
    FloatingPointRange, IntegerRange, Log, Parameter, ParameterDescriptor, ParameterEvent,
    ParameterValue, BatteryState, CameraInfo, CompressedImage, Imu, JointState, LaserScan,
    NavSatFix, NavSatStatus, PointCloud2, PointField, RegionOfInterest, Temperature, Bool, Byte,
    Char, ColorRGBA, Empty, Float32MultiArray, Float64, Float64MultiArray, Header, Int32,
    Int8MultiArray, MultiArrayDimension, MultiArrayLayout, String, UInt64, Arrays, BasicTypes,
    BoundedPlainSequences, BoundedSequences, Builtins, Constants, Defaults, Nested, Strings,
    UnboundedSequences, WStrings, UUID,
)
SERVICES = (
    CancelGoal, GetAvailableTransitions, DescribeParameters, SetParameters, SetBool,
    BasicTypesService, EmptyService,
)
ACTIONS = (
    Fibonacci, NestedMessage,
)


def structures():
    """Return the classes of all structures, by name as rclpy spells it for a field."""
    classes = list(MESSAGES)
    services = list(SERVICES)
    for action in ACTIONS:
        classes += [action.Goal, action.Result, action.Feedback, action.Impl.FeedbackMessage]
        services += [action.Impl.SendGoalService, action.Impl.GetResultService]
    for service in services:
        classes += [service.Request, service.Response]
    return {spelled(cls._TYPE): cls for cls in classes}


def spelled(name):
    """Return ``std_msgs/Header`` for ``std_msgs/msg/Header``; names of services keep ``srv/``."""
    package, kind, plain = name.split("/")
    return "%s/%s%s" % (package, "srv/" if kind == "srv" else "", plain)


CLASSES = structures()


def build(kind, values):
    """Return the message with a dict of values."""
    cls = CLASSES[kind]
    kinds = dict(cls._FIELDS)
    arguments = {}
    for name in values:
        value = values[name]
        inner = kinds[name]
        if isinstance(value, dict):
            value = build(inner, value)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            if inner.startswith("sequence<"):
                inner = inner[9:-1].split(",")[0]
            value = [build(inner.split("[")[0], item) for item in value]
        arguments[name] = value
    return cls(**arguments)


def packed(message):
    """Return the payload, packed at an odd offset of a buffer with stale octets."""
    size = message.cdr_size()
    buf = bytearray(b"\xaa" * (size + 10))
    assert message.pack_into(buf, 5, 5) == 5 + size
    assert bytes(buf[:5]) == b"\xaa" * 5 and bytes(buf[5 + size :]) == b"\xaa" * 5
    return bytes(buf[5 : 5 + size])


def agree(name, values, payload, padded):
    """Check that the message is packed to these octets and read from them."""
    kind = spelled(name)
    message = build(kind, values)
    want = bytes.fromhex(payload)
    octets = packed(message)
    if padded:
        assert not any(want[len(octets) :]), name
        want = want[: len(octets)]
    assert octets == want, (name, octets, want)
    again, end = CLASSES[kind].unpack_from(want, 0, 0, len(want))
    assert end == len(want), name
    assert again == message, (name, again, message)
    assert packed(again) == want, name


# Messages with default values that have many digits.
MANY_DIGITS = [
    "test_msgs/msg/" + name
    for name in ("Arrays", "BoundedSequences", "Defaults", "UnboundedSequences")
]


def test_octets_are_those_of_rclpy():
    count = 0
    for name, values, payload in rclpy_vectors.VECTORS:
        if not SINGLE_FLOATS or (fits_single(values) and name not in MANY_DIGITS):
            agree(name, values, payload, True)
            count += 1
    assert count > (30 if SINGLE_FLOATS else 50), count


def test_octets_are_those_of_rosbags():
    for name, values, payload in vectors.VECTORS:
        if not SINGLE_FLOATS or fits_single(values):
            agree(name, values, payload, False)


def test_a_message_that_ends_too_early_is_rejected():
    for name, values, _ in rclpy_vectors.VECTORS:
        message = build(spelled(name), values)
        octets = packed(message)
        for end in range(0, len(octets), 1 + len(octets) // 40):
            for length in (end, len(octets)):
                try:
                    type(message).unpack_from(octets[:length], 0, 0, end)
                except ValueError:
                    continue
                raise AssertionError((name, end, length))


def test_a_buffer_that_is_too_small_is_rejected():
    for name, values, _ in rclpy_vectors.VECTORS:
        message = build(spelled(name), values)
        size = message.cdr_size()
        for room in range(0, size, 1 + size // 20):
            try:
                message.pack_into(bytearray(room), 0, 0)
            except ValueError:
                continue
            raise AssertionError((name, room))


def test_damaged_octets_are_rejected_or_a_valid_message():
    """With any octet set to 255, as in a huge length, ValueError is the only exception."""
    for name, values, _ in rclpy_vectors.VECTORS:
        message = build(spelled(name), values)
        octets = bytearray(packed(message))
        for at in range(0, len(octets), 1 + len(octets) // 60):
            octet = octets[at]
            octets[at] = 255
            try:
                again = type(message).unpack_from(octets, 0, 0, len(octets))[0]
                assert again.cdr_size() > 0
            except ValueError:
                pass
            octets[at] = octet


def test_messages_are_compared_by_their_values():
    for name, values, _ in rclpy_vectors.VECTORS:
        kind = spelled(name)
        cls = CLASSES[kind]
        message = build(kind, values)
        assert message == build(kind, values)
        assert not message == Int32() or cls is Int32
        assert repr(message).startswith(cls._TYPE.replace("/", ".") + "("), repr(message)
    assert Int32(data=5) != Int32(data=6)


def test_names():
    for kind in CLASSES:
        cls = CLASSES[kind]
        package, folder, plain = cls._TYPE.split("/")
        assert cls.get_fields_and_field_types() == dict(cls._FIELDS)
        assert spelled("/".join((package, folder, plain))) == kind
    for whole in SERVICES + ACTIONS:
        assert whole._TYPE.split("/")[1] in ("srv", "action")


def test_an_action_has_all_its_structures():
    impl = Fibonacci.Impl
    assert impl.CancelGoalService is CancelGoal and impl.GoalStatusMessage is GoalStatusArray
    assert Fibonacci._TYPE == "test_msgs/action/Fibonacci"
    assert impl.SendGoalService._TYPE == "test_msgs/action/Fibonacci_SendGoal"
    request = impl.SendGoalService.Request(goal=Fibonacci.Goal(order=7))
    assert type(request.goal_id) is UUID and len(request.goal_id.uuid) == 16
    assert type(impl.SendGoalService.Response().stamp) is Time
    assert type(impl.GetResultService.Response().result) is Fibonacci.Result
    assert type(impl.FeedbackMessage().feedback) is Fibonacci.Feedback
    try:
        packed(impl.FeedbackMessage(feedback=Fibonacci.Goal()))
    except TypeError:
        return
    raise AssertionError("another section was taken")


def test_constants_and_defaults():
    assert GoalStatus.STATUS_SUCCEEDED == 4 and CancelGoal.Response.ERROR_REJECTED == 1
    assert (Constants.INT64_CONST, Constants.BOOL_CONST) == (-40000000, True)
    assert Strings.STRING_CONST == "Hello world!" and Log.FATAL == 50
    assert Quaternion().w == 1.0 and NavSatStatus().status == -2
    assert Defaults().uint64_value == 50000000
    assert Strings().string_value_default4 == "Hello'world!"
    first, second = Arrays(), Arrays()
    assert list(first.int16_values_default) == [0, 32767, -32768]
    first.int16_values_default[0] = 5
    first.string_values.append("more")
    assert second == Arrays() and first != second


def test_strings_are_octets_of_utf8_and_units_of_utf16():
    for text in ("", "a", "h\xe9", "\u6f22", "\U0001f600", "a" * 300):
        message = Strings(string_value=text)
        octets = packed(message)
        length = len(text.encode()) + 1
        assert octets[:4] == bytes((length & 255, length >> 8, 0, 0))
        assert octets[4 : 4 + length] == text.encode() + b"\0"
        wide = packed(WStrings(wstring_value=text))
        units = len(text) + (text > "\U00010000")
        assert wide[:4] == bytes((units & 255, units >> 8, 0, 0))
        assert WStrings.unpack_from(wide, 0, 0, len(wide))[0].wstring_value == text


def test_bounds_are_checked_both_ways():
    for cls, values in (
        (BoundedSequences, {"int32_values": [1] * 4}),
        (Strings, {"bounded_string_value": "x" * 23}),
        (WStrings, {"bounded_sequence_of_wstrings": ["", "", "", ""]}),
        (Arrays, {"uint8_values": b"1234"}),
        (Arrays, {"float64_values": [1.0] * 2}),
        (BasicTypes, {"int8_value": 128}),
        (Bool, {"data": 2}),
        (UInt64, {"data": -1}),
    ):
        try:
            packed(cls(**values))
        except ValueError:
            continue
        raise AssertionError(values)
    octets = bytearray(packed(Strings(bounded_string_value="x" * 22)))
    at = bytes(octets).find(b"xxx") - 4
    octets[at] = 200
    try:
        Strings.unpack_from(bytes(octets) + bytes(300), 0, 0, len(octets) + 300)
    except ValueError:
        return
    raise AssertionError("a bound was not held")


def test_big_endian_is_read():
    octets = bytes.fromhex("0a0b0c0d")
    assert Int32.unpack_from(octets, 0, 0, 4, False)[0].data == 0x0A0B0C0D
    octets = bytes.fromhex(
        "00000001 00000002 28000000 00000003 61620000 00000002 63000000 00000001 00000000"
        " 00000001 00000000 00000009"
    )
    message = Log.unpack_from(octets, 0, 0, len(octets), False)[0]
    assert (message.stamp.sec, message.stamp.nanosec, message.level) == (1, 2, 40)
    assert (message.name, message.msg, message.line) == ("ab", "c", 9)
    values = bytes.fromhex("3ff0000000000000 4000000000000000 4008000000000000")
    assert Vector3.unpack_from(values, 0, 0, 24, False)[0] == Vector3(x=1.0, y=2.0, z=3.0)
