"""Contact settings of Newton's MuJoCo solver."""

from __future__ import annotations

import math
from typing import Any, ClassVar, Literal, Self

from pydantic import Field, field_validator, model_validator

from gauge_envs.scene import ContactMode
from gauge_envs.tools.recipes.aim import Aim
from gauge_envs.tools.recipes.engines.base import ContactSettings, numbers_text
from gauge_envs.tools.recipes.engines.mujoco import MuJoCoSettings, contact_of
from gauge_envs.tools.recipes.probes import Build


class NewtonSettings(ContactSettings):
    """Settings of SolverMuJoCo, and material of the shape that has priority.

    `ke` and `kd` may stand for `solref`: Newton's solver turns them into the time constant 2 / kd and the damping ratio
    kd / (2 sqrt(ke)).

    Attributes:
        integrator: Integrator.
        cone: Friction cone.
        impratio: Ratio of frictional to normal impedance.
        iterations: Iterations of the solver.
        ls_iterations: Iterations of a line search.
        mu: Coefficient of friction.
        kf: Friction gain [N s/m]; negative for friction with the damping of the contact.
        solref: Time constant [s] and damping ratio; or the negative stiffness [1/s^2] and damping [1/s] per mass.
        solimp: Impedance: d0, dwidth, width [m], midpoint, power.
    """

    engine: ClassVar[str] = "newton"
    is_soft: ClassVar[bool] = True
    also: ClassVar[tuple[str, ...]] = ("ke", "kd")

    integrator: Literal["euler", "implicitfast"] = "euler"
    cone: Literal["pyramidal", "elliptic"] = "pyramidal"
    impratio: float = Field(default=1.0, gt=0.0)
    iterations: int = Field(default=100, ge=1)
    ls_iterations: int = Field(default=50, ge=1)
    mu: float = Field(default=1.0, gt=0.0)
    kf: float = 1000.0
    solref: tuple[float, float] = (0.02, 1.0)
    solimp: tuple[float, float, float, float, float] = (0.9, 0.95, 0.001, 0.5, 2.0)

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
        return values | {"solref": (2.0 / damping, damping / (2.0 * math.sqrt(stiffness)))}

    @field_validator("solimp", mode="before")
    @classmethod
    def _with_shape(cls, value: Any) -> Any:
        return (*value, 0.5, 2.0)[:5] if isinstance(value, list | tuple) and len(value) == 3 else value

    @classmethod
    def aimed(cls, aim: Aim) -> Self:
        """Return MuJoCo's settings, with the friction gain that stops the tangential motion of a one-step impact."""
        contact = contact_of(aim)
        gain = -1.0
        if any(tangential := contact.pop("solreffriction", (0.0, 0.0))):
            width = contact["solimp"][1]
            share = (1.0 - width) / contact["impratio"] + width
            gain = -tangential[1] * width * aim.mass_kg / share
        return cls(
            timestep_s=aim.timestep_s,
            integrator="implicitfast",
            cone="elliptic",
            mu=aim.friction,
            kf=gain,
            **contact,
        )

    @property
    def sliding_friction(self) -> float:
        """Coefficient of friction of the pair."""
        return self.mu

    def build(self, mass_kg: float) -> Build:
        """Return SolverMuJoCo with contacts of Newton's collision pipeline."""
        given = {
            "preset": "rigid",
            "integrator": self.integrator,
            "cone": self.cone,
            "impratio": self.impratio,
            "iterations": self.iterations,
            "line_search_iterations": self.ls_iterations,
            "contact_solref": self.solref,
            "contact_solimp": self.solimp,
            "contact_kf_n_s_per_m": self.kf,
        }
        return Build(friction=self.mu, restitution=0.0, mode=ContactMode.SUSTAINED, settings=given)

    def snippet(self, mass_kg: float) -> str:
        """Return Python for Newton; the attributes need `SolverMuJoCo.register_custom_attributes(builder)`."""
        return (
            "import newton\n"
            "import warp as wp\n\n"
            "# newton.solvers.SolverMuJoCo.register_custom_attributes(builder) comes before the shapes.\n"
            "config = newton.ModelBuilder.ShapeConfig(\n"
            f"    mu={self.mu:g}, kf={self.kf:g}, mu_torsional=0.0, mu_rolling=0.0, gap=0.002\n"
            ")\n"
            "attributes = {  # of the foot's shapes: add_shape_box(..., cfg=config, custom_attributes=attributes)\n"
            '    "mujoco:condim": 3,\n'
            '    "mujoco:geom_priority": 1,\n'
            '    "mujoco:solref_mode": 1,  # solref as given\n'
            f'    "mujoco:solref": wp.vec2({numbers_text(self.solref).replace(" ", ", ")}),\n'
            '    "mujoco:geom_solimp": wp.types.vector(5, wp.float32)'
            f"({numbers_text(self.solimp).replace(' ', ', ')}),\n"
            "}\n"
            "options = dict(  # SolverMuJoCo(model, **options), which takes contacts from newton.CollisionPipeline\n"
            f'    solver="newton", integrator="{self.integrator}", cone="{self.cone}", impratio={self.impratio:g},\n'
            f"    iterations={self.iterations}, ls_iterations={self.ls_iterations}, tolerance=1e-8, "
            "use_mujoco_contacts=False,\n"
            ")\n"
            f"timestep = {self.timestep_s:.9g}\n"
        )

    @classmethod
    def limits(cls, quantity: str) -> str:
        """Return what the contact equation limits, which is MuJoCo's."""
        if quantity == "restitution":
            return (
                "Newton's restitution has no effect in its MuJoCo solver: a rebound is the damping of a contact "
                "equation that is evaluated once a step"
            )
        return MuJoCoSettings.limits(quantity).replace("MuJoCo's", "the MuJoCo solver's")
