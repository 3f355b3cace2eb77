"""QoS policies that ROS 2 does not have; the others are tested where rclpy is installed."""

import pytest

from uros.middleware.ros2 import profiles
from uros.qos import DurabilityPolicy, QoSProfile, sensor_data_profile


@pytest.mark.parametrize(
    ("qos", "missing"),
    [
        (QoSProfile(partitions=("a",)), "partitions"),
        (QoSProfile(ownership_exclusive=True), "exclusive ownership"),
        (QoSProfile(ownership_strength=0), "exclusive ownership"),
        (QoSProfile(separation_ms=1), "a least time between samples"),
        (QoSProfile(durability=DurabilityPolicy.TRANSIENT), "a durability beyond transient local"),
        (QoSProfile(durability=DurabilityPolicy.PERSISTENT), "a durability beyond transient local"),
    ],
)
def test_policies_that_ros_does_not_have_are_named(qos, missing):
    assert profiles.lacking(qos) == missing


@pytest.mark.parametrize(
    "qos",
    [
        QoSProfile(), sensor_data_profile(), QoSProfile(user_data=b"x", separation_ms=0),
        QoSProfile(durability=DurabilityPolicy.TRANSIENT_LOCAL, deadline_ms=1, lifespan_ms=1),
    ],
)  # fmt: skip
def test_policies_of_ros_are_accepted(qos):
    assert profiles.lacking(qos) == ""
