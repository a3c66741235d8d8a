"""Real pushes of a cube on every engine: friction, travel, yaw and slip, and what the scatter of pushes leaves.

    python -m studies.pushes.pushes slide       friction of the table from the slide after the push: slides.csv
    python -m studies.pushes.pushes run ENGINE  odd trials, each on its own path: a row of engines.csv
    python -m studies.pushes.pushes run mean    the mean of the even trials from the start of each, without physics

Even trials are for fits, odd trials judge.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from gauge_envs.backends import backend_for
from gauge_envs.envs.driver_paths import DriverPaths
from gauge_envs.envs.trial_start import driven_trial
from gauge_envs.experiments.experiment import TaskExperiment
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.scene import Scene
from gauge_envs.scene.geometry import vector
from gauge_envs.scene.scene import GRAVITY_M_PER_S2
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S
from scripts.build_pushes import (
    NAME,
    START_S,
    Push,
    read_pushes,
)

HERE = Path(__file__).parent
EVEN, ODD = range(0, 20, 2), range(1, 20, 2)
PUSH_S = (-0.1, 0.33)
"""Common times between which the hand pushes."""

COPIES = 10
"""Simulations of each trial: 0.1 um at the start moves the end of MuJoCo's cube by 1.5 mm."""

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Track:
    """Motion of the cube beside that of the hand, S samples.

    Attributes:
        cube_mm: Centre of the cube, shape [S, 3].
        turn_deg: Rotation vector of the cube from its start, shape [S, 3].
        hand_mm: Origin of the body of the hand, shape [S, 3].
    """

    cube_mm: FloatArray
    turn_deg: FloatArray
    hand_mm: FloatArray

    def measures(self, times_s: FloatArray) -> dict[str, float]:
        """Return travel, largest pitch and last yaw of the cube, and its slip along the hand to the left."""
        first, last = (int(np.argmax(times_s >= time_s)) for time_s in PUSH_S)
        apart = (self.cube_mm - self.hand_mm)[:, 1]
        return {
            "travel_mm": float(self.cube_mm[-1, 0] - self.cube_mm[0, 0]),
            "aside_mm": float(self.cube_mm[-1, 1] - self.cube_mm[first, 1]),
            "slip_mm": float(apart[last] - apart[first]),
            "pitch_deg": float(self.turn_deg[:, 1].max()),
            "yaw_deg": float(self.turn_deg[-1, 2]),
        }


def sample_times_s(scene: Scene) -> FloatArray:
    """Return the common times of the samples of an episode."""
    return START_S + SAMPLE_INTERVAL_S * np.arange(
        round(scene.duration_s / SAMPLE_INTERVAL_S) + 1
    )


def recorded(push: Push, times_s: FloatArray) -> Track:
    """Return a recorded push at common times."""
    turn_deg = np.degrees(push.at(push.cube_turn, times_s))
    return Track(
        1e3 * push.at(push.cube_m, times_s),
        turn_deg,
        1e3 * push.at(push.hand_path, times_s)[:, :3],
    )


def own_path(experiment: TaskExperiment, trial: int) -> Scene:
    """Return the scene with the start and the path of a trial, as a reset to it builds it."""
    driven = driven_trial(experiment, trial)
    assert driven is not None
    return driven.scene


def simulated(
    engine: str, scene: Scene, settings: Mapping[str, Any] | None = None
) -> Track:
    """Return a simulated push."""
    simulation = backend_for(engine, None).build(scene, dict(settings or {}))
    simulation.reset(0)
    count = len(sample_times_s(scene))
    paths = DriverPaths(scene, scene.duration_s)
    states = np.empty((count, 2, 13))
    for index in range(count):
        if index:
            paths.advance(simulation, index - 1)
        states[index] = simulation.body_states(("cube", "hand"))
    simulation.close()
    turns = Rotation.from_quat(states[:, 0, 3:7], scalar_first=True).as_rotvec(
        degrees=True
    )
    return Track(1e3 * states[:, 0, :3], turns, 1e3 * states[:, 1, :3])


