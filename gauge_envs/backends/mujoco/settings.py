"""Numerical settings of the MuJoCo backend: the presets, and which preset a scene gets.

A preset is picked from what the scene contains, never from how well it scores. What is engine default and what is
not, and why, stands beside each number.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, ValidationInfo, field_validator

from gauge_envs.backends.settings import SteppedSettings, resolve_settings
from gauge_envs.scene import Cloth, Rod, Scene, SoftBody

__all__ = [
    "PRESETS",
    "SettingsMuJoCo",
    "settings_for",
]


def _in_one_format(solref: tuple[float, float]) -> tuple[float, float]:
    """MuJoCo replaces a mixture by its default, and tells on its log alone."""
    if (solref[0] > 0.0) != (solref[1] > 0.0):
        raise ValueError("both numbers must be positive (time constant, damping ratio) or neither (direct format)")
    return solref


SolRef = Annotated[tuple[float, float], AfterValidator(_in_one_format)]
NonNegative = Annotated[float, Field(ge=0.0)]
SolImp = tuple[float, float, float, float, float]
Friction = tuple[NonNegative, NonNegative, NonNegative, NonNegative, NonNegative]


class SettingsMuJoCo(SteppedSettings):
    """Settings of one simulation.

    Contacts follow recipes: `sustained_*` for bodies that stay in touch, `impact_*` for those that collide, which need
    the coefficient of restitution that MuJoCo lacks. `contact_*` put constants as models state them in the place of
    all recipes; None leaves them. Friction is the scene's unless `friction_scale` or `o_friction` says otherwise.

    Attributes:
        integrator: MuJoCo's name of the integrator.
        cone: Friction cone.
        impratio: Ratio of frictional to normal constraint impedance; above 1 it keeps resting bodies from creeping.
        solver: Constraint solver.
        iterations: Cap on solver iterations.
        tolerance: Solver tolerance.
        ls_iterations: Cap on iterations of each line search.
        ls_tolerance: Tolerance of the line search.
        noslip_iterations: Cap on iterations of the second solve, which has hard friction and so removes creep; off.
        noslip_tolerance: Its tolerance.
        ccd_iterations: Cap on iterations of the collision of convex shapes.
        ccd_tolerance: Its tolerance.
        warmstart: Start the solver from the last step's forces.
        refsafe: Raise a contact's time constant to two steps where it is shorter, for stability.
        eulerdamp: Take joint damping implicitly in the Euler integrator; scenes have none.
        nativeccd: Collide convex shapes with MuJoCo's own code, not with libccd.
        multiccd: Look for several contact points between convex shapes; one alone lets them rock.
        island: Solve bodies that do not touch each other apart.
        diagexact: Compute the diagonal of the constraint inertia, which scales softness, exactly; MuJoCo estimates it.
        sleep: Stop simulating what has come to rest.
        sleep_tolerance: Velocity below which a body is at rest.
        speculative: Add contacts ahead of time, so that fast bodies do not pass through thin ones.
        contact_solref: Time constant [s] and damping ratio of every contact; or, neither positive, minus its stiffness
            and minus its damping. Contacts then have no restitution of their own.
        contact_solreffriction: The same along the surface, for the elliptic cone and rigid bodies; None takes
            `contact_solref` where that is given.
        contact_solimp: Impedance of every contact: d0, dwidth, width [m], midpoint, power.
        contact_margin_m: Distance at which every contact holds bodies apart: with a margin they hover.
        contact_gap_m: Further distance at which a contact is found, without force.
        condim: Dimension of contacts with friction: 1 none, 3 sliding, 4 torsional too, 6 rolling too. None is 3.
        torsional_friction_m: Torsional friction over normal force, from `condim` 4 on.
        rolling_friction_m: Rolling friction over normal force, with `condim` 6.
        friction_scale: Factor on the scene's coefficients of friction.
        o_friction: Friction of every contact in the place of the scene's, as MuJoCo's `override` does: tangential (2),
            torsional [m], rolling (2) [m].
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
            None where it follows from `cloth_softness_m2_per_kg`.
        cloth_softness_m2_per_kg: Softness s of a cloth's contacts, from which each cloth gets a constant impedance
            d = 1 / (1 + s rho), rho its areal density: MuJoCo's regularization, (1 - d) / (d m) for a vertex of mass m,
            is then s over the area of a vertex, for light and heavy cloth and for any cells. None where `cloth_solimp`
            is given.
    """

    integrator: Literal["Euler", "RK4", "implicit", "implicitfast", "discrete"] = "implicitfast"
    cone: Literal["pyramidal", "elliptic"] = "elliptic"
    impratio: float = Field(default=10.0, gt=0.0)
    solver: Literal["PGS", "CG", "Newton"] = "Newton"
    iterations: int = Field(default=100, ge=1)
    tolerance: float = Field(default=1e-8, ge=0.0)
    ls_iterations: int = Field(default=50, ge=1)
    ls_tolerance: float = Field(default=0.01, ge=0.0)
    noslip_iterations: int = Field(default=0, ge=0)
    noslip_tolerance: float = Field(default=1e-6, ge=0.0)
    ccd_iterations: int = Field(default=35, ge=1)
    ccd_tolerance: float = Field(default=1e-6, ge=0.0)
    warmstart: bool = True
    refsafe: bool = True
    eulerdamp: bool = True
    nativeccd: bool = True
    multiccd: bool = True
    island: bool = True
    diagexact: bool = False
    sleep: bool = False
    sleep_tolerance: float = Field(default=1e-3, ge=0.0)
    speculative: bool = False
    contact_solref: SolRef | None = None
    contact_solreffriction: SolRef | None = None
    contact_solimp: SolImp | None = None
    contact_margin_m: float | None = Field(default=None, ge=0.0)
    contact_gap_m: float | None = Field(default=None, ge=0.0)
    condim: Literal[1, 3, 4, 6] | None = None
    torsional_friction_m: float = Field(default=0.0, ge=0.0)
    rolling_friction_m: float = Field(default=0.0, ge=0.0)
    friction_scale: float = Field(default=1.0, ge=0.0)
    o_friction: Friction | None = None
    sustained_solref: tuple[float, float] = (0.002, 1.0)
    sustained_solimp: tuple[float, float, float] = (0.95, 0.95, 0.001)
    impact_stiffness: float = Field(default=0.002, gt=0.0)
    impact_solimp: tuple[float, float, float] = (0.99, 0.99, 0.001)
    kinematic_mass_kg: float = Field(default=1e3, gt=0.0)
    cloth_cell_m: float = Field(default=0.025, gt=0.0)
    cloth_fold_radius_m: float = Field(default=0.002, ge=0.0)
    cloth_solref: tuple[float, float] = (0.005, 1.0)
    cloth_solimp: tuple[float, float, float] | None = (0.9, 0.95, 0.001)
    cloth_softness_m2_per_kg: float | None = Field(default=None, gt=0.0)

    @field_validator("cloth_softness_m2_per_kg")
    @classmethod
    def _one_of_two(cls, softness: float | None, info: ValidationInfo) -> float | None:
        # An impedance that is itself at fault is not in the data, and is told first.
        if "cloth_solimp" in info.data and (softness is None) == (info.data["cloth_solimp"] is None):
            raise ValueError("either this or cloth_solimp must be given, and the other one None")
        return softness


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
    # Bodies that move under forces lie on the cloth. Where nothing does, so short a time constant would only cost: a
    # probe that touches a cloth in a frame gains it 2 % of its work. What a body on cloth must do decides: hold on 10
    # degrees, slide on 30, ride along at constant speed. MuJoCo makes contacts soft in proportion to the lightness of
    # what touches: with its own impedance a cube of 0.34 kg on vertices of 0.3 g creeps by 15 mm/s on 10 degrees. Where
    # contacts are much stiffer than this, the load jumps from vertex to vertex and the cloth slips away below; so it
    # does with the pyramidal cone, which stiffens the normal direction by 2 / mu^2. Half the time constant keeps the
    # cube from sinking in deeper than the cloth is thick.
    "cloth_loaded": SettingsMuJoCo(
        preset="cloth_loaded",
        timestep_s=1 / 900,
        integrator="discrete",
        impratio=1.0,
        cloth_solref=(0.0025, 1.0),
        cloth_solimp=None,
        cloth_softness_m2_per_kg=0.0375,
    ),
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
    # MuJoCo as it comes: what a model has that states nothing. Only masses, shapes and friction are the scene's.
    # Environments drive in intervals that this step does not divide, so they need another `drive_interval_s`.
    "out_of_box": SettingsMuJoCo(
        preset="out_of_box",
        timestep_s=0.002,
        drive_interval_s=0.002,
        integrator="Euler",
        cone="pyramidal",
        impratio=1.0,
        contact_solref=(0.02, 1.0),
        contact_solimp=(0.9, 0.95, 0.001, 0.5, 2.0),
    ),
}

STACK_BODY_COUNT = 20
"""From this many dynamic bodies on, contacts are so many that the `stack` preset is used."""


def _preset_name(scene: Scene) -> str:
    if scene.deformables:
        cloths = {body.name for body in scene.deformables if isinstance(body, Cloth)}
        if cloths:
            touched = [set(c.first) | set(c.second) for c in scene.contacts if cloths & {*c.first, *c.second}]
            folds = any(cloths & set(c.first) & set(c.second) for c in scene.contacts)
            if folds and set().union(*touched) - cloths:
                return "drape"
            loads = {body.name for body in scene.dynamic_bodies}
            return "cloth_loaded" if loads & set().union(*touched) else "cloth"
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
