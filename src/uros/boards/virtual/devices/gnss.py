"""A receiver of satellites on a UART: NMEA 0183, once a second.

Its position is that of the world plus an error that wanders: of a pure function of time and the
seed, as the number of satellites is, so that it does not matter how often the receiver is asked.
Each whole second it says RMC, GGA and GSA, a moment later and at the speed of the line, 960 octets
a second. What nobody reads for long is lost, the oldest first.

After power-on it knows nothing; the time after some seconds; and where it is after
``cold_start_s``. Left out: GSV, VTG and GLL, and everything that can be set: what is written to it
is swallowed.
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
_AGAIN_S: Final = 3.0  # to find itself again after the sky was covered
_KEPT: Final = 4096  # octets that nobody has read

_KNOT: Final = 30.0  # seconds between two knots of what wanders
_ERROR_M: Final = 1.2  # one sigma of a knot, towards each side
_ERROR_UP_M: Final = 2.2
_GEOID_M: Final = 38.5
_DAMAGE: Final = 0.01  # of all octets, with the fault "noise"
_JUMP_M: Final = (80.0, 400.0)
_METRES: Final = 111_320.0  # of a degree; near enough for an error
_KNOTS: Final = 3600 / 1852


def checksum(body: str) -> int:
    """Of what is between $ and *."""
    out = 0
    for octet in body.encode():
        out ^= octet
    return out


def sentence(body: str) -> bytes:
    """With all that is around it."""
    return f"${body}*{checksum(body):02X}\r\n".encode()


def angle(degrees: float, digits: int, decimals: int, letters: str) -> str:
    """Degrees and minutes as NMEA has them, and the letter of the side."""
    side = letters[degrees < 0]
    whole = 60 * 10**decimals
    units = round(abs(degrees) * whole)
    minutes, fraction = divmod(units % whole, 10**decimals)
    return f"{units // whole:0{digits}d}{minutes:02d}.{fraction:0{decimals}d},{side}"


class Gnss(Part):
    """``place(seconds)`` says where it is at a time since power-on, which was at ``epoch``, in
    seconds since 1970. ``read`` and ``write`` are the other end of its UART.
    """

    FAULTS: ClassVar[dict[str, str]] = {
        "nofix": "the sky is covered: it sees too few satellites",
        "noise": f"of the octets on its line {_DAMAGE * 100:g} in 100 come damaged",
        "silent": "says nothing any more",
        "jam": "is disturbed: its position jumps by some hundred metres, and it says how bad it is",
    }
    ACTS: ClassVar[dict[str, str]] = {
        "cold": "is switched off and on: it knows nothing, and looks for satellites anew",
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
        self._late_us = round((epoch - self._epoch) * _SECOND)  # power-on after a whole second
        self._seed = f"{seed}/{name}"
        self._octet_us = 10 * _SECOND / baud
        self._cold_start_s = cold_start_s
        self._decimals = decimals
        self._now = 0
        self._second = 1  # the next one that is told
        self._on_since = 0.0
        self._covered_until = -math.inf
        self._says: list[tuple[float, bytes]] = []  # when the first octet's turn is, and what
        self._line_free = 0.0
        self._shown = ""

    # The line.

    def read(self, size: int) -> bytes | None:
        """At most ``size`` octets of those that have come; None: none."""
        out = bytearray()
        while self._says and len(out) < size:
            begins, data = self._says[0]
            come = min(int((self._now - begins) / self._octet_us), len(data))
            take = min(come, size - len(out))
            if take <= 0:
                break
            out += data[:take]
            if take == len(data):
                self._says.pop(0)
            else:
                self._says[0] = (begins + take * self._octet_us, data[take:])
        return bytes(out) if out else None

    def write(self, data: bytes) -> int:
        """Nothing can be set."""
        return len(data)

    def any(self) -> int:
        """How many octets have come."""
        return sum(
            min(max(int((self._now - begins) / self._octet_us), 0), len(data))
            for begins, data in self._says
        )

    # The part.

    def act(self, kind: str, value: str = "") -> None:
        if kind == "cold":
            self._on_since = self._now / _SECOND
            self._covered_until = -math.inf

    def shows(self) -> str:
        return self._shown

    def advance(self, t_us: int) -> None:
        self._now = max(self._now, t_us)
        newest = (self._now + self._late_us - _LATENCY_US) // _SECOND
        # What would be lost at once is not said.
        self._second = max(self._second, newest - _KEPT // 100)
        while self._second <= newest:
            self._tell(self._second)
            self._second += 1

    def _tell(self, second: int) -> None:
        lines = self._lines(second)
        if not lines:
            return
        data = b"".join(lines)
        if "noise" in self.faults:
            data = self._damaged(second, data)
        begins = max(float(second * _SECOND - self._late_us + _LATENCY_US), self._line_free)
        self._line_free = begins + len(data) * self._octet_us
        self._says.append((begins, data))
        while sum(len(said) for _, said in self._says) > _KEPT:
            self._says.pop(0)

    def _damaged(self, second: int, data: bytes) -> bytes:
        source = random.Random(f"{self._seed}/noise/{second}")
        return bytes(
            octet ^ 1 << source.randrange(8) if source.random() < _DAMAGE else octet
            for octet in data
        )

    # What it knows.

    def _wander(self, what: str, t: float) -> float:
        """A number that wanders around 0 with a sigma of about 1."""
        number = math.floor(t / _KNOT)
        a, b = (
            random.Random(f"{self._seed}/{what}/{knot}").gauss(0, 1)
            for knot in (number, number + 1)
        )
        part = t / _KNOT - number
        part = part * part * (3 - 2 * part)
        return a + (b - a) * part

    def satellites(self, t: float) -> int:
        """How many it uses at a time since power-on."""
        return round(min(max(9 + 2 * self._wander("satellites", t), 5), 12))

    def _lines(self, second: int) -> list[bytes]:
        t = second - self._late_us / _SECOND
        on_for = t - self._on_since
        if "silent" in self.faults:
            return []
        if on_for <= 1.0:
            return [sentence("GNTXT,01,01,02,starting")]
        if "nofix" in self.faults:
            self._covered_until = t + _AGAIN_S
        fixed = on_for > self._cold_start_s and t > self._covered_until
        clock = day = ""
        if on_for > min(_TIME_KNOWN_S, self._cold_start_s):
            utc = time.gmtime(self._epoch + second)
            clock, day = time.strftime("%H%M%S.00", utc), time.strftime("%d%m%y", utc)
        if not fixed:
            self._shown = "no fix"
            return [
                sentence(f"GNRMC,{clock},V,,,,,,,{day},,,N,V"),
                sentence(f"GNGGA,{clock},,,,,0,00,99.99,,,,,,"),
                sentence("GNGSA,A,1,,,,,,,,,,,,,99.99,99.99,99.99,1"),
            ]
        at = self._place(t)
        used = self.satellites(t)
        hdop = 0.5 + 4.0 / used
        east = _ERROR_M * hdop * self._wander("east", t)
        north = _ERROR_M * hdop * self._wander("north", t)
        up = _ERROR_UP_M * hdop * self._wander("up", t)
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
        self._shown = f"{latitude:.3f} {longitude:.3f}, {used} satellites"
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
