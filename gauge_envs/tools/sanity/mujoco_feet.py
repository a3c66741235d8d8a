"""Find the feet of a robot in a MuJoCo model: the geoms that stand on the ground, and the mass that they carry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from gauge_envs.backends.mujoco.model_settings import ContactPairs, PairKind, can_move, contact_settings
from gauge_envs.scene import GRAVITY_M_PER_S2, Box, Capsule, ConvexUnion, Cylinder, Ellipsoid, Part, Pose, Sphere
from gauge_envs.scene.geometry import vector
from gauge_envs.tools.sanity.foot import COPIES, FootGeometry
from gauge_envs.tools.sanity.model import ContactGroup

STANDING_KEYFRAMES = ("home", "stand", "standing")
"""Names of keyframes in which robots stand; MuJoCo Menagerie uses `home`."""

STANDS_WITHIN = 0.1
"""Height above the lowest point, over the height of the robot, up to which a body counts as standing."""

SOLE_WITHIN = 0.01
"""Height above the lowest point of a foot, over the height of the robot, up to which a geom is part of its sole."""

UPRIGHT = 0.7
"""Least vertical component of a slide joint with which a robot can rise and fall."""

FLAT = 1e-3
"""Component of a unit vector below which a face or an edge counts as level."""

HELD_M_PER_S = 1e-3
"""Speed of falling below which the damping of a joint counts as holding a robot [m/s]."""

MOST_GEOMS = 4
"""Most geoms of a foot that are listed; of more, the others are counted."""

GEOM_KINDS = {
    mujoco.mjtGeom.mjGEOM_SPHERE: "sphere",
    mujoco.mjtGeom.mjGEOM_CAPSULE: "capsule",
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: "ellipsoid",
    mujoco.mjtGeom.mjGEOM_CYLINDER: "cylinder",
    mujoco.mjtGeom.mjGEOM_BOX: "box",
    mujoco.mjtGeom.mjGEOM_MESH: "hull of a mesh",
}
"""Types of geoms that a foot may have, with their names."""


class NoFootError(Exception):
    """A model has no foot; the message is the reason."""


@dataclass(frozen=True, kw_only=True)
class _Stance:
    """Pose of a model in which its robot stands.

    Attributes:
        label: Name of the pose.
        up: Rotation from the model's world to a frame with z up.
        positions_m: Positions of the geoms in that frame [m], shape [geom_count, 3].
        rotations: Rotations of the geoms to that frame.
        joint_axes: Axes of the joints in that frame, shape [joint_count, 3].
    """

    label: str
    up: Rotation
    positions_m: NDArray[np.float64]
    rotations: Rotation
    joint_axes: NDArray[np.float64]


def read_foot(
    model: mujoco.MjModel,
    pairs: ContactPairs,
    groups: Sequence[ContactGroup],
    up: tuple[float, float, float],
) -> FootGeometry:
    """Return the foot of the heaviest robot of a model.

    A robot can rise and fall: its first joint is free, or a vertical slide that nothing drives or holds. It has an
    actuator, unless the model has none. Its feet are the bodies that can touch the ground and lie lowest in the
    keyframe `home`, or in the initial pose with joints within their limits. Of several feet, the lowest one is read.

    Args:
        model: The compiled model.
        pairs: All pairs of geoms that can collide.
        groups: Contact constants, those that are judged marked as used.
        up: Unit vector away from the ground, shape [3].
    """
    touching = _touching(model, pairs)
    if not touching:
        raise NoFootError("the model has no ground that a moving geom can touch")
    stance = _stance(model, np.asarray(up))
    robots = {_first_moving_body(model, int(model.geom_bodyid[geom])) for geom in touching}
    driven = _driven_bodies(model)
    if driven:
        robots &= {_first_moving_body(model, body) for body in driven}
    standing = [body for body in robots if _can_fall(model, stance, body)]
    if not standing:
        raise NoFootError("no robot of the model stands on the ground under its own weight")
    robot = max(standing, key=lambda body: (model.body_subtreemass[body], -body))
    geoms = [g for g in touching if _first_moving_body(model, int(model.geom_bodyid[g])) == robot]
    lowest = {geom: _lowest_m(model, stance, geom) for geom in geoms}
    height = max(_top_m(model, stance, robot) - min(lowest.values()), 1e-3)
    standing_geoms = {g: z for g, z in lowest.items() if z <= min(lowest.values()) + STANDS_WITHIN * height}
    feet = _soles(_feet(model, standing_geoms), lowest, SOLE_WITHIN * height)
    body = min(feet, key=lambda one: (min(lowest[geom] for geom in feet[one]), one))
    mass = float(model.body_subtreemass[robot])
    return FootGeometry(
        name=model.body(body).name or f"body {body}",
        geoms=_geoms_text(model, feet[body], body),
        parts=_parts(model, stance, feet[body]),
        load_kg=mass / len(feet),
        robot_mass_kg=mass,
        foot_count=len(feet),
        pose=stance.label,
        sets=_sets(model, pairs, groups, {geom for several in feet.values() for geom in several}),
        softening=float(model.body_invweight0[body, 0]) * COPIES * mass / len(feet),
    )


def _touching(model: mujoco.MjModel, pairs: ContactPairs) -> list[int]:
    """Return the moving geoms that can touch the ground: planes and height fields, or other geoms of the world."""
    rows = _ground_rows(pairs)
    moving = can_move(model)
    geoms = pairs.geoms[rows]
    return [int(geom) for geom in np.unique(geoms[moving[geoms]])]


def _ground_rows(pairs: ContactPairs) -> NDArray[np.intp]:
    kind = pairs.kinds.min() if len(pairs.kinds) else PairKind.MOVING
    return np.flatnonzero((pairs.kinds == kind) & (pairs.kinds < PairKind.MOVING))


# --- stance ----------------------------------------------------------------------------------------------------------


def _stance(model: mujoco.MjModel, up: NDArray[np.float64]) -> _Stance:
    data = mujoco.MjData(model)
    label = "initial pose"
    names = [model.key(index).name for index in range(model.nkey)]
    known = next((name for name in STANDING_KEYFRAMES if name in names), None)
    if known is not None:
        mujoco.mj_resetDataKeyframe(model, data, names.index(known))
        label = f"keyframe {known}"
    for joint in np.flatnonzero(model.jnt_limited):
        # A comparison of an enumerator with NumPy's integers depends on the order, so both become Python's.
        if int(model.jnt_type[joint]) in (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)):
            place = model.jnt_qposadr[joint]
            data.qpos[place] = np.clip(data.qpos[place], *model.jnt_range[joint])
    mujoco.mj_kinematics(model, data)
    turn = Rotation.identity()
    if up[2] < 1.0:
        turn = Rotation.align_vectors([[0.0, 0.0, 1.0]], [up])[0]
    return _Stance(
        label=label,
        up=turn,
        positions_m=turn.apply(data.geom_xpos),
        rotations=turn * Rotation.from_matrix(data.geom_xmat.reshape(-1, 3, 3)),
        joint_axes=turn.apply(data.xaxis),
    )


def _first_moving_body(model: mujoco.MjModel, body: int) -> int:
    """Return the body nearest to the world that moves a body; the body itself when nothing moves it."""
    first = body
    while body:
        if model.body_dofnum[body]:
            first = body
        body = int(model.body_parentid[body])
    return int(first)


def _driven_bodies(model: mujoco.MjModel) -> set[int]:
    """Return the bodies on which actuators act."""
    bodies = set()
    for actuator in range(model.nu):
        kind, target = int(model.actuator_trntype[actuator]), int(model.actuator_trnid[actuator, 0])
        if kind in (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)):
            bodies.add(int(model.jnt_bodyid[target]))
        elif kind == int(mujoco.mjtTrn.mjTRN_TENDON):
            bodies |= _pulled_bodies(model, target)
        elif kind in (int(mujoco.mjtTrn.mjTRN_SITE), int(mujoco.mjtTrn.mjTRN_SLIDERCRANK)):
            bodies.add(int(model.site_bodyid[target]))
        elif kind == int(mujoco.mjtTrn.mjTRN_BODY):
            bodies.add(target)
    return bodies


def _pulled_bodies(model: mujoco.MjModel, tendon: int) -> set[int]:
    """Return the bodies of the joints and sites of a tendon."""
    first = int(model.tendon_adr[tendon])
    owners = {int(mujoco.mjtWrap.mjWRAP_JOINT): model.jnt_bodyid, int(mujoco.mjtWrap.mjWRAP_SITE): model.site_bodyid}
    return {
        int(owners[int(model.wrap_type[wrap])][model.wrap_objid[wrap]])
        for wrap in range(first, first + int(model.tendon_num[tendon]))
        if int(model.wrap_type[wrap]) in owners
    }


def _can_fall(model: mujoco.MjModel, stance: _Stance, body: int) -> bool:
    """Return whether the first joints of a body let it rise and fall."""
    weight = float(model.body_subtreemass[body]) * GRAVITY_M_PER_S2
    on_joints = model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_JOINT)
    driven = set(model.actuator_trnid[on_joints, 0].tolist())
    for joint in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]):
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
            return True
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE:
            falls = weight > HELD_M_PER_S * model.dof_damping[model.jnt_dofadr[joint]]
            if abs(stance.joint_axes[joint, 2]) > UPRIGHT and joint not in driven and falls:
                return True
    return False


def _lowest_m(model: mujoco.MjModel, stance: _Stance, geom: int) -> float:
    """Return the height of the lowest point of a geom [m]."""
    return float(_support_m(model, stance, geom)[2])


def _support_m(model: mujoco.MjModel, stance: _Stance, geom: int) -> NDArray[np.float64]:
    """Return the lowest point of a geom [m], the middle of a lowest face or edge, shape [3]."""
    down = -stance.rotations[geom].as_matrix()[2]
    down[np.abs(down) < FLAT] = 0.0
    size = model.geom_size[geom]
    kind = model.geom_type[geom]
    point = down * model.geom_rbound[geom]
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        point = size[0] * down + [0.0, 0.0, size[1] * np.sign(down[2])]
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        aside = np.array([down[0], down[1], 0.0])
        point = size[0] * aside / max(float(np.linalg.norm(aside)), FLAT) + [0.0, 0.0, size[1] * np.sign(down[2])]
    elif kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        point = size**2 * down / np.linalg.norm(size * down)
    elif kind == mujoco.mjtGeom.mjGEOM_BOX:
        point = size * np.sign(down)
    elif kind == mujoco.mjtGeom.mjGEOM_MESH:
        vertices = _vertices_m(model, geom)
        depths = vertices @ down
        point = vertices[depths > depths.max() - FLAT * float(model.geom_rbound[geom])].mean(axis=0)
    return np.asarray(stance.positions_m[geom] + stance.rotations[geom].apply(point))


def _top_m(model: mujoco.MjModel, stance: _Stance, robot: int) -> float:
    """Return the height of the highest geom of a robot [m], by its bounding sphere."""
    own = [geom for geom in range(model.ngeom) if _first_moving_body(model, int(model.geom_bodyid[geom])) == robot]
    return float((stance.positions_m[own, 2] + model.geom_rbound[own]).max())


def _feet(model: mujoco.MjModel, lowest: dict[int, float]) -> dict[int, list[int]]:
    """Return the standing geoms of each body, without bodies that carry another one that stands."""
    bodies: dict[int, list[int]] = {}
    for geom in lowest:
        bodies.setdefault(int(model.geom_bodyid[geom]), []).append(geom)
    carrying = {parent for body in bodies for parent in _ancestors(model, body)}
    return {body: geoms for body, geoms in bodies.items() if body not in carrying}


def _soles(feet: dict[int, list[int]], lowest_m: dict[int, float], within_m: float) -> dict[int, list[int]]:
    """Return the geoms of each foot that lie as low as its lowest one, within a height."""
    return {
        body: [geom for geom in geoms if lowest_m[geom] <= min(lowest_m[other] for other in geoms) + within_m]
        for body, geoms in feet.items()
    }


def _ancestors(model: mujoco.MjModel, body: int) -> list[int]:
    found = []
    while body := int(model.body_parentid[body]):
        found.append(body)
    return found


# --- solids ----------------------------------------------------------------------------------------------------------


def _parts(model: mujoco.MjModel, stance: _Stance, geoms: Sequence[int]) -> tuple[Part, ...]:
    """Return geoms as solids, with their lowest point as origin."""
    origin = min((_support_m(model, stance, geom) for geom in geoms), key=lambda point: float(point[2]))
    return tuple(
        Part(
            shape=_solid(model, geom),
            pose=Pose.from_rotation(vector(stance.positions_m[geom] - origin), stance.rotations[geom]),
        )
        for geom in geoms
    )


def _solid(model: mujoco.MjModel, geom: int) -> Box | Sphere | Cylinder | Capsule | Ellipsoid | ConvexUnion:
    x, y, z = model.geom_size[geom].tolist()
    kind = model.geom_type[geom]
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return Sphere(radius_m=x)
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return Capsule(radius_m=x, length_m=2.0 * y)
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return Cylinder(radius_m=x, length_m=2.0 * y)
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        return Ellipsoid(radii_m=(x, y, z))
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return Box(size_m=(2.0 * x, 2.0 * y, 2.0 * z))
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        vertices = _vertices_m(model, geom)
        try:
            hull = vertices[ConvexHull(vertices).vertices]
        except QhullError:
            raise NoFootError("the foot is a flat mesh, which the scenes cannot have") from None
        return ConvexUnion(pieces_m=(tuple(vector(point) for point in hull),))
    name = mujoco.mjtGeom(int(kind)).name.removeprefix("mjGEOM_").lower()
    raise NoFootError(f"the foot is a geom of type {name}, which the scenes cannot have")


def _vertices_m(model: mujoco.MjModel, geom: int) -> NDArray[np.float64]:
    """Return the vertices of the mesh of a geom in the frame of the geom [m], shape [vertex_count, 3]."""
    mesh = model.geom_dataid[geom]
    first = model.mesh_vertadr[mesh]
    vertices: NDArray[np.float64] = model.mesh_vert[first : first + model.mesh_vertnum[mesh]].astype(np.float64)
    return vertices


def _geoms_text(model: mujoco.MjModel, geoms: Sequence[int], body: int) -> str:
    owner = model.body(body).name or f"body {body}"
    names = [model.geom(geom).name or f"geom {geom} of {owner}" for geom in geoms]
    kinds = [GEOM_KINDS.get(mujoco.mjtGeom(int(model.geom_type[geom])), "geom") for geom in geoms]
    texts = [f"{name} ({kind})" for name, kind in zip(names, kinds, strict=True)]
    if len(texts) > MOST_GEOMS:
        texts = [*texts[: MOST_GEOMS - 1], f"{len(texts) - MOST_GEOMS + 1} more"]
    return ", ".join(texts)


def _sets(
    model: mujoco.MjModel, pairs: ContactPairs, groups: Sequence[ContactGroup], feet: set[int]
) -> tuple[str, ...]:
    """Return the names of the judged sets of contact constants that feet have on the ground."""
    rows = [row for row in _ground_rows(pairs) if set(pairs.geoms[row].tolist()) & feet]
    own = [contact_settings(model, pairs.constants[row]) for row in rows]
    names: dict[str, str] = {}
    for group in groups:
        # Groups with the same settings are one set, with the name of the first.
        if group.is_used and group.settings in own:
            names.setdefault(repr(group.settings), group.geoms)
    return tuple(names.values())
