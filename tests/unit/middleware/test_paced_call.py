"""Calls after changes: soon after the first one, and at most one a second."""

import pytest

from uros.middleware import paced_call
from uros.middleware.paced_call import PacedCall


class Clock:
    now = 1000.0

    def monotonic(self):
        return self.now


def test_all_changes_of_a_second_cause_one_call(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(paced_call, "time", clock)
    calls = []
    paced = PacedCall(lambda: calls.append(clock.now))
    assert paced.due is None
    for _ in range(300):  # three seconds of changes, every 10 ms
        paced.changed()
        if paced.due <= clock.now:
            paced.tick(clock.now)
        clock.now += 0.01
    assert len(calls) == 3
    assert calls[0] == pytest.approx(1000.1, abs=0.02)
    assert [round(b - a, 1) for a, b in zip(calls, calls[1:], strict=False)] == [1.0, 1.0]
