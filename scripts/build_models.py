"""Solve the calibrated scenes of experiments without a real reference, and write `scoring/models/<variant>.npz`.

`measure` runs each id on engines of different families: default settings, and each of time step, cell and iterations
coarser and finer, one at a time. It extrapolates each of them to zero (Richardson), adds the corrections, and
takes the mean over the engines. An engine only checks a cloth that moves alike across its width, which a sheet solves
(`scripts/sheet.py`), and foam that is pressed, which a block at rest solves (`scripts/solid.py`). The method is in
`studies/models/README.md`.
"""

from __future__ import annotations

import io
import json
import math
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from scipy.spatial import ConvexHull

from gauge_envs.backends import backend
from gauge_envs.backends.world import Simulation
from gauge_envs.envs.env import GaugeEnv
from gauge_envs.errors import GaugeError
from gauge_envs.evaluation.reference import band_grade
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.variants import variants
from gauge_envs.files import write_whole
from gauge_envs.observables.kinds import Observable
from gauge_envs.observables.observer import observe_markers
from gauge_envs.references.grades import BandGrade
from gauge_envs.references.models import (
    BLOCK,
    SHEET,
    STRIDE,
    EngineSolution,
    ModelSidecar,
    Refinement,
    packed,
)
from gauge_envs.references.published import published_baselines
from gauge_envs.scene import Cloth, Rod, Scene, SoftBody
from gauge_envs.scene.fabrics import Fabric
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import DRIVE_INTERVAL_S, FRAME_RATE_HZ
from scripts.build_convergence import least_edge_m, supported
from scripts.extrapolation import (
    LEAST_SPAN,
    anchored,
    combined,
    extrapolate,
    known_frames,
    rms,
)
from scripts.generated import SCORING, Request
from scripts.pressed import LEVELS, faces_of, pressed_block
from scripts.sheet import marker_places_m, sheet_of, solve_sheet
from scripts.solid import is_pressed_block

LIMIT_S = 900.0
"""Processor time of an episode at most [s]."""

SCATTER_SHARE = 0.5
"""Share of the published scatter of real trials at which a reference ends."""

MOTION_SHARE = 0.1
"""Share of the root mean square motion at which a reference ends where no scatter is published."""

SHEET_SHARE = 0.05
"""The same for the markers of a sheet, which is cheap enough to be known better. It was chosen on satin and oxford."""

LEAST_SHARE_APART = 0.02
"""Least uncertainty that is resolved, over the distance of the engines."""

LEAST_UNCERTAINTY = 1e-6
"""Least uncertainty that a file holds, in the unit of g(t)."""

POINT_QUANTUM_MM = 0.01
"""Resolution of stored marker positions [mm]."""

DEFORMABLE_ENGINES = ("mujoco", "newton")
"""Engines of different families for scenes with deformable bodies."""

RIGID_ENGINES = ("mujoco", "rapier", "physx", "drake")
"""Engines of different families for rigid scenes; Newton's rigid solver is MuJoCo's."""

SHEET_CELLS = {1: 80, 2: 160}
"""Cells of a sheet along the warp by default, by the number of its held ends."""

CLOTH_HORIZON_S = 5.0
"""End of the solution of a cloth whose angles are compared [s].

The scenes have no damping, and the implicit steps of engines damp all the same. The longer the motion, the more of the
agreement of engines is that of their damping."""

BLOCK_HORIZON_S = 0.6
"""End of the solution of a block that is pressed [s]. Until then it is at rest in all but its slow motion."""

BLOCK_POINTS_S = 0.5
"""The same of its markers, with which the limits of engines in tests agree [s]."""

TAUT_HORIZON_S = 1.5
"""The same of a sheet between two held ends [s]. It falls flat and is caught; from then on waves run to and fro in it,
and each refinement moves the markers by a tenth of their motion."""

CELL_FACTORS = (2.0, 0.5)
"""Cells of the refined levels over those of the default settings, coarse to fine."""

