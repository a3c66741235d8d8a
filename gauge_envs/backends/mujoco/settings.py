"""Numerical settings of the MuJoCo backend: its presets and the choice of a preset for a scene.

The content of a scene determines its preset; scores have no influence. The presets are in
`presets.toml`, each with the reasons for its numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, ValidationInfo, field_validator

from gauge_envs.backends.mujoco.versions import check_installed
from gauge_envs.backends.settings import (
    STACK_BODY_COUNT,
    SteppedSettings,
    load_presets,
    read_presets,
    resolve_settings,
)
from gauge_envs.backends.shared.cells import CellSize, check_cells, common_cell_m
from gauge_envs.scene import Cloth, Rod, Rope, Scene, SoftBody


def _in_one_format(solref: tuple[float, float]) -> tuple[float, float]:
    """Raise an error for a mixture of both formats, which MuJoCo replaces by its default with a mere log message."""
    if (solref[0] > 0.0) != (solref[1] > 0.0):
        raise ValueError(
            "both numbers must be positive (time constant, damping ratio) or neither (direct format)"
        )
    return solref


SolRef = Annotated[tuple[float, float], AfterValidator(_in_one_format)]
NonNegative = Annotated[float, Field(ge=0.0)]
SolImp = tuple[float, float, float, float, float]
Friction = tuple[NonNegative, NonNegative, NonNegative, NonNegative, NonNegative]


class SettingsMuJoCo(SteppedSettings):
    """Settings of one MuJoCo simulation.

    Contacts between rigid bodies follow a recipe. `sustained_*` sets the recipe of lasting contacts. `impact_*` sets
    the recipe of collisions, which reproduces the coefficient of restitution that MuJoCo lacks. `contact_*` overrides
    all recipes unless it is None. The scene defines friction unless `friction_scale` or `o_friction` changes it.

    Attributes:
        integrator: Integrator, under MuJoCo's name.
        cone: Friction cone.
        impratio: Ratio of frictional to normal constraint impedance; values above 1 reduce the creep of resting bodies.
        solver: Constraint solver.
        iterations: Maximum number of solver iterations.
        tolerance: Solver tolerance, relative to the mean inertia, which heavy driven bodies raise. With CG and 1e-8, a
            box at rest on a driven slab moves at 11 mm/s; with 1e-10 at 0.1 mm/s.
        ls_iterations: Maximum number of iterations of each line search.
        ls_tolerance: Tolerance of the line search.
        noslip_iterations: Maximum number of iterations of the no-slip solver, whose hard friction removes creep; 0
            disables it.
        noslip_tolerance: Tolerance of the no-slip solver.
        ccd_iterations: Maximum number of iterations of convex collision detection.
        ccd_tolerance: Tolerance of convex collision detection.
        warmstart: Start the solver from the forces of the last step.
        refsafe: Raise a contact's time constant to at least two time steps, for stability.
        eulerdamp: Integrate joint damping implicitly in the Euler integrator; scenes have no joint damping.
        nativeccd: Use MuJoCo's native convex collision detection instead of libccd.
        multiccd: Find several contact points between convex shapes; with a single one they rock.
        island: Solve groups of bodies without mutual contact separately.
        diagexact: Compute the diagonal of the constraint inertia, which scales softness, exactly instead of
            approximately.
        sleep: Stop simulating bodies at rest.
        sleep_tolerance: Velocity below which a body is at rest.
        speculative: Add contacts before bodies touch, so that fast bodies do not pass through thin ones.
        contact_solref: Time constant [s] and damping ratio of every contact; or, if not positive, the negative
            stiffness and the negative damping. Contacts then ignore the scene's restitution.
        contact_solreffriction: The same in the tangential directions, for the elliptic cone and rigid bodies. If it is
            None, `contact_solref` applies if given.
        contact_solimp: Impedance of every contact: d0, dwidth, width [m], midpoint, power.
        contact_margin_m: Distance at which the force of every contact starts; bodies hover at a positive margin.
        contact_gap_m: Additional distance at which a contact is detected without force.
        condim: Dimension of contacts with friction: 1 frictionless, 3 sliding, 4 adds torsional, 6 adds rolling
            friction. None stands for 3.
        torsional_friction_m: Torsional friction coefficient, used if `condim` is at least 4.
        rolling_friction_m: Rolling friction coefficient, used if `condim` is 6.
        inverse_weight_scale: Factor on the inverse weight of dynamic bodies, by which MuJoCo softens their contacts
            unless `diagexact` is on. A foot counts with the inertia of its link, not with the load of the robot.
        friction_scale: Factor on the scene's coefficients of friction.
        o_friction: Friction of every contact, which replaces the scene's as MuJoCo's `override` does: tangential (2),
            torsional [m], rolling (2) [m].
        sustained_solref: Time constant [s] and damping ratio of sustained contacts.
        sustained_solimp: Impedance of sustained contacts: d0, dwidth, width [m].
        impact_stiffness: Dimensionless stiffness s of impacts; MuJoCo's direct solref is (-s/h^2, -(1+e)/h). It adds
            about s to the coefficient of restitution, and pushes resting bodies apart within h (1+e)/s seconds.
        impact_solimp: Impedance of impacts. It is constant in depth, so that the rebound does not depend on depth.
        kinematic_mass_kg: Mass of a driven body. It is so large that contacts do not slow the body between two drives:
            1 N moves 1000 kg by 0.02 micrometres in 1/180 s. At 1e6 kg, a cube on the body creeps 300 times faster,
            because the solver loses accuracy.
        cell_m: Desired edge of the cells of deformable bodies, adjusted so that it divides each side: triangles of a
            cloth, elements of 27 nodes of a soft body (largest edge), segments of a rope or rod. None gives cloth cells
            of 25 mm, a rope segments of 10 mm, and a rod 15 segments. A single soft body then has 4 cells along and 2
            across, and each body of a soft row 2 along and 1 across. A given value is 0.5 mm to 1 m and at most the
            longest side, and no body may have more than 60 000 nodes.
        cloth_fold_radius_m: Half the collision thickness of a cloth that touches itself, about its displacement in one
            step; otherwise layers pass through each other. Other cloth collides with its physical thickness.
        cloth_solref: Time constant [s] and damping ratio of a cloth's contacts.
        cloth_solimp: Impedance of a cloth's contacts. Light cloth bounces on stiffer contacts; bodies sink into softer
            ones. None if `cloth_softness_m2_per_kg` determines it.
        cloth_softness_m2_per_kg: Softness s of a cloth's contacts. A cloth of areal density rho gets the constant
            impedance d = 1 / (1 + s rho). For every density and cell size, MuJoCo's regularization of a vertex of
            mass m, (1 - d) / (d m), is then s over the area of the vertex. None if `cloth_solimp` is given.
    """

    integrator: Literal["Euler", "RK4", "implicit", "implicitfast", "discrete"] = (
        "implicitfast"
    )
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
    inverse_weight_scale: float = Field(default=1.0, gt=0.0)
    friction_scale: float = Field(default=1.0, ge=0.0)
    o_friction: Friction | None = None
    sustained_solref: tuple[float, float] = (0.002, 1.0)
    sustained_solimp: tuple[float, float, float] = (0.95, 0.95, 0.001)
    impact_stiffness: float = Field(default=0.002, gt=0.0)
    impact_solimp: tuple[float, float, float] = (0.99, 0.99, 0.001)
    kinematic_mass_kg: float = Field(default=1e3, gt=0.0)
    cell_m: CellSize = None
    cloth_fold_radius_m: float = Field(default=0.002, ge=0.0)
    cloth_solref: tuple[float, float] = (0.005, 1.0)
    cloth_solimp: tuple[float, float, float] | None = (0.9, 0.95, 0.001)
    cloth_softness_m2_per_kg: float | None = Field(default=None, gt=0.0)

    @field_validator("torsional_friction_m", "rolling_friction_m")
    @classmethod
    def _condim_has_it(cls, length_m: float, info: ValidationInfo) -> float:
        needed = 6 if info.field_name == "rolling_friction_m" else 4
        if length_m and (info.data.get("condim") or 3) < needed:
            raise ValueError(f"would change nothing: set condim={needed} too")
        return length_m

    @field_validator("cloth_softness_m2_per_kg")
    @classmethod
    def _exactly_one_given(
        cls, softness: float | None, info: ValidationInfo
    ) -> float | None:
        # An invalid `cloth_solimp` is not in the data; its own error is reported first.
        if "cloth_solimp" in info.data and (softness is None) == (
            info.data["cloth_solimp"] is None
        ):
            raise ValueError(
                "either this or cloth_solimp must be given, and the other must be None"
            )
        return softness


PRESETS = load_presets(SettingsMuJoCo, __file__)

TRAINING = "training"
"""Preset for many episodes; its numbers depend on the preset of the scene."""

TRAINING_CHANGES = read_presets(__file__, "training")
"""Changes of the preset `training` to the preset of a scene; `rope` stands for scenes with a rope, `soft_touched` for
soft bodies with contacts.

