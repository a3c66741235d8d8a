"""Genesis's contact settings: the friction of materials, and the constants of the constraint solver."""

import math
from typing import Any, Self

from pydantic import Field, model_validator
from scipy.optimize import brentq

from gauge_envs.backends.shared.spring_damper import damping_ratio_of
from gauge_envs.tools.recipes.aim import Aim
from gauge_envs.tools.recipes.closed_forms import MuJoCoContact
from gauge_envs.tools.recipes.engines.base import ContactSettings, numbers
from gauge_envs.tools.recipes.engines.mujoco import (
    LIMITS as MUJOCO_LIMITS,
    impedance_of,
    spring_frequency_per_s,
)

IMPACT_STEPS = (4, 5, 6, 7, 8, 9, 10, 12, 14, 16, 18, 20, 24, 28, 32, 40, 50, 60)
"""Steps that half a period of a contact's spring lasts, from hard to soft."""

MAX_IMPACT_S = 0.09
"""Longest half period [s]. At 2 m/s a body then sinks in by 57 mm; the balls of the drop, of 60 mm, fall through the
ground if they sink in by more than their diameter."""

MAX_SCATTER = 0.05
"""Largest range of restitutions between the moments of a step at which an impact may start."""

NO_REBOUND = 0.002
"""Mean restitution that counts as none."""

HARD_IMPEDANCE = 0.95
"""Impedance of a contact without rebound."""

SOFT_IMPEDANCE = 0.5
"""Impedance of a contact that rebounds or has a given stiffness. It bears a body at a depth near that of the fall in a
step. With 0.9999, which bears it at the surface, a plate on a contact with restitution 0.6 and steps of 2 ms hops
without end, and creeps at 3.5 mm/s."""

MIN_RATIO = 1e-4
"""Smallest damping ratio of an impact."""

MIN_TIME_STEPS = 2.0
"""Time constant to which Genesis raises shorter ones [steps]."""

SolParams = tuple[float, float, float, float, float, float, float]
"""Time constant [s], damping ratio, and impedance: least, greatest, width [m], midpoint, power."""

SHAPE = (0.001, 0.5, 2.0)
"""Width [m], midpoint and power of an impedance that is constant in depth."""


NATIVES = {
    "friction_cone": "friction_cone",
    "contact_resolution": "contact_resolution",
    "impratio": "impratio",
}
"""Settings of the backend, by the field that states them."""

LIMITS = {
    "restitution": "Genesis has no coefficient of restitution, and raises the time constant of a contact to two "
    "steps: a rebound is a damped spring that lasts several steps",
    "penetration_m": MUJOCO_LIMITS["penetration_m"].replace("MuJoCo", "Genesis"),
}
"""What the engine itself limits, by the measured value."""


