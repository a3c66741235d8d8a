"""Real tosses of a cube on every engine: errors, their floor, and impacts.

    python cube_toss.py run ENGINE OUT [--preset NAME] [--half judge] [--every 1] [--set KEY=VALUE ...]
    python cube_toss.py floor ENGINE OUT        error between two starts within the measurement
    python cube_toss.py recorded OUT            impacts of the recorded tosses
    python cube_toss.py report OUT              the tables of the study

Each command but the last writes JSON files into the folder OUT. Odd tosses judge; `cube_toss_fit.py`
fits constants on even ones. Tosses that repeat an earlier one are left out.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmarks.toss_errors import (
    bootstrap_interval,
    impacts,
    perturbed_scene,
    shot_error,
)
from gauge_envs.backends import backend_for
from gauge_envs.experiments.resolve import load_experiment, with_trial
from gauge_envs.references.single_shot import SingleShots, single_shots
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S

FloatArray = NDArray[np.float64]
Toss = tuple[int, FloatArray, FloatArray]
"""Trial, times [s], and states of the recorded bodies, shape [T, body_count, 13]."""


def recorded_tosses(name: str) -> SingleShots:
    """Return the recorded tosses of an experiment."""
    found = single_shots(name)
    assert found is not None
    return found


def simulated_tosses(
    name: str,
    engine: str,
    trials: Sequence[int],
    *,
    settings: Mapping[str, Any],
    constants: Mapping[str, float],
    floor: bool,
    worlds_at_once: int,
) -> Iterator[Toss]:
    """Yield simulated tosses, 180 samples a second.

    Args:
        name: Name of the experiment.
        engine: Name of the backend.
        trials: Numbers of the trials.
        settings: Settings of the engine.
        constants: Constants that replace the calibrated ones, as `cube.friction`.
        floor: Whether each toss starts with an error of the size of that of the measured start.
        worlds_at_once: Number of tosses that are built at once.
    """
    sidecar = recorded_tosses(name).sidecar
    experiment = load_experiment(name, dict(constants))
    count = round(experiment.scene.duration_s / SAMPLE_INTERVAL_S)
    times_s = np.asarray(SAMPLE_INTERVAL_S * np.arange(count + 1), dtype=np.float64)
    for begin in range(0, len(trials), worlds_at_once):
        chunk = trials[begin : begin + worlds_at_once]
        scenes = [with_trial(experiment, trial).scene for trial in chunk]
        if floor:
            scenes = [
                perturbed_scene(scene, sidecar, seed=trial)
                for trial, scene in zip(chunk, scenes, strict=True)
            ]
        worlds = backend_for(engine, None).build_worlds(scenes, dict(settings))
        worlds.reset(0)
        states = np.empty((count + 1, len(chunk), len(sidecar.bodies), 13))
        for number in range(count + 1):
            if number:
                worlds.advance(SAMPLE_INTERVAL_S)
            for place, world in enumerate(worlds.worlds):
                states[number, place] = world.body_states(sidecar.bodies)
        worlds.close()
        yield from (
            (trial, times_s, states[:, place]) for place, trial in enumerate(chunk)
        )


class Run:
    """One run of an engine, as the command line asks for it.

    Args:
        options: Options of `add_run_options`.
        recorded: The recorded tosses.
        is_constant: Whether a changed key is a constant of the bodies; the others are settings of the engine.
    """

    def __init__(
        self,
        options: argparse.Namespace,
        recorded: SingleShots,
        is_constant: Callable[[str], bool],
    ) -> None:
        changes = {
            key: json.loads(value)
            for key, value in (text.split("=", 1) for text in options.set)
        }
        self.constants = {
            key: value for key, value in changes.items() if is_constant(key)
        }
        self.settings = {
            key: value for key, value in changes.items() if key not in self.constants
        }
        self.settings |= {"preset": options.preset} if options.preset else {}
        self.trials = recorded.trials(options.half, every=options.every)
        preset = options.preset or "default"
        self.name = options.name or f"run-{options.engine}-{preset}"
        self._head = {"engine": options.engine, "preset": preset, "changes": changes}
        self._out, self._start = options.out, time.perf_counter()

    def write(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Write the rows, with what ran and how long it took."""
        write(
            self._out,
            self.name,
            self._head | {"wall_s": time.perf_counter() - self._start, "rows": rows},
        )


