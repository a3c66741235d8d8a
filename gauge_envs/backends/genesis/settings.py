"""Numerical settings of the Genesis backend, and the presets of rigid scenes."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from gauge_envs.backends.settings import SteppedSettings


class SettingsGenesis(SteppedSettings):
    """Settings of a Genesis scene and of its rigid solver. Solvers of deformable bodies have subclasses.

    Attributes:
        precision: Bits of floating-point numbers. Genesis has one precision per process.
        integrator: Integrator of rigid bodies, under Genesis's name.
        constraint_solver: Constraint solver.
        iterations: Maximum number of iterations of the constraint solver.
        tolerance: Residual at which the constraint solver stops.
        line_search_iterations: Maximum number of iterations of each line search.
        line_search_tolerance: Tolerance of the line search.
        noslip_iterations: Iterations of the no-slip solver, for the pyramidal cone; 0 disables it.
        friction_cone: `elliptic`, the exact cone, or `pyramidal`.
        contact_resolution: `signorini` bounds friction by the normal force; `convex` lets sliding raise that force.
            The pyramidal cone needs `convex`.
        impratio: Ratio of frictional to normal constraint impedance. Scenes whose contacts all lack friction have 1e-9:
            Genesis has no contact without friction, and friction is then too soft to act.
        pruning_tolerance: Share of a contact patch by which points may be left out; None keeps all points.
        multi_contact: Find several contact points of a pair of convex shapes.
        box_box_detection: Use Genesis's own detection of contacts between boxes.
        gjk: Detect contacts of convex shapes with GJK instead of MPR.
        sustained_timeconst_s: Time constant of sustained contacts [s], at least two steps.
        sustained_dampratio: Damping ratio of sustained contacts.
        sustained_impedance: Impedance of sustained contacts: least, greatest, width [m].
        impact_steps: Steps that half a period of the spring of an impact lasts. None gives impacts the constants of
            sustained contacts, so that they have no restitution.
        impact_speed_m_per_s: Speed at which impacts have their restitution under gravity; slower ones have less. None
            gives the fastest fall, start or driver of the scene, to two digits.
        impact_impedance: Impedance of impacts, constant in depth; Genesis takes 0.0001 to 0.9999.
        kinematic_mass_kg: Mass of a driven body, so large that contacts do not slow it between two drives.
        hinge_armature_kg_m2: Rotor inertia of each hinge; Genesis gives 0.1 to hinges that state none.
        tether_rate: Natural frequency of a taut string times the step; a string is a spring with critical damping.
    """

    precision: Literal[32, 64] = 64
    integrator: Literal["approximate_implicitfast", "implicitfast", "Euler"] = "approximate_implicitfast"
    constraint_solver: Literal["Newton", "CG"] = "Newton"
    iterations: int = Field(default=100, ge=1)
    tolerance: float = Field(default=1e-10, gt=0.0)
    line_search_iterations: int = Field(default=50, ge=1)
    line_search_tolerance: float = Field(default=1e-2, gt=0.0)
    noslip_iterations: int = Field(default=0, ge=0)
    friction_cone: Literal["elliptic", "pyramidal"] = "elliptic"
    contact_resolution: Literal["signorini", "convex"] = "signorini"
    impratio: float = Field(default=100.0, gt=0.0)
    pruning_tolerance: float | None = Field(default=None, gt=0.0)
    multi_contact: bool = True
    box_box_detection: bool = False
    gjk: bool = False
    sustained_timeconst_s: float = Field(default=0.002, gt=0.0)
    sustained_dampratio: float = Field(default=1.0, gt=0.0)
    sustained_impedance: tuple[float, float, float] = (0.95, 0.95, 0.001)
    impact_steps: int | None = Field(default=40, ge=6)
    impact_speed_m_per_s: float | None = Field(default=None, gt=0.0)
    impact_impedance: float = Field(default=0.9999, ge=1e-4, le=0.9999)
    kinematic_mass_kg: float = Field(default=1e3, gt=0.0)
    hinge_armature_kg_m2: float = Field(default=0.0, ge=0.0)
    tether_rate: float = Field(default=0.5, gt=0.0, le=1.0)

    @model_validator(mode="after")
    def _cone_fits(self) -> SettingsGenesis:
        if self.friction_cone == "pyramidal" and self.contact_resolution == "signorini":
            raise ValueError("contact_resolution must be 'convex' with friction_cone 'pyramidal'")
        if self.friction_cone == "elliptic" and self.noslip_iterations:
            raise ValueError("noslip_iterations must be 0 with friction_cone 'elliptic'")
        if self.constraint_solver == "CG" and self.contact_resolution == "signorini":
            raise ValueError("contact_resolution must be 'convex' with constraint_solver 'CG'")
        return self


OUT_OF_BOX = SettingsGenesis(
    preset="out_of_box",
    timestep_s=1 / 180,
    precision=32,
    iterations=25,
    # Genesis's `tolerance=None` stands for this in single precision; with MuJoCo compatibility it is ten times larger.
    tolerance=1e-6,
    friction_cone="pyramidal",
    contact_resolution="convex",
    impratio=1.0,
    pruning_tolerance=0.02,
    # Twice the step: Genesis raises its default of 0.01 s to it.
    sustained_timeconst_s=2 / 180,
    sustained_impedance=(0.9, 0.95, 0.001),
    impact_steps=None,
    hinge_armature_kg_m2=0.1,
)

PRESETS: dict[str, SettingsGenesis] = {
    "default": SettingsGenesis(preset="default", timestep_s=1 / 9000),
    # Impacts alone: a rebound depends on the moment within a step at which it starts. Of 0.2, it is within 0.0045 with
    # 100 steps of contact, which last 3 ms here.
    "impact": SettingsGenesis(preset="impact", timestep_s=1 / 36000, impact_steps=100),
    "impact_chain": SettingsGenesis(preset="impact_chain", timestep_s=1 / 9000),
    "contact_free": SettingsGenesis(preset="contact_free", timestep_s=1 / 1800),
    # Many resting contacts: a step of a wall of 118 bricks takes 15 ms with the pyramidal cone, and 86 ms with
    # Signorini contacts. The wall sinks by 0.4 mm then, and by 0.2 mm with them.
    "stack": SettingsGenesis(
        preset="stack",
        timestep_s=1 / 900,
        iterations=25,
        tolerance=1e-6,
        friction_cone="pyramidal",
        contact_resolution="convex",
        impratio=1.0,
        pruning_tolerance=0.02,
        sustained_timeconst_s=0.005,
    ),
    # Genesis's defaults at the rate of the paper's rigid runs; only masses, shapes and friction come from the scene.
    "out_of_box": OUT_OF_BOX,
    # The paper states 180 Hz, and that all settings but the physical parameters are defaults.
    "paper": OUT_OF_BOX.model_copy(update={"preset": "paper"}),
}
