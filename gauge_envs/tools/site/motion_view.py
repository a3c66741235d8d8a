"""3D views of results: run each episode again, and write its poses as data of a page.

A result file has only the generalized trajectory g(t), and all inputs of the run: scene, engine, settings, parameters,
initial state and seed.
"""

from base64 import b64encode
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends import engine_call, versions_of
from gauge_envs.envs.arguments import EnvArguments
from gauge_envs.envs.initial_states import InitialStates
from gauge_envs.envs.rollout import Rollout
from gauge_envs.errors import GaugeError
from gauge_envs.experiments.experiment import AssetKind, Experiment
from gauge_envs.observables.kinds import Observable
from gauge_envs.references.band import Band
from gauge_envs.rendering.camera import FIELD_OF_VIEW_DEG, experiment_view
from gauge_envs.rendering.materials import LOOKS, STRING_RADIUS_M
from gauge_envs.rendering.reference_path import reference_path, reference_words
from gauge_envs.rendering.skin import Skin
from gauge_envs.runs.result import Result
from gauge_envs.runs.result_file import recorded_experiment
from gauge_envs.runs.workers import call_engine
from gauge_envs.scene import Compound, ConvexUnion, Deformable, Rod, Rope, Sphere
from gauge_envs.scene.geometry import FloatArray, Pose
from gauge_envs.scene.meshes import hull_triangles
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLES_PER_FRAME
from gauge_envs.tools.compare import judging_band

RIGID_VIEWS_PER_FRAME = 2
"""Recorded views per frame of rigid scenes: 60 views per second. Deformable scenes have 30."""

MAX_COUNT = 32767
"""Largest stored integer."""


class MotionViewError(GaugeError, RuntimeError):
    """An episode has no 3D view; the message gives the reason."""


# --- the run ---


@dataclass(frozen=True, kw_only=True)
class MotionView:
    """Positions of the bodies of an episode.

    Attributes:
        rate_hz: Views per second.
        bodies: Names of the moving rigid bodies.
        poses: Positions [m] and quaternions w x y z of these bodies, shape [view_count, body_count, 7].
        nodes_m: Nodes of each deformable body by name [m], shape [view_count, node_count, 3].
        markers_m: Markers at the frames [m], shape [frame_count, marker_count, 3]; `marker_count` is 0 if bodies are
            observed.
    """

    rate_hz: float
    bodies: tuple[str, ...]
    poses: FloatArray
    nodes_m: Mapping[str, FloatArray]
    markers_m: FloatArray


def motion_view(result: Result) -> MotionView:
    """Run the episode of a result again, and return the positions of its bodies.

    An engine outside this package runs in another process.

    Args:
        result: The result.

    Raises:
        MotionViewError: The result lacks inputs of the run, or other versions are installed.
        GaugeError: The engine cannot run the episode.
    """
    if result.backend is None or result.trajectory is None:
        raise MotionViewError(
            "the result comes from a trajectory file, not from an engine"
        )
    return call_engine(result.backend, _run_again, result, result.backend)


def _run_again(result: Result, backend: str) -> MotionView:
    """Run the episode of a result on its engine, and return the positions of its bodies."""
    if difference := result.version_difference(versions_of(backend)):
        raise MotionViewError(difference)
    if result.asset.get("kind") == AssetKind.MODEL:
        raise MotionViewError(
            f"the scene is in the file {result.asset['file']}, not in the result"
        )
    experiment = recorded_experiment(result)
    arguments = EnvArguments(
        result.id,
        backend=backend,
        settings=result.settings_given or None,
        marker_proxy=result.marker_proxy,
    )
    seed, initial_states = result.seed or 0, InitialStates(experiment)
    options: Mapping[str, Any] = {"jitter": result.jitter or None}
    if "trial" in result.jitter:
        options = result.jitter
    initial_state = initial_states.sample(
        initial_states.of_reset(options, seeded=True), seed
    )
    with engine_call(backend, "run"):
        rollout = arguments.rollout([experiment])
        try:
            rollout.reset([initial_state], seed)
            return _recorded(rollout)
        finally:
            rollout.simulation.close()


def _recorded(rollout: Rollout) -> MotionView:
    """Run an episode to its end with zero actions, and return its views."""
    views_per_frame = RIGID_VIEWS_PER_FRAME
    if rollout.experiment.scene.deformables:
        views_per_frame = 1
    samples_per_view = SAMPLES_PER_FRAME // views_per_frame
    # The initial state is the first view.
    views = [(rollout.poses(), rollout.nodes_m())]
    while not rollout.is_over[0]:
        for sample in rollout.substeps():
            if (sample + 1) % samples_per_view == 0:
                views.append((rollout.poses(), rollout.nodes_m()))
    bodies, softs = views[0]
    poses = np.array([[*poses.values()] for poses, _ in views])
    return MotionView(
        rate_hz=FRAME_RATE_HZ * views_per_frame,
        bodies=tuple(bodies),
        poses=poses.reshape(len(views), len(bodies), 7),
        nodes_m={
            name: np.array([nodes_m[name] for _, nodes_m in views]) for name in softs
        },
        markers_m=rollout.recording.trajectory().markers_m,
    )


# --- data of a view, JSON-ready ---


