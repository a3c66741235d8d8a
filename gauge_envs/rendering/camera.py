"""The camera of a scene: it frames what is expected to move, and sees the motion from the side.

The expectation comes before the run: from the start, the drivers, strings and hinges, free flight, and the reference
where it is of positions. It decides the picture alone, so that a coarse guess is enough.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from gauge_envs.evaluation.reference_path import ReferencePath
from gauge_envs.rendering.expected import Expected, expected_motion
from gauge_envs.scene import Plane, Scene, SoftBody
from gauge_envs.scene.geometry import FloatArray

FIELD_OF_VIEW_DEG = 30.0
"""Vertical field of view of the camera [deg]."""
AZIMUTH_DEG = 125.0
"""Direction of a view without a plane of motion, anticlockwise from the x axis [deg]."""
OFF_AXIS_DEG = 32.0
"""Angle between the view and the normal of the plane of motion [deg]: bodies show two sides."""
ELEVATIONS_DEG = (-34.0, -13.0)
"""Elevation of the view for a flat action, and for one as high as wide [deg]."""
MARGIN = 0.07
"""Share of the picture between the action and each edge."""
MOST_PLACES = 400
"""About the largest number of places that are tested for what hides them."""
LEAST_SIZE_M = 0.08
"""Smallest extent that fills a picture [m]."""


@dataclass(frozen=True, kw_only=True)
class View:
    """A perspective camera without roll.

    Attributes:
        target_m: Point in the middle of the picture [m], shape [3].
        distance_m: Distance of the camera from it [m].
        azimuth_deg: Direction of the view in the level plane, anticlockwise from the x axis [deg].
        elevation_deg: Angle of the view above the level plane [deg]; negative from above.
    """

    target_m: FloatArray
    distance_m: float
    azimuth_deg: float
    elevation_deg: float

    @property
    def axes(self) -> FloatArray:
        """Unit vectors to the right, up and into the picture, as rows, shape [3, 3]."""
        return _axes(self.azimuth_deg, self.elevation_deg)

    @property
    def eye_m(self) -> FloatArray:
        """Place of the camera [m], shape [3]."""
        return self.target_m - self.distance_m * self.axes[2]

    def pixels(self, points_m: FloatArray, *, width: int, height: int) -> FloatArray:
        """Return where points are in a picture: columns and rows [pixels], shape [point_count, 2].

        Args:
            points_m: Points in front of the camera [m], shape [point_count, 3].
            width: Picture width [pixels].
            height: Picture height [pixels].
        """
        x, y, depth = ((points_m - self.eye_m) @ self.axes.T).T
        scale = 0.5 * height / np.tan(np.radians(0.5 * FIELD_OF_VIEW_DEG)) / depth
        return np.column_stack([0.5 * width + scale * x, 0.5 * height - scale * y])

    def mujoco_camera(self) -> mujoco.MjvCamera:
        """Return the camera for MuJoCo's renderer."""
        camera = mujoco.MjvCamera()
        camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        camera.lookat[:] = self.target_m
        camera.distance = self.distance_m
        camera.azimuth, camera.elevation = self.azimuth_deg, self.elevation_deg
        return camera


def scene_view(scene: Scene, *, aspect: float = 4.0 / 3.0, reference: ReferencePath | None = None) -> View:
    """Return the view that shows the expected action of a scene as large as it fits.

    Args:
        scene: The scene.
        aspect: Width of the picture over its height.
        reference: Places of the reference, or None.
    """
    expected = expected_motion(scene, reference)
    points = expected.points_m
    extent = np.ptp(points, axis=0)
    flatness = extent[2] / max(float(np.hypot(*extent[:2])), 1e-9)
    low, high = ELEVATIONS_DEG
    elevation = low + (high - low) * min(flatness / 0.7, 1.0)
    azimuth = _azimuth_deg(scene, expected, elevation)
    return _fitted(points, azimuth, elevation, aspect)


def _axes(azimuth_deg: float, elevation_deg: float) -> FloatArray:
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    forward = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
    right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
    return np.array([right, np.cross(right, forward), forward])


