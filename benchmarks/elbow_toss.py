"""Real tosses of two hinged blocks on every engine: errors and their floor, and what the real hinge does in impacts.

    python benchmarks/elbow_toss.py run ENGINE OUT [--preset NAME] [--half judge] [--every 1] [--set KEY=VALUE ...]
    python benchmarks/elbow_toss.py floor ENGINE OUT       error between two starts within the measurement
    python benchmarks/elbow_toss.py hinge OUT              angular impulse that the real hinge passes on in impacts
    python benchmarks/elbow_toss.py report OUT             the tables of docs/elbow_toss.md

Each command but the last writes a JSON file into the folder OUT. Odd tosses judge; constants are fitted on even ones.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from cube_toss import median, quartiles, write
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from gauge_envs.backends import backend_for
from gauge_envs.evaluation.single_shot import angle_error, bootstrap_interval, perturbed_scene, shot_error
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.single_shot import with_trial
from gauge_envs.references.single_shot import SingleShot, SingleShots, single_shots
from gauge_envs.scene.scene import GRAVITY_M_PER_S2
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S

NAME = "ElbowToss-blocks"
WORLDS = 20
"""Tosses that are built at once."""

FloatArray = NDArray[np.float64]
Toss = tuple[int, FloatArray, FloatArray]
"""Trial, times, and states of the recorded bodies, shape [T, body_count, 13]."""


def shots() -> SingleShots:
    """Return the recorded tosses."""
    found = single_shots(NAME)
    assert found is not None
    return found


def tosses(
    engine: str,
    trials: Sequence[int],
    *,
    settings: Mapping[str, Any] | None = None,
    constants: Mapping[str, float] | None = None,
    floor: bool = False,
) -> Iterator[Toss]:
    """Yield simulated tosses, 180 samples a second.

    Args:
        engine: Name of the backend.
        trials: Numbers of the trials.
        settings: Settings of the engine.
        constants: Constants that replace those of both blocks, as `friction`.
        floor: Whether each toss starts with an error of the size of that of the measured start.
    """
    data = shots()
    changed = {f"{body}.{key}": value for body in data.sidecar.bodies for key, value in (constants or {}).items()}
    experiment = load_experiment(NAME, changed)
    count = round(experiment.scene.duration_s / SAMPLE_INTERVAL_S)
    times_s = SAMPLE_INTERVAL_S * np.arange(count + 1)
    for begin in range(0, len(trials), WORLDS):
        chunk = trials[begin : begin + WORLDS]
        scenes = [with_trial(experiment, trial).scene for trial in chunk]
        if floor:
            scenes = [
                perturbed_scene(scene, data.sidecar, seed=trial) for trial, scene in zip(chunk, scenes, strict=True)
            ]
        worlds = backend_for(engine, None).build_worlds(scenes, dict(settings or {}))
        worlds.reset(0)
        states = np.empty((count + 1, len(chunk), len(data.sidecar.bodies), 13))
        for number in range(count + 1):
            if number:
                worlds.advance(SAMPLE_INTERVAL_S)
            for place, world in enumerate(worlds.worlds):
                states[number, place] = world.body_states(data.sidecar.bodies)
        worlds.close()
        yield from ((trial, times_s, states[:, place]) for place, trial in enumerate(chunk))


def row_of(one: Toss, recorded: Sequence[SingleShot]) -> dict[str, Any]:
    """Return the errors of one simulated toss against the records of its bodies: of each body, means, and the hinge."""
    trial, times_s, states = one
    rotations = [Rotation.from_quat(states[:, place, 3:7], scalar_first=True) for place in range(len(recorded))]
    bodies = [
        asdict(shot_error(shot, times_s, states[:, place, :3], rotations[place])) for place, shot in enumerate(recorded)
    ]
    angle = asdict(angle_error((recorded[0], recorded[1]), times_s, (rotations[0], rotations[1])))
    mean = {key: float(np.mean([body[key] for body in bodies])) for key in bodies[0] if key != "trial"}
    return {"trial": trial} | mean | {f"hinge_{key}": angle[key] for key in ("early_deg", "mean_deg", "rest_deg")}


def records(trial: int) -> list[SingleShot]:
    """Return the record of each body."""
    return [shots().shot(trial, body) for body in shots().sidecar.bodies]


def run(options: argparse.Namespace) -> None:
    """Write the errors of an engine."""
    changes = {key: json.loads(value) for key, value in (text.split("=", 1) for text in options.set)}
    constants = {key: value for key, value in changes.items() if key in ("friction", "restitution", "inertia_kg_m2")}
    settings = {key: value for key, value in changes.items() if key not in constants}
    settings |= {"preset": options.preset} if options.preset else {}
    trials = shots().trials(options.half)[:: options.every]
    start = time.perf_counter()
    found = [
        row_of(one, records(one[0])) for one in tosses(options.engine, trials, settings=settings, constants=constants)
    ]
    name = options.name or f"run-{options.engine}-{options.preset or 'default'}"
    head = {"engine": options.engine, "preset": options.preset or "default", "changes": changes}
    write(options.out, name, head | {"wall_s": time.perf_counter() - start, "rows": found})
    print(name, len(found), {key: median(found, key) for key in KEYS}, flush=True)


def floor(options: argparse.Namespace) -> None:
    """Write the errors between a toss and one with a start within the measurement."""
    trials = shots().trials("judge")[:: options.every]
    plain = {trial: states for trial, _, states in tosses(options.engine, trials)}
    found = []
    for one in tosses(options.engine, trials, floor=True):
        reference = [
            replace(shot, times_s=one[1], positions_m=states[:, :3], quaternions=states[:, 3:7])
            for shot, states in zip(records(one[0]), plain[one[0]].swapaxes(0, 1), strict=True)
        ]
        found.append(row_of(one, reference))
    write(options.out, f"floor-{options.engine}", {"engine": options.engine, "preset": "floor", "rows": found})
    print("floor", len(found), {key: median(found, key) for key in KEYS})


KEYS = ("early_mm", "early_deg", "hinge_early_deg", "rest_mm", "rest_deg", "hinge_rest_deg", "same_face")


def hinge(options: argparse.Namespace) -> None:
    """Placeholder."""


def report(options: argparse.Namespace) -> None:
    """Print the table of the page."""
    print(
        "| engine | preset | tosses | 0.3 s, mm | 0.3 s, degrees | hinge, degrees | 0.8 s, mm | 0.8 s, degrees "
        "| hinge, degrees | same face up |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    for file in (*sorted(options.out.glob("run-*.json")), *sorted(options.out.glob("floor-*.json"))):
        content = json.loads(file.read_text())
        found = content["rows"]
        label = content["preset"] + "".join(f", {key} {value}" for key, value in content.get("changes", {}).items())
        cells = [content["engine"], label, str(len(found)), *(quartiles(found, key) for key in KEYS[:-1])]
        same = 100 * float(np.mean([row["same_face"] for row in found]))
        print(f"| {' | '.join(cells)} | {same:.0f} % |")


def main() -> None:
    """Run one of the commands."""
    parser = argparse.ArgumentParser(description="Real tosses of two hinged blocks on every engine.")
    commands = parser.add_subparsers(required=True)
    for function in (run, floor, hinge, report):
        command = commands.add_parser(function.__name__)
        command.set_defaults(function=function)
        if function in (run, floor):
            command.add_argument("engine")
        command.add_argument("out", type=Path)
        if function in (run, floor):
            command.add_argument("--preset")
            command.add_argument("--half", choices=("fit", "judge"), default="judge")
            command.add_argument("--every", type=int, default=1)
            command.add_argument("--set", nargs="*", default=[])
            command.add_argument("--name")
    options = parser.parse_args()
    options.function(options)


if __name__ == "__main__":
    main()
