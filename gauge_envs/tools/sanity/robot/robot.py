"""The target's own model: its robot, how it stands, and its measured properties."""

import copy
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property, wraps
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypeAlias, TypeVar

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.backends.mujoco.contact_table import ContactPairs, PairKind, can_move
from gauge_envs.errors import TargetError
from gauge_envs.scene import GRAVITY_M_PER_S2, Vector
from gauge_envs.scene.geometry import BoolArray, FloatArray, IntArray
from gauge_envs.tools.sanity.robot.model_text import ModelText

Place: TypeAlias = tuple[str, int]
"""Kind of an element of the model, such as `joint`, and its id in the compiled model."""

STANDING = ("home", "stand", "standing")
"""Names of keyframes in which robots stand."""

BODY_JOINS = (int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD))
"""Types of equalities that join bodies."""

WRAP_SITE = int(mujoco.mjtWrap.mjWRAP_SITE)

ALONG_AN_AXIS = 0.999
"""Smallest component of the hinges of a robot that moves in a plane along an axis of the world."""


@dataclass(frozen=True, kw_only=True)
class Stance:
    """Pose of a model in which its robot stands.

    Attributes:
        qpos: Generalized position, shape [nq].
        positions_m: Positions of the geoms in a frame with z up [m], shape [geom_count, 3].
        rotations: Rotations of the geoms to that frame.
        joint_axes: Axes of the joints in that frame, shape [joint_count, 3].
    """

    qpos: FloatArray
    positions_m: FloatArray
    rotations: Rotation
    joint_axes: FloatArray


@dataclass(frozen=True, kw_only=True)
class Standing:
    """Robot of a model that stands on the ground, and its feet.

    Attributes:
        body: First moving body of the robot.
        height_m: Height of the robot [m].
        ground_m: Height of its lowest point [m].
        support_m: Height of the lowest point of each geom that can touch the ground [m].
        feet: Geoms of each foot, by its body.
    """

    body: int
    height_m: float
    ground_m: float
    support_m: Mapping[int, float]
    feet: Mapping[int, list[int]]


