import math
import sys

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uros.tools.values.yaml_read import Plain, YamlError, read, resolve
from uros.tools.values.yaml_text import dump


def python_of(node):
    if isinstance(node, dict):
        return {key: python_of(value) for key, value in node.items()}
    if isinstance(node, list):
        return [python_of(item) for item in node]
    return resolve(node) if isinstance(node, Plain) else str(node)


@pytest.mark.parametrize(
    "text, value",
    [
        ("", None),
        ("# nothing", None),
        ("data: 1", {"data": 1}),
        ("{data: 1}", {"data": 1}),
        ("{data: Hello World}", {"data": "Hello World"}),
        ("{x: 1.5, name: 'it''s', on: [yes, no]}", {"x": 1.5, "name": "it's", "on": [True, False]}),
        ('"a\\tb\\x41\\u00e9\\\\"', "a\tbA\u00e9\\"),
        ("a: 1\nb:\n  c: 2 # two\n  d:\n  - 3\n  - e: 4\n    f: 5\n", {
            "a": 1, "b": {"c": 2, "d": [3, {"e": 4, "f": 5}]}
        }),
        ("[[1, 2],\n [3], {a: b}, c: d]", [[1, 2], [3], {"a": "b"}, {"c": "d"}]),
        ("- - 1\n  - 2\n-\n  a: 3", [[1, 2], {"a": 3}]),
        ("a:\nb: ~", {"a": None, "b": None}),
        ("'one\n  two\n\n  three'", "one two\nthree"),
        ('"one\\\n  two"', "onetwo"),
        ("{a, b}", {"a": None, "b": None}),
        ("url: http://x:1/y#z", {"url": "http://x:1/y#z"}),
        ("--- \ndata: 1\n---\n", {"data": 1}),  # what `topic echo` prints
        ('{"data": 1}', {"data": 1}),
        ("{a: }", {"a": None}),
        ("{'a:b': }", {"a:b": None}),
        ("a: |\n  one\n   two\nb: >-\n  three\n  four", {"a": "one\n two\n", "b": "three four"}),
        ("a: one\n  two", {"a": "one two"}),
        ("? a\n: b", {"a": "b"}),
        ("a: &x 1", {"a": 1}),
        ("{a: !!int 1, b: !!str 1, c: !!seq [!!null ~], d: !!map {}}", {
            "a": 1, "b": "1", "c": [None], "d": {}
        }),
        ("%YAML 1.1\n--- a\n...\n", "a"),
        ("'<<': 1", {"<<": 1}),
        ("[" * 64 + "]" * 64, eval("[" * 64 + "]" * 64)),
        ("[" + "[a], " * 99 + "]", [["a"]] * 99),
    ],
)  # fmt: skip
def test_documents(text, value):
    assert python_of(read(text)) == value


@pytest.mark.parametrize(
    "text, value",
    [
        ("0", 0), ("-12", -12), ("+7", 7), ("0x1F", 31), ("010", 8), ("0b101", 5), ("1_000", 1000),
        ("1:30", 90), ("1.5", 1.5), ("-.5", "-.5"), (".5", 0.5), ("1.", 1.0), ("1e3", "1e3"),
        ("1.0e+3", 1000.0), (".inf", math.inf), ("-.INF", -math.inf), ("yes", True), ("Off", False),
        ("y", "y"), ("~", None), ("null", None), ("", None), ("2020-01-01", "2020-01-01"),
        ("08", "08"), ("_1", "_1"), ("0x_", "0x_"), ("1:30.5", 90.5), ("yes\n", "yes\n"),
        ("<<", "<<"), ("=", "="), ("1" * 5000, "1" * 5000),
        ("1" + ":59" * 400 + ".0", "1" + ":59" * 400 + ".0"),  # above what a float holds
        ("1" + ":59" * 100_000, "1" + ":59" * 100_000),  # seconds to work out
    ],
)  # fmt: skip
def test_plain_scalars_are_those_of_yaml_1_1(text, value):
    found = resolve(text)
    assert found == value and type(found) is type(value)


def test_quoted_scalars_are_distinguished():
    node = read("{a: 1, b: '1'}")
    assert isinstance(node["a"], Plain) and not isinstance(node["b"], Plain)


