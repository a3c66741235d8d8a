"""Measure error over cost for every installed engine; write the table of `docs/accuracy_and_cost.md`.

The folder of results holds result files of `gauge run`, so the builder can be stopped at any time, and goes on where it
was. Engines that live in another environment run there, with `--engine` and the same folder. Engines that are not
installed are left out with a note. What the folder lacks stays as `scoring/pareto.json` has it, with its date.

Repeats differ in their seed alone, which changes no start without jitter, and so are the same episode. They run in
rounds: each round runs every setting once, so that other work on the machine does not fall on one setting alone. A run
that is predicted to take longer than `LIMIT_S`, from the last coarser step, is left out; an engine's default settings
are not. Runs of more than `REPEAT_BELOW_S` are not repeated.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from gauge_envs import load_experiment
from gauge_envs.backends import backend
from gauge_envs.errors import MissingExtraError
from gauge_envs.files import json_ready, processor, write_whole
from gauge_envs.runs.batch import run_many
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Result
from gauge_envs.runs.result_file import load_result
from gauge_envs.scene.timing import DRIVE_INTERVAL_S
from gauge_envs.tools.compare.cost import ErrorMeasure, step_text
from scripts.generated import (
    ROOT,
    SCORING,
    Request,
    markdown_table,
    page_part,
    stale_note,
)
from scripts.pareto import tradeoff, with_floor
from scripts.pareto_model import Family, Tradeoff

DATA = SCORING / "pareto.json"
PAGE = ROOT / "docs" / "accuracy_and_cost.md"
SCRIPT = f"scripts/{Path(__file__).name}"

LIMIT_S = 10.0
"""CPU time of an episode at most [s]."""

REPEATS = 3
"""Runs of each setting, whose least CPU time counts."""

REPEAT_BELOW_S = 3.0
"""CPU time of an episode above which it runs once [s]: its timing is no longer dominated by short disturbances."""

SLIDES = ("SlopeSlider-2-wood", "SlopeSlider-2-plastic", "SlopeSlider-2-metal")
BALL, CRADLE, PENDULUM = "BouncingBall-rubber", "NewtonsCradle-metal", "Pendulum-metal"
CARRIED, TURNED = "Turntable-1-wood", "Turntable-3-metal"
VARIANTS = (*SLIDES, BALL, CARRIED, TURNED, PENDULUM, CRADLE)
LONG = (PENDULUM, CRADLE)
"""Variants of 100 s and 34 s, which take most of the time."""

EVERY_OTHER = ("newton", "drake")
"""Engines that run every other step of `LONG` only: all steps, three times each, would take six minutes of CPU time."""

CONTACTS = (*SLIDES, BALL, TURNED)

DEFAULT_STEPS = {
    "mujoco": (1, 2, 5, 10, 25, 50, 100, 200),
    "rapier": (1, 2, 5, 10, 20, 40),
    "physx": (1, 2, 5, 10, 20, 40),
    "newton": (1, 2, 5, 10, 20, 40),
    "drake": (1, 2, 5, 10, 20, 40),
    "pybullet": (1, 2, 5, 10, 25, 50, 100),
    "genesis": (1, 2, 5, 10, 20, 50),
}
"""Steps in 1/180 s with the engine's own preset for the scene."""

IMPACT_STEPS = {"drake": (25, 50, 100, 200, 400, 800), "genesis": (20, 50, 100, 200)}
"""The same for impacts, where an engine's preset has other steps."""

FEW = {"genesis": (*SLIDES, BALL, TURNED), "pybullet": (*SLIDES, BALL, CARRIED, TURNED)}
"""Variants of engines that are slow. Genesis builds the scene for each step, for 2 to 4 s, and takes 20 s of CPU time
for the pendulum; PyBullet takes 2 s for the pendulum and the cradle already at the coarsest step."""

KEEPS_MODEL = ("genesis",)
"""Engines that start a repeat without building the scene again, so that repeats follow each other directly."""

