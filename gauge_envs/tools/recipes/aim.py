"""Describe the requested behaviour of a contact, the mass of the body and the time step."""

import math
from dataclasses import dataclass

from gauge_envs.backends.shared.spring_damper import (
    damping_ratio_of,
    spring_damper_restitution,
)
from gauge_envs.errors import ParameterError
from gauge_envs.scene import GRAVITY_M_PER_S2

FREE_FRICTION = 0.5
"""Coefficient of friction of the simulated contact if none is requested."""

RANGES = {
    "friction": (0.01, 2.0),
    "restitution": (0.0, 1.0),
    "penetration_m": (1e-7, 0.01),
    "stiffness_n_per_m": (1e-3, math.inf),
    "damping_n_s_per_m": (0.0, math.inf),
    "torsion_m": (1e-5, 0.01),
    "rolling_m": (1e-5, 0.01),
    "creep_m_s": (1e-9, 1.0),
    "mass_kg": (1e-3, 1e4),
    "timestep_s": (5e-5, 0.05),
}
"""Smallest and largest values that the scenes can measure.

The plate is 0.03 m thick and tips at a friction of 4. A ball with more torsional or rolling friction slides instead of
rolling. A recipe takes minutes at shorter time steps; at longer time steps a ball falls 0.1 m in a step.
"""


@dataclass(frozen=True, kw_only=True)
class Aim:
    """Requested behaviour of a contact; None for a value that does not matter.

    Attributes:
        friction: Coulomb coefficient, static and dynamic, of a body in sustained contact.
        restitution: Rebound speed divided by impact speed.
        penetration_m: Largest depth of the plate at rest on four corners [m].
        stiffness_n_per_m: Weight of the plate divided by its depth at rest [N/m]. None gives the hardest contact.
        damping_n_s_per_m: Damping in addition to this stiffness [N s/m], instead of the restitution.
        torsion_m: Torque of friction about the normal, divided by the normal force [m].
        rolling_m: Torque against rolling, divided by the normal force [m].
        creep_m_s: Largest speed on a slope of half the friction [m/s].
        mass_kg: Mass of the body [kg].
        timestep_s: Time step of the engine [s].
    """

    friction: float | None = None
    restitution: float | None = None
    penetration_m: float | None = None
    stiffness_n_per_m: float | None = None
    damping_n_s_per_m: float | None = None
    torsion_m: float | None = None
    rolling_m: float | None = None
    creep_m_s: float | None = None
    mass_kg: float
    timestep_s: float

    def check(self) -> None:
        """Check that the scenes can measure the behaviour.

        Raises:
            ParameterError: A value is out of range, or two values contradict each other.
        """
        for name, (low, high) in RANGES.items():
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                raise ParameterError(f"{name} {value:g}: expected {low:g} to {high:g}")
        if self.damping_n_s_per_m is not None and (
            self.stiffness_n_per_m is None or self.restitution is not None
        ):
            raise ParameterError(
                "damping needs a stiffness, and replaces the restitution: give a stiffness and no restitution"
            )
        if self.stiffness_n_per_m is not None and self.penetration_m is not None:
            raise ParameterError(
                "stiffness and penetration both determine the depth at rest: give only one"
            )
        low_m, high_m = RANGES["penetration_m"]
        depth_m = self.depth_m()
        if depth_m is not None and not low_m <= depth_m <= high_m:
            raise ParameterError(
                f"stiffness_n_per_m gives a depth of {depth_m:.3g} m: expected {low_m:g} to {high_m:g}"
            )

    @property
    def sliding_friction(self) -> float:
        """Coefficient of friction of the simulated contact."""
        return FREE_FRICTION if self.friction is None else self.friction

    def depth_m(self, margin: float = 1.0) -> float | None:
        """Return the depth at rest [m] of the stiffness, or `margin` times the largest allowed depth."""
        if self.stiffness_n_per_m is not None:
            return self.mass_kg * GRAVITY_M_PER_S2 / self.stiffness_n_per_m
        return None if self.penetration_m is None else margin * self.penetration_m

    @property
    def rebound(self) -> float | None:
        """Requested restitution, or the restitution of the spring and damper."""
        if self.damping_n_s_per_m is None or self.stiffness_n_per_m is None:
            return self.restitution
        critical_n_s_per_m = 2.0 * math.sqrt(self.stiffness_n_per_m * self.mass_kg)
        return spring_damper_restitution(self.damping_n_s_per_m / critical_n_s_per_m)

    @property
    def damping_ratio(self) -> float:
        """Damping ratio of a spring and damper with the requested rebound; 1 without a rebound."""
        return 1.0 if self.rebound is None else damping_ratio_of(self.rebound)

    @property
    def targets(self) -> dict[str, float | None]:
        """Target of each measured value, by name; None for a value that does not matter."""
        return {
            "friction": self.friction,
            "restitution": self.rebound,
            "impact_friction": self.friction,
            "slip_restitution": self.rebound,
            "penetration_m": self.depth_m(),
            "creep_m_s": self.creep_m_s,
            "torsion_m": self.torsion_m,
            "rolling_m": self.rolling_m,
        }
