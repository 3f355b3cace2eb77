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


def test_named_profiles_are_those_of_rmw() -> None:
    profile = qos.default_profile()
    assert profile.depth == 10 and profile.reliable and not profile.transient_local
    assert profile.history == HistoryPolicy.KEEP_LAST
    assert qos.services_profile() == profile
    sensor = qos.sensor_data_profile()
    assert sensor.depth == 5 and not sensor.reliable and not sensor.transient_local


def test_equal_where_every_field_is() -> None:
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


def test_flags_come_back() -> None:
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
    assert to_flags(profile) == 0x02


def test_flags_without_a_meaning_are_passed_over() -> None:
    assert from_flags(0xFFC3, 10) == from_flags(0x03, 10)


def test_a_depth_of_0_is_none() -> None:
    assert from_flags(0x03, 0).depth == 1
    assert from_flags(0x03, None).depth == 1