@dataclass(frozen=True, kw_only=True, eq=False)
class Robot:
    """A compiled model.

    Attributes:
        model: The model.
        pairs: All pairs of geoms that can collide.
        up: Unit vector away from the ground, shape [3].
        standing: The robot that stands on the ground; None when there is none.
        spec: The model before it was compiled; None when only the compiled one is known.
        pair: Names of two geoms whose constants count; None for all on the ground.
        file: File of the model; None when it is not known.
        known: Results of measurements, by function and arguments; see `once`.
    """

    model: mujoco.MjModel
    pairs: ContactPairs
    up: Vector
    standing: Standing | None = None
    spec: mujoco.MjSpec | None = None
    pair: tuple[str, str] | None = None
    file: Path | None = None
    known: dict[tuple[object, ...], Any] = field(default_factory=dict, init=False)

    def place_text(self, place: Place) -> str:
        """Return an element of the model as a text: its kind, and its name or number."""
        kind, number = place
        name = getattr(self.model, kind)(number).name
        return f'{kind} "{name}"' if name else f"{kind} {number}"

    def source_of(self, place: Place) -> tuple[str, int]:
        """Return file and line of an element of the model; no file where the text is unknown."""
        if self.text is None:
            return "", 0
        element = self.text.element(self.model, *place)
        if element is None:
            return "", 0
        return str(element.file), self.text.line(element)

    @cached_property
    def text(self) -> ModelText | None:
        """Text of the model's files; None where it is unknown."""
        if self.file is None or self.spec is None:
            return None
        try:
            return ModelText(self.file)
        except (OSError, ValueError, KeyError):
            return None

    def without(self, *features: str) -> mujoco.MjModel:
        """Return a copy of the model with some features switched off."""
        model = copy.copy(self.model)
        for feature in features:
            model.opt.disableflags |= disable_bit(feature)
        return model

    @cached_property
    def stance(self) -> Stance:
        """Keyframe in which it stands, or the first one.

        Without a keyframe it is the initial pose with joints within their limits.
        """
        model, data = self.model, mujoco.MjData(self.model)
        if model.nkey:
            mujoco.mj_resetDataKeyframe(model, data, standing_key(model))
        is_clipped = (model.jnt_limited != 0) & joints_of(model, "HINGE", "SLIDE")
        places = model.jnt_qposadr[is_clipped]
        data.qpos[places] = np.clip(data.qpos[places], *model.jnt_range[is_clipped].T)
        mujoco.mj_kinematics(model, data)
        if not np.isfinite(np.hstack([data.geom_xpos, data.geom_xmat])).all():
            raise TargetError(
                f"{self.file or 'model'}: the poses of its geoms are not finite: it has a NaN or an infinite number"
            )
        to_z_up = Rotation.align_vectors([[0.0, 0.0, 1.0]], [self.up])[0]
        return Stance(
            qpos=data.qpos.copy(),
            positions_m=to_z_up.apply(data.geom_xpos),
            rotations=to_z_up * Rotation.from_matrix(data.geom_xmat.reshape(-1, 3, 3)),
            joint_axes=to_z_up.apply(data.xaxis),
        )

    @cached_property
    def driven_dofs(self) -> IntArray:
        """Degrees of freedom that actuators move, through joints, tendons, sites or bodies."""
        data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, data)
        dofs: IntArray = data.moment_colind[data.actuator_moment.ravel() != 0.0]
        return dofs

    @cached_property
    def driven_trees(self) -> set[int]:
        """Trees of bodies that actuators move."""
        return set(self.model.dof_treeid[self.driven_dofs].tolist())

    @cached_property
    def bodies(self) -> list[int]:
        """Bodies of the robot that stands; without one, bodies of arms that actuators move; else all moving bodies."""
        model = self.model
        trees = model.body_treeid
        if self.standing is not None:
            return np.flatnonzero(trees == trees[self.standing.body]).tolist()
        moving = trees >= 0
        is_driven = moving & np.isin(trees, list(self.driven_trees))
        # Fingers of a palm that does not move are trees of one arm.
        is_arm = moving & np.isin(model.body_rootid, model.body_rootid[is_driven])
        return np.flatnonzero(is_arm if is_arm.any() else moving).tolist()

    @cached_property
    def ground_rows(self) -> IntArray:
        """Rows of `pairs` of a moving geom and the ground: planes and height fields, else other geoms of the world."""
        kinds = self.pairs.kinds
        kind = kinds.min(initial=PairKind.MOVING)
        return np.flatnonzero((kinds == kind) & (kind < PairKind.MOVING))

    @cached_property
    def foot_rows(self) -> list[int]:
        """Rows of `pairs` in which a foot meets the ground."""
        if self.standing is None:
            return []
        feet = [geom for geoms in self.standing.feet.values() for geom in geoms]
        touches = np.isin(self.pairs.geoms[self.ground_rows], feet).any(axis=1)
        return self.ground_rows[touches].tolist()

    @cached_property
    def moves_along_axis(self) -> bool:
        """Whether all hinges of the robot turn about one horizontal axis of the world, and nothing is free."""
        is_part = np.isin(self.model.jnt_bodyid, self.bodies)
        hinges = self.stance.joint_axes[is_part & joints_of(self.model, "HINGE")]
        if not len(hinges) or joints_of(self.model, "FREE", "BALL")[is_part].any():
            return False
        return bool((np.abs(hinges[:, :2]) > ALONG_AN_AXIS).all(axis=0).any())


def standing_key(model: mujoco.MjModel) -> int:
    """Return the keyframe in which a robot stands, by its name, or the first one."""
    names = [model.key(index).name for index in range(model.nkey)]
    return next((names.index(name) for name in STANDING if name in names), 0)


Result = TypeVar("Result")
Arguments = ParamSpec("Arguments")


