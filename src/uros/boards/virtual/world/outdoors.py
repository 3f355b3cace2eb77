"""A place outdoors, where the board is carried slowly around a circle.

Every quantity is a pure function of the seconds since power-on and the seed: any time may be asked
for in any order, and weeks cost no more than a second.

The board lies flat: its x is forward, y left and z up; the circle is walked counter-clockwise. The
axes of the world are east, north and up (REP 103). The place comes from the seed, the magnetic
field from the place (the earth's dipole), the light from the time of day.
"""

from __future__ import annotations

import math
import random
from typing import Final, NamedTuple

DAY: Final = 86_400.0
G: Final = 9.80665

# Monday, 1 June 2026, 00:00 UTC: the default date.
EPOCH: Final = 1_780_272_000

# Parks: latitude and longitude.
_PLACES: Final = (
    (35.43, 139.36), (53.46, -2.25), (52.51, 13.37), (1.31, 103.82), (-1.28, 36.81),
    (-34.57, -58.42), (40.78, -73.97), (-33.87, 151.22), (64.14, -21.93), (28.59, 77.22),
)  # fmt: skip
_NEARBY: Final = 0.005  # degrees

RADIUS: Final = 20.0  # m, of the circle
SPEED: Final = 0.8  # m/s
_STEPS: Final = 1.8  # steps a second; each lifts the board
_LIFT: Final = 0.4  # m/s²
_TILT: Final = 0.02  # rad/s: amplitude of the roll rate

# WGS 84, and the earth's magnetic field as a dipole: its northern pole, and its flux density at the
# equator.
_SEMI_MAJOR: Final = 6_378_137.0
_ECCENTRICITY_2: Final = 6.69437999014e-3
_POLE: Final = (math.radians(80.7), math.radians(-72.7))
_EQUATOR_TESLA: Final = 2.98e-5

_SUN: Final = 100_000.0  # lx with the sun at the zenith
_SUNRISE: Final = 6.0
_SUNSET: Final = 20.0
_MOON: Final = 0.2

# The obstacle: a wall with gaps. Seconds of a pass, and distances in m.
_PASS: Final = 90.0
_NEAR: Final = 0.4
_FAR: Final = 7.0

# A lithium cell: state of charge and open-circuit voltage in V.
_REST: Final = ((0.0, 3.2), (0.05, 3.45), (0.1, 3.6), (0.2, 3.68), (0.4, 3.76), (0.6, 3.87),
                (0.8, 4.0), (0.9, 4.08), (1.0, 4.2))  # fmt: skip
_LASTS: Final = 6 * 3600.0  # seconds, from full to empty
_DROP: Final = 0.03  # V: voltage drop by the board's load


class Motion(NamedTuple):
    """Position and velocity of the board.

    Attributes:
        latitude: In degrees.
        longitude: In degrees.
        altitude: In m above the ellipsoid.
        speed: In m/s.
        course: In degrees clockwise from north.
    """

    latitude: float
    longitude: float
    altitude: float
    speed: float
    course: float


def dipole(latitude: float, longitude: float) -> tuple[float, float, float]:
    """Return the earth's magnetic field: east, north and up, in tesla.

    Args:
        latitude: In degrees.
        longitude: In degrees.
    """
    phi, lam = math.radians(latitude), math.radians(longitude)
    pole_phi, pole_lam = _POLE

    def unit(p: float, q: float) -> tuple[float, float, float]:
        return math.cos(p) * math.cos(q), math.cos(p) * math.sin(q), math.sin(p)

    up = unit(phi, lam)
    moment = unit(pole_phi, pole_lam)  # the dipole points the other way
    east = (-math.sin(lam), math.cos(lam), 0.0)
    north = unit(phi + math.pi / 2, lam)

    def dot(a: tuple[float, float, float], b: tuple[float, float, float]) -> float:
        return sum(x * y for x, y in zip(a, b, strict=True))

    return (
        _EQUATOR_TESLA * dot(moment, east),
        _EQUATOR_TESLA * dot(moment, north),
        -2 * _EQUATOR_TESLA * dot(moment, up),
    )


def rest_voltage(full: float) -> float:
    """Return the open-circuit voltage of a lithium cell in V, by its charge (0 to 1)."""
    full = min(max(full, 0.0), 1.0)
    for (low, below), (high, above) in zip(_REST, _REST[1:], strict=False):
        if full <= high:
            return below + (above - below) * (full - low) / (high - low)
    return _REST[-1][1]


