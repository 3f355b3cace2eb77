"""The generated codecs: octets equal to those of rosbags; malformed octets and invalid values."""

import ast
import random
from array import array

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import get_types_from_msg
from support.examples import examples
from support.variants import slow_except
from unit.interfaces import samples
from unit.interfaces.vectors import VECTORS, build

from uros.interfaces import InterfaceError, add_folder, load, registry
from uros.interfaces.codec import from_cdr, to_cdr
from uros.interfaces.emit import RUN_VALUES, UNROLL
from uros.interfaces.generate import generate
from uros.interfaces.layout import INLINE_LEAVES

INNER = "uint8 a\nfloat64 b\n"
MIXED = """
uint8 a
float64 b
uint8[] c
float64[] d
uint16 e
Inner[] f
Inner[2] g
string[] h
bool[3] i
int64[<=4] j
string<=5[2] k
float32[50] l
int8[3] m
int16[] n
bool[] o
Inner p
uint8[5] q
string<=4 r
Inner[<=2] s
byte t
uint64 u
int8[] v
"""
# Too many fields to be inlined where it is nested; aligned to 8, and not a multiple of 8 long.
LARGE = "float64 first\n" + "".join(f"uint8 f{i}\n" for i in range(INLINE_LEAVES + 3))


def shuffled(number: int) -> str:
    """Return a random definition: the order of fields decides on padding and runs."""
    chance = random.Random(number)
    numbers = ["bool", "uint8", "int8", "uint16", "int16", "uint32", "float32", "float64", "int64"]
    fields = []
    for i in range(chance.randrange(3, 12)):
        kind = chance.choice([*numbers, "uint8", "string", "Inner", "Large", "Large", "Empty"])
        sizes = ["", "", "", "[]", "[<=3]", "[2]"]
        if kind in numbers:
            sizes += [f"[{UNROLL}]", f"[{UNROLL + 1}]", f"[{RUN_VALUES}]", f"[{RUN_VALUES + 1}]"]
        fields.append(f"{kind}{chance.choice(sizes)} f{i}\n")
    return "".join(fields)


SOURCES = {"Empty": "", "Inner": INNER, "Large": LARGE, "Mixed": MIXED}
SOURCES["Behind"] = (
    "uint8 a\nLarge b\nuint8 c\nLarge[2] d\nuint8 e\nLarge[] f\nfloat64 g\n"
    "uint8 h\nstring[2] i\nLarge j\nuint16 k\nLarge l\nfloat64 m\nLarge n\nstring o\n"
)
SOURCES.update({f"Shuffled{number}": shuffled(number) for number in range(40)})
CASES = [*samples.messages(), *(f"codec_cases/msg/{name}" for name in SOURCES)]
# For what takes long, each sixth type; the others are for make test-full.
SOME_CASES = slow_except(CASES, *CASES[::6])
# rosbags does not support wstring; test_wstring has vectors.
WIDE = ("example_interfaces/msg/WString", "test_msgs/msg/WStrings")


@pytest.fixture(scope="module", autouse=True)
def cases(tmp_path_factory):
    folder = tmp_path_factory.mktemp("x") / "codec_cases"
    folder.mkdir()
    for name, text in SOURCES.items():
        (folder / f"{name}.msg").write_text(text)
        samples.store().register(get_types_from_msg(text, f"codec_cases/msg/{name}"))
    add_folder(folder)


def oracle_bytes(msg, little=True):
    name = samples.oracle_name(registry.message(msg._TYPE))
    oracle = samples.as_oracle(msg)
    return bytes(samples.store().serialize_cdr(oracle, name, little_endian=little))


@pytest.mark.parametrize("name", [name for name in CASES if name not in WIDE])
def test_against_rosbags(name):
    rng = random.Random(name)
    for _ in range(examples(12)):
        msg = samples.message(name, rng)
        want = oracle_bytes(msg)
        assert to_cdr(msg) == want
        assert msg.cdr_size() == len(want) - 4
        assert from_cdr(load(name), want) == msg
        assert from_cdr(load(name), oracle_bytes(msg, little=False)) == msg
        assert to_cdr(from_cdr(load(name), want)) == want
        back = samples.store().deserialize_cdr(
            to_cdr(msg), samples.oracle_name(registry.message(name))
        )
        assert oracle_equal(back, samples.as_oracle(msg))


