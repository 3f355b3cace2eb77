"""Exact float64 values against the arithmetic of CPython, which rounds correctly."""

import struct
from fractions import Fraction

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from uros.interfaces.sensor_msgs.msg import NavSatFix

from uros.client.float64 import Exact, Float64


def bits_of(value: float) -> int:
    return int.from_bytes(struct.pack("<d", value), "little")


@given(st.integers(), st.integers().filter(bool))
@example(2**53 + 1, 1)
@example(5, 2**1076)
@example(-(10**400), 10**399)
def test_a_fraction_is_rounded_as_cpython_divides(numerator: int, denominator: int) -> None:
    bits = Float64(numerator, denominator).bits
    expected = bits_of(numerator / denominator)
    assert bits == (expected if numerator else 0)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_each_double_is_represented(value: float) -> None:
    fraction = Fraction(value)
    bits = Float64(fraction.numerator, fraction.denominator).bits
    assert bits == (bits_of(value) if value else 0)


@given(st.integers(-(2**2200), 2**2200), st.integers(1, 2**1200))
def test_an_overflow_is_refused_as_by_cpython(numerator: int, denominator: int) -> None:
    try:
        expected = bits_of(numerator / denominator)
    except OverflowError:
        with pytest.raises(OverflowError):
            Float64(numerator, denominator)
    else:
        assert Float64(numerator, denominator).bits == (expected if numerator else 0)


@given(
    st.integers(-900000000, 900000000),
    st.integers(-1800000000, 1800000000),
    st.text(st.characters(codec="ascii", exclude_characters="\0"), max_size=20),
)
def test_a_receivers_integers_reach_the_wire(latitude: int, longitude: int, frame: str) -> None:
    plain = NavSatFix(latitude=latitude / 10**7, longitude=longitude / 10**7)
    fix = NavSatFix()
    plain.header.frame_id = fix.header.frame_id = frame
    exact = Exact(fix, latitude=Float64(latitude, 10**7), longitude=Float64(longitude, 10**7))
    expected, buf = bytearray(plain.cdr_size()), bytearray(exact.cdr_size())
    plain.pack_into(expected, 0, 0)
    assert exact.pack_into(buf, 0, 0) == len(expected)
    assert buf == expected
