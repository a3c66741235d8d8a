"""3D views of results: the poses and nodes of a run as data of a page."""

from base64 import b64encode
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import ResultFileError
from gauge_envs.experiments.experiment import AssetKind, Experiment
from gauge_envs.observables.kinds import Observable
from gauge_envs.references.band import Band
from gauge_envs.rendering.camera import FIELD_OF_VIEW_DEG, experiment_view
from gauge_envs.rendering.materials import LOOKS, STRING_RADIUS_M
from gauge_envs.rendering.reference_path import reference_path, reference_words
from gauge_envs.rendering.skin import Skin
from gauge_envs.runs.motion import Motion
from gauge_envs.runs.result import Result
from gauge_envs.runs.result_file import recorded_experiment
from gauge_envs.scene import Compound, ConvexUnion, Deformable, Rod, Rope, Sphere
from gauge_envs.scene.geometry import FloatArray, Pose
from gauge_envs.scene.meshes import hull_triangles
from gauge_envs.tools.compare import judging_band

MAX_COUNT = 32767
"""Largest stored integer."""


def motion_view_data(result: Result, motion: Motion) -> dict[str, Any]:
    """Return the data of the 3D view of a result, JSON-ready; reference positions become the ghost.

    Raises:
        GaugeError: The scene is in a model file of an engine and not in the result.
    """
    if result.asset.get("kind") == AssetKind.MODEL:
        raise ResultFileError(
            f"the scene is in the file {result.asset['file']}, not in the result"
        )
    experiment = recorded_experiment(result)
    if "trial" in result.jitter:
        experiment = replace(experiment, trial=int(result.jitter["trial"]))
    markers_m = result.trajectory.markers_m() if result.trajectory else None
    if markers_m is None:
        markers_m = np.empty((0, 0, 3))
    return {
        "rate": motion.rate_hz,
        "views": len(motion.poses),
        "scene": scene_data(experiment),
        "moving": list(motion.bodies),
        "positions": quantized(motion.poses[..., :3]),
        # Quaternions are stored x y z w, the order of three.js.
        "turns": quantized(motion.poses[..., [4, 5, 6, 3]]),
        "soft": [
            _soft_data(body, motion.nodes_m[body.name])
            for body in experiment.scene.deformables
        ],
        "markers": {
            **quantized(markers_m),
            "count": markers_m.shape[1],
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
