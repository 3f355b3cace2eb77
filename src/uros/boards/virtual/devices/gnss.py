"""A GNSS receiver on a UART: NMEA 0183, once a second.

Its position is that of the world plus an error that drifts. The error and the number of satellites
are pure functions of time and the seed, so that they do not depend on how often the receiver is
read. After each whole second it sends RMC, GGA and GSA, with a latency and at the speed of the line
(960 octets a second at 9600 baud). Of data that is not read, the oldest is lost.

After power-on it has neither time nor position; it has the time after some seconds and a fix after
``cold_start_s``. Left out: GSV, VTG and GLL, and configuration: what is written to it is ignored.
"""

from __future__ import annotations

import math
import random
import time
from collections.abc import Callable
from typing import ClassVar, Final

from ..hardware.parts import Part
from ..world.outdoors import Motion

_SECOND: Final = 1_000_000
_LATENCY_US: Final = 60_000  # from a second to its first octet
_TIME_KNOWN_S: Final = 6.0
_REACQUIRE_S: Final = 3.0  # to a new fix after the sky was covered
_BUFFER: Final = 4096  # octets not read yet

_KNOT: Final = 30.0  # seconds between two interpolation nodes of the drift
_ERROR_M: Final = 1.2  # one sigma of a node, on each horizontal axis
_ERROR_UP_M: Final = 2.2
_GEOID_M: Final = 38.5
_DAMAGE: Final = 0.01  # share of damaged octets with the fault "noise"
_JUMP_M: Final = (80.0, 400.0)
_METRES: Final = 111_320.0  # of a degree; near enough for an error
_KNOTS: Final = 3600 / 1852


def checksum(body: str) -> int:
    """Return the NMEA checksum of what is between $ and *."""
    out = 0
    for octet in body.encode():
        out ^= octet
    return out


def sentence(body: str) -> bytes:
    """Return the NMEA sentence with this body: $, checksum and CR LF added."""
    return f"${body}*{checksum(body):02X}\r\n".encode()


def angle(degrees: float, digits: int, decimals: int, letters: str) -> str:
    """Format an angle in degrees and minutes, followed by the letter of its hemisphere.

    Args:
        degrees: The angle, negative in the south or west.
        digits: The number of digits for the degrees.
        decimals: The number of decimals of the minutes.
        letters: The letters for a positive and for a negative angle.
    """
    side = letters[degrees < 0]
    per_degree = 60 * 10**decimals
    units = round(abs(degrees) * per_degree)
    minutes, fraction = divmod(units % per_degree, 10**decimals)
    return f"{units // per_degree:0{digits}d}{minutes:02d}.{fraction:0{decimals}d},{side}"