def motion_view_data(result: Result) -> dict[str, Any]:
    """Run the episode of a result again, and return the data of its 3D view; reference positions become the ghost.

    Raises:
        GaugeError: The episode has no 3D view; see `motion_view`.
    """
    episode = motion_view(result)
    experiment = recorded_experiment(result)
    if "trial" in result.jitter:
        experiment = replace(experiment, trial=int(result.jitter["trial"]))
    return {
        "rate": episode.rate_hz,
        "views": len(episode.poses),
        "scene": scene_data(experiment),
        "moving": list(episode.bodies),
        "positions": quantized(episode.poses[..., :3]),
        # Quaternions are stored x y z w, the order of three.js.
        "turns": quantized(episode.poses[..., [4, 5, 6, 3]]),
        "soft": [
            _soft_data(body, episode.nodes_m[body.name])
            for body in experiment.scene.deformables
        ],
        "markers": {
            **quantized(episode.markers_m),
            "count": episode.markers_m.shape[1],
        },
        "ghost": _ghost(experiment, judging_band(experiment, [result])),
    }


def quantized(values: FloatArray) -> dict[str, Any]:
    """Return values as base64 of 16-bit integers, and the value of a step; values that are not finite become 0.

    The error of a value is at most half a step; the largest absolute value has 32,767 steps.
    """
    finite = np.nan_to_num(values, posinf=0.0, neginf=0.0)
    step = float(np.abs(finite).max(initial=1e-9)) / MAX_COUNT
    return {"data": _packed(np.rint(finite / step), "<i2"), "step": step}


def _packed(values: NDArray[Any], dtype: str) -> str:
    """Return numbers as base64 of integers in the byte order of browsers."""
    return b64encode(values.astype(dtype).tobytes()).decode("ascii")


def scene_data(experiment: Experiment) -> dict[str, Any]:
    """Return the static part of the scene of an experiment: shapes, colours, strings and the camera."""
    scene = experiment.scene
    view = experiment_view(experiment)
    shapes = list(dict.fromkeys(body.shape for body in scene.bodies))
    return {
        "shapes": [
            _solids(shape, Pose(position_m=(0.0, 0.0, 0.0))) for shape in shapes
        ],
        "bodies": [
            {
                "name": body.name,
                "shape": shapes.index(body.shape),
                "color": _color(body.motion.value),
                "pose": _pose(body.pose),
            }
            for body in scene.bodies
        ],
        "strings": [
            {"body": joint.body, "anchor": list(joint.anchor_m)}
            for joint in scene.joints
        ],
        "string": {"radius": STRING_RADIUS_M},
        "camera": {**view.model_dump(), "fov_deg": FIELD_OF_VIEW_DEG},
    }


def _color(look: str) -> str:
    """Return the colour of a look in CSS."""
    red, green, blue = (round(255 * part) for part in LOOKS[look].color)
    return f"#{red:02x}{green:02x}{blue:02x}"


def _pose(pose: Pose) -> list[float]:
    """Return position and quaternion x y z w, the order of three.js."""
    w, x, y, z = pose.quaternion
    return [*pose.position_m, x, y, z, w]


def _solids(shape: Any, pose: Pose) -> list[dict[str, Any]]:
    """Return the solids of a shape, with attributes and pose in the body frame."""
    if isinstance(shape, Compound):
        solids: list[dict[str, Any]] = []
        for part in shape.parts:
            solids += _solids(part.shape, part.pose)
        return solids
    sizes = asdict(shape)
    if isinstance(shape, ConvexUnion):
        hulls = [hull_triangles(np.asarray(piece)) for piece in shape.pieces_m]
        sizes = {"triangles": np.concatenate(hulls).ravel().tolist()}
    kind = type(shape).__name__.lower()
    return [{**sizes, "kind": kind, "pose": _pose(pose)}]


def _soft_data(body: Deformable, nodes_m: FloatArray) -> dict[str, Any]:
    data = {
        "count": nodes_m.shape[1],
        "nodes": quantized(nodes_m),
        "color": _color("dynamic"),
    }
    if isinstance(body, Rope | Rod):
        return {**data, "kind": "line", "radius": body.radius_m}
    faces = Skin(body, nodes_m[0]).faces
    return {**data, "kind": "surface", "faces": _packed(faces, "<u2")}


def _ghost(experiment: Experiment, band: Band | None) -> dict[str, Any] | None:
    """Return the reference positions of bodies or markers at the frames, if any."""
    path = reference_path(experiment, band)
    if band is None or path is None:
        return None
    text = (
        f"Ghost: {reference_words(band.kind, band.trial_count)}; not aligned in time."
    )
    if not path.is_full:
        text += " Directions without measurements keep the initial position of the simulation."
    is_of_bodies = experiment.score.observable is Observable.POSITION
    radii: list[float | None] = []
    for name in path.names:
        radius_m = None
        if is_of_bodies:
            shape = experiment.scene.body(name).shape
            radius_m = shape.radius_m if isinstance(shape, Sphere) else None
        radii.append(radius_m)
    places_m: list[list[list[float]] | None] = []
    for row in path.places_m:
        is_known = np.isfinite(row).all()
        places_m.append(row.tolist() if is_known else None)
    return {"text": text, "radii": radii, "places": places_m}
