"""Processor time against the cells of a cloth, the number of bricks and the number of worlds, as `growth.csv`.

Of cloth and bricks it is that of a step of MuJoCo; of worlds that of a frame of all of them, with MuJoCo's preset
`training` and with an engine that costs nothing.

PYTHONPATH=benchmarks python studies/cost/growth.py > studies/cost/growth.csv
"""

from __future__ import annotations

import csv
import sys
import time
from collections.abc import Iterator
from itertools import chain, pairwise
from math import log

import worlds

from gauge_envs import load_experiment
from gauge_envs.backends import backend
from gauge_envs.scene import Box, Contact, Motion, Plane, Pose, RigidBody, Scene

CELLS_M = (0.05, 0.025, 0.0125, 0.00625)
BRICKS = (10, 30, 100, 300, 1000)
WORLDS = (1, 4, 16, 64, 256, 1024, 4096)
LAYERS = 5
BRICK_M = (0.06, 0.03, 0.02)


def columns(count: int) -> Scene:
    """Columns of bricks, five high, that stand apart on the ground."""
    origin = Pose(position_m=(0.0, 0.0, 0.0))
    ground = RigidBody(
        name="ground", shape=Plane(), motion=Motion.FIXED, mass_kg=1.0, pose=origin
    )
    names = [f"brick-{index}" for index in range(count)]
    bricks = [
        RigidBody(
            name=name,
            shape=Box(size_m=BRICK_M),
            motion=Motion.DYNAMIC,
            mass_kg=0.02,
            pose=Pose(
                position_m=(
                    0.1 * (index // LAYERS),
                    0.0,
                    BRICK_M[2] * (index % LAYERS + 0.5),
                )
            ),
        )
        for index, name in enumerate(names)
    ]
    contact = Contact(
        first=(*names, "ground"),
        second=(*names, "ground"),
        friction=0.4,
        restitution=0.0,
    )
    return Scene(bodies=(*bricks, ground), contacts=(contact,), duration_s=1.0)


def step_s(scene: Scene, settings: dict[str, object], steps: int) -> float:
    """Processor time of a step [s], the least of three runs."""
    simulation = backend("mujoco").build(scene, settings)
    timestep_s = float(simulation.settings["timestep_s"])
    simulation.reset(0)
    simulation.advance(5 * timestep_s)
    spent = []
    for _ in range(3):
        start = time.process_time()
        simulation.advance(steps * timestep_s)
        spent.append((time.process_time() - start) / steps)
    return min(spent)


def frame_s(count: int) -> float:
    """Processor time of a frame of many worlds of SlopeSlider-2-wood [s]."""
    row = worlds.measured("mujoco", count, {"preset": "training"}, 2)
    assert row is not None
    return 1e-6 * count * (row.engine_us + row.host_us)


def rows() -> Iterator[tuple[str, str, float, float]]:
    cloth = load_experiment("TextileFlinging-satin").scene
    for cell_m in CELLS_M:
        yield (
            "cloth",
            "cell_mm",
            1e3 * cell_m,
            step_s(cloth, {"cell_m": cell_m}, round(2000 * cell_m)),
        )
    for count in BRICKS:
        yield (
            "bricks",
            "count",
            count,
            step_s(columns(count), {"preset": "stack"}, max(5, 1000 // count)),
        )
    worlds.clock = time.process_time
    for count in WORLDS:
        yield "worlds of MuJoCo", "count", count, frame_s(count)
    worlds.stub_engine()
    for count in WORLDS:
        yield "worlds of a stub", "count", count, frame_s(count)


def main() -> None:
    table = csv.writer(sys.stdout, lineterminator="\n")
    table.writerow(["scene", "parameter", "value", "ms", "exponent"])
    for before, row in pairwise(chain([None], rows())):
        exponent = ""
        if before is not None and before[0] == row[0]:
            exponent = f"{log(row[3] / before[3]) / log(row[2] / before[2]):.2f}"
        table.writerow([*row[:2], f"{row[2]:g}", f"{1e3 * row[3]:.3g}", exponent])
        sys.stdout.flush()


if __name__ == "__main__":
    main()
