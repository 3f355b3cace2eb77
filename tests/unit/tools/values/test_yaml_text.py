"""Expected texts were printed by PyYAML 6.0: dump(…, allow_unicode=True, width=sys.maxsize)."""

import math

import pytest

from uros.tools.values.yaml_text import dump


@pytest.mark.parametrize(
    "value, text",
    [
        (True, "true"),
        (None, "null"),
        (-5, "-5"),
        (2**63, "9223372036854775808"),
        (0.0, "0.0"),
        (-0.0, "-0.0"),
        (0.10000000149011612, "0.10000000149011612"),
        (1e16, "1.0e+16"),
        (1e-07, "1.0e-07"),
        (1.5e300, "1.5e+300"),
        (math.inf, ".inf"),
        (-math.inf, "-.inf"),
        (math.nan, ".nan"),
        ("hello world", "hello world"),
        ("base_link", "base_link"),
        ("", "''"),
        ("123", "'123'"),
        ("0x1F", "'0x1F'"),
        ("1_000", "'1_000'"),
        ("1.5", "'1.5'"),
        ("1e5", "1e5"),
        ("+.5", "+.5"),
        ("12:30", "'12:30'"),
        ("2026-01-02", "'2026-01-02'"),
        ("yes", "'yes'"),
        ("Off", "'Off'"),
        ("y", "y"),
        ("null", "'null'"),
        ("~", "'~'"),
        (".nan", "'.nan'"),
        ("=", "'='"),
        ("<<", "'<<'"),
        ("kept: yes", "'kept: yes'"),
        ("a:b", "a:b"),
        ("a:", "'a:'"),
        ("a #b", "'a #b'"),
        ("a#b", "a#b"),
        ("- a", "'- a'"),
        ("-a", "-a"),
        ("?", "'?'"),
        ("---", "'---'"),
        ("...", "'...'"),
        ("[x]", "'[x]'"),
        ("a[x], {y}", "a[x], {y}"),
        ("it's", "it's"),
        ("'it's", "'''it''s'"),
        (" a", "' a'"),
        ("a ", "'a '"),
        ("a\tb", '"a\\tb"'),
        ("\0", '"\\0"'),
        ("\x7f\x80", '"\\x7F\\x80"'),
        ("grün 😀", "grün 😀"),
        ("\x01😀", '"\\x01\\U0001F600"'),
        ("\ufeff", '"\\uFEFF"'),
        ("a\nb", "'a\n\n    b'"),
        ("a\n", "'a\n\n    '"),
        ("a\n\nb", "'a\n\n\n    b'"),
        ("a \nb", '"a \\nb"'),
        ('"\\\r\n', '"\\"\\\\\\r\\n"'),
    ],
)
def test_scalars(value, text):
    assert dump({"o": {"k": value}}) == f"o:\n  k: {text}\n"


def test_keys_are_quoted_too():
    assert dump({"y": 1, "on": 2}) == "y: 1\n'on': 2\n"


def test_nothing():
    assert dump({}) == "{}\n"
    assert dump({"a": [], "b": {}}) == "a: []\nb: {}\n"


NESTED = {
    "header": {"stamp": {"sec": 1}, "frame_id": ""},
    "data": [1, 2],
    "points": [{"x": 1.0, "names": ["a", "no"]}, {}],
}


def test_blocks():
    assert dump(NESTED) == (
        "header:\n  stamp:\n    sec: 1\n  frame_id: ''\n"
        "data:\n- 1\n- 2\n"
        "points:\n- x: 1.0\n  names:\n  - a\n  - 'no'\n- {}\n"
    )


def test_flow():
    assert dump(NESTED, flow=True) == (
        "header:\n  stamp:\n    sec: 1\n  frame_id: ''\n"
        "data: [1, 2]\n"
        "points: [{x: 1.0, names: [a, 'no']}, {}]\n"
    )


def test_more_strings_need_quotes_in_flow():
    strings = ["a,b", "a[0]", "a?b", ":x", "a:b", "plain"]
    assert dump({"s": strings}, flow=True) == "s: ['a,b', 'a[0]', 'a?b', ':x', 'a:b', plain]\n"
    assert dump({"s": strings}) == "s:\n" + "".join(f"- {text}\n" for text in strings)
