"""Numerical settings of the MuJoCo backend: the presets, and which preset a scene gets.

A preset is picked from what the scene contains, never from how well it scores. What is engine default and what is
not, and why, stands beside each number.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import Field

from gauge_envs.backends.presets import SteppedSettings, resolve_settings
from gauge_envs.scene import Cloth, Rod, Scene, SoftBody

__all__ = ["PRESETS", "SettingsMuJoCo", "settings_for"]


class SettingsMuJoCo(SteppedSettings):
    """Settings of one simulation.

    Attributes:
        integrator: MuJoCo's name of the integrator.
        cone: Friction cone.
        impratio: Ratio of frictional to normal constraint impedance; above 1 it keeps resting bodies from creeping.
        solver: Constraint solver.
        iterations: Cap on solver iterations.
        tolerance: Solver tolerance.
        sustained_solref: Time constant [s] and damping ratio of sustained contacts.
        sustained_solimp: Impedance of sustained contacts: d0, dwidth, width [m].
        impact_stiffness: Dimensionless stiffness s of impacts; MuJoCo's direct solref is (-s/h^2, -(1+e)/h). It adds
            about s to the coefficient of restitution, and pushes resting bodies apart within h (1+e)/s seconds.
        impact_solimp: Impedance of impacts; constant in depth, since the rebound would depend on depth otherwise.
        kinematic_mass_kg: Mass of a driven body. Large enough that contacts do not slow it between two drives: 1 N
            moves 1000 kg by 0.02 micrometres in 1/180 s. Small enough for the solver: at 1e6 kg a cube on it creeps
            300 times faster.
        cloth_cell_m: Wanted edge length of a cloth's cells.
        cloth_fold_radius_m: Half the thickness with which a cloth that touches itself collides: about the way that it
            goes in one step, or layers pass through each other. Other cloth collides with its physical thickness.
        cloth_solref: Time constant [s] and damping ratio of a cloth's contacts.
        cloth_solimp: Impedance of a cloth's contacts. Stiffer ones bounce light cloth, softer ones let bodies sink in.
    """

    integrator: Literal["Euler", "RK4", "implicit", "implicitfast", "discrete"] = "implicitfast"
    cone: Literal["pyramidal", "elliptic"] = "elliptic"
    impratio: float = Field(default=10.0, gt=0.0)
    solver: Literal["PGS", "CG", "Newton"] = "Newton"
    iterations: int = Field(default=100, ge=1)
    tolerance: float = Field(default=1e-8, ge=0.0)
    sustained_solref: tuple[float, float] = (0.002, 1.0)
    sustained_solimp: tuple[float, float, float] = (0.95, 0.95, 0.001)
    impact_stiffness: float = Field(default=0.002, gt=0.0)
    impact_solimp: tuple[float, float, float] = (0.99, 0.99, 0.001)
    kinematic_mass_kg: float = Field(default=1e3, gt=0.0)
    cloth_cell_m: float = Field(default=0.025, gt=0.0)
    cloth_fold_radius_m: float = Field(default=0.002, ge=0.0)
    cloth_solref: tuple[float, float] = (0.005, 1.0)
    cloth_solimp: tuple[float, float, float] = (0.9, 0.95, 0.001)


PRESETS: dict[str, SettingsMuJoCo] = {
    # Chosen on closed forms, not on scores: a slide's acceleration and hops, creep on a slope that holds, drift on a
    # plate at constant speed. MuJoCo's contact constraints leave out the acceleration that comes from the rotation of
    # the contact point, so a body carried round at omega slips outward at about omega^2 r times half the contact's
    # time constant: 11 mm/s with the default 0.02 s at 4 rad/s and 74 mm, 1 mm/s with 0.002 s. So short a time
    # constant hops when sliding unless the step is short too. The elliptic cone with impratio 10 keeps creep at 2 um/s.
    "contact": SettingsMuJoCo(preset="contact", timestep_s=1 / 9000),
    # Bodies that touch and collide in a chain: an impedance close to 1 keeps the contacts between them hard, so that
    # the impulse leaves one contact before it builds up in the next.
    "impact_chain": SettingsMuJoCo(preset="impact_chain", timestep_s=1 / 9000, impact_solimp=(0.9999, 0.9999, 0.001)),
    # No contact: RK4 holds the energy of a pendulum to 1e-6 in 100 s.
    "contact_free": SettingsMuJoCo(preset="contact_free", timestep_s=1 / 1800, integrator="RK4"),
    # Many resting contacts: the cheaper pyramidal cone, a softer reference and a longer step.
    "stack": SettingsMuJoCo(
        preset="stack",
        timestep_s=1 / 900,
        cone="pyramidal",
        impratio=1.0,
        sustained_solref=(0.01, 1.0),
        sustained_solimp=(0.95, 0.99, 0.001),
    ),
    # Deformable bodies: `discrete` is the integrator that takes their elasticity implicitly. At 1/900 s the marker
    # paths of a flung cloth are within 0.5 mm of those at half the step; cells of 25 mm put a vertex under a marker.
    "cloth": SettingsMuJoCo(preset="cloth", timestep_s=1 / 900, integrator="discrete", cone="pyramidal", impratio=1.0),
    # Cloth that folds over and between bodies has thousands of contacts: conjugate gradients with a cap on iterations
    # are five times faster than Newton there, and larger cells do the rest.
    "drape": SettingsMuJoCo(
        preset="drape",
        timestep_s=1 / 900,
        integrator="discrete",
        cone="pyramidal",
        impratio=1.0,
        solver="CG",
        iterations=50,
        cloth_cell_m=1 / 30,
    ),
    # The cap on iterations holds for the inner solve with the stiffness too, which needs hundreds where foam and rubber
    # meet.
    "soft": SettingsMuJoCo(
        preset="soft", timestep_s=1 / 900, integrator="discrete", cone="pyramidal", impratio=1.0, iterations=2000
    ),
    "rod": SettingsMuJoCo(preset="rod", timestep_s=1 / 1800, integrator="discrete"),
}

STACK_BODY_COUNT = 20
"""From this many dynamic bodies on, contacts are so many that the `stack` preset is used."""


def _preset_name(scene: Scene) -> str:
    if scene.deformables:
        cloths = {body.name for body in scene.deformables if isinstance(body, Cloth)}
        if cloths:
            touched = [set(c.first) | set(c.second) for c in scene.contacts if cloths & {*c.first, *c.second}]
            folds = any(cloths & set(c.first) & set(c.second) for c in scene.contacts)
            return "drape" if folds and set().union(*touched) - cloths else "cloth"
        if any(isinstance(body, SoftBody) for body in scene.deformables):
            return "soft"
        # A rope is a chain of constraints, without elasticity: it wants the short step of contacts.
        return "rod" if any(isinstance(body, Rod) for body in scene.deformables) else "contact"
    if not scene.contacts:
        return "contact_free"
    if len(scene.dynamic_bodies) >= STACK_BODY_COUNT:
        return "stack"
    return "impact_chain" if scene.has_impact_chain else "contact"


def settings_for(scene: Scene, overrides: Mapping[str, Any] | None = None) -> SettingsMuJoCo:
    """Settings of a scene: its preset, with overrides put in.

    Raises:
        UnknownNameError: No such preset.
        ParameterError: No such setting, or an impossible value.
    """
    return resolve_settings("MuJoCo", PRESETS, preset=_preset_name(scene), changes=overrides)
