"""The watchdog, the cause of a reset, and what a reset keeps."""

import pytest

from uros.boards.virtual.hardware import resets
from uros.boards.virtual.hardware.board import VirtualBoard
from uros.boards.virtual.hardware.clock import ManualClock
from uros.boards.virtual.models.catalog import find


@pytest.fixture
def clock():
    return ManualClock()


def test_the_watchdog_is_due_when_it_is_not_fed(clock):
    unit = resets.Resets(clock)
    assert unit.left_us() is None
    unit.feed(1000)
    clock.advance(999_999)
    assert unit.left_us() == 1
    unit.feed()
    clock.advance(600_000)
    assert unit.left_us() == 400_000
    clock.advance(600_000)
    assert unit.left_us() == 0
    unit.feed(3000)  # another timeout
    assert unit.left_us() == 3_000_000


@pytest.mark.parametrize("cause", [resets.HARD, resets.WATCHDOG, resets.DEEP_SLEEP, resets.SOFT])
def test_a_reset_keeps_the_memory_and_only_a_soft_one_the_watchdog(clock, cause):
    board = VirtualBoard(find("esp32_publisher"), clock)
    try:
        assert board.resets.cause == resets.POWER_ON
        board.resets.feed(1000)
        board.resets.memory = b"kept"
        board.reset(cause)
        assert board.resets.cause == cause and board.resets.memory == b"kept"
        assert (board.resets.left_us() is None) == (cause != resets.SOFT)
    finally:
        board.close()
