"""Contact settings of Newton's MuJoCo solver."""

from typing import Any, ClassVar, Literal

from pydantic import Field

from gauge_envs.tools.recipes.aim import Aim
from gauge_envs.tools.recipes.engines.base import numbers
from gauge_envs.tools.recipes.engines.mujoco import ConstraintSettings, contact_of


class NewtonSettings(ConstraintSettings):
    """Settings of SolverMuJoCo, and material of the shape with priority.

    Newton's solver turns `ke` and `kd` of shapes into the `solref` 2 / kd and kd / (2 sqrt(ke)).

    Attributes:
        mu: Coefficient of friction.
        kf: Friction gain [N s/m]; a negative value means the damping of the contact.
        solref: Time constant [s] and damping ratio; or the negative stiffness [1/s^2] and damping [1/s] per mass.
        solimp: Impedance: d0, dwidth, width [m], midpoint, power.
    """

    engine = "newton"
    friction_field = "mu"
    preset = "rigid"
    natives: ClassVar = ConstraintSettings.natives | {
        "iterations": "iterations",
        "ls_iterations": "line_search_iterations",
        "kf": "contact_kf_n_s_per_m",
    }
    limits: ClassVar = ConstraintSettings.limits | {
        "restitution": "Newton's restitution has no effect in its MuJoCo solver: the damping of a contact equation, "
        "evaluated once a step, determines the rebound"
    }

    integrator: Literal["euler", "implicitfast"] = "euler"
    iterations: int = 100
    ls_iterations: int = 50
    mu: float = Field(default=1.0, gt=0.0)
    kf: float = 1000.0

    @classmethod
    def constants(cls, aim: Aim) -> dict[str, Any]:
        """Return MuJoCo's settings, with a friction gain equal to their tangential damping."""
        contact = contact_of(aim)
        gain_n_s_per_m = -1.0
        if "solreffriction" in contact:
            _, damping_per_s = contact.pop("solreffriction")
            impedance = contact["solimp"][1]
            share = (1.0 - impedance) / contact["impratio"] + impedance
            gain_n_s_per_m = -damping_per_s * impedance * aim.mass_kg / share
        return {**contact, "kf": gain_n_s_per_m}

    def snippet(self) -> str:
        """Return Python for shapes, solver and step."""
        return f"""\
import newton
import warp as wp

# newton.solvers.SolverMuJoCo.register_custom_attributes(builder) comes before the shapes.
config = newton.ModelBuilder.ShapeConfig(
    mu={self.mu:g}, kf={self.kf:g}, mu_torsional={self.torsion_m:g}, mu_rolling={self.rolling_m:g}, gap=0.002
)
attributes = {{  # of the foot's shapes: add_shape_box(..., cfg=config, custom_attributes=attributes)
    "mujoco:condim": {self.condim},
    "mujoco:geom_priority": 1,
    "mujoco:solref_mode": 1,  # solref as given
    "mujoco:solref": wp.vec2({numbers(self.solref, ", ")}),
    "mujoco:geom_solimp": wp.types.vector(5, wp.float32)({numbers(self.solimp, ", ")}),
}}
options = dict(  # SolverMuJoCo(model, **options), which takes contacts from newton.CollisionPipeline
    solver="newton", integrator="{self.integrator}", cone="{self.cone}", impratio={self.impratio:g},
    iterations={self.iterations}, ls_iterations={self.ls_iterations}, tolerance=1e-6, use_mujoco_contacts=False,
)
timestep = {self.timestep_s:.9g}
"""
