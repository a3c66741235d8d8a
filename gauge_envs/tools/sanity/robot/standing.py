"""Find the robot of a model that stands on the ground, and its feet."""

import mujoco
import numpy as np

from gauge_envs.backends.mujoco.contact_table import can_move
from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.sanity.robot.robot import (
    Robot,
    Standing,
    chain_of,
    joints_of,
    joints_of_motors,
    unheld,
)

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
