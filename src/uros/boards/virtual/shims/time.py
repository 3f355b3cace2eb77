# mypy: disable-error-code="no-any-return"
"""MicroPython's ``time`` on the board's own clock; the epoch is 2000, as on bare metal."""

import struct

import _board  # type: ignore[import-not-found]
import _irq  # type: ignore[import-not-found]

_PERIOD = 1 << 30
_HALF = _PERIOD >> 1
_LONGEST_US = 500000000  # of one wait
_DAYS_BEFORE = (0, 31, 59, 90, 120, 151, 181, 212, 243, 273, 304, 334)


def ticks_ms() -> int:
    """Return the tick counter in milliseconds, modulo 2^30."""
    if _irq.handlers:
        _irq.run()
    return _board.number(_board.TICKS_MS)


def ticks_us() -> int:
    """Return the tick counter in microseconds, modulo 2^30."""
    if _irq.handlers:
        _irq.run()
    return _board.number(_board.TICKS_US)


ticks_cpu = ticks_us


def ticks_add(ticks: int, delta: int) -> int:
    """Return a tick value offset by ``delta``."""
    if not -_HALF <= delta < _HALF:
        raise OverflowError("ticks interval overflow")
    return (ticks + delta) & (_PERIOD - 1)


def ticks_diff(end: int, start: int) -> int:
    """Return the difference of two tick values, in -2^29 .. 2^29 - 1."""
    return ((end - start + _HALF) & (_PERIOD - 1)) - _HALF


def sleep(seconds: float) -> None:
    """Sleep for seconds."""
    sleep_us(int(seconds * 1000000))


def sleep_ms(ms: int) -> None:
    """Sleep for milliseconds."""
    sleep_us(int(ms) * 1000)


def sleep_us(us: int) -> None:
    """Sleep for microseconds."""
    us = int(us)
    while us > 0:
        wait = min(us, _LONGEST_US)
        us -= wait - _board.number(_board.SLEEP, struct.pack("<I", wait))
        if _irq.handlers:
            _irq.run()


def time_ns() -> int:
    """Return the time in nanoseconds since 2000."""
    return struct.unpack("<q", _board.call(_board.EPOCH))[0]


def time() -> int:
    """Return the time in seconds since 2000."""
    return time_ns() // 1000000000


def gmtime(seconds: int | None = None) -> "tuple[int, ...]":
    """Return a time in seconds since 2000, by default the current one, as a tuple.

    It is (year, month, day, hour, minute, second, weekday from Monday 0, day of the year from 1).
    """
    at = time() if seconds is None else int(seconds)
    days, second = at // 86400, at % 86400
    weekday = (days + 5) % 7  # 2000-01-01 was a Saturday
    year = 2000 + min(days // 366, days // 365)  # not too late, and not by much
    while _days_to(year + 1) <= days:
        year += 1
    days -= _days_to(year)
    month = 12
    while _day_of_year(year, month) > days:
        month -= 1
    day = days - _day_of_year(year, month) + 1
    return (year, month, day, second // 3600, second // 60 % 60, second % 60, weekday, days + 1)


localtime = gmtime


def mktime(moment: "tuple[int, ...]") -> int:
    """Return the seconds since 2000 of a ``gmtime`` tuple; fields after the year may overflow."""
    year, month, day, hour, minute, second = moment[:6]
    year += (month - 1) // 12
    month = (month - 1) % 12 + 1
    days = _days_to(year) + _day_of_year(year, month) + day - 1
    return ((days * 24 + hour) * 60 + minute) * 60 + second


def _days_to(year: int) -> int:
    """Return the days from 2000 to the first of January of a year."""
    before = year - 1
    leap = before // 4 - before // 100 + before // 400 - 484  # the leap years below 2000
    return (year - 2000) * 365 + leap


def _day_of_year(year: int, month: int) -> int:
    """Return the days from the first of January to the first of a month."""
    leap = month > 2 and (year % 4 == 0 and year % 100 != 0 or year % 400 == 0)
    return _DAYS_BEFORE[month - 1] + leap
