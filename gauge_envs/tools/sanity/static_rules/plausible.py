"""Static rules: numbers that no real part has."""

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.pages.text import digits_text
from gauge_envs.scene.geometry import BoolArray, FloatArray
from gauge_envs.tools.sanity.model_checks.check import Fault, rule
from gauge_envs.tools.sanity.model_checks.drives import drives, start
from gauge_envs.tools.sanity.robot.robot import (
    LIQUID_KG_PER_M3,
    Robot,
    chain_of,
    geom_name,
    joints_of,
    name_of,
    once,
    root_of,
)
from gauge_envs.tools.sanity.verdict import Severity

TYPES = mujoco.mjtGeom
SOLIDS = (
    TYPES.mjGEOM_SPHERE,
    TYPES.mjGEOM_CAPSULE,
    TYPES.mjGEOM_CYLINDER,
    TYPES.mjGEOM_BOX,
)
"""Shapes whose size is exact."""

MARKER_M = 0.01
"""Size of shapes that mark the place of a link instead of showing it [m]."""


def mesh_volume_m3(model: mujoco.MjModel, geom: int) -> float:
    """Return the volume of the mesh of a geom by the divergence theorem [m^3]; NaN where it is not closed."""
    mesh = int(model.geom_dataid[geom])
    vertices = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]]
    faces = model.mesh_face[model.mesh_faceadr[mesh] :][: model.mesh_facenum[mesh]]
    begins, ends = faces.ravel(), faces[:, [1, 2, 0]].ravel()
    edges, reverse = (
        a.astype(np.int64) << 32 | b for a, b in ((begins, ends), (ends, begins))
    )
    if len(np.unique(edges)) < len(edges) or not np.isin(reverse, edges).all():
        return float("nan")
    first, second, third = vertices.astype(np.float64)[faces].transpose(1, 0, 2)
    return abs(float(np.einsum("ni,ni->", first, np.cross(second, third)))) / 6.0


def volumes_and_squares(model: mujoco.MjModel) -> tuple[FloatArray, FloatArray]:
    """Return volume and squared radius of gyration of each geom, shapes [ngeom]; of a mesh, those of its ellipsoid.

    The squared radius of gyration is half the trace of the inertia over the mass.
    """
    spec = mujoco.MjSpec()
    for geom in range(model.ngeom):
        kind, size_m = int(model.geom_type[geom]), model.geom_size[geom]
        if kind not in SOLIDS:
            kind, size_m = TYPES.mjGEOM_ELLIPSOID, model.geom_aabb[geom, 3:]
        body = spec.worldbody.add_body()
        body.add_geom(type=kind, size=np.maximum(size_m, 1e-6), density=1.0)
    alone = spec.compile()
    volumes = alone.body_mass[1:]
    return volumes, 0.5 * alone.body_inertia[1:].sum(axis=1) / volumes


def solid_geoms(model: mujoco.MjModel) -> BoolArray:
    """Return which geoms can collide, shape [ngeom]."""
    solid: BoolArray = (model.geom_contype | model.geom_conaffinity) != 0
    solid[[*model.pair_geom1.tolist(), *model.pair_geom2.tolist()]] = True
    return solid


@dataclass(frozen=True, kw_only=True)
class BodyShape:
    """Shapes of a body.

    Attributes:
        low_m: Smallest coordinates of the shapes in the frame of the body [m], shape [3].
        high_m: Largest coordinates [m], shape [3].
        volume_m3: Smallest volume of its colliding or drawn shapes without meshes, which may be hollow [m^3].
        square_m2: Smallest squared radius of gyration of its colliding or drawn shapes with an even density [m^2].
    """

    low_m: FloatArray
    high_m: FloatArray
    volume_m3: float
    square_m2: float

    @property
    def box_m3(self) -> float:
        """Volume of the box around the shapes [m^3]."""
        return float((self.high_m - self.low_m).prod())

    def farthest_m(self, point_m: FloatArray) -> float:
        """Return the distance of a point from the farthest corner of the box [m]."""
        away = np.maximum(np.abs(self.low_m - point_m), np.abs(self.high_m - point_m))
        return float(np.linalg.norm(away))


