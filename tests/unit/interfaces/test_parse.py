"""The parser: definitions it accepts, and errors with file, line, fault and remedy."""

import pytest

from uros.interfaces.errors import InterfaceError
from uros.interfaces.parse import Type, parse_action, parse_msg, parse_srv


def fields(text):
    return parse_msg(text, "pkg", "Name").fields


def default(text):
    return fields(text)[0].default


def test_types():
    text = """
    # a comment
    bool a
    uint8[4] b   # with a comment
    float64[<=3] c
    string[] d
    string<=5 e
    wstring<=6[<=7] f
    Other g
    std_msgs/Header h
    std_msgs/msg/Header[2] i
    """
    assert [f.type for f in fields(text)] == [
        Type("bool"),
        Type("uint8", "fixed", 4),
        Type("float64", "bounded", 3),
        Type("string", "unbounded"),
        Type("string", "", 0, 5),
        Type("wstring", "bounded", 7, 6),
        Type("pkg/msg/Other"),
        Type("std_msgs/msg/Header"),
        Type("std_msgs/msg/Header", "fixed", 2),
    ]
    assert str(fields(text)[5].type) == "wstring<=6[<=7]"


def test_constants():
    text = "uint8 A=1\nint8 B = -2\nstring C= 'it#s' # note\nstring D=plain\n"
    text += "bool E=true\nfloat32 F=1e3"
    values = {c.name: c.value for c in parse_msg(text, "pkg", "Name").constants}
    assert values == {"A": 1, "B": -2, "C": "it#s", "D": "plain", "E": True, "F": 1000.0}
    assert [type(v) for v in values.values()] == [int, int, str, str, bool, float]


@pytest.mark.parametrize(
    ("line", "value"),
    [
        ("int32 x -5", -5),
        ("uint8 x 0xff", 255),
        ("int32 x 007", 7),
        ("int64 x -9223372036854775808", -(2**63)),
        ("float64 x 1.5", 1.5),
        ("float32 x -inf", float("-inf")),
        ("bool x True", True),
        ('string x "a, \\"b\\" # c"', 'a, "b" # c'),
        ("string x 'it\\'s'", "it's"),
        ("string x no quotes", "no quotes"),
        ('string x "Hello\'world!"', "Hello'world!"),
        ("wstring x 'ハロー'", "ハロー"),
        ("uint8[] x [1, 2,3]", (1, 2, 3)),
        ("uint8[] x []", ()),
        ("bool[2] x [true, false]", (True, False)),
        ("string[<=3] x ['a,b', \"c\", d]", ("a,b", "c", "d")),
        ("string<=3 x abc", "abc"),
        ("string x it's # note", "it's"),
        ("int32 x", None),
        ("int32\tx\t7", 7),
    ],
)
def test_defaults(line, value):
    assert default(line) == value


@pytest.mark.parametrize(
    ("text", "line", "fault", "remedy"),
    [
        ("float x", 1, "unknown type 'float'", "float32"),
        ("\n\nHeader! x", 3, "bad type", "type[n]"),
        ("time x", 1, "unknown type 'time'", "builtin_interfaces"),
        ("a/b/c/D x", 1, "unknown type", "package/Name"),
        ("int32 X", 1, "bad field name 'X'", "lower case"),
        ("int32 a__b", 1, "bad field name", "single underscores"),
        ("int32 a_", 1, "bad field name", "underscores"),
        ("int32 a\nint8 a", 2, "duplicate field 'a'", "rename"),
        ("int32 A=1\nint32 A=2", 2, "duplicate constant 'A'", "rename"),
        ("int32 a=1", 1, "bad constant name 'a'", "UPPER_CASE"),
        ("int32[] A=1", 1, "constant cannot be", "plain primitive"),
        ("std_msgs/Header A=1", 1, "constant cannot be", "plain primitive"),
        ("int8 A=128", 1, "128 is out of range for int8", "-128 to 127"),
        ("uint8 a -1", 1, "out of range for uint8", "0 to 255"),
        ("uint64 a 18446744073709551616", 1, "out of range for uint64", "wider"),
        ("float32 a 1e39", 1, "out of range for float32", "float64"),
        ("int32 a 1.5", 1, "bad int32 '1.5'", "whole number"),
        ("int32 a " + "9" * 5000, 1, "bad int32", "whole number"),
        ("bool a maybe", 1, "bad bool 'maybe'", "true or false"),
        ("float64 a one", 1, "bad float64 'one'", "a number"),
        ("int32[2] a [1]", 1, "needs 2 default values, not 1", "each element"),
        ("int32[<=1] a [1, 2]", 1, "2 default values", "at most 1"),
        ("int32[] a 1", 1, "bad array default", "[a, b, c]"),
        ("int32[] a [1,,2]", 1, "empty element", "spare comma"),
        ("int32[0] a", 1, "bad size '0'", "1 to"),
        ("int32[-1] a", 1, "bad size '-1'", "1 to"),
        ("int32[<=] a", 1, "bad type", "bound"),
        ("string<=x a", 1, "bad size 'x'", "1 to"),
        ("int32<=3 a", 1, "'int32' cannot have a length bound", "string"),
        ("string<=2 a abc", 1, "default of 3 characters", "at most 2"),
        ('string a "abc', 1, "no closing quote", "close it"),
        ('string a "a" b', 1, "after the closing quote", "escape"),
        ("std_msgs/Header a 1", 1, "cannot have a default", "primitive"),
        ("int32", 1, "'int32' has no name", "type name"),
    ],
)
def test_faults(text, line, fault, remedy):
    with pytest.raises(InterfaceError) as caught:
        parse_msg(text, "pkg", "Name", "folder/Name.msg")
    message = str(caught.value)
    assert message.startswith(f"folder/Name.msg:{line}: ")
    assert fault in message
    assert remedy in message.partition("; ")[2]


@pytest.mark.parametrize(("package", "name"), [("Pkg", "Name"), ("p__k", "Name"), ("pkg", "a_b")])
def test_bad_names(package, name):
    with pytest.raises(InterfaceError, match="bad (package|type) name"):
        parse_msg("", package, name)


def test_service():
    service = parse_srv("int32 a\nuint8 K=1\n---\n", "pkg", "Do")
    assert service.type_name == "pkg/srv/Do"
    assert service.request.type_name == "pkg/srv/Do_Request"
    assert [f.name for f in service.request.fields] == ["a"]
    assert service.response.fields == ()
    with pytest.raises(InterfaceError, match="0 lines of '---', expected 1; divide request and"):
        parse_srv("int32 a\n", "pkg", "Do")


def test_action():
    action = parse_action("int32 a\n---\nint32 b\n---\nOther c\n", "pkg", "Go")
    parts = [action.goal, action.result, action.feedback]
    assert [p.name for p in parts] == ["Go_Goal", "Go_Result", "Go_Feedback"]
    assert [p.fields[0].name for p in parts] == ["a", "b", "c"]
    with pytest.raises(InterfaceError, match="1 lines of '---', expected 2"):
        parse_action("int32 a\n---\nint32 b\n", "pkg", "Go")
