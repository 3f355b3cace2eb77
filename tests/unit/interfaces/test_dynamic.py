"""Types from text at run time: the same classes as the generator's, for any definition."""

import string

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from support.examples import examples

from uros.interfaces import InterfaceError, dynamic, parse
from uros.interfaces import load as load_generated
from uros.interfaces.codec import from_cdr, to_cdr
from uros.interfaces.generate import generate
from uros.interfaces.parse import FLOATS, INTEGERS, PRIMITIVES, parse_msg

TEXTS = st.text(st.sampled_from(string.ascii_letters + "äß漢😀 _/#,'\"\\\n="), max_size=9)
NESTED = ("Inner", "std_msgs/Header", "geometry_msgs/msg/Quaternion")
INNER = "int8 a 5\nfloat64[] b\nstring c 'x'\n"
NAMES = st.from_regex(r"[a-z](_?[a-z0-9]){0,6}", fullmatch=True)
WORDS = ["class", "self", "pack_into", "from", "cdr_size", "x", "value", "lambda", "async"]


def escaped(text):
    """Return the text as a quoted literal of a definition."""
    out = text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
    return f'"{out}"'


def literals(name, bound):
    """Literals of a primitive type, as in a definition."""
    if name == "bool":
        return st.sampled_from(["true", "false", "True", "0", "1"])
    if name in INTEGERS:
        numbers = st.integers(*INTEGERS[name])
        return st.one_of(numbers.map(str), numbers.map(hex), numbers.map("{:+}".format))
    if name in FLOATS:
        width = 32 if name == "float32" else 64
        return st.floats(width=width, allow_nan=False).filter(
            lambda value: abs(value) < 3.4e38 or value in (float("inf"), -float("inf"))
        ).map(repr)  # fmt: skip
    return TEXTS.map(lambda text: escaped(text[: (bound or 99) // 4]))


@st.composite
def field_lines(draw, name):
    kind = draw(st.sampled_from([*PRIMITIVES, *NESTED]))
    bound = draw(st.sampled_from([0, 0, 7, 40])) if kind in parse.STRINGS else 0
    array, size = draw(st.sampled_from([("", 0)] * 3 + [("[]", 0), ("[3]", 3), ("[<=4]", 4)]))
    line = f"{kind}{f'<={bound}' if bound else ''}{array} {name}"
    if kind in PRIMITIVES and draw(st.booleans()):
        if array:
            count = 3 if size == 3 else draw(st.integers(0, size or 5))
            items = [draw(literals(kind, bound)) for _ in range(count)]
            line += f" [{draw(st.sampled_from([', ', ',', ' ,  '])).join(items)}]"
        else:
            line += " " + draw(literals(kind, bound))
    return line + draw(st.sampled_from(["", "  # words", "\t# it's", ' # "x', "\r"]))


@st.composite
def constant_lines(draw, name):
    kind = draw(st.sampled_from(PRIMITIVES))
    value = draw(literals(kind, 0))
    return f"{kind} {name.upper()}{draw(st.sampled_from(['=', ' = ']))}{value}"


@st.composite
def definitions(draw):
    names = draw(st.lists(st.one_of(NAMES, st.sampled_from(WORDS)), max_size=7, unique=True))
    lines = [draw(st.one_of(field_lines(n), field_lines(n), constant_lines(n))) for n in names]
    return "\n".join(lines)


def both(text):
    """Return the classes of the generator and of `dynamic`, from the same text."""
    sources = []
    for name, source in (("Inner", INNER), ("Outer", text)):
        definition = parse_msg(source, "dyn_cases", name)
        sources.append(source_of(definition))
    scope = {}
    for code in sources:
        exec(code, scope)
    return scope["Outer"], dynamic.load("dyn_cases/msg/Outer", text, {"dyn_cases/msg/Inner": INNER})


def source_of(definition):
    """Return the source of the generated module, with ``Inner`` taken from the same scope."""
    from uros.interfaces import registry

    known = registry.definition

    def find(name):
        if name == "dyn_cases/msg/Inner":
            return parse_msg(INNER, "dyn_cases", "Inner")
        return known(name)

    registry.definition = find
    try:
        text = generate(definition, "uros.interfaces.")
    finally:
        registry.definition = known
    line = "from uros.interfaces.dyn_cases.msg._inner import Inner as _Inner"
    return text.replace(line, "_Inner = Inner")


def fill(message, draw):
    """Set random values in every field of a message of any class."""
    for (_, kind), slot in zip(message._FIELDS, message.__slots__, strict=True):
        setattr(message, slot, value(kind, getattr(message, slot), draw))


def value(kind, now, draw):
    if kind.startswith("sequence<"):
        inner, _, bound = kind[9:-1].rpartition(", ")
        if not inner or bound.endswith(">"):
            inner, bound = kind[9:-1], "3"
        count = draw(st.integers(0, int(bound)))
        return items(inner, count, None, draw)
    if kind.endswith("]"):
        inner, _, size = kind[:-1].rpartition("[")
        return items(inner, int(size), now, draw)
    if "/" in kind:
        fill(now, draw)
        return now
    if "string" in kind:
        plain, _, bound = kind[:-1].partition("<")
        return draw(TEXTS)[: (int(bound) if plain != kind[:-1] and bound else 99) // 4]
    if kind == "boolean":
        return draw(st.booleans())
    if kind in ("float", "double"):
        return draw(st.floats(width=32 if kind == "float" else 64, allow_nan=False))
    return draw(st.integers(*INTEGERS["uint8" if kind == "octet" else kind]))


def items(kind, count, now, draw):
    if "/" in kind:
        # An empty sequence of messages has no element to copy; a fixed array keeps its elements.
        return now if now is not None else []
    out = [value(kind, None, draw) for _ in range(count)]
    return bytes(out) if kind in ("uint8", "octet") else out


def same(a, b):
    """Whether messages of the two classes have equal values."""
    return repr(a) == repr(b)


@settings(max_examples=examples(300), deadline=None)
@given(definitions(), st.data())
def test_random_definitions(text, data):
    generated, loaded = both(text)
    assert loaded._FIELDS == generated._FIELDS
    assert loaded.__slots__ == generated.__slots__
    assert (loaded._TYPE, loaded._DDS_TYPE) == (generated._TYPE, generated._DDS_TYPE)
    constants = [name for name in vars(generated) if name.isupper() and name[0] != "_"]
    for name in constants:
        constant = getattr(loaded, name)
        expected = getattr(generated, name)
        assert constant == expected and type(constant) is type(expected)
    assert same(loaded(), generated())
    message = generated()
    fill(message, data.draw)
    octets = to_cdr(message)
    again = from_cdr(loaded, octets)
    assert same(again, message)
    assert to_cdr(again) == octets
    assert again.cdr_size() == len(octets) - 4
    assert again == from_cdr(loaded, octets)
    # The result is independent of the start offset and of stale octets.
    buf = bytearray(b"\xaa" * (len(octets) + 9))
    end = len(octets) - 4 + 5
    assert again.pack_into(buf, 5, 5) == end and bytes(buf[5:end]) == octets[4:]
    assert loaded.unpack_from(buf, 5, 5, end) == (again, end)


@settings(max_examples=examples(100), deadline=None)
@given(definitions(), st.data())
def test_big_endian_and_damage(text, data):
    generated, loaded = both(text)
    message = generated()
    fill(message, data.draw)
    octets = bytearray(to_cdr(message))
    for end in range(4, len(octets)):
        with pytest.raises(InterfaceError):
            from_cdr(loaded, octets[:end])
    for _ in range(20):
        at = data.draw(st.integers(4, len(octets) - 1))
        octets[at] = data.draw(st.sampled_from([0, 1, 0x7F, 0xFF]))
        octets[1] = data.draw(st.sampled_from([0, 1]))
        results = []
        for cls in (generated, loaded):
            try:
                results.append(repr(from_cdr(cls, bytes(octets))))
            except InterfaceError:
                results.append("fault")
        assert results[0] == results[1]


BAD = [
    "int33 x", "int32", "int32 X", "int32 x\nint32 x", "int32 x_", "int32 _x", "int32 x__y",
    "int32 x-y", "string<= x", "string<=0 x", "int32<=5 x", "int32[<=] x", "int32[0] x",
    "int32[-1] x", "int32[4294967296] x", "int32[2 x", "int32[x] x", "bool b maybe", "int8 x 128",
    "uint8 x -1", "int32 x 1_0", "int32 x 0x", "int32 x five", "int32 x 1.5", "float32 x 3.5e38",
    "float64 x x", "int32[2] x [1]", "int32[<=2] x [1,2,3]", "int32[] x 1", "int32[] x [1,]",
    "int32[] x [,1]", "string x 'a", 'string x "a" b', "string<=2 x 'abc'", "string[] x ['a]",
    "Inner x 5", "Inner X=5", "string<=5 X='a'", "int32[2] X=[1,2]", "int32 x=5", "int32 Xy=5",
    "int32 X=5\nint32 X=6", "a/b/c x", "A/B x", "pkg/msg/lower x", "Outer x", "Lost x", "/X x",
    "int32 x 1 2", "uint64 x 18446744073709551616", "int64 X=-9223372036854775809", "---",
    "wstring<=1 x '😀'", "int32 #x",
    # Numbers of too many digits, also where they are small: found by fuzzing.
    f"int32[{'0' * 10}2] x", f"string<={'0' * 10}2 x", f"int32[{'9' * 5000}] x",
    f"int32 x {'0' * 40}5", f"int32 x -0x{'0' * 40}5", f"int32 x 0b{'0' * 80}1",
    f"int32 X={'9' * 5000}",
]  # fmt: skip


@pytest.mark.parametrize("text", BAD)
def test_definitions_that_are_rejected(text):
    """Both parsers reject the text; `dynamic` names the line, and alone loads nested types."""
    text = "int8 first\n\n" + text
    others = {"dyn_cases/msg/Inner": INNER}
    with pytest.raises(InterfaceError) as caught:
        dynamic.load("dyn_cases/msg/Outer", text, others)
    line = 2 + len(text.splitlines()[2:])
    assert str(caught.value).startswith(f"dyn_cases/msg/Outer:{line}: ")
    if text.endswith(("Outer x", "Lost x")):
        return
    with pytest.raises(InterfaceError):
        parse_msg(text, "dyn_cases", "Outer")


SPELLINGS = st.lists(
    st.sampled_from([
        "int32", "int8", "bool", "float32", "string", "wstring", " ", " ", " ", "[]", "[2]",
        "[<=2]", "<=2", "x", "y", "X", "Y_", "_", "=", " = ", "5", "-", "+", "0x1F", "1.5", "true",
        "'", '"', "'a'", "[1, 2]", "[1,", "]", ",", "#", "\\", "\n", "\n", "\t", "---", "/",
        "<", "😀",
    ]),
    max_size=14,
).map("".join)  # fmt: skip


@settings(max_examples=examples(1500), deadline=None)
@given(SPELLINGS)
def test_any_text(text):
    """Both parsers accept the same texts, with the same fields and constants."""
    try:
        definition = parse_msg(text, "dyn_cases", "Outer")
    except InterfaceError:
        definition = None
    try:
        loaded = dynamic.load("dyn_cases/msg/Outer", text)
    except InterfaceError as error:
        if "give load its class or text" in str(error):
            assume(False)
        loaded = None
    assert (definition is None) == (loaded is None), text
    if definition:
        assert [name for name, _ in loaded._FIELDS] == [field.name for field in definition.fields]
        for constant in definition.constants:
            assert getattr(loaded, constant.name) == constant.value


@pytest.mark.parametrize("text", [
    "string x it's  # no", 'string x a"b # c"', "string x 'it''", "string[] x [it's, 'a, b']",
    "string[] x [a 'b, c']", "string x 'a#b' # c", "string X = 'a # b' # c", "wstring x \"#\"#",
    "int8 x 5# '", "string x '\\'#' # '", "string x '", "string x \\'", "int8 x  +0X1f",
    "bool x TRUE", "float32 x 1e3", "float64 x Infinity", "int8[] x []", "int8[] x [ ]",
    "string[] x ['']", f"int32 x -{'0' * 39}5", f"int8 x +0x{'0' * 39}5", f"int8 x 0b{'0' * 79}1",
    "int8[0000000003] x [1, 2, 3]",
])  # fmt: skip
def test_texts_that_are_hard_to_read(text):
    """Both parsers read quotes within words and marks within quotes alike."""
    try:
        definition = parse_msg(text, "dyn_cases", "Outer")
    except InterfaceError:
        with pytest.raises(InterfaceError):
            dynamic.load("dyn_cases/msg/Outer", text)
        return
    loaded = dynamic.load("dyn_cases/msg/Outer", text)
    for constant in definition.constants:
        assert getattr(loaded, constant.name) == constant.value
    for field in definition.fields:
        default = getattr(loaded(), field.name)
        assert (tuple(default) if field.type.array else default) == field.default


def test_names():
    for name in ("Reading", "my_msgs/Reading", "my_msgs/action/Reading", "My/msg/R", "a/msg/r", ""):
        with pytest.raises(InterfaceError, match="bad name"):
            dynamic.load(name, "int32 x")


def test_errors_name_the_place_and_the_remedy():
    with pytest.raises(InterfaceError) as caught:
        dynamic.load("my_msgs/msg/R", "int32 x\nint33 y  # no\n")
    assert str(caught.value) == (
        "my_msgs/msg/R:2: bad type in 'int33 y'; on a host, 'uros interface show' says more"
    )
    with pytest.raises(InterfaceError, match="R:1: no my_msgs/msg/Lost; give load its class or t"):
        dynamic.load("my_msgs/msg/R", "Lost x")
    with pytest.raises(InterfaceError, match="In:1: bad size in 'int8"):
        dynamic.load("my_msgs/msg/R", "In x", {"my_msgs/msg/In": "int8[-] x"})
    with pytest.raises(InterfaceError, match="B:1: bad ring of types in 'A a'"):
        dynamic.load("c/msg/A", "B b", {"c/msg/B": "A a", "c/msg/A": "B b"})


def test_a_service():
    store = dynamic.load("my_msgs/srv/Store", "Item[] items\n---\n# Kept.\nbool kept true\n", {
        "my_msgs/msg/Item": "uint8 id\nstring name",
    })  # fmt: skip
    assert store._TYPE == "my_msgs/srv/Store"
    assert store._DDS_TYPE == "my_msgs::srv::dds_::Store_"
    assert store.Request._TYPE == "my_msgs/srv/Store_Request"
    assert store.Request._FIELDS == (("items", "sequence<my_msgs/Item>"),)
    assert store.Response().kept is True
    for text in ("int8 x", "int8 x\n---\n---\n"):
        with pytest.raises(InterfaceError, match="bad number of lines '---'"):
            dynamic.load("my_msgs/srv/Store", text)


def test_known_types_are_nested_unchanged():
    header = load_generated("std_msgs/Header")
    point = dynamic.load("my_msgs/msg/Point", "float32 x 1.5\nfloat32 y")
    cls = dynamic.load(
        "my_msgs/msg/Track", "std_msgs/Header header\nPoint[2] ends\nPoint[] points",
        {"my_msgs/msg/Point": point},
    )  # fmt: skip
    track = cls(points=[point(2.0, 3.0)])
    assert type(track.header) is header and type(track.ends[1]) is point
    track.header.frame_id = "map"
    again = from_cdr(cls, to_cdr(track))
    assert again == track and again.header.frame_id == "map" and again.points[0].y == 3.0
    track.ends[0] = header()
    with pytest.raises(TypeError, match=r"Track.ends\[0\]: expected my_msgs/Point, got std_msgs"):
        to_cdr(track)


@pytest.mark.parametrize(
    ("values", "error", "fault"),
    [
        ({"a": 200}, InterfaceError, "T.a: 200 is out of range -128 to 127"),
        ({"a": "x"}, TypeError, "T.a: expected int8, got str"),
        ({"b": ["1"]}, TypeError, r"T.b\[0\]: expected double, got str"),
        ({"b": [1.0] * 3}, InterfaceError, "T.b: 3 elements, at most 2"),
        ({"c": "abcdef"}, InterfaceError, "T.c: length 6, at most 5"),
        ({"d": [True]}, InterfaceError, "T.d: 1 elements, only 2"),
        ({"d": [0, 2]}, InterfaceError, r"T.d\[1\]: 2 is out of range 0 to 1"),
        ({"e": b"123"}, InterfaceError, "T.e: 3 elements, only 2"),
        ({"f": 5}, TypeError, "T.f: expected std_msgs/Header, got int"),
    ],
)
def test_values_that_do_not_fit(values, error, fault):
    cls = dynamic.load(
        "my_msgs/msg/T",
        "int8 a\nfloat64[<=2] b\nstring<=5 c\nbool[2] d\nuint8[2] e\nstd_msgs/Header f",
    )
    with pytest.raises(error, match=fault):
        to_cdr(cls(**values))
    message = cls()
    for room in range(message.cdr_size()):
        with pytest.raises(InterfaceError, match=f"octets, the buffer has {room}"):
            message.pack_into(bytearray(room), 0, 0)


def test_arguments():
    cls = dynamic.load("my_msgs/msg/P", "int8 x 3\nint8[] y [1]\nint8 class")
    assert repr(cls()) == "my_msgs.msg.P(x=3, y=[1], class_=0)"
    assert cls(1, [2], class_=3) == cls(x=1, y=[2], class_=3) != cls()
    cls().y.append(5)
    assert list(cls().y) == [1]
    for arguments, words in (((1, [], 3, 4), {}), ((), {"z": 1}), ((1,), {"x": 1})):
        with pytest.raises(TypeError, match="P has 3 fields: x, y, class_"):
            cls(*arguments, **words)
    with pytest.raises(AttributeError):
        cls().z = 1


def test_decoding_into_a_message_is_all_or_nothing():
    cls = dynamic.load("my_msgs/msg/P", "int32 x\nstring name")
    message, kept = cls(1, "one"), cls(1, "one")
    octets = bytearray(to_cdr(cls(2, "two")))[4:]
    for end in range(len(octets)):
        with pytest.raises(InterfaceError):
            message.unpack_into(octets, 0, 0, end)
        assert message == kept
    assert message.unpack_into(octets, 0, 0, len(octets)) == len(octets)
    assert message == cls(2, "two")


def test_it_can_be_forgotten():
    import sys

    from uros.interfaces import dynamic as first

    cls = first.load("my_msgs/msg/P", "int32 x")
    first.forget()
    try:
        assert "uros.interfaces.dynamic" not in sys.modules
        from uros.interfaces import dynamic as second

        assert second is not first
        assert from_cdr(cls, to_cdr(cls(5))).x == 5
    finally:
        sys.modules["uros.interfaces.dynamic"] = first
        sys.modules["uros.interfaces"].dynamic = first