def mean_push(real: Track, times_s: FloatArray) -> Track:
    """Return the mean of the even trials, from the start of another one."""
    pushes = read_pushes()
    even = [recorded(pushes.trials[trial], times_s) for trial in EVEN]
    cube_mm, turn_deg, hand_mm = (
        np.mean([getattr(one, name) for one in even], axis=0)
        for name in ("cube_mm", "turn_deg", "hand_mm")
    )
    return Track(cube_mm - cube_mm[0] + real.cube_mm[0], turn_deg, hand_mm)


def scored(
    engine: str,
    trials: Sequence[int],
    *,
    copies: int = 1,
) -> list[dict[str, float]]:
    """Return measures and errors of simulated trials, and the measures of the recorded ones as `real_*`.

    Args:
        engine: Name of the backend, or `mean`.
        trials: Numbers of the trials.
        copies: Number of simulations of each trial, whose mean counts: all but one start 0.1 um away.
    """
    pushes = read_pushes()
    experiment = load_experiment(NAME)
    times_s = sample_times_s(experiment.scene)
    pushing = (times_s > PUSH_S[0]) & (times_s < PUSH_S[1])
    rows = []
    for trial in trials:
        real = recorded(pushes.trials[trial], times_s)
        driven, several = own_path(experiment, trial), []
        for copy in range(copies):
            if engine == "mean":
                found = mean_push(real, times_s)
            else:
                found = simulated(engine, shifted(driven, copy, 1e-7 * (copy > 0)))
            error_mm = found.cube_mm[:, 0] - real.cube_mm[:, 0]
            errors = {"rmse_mm": error_mm, "push_rmse_mm": error_mm[pushing]}
            means = {
                name: float(np.sqrt(np.mean(one**2))) for name, one in errors.items()
            }
            several.append(means | found.measures(times_s))
        expected = {
            f"real_{name}": value for name, value in real.measures(times_s).items()
        }
        measures = {
            name: float(np.mean([one[name] for one in several])) for name in several[0]
        }
        spread = float(
            np.std([one["travel_mm"] for one in several])
            * np.sqrt(copies / max(copies - 1, 1))
        )
        rows.append(
            {"trial": float(trial), **measures, "copies_mm": spread, **expected}
        )
    return rows


def shifted(scene: Scene, seed: int, size_m: float) -> Scene:
    """Return the scene with a cube that starts elsewhere on the table, by a normal number in each direction."""
    cube, shift_m = (
        scene.body("cube"),
        np.append(np.random.default_rng(seed).normal(0.0, size_m, 2), 0.0),
    )
    moved = replace(
        cube,
        pose=replace(
            cube.pose, position_m=vector(np.add(cube.pose.position_m, shift_m))
        ),
    )
    return replace(
        scene,
        bodies=tuple(moved if body.name == "cube" else body for body in scene.bodies),
    )


def column(rows: Sequence[Mapping[str, float]], name: str) -> FloatArray:
    """Return one measure of all rows."""
    return np.array([row[name] for row in rows])


def bootstrap(values: FloatArray, *, seed: int = 0) -> tuple[float, float]:
    """Return the 95 % interval of the mean over trials."""
    draws = (
        np.random.default_rng(seed).choice(values, (10_000, len(values))).mean(axis=1)
    )
    low, high = np.percentile(draws, [2.5, 97.5])
    return float(low), float(high)


