"""Edges of an encoder, against the angle of its disc."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uros.boards.virtual.devices.encoder import EDGES, Encoder


class Disc:
    """An encoder on a wheel that tests turn; ``edges`` are the edges that it reported."""

    def __init__(self, *faults: str, seed: object = 0, uneven: float = 0.0) -> None:
        self.encoder = Encoder(seed, uneven)
        self.encoder.faults.update(faults)
        self.encoder.on_edge = lambda t_us, level: self.edges.append((t_us, level))
        self.edges: list[tuple[int, int]] = []
        self.angle = 0.0
        self.t_us = 0

    def turn(self, degrees: float, ms: int) -> None:
        for _ in range(ms):
            after = self.angle + math.radians(degrees) / ms
            for t_us, level in self.encoder.edges(self.t_us, 1000, self.angle, after):
                self.encoder.set_level(t_us, level)
            self.angle = after
            self.t_us += 1000


@pytest.mark.parametrize("way", [1, -1])
def test_forty_edges_a_turn_in_either_direction(way: int) -> None:
    disc = Disc()
    disc.turn(way * 360, 1000)
    assert len(disc.edges) == EDGES
    # The line changes at each.
    levels = [level for _, level in disc.edges]
    assert all(a != b for a, b in zip(levels, levels[1:], strict=False))
    assert disc.encoder.level == levels[-1]


def test_edges_have_their_own_time_within_a_step() -> None:
    disc = Disc()
    # An edge each 12.6 ms and a bit.
    disc.turn(360, 507)
    times = [t for t, _ in disc.edges]
    gaps = [b - a for a, b in zip(times, times[1:], strict=False)]
    assert all(abs(gap - 507_000 / EDGES) <= 2 for gap in gaps), gaps


def test_several_edges_in_a_step_are_reported_in_order() -> None:
    disc = Disc()
    disc.turn(36, 1)
    assert len(disc.edges) == 4
    times = [t for t, _ in disc.edges]
    assert times == sorted(times) and times[-1] < 1000


def test_wide_teeth_shift_every_other_edge() -> None:
    disc = Disc(uneven=0.2)
    disc.turn(360, 4000)
    assert len(disc.edges) == EDGES
    gaps: dict[int, list[int]] = {0: [], 1: []}
    for (a, level), (b, _) in zip(disc.edges, disc.edges[1:], strict=False):
        gaps[level].append(b - a)
    for level, share in ((1, 1.2), (0, 0.8)):
        assert all(abs(gap - share * 100_000) < 50 for gap in gaps[level]), gaps


def test_rocking_over_an_edge_reports_an_edge_each_time() -> None:
    disc = Disc()
    disc.turn(9, 10)
    before = len(disc.edges)
    for _ in range(10):
        disc.turn(-9, 10)
        disc.turn(9, 10)
    assert len(disc.edges) == before + 20


@given(st.lists(st.tuples(st.floats(-400, 400), st.integers(1, 50)), max_size=20))
def test_the_level_follows_the_disc(ways: list[tuple[float, int]]) -> None:
    disc = Disc(seed=5, uneven=0.1)
    for degrees, ms in ways:
        disc.turn(degrees, ms)
        # From 0 on there is a tooth, 1.1 steps wide, and a slot of 0.9.
        scale = EDGES / math.tau
        place = (disc.angle * scale + disc.encoder._phase) % 2
        if min(abs(place - edge) for edge in (0, 1.1, 2)) > 1e-9:
            assert disc.encoder.level == (1 if place < 1.1 else 0)


def test_a_dead_encoder_reports_no_edges_until_it_is_healed() -> None:
    disc = Disc("dead")
    disc.turn(360, 1000)
    assert disc.edges == []
    disc.encoder.faults.clear()
    disc.turn(360, 1000)
    assert len(disc.edges) == EDGES


def test_missing_teeth_are_missing_edges_each_turn() -> None:
    disc = Disc("teeth")
    disc.turn(360, 1000)
    first = len(disc.edges)
    disc.turn(360, 1000)
    assert first == len(disc.edges) - first == EDGES - 6


def test_noise_is_short_pulses_and_comes_from_the_seed() -> None:
    disc, same, different = Disc("noise"), Disc("noise"), Disc("noise", seed=1)
    for each in (disc, same, different):
        each.turn(0, 3000)
    assert 10 < len(disc.edges) / 2 < 60
    assert disc.edges == same.edges != different.edges
    for (a, up), (b, down) in zip(disc.edges[::2], disc.edges[1::2], strict=True):
        assert 20 <= b - a <= 500 and up != down == disc.encoder.level


def test_the_angle_at_power_on_comes_from_the_seed() -> None:
    first = set()
    for seed in range(20):
        disc = Disc(seed=seed)
        disc.turn(9.1, 1000)
        first.add(disc.edges[0][0])
    assert len(first) == 20


def test_an_uneven_out_of_range_is_refused() -> None:
    with pytest.raises(ValueError, match="uneven"):
        Encoder(0, 1.5)