Chosen by distance to the default settings and cost; `scoring/convergence/mujoco.csv` has both for each id.
"""

CLOTH_CELL_M = 0.025
"""Default edge of a cloth's cells [m]."""

ROPE_CELL_M = 0.01
"""Default length of a rope's segments [m]."""

NODE_LIMIT = 60_000
"""Largest number of nodes of a body that `cell_m` may ask for; as many nodes of soft cells take 0.4 GB."""


def _preset_name(scene: Scene) -> str:
    if scene.deformables:
        if scene.has(Cloth):
            return _cloth_preset_name(scene)
        if scene.has(SoftBody):
            is_led = not (scene.contacts or scene.dynamic_bodies) and scene.drivers
            return "soft_driven" if is_led else "soft"
        # A rope is a chain of constraints without elasticity, so it needs the short time step of contacts.
        return "rod" if scene.has(Rod) else "contact"
    if not scene.contacts:
        return "contact_free"
    if len(scene.dynamic_bodies) >= STACK_BODY_COUNT:
        return "stack"
    return "impact_chain" if scene.has_impact_chain else "contact"


def _cloth_preset_name(scene: Scene) -> str:
    cloths = {body.name for body in scene.deformables if isinstance(body, Cloth)}
    bodies = set()
    folds = False
    for contact in scene.contacts:
        first, second = {*contact.first}, {*contact.second}
        if cloths & (first | second):
            bodies |= (first | second) - cloths
            folds |= bool(cloths & first & second)
    if not bodies:
        return "cloth"
    if folds:
        return "drape"
    dynamic = {body.name for body in scene.dynamic_bodies}
    return "cloth_loaded" if bodies & dynamic else "cloth_probed"


