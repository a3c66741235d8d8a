"""Find the robot of a model that stands on the ground, and its feet."""

import mujoco
import numpy as np

from gauge_envs.backends.mujoco.contact_table import can_move
from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.tools.sanity.robot.robot import (
    Robot,
    Standing,
    chain_of,
    joints_of,
    joints_of_motors,
)

STANDS_WITHIN = 0.1
"""Height above the lowest point, over the height of the robot, up to which a body counts as standing."""

SOLE_WITHIN = 0.01
"""Height above the lowest point of a foot, over the height of the robot, up to which a geom is part of its sole."""

UPRIGHT = 0.7
"""Smallest vertical component of a slide joint with which a robot can rise and fall."""

FLAT = 1e-3
"""Component of a unit vector below which a face or an edge counts as level."""

MIN_FALL_M_PER_S = 1e-3
"""Speed of falling below which the damping of a joint holds a robot [m/s]."""

LIQUID_KG_PER_M3 = 10.0
"""Density of the medium above which a robot swims; air has 1.2 [kg/m^3]."""


class NoFootError(Exception):
    """A model has no foot; the message is the reason."""


def find_standing(robot: Robot) -> Standing:
    """Return the heaviest robot of a model that stands, with its feet.

    A robot can rise and fall: its first joint is free, or a vertical slide that nothing drives or holds. It has an
    actuator, or joints in a model without actuators. Its feet are the lowest bodies in its pose that can touch the
    ground.

    Raises:
        NoFootError: There is none.
    """
    model, stance = robot.model, robot.stance
    geoms = np.unique(robot.pairs.geoms[robot.ground_rows])
    touching = geoms[can_move(model)[geoms]].tolist()
    if not touching:
        raise NoFootError("the model has no ground that a moving geom can touch")
    if model.opt.density > LIQUID_KG_PER_M3:
        raise NoFootError("the robot swims: the model's medium is a liquid")
    trees, moved = model.body_treeid[model.geom_bodyid], robot.driven_trees
    standing = [
        int(model.tree_bodyadr[tree])
        for tree in set(trees[touching].tolist())
        # A free box is a body; a robot has motors, or joints in a model without motors.
        if (tree in moved if moved else model.tree_bodynum[tree] > 1)
        and _can_fall(robot, int(model.tree_bodyadr[tree]))
    ]
    if not standing:
        raise NoFootError(
            "no robot of the model stands on the ground under its own weight"
        )
    base = max(standing, key=lambda body: (model.body_subtreemass[body], -body))
    is_part = trees == model.body_treeid[base]
    support = {geom: support_m(robot, geom) for geom in touching if is_part[geom]}
    ground_m = min(float(point[2]) for point in support.values())
    tops_m = stance.positions_m[is_part, 2] + model.geom_rbound[is_part]
    height_m = max(float(tops_m.max()) - ground_m, 1e-3)
    bodies: dict[int, list[int]] = {}
    for geom, point in support.items():
        if point[2] <= ground_m + STANDS_WITHIN * height_m:
            bodies.setdefault(int(model.geom_bodyid[geom]), []).append(geom)
    # A body that carries a standing body is no foot.
    for carrying in {parent for body in bodies for parent in chain_of(model, body)[1:]}:
        bodies.pop(carrying, None)
    feet = {}
    for body, body_geoms in bodies.items():
        sole_m = min(support[geom][2] for geom in body_geoms) + SOLE_WITHIN * height_m
        feet[body] = [geom for geom in body_geoms if support[geom][2] <= sole_m]
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
    falls |= joints_of(model, "FREE")
    return bool(falls[model.jnt_bodyid == body].any())


def support_m(robot: Robot, geom: int) -> FloatArray:
    """Return the lowest point of a geom [m], the middle of a lowest face or edge, shape [3]."""
    model, stance = robot.model, robot.stance
    down = -stance.rotations[geom].as_matrix()[2]
    down[np.abs(down) < FLAT] = 0.0
    size, kind = model.geom_size[geom], geom_kind(model, geom)
    # A sphere is a capsule without length.
    end = np.array([0.0, 0.0, size[1] * np.sign(down[2])])
    point = size[0] * down + end
    if kind == "CYLINDER":
        aside = down * [1.0, 1.0, 0.0]
        point = size[0] * aside / max(length_of(aside), FLAT) + end
    elif kind == "ELLIPSOID":
        point = size**2 * down / length_of(size * down)
    elif kind == "BOX":
        point = size * np.sign(down)
    elif kind == "MESH":
        vertices = mesh_vertices_m(model, geom)
        depths = vertices @ down
        is_deep = depths > depths.max() - FLAT * model.geom_rbound[geom]
        point = vertices[is_deep].mean(axis=0)
    return stance.positions_m[geom] + stance.rotations[geom].apply(point)


def geom_kind(model: mujoco.MjModel, geom: int) -> str:
    """Return the type of a geom, such as `SPHERE`."""
    return str(mujoco.mjtGeom(int(model.geom_type[geom])).name).removeprefix("mjGEOM_")


def mesh_vertices_m(model: mujoco.MjModel, geom: int) -> FloatArray:
    """Return the vertices of the mesh of a geom in the frame of the geom [m], shape [vertex_count, 3]."""
    mesh = model.geom_dataid[geom]
    first = model.mesh_vertadr[mesh]
    return model.mesh_vert[first : first + model.mesh_vertnum[mesh]].astype(np.float64)
