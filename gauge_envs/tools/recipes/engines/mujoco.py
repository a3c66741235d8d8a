"""Contact settings of MuJoCo, and of engines that solve its equations."""

import math
from collections.abc import Callable
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import BeforeValidator, Field

from gauge_envs.backends.mujoco.settings import SolImp, SolRef
from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.scene.bodies import friction_dimension
from gauge_envs.tools.recipes.aim import Aim
from gauge_envs.tools.recipes.engines.base import ContactSettings, numbers, rounded

PLATE_CONTACTS = 4
"""Number of corners on which the plate of the probes rests."""

SETTLE_S = 0.2
"""Time constant for the return of a body to its depth at rest, after a one-step impact [s]."""

MAX_STIFFNESS = 0.02
"""Largest dimensionless stiffness of a one-step impact, equal to the scatter of the restitution between phases."""

MAX_IMPEDANCE = 0.9999
"""MuJoCo's limit of the impedance, mjMAXIMP."""

TANGENTIAL_SHARE, BOUNCY_TANGENTIAL_SHARE = 0.2, 0.3
"""Share of the sliding speed that friction of a one-step impact removes in a step, below Coulomb's limit.

The second value is for bouncy contacts. The elliptic cone solves friction and normal force together, so a larger share
lifts a sliding body more. A plate with friction 0.4, restitution 0.6 and a step of 5 ms hops by 14 mm at a share of 1,
and by 0.8 mm at 0.2. At 0.05 it hops by 0.1 mm, but friction is 5 % too low. A smaller share also creeps more, and
removes less speed and spin in an oblique impact.
"""

GRIPPING_SHARE = 0.95
"""Share with which impacts that should stop the slip follow Coulomb's law. Then a sliding body hops much higher."""

BOUNCY_RESTITUTION = 0.7
"""Restitution above which a contact is bouncy."""

SOFT_IMPEDANCE = 0.5
"""Impedance of a contact with a given stiffness. Slides are within 0.3 % of Coulomb's law. With 0.1, the error is 5 to
10 % at some steps, because softness also acts on friction."""

SOFT_IMPRATIO = 100.0
"""Ratio of frictional to normal impedance of such a contact; it creeps ten times slower than with 10."""

RESOLVED_RATE = 0.3
"""Largest natural frequency times the step of a spring contact; an impact then lasts ten steps."""

DEFAULT_TIME_S = 0.02
"""MuJoCo's default time constant [s]. With much shorter ones, sliding bodies hop."""

DAMPED_STEPS = 10.0
"""Minimum time constant [steps] for full tangential damping: a plate at 4 m/s then hops by 4 mm."""

DEFAULT_SOLIMP = (0.9, 0.95, 0.001, 0.5, 2.0)
"""MuJoCo's impedance."""

MARGIN = 0.8
"""Target depth, as a share of the allowed depth."""


SOFT_DEPTH = (
    "{}'s contact is soft: its depth at rest is (1 - d) g / (d k) on one contact, and its impedance d is at most "
    "0.9999"
)
"""Why an engine that solves MuJoCo's contact equation misses a depth."""


def _with_shape(solimp: Any) -> Any:
    """Return an impedance with MuJoCo's defaults for missing values."""
    is_single = isinstance(solimp, str)
    return solimp if is_single else (*solimp, *DEFAULT_SOLIMP[len(solimp) :])


def _first(coefficients: Any) -> Any:
    """Return the sliding coefficient, the first of up to five in MJCF."""
    return coefficients[0] if isinstance(coefficients, tuple) else coefficients


