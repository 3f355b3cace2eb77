"""Below the binding's public names: topics without type information, and checks of the binding."""

import ctypes

import pytest

from uros.middleware.base import MiddlewareError
from uros.middleware.dds import builtin, config, cyclone
from uros.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)


@pytest.fixture
def participant(own_domain_id):
    import os

    cyclone.open_domain(own_domain_id, config.config_xml(os.environ, 1))
    yield cyclone.create_participant(own_domain_id, b"enclave=/;")
    cyclone.close_domain(own_domain_id)


def ops_of(topic):
    """The operations table of a topic's sertype."""
    sertype = ctypes.c_void_p()
    assert cyclone._get_entity_sertype(topic, ctypes.byref(sertype)) == 0
    table = ctypes.cast(sertype.value, ctypes.POINTER(ctypes.c_void_p))[0]
    return list(ctypes.cast(table, ctypes.POINTER(ctypes.c_void_p * 14)).contents)


def test_a_topic_announces_no_type(participant):
    first = cyclone.create_topic(participant, "rt/a", "std_msgs::msg::dds_::String_")
    second = cyclone.create_topic(participant, "rt/b", "std_msgs::msg::dds_::Int32_")
    for topic in (first, second):
        ops = ops_of(topic)
        # arg and the last two are empty in the binding's own table
        assert [i for i, entry in enumerate(ops) if entry is None] == [1, 8, 9, 10, 12, 13]


def test_all_topics_of_a_type_share_its_descriptor(participant):
    topics = [cyclone.create_topic(participant, f"rt/{i}", "pkg::msg::dds_::X_") for i in range(5)]
    sertypes = set()
    for topic in topics:
        sertype = ctypes.c_void_p()
        cyclone._get_entity_sertype(topic, ctypes.byref(sertype))
        sertypes.add(sertype.value)
    assert len(sertypes) == 1


def test_a_table_that_is_not_exported_is_recognised_by_its_shape(monkeypatch):
    """macOS and Windows do not export the table."""
    binding = ctypes.CDLL(cyclone._clayer.__file__)
    try:
        real = (ctypes.c_void_p * 14).in_dll(binding, "ddspy_sertype_ops")
    except ValueError:
        pytest.skip("not on this platform: the table is not exported")

    def no_library(*_):
        raise OSError

    monkeypatch.setattr(cyclone.ctypes, "CDLL", no_library)
    assert cyclone._is_ops_table(ctypes.addressof(real))
    for index in range(14):
        table = (ctypes.c_void_p * 14)(*real)
        table[index] = None if table[index] else 1
        assert not cyclone._is_ops_table(ctypes.addressof(table)), index


def test_a_binding_of_another_layout_is_refused(participant, monkeypatch):
    """A table other than the known one must not be patched, even if it would work."""
    create = cyclone._clayer.ddspy_topic_create
    copies = []

    class Binding:
        @staticmethod
        def ddspy_topic_create(*arguments):
            topic = create(*arguments)
            sertype = ctypes.c_void_p()
            cyclone._get_entity_sertype(topic, ctypes.byref(sertype))
            word = ctypes.cast(sertype.value, ctypes.POINTER(ctypes.c_void_p))
            copy = (ctypes.c_void_p * 14)()
            ctypes.memmove(copy, word[0], ctypes.sizeof(copy))
            copies.append(copy)
            word[0] = ctypes.addressof(copy)
            return topic

        __file__ = cyclone._clayer.__file__

    monkeypatch.setattr(cyclone, "_clayer", Binding)
    for patched_ops in ({}, dict(cyclone._patched_ops)):
        monkeypatch.setattr(cyclone, "_patched_ops", patched_ops)
        with pytest.raises(MiddlewareError, match="install the version uros is tested with"):
            cyclone.create_topic(participant, "rt/strange", "pkg::msg::dds_::Strange_")
        assert cyclone._patched_ops == patched_ops


@pytest.mark.parametrize(
    "name", ["", "a topic", "rt/ü", "x" * 300], ids=["empty", "space", "umlaut", "long"]
)
def test_a_name_is_taken_or_refused_with_an_error(participant, name):
    try:
        topic = cyclone.create_topic(participant, name, "pkg::msg::dds_::X_")
    except MiddlewareError as error:
        assert repr(name) in str(error)
    else:
        cyclone.delete(topic)


def test_qos_is_announced_as_requested(participant):
    """Peers read the QoS of an endpoint from the builtin topic."""
    requested = QoSProfile(
        depth=7,
        reliability=ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
        deadline_ms=1500,
        lifespan_ms=2500,
        liveliness=LivelinessPolicy.MANUAL_BY_TOPIC,
        liveliness_lease_ms=3500,
        partitions=("left", "right"),
        user_data=b"mine;",
    )
    topic = cyclone.create_topic(participant, "rt/qos", "pkg::msg::dds_::X_")
    writer = cyclone.create_writer(
        cyclone.create_group("publisher", participant, requested.partitions),
        topic,
        requested,
        b"ours;",
    )
    everyone = builtin.create_reader(participant, builtin.TOPIC_PUBLICATION)
    endpoints = dict(builtin.take_endpoints(everyone, 100))
    owner, name, type_name, qos = endpoints[cyclone.guid(writer)]
    assert (owner, name, type_name) == (
        cyclone.guid(participant), "rt/qos", "pkg::msg::dds_::X_",
    )  # fmt: skip
    expected = requested
    expected.user_data = b"mine;ours;"
    assert qos == expected


def test_keep_all(participant):
    topic = cyclone.create_topic(participant, "rt/qos", "pkg::msg::dds_::X_")
    requested = QoSProfile(history=HistoryPolicy.KEEP_ALL)
    reader = cyclone.create_reader(
        cyclone.create_group("subscriber", participant), topic, requested
    )
    everyone = builtin.create_reader(participant, builtin.TOPIC_SUBSCRIPTION)
    qos = dict(builtin.take_endpoints(everyone, 100))[cyclone.guid(reader)][3]
    assert qos.history == HistoryPolicy.KEEP_ALL


def test_errors_name_the_failed_action(own_domain_id):
    with pytest.raises(MiddlewareError, match=f"domain {own_domain_id} is not open"):
        cyclone.create_participant(own_domain_id, b"")
    with pytest.raises(MiddlewareError, match="DDS cannot get a GUID"):
        cyclone.guid(1)
    with pytest.raises(MiddlewareError, match="DDS cannot write"):
        cyclone.write(1, b"\0\1\0\0\0\0\0\0")
    cyclone.delete(1)


def test_types_over_the_limit_are_refused(participant, monkeypatch):
    monkeypatch.setattr(cyclone, "MAX_TYPES", len(cyclone._sertypes) + 1)
    topic = cyclone.create_topic(participant, "rt/a", "a::msg::dds_::First_")
    with pytest.raises(MiddlewareError, match="'a::msg::dds_::Second_' is refused"):
        cyclone.create_topic(participant, "rt/b", "a::msg::dds_::Second_")
    # Ordinary boards are served whatever types others have created.
    type_name = "std_msgs::msg::dds_::Int64MultiArray_"
    cyclone.delete(cyclone.create_topic(participant, "rt/d", type_name))
    cyclone.delete(cyclone.create_topic(participant, "rt/c", "a::msg::dds_::First_"))
    cyclone.delete(topic)
