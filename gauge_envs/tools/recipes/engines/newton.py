"""Contact settings of Newton's MuJoCo solver."""

from __future__ import annotations

import math
from typing import Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from gauge_envs.backends.newton.settings import PRESETS
from gauge_envs.tools.recipes.aim import Aim
from gauge_envs.tools.recipes.closed_forms import Solimp
from gauge_envs.tools.recipes.engines.base import stated_by
from gauge_envs.tools.recipes.engines.mujoco import (
    ConstraintSettings,
    MuJoCoSettings,
    contact_of,
)


@stated_by(PRESETS["out_of_box"])
class NewtonSettings(ConstraintSettings):
    """Settings of SolverMuJoCo, and material of the shape that has priority.

    `ke` and `kd` may stand for `solref`: Newton's solver turns them into the time constant 2 / kd and the damping ratio
    kd / (2 sqrt(ke)).

    Attributes:
        mu: Coefficient of friction.
        kf: Friction gain [N s/m]; negative for friction with the damping of the contact.
        solref: Time constant [s] and damping ratio; or the negative stiffness [1/s^2] and damping [1/s] per mass.
        solimp: Impedance: d0, dwidth, width [m], midpoint, power.
    """

    engine: ClassVar[str] = "newton"
    is_soft: ClassVar[bool] = True
    also: ClassVar[tuple[str, ...]] = ("ke", "kd")
    friction_field: ClassVar[str] = "mu"
    preset: ClassVar[str] = "rigid"
    limits: ClassVar[dict[str, str]] = {
        name: text.replace("MuJoCo's", "the MuJoCo solver's")
        for name, text in MuJoCoSettings.limits.items()
    } | {
        "restitution": "Newton's restitution has no effect in its MuJoCo solver: a rebound is the damping of a contact "
        "equation that is evaluated once a step"
    }
    template: ClassVar[str] = """\
import newton
import warp as wp

# newton.solvers.SolverMuJoCo.register_custom_attributes(builder) comes before the shapes.
config = newton.ModelBuilder.ShapeConfig(
    mu={mu}, kf={kf}, mu_torsional={torsion_m}, mu_rolling={rolling_m}, gap=0.002
)
attributes = {{  # of the foot's shapes: add_shape_box(..., cfg=config, custom_attributes=attributes)
    "mujoco:condim": {condim},
    "mujoco:geom_priority": 1,
    "mujoco:solref_mode": 1,  # solref as given
    "mujoco:solref": wp.vec2({solref}),
    "mujoco:geom_solimp": wp.types.vector(5, wp.float32)({solimp}),
}}
options = dict(  # SolverMuJoCo(model, **options), which takes contacts from newton.CollisionPipeline
    solver="newton", integrator="{integrator}", cone="{cone}", impratio={impratio},
    iterations={iterations}, ls_iterations={ls_iterations}, tolerance=1e-6, use_mujoco_contacts=False,
)
timestep = {timestep_s}
"""

    integrator: Literal["euler", "implicitfast"] = "euler"
    cone: str
    impratio: float
    iterations: int
    ls_iterations: int
    mu: float = Field(default=1.0, gt=0.0)
    kf: float = 1000.0
    solref: tuple[float, float] = (0.02, 1.0)
    solimp: Solimp = (0.9, 0.95, 0.001, 0.5, 2.0)

    @model_validator(mode="before")
    @classmethod
    def _from_material(cls, data: Any) -> Any:
        if not isinstance(data, dict) or not {"ke", "kd"} & set(data):
            return data
        if "solref" in data or not {"ke", "kd"} <= set(data):
            raise ValueError("ke and kd go together, and without solref")
        values = {key: value for key, value in data.items() if key not in ("ke", "kd")}
        stiffness, damping = float(data["ke"]), float(data["kd"])
        if stiffness <= 0.0 or damping <= 0.0:
            raise ValueError("ke and kd must be positive")
        return values | {
            "solref": (2.0 / damping, damping / (2.0 * math.sqrt(stiffness)))
        }

    @classmethod
    def aimed(cls, aim: Aim) -> Self:
        """Return MuJoCo's settings, with the friction gain that stops the tangential motion of a one-step impact."""
        contact = contact_of(aim)
        gain = -1.0
        if any(tangential := contact.pop("solreffriction", (0.0, 0.0))):
            width = contact["solimp"][1]
            share = (1.0 - width) / contact["impratio"] + width
            gain = -tangential[1] * width * aim.mass_kg / share
        return cls.of(
            timestep_s=aim.timestep_s,
            integrator="implicitfast",
            cone="elliptic",
            mu=aim.friction,
            kf=gain,
            **contact,
        )
