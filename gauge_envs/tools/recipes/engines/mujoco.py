"""MuJoCo's contact settings, and those of the engines that run its equations."""

import math
from typing import Any, ClassVar, Self

from pydantic import Field, field_validator

from gauge_envs.backends.mujoco.settings import PRESETS
from gauge_envs.backends.shared.spring_damper import damping_ratio_of
from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.recipes.aim import Aim
from gauge_envs.tools.recipes.closed_forms import MuJoCoContact, Solimp
from gauge_envs.tools.recipes.engines.base import ContactSettings, stated_by
from gauge_envs.tools.recipes.probes import PLATE_CONTACTS

SETTLE_S = 0.2
"""Time constant with which a resting body of a one-step impact returns to its depth [s], where the step allows it."""

MOST_STIFFNESS = 0.02
"""Largest dimensionless stiffness of a one-step impact. It scatters the restitution by as much between phases."""

LEAST_IMPEDANCE, MOST_IMPEDANCE = 1e-4, 0.9999
"""Range of the impedance, and of its midpoint: MuJoCo's own limits, mjMINIMP and mjMAXIMP."""

TANGENTIAL_SHARES = ((0.7, 0.2), (1.0, 0.3))
"""Share of the sliding speed that friction of a one-step impact takes in a step, below Coulomb's limit, for
restitutions up to a value.

The elliptic cone solves friction and normal force together: the more of the speed friction is to take, the more it
lifts a sliding body. With friction 0.4, restitution 0.6 and a step of 5 ms a plate hops by 14 mm at a share of 1, by
0.8 mm at 0.2 and by 0.1 mm at 0.05, where friction is 5 % too low. A smaller share also creeps more, and takes less
speed and spin in an oblique impact.
"""

SOFT_IMPEDANCE = 0.5
"""Impedance of a contact with a given stiffness. Slides are within 0.3 % of Coulomb's law; with 0.1 they are 5 to 10 %
off at some steps, as softness also acts on friction."""

SOFT_IMPRATIO = 100.0
"""Ratio of frictional to normal impedance of such a contact, which creeps ten times slower than with 10."""

RESOLVED_RATE = 0.3
"""Largest natural frequency times the step of a contact that is a spring; its impact then lasts ten steps."""

DEFAULT_TIME_S = 0.02
"""MuJoCo's default time constant [s]. Bodies on much shorter ones hop while they slide."""

STEPS = 10.0
"""Fewest steps of a time constant whose damping is kept in the tangential directions: a plate at 4 m/s hops by 4 mm."""

MARGIN = 0.8
"""Share of the allowed depth that settings aim at."""


class ConstraintSettings(ContactSettings):
    """Settings of an engine with MuJoCo's contact constraint, in which three numbers may stand for five."""

    @field_validator("solimp", mode="before", check_fields=False)
    @classmethod
    def _with_shape(cls, value: Any) -> Any:
        return (
            (*value, 0.5, 2.0)[:5]
            if isinstance(value, list | tuple) and len(value) == 3
            else value
        )

    def texts(self) -> dict[str, str]:
        """Return the values of the fields, with the dimension of contacts."""
        return super().texts() | {
            "condim": "6" if self.rolling_m else "4" if self.torsion_m else "3"
        }


@stated_by(PRESETS["out_of_box"])
class MuJoCoSettings(ConstraintSettings):
    """Options of MuJoCo and constants of one pair of geoms.

    Attributes:
        friction: Sliding coefficient of the pair.
        solreffriction: As `solref` in the tangential directions; zeros stand for `solref`.
    """

    engine: ClassVar[str] = "mujoco"
    is_soft: ClassVar[bool] = True
    limits: ClassVar[dict[str, str]] = {
        "restitution": "MuJoCo has no coefficient of restitution: a rebound is the damping of a contact equation that "
        "is evaluated once a step",
        "friction": "MuJoCo's friction and normal force are solved together as one soft constraint",
        "penetration_m": "MuJoCo's contact is soft: its depth at rest is (1 - d) g / (d k) on one contact, and its "
        "impedance d is at most 0.9999",
    }
    template: ClassVar[str] = """\
<option timestep="{timestep_s}" integrator="{integrator}" cone="{cone}" impratio="{impratio}"/>
<contact>
  <pair geom1="foot" geom2="floor" condim="{condim}"
        friction="{friction} {friction} {torsion_m} {rolling_m} {rolling_m}"
        solref="{solref}" solimp="{solimp}"{tangential}/>
</contact>
"""
    separator: ClassVar[str] = " "
    comment: ClassVar[str] = "<!-- {} -->"

    integrator: str
    cone: str
    impratio: float
    friction: float = Field(default=1.0, gt=0.0)
    solref: tuple[float, float]
    solreffriction: tuple[float, float] = (0.0, 0.0)
    solimp: Solimp

    @field_validator("friction", mode="before")
    @classmethod
    def _sliding(cls, value: Any) -> Any:
        """MJCF states up to five coefficients, of which the first one is that of sliding."""
        return value[0] if isinstance(value, list | tuple) and value else value

    @classmethod
    def aimed(cls, aim: Aim) -> Self:
        """Return one of three kinds: hard without rebound, one step that reverses the speed, spring and damper."""
        return cls.of(
            timestep_s=aim.timestep_s,
            integrator="implicitfast",
            cone="elliptic",
            friction=aim.friction,
            **contact_of(aim),
        )

    def texts(self) -> dict[str, str]:
        """Return the values of the fields, with the attribute of the tangential directions where it is needed."""
        texts = super().texts()
        tangential = (
            f'\n        solreffriction="{texts["solreffriction"]}"'
            if any(self.solreffriction)
            else ""
        )
        return texts | {"tangential": tangential}

    def constraint(self) -> MuJoCoContact:
        """Return MuJoCo's documented equation."""
        return MuJoCoContact(
            solref=self.solref,
            solimp=_in_force(self.solimp),
            solreffriction=self.solreffriction,
            friction=self.friction,
            impratio=self.impratio,
            is_elliptic=self.cone == "elliptic",
            timestep_s=self.timestep_s,
        )