class GenesisSettings(ContactSettings):
    """Options of Genesis's rigid solver, the friction of both materials, and the constants of all geoms.

    Attributes:
        friction: Coefficient of friction.
        sol_params: Time constant [s], damping ratio, and impedance: least, greatest, width [m], midpoint, power.
    """

    engine = "genesis"
    is_soft = True
    natives = NATIVES
    limits = LIMITS

    friction: float = Field(default=1.0, ge=0.01, le=5.0)
    sol_params: SolParams = (
        0.01,
        1.0,
        0.9,
        0.95,
        *SHAPE,
    )
    friction_cone: str = "pyramidal"
    contact_resolution: str = "convex"
    impratio: float = 1.0

    @model_validator(mode="before")
    @classmethod
    def _defaults_of_cone(cls, values: dict[str, Any]) -> dict[str, Any]:
        """With the elliptic cone, Genesis has other defaults for the resolution and the ratio of impedances."""
        if values.get("friction_cone") == "elliptic":
            return {"contact_resolution": "signorini", "impratio": 100.0, **values}
        return values

    @model_validator(mode="after")
    def _measurable(self) -> Self:
        if min(self.sol_params[:2]) <= 0.0:
            raise ValueError(
                "time constant and damping ratio must be positive: Genesis has no direct format"
            )
        if self.sol_params[5:] != SHAPE[1:]:
            raise ValueError(
                "midpoint and power must be those of Genesis, 0.5 and 2: others are not measured"
            )
        return self

    @classmethod
    def constants(cls, aim: Aim) -> dict[str, Any]:
        """Return a spring that rebounds as hard as steps resolve it, or the spring and damper that is asked for."""
        frequency_per_s = spring_frequency_per_s(aim)
        if frequency_per_s is None:
            return {"sol_params": _impact(aim), "friction_cone": "elliptic"}
        ratio = 1.0
        if aim.rebound is not None:
            ratio = max(damping_ratio_of(aim.rebound), 1e-3)
        ratio = min(ratio, _max_ratio(frequency_per_s, aim.timestep_s))
        solref = (1.0 / (ratio * frequency_per_s), ratio)
        sol_params = (*solref, SOFT_IMPEDANCE, SOFT_IMPEDANCE, *SHAPE)
        return {"sol_params": sol_params, "friction_cone": "elliptic"}

    def snippet(self) -> str:
        """Return Python for the options, the material and the constants of a scene."""
        torsion, rolling = f"{self.torsion_m:g}", f"{self.rolling_m:g}"
        turns = bool(self.torsion_m or self.rolling_m)
        return f"""\
import genesis as gs

gs.init(backend=gs.cpu, precision="64")

DT = {self.timestep_s:.9g}  # gs.options.SimOptions(dt=DT)

def rigid_options():  # gs.Scene(rigid_options=rigid_options(), ...)
    return gs.options.RigidOptions(
        friction_cone=gs.friction_cone.{self.friction_cone},
        contact_resolution=gs.contact_resolution.{self.contact_resolution},
        impratio={self.impratio:g},
        enable_torsional_friction={turns},
        enable_rolling_friction={turns},
    )

def material():  # of both entities
    return gs.materials.Rigid(friction={self.friction:g}, friction_torsional={torsion}, friction_rolling={rolling})

def set_contact(scene):  # after scene.build()
    scene.rigid_solver.set_global_sol_params(({numbers(self.sol_params, ", ")}))
"""

    def backend_settings(self, mass_kg: float) -> dict[str, Any]:
        """Return the constants of sustained contacts, in double precision."""
        time_s, ratio, *impedance = self.sol_params[:5]
        return {
            **super().backend_settings(mass_kg),
            "precision": 64,
            "tolerance": 1e-8,
            "sustained_timeconst_s": time_s,
            "sustained_dampratio": ratio,
            "sustained_impedance": tuple(impedance),
        }

    def closed_form(self) -> dict[str, float | None]:
        """Return what MuJoCo's documented equation gives, from which Genesis's solver descends."""
        return MuJoCoContact(
            solref=self.sol_params[:2],
            solimp=self.sol_params[2:],
            friction=self.friction,
            impratio=self.impratio,
            is_elliptic=self.friction_cone == "elliptic",
            timestep_s=self.timestep_s,
        ).form()


def _max_ratio(frequency_per_s: float, timestep_s: float) -> float:
    """Return the damping ratio with which a spring [1/s] has the shortest time constant, 1 / (ratio frequency)."""
    return 1.0 / (MIN_TIME_STEPS * timestep_s * frequency_per_s)


def _impact(aim: Aim) -> SolParams:
    """Return the constants of the hardest spring whose rebound scatters little."""
    restitution = aim.rebound or 0.0
    candidates: list[tuple[float, SolParams]] = []
    for steps in IMPACT_STEPS:
        half_period_s = steps * aim.timestep_s
        if candidates and half_period_s > MAX_IMPACT_S:
            break
        contact = _rebounding(aim, restitution, math.pi / half_period_s)
        rebounds = contact.rebounds()
        miss = abs(sum(rebounds) / len(rebounds) - restitution)
        scatter = max(rebounds) - min(rebounds)
        fault = max(miss - NO_REBOUND, 0.0) + max(scatter - MAX_SCATTER, 0.0)
        candidates.append((fault, (*contact.solref, *contact.solimp)))
        if fault == 0.0:
            break
    return min(candidates)[1]


def _rebounding(aim: Aim, restitution: float, frequency_per_s: float) -> MuJoCoContact:
    """Return a spring [1/s] whose mean rebound is a restitution, or comes nearest to it.

    Its impedance bears the weight at a depth that steps do not leave.
    """
    impedance = impedance_of(
        aim,
        SOFT_IMPEDANCE if restitution else HARD_IMPEDANCE,
        lambda load_s2: 1.0 - load_s2 * frequency_per_s**2,
    )

    def contact(ratio: float) -> MuJoCoContact:
        return MuJoCoContact(
            solref=(1.0 / (ratio * frequency_per_s), ratio),
            solimp=(impedance, impedance, *SHAPE),
            timestep_s=aim.timestep_s,
        )

    def excess(ratio: float) -> float:
        rebounds = contact(ratio).rebounds()
        return sum(rebounds) / len(rebounds) - restitution

    max_ratio = _max_ratio(frequency_per_s, aim.timestep_s)
    if excess(max_ratio) >= 0.0:
        return contact(max_ratio)
    if excess(MIN_RATIO) <= 0.0:
        return contact(MIN_RATIO)
    return contact(brentq(excess, MIN_RATIO, max_ratio, xtol=1e-5))