def once(
    function: Callable[Concatenate[Robot, Arguments], Result],
) -> Callable[Concatenate[Robot, Arguments], Result]:
    """Return a function that measures a robot once, and keeps its result in the robot."""

    @wraps(function)
    def remembered(
        robot: Robot, /, *args: Arguments.args, **kwargs: Arguments.kwargs
    ) -> Result:
        key = (function, *args, *kwargs.items())
        if key not in robot.known:
            robot.known[key] = function(robot, *args, **kwargs)
        result: Result = robot.known[key]
        return result

    return remembered


def disable_bit(feature: str) -> int:
    """Return MuJoCo's bit that switches a feature off, such as `limit`."""
    return int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{feature.upper()}"))


def switched_off(model: mujoco.MjModel, *features: str) -> bool:
    """Return whether a model switches one of some features off."""
    return any(model.opt.disableflags & disable_bit(feature) for feature in features)


def acts_on_joints(model: mujoco.MjModel) -> BoolArray:
    """Return which actuators act on a joint, shape [nu]."""
    kinds = mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT
    return np.isin(model.actuator_trntype, kinds)


def joints_of_motors(model: mujoco.MjModel) -> IntArray:
    """Return the joint of each actuator that acts on a joint."""
    joints: IntArray = model.actuator_trnid[acts_on_joints(model), 0]
    return joints


def joints_of(model: mujoco.MjModel, *kinds: str) -> BoolArray:
    """Return which joints are of some types, such as `HINGE`, shape [joint_count]."""
    known = [getattr(mujoco.mjtJoint, f"mjJNT_{kind}") for kind in kinds]
    return np.isin(model.jnt_type, known)


def free_balls(model: mujoco.MjModel) -> BoolArray:
    """Return which geoms are balls that move freely, shape [ngeom]."""
    is_ball = np.isin(model.geom_bodyid, model.jnt_bodyid[joints_of(model, "FREE")])
    is_ball &= model.body_geomnum[model.geom_bodyid] == 1
    is_ball &= model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE
    return is_ball


def name_of(model: mujoco.MjModel, kind: str, number: int) -> str:
    """Return the name of an element; for a body without a name, its first geom's name; else its kind and number."""
    code = getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}")
    name: str | None = mujoco.mj_id2name(model, code, number)
    if kind == "body" and not name and model.body_geomnum[number]:
        name = model.geom(int(model.body_geomadr[number])).name
    return name or f"{kind} {number}"


def spec_element(spec: mujoco.MjSpec, kind: str, number: int) -> Any:
    """Return an element of a spec by its id in the compiled model."""
    kinds = {"equality": "equalities", "body": "bodies"}.get(kind, f"{kind}s")
    return next(element for element in getattr(spec, kinds) if element.id == number)


def geom_name(model: mujoco.MjModel, geom: int) -> str:
    """Return the name of a geom, or its number and its body."""
    owner = model.body(int(model.geom_bodyid[geom])).name
    return model.geom(geom).name or f"geom {geom} of {owner or 'an unnamed body'}"


def chain_of(model: mujoco.MjModel, body: int) -> list[int]:
    """Return a body and all that carry it, but the world."""
    chain = []
    while body:
        chain.append(body)
        body = int(model.body_parentid[body])
    return chain


def grasping_pairs(model: mujoco.MjModel, pairs: ContactPairs) -> BoolArray:
    """Return for each pair whether a driven part can grasp a free body."""
    roots = model.body_rootid
    driven = np.isin(roots, roots[model.jnt_bodyid[joints_of_motors(model)]])
    free = np.isin(roots, model.jnt_bodyid[joints_of(model, "FREE")]) & ~driven
    bodies = model.geom_bodyid[pairs.geoms]
    grasps: BoolArray = driven[bodies].any(axis=1) & free[bodies].any(axis=1)
    return grasps


