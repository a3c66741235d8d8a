"""Measure error over cost for every installed engine, and write `docs/accuracy_and_cost.md`'s tables and figure.

    python scripts/build_pareto.py --results DIR                  runs what DIR lacks, then writes all files
    python scripts/build_pareto.py --results DIR --engine rapier  runs this engine only, and writes nothing else
    python scripts/build_pareto.py --docs                         writes the page from `scoring/pareto.json`
    python scripts/build_pareto.py --check                        fails if the page is not current

DIR holds result files of `gauge run`. Repeats differ in their seed alone, which changes no start without jitter, and so
are the same episode. They run in rounds: each round runs every setting once, so that other work on the machine does not
fall on one setting alone. A run that is predicted to take longer than `--limit-s`, from the last coarser step, is left
out. Runs of more than `REPEAT_BELOW_S` are not repeated. The script can be stopped at any time.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gauge_envs.runs.batch import run_many
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Result

ROOT = Path(__file__).parents[1]

REPEATS = 3
REPEAT_BELOW_S = 2.0
"""CPU time of an episode above which it runs once [s]: its timing is no longer dominated by short disturbances."""

INTERVAL_S = 1 / 180
"""Interval of the environments [s]; every step divides it."""

SLIDES = ("SlopeSlider-2-wood", "SlopeSlider-2-plastic", "SlopeSlider-2-metal")
BALL, CRADLE, PENDULUM = "BouncingBall-rubber", "NewtonsCradle-metal", "Pendulum-metal"
CARRIED, TURNED = "Turntable-1-wood", "Turntable-3-metal"
VARIANTS = (*SLIDES, BALL, CARRIED, TURNED, PENDULUM, CRADLE)
CONTACTS = (*SLIDES, BALL, TURNED)

DEFAULT_STEPS = {
    "mujoco": (1, 2, 5, 10, 25, 50, 100, 200),
    "rapier": (1, 2, 5, 10, 20, 40),
    "physx": (1, 2, 5, 10, 20, 40),
    "newton": (1, 2, 5, 10, 20, 40),
    "drake": (1, 2, 5, 10, 20, 40),
    "pybullet": (1, 2, 5, 10, 25, 50, 100),
}
"""Steps in 1/180 s with the engine's own preset for the scene."""

IMPACT_STEPS = {"drake": (25, 50, 100, 200, 400, 800)}
"""The same for impacts, where an engine's preset has other steps."""

FEW = {"pybullet": ("SlopeSlider-2-wood", BALL)}
"""Variants of an engine that is slow."""

PRESET_STEPS = (1, 2, 5, 10, 20)
ITERATIONS = {
    "mujoco": ("iterations", (1, 3, 10)),
    "physx": ("position_iterations", (1, 4, 30)),
    "rapier": ("solver_iterations", (1, 4, 16)),
}
"""Setting and values that are varied at the default step of an engine, beside its default."""


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """Runs of one engine and variant, from the coarsest step on; only the step or the iterations differ."""

    engine: str
    variant: str
    points: tuple[Mapping[str, Any], ...]
    parameters: str = "calibrated"
    skipped: list[Mapping[str, Any]] = field(default_factory=list)


def sweeps(engine: str) -> Iterator[Sweep]:
    """Yield the sweeps of an engine, the quick variants first."""
    for variant in FEW.get(engine, VARIANTS):
        impact = variant in (BALL, CRADLE)
        steps = IMPACT_STEPS.get(engine, DEFAULT_STEPS[engine]) if impact else DEFAULT_STEPS[engine]
        points = tuple({"timestep_s": INTERVAL_S / count} for count in steps)
        yield Sweep(engine=engine, variant=variant, points=({}, *points))
        if variant == BALL:
            yield Sweep(engine=engine, variant=variant, points=({}, *points), parameters="recorded")
    if engine in ("mujoco", "rapier", "physx", "newton"):
        own = {"drive_interval_s": INTERVAL_S} if engine == "mujoco" else {}
        for variant in CONTACTS:
            points = tuple(
                {"preset": "out_of_box", "timestep_s": INTERVAL_S / count} | own for count in PRESET_STEPS
            )
            yield Sweep(engine=engine, variant=variant, points=points)
    if engine in ITERATIONS:
        name, values = ITERATIONS[engine]
        for variant in (SLIDES[0], CRADLE):
            yield Sweep(engine=engine, variant=variant, points=tuple({name: value} for value in values))


def request_of(sweep: Sweep, settings: Mapping[str, Any], seed: int) -> RunRequest:
    """Return the request of one run."""
    return RunRequest(
        sweep.variant, backend=sweep.engine, settings=dict(settings), parameters=sweep.parameters, seed=seed
    )


def measure(engine: str, folder: Path, limit_s: float) -> None:
    """Run what a folder lacks of one engine."""
    chosen = list(sweeps(engine))
    for seed in range(REPEATS):
        for sweep in chosen:
            before: Result | None = None
            for settings in sweep.points:
                if settings in sweep.skipped or _predicted_s(before, settings) > limit_s:
                    sweep.skipped.append(settings)
                    continue
                (result,) = run_many([request_of(sweep, settings, seed)], out=folder, resume=True)
                spent_s = result.cpu_s or 0.0
                print(f"{engine} {sweep.variant} {dict(settings)} {result.outcome.value} {spent_s:.2f} s", flush=True)
                if result.error is not None or spent_s > REPEAT_BELOW_S:
                    sweep.skipped.append(settings)
                if settings.get("timestep_s"):
                    before = result


def _predicted_s(before: Result | None, settings: Mapping[str, Any]) -> float:
    """Return the CPU time that a run will take, from that with a coarser step; 0 without one."""
    if before is None or not before.cpu_s or before.diverged or not settings.get("timestep_s"):
        return 0.0
    return before.cpu_s * float(before.settings["timestep_s"]) / float(settings["timestep_s"])


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the script; return its exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--results", type=Path, help="folder of the results")
    parser.add_argument("--engine", action="append", help="measure this engine only; repeatable")
    parser.add_argument("--limit-s", type=float, default=12.0, help="CPU time of an episode at most [s]")
    options = parser.parse_args(arguments)
    for engine in options.engine or DEFAULT_STEPS:
        measure(engine, options.results, options.limit_s)
    return 0


if __name__ == "__main__":
    sys.exit(main())