class Outdoors:
    """One place. The times ``t`` of its methods are in seconds since power-on.

    Attributes:
        latitude: Of the circle's middle, in degrees.
        longitude: Of the circle's middle, in degrees.
        altitude: In m above the ellipsoid.
        epoch: The time of power-on, in seconds since 1970.
        metres: The length in m of one degree of latitude and of one degree of longitude.

    Args:
        seed: The seed of place and phases.
        start_hour: The local solar time at power-on, in hours.
        epoch: See the attribute; by default a day in June at ``start_hour``.
        charge: The battery's state of charge at power-on, 0 to 1.
    """

    def __init__(
        self, seed: int = 0, start_hour: float = 10.0, epoch: int | None = None, charge: float = 0.9
    ) -> None:
        source = random.Random(f"{seed}/outdoors")
        latitude, longitude = source.choice(_PLACES)
        self.latitude = latitude + source.uniform(-_NEARBY, _NEARBY)
        self.longitude = longitude + source.uniform(-_NEARBY, _NEARBY)
        self.altitude = source.uniform(5.0, 400.0)
        self._heading = source.uniform(0.0, 2 * math.pi)
        self._phase = source.uniform(0.0, 2 * math.pi)
        self._charge = charge
        if epoch is None:
            epoch = EPOCH + round((start_hour - self.longitude / 15) * 3600)
        self.epoch = epoch
        sine = math.sin(math.radians(self.latitude))
        shape = 1 - _ECCENTRICITY_2 * sine * sine

        self.metres = (
            math.radians(_SEMI_MAJOR * (1 - _ECCENTRICITY_2) / shape**1.5),
            math.radians(_SEMI_MAJOR / math.sqrt(shape)) * math.cos(math.radians(self.latitude)),
        )
        self._field = dipole(self.latitude, self.longitude)

    # The walk.

    def heading(self, t: float) -> float:
        """Return the yaw of the board's x axis in rad, counter-clockwise from east."""
        return (self._heading + SPEED / RADIUS * t) % (2 * math.pi)

    def offset(self, t: float) -> tuple[float, float]:
        """Return the offset from the circle's middle: metres east and north."""
        angle = self.heading(t) - math.pi / 2
        return RADIUS * math.cos(angle), RADIUS * math.sin(angle)

    def roll(self, t: float) -> float:
        """Return the roll rate in rad/s, which comes from walking."""
        return _TILT * math.sin(math.pi * _STEPS * t + self._phase)

    def place(self, t: float) -> Motion:
        """Return the true position and velocity."""
        east, north = self.offset(t)
        longitude = self.longitude + east / self.metres[1]
        return Motion(
            self.latitude + north / self.metres[0],
            (longitude + 180.0) % 360.0 - 180.0,
            self.altitude,
            SPEED,
            (90.0 - math.degrees(self.heading(t))) % 360.0,
        )

    # What each sensor measures.

    def motion(self, t: float) -> tuple[float, float, float, float, float, float]:
        """Return proper acceleration (m/s²) and angular velocity (rad/s) on the board's axes."""
        lift = _LIFT * math.sin(2 * math.pi * _STEPS * t + self._phase)
        return 0.0, SPEED * SPEED / RADIUS, G + lift, self.roll(t), 0.0, SPEED / RADIUS

    def field(self, t: float) -> tuple[float, float, float]:
        """Return the magnetic field on the board's axes, in tesla."""
        east, north, up = self._field
        heading = self.heading(t)
        cos, sin = math.cos(heading), math.sin(heading)
        return east * cos + north * sin, north * cos - east * sin, up

    def sun(self, t: float) -> float:
        """Return the height of the sun: 0 at night, 1 at noon of local solar time."""
        hour = (self.epoch + self.longitude * 240 + t) % DAY / 3600
        return max(0.0, math.sin(math.pi * (hour - _SUNRISE) / (_SUNSET - _SUNRISE)))

    def light(self, t: float) -> float:
        """Return the illuminance in lux: sun and clouds."""
        clouds = 0.75 + 0.2 * math.sin(2 * math.pi * t / 410 + self._phase)
        return _SUN * self.sun(t) * clouds + _MOON

    def temperature(self, t: float) -> float:
        """Return the air temperature in °C."""
        return 14.0 + 9.0 * self.sun(t - 7200) + 0.3 * math.sin(2 * math.pi * t / 300)

    def humidity(self, t: float) -> float:
        """Return the relative humidity, 0 to 1; it falls as the temperature rises."""
        return min(max(0.75 - 0.025 * (self.temperature(t) - 14.0), 0.05), 0.98)

    def air(self, t: float) -> tuple[float, float]:
        """Return the air temperature in °C and the relative humidity (0 to 1)."""
        return self.temperature(t), self.humidity(t)

    def target(self, t: float) -> tuple[float, float]:
        """Return the distance of the wall in m (infinite at a gap) and its reflectivity."""
        phase = t % _PASS / _PASS
        if phase > 0.85:
            return math.inf, 0.0
        middle, half = (_FAR + _NEAR) / 2, (_FAR - _NEAR) / 2
        return middle + half * math.cos(2 * math.pi * phase / 0.85), 0.7

    def cell(self, t: float) -> tuple[float, float]:
        """Return the battery's voltage in V and state of charge (0 to 1)."""
        full = min(max(self._charge - t / _LASTS, 0.0), 1.0)
        return rest_voltage(full) - _DROP, full