COSTLY_CELL_FACTORS = (2.0, 2.0 / 3.0)
"""The same for soft bodies and vertex block descent, whose cost grows with a high power of the number of cells."""


@dataclass(frozen=True, kw_only=True)
class Level:
    """One episode with one refined parameter.

    Attributes:
        parameter: `step`, `cell` or `iterations`; `base` for the default settings.
        factor: Size of the parameter over that of the default settings; smaller is finer.
        settings: Settings of the run.
    """

    parameter: str
    factor: float
    settings: Mapping[str, Any]

    @property
    def name(self) -> str:
        """Name of the file of the run."""
        return f"{self.parameter}-{self.factor:.4g}"


def engines_of(experiment: Experiment) -> tuple[str, ...]:
    """Return the engines that solve an experiment, the sheet or the block first where it is one.

    All of them must simulate the same fabric: an engine whose law replaces a constant of it is left out.
    """
    wanted = DEFORMABLE_ENGINES if experiment.scene.deformables else RIGID_ENGINES
    if sheet_of(experiment.scene) is not None:
        return (SHEET, "mujoco")
    if is_pressed_block(experiment.scene):
        return (BLOCK, "mujoco")
    return tuple(
        name
        for name in wanted
        if supported(experiment.name, name)
        and not (is_held_cloth(experiment) and replaces_constants(experiment, name))
    )


def is_held_cloth(experiment: Experiment) -> bool:
    """Return whether the angles of a cloth are compared, whose motion rods and frames alone prescribe."""
    return experiment.score.observable.unit == "rad"


def replaces_constants(experiment: Experiment, engine: str) -> bool:
    """Return whether the law of an engine cannot take all constants of a fabric as they are."""
    mapping = backend(engine).fabric_constants
    return any(
        mapping is not None and bool(mapping(Fabric.of(body)).replaced)
        for body in experiment.scene.deformables
        if isinstance(body, Cloth)
    )


SHEET_LEVELS = (
    Level(parameter="base", factor=1.0, settings={}),
    Level(parameter="cell", factor=2.0, settings={"cell": 2.0}),
    Level(parameter="step", factor=0.5, settings={"step": 0.5}),
    Level(parameter="cell", factor=0.5, settings={"cell": 0.5}),
)
"""Runs of the undamped sheet."""

BLOCK_LEVELS = tuple(
    Level(parameter=parameter, factor=factor, settings=settings)
    for parameter, runs in LEVELS.items()
    for factor, settings in runs
)
"""Runs of the block; its steps are those of the driven body."""


def solved_span(experiment: Experiment) -> int:
    """Return the number of frames, from the first one, that are solved."""
    if is_pressed_block(experiment.scene):
        return min(experiment.frame_count, round(BLOCK_HORIZON_S * FRAME_RATE_HZ) + 1)
    if not is_held_cloth(experiment):
        return experiment.frame_count
    sheet = sheet_of(experiment.scene)
    is_taut = sheet is not None and len(sheet.end_drivers) == 2
    horizon_s = TAUT_HORIZON_S if is_taut else CLOTH_HORIZON_S
    return min(experiment.frame_count, round(horizon_s * FRAME_RATE_HZ) + 1)