def _in_force(solimp: Solimp) -> Solimp:
    """Return the impedance that MuJoCo makes of a stated one: function getsolparam in engine_core_constraint.c."""
    d0, dwidth, width_m, midpoint, power = solimp
    d0, dwidth, midpoint = (
        min(max(one, LEAST_IMPEDANCE), MOST_IMPEDANCE) for one in (d0, dwidth, midpoint)
    )
    return d0, dwidth, max(width_m, 0.0), midpoint, max(power, 1.0)


def contact_of(aim: Aim) -> dict[str, Any]:
    """Return `solref`, `solreffriction`, `solimp` and `impratio` for an aim."""
    if aim.stiffness_n_per_m is not None:
        per_mass = (
            (1.0 - SOFT_IMPEDANCE)
            * aim.stiffness_n_per_m
            / (PLATE_CONTACTS * aim.mass_kg)
        )
        if math.sqrt(per_mass) * aim.timestep_s <= RESOLVED_RATE:
            return _spring(aim, per_mass)
    if aim.rebound is None or aim.rebound <= 0.0:
        return _hard(aim)
    return _one_step(aim, aim.rebound)


def load_s2(aim: Aim) -> float | None:
    """Return the depth that settings aim at times the number of contacts, over gravity [s^2]; None without a depth."""
    depth_m = aim.aimed_depth_m(MARGIN)
    return None if depth_m is None else depth_m * PLATE_CONTACTS / GRAVITY_M_PER_S2


def _impedance(aim: Aim, usual: float, exact: float) -> float:
    """Return the impedance for a depth: that of a stiffness, and at least the usual one for an allowed depth."""
    least = usual if aim.stiffness_n_per_m is None else SOFT_IMPEDANCE
    return min(max(least, exact), MOST_IMPEDANCE)


def _hard(aim: Aim) -> dict[str, Any]:
    """Return a critically damped contact with MuJoCo's time constant, and an impedance for the depth.

    At long steps its damping would take the sliding speed in a step or two, and what slides at 4 m/s would hop by
    58 mm. Less damping in the tangential directions hops by 3 mm; `impratio` makes up for the creep.
    """
    time_s, impedance = max(DEFAULT_TIME_S, 2.0 * aim.timestep_s), 0.95
    if (load := load_s2(aim)) is not None:
        # On n contacts the depth is (1 - d) g T^2 / n for a constant impedance d.
        impedance = _impedance(aim, impedance, 1.0 - load / time_s**2)
    contact = {
        "solref": (time_s, 1.0),
        "solimp": (impedance, impedance, 0.001, 0.5, 2.0),
        "impratio": 10.0,
    }
    if (shorter := STEPS * aim.timestep_s / time_s) > 1.0:
        contact["solreffriction"] = (0.0, -2.0 / (STEPS * aim.timestep_s))
        contact["impratio"] = 10.0 * shorter
    return contact


def _one_step(aim: Aim, restitution: float) -> dict[str, Any]:
    """Return a contact that turns the speed v into -e v in one step, as the MuJoCo backend's impacts."""
    step = aim.timestep_s
    stiffness = min(step * (1.0 + restitution) / SETTLE_S, MOST_STIFFNESS) / step**2
    impedance = 0.99
    if (load := load_s2(aim)) is not None:
        impedance = _impedance(aim, impedance, 1.0 / (1.0 + load * stiffness))
    return {
        "solref": (-stiffness, -(1.0 + restitution) / step),
        # The same damping would reverse the tangential velocity too.
        "solreffriction": (
            0.0,
            -next(share for limit, share in TANGENTIAL_SHARES if restitution <= limit)
            / step,
        ),
        "solimp": (impedance, impedance, 0.001, 0.5, 2.0),
        "impratio": 10.0,
    }


def _spring(aim: Aim, per_mass: float) -> dict[str, Any]:
    """Return a spring and damper of a stiffness per mass [1/s^2], which many steps resolve."""
    d = SOFT_IMPEDANCE
    ratio = 1.0 if aim.rebound is None else damping_ratio_of(aim.rebound)
    # More damping than stops the body in a step turns into a rebound.
    damping = min(2.0 * ratio * math.sqrt(per_mass), 1.0 / aim.timestep_s)
    return {
        "solref": (-per_mass, -damping),
        "solimp": (d, d, 0.001, 0.5, 2.0),
        "impratio": SOFT_IMPRATIO,
    }
