"""Shapes that are added to a picture after its bodies: tubes, balls and translucent copies of bodies."""

from __future__ import annotations

from itertools import pairwise

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.envs.rendering.overlay import RECORDED_COLOR, SIMULATED_COLOR, Color, Overlay
from gauge_envs.errors import UnknownNameError

FloatArray = NDArray[np.float64]

MARKER_PX = 4.0
"""Radius of a marker [pixels]."""
RECORDED_MARKER_PX = 3.4
"""Radius of a marker of the reference [pixels]: where a simulation follows it, its own marker covers it."""
PATH_PX = 1.6
"""Radius of the tube of a path [pixels]."""
RECORDED_PATH_PX = 1.3
"""Radius of a path in the colour of the reference [pixels]: where a simulation follows it, its own path covers it."""
GHOST_AHEAD_PX = 3.0
"""Distance by which a ghost is drawn nearer to the camera than it is [pixels].

Surfaces of a ghost and its body that coincide are at the same depth, so that rounding would decide for each pixel, and
differently in each picture, which one is in front. A ghost that is displaced by less than can be seen is in front.
"""


def add_tube(drawing: mujoco.MjvScene, start: FloatArray, end: FloatArray, *, radius_m: float, color: Color) -> None:
    """Add a straight tube with round ends between two points [m], shape [3] each."""
    kind = mujoco.mjtGeom.mjGEOM_CAPSULE
    geom = _next_geom(drawing)
    mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(), np.array(color, dtype=np.float32))
    mujoco.mjv_connector(geom, kind, radius_m, start, end)


def add_ball(drawing: mujoco.MjvScene, centre: FloatArray, *, radius_m: float, color: Color) -> None:
    """Add a ball around a point [m], shape [3]."""
    kind = mujoco.mjtGeom.mjGEOM_SPHERE
    geom = _next_geom(drawing)
    size = np.full(3, radius_m)
    mujoco.mjv_initGeom(geom, kind, size, centre, np.eye(3).ravel(), np.array(color, dtype=np.float32))
    # Light of its own keeps the colour of a small ball readable in the shade.
    geom.emission = 0.4


def overlay_geom_count(model: mujoco.MjModel, overlay: Overlay) -> int:
    """Return the number of shapes of an overlay."""
    return overlay.geom_count + sum(int(model.body(_known(model, name)).geomnum[0]) for name in overlay.ghosts)


def add_overlay(drawing: mujoco.MjvScene, model: mujoco.MjModel, overlay: Overlay, *, pixel_m: float) -> None:
    """Add an overlay to a drawing that has room for `overlay_geom_count` more shapes.

    Args:
        drawing: The drawing.
        model: Model of the bodies.
        overlay: The overlay.
        pixel_m: Size of a pixel in the middle of the scene [m]. Balls and tubes have the same size in pixels there,
            whatever the size of the scene.
    """
    for points, color, radius_px in (
        (overlay.recorded_m, RECORDED_COLOR, RECORDED_MARKER_PX),
        (overlay.markers_m, SIMULATED_COLOR, MARKER_PX),
    ):
        for point in points[np.isfinite(points).all(axis=1)]:
            add_ball(drawing, point, radius_m=radius_px * pixel_m, color=color)
    for path in overlay.paths:
        known = np.asarray(np.isfinite(path.points_m).all(axis=1))
        radius_m = pixel_m * (RECORDED_PATH_PX if path.color == RECORDED_COLOR else PATH_PX)
        for (start, end), both_known in zip(pairwise(path.points_m), known[1:] & known[:-1], strict=True):
            if both_known:
                add_tube(drawing, start, end, radius_m=radius_m, color=path.color)
                drawing.geoms[drawing.ngeom - 1].emission = 0.4
    for name, pose in overlay.ghosts.items():
        if np.isfinite(pose).all():
            ahead = GHOST_AHEAD_PX * pixel_m * _to_camera(drawing, pose[:3])
            _add_ghost(drawing, model, name, np.concatenate([pose[:3] + ahead, pose[3:]]), overlay.ghost_color)


def _to_camera(drawing: mujoco.MjvScene, point_m: FloatArray) -> FloatArray:
    """Return the unit vector from a point [m] to the camera of a drawing, shape [3]."""
    # A drawing has a camera for each eye; a picture is taken from between them.
    left, right = drawing.camera
    way = -left.forward.astype(np.float64) if left.orthographic else 0.5 * (left.pos + right.pos) - point_m
    unit: FloatArray = way / np.linalg.norm(way)
    return unit


def _add_ghost(drawing: mujoco.MjvScene, model: mujoco.MjModel, name: str, pose: FloatArray, color: Color) -> None:
    turn = Rotation.from_quat(pose[3:], scalar_first=True)
    body = model.body(_known(model, name))
    for index in range(int(body.geomadr[0]), int(body.geomadr[0] + body.geomnum[0])):
        place = pose[:3] + turn.apply(model.geom_pos[index])
        axes = (turn * Rotation.from_quat(model.geom_quat[index], scalar_first=True)).as_matrix()
        geom = _next_geom(drawing)
        kind = mujoco.mjtGeom(int(model.geom_type[index]))
        rgba = np.array(color, dtype=np.float32)
        mujoco.mjv_initGeom(geom, kind, model.geom_size[index], place, axes.ravel(), rgba)
        if kind == mujoco.mjtGeom.mjGEOM_MESH:
            # A drawing numbers each mesh twice: as itself, then as its convex hull.
            geom.dataid = 2 * int(model.geom_dataid[index])


def _known(model: mujoco.MjModel, name: str) -> str:
    names = [model.body(index).name for index in range(1, model.nbody)]
    if name not in names:
        raise UnknownNameError("body", name, names)
    return name


def _next_geom(drawing: mujoco.MjvScene) -> mujoco.MjvGeom:
    geom = drawing.geoms[drawing.ngeom]
    drawing.ngeom += 1
    return geom