EXACT = ("settings_given", "effort", "step_s", "sufficient_step_s")
"""Fields of the data that are requests, and so are not rounded."""

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
        steps = DEFAULT_STEPS[engine]
        if variant in (BALL, CRADLE):
            steps = IMPACT_STEPS.get(engine, steps)
        if engine in EVERY_OTHER and variant in LONG:
            steps = steps[::2]
        points = tuple({"timestep_s": DRIVE_INTERVAL_S / count} for count in steps)
        yield Sweep(engine=engine, variant=variant, points=({}, *points))
        if variant == BALL:
            yield Sweep(
                engine=engine,
                variant=variant,
                points=({}, *points),
                parameters="recorded",
            )
    if engine in ("mujoco", "rapier", "physx", "newton"):
        chosen: dict[str, Any] = {"preset": "out_of_box"}
        if engine == "mujoco":
            # Its own interval of 2 ms does not divide that of the environments.
            chosen["drive_interval_s"] = DRIVE_INTERVAL_S
        for variant in CONTACTS:
            own_steps = tuple(
                chosen | {"timestep_s": DRIVE_INTERVAL_S / count}
                for count in PRESET_STEPS
            )
            yield Sweep(engine=engine, variant=variant, points=own_steps)
    if engine in ITERATIONS:
        name, values = ITERATIONS[engine]
        for variant in (SLIDES[0], CRADLE):
            yield Sweep(
                engine=engine,
                variant=variant,
                points=tuple({name: value} for value in values),
            )


def run_engine(engine: str, folder: Path) -> None:
    """Run what a folder lacks of one engine."""
    try:
        backend(engine)
    except MissingExtraError as error:
        print(f"note: {engine} is left out: {error}", file=sys.stderr)
        return
    rounds = (
        [tuple(range(REPEATS))]
        if engine in KEEPS_MODEL
        else [(seed,) for seed in range(REPEATS)]
    )
    chosen = list(sweeps(engine))
    for seeds in rounds:
        for sweep in chosen:
            before: Result | None = None
            for settings in sweep.points:
                predicted_s = 0.0
                if before is not None and not before.diverged:
                    steps = before.settings["timestep_s"] / settings["timestep_s"]
                    predicted_s = steps * (before.cpu_s or 0.0)
                if settings in sweep.skipped or predicted_s > LIMIT_S:
                    sweep.skipped.append(settings)
                    continue
                results = [run(sweep, settings, seed, folder) for seed in seeds]
                failed = any(one.error is not None for one in results)
                if failed or (results[0].cpu_s or 0.0) > REPEAT_BELOW_S:
                    sweep.skipped.append(settings)
                if "timestep_s" in settings:
                    before = results[0]


def run(sweep: Sweep, settings: Mapping[str, Any], seed: int, folder: Path) -> Result:
    """Return one run, from a folder that has it or a new one."""
    request = RunRequest(
        sweep.variant,
        backend=sweep.engine,
        settings=dict(settings),
        parameters=sweep.parameters,
        seed=seed,
    )
    (result,) = run_many([request], out=folder, resume=True)
    outcome = f"{result.outcome.value} {result.cpu_s} s {result.error}"
    print(f"{sweep.engine} {sweep.variant} {dict(settings)} {outcome}", flush=True)
    return result