def random_poses(model: mujoco.MjModel, poses: int) -> Iterator[mujoco.MjData]:
    """Yield a model in random poses within its joint limits, at rest; free and ball joints stay."""
    data, generator = mujoco.MjData(model), np.random.default_rng(0)
    is_hinge = joints_of(model, "HINGE")
    moving = is_hinge | joints_of(model, "SLIDE")
    limits = np.where(is_hinge[:, None], [-np.pi, np.pi], [-1.0, 1.0])
    is_limited = model.jnt_limited != 0
    limits[is_limited] = model.jnt_range[is_limited]
    for _ in range(poses):
        data.qpos[model.jnt_qposadr[moving]] = generator.uniform(*limits[moving].T)
        mujoco.mj_forward(model, data)
        yield data


def root_of(model: mujoco.MjModel, body: int) -> int:
    """Return the first body of the tree of a body."""
    return int(model.tree_bodyadr[model.body_treeid[body]])


@once
def reaches_m(robot: Robot) -> FloatArray:
    """Return the length of the limb from each body on, stretched, shape [nbody]: no pose reaches farther."""
    model = robot.model
    reaches = np.zeros(model.nbody)
    ends = np.linalg.norm(model.geom_pos, axis=1) + model.geom_rbound
    np.maximum.at(reaches, model.geom_bodyid, ends)
    for body in range(model.nbody - 1, 0, -1):
        parent = model.body_parentid[body]
        arm = np.linalg.norm(model.body_pos[body]) + reaches[body]
        reaches[parent] = max(reaches[parent], arm)
    return reaches


def unheld(model: mujoco.MjModel) -> list[int]:
    """Return bodies with a free joint whose tree no weld, connection or tendon holds."""
    ends = np.hstack([model.eq_obj1id, model.eq_obj2id])
    of_sites = np.tile(model.eq_objtype == mujoco.mjtObj.mjOBJ_SITE, 2)
    is_joined = np.tile(np.isin(model.eq_type, BODY_JOINS), 2)
    bodies = np.where(
        of_sites, model.site_bodyid[ends * of_sites] if model.nsite else 0, ends
    )
    held = model.body_treeid[bodies[is_joined & (ends >= 0)]].tolist()
    for first, count in zip(model.tendon_adr, model.tendon_num, strict=True):
        wraps = slice(first, first + count)
        sites = model.wrap_objid[wraps][model.wrap_type[wraps] == WRAP_SITE]
        joined = {*model.body_treeid[model.site_bodyid[sites]].tolist()}
        held += joined if len(joined) > 1 else ()
    free = model.jnt_bodyid[joints_of(model, "FREE")]
    loose: list[int] = free[~np.isin(model.body_treeid[free], held)].tolist()
    return loose


def free_objects(model: mujoco.MjModel) -> list[int]:
    """Return bodies that move freely, and alone."""
    bodies = model.jnt_bodyid[joints_of(model, "FREE")]
    is_alone = model.body_subtreemass[bodies] == model.body_mass[bodies]
    alone: list[int] = bodies[is_alone].tolist()
    return alone


STANDS_WITHIN = 0.1
"""Height above the lowest point, over the height of the robot, up to which a body counts as standing."""

SOLE_WITHIN = 0.01
"""Height above the lowest point of a foot, over the height of the robot, up to which a geom is part of its sole."""

UPRIGHT = 0.7
"""Smallest vertical component of a slide joint with which a robot can rise and fall."""

MIN_FALL_M_PER_S = 1e-3
"""Speed of falling below which the damping of a joint holds a robot [m/s]."""

LIQUID_KG_PER_M3 = 10.0
"""Density of the medium above which a robot swims; air has 1.2 [kg/m^3]."""


