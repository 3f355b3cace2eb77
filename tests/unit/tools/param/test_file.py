import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uros.tools.errors import ToolError
from uros.tools.param.dump import dumped
from uros.tools.param.file import read_file, read_text
from uros.tools.param.values import Typed
from uros.tools.values.yaml_read import YamlError


def found(text, node="/lab/cam", **options):
    return {name: typed.value for name, typed in read_text(text, node, **options).items()}


@pytest.mark.parametrize(
    "keys",
    [
        "/lab/cam:", "lab/cam:", "/lab:\n cam:", "lab:\n  cam:", "/**:", "/*/cam:", "/lab/*:",
        "/lab/**:", "/**/cam:", "/lab:\n /cam:", "/**/lab/cam:", "/**:\n cam:",
    ],
)  # fmt: skip
def test_names_of_the_node(keys):
    assert found(f"{keys}\n   ros__parameters: {{a: 1, b: {{c: x}}}}\n") == {"a": 1, "b.c": "x"}


@pytest.mark.parametrize("keys", ["/cam:", "/*:", "/lab:", "/lab/cam/x:", "/*/*/cam:", "/lab/ca*:"])
def test_names_of_other_nodes(keys):
    with pytest.raises(Exception, match="has no parameters for /lab/cam; it has those of /"):
        found(f"{keys}\n  ros__parameters: {{a: 1}}\n")


def test_the_nodes_own_name_takes_precedence_over_wildcards():
    text = "/lab/cam: {ros__parameters: {a: 1}}\n/**: {ros__parameters: {a: 2, b: 3}}\n"
    assert found(text) == {"a": 1, "b": 3}
    assert found(text, use_wildcard=False) == {"a": 1}


def test_values_keep_the_types_that_they_have_in_the_file():
    text = """
/**:
  ros__parameters:
    number: 1
    double: 1.0
    digits: '1'
    word: yes
    quoted: "yes"
    nothing:
    arm.speed: .inf
    list: [1.0, .nan]
    octets:
    - !!binary AA==
    - !!binary |
      /w==
"""
    values = read_text(text, "/x")
    assert values["number"] == (2, 1) and values["double"] == (3, 1.0)
    assert values["digits"] == (4, "1") and values["quoted"] == (4, "yes")
    assert values["word"] == (1, True) and values["nothing"] == (0, None)
    assert values["arm.speed"] == (3, math.inf) and values["octets"] == (5, b"\x00\xff")
    assert values["list"].kind == 8 and math.isnan(values["list"].value[1])


@pytest.mark.parametrize(
    "text, said",
    [
        ("- a", "line 1, column 1, at '- a': names of nodes were expected"),
        ("word", "line 1, column 1, at 'word': names of nodes were expected"),
        ("ros__parameters: {}", "the name of a node was expected above ros__parameters"),
        ("/x:\n  a: 1", "line 2, column 6, at '1': names of nodes were expected"),
        ("/x:\n  ros__parameters: [1]", "line 2, column 20.*names of parameters were expected"),
        ("/x:\n  ros__parameters:\n    a: [1,\n     b]", "line 4, column 6.*all of one kind"),
        ("/x:\n  ros__parameters:\n    a: [1, 2.5]", "column 12, at '2.5\\]'.*all of one kind"),
        ("/x:\n  ros__parameters:\n    a: [[1]]", "line 3, column 8.*all of one kind"),
        ("/x:\n  ros__parameters:\n    a: 99999999999999999999", "line 3.*fit 64 bits"),
        ("/x:\n  ros__parameters:\n    a: 1\n    a: 2", "line 4.*'a' stands there twice"),
        ("/x:\n  ros__parameters:\n    a: *b", "line 3.*alias or a tag"),
        ("/x:\n  ros__parameters:\n    a: !!binary '#'", "line 3.*base64"),
        ('/x:\n  ros__parameters:\n    a: "\\0"', "line 3.*NUL"),
        ("/x:\n  ros__parameters:\n   a: 1\n  b", "line 5|line 4"),
        ("/x:\n\tros__parameters: 1", "line 2.*tab"),
    ],
)
def test_faults_name_the_line(text, said):
    with pytest.raises(YamlError, match=said):
        read_text(text, "/x")


def test_files_that_cannot_be_read(tmp_path):
    file = tmp_path / "x.yaml"
    with pytest.raises(ToolError, match="x.yaml cannot be read: No such file"):
        read_file(file, "/x")
    with pytest.raises(ToolError, match="cannot be read: Is a directory"):
        read_file(tmp_path, "/x")
    file.write_bytes(b"/x: \xff")
    with pytest.raises(ToolError, match="x.yaml is not text in UTF-8"):
        read_file(file, "/x")
    file.write_text("/x: {")
    with pytest.raises(ToolError, match="x.yaml: line 1"):
        read_file(file, "/x")
    for text in ("", "# nothing\n"):
        file.write_text(text)
        with pytest.raises(ToolError, match="has no parameters for /x; it has those of no node"):
            read_file(file, "/x")
    file.write_text("/lab/cams: {ros__parameters: {}}")
    with pytest.raises(ToolError, match="it has those of /lab/cams; did you mean '/lab/cams'"):
        read_file(file, "/lab/cam")
    file.write_bytes(b"\xef\xbb\xbf/x: {ros__parameters: {a: 1}}\r\n")
    assert read_file(file, "/x") == {"a": Typed(2, 1)}


NAMES = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), min_size=1)
INTS = st.integers(-(2**63), 2**63 - 1)
TEXT = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]))
VALUES = st.one_of(
    st.builds(Typed, st.just(1), st.booleans()),
    st.builds(Typed, st.just(2), INTS),
    st.builds(Typed, st.just(3), st.floats(allow_nan=False)),
    st.builds(Typed, st.just(4), TEXT),
    st.builds(Typed, st.just(5), st.binary(min_size=1)),
    st.builds(Typed, st.just(6), st.lists(st.booleans())),
    st.builds(Typed, st.just(7), st.lists(INTS, min_size=1)),
    st.builds(Typed, st.just(8), st.lists(st.floats(allow_nan=False), min_size=1)),
    st.builds(Typed, st.just(9), st.lists(TEXT, min_size=1)),
)


@given(st.dictionaries(NAMES, VALUES))
def test_what_dump_prints_is_what_load_reads(values):
    assert read_text(dumped("/lab/cam", values), "/lab/cam") == values


@given(st.text(alphabet=st.sampled_from("/x:*-[]{}1.'\"!&# \n\tros__parametersbinary")))
def test_any_text_is_read_or_refused(text):
    try:
        read_text(text, "/x")
    except YamlError:
        pass
    except Exception as error:
        assert "has no parameters for /x" in str(error)


def test_dump_nests_names_by_their_dots():
    values = {"b": Typed(2, 1), "a.b.c": Typed(4, "x"), "a": Typed(3, 1.0), "n": Typed(0, None)}
    assert dumped("/cam", values) == (
        "/cam:\n  ros__parameters:\n    a: 1.0\n    a.b.c: x\n    b: 1\n    n: null\n"
    )