def _fitted(points_m: FloatArray, azimuth_deg: float, elevation_deg: float, aspect: float) -> View:
    """Return the nearest view in which all points are inside the margin.

    Each of two opposite sides of the frustum bounds the depth of the camera; the stricter pair decides, and the other
    one is centred.
    """
    axes = _axes(azimuth_deg, elevation_deg)
    middle = 0.5 * (points_m.min(axis=0) + points_m.max(axis=0))
    places = (points_m - middle) @ axes.T
    half = np.array([aspect, 1.0]) * np.tan(np.radians(0.5 * FIELD_OF_VIEW_DEG)) * (1.0 - 2.0 * MARGIN)
    across, depth = places[:, :2], places[:, 2:]
    highest, lowest = (across + half * depth).min(axis=0), (across - half * depth).max(axis=0)
    near = min(float(((highest - lowest) / (2.0 * half)).min()), float(depth.min()) - 0.5 * LEAST_SIZE_M / half[1])
    # The view is centred where its sides touch the points at this depth.
    centre = 0.5 * ((across - half * (depth - near)).max(axis=0) + (across + half * (depth - near)).min(axis=0))
    eye = middle + np.array([*centre, near]) @ axes
    distance = -near
    return View(
        target_m=eye + distance * axes[2], distance_m=distance, azimuth_deg=azimuth_deg, elevation_deg=elevation_deg
    )


def _azimuth_deg(scene: Scene, expected: Expected, elevation_deg: float) -> float:
    """Return the azimuth from which the motion is seen side-on and the fewest of its places and markers are hidden."""
    across = expected.across
    if across is None:
        candidates = [AZIMUTH_DEG + turn for turn in (0.0, 180.0, 90.0, -90.0)]
    else:
        normal = float(np.degrees(np.arctan2(across[1], across[0])))
        candidates = [normal + side + turn for side in (0.0, 180.0) for turn in (OFF_AXIS_DEG, -OFF_AXIS_DEG)]
    candidates.sort(key=lambda angle: abs((angle - AZIMUTH_DEG + 180.0) % 360.0 - 180.0))
    forwards = [_axes(angle, elevation_deg)[2] for angle in candidates]
    hidden = [_hidden_share(scene, expected, forward) + _hidden_markers(scene, forward) for forward in forwards]
    # Python's minimum is the first of equals, the one nearest to the usual direction.
    return candidates[int(np.argmin(hidden))]


def _hidden_share(scene: Scene, expected: Expected, forward: FloatArray) -> float:
    """Return the share of the places of moving bodies that a still body covers, seen along a direction."""
    places = expected.places_m[:: -(-len(expected.places_m) // MOST_PLACES)]
    hidden = np.zeros(len(places), dtype=np.bool_)
    for body in scene.bodies:
        if body.name in expected.movers or isinstance(body.shape, Plane):
            continue
        corners = body.shape.corners_m
        starts, way = body.pose.to_body(places), body.pose.rotation.apply(-forward, inverse=True)
        hidden |= _meets_box(starts, way, corners.min(axis=0), corners.max(axis=0))
    return float(hidden.mean())


def _hidden_markers(scene: Scene, forward: FloatArray) -> float:
    """Return the share of the markers that are on the far sides of soft bodies, seen along a direction."""
    if scene.markers is None:
        return 0.0
    places = np.array(scene.markers.positions_m)
    hidden = np.zeros(len(places), dtype=np.bool_)
    for body in scene.deformables:
        if isinstance(body, SoftBody):
            corners = body.shape.corners_m
            starts, way = body.pose.to_body(places), body.pose.rotation.apply(-forward, inverse=True)
            # A little smaller than the body, so that a marker on a near side does not hide itself.
            hidden |= _meets_box(starts, way, 0.98 * corners.min(axis=0), 0.98 * corners.max(axis=0))
    return float(hidden.mean())


def _meets_box(starts: FloatArray, way: FloatArray, low: FloatArray, high: FloatArray) -> NDArray[np.bool_]:
    """Return which rays from points along one direction meet a box; a ray that starts inside does."""
    way = np.where(np.abs(way) < 1e-12, 1e-12, way)
    first, second = (low - starts) / way, (high - starts) / way
    enter, leave = np.minimum(first, second).max(axis=1), np.maximum(first, second).min(axis=1)
    return np.asarray((leave > np.maximum(enter, 0.0)) & (leave > 0.0))