def find_standing(robot: Robot) -> Standing | None:
    """Return the heaviest robot of a model that stands, with its feet; None where none stands.

    A robot can rise and fall: its first joint is free, or a vertical slide that nothing drives or holds. It has an
    actuator, or joints in a model without actuators. Its feet are the lowest bodies in its pose that can touch the
    ground. In a liquid it swims.
    """
    model, stance = robot.model, robot.stance
    geoms = np.unique(robot.pairs.geoms[robot.ground_rows])
    touching = geoms[can_move(model)[geoms]].tolist()
    if model.opt.density > LIQUID_KG_PER_M3:
        return None
    trees, moved = model.body_treeid[model.geom_bodyid], robot.driven_trees
    standing = [
        int(model.tree_bodyadr[tree])
        for tree in set(trees[touching].tolist())
        # A free box is a body; a robot has motors, or joints in a model without motors.
        if (tree in moved if moved else model.tree_bodynum[tree] > 1)
        and _can_fall(robot, int(model.tree_bodyadr[tree]))
    ]
    if not standing:
        return None
    base = max(standing, key=lambda body: (model.body_subtreemass[body], -body))
    is_part = trees == model.body_treeid[base]
    support = {geom: support_m(robot, geom) for geom in touching if is_part[geom]}
    ground_m = min(support.values())
    tops_m = stance.positions_m[is_part, 2] + model.geom_rbound[is_part]
    height_m = max(float(tops_m.max()) - ground_m, 1e-3)
    bodies: dict[int, list[int]] = {}
    for geom, low_m in support.items():
        if low_m <= ground_m + STANDS_WITHIN * height_m:
            bodies.setdefault(int(model.geom_bodyid[geom]), []).append(geom)
    # A body that carries a standing body is no foot.
    for carrying in {parent for body in bodies for parent in chain_of(model, body)[1:]}:
        bodies.pop(carrying, None)
    feet = {}
    for body, body_geoms in bodies.items():
        sole_m = min(support[geom] for geom in body_geoms) + SOLE_WITHIN * height_m
        feet[body] = [geom for geom in body_geoms if support[geom] <= sole_m]
    return Standing(
        body=base,
        height_m=height_m,
        ground_m=ground_m,
        support_m=support,
        feet=feet,
    )


def _can_fall(robot: Robot, body: int) -> bool:
    """Return whether the first joints of a body let it rise and fall."""
    model = robot.model
    weight_n = model.body_subtreemass[body] * GRAVITY_M_PER_S2
    dampings = np.atleast_2d(model.dof_damping.T)[0, model.jnt_dofadr]
    falls = joints_of(model, "SLIDE") & (
        np.abs(robot.stance.joint_axes[:, 2]) > UPRIGHT
    )
    falls &= weight_n > MIN_FALL_M_PER_S * dampings
    falls[joints_of_motors(model)] = False
    return body in unheld(model) or bool(falls[model.jnt_bodyid == body].any())


def support_m(robot: Robot, geom: int) -> float:
    """Return the height of the lowest point of a geom [m]."""
    model, stance = robot.model, robot.stance
    down = -stance.rotations[geom].as_matrix()[2]
    a, b, _ = size = model.geom_size[geom]
    aside = float(np.hypot(*down[:2]))
    # The support function of each shape; a sphere is a capsule without length.
    depths = {
        "mjGEOM_CYLINDER": a * aside + b * abs(down[2]),
        "mjGEOM_ELLIPSOID": np.linalg.norm(size * down),
        "mjGEOM_BOX": size @ np.abs(down),
    }
    kind = mujoco.mjtGeom(int(model.geom_type[geom])).name
    depth_m = depths.get(kind, a + b * abs(down[2]))
    if kind == "mjGEOM_MESH":
        depth_m = (mesh_vertices_m(model, geom) @ down).max()
    return float(stance.positions_m[geom, 2] - depth_m)


def mesh_vertices_m(model: mujoco.MjModel, geom: int) -> FloatArray:
    """Return the vertices of the mesh of a geom in the frame of the geom [m], shape [vertex_count, 3]."""
    mesh = model.geom_dataid[geom]
    first = model.mesh_vertadr[mesh]
    return model.mesh_vert[first : first + model.mesh_vertnum[mesh]].astype(np.float64)