def add_run_options(command: argparse.ArgumentParser) -> None:
    """Add the options of a run to a command."""
    command.add_argument("--preset")
    command.add_argument("--half", choices=("fit", "judge"), default="judge")
    command.add_argument("--set", nargs="*", default=[])
    command.add_argument("--name")


def write(out: Path, name: str, content: Any) -> None:
    """Write one JSON file."""
    out.mkdir(parents=True, exist_ok=True)
    (out / f"{name}.json").write_text(json.dumps(content), encoding="utf-8")


def median(found: Sequence[Mapping[str, Any]], key: str) -> float:
    """Return the rounded median of one error."""
    return round(float(np.median([row[key] for row in found])), 2)


def quartiles(found: Sequence[Mapping[str, Any]], key: str) -> str:
    """Return the median of one error with its quartiles."""
    low, middle, high = np.percentile([row[key] for row in found], [25, 50, 75])
    return f"{middle:.1f} ({low:.1f} to {high:.1f})"


NAME = "CubeToss-acrylic"
HALF_WIDTH_M = 0.0524
WORLDS = 50
"""Tosses that are built at once."""

FloatArray = NDArray[np.float64]


def shots() -> SingleShots:
    """Return the recorded tosses."""
    return recorded_tosses(NAME)


def toss(
    engine: str,
    trials: Sequence[int],
    *,
    settings: Mapping[str, Any] | None = None,
    constants: Mapping[str, float] | None = None,
    floor: bool = False,
) -> Iterator[tuple[int, FloatArray, FloatArray, Rotation]]:
    """Yield trial, times, positions and orientations of simulated tosses; the arguments are those of `tosses`."""
    some = simulated_tosses(
        NAME,
        engine,
        trials,
        settings=settings or {},
        constants=constants or {},
        floor=floor,
        worlds_at_once=WORLDS,
    )
    for trial, times_s, states in some:
        yield (
            trial,
            times_s,
            states[:, 0, :3],
            Rotation.from_quat(states[:, 0, 3:7], scalar_first=True),
        )


Toss = tuple[int, FloatArray, FloatArray, Rotation]


def row_of(one: Toss) -> dict[str, Any]:
    """Return the errors and the impacts of one simulated toss."""
    trial, times_s, positions_m, rotations = one
    body = load_experiment(NAME).scene.body("cube")
    struck = impacts(body, HALF_WIDTH_M, times_s, positions_m, rotations)
    error = asdict(shot_error(shots().shot(trial), times_s, positions_m, rotations))
    return error | {"impacts": [asdict(impact) for impact in struck]}


def rows(engine: str, trials: Sequence[int], **keywords: Any) -> list[dict[str, Any]]:
    """Return errors and impacts of each simulated toss."""
    return [row_of(one) for one in toss(engine, trials, **keywords)]


def run(options: argparse.Namespace) -> None:
    """Write the errors of an engine."""
    wanted = Run(options, shots(), lambda key: key.startswith("cube."))
    found = rows(
        options.engine,
        wanted.trials,
        settings=wanted.settings,
        constants=wanted.constants,
    )
    wanted.write(found)
    print(
        wanted.name,
        len(found),
        {key: median(found, key) for key in ("early_mm", "early_deg", "rest_mm")},
    )


def floor(options: argparse.Namespace) -> None:
    """Write the errors between a toss and one with a start within the measurement."""
    trials = shots().trials("judge", every=options.every)
    plain = {trial: rest for trial, *rest in toss(options.engine, trials)}
    found = []
    for trial, times_s, positions_m, rotations in toss(
        options.engine, trials, floor=True
    ):
        _, reference_m, turned = plain[trial]
        shot = replace(
            shots().shot(trial),
            times_s=times_s,
            positions_m=reference_m,
            quaternions=turned.as_quat(scalar_first=True),
        )
        found.append(asdict(shot_error(shot, times_s, positions_m, rotations)))
    write(
        options.out,
        f"floor-{options.engine}",
        {"engine": options.engine, "rows": found},
    )
    print(
        options.engine,
        {
            key: median(found, key)
            for key in ("early_mm", "early_deg", "rest_mm", "rest_deg")
        },
    )


