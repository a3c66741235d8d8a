"""3D replays of results: each episode runs again, and its poses become the data of a page.

A result file holds the generalized trajectory g(t) alone, and everything that the run needs: scene, engine, settings,
parameters, start and seed.
"""

from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends import engine_call, versions_of
from gauge_envs.envs.arguments import EnvArguments
from gauge_envs.envs.initial_states import Draw, InitialStates
from gauge_envs.envs.rollout import Rollout
from gauge_envs.errors import GaugeError
from gauge_envs.experiments.experiment import AssetKind, Experiment
from gauge_envs.observables.kinds import Observable
from gauge_envs.references.band import Band
from gauge_envs.references.kind import Kind
from gauge_envs.rendering.camera import FIELD_OF_VIEW_DEG, experiment_view
from gauge_envs.rendering.materials import LOOKS, STRING_RADIUS_M
from gauge_envs.rendering.reference_path import reference_path, reference_words
from gauge_envs.rendering.skin import Skin
from gauge_envs.runs.isolation import call_engine
from gauge_envs.runs.result import Result
from gauge_envs.runs.result_file import recorded_experiment
from gauge_envs.scene import (
    Box,
    Capsule,
    Compound,
    ConvexUnion,
    Cylinder,
    Deformable,
    Ellipsoid,
    Plane,
    Rod,
    Rope,
    Sphere,
)
from gauge_envs.scene.geometry import Pose, Shape
from gauge_envs.scene.jitter import Jitter
from gauge_envs.scene.meshes import hull_triangles
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLES_PER_FRAME
from gauge_envs.tools.compare import judging_band

RIGID_VIEWS_PER_FRAME = 2
"""Recorded views in each frame of a scene of rigid bodies, so 60 a second; deformable bodies are recorded 30 times."""

MAX_COUNT = 32767
"""Largest stored number."""

ROUND_M = 5
"""Digits of lengths in metres that are written as text: 10 micrometres."""

SOLIDS: Mapping[type, Mapping[str, str]] = {
    Box: {"size": "size_m"},
    Sphere: {"radius": "radius_m"},
    Cylinder: {"radius": "radius_m", "length": "length_m"},
    Capsule: {"radius": "radius_m", "length": "length_m"},
    Ellipsoid: {"radii": "radii_m"},
    Plane: {},
}
"""Attributes of each shape by their names in the data."""


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
    poses: NDArray[np.float32]
    nodes_m: Mapping[str, NDArray[np.float32]]
    markers_m: NDArray[np.float32]


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
    with engine_call(backend, "build"):
        rollout = arguments.rollout([experiment], [None])
    try:
        with engine_call(backend, "advance"):
            start = InitialStates(experiment).sample(_draw(result), result.seed or 0)
            rollout.reset([start], result.seed or 0)
            return _recorded(rollout)
    finally:
        rollout.simulation.close()


def _draw(result: Result) -> Draw:
    """Return what drew the start of a result."""
    if not result.jitter:
        return None
    if "trial" in result.jitter:
        return int(result.jitter["trial"])
    # A result leaves out the standard deviations of velocities that are zero, which are the defaults.
    return Jitter(**result.jitter)


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
    poses = np.array([[*poses.values()] for poses, _ in views], dtype=np.float32)
    return Replay(
        rate_hz=FRAME_RATE_HZ * views_per_frame,
        bodies=tuple(bodies),
        poses=poses.reshape(len(views), len(bodies), 7),
        nodes_m={
            name: np.array([nodes_m[name] for _, nodes_m in views], dtype=np.float32)
            for name in softs
        },
        markers_m=rollout.trajectory().markers_m.astype(np.float32),
    )


# --- its data, JSON-ready ---


def replay_data(result: Result, *, label: str, color: str) -> dict[str, Any]:
    """Run the episode of a result again, and return its replay; a reference of positions becomes the ghost.

    Raises:
        GaugeError: There is no replay, see `replay`.
    """
    made = replay(result)
    experiment = recorded_experiment(result)
    if "trial" in result.jitter:
        experiment = replace(experiment, trial=int(result.jitter["trial"]))
    # Quaternions are stored x y z w, the order of three.js.
    turns = np.rint(MAX_COUNT * np.nan_to_num(made.poses[..., [4, 5, 6, 3]]))
    has_markers = made.markers_m.size > 0
    return {
        "label": label,
        "color": color,
        "rate": made.rate_hz,
        "views": len(made.poses),
        "scene": scene_data(experiment),
        "moving": list(made.bodies),
        "positions": quantized(made.poses[..., :3]),
        "turns": _packed(turns, "<i2"),
        "soft": [
            _soft_data(body, made.nodes_m[body.name])
            for body in experiment.scene.deformables
        ],
        "markers": {**quantized(made.markers_m), "count": made.markers_m.shape[1]}
        if has_markers
        else None,
        "ghost": _ghost(experiment, judging_band(experiment, [result])),
    }


