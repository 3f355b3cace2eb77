"""QoS profiles that match all publishers of a topic."""

import pytest

from uros.host.matching import adapt
from uros.qos import DurabilityPolicy as D
from uros.qos import QoSProfile
from uros.qos import ReliabilityPolicy as R


def offers(*pairs):
    return [QoSProfile(reliability=r, durability=d) for r, d in pairs]


@pytest.mark.parametrize(
    "offered, reliability, durability, notes",
    [
        ([], R.BEST_EFFORT, D.VOLATILE, 0),
        ([(R.RELIABLE, D.VOLATILE)], R.RELIABLE, D.VOLATILE, 0),
        ([(R.RELIABLE, D.TRANSIENT_LOCAL)], R.RELIABLE, D.TRANSIENT_LOCAL, 0),
        ([(R.BEST_EFFORT, D.VOLATILE)], R.BEST_EFFORT, D.VOLATILE, 0),
        ([(R.RELIABLE, D.VOLATILE), (R.BEST_EFFORT, D.VOLATILE)], R.BEST_EFFORT, D.VOLATILE, 1),
        (
            [(R.RELIABLE, D.TRANSIENT_LOCAL), (R.BEST_EFFORT, D.VOLATILE)],
            R.BEST_EFFORT,
            D.VOLATILE,
            2,
        ),
        ([(R.RELIABLE, D.TRANSIENT), (R.RELIABLE, D.PERSISTENT)], R.RELIABLE, D.TRANSIENT_LOCAL, 0),
    ],
)
def test_only_policies_that_all_publishers_offer_are_requested(
    offered, reliability, durability, notes
):
    profile = QoSProfile(5, R.BEST_EFFORT)
    assert len(adapt(profile, offers(*offered))) == notes
    assert (profile.reliability, profile.durability) == (reliability, durability)
    assert profile.depth == 5


def test_requested_policies_are_kept():
    profile = QoSProfile(reliability=R.BEST_EFFORT, durability=D.VOLATILE)
    offered = offers((R.RELIABLE, D.TRANSIENT_LOCAL))
    assert adapt(profile, offered, keep_reliability=True) == []
    assert (profile.reliability, profile.durability) == (R.BEST_EFFORT, D.TRANSIENT_LOCAL)
    profile = QoSProfile(reliability=R.BEST_EFFORT, durability=D.VOLATILE)
    adapt(profile, offered, keep_durability=True)
    assert (profile.reliability, profile.durability) == (R.RELIABLE, D.VOLATILE)


def test_partitions_of_all_publishers():
    profile = QoSProfile()
    adapt(profile, [QoSProfile(), QoSProfile(partitions=("",))])
    assert profile.partitions == ()
    adapt(profile, [QoSProfile(partitions=("b", "a")), QoSProfile()])
    assert profile.partitions == ("", "a", "b")