@once
def body_shapes(robot: Robot) -> dict[int, BodyShape]:
    """Return the shapes of each moving body that has some larger than a marker."""
    model, shapes = robot.model, {}
    rotations = Rotation.from_quat(model.geom_quat, scalar_first=True)
    centres = model.geom_pos + rotations.apply(model.geom_aabb[:, :3])
    halves = np.einsum(
        "nij,nj->ni", np.abs(rotations.as_matrix()), model.geom_aabb[:, 3:]
    )
    volumes, squares = volumes_and_squares(model)
    solid = solid_geoms(model)
    solids = np.where(model.geom_type == TYPES.mjGEOM_MESH, 0.0, volumes)
    is_solid_shape = model.geom_type >= int(TYPES.mjGEOM_SPHERE)
    for body in np.flatnonzero(model.body_treeid >= 0).tolist():
        of_body = (model.geom_bodyid == body) & is_solid_shape
        groups = [of_body & solid, of_body & ~solid]
        groups = [np.flatnonzero(group) for group in groups if group.any()]
        if not groups:
            continue
        every = np.hstack(groups)
        if (
            np.ptp(
                [*(centres - halves)[every], *(centres + halves)[every]], axis=0
            ).max()
            < MARKER_M
        ):
            continue
        shapes[body] = BodyShape(
            low_m=(centres - halves)[every].min(axis=0),
            high_m=(centres + halves)[every].max(axis=0),
            volume_m3=min(float(solids[group].sum()) for group in groups),
            square_m2=min(
                _square(volumes[group], squares[group], centres[group])
                for group in groups
            ),
        )
    return shapes


def _square(volumes: FloatArray, squares: FloatArray, centres: FloatArray) -> float:
    """Return the squared radius of gyration of several shapes about their common centre [m^2]."""
    weights = volumes / max(volumes.sum(), 1e-300)
    away = centres - weights @ centres
    return float(weights @ (squares + (away**2).sum(axis=1)))


# --- masses ----------------------------------------------------------------------------------------------------------

OSMIUM_KG_PER_M3, POINT_KG_PER_M3 = 22_600.0, 100_000.0
"""Density of the densest metal, and of an object that stands for no point mass [kg/m^3]."""

LIGHT_KG_PER_M3 = 3.0
"""Density of aerogel [kg/m^3]."""

MIN_SHARE = 1e-3
"""Share of the robot's mass below which nothing depends on a link."""


@rule(
    "density",
    title="mass of a link over its own shapes",
    source="the densest metal has 22,600 kg/m^3, aerogel 3; the box around all shapes of the link",
    consequence="The policy learns forces of another robot.",
    most=Severity.ADVICE,
)
def density(robot: Robot) -> Iterator[Fault]:
    """Yield bodies that are denser than any metal in the box around their shapes, or lighter than aerogel."""
    model, shapes = robot.model, body_shapes(robot)
    # A rod without mass may carry a weight that is welded to it.
    links_kg = np.bincount(model.body_weldid, model.body_mass, model.nbody)
    for body, shape in shapes.items():
        mass_kg, name = model.body_mass[body], name_of(model, "body", body)
        least_kg = MIN_SHARE * model.body_subtreemass[model.body_rootid[body]]
        dense = mass_kg / max(shape.box_m3, 1e-12)
        light = links_kg[model.body_weldid[body]] / max(shape.volume_m3, 1e-12)
        is_object = int(model.body_treeid[body]) not in robot.driven_trees
        limit = POINT_KG_PER_M3 if is_object else OSMIUM_KG_PER_M3
        if dense > limit and mass_kg > least_kg:
            text = f"{name} weighs {mass_kg:.3g} kg: {dense:,.0f} kg/m^3 around it; the densest metal has 22,600"
            yield Fault(("body", body), name, text, dense / limit)
        own = model.geom_bodyid == body
        is_marker = is_object and not solid_geoms(model)[own].any()
        is_light = 0.0 < light < LIGHT_KG_PER_M3 and model.body_gravcomp[body] <= 1.0
        if is_light and model.body_dofnum[body] and not is_marker:
            text = f"{name} weighs {mass_kg:.3g} kg: {light:.2g} kg/m^3; aerogel has 3"
            yield Fault(("body", body), name, text, 1.0 / light)


