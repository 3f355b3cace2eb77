"""Speed and distance of a wheel, from edges at given times."""

import math

from uros.control.wheel import Wheel

try:
    from micropython import heap_lock, heap_unlock
except ImportError:

    def heap_lock():
        pass

    heap_unlock = heap_lock

TICKS = 0x3FFFFFFF
PITCH = 2 * math.pi * 0.0325 / 40


class Turned:
    """A Wheel with the edges of a simulated wheel, updated every 20 ms.

    ``at`` is the position of the simulated wheel in edges; it begins between edge 0 and 1.
    """

    def __init__(self, begin_us=0, **options):
        self.wheel = Wheel(**options)
        self.t_us = begin_us
        self.at = 0.5
        self.moved = 0.0

    def turn(self, seconds, speed, target=None):
        """Turn the simulated wheel at ``speed`` m/s."""
        # As in a control cycle: measure first, then drive.
        self.update(speed if target is None else target)
        for ms in range(1, round(seconds * 1000) + 1):
            before = self.at
            self.at += speed * 0.001 / PITCH
            for edge in range(math.floor(before), math.floor(self.at), 1 if speed > 0 else -1):
                edge += 1 if speed > 0 else 0
                share = (edge - before) / (self.at - before)
                self.wheel.edge(self.t_us + int(share * 999) & TICKS)
            self.t_us = self.t_us + 1000 & TICKS
            if ms % 20 == 0:
                self.update(speed if target is None else target)

    def update(self, target):
        self.wheel.update(self.t_us, target)
        self.moved += self.wheel.moved

    def off(self):
        """Return the measured minus the true distance, in edges."""
        return self.moved / PITCH - (self.at - 0.5)


def near(value, wanted, within):
    assert abs(value - wanted) <= within, (value, wanted)


def test_a_constant_speed_is_measured():
    for speed in (0.05, 0.3, 0.9):
        turned = Turned()
        turned.turn(1.0, speed)
        near(turned.wheel.speed, speed, speed * 0.001)
        near(turned.off(), 0, 0.05)


def test_the_speed_has_the_sign_of_the_target():
    turned = Turned()
    turned.turn(1.0, -0.3)
    near(turned.wheel.speed, -0.3, 0.001)
    near(turned.off(), 0, 0.05)
    assert turned.wheel.edges < 0


def test_the_speed_falls_to_zero_while_no_edge_arrives():
    turned = Turned()
    turned.turn(1.0, 0.3)
    speeds = []
    for _ in range(25):
        turned.turn(0.02, 0.0, 0.3)
        speeds.append(turned.wheel.speed)
    assert all(a >= b for a, b in zip(speeds, speeds[1:])), speeds
    assert speeds[3] < 0.09 and speeds[-1] == 0, speeds
    assert turned.wheel.resting


def test_the_distance_is_extrapolated_between_edges():
    turned = Turned()
    turned.turn(1.0, 0.1)
    for _ in range(20):
        turned.turn(0.02, 0.1)
        near(turned.off(), 0, 0.1)
        near(turned.wheel.moved, 0.1 * 0.02, 0.0003)


def test_an_edge_passed_again_after_a_reversal_adds_no_distance():
    turned = Turned()
    for _ in range(20):
        turned.turn(0.31, 0.2)
        turned.turn(0.2, 0.0, 0.0)
        turned.turn(0.31, -0.2)
        turned.turn(0.2, 0.0, 0.0)
    # If the edge counted in both directions, each of the 40 turns would add an edge.
    near(turned.off(), 0, 0.6)


def test_edges_during_braking_count_in_the_old_direction():
    turned = Turned()
    turned.turn(0.5, 0.3)
    turned.turn(0.1, 0.2, -0.3)
    assert turned.wheel.reversing
    assert turned.wheel.speed > 0
    turned.turn(0.06, 0.04, -0.3)
    assert turned.wheel.reversing
    turned.turn(0.2, 0.0, -0.3)
    assert not turned.wheel.reversing
    turned.turn(0.5, -0.3)
    near(turned.off(), 0, 0.1)


def test_a_slow_wheel_is_braked_before_it_reverses():
    # At 20 mm/s the edges are 255 ms apart: no edge for 80 ms means no rest before braking.
    turned = Turned()
    turned.turn(1.0, 0.05)
    turned.turn(0.5, 0.02)
    turned.turn(0.06, 0.02, -0.3)
    assert turned.wheel.reversing


def test_a_wheel_turned_from_outside_is_not_braked_for_ever():
    turned = Turned()
    turned.turn(0.5, 0.3)
    turned.turn(1.2, 0.3, -0.3)
    assert not turned.wheel.reversing


def test_teeth_wider_than_slots_do_not_disturb_the_speed():
    wheel = Wheel()
    t = 0
    for edge in range(40):
        t += 22000 if edge & 1 else 12000
        wheel.edge(t)
        wheel.update(t + 1000, 0.3)
    near(wheel.speed, 2 * PITCH / 0.034, 1e-4)


def test_ticks_wrap():
    turned = Turned(begin_us=TICKS - 480_000 - TICKS % 20_000)
    turned.turn(1.0, 0.3)
    near(turned.wheel.speed, 0.3, 0.001)
    near(turned.off(), 0, 0.05)


def test_a_wheel_may_rest_for_longer_than_the_period_of_ticks():
    turned = Turned()
    turned.turn(0.5, 0.3)
    turned.turn(0.4, 0.0)
    # 1024 s later the wrapped ticks equal the time of the last edge.
    for _ in range(60):
        turned.t_us = turned.t_us + 20_000_000 & TICKS
        turned.wheel.update(turned.t_us)
        assert turned.wheel.speed == 0 and turned.wheel.moved == 0


def test_glitch_us_ignores_short_pulses():
    turned = Turned(glitch_us=500)
    for _ in range(10):
        turned.turn(0.1, 0.3)
        turned.wheel.edge(turned.t_us + 100)
        turned.wheel.edge(turned.t_us + 250)
        turned.wheel.update(turned.t_us + 300, 0.3)
        turned.moved += turned.wheel.moved
        near(turned.wheel.speed, 0.3, 0.02)
    near(turned.off(), 0, 0.6)


def test_edges_served_late_and_together_are_all_counted():
    wheel = Wheel()
    for edge in range(3):
        wheel.edge(17000 * (edge + 1))
        wheel.update(17000 * (edge + 1) + 1000, 0.3)
    edges = wheel.edges
    for edge in range(4):
        wheel.edge(120000 + edge * 20)
    wheel.update(121000, 0.3)
    assert wheel.edges == edges + 4
    assert wheel.speed <= 2.0


def test_the_first_edge_of_a_motion_has_no_speed():
    wheel = Wheel()
    wheel.update(20000, 0.3)
    wheel.update(40000, 0.3)
    assert wheel.unsure_us == 40000
    wheel.edge(50000)
    wheel.update(60000, 0.3)
    assert wheel.speed == 0 and wheel.unsure_us == 60000
    wheel.edge(67000)
    wheel.update(80000, 0.3)
    near(wheel.speed, PITCH / 0.017, 0.001)
    assert wheel.unsure_us == 0


def test_the_interrupt_allocates_nothing():
    wheel = Wheel(glitch_us=100)
    edge = wheel.edge
    heap_lock()
    try:
        for t in range(0, 100000, 1700):
            edge(t)
        edge(100050)
        edge(TICKS)
        edge(90)
    finally:
        heap_unlock()
    wheel.update(101000, 0.3)
    assert wheel.edges > 50