class Gnss(Part):
    """A GNSS receiver. ``read`` and ``write`` are the board's end of the UART.

    Args:
        place: Returns the true position and velocity at a time in seconds since power-on.
        epoch: The time of power-on, in seconds since 1970.
        name: The part's name.
        seed: The seed of position error and damage.
        baud: The baud rate of the UART.
        cold_start_s: The time to first fix in seconds.
        decimals: The decimals of the minutes in its positions.
    """

    FAULTS: ClassVar[dict[str, str]] = {
        "nofix": "the sky is covered: it receives too few satellites",
        "noise": f"{_DAMAGE * 100:g} % of the octets on its line are damaged",
        "silent": "sends nothing",
        "jam": "is jammed: its position jumps by some hundred metres, with a high HDOP",
    }
    ACTS: ClassVar[dict[str, str]] = {
        "cold": "restart it cold: it has neither time nor position until it finds satellites",
    }

    def __init__(
        self,
        place: Callable[[float], Motion],
        epoch: float,
        name: str = "gnss",
        seed: int = 0,
        baud: int = 9600,
        cold_start_s: float = 27.0,
        decimals: int = 5,
    ) -> None:
        super().__init__(name)
        self._place = place
        self._epoch = math.floor(epoch)
        self._offset_us = round((epoch - self._epoch) * _SECOND)  # power-on after a whole second
        self._seed = f"{seed}/{name}"
        self._octet_us = 10 * _SECOND / baud
        self._cold_start_s = cold_start_s
        self._decimals = decimals
        self._now = 0
        self._second = 1  # the next one that is reported
        self._on_since = 0.0
        self._no_fix_until = -math.inf
        self._queue: list[tuple[float, bytes]] = []  # the first octet's time in µs, data
        self._line_free = 0.0
        self._summary = ""

    # The line.

    def read(self, size: int) -> bytes | None:
        """Return at most ``size`` octets that have arrived, None when there are none."""
        out = bytearray()
        while self._queue and len(out) < size:
            starts_at, data = self._queue[0]
            arrived = min(int((self._now - starts_at) / self._octet_us), len(data))
            take = min(arrived, size - len(out))
            if take <= 0:
                break
            out += data[:take]
            if take == len(data):
                self._queue.pop(0)
            else:
                self._queue[0] = (starts_at + take * self._octet_us, data[take:])
        return bytes(out) if out else None

    def write(self, data: bytes) -> int:
        """Ignore what is written; return its length."""
        return len(data)

    def any(self) -> int:
        """Return how many octets have arrived."""
        return sum(
            min(max(int((self._now - starts_at) / self._octet_us), 0), len(data))
            for starts_at, data in self._queue
        )

    # The part.

    def act(self, kind: str, value: str = "") -> None:
        """Carry out one of ACTS."""
        if kind == "cold":
            self._on_since = self._now / _SECOND
            self._no_fix_until = -math.inf

    def shows(self) -> str:
        """Return the last position and the number of satellites, or "no fix"."""
        return self._summary

    def advance(self, t_us: int) -> None:
        """Advance to the time ``t_us`` in µs since power-on."""
        self._now = max(self._now, t_us)
        newest = (self._now + self._offset_us - _LATENCY_US) // _SECOND
        # Skip the seconds whose data would be lost at once.
        self._second = max(self._second, newest - _BUFFER // 100)
        while self._second <= newest:
            self._send(self._second)
            self._second += 1

    def _send(self, second: int) -> None:
        lines = self._lines(second)
        if not lines:
            return
        data = b"".join(lines)
        if "noise" in self.faults:
            data = self._damaged(second, data)
        starts_at = max(float(second * _SECOND - self._offset_us + _LATENCY_US), self._line_free)
        self._line_free = starts_at + len(data) * self._octet_us
        self._queue.append((starts_at, data))
        while sum(len(queued) for _, queued in self._queue) > _BUFFER:
            self._queue.pop(0)

    def _damaged(self, second: int, data: bytes) -> bytes:
        source = random.Random(f"{self._seed}/noise/{second}")
        return bytes(
            octet ^ 1 << source.randrange(8) if source.random() < _DAMAGE else octet
            for octet in data
        )

    # Time, position and satellites.

    def _drift(self, quantity: str, t: float) -> float:
        """Return a value that drifts around 0 with a standard deviation of about 1."""
        number = math.floor(t / _KNOT)
        a, b = (
            random.Random(f"{self._seed}/{quantity}/{knot}").gauss(0, 1)
            for knot in (number, number + 1)
        )
        part = t / _KNOT - number
        part = part * part * (3 - 2 * part)
        return a + (b - a) * part

    def satellites(self, t: float) -> int:
        """Return how many satellites it uses at a time in seconds since power-on."""
        return round(min(max(9 + 2 * self._drift("satellites", t), 5), 12))

    def _lines(self, second: int) -> list[bytes]:
        t = second - self._offset_us / _SECOND
        on_for = t - self._on_since
        if "silent" in self.faults:
            return []
        if on_for <= 1.0:
            return [sentence("GNTXT,01,01,02,starting")]
        if "nofix" in self.faults:
            self._no_fix_until = t + _REACQUIRE_S
        fixed = on_for > self._cold_start_s and t > self._no_fix_until
        clock = day = ""
        if on_for > min(_TIME_KNOWN_S, self._cold_start_s):
            utc = time.gmtime(self._epoch + second)
            clock, day = time.strftime("%H%M%S.00", utc), time.strftime("%d%m%y", utc)
        if not fixed:
            self._summary = "no fix"
            return [
                sentence(f"GNRMC,{clock},V,,,,,,,{day},,,N,V"),
                sentence(f"GNGGA,{clock},,,,,0,00,99.99,,,,,,"),
                sentence("GNGSA,A,1,,,,,,,,,,,,,99.99,99.99,99.99,1"),
            ]
        at = self._place(t)
        used = self.satellites(t)
        hdop = 0.5 + 4.0 / used
        east = _ERROR_M * hdop * self._drift("east", t)
        north = _ERROR_M * hdop * self._drift("north", t)
        up = _ERROR_UP_M * hdop * self._drift("up", t)
        if "jam" in self.faults:
            source = random.Random(f"{self._seed}/jam/{second}")
            jump, turn = source.uniform(*_JUMP_M), source.uniform(0, 2 * math.pi)
            east += jump * math.cos(turn)
            north += jump * math.sin(turn)
            hdop, used = source.uniform(8.0, 20.0), 4
        latitude = at.latitude + north / _METRES
        per_degree = _METRES * max(math.cos(math.radians(at.latitude)), 1e-3)
        longitude = (at.longitude + east / per_degree + 180.0) % 360.0 - 180.0
        where = (
            f"{angle(latitude, 2, self._decimals, 'NS')},"
            f"{angle(longitude, 3, self._decimals, 'EW')}"
        )
        height = at.altitude + up - _GEOID_M
        vdop = 1.6 * hdop
        numbers = [f"{number:02d}" for number in range(2, 2 + used)] + [""] * (12 - used)
        self._summary = f"{latitude:.3f} {longitude:.3f}, {used} satellites"
        return [
            sentence(
                f"GNRMC,{clock},A,{where},{at.speed * _KNOTS:.3f},{at.course:.2f},{day},,,A,V"
            ),
            sentence(
                f"GNGGA,{clock},{where},1,{used:02d},{hdop:.2f},{height:.1f},M,{_GEOID_M:.1f},M,,"
            ),
            sentence(
                f"GNGSA,A,3,{','.join(numbers)},{math.hypot(hdop, vdop):.2f},{hdop:.2f},"
                f"{vdop:.2f},1"
            ),
        ]
