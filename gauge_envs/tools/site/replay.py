"""3D replays of results: each episode runs again, and its poses become the data of a page.

A result file holds the generalized trajectory g(t) alone, and everything that the run needs: scene, engine, settings,
parameters, start and seed.
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
from gauge_envs.runs.isolation import call_engine
from gauge_envs.runs.result import Result
from gauge_envs.runs.result_file import recorded_experiment
from gauge_envs.scene import Compound, ConvexUnion, Deformable, Rod, Rope, Sphere
from gauge_envs.scene.geometry import FloatArray, Pose
from gauge_envs.scene.meshes import hull_triangles
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLES_PER_FRAME
from gauge_envs.tools.compare import judging_band

RIGID_VIEWS_PER_FRAME = 2
"""Recorded views in each frame of a scene of rigid bodies, so 60 a second; deformable bodies are recorded 30 times."""

MAX_COUNT = 32767
"""Largest stored number."""


class ReplayError(GaugeError, RuntimeError):
    """An episode has no replay; the message states the reason."""


# --- the run ---


@dataclass(frozen=True, kw_only=True)
class Replay:
    """Where the bodies of an episode are.

    Attributes:
        rate_hz: Views a second.
        bodies: Names of the rigid bodies that move.
        poses: Their positions [m] and quaternions w x y z, shape [view_count, body_count, 7].
        nodes_m: Nodes of each deformable body by name [m], shape [view_count, node_count, 3].
        markers_m: Markers at the frames [m], shape [frame_count, marker_count, 3]; `marker_count` is 0 if bodies are
            observed.
    """

    rate_hz: float
    bodies: tuple[str, ...]
    poses: FloatArray
    nodes_m: Mapping[str, FloatArray]
    markers_m: FloatArray


def replay(result: Result) -> Replay:
    """Run the episode of a result again and return where its bodies are.

    An engine outside this package runs in another process.

    Args:
        result: The result.

    Raises:
        ReplayError: The result does not hold the run, or other versions are installed.
        GaugeError: The engine cannot run it.
    """
    if result.backend is None or result.trajectory is None:
        raise ReplayError("the result is of a trajectory file: no engine ran it")
    return call_engine(result.backend, _run_again, result, result.backend)


def _run_again(result: Result, backend: str) -> Replay:
    """Run the episode of a result on its engine and return where its bodies are."""
    if difference := result.made_with_other_than(versions_of(backend)):
        raise ReplayError(difference)
    if result.asset.get("kind") == AssetKind.MODEL:
        raise ReplayError(
            f"the scene is in the file {result.asset['file']}, which is no part of the result"
        )
    experiment = recorded_experiment(result)
    arguments = EnvArguments(
        result.id,
        backend=backend,
        settings=result.settings_given or None,
        marker_proxy=result.marker_proxy,
    )
    seed, starts = result.seed or 0, InitialStates(experiment)
    options: Mapping[str, Any] = {"jitter": result.jitter or None}
    if "trial" in result.jitter:
        options = result.jitter
    start = starts.sample(starts.of_reset(options, seeded=True), seed)
    with engine_call(backend, "run"):
        rollout = arguments.rollout([experiment], [None])
        try:
            rollout.reset([start], seed)
            return _recorded(rollout)
        finally:
            rollout.simulation.close()


def _recorded(rollout: Rollout) -> Replay:
    """Run an episode to its end with zero actions, and return its views."""
    views_per_frame = RIGID_VIEWS_PER_FRAME
    if rollout.experiment.scene.deformables:
        views_per_frame = 1
    samples_per_view = SAMPLES_PER_FRAME // views_per_frame
    # The start is a view too.
    views = [(rollout.poses(), rollout.nodes_m())]
    while not rollout.is_over[0]:
        for sample in rollout.substeps():
            if (sample + 1) % samples_per_view == 0:
                views.append((rollout.poses(), rollout.nodes_m()))
    bodies, softs = views[0]
    poses = np.array([[*poses.values()] for poses, _ in views])
    return Replay(
        rate_hz=FRAME_RATE_HZ * views_per_frame,
        bodies=tuple(bodies),
        poses=poses.reshape(len(views), len(bodies), 7),
        nodes_m={
            name: np.array([nodes_m[name] for _, nodes_m in views]) for name in softs
        },
        markers_m=rollout.trajectory().markers_m,
    )


# --- its data, JSON-ready ---


def replay_data(result: Result) -> dict[str, Any]:
    """Run the episode of a result again, and return its replay; a reference of positions becomes the ghost.

    Raises:
        GaugeError: There is no replay, see `replay`.
    """
    made = replay(result)
    experiment = recorded_experiment(result)
    if "trial" in result.jitter:
        experiment = replace(experiment, trial=int(result.jitter["trial"]))
    return {
        "rate": made.rate_hz,
        "views": len(made.poses),
        "scene": scene_data(experiment),
        "moving": list(made.bodies),
        "positions": quantized(made.poses[..., :3]),
        # Quaternions are stored x y z w, the order of three.js.
        "turns": quantized(made.poses[..., [4, 5, 6, 3]]),
        "soft": [
            _soft_data(body, made.nodes_m[body.name])
            for body in experiment.scene.deformables
        ],
        "markers": {**quantized(made.markers_m), "count": made.markers_m.shape[1]},
        "ghost": _ghost(experiment, judging_band(experiment, [result])),
    }


def quantized(values: FloatArray) -> dict[str, Any]:
    """Return values as base64 of integers of 16 bits, and the step between two of them; one that is not finite is 0.

    A value is wrong by half a step at most; 32,767 steps are the largest absolute value.
    """
    finite = np.nan_to_num(values, posinf=0.0, neginf=0.0)
    step = float(np.abs(finite).max(initial=1e-9)) / MAX_COUNT
    return {"data": _packed(np.rint(finite / step), "<i2"), "step": step}


def _packed(values: NDArray[Any], dtype: str) -> str:
    """Return numbers as base64 of integers in the byte order of browsers."""
    return b64encode(values.astype(dtype).tobytes()).decode("ascii")


def scene_data(experiment: Experiment) -> dict[str, Any]:
    """Return the still part of the scene of an experiment: shapes, colours, strings and the camera."""
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
    """Return the solids of a shape, each with its attributes and its place in the body frame."""
    if isinstance(shape, Compound):
        parts = (_solids(part.shape, part.pose) for part in shape.parts)
        return [solid for solids in parts for solid in solids]
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
    """Return the reference positions of bodies or markers at the frames; None if there are none."""
    path = reference_path(experiment, band)
    if band is None or path is None:
        return None
    text = (
        f"Ghost: {reference_words(band.kind, band.trial_count)}; not aligned in time."
    )
    if not path.is_full:
        text += " Directions that were not measured keep the start of the simulation."
    radii: list[float | None] = [None] * len(path.names)
    if experiment.score.observable is Observable.POSITION:
        shapes = (experiment.scene.body(name).shape for name in path.names)
        radii = [
            shape.radius_m if isinstance(shape, Sphere) else None for shape in shapes
        ]
    return {
        "text": text,
        "radii": radii,
        "places": [
            row.tolist() if np.isfinite(row).all() else None for row in path.places_m
        ],
    }
