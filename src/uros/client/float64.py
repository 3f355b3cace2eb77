"""Exact float64 fields on boards whose floats have 32 bits.

MicroPython's ports for rp2, esp32 and others compute with 32-bit floats, which have 24 bits of
precision: a latitude near 50 degrees is then good to 0.4 m. Integers have no such limit, and most
receivers and counters give integers anyway (u-blox: degrees in units of 1e-7). So a value is a
fraction of two integers, and integer arithmetic rounds it to the IEEE double on the wire::

    fix = NavSatFix()
    fix.status.status = 0
    latitude = Float64(501234567, 10000000)  # 50.1234567
    longitude = Float64(86543210, 10000000)
    publisher.publish(Exact(fix, latitude=latitude, longitude=longitude))

The same program runs on ports with 64-bit floats, with the same octets as the result. Received
float64 fields are rounded to the port's floats.
"""

try:
    from typing import Any, Final
except ImportError:  # MicroPython
    pass

_MANTISSA_BITS: Final = 52
_LEAST_EXPONENT: Final = -1074  # of the last bit: that of the subnormal numbers
_MOST_EXPONENT: Final = 971  # of the last bit of the largest numbers
_SIGN: Final = 1 << 63
# Marks are powers of two that 32-bit floats represent; the exponent of 1.0 in the octets of a
# double, with a bias of 1023.
_BIAS: Final = 1023
_MOST_FIELDS: Final = 100


class Float64:
    """The double nearest to ``numerator / denominator``; ties go to the even one.

    Attributes:
        bits: The 64 bits of the double, as an integer.

    Raises:
        ZeroDivisionError: The denominator is 0.
        OverflowError: The value is beyond the range of float64.
        TypeError: An argument is not an integer.
    """

    def __init__(self, numerator: int, denominator: int = 1) -> None:
        for value in (numerator, denominator):
            if not isinstance(value, int):
                raise TypeError("Float64: give integers, numerator and denominator")
        if not denominator:
            raise ZeroDivisionError("Float64: the denominator is 0")
        negative = (numerator < 0) != (denominator < 0)
        self.bits = _bits(abs(numerator), abs(denominator))
        if negative and numerator:
            self.bits |= _SIGN


class Exact:
    """A message for `Publisher.publish`, some of whose float64 fields are `Float64` values.

    Args:
        message: The message; its other fields may change later.
        parts: Fields of nested messages, and of Vector3, Point and Quaternion: tuples of the
            message that has the field, the field's name, and the value, as in
            ``Exact(odometry, (odometry.pose.pose.position, "x", x))``. A path in one string would
            not tell the builder which fields the program uses.
        values: The values by the names of their fields, which are float64 of the message itself.

    Raises:
        TypeError: A value is no `Float64`.
        AttributeError: The message has no such field.
        ValueError: There are more than 100 values, or, when it is published: a field is no float64.
    """

    def __init__(
        self, message: "Any", *parts: "tuple[Any, str, Float64]", **values: Float64
    ) -> None:
        self._TYPE = message._TYPE
        self.message = message
        self._fields: "list[tuple[Any, str, Float64]]" = list(parts)
        for name in values:
            self._fields.append((message, name, values[name]))
        if len(self._fields) > _MOST_FIELDS:
            raise ValueError("Exact: at most %d values" % _MOST_FIELDS)
        for owner, name, value in self._fields:
            if not isinstance(value, Float64):
                raise TypeError("Exact: %s takes a Float64" % name)
            getattr(owner, name)

    def cdr_size(self, o: int = 0) -> int:
        """Return the offset after the message that begins at offset ``o``."""
        size: int = self.message.cdr_size(o)
        return size

    def pack_into(self, buf: "Any", offset: int, start: int) -> int:
        """Pack the message; offsets are aligned from ``start`` on. Return the offset after it."""
        before = [getattr(owner, name) for owner, name, _ in self._fields]
        try:
            # The fields' places are the octets that differ between two packings.
            self._mark(False)
            end: int = self.message.pack_into(buf, offset, start)
            plain = bytes(memoryview(buf)[offset:end])
            self._mark(True)
            self.message.pack_into(buf, offset, start)
        finally:
            for i, (owner, name, _) in enumerate(self._fields):
                setattr(owner, name, before[i])
        found = 0
        at = offset + (start - offset) % 8
        while at + 8 <= end:
            high = buf[at + 7] << 4 | buf[at + 6] >> 4
            if plain[at - offset + 7] != buf[at + 7] or plain[at - offset + 6] != buf[at + 6]:
                i = high - _BIAS
                if not 0 <= i < len(self._fields):
                    break
                buf[at : at + 8] = self._fields[i][2].bits.to_bytes(8, "little")
                found += 1
            at += 8
        if found != len(self._fields):
            raise ValueError("Exact: a field of %s is no float64" % self._TYPE)
        return end

    def _mark(self, marked: bool) -> None:
        """Set each field to its mark, a power of two of its index, or to 0."""
        mark = 1.0
        for owner, name, _ in self._fields:
            setattr(owner, name, mark if marked else 0.0)
            mark *= 2


def _bits(numerator: int, denominator: int) -> int:
    """Return the bits of the double nearest to a fraction that is not negative."""
    if not numerator:
        return 0
    # The exponent of the last bit, so that the quotient has 53 or 54 bits.
    exponent = _length(numerator) - _length(denominator) - _MANTISSA_BITS - 1
    quotient, rest, divisor = _divided(numerator, denominator, exponent)
    while quotient >> _MANTISSA_BITS + 1 or exponent < _LEAST_EXPONENT:
        exponent = max(exponent + 1, _LEAST_EXPONENT)
        quotient, rest, divisor = _divided(numerator, denominator, exponent)
    if 2 * rest > divisor or (2 * rest == divisor and quotient & 1):
        quotient += 1
        if quotient >> _MANTISSA_BITS + 1:
            quotient >>= 1
            exponent += 1
    if exponent > _MOST_EXPONENT:
        raise OverflowError("Float64: beyond the range of float64")
    if not quotient >> _MANTISSA_BITS:  # subnormal
        return quotient
    return quotient + (exponent - _LEAST_EXPONENT << _MANTISSA_BITS)


def _divided(numerator: int, denominator: int, exponent: int) -> "tuple[int, int, int]":
    """Return quotient, rest and divisor of a fraction in units of two to the exponent."""
    if exponent < 0:
        numerator <<= -exponent
    else:
        denominator <<= exponent
    return numerator // denominator, numerator % denominator, denominator


def _length(number: int) -> int:
    """Return the number of bits of a positive integer."""
    return len(bin(number)) - 2
