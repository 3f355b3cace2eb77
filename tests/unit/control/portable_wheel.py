"""A wheel's speed and way, from edges at times that the tests choose."""

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
    """A Wheel, told of the edges that a true wheel passes, updated every 20 ms. ``at`` is where
    that is, in edges; it begins between edge 0 and 1."""

    def __init__(self, begin_us=0, **options):
        self.wheel = Wheel(**options)
        self.t_us = begin_us
        self.at = 0.5
        self.moved = 0.0

    def turn(self, seconds, speed, target=None):
        """The true wheel turns at ``speed`` m/s."""
        # As control does: it measures first, and then drives.
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
        """How far its way is from the true one, in edges."""
        return self.moved / PITCH - (self.at - 0.5)


def near(value, wanted, within):
    assert abs(value - wanted) <= within, (value, wanted)


def test_an_even_speed_is_measured_as_it_is():
    for speed in (0.05, 0.3, 0.9):
        turned = Turned()
        turned.turn(1.0, speed)
        near(turned.wheel.speed, speed, speed * 0.001)
        near(turned.off(), 0, 0.05)


def test_backward_it_has_the_sign_of_its_target():
    turned = Turned()
    turned.turn(1.0, -0.3)
    near(turned.wheel.speed, -0.3, 0.001)
    near(turned.off(), 0, 0.05)
    assert turned.wheel.edges < 0


def test_it_falls_while_the_next_edge_is_late_and_ends_at_nothing():
    turned = Turned()
    turned.turn(1.0, 0.3)
    seen = []
    for _ in range(25):
        turned.turn(0.02, 0.0, 0.3)
        seen.append(turned.wheel.speed)
    assert all(a >= b for a, b in zip(seen, seen[1:])), seen
    assert seen[3] < 0.09 and seen[-1] == 0, seen
    assert turned.wheel.resting


def test_between_edges_the_way_goes_on_with_the_speed():
    turned = Turned()
    turned.turn(1.0, 0.1)
    for _ in range(20):
        turned.turn(0.02, 0.1)
        near(turned.off(), 0, 0.1)
        near(turned.wheel.moved, 0.1 * 0.02, 0.0003)


def test_turning_back_passes_the_same_edge_once_more_and_that_is_no_way():
    turned = Turned()
    for _ in range(20):
        turned.turn(0.31, 0.2)
        turned.turn(0.2, 0.0, 0.0)
        turned.turn(0.31, -0.2)
        turned.turn(0.2, 0.0, 0.0)
    # Counted as one way and the other, each of the 40 turns would be an edge.
    near(turned.off(), 0, 0.6)


def test_edges_while_it_is_braked_belong_to_the_way_that_it_came():
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


def test_a_slow_wheel_that_is_to_reverse_is_braked_before_it_counts_as_standing():
    # At 20 mm/s an edge comes each 255 ms: no edge for 80 ms says nothing before the brake.
    turned = Turned()
    turned.turn(1.0, 0.05)
    turned.turn(0.5, 0.02)
    turned.turn(0.06, 0.02, -0.3)
    assert turned.wheel.reversing


def test_what_something_else_turns_is_not_braked_for_ever():
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


def test_a_wheel_may_stand_for_longer_than_the_ticks_go_round():
    turned = Turned()
    turned.turn(0.5, 0.3)
    turned.turn(0.4, 0.0)
    # 1024 s later, when the last edge's time seems to be now.
    for _ in range(60):
        turned.t_us = turned.t_us + 20_000_000 & TICKS
        turned.wheel.update(turned.t_us)
        assert turned.wheel.speed == 0 and turned.wheel.moved == 0


def test_short_pulses_are_no_edges_where_that_is_asked_for():
    turned = Turned(glitch_us=500)
    for _ in range(10):
        turned.turn(0.1, 0.3)
        turned.wheel.edge(turned.t_us + 100)
        turned.wheel.edge(turned.t_us + 250)
        turned.wheel.update(turned.t_us + 300, 0.3)
        turned.moved += turned.wheel.moved
        near(turned.wheel.speed, 0.3, 0.02)
    near(turned.off(), 0, 0.6)


def test_edges_that_come_late_and_together_are_all_counted():
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


def test_the_first_edges_of_a_motion_do_not_tell_its_speed():
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
