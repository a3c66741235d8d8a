"""Recorded tosses on an engine: what the scripts of the cube and of the hinged blocks share."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from toss_errors import perturbed_scene

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
