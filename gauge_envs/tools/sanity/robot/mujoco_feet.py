"""Find the feet of a robot in a MuJoCo model: the geoms that stand on the ground, and the mass that they carry."""

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.errors import TargetError
from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.scene.geometry import BoolArray, FloatArray, IntArray, length_of
from gauge_envs.tools.bench.model_settings import ContactPairs, PairKind, can_move

STANDS_WITHIN = 0.1
"""Height above the lowest point, over the height of the robot, up to which a body counts as standing."""

SOLE_WITHIN = 0.01
"""Height above the lowest point of a foot, over the height of the robot, up to which a geom is part of its sole."""

UPRIGHT = 0.7
"""Least vertical component of a slide joint with which a robot can rise and fall."""

FLAT = 1e-3
"""Component of a unit vector below which a face or an edge counts as level."""

STANDING = ("home", "stand", "standing")
"""Names of keyframes in which robots stand."""

HELD_M_PER_S = 1e-3
"""Speed of falling below which the damping of a joint counts as holding a robot [m/s]."""

LIQUID_KG_PER_M3 = 10.0
"""Density of the medium from which on a robot swims; air has 1.2 [kg/m^3]."""


class NoFootError(Exception):
    """A model has no foot; the message is the reason."""


@dataclass(frozen=True, kw_only=True)
class Stance:
    """Pose of a model in which its robot stands.

    Attributes:
        label: Name of the pose.
        qpos: Generalized position, shape [nq].
        ctrl: Controls that belong to the pose, shape [nu]; zeros where no keyframe states them.
        positions_m: Positions of the geoms in a frame with z up [m], shape [geom_count, 3].
        rotations: Rotations of the geoms to that frame.
        joint_axes: Axes of the joints in that frame, shape [joint_count, 3].
    """

    label: str
    qpos: FloatArray
    ctrl: FloatArray
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
        support_m: Lowest point of each geom that can touch the ground [m].
        feet: Geoms of each foot, by its body.
    """

    body: int
    height_m: float
    ground_m: float
    support_m: Mapping[int, FloatArray]
    feet: Mapping[int, list[int]]


def find_standing(
    model: mujoco.MjModel, pairs: ContactPairs, stance: Stance
) -> Standing:
    """Return the heaviest robot of a model that stands, with its feet.

    A robot can rise and fall: its first joint is free, or a vertical slide that nothing drives or holds. It has an
    actuator, or joints in a model without actuators. Its feet are the bodies that can touch the ground and lie
    lowest in its pose.

    Raises:
        NoFootError: There is none.
    """
    geoms = np.unique(pairs.geoms[ground_rows(pairs)])
    touching = geoms[can_move(model)[geoms]].tolist()
    if not touching:
        raise NoFootError("the model has no ground that a moving geom can touch")
    if model.opt.density > LIQUID_KG_PER_M3:
        raise NoFootError("the robot swims: the model's medium is a liquid")
    trees, moved = model.body_treeid[model.geom_bodyid], driven_trees(model)
    standing = [
        int(model.tree_bodyadr[tree])
        for tree in set(trees[touching].tolist())
        # A free box is a body; a robot has motors, or joints in a model without motors.
        if (tree in moved if moved else model.tree_bodynum[tree] > 1)
        and _can_fall(model, stance, int(model.tree_bodyadr[tree]))
    ]
    if not standing:
        raise NoFootError(
            "no robot of the model stands on the ground under its own weight"
        )
    base = max(standing, key=lambda body: (model.body_subtreemass[body], -body))
    is_part = trees == model.body_treeid[base]
    support = {
        geom: support_m(model, stance, geom) for geom in touching if is_part[geom]
    }
    ground_m = min(float(point[2]) for point in support.values())
    tops_m = stance.positions_m[is_part, 2] + model.geom_rbound[is_part]
    height_m = max(float(tops_m.max()) - ground_m, 1e-3)
    bodies: dict[int, list[int]] = {}
    for geom, point in support.items():
        if point[2] <= ground_m + STANDS_WITHIN * height_m:
            bodies.setdefault(int(model.geom_bodyid[geom]), []).append(geom)
    # A body that carries another one that stands is no foot.
    for carrying in {other for body in bodies for other in chain_of(model, body)[1:]}:
        bodies.pop(carrying, None)
    feet = {}
    for body, own in bodies.items():
        sole_m = min(support[geom][2] for geom in own) + SOLE_WITHIN * height_m
        feet[body] = [geom for geom in own if support[geom][2] <= sole_m]
    return Standing(
        body=base,
        height_m=height_m,
        ground_m=ground_m,
        support_m=support,
        feet=feet,
    )


def ground_rows(pairs: ContactPairs) -> IntArray:
    """Return the pairs of a moving geom and the ground: planes and height fields, or other geoms of the world."""
    kind = pairs.kinds.min(initial=PairKind.MOVING)
    return np.flatnonzero((pairs.kinds == kind) & (kind < PairKind.MOVING))


def free_balls(model: mujoco.MjModel) -> BoolArray:
    """Return which geoms are balls that move freely, shape [ngeom]."""
    is_free = np.isin(model.geom_bodyid, model.jnt_bodyid[joints_of(model, "FREE")])
    is_alone = model.body_geomnum[model.geom_bodyid] == 1
    is_sphere = model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE
    balls: BoolArray = is_free & is_alone & is_sphere
    return balls


def name_of(model: mujoco.MjModel, kind: str, number: int) -> str:
    """Return the name of an element, or its kind and number."""
    return getattr(model, kind)(number).name or f"{kind} {number}"


def geom_name(model: mujoco.MjModel, geom: int) -> str:
    """Return the name of a geom, or its number and its body."""
    owner = model.body(int(model.geom_bodyid[geom])).name
    return model.geom(geom).name or f"geom {geom} of {owner or 'an unnamed body'}"


# --- stance ----------------------------------------------------------------------------------------------------------


def stance_of(model: mujoco.MjModel, up: FloatArray) -> Stance:
    """Return the keyframe in which a robot stands, or the first one.

    Without a keyframe it is the initial pose with joints within their limits.
    """
    data, label = mujoco.MjData(model), "initial pose"
    if model.nkey:
        names = [model.key(index).name for index in range(model.nkey)]
        known = next((name for name in STANDING if name in names), names[0])
        mujoco.mj_resetDataKeyframe(model, data, names.index(known))
        label = f"keyframe {known}".rstrip()
    is_clipped = (model.jnt_limited != 0) & joints_of(model, "HINGE", "SLIDE")
    places = model.jnt_qposadr[is_clipped]
    data.qpos[places] = np.clip(data.qpos[places], *model.jnt_range[is_clipped].T)
    mujoco.mj_kinematics(model, data)
    if not (np.isfinite(data.geom_xpos).all() and np.isfinite(data.geom_xmat).all()):
        raise TargetError(
            "the poses of the model's geoms are not finite: it states a NaN or an infinite number"
        )
    turn = Rotation.align_vectors([[0.0, 0.0, 1.0]], [up])[0]
    return Stance(
        label=label,
        qpos=data.qpos.copy(),
        ctrl=data.ctrl.copy(),
        positions_m=turn.apply(data.geom_xpos),
        rotations=turn * Rotation.from_matrix(data.geom_xmat.reshape(-1, 3, 3)),
        joint_axes=turn.apply(data.xaxis),
    )


def joints_of(model: mujoco.MjModel, *kinds: str) -> BoolArray:
    """Return which joints are of some types, such as `HINGE`, shape [joint_count]."""
    known = [getattr(mujoco.mjtJoint, f"mjJNT_{kind}") for kind in kinds]
    return np.isin(model.jnt_type, known)


def driven_trees(model: mujoco.MjModel) -> set[int]:
    """Return the trees of bodies that actuators move, through joints, tendons, sites or bodies."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    dofs = data.moment_colind[data.actuator_moment.ravel() != 0.0]
    return set(model.dof_treeid[dofs].tolist())


