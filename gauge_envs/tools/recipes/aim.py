"""What a recipe is asked for: the behaviour of a contact, the mass of the body and the time step."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace

from gauge_envs.backends.shared.spring_damper import spring_damper_restitution
from gauge_envs.errors import ParameterError
from gauge_envs.scene import GRAVITY_M_PER_S2

FRICTION_RANGE = (0.01, 2.0)
"""Coefficients of friction that the scenes measure: the plate tips at 4, and on less it slides on a level slope."""

MASS_RANGE_KG = (1e-3, 1e4)
"""Masses that the scenes measure [kg]."""

TIMESTEP_RANGE_S = (5e-5, 0.05)
"""Time steps that the scenes measure [s]: below, a recipe takes minutes; above, a ball falls 0.1 m in a step."""

PENETRATION_RANGE_M = (1e-7, 0.01)
"""Depths at rest that the scenes measure [m]: the plate is 0.03 m thick."""


TURNING_RANGE_M, CREEP_RANGE_M_S = (1e-5, 0.01), (1e-9, 1.0)
"""Torsional and rolling friction [m], above which a ball slides and does not roll, and creep [m/s]."""

FREE_FRICTION = 0.5
"""Coefficient of friction with which a contact is built and measured when none is asked for."""


@dataclass(frozen=True, kw_only=True)
class Aim:
    """Behaviour of a contact that settings are to give.

    Attributes:
        friction: Coulomb coefficient, static and dynamic, of a body that holds contact.
        restitution: Rebound over impact speed; None if it does not matter.
        penetration_m: Largest depth of the plate at rest on four corners [m]; None if it does not matter.
        stiffness_n_per_m: Weight of the plate over its depth at rest [N/m]; None for a contact as hard as it gets.
        damping_n_s_per_m: Damping beside this stiffness [N s/m], in place of the restitution; None if it is not given.
        torsion_m: Torque of friction about the normal, over the normal force [m]; None if it does not matter.
        rolling_m: Torque against rolling, over the normal force [m]; None if it does not matter.
        creep_m_s: Largest speed on a slope of half the friction [m/s]; None if it does not matter.
        mass_kg: Mass of the body [kg].
        timestep_s: Time step of the engine [s].
        is_friction_asked: Whether the friction matters. If not, it is a value to build and measure with.

    Raises:
        ParameterError: A value is out of the range that can be measured, or two values contradict each other.
    """

    friction: float
    restitution: float | None = None
    penetration_m: float | None = None
    stiffness_n_per_m: float | None = None
    damping_n_s_per_m: float | None = None
    torsion_m: float | None = None
    rolling_m: float | None = None
    creep_m_s: float | None = None
    mass_kg: float
    timestep_s: float
    is_friction_asked: bool = True

    def __post_init__(self) -> None:
        check_measurable("friction", self.friction, FRICTION_RANGE)
        check_measurable("mass", self.mass_kg, MASS_RANGE_KG, " kg")
        check_measurable("timestep", self.timestep_s, TIMESTEP_RANGE_S, " s")
        if self.restitution is not None:
            check_measurable("restitution", self.restitution, (0.0, 1.0))
        for name, value in self.turning.items():
            check_measurable(name, value, TURNING_RANGE_M, " m")
        if self.creep_m_s is not None:
            check_measurable("creep", self.creep_m_s, CREEP_RANGE_M_S, " m/s")
        if self.penetration_m is not None:
            check_measurable(
                "penetration", self.penetration_m, PENETRATION_RANGE_M, " m"
            )
        if self.stiffness_n_per_m is not None:
            self._check_stiffness(self.stiffness_n_per_m)
        if self.damping_n_s_per_m is not None:
            if self.stiffness_n_per_m is None or self.restitution is not None:
                raise ParameterError(
                    "damping: it determines the rebound beside a stiffness: give a stiffness and no restitution"
                )
            check_measurable(
                "damping", self.damping_n_s_per_m, (0.0, math.inf), " N s/m"
            )

    def _check_stiffness(self, stiffness: float) -> None:
        if self.penetration_m is not None:
            raise ParameterError(
                "stiffness and penetration both state the depth at rest: give one of them"
            )
        weight = self.mass_kg * GRAVITY_M_PER_S2
        low, high = (
            float(f"{weight / depth_m:.3g}")
            for depth_m in reversed(PENETRATION_RANGE_M)
        )
        check_measurable("stiffness", stiffness, (low, high), " N/m for this mass")

    @property
    def turning(self) -> dict[str, float]:
        """Torsional and rolling friction that are asked for [m], by name."""
        several = {"torsion_m": self.torsion_m, "rolling_m": self.rolling_m}
        return {name: value for name, value in several.items() if value is not None}

    @property
    def depth_m(self) -> float | None:
        """Depth at rest that is asked for [m]: the largest one allowed, or that of the stiffness."""
        if self.stiffness_n_per_m is not None:
            return self.mass_kg * GRAVITY_M_PER_S2 / self.stiffness_n_per_m
        return self.penetration_m

    def aimed_depth_m(self, margin: float) -> float | None:
        """Return the depth at rest that settings aim at [m]: a share of an allowed one, or that of the stiffness."""
        return (
            None
            if self.depth_m is None
            else (margin if self.stiffness_n_per_m is None else 1.0) * self.depth_m
        )

    @property
    def rebound(self) -> float | None:
        """Restitution that is asked for, or that of a linear spring and damper; None if neither is given."""
        if self.damping_n_s_per_m is None or self.stiffness_n_per_m is None:
            return self.restitution
        critical = 2.0 * math.sqrt(self.stiffness_n_per_m * self.mass_kg)
        return spring_damper_restitution(self.damping_n_s_per_m / critical)

    def changed(self, **values: float) -> Aim:
        """Return an aim with other values, which may be out of range: a search for settings passes the target."""
        aim = replace(self)
        if "restitution" in values:
            object.__setattr__(aim, "damping_n_s_per_m", None)
        for name, value in values.items():
            object.__setattr__(aim, name, value)
        return aim

    def asked(self) -> dict[str, float | None]:
        """Return the request, JSON-ready."""
        values = asdict(self)
        return values | {
            "friction": self.friction if values.pop("is_friction_asked") else None
        }


def check_measurable(
    name: str,
    value: float,
    limits: tuple[float, float],
    unit: str = "",
    *,
    what: str = "a recipe is",
) -> None:
    """Raise an error for a value that the scenes do not measure."""
    low, high = limits
    if not low <= value <= high:
        upper = f" to {high:g}" if math.isfinite(high) else " or more"
        raise ParameterError(
            f"{name} {value:g}{unit}: {what} measured for {low:g}{upper}{unit}"
        )