@pytest.mark.parametrize(
    "text, said",
    [
        ("{data:1}", "a blank is missing behind the colon of 'data:1'"),
        ("{data: 1", "the } is missing"),
        ("[1, 2", "the ] is missing"),
        ("[1 2]]", "here the value has ended"),
        ("{a: b c: d}", "a comma or } was expected"),
        ("'a", "line 1, column 3: the closing quote is missing"),
        ("'a\nb", "line 2, column 2: the closing quote is missing"),
        ('"a\\q"', "no such escape"),
        ('"\\x4"', "2 hexadecimal digits"),
        ('"\\UFFFFFFFF"', "no such character"),
        ('"\\U00110000"', "no such character"),
        ('"\\ud800"', "no such character"),
        ("a: b: c", "a second colon in a value; put {..} or quotes around the value"),
        ("a: 1\n  b: 2", "line 2, column 4, at ': 2': a second colon in a value"),
        ("a: - 1", "a list begins on a line of its own, or in [brackets]"),
        ("a: 1\nb\nc: 1", "a colon and a blank were expected behind a field's name"),
        ("[-1, - 1]", "line 1, column 6, at '- 1]': expected the node content, but found '-'; put"),
        ("a: @b", "'@' that cannot start any token; put text that holds signs in quotes"),
        ("a: 1\na: 2", "'a' stands there twice"),
        ("{a: 1, a: 2}", "'a' stands there twice"),
        ("a: *x", "an alias or a tag; put the text in quotes"),
        ("a: &x [*x]", "an alias"),
        ("- &a [x]\n- &b [*a, *a]\n- &c [*b, *b]", "an alias"),
        ("*x : 1", "an alias"),
        ("a: !colour red", "a tag"),
        ("a: !!binary YQ==", "a tag"),
        ("a: !!python/object/apply:os.getpid []", "a tag"),
        ("<<: {a: 1}", "without merging"),
        ("[a: 1]: 2", "the name of a field is a word"),
        ("{[a]: 2}", "the name of a field is a word"),
        ("a: 1\n\tb: 2", "line 2, column 1, at '\\tb: 2': a tab cannot stand here; put blanks"),
        ("[a?b]", ""),
        ("- 1\nb: 2", ""),
        ("a: 1\n- 2", ""),
        ("one\n---\ntwo", "line 3, column 1, at 'two': another document begins; give one"),
        ("one\n---\n---\n", "another document begins"),
        ("a\x00b", "the character '\\x00' cannot stand in YAML"),
        ("a\ud800", "cannot stand in YAML"),
        ("[" * 1000, "nested more than 64 deep"),
        ("- " * 1000, "nested more than 64 deep"),
        ("? " * 1000, "nested more than 64 deep"),
        ("%YAML 1." + "1" * 5000 + "\n--- a", "line 1, column 9"),
    ],
)
def test_documents_that_are_rejected(text, said):
    with pytest.raises(YamlError) as refused:
        read(text)
    assert said in str(refused.value)
    assert "\n" not in str(refused.value) and str(refused.value).startswith("line ")


def test_a_nearly_full_stack():
    def below(frames):
        return below(frames - 1) if frames else read("[" * 60 + "]" * 60)

    spare, depth = sys.getrecursionlimit(), 0
    frame = sys._getframe()
    while frame:
        frame, depth = frame.f_back, depth + 1
    with pytest.raises(YamlError, match="nested too deep"):
        below(spare - depth - 100)


SIGNS = "{}[],:-#'\"\\ \n\tab1~?!&*|>%@x<=.\x85\u2028"


WORDS = ["!!str ", "&a ", "*a", "<<: ", "---\n", "...\n", "%YAML 1.1\n", ">-\n", "\\ud800"]


@settings(deadline=5000)
@given(
    st.text()
    | st.text(st.sampled_from(SIGNS), max_size=30)
    | st.lists(st.sampled_from([*SIGNS, *WORDS]), max_size=20).map("".join)
)
def test_any_text_is_read_or_rejected(text):
    try:
        python_of(read(text))
    except YamlError:
        pass


# What PyYAML writes of U+0085 is not what it reads; yaml_text writes the same.
CHARACTERS = st.characters(codec="utf-8", exclude_characters="\x85")
TEXTS = st.text(CHARACTERS, max_size=20) | st.sampled_from(
    ["yes", "1", "- a", "a: b", "x\n\ny ", "'", '"', "#", "{", "0x1", "~", "2020-01-01", "<<"]
)
SCALARS = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | TEXTS
NAMES = st.text("abcdefgh_0", min_size=1, max_size=6).filter(lambda text: resolve(text) == text)
DOCUMENTS = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(NAMES, inner, max_size=4),
    max_leaves=12,
)


@given(DOCUMENTS, st.booleans())
def test_written_values_are_read_unchanged(value, flow):
    assert python_of(read(dump(value, flow))) == value
