"""Read the foot of a robot in a MuJoCo model: its solids, and the mass that it carries."""

from collections.abc import Callable, Mapping, Sequence

import mujoco
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from gauge_envs.backends.mujoco.contact_table import COLUMNS, contact_settings
from gauge_envs.scene import (
    Box,
    Capsule,
    ConvexUnion,
    Cylinder,
    Ellipsoid,
    Part,
    Pose,
    Sphere,
)
from gauge_envs.scene.geometry import vector
from gauge_envs.tools.sanity.robot.foot import COPIES, FootGeometry
from gauge_envs.tools.sanity.robot.robot import Robot, geom_name, listed, name_of
from gauge_envs.tools.sanity.robot.standing import (
    NoFootError,
    geom_kind,
    mesh_vertices_m,
)
from gauge_envs.tools.sanity.training import ContactGroup

Solid = Box | Sphere | Cylinder | Capsule | Ellipsoid | ConvexUnion

SOLIDS: Mapping[str, Callable[..., Solid]] = {
    "SPHERE": lambda x, *_: Sphere(radius_m=x),
    "CAPSULE": lambda x, y, _: Capsule(radius_m=x, length_m=2.0 * y),
    "ELLIPSOID": lambda *radii: Ellipsoid(radii_m=radii),
    "CYLINDER": lambda x, y, _: Cylinder(radius_m=x, length_m=2.0 * y),
    "BOX": lambda x, y, z: Box(size_m=(2.0 * x, 2.0 * y, 2.0 * z)),
}
"""Solid of a size for each type of geom of a foot, except meshes."""


def read_foot(robot: Robot, groups: Sequence[ContactGroup]) -> FootGeometry:
    """Return the lowest foot of a robot that stands.

    Args:
        robot: The robot.
        groups: Contact constants; those that are checked are marked as used.

    Raises:
        NoFootError: It does not stand, or the scenes cannot have its foot.
    """
    model, standing = robot.model, robot.standing
    if standing is None:
        raise NoFootError("the robot does not stand")
    support, feet = standing.support_m, standing.feet
    body, lowest = min(
        ((body, geom) for body, geoms in feet.items() for geom in geoms),
        key=lambda sole: (support[sole[1]][2], sole[0]),
    )
    mass_kg = float(model.body_subtreemass[standing.body])
    load_kg = mass_kg / len(feet)
    constants = robot.pairs.constants[robot.foot_rows]
    settings = [contact_settings(model, row) for row in constants]
    names: dict[str, str] = {}
    for group in groups:
        # Groups with the same settings are one set, with the name of the first.
        if group.is_used and group.settings in settings:
            names.setdefault(repr(group.settings), group.geoms)
    is_its = np.isin(robot.pairs.geoms[robot.foot_rows], feet[body]).any(axis=1)
    stance, texts, parts = robot.stance, [], []
    for geom in feet[body]:
        texts.append(f"{geom_name(model, geom)} ({geom_kind(model, geom).lower()})")
        place_m = vector(stance.positions_m[geom] - support[lowest])
        pose = Pose.from_rotation(place_m, stance.rotations[geom])
        parts.append(Part(shape=_solid(model, geom), pose=pose))
    return FootGeometry(
        name=name_of(model, "body", body),
        geoms=listed(texts),
        parts=tuple(parts),
        load_kg=load_kg,
        sets=tuple(names.values()),
        softening=float(model.body_invweight0[body, 0]) * COPIES * load_kg,
        friction=float(constants[is_its, COLUMNS["friction"].start].min()),
    )


def _solid(model: mujoco.MjModel, geom: int) -> Solid:
    kind = geom_kind(model, geom)
    if kind in SOLIDS:
        return SOLIDS[kind](*model.geom_size[geom].tolist())
    if kind != "MESH":
        raise NoFootError(
            f"the foot is a geom of type {kind.lower()}, which the scenes cannot have"
        )
    points_m = mesh_vertices_m(model, geom)
    try:
        hull = points_m[ConvexHull(points_m).vertices]
    except QhullError:
        raise NoFootError(
            "the foot is a flat mesh, which the scenes cannot have"
        ) from None
    return ConvexUnion(pieces_m=(tuple(vector(point) for point in hull),))
