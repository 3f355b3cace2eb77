"""The room that the virtual sensors measure.

Every quantity is a pure function of the seconds since power-on and the seed: any time may be asked
for in any order, and weeks cost no more than a second.

The door opens about once a minute. The room is cool at power-on and is being heated; the sun warms
it by day, and the open door lowers the temperature and raises the humidity. Daylight falls in
through a window, and a lamp is on in the evening. The thermocouple is on a hotplate that is
switched on and off; its cold junction, on the board, is a little warmer than the room.
"""

from __future__ import annotations

import math
import random
from typing import Final

DAY: Final = 86_400.0

# The door: it opens once in each interval, and takes a second to open and to close.
DOOR_INTERVAL: Final = 60.0
DOOR_CLOSED_MM: Final = 3.0
DOOR_OPEN_MM: Final = 400.0
_DOOR_MOVES: Final = 1.0
_DOOR_OPEN: Final = (8.0, 20.0)

# Temperatures in °C: the set point of the heating, the deficit at power-on, thermostat, sun, door.
_HEATED: Final = 21.5
_COOL_START: Final = 2.0
_WARM_UP: Final = 900.0  # seconds
_THERMOSTAT: Final = 0.25
_THERMOSTAT_PERIOD: Final = 1200.0
_SUN: Final = 2.0
_SUN_LAG: Final = 5400.0
_DOOR_LOSS: Final = 0.01  # °C a second
_DOOR_RECOVERY: Final = 240.0  # seconds

_HUMIDITY: Final = 0.45
_BOARD_WARMTH: Final = 1.2

# The hotplate: the temperature in °C above the board that it would reach, its time constant, and
# its switching period and on-time, in seconds.
_PLATE: Final = 90.0
_PLATE_TAU: Final = 75.0
_PLATE_PERIOD: Final = 240.0
_PLATE_ON: Final = 90.0

_DAYLIGHT: Final = 600.0  # lx at noon under a clear sky
_LAMP: Final = 140.0
_SUNRISE: Final = 6.0
_SUNSET: Final = 20.0


class Room:
    """One room. The times ``t`` of its methods are in seconds since power-on.

    Args:
        seed: The seed of the door and of phases.
        start_hour: The time of day at power-on, in hours.
    """

    def __init__(self, seed: int = 0, start_hour: float = 9.0) -> None:
        self._seed = seed
        self._start = start_hour * 3600

    def _visit(self, interval: int) -> tuple[float, float]:
        """Return when the door starts to open and when it is closed again, in one interval."""
        source = random.Random(f"{self._seed}/door/{interval}")
        lasts = source.uniform(*_DOOR_OPEN) + 2 * _DOOR_MOVES
        begins = interval * DOOR_INTERVAL + source.uniform(5.0, DOOR_INTERVAL - lasts - 5.0)
        return begins, begins + lasts

    def door(self, t: float) -> float:
        """Return how far the door is open: 0 closed, 1 open."""
        begins, ends = self._visit(math.floor(t / DOOR_INTERVAL))
        moved = min(t - begins, ends - t) / _DOOR_MOVES
        moved = min(max(moved, 0.0), 1.0)
        return moved * moved * (3 - 2 * moved)

    def door_mm(self, t: float) -> float:
        """Return the distance from the proximity sensor to the door in mm."""
        return DOOR_CLOSED_MM + (DOOR_OPEN_MM - DOOR_CLOSED_MM) * self.door(t)

    def _door_loss(self, t: float) -> float:
        """Return the temperature loss of all door openings so far in °C.

        The temperature falls while the door is open and recovers exponentially.
        """
        tau = _DOOR_RECOVERY
        now = math.floor(t / DOOR_INTERVAL)
        loss = 0.0
        for interval in range(now - math.ceil(8 * tau / DOOR_INTERVAL), now + 1):
            begins, ends = self._visit(interval)
            if begins < t:
                ends = min(ends, t)
                loss += math.exp((ends - t) / tau) - math.exp((begins - t) / tau)
        return _DOOR_LOSS * tau * loss

    def _sun(self, t: float) -> float:
        """Return the height of the sun: 0 at night, 1 at noon."""
        hour = (self._start + t) % DAY / 3600
        return max(0.0, math.sin(math.pi * (hour - _SUNRISE) / (_SUNSET - _SUNRISE)))

    def temperature(self, t: float) -> float:
        """Return the air temperature in °C: about 19 to 24."""
        return (
            _HEATED
            - _COOL_START * math.exp(-max(t, 0.0) / _WARM_UP)
            + _THERMOSTAT * math.sin(2 * math.pi * t / _THERMOSTAT_PERIOD)
            + _SUN * self._sun(t - _SUN_LAG)
            - self._door_loss(t)
        )

    def humidity(self, t: float) -> float:
        """Return the relative humidity, 0 to 1; it falls as the temperature rises."""
        slow = 0.03 * math.sin(2 * math.pi * t / 7000 + self._seed)
        warmer = self.temperature(t) - _HEATED
        humidity = _HUMIDITY + slow - 0.025 * warmer + 0.01 * self._door_loss(t)
        return min(max(humidity, 0.05), 0.95)

    def daylight(self, t: float) -> float:
        """Return the illuminance in lux: sun and clouds, a lamp from 18 to 23 o'clock."""
        clouds = 0.8 + 0.15 * math.sin(2 * math.pi * t / 610 + self._seed) + 0.05 * math.sin(t / 19)
        hour = (self._start + t) % DAY / 3600
        lamp = _LAMP if 18 <= hour < 23 else 0.0
        return _DAYLIGHT * self._sun(t) * clouds + lamp + 0.5

    def cold(self, t: float) -> float:
        """Return the temperature of the cold junction on the board in °C."""
        return self.temperature(t) + _BOARD_WARMTH

    def hot(self, t: float) -> float:
        """Return the temperature of the hot junction on the hotplate in °C: about 30 to 90."""
        # Periodic steady state: each period ends at the temperature at which it started.
        fall = math.exp(-(_PLATE_PERIOD - _PLATE_ON) / _PLATE_TAU)
        rise = math.exp(-_PLATE_ON / _PLATE_TAU)
        peak = _PLATE * (1 - rise) / (1 - rise * fall)
        phase = t % _PLATE_PERIOD
        if phase < _PLATE_ON:
            above = _PLATE - (_PLATE - peak * fall) * math.exp(-phase / _PLATE_TAU)
        else:
            above = peak * math.exp(-(phase - _PLATE_ON) / _PLATE_TAU)
        return self.cold(t) + above

    # What each sensor measures.

    def air(self, t: float) -> tuple[float, float]:
        """Return the air temperature in °C and the relative humidity (0 to 1)."""
        return self.temperature(t), self.humidity(t)

    def junctions(self, t: float) -> tuple[float, float]:
        """Return the temperatures of hot and cold junction in °C."""
        return self.hot(t), self.cold(t)

    def scene(self, t: float) -> tuple[float, float]:
        """Return the distance of the door in mm and the illuminance in lux."""
        return self.door_mm(t), self.daylight(t)
