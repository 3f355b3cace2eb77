"""QoS profiles as rclpy's.

rclpy has no partitions, no ownership, no time-based filter, and of durabilities only volatile and
transient local. These decide which endpoints match, so a profile that asks for more is refused.
User data only informs, and is left out.
"""

from __future__ import annotations

from typing import Any, Final

from ...qos import DurabilityPolicy, HistoryPolicy, QoSProfile
from ..base import MiddlewareError

_MAX_DEPTH: Final = 0x7FFFFFFF
_MAX_MS: Final = 0x7FFFFFFF * 1000  # DDS has 31 bits for seconds


def lacking(qos: QoSProfile) -> str:
    """Return what the profile asks for and rclpy does not have; '' if it has everything."""
    if qos.partitions:
        return "partitions"
    if qos.ownership_exclusive or qos.ownership_strength is not None:
        return "exclusive ownership"
    if qos.separation_ms:
        return "a least time between samples"
    if qos.durability in (DurabilityPolicy.TRANSIENT, DurabilityPolicy.PERSISTENT):
        return "a durability beyond transient local"
    return ""


def to_rclpy(qos: QoSProfile) -> Any:
    """Return the profile as rclpy's C interface takes it.

    Raises:
        MiddlewareError: It asks for what rclpy does not have.
    """
    from rclpy import qos as ros
    from rclpy.duration import Duration

    missing = lacking(qos)
    if missing:
        raise MiddlewareError(f"ROS 2 has no {missing}: start the agent with -m dds")

    def duration(milliseconds: int | None) -> Any:
        if milliseconds is None:
            return Duration()  # zero: rmw's way to say unlimited
        return Duration(nanoseconds=min(milliseconds, _MAX_MS) * 1_000_000)

    keep_all = qos.history == HistoryPolicy.KEEP_ALL
    return ros.QoSProfile(
        history=ros.HistoryPolicy.KEEP_ALL if keep_all else ros.HistoryPolicy.KEEP_LAST,
        depth=max(1, min(qos.depth, _MAX_DEPTH)),
        reliability=ros.ReliabilityPolicy(qos.reliability),
        durability=ros.DurabilityPolicy(qos.durability),
        deadline=duration(qos.deadline_ms),
        lifespan=duration(qos.lifespan_ms),
        liveliness=ros.LivelinessPolicy(qos.liveliness),
        liveliness_lease_duration=duration(qos.liveliness_lease_ms),
    ).get_c_qos_profile()
