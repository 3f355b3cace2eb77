"""Token buckets, the rate limiter of the agent and the middlewares.

Everything that has a rate uses these two classes: messages of a client (``max_rate``), time for
creating and deleting, TLS handshakes, answers of the discovery port, lines of the log, and
discovery info of other participants. The caller passes the time, in seconds of any monotonic clock.
"""

from __future__ import annotations

from typing import Final

# How many keys are remembered before full buckets are searched for.
_MIN_KEYS: Final = 256


class TokenBucket:
    """A token bucket: holds up to ``burst`` tokens and is refilled at ``rate`` tokens a second.

    It starts full. A clock that goes backwards adds nothing.

    Args:
        burst: The most tokens that can be taken at once, above 0.
        rate: Tokens added a second.
    """

    __slots__ = ("_tokens", "_updated_at", "burst", "rate")

    def __init__(self, burst: float, rate: float) -> None:
        self.burst = burst
        self.rate = rate
        self._tokens = burst
        self._updated_at = 0.0

    def available(self, now: float) -> float:
        """Refill; return the number of tokens, which is negative while there is a debt."""
        added = max(0.0, now - self._updated_at) * self.rate
        self._updated_at = now
        self._tokens = min(self.burst, self._tokens + added)
        return self._tokens

    def take(self, now: float, tokens: float = 1.0) -> bool:
        """Take tokens if that many are there; return whether they were."""
        if self.available(now) < tokens:
            return False
        self._tokens -= tokens
        return True

    def spend(self, tokens: float) -> None:
        """Take tokens whose number is known only afterwards; the debt is limited to ``burst``."""
        self._tokens = max(-self.burst, self._tokens - tokens)

    def put_back(self, tokens: float = 1.0) -> None:
        """Return tokens that were taken and not used."""
        self._tokens = min(self.burst, self._tokens + tokens)


class KeyedTokenBuckets:
    """A token bucket for each key, and one that all keys share.

    Full buckets are forgotten when many keys are known: a new one would be the same. While the
    shared bucket is empty no key is added, so a flood of new keys takes bounded memory.

    Args:
        each: A key's burst and rate.
        shared: Burst and rate of all keys together.
    """

    __slots__ = ("_buckets", "_each", "_forget_at", "_shared")

    def __init__(self, each: tuple[float, float], shared: tuple[float, float]) -> None:
        self._each = each
        self._shared = TokenBucket(*shared)
        self._buckets: dict[str, TokenBucket] = {}
        self._forget_at = _MIN_KEYS

    def __len__(self) -> int:
        return len(self._buckets)

    def __contains__(self, key: str) -> bool:
        return key in self._buckets

    def take(self, key: str, now: float) -> bool:
        """Take one token of the key's bucket and one of the shared bucket, or none."""
        bucket = self._buckets.get(key)
        if bucket is not None and bucket.available(now) < 1.0:
            return False
        if not self._shared.take(now):
            return False
        if bucket is None:
            if len(self._buckets) >= self._forget_at:
                self._forget_full(now)
            bucket = self._buckets[key] = TokenBucket(*self._each)
            bucket.available(now)
        bucket.spend(1.0)
        return True

    def _forget_full(self, now: float) -> None:
        self._buckets = {
            key: bucket
            for key, bucket in self._buckets.items()
            if bucket.available(now) < bucket.burst
        }
        # The next search only after as many keys again: the cost of each key stays constant.
        self._forget_at = max(_MIN_KEYS, 2 * len(self._buckets))
