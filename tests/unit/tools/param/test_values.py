import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uros.interfaces import load
from uros.interfaces.codec import from_cdr, to_cdr
from uros.tools.errors import ToolError
from uros.tools.param.values import (
    Typed,
    as_declared,
    from_message,
    from_text,
    plain,
    shown,
    to_message,
    type_name,
)

# Texts on the command line, also for the comparison with rclpy in tests/interop.
TEXTS = [
    "1", "-1", "+7", "0", "007", "0o17", "0x10", "0b101", "1_000", "9223372036854775807",
    "1.0", "1.", ".5", "-.5", "1e5", "1.0e5", "1.0e+5", ".inf", "-.inf", ".nan", "nan", "inf",
    "1:30", "1:30.5", "true", "True", "yes", "off", "y", "n", "'yes'", '"1"', "", "~", "null",
    "text", "a b", "grün ☃", "it's", "a: b", "a: b: c", "{a: 1}", "2020-01-01", "[", "]", "'open",
    "@x", "*x", "&a 1", "!x y", "!!float 1", "!!str 1", "# comment", "a # comment", "- 1", "-",
    "[]", "[1, 2]", "[1, true]", "[true, false]", "[1.0, .nan]", "[1, 2.5]", "[a, b]", "['1', '']",
    "[a, 1]", "[[1], [2]]", "[~]", "[null, 1]", "[1,2,]", "[ ]", "- 1\n- 2", "a\\nb", '"a\\tb"',
    "=", "<<", "1 2", "0x_", "1__0", "%",
]  # fmt: skip


@pytest.mark.parametrize(
    "text, kind, value",
    [
        ("1", 2, 1),
        ("1.0", 3, 1.0),
        ("yes", 1, True),
        ("'yes'", 4, "yes"),
        ("1e5", 4, "1e5"),  # no number in YAML 1.1
        ("[]", 6, []),
        ("[1, true]", 7, [1, 1]),
        ("[1, 2.5]", 4, "[1, 2.5]"),
        ("{a: 1}", 4, "{a: 1}"),
        ("2020-01-01", 4, "2020-01-01"),
        ("'open", 4, "'open"),
        ("!!float 1", 3, 1.0),
        ("!!binary AP8=", 5, b"\x00\xff"),
        ("[!!binary AA==, !!binary /w==]", 5, b"\x00\xff"),
        ("[!!binary AA==, 1]", 4, "[!!binary AA==, 1]"),
        ("!!binary x", 4, "!!binary x"),
    ],
)
def test_text_of_the_command_line(text, kind, value):
    assert from_text(text) == Typed(kind, value)


def test_texts_of_the_command_line_that_cannot_be_sent():
    for text, said in (
        ("9223372036854775808", "9223372036854775808 does not fit 64 bits"),
        ("[1, -9223372036854775809]", "does not fit 64 bits"),
        ('"a\\0b"', "a NUL"),
        ("\udc80", "not text in UTF-8"),
    ):
        with pytest.raises(ToolError, match=said):
            from_text(text)


@given(st.text())
def test_any_text_means_something_or_is_refused(text):
    try:
        typed = from_text(text)
    except ToolError:
        return
    message = to_message(typed)
    received = from_cdr(type(message), to_cdr(message))
    assert from_message(received).kind == typed.kind
    assert shown(typed, False).startswith(shown(Typed(typed.kind, typed.value), False)[:5])


def test_an_empty_list_takes_the_type_of_its_parameter():
    empty = from_text("[]")
    assert as_declared(empty, 7) == Typed(7, [])
    assert as_declared(empty, 5) == Typed(5, b"")
    assert as_declared(empty, 2) == as_declared(empty, 0) == empty
    assert as_declared(Typed(6, [True]), 7) == Typed(6, [True])


def test_values_as_text():
    assert shown(Typed(0, None), False) == "Parameter not set."
    assert shown(Typed(0, None), True) == "None"
    assert shown(Typed(5, b"\x00\x41"), False) == "Byte values are: [b'\\x00', b'A']"
    assert shown(Typed(4, "a\n\tb\x1b"), True) == "a\n\tb\\x1b"
    assert shown(Typed(3, math.inf), False) == "Double value is: inf"
    assert plain(Typed(7, [1])) == [1]


def test_a_type_that_nobody_knows():
    message = load("rcl_interfaces/msg/ParameterValue")(type=77)
    with pytest.raises(ToolError, match="the unknown type 77"):
        from_message(message)
    assert type_name(77) == "unknown type 77" and type_name(3) == "double"