class ConstraintSettings(ContactSettings):
    """Settings of an engine that solves MuJoCo's contact equation.

    Attributes:
        solref: Time constant [s] and damping ratio; or the negative stiffness [1/s^2] and damping [1/s] per mass.
        solimp: Impedance: d0, dwidth, width [m], midpoint, power.
    """

    is_soft = True
    natives: ClassVar = {
        "integrator": "integrator",
        "cone": "cone",
        "impratio": "impratio",
        "solref": "contact_solref",
        "solimp": "contact_solimp",
    }
    limits: ClassVar = {
        "restitution": "MuJoCo has no coefficient of restitution: the damping of a contact equation, evaluated once "
        "a step, determines the rebound",
        "friction": "MuJoCo solves friction and normal force together as one soft constraint",
        "impact_friction": "MuJoCo's friction removes a share of the slip in each step, and an impact lasts a step",
        "slip_restitution": "MuJoCo's friction raises the normal force of a body that slips",
        "penetration_m": SOFT_DEPTH.format("MuJoCo"),
    }

    integrator: str
    cone: Literal["pyramidal", "elliptic"] = "pyramidal"
    impratio: float = Field(default=1.0, gt=0.0)
    solref: SolRef = (0.02, 1.0)
    solimp: Annotated[SolImp, BeforeValidator(_with_shape)] = DEFAULT_SOLIMP

    @property
    def condim(self) -> int:
        """MuJoCo's contact dimension for sliding, torsional and rolling friction of the settings."""
        return friction_dimension(self.torsion_m, self.rolling_m)


class MuJoCoSettings(ConstraintSettings):
    """Options of MuJoCo and constants of one pair of geoms.

    Attributes:
        friction: Sliding coefficient of the pair.
        solreffriction: Same as `solref` in the tangential directions; zeros mean `solref`.
    """

    engine = "mujoco"
    natives: ClassVar = ConstraintSettings.natives | {
        "solreffriction": "contact_solreffriction"
    }

    integrator: str = "Euler"
    friction: Annotated[float, BeforeValidator(_first)] = Field(default=1.0, gt=0.0)
    solreffriction: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def constants(cls, aim: Aim) -> dict[str, Any]:
        """Return a hard contact without rebound, a one-step impact, or a spring and damper."""
        return contact_of(aim)

    def gripping(self) -> Self | None:
        """Return the settings with a friction that stops the slip in a step; None if they have it already."""
        gripping = (0.0, rounded(-GRIPPING_SHARE / self.timestep_s))
        if self.solreffriction == gripping:
            return None
        return self.model_copy(update={"solreffriction": gripping})

    @property
    def gripping_text(self) -> str:
        """The tangential time constant in MJCF."""
        return f'solreffriction="{numbers(self.solreffriction)}"'

    def snippet(self) -> str:
        """Return options and a pair in MJCF."""
        impratio = f"{self.impratio:g}"
        friction = (self.friction, self.friction, self.torsion_m, self.rolling_m)
        tangential = ""
        if any(self.solreffriction):
            tangential = f'\n        solreffriction="{numbers(self.solreffriction)}"'
        return f"""\
<option timestep="{self.timestep_s:.9g}" integrator="{self.integrator}" cone="{self.cone}" impratio="{impratio}"/>
<contact>
  <pair geom1="foot" geom2="floor" condim="{self.condim}"
        friction="{numbers(friction)} {self.rolling_m:g}"
        solref="{numbers(self.solref)}" solimp="{numbers(self.solimp)}"{tangential}/>
</contact>
"""


def contact_of(aim: Aim) -> dict[str, Any]:
    """Return integrator, cone, `solref`, `solreffriction`, `solimp` and `impratio` for an aim."""
    frequency_per_s = spring_frequency_per_s(aim)
    if frequency_per_s is not None:
        contact = _spring(aim, frequency_per_s)
    elif aim.rebound:
        contact = _single_step(aim, aim.rebound)
    else:
        contact = _hard(aim)
    return {"integrator": "implicitfast", "cone": "elliptic", **contact}


