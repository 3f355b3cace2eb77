"""The definitions of each ROS 2 distribution, beside those of rosbags, and how one is chosen."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from rosbags.typesys import Stores, get_typestore
from support.paths import ROOT

from uros.interfaces import InterfaceError, distro, registry, typehash

DOCS = ROOT / "docs" / "interfaces.md"
# What rosbags' stores have not: packages that they leave out, and what came with a later release
# of a distribution than theirs.
LEFT_OUT = ("example_interfaces", "test_msgs")
LATER = {"geometry_msgs/msg/VelocityStamped": ("humble", "iron")}
# They take char for a type of its own, and ours say uint8, as the octets are.
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
    """The packaged messages of the chosen distribution that the other stores may have."""
    found = [it for it in registry.packaged_types() if "/msg/" in it]
    return [it for it in found if it.partition("/")[0] not in LEFT_OUT]


def store(name):
    return get_typestore(Stores(f"ros2_{name}"))


def test_a_distribution_has_the_messages_that_rosbags_has_of_it(name):
    types = store(name)
    ours = set(messages())
    packages = {it.partition("/")[0] for it in ours}
    theirs = {it for it in types.fielddefs if it.partition("/")[0] in packages and "/msg/" in it}
    later = {it for it, those in LATER.items() if name in those}
    assert theirs - ours == set()
    assert ours - theirs == later


def test_their_fields_and_constants_are_those_of_rosbags(name):
    types = store(name)
    for one in messages():
        if one not in types.fielddefs:
            continue
        constants, fields = types.fielddefs[one]
        ours = registry.message(one)
        fields = [it for it in fields if it[0] != typehash.EMPTY_MEMBER.name]
        assert [it.name for it in ours.fields] == [it[0] for it in fields], one
        assert {(it.name, it.value) for it in ours.constants} == {
            (it[0], it[2]) for it in constants
        }, one
        assert [_octets(it.type) for it in ours.fields] == [_theirs(it[1]) for it in fields], one


def _octets(type_):
    name = {"byte": "octet", "char": "uint8"}.get(type_.name, type_.name)
    if type_.string_bound:
        name += f"<={type_.string_bound}"
    return name, type_.array, type_.size


def _theirs(field):
    kind, more = int(field[0]), field[1]
    if kind in (3, 4):
        name, _, _ = _theirs(more[0])
        array = "fixed" if kind == 3 else ("bounded" if more[1] else "unbounded")
        return name, array, more[1]
    if kind == 2:
        return more, "", 0
    base, bound = more
    base = {"byte": "octet", "char": "uint8"}.get(base, base)
    return (f"{base}<={bound}" if bound else base), "", 0


def test_hashes_are_those_of_rosbags_from_iron_on(name):
    types = store(name)
    for one in messages():
        known = typehash.known_hash(one)
        if name == "humble":
            assert known is None
        elif one in types.fielddefs and one not in CHAR:
            assert known == types.hash_rihs01(one) == typehash.type_hash(registry.message(one))


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


def test_the_environment_chooses_and_a_name_that_is_none_is_refused(monkeypatch):
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


@pytest.mark.parametrize(("chosen", "said"), [("humble", "36 True False"), ("", "40 True True")])
def test_a_host_s_classes_are_those_of_ros_distro(chosen, said):
    done = subprocess.run(
        [sys.executable, "-c", CLASS], env={"ROS_DISTRO": chosen}, capture_output=True, text=True
    )
    assert done.stdout.strip() == said, done.stderr


def test_older_definitions_differ_from_those_of_the_next_distribution(choose):
    """A file that says the same would be one too many."""
    for at, one in enumerate(distro.DISTROS[:-1]):
        folder = Path(distro.__file__).parent / "older" / one
        for file in folder.rglob("*.msg") if folder.is_dir() else ():
            full = "/".join((*file.parts[-3:-1], file.stem))
            texts = []
            for name in (one, distro.DISTROS[at + 1]):
                choose(name)
                texts.append(registry.source(full)[0])
            assert texts[0] == file.read_text() != texts[1]


def differences():
    """Rows of the table: type, and what it is in each distribution beside the newest one."""
    rows = {}
    for one in registry.packaged_types():
        marks = []
        for name in distro.DISTROS:
            distro.use(name)
            if not registry.exists(one):
                marks.append("–")
                continue
            text = registry.source(one)[0]
            distro.use(distro.NEWEST)
            marks.append("as now" if text == registry.source(one)[0] else "another")
        if set(marks) != {"as now"}:
            rows[one] = marks
    return rows


def test_the_page_s_table_is_what_differs(choose):
    choose(distro.NEWEST)
    section = DOCS.read_text().partition("## Distributions of ROS 2")[2].partition("\n## ")[0]
    told = {}
    for line in section.splitlines():
        cells = [cell.strip() for cell in line.strip("| ").split("|")]
        if len(cells) == 6 and re.match(r"`\w+/\w+/\w+`", cells[0]):
            for one in re.findall(r"`(\w+/\w+/\w+)`", cells[0]):
                told[one] = cells[1:5]
    assert told == differences()
