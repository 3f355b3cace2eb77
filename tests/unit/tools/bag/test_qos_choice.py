import pytest
from hypothesis import given
from hypothesis import strategies as st

from uros.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from uros.tools.bag.qos_choice import offered, read_overrides
from uros.tools.errors import ToolError

BEST_EFFORT, RELIABLE = ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE
LATCHED, VOLATILE = DurabilityPolicy.TRANSIENT_LOCAL, DurabilityPolicy.VOLATILE


def read(tmp_path, text):
    file = tmp_path / "qos.yaml"
    file.write_text(text, "utf-8")
    return read_overrides(str(file))


def test_overrides(tmp_path):
    found = read(
        tmp_path,
        """
/chatter:
  history: keep_all
  reliability: best_effort
  durability: transient_local
  liveliness: manual_by_topic
  deadline: {sec: 1, nsec: 500000000}
  lifespan: {sec: 0, nsec: 1}
  liveliness_lease_duration: {sec: 9223372036, nsec: 854775807}
  avoid_ros_namespace_conventions: false
/other: {depth: 7}
""",
    )
    assert found["/chatter"] == QoSProfile(
        10, BEST_EFFORT, LATCHED, HistoryPolicy.KEEP_ALL, 1500, 1, LivelinessPolicy.MANUAL_BY_TOPIC
    )
    assert found["/other"] == QoSProfile(7)
    assert read(tmp_path, "") == {} and read_overrides(None) == {}


@pytest.mark.parametrize(
    "text, said",
    [
        ("x", "expected topics"),
        ("/x: 1", "/x: expected policies"),
        ("/x: {reliabilty: reliable}", "no policy 'reliabilty'; did you mean 'reliability'"),
        ("/x: {reliability: relible}", "'relible' is none of"),
        ("/x: {depth: -1}", "/x: depth: expected an integer"),
        ("/x: {depth: true}", "/x: depth: expected an integer"),
        ("/x: {deadline: 1}", "/x: deadline: expected {sec"),
        ("/x: {deadline: {sec: 1, nsec: x}}", "/x: deadline: nsec: expected an integer"),
        ("/x: {a: b: c}", "a comma or } was expected"),
    ],
)
def test_wrong_overrides_are_named(tmp_path, text, said):
    with pytest.raises(ToolError, match="qos.yaml") as caught:
        read(tmp_path, text)
    assert said in str(caught.value)


@given(st.text(max_size=60))
def test_any_text_is_a_profile_or_a_tool_error(tmp_path_factory, text):
    file = tmp_path_factory.getbasetemp() / "any.yaml"
    file.write_text(text, "utf-8", "surrogatepass")
    try:
        assert isinstance(read_overrides(str(file)), dict)
    except ToolError:
        pass


def test_a_file_that_cannot_be_read(tmp_path):
    for path in (tmp_path, tmp_path / "none"):
        with pytest.raises(ToolError, match="qos-profile-overrides-path"):
            read_overrides(str(path))


# --- what is offered ----------------------------------------------------------------------------


def test_the_recorded_profile_is_offered():
    qos, differ = offered([QoSProfile(5, BEST_EFFORT, deadline_ms=100)])
    assert (qos.reliability, qos.durability, qos.deadline_ms) == (BEST_EFFORT, VOLATILE, 100)
    assert not differ and qos.history == HistoryPolicy.KEEP_LAST


def test_nothing_recorded_is_the_default():
    qos, differ = offered([])
    assert (qos.reliability, qos.durability, differ) == (RELIABLE, VOLATILE, False)


@pytest.mark.parametrize("depths, depth", [([1], 1), ([0], 10), ([1, 1, 1], 3), ([5, 0], 15)])
def test_a_latched_topic_has_room_for_what_all_publishers_latched(depths, depth):
    qos, _ = offered([QoSProfile(each, durability=LATCHED) for each in depths])
    assert qos.transient_local and qos.depth == depth


def test_publishers_that_differ_give_the_strongest():
    qos, differ = offered(
        [QoSProfile(1, BEST_EFFORT), QoSProfile(1, RELIABLE), QoSProfile(1, durability=LATCHED)]
    )
    assert differ and qos.reliable and qos.transient_local


def test_unknown_policies_are_those_of_a_writer():
    qos, differ = offered(
        [QoSProfile(0, 3, 3, 3, liveliness=4), QoSProfile(0, 0, 0, 0, liveliness=0)]
    )
    assert not differ
    assert qos == QoSProfile(1000)


def test_keep_all_stays():
    assert (
        offered([QoSProfile(history=HistoryPolicy.KEEP_ALL)])[0].history == HistoryPolicy.KEEP_ALL
    )
