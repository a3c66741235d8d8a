"""Simulate a layer of gauge-envs in Isaac Sim, and write the trajectory that `gauge score` reads.

`gauge data isaac-sim` writes the layer. This script runs in Isaac Sim's own Python, which does not need gauge-envs:

    ./python.sh run_layer.py TextileBending-satin.usda --out satin.csv

It moves the driven bodies at every step, records the scored points at 30 Hz, and writes their g(t). On a machine with
gauge-envs, `gauge score satin.csv --id TextileBending-satin` scores the file. `--record-hz 180` records as often as
runs of gauge-envs do, for the release alignment of undriven motion.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

FRAME_RATE_HZ = 30

RECORD_HZ = (30, 60, 90, 180)
"""Rates of recording: multiples of the frames that divide both rates of the solver, 180 and 900."""


class LayerError(Exception):
    """A layer cannot be simulated; the message names the file and what to do."""


class DivergedError(Exception):
    """A recorded value is not a finite number."""


@dataclass(frozen=True)
class Driver:
    """Motion of a driven body.

    Attributes:
        path: Path of its prim.
        positions_m: Position after each step, the start first, shape [step_count + 1, 3].
        quaternions: Orientation w, x, y, z after each step, shape [step_count + 1, 4].
    """

    path: str
    positions_m: FloatArray
    quaternions: FloatArray


@dataclass(frozen=True)
class Plan:
    """Settings of a simulation in a layer.

    Attributes:
        steps_per_second: Rate of the solver.
        frame_count: Recorded frames at 30 Hz, the first one at time 0.
        observable: Kind of g(t): `position`, `marker_position`, `curvature`, `line_curvature` or `face_area`.
        unit: Unit of g(t).
        coordinates: Names of the columns of g(t).
        recorded: Paths of the bodies whose positions are recorded; empty for markers.
        drivers: Driven bodies.
    """

    steps_per_second: int
    frame_count: int
    observable: str
    unit: str
    coordinates: tuple[str, ...]
    recorded: tuple[str, ...]
    drivers: tuple[Driver, ...] = ()

    @property
    def step_count(self) -> int:
        """Number of steps of the solver."""
        return (self.frame_count - 1) * self.steps_per_second // FRAME_RATE_HZ


# --- layer -----------------------------------------------------------------------------------------------------------


def read_plan(stage: Any) -> Plan:
    """Read the settings of the simulation in a layer.

    Raises:
        LayerError: `gauge data isaac-sim` did not write the layer.
    """
    layer = stage.GetRootLayer()
    entries = layer.customLayerData.get("gauge", {}).get("isaac_sim")
    if entries is None:
        raise LayerError(f"{layer.identifier}: not a layer of 'gauge data isaac-sim'; write one with that command")
    plan = Plan(
        steps_per_second=int(entries["steps_per_second"]),
        frame_count=int(entries["frame_count"]),
        observable=str(entries["observable"]),
        unit=str(entries["unit"]),
        coordinates=tuple(map(str, entries["coordinates"])),
        recorded=tuple(map(str, entries["recorded"])),
    )
    return replace(plan, drivers=tuple(read_drivers(stage, plan)))


def has_deformable_bodies(stage: Any) -> bool:
    """Return whether a stage has cloth or foam."""
    applied = (prim.GetPrimTypeInfo().GetAppliedAPISchemas() for prim in stage.Traverse())
    return any("OmniPhysicsDeformableBodyAPI" in names for names in applied)


def read_drivers(stage: Any, plan: Plan) -> list[Driver]:
    """Return the motion of every driven body, from its time samples."""
    codes_per_step = stage.GetTimeCodesPerSecond() / plan.steps_per_second
    codes = [step * codes_per_step for step in range(plan.step_count + 1)]
    drivers = []
    for prim in stage.Traverse():
        if not prim.HasAttribute("gauge:driver"):
            continue
        translate, orient = (prim.GetAttribute(f"xformOp:{name}") for name in ("translate", "orient"))
        quaternions = [orient.Get(code) for code in codes]
        drivers.append(
            Driver(
                path=str(prim.GetPath()),
                positions_m=np.array([translate.Get(code) for code in codes], dtype=np.float64),
                quaternions=np.array([[q.GetReal(), *q.GetImaginary()] for q in quaternions], dtype=np.float64),
            )
        )
    return drivers


def take_over_drivers(stage: Any, drivers: Sequence[Driver]) -> None:
    """Replace the time samples of driven bodies with their start poses, so that `place` moves them."""
    for driver in drivers:
        prim = stage.GetPrimAtPath(driver.path)
        for name in ("translate", "orient"):
            prim.GetAttribute(f"xformOp:{name}").Clear()
        place(stage, driver, 0)


def place(stage: Any, driver: Driver, step: int) -> None:
    """Write the pose of a driven body after a step; PhysX makes it the body's kinematic target."""
    from pxr import Gf

    prim = stage.GetPrimAtPath(driver.path)
    prim.GetAttribute("xformOp:translate").Set(Gf.Vec3d(*driver.positions_m[step].tolist()))
    prim.GetAttribute("xformOp:orient").Set(Gf.Quatd(*driver.quaternions[step].tolist()))