def levels_of(experiment: Experiment, engine: str) -> list[Level]:
    """Return the runs of an engine, the cheapest parameters first."""
    if engine == SHEET:
        return list(SHEET_LEVELS)
    if engine == BLOCK:
        return list(BLOCK_LEVELS)
    scene = experiment.scene
    simulation = backend(engine).build(scene, {})
    default = dict(simulation.settings)
    cell_m = default_cell_m(experiment, simulation)
    simulation.close()
    levels = [Level(parameter="base", factor=1.0, settings={})]
    count = round(DRIVE_INTERVAL_S / default["timestep_s"])
    vbd = default.get("solver") == "SolverVBD"
    # A much larger step needs more iterations of vertex block descent, and would change two things at once.
    for steps in (math.ceil((0.75 if vbd else 0.5) * count), 2 * count):
        # Drivers move by whole intervals, so a step divides them.
        step = {"timestep_s": DRIVE_INTERVAL_S / steps}
        levels.append(Level(parameter="step", factor=count / steps, settings=step))
    if sheet_of(scene) is not None:
        # This engine only checks the sheet: where its changes explain the distance, they need not be finer.
        assert cell_m is not None
        coarse = {"cell_m": CELL_FACTORS[0] * cell_m}
        return [
            *levels,
            Level(parameter="cell", factor=CELL_FACTORS[0], settings=coarse),
        ]
    if scene.deformables:
        if vbd:
            for factor in (0.5, 0.25):
                more = {"iterations": round(default["iterations"] / factor)}
                levels.append(
                    Level(parameter="iterations", factor=factor, settings=more)
                )
        else:
            tighter = {
                "tolerance": 1e-2 * default["tolerance"],
                "iterations": 4 * default["iterations"],
            }
            levels.append(Level(parameter="iterations", factor=0.25, settings=tighter))
    if cell_m is not None:
        levels += _cell_levels(scene, default, cell_m=cell_m, step_count=count)
    return levels


def _cell_levels(
    scene: Scene, default: Mapping[str, Any], *, cell_m: float, step_count: int
) -> Iterator[Level]:
    """Yield the runs with other cells: of all deformable bodies of a scene, or of each segment of a rod."""
    is_vbd = default.get("solver") == "SolverVBD"
    is_soft = scene.has(SoftBody)
    is_rod = scene.has(Rod)
    for factor in COSTLY_CELL_FACTORS if is_soft or is_vbd else CELL_FACTORS:
        cell: dict[str, Any] = {"cell_m": factor * cell_m}
        if is_vbd:
            # An iteration moves information by one node.
            cell["iterations"] = max(round(default["iterations"] / factor**2), 1)
        elif factor < 1.0 and is_rod:
            # Shorter segments are stiffer: with a longer step MuJoCo's rod would stretch too much.
            steps = math.ceil(step_count / factor)
            cell["timestep_s"] = DRIVE_INTERVAL_S / steps
        yield Level(parameter="cell", factor=factor, settings=cell)


def default_cell_m(experiment: Experiment, simulation: Simulation) -> float | None:
    """Return the edge of the default cells [m]; None for a scene without cells."""
    if simulation.settings.get("cell_m") is not None:
        return float(simulation.settings["cell_m"])
    if not experiment.scene.deformables:
        return None
    return least_edge_m(experiment.scene, simulation.nodes)


def solve(experiment: Experiment, engine: str, level: Level) -> dict[str, Any]:
    """Return g(t), points and cost of an episode with zero actions; `fault` says why it was left out."""
    if engine == SHEET:
        return solve_as_sheet(experiment, level)
    if engine == BLOCK:
        return solve_as_block(experiment, level)
    start = time.process_time()
    last_frame = solved_span(experiment) - 1
    try:
        env = GaugeEnv(
            experiment.name,
            backend=engine,
            settings=dict(level.settings),
            marker_proxy="material",
        )
    except GaugeError as error:
        return {"fault": str(error)}
    space = env.action_space
    zero = np.zeros(space.shape) if isinstance(space, gymnasium.spaces.Box) else 0
    fault, over = "", False
    try:
        env.reset(seed=0)
        while not over and not fault:
            *_, terminated, truncated, info = env.step(zero)
            over = terminated or truncated or info["frame"] >= last_frame
            fault = info.get("diverged", "")
            if time.process_time() - start > LIMIT_S:
                fault = f"stopped after {LIMIT_S:g} s of processor time"
        trajectory = env.trajectory()
        count = solved_span(experiment)
        points = (
            trajectory.bodies[..., :3]
            if trajectory.bodies.size
            else trajectory.markers_m
        )
        settings = {
            key: value
            for key, value in env.simulation.settings.items()
            if isinstance(value, float | int | str)
        }
        return {
            "frames": trajectory.frames[:count],
            "points_m": points[:count],
            "settings": json.dumps(settings),
            "versions": json.dumps(dict(env.versions)),
            "processor_s": time.process_time() - start,
            "fault": fault,
        }
    finally:
        env.close()


