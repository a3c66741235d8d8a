"""Build and check the generated assets: every variant as USD and MJCF, every solid as OBJ.

The files in `assets/` are built from the task files and checked in. Other tools open them without gauge-envs. An edited
copy of a USD layer or of an MJCF file can be the scene of an experiment (`experiments.scene_source`).
"""

import math
import re
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.variants import variants
from gauge_envs.files import data_folder
from gauge_envs.pages.document import save_file
from gauge_envs.scene import (
    Box,
    Cloth,
    ConvexUnion,
    Cylinder,
    Deformable,
    Plane,
    RigidBody,
    Rod,
    Rope,
    Shape,
    Sphere,
)
from gauge_envs.scene.meshes import PRISM_SIDES, hull_triangles
from gauge_envs.tools.assets.export import mjcf_text, usd_layer_text

SPHERE_SUBDIVISIONS = 3
"""Subdivisions of the icosahedron that approximates a sphere in an OBJ file: 642 vertices."""

OBJ_DECIMALS = 12
"""Number of decimals of a coordinate in an OBJ file [m]."""

RELATIVE_TOLERANCE = 3e-7
"""Relative difference up to which numbers are equal in a check. Sines differ in their last digit between machines, and
USD keeps some values in single precision."""
ABSOLUTE_TOLERANCE = 1e-12

NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?")

KINDS = re.compile(
    r'<numeric name="(?P<name>[^"]+)/kinds" size="\d+" data="(?P<kinds>[^"]*)" />\s*'
    r'<numeric name="(?P=name)/kind" size="\d+" data="(?P<kind>[^"]*)" />'
)
"""Distinct rows of a compiled table in an MJCF file, and the index of the distinct row for each row."""


# --- folder ----------------------------------------------------------------------------------------------------------


def assets_folder() -> Path:
    """Return the folder of the checked-in assets, in a checkout and in an installed wheel."""
    return data_folder("tasks").parent / "assets"


def asset_texts(
    advance: Callable[[str], None] = lambda name: None,
) -> Iterator[tuple[str, str]]:
    """Yield the path below the assets folder and the text of every generated file.

    Args:
        advance: Function that is called with the name of each experiment and solid after its files.
    """
    for variant in variants():
        experiment = load_experiment(variant)
        yield f"mjcf/{experiment.name}.xml", mjcf_text(experiment)
        yield f"usd/{experiment.name}.usda", usd_layer_text(experiment)
        advance(experiment.name)
    for name, (shape, _) in solid_shapes().items():
        yield f"obj/{name}.obj", shape_to_obj(shape, name)
        advance(name)


def build_assets(
    folder: Path, texts: Iterable[tuple[str, str]] | None = None
) -> list[Path]:
    """Write generated files, and remove files of earlier builds that are no longer generated.

    Args:
        folder: Folder of the assets.
        texts: Files to write, by default `asset_texts`.

    Returns:
        Paths of the written files.

    Raises:
        ResultFileError: The folder cannot be written.
    """
    written = [save_file(folder / name, text) for name, text in texts or asset_texts()]
    for path in set(_generated(folder)) - set(written):
        path.unlink()
    return written


def stale_asset(
    folder: Path, texts: Iterable[tuple[str, str]] | None = None
) -> Path | None:
    """Return the first file that is missing, differs from its current text, or is no longer generated; else None.

    Files that differ only in the last digits of numbers are equal.
    """
    left_over = set(_generated(folder))
    for name, text in texts or asset_texts():
        path = folder / name
        if path not in left_over:
            return path
        if not _is_same(path.read_text("utf-8", errors="replace"), text):
            return path
        left_over.remove(path)
    return min(left_over, default=None)


def asset_rows(folder: Path) -> list[dict[str, Any]]:
    """Return one row per file: `file`, `bytes`, and `of`, the variant or the bodies that it shows."""
    solids = solid_shapes()
    rows = []
    for path in _generated(folder):
        _, bodies = solids.get(path.stem, (None, [f"GAUGE/{path.stem}"]))
        rows.append(
            {
                "file": f"{path.parent.name}/{path.name}",
                "bytes": path.stat().st_size,
                "of": bodies,
            }
        )
    return rows


def _generated(folder: Path) -> list[Path]:
    return sorted(
        path
        for name in ("mjcf", "obj", "usd")
        for path in (folder / name).glob("*")
        if path.is_file()
    )