def quantized(positions_m: NDArray[np.floating]) -> dict[str, Any]:
    """Return positions as numbers of 16 bits; a position that is not finite becomes the centre.

    Args:
        positions_m: Positions [m], shape [..., 3].

    Returns:
        The numbers as base64, the position of number 0 [m], and the length of one count along each axis [m]; a position
        is wrong by half of it at most.
    """
    points = positions_m.reshape(-1, 3).astype(np.float64)
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        points = np.zeros((1, 3))
    low, high = points.min(axis=0), points.max(axis=0)
    centre = 0.5 * (low + high)
    step = np.maximum(0.5 * (high - low) / MAX_COUNT, 1e-12)
    counts = np.rint((positions_m - centre) / step)
    return {
        "data": _packed(np.nan_to_num(counts, posinf=0.0, neginf=0.0), "<i2"),
        "centre": centre.tolist(),
        "step": step.tolist(),
    }


def _packed(values: NDArray[Any], dtype: str) -> str:
    """Return numbers as base64 of integers in the byte order of browsers."""
    return b64encode(values.astype(dtype).tobytes()).decode("ascii")


def scene_data(experiment: Experiment) -> dict[str, Any]:
    """Return the still part of the scene of an experiment: shapes, colours, strings and the camera."""
    scene = experiment.scene
    view = experiment_view(experiment)
    shapes = list(dict.fromkeys(body.shape for body in scene.bodies))
    return {
        "shapes": [_solids(shape) for shape in shapes],
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
        "camera": {
            "target": np.round(view.target_m, ROUND_M).tolist(),
            "distance": view.distance_m,
            "azimuth": view.azimuth_deg,
            "elevation": view.elevation_deg,
            "fov": FIELD_OF_VIEW_DEG,
        },
    }


def _color(look: str) -> str:
    """Return the colour of a look in CSS."""
    red, green, blue = (round(255 * part) for part in LOOKS[look].color)
    return f"#{red:02x}{green:02x}{blue:02x}"


def _pose(pose: Pose) -> list[float]:
    """Return position and quaternion x y z w, the order of three.js."""
    w, x, y, z = pose.quaternion
    return [*pose.position_m, x, y, z, w]


def _solids(shape: Shape) -> list[dict[str, Any]]:
    """Return the solids of a shape, each with its place in the body frame."""
    if isinstance(shape, Compound):
        return [
            {**solid, "pose": _pose(part.pose)}
            for part in shape.parts
            for solid in _solids(part.shape)  # type: ignore[arg-type]
        ]
    if isinstance(shape, ConvexUnion):
        hulls = (hull_triangles(np.asarray(piece)) for piece in shape.pieces_m)
        return [
            {"kind": "mesh", "triangles": np.round(hull, ROUND_M + 1).ravel().tolist()}
            for hull in hulls
        ]
    sizes = {name: getattr(shape, key) for name, key in SOLIDS[type(shape)].items()}
    return [{"kind": type(shape).__name__.lower(), **sizes}]


def _soft_data(body: Deformable, nodes_m: NDArray[np.float32]) -> dict[str, Any]:
    data = {
        "count": nodes_m.shape[1],
        "nodes": quantized(nodes_m),
        "color": _color("dynamic"),
    }
    if isinstance(body, Rope | Rod):
        return {**data, "kind": "line", "radius": body.radius_m}
    faces = Skin(body, nodes_m[0].astype(np.float64)).faces
    return {**data, "kind": "surface", "faces": _packed(faces, "<u2")}


def _ghost(experiment: Experiment, band: Band | None) -> dict[str, Any] | None:
    """Return the reference positions of bodies or markers at the frames; None if there are none."""
    path = reference_path(experiment, band)
    if band is None or path is None:
        return None
    radii: list[float | None] = [None] * len(path.names)
    if experiment.score.observable is Observable.POSITION:
        shapes = (experiment.scene.body(name).shape for name in path.names)
        radii = [
            shape.radius_m if isinstance(shape, Sphere) else None for shape in shapes
        ]
    return {
        "kind": band.kind.value,
        "trials": band.trial_count,
        "full": path.is_full,
        "names": list(path.names),
        "radii": radii,
        "places": [
            np.round(row, ROUND_M).tolist() if np.isfinite(row).all() else None
            for row in path.places_m
        ],
    }


def ghost_text(ghosts: Sequence[Mapping[str, Any]]) -> str:
    """Return what the ghost of a page is, in words; an empty text without one."""
    if not ghosts:
        return ""
    ghost = ghosts[0]
    kind = Kind(ghost["kind"])
    text = f"Ghost: {reference_words(kind, ghost['trials'])}"
    if not kind.is_real:
        text += ", no recorded motion"
    text += "; not aligned in time."
    if not ghost["full"]:
        text += " Directions that were not measured keep the start of the simulation."
    places = ghost["places"]
    last = max((frame for frame, place in enumerate(places) if place), default=0)
    if last < len(places) - 1:
        text += f" It ends at {last / FRAME_RATE_HZ:.2f} s."
    return text
