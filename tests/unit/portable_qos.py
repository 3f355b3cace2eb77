"""QoS profiles and the flags they travel as. Also runs on MicroPython."""

from uros import qos
from uros.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSProfile,
    ReliabilityPolicy,
    from_flags,
    to_flags,
)
from uros.wire import ids


def test_named_profiles_are_those_of_rmw() -> None:
    profile = qos.default_profile()
    assert profile.depth == 10 and profile.reliable and not profile.transient_local
    assert profile.history == HistoryPolicy.KEEP_LAST
    assert qos.services_profile() == profile
    sensor = qos.sensor_data_profile()
    assert sensor.depth == 5 and not sensor.reliable and not sensor.transient_local


def test_profiles_are_equal_if_all_fields_are() -> None:
    assert QoSProfile() == QoSProfile() and hash(QoSProfile()) == hash(QoSProfile())
    assert QoSProfile() != 10
    for name, value in (
        ("depth", 11),
        ("reliability", ReliabilityPolicy.BEST_EFFORT),
        ("durability", DurabilityPolicy.TRANSIENT_LOCAL),
        ("history", HistoryPolicy.KEEP_ALL),
        ("deadline_ms", 1),
        ("lifespan_ms", 1),
        ("liveliness", qos.LivelinessPolicy.MANUAL_BY_TOPIC),
        ("liveliness_lease_ms", 1),
        ("ownership_exclusive", True),
        ("ownership_strength", 1),
        ("separation_ms", 1),
        ("partitions", ("a",)),
        ("user_data", b"x"),
    ):
        other = QoSProfile()
        setattr(other, name, value)
        assert other != QoSProfile(), name
        assert QoSProfile(**{name: value}) == other
        assert "%s=%r" % (name, value) in repr(other)


