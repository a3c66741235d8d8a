"""Build and check the generated assets: every variant as USD and MJCF, every solid as OBJ.

The files in `assets/` are built from the task files and checked in. Other tools open them without gauge-envs. An edited
copy of a USD layer or of an MJCF file can be the scene of an experiment (`experiments.scene_source`).
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from gauge_envs.errors import ParameterError, ResultFileError
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.variants import variants
from gauge_envs.files import data_folder, os_errors, write_texts
from gauge_envs.scene import (
    Box,
    Compound,
    ConvexUnion,
    Cylinder,
    Plane,
    Rod,
    Rope,
    Shape,
    SoftBody,
    Sphere,
)
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.meshes import hull_faces
from gauge_envs.tools.assets.export import mjcf_text, usd_layer_text
from gauge_envs.tools.mjcf import NUMBER, expanded

FOLDERS = ("mjcf", "obj", "usd")

CYLINDER_SIDES = 96
"""Sides of the prism that approximates a cylinder in an OBJ file."""

SPHERE_SUBDIVISIONS = 3
"""Subdivisions of the icosahedron that approximates a sphere in an OBJ file: 642 vertices."""

SAME_RELATIVE = 3e-7
"""Relative difference up to which numbers are equal in a check. Sines differ in their last digit between machines, and
USD keeps some values in single precision."""
SAME_ABSOLUTE = 1e-12


# --- folder ----------------------------------------------------------------------------------------------------------


def assets_folder() -> Path:
    """Return the folder of the checked-in assets, in a checkout and in an installed wheel."""
    return data_folder("tasks").parent / "assets"


def asset_texts() -> Iterator[tuple[str, str]]:
    """Yield the path below the assets folder and the text of every generated file, by folder in alphabetical order."""
    experiments = [load_experiment(variant) for variant in variants()]
    for experiment in experiments:
        yield f"mjcf/{experiment.name}.xml", mjcf_text(experiment)
    for name, solid in solid_shapes().items():
        yield f"obj/{name}.obj", shape_to_obj(solid.shape, name)
    for experiment in experiments:
        yield f"usd/{experiment.name}.usda", usd_layer_text(experiment)


def build_assets(folder: Path) -> list[Path]:
    """Write every generated file, and remove files of earlier builds that are no longer generated.

    Returns:
        Paths of the written files.
    """
    with os_errors(
        lambda cause: ResultFileError(
            f"{folder}: assets cannot be written there: {cause}"
        )
    ):
        written = write_texts(folder, asset_texts())
        for path in set(_generated(folder)) - set(written):
            path.unlink()
    return written


def stale_asset(folder: Path) -> Path | None:
    """Return the first file that is missing, differs from its current text, or is no longer generated; else None.

    Files that differ in the last digits of numbers alone are equal.
    """
    expected = set()
    for name, text in asset_texts():
        path = folder / name
        expected.add(path)
        if not path.is_file() or not _same(
            path.read_text(encoding="utf-8", errors="replace"), text
        ):
            return path
    return min(set(_generated(folder)) - expected, default=None)


def asset_rows(folder: Path) -> list[dict[str, Any]]:
    """Return one row per file: `file`, `bytes`, and `of`, the variant or the bodies that it shows."""
    solids = solid_shapes()
    rows = []
    for path in _generated(folder):
        solid = solids.get(path.stem) if path.suffix == ".obj" else None
        shown = f"GAUGE/{path.stem}" if solid is None else ", ".join(solid.bodies)
        rows.append(
            {
                "file": f"{path.parent.name}/{path.name}",
                "bytes": path.stat().st_size,
                "of": shown,
            }
        )
    return rows


def _generated(folder: Path) -> list[Path]:
    return sorted(
        path for name in FOLDERS for path in (folder / name).glob("*") if path.is_file()
    )


def _same(one: str, other: str) -> bool:
    if one == other:
        return True
    one, other = expanded(one), expanded(other)
    if NUMBER.split(one) != NUMBER.split(other):
        return False
    pairs = zip(NUMBER.findall(one), NUMBER.findall(other), strict=True)
    return all(
        a == b
        or math.isclose(
            float(a), float(b), rel_tol=SAME_RELATIVE, abs_tol=SAME_ABSOLUTE
        )
        for a, b in pairs
    )


# --- OBJ -------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SharedSolid:
    """A shape, and the bodies of that shape, as `SlopeSlider/cube`."""

    shape: Shape
    bodies: tuple[str, ...]


@cache
def solid_shapes() -> dict[str, SharedSolid]:
    """Return every distinct solid of the scenes; primitives are named by dimensions, polyhedra by their body."""
    users: dict[Shape, dict[str, str]] = {}
    for variant in variants():
        experiment = load_experiment(variant)
        scene, listed = experiment.scene, experiment.spec.names
        shapes = {
            body.name: body.shape
            for body in scene.bodies
            if not isinstance(body.shape, Plane)
        }
        for body in scene.deformables:
            if isinstance(body, SoftBody):
                shapes[body.name] = body.shape
            elif isinstance(body, Rope | Rod):
                shapes[body.name] = Cylinder(
                    radius_m=body.radius_m, length_m=body.length_m
                )
        for name, shape in shapes.items():
            # Counted bodies share one entry of the task file.
            label = name if name in listed else name.rpartition("-")[0]
            users.setdefault(shape, {}).setdefault(f"{variant.family}/{label}", label)
    solids: dict[str, SharedSolid] = {}
    for solid, bodies in users.items():
        title = _shape_name(solid, next(iter(bodies.values())))
        if title in solids:
            title = next(iter(bodies)).replace("/", "-")
        solids[title] = SharedSolid(solid, tuple(bodies))
    return dict(sorted(solids.items()))


def _shape_name(shape: Shape, body: str) -> str:
    if isinstance(shape, Box):
        return f"box-{_millimetres(*shape.size_m)}"
    if isinstance(shape, Sphere):
        return f"sphere-{_millimetres(2.0 * shape.radius_m)}"
    if isinstance(shape, Cylinder):
        return f"cylinder-{_millimetres(2.0 * shape.radius_m, shape.length_m)}"
    return body


def _millimetres(*lengths_m: float) -> str:
    return "x".join(f"{1e3 * length:g}" for length in lengths_m) + "mm"


def shape_to_obj(shape: Shape, name: str) -> str:
    """Return a solid as Wavefront OBJ, in metres, in the body frame, with one watertight group per convex piece.

    Spheres and cylinders become polyhedra of the exact volume: faces are inside the true surface, vertices outside.
    """
    pieces, note = _pieces(shape)
    lines = [f"# {name}: volume {shape.volume_m3!r} m^3{note}", f"o {name}"]
    first = 1
    for index, (points, faces) in enumerate(pieces):
        lines.append(f"g piece_{index}")
        lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in (points + 0.0).tolist()]
        lines += [
            "f " + " ".join(str(first + vertex) for vertex in face) for face in faces
        ]
        first += len(points)
    return "\n".join(lines) + "\n"


Polyhedron = tuple[FloatArray, list[tuple[int, ...]]]


def _pieces(shape: Shape) -> tuple[list[Polyhedron], str]:
    """Return the convex pieces of a solid, and a note on its approximation."""
    if isinstance(shape, ConvexUnion):
        return [_polyhedron(np.array(piece)) for piece in shape.pieces_m], ""
    if isinstance(shape, Box):
        return [_polyhedron(shape.corners_m)], ""
    if isinstance(shape, Sphere):
        sphere = trimesh.creation.icosphere(subdivisions=SPHERE_SUBDIVISIONS)
        scale = (shape.volume_m3 / sphere.volume) ** (1.0 / 3.0)
        note = f"; sphere of radius {shape.radius_m!r} m, vertices at {scale / shape.radius_m:.5f} of it"
        return [
            (
                np.asarray(sphere.vertices) * scale,
                [tuple(face) for face in sphere.faces.tolist()],
            )
        ], note
    if isinstance(shape, Cylinder):
        angle = 2.0 * np.pi / CYLINDER_SIDES
        radius = shape.radius_m * math.sqrt(angle / math.sin(angle))
        angles = angle * np.arange(CYLINDER_SIDES)
        ring = np.column_stack([radius * np.cos(angles), radius * np.sin(angles)])
        ends = [
            np.insert(ring, 2, height, axis=1)
            for height in (-0.5 * shape.length_m, 0.5 * shape.length_m)
        ]
        note = f"; cylinder of radius {shape.radius_m!r} m, vertices at {radius / shape.radius_m:.5f} of it"
        return [_polyhedron(np.concatenate(ends))], note
    kind = (
        "a compound of solids"
        if isinstance(shape, Compound)
        else "a plane, which is not a solid,"
    )
    raise ParameterError(f"{kind} has no OBJ file")


def _polyhedron(points_m: FloatArray) -> Polyhedron:
    return points_m, hull_faces(points_m)
