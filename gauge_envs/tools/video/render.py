"""Film an episode of an engine from where the first frame of its task was taken, so that the clip can be scored.

The view is a parallel projection with the scale, the place and the direction of the task's first frame. A clip comes
with the exact track of the object, which the tracker has to find.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends import Simulation
from gauge_envs.backends.registry import backend as backend_named
from gauge_envs.envs.driver_paths import DriverPaths
from gauge_envs.errors import ParameterError, UnsupportedSceneError
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.rendering.flat import FlatView
from gauge_envs.rendering.renderer import SceneRenderer
from gauge_envs.scene import Hinge, Motion as BodyMotion, RigidBody, Scene
from gauge_envs.scene.geometry import FloatArray, vector_quaternions
from gauge_envs.scene.jitter import swung
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S
from gauge_envs.tools.video.tasks import (
    REFERENCE_SIZE_PX,
    Motion,
    VideoTask,
    video_task,
)
from gauge_envs.tools.video.track import Track, save_track
from gauge_envs.tools.video.writer import film_writer

SAMPLE_RATE_HZ = round(1.0 / SAMPLE_INTERVAL_S)
"""Rate at which an engine is read [Hz]."""

MOST_SECONDS = 60.0
"""Longest film [s]."""

MIDDLE_PX = 0.5 * (np.array(REFERENCE_SIZE_PX) - 1.0)
"""Middle of a picture [px]; the first pixel has its centre at 0."""

DARK = (0.09, 0.09, 0.10, 1.0)
COLORS = {
    "wood": (0.80, 0.62, 0.42, 1.0),
    "plastic": (0.16, 0.17, 0.20, 1.0),
    "metal": (0.78, 0.76, 0.78, 1.0),
}
"""Colours of the cubes by material; balls are dark, as in the first frames."""


@dataclass(frozen=True, kw_only=True)
class Film:
    """A filmed episode.

    Attributes:
        task: The task.
        fps: Frames per second.
        pictures: Pictures in red, green and blue, each of shape [480, 832, 3].
        track: Exact track of the object.
    """

    task: VideoTask
    fps: float
    pictures: tuple[NDArray[np.uint8], ...]
    track: Track

    def save(self, path: Path) -> Path:
        """Write the film as MP4 and its exact track beside it, as `NAME.track.csv`; return the path of the track."""
        with film_writer(path, size=REFERENCE_SIZE_PX, fps=self.fps) as writer:
            for picture in self.pictures:
                writer.add(picture)
        return save_track(self.track, path.with_suffix(".track.csv"))


def film(
    task: str,
    *,
    backend: str = "mujoco",
    parameters: str | Mapping[str, Any] = "calibrated",
    settings: Mapping[str, Any] | None = None,
    fps: float = 30.0,
    seconds: float | None = None,
    release_s: float = 0.3,
    seed: int = 0,
) -> Film:
    """Film an episode of an engine.

    Args:
        task: Id of a task, as `SlopeSlider-2-wood`.
        backend: Engine.
        parameters: Parameter set or overrides, as for `gauge_envs.load_experiment`.
        settings: Numerical settings of the engine.
        fps: Frames per second; divides 180.
        seconds: Time from the release to the end [s]; None for the whole experiment, at most 8 s.
        release_s: Time at which the held object is released [s], rounded to 1/180 s. It may fall between two frames.
        seed: Seed of the engine.
    """
    chosen = video_task(task)
    samples_per_frame = SAMPLE_RATE_HZ / fps if fps > 0.0 else 0.0
    if samples_per_frame < 1.0 or samples_per_frame != int(samples_per_frame):
        raise ParameterError(
            f"fps is {fps:g}: it must divide {SAMPLE_RATE_HZ}, as 15, 30 or 60"
        )
    scene = _as_in_first_frame(load_experiment(task, parameters).scene, chosen)
    lasts_s = min(scene.duration_s, 8.0) if seconds is None else seconds
    if not 0.0 < lasts_s <= MOST_SECONDS:
        raise ParameterError(
            f"seconds is {lasts_s:g}: it must be more than 0 and at most {MOST_SECONDS:g}"
        )
    if not 0.0 <= release_s <= MOST_SECONDS:
        raise ParameterError(
            f"release_s is {release_s:g}: it must be from 0 to {MOST_SECONDS:g}"
        )
    engine = backend_named(backend)
    if missing := engine.supports(scene).missing:
        raise UnsupportedSceneError(engine.name, missing)
    simulation = engine.build(scene, settings)
    try:
        simulation.reset(seed)
        release_samples = round(release_s * SAMPLE_RATE_HZ)
        frames = list(
            _frames(
                simulation,
                scene,
                chosen,
                release_samples,
                round(lasts_s * SAMPLE_RATE_HZ),
                int(samples_per_frame),
            )
        )
    finally:
        simulation.close()
    track = Track(
        frames=np.arange(len(frames)),
        fps=float(fps),
        points_px=np.array([place for _, place in frames]),
        confidence=np.ones(len(frames)),
        size_ratio=np.ones(len(frames)),
    )
    return Film(
        task=chosen,
        fps=float(fps),
        pictures=tuple(picture for picture, _ in frames),
        track=track,
    )


def _frames(
    simulation: Simulation,
    scene: Scene,
    task: VideoTask,
    release_samples: int,
    count: int,
    samples_per_frame: int,
) -> Iterator[tuple[NDArray[np.uint8], FloatArray]]:
    """Yield pictures, and the place of the object in each [px]; a frame is exposed in the first half of its time."""
    view = _view(scene, task)
    tracked = scene.dynamic_bodies[-1].name
    renderer = SceneRenderer(scene, {}, *REFERENCE_SIZE_PX, view=view)
    names = [body.name for body in scene.bodies if body.motion is not BodyMotion.FIXED]
    paths = DriverPaths(scene, (count + 1) * SAMPLE_INTERVAL_S)
    exposed = max(1, samples_per_frame // 2)
    pictures: list[NDArray[np.uint8]] = []
    places: list[FloatArray] = []
    try:
        for sample in range(release_samples + count):
            if sample > release_samples:
                paths.advance(simulation, sample - release_samples - 1)
            if sample % samples_per_frame < exposed:
                states = simulation.body_states(names)
                if sample <= release_samples and pictures:
                    pictures.append(pictures[-1])
                else:
                    pictures.append(
                        renderer.picture(
                            dict(zip(names, states[:, :7], strict=True)), {}
                        )
                    )
                away = (
                    states[names.index(tracked), :3] - view.centre_m
                ) / view.scale_m_per_px
                places.append(
                    np.array([away @ view.right, away @ view.down]) + MIDDLE_PX
                )
            if sample % samples_per_frame == exposed - 1:
                mean = np.mean(pictures, axis=0, dtype=np.float32)
                yield np.asarray(mean.round(), dtype=np.uint8), np.mean(places, axis=0)
                if sample >= release_samples:
                    pictures.clear()
                else:
                    pictures = pictures[-1:]
                places.clear()
    finally:
        renderer.close()


# --- where the first frame was taken ---------------------------------------------------------------------------------
# A task follows the last ball of a cradle, and the only dynamic body elsewhere.


def _as_in_first_frame(scene: Scene, task: VideoTask) -> Scene:
    """Return a scene that starts as the first frame shows it: its pendulum is held at a smaller angle."""
    if task.motion is not Motion.PENDULUM:
        return scene
    body = scene.dynamic_bodies[-1]
    hinge = _hinge(scene, body)
    assert task.pivot_px is not None
    across, down = np.subtract(task.centre_px, task.pivot_px)
    right = _sideways(hinge)
    arm = np.subtract(body.pose.position_m, hinge.anchor_m)
    wanted = np.arctan2(across, down)
    angle = wanted - np.arctan2(arm @ right, -arm[2])
    # A positive rotation about right x down moves a hanging ball to the left of the picture.
    rotation_rad = -angle * np.cross(right, (0.0, 0.0, -1.0))
    turn = vector_quaternions(rotation_rad[None])[0]
    started = swung(body, turn, np.asarray(hinge.anchor_m))
    return replace(
        scene,
        bodies=tuple(started if one.name == body.name else one for one in scene.bodies),
    )


def _view(scene: Scene, task: VideoTask) -> FlatView:
    """Return the parallel projection in which the scene starts where the first frame of the task shows it."""
    body = scene.dynamic_bodies[-1]
    seen_m, seen_px = np.asarray(body.pose.position_m), np.array(task.centre_px)
    scale_m_per_px = task.scale_m_per_px
    down = np.array([0.0, 0.0, -1.0])
    if task.motion is Motion.SLIDE:
        assert task.direction is not None
        normal = body.pose.matrix
        normal = normal[:, int(np.abs(normal[2]).argmax())]
        normal = normal * np.sign(normal[2])
        slide = down - (down @ normal) * normal
        slide /= np.linalg.norm(slide)
        x, y = task.direction
        # The normal of the board is up the picture, at a right angle to the direction of the slide.
        right, down = x * slide - y * normal, y * slide + x * normal
    elif task.motion is Motion.FALL:
        right = np.array([1.0, 0.0, 0.0])
    elif task.motion is Motion.TURN:
        assert task.pivot_px is not None
        plate = next(one for one in scene.bodies if one.motion is BodyMotion.KINEMATIC)
        arm = seen_m - plate.pose.position_m
        right = np.array([arm[0], arm[1], 0.0]) * np.sign(
            task.centre_px[0] - task.pivot_px[0]
        )
        right /= np.linalg.norm(right)
        down = np.cross((0.0, 0.0, -1.0), right)
    else:
        assert task.pivot_px is not None
        hinge = _hinge(scene, body)
        right = _sideways(hinge)
        if task.motion is Motion.CRADLE:
            first = scene.dynamic_bodies[0]
            arm = np.subtract(first.pose.position_m, _hinge(scene, first).anchor_m)
            right = -right * np.sign(arm @ right)
        seen_m, seen_px = np.asarray(hinge.anchor_m), np.array(task.pivot_px)
        if task.motion is Motion.PENDULUM:
            # The stated rod is 8 mm shorter than that of the first frame, in which the ball must be at its place.
            arm_m = np.linalg.norm(np.subtract(body.pose.position_m, seen_m))
            scale_m_per_px = float(arm_m) / math.dist(task.centre_px, task.pivot_px)
    offset_px = MIDDLE_PX - seen_px
    colors, grain = _colors(scene, task)
    return FlatView(
        centre_m=seen_m + scale_m_per_px * (offset_px[0] * right + offset_px[1] * down),
        right=right,
        down=down,
        scale_m_per_px=scale_m_per_px,
        colors=colors,
        grain=grain,
    )


def _colors(
    scene: Scene, task: VideoTask
) -> tuple[dict[str, tuple[float, float, float, float]], frozenset[str]]:
    """Return the colours of the moving bodies, and the names of those with a grain, by which a turning face is seen."""
    if task.motion in (Motion.SLIDE, Motion.TURN):
        body = scene.dynamic_bodies[-1].name
        return {body: COLORS[task.id.rsplit("-", 1)[1]]}, frozenset({body})
    return dict.fromkeys(
        (body.name for body in scene.dynamic_bodies), DARK
    ), frozenset()


def _hinge(scene: Scene, body: RigidBody) -> Hinge:
    return next(
        joint
        for joint in scene.joints
        if isinstance(joint, Hinge) and joint.body == body.name
    )


def _sideways(hinge: Hinge) -> FloatArray:
    """Return the level direction in which a body on a hinge swings, shape [3]."""
    side: FloatArray = np.cross(hinge.axis, (0.0, 0.0, 1.0))
    return side / np.linalg.norm(side)
