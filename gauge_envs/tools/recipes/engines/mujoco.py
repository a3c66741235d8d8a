"""MuJoCo's contact settings, and those of the engines that run its equations."""

import math
from collections.abc import Callable
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Field

from gauge_envs.backends.mujoco.settings import SolImp, SolRef
from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.recipes.aim import Aim
from gauge_envs.tools.recipes.engines.base import ContactSettings, numbers
from gauge_envs.tools.recipes.probes import PLATE_CONTACTS

SETTLE_S = 0.2
"""Time constant with which a resting body of a one-step impact returns to its depth [s], where the step allows it."""

MAX_STIFFNESS = 0.02
"""Largest dimensionless stiffness of a one-step impact. It scatters the restitution by as much between phases."""

MAX_IMPEDANCE = 0.9999
"""MuJoCo's limit of the impedance, mjMAXIMP."""

TANGENTIAL_SHARE, BOUNCY_TANGENTIAL_SHARE = 0.2, 0.3
"""Share of the sliding speed that friction of a one-step impact takes in a step, below Coulomb's limit; and that of
bouncy contacts.

The elliptic cone solves friction and normal force together: the more of the speed friction is to take, the more it
lifts a sliding body. With friction 0.4, restitution 0.6 and a step of 5 ms a plate hops by 14 mm at a share of 1, by
0.8 mm at 0.2 and by 0.1 mm at 0.05, where friction is 5 % too low. A smaller share also creeps more, and takes less
speed and spin in an oblique impact.
"""

BOUNCY_RESTITUTION = 0.7
"""Restitution above which a contact is bouncy."""

SOFT_IMPEDANCE = 0.5
"""Impedance of a contact with a given stiffness. Slides are within 0.3 % of Coulomb's law; with 0.1 they are 5 to 10 %
off at some steps, as softness also acts on friction."""

SOFT_IMPRATIO = 100.0
"""Ratio of frictional to normal impedance of such a contact, which creeps ten times slower than with 10."""

RESOLVED_RATE = 0.3
"""Largest natural frequency times the step of a contact that is a spring; its impact then lasts ten steps."""

DEFAULT_TIME_S = 0.02
"""MuJoCo's default time constant [s]. Bodies on much shorter ones hop while they slide."""

DAMPED_STEPS = 10.0
"""Fewest steps of a time constant whose damping is kept in the tangential directions: a plate at 4 m/s hops by 4 mm."""

DEFAULT_SOLIMP = (0.9, 0.95, 0.001, 0.5, 2.0)
"""MuJoCo's impedance."""

MARGIN = 0.8
"""Share of the allowed depth that settings aim at."""


def _with_shape(solimp: Any) -> Any:
    """Return an impedance with MuJoCo's default for what MJCF leaves out."""
    is_single = isinstance(solimp, str)
    return solimp if is_single else (*solimp, *DEFAULT_SOLIMP[len(solimp) :])


def _first(coefficients: Any) -> Any:
    """Return the coefficient of sliding, which is the first of up to five in MJCF."""
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
        "restitution": "MuJoCo has no coefficient of restitution: a contact equation that is evaluated once a step "
        "determines the rebound by its damping",
        "friction": "MuJoCo solves friction and normal force together as one soft constraint",
        "penetration_m": "MuJoCo's contact is soft: its depth at rest is (1 - d) g / (d k) on one contact, and its "
        "impedance d is at most 0.9999",
    }

    integrator: str
    cone: Literal["pyramidal", "elliptic"] = "pyramidal"
    impratio: float = Field(default=1.0, gt=0.0)
    solref: SolRef = (0.02, 1.0)
    solimp: Annotated[SolImp, BeforeValidator(_with_shape)] = DEFAULT_SOLIMP

    @property
    def condim(self) -> int:
        """MuJoCo's dimension of contacts that resist what the settings resist."""
        if self.rolling_m:
            return 6
        return 4 if self.torsion_m else 3