def test_no_call_has_too_many_arguments():
    """MicroPython passes 255 arguments at most, and the size of code is limited."""
    for name in ("Shuffled7", "Behind", "Large"):
        source = generate(registry.message(f"codec_cases/msg/{name}"), "uros.interfaces.")
        calls = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call)]
        packs = [call for call in calls if ast.unparse(call.func) == "pack_into"]
        assert max(len(call.args) for call in packs) <= RUN_VALUES + UNROLL + 3
    behind = generate(registry.message("codec_cases/msg/Behind"), "uros.interfaces.")
    assert "self.b.cdr_size(" in behind and "self.b.f0" not in behind


def oracle_equal(a, b):
    if hasattr(a, "__dataclass_fields__"):
        return all(oracle_equal(getattr(a, n), getattr(b, n)) for n in a.__dataclass_fields__)
    if isinstance(a, (list, np.ndarray)):
        return len(a) == len(b) and all(map(oracle_equal, a, b))
    return a == b


@pytest.mark.parametrize("name", SOME_CASES)
def test_offsets_and_stale_buffers(name):
    """Alignment counts from ``start``; padding is written, whatever the buffer held before."""
    msg = samples.message(name, random.Random(name))
    want = to_cdr(msg)[4:]
    for offset in (1, 3, 8):
        buf = bytearray(b"\xaa" * (offset + len(want) + 5))
        assert msg.pack_into(memoryview(buf), offset, offset) == offset + len(want)
        assert bytes(buf[offset:]) == want + b"\xaa" * 5
        end = offset + len(want)
        assert load(name).unpack_from(buf, offset, offset, end) == (msg, end)
    for room in range(0, len(want), 1 + len(want) // 400):
        buf = bytearray(room)
        with pytest.raises(
            InterfaceError, match=f"needs {len(want)} octets, the buffer has {room}"
        ):
            msg.pack_into(buf, 0, 0)
        assert len(buf) == room


@pytest.mark.parametrize("name", SOME_CASES)
def test_truncated(name):
    cls = load(name)
    data = to_cdr(samples.message(name, random.Random(name)))
    for end in range(0, len(data), 1 + len(data) // 2000):
        with pytest.raises(InterfaceError):
            from_cdr(cls, data[:end])


def attempt(cls, data):
    try:
        from_cdr(cls, data)
    except InterfaceError:
        pass


@settings(max_examples=examples(300), deadline=None)
@given(st.sampled_from(CASES), st.binary(max_size=200), st.booleans())
def test_random_bytes(name, data, little):
    """Random octets raise InterfaceError only."""
    attempt(load(name), bytes([0, little, 0, 0]) + data)


@pytest.mark.parametrize("name", SOME_CASES)
def test_mutated_bytes(name):
    rng = random.Random(name)
    cls = load(name)
    for _ in range(examples(40)):
        data = bytearray(to_cdr(samples.message(name, rng)))
        for _ in range(rng.randint(1, 4)):
            data[rng.randrange(len(data))] = rng.choice([0, 1, 0x7F, 0xFF, rng.randrange(256)])
        attempt(cls, bytes(data))


@pytest.mark.parametrize(
    "name", ["sensor_msgs/msg/Image", "nav_msgs/msg/Path", "sensor_msgs/msg/JointState"]
)
def test_huge_lengths(name):
    """A length is checked before memory is allocated for it."""
    data = bytearray(to_cdr(load(name)()))
    for at in range(4, len(data) - 3, 4):
        for length in (0x7FFFFFFF, 0xFFFFFFFF, 0x20000000):
            hostile = bytearray(data)
            hostile[at : at + 4] = length.to_bytes(4, "little")
            attempt(load(name), bytes(hostile))


@pytest.mark.parametrize(("name", "values", "payload"), VECTORS)
def test_vectors(name, values, payload):
    msg = build(name, values, load)
    assert to_cdr(msg)[4:].hex() == payload
    assert from_cdr(load(name), b"\0\1\0\0" + bytes.fromhex(payload)) == msg


@pytest.mark.parametrize(
    ("data", "fault"),
    [
        (b"", "0 octets are no CDR message"),
        (b"\0\1\0", "3 octets"),
        (b"\0\3\0\0" + b"\0" * 8, "encapsulation 00 03 is not supported"),
        (b"\0\7\0\0" + b"\0" * 8, "encapsulation 00 07"),
        (b"\1\1\0\0" + b"\0" * 8, "encapsulation 01 01"),
        (b"\0\1\0\0\5\0\0\0abcde", "does not end with NUL"),
        (b"\0\1\0\0\5\0\0\0abc\0", "std_msgs/msg/String: 5 octets needed at offset 8, 4 are left"),
    ],
)
def test_bad_messages(data, fault):
    with pytest.raises(InterfaceError, match=fault):
        from_cdr(load("std_msgs/msg/String"), data)


def test_tolerated():
    cls = load("std_msgs/msg/String")
    assert from_cdr(cls, b"\0\1\0\3\2\0\0\0a\0\0\0").data == "a"
    assert from_cdr(cls, b"\0\1\0\0\0\0\0\0").data == ""
    assert from_cdr(cls, b"\0\1\0\0\4\0\0\0a\xff\xfe\0").data == "a\ufffd\ufffd"
    assert from_cdr(cls, bytearray(b"\0\0\0\0\0\0\0\2a\0")).data == "a"


def test_wstring(tmp_path):
    """As rmw_fastrtps and rmw_cyclonedds write it: units of UTF-16, each in a uint32."""
    folder = tmp_path / "wide_cases"
    folder.mkdir()
    (folder / "Wide.msg").write_text("uint8 a\nwstring<=4 b\nwstring[] c\nuint8 d\nuint64 e\n")
    add_folder(folder)
    cls = load("wide_cases/Wide")
    msg = cls(1, "é😀", ["x"], 2, 3)
    data = to_cdr(msg)
    assert data[4:].hex(" ", -4) == (
        "01000000 03000000 e9000000 3dd80000 00de0000"
        " 01000000 01000000 78000000 02000000 00000000 03000000 00000000"
    )
    assert from_cdr(cls, data) == msg
    with pytest.raises(InterfaceError, match="Wide.b: length 5, at most 4"):
        to_cdr(cls(b="abcde"))
    with pytest.raises(InterfaceError, match="length 9, at most 4"):
        from_cdr(cls, b"\0\1\0\0" + b"\1\0\0\0\x09\0\0\0" + bytes(60))
    lone = bytes.fromhex("00010000 01000000 02000000 3dd80000 41000100" + "00" * 24)
    assert from_cdr(cls, lone).b == "\ufffd\ufffd"


MIXED_NAME = "codec_cases/msg/Mixed"


@pytest.mark.parametrize(
    ("name", "values", "fault"),
    [
        ("std_msgs/Int8", {"data": 128}, "Int8.data: 128 is out of range -128 to 127"),
        ("std_msgs/UInt64", {"data": -1}, "UInt64.data: -1 is out of range"),
        ("std_msgs/Bool", {"data": 2}, "Bool.data: 2 is out of range 0 to 1"),
        ("std_msgs/Float32", {"data": 1e39}, "Float32.data: 1e.39 is out of range of a float"),
        ("std_msgs/String", {"data": "\ud800"}, "String.data: the text has a lone surrogate"),
        ("std_msgs/Int16MultiArray", {"data": [0, 40000]}, r"data\[1\]: 40000 is out of range"),
        ("std_msgs/UInt8MultiArray", {"data": [0, 256]}, r"data\[1\]: 256 is out of range"),
        ("sensor_msgs/Imu", {"orientation_covariance": [0.0]}, "Imu.orientation_covariance: 1 el"),
        (MIXED_NAME, {"j": [0] * 5}, "Mixed.j: 5 elements, at most 4"),
        (MIXED_NAME, {"i": [0] * 2}, "Mixed.i: 2 elements, only 3"),
        (MIXED_NAME, {"q": b"1234"}, "Mixed.q: 4 elements, only 5"),
        (MIXED_NAME, {"r": "äöü"}, "Mixed.r: length 6, at most 4"),
        (MIXED_NAME, {"k": ["", "123456"]}, r"Mixed.k\[1\]: length 6, at most 5"),
        (MIXED_NAME, {"m": [0, 0, -129]}, r"Mixed.m\[2\]: -129 is out of range"),
    ],
)
def test_values_out_of_range(name, values, fault):
    with pytest.raises(InterfaceError, match=fault):
        to_cdr(load(name)(**values))


@pytest.mark.parametrize(
    ("name", "values", "fault"),
    [
        ("std_msgs/Int32", {"data": "5"}, "std_msgs/msg/Int32.data: expected int32, got str"),
        ("std_msgs/Int32", {"data": 5.0}, "Int32.data: expected int32, got float"),
        ("std_msgs/Int32", {"data": None}, "Int32.data: expected int32, got NoneType"),
        ("std_msgs/Float64", {"data": "x"}, "Float64.data: expected double, got str"),
        ("std_msgs/String", {"data": 5}, "String.data: expected string, got int"),
        ("std_msgs/String", {"data": b"x"}, "String.data: expected string, got bytes"),
        ("std_msgs/String", {"data": []}, "String.data: expected string, got list"),
        (
            "std_msgs/UInt8MultiArray",
            {"data": "text"},
            "data: expected a sequence of uint8, got str",
        ),
        ("std_msgs/UInt8MultiArray", {"data": 7}, "data: expected a sequence of uint8, got int"),
        ("std_msgs/Float64MultiArray", {"data": b"ab"}, "expected a sequence of double, got bytes"),
        ("std_msgs/Float64MultiArray", {"data": [1, "x"]}, r"data\[1\]: expected double, got str"),
        ("std_msgs/Float64MultiArray", {"data": {1: 2}}, "expected a sequence of double, got dict"),
        ("sensor_msgs/JointState", {"name": "abc"}, "name: expected a sequence of string, got str"),
        ("geometry_msgs/Twist", {"linear": 5}, "linear: expected geometry_msgs/Vector3, got int"),
    ],
)
def test_values_of_wrong_type(name, values, fault):
    with pytest.raises(TypeError, match=fault):
        to_cdr(load(name)(**values))


def test_wrong_message_inside():
    twist = load("geometry_msgs/Twist")(linear=load("geometry_msgs/Point")())
    with pytest.raises(
        TypeError, match="linear: expected geometry_msgs/Vector3, got geometry_msgs/"
    ):
        to_cdr(twist)
    path = load("nav_msgs/Path")(poses=[load("geometry_msgs/PoseStamped")()])
    path.poses[0].pose.position.x = "far"
    with pytest.raises(
        TypeError, match=r"nav_msgs/msg/Path.poses\[0\].pose.position.x: expected do"
    ):
        to_cdr(path)
    path.poses[0] = twist
    with pytest.raises(TypeError, match=r"Path.poses\[0\]: expected geometry_msgs/PoseStamped"):
        to_cdr(path)
    del twist.linear
    with pytest.raises(TypeError, match="Twist.linear is not set"):
        to_cdr(twist)


@pytest.mark.parametrize(
    "data",
    [
        [1, 2, 255],
        (1, 2, 255),
        b"\1\2\xff",
        bytearray(b"\1\2\xff"),
        memoryview(b"\1\2\xff"),
        memoryview(b"\1-\2-\xff")[::2],
        array("B", [1, 2, 255]),
        np.array([1, 2, 255], dtype=np.uint8),
        [b"\1", b"\2", b"\xff"],
    ],
)
def test_octets_are_packed_from_many_types(data):
    cls = load("std_msgs/UInt8MultiArray")
    assert from_cdr(cls, to_cdr(cls(data=data))).data == b"\1\2\xff"


@pytest.mark.parametrize(
    "data", [[1, 2], (1, 2), array("f", [1, 2]), array("d", [1, 2]), np.array([1.0, 2.0])]
)
def test_numbers_are_packed_from_many_types(data):
    cls = load("std_msgs/Float32MultiArray")
    values = from_cdr(cls, to_cdr(cls(data=data))).data
    assert isinstance(values, array)
    assert values.typecode == "f"
    assert list(values) == [1.0, 2.0]


def test_byte_takes_an_octet_of_bytes():
    cls = load("std_msgs/Byte")
    assert from_cdr(cls, to_cdr(cls(b"\5"))).data == 5


def test_nan():
    cls = load("std_msgs/Float32")
    assert str(from_cdr(cls, to_cdr(cls(float("nan")))).data) == "nan"