MAX_GYRATION, MIN_GYRATION = 1.0, 1.0 / 5.0
"""Squared radius of gyration over that of the farthest corner of the link's own shapes, and over that of the shapes."""


@rule(
    "inertia",
    title="inertia of a link over its own shapes",
    source="a mass inside a box gyrates with less than the distance of its farthest corner; with a motor at one end, "
    "with more than half of an even density",
    consequence="The link turns faster or slower than the real one.",
    most=Severity.ADVICE,
)
def inertia(robot: Robot) -> Iterator[Fault]:
    """Yield bodies whose mass would lie outside of their shapes, or in a small part of them."""
    model = robot.model
    for body, shape in body_shapes(robot).items():
        mass_kg, name = model.body_mass[body], name_of(model, "body", body)
        if mass_kg < MIN_SHARE * model.body_subtreemass[model.body_rootid[body]]:
            continue
        square = 0.5 * model.body_inertia[body].sum() / max(mass_kg, 1e-12)
        most = shape.farthest_m(model.body_ipos[body]) ** 2
        ratio = square / max(shape.square_m2, 1e-12)
        if square > MAX_GYRATION * most or ratio < MIN_GYRATION:
            text = f"{name} of {mass_kg:.3g} kg has {digits_text(ratio)} times the inertia of its own shapes"
            yield Fault(
                ("body", body),
                name,
                text,
                max(ratio, 1.0 / max(ratio, 1e-12)),
            )


MAX_AWAY = 10.0
"""Distance of a centre of mass from the box around the link over its diagonal: drawn parts may be missing."""


@rule(
    "centre-of-mass",
    title="centre of mass outside of the link",
    source="a mass inside its shapes has its centre in the box around them",
    consequence="The link falls to a side that the real one does not have.",
    most=Severity.ADVICE,
)
def centre(robot: Robot) -> Iterator[Fault]:
    """Yield bodies whose centre of mass is farther from the box around them than its diagonal."""
    model = robot.model
    for body, shape in body_shapes(robot).items():
        point = model.body_ipos[body]
        out_m = np.linalg.norm(point - np.clip(point, shape.low_m, shape.high_m))
        size_m = np.linalg.norm(shape.high_m - shape.low_m)
        if out_m > MAX_AWAY * size_m:
            name = name_of(model, "body", body)
            text = f"{name} has its centre of mass {out_m:.3g} m outside of its shapes of {size_m:.3g} m"
            yield Fault(("body", body), name, text, float(out_m / size_m))


MESH_SHARE = 1.5
"""Mass of a mesh by MuJoCo's legacy rule over that of its volume above which it is said."""


@rule(
    "mesh-mass",
    title="mass of a mesh by the legacy rule",
    source='MuJoCo\'s inertia="legacy" counts the volume of a mesh that is not convex several times; exact does not',
    consequence="The link is heavier than its density says.",
)
def mesh_mass(robot: Robot) -> Iterator[Fault]:
    """Yield bodies with a single mesh and a density, whose mass is not density times volume."""
    model = robot.model
    for geom in robot.spec.geoms if robot.spec else ():
        body = int(model.geom_bodyid[geom.id])
        is_single = (
            model.body_geomnum[body] == 1
            and model.geom_type[geom.id] == mujoco.mjtGeom.mjGEOM_MESH
        )
        if not is_single or geom.parent.explicitinertial or np.isfinite(geom.mass):
            continue
        mass_kg = model.body_mass[body]
        exact_kg = geom.density * mesh_volume_m3(model, geom.id)
        if mass_kg > MESH_SHARE * exact_kg:
            name = name_of(model, "body", body)
            text = f"{name} weighs {mass_kg:.3g} kg; density times volume is {exact_kg:.3g}"
            yield Fault(("body", body), name, text, mass_kg / max(exact_kg, 1e-12))


# --- joints ----------------------------------------------------------------------------------------------------------

MAX_TURNS, MIN_RANGE_RAD, ENDLESS = 4.0, 0.12, 1600.0
"""Largest range of a hinge in turns, the smallest (2 pi in degrees that are read twice is 0.11), and no stop at all."""


