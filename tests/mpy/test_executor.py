"""Tests that a round of callbacks allocates no memory on a board."""

from mpy.harness import MicroPython, portable_sources, shared_sources

PROGRAM = """
import micropython
from uros.client.executor import Executor, Timer
from uros.client.guard_condition import GuardCondition

class Clock:
    now = 1000

    def ms(self):
        return self.now

clock = Clock()
calls = 0

def called():
    global calls
    calls += 1

executor = Executor()
executor.between = called
for _ in range(5):
    executor.add(Timer(0.0333, called, clock))
guard = GuardCondition(called, clock)
executor.add(guard)

def run():
    for i in range(100):
        clock.now += executor.wait(clock.now, 50)
        if i % 3 == 0:
            guard.trigger()
        executor.execute(clock.now)
        executor.overfull()

run()
micropython.heap_lock()
try:
    run()
finally:
    micropython.heap_unlock()
print(calls > 300, executor.failed)
"""


def test_a_round_without_a_trigger_allocates_nothing(micropython: MicroPython) -> None:
    micropython.install(portable_sources())
    micropython.install(shared_sources())
    assert micropython.run(PROGRAM) == "True 0\n"