def spring_frequency_per_s(aim: Aim) -> float | None:
    """Return the natural frequency of a contact [1/s]; None without a stiffness or if steps do not resolve it."""
    if aim.stiffness_n_per_m is None:
        return None
    stiffness_n_per_m = (1.0 - SOFT_IMPEDANCE) * aim.stiffness_n_per_m / PLATE_CONTACTS
    frequency_per_s = math.sqrt(stiffness_n_per_m / aim.mass_kg)
    is_resolved = frequency_per_s * aim.timestep_s <= RESOLVED_RATE
    return frequency_per_s if is_resolved else None


def impedance_of(aim: Aim, usual: float, exact: Callable[[float], float]) -> float:
    """Return the impedance for the depth of an aim; an allowed depth needs at least the usual impedance.

    Args:
        aim: The aim.
        usual: Impedance without a depth.
        exact: Function of (depth at rest) (number of contacts) / gravity [s^2] that returns the impedance.
    """
    depth_m = aim.depth_m(MARGIN)
    if depth_m is None:
        return usual
    smallest = usual if aim.stiffness_n_per_m is None else SOFT_IMPEDANCE
    load_s2 = depth_m * PLATE_CONTACTS / GRAVITY_M_PER_S2
    return min(max(smallest, exact(load_s2)), MAX_IMPEDANCE)


def _hard(aim: Aim) -> dict[str, Any]:
    """Return a critically damped contact with MuJoCo's time constant, and an impedance for the depth.

    At long steps, full damping would stop a sliding body in two steps, and a body at 4 m/s would hop by 58 mm. With
    less tangential damping, it hops by 3 mm; `impratio` compensates the creep.
    """
    time_s = max(DEFAULT_TIME_S, 2.0 * aim.timestep_s)
    # On n contacts the depth is (1 - d) g T^2 / n for a constant impedance d.
    impedance = impedance_of(aim, 0.95, lambda load_s2: 1.0 - load_s2 / time_s**2)
    contact = {
        "solref": (time_s, 1.0),
        "solimp": (impedance, impedance, 0.001),
        "impratio": 10.0,
    }
    damped_s = DAMPED_STEPS * aim.timestep_s
    if damped_s > time_s:
        contact["solreffriction"] = (0.0, -2.0 / damped_s)
        contact["impratio"] = 10.0 * damped_s / time_s
    return contact


def _single_step(aim: Aim, restitution: float) -> dict[str, Any]:
    """Return a contact that reverses the speed v to -e v in one step, as impacts of the MuJoCo backend."""
    step_s = aim.timestep_s
    stiffness = min(step_s * (1.0 + restitution) / SETTLE_S, MAX_STIFFNESS)
    stiffness_per_s2 = stiffness / step_s**2
    # The depth is (1 - d) g / (n d k) for a constant stiffness k.
    impedance = impedance_of(
        aim, 0.99, lambda load_s2: 1.0 / (1.0 + load_s2 * stiffness_per_s2)
    )
    # The same damping would reverse the tangential velocity too.
    is_bouncy = restitution > BOUNCY_RESTITUTION
    share = BOUNCY_TANGENTIAL_SHARE if is_bouncy else TANGENTIAL_SHARE
    return {
        "solref": (-stiffness_per_s2, -(1.0 + restitution) / step_s),
        "solreffriction": (0.0, -share / step_s),
        "solimp": (impedance, impedance, 0.001),
        "impratio": 10.0,
    }


def _spring(aim: Aim, frequency_per_s: float) -> dict[str, Any]:
    """Return a spring and damper with a natural frequency [1/s] that many steps resolve."""
    # Damping that more than stops the body in a step causes a rebound.
    damping_per_s = min(2.0 * aim.damping_ratio * frequency_per_s, 1.0 / aim.timestep_s)
    return {
        "solref": (-(frequency_per_s**2), -damping_per_s),
        "solimp": (SOFT_IMPEDANCE, SOFT_IMPEDANCE, 0.001),
        "impratio": SOFT_IMPRATIO,
    }
