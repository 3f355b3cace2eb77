"""A board starts with any content of its parameter file."""

import json
import string

from hypothesis import example, given
from hypothesis import strategies as st

from uros.client.parameter_file import ParameterFile


class Timer:
    def cancel(self):
        pass


class Node:
    def create_timer(self, period, callback):
        return Timer()


def opened(path, octets):
    path.write_bytes(octets)
    file, lines = ParameterFile(str(path)), []
    file.say = lines.append
    file.open(Node())
    return file, lines


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner),
    max_leaves=8,
)


@given(octets=st.binary(max_size=200))
@example(octets=b"[" * 100_000)
@example(octets=b'{"a": [8, [1' + b"0" * 400 + b"]]}")
@example(octets=b'{"a": [3, 1' + b"0" * 400 + b"]}")
def test_any_bytes_in_a_parameter_file(tmp_path_factory, octets):
    file, lines = opened(tmp_path_factory.mktemp("flash") / "params.json", octets)
    assert bool(file.values) or lines or octets.strip() == b"{}"


@given(st.dictionaries(st.text(string.ascii_letters, max_size=4), VALUES, max_size=4))
@example({"a": [2, 10**400], "b": [3, 10**400], "c": [77, 1], "d": ["x", 1], "e": [None, 5]})
def test_any_json_in_a_parameter_file(tmp_path_factory, content):
    octets = json.dumps(content).encode()
    file, lines = opened(tmp_path_factory.mktemp("flash") / "params.json", octets)
    assert len(file.values) + len(lines) == len(content)
    for name, parameter in file.values.items():
        assert parameter.name == name and parameter.type_.value == parameter.kind
