"""The classes of boards, on CPython: octets equal to those of hosts and rosbags, both ways."""

import importlib
import random
import sys

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.examples import examples
from unit.interfaces import samples

from uros.interfaces import InterfaceError, load, registry, write_package
from uros.interfaces.codec import from_cdr, to_cdr
from uros.interfaces.runtime import Message

NAMES = [n for n in samples.messages() if "/msg/" in n and "WString" not in n]
_classes = {}


@pytest.fixture(scope="module", autouse=True)
def package(tmp_path_factory):
    """Writes all packaged messages as for a board, and imports them without uros.interfaces."""
    folder = tmp_path_factory.mktemp("board")
    before = set(sys.modules)
    write_package(NAMES, folder)
    sys.path.insert(0, str(folder))
    try:
        for name in NAMES:
            package, kind, plain = name.split("/")
            _classes[name] = getattr(importlib.import_module(f"{package}.{kind}"), plain)
        yield
    finally:
        sys.path.remove(str(folder))
        for name in set(sys.modules) - before:
            if name.partition(".")[0].endswith(("_msgs", "_interfaces")):
                del sys.modules[name]


def as_board(value):
    """Return a host's message as a message of the board's class."""
    if isinstance(value, list):
        return [as_board(item) for item in value]
    if not isinstance(value, Message):
        return value
    return _classes[value._TYPE](**{n: as_board(getattr(value, n)) for n in value.__slots__})


@pytest.mark.parametrize("name", NAMES)
def test_as_a_host(name):
    rng = random.Random(name)
    cls = _classes[name]
    reused = cls()
    for _ in range(examples(6)):
        host = samples.message(name, rng)
        want = to_cdr(host)
        msg = as_board(host)
        assert to_cdr(msg) == want
        assert msg.cdr_size() == len(want) - 4
        assert repr(msg) == repr(host)
        assert from_cdr(cls, want) == msg
        assert reused.unpack_into(want, 4, 4, len(want)) == len(want)
        assert reused == msg
        assert to_cdr(reused) == want
        oracle = samples.oracle_name(registry.message(name))
        big = samples.store().serialize_cdr(samples.as_oracle(host), oracle, little_endian=False)
        assert from_cdr(cls, bytes(big)) == msg
        host_reused = load(name)()
        assert host_reused.unpack_into(want, 4, 4, len(want)) == len(want)
        assert host_reused == host


