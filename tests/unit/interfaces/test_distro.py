"""The definitions of each ROS 2 distribution, compared with rosbags, and the choice of one."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from rosbags.typesys import Stores, get_typestore
from support.paths import ROOT

from uros.interfaces import InterfaceError, distro, registry, typehash

DOCS = ROOT / "docs" / "interfaces.md"
# Missing in rosbags' stores: packages that they leave out, and types that a later release of a
# distribution added.
LEFT_OUT = ("example_interfaces", "test_msgs")
LATER = {"geometry_msgs/msg/VelocityStamped": ("humble", "iron")}
# rosbags treats char as a separate type; the definitions of uros have uint8, as the octets are.
CHAR = {
    "rmw_dds_common/msg/Gid", "rmw_dds_common/msg/NodeEntitiesInfo",
    "rmw_dds_common/msg/ParticipantEntitiesInfo", "service_msgs/msg/ServiceEventInfo",
    "std_msgs/msg/Char",
}  # fmt: skip


@pytest.fixture
def choose():
    """Choose a distribution for a test."""
    yield distro.use
    distro.use("")


@pytest.fixture(params=distro.DISTROS)
def name(request, choose):
    choose(request.param)
    return request.param


def messages():
    """Return the packaged messages of the chosen distribution, of packages that rosbags has."""
    names = [name for name in registry.packaged_types() if "/msg/" in name]
    return [name for name in names if name.partition("/")[0] not in LEFT_OUT]


def store(name):
    return get_typestore(Stores(f"ros2_{name}"))


def test_a_distribution_has_the_messages_that_rosbags_has_of_it(name):
    types = store(name)
    packaged = set(messages())
    packages = {type_name.partition("/")[0] for type_name in packaged}
    known = {
        type_name
        for type_name in types.fielddefs
        if type_name.partition("/")[0] in packages and "/msg/" in type_name
    }
    later = {type_name for type_name, distros in LATER.items() if name in distros}
    assert known - packaged == set()
    assert packaged - known == later


def test_fields_and_constants_are_those_of_rosbags(name):
    types = store(name)
    for full in messages():
        if full not in types.fielddefs:
            continue
        constants, fields = types.fielddefs[full]
        message = registry.message(full)
        fields = [pair for pair in fields if pair[0] != typehash.EMPTY_MEMBER.name]
        assert [field.name for field in message.fields] == [pair[0] for pair in fields], full
        assert {(constant.name, constant.value) for constant in message.constants} == {
            (constant[0], constant[2]) for constant in constants
        }, full
        kinds = [_octets(field.type) for field in message.fields]
        assert kinds == [_rosbags_octets(pair[1]) for pair in fields], full


def _octets(type_):
    name = {"byte": "octet", "char": "uint8"}.get(type_.name, type_.name)
    if type_.string_bound:
        name += f"<={type_.string_bound}"
    return name, type_.array, type_.size


def _rosbags_octets(field):
    kind, more = int(field[0]), field[1]
    if kind in (3, 4):
        name, _, _ = _rosbags_octets(more[0])
        array = "fixed" if kind == 3 else ("bounded" if more[1] else "unbounded")
        return name, array, more[1]
    if kind == 2:
        return more, "", 0
    base, bound = more
    base = {"byte": "octet", "char": "uint8"}.get(base, base)
    return (f"{base}<={bound}" if bound else base), "", 0


def test_hashes_are_those_of_rosbags_from_iron_on(name):
    types = store(name)
    for full in messages():
        known = typehash.known_hash(full)
        if name == "humble":
            assert known is None
        elif full in types.fielddefs and full not in CHAR:
            digest = typehash.type_hash(registry.message(full))
            assert known == types.hash_rihs01(full) == digest


def test_humble_has_no_services_of_later_ones_and_classes_without_hashes(choose):
    choose("humble")
    assert not registry.exists("rcl_interfaces/srv/GetLoggerLevels")
    assert not registry.has_package("service_msgs")
    assert "type_description_interfaces" not in registry.packages()
    assert typehash.hash_of(registry.definition("std_srvs/srv/Trigger")) == ""
    assert typehash.known_hash("std_srvs/srv/Trigger") is None
    assert typehash.is_known("std_srvs::srv::dds_::Trigger_Request_")
    with pytest.raises(InterfaceError, match="came with ROS 2 Iron.*definitions of Humble"):
        registry.definition("rcl_interfaces/msg/LoggerLevel")


def test_ros_distro_chooses_and_an_unknown_name_is_rejected(monkeypatch):
    monkeypatch.setenv("ROS_DISTRO", " Humble ")
    assert distro.chosen() == "humble"
    assert len(registry.message("sensor_msgs/msg/Range").fields) == 6
    monkeypatch.setenv("ROS_DISTRO", "")
    assert distro.chosen() == "kilted"
    assert len(registry.message("sensor_msgs/msg/Range").fields) == 7
    for newer in ("rolling", "lyrical"):
        monkeypatch.setenv("ROS_DISTRO", newer)
        assert distro.chosen() == "kilted"
    monkeypatch.setenv("ROS_DISTRO", "zebra")
    with pytest.raises(InterfaceError, match="ROS_DISTRO: no definitions of ROS 2 'zebra'"):
        registry.definition("std_msgs/msg/Int32")
    assert typehash.known_hash("std_msgs/msg/Int32") is None
    with pytest.raises(InterfaceError, match="there are humble, iron, jazzy, kilted, lyrical"):
        distro.use("zebra")


CLASS = """
from uros.interfaces import load
from uros.interfaces.codec import to_cdr
from uros.interfaces.sensor_msgs.msg import Range
print(len(to_cdr(Range())), Range is load("sensor_msgs/msg/Range"), hasattr(Range(), "variance"))
"""


@pytest.mark.parametrize(("chosen", "output"), [("humble", "36 True False"), ("", "40 True True")])
def test_a_host_s_classes_are_those_of_ros_distro(chosen, output):
    done = subprocess.run(
        [sys.executable, "-c", CLASS], env={"ROS_DISTRO": chosen}, capture_output=True, text=True
    )
    assert done.stdout.strip() == output, done.stderr


def test_older_definitions_differ_from_those_of_the_next_distribution(choose):
    """A file equal to that of the next distribution would be superfluous."""
    for at, older in enumerate(distro.DISTROS[:-1]):
        folder = Path(distro.__file__).parent / "older" / older
        for file in folder.rglob("*.msg") if folder.is_dir() else ():
            full = "/".join((*file.parts[-3:-1], file.stem))
            texts = []
            for name in (older, distro.DISTROS[at + 1]):
                choose(name)
                texts.append(registry.source(full)[0])
            assert texts[0] == file.read_text() != texts[1]


def differences():
    """Return the rows of the table: a type, and how it differs in each distribution."""
    rows = {}
    for full in registry.packaged_types():
        marks = []
        for name in distro.DISTROS:
            distro.use(name)
            if not registry.exists(full):
                marks.append("–")
                continue
            text = registry.source(full)[0]
            distro.use(distro.NEWEST)
            marks.append("as now" if text == registry.source(full)[0] else "another")
        if set(marks) != {"as now"}:
            rows[full] = marks
    return rows


def test_the_table_of_the_page_has_all_differences(choose):
    choose(distro.NEWEST)
    section = DOCS.read_text().partition("## Distributions of ROS 2")[2].partition("\n## ")[0]
    listed = {}
    for line in section.splitlines():
        cells = [cell.strip() for cell in line.strip("| ").split("|")]
        if len(cells) == 6 and re.match(r"`\w+/\w+/\w+`", cells[0]):
            for full in re.findall(r"`(\w+/\w+/\w+)`", cells[0]):
                listed[full] = cells[1:5]
    assert listed == differences()