def loss(row: Mapping[str, float]) -> float:
    """Return the mean position error in half widths plus the mean rotation error in radians."""
    return row["mean_mm"] / (1e3 * HALF_WIDTH_M) + float(np.radians(row["mean_deg"]))


def recorded(options: argparse.Namespace) -> None:
    """Write the impacts of the independent recorded tosses."""
    data, body = shots(), load_experiment(NAME).scene.body("cube")
    found = []
    for trial in data.trials():
        shot = data.shot(trial)
        rotations = Rotation.from_quat(shot.quaternions, scalar_first=True)
        struck = impacts(body, HALF_WIDTH_M, shot.times_s, shot.positions_m, rotations)
        found.append({"trial": trial, "impacts": [asdict(impact) for impact in struck]})
    write(options.out, "recorded", {"rows": found})


def report(options: argparse.Namespace) -> None:
    """Print the tables of the page."""
    print(
        "| engine | preset | tosses | 0.3 s, mm | 0.3 s, degrees | at rest, mm | at rest, degrees | same face |"
    )
    print("|---|---|---|---|---|---|---|---|")
    keys = ("early_mm", "early_deg", "rest_mm", "rest_deg")
    for file in (
        *sorted(options.out.glob("run-*.json")),
        *sorted(options.out.glob("floor-*.json")),
    ):
        content = json.loads(file.read_text())
        found = content["rows"]
        label = "floor" if file.name.startswith("floor") else content["preset"]
        if content.get("changes"):
            label += f", {content['changes']}"
        cells = [
            content["engine"],
            label,
            str(len(found)),
            *(quartiles(found, key) for key in keys),
        ]
        same = 100 * float(np.mean([row["same_face"] for row in found]))
        print(f"| {' | '.join(cells)} | {same:.0f} % |")
    print(
        "\n| engine | mean error, mm | mean error, degrees | loss | slip at rest, mm/s |\n|---|---|---|---|---|"
    )
    for file in sorted(options.out.glob("run-*.json")):
        content = json.loads(file.read_text())
        found = content["rows"]
        cells = [f"{file.stem.removeprefix('run-')}"]
        for values in (
            [row["mean_mm"] for row in found],
            [row["mean_deg"] for row in found],
            [*map(loss, found)],
        ):
            low, high = bootstrap_interval(values, np.mean)
            cells.append(f"{np.mean(values):.3g} [{low:.3g}, {high:.3g}]")
        print(f"| {' | '.join([*cells, quartiles(found, 'slip_mm_per_s')])} |")
    print("\n| | corner: number, e, energy lost | edge | face |\n|---|---|---|---|")
    for file in (
        options.out / "recorded.json",
        *sorted(options.out.glob("run-*.json")),
    ):
        if file.is_file():
            print(
                f"| {file.stem} | {' | '.join(_impact_cells(json.loads(file.read_text())['rows']))} |"
            )


def _impact_cells(found: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    struck = [impact for row in found for impact in row["impacts"]]
    for kind in ("corner", "edge", "face"):
        some = [impact for impact in struck if impact["kind"] == kind]
        if len(some) < 5:
            yield f"{len(some)}"
            continue
        texts = []
        for key in ("restitution", "energy_lost"):
            values = [impact[key] for impact in some]
            low, high = bootstrap_interval(values)
            texts.append(f"{np.median(values):.2f} [{low:.2f}, {high:.2f}]")
        yield f"{len(some)}, {', '.join(texts)}"


def main() -> None:
    """Run one of the commands."""
    parser = argparse.ArgumentParser(
        description="Real tosses of a cube on every engine."
    )
    commands = parser.add_subparsers(required=True)
    for function in (run, floor, recorded, report):
        command = commands.add_parser(function.__name__)
        command.set_defaults(function=function)
        if function in (run, floor):
            command.add_argument("engine")
        command.add_argument("out", type=Path)
        if function in (run, floor):
            command.add_argument("--every", type=int, default=1)
        if function is run:
            add_run_options(command)
    options = parser.parse_args()
    options.function(options)


if __name__ == "__main__":
    main()