def summary(rows: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Return the table row of some trials: means, with the 95 % interval of RMSE and error of travel."""
    error_mm = column(rows, "travel_mm") - column(rows, "real_travel_mm")
    ends = {
        "rmse_mm": bootstrap(column(rows, "rmse_mm")),
        "travel_error_mm": bootstrap(error_mm),
    }
    found = {
        "rmse_mm": float(column(rows, "rmse_mm").mean()),
        "travel_error_mm": float(error_mm.mean()),
    }
    both = {
        f"{name}_{end}": value
        for name, pair in ends.items()
        for end, value in zip(("low", "high"), pair, strict=True)
    }
    names = (
        "push_rmse_mm",
        "travel_mm",
        "aside_mm",
        "slip_mm",
        "pitch_deg",
        "yaw_deg",
        "copies_mm",
    )
    means = {name: float(column(rows, name).mean()) for name in names}
    stds = {
        f"{name}_std": float(column(rows, name).std(ddof=1))
        for name in ("travel_mm", "yaw_deg")
    }
    return (
        found
        | both
        | {"travel_error_std_mm": float(error_mm.std(ddof=1))}
        | means
        | stds
    )


def write(name: str, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write a table beside this script."""
    with (HERE / name).open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        for row in rows:
            writer.writerow(
                {
                    key: f"{cell:.3f}" if isinstance(cell, float) else cell
                    for key, cell in row.items()
                }
            )


def slide_friction(
    times_s: FloatArray, positions_m: FloatArray, *, last_m: float = 0.006
) -> tuple[float, float]:
    """Return the coefficient of friction of a slide to rest, and its standard error.

    A free body on a level table ends with x = x_end - mu g (t_end - t)^2 / 2, fitted to the last part of its path.

    Args:
        times_s: Times, shape [T].
        positions_m: Positions along the slide, at rest at the end, shape [T].
        last_m: Length of the part that is fitted.
    """
    left_m = np.median(positions_m[-20:]) - positions_m
    first = int(np.flatnonzero(left_m > last_m)[-1]) + 1
    part = slice(first, first + 25)

    def misfit(parameters: FloatArray) -> FloatArray:
        friction, end_s, end_mm = parameters
        left_s = np.maximum(end_s - times_s[part], 0.0)
        return (
            end_mm
            - 500.0 * friction * GRAVITY_M_PER_S2 * left_s**2
            - 1e3 * positions_m[part]
        )

    fit = least_squares(
        misfit,
        [0.3, times_s[first] + 0.06, 1e3 * positions_m[-1]],
        x_scale=[0.1, 0.01, 1.0],
    )
    variance = 2.0 * fit.cost / (len(fit.fun) - 3) * np.linalg.inv(fit.jac.T @ fit.jac)
    return float(fit.x[0]), float(np.sqrt(variance[0, 0]))


def slide(options: argparse.Namespace) -> None:
    """Write the friction of each slide, and print both halves."""
    rows = []
    for trial, push in enumerate(read_pushes().trials):
        late = push.times_s > 0.3
        friction, error = slide_friction(push.times_s[late], push.cube_m[late, 0])
        rows.append(
            {
                "trial": trial,
                "half": "judge" if trial % 2 else "fit",
                "friction": friction,
                "error": error,
            }
        )
    write("slides.csv", rows)
    for half in ("fit", "judge"):
        values = np.array([row["friction"] for row in rows if row["half"] == half])
        print(half, values.mean(), bootstrap(values), "std", values.std(ddof=1))


def run(options: argparse.Namespace) -> None:
    """Write the row of an engine, and that of the recorded pushes."""
    file = HERE / "engines.csv"
    rows: list[Mapping[str, Any]] = []
    if file.is_file():
        with file.open(encoding="utf-8", newline="") as stream:
            rows = [
                row
                for row in csv.DictReader(stream)
                if row["engine"] not in (options.engine, "recorded")
            ]
    found = scored(options.engine, ODD, copies=COPIES)
    rows.append({"engine": options.engine, **summary(found)})
    names = [name for name in found[0] if name.startswith("real_")]
    real = [
        row | {name.removeprefix("real_"): row[name] for name in names} for row in found
    ]
    nothing = {"rmse_mm": 0.0, "push_rmse_mm": 0.0, "copies_mm": 0.0}
    rows.append({"engine": "recorded", **summary([row | nothing for row in real])})
    write("engines.csv", sorted(rows, key=lambda row: row["engine"]))
    travel = np.corrcoef(column(found, "travel_mm"), column(found, "real_travel_mm"))[
        0, 1
    ]
    print(rows[-2], "correlation of travel", travel)


def main() -> None:
    """Run one command."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(required=True)
    for function in (slide, run):
        command = commands.add_parser(function.__name__)
        command.set_defaults(function=function)
        if function is run:
            command.add_argument("engine")
    options = parser.parse_args()
    options.function(options)


if __name__ == "__main__":
    main()
