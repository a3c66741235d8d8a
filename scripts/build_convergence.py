"""Measure the convergence of whole episodes, and write `scoring/convergence/<engine>.csv`.

Each variant runs with the default settings, with half the time step, and with half the cell if it has deformable
bodies. The finer runs are compared with the default one over all frames, at the material points of the markers. A
finer mesh can change the time step of a preset that depends on the cell. With half the cell, vertex block descent has
four times the iterations: each one moves information by one node, so a finer mesh with as many is less accurate. A
third run has the preset `training`, with engines that have one. A run
that exceeds `LIMIT_S` is stopped, and its row stays absent. The file is written after each row, so that the script
can be stopped at any time.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from gauge_envs.backends import backend
from gauge_envs.envs.arguments import check_support
from gauge_envs.envs.env import GaugeEnv
from gauge_envs.errors import GaugeError, UnsupportedSceneError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.variants import variants
from gauge_envs.files import write_whole
from gauge_envs.references.convergence import (
    REFINED_SETTINGS,
    Convergence,
    RefinedSetting,
    read_convergence,
)
from gauge_envs.references.published import published_baselines
from gauge_envs.scene import Scene, SoftBody
from gauge_envs.scene.geometry import FloatArray
from scripts.generated import SCORING, Request

TRAINING_ENGINES = ("mujoco", "newton")
"""Engines with a preset `training`."""

LIMIT_S = 600.0
"""Wall time of an episode at most [s]."""


class TooSlowError(Exception):
    """The episode exceeded its limit of wall time."""


@dataclass(frozen=True)
class ConvergenceTable:
    """Measured convergence of one engine.

    Attributes:
        notes: Texts of the head of the file by key: `engine` with its version, and `date`.
        rows: Measured rows, by variant and setting.
    """

    notes: Mapping[str, str]
    rows: Mapping[tuple[str, RefinedSetting], Convergence]

    def of(self, variant: str) -> dict[RefinedSetting, Convergence]:
        """Return the rows of a variant by setting; a setting that was not measured is absent."""
        return {
            setting: row
            for setting in REFINED_SETTINGS
            if (row := self.rows.get((variant, setting)))
        }

    @classmethod
    def read(cls, file: Path) -> ConvergenceTable:
        """Read a table."""
        head = [
            line
            for line in file.read_text(encoding="utf-8").splitlines()
            if line.startswith("#")
        ]
        notes = dict(
            line.removeprefix("#").strip().partition(": ")[::2]
            for line in head
            if ": " in line
        )
        read_convergence.cache_clear()
        return cls(notes=notes, rows=read_convergence(file))

    def text(self) -> str:
        """Return the table as the text of its file, sorted by variant and setting."""
        lines = [f"# {key}: {note}" for key, note in self.notes.items()]
        lines.append(",".join(Convergence.model_fields))
        ordered = sorted(
            self.rows.values(),
            key=lambda row: (row.variant, REFINED_SETTINGS.index(row.setting)),
        )
        return "\n".join([*lines, *(_line(row) for row in ordered)]) + "\n"

    def with_rows(self, rows: Iterable[Convergence]) -> ConvergenceTable:
        """Return the table with further rows, which replace those of the same variant and setting."""
        return ConvergenceTable(
            self.notes,
            {**self.rows, **{(row.variant, row.setting): row for row in rows}},
        )


def _line(row: Convergence) -> str:
    values = row.model_dump().values()
    return ",".join(
        "" if value is None else f"{value:.4g}" if isinstance(value, float) else value
        for value in values
    )


@dataclass(frozen=True, kw_only=True)
class Run:
    """One episode.

    Attributes:
        frames: g(t) at 30 Hz, shape [frame_count, coordinate_count].
        points_m: Observed points at the frames, markers or bodies [m], shape [frame_count, point_count, 3].
        settings: Settings in force.
        nodes_m: Nodes of each deformable body at the start [m], shape [node_count, 3].
        steps_per_s: Environment steps per second of processor time.
    """

    frames: FloatArray
    points_m: FloatArray
    settings: Mapping[str, Any]
    nodes_m: Mapping[str, FloatArray]
    steps_per_s: float


def run(name: str, engine: str, settings: Mapping[str, Any]) -> Run:
    """Run an episode with zero actions.

    Raises:
        TooSlowError: It takes longer than the limit.
    """
    env = GaugeEnv(name, backend=engine, settings=settings, marker_proxy="material")
    space = env.action_space
    zero = np.zeros(space.shape) if isinstance(space, gymnasium.spaces.Box) else 0
    try:
        start = time.perf_counter()
        env.reset(seed=0)
        nodes_m = env.episode.nodes_m()
        over, begin = False, time.process_time()
        while not over:
            *_, terminated, truncated, _ = env.step(zero)
            over = terminated or truncated
            if time.perf_counter() - start > LIMIT_S:
                raise TooSlowError
        spent_s = time.process_time() - begin
        trajectory = env.trajectory()
        points = (
            trajectory.bodies[..., :3]
            if trajectory.bodies.size
            else trajectory.markers_m
        )
        count = env.experiment.frame_count
        return Run(
            frames=trajectory.frames[:count],
            points_m=points[:count],
            settings=env.simulation.settings,
            nodes_m=nodes_m,
            steps_per_s=(len(trajectory.frames) - 1) / spent_s,
        )
    finally:
        env.close()


def default_value(
    experiment: Experiment, setting: RefinedSetting, default: Run
) -> float:
    """Return the value of a setting in the default run; the smallest edge for a mesh with a fixed number of cells."""
    value = default.settings.get(setting)
    if value is None:
        value = least_edge_m(experiment.scene, default.nodes_m.__getitem__)
    return float(value)


def least_edge_m(scene: Scene, nodes_m: Callable[[str], FloatArray]) -> float:
    """Return the least edge of the default cells of the deformable bodies of a scene [m]; infinite without any.

    Args:
        scene: The scene.
        nodes_m: Returns the nodes of a body [m], shape [node_count, 3].
    """
    edges_m = [math.inf]
    for body in scene.deformables:
        if isinstance(body, SoftBody):
            # MuJoCo's foam has two cells across a single body, and two along each body of a row.
            edges_m.append(0.5 * min(body.shape.size_m))
        else:
            steps_m = np.diff(nodes_m(body.name), axis=0)
            edges_m.append(float(np.linalg.norm(steps_m, axis=1).min()))
    return min(edges_m)


def finer_settings(
    setting: RefinedSetting, value: float, default: Run
) -> dict[str, Any]:
    """Return the settings of the finer run."""
    settings: dict[str, Any] = {setting: 0.5 * value}
    if setting == "cell_m" and default.settings.get("solver") == "SolverVBD":
        settings["iterations"] = 4 * default.settings["iterations"]
    return settings


def compare(
    name: str,
    setting: RefinedSetting,
    default: Run,
    finer: Run,
    values: tuple[float, float],
) -> Convergence:
    """Return the row of a finer run; without differences if one of the runs diverged."""
    score = load_experiment(name).score
    head = {
        "variant": name,
        "setting": setting,
        "default": values[0],
        "refined": values[1],
    }
    head["unit"] = score.observable.unit
    if default.frames.shape != finer.frames.shape:
        return Convergence.model_validate(head)
    difference = finer.frames - default.frames
    distance = np.sqrt(
        np.nansum(difference**2, axis=1)[np.isfinite(difference).any(axis=1)]
    )
    rms = float(np.sqrt(np.mean(distance**2)))
    baseline = published_baselines(name).get("rmse")
    apart_mm = 1e3 * np.linalg.norm(finer.points_m - default.points_m, axis=-1)
    return Convergence.model_validate(
        head
        | {
            "rms": rms,
            "max": float(distance.max()),
            "share": None if baseline is None else rms / baseline.mean,
            "points_rms_mm": float(np.sqrt(np.nanmean(apart_mm**2))),
            "points_max_mm": float(np.nanmax(apart_mm)),
        }
    )


def measured_rows(
    name: str, engine: str, wanted: Sequence[RefinedSetting]
) -> Iterator[tuple[Convergence, float]]:
    """Yield the wanted rows of a variant, each with the wall time of its finer run [s]."""
    experiment = load_experiment(name)
    default = run(name, engine, {})
    for setting in wanted:
        start = time.perf_counter()
        try:
            if setting == "training":
                finer = run(name, engine, {"preset": setting})
                values = (default.steps_per_s, finer.steps_per_s)
            else:
                value = default_value(experiment, setting, default)
                finer = run(name, engine, finer_settings(setting, value, default))
                values = (value, 0.5 * value)
        except TooSlowError:
            print(f"{name}, {setting}: stopped after {LIMIT_S:g} s", flush=True)
            continue
        yield (
            compare(name, setting, default, finer, values),
            time.perf_counter() - start,
        )


def settings_of(
    name: str, engine: str, chosen: Sequence[RefinedSetting]
) -> list[RefinedSetting]:
    """Return the settings that apply to a variant: rigid bodies have no cells, some engines no preset for training."""
    applying = ["timestep_s"]
    if load_experiment(name).scene.deformables:
        applying.append("cell_m")
    if engine in TRAINING_ENGINES:
        applying.append("training")
    return [setting for setting in chosen if setting in applying]


def supported(name: str, engine: str) -> bool:
    """Return whether an engine can build a variant."""
    try:
        check_support(load_experiment(name), engine)
    except UnsupportedSceneError:
        return False
    return True


def measure(request: Request, scoring: Path = SCORING) -> None:
    """Measure the rows that the tables lack; rows of another version of the engine go first."""
    known = [variant.name for variant in variants()]
    names = dict.fromkeys(
        name for pattern in request.ids for name in known if fnmatchcase(name, pattern)
    )
    for engine in request.engines or TRAINING_ENGINES:
        _measure_engine(engine, names, scoring / "convergence" / f"{engine}.csv")


def _measure_engine(engine: str, names: Iterable[str], file: Path) -> None:
    """Add the missing rows of an engine to its table, which is written after each row."""
    version = ", ".join(
        f"{key} {text}" for key, text in backend(engine).versions().items()
    )
    notes = {
        "written by": "scripts/build_convergence.py",
        "engine": version,
        "date": datetime.now(UTC).date().isoformat(),
    }
    table = ConvergenceTable(notes, {})
    if file.is_file():
        old = ConvergenceTable.read(file)
        if old.notes["engine"] == version:
            table = ConvergenceTable(notes, old.rows)
    for name in names:
        wanted = [
            setting
            for setting in settings_of(name, engine, REFINED_SETTINGS)
            if (name, setting) not in table.rows
        ]
        if not wanted or not supported(name, engine):
            continue
        try:
            for row, wall_s in measured_rows(name, engine, wanted):
                table = table.with_rows([row])
                file.parent.mkdir(exist_ok=True)
                write_whole(file, table.text().encode())
                what = f"{name}, {row.setting}: rms {row.rms} {row.unit}"
                print(f"{what}, share {row.share} ({wall_s:.0f} s)", flush=True)
        except TooSlowError:
            print(
                f"{name}: the default run was stopped after {LIMIT_S:g} s", flush=True
            )
        except GaugeError as error:
            print(f"{name}: {error}", file=sys.stderr, flush=True)