def solve_as_sheet(experiment: Experiment, level: Level) -> dict[str, Any]:
    """Return the same of a sheet, with the factors on cell and step of a level."""
    start = time.process_time()
    sheet, markers = sheet_of(experiment.scene), experiment.scene.markers
    assert sheet is not None
    assert markers is not None
    cells = SHEET_CELLS[len(sheet.end_drivers)]
    nodes_m, _, _ = solve_sheet(
        sheet,
        cells=round(cells / level.settings.get("cell", 1.0)),
        frames=solved_span(experiment),
        step_factor=level.settings.get("step", 1.0),
    )
    points_m = marker_places_m(sheet, nodes_m, np.asarray(markers.positions_m))
    settings = {"preset": "undamped", "cells": cells}
    return _of_points(experiment, points_m, settings, start)


def solve_as_block(experiment: Experiment, level: Level) -> dict[str, Any]:
    """Return the same of a pressed block at rest, and the force of the cube at its places."""
    start = time.process_time()
    scene, markers = experiment.scene, experiment.scene.markers
    assert markers is not None
    block = pressed_block(scene, BLOCK_HORIZON_S, **level.settings)
    times_s = np.arange(solved_span(experiment)) / FRAME_RATE_HZ
    points_m = block.points_m(faces_of(scene, times_s), np.asarray(markers.positions_m))
    settings = {"preset": "at rest", "cells": len(block.block.places_m)}
    found = _of_points(experiment, points_m, settings, start)
    return {**found, "faces_m": block.faces_m, "pushes_n": block.pushes_n}


def _of_points(
    experiment: Experiment,
    points_m: FloatArray,
    settings: Mapping[str, Any],
    start: float,
) -> dict[str, Any]:
    """Return what `solve` does of places of markers, computed since a processor time [s]."""
    markers = experiment.scene.markers
    assert markers is not None
    return {
        "frames": observe_markers(
            points_m, markers=markers, observable=experiment.score.observable
        ),
        "points_m": points_m,
        "settings": json.dumps(settings),
        "versions": json.dumps({"numpy": np.__version__}),
        "processor_s": time.process_time() - start,
        "fault": "",
    }


def wanted_experiments(patterns: Sequence[str]) -> Iterator[Experiment]:
    """Yield the experiments without a real reference whose name matches a pattern, in the order of the patterns."""
    known = [variant.name for variant in variants()]
    for name in dict.fromkeys(
        name for pattern in patterns for name in known if fnmatchcase(name, pattern)
    ):
        if band_grade(name) in (BandGrade.NONE, BandGrade.MODEL):
            yield load_experiment(name)


def solve_all(request: Request) -> None:
    """Run all episodes that the folder lacks."""
    for experiment in wanted_experiments(request.ids):
        for engine in engines_of(experiment):
            if request.engines and engine not in request.engines:
                continue
            for level in levels_of(experiment, engine):
                file = request.results / experiment.name / f"{engine}-{level.name}.npz"
                if file.exists():
                    continue
                values = solve(experiment, engine, level)
                file.parent.mkdir(parents=True, exist_ok=True)
                content = io.BytesIO()
                np.savez_compressed(content, **values)
                write_whole(file, content.getvalue())
                fault = f", {values['fault']}" if values["fault"] else ""
                spent = f"{values.get('processor_s', 0):.0f} s"
                print(
                    f"{experiment.name}, {engine} {level.name}: {spent}{fault}",
                    flush=True,
                )


# --- references ---


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """A finished run of `solve`."""

    engine: str
    parameter: str
    factor: float
    values: Mapping[str, Any]

    def quantity(self, name: str) -> FloatArray:
        """Return `frames`, or `points_m` as `[T, 3 P]` in mm."""
        array = np.asarray(self.values[name], dtype=np.float64)
        return array if name == "frames" else 1e3 * array.reshape(len(array), -1)