@pytest.mark.parametrize("name", NAMES)
def test_offsets_stale_buffers_and_truncation(name):
    msg = as_board(samples.message(name, random.Random(name)))
    cls = type(msg)
    want = to_cdr(msg)[4:]
    for offset in (1, 3, 8):
        end = offset + len(want)
        buf = bytearray(b"\xaa" * (end + 5))
        assert msg.pack_into(memoryview(buf), offset, offset) == end
        assert bytes(buf[offset:]) == want + b"\xaa" * 5
        assert cls.unpack_from(buf, offset, offset, end) == (msg, end)
    reused = cls()
    for room in range(0, len(want), 1 + len(want) // 100):
        with pytest.raises(InterfaceError, match=f"needs {len(want)} octets"):
            msg.pack_into(bytearray(room), 0, 0)
        for buf, end in ((want[:room], len(want)), (want, room)):
            with pytest.raises(InterfaceError):
                cls.unpack_from(buf, 0, 0, end)
            with pytest.raises(InterfaceError):
                reused.unpack_into(buf, 0, 0, end)
        reused.cdr_size()  # still a valid message


@settings(max_examples=examples(300), deadline=None)
@given(st.sampled_from(NAMES), st.binary(max_size=200), st.booleans(), st.booleans())
def test_random_bytes(name, data, little, again):
    """Random octets raise InterfaceError only, and leave a valid message."""
    msg = _classes[name]()
    try:
        msg.unpack_into(data, 0, 0, len(data), little)
        if again:
            msg.unpack_into(data[::-1], 0, 0, len(data), little)
    except InterfaceError:
        pass
    assert to_cdr(type(msg).unpack_from(to_cdr(msg), 4, 4, 4 + msg.cdr_size())[0]) == to_cdr(msg)


@settings(max_examples=examples(100), deadline=None)
@given(st.integers(-(2**31), 2**31 - 1), st.integers(0, 2**32 - 1))
def test_seconds_in_halves(sec, nanosec):
    for cls in (_classes["builtin_interfaces/msg/Time"], load("builtin_interfaces/Time")):
        time = cls(sec, nanosec)
        assert (time.sec, time.high, time.low) == (sec, sec >> 16, sec & 0xFFFF)
        data = to_cdr(time)
        assert from_cdr(cls, data) == time
        for first, second in (("high", "low"), ("low", "high")):
            copy = cls(1700000000)
            setattr(copy, first, getattr(time, first))
            setattr(copy, second, getattr(time, second))
            assert copy.sec == sec


def test_unpack_into_keeps_the_objects_of_a_message():
    imu = _classes["sensor_msgs/msg/Imu"]
    source = imu()
    source.header.frame_id = "a frame of some length"
    source.angular_velocity.y = 2.5
    source.orientation_covariance[8] = 1.5
    data = to_cdr(source)
    msg = imu()
    msg.header.frame_id = bytes("a frame of some length", "ascii").decode()
    before = [
        msg.header, msg.header.stamp, msg.header.frame_id, msg.angular_velocity,
        msg.orientation_covariance,
    ]  # fmt: skip
    msg.unpack_into(data, 4, 4, len(data))
    assert msg == source
    after = [
        msg.header, msg.header.stamp, msg.header.frame_id, msg.angular_velocity,
        msg.orientation_covariance,
    ]  # fmt: skip
    assert all(a is b for a, b in zip(before, after, strict=True))


def test_fixed_arrays_of_doubles_are_packed_from_many_types():
    from array import array

    imu = _classes["sensor_msgs/msg/Imu"]
    values = [float(i) for i in range(9)]
    want = to_cdr(imu(orientation_covariance=values))
    for covariance in (
        values, tuple(values), array("d", values), array("f", values), array("q", range(9)),
        imu(orientation_covariance=values).orientation_covariance, range(9),
    ):  # fmt: skip
        msg = imu()
        msg.orientation_covariance = covariance
        assert to_cdr(msg) == want
    msg.orientation_covariance = [0.0] * 8
    with pytest.raises(InterfaceError, match="orientation_covariance: 8 elements, only 9"):
        to_cdr(msg)
    msg.orientation_covariance = _classes["nav_msgs/msg/Odometry"]().pose.covariance
    with pytest.raises(InterfaceError, match="orientation_covariance: 36 elements, only 9"):
        to_cdr(msg)
    with pytest.raises(TypeError):
        imu().orientation_covariance.append(1.0)
    for wrong in ("123456789", 5, None, [None] * 9):
        msg.orientation_covariance = wrong
        if wrong is not None:
            with pytest.raises(TypeError):
                to_cdr(msg)


@pytest.mark.parametrize(
    ("name", "field", "value", "error", "text"),
    [
        ("std_msgs/msg/Int32", "data", "5", TypeError, "data: expected int32, got str"),
        ("std_msgs/msg/Int32", "data", 2**31, InterfaceError, "out of range"),
        ("std_msgs/msg/String", "data", 5, TypeError, "data: expected string, got int"),
        ("geometry_msgs/msg/Twist", "linear", 5, TypeError, "expected geometry_msgs/Vector3"),
        ("sensor_msgs/msg/Imu", "header", None, TypeError, "expected std_msgs/Header"),
    ],
)
def test_errors_name_the_field(name, field, value, error, text):
    msg = _classes[name]()
    setattr(msg, field, value)
    with pytest.raises(error, match=text):
        to_cdr(msg)


def test_a_point_is_no_vector():
    twist = _classes["geometry_msgs/msg/Twist"]()
    twist.linear = _classes["geometry_msgs/msg/Point"]()
    with pytest.raises(TypeError, match="linear: expected geometry_msgs/Vector3"):
        to_cdr(twist)
    with pytest.raises(TypeError):
        twist.angular.x = "far"
    time = _classes["builtin_interfaces/msg/Time"](2**31)
    with pytest.raises(InterfaceError, match="Time.sec: 2147483648 is out of range"):
        to_cdr(time)