def gathered(results: Iterable[Result], stored: Mapping[str, Any]) -> dict[str, Any]:
    """Return the data with those of results; other engines and phenomena stay as they are stored."""
    found = tradeoff(results)
    for note in found.notes:
        print(f"note: {note}", file=sys.stderr)
    new = asdict(found)
    before = {str(one["name"]): one for one in stored["tradeoff"]["phenomena"]}
    dates = dict(stored["provenance"]["dates"])
    for phenomenon in new["phenomena"]:
        families = list(phenomenon["families"])
        engines = {family["backend"] for family in families}
        dates |= dict.fromkeys(engines, datetime.now(UTC).date().isoformat())
        kept = before.pop(phenomenon["name"], {}).get("families", [])
        families += [one for one in kept if one["backend"] not in engines]
        phenomenon["families"] = sorted(families, key=lambda one: str(one["backend"]))
    new["phenomena"] = sorted(
        [*new["phenomena"], *before.values()], key=lambda one: str(one["name"])
    )
    provenance = {
        "written by": SCRIPT,
        "dates": dates,
        "machine": f"{os.cpu_count()} cores of {processor()}, shared with other work",
    }
    return {"provenance": provenance, "tradeoff": _rounded(json_ready(new))}


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {
            key: one if key in EXACT else _rounded(one) for key, one in value.items()
        }
    if isinstance(value, list):
        return [_rounded(one) for one in value]
    return float(f"{value:.4g}") if isinstance(value, float) else value


def page(notes: Mapping[str, Any], found: Tradeoff) -> str:
    """Return the generated part of the page: the sufficient steps of the default presets, with their costs."""
    families = {
        (one.name, family.backend): family
        for one in found.phenomena
        for family in one.families
        if family.is_default
    }
    engines = sorted({backend for _, backend in families})
    rows = []
    for phenomenon in found.phenomena:
        name = phenomenon.name
        cells = [sufficient(families.get((name, engine))) for engine in engines]
        rows.append([name.replace(", ", " "), *cells])
    of_date: dict[str, list[str]] = {}
    for engine, date in sorted(notes["dates"].items()):
        of_date.setdefault(date, []).append(engine)
    dates = "; ".join(f"{', '.join(of_date[date])} {date}" for date in sorted(of_date))
    lines = [
        *stale_note("pareto-data"),
        *markdown_table(("experiment", *engines), rows),
        "",
        f"Measured: {dates}; {notes['machine']}. "
        "Inputs are those of the date of each engine, and costs are over MuJoCo's of that date.",
    ]
    return "\n".join(lines)


def sufficient(family: Family | None) -> str:
    """Return the sufficient step of a series and its cost over MuJoCo's; empty if the series did not run."""
    if family is None:
        return ""
    for point in family.points:
        if point.is_on_main_line and point.step_s == family.sufficient_step_s:
            return f"{step_text(point.step_s)}, {point.cost_ratio:.2g}"
    return "not resolved"


def stored() -> tuple[dict[str, Any], Tradeoff]:
    """Return the data, and their errors with the parametric floors of today, and the steps that suffice for them."""
    values = json.loads(DATA.read_text(encoding="utf-8"))
    adapter = TypeAdapter(Tradeoff)
    found = adapter.validate_python(values["tradeoff"])
    phenomena = []
    for one in found.phenomena:
        parameters = one.name.partition(", ")[2] or "calibrated"
        measures = [
            ErrorMeasure.of(load_experiment(name, parameters=parameters))
            for name in one.ids
        ]
        families = tuple(
            with_floor(family, measures, over_scatter=one.unit == "scatter")
            for family in one.families
        )
        phenomena.append(replace(one, families=families))
    today = _rounded(json_ready(asdict(replace(found, phenomena=tuple(phenomena)))))
    return values, adapter.validate_python(today)


def contents(scoring: Path = SCORING) -> dict[Path, str]:
    """Return the data with the floors of today, and the page with its generated part replaced."""
    values, found = stored()
    data = values | {"tradeoff": json_ready(asdict(found))}
    text = page(values["provenance"], found)
    return {
        DATA: json.dumps(data, separators=(",", ":")) + "\n",
        **page_part(PAGE, "pareto", SCRIPT, text),
    }


def measure(request: Request) -> None:
    """Run what the folder lacks, of all engines or of some, and write the data."""
    for engine in request.engines or DEFAULT_STEPS:
        run_engine(engine, request.results)
    results = [load_result(file) for file in sorted(request.results.glob("*.json"))]
    values = gathered(results, json.loads(DATA.read_text(encoding="utf-8")))
    write_whole(DATA, (json.dumps(values, separators=(",", ":")) + "\n").encode())