def read_runs(folder: Path, frame_count: int) -> list[Run]:
    """Return the runs of a variant that finished."""
    runs = []
    for file in sorted(folder.glob("*.npz")):
        engine, parameter, factor = file.stem.split("-")
        with np.load(file) as archive:
            values = {name: archive[name] for name in archive.files}
        if not str(values["fault"]) and len(values["frames"]) == frame_count:
            runs.append(
                Run(
                    engine=engine,
                    parameter=parameter,
                    factor=float(factor),
                    values=values,
                )
            )
    return runs


def solutions(
    runs: Sequence[Run], quantity: str
) -> dict[str, tuple[FloatArray, FloatArray, dict[str, Any]]]:
    """Return the solution of each engine, its standard uncertainty, and what was refined.

    An engine without a second run of a parameter is left out, because nothing says how far it is from its solution.
    """
    found = {}
    for engine in dict.fromkeys(run.engine for run in runs):
        of_engine = [run for run in runs if run.engine == engine]
        base = next((run for run in of_engine if run.parameter == "base"), None)
        if base is None:
            continue
        start = base.quantity(quantity)
        total, square, refined = np.zeros_like(start), np.zeros_like(start), {}
        for parameter in dict.fromkeys(
            run.parameter for run in of_engine if run is not base
        ):
            levels = sorted(
                [base, *(run for run in of_engine if run.parameter == parameter)],
                key=lambda run: -run.factor,
            )
            factors = [run.factor for run in levels]
            if len(levels) < 2:
                break
            result = extrapolate([run.quantity(quantity) for run in levels], factors)
            total, square = (
                total + result.correction,
                square + np.square(result.uncertainty),
            )
            refined[parameter] = (
                factors,
                result,
                levels[-1].quantity(quantity) - levels[-2].quantity(quantity),
            )
        else:
            if "step" in refined:
                found[engine] = (start + total, np.sqrt(square), refined)
    return found


