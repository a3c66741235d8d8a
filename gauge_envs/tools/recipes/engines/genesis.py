"""Genesis's contact settings: the friction of materials, and the constants of the constraint solver."""

import math
from collections.abc import Mapping
from typing import Any, ClassVar, Self

from pydantic import Field, field_validator, model_validator
from scipy.optimize import brentq

from gauge_envs.backends.genesis.settings import PRESETS
from gauge_envs.backends.shared.spring_damper import damping_ratio_of
from gauge_envs.tools.recipes.aim import Aim
from gauge_envs.tools.recipes.closed_forms import MuJoCoContact
from gauge_envs.tools.recipes.engines.base import ContactSettings, stated_by
from gauge_envs.tools.recipes.engines.mujoco import RESOLVED_RATE, load_s2
from gauge_envs.tools.recipes.probes import DROP_M, PLATE_CONTACTS

IMPACT_STEPS = (4, 5, 6, 7, 8, 9, 10, 12, 14, 16, 18, 20, 24, 28, 32, 40, 50, 60)
"""Steps that half a period of a contact's spring lasts, from hard to soft."""

LONGEST_IMPACT_S = 0.09
"""Longest half period [s]. At 2 m/s a body then sinks in by 57 mm; the balls of the drop, of 60 mm, fall through the
ground if they sink in by more than their diameter."""

MOST_SCATTER = 0.05
"""Largest range of restitutions between the moments of a step at which an impact may start."""

NO_REBOUND = 0.002
"""Mean restitution that counts as none."""

MOST_IMPEDANCE = 0.9999
"""Largest impedance, Genesis's own limit."""

HARD_IMPEDANCE = 0.95
"""Impedance of a contact without rebound."""

SOFT_IMPEDANCE = 0.5
"""Impedance of a contact that rebounds or has a given stiffness. It bears a body at a depth near that of the fall in a
step. With 0.9999, which bears it at the surface, a plate on a contact with restitution 0.6 and steps of 2 ms hops
without end, and creeps at 3.5 mm/s."""

LEAST_RATIO = 1e-4
"""Smallest damping ratio."""

LEAST_TIME_STEPS = 2.0
"""Time constant to which Genesis raises shorter ones [steps]."""

PHASES = 8
"""Moments within a step over which restitutions are compared."""