@rule(
    "range-unit",
    title="range of a hinge in another unit",
    source="a hinge with stops turns by less than four turns; a range of 6.28 read as degrees is 0.11 rad",
    consequence="The joint has no stops, or does not move.",
)
def range_unit(robot: Robot) -> Iterator[Fault]:
    """Yield hinges whose range looks like degrees in a file of radians, or the reverse."""
    model = robot.model
    driven = model.dof_jntid[robot.driven_dofs]
    limited = np.flatnonzero((model.jnt_limited != 0) & joints_of(model, "HINGE"))
    in_degrees = robot.spec and robot.spec.compiler.degree
    for joint in limited.tolist():
        low, high = model.jnt_range[joint]
        name, span = name_of(model, "joint", joint), high - low
        turns = span / (2.0 * np.pi)
        halves = np.array([low, high]) / np.pi
        is_turns = np.allclose(halves, np.rint(halves), atol=1e-3)
        if MAX_TURNS < turns < ENDLESS and not (in_degrees or is_turns):
            text = f"{name} can turn {digits_text(turns)} times round: range {low:.4g} to {high:.4g} "
            text += "looks like degrees in a file of radians"
            right = "range", np.deg2rad([low, high])
        elif span < MIN_RANGE_RAD and joint in driven and in_degrees:
            low, high = np.rad2deg([low, high])
            if max(-low, high) > 1.5 * np.pi and np.allclose(
                [low, high], np.rint([low, high])
            ):
                continue
            text = f"{name} can turn by {np.rad2deg(span):.3g} degrees: range {low:.4g} to {high:.4g} "
            text += "looks like radians in a file of degrees"
            right, span = ("range", np.rad2deg([low, high])), 1.0 / max(span, 1e-9)
        else:
            continue
        yield Fault(("joint", joint), name, text, span, change=right)


MIN_STEPS = 20.0
"""Steps in which a motor turns a joint from stop to stop: in each the speed then changes by a tenth of its peak."""


@rule(
    "armature",
    title="joints without rotor inertia that a step does not resolve",
    source="stop to stop at full torque takes 2 sqrt(range * inertia / torque), and range * damping / torque or more",
    consequence="The joint is as fast as no rotor, and the step does not resolve it.",
    most=Severity.ADVICE,
)
def armature(robot: Robot) -> Iterator[Fault]:
    """Yield hinges without armature that their motors turn from stop to stop in a few steps."""
    model, matrix = robot.model, np.zeros((robot.model.nv, robot.model.nv))
    mujoco.mj_fullM(model, start(robot), matrix)
    for drive in drives(robot):
        if not drive.is_hinge or drive.armature or np.isinf(drive.limit):
            continue
        inertia = matrix[drive.dof, drive.dof]
        span = float(np.ptp(model.jnt_range[drive.joint])) or 2.0 * np.pi
        least_s = MIN_STEPS * model.opt.timestep
        least = drive.limit * least_s**2 / (4.0 * span)
        if inertia < least and span * drive.damping < drive.limit * least_s:
            text = f"{drive.name} has no armature: {drive.limit:.3g} N m give it {drive.limit / inertia:,.0f} rad/s^2"
            right = "armature", max(inertia, least - inertia)
            yield Fault(
                ("joint", drive.joint), drive.name, text, least / inertia, change=right
            )


# --- feet and bases --------------------------------------------------------------------------------------------------

LOW_FRICTION, HIGH_FRICTION = 0.05, 3.0
"""Friction of feet: wet ice on rubber has 0.05 and more, racing tyres less than 3."""


@rule(
    "robot-friction",
    title="friction of a foot that no real sole has",
    source="wet ice 0.05, racing tyres below 3",
    consequence="The foot slips or grips as on no real floor.",
    most=Severity.ADVICE,
)
def foot_friction(robot: Robot) -> Iterator[Fault]:
    """Yield feet whose friction on the ground is outside of the limits."""
    driven = {drive.body for drive in drives(robot)}
    for row in robot.foot_rows:
        condim, friction = robot.pairs.constants[row, :2].tolist()
        met, ends = friction * (condim > 1), robot.pairs.geoms[row].tolist()
        # The pair is in the order of ids; the foot is on a body of the robot.
        ground, foot = sorted(
            ends, key=lambda geom: int(robot.model.geom_bodyid[geom]) in robot.bodies
        )
        # A ball without friction is a caster, which no motor moves.
        is_moved = not driven.isdisjoint(
            chain_of(robot.model, int(robot.model.geom_bodyid[foot]))
        )
        if (is_moved and met < LOW_FRICTION) or met > HIGH_FRICTION:
            name = geom_name(robot.model, foot)
            text = f"{name} has friction {met:g} on {geom_name(robot.model, ground)}"
            text += ", by condim 1" if condim == 1 else ""
            ratio = max(LOW_FRICTION / max(met, 1e-9), met / HIGH_FRICTION)
            yield Fault(("geom", foot), name, text, ratio)