def write_model(experiment: Experiment, runs: Sequence[Run], folder: Path) -> str:
    """Write the reference of a variant, or return why it has none; empty if it has."""
    each = solutions(runs, "frames")
    wanted = engines_of(experiment)
    # One fabric is worth more than two engines: where only one takes its constants, its refinement is the uncertainty.
    is_sure = SHEET in each or BLOCK in each
    least = 1 if is_sure or (len(wanted) == 1 and is_held_cloth(experiment)) else 2
    if len(each) < least:
        return unsolved_reason(experiment, each)
    each = {engine: each[engine] for engine in wanted if engine in each}
    merged = anchored if is_sure else combined
    name, file = experiment.name, folder / f"{experiment.name}.npz"
    mean, uncertainty, apart = merged(
        [(value, spread) for value, spread, _ in each.values()]
    )
    frame_count = experiment.frame_count
    # A published scatter that geometry forbids is of another unit or observable, and limits nothing.
    baseline = (
        None if experiment.impossible_scores else published_baselines(name).get("rmse")
    )
    motion = rms(mean - mean[0])
    limit = (
        SCATTER_SHARE * baseline.mean
        if baseline is not None and baseline.mean
        else MOTION_SHARE * motion
    )
    count, gap = known_frames(uncertainty, limit)
    known = np.delete(np.arange(count), slice(*gap) if gap else [])
    unit = experiment.score.observable.unit
    exceeds = f"exceeds {limit:.3g} {unit}"
    ends = "" if len(known) == len(mean) else f"its uncertainty {exceeds}"
    if not ends and len(mean) < frame_count:
        ends = (
            "the block is solved at rest, and there it is pressed to a fifth of its width"
            if BLOCK in each
            else "solvers agree there because they damp alike, and the scene has no damping"
        )
    found_points = solutions(runs, "points_m") if unit != "mm" else {}
    points = {engine: found_points[engine] for engine in each if engine in found_points}
    point_count, point_gap, point_arrays = None, None, {}
    if points:
        places, spread, _ = merged(
            [(value, left) for value, left, _ in points.values()]
        )
        # One number for each marker: the uncertainty of a coordinate of it.
        spread = np.sqrt(np.square(spread).reshape(len(spread), -1, 3).mean(axis=2))
        point_count, point_gap = known_frames(
            np.sqrt(3.0) * spread,
            (SHEET_SHARE if SHEET in each else MOTION_SHARE) * rms(places - places[0]),
        )
        point_count = max(point_count, 1)
        if BLOCK in each:
            point_count = min(point_count, round(BLOCK_POINTS_S * FRAME_RATE_HZ) + 1)
        point_arrays = {
            "points": packed(places[:point_count], POINT_QUANTUM_MM),
            "points_uncertainty": spread[:point_count:STRIDE].astype(np.float16),
        }
    is_short = max(count, point_count or 0) < LEAST_SPAN * len(mean)
    if count < 2 or (is_short and not is_sure):
        return (
            f"the solutions of {', '.join(each)} agree for {count / FRAME_RATE_HZ:.2f} of "
            f"{len(mean) / FRAME_RATE_HZ:.2f} s; then the uncertainty of their mean {exceeds}"
        )
    # An angle that is 0 by symmetry is exact, and the engine that checks it is some noise away.
    quantum = rounded(
        max(
            float(np.median(uncertainty[known])),
            1e-9 * float(np.abs(mean).max()),
            LEAST_SHARE_APART * rms(apart[known]),
        )
        / 20.0
    )
    uncertainty = np.maximum(uncertainty, LEAST_UNCERTAINTY)
    values = [value[:count] - mean[:count] for value, _, _ in each.values()]
    arrays = {
        "mean": packed(mean[:count], quantum),
        "offsets": np.array([packed(value, quantum) for value in values]),
        "uncertainty": uncertainty[:count:STRIDE].astype(np.float16),
        **point_arrays,
    }
    sidecar = ModelSidecar(
        unit=unit,
        coordinates=coordinate_names(experiment, mean.shape[1]),
        frames=frame_count,
        solved_frames=count,
        point_frames=point_count,
        gap=gap,
        point_gap=point_gap,
        ends=ends,
        quantum=quantum,
        point_quantum_mm=POINT_QUANTUM_MM if points else None,
        families_apart=digits(rms(apart[known])),
        engines=tuple(
            EngineSolution(
                engine=engine,
                version=", ".join(
                    f"{key} {text}"
                    for key, text in json.loads(str(base.values["versions"])).items()
                ),
                preset=str(json.loads(str(base.values["settings"]))["preset"]),
                refinements=tuple(
                    Refinement(
                        parameter=parameter,
                        factors=tuple(factors),
                        order=None if result.order is None else digits(result.order),
                        change=digits(rms(change[known])),
                        uncertainty=digits(rms(result.uncertainty[known])),
                    )
                    for parameter, (factors, result, change) in refined.items()
                ),
                correction=digits(rms((value - base.quantity("frames"))[known])),
            )
            for engine, (value, _, refined) in each.items()
            for base in [
                next(
                    run
                    for run in runs
                    if run.engine == engine and run.parameter == "base"
                )
            ]
        ),
        processor_s=digits(sum(float(run.values["processor_s"]) for run in runs)),
    )
    content = io.BytesIO()
    np.savez_compressed(content, **arrays)
    write_whole(file, content.getvalue())
    write_whole(
        file.with_suffix(".json"), (sidecar.model_dump_json(indent=1) + "\n").encode()
    )
    return ""


def unsolved_reason(experiment: Experiment, solved_by: Collection[str]) -> str:
    """Return why an experiment has no reference, of which fewer than two engines have finished runs."""
    engines = engines_of(experiment)
    if len(engines) < 2:
        return f"two families of engines are needed, and only {', '.join(engines)} builds it"
    missing = [name for name in engines if name not in solved_by]
    return f"not solved yet: finished runs of {' and '.join(missing)} are missing"