@stated_by(PRESETS["out_of_box"])
class GenesisSettings(ContactSettings):
    """Options of Genesis's rigid solver, the friction of both materials, and the constants of all geoms.

    Attributes:
        friction: Coefficient of friction.
        sol_params: Time constant [s], damping ratio, and impedance: least, greatest, width [m], midpoint, power.
    """

    engine: ClassVar[str] = "genesis"
    is_soft: ClassVar[bool] = True
    limits: ClassVar[dict[str, str]] = {
        "restitution": "Genesis has no coefficient of restitution, and raises the time constant of a contact to two "
        "steps: a rebound is a damped spring that lasts several steps",
        "penetration_m": "Genesis's contact is soft: its depth at rest is (1 - d) g / (d k) on one contact, and its "
        "impedance d is at most 0.9999",
    }
    template: ClassVar[str] = """\
import genesis as gs

gs.init(backend=gs.cpu, precision="64")

DT = {timestep_s}  # gs.options.SimOptions(dt=DT)

def rigid_options():  # gs.Scene(rigid_options=rigid_options(), ...)
    return gs.options.RigidOptions(
        friction_cone=gs.friction_cone.{friction_cone},
        contact_resolution=gs.contact_resolution.{contact_resolution},
        impratio={impratio},
        enable_torsional_friction={turns},
        enable_rolling_friction={turns},
    )

def material():  # of both entities
    return gs.materials.Rigid(friction={friction}, friction_torsional={torsion_m}, friction_rolling={rolling_m})

def set_contact(scene):  # after scene.build()
    scene.rigid_solver.set_global_sol_params(({sol_params}))
"""

    friction: float = Field(default=1.0, ge=0.01, le=5.0)
    sol_params: tuple[float, float, float, float, float, float, float] = (
        0.01,
        1.0,
        0.9,
        0.95,
        0.001,
        0.5,
        2.0,
    )
    friction_cone: str
    contact_resolution: str
    impratio: float

    @model_validator(mode="before")
    @classmethod
    def _defaults_of_cone(cls, values: Any) -> Any:
        """With the elliptic cone, Genesis has other defaults for the resolution and the ratio of impedances."""
        if isinstance(values, dict) and values.get("friction_cone") == "elliptic":
            return {"contact_resolution": "signorini", "impratio": 100.0} | values
        return values

    @field_validator("sol_params")
    @classmethod
    def _possible(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        if not (value[0] > 0.0 and value[1] > 0.0):
            raise ValueError(
                "time constant and damping ratio must be positive: Genesis has no direct format"
            )
        if value[5:] != (0.5, 2.0):
            raise ValueError(
                "midpoint and power must be those of Genesis, 0.5 and 2: others are not measured"
            )
        return value

    @model_validator(mode="after")
    def _cone_fits(self) -> Self:
        if self.friction_cone == "pyramidal" and self.contact_resolution == "signorini":
            raise ValueError(
                "contact_resolution must be 'convex' with friction_cone 'pyramidal'"
            )
        return self

    @classmethod
    def aimed(cls, aim: Aim) -> Self:
        """Return a spring that rebounds as hard as steps resolve it, or the spring and damper that is asked for."""
        constants = None
        if aim.stiffness_n_per_m is not None:
            constants = _spring(aim, aim.stiffness_n_per_m)
        time_s, ratio, impedance = constants or _impact(aim)
        return cls.of(
            timestep_s=aim.timestep_s,
            friction=aim.friction,
            sol_params=(time_s, ratio, impedance, impedance, 0.001, 0.5, 2.0),
            friction_cone="elliptic",
            contact_resolution="signorini",
            impratio=100.0,
        )

    def texts(self) -> dict[str, str]:
        """Return the values of the template, of which Genesis needs to know whether a contact resists turning."""
        return super().texts() | {"turns": str(bool(self.torsion_m or self.rolling_m))}

    def further(self, mass_kg: float) -> Mapping[str, Any]:
        """Return the constants of sustained contacts, in double precision."""
        time_s, ratio, *impedance = self.sol_params[:5]
        return {
            "precision": 64,
            "tolerance": 1e-8,
            "sustained_timeconst_s": time_s,
            "sustained_dampratio": ratio,
            "sustained_impedance": tuple(impedance),
        }

    def constraint(self) -> MuJoCoContact:
        """Return MuJoCo's documented equation, from which Genesis's solver descends."""
        return MuJoCoContact(
            solref=self.sol_params[:2],
            solimp=self.sol_params[2:],
            solreffriction=(0.0, 0.0),
            friction=self.friction,
            impratio=self.impratio,
            is_elliptic=self.friction_cone == "elliptic",
            timestep_s=self.timestep_s,
        )


def _spring(aim: Aim, stiffness_n_per_m: float) -> tuple[float, float, float] | None:
    """Return time constant, damping ratio and impedance of a stiffness, or None if steps do not resolve it."""
    frequency = math.sqrt(
        (1.0 - SOFT_IMPEDANCE) * stiffness_n_per_m / (PLATE_CONTACTS * aim.mass_kg)
    )
    if frequency * aim.timestep_s > RESOLVED_RATE:
        return None
    ratio = 1.0 if aim.rebound is None else max(damping_ratio_of(aim.rebound), 1e-3)
    ratio = min(ratio, 1.0 / (LEAST_TIME_STEPS * aim.timestep_s * frequency))
    return 1.0 / (ratio * frequency), ratio, SOFT_IMPEDANCE


def _impact(aim: Aim) -> tuple[float, float, float]:
    """Return time constant, damping ratio and impedance of the hardest spring whose rebound scatters little."""
    step, target = aim.timestep_s, aim.rebound or 0.0
    found: list[tuple[float, float, float, float]] = []
    for steps in IMPACT_STEPS:
        frequency = math.pi / (steps * step)
        if found and steps * step > LONGEST_IMPACT_S:
            break
        impedance = _impedance(aim, frequency)
        ratio = _ratio(target, frequency, impedance, step)
        rebounds = _rebounds(ratio, frequency, impedance, step)
        miss = abs(sum(rebounds) / len(rebounds) - target)
        scatter = max(rebounds) - min(rebounds)
        fault = max(miss - NO_REBOUND, 0.0) + max(scatter - MOST_SCATTER, 0.0)
        found.append((fault, 1.0 / (ratio * frequency), ratio, impedance))
        if fault == 0.0:
            break
    return min(found)[1:]


def _impedance(aim: Aim, frequency: float) -> float:
    """Return the impedance of a rebounding contact: it carries weight at a depth that steps do not leave."""
    usual = SOFT_IMPEDANCE if aim.rebound else HARD_IMPEDANCE
    if (load := load_s2(aim)) is None:
        return usual
    least = SOFT_IMPEDANCE if aim.stiffness_n_per_m is not None else usual
    return min(max(1.0 - load * frequency**2, least), MOST_IMPEDANCE)


def _ratio(target: float, frequency: float, impedance: float, step: float) -> float:
    """Return the damping ratio with which the mean of rebounds is a restitution, or comes nearest to it."""
    greatest = 1.0 / (LEAST_TIME_STEPS * step * frequency)

    def excess(ratio: float) -> float:
        rebounds = _rebounds(ratio, frequency, impedance, step)
        return sum(rebounds) / len(rebounds) - target

    if excess(greatest) >= 0.0:
        return greatest
    if excess(LEAST_RATIO) <= 0.0:
        return LEAST_RATIO
    return float(brentq(excess, LEAST_RATIO, greatest, xtol=1e-5))


def _rebounds(
    ratio: float, frequency: float, impedance: float, step: float
) -> tuple[float, ...]:
    contact = MuJoCoContact(
        solref=(1.0 / (ratio * frequency), ratio),
        solimp=(impedance, impedance, 0.001, 0.5, 2.0),
        solreffriction=(0.0, 0.0),
        friction=1.0,
        impratio=1.0,
        is_elliptic=True,
        timestep_s=step,
    )
    return contact.rebounds(drop_m=DROP_M, phase_count=PHASES)