FREE_SHARE = 0.05
"""Share of its speed that a free base may lose in 1 s: air takes less from anything heavier than a balloon."""


@rule(
    "robot-free",
    title="free joint that brakes its robot in the air",
    source='nothing holds a base in the air; defaults of joints apply to <joint type="free"> and not to <freejoint>',
    consequence="The policy learns to turn and fall slower than the robot does.",
)
def free_joint(robot: Robot) -> Iterator[Fault]:
    """Yield free joints of robots with friction, damping or armature; a ball may be braked to keep it from rolling."""
    model, matrix = robot.model, np.zeros((robot.model.nv, robot.model.nv))
    bases = [root_of(model, drive.body) for drive in drives(robot)]
    is_base = joints_of(model, "FREE") & np.isin(model.jnt_bodyid, bases)
    if model.opt.density > LIQUID_KG_PER_M3 or not is_base.any():
        return
    mujoco.mj_fullM(model, start(robot), matrix)
    damping = np.atleast_2d(model.dof_damping.T)[0]
    dry, rotor = model.dof_frictionloss, model.dof_armature
    shares = np.maximum(damping + dry, rotor) / (np.diag(matrix) - rotor)
    for joint in np.flatnonzero(is_base).tolist():
        first = model.jnt_dofadr[joint]
        share = float(shares[first : first + 6].max())
        if share > FREE_SHARE:
            name = name_of(model, "body", int(model.jnt_bodyid[joint]))
            text = f"{name} is braked in the air by damping {damping[first]:g}, friction {dry[first]:g}, "
            text += f"armature {rotor[first]:g}"
            yield Fault(("joint", joint), name, text, share)


# --- the world -------------------------------------------------------------------------------------------------------


SWIM_KG_PER_M3 = 2000.0
"""Density from which on a medium is no mistaken water: swimmers of MuJoCo have 3000 to 5000 [kg/m^3]."""


@rule(
    "medium",
    title="a liquid around a robot on feet",
    source="air has 1.2 kg/m^3 and 1.8e-5 Pa s; water 1000 and 1e-3",
    consequence="The robot walks as under water.",
    most=Severity.ADVICE,
)
def medium(robot: Robot) -> Iterator[Fault]:
    """Yield a density or viscosity of the medium of a robot with wheels, feet or a fixed base above a floor."""
    option = robot.model.opt
    is_liquid = LIQUID_KG_PER_M3 < option.density < SWIM_KG_PER_M3
    if len(robot.ground_rows) and is_liquid:
        text = f"the medium has {option.density:g} kg/m^3, a liquid; air has 1.2"
        yield Fault(("body", 0), "option", text, option.density)


SENSORS = (mujoco.mjtSensor.mjSENS_ACCELEROMETER, mujoco.mjtSensor.mjSENS_GYRO)


@rule(
    "imu-frame",
    title="inertial sensor upside down",
    source="an accelerometer at rest measures 9.81 m/s^2 upwards",
    consequence="The policy gets gravity with the wrong sign.",
    most=Severity.ADVICE,
)
def imu_frame(robot: Robot) -> Iterator[Fault]:
    """Yield sites of inertial sensors whose z axis points down where the robot stands."""
    model, data = robot.model, start(robot)
    for number in np.flatnonzero(np.isin(model.sensor_type, SENSORS)).tolist():
        site = int(model.sensor_objid[number])
        axis: FloatArray = data.site_xmat[site].reshape(3, 3)[:, 2]
        if robot.standing is not None and axis @ np.asarray(robot.up) < -0.9:
            name = name_of(model, "site", site)
            text = f"site {name} of an inertial sensor is upside down: at rest it measures -9.81 m/s^2 along z"
            yield Fault(("site", site), name, text)
