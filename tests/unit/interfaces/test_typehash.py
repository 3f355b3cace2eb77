"""Type hashes against rosbags and against the hashes that ROS 2 installs carry."""

from pathlib import Path

import pytest
from unit.interfaces import samples

import uros.interfaces
from uros.interfaces import known_hash, registry, typehash
from uros.interfaces.parse import parse_msg

# Copied from share/*/{msg,srv,action}/*.json ("type_hashes") of the ROS 2 Kilted packages: all of
# actions, services and char, and the messages of packages that were added after the others.
INSTALLED = dict(
    line.split()
    for line in Path(__file__).with_name("installed_hashes.txt").read_text("ascii").splitlines()
)
# From share/test_msgs/msg/WStrings.json of ROS 2 Kilted.
WSTRINGS = "5a2c8ddb2054600023b9a180652f2ba895373217cad4b1f0fc1258c9e4424a79"
WSTRINGS_TEXT = """
wstring wstring_value
wstring wstring_value_default1 "Hello world!"
wstring wstring_value_default2 "Hellö wörld!"
wstring wstring_value_default3 "ハローワールド"
wstring[3] array_of_wstrings
wstring[<=3] bounded_sequence_of_wstrings
wstring[] unbounded_sequence_of_wstrings
"""
MESSAGES = [name for name in registry.packaged_types() if "/msg/" in name]
# Neither in an install from PyPI, nor does rosbags hash them as ROS 2 does.
UNKNOWN = {"example_interfaces/msg/Char", "example_interfaces/msg/WString"}


@pytest.mark.parametrize("name", MESSAGES)
def test_against_rosbags(name):
    message = registry.message(name)
    # rosbags hashes char as a type of its own where ROS 2 takes it for uint8, its Gid is of char,
    # and it has no wstring.
    odd = samples.holds(message, "char") or samples.holds(message, "wstring")
    if odd or name.startswith("rmw_dds_common/"):
        assert name in INSTALLED or name in UNKNOWN
    else:
        assert typehash.type_hash(message) == samples.store().hash_rihs01(name)


@pytest.mark.parametrize("name", INSTALLED)
def test_against_installed(name):
    definition = registry.definition(name)
    assert typehash.type_hash(definition) == INSTALLED[name]
    assert known_hash(name) == INSTALLED[name]


def test_wstrings():
    message = parse_msg(WSTRINGS_TEXT, "test_msgs", "WStrings")
    assert typehash.type_hash(message) == "RIHS01_" + WSTRINGS


def test_table_is_current():
    table = Path(typehash.__file__).with_name("hashes.txt")
    assert table.read_text(encoding="ascii") == typehash.table_text(), (
        "run python -m uros.interfaces.typehash"
    )


def test_spellings():
    want = known_hash("std_msgs/msg/Int32")
    assert want
    assert known_hash("std_msgs/Int32") == want
    assert known_hash("std_msgs::msg::dds_::Int32_") == want
    assert known_hash("std_msgs/msg/Nothing") is None
    assert known_hash("///") is None
    assert uros.interfaces.known_hash("std_srvs::srv::dds_::Trigger_Request_") == known_hash(
        "std_srvs/srv/Trigger_Request"
    )
