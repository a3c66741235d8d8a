"""The camera of pictures: `scoring/cameras.toml` for tasks, and a rule for all other scenes."""

import mujoco
import numpy as np

from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.tables import Camera
from gauge_envs.rendering.reference_path import ReferencePath
from gauge_envs.scene import Hinge, Plane, Scene
from gauge_envs.scene.geometry import FloatArray, length_of, vector
from gauge_envs.scene.meshes import outline_m

FIELD_OF_VIEW_DEG = 30.0
"""Vertical field of view of the camera [deg]."""
TABLE_ASPECT = 4.0 / 3.0
"""Least width over height of pictures that show all that the cameras of the table frame."""

# --- the rule for scenes without a camera in the table ---

AZIMUTH_DEG = 125.0
ELEVATION_DEG = -18.0
OFF_AXIS_DEG = 20.0
"""Angle between the view and the axis of a swing [deg]: the swing is seen nearly face on, and bodies show two sides."""
ROOM = 1.25
"""Radius of the sphere that fills the height of a picture, over that of the sphere around the scene."""
LEAST_RADIUS_M = 0.04
"""Smallest radius of the sphere around a scene [m]."""
FLOOR_IN_VIEW_M = 0.6
"""Largest distance of the floor below all bodies at which it is in the picture [m]."""


class View(Camera):
    """A perspective camera, and where it sees points."""

    @property
    def axes(self) -> FloatArray:
        """Unit vectors to the right, up and into the picture, as rows, shape [3, 3]."""
        azimuth, elevation = np.radians([self.azimuth_deg, self.elevation_deg])
        level = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        forward = np.cos(elevation) * level + [0.0, 0.0, np.sin(elevation)]
        right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
        return np.array([right, np.cross(right, forward), forward])

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
        camera.azimuth = self.azimuth_deg
        camera.elevation = self.elevation_deg
        return camera


def experiment_view(
    experiment: Experiment,
    *,
    aspect: float = TABLE_ASPECT,
    reference: ReferencePath | None = None,
) -> View:
    """Return the view of an experiment: that of its camera, else that of the rule.

    Args:
        experiment: The experiment.
        aspect: Width of the picture over its height; a narrow one is taken from further away.
        reference: Places that the rule frames beside those of the scene, or None.
    """
    camera = experiment.camera
    view = (
        scene_view(experiment.scene, reference=reference)
        if camera is None
        else View(**camera.model_dump())
    )
    if aspect >= TABLE_ASPECT:
        return view
    return view.model_copy(
        update={"distance_m": view.distance_m * TABLE_ASPECT / aspect}
    )


def scene_view(scene: Scene, *, reference: ReferencePath | None = None) -> View:
    """Return the view that shows the bodies at the start, and where they can go, by a rule.

    Args:
        scene: The scene.
        reference: Further places that are shown, or None.
    """
    points = [_start_and_reach_m(scene)]
    if reference is not None:
        known = np.isfinite(reference.places_m).all(axis=2)
        points.append(reference.places_m[known])
    corners = np.concatenate(points)
    low, high = corners.min(axis=0), corners.max(axis=0)
    radius = max(0.5 * length_of(high - low), LEAST_RADIUS_M)
    azimuth_deg = AZIMUTH_DEG
    for joint in scene.joints:
        axis = joint.axis if isinstance(joint, Hinge) else (0.0, 1.0, 0.0)
        azimuth_deg = float(np.degrees(np.arctan2(axis[1], axis[0]))) + OFF_AXIS_DEG
    return View(
        target_m=vector(0.5 * (low + high)),
        distance_m=ROOM * radius / np.sin(np.radians(0.5 * FIELD_OF_VIEW_DEG)),
        azimuth_deg=azimuth_deg,
        elevation_deg=ELEVATION_DEG,
    )


def _start_and_reach_m(scene: Scene) -> FloatArray:
    """Return corners at the start, ends of driven motion and of swings, and the floor below, shape [point_count, 3]."""
    points = [np.zeros((0, 3))]
    for body in scene.bodies:
        if not isinstance(body.shape, Plane):
            points.append(body.pose.to_world(body.shape.corners_m))
    for soft in scene.deformables:
        points.append(outline_m(soft))
    for driver in scene.drivers:
        carrier = scene.body(driver.body)
        end = driver.pose(carrier.pose, scene.duration_s)
        way_m = np.subtract(end.position_m, carrier.pose.position_m)
        points.append(carrier.pose.to_world(carrier.shape.corners_m) + way_m)
        carried = {
            attachment.deformable
            for attachment in scene.attachments
            if attachment.to == driver.body
        }
        for soft in scene.deformables:
            if soft.name in carried:
                points.append(outline_m(soft) + way_m)
    for joint in scene.joints:
        anchor = np.asarray(joint.anchor_m)
        arm_m = np.linalg.norm(anchor - scene.body(joint.body).pose.position_m)
        axis = np.asarray(joint.axis if isinstance(joint, Hinge) else (0.0, 1.0, 0.0))
        sideways = np.cross(axis, (0.0, 0.0, 1.0))
        points.append(
            anchor
            + arm_m * np.array([sideways, -sideways, (0.0, 0.0, -1.0), (0.0, 0.0, 0.0)])
        )
    corners = np.concatenate(points)
    if not len(corners):
        return np.zeros((1, 3))
    hanging = {joint.body for joint in scene.joints}
    can_fall = any(body.name not in hanging for body in scene.dynamic_bodies)
    lowest = corners.min(axis=0)
    if can_fall and 0.0 < lowest[2] - scene.floor_height_m < FLOOR_IN_VIEW_M:
        corners = np.concatenate(
            [corners, [[lowest[0], lowest[1], scene.floor_height_m]]]
        )
    return corners