# --- recorded points -------------------------------------------------------------------------------------------------


def reader(stage: Any, plan: Plan) -> Callable[[], FloatArray]:
    """Return a reader of the current recorded points [m], shape [point_count, 3]."""
    from pxr import Usd, UsdGeom

    def to_world(path: str, points: FloatArray) -> FloatArray:
        xform = UsdGeom.Xformable(stage.GetPrimAtPath(path))
        matrix = np.array(xform.ComputeLocalToWorldTransform(Usd.TimeCode.Default()), dtype=np.float64)
        return points @ matrix[:3, :3] + matrix[3, :3]

    if plan.recorded:
        return lambda: np.concatenate([to_world(path, np.zeros((1, 3))) for path in plan.recorded])
    markers = stage.GetPrimAtPath("/World/Markers")
    bodies = [str(path) for path in markers.GetRelationship("gauge:bodies").GetTargets()]
    nodes = np.array(markers.GetAttribute("gauge:isaac:nodes").Get(), dtype=np.int64)
    weights = np.array(markers.GetAttribute("gauge:isaac:weights").Get(), dtype=np.float64)

    def marker_positions() -> FloatArray:
        meshes = [
            to_world(path, np.array(stage.GetPrimAtPath(path).GetAttribute("points").Get(), dtype=np.float64))
            for path in bodies
        ]
        return np.einsum("mk,mkc->mc", weights, np.concatenate(meshes)[nodes])

    return marker_positions


def generalized(stage: Any, observable: str, points_m: FloatArray) -> FloatArray:
    """Return g(t) of recorded points.

    Args:
        stage: The stage; its `/World/Markers` has faces, lines, corners and edges.
        observable: Kind of g(t).
        points_m: Points [m], shape [frame_count, point_count, 3].

    Returns:
        g(t) in the unit of the observable, shape [frame_count, coordinate_count].
    """
    if observable in ("position", "marker_position"):
        return 1e3 * points_m.reshape(len(points_m), -1)
    markers = stage.GetPrimAtPath("/World/Markers")
    rows = {name: np.array(markers.GetAttribute(f"gauge:{name}").Get() or [], dtype=np.int64) for name in ROW_NAMES}
    if observable == "face_area":
        return face_areas(points_m, rows["faces"])
    if observable == "line_curvature":
        return turning_angles(points_m, rows["lines"])
    return curvatures(points_m, rows["faces"], rows["corner"], rows["edge"])


ROW_NAMES = ("faces", "lines", "corner", "edge")


def face_areas(points_m: FloatArray, faces: NDArray[np.int64]) -> FloatArray:
    """Return the areas of the marker triangles [mm^2], shape [frame_count, face_count]."""
    a, b, c = np.moveaxis(1e3 * points_m[:, faces], 2, 0)
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=-1)


def turning_angles(points_m: FloatArray, lines: NDArray[np.int64]) -> FloatArray:
    """Return the angle between the two segments at each inner marker of a line [rad]."""
    before = {int(end): int(start) for start, end in lines}
    after = {int(start): int(end) for start, end in lines}
    inner = sorted(before.keys() & after.keys())
    incoming = points_m[:, inner] - points_m[:, [before[marker] for marker in inner]]
    outgoing = points_m[:, [after[marker] for marker in inner]] - points_m[:, inner]
    return angles_between(incoming, outgoing)


def curvatures(
    points_m: FloatArray, faces: NDArray[np.int64], corner: NDArray[np.int64], edge: NDArray[np.int64]
) -> FloatArray:
    """Return the angle deficit at each marker [rad], shape [frame_count, marker_count]."""
    full = np.full(points_m.shape[1], 2.0 * np.pi)
    full[edge] = np.pi
    full[corner] = 0.5 * np.pi
    deficit = np.tile(full, (len(points_m), 1))
    for place_in_face in range(3):
        here, following, previous = (faces[:, (place_in_face + shift) % 3] for shift in range(3))
        angles = angles_between(points_m[:, following] - points_m[:, here], points_m[:, previous] - points_m[:, here])
        for column, marker in enumerate(here):
            deficit[:, marker] -= angles[:, column]
    return deficit


