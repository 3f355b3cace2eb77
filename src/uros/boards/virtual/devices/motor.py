"""A brushed DC motor with its gear, as it is seen at the wheel's shaft.

By default a TT motor, 1:48, of the kind that robot car kits have. Inductance is left out: its time
constant is below the millisecond that everything here is integrated by. Where a bridge leaves the
motor to coast, no current flows in that part of the PWM's period.
"""

from __future__ import annotations

import math
import random
from typing import ClassVar, Final

RESISTANCE: Final = 5.0  # ohm
BACK_EMF: Final = 0.0042  # V·s/rad of the rotor, and N·m/A
GEAR: Final = 48.0
EFFICIENCY: Final = 0.6  # of the gear
ROTOR: Final = 1.4e-7  # kg·m²
WHEEL: Final = 2.0e-5  # kg·m², around its own axle
COULOMB: Final = 0.014  # N·m at the wheel, while it turns
STICTION: Final = 1.25  # times COULOMB, while it stands
VISCOUS: Final = 2.5e-4  # N·m·s/rad


class Motor:
    """One motor. ``speed`` is the wheel's, in rad/s; ``current`` what the winding carried last and
    ``draw`` what it took from the supply, in A, both as means over the PWM's period.

    What makes motors differ, resistance, torque constant and friction, is drawn from ``seed``,
    each within ``spread`` of the values above: 0.15 is ±15 %.
    """

    FAULTS: ClassVar[dict[str, str]] = {
        "stuck": "its wheel is blocked",
        "weak": "gives 60 % of its torque",
        "open": "its winding is broken: no current",
        "slips": "its wheel spins on the floor: a quarter of the way is lost",
    }

    def __init__(self, seed: object = 0, spread: float = 0.15) -> None:
        if not 0 <= spread <= 0.15:
            raise ValueError(f"a spread is 0 to 0.15, not {spread}")
        source = random.Random(f"{seed}/motor")
        self.resistance = RESISTANCE * (1 + source.uniform(-spread, spread))
        # Of the whole gear: volts a rad/s of the wheel; its torque an ampere is less by the losses.
        self.back_emf = BACK_EMF * GEAR * (1 + source.uniform(-spread, spread))
        self.coulomb = COULOMB * (1 + source.uniform(-spread, spread))
        self.viscous = VISCOUS
        self.inertia = ROTOR * GEAR * GEAR * EFFICIENCY + WHEEL
        self.speed = 0.0
        self.current = 0.0
        self.draw = 0.0
        self.faults: set[str] = set()

    def torque(self, volts: float, drive: float, brake: float) -> float:
        """Of the shaft in N·m, without dry friction; notes ``current`` and ``draw``.

        ``drive`` is the share of the time, -1 to 1, in which the supply of ``volts`` is on the
        winding, and ``brake`` the share in which the winding is shorted.
        """
        share = abs(drive) + brake
        if not share or "open" in self.faults:
            self.current = self.draw = 0.0
            return -self.viscous * self.speed
        emf = self.back_emf * self.speed
        current = self.current = (drive * volts - share * emf) / self.resistance
        self.draw = current * drive / share
        factor = EFFICIENCY * (0.6 if "weak" in self.faults else 1.0)
        return factor * self.back_emf * current - self.viscous * self.speed

    @property
    def friction(self) -> float:
        """What dry friction takes at most, in N·m."""
        if "stuck" in self.faults:
            return math.inf
        return self.coulomb if self.speed else self.coulomb * STICTION

    def step(self, dt: float, volts: float, drive: float, brake: float = 0.0) -> None:
        """``dt`` seconds with the wheel in the air."""
        speed = self.speed + self.torque(volts, drive, brake) * dt / self.inertia
        lost = self.friction * dt / self.inertia
        self.speed = math.copysign(max(abs(speed) - lost, 0.0), speed)
