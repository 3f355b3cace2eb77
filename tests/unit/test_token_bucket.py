"""Token buckets compared with a plain model and with their limits."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uros.token_bucket import KeyedTokenBuckets, TokenBucket

SECONDS = st.floats(0, 10, width=32)
BURSTS = st.floats(1, 100, width=32)
RATES = st.floats(0.0625, 100, width=32)


@given(BURSTS, RATES, st.lists(SECONDS, max_size=60))
def test_in_any_interval_no_more_passes_than_burst_and_rate_allow(burst, rate, pauses):
    bucket, now, passed = TokenBucket(burst, rate), 0.0, []
    for pause in pauses:
        now += pause
        if bucket.take(now):
            passed.append(now)
    for first in range(len(passed)):
        for last in range(first, len(passed)):
            allowed = burst + rate * (passed[last] - passed[first])
            assert last - first + 1 <= allowed + 1e-6


@given(BURSTS, RATES)
def test_a_bucket_starts_full_and_is_full_again_after_burst_over_rate_seconds(burst, rate):
    bucket = TokenBucket(burst, rate)
    assert bucket.available(1000.0) == burst
    assert sum(bucket.take(1000.0) for _ in range(200)) == int(burst)
    assert bucket.available(1000.0 + burst / rate + 1e-3) == pytest.approx(burst)


@given(BURSTS, RATES, st.lists(st.tuples(SECONDS, SECONDS, st.booleans()), max_size=60))
def test_the_level_stays_between_debt_and_burst(burst, rate, steps):
    bucket, now = TokenBucket(burst, rate), 0.0
    for pause, tokens, back in steps:
        now += pause
        (bucket.put_back if back else bucket.spend)(tokens)
        assert -burst <= bucket.available(now) <= burst
    assert bucket.available(now + 2 * burst / rate + 1e-3) == pytest.approx(burst)


@given(st.lists(st.tuples(st.floats(0, 0.5), st.floats(0, 10)), max_size=40))
def test_no_more_is_spent_than_the_rate_allows_and_a_debt_is_bounded(steps):
    bucket, now, spent, start = TokenBucket(0.5, 0.25), 0.0, 0.0, True
    for wait, cost in steps:
        now += wait
        if bucket.available(now) > 0:
            assert spent <= 0.5 + now * 0.25 + 10 or start
            bucket.spend(cost)
            spent += min(cost, 1.0)
        start = False
    assert bucket.available(now + 2.1) > 0  # for any debt


def test_a_token_that_is_put_back_can_be_taken_again():
    bucket = TokenBucket(1, 1)
    assert bucket.take(5.0) and not bucket.take(5.0)
    bucket.put_back()
    assert bucket.take(5.0) and not bucket.take(5.0)


def test_a_clock_that_goes_backwards_adds_nothing():
    bucket = TokenBucket(10, 1)
    assert bucket.take(100.0, 10) and bucket.available(50.0) == 0.0
    assert bucket.available(51.0) == 1.0


# --- by key ---------------------------------------------------------------------------


@given(st.lists(st.tuples(SECONDS, st.sampled_from("abcd")), max_size=80))
def test_each_key_and_all_keys_stay_within_their_limits(requests):
    buckets, now = KeyedTokenBuckets((2, 0.5), (4, 1.0)), 0.0
    passed = []
    for pause, key in requests:
        now += pause / 8
        if buckets.take(key, now):
            passed.append((now, key))
    for keys, burst, rate in [*((key, 2, 0.5) for key in "abcd"), ("abcd", 4, 1.0)]:
        times = [at for at, key in passed if key in keys]
        for first in range(len(times)):
            for last in range(first, len(times)):
                assert last - first + 1 <= burst + rate * (times[last] - times[first]) + 1e-6


@given(st.lists(st.tuples(SECONDS, st.integers(0, 40)), max_size=200))
def test_forgetting_full_buckets_changes_nothing(requests):
    """Compared with a bucket for each key that is never forgotten."""
    buckets, now = KeyedTokenBuckets((2, 0.5), (8, 4.0)), 0.0
    buckets._forget_at = 2
    own_buckets, shared = {}, TokenBucket(8, 4.0)
    for pause, number in requests:
        now += pause / 8
        own = own_buckets.setdefault(number, TokenBucket(2, 0.5))
        expected = own.available(now) >= 1 and shared.take(now)
        if expected:
            own.spend(1)
        assert buckets.take(str(number), now) is expected


def test_a_request_that_one_limit_refuses_costs_nothing_at_the_other():
    buckets = KeyedTokenBuckets((1, 1), (2, 1))
    assert buckets.take("a", 5.0)
    assert not any(buckets.take("a", 5.0) for _ in range(10))
    assert buckets.take("b", 5.0) and not buckets.take("c", 5.0)
    assert buckets.take("c", 6.0)  # its own bucket was not charged by the refusal


def test_a_flood_of_new_keys_takes_bounded_memory():
    buckets = KeyedTokenBuckets((1, 1), (50, 50))
    for number in range(100_000):
        buckets.take(str(number), number / 1000)
    assert len(buckets) < 1000
