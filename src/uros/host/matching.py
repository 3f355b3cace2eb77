"""A QoS profile that every publisher of a topic matches, as ``ros2 topic echo`` chooses it."""

from __future__ import annotations

from collections.abc import Sequence

from ..qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy


def adapt(
    profile: QoSProfile,
    offered: Sequence[QoSProfile],
    keep_reliability: bool = False,
    keep_durability: bool = False,
) -> list[str]:
    """Set reliability and durability of ``profile`` to the best that all publishers offer.

    The profile becomes reliable only if all publishers are, and transient local only if all are;
    its partitions are those of the publishers. Without publishers nothing is changed.

    Args:
        profile: The profile to change.
        offered: The profiles of the publishers.
        keep_reliability: Leave the reliability as it is.
        keep_durability: Leave the durability as it is.

    Returns:
        A sentence for each policy that only some publishers offer.
    """
    if not offered:
        return []
    notes = []
    if not keep_reliability:
        reliable = [qos.reliable for qos in offered]
        profile.reliability = (
            ReliabilityPolicy.RELIABLE if all(reliable) else ReliabilityPolicy.BEST_EFFORT
        )
        if any(reliable) and not all(reliable):
            notes.append(_note("reliable", "best effort"))
    if not keep_durability:
        transient = [qos.transient_local for qos in offered]
        profile.durability = (
            DurabilityPolicy.TRANSIENT_LOCAL if all(transient) else DurabilityPolicy.VOLATILE
        )
        if any(transient) and not all(transient):
            notes.append(_note("transient local", "volatile"))
    # No partition and the partition "" are the same.
    partitions = {name for qos in offered for name in qos.partitions or ("",)}
    profile.partitions = () if partitions == {""} else tuple(sorted(partitions))
    return notes


def _note(some: str, fallback: str) -> str:
    return (
        f"some, but not all, publishers are {some}; listening as {fallback},"
        " which reaches all of them"
    )