def _training_preset(scene: Scene) -> SettingsMuJoCo:
    name = _preset_name(scene)
    kind = name
    if scene.has(Rope):
        kind = "rope"
    elif kind == "soft" and scene.contacts:
        kind = "soft_touched"
    return PRESETS[name].model_copy(
        update={"preset": TRAINING} | TRAINING_CHANGES[kind]
    )


def settings_for(
    scene: Scene, overrides: Mapping[str, Any] | None = None
) -> SettingsMuJoCo:
    """Return the settings of a scene: its preset with the user's overrides."""
    presets = PRESETS | {TRAINING: _training_preset(scene)}
    settings = resolve_settings(
        "MuJoCo", presets, preset=_preset_name(scene), changes=overrides
    )
    check_installed(settings.model_dump(), overrides or {})
    if settings.cell_m is not None and overrides and "cell_m" in overrides:
        check_cells(
            "MuJoCo",
            scene,
            settings.cell_m,
            node_limit=NODE_LIMIT,
            soft_nodes_per_edge=2,
        )
        return settings
    defaults = {Cloth: settings.cell_m or CLOTH_CELL_M, Rope: ROPE_CELL_M}
    cell_m = common_cell_m(scene, defaults) or settings.cell_m
    return settings.model_copy(update={"cell_m": cell_m})