def end_statistics(runs: Sequence[Run]) -> dict[str, dict[str, list[float]]]:
    """Return statistics of the last frame: of each engine the mean, the standard deviation and the number of runs.

    They are of all recorded points, as bodies or markers. Runs of an engine differ in step, cell and iterations. Where
    these change the motion at random, their scatter is what the engine leaves open.
    """
    found: dict[str, dict[str, list[float]]] = {name: {} for name in STATISTICS}
    for engine in dict.fromkeys(run.engine for run in runs):
        points = [
            np.asarray(run.values["points_m"], dtype=np.float64)
            for run in runs
            if run.engine == engine
        ]
        for name, statistic in STATISTICS.items():
            values = [statistic(1e3 * one) for one in points]
            spread = float(np.std(values, ddof=1)) if len(values) > 1 else 0.0
            found[name][engine] = [
                digits(float(np.mean(values))),
                digits(spread),
                len(values),
            ]
    return found


def _hull_area_mm2(points_mm: FloatArray) -> float:
    """Return the area that the points cover at the last frame, seen from above; 0 for fewer than four."""
    return (
        float(ConvexHull(points_mm[-1, :, :2]).volume)
        if points_mm.shape[1] > 3
        else 0.0
    )


STATISTICS: Mapping[str, Callable[[FloatArray], float]] = {
    "mean height [mm]": lambda points_mm: float(points_mm[-1, :, 2].mean()),
    "mean distance moved [mm]": lambda points_mm: float(
        np.linalg.norm(points_mm[-1] - points_mm[0], axis=1).mean()
    ),
    "share that fell by 10 mm or more": lambda points_mm: float(
        np.mean(points_mm[-1, :, 2] < points_mm[0, :, 2] - 10.0)
    ),
    "area seen from above [mm^2]": _hull_area_mm2,
}
"""Statistics of the last frame of an episode whose trajectory is not determined; the argument has shape [T, P, 3]."""


def coordinate_names(experiment: Experiment, width: int) -> tuple[str, ...]:
    """Return names of the coordinates of g(t)."""
    if experiment.score.observable is Observable.POSITION:
        bodies = experiment.recorded
        return tuple(
            f"{body}.{axis}" if len(bodies) > 1 else axis
            for body in bodies
            for axis in "xyz"
        )
    if experiment.score.observable is Observable.MARKER_POSITION:
        return tuple(
            f"marker-{index}.{axis}" for index in range(width // 3) for axis in "xyz"
        )
    return tuple(
        f"{experiment.score.observable.value}-{index}" for index in range(width)
    )


def digits(value: float) -> float:
    """Return three significant digits."""
    return float(f"{value:.3g}")


def rounded(value: float) -> float:
    """Return the power of ten below a value, or twice or five times that."""
    power = 10.0 ** math.floor(math.log10(value))
    return float(
        f"{max(factor for factor in (1.0, 2.0, 5.0) if factor * power <= value * 1.0001) * power:.1g}"
    )


def measure(request: Request) -> None:
    """Run the missing episodes; write the references of all ids with runs, and why others have none."""
    solve_all(request)
    folder = SCORING / "models"
    folder.mkdir(exist_ok=True)
    file = folder / "unsolved.json"
    reasons = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
    for experiment in wanted_experiments(request.ids):
        runs = read_runs(request.results / experiment.name, solved_span(experiment))
        if not runs:
            if not (folder / f"{experiment.name}.npz").is_file():
                reasons[experiment.name] = {
                    "reason": unsolved_reason(experiment, ()),
                    "statistics": {},
                }
            continue
        reason = write_model(experiment, runs, folder)
        reasons.pop(experiment.name, None)
        if reason:
            reasons[experiment.name] = {
                "reason": reason,
                "statistics": end_statistics(runs),
            }
            for stale in folder.glob(f"{experiment.name}.*"):
                stale.unlink()
        print(f"{experiment.name}: {reason or 'written'}", flush=True)
    write_whole(file, (json.dumps(reasons, indent=1, sort_keys=True) + "\n").encode())
