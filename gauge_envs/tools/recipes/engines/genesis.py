"""Genesis's contact settings: the friction of materials, and the constants of the constraint solver."""

import math
from typing import Any, ClassVar, Self

import numpy as np
from pydantic import Field, model_validator

from gauge_envs.scene import GRAVITY_M_PER_S2 as G
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.recipes.aim import Aim
from gauge_envs.tools.recipes.engines.base import (
    ContactSettings,
    numbers,
    root_or_end,
)
from gauge_envs.tools.recipes.engines.mujoco import (
    ConstraintSettings,
    impedance_of,
    spring_frequency_per_s,
)
from gauge_envs.tools.recipes.probes import drop_heights_m

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

MAX_CONTACT_S = 0.3
"""Time after which an impact counts as a rest [s]."""

MIN_TIME_STEPS = 2.0
"""Time constant to which Genesis raises shorter ones [steps]."""

SolParams = tuple[float, float, float, float, float, float, float]
"""Time constant [s], damping ratio, and impedance: least, greatest, width [m], midpoint, power."""

SHAPE = (0.001, 0.5, 2.0)
"""Width [m], midpoint and power of an impedance that is constant in depth."""


class GenesisSettings(ContactSettings):
    """Options of Genesis's rigid solver, the friction of both materials, and the constants of all geoms.

    Attributes:
        friction: Coefficient of friction.
        sol_params: Time constant [s], damping ratio, and impedance: least, greatest, width [m], midpoint, power.
    """

    engine = "genesis"
    is_soft = True
    natives: ClassVar = {
        "friction_cone": "friction_cone",
        "contact_resolution": "contact_resolution",
        "impratio": "impratio",
    }
    limits: ClassVar = {
        "restitution": "Genesis has no coefficient of restitution, and raises the time constant of a contact to two "
        "steps: a rebound is a damped spring that lasts several steps",
        "penetration_m": ConstraintSettings.limits["penetration_m"].replace(
            "MuJoCo", "Genesis"
        ),
    }

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
            sol_params = _impact(aim)
        else:
            ratio = max(aim.damping_ratio, 1e-3)
            ratio = min(ratio, _max_ratio(aim, frequency_per_s))
            sol_params = _constants(frequency_per_s, ratio, SOFT_IMPEDANCE)
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


def _max_ratio(aim: Aim, frequency_per_s: float) -> float:
    """Return the damping ratio with which a spring [1/s] has the shortest time constant, 1 / (ratio frequency)."""
    return 1.0 / (MIN_TIME_STEPS * aim.timestep_s * frequency_per_s)


def _impact(aim: Aim) -> SolParams:
    """Return the constants of the hardest spring whose rebound scatters little."""
    restitution = aim.rebound or 0.0
    max_steps = MAX_IMPACT_S / aim.timestep_s
    candidates: dict[float, SolParams] = {}
    for steps in IMPACT_STEPS:
        if candidates and steps > max_steps:
            break
        frequency_per_s = math.pi / (steps * aim.timestep_s)
        impedance, ratio = _rebounding(aim, restitution, frequency_per_s)
        restitutions = rebounds(frequency_per_s, ratio, impedance, aim.timestep_s)
        miss = abs(restitutions.mean() - restitution)
        scatter = np.ptp(restitutions)
        fault = max(miss - NO_REBOUND, 0.0) + max(scatter - MAX_SCATTER, 0.0)
        candidates.setdefault(fault, _constants(frequency_per_s, ratio, impedance))
        if fault == 0.0:
            break
    return candidates[min(candidates)]


def _constants(frequency_per_s: float, ratio: float, impedance: float) -> SolParams:
    """Return a spring [1/s] with a damping ratio, whose impedance is constant in depth."""
    time_s = 1.0 / (ratio * frequency_per_s)
    return time_s, ratio, impedance, impedance, *SHAPE


def _rebounding(
    aim: Aim, restitution: float, frequency_per_s: float
) -> tuple[float, float]:
    """Return impedance and damping ratio of a spring [1/s] whose mean rebound is nearest to a restitution.

    The impedance bears the weight at a depth that steps do not leave.
    """
    impedance = impedance_of(
        aim,
        SOFT_IMPEDANCE if restitution else HARD_IMPEDANCE,
        lambda load_s2: 1.0 - load_s2 * frequency_per_s**2,
    )

    def excess(ratio: float) -> float:
        restitutions = rebounds(frequency_per_s, ratio, impedance, aim.timestep_s)
        return float(restitutions.mean()) - restitution

    max_ratio = _max_ratio(aim, frequency_per_s)
    return impedance, root_or_end(excess, MIN_RATIO, max_ratio)


def rebounds(
    frequency_per_s: float, ratio: float, impedance: float, timestep_s: float
) -> FloatArray:
    """Return the restitution of each drop of `probes` by MuJoCo's contact equation, from which Genesis's descends.

    A contact that pushes gives the acceleration (1 - d) g - 2 z w v - w^2 r at a depth r and a speed v into the ground.
    Steps change first the velocity, then the position.

    Args:
        frequency_per_s: Natural frequency w of the contact [1/s].
        ratio: Damping ratio z.
        impedance: Impedance d, constant in depth.
        timestep_s: Time step [s].

    Source: MuJoCo documentation, Computation, section Constraint model, and Modeling, section Solver parameters.
    """
    height_m = drop_heights_m(timestep_s)
    # After n steps of the fall the speed is n g h, and the fallen height n (n + 1) g h^2 / 2.
    fall_steps = 2.0 * height_m / (G * timestep_s**2)
    count = np.floor(np.sqrt(0.25 + fall_steps) + 0.5)
    speed_m_per_s = count * G * timestep_s
    depth_m = 0.5 * (count + 1.0) * speed_m_per_s * timestep_s - height_m
    load_m_per_s2 = (1.0 - impedance) * G
    for _ in range(math.ceil(MAX_CONTACT_S / timestep_s)):
        # Bodies that have left stay as they are.
        step_s = timestep_s * (depth_m > 0.0)
        if not step_s.any():
            break
        spring_m_per_s2 = frequency_per_s**2 * depth_m
        damper_m_per_s2 = 2.0 * ratio * frequency_per_s * speed_m_per_s
        push_m_per_s2 = spring_m_per_s2 + damper_m_per_s2 - load_m_per_s2
        speed_m_per_s -= step_s * np.maximum(push_m_per_s2, -G)
        depth_m += step_s * speed_m_per_s
    # Positions without force lie on a parabola, whose slope is that between two steps.
    rise_m_per_s = np.maximum(-speed_m_per_s - 0.5 * timestep_s * G, 0.0)
    peak_m = np.where(depth_m <= 0.0, 0.5 * rise_m_per_s**2 / G - depth_m, 0.0)
    return np.sqrt(np.maximum(peak_m, 0.0) / height_m)
