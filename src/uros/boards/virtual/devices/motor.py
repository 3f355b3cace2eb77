"""A brushed DC gear motor, seen at the wheel's shaft.

By default a TT motor, 1:48, of the kind in robot car kits. Inductance is left out: its time
constant is below the integration step of 1 ms. While the bridge lets the motor coast, no current
flows in that part of the PWM period.
"""

from __future__ import annotations

import math
import random
from typing import ClassVar, Final

RESISTANCE: Final = 5.0  # ohm
BACK_EMF: Final = 0.0042  # V·s/rad at the rotor, and N·m/A
GEAR: Final = 48.0
EFFICIENCY: Final = 0.6  # of the gear
ROTOR: Final = 1.4e-7  # kg·m²
WHEEL: Final = 2.0e-5  # kg·m², around its own axle
COULOMB: Final = 0.014  # N·m at the wheel while it turns
STICTION: Final = 1.25  # times COULOMB while it is at rest
VISCOUS: Final = 2.5e-4  # N·m·s/rad


class Motor:
    """One motor.

    Attributes:
        speed: The wheel's speed in rad/s.
        current: The winding's current in A, as a mean over the PWM period.
        draw: The current from the supply in A, as a mean over the PWM period.
        faults: The faults that are injected.

    Args:
        seed: The seed of resistance, torque constant and friction, which differ between motors.
        spread: How far each of these is from its nominal value at most: 0.15 is ±15 %.

    Raises:
        ValueError: ``spread`` is not in 0 to 0.15.
    """

    FAULTS: ClassVar[dict[str, str]] = {
        "stuck": "its wheel is blocked",
        "weak": "gives 60 % of its torque",
        "open": "its winding is open: no current",
        "slips": "its wheel slips on the floor: a quarter of the distance is lost",
    }

    def __init__(self, seed: object = 0, spread: float = 0.15) -> None:
        if not 0 <= spread <= 0.15:
            raise ValueError(f"spread is 0 to 0.15, not {spread}")
        source = random.Random(f"{seed}/motor")
        self.resistance = RESISTANCE * (1 + source.uniform(-spread, spread))
        # At the gear's output: V·s/rad of the wheel; the torque per A is reduced by EFFICIENCY.
        self.back_emf = BACK_EMF * GEAR * (1 + source.uniform(-spread, spread))
        self.coulomb = COULOMB * (1 + source.uniform(-spread, spread))
        self.viscous = VISCOUS
        self.inertia = ROTOR * GEAR * GEAR * EFFICIENCY + WHEEL
        self.speed = 0.0
        self.current = 0.0
        self.draw = 0.0
        self.faults: set[str] = set()

    def torque(self, volts: float, drive: float, brake: float) -> float:
        """Return the torque at the shaft in N·m without dry friction; set ``current`` and ``draw``.

        Args:
            volts: The supply voltage in V.
            drive: The duty cycle, -1 to 1, at which the supply is on the winding.
            brake: The duty cycle at which the winding is shorted.
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
        """The largest torque of dry friction, in N·m."""
        if "stuck" in self.faults:
            return math.inf
        return self.coulomb if self.speed else self.coulomb * STICTION

    def step(self, dt: float, volts: float, drive: float, brake: float = 0.0) -> None:
        """Integrate ``dt`` seconds with the wheel off the ground; see :meth:`torque`."""
        speed = self.speed + self.torque(volts, drive, brake) * dt / self.inertia
        lost = self.friction * dt / self.inertia
        self.speed = math.copysign(max(abs(speed) - lost, 0.0), speed)
