"""The lines of keys in a TOML file."""

import pytest

from uros.agent.policy.config_values import ConfigError
from uros.agent.policy.toml_file import MAX_FILE, TomlError, TomlFile

TEXT = """\
# a comment
[agent]
verbose = 5

refs = [
    "a",
    "b",
]

[[transport]]
type = "udp4"

# another
[[transport]]
type = "tcp4"
port = 1
tls.deep = 2
text = \"\"\"
[[transport]]
x = 1
\"\"\"

[client.qos."/odom"]
depth = 1
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text(TEXT)
    return TomlFile(path)


@pytest.mark.parametrize(
    ("place", "line"),
    [
        (("agent",), "[agent]"),
        (("agent", "verbose"), "verbose = 5"),
        (("agent", "refs"), "refs = ["),
        (("transport",), "[[transport]]"),
        (("transport", 1), "# another"),
        (("transport", 1, "type"), 'type = "tcp4"'),
        (("transport", 1, "port"), "port = 1"),
        (("transport", 1, "tls", "deep"), "tls.deep = 2"),
        (("transport", 1, "text"), 'text = """'),
        (("transport", 1, "none"), "# another"),
        (("client", "qos", "/odom", "depth"), "depth = 1"),
        (("agent", "none"), "[agent]"),
        (("none",), "# a comment"),
    ],
)
def test_the_line_of_a_value_or_of_the_table_that_it_is_not_in(file, place, line):
    number = TEXT.splitlines().index(line) + 1
    if line == "# another":
        number += 1
    assert file.line(*place) == number


def test_a_file_without_a_line_end(tmp_path):
    path = tmp_path / "a.toml"
    path.write_bytes(b"a = 1\r\nb = 2")
    assert TomlFile(path).line("b") == 2


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"a = \n", "no TOML: Invalid value (at line 1, column 5)"),
        (b"a = '\xff'\n", "no TOML: "),
        (b"a = " + b"1" * 5000, "no TOML: "),
        (b"#" * (MAX_FILE + 1), f"over {MAX_FILE} bytes"),
    ],
)
def test_a_file_that_is_no_toml_is_named(tmp_path, content, said):
    path = tmp_path / "a.toml"
    path.write_bytes(content)
    with pytest.raises(ConfigError) as error:
        TomlFile(path)
    assert str(error.value).startswith(f"{path}: ") and said in str(error.value)


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    with pytest.raises(ConfigError, match="No such file"):
        TomlFile(tmp_path / "none")
    with pytest.raises(ConfigError, match="null"):
        TomlFile("a\0b")


def test_a_byte_order_mark_is_skipped(tmp_path):
    path = tmp_path / "a.toml"
    path.write_bytes(b"\xef\xbb\xbf[agent]\nverbose = 5\n")
    file = TomlFile(path)
    assert file.content == {"agent": {"verbose": 5}}
    assert file.line("agent", "verbose") == 2


@pytest.mark.parametrize(
    ("raw", "line"),
    [
        (b"[agent]\nverbose = \n", 2),
        (b"[agent]\n\n[agent]\nverbose = 1\n", 3),
        (b"[agent]\nrefs = [\n  1,\n", 3),
        (b"[agent]\nname = '\xff'\n", 2),
        (b"a = " + b"[" * 5000, 1),
        (b"\na = " + b"1" * 5000, 1),
    ],
)
def test_a_fault_has_the_line_that_the_parser_tells(tmp_path, raw, line):
    path = tmp_path / "a.toml"
    path.write_bytes(raw)
    with pytest.raises(TomlError) as error:
        TomlFile(path)
    assert error.value.line == line
    assert str(error.value) == f"{path}: {error.value.reason}"
    assert error.value.reason.startswith("no TOML: ")