def acts_on_joints(model: mujoco.MjModel) -> BoolArray:
    """Return which actuators act on a joint, shape [nu]."""
    kinds = mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT
    return np.isin(model.actuator_trntype, kinds)


def joints_of_motors(model: mujoco.MjModel) -> IntArray:
    """Return the joint of each actuator that acts on a joint."""
    joints: IntArray = model.actuator_trnid[acts_on_joints(model), 0]
    return joints


def _can_fall(model: mujoco.MjModel, stance: Stance, body: int) -> bool:
    """Return whether the first joints of a body let it rise and fall."""
    weight_n = float(model.body_subtreemass[body]) * GRAVITY_M_PER_S2
    dampings = np.atleast_2d(model.dof_damping.T)[0, model.jnt_dofadr]
    falls = joints_of(model, "SLIDE") & (np.abs(stance.joint_axes[:, 2]) > UPRIGHT)
    falls &= weight_n > HELD_M_PER_S * dampings
    falls[joints_of_motors(model)] = False
    falls |= joints_of(model, "FREE")
    return bool(falls[model.jnt_bodyid == body].any())


def support_m(model: mujoco.MjModel, stance: Stance, geom: int) -> FloatArray:
    """Return the lowest point of a geom [m], the middle of a lowest face or edge, shape [3]."""
    down = -stance.rotations[geom].as_matrix()[2]
    down[np.abs(down) < FLAT] = 0.0
    size, kind = model.geom_size[geom], kind_of(model, geom)
    # A sphere is a capsule without length.
    end = np.array([0.0, 0.0, size[1] * np.sign(down[2])])
    point = size[0] * down + end
    if kind == "CYLINDER":
        aside = down * [1.0, 1.0, 0.0]
        point = size[0] * aside / max(length_of(aside), FLAT) + end
    elif kind == "ELLIPSOID":
        point = size**2 * down / np.linalg.norm(size * down)
    elif kind == "BOX":
        point = size * np.sign(down)
    elif kind == "MESH":
        vertices = vertices_m(model, geom)
        depths = vertices @ down
        is_deep = depths > depths.max() - FLAT * float(model.geom_rbound[geom])
        point = vertices[is_deep].mean(axis=0)
    return stance.positions_m[geom] + stance.rotations[geom].apply(point)


def chain_of(model: mujoco.MjModel, body: int) -> list[int]:
    """Return a body and all that carry it, but the world."""
    chain = []
    while body:
        chain.append(body)
        body = int(model.body_parentid[body])
    return chain


def kind_of(model: mujoco.MjModel, geom: int) -> str:
    """Return the type of a geom, such as `SPHERE`."""
    return str(mujoco.mjtGeom(int(model.geom_type[geom])).name).removeprefix("mjGEOM_")


def vertices_m(model: mujoco.MjModel, geom: int) -> FloatArray:
    """Return the vertices of the mesh of a geom in the frame of the geom [m], shape [vertex_count, 3]."""
    mesh = model.geom_dataid[geom]
    first = model.mesh_vertadr[mesh]
    return model.mesh_vert[first : first + model.mesh_vertnum[mesh]].astype(np.float64)