def test_flags_of_recorded_writers() -> None:
    # tests/captures: rclc_image and binary_entities
    profile = from_flags(0x03, 10)
    assert profile == QoSProfile(10)
    profile = from_flags(0x0B, None)
    assert profile == QoSProfile(1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def test_each_flag() -> None:
    assert from_flags(0, 3) == QoSProfile(
        3, ReliabilityPolicy.BEST_EFFORT, history=HistoryPolicy.KEEP_ALL
    )
    assert from_flags(0x06, 1).ownership_exclusive
    for flag, durability in (
        (0x00, DurabilityPolicy.VOLATILE),
        (0x08, DurabilityPolicy.TRANSIENT_LOCAL),
        (0x10, DurabilityPolicy.TRANSIENT),
        (0x20, DurabilityPolicy.PERSISTENT),
    ):
        profile = from_flags(flag | 0x03, 1)
        assert profile.durability == durability
        assert profile.transient_local == (flag != 0)
    assert not QoSProfile(durability=DurabilityPolicy.SYSTEM_DEFAULT).transient_local


def test_flags_survive_a_round_trip() -> None:
    for flags in range(64):
        if flags & 0x38 in (0x00, 0x08, 0x10, 0x20):
            assert to_flags(from_flags(flags, 7)) == flags
            assert from_flags(flags, 7).depth == 7


def test_system_defaults_in_flags() -> None:
    profile = QoSProfile(
        reliability=ReliabilityPolicy.SYSTEM_DEFAULT,
        durability=DurabilityPolicy.SYSTEM_DEFAULT,
        history=HistoryPolicy.SYSTEM_DEFAULT,
    )
    assert to_flags(profile) == to_flags(qos.qos_profile_system_default) == 0x03
    assert to_flags(profile, ids.KIND_DATAWRITER) == 0x03
    assert to_flags(profile, ids.KIND_DATAREADER) == 0x02


def test_presets_are_those_of_rclpy() -> None:
    """tests/interop asks rclpy for them."""
    local = DurabilityPolicy.TRANSIENT_LOCAL
    for profile, same in (
        (qos.qos_profile_default, QoSProfile(10)),
        (qos.qos_profile_sensor_data, QoSProfile(5, ReliabilityPolicy.BEST_EFFORT)),
        (qos.qos_profile_services_default, QoSProfile(10)),
        (qos.qos_profile_parameters, QoSProfile(1000)),
        (qos.qos_profile_parameter_events, QoSProfile(1000)),
        (qos.qos_profile_rosout_default, QoSProfile(1000, durability=local, lifespan_ms=10000)),
        (qos.qos_profile_action_status_default, QoSProfile(1, durability=local)),
    ):
        assert profile == same
        assert to_flags(profile, ids.KIND_DATAWRITER) == to_flags(profile)


def test_unsupported_policies_are_rejected_with_the_remedy() -> None:
    writer, reader = ids.KIND_DATAWRITER, ids.KIND_DATAREADER
    services = (ids.KIND_REQUESTER, ids.KIND_REPLIER)
    endpoints = (writer, reader)
    every = endpoints + services
    for name, value, kinds, said in (
        ("reliability", 3, every, "RELIABLE or BEST_EFFORT"),
        ("reliability", 4, every, "RELIABLE or BEST_EFFORT"),
        ("durability", 3, every, "TRANSIENT_LOCAL"),
        ("durability", 4, every, "TRANSIENT_LOCAL"),
        ("durability", DurabilityPolicy.TRANSIENT_LOCAL, services, "VOLATILE for a service"),
        ("durability", DurabilityPolicy.PERSISTENT, services, "VOLATILE for a service"),
        ("history", 3, every, "KEEP_ALL"),
        ("liveliness", qos.LivelinessPolicy.MANUAL_BY_TOPIC, every, "AUTOMATIC"),
        ("liveliness", 5, every, "AUTOMATIC"),
        ("liveliness_lease_ms", 100, every, "None"),
        ("depth", -1, every, "0 to 65535"),
        ("depth", 65536, every, "0 to 65535"),
        ("deadline_ms", -1, every, "1 to 4294967295"),
        ("deadline_ms", 1 << 32, every, "1 to 4294967295"),
        ("lifespan_ms", 1 << 32, every, "1 to 4294967295"),
        ("deadline_ms", 5, services, "None for a service"),
        ("lifespan_ms", 5, services, "None for a service"),
        ("ownership_exclusive", True, services, "XML"),
        ("partitions", ("a",), every, "XML"),
        ("separation_ms", 5, every, "XML"),
        ("ownership_strength", 0, every, "XML"),
        ("user_data", b"x", every, "XML"),
    ):
        for kind in every:
            profile = QoSProfile(**{name: value})
            try:
                to_flags(profile, kind)
            except ValueError as error:
                given = "%s=%r" % (name, value)
                assert kind in kinds, (name, kind)
                assert said in str(error) and given in str(error), str(error)
            else:
                assert kind not in kinds, (name, value, kind)


def test_supported_policies_are_accepted() -> None:
    for name, value in (
        ("depth", 0), ("depth", 65535), ("deadline_ms", 0xFFFFFFFF), ("lifespan_ms", 0xFFFFFFFF),
        ("deadline_ms", 0), ("liveliness", 0), ("liveliness_lease_ms", 0), ("separation_ms", 0),
        ("durability", DurabilityPolicy.TRANSIENT), ("durability", DurabilityPolicy.PERSISTENT),
        ("ownership_exclusive", True), ("history", HistoryPolicy.KEEP_ALL),
    ):  # fmt: skip
        for kind in (ids.KIND_DATAWRITER, ids.KIND_DATAREADER):
            assert to_flags(QoSProfile(**{name: value}), kind) >= 0


def test_undefined_flags_are_ignored() -> None:
    assert from_flags(0xFFC3, 10) == from_flags(0x03, 10)


def test_a_depth_of_0_is_1() -> None:
    assert from_flags(0x03, 0).depth == 1
    assert from_flags(0x03, None).depth == 1