def _is_same(text: str, expected: str) -> bool:
    """Return whether texts are equal, up to the last digits of their numbers."""
    if text == expected:
        return True
    text, expected = _expanded(text), _expanded(expected)
    if NUMBER.split(text) != NUMBER.split(expected):
        return False
    numbers, expected_numbers = (
        np.array(NUMBER.findall(page), dtype=np.float64) for page in (text, expected)
    )
    return np.allclose(
        numbers, expected_numbers, rtol=RELATIVE_TOLERANCE, atol=ABSOLUTE_TOLERANCE
    )


def _expanded(text: str) -> str:
    """Return a file's text with all table rows written out, since bitwise equality of rows depends on the machine."""

    def rows(match: re.Match[str]) -> str:
        kind = np.array(match["kind"].split(), dtype=int)
        kinds = np.array(match["kinds"].split()).reshape(kind.max() + 1, -1)
        return "\n".join(map(" ".join, kinds[kind]))

    return KINDS.sub(rows, text)


# --- OBJ -------------------------------------------------------------------------------------------------------------


@cache
def solid_shapes() -> dict[str, tuple[Shape, list[str]]]:
    """Return every distinct solid of the scenes and its bodies, as `SlopeSlider/cube`.

    Primitives are named by their dimensions, polyhedra by their body.
    """
    bodies_of: dict[Shape, list[str]] = {}
    for variant in variants():
        experiment = load_experiment(variant)
        scene = experiment.scene
        for body in (*scene.bodies, *scene.deformables):
            if (shape := _solid(body)) is not None:
                # Counted bodies share one entry of the task file.
                is_counted = body.name not in experiment.spec.names
                label = body.name.rpartition("-")[0] if is_counted else body.name
                bodies_of.setdefault(shape, []).append(f"{variant.family}/{label}")
    solids = {
        _shape_name(shape) or bodies[0].partition("/")[2]: (
            shape,
            [*dict.fromkeys(bodies)],
        )
        for shape, bodies in bodies_of.items()
    }
    return dict(sorted(solids.items()))


def _solid(body: RigidBody | Deformable) -> Shape | None:
    """Return the shape of a solid, ropes and rods as cylinders; None for a plane and for cloth."""
    if isinstance(body, Rope | Rod):
        return Cylinder(radius_m=body.radius_m, length_m=body.length_m)
    if isinstance(body, Cloth) or isinstance(body.shape, Plane):
        return None
    return body.shape


def _shape_name(shape: Shape) -> str:
    """Return the name of a primitive, as `box-20x40x15mm`; empty for a polyhedron."""
    lengths_m: tuple[float, ...]
    match shape:
        case Box():
            kind, lengths_m = "box", shape.size_m
        case Sphere():
            kind, lengths_m = "sphere", (2.0 * shape.radius_m,)
        case Cylinder():
            kind, lengths_m = "cylinder", (2.0 * shape.radius_m, shape.length_m)
        case _:
            return ""
    return f"{kind}-{'x'.join(f'{1e3 * length_m:g}' for length_m in lengths_m)}mm"


def shape_to_obj(shape: Shape, name: str) -> str:
    """Return a solid as Wavefront OBJ, in metres, in the body frame, with one watertight object per convex piece.

    Spheres and cylinders become polyhedra of the exact volume: faces are inside the true surface, vertices outside.
    """
    pieces = {f"{name}_{index}": mesh for index, mesh in enumerate(_pieces(shape))}
    header = f"{name}: volume {shape.volume_m3!r} m^3"
    scene = trimesh.Scene(pieces)
    return str(scene.export(file_type="obj", digits=OBJ_DECIMALS, header=header))


def _pieces(shape: Shape) -> list[trimesh.Trimesh]:
    """Return each convex piece of a solid [m]."""
    if isinstance(shape, Sphere):
        sphere = trimesh.creation.icosphere(subdivisions=SPHERE_SUBDIVISIONS)
        sphere.apply_scale((shape.volume_m3 / sphere.volume) ** (1.0 / 3.0))
        return [sphere]
    if isinstance(shape, Cylinder):
        cylinder = trimesh.creation.cylinder(1.0, shape.length_m, PRISM_SIDES)
        scale = math.sqrt(shape.volume_m3 / cylinder.volume)
        cylinder.apply_scale([scale, scale, 1.0])
        return [cylinder]
    pieces_m = [shape.corners_m]
    if isinstance(shape, ConvexUnion):
        pieces_m = [np.array(piece_m) for piece_m in shape.pieces_m]
    return [
        trimesh.Trimesh(**trimesh.triangles.to_kwargs(hull_triangles(piece_m)))
        for piece_m in pieces_m
    ]
