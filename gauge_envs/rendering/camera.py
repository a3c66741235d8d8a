"""Camera of pictures: the camera of the task, or a view of the start and the motion."""

from fnmatch import fnmatchcase

import mujoco
import numpy as np

from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.tables import FileModel, read_toml, scoring_folder
from gauge_envs.scene import Hinge, Plane, Scene
from gauge_envs.scene.geometry import FloatArray, Positive, Vector, length_of, vector
from gauge_envs.scene.meshes import outline_m

FIELD_OF_VIEW_DEG = 30.0
"""Vertical field of view [deg]."""
TASK_ASPECT = 4.0 / 3.0
"""Aspect ratio of pictures for which the cameras of tasks are chosen."""

# --- view of a scene without a camera ---

AZIMUTH_DEG = 125.0
ELEVATION_DEG = -18.0
OFF_AXIS_DEG = 20.0
"""Angle between the view and the axis of a swing [deg]; bodies then show two sides."""
MARGIN = 1.25
"""Radius of the sphere that fills the height of a picture, over the radius of the sphere around all places."""
MIN_RADIUS_M = 0.04
"""Smallest radius of the sphere around all places [m]."""
FLOOR_IN_VIEW_M = 0.6
"""Largest distance of the floor below all bodies at which the picture includes it [m]."""


class View(FileModel):
    """A perspective camera without roll.

    Attributes:
        target_m: Point in the centre of the picture [m].
        distance_m: Distance of the camera from the target [m].
        azimuth_deg: Direction of the view in the level plane, anticlockwise from the x axis [deg].
        elevation_deg: Angle of the view above the level plane [deg]; negative from above.
    """

    target_m: Vector
    distance_m: Positive
    azimuth_deg: float
    elevation_deg: float

    @property
    def axes(self) -> FloatArray:
        """Unit vectors to the right, up and into the picture, as rows, shape [3, 3]."""
        azimuth, elevation = np.radians([self.azimuth_deg, self.elevation_deg])
        level = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        forward = np.cos(elevation) * level + [0.0, 0.0, np.sin(elevation)]
        right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
        return np.array([right, np.cross(right, forward), forward])

    @property
    def height_m(self) -> float:
        """Height of the picture at the distance of the target [m]."""
        half_angle = np.radians(0.5 * FIELD_OF_VIEW_DEG)
        return 2.0 * self.distance_m * float(np.tan(half_angle))


class CameraFile(FileModel):
    """Content of `scoring/cameras.toml`.

    Attributes:
        camera: Camera by the name of the task, which may have wildcards.
    """

    camera: dict[str, View]


def free_camera(view: View) -> mujoco.MjvCamera:
    """Return MuJoCo's camera for a view."""
    camera = mujoco.MjvCamera()
    camera.lookat[:] = view.target_m
    camera.distance = view.distance_m
    camera.azimuth = view.azimuth_deg
    camera.elevation = view.elevation_deg
    return camera


def experiment_view(
    experiment: Experiment,
    *,
    aspect: float = TASK_ASPECT,
    places_m: FloatArray | None = None,
) -> View:
    """Return the camera of an experiment, or a view of its scene if it has none.

    Args:
        experiment: The experiment.
        aspect: Width of the picture over its height; the camera moves away for a narrow one.
        places_m: Further places in the view of a scene [m], shape [..., 3]; NaN if unknown.
    """
    cameras = read_toml(scoring_folder("cameras.toml"), CameraFile).camera
    task_views = [
        view
        for pattern, view in cameras.items()
        if fnmatchcase(experiment.name, pattern)
    ]
    view = task_views[0] if task_views else scene_view(experiment.scene, places_m)
    distance_m = view.distance_m * max(TASK_ASPECT / aspect, 1.0)
    return view.model_copy(update={"distance_m": distance_m})


def scene_view(scene: Scene, places_m: FloatArray | None = None) -> View:
    """Return a view of all bodies at the start and of their motion.

    Args:
        scene: The scene.
        places_m: Further places in the view [m], shape [..., 3]; NaN if unknown.
    """
    points_m = _places_in_view_m(scene)
    if places_m is not None:
        points_m = np.concatenate([points_m, places_m.reshape(-1, 3)])
    low_m, high_m = np.nanmin(points_m, axis=0), np.nanmax(points_m, axis=0)
    radius_m = max(0.5 * length_of(high_m - low_m), MIN_RADIUS_M)
    azimuth_deg = AZIMUTH_DEG
    for joint in scene.joints:
        axis = joint.axis if isinstance(joint, Hinge) else (0.0, 1.0, 0.0)
        azimuth_deg = float(np.degrees(np.arctan2(axis[1], axis[0]))) + OFF_AXIS_DEG
    return View(
        target_m=vector(0.5 * (low_m + high_m)),
        distance_m=MARGIN * radius_m / np.sin(np.radians(0.5 * FIELD_OF_VIEW_DEG)),
        azimuth_deg=azimuth_deg,
        elevation_deg=ELEVATION_DEG,
    )


def _places_in_view_m(scene: Scene) -> FloatArray:
    """Return corners at the start, ends of driven motion and of swings, and the floor below, shape [n, 3]."""
    points = [outline_m(soft) for soft in scene.deformables]
    for body in scene.bodies:
        if not isinstance(body.shape, Plane):
            points.append(body.pose.to_world(body.shape.corners_m))
    for driver in scene.drivers:
        body = scene.body(driver.body)
        end = driver.pose(body.pose, scene.duration_s)
        points.append(end.to_world(body.shape.corners_m))
    for joint in scene.joints:
        anchor_m = np.asarray(joint.anchor_m)
        arm_m = length_of(anchor_m - scene.body(joint.body).pose.position_m)
        points.append(anchor_m + arm_m * np.vstack([np.eye(3)[:2], -np.eye(3)]))
    points_m = np.concatenate(points)
    lowest_m = points_m.min(axis=0)
    if scene.dynamic_bodies and not scene.joints:
        fall_m = lowest_m[2] - scene.floor_height_m
        if 0.0 < fall_m < FLOOR_IN_VIEW_M:
            floor_m = np.array([[*lowest_m[:2], scene.floor_height_m]])
            return np.concatenate([points_m, floor_m])
    return points_m
