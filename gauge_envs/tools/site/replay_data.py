"""Data of a replay: shapes, quantized poses and nodes, and the real trajectory as a ghost.

Positions are whole numbers of 16 bits between the ends of their range, orientations the components of the quaternion
times 32767.
"""

from base64 import b64encode
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.experiments.experiment import Experiment
from gauge_envs.observables.kinds import Observable
from gauge_envs.references.band import Band
from gauge_envs.references.kind import Kind
from gauge_envs.rendering.camera import FIELD_OF_VIEW_DEG, experiment_view
from gauge_envs.rendering.materials import LOOKS, STRING_RADIUS_M
from gauge_envs.rendering.reference_path import reference_path, reference_words
from gauge_envs.rendering.skin import Skin
from gauge_envs.scene import (
    Box,
    Capsule,
    Cloth,
    Compound,
    ConvexUnion,
    Cylinder,
    Ellipsoid,
    Motion,
    Plane,
    Rod,
    Rope,
    SoftBody,
    Sphere,
)
from gauge_envs.scene.geometry import Pose, Shape
from gauge_envs.scene.meshes import hull_triangles
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.site.replay import (
    Replay,
)

MAX_COUNT = 32767
"""Largest stored number."""

ROUND_M = 5
"""Digits of lengths in metres that are written as text: 10 micrometres."""


def quantized(positions_m: NDArray[np.floating[Any]]) -> dict[str, Any]:
    """Return positions as numbers of 16 bits, JSON-ready; a position that is not finite becomes the centre.

    Args:
        positions_m: Positions [m], shape [..., 3].

    Returns:
        The numbers as base64, the position of number 0 [m], and the length of one count along each axis [m]; a position
        is wrong by half of it at most.
    """
    points = positions_m.reshape(-1, 3).astype(np.float64)
    finite = points[np.isfinite(points).all(axis=1)]
    low, high = (
        (finite.min(axis=0), finite.max(axis=0))
        if len(finite)
        else (np.zeros(3), np.zeros(3))
    )
    centre, step = 0.5 * (low + high), np.maximum(0.5 * (high - low) / MAX_COUNT, 1e-12)
    counts = np.nan_to_num(
        np.rint((positions_m - centre) / step), posinf=0.0, neginf=0.0
    ).astype(np.int16)
    return {"data": _packed(counts), "centre": centre.tolist(), "step": step.tolist()}


def _packed(values: NDArray[Any]) -> str:
    """Return integers as base64, in the byte order of browsers."""
    return b64encode(
        np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<")).tobytes()
    ).decode("ascii")


def scene_data(experiment: Experiment) -> dict[str, Any]:
    """Return the still part of the scene of an experiment, JSON-ready: shapes, colours, strings and the camera."""
    scene = experiment.scene
    shapes: list[list[dict[str, Any]]] = []
    known: dict[Shape, int] = {}
    bodies = []
    for body in scene.bodies:
        if body.shape not in known:
            known[body.shape] = len(shapes)
            shapes.append(_solids(body.shape))
        bodies.append(
            {
                "name": body.name,
                "shape": known[body.shape],
                "color": _color(LOOKS[body.motion.value].color),
                "pose": _pose(body.pose),
            }
        )
    view = experiment_view(experiment)
    return {
        "shapes": shapes,
        "bodies": bodies,
        "strings": [
            {"body": joint.body, "anchor": list(joint.anchor_m)}
            for joint in scene.joints
        ],
        "string": {"radius": STRING_RADIUS_M},
        "camera": {
            "target": [round(float(x), ROUND_M) for x in view.target_m],
            "distance": view.distance_m,
            "azimuth": view.azimuth_deg,
            "elevation": view.elevation_deg,
            "fov": FIELD_OF_VIEW_DEG,
        },
    }


def _color(rgba: Sequence[float]) -> str:
    return "#" + "".join(f"{round(255 * part):02x}" for part in rgba[:3])


def _pose(pose: Pose) -> list[float]:
    """Return position and quaternion x y z w, the order of three.js."""
    w, x, y, z = pose.quaternion
    return [*pose.position_m, x, y, z, w]


SOLIDS: Mapping[type, tuple[str, Mapping[str, str]]] = {
    Box: ("box", {"size": "size_m"}),
    Sphere: ("sphere", {"radius": "radius_m"}),
    Cylinder: ("cylinder", {"radius": "radius_m", "length": "length_m"}),
    Capsule: ("capsule", {"radius": "radius_m", "length": "length_m"}),
    Ellipsoid: ("ellipsoid", {"radii": "radii_m"}),
    Plane: ("plane", {}),
}
"""Kind of each shape, and its attributes by their names in the data."""


