"""Write the numbers of makers' models that `robot-maker` compares: `python -m studies.robots.tables LIST.csv`.

LIST.csv has the columns name, robot, source, licence and path (of an MJCF file). Meshes that a copy lacks are
replaced by boxes, and numbers that change with the size of the box are left out.
"""

import csv
import io
import math
import sys
from pathlib import Path

import mujoco
import numpy as np

from gauge_envs.files import data_folder
from gauge_envs.tools.sanity import configuration
from gauge_envs.tools.sanity.robot.quantities import quantities

FOLDER = data_folder("scoring") / "facts" / "robots"

BOX_FACES = [
    *([0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4]),
    *([2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5]),
]

BOX_SIZES_M = (0.02, 0.03)
"""Halves of the edges of the boxes in place of missing meshes."""


def compiled(path: Path, half_m: float) -> mujoco.MjModel:
    """Return a model whose missing meshes are boxes, and whose pictures are left out."""
    spec = mujoco.MjSpec.from_file(str(path))
    folder = path.parent / spec.modelfiledir / spec.meshdir
    signs = np.array(list(np.ndindex(2, 2, 2))) * 2 - 1
    for mesh in spec.meshes:
        if mesh.file and not (folder / mesh.file).is_file():
            mesh.name = mesh.name or Path(mesh.file).stem
            mesh.file = ""
            mesh.uservert = (half_m * signs).ravel()
            mesh.userface = np.ravel(BOX_FACES)
    for texture in list(spec.textures):
        if texture.file or any(texture.cubefiles):
            spec.delete(texture)
    for material in spec.materials:
        material.textures = [""] * len(material.textures)
    return spec.compile()


def numbers(path: Path) -> dict[tuple[str, str], float]:
    """Return the numbers of a model that do not depend on missing meshes, by quantity and part."""
    several = []
    for half_m in BOX_SIZES_M:
        robot = configuration(compiled(path, half_m)).robot
        known = quantities(robot)
        several.append(
            {(q, part): v for q, parts in known.items() for part, v in parts.items()}
        )
    first, second = several
    return {
        key: value
        for key, value in first.items()
        if _is_same(value, second.get(key, math.nan))
    }


def _is_same(first: float, second: float) -> bool:
    return first == second or math.isclose(first, second, rel_tol=1e-6, abs_tol=1e-9)


def table(path: Path) -> str:
    """Return the table of a model, a line for each quantity."""
    lines: dict[str, list[str]] = {}
    for (quantity, part), value in numbers(path).items():
        lines.setdefault(quantity, [quantity]).append(f"{part}={value:.6g}")
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerows(lines.values())
    return stream.getvalue()


def main(listing: Path) -> None:
    """Write the tables of all models of a list that differ in a number, and the index."""
    FOLDER.mkdir(exist_ok=True)
    models: dict[str, dict[str, str]] = {}
    with listing.open(encoding="utf-8") as stream:
        for model in csv.DictReader(stream):
            models.setdefault(table(Path(model["path"])), model)
    for text, model in models.items():
        (FOLDER / f"{model['name']}.csv").write_text(text, encoding="utf-8")
    with (FOLDER / "index.csv").open("w", encoding="utf-8", newline="") as stream:
        columns = ["name", "robot", "source", "licence"]
        writer = csv.DictWriter(
            stream, columns, lineterminator="\n", extrasaction="ignore"
        )
        writer.writeheader()
        writer.writerows(models.values())


if __name__ == "__main__":
    main(Path(sys.argv[1]))
