"""Contact settings of Genesis: friction of materials, and constants of the constraint solver."""

import math
from typing import Any, ClassVar, Self

from pydantic import Field, model_validator

from gauge_envs.tools.recipes.aim import Aim
from gauge_envs.tools.recipes.engines.base import ContactSettings, numbers
from gauge_envs.tools.recipes.engines.mujoco import (
    SOFT_DEPTH,
    impedance_of,
    spring_frequency_per_s,
)

IMPACT_STEPS = 16.0
"""Steps in half a period of the contact spring. With fewer steps, rebounds depend on the phase of the impact."""

HARD_STEPS = 9.0
"""Steps in half a period of a contact without rebound."""

MIN_IMPACT_STEPS = 4.0
"""Steps in half a period of the hardest resolved spring."""

MAX_IMPACT_S = 0.09
"""Longest half period [s]. At 2 m/s, a body then sinks in by 57 mm. Balls that sink in by more than their diameter,
60 mm, fall through the ground."""

HARD_IMPEDANCE = 0.95
"""Impedance of a contact without rebound."""

SOFT_IMPEDANCE = 0.5
"""Impedance of a contact that rebounds or has a given stiffness. The depth at rest is near the fall in a step.

With 0.9999, the body rests at the surface, but a plate with restitution 0.6 and steps of 2 ms never stops hopping and
creeps at 3.5 mm/s."""

MIN_RATIO = 1e-3
"""Smallest damping ratio of an impact."""

MIN_TIME_STEPS = 2.0
"""Smallest time constant in Genesis [steps]; it raises shorter ones."""

SolParams = tuple[float, float, float, float, float, float, float]

SHAPE = (0.001, 0.5, 2.0)
"""Width [m], midpoint and power of an impedance that is constant in depth."""


class GenesisSettings(ContactSettings):
    """Options of Genesis's rigid solver, the friction of both materials, and the constants of all geoms.

    Attributes:
        friction: Coefficient of friction.
        sol_params: Time constant [s], damping ratio, and impedance: minimum, maximum, width [m], midpoint, power.
    """

    engine = "genesis"
    is_soft = True
    natives: ClassVar = {
        "friction_cone": "friction_cone",
        "contact_resolution": "contact_resolution",
        "impratio": "impratio",
    }
    limits: ClassVar = {
        "restitution": "Genesis has no coefficient of restitution: a rebound is a damped spring over several steps; "
        "the time constant of a contact is at least two steps",
        "penetration_m": SOFT_DEPTH.format("Genesis"),
    }

    friction: float = Field(default=1.0, ge=0.01, le=5.0)
    sol_params: SolParams = (0.01, 1.0, 0.9, 0.95, *SHAPE)
    friction_cone: str = "pyramidal"
    contact_resolution: str = "convex"
    impratio: float = 1.0

    @model_validator(mode="before")
    @classmethod
    def _defaults_of_cone(cls, values: dict[str, Any]) -> dict[str, Any]:
        """Add the defaults of the elliptic cone for the resolution and the ratio of impedances."""
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
                "midpoint and power must be 0.5 and 2, the defaults of Genesis"
            )
        return self

    @classmethod
    def constants(cls, aim: Aim) -> dict[str, Any]:
        """Return the spring of the stiffness, or a spring that steps resolve, with the damping of the rebound."""
        spring_per_s = spring_frequency_per_s(aim)
        steps, usual = HARD_STEPS, HARD_IMPEDANCE
        if aim.rebound:
            steps, usual = IMPACT_STEPS, SOFT_IMPEDANCE
        steps = max(min(steps, MAX_IMPACT_S / aim.timestep_s), MIN_IMPACT_STEPS)
        frequency_per_s = spring_per_s or math.pi / (steps * aim.timestep_s)
        impedance = SOFT_IMPEDANCE
        if spring_per_s is None:
            impedance = impedance_of(
                aim, usual, lambda load_s2: 1.0 - load_s2 * frequency_per_s**2
            )
        # The time constant is 1 / (ratio frequency).
        max_ratio = 1.0 / (MIN_TIME_STEPS * aim.timestep_s * frequency_per_s)
        ratio = min(max(aim.damping_ratio, MIN_RATIO), max_ratio)
        time_s = 1.0 / (ratio * frequency_per_s)
        return {
            "sol_params": (time_s, ratio, impedance, impedance, *SHAPE),
            "friction_cone": "elliptic",
        }

    def snippet(self) -> str:
        """Return Python for the options, the material and the constants of a scene."""
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
    return gs.materials.Rigid(
        friction={self.friction:g}, friction_torsional={self.torsion_m:g}, friction_rolling={self.rolling_m:g}
    )

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