def _solids(shape: Shape) -> list[dict[str, Any]]:
    """Return the solids of a shape, each with its place in the body frame."""
    if isinstance(shape, Compound):
        solids = []
        for part in shape.parts:
            for solid in _solids(part.shape):  # type: ignore[arg-type]
                solids.append(solid | {"pose": _pose(part.pose)})
        return solids
    if isinstance(shape, ConvexUnion):
        triangles = (hull_triangles(np.asarray(piece)) for piece in shape.pieces_m)
        return [
            {"kind": "mesh", "triangles": np.round(one, ROUND_M + 1).ravel().tolist()}
            for one in triangles
        ]
    kind, sizes = SOLIDS[type(shape)]
    return [
        {"kind": kind}
        | {name: getattr(shape, attribute) for name, attribute in sizes.items()}
    ]


def replay_data(
    experiment: Experiment, replay: Replay, band: Band | None, *, label: str, color: str
) -> dict[str, Any]:
    """Return a replay of the experiment that ran, JSON-ready; a band of positions becomes the ghost."""
    # Quaternions are stored x y z w, the order of three.js.
    turns = (
        np.rint(MAX_COUNT * np.nan_to_num(replay.poses[..., [4, 5, 6, 3]]))
        .clip(-MAX_COUNT, MAX_COUNT)
        .astype(np.int16)
    )
    return {
        "label": label,
        "color": color,
        "rate": replay.rate_hz,
        "views": len(replay.poses),
        "scene": scene_data(experiment),
        "moving": list(replay.bodies),
        "positions": quantized(replay.poses[..., :3]),
        "turns": _packed(turns),
        "soft": [
            _soft(body, replay.nodes_m[body.name])
            for body in experiment.scene.deformables
        ],
        "markers": quantized(replay.markers_m) | {"count": replay.markers_m.shape[1]}
        if replay.markers_m.size
        else None,
        "ghost": None if band is None else _ghost(experiment, band),
    }


def _soft(
    body: Cloth | SoftBody | Rope | Rod, nodes_m: NDArray[np.float32]
) -> dict[str, Any]:
    data: dict[str, Any] = {"count": nodes_m.shape[1], "nodes": quantized(nodes_m)}
    if isinstance(body, Rope | Rod):
        return data | {
            "kind": "line",
            "radius": body.radius_m,
            "color": _color(LOOKS[Motion.DYNAMIC.value].color),
        }
    faces = Skin(body, nodes_m[0].astype(np.float64)).faces
    return data | {
        "kind": "surface",
        "faces": _packed(faces.astype(np.uint16)),
        "color": _color(LOOKS[Motion.DYNAMIC.value].color),
    }


def _ghost(experiment: Experiment, band: Band) -> dict[str, Any] | None:
    """Return the real positions of bodies or markers at the frames; None if the band is of other quantities."""
    path = reference_path(experiment, band)
    if path is None:
        return None
    is_body = experiment.score.observable is Observable.POSITION
    shapes = [
        experiment.scene.body(name).shape if is_body else None for name in path.names
    ]
    return {
        "kind": band.kind.value,
        "trials": band.trial_count,
        "full": path.is_full,
        "names": list(path.names),
        "radii": [
            shape.radius_m if isinstance(shape, Sphere) else None for shape in shapes
        ],
        "places": [
            np.round(row, ROUND_M).tolist() if np.isfinite(row).all() else None
            for row in path.places_m
        ],
        "measured": band.measured.tolist(),
    }


def ghost_text(ghosts: Sequence[Mapping[str, Any]]) -> str:
    """Return what the ghost of a page is, in words; an empty text without one."""
    if not ghosts:
        return ""
    ghost = ghosts[0]
    kind = Kind(ghost["kind"])
    what = reference_words(kind, ghost["trials"])
    what += ", no recorded motion" if not kind.is_real else ""
    kept = (
        ""
        if ghost["full"]
        else " Directions that were not measured keep the start of the simulation."
    )
    last = max(
        (frame for frame, place in enumerate(ghost["places"]) if place is not None),
        default=0,
    )
    end = (
        f" It ends at {last / FRAME_RATE_HZ:.2f} s."
        if last < len(ghost["places"]) - 1
        else ""
    )
    return f"Ghost: {what}; not aligned in time.{kept}{end}"
