"""Generated assets: every variant as USD, every rigid one as MJCF, every solid as OBJ; built, and checked for currency.

The files in `assets/` are built from the task files and are checked in; nothing reads them back. They are for users
of other tools: each opens without gauge-envs.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray

from gauge_envs.backends.mujoco import BackendMuJoCo, SimulationMuJoCo
from gauge_envs.env import SAMPLE_INTERVAL_S, DriverPath
from gauge_envs.errors import ParameterError, ResultFileError, UnsupportedSceneError
from gauge_envs.experiment import Experiment, experiment
from gauge_envs.meshes import hull_faces
from gauge_envs.paths import data_folder
from gauge_envs.result import task_sha256
from gauge_envs.scene import Box, ConvexUnion, Cylinder, Plane, Rod, Rope, Shape, SoftBody, Sphere
from gauge_envs.task import task_path, variants
from gauge_envs.usd import SOURCE, usd_text

__all__ = [
    "asset_rows",
    "asset_texts",
    "assets_folder",
    "build_assets",
    "mjcf_text",
    "scene_to_mjcf",
    "shape_to_obj",
    "solid_shapes",
    "stale_asset",
]

FOLDERS = ("mjcf", "obj", "usd")

CYLINDER_SIDES = 96
"""Sides of the prism that stands for a cylinder in an OBJ file."""

SPHERE_SUBDIVISIONS = 3
"""Subdivisions of the icosahedron that stands for a sphere in an OBJ file: 642 vertices."""

NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?")

SAME_RELATIVE = 3e-7
"""Numbers this close are equal in a check: sines differ in their last digit between machines, and USD keeps some
values in single precision."""
SAME_ABSOLUTE = 1e-12


# --- folder ----------------------------------------------------------------------------------------------------------


def assets_folder() -> Path:
    """Folder of the checked-in assets, in a checkout and in an installed wheel."""
    return data_folder("tasks").parent / "assets"


def asset_texts() -> Iterator[tuple[str, str]]:
    """Path below the assets folder and text of every generated file, in alphabetical order of folders."""
    resolved = [experiment(variant) for variant in variants()]
    for one in resolved:
        if not one.scene.deformables:
            yield f"mjcf/{one.variant.name}.xml", mjcf_text(one)
    for name, solid in solid_shapes().items():
        yield f"obj/{name}.obj", shape_to_obj(solid.shape, name)
    for one in resolved:
        yield f"usd/{one.variant.name}.usda", usd_text(one)


def build_assets(folder: Path) -> list[Path]:
    """Write every generated file, and remove files of earlier builds that are no longer made.

    Returns:
        What was written.

    Raises:
        ResultFileError: The folder cannot be written.
    """
    written = []
    try:
        for name, text in asset_texts():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8", newline="\n")
            written.append(path)
        for path in set(_generated(folder)) - set(written):
            path.unlink()
    except OSError as error:
        raise ResultFileError(f"{folder}: assets cannot be written there: {error.strerror or error}") from error
    return written


def stale_asset(folder: Path) -> Path | None:
    """The first file that is missing, differs from what would be built now, or is no longer made; None if all is well.

    Files are equal when their bytes are, or when all that differs is last digits of numbers.
    """
    expected = set()
    for name, text in asset_texts():
        path = folder / name
        expected.add(path)
        if not path.is_file() or not _same(path.read_text(encoding="utf-8", errors="replace"), text):
            return path
    return min(set(_generated(folder)) - expected, default=None)


def asset_rows(folder: Path) -> list[dict[str, Any]]:
    """One row a file: `file`, `bytes`, and `of`, the variant or the bodies that it shows."""
    solids = solid_shapes()
    rows = []
    for path in _generated(folder):
        solid = solids.get(path.stem) if path.suffix == ".obj" else None
        shown = f"GAUGE/{path.stem}" if solid is None else ", ".join(solid.bodies)
        rows.append({"file": f"{path.parent.name}/{path.name}", "bytes": path.stat().st_size, "of": shown})
    return rows


def _generated(folder: Path) -> list[Path]:
    return sorted(path for name in FOLDERS for path in (folder / name).glob("*") if path.is_file())


def _same(one: str, other: str) -> bool:
    if one == other:
        return True
    if NUMBER.split(one) != NUMBER.split(other):
        return False
    pairs = zip(NUMBER.findall(one), NUMBER.findall(other), strict=True)
    return all(
        a == b or math.isclose(float(a), float(b), rel_tol=SAME_RELATIVE, abs_tol=SAME_ABSOLUTE) for a, b in pairs
    )


# --- MJCF ------------------------------------------------------------------------------------------------------------


def scene_to_mjcf(resolved: Experiment, path: Path) -> None:
    """Write the MuJoCo model of a rigid variant as a self-contained file, in full precision.

    The compiled file equals the model that the MuJoCo backend steps, bit for bit. Where a body is driven, the file
    carries its motion as custom numbers `driver/<body>` and says how to replay it.

    Raises:
        UnsupportedSceneError: The scene holds a deformable body.
        ResultFileError: The file cannot be written.
    """
    text = mjcf_text(resolved)
    try:
        path.write_text(text, encoding="utf-8", newline="\n")
    except OSError as error:
        raise ResultFileError(f"{path}: cannot be written: {error.strerror or error}") from error


def mjcf_text(resolved: Experiment) -> str:
    """The text that `scene_to_mjcf` writes.

    Raises:
        UnsupportedSceneError: The scene holds a deformable body.
    """
    scene = resolved.scene
    if scene.deformables:
        names = ", ".join(repr(body.name) for body in scene.deformables)
        raise UnsupportedSceneError(
            f"{resolved.variant.id}: no MJCF of deformable {names}: their stiffness is written into the compiled model"
        )
    simulation = BackendMuJoCo().build(scene)
    family = resolved.variant.family
    notes = [
        f"{resolved.spec.title}: {resolved.variant.id}, parameters: {resolved.parameters}.",
        f"Task file: tasks/{task_path(family).name}, sha256 {task_sha256(family)}.",
        SOURCE,
    ]
    for driver in scene.drivers:
        rows = _driver_rows(simulation, resolved, DriverPath(driver, scene, resolved.frame_count))
        simulation.spec.add_numeric(name=f"driver/{driver.body}", size=rows.size, data=rows.ravel().tolist())
        notes.append(_replay_note(driver.body, driver.provenance, simulation, rows))
    root = ElementTree.fromstring(simulation.spec.to_xml())
    root.set("model", resolved.variant.name)
    _restore_digits(root, simulation.spec)
    comment = ElementTree.Comment("\n    " + "\n    ".join(notes) + "\n  ")
    comment.tail = "\n\n  "
    root.insert(0, comment)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _driver_rows(simulation: SimulationMuJoCo, resolved: Experiment, path: DriverPath) -> NDArray[np.float64]:
    """What to write before each sample interval, shape [interval_count, 19]: qpos 7, qvel 6, xfrc_applied 6."""
    model, data = simulation.model, simulation.data
    joint, body = model.joint(path.body), model.body(path.body)
    position, speed = int(joint.qposadr[0]), int(joint.dofadr[0])
    still = np.zeros(path.motion_count)
    rows = []
    for sample in range(round(resolved.scene.duration_s / SAMPLE_INTERVAL_S)):
        simulation.drive(path.body, *path.interval(sample, still))
        state = data.qpos[position : position + 7], data.qvel[speed : speed + 6], data.xfrc_applied[body.id]
        rows.append(np.concatenate(state))
    return np.array(rows)


def _replay_note(body: str, provenance: str, simulation: SimulationMuJoCo, rows: NDArray[np.float64]) -> str:
    steps = round(SAMPLE_INTERVAL_S / simulation.model.opt.timestep)
    return (
        f"Driven body {body!r} (motion: {provenance}): custom numeric 'driver/{body}' holds {len(rows)} rows of "
        f"{rows.shape[1]} numbers.\n    Before every {steps} steps write the next row: [0:7] to the qpos of free joint "
        f"{body!r}, [7:13] to its qvel,\n    [13:19] to xfrc_applied of body {body!r}."
    )


ALIASES = {"vertex": "uservert", "solreflimit": "solref_limit", "solimplimit": "solimp_limit"}
"""Names in MuJoCo's editable model where they differ from the XML's."""


def _restore_digits(root: ElementTree.Element, spec: mujoco.MjSpec) -> None:
    """Give every number back the digits that MuJoCo's XML writer drops: it prints six, and 1/9000 s needs more."""
    pairs = iter(spec.pairs)
    find: dict[str, Any] = {
        "option": lambda _: spec.option,
        "mesh": spec.mesh,
        "body": spec.body,
        "geom": spec.geom,
        "joint": spec.joint,
        "site": spec.site,
        "spatial": spec.tendon,
        "pair": lambda _: next(pairs),
        "numeric": spec.numeric,
    }
    for element in root.iter():
        source = find[element.tag](element.get("name", "")) if element.tag in find else None
        for key, text in element.items() if source is not None else ():
            exact = getattr(source, ALIASES.get(key, key), None)
            if exact is None or not NUMBER.fullmatch(text.split(" ")[0]):
                continue
            written = np.array(text.split(), dtype=np.float64)
            # Trailing defaults are not written.
            values = np.atleast_1d(np.asarray(exact, dtype=np.float64))[: written.size]
            if written.shape == values.shape and np.allclose(written, values, rtol=1e-5, atol=1e-12):
                element.set(key, " ".join(repr(value).removesuffix(".0") for value in values.tolist()))