def angles_between(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the angles between vectors in [0, pi], shape of the vectors without the last axis."""
    return np.arctan2(np.linalg.norm(np.cross(first, second), axis=-1), (first * second).sum(axis=-1))


# --- simulation ------------------------------------------------------------------------------------------------------


class IsaacSim:
    """Isaac Sim with an open layer: the only part of this script that calls Isaac Sim.

    Args:
        layer: Layer to open.
        gui: Whether to show the window.

    Attributes:
        stage: The open stage.
    """

    def __init__(self, layer: Path, *, gui: bool) -> None:
        from isaacsim import SimulationApp

        # Kit would read the arguments of this script as its own.
        del sys.argv[1:]
        # Isaac Sim 5 has deformable bodies behind this setting.
        beta = "--/persistent/physics/enableDeformableBeta=true"
        self._app = SimulationApp({"headless": not gui, "extra_args": [beta]})
        self._gui = gui
        # These modules exist only after the app has started.
        import carb
        import omni.physx
        import omni.usd

        settings = carb.settings.get_settings()
        # The stage receives poses and points only with these.
        settings.set_bool("/physics/fabricEnabled", False)
        settings.set_bool("/physics/suppressReadback", False)
        settings.set_bool("/physics/updateToUsd", True)
        settings.set_bool("/physics/updateParticlesToUsd", True)
        context = omni.usd.get_context()
        if not context.open_stage(str(layer)):
            self._app.close()
            raise LayerError(f"{layer}: Isaac Sim cannot open the file")
        self.stage = context.get_stage()
        if has_deformable_bodies(self.stage):
            # Exact cylinders do not collide with deformable bodies, convex meshes do.
            settings.set_bool("/physics/collisionApproximateCylinders", True)
        self._stage_id = context.get_stage_id()
        self._physics = omni.physx.get_physx_simulation_interface()

    def start(self) -> None:
        """Build the scene in PhysX, from the stage as it is now."""
        self._physics.attach_stage(self._stage_id)

    def step(self, interval_s: float, time_s: float) -> None:
        """Advance one step; the stage then holds poses and points."""
        self._physics.simulate(interval_s, time_s)
        self._physics.fetch_results()

    def show(self) -> None:
        """Draw the window, if there is one."""
        if self._gui:
            self._app.update()

    def close(self) -> None:
        """Release the scene and end the app, which may end the process."""
        self._physics.detach_stage()
        self._app.close()


def record(simulation: IsaacSim, plan: Plan, record_hz: int) -> FloatArray:
    """Simulate a plan and return its recorded points [m], shape [sample_count, point_count, 3].

    Raises:
        DivergedError: A point is not finite.
    """
    stage = simulation.stage
    take_over_drivers(stage, plan.drivers)
    read = reader(stage, plan)
    simulation.start()
    samples = [read()]
    for step in range(plan.step_count):
        for driver in plan.drivers:
            place(stage, driver, step + 1)
        simulation.step(1.0 / plan.steps_per_second, step / plan.steps_per_second)
        if (step + 1) % (plan.steps_per_second // record_hz) == 0:
            samples.append(read())
            if not np.isfinite(samples[-1]).all():
                time_s = (step + 1) / plan.steps_per_second
                raise DivergedError(f"at {time_s:.4f} s a recorded point is not finite; no file is written")
            simulation.show()
    return np.stack(samples)


def write_csv(path: Path, plan: Plan, values: FloatArray, record_hz: int) -> None:
    """Write g(t) as the CSV that `gauge score` reads."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["time_s", *(f"{name} [{plan.unit}]" for name in plan.coordinates)])
        for sample, row in enumerate(values.tolist()):
            writer.writerow([f"{sample / record_hz:.9f}", *(f"{value:.9g}" for value in row)])


def main(arguments: Sequence[str]) -> int:
    """Simulate a layer and write its trajectory; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("layer", type=Path, help="layer of 'gauge data isaac-sim'")
    parser.add_argument("--out", type=Path, help="CSV to write; by default next to the layer")
    parser.add_argument("--record-hz", type=int, choices=RECORD_HZ, default=FRAME_RATE_HZ, help="samples per second")
    parser.add_argument("--gui", action="store_true", help="show the window")
    chosen = parser.parse_args(arguments)
    out = chosen.out or chosen.layer.with_suffix(".csv")
    if not chosen.layer.is_file():
        print(f"error: {chosen.layer}: no such file", file=sys.stderr)
        return 2
    try:
        simulation = IsaacSim(chosen.layer.resolve(), gui=chosen.gui)
    except LayerError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    try:
        plan = read_plan(simulation.stage)
        points_m = record(simulation, plan, chosen.record_hz)
        if (points_m == points_m[0]).all():
            note = "warning: no recorded point moved; Isaac Sim may not have written its results to the stage"
            print(note, file=sys.stderr)
        write_csv(out, plan, generalized(simulation.stage, plan.observable, points_m), chosen.record_hz)
        print(out)
    except (LayerError, DivergedError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2 if isinstance(error, LayerError) else 1
    finally:
        simulation.close()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
