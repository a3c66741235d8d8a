"""Run the scenes of this folder in any simulator, and write the motion that `gauge sanity judge` reads.

This file needs Python alone. Give `run` a function that makes your world of one scene, with these members:

    world.step_s                  time step [s]
    world.state(name)             x, y, z [m], qw, qx, qy, qz, vx, vy, vz [m/s] of a body's origin
    world.drive(name, numbers)    set pose (7), velocity (6) and acceleration (6) of a driven body
    world.step(count)             simulate so many steps
"""

import csv
import json
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any


def run(folder: str | Path, make_world: Callable[[Path, dict[str, Any]], Any], only: Collection[str] = ()) -> None:
    """Run the scenes of a folder and write `motion.csv` of each.

    Args:
        folder: Folder with `manifest.json`.
        make_world: Function from the folder of a scene and its entry in the manifest to a world at its start.
        only: Names of scenes; all when empty.
    """
    manifest = json.loads((Path(folder) / "manifest.json").read_text(encoding="utf-8"))
    for scene in manifest["scenes"]:
        if only and scene["name"] not in only:
            continue
        place = Path(folder) / scene["name"]
        world, drivers = make_world(place, scene), read_drivers(place, scene)
        steps = max(1, int(scene["longest_interval_s"] / world.step_s + 1e-6))
        interval_s = steps * world.step_s
        with (place / "motion.csv").open("w", newline="", encoding="utf-8") as file:
            out = csv.writer(file)
            out.writerow(manifest["columns"])
            for sample in range(round(scene["seconds"] / interval_s) + 1):
                for name in scene["recorded"]:
                    out.writerow([sample * interval_s, name, *world.state(name)])
                for name, rows in drivers.items():
                    world.drive(name, numbers_at(rows, sample * interval_s))
                world.step(steps)


def read_drivers(place: Path, scene: dict[str, Any]) -> dict[str, list[list[float]]]:
    """Return the rows of the drivers of a scene by name of the body, each of 20 numbers with the time first."""
    rows: dict[str, list[list[float]]] = {}
    if scene["drivers"]:
        with (place / scene["drivers"]).open(newline="", encoding="utf-8") as file:
            for time_s, name, *numbers in list(csv.reader(file))[1:]:
                rows.setdefault(name, []).append([float(time_s), *map(float, numbers)])
    return rows


def numbers_at(rows: list[list[float]], time_s: float) -> list[float]:
    """Return pose, velocity and acceleration at a time, linear between two rows."""
    index = min(int(time_s / rows[1][0] + 1e-6), len(rows) - 2)
    share = (time_s - rows[index][0]) / (rows[index + 1][0] - rows[index][0])
    share = 0.0 if share < 1e-6 else min(share, 1.0)
    return [a + share * (b - a) for a, b in zip(rows[index][1:], rows[index + 1][1:], strict=True)]