# --- OBJ -------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Solid:
    """A shape and the bodies that have it, as `SlopeSlider/cube`."""

    shape: Shape
    bodies: tuple[str, ...]


@cache
def solid_shapes() -> dict[str, Solid]:
    """Every distinct solid of the scenes, by name: primitives by their dimensions, polyhedra by their body's name."""
    users: dict[Shape, dict[str, str]] = {}
    for variant in variants():
        resolved = experiment(variant)
        scene, listed = resolved.scene, resolved.spec.names
        for name, shape in [
            *((body.name, body.shape) for body in scene.bodies if not isinstance(body.shape, Plane)),
            *((body.name, body.shape) for body in scene.deformables if isinstance(body, SoftBody)),
            *(
                (body.name, Cylinder(radius_m=body.radius_m, length_m=body.length_m))
                for body in scene.deformables
                if isinstance(body, Rope | Rod)
            ),
        ]:
            # Counted bodies share one entry of the task file.
            label = name if name in listed else name.rpartition("-")[0]
            users.setdefault(shape, {}).setdefault(f"{variant.family}/{label}", label)
    solids: dict[str, Solid] = {}
    for solid, bodies in users.items():
        title = _shape_name(solid, next(iter(bodies.values())))
        if title in solids:
            title = next(iter(bodies)).replace("/", "-")
        solids[title] = Solid(solid, tuple(bodies))
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
    """A solid as Wavefront OBJ, in metres, in the body frame; one group a convex piece, each watertight.

    Spheres and cylinders become polyhedra of the exact volume, so that their flat faces lie inside the true surface
    and their vertices outside.

    Raises:
        ParameterError: A plane is no solid.
    """
    pieces, note = _pieces(shape)
    lines = [f"# {name}: volume {shape.volume_m3!r} m^3{note}", f"o {name}"]
    first = 1
    for index, (points, faces) in enumerate(pieces):
        lines.append(f"g piece_{index}")
        lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in (points + 0.0).tolist()]
        lines += ["f " + " ".join(str(first + vertex) for vertex in face) for face in faces]
        first += len(points)
    return "\n".join(lines) + "\n"