class MuJoCoSettings(ConstraintSettings):
    """Options of MuJoCo and constants of one pair of geoms.

    Attributes:
        friction: Sliding coefficient of the pair.
        solreffriction: As `solref` in the tangential directions; zeros stand for `solref`.
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
        """Return one of three kinds: hard without rebound, one step that reverses the speed, spring and damper."""
        return contact_of(aim)

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
        contact = _one_step(aim, aim.rebound)
    else:
        contact = _hard(aim)
    return {"integrator": "implicitfast", "cone": "elliptic", **contact}


def spring_frequency_per_s(aim: Aim) -> float | None:
    """Return the natural frequency of a contact with a stiffness [1/s]; None without one that steps resolve."""
    if aim.stiffness_n_per_m is None:
        return None
    stiffness_n_per_m = (1.0 - SOFT_IMPEDANCE) * aim.stiffness_n_per_m / PLATE_CONTACTS
    frequency_per_s = math.sqrt(stiffness_n_per_m / aim.mass_kg)
    is_resolved = frequency_per_s * aim.timestep_s <= RESOLVED_RATE
    return frequency_per_s if is_resolved else None


def impedance_of(aim: Aim, usual: float, exact: Callable[[float], float]) -> float:
    """Return the impedance for the depth of an aim: that of a stiffness, and at least the usual one for an allowed one.

    Args:
        aim: The aim.
        usual: Impedance without a depth.
        exact: Impedance for the depth at rest times the number of contacts, over gravity [s^2].
    """
    depth_m = aim.depth_m(MARGIN)
    if depth_m is None:
        return usual
    smallest = usual if aim.stiffness_n_per_m is None else SOFT_IMPEDANCE
    load_s2 = depth_m * PLATE_CONTACTS / GRAVITY_M_PER_S2
    return min(max(smallest, exact(load_s2)), MAX_IMPEDANCE)


def _hard(aim: Aim) -> dict[str, Any]:
    """Return a critically damped contact with MuJoCo's time constant, and an impedance for the depth.

    At long steps its damping would take the sliding speed in a step or two, and what slides at 4 m/s would hop by
    58 mm. Less damping in the tangential directions hops by 3 mm; `impratio` makes up for the creep.
    """
    time_s = max(DEFAULT_TIME_S, 2.0 * aim.timestep_s)
    # On n contacts the depth is (1 - d) g T^2 / n for a constant impedance d.
    impedance = impedance_of(aim, 0.95, lambda load_s2: 1.0 - load_s2 / time_s**2)
    contact: dict[str, Any] = {
        "solref": (time_s, 1.0),
        "solimp": (impedance, impedance, 0.001),
        "impratio": 10.0,
    }
    damped_s = DAMPED_STEPS * aim.timestep_s
    if damped_s > time_s:
        contact["solreffriction"] = (0.0, -2.0 / damped_s)
        contact["impratio"] = 10.0 * damped_s / time_s
    return contact


def _one_step(aim: Aim, restitution: float) -> dict[str, Any]:
    """Return a contact that turns the speed v into -e v in one step, as the MuJoCo backend's impacts."""
    step_s = aim.timestep_s
    stiffness = min(step_s * (1.0 + restitution) / SETTLE_S, MAX_STIFFNESS)
    stiffness_per_s2 = stiffness / step_s**2
    # And (1 - d) g / (n d k) for a constant stiffness k.
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
    """Return a spring and damper of a natural frequency [1/s], which many steps resolve."""
    # More damping than stops the body in a step turns into a rebound.
    damping_per_s = min(2.0 * aim.damping_ratio * frequency_per_s, 1.0 / aim.timestep_s)
    return {
        "solref": (-(frequency_per_s**2), -damping_per_s),
        "solimp": (SOFT_IMPEDANCE, SOFT_IMPEDANCE, 0.001),
        "impratio": SOFT_IMPRATIO,
    }
