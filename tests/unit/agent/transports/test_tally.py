"""Which of many faults are told: all are counted, whatever comes."""

from uros.agent.transports import tally
from uros.agent.transports.tally import Seldom, Tally


def test_a_tally_tells_the_first_the_second_the_fourth():
    faults = Tally()
    told = [number for number in range(1, 101) if faults.add()]
    assert told == [1, 2, 4, 8, 16, 32, 64] and faults.count == 100


def test_faults_of_one_kind_are_told_more_and_more_seldom():
    faults = Seldom()
    said = [(at, count) for at in range(1, 1001) if (count := faults.add("it", float(at)))]
    assert said[:4] == [(1, 1), (2, 1), (4, 2), (8, 4)]
    assert len(said) < 25 and sum(count for _, count in said) > 940
    # and after a quiet time as at first
    assert faults.add("it", 1e6) and faults.add("it", 1e6 + tally.FIRST)


def test_kinds_of_faults_do_not_hide_each_other_and_are_not_kept_for_ever():
    faults = Seldom()
    assert faults.add("one", 1.0) == 1 and not faults.add("one", 1.0)
    assert faults.add("other", 1.0) == 1
    for number in range(3 * tally.MAX_KINDS):
        assert faults.add(f"kind {number}", 1.0) == 1
        assert len(faults._kinds) <= tally.MAX_KINDS