Polyhedron = tuple[NDArray[np.float64], list[tuple[int, ...]]]


def _pieces(shape: Shape) -> tuple[list[Polyhedron], str]:
    """Convex pieces of a solid, and a remark on how it was approximated."""
    if isinstance(shape, ConvexUnion):
        return [_polyhedron(np.array(piece)) for piece in shape.pieces_m], ""
    if isinstance(shape, Box):
        return [_polyhedron(shape.corners_m)], ""
    if isinstance(shape, Sphere):
        sphere = trimesh.creation.icosphere(subdivisions=SPHERE_SUBDIVISIONS)
        scale = (shape.volume_m3 / sphere.volume) ** (1.0 / 3.0)
        note = f"; sphere of radius {shape.radius_m!r} m, vertices at {scale / shape.radius_m:.5f} of it"
        return [(np.asarray(sphere.vertices) * scale, [tuple(face) for face in sphere.faces.tolist()])], note
    if isinstance(shape, Cylinder):
        angle = 2.0 * np.pi / CYLINDER_SIDES
        radius = shape.radius_m * math.sqrt(angle / math.sin(angle))
        angles = angle * np.arange(CYLINDER_SIDES)
        ring = np.column_stack([radius * np.cos(angles), radius * np.sin(angles)])
        ends = [np.insert(ring, 2, height, axis=1) for height in (-0.5 * shape.length_m, 0.5 * shape.length_m)]
        note = f"; cylinder of radius {shape.radius_m!r} m, vertices at {radius / shape.radius_m:.5f} of it"
        return [_polyhedron(np.concatenate(ends))], note
    raise ParameterError("a plane is no solid: it has no OBJ")


def _polyhedron(points_m: NDArray[np.float64]) -> Polyhedron:
    return points_m, hull_faces(points_m)
