"""Measure every installed engine with its presets, and write the tables of `docs/engines/comparison.md`.

    python scripts/build_engine_table.py --results DIR                  measures what DIR lacks, then writes both files
    python scripts/build_engine_table.py --results DIR --engine rapier  measures this engine only; ranks stay
    python scripts/build_engine_table.py --results DIR --grades         runs what the ranks need; writes the ranks only
    python scripts/build_engine_table.py --again CHECK                  runs a check again in all configurations
    python scripts/build_engine_table.py --docs                         writes the page from `scoring/engines.json`
    python scripts/build_engine_table.py --tables                       prints all tables of the data
    python scripts/build_engine_table.py --check                        fails if the page is not current

DIR keeps the result files and the conformance checks, one folder for each configuration, so that the script can be
stopped at any time. Wall times are ratios to MuJoCo's default preset, which runs right before each episode.

Ranks compare all configurations, whose result files must be in DIR together. `--grades` measures no cost and no checks,
so that a new engine joins the ranks without a second measurement of the others. An engine of another environment runs
there, with `--engine` and the same DIR; ranks are written where all configurations are complete.

`--again` is for a conformance check that changed: it moves the check between the passed, failed and declined ones.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from generated import ROOT, SCORING, markdown_table, settle, with_part

from gauge_envs import load_experiment
from gauge_envs.files import json_ready, write_whole
from gauge_envs.runs.batch import run_many
from gauge_envs.runs.configuration import RunConfiguration
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.runs.result_file import load_result, result_file_name, write_result
from gauge_envs.tools.compare.comparison import compare
from gauge_envs.tools.compare.grades import GradeComparison
from gauge_envs.tools.conformance import run_checks

DATA = SCORING / "engines.json"
PAGE = ROOT / "docs" / "engines" / "comparison.md"
SCRIPT = Path(__file__).name

ENGINES = ("mujoco", "newton", "physx", "pybullet", "rapier", "drake", "genesis")
MORE_PRESETS = {"physx": ("isaac", "paper"), "newton": ("paper",), "genesis": ("paper",)}
"""Presets beside the default one, which is the empty text, and `out_of_box`."""

PAPER_STEP = {"timestep_s": 1 / 180, "drive_interval_s": 1 / 180}
"""Settings beside MuJoCo's `out_of_box`, whose own step of 2 ms does not divide the interval of the environments."""

SHORT_S = 5.0
"""Wall time below which an episode runs twice, for the faster time [s]."""

STATUSES = ("pass", "fail", "error", "declined")

SLIDES = ("SlopeSlider-2-wood", "SlopeSlider-2-plastic", "SlopeSlider-2-metal")
LAWS = ("SlopeSlider-1-wood", "SlopeSlider-1-plastic", "SlopeSlider-1-metal")
LAWS += ("Turntable-1-wood", "Turntable-1-plastic", "Turntable-1-metal")
RECORDINGS = ("SlopeSlider-3-metal", "Turntable-3-metal")
BALL, CRADLE, PENDULUM, WALL = "BouncingBall-rubber", "NewtonsCradle-metal", "Pendulum-metal", "WallBreaking-wood"
VARIANTS = (*SLIDES, BALL, *LAWS, *RECORDINGS, "Turntable-2-wood", CRADLE, PENDULUM, WALL)
GRADED = (*SLIDES, BALL, *LAWS, *RECORDINGS)
"""Variants with a reference, which the ranks compare."""

TIMED = ("SlopeSlider-2-wood", BALL, "Turntable-2-wood", CRADLE, PENDULUM, WALL)

RATIOS = {
    "slide": "slide",
    "roll": "roll-cylinder",
    "e = 0.5": "rebound-0.5",
    "e = 0.95": "rebound-0.95",
    "period": "pendulum-period",
}
"""Columns of measured over expected values, and their conformance checks."""

MAIN_RATIOS = ("slide", "e = 0.5", "period")
"""Those that the page shows."""


def presets_of(engine: str) -> tuple[str, ...]:
    """Return the presets of an engine that the page compares."""
    return ("", "out_of_box", *MORE_PRESETS.get(engine, ()))


def name_of(engine: str, preset: str) -> str:
    """Return the name of a configuration."""
    return f"{engine}, `{preset}`" if preset else engine


def settings_of(engine: str, preset: str) -> dict[str, Any]:
    """Return the settings that select a preset."""
    if not preset:
        return {}
    return {"preset": preset} | (PAPER_STEP if engine == "mujoco" else {})


def conformance(engine: str, preset: str, file: Path) -> list[dict[str, Any]]:
    """Return the conformance checks of a configuration, from its file if there is one."""
    if not file.is_file():
        results = run_checks(engine, settings=settings_of(engine, preset))
        rows = [json.dumps(json_ready(asdict(one))) for one in results]
        write_whole(file, ("\n".join(rows) + "\n").encode())
    return [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]


def episode(engine: str, preset: str, variant: str) -> tuple[Result, float]:
    """Run one episode; return its result and its wall time [s], the faster of two runs if they are short."""
    request = RunRequest(variant, backend=engine, settings=settings_of(engine, preset))
    (result,) = run_many([request])
    wall_s = result.wall_s or 0.0
    if 0.0 < wall_s < SHORT_S:
        (again,) = run_many([request])
        wall_s = min(wall_s, again.wall_s or wall_s)
    return result, wall_s


def measure(engine: str, preset: str, folder: Path, variants: Sequence[str]) -> None:
    """Run the episodes and checks of a configuration that its folder lacks."""
    folder.mkdir(parents=True, exist_ok=True)
    ratios_file = folder / "ratios.json"
    ratios = json.loads(ratios_file.read_text(encoding="utf-8")) if ratios_file.is_file() else {}
    declined_file = folder / "declined.json"
    declined = json.loads(declined_file.read_text(encoding="utf-8")) if declined_file.is_file() else {}
    for variant in variants:
        if variant in ratios:
            continue
        started = time.perf_counter()
        _, reference_s = episode("mujoco", "", variant) if variant in TIMED else (None, 0.0)
        result, wall_s = episode(engine, preset, variant)
        if result.error is None:
            write_result(result, folder / result_file_name(result))
        else:
            declined[variant] = {"outcome": result.outcome.value, "reason": result.error}
            write_whole(declined_file, json.dumps(declined, indent=1).encode())
        ratios[variant] = wall_s / reference_s if reference_s and result.error is None else None
        write_whole(ratios_file, json.dumps(ratios, indent=1).encode())
        print(f"{name_of(engine, preset)}: {variant} {result.outcome.value}, {time.perf_counter() - started:.0f} s")
    conformance(engine, preset, folder / "conformance.jsonl")


def implied(result: Result, parameter: str) -> float | None:
    """Return a parameter that the trajectory implies, or None."""
    return next((one.value for one in result.score.implied if one.parameter == parameter), None)


def acceleration_ratio(result: Result) -> float | None:
    """Return the acceleration of a slide at 30 degrees over g (sin - mu cos) of the friction in the scene."""
    friction = implied(result, "friction")
    if friction is None:
        return None
    contact = load_experiment(result.id).scene.contacts[0]
    slope = np.radians(30.0)
    measured, expected = (np.sin(slope) - mu * np.cos(slope) for mu in (friction, contact.friction))
    return float(measured / expected)


def rebound_ratio(result: Result) -> float | None:
    """Return the restitution of the ball's first rebound over that of the scene."""
    value = implied(result, "restitution")
    contact = load_experiment(result.id).scene.contacts[0]
    return None if value is None else value / contact.restitution


def record(engine: str, preset: str, folder: Path) -> dict[str, Any]:
    """Return what the page states about one configuration, JSON-ready."""
    results = {one.id.removeprefix("GAUGE/"): one for one in map(load_result, sorted(folder.glob("*-*.json")))}
    ratios = json.loads((folder / "ratios.json").read_text(encoding="utf-8"))
    checks = conformance(engine, preset, folder / "conformance.jsonl")
    by_status = {status: [one["check"] for one in checks if one["status"] == status] for status in STATUSES}
    by_check = {one["check"]: one for one in checks}
    return {
        "engine": engine,
        "preset": preset,
        "versions": engine_versions(results.values()),
        "conformance": {"passed": len(by_status["pass"]), "failed": [*by_status["fail"], *by_status["error"]]}
        | {"declined": by_status["declined"]},
        "laws": {column: law_ratio(by_check[check]) for column, check in RATIOS.items()}
        | {"energy loss": measured_value(by_check["pendulum-energy"])}
        | {f"slide {name.rsplit('-', 1)[1]}": acceleration_ratio(results[name]) for name in SLIDES}
        | {"rebound": rebound_ratio(results[BALL])},
        "episodes": {name: episode_record(one) for name, one in results.items()} | not_run(folder),
        "wall_ratios": ratios,
    }


def not_run(folder: Path) -> dict[str, Any]:
    """Return the episodes of a configuration that did not run, with their reasons."""
    file = folder / "declined.json"
    return dict(json.loads(file.read_text(encoding="utf-8"))) if file.is_file() else {}


def engine_versions(results: Iterable[Result]) -> dict[str, str]:
    """Return the versions of the engine's packages in results."""
    return next((dict(RunConfiguration.of(one).engine_versions) for one in results if one.error is None), {})


def law_ratio(check: Mapping[str, Any]) -> float | None:
    """Return the measured over the expected value of a check that ran."""
    measured = measured_value(check)
    return None if measured is None else measured / check["expected"]


def measured_value(check: Mapping[str, Any]) -> float | None:
    """Return the measured value of a check, None if it was declined or raised an error."""
    value = check.get("measured")
    return float(value) if value is not None else None


def episode_record(result: Result) -> dict[str, Any]:
    """Return outcome and scores of one episode, JSON-ready; scores that do not apply are absent."""
    kept = ("rmse_normalized", "rmse_normalized_95", "rmse_aligned_normalized", "rmse_aligned_normalized_95")
    kept += ("mte", "lsd_normalized", "pd_normalized", "el")
    values = {name: getattr(result.score, name) for name in kept}
    return {
        "outcome": result.outcome.value,
        "grade": result.score.grade,
        "reason": result.error or result.diverged_reason,
    } | {name: value for name, value in values.items() if value is not None}


def grade_record(grade: GradeComparison, names: Sequence[str]) -> dict[str, Any]:
    """Return the ranks of one grade and the pairs that are not distinguishable, JSON-ready."""
    return {
        "grade": grade.name,
        "ids": list(grade.ids),
        "scores": [
            {"configuration": names[one.configuration], "rank": one.rank, "mean": one.mean.value}
            | {"interval_95": list(one.mean.interval_95)}
            for one in grade.scores
            if one.mean is not None
        ],
        "indistinguishable": [
            [names[pair.first], names[pair.second]] for pair in grade.pairs if not pair.distinguishable
        ],
    }


def gather(results: Path, configurations: Sequence[tuple[str, str]]) -> dict[str, Any]:
    """Return the content of the data file from the folders of all configurations."""
    every = [load_result(file) for one in configurations for file in sorted(folder_of(results, *one).glob("*-*.json"))]
    comparison = compare(every)
    names = [name_of(one.backend or "", one.settings_given.get("preset", "")) for one in comparison.configurations]
    return {
        "configurations": [record(*one, folder_of(results, *one)) for one in configurations],
        "grades": [grade_record(one, names) for one in comparison.grades],
    }


def run_graded(engine: str, preset: str, folder: Path) -> None:
    """Run the graded episodes of a configuration that its folder lacks."""
    requests = [RunRequest(variant, backend=engine, settings=settings_of(engine, preset)) for variant in GRADED]
    for result in run_many(requests, out=folder, resume=True):
        print(
            f"{name_of(engine, preset)}: {result.id} {result.outcome.value} {result.error or ''}".rstrip(), flush=True
        )


def ranked(results: Path, configurations: Sequence[tuple[str, str]]) -> list[dict[str, Any]]:
    """Return the ranks of all configurations, JSON-ready.

    Raises:
        SystemExit: A folder lacks an episode.
    """
    every: list[Result] = []
    for engine, preset in configurations:
        files = sorted(folder_of(results, engine, preset).glob("*-*.json"))
        chosen = [one for one in map(load_result, files) if one.id.removeprefix("GAUGE/") in GRADED]
        missing = set(GRADED) - {one.id.removeprefix("GAUGE/") for one in chosen}
        if missing:
            raise SystemExit(f"no ranks: {name_of(engine, preset)} lacks {', '.join(sorted(missing))}")
        every += chosen
    comparison = compare(every)
    names = [name_of(one.backend or "", one.settings_given.get("preset", "")) for one in comparison.configurations]
    return [grade_record(one, names) for one in comparison.grades]


def merged(known: Mapping[str, Any], measured: Mapping[str, Any]) -> dict[str, Any]:
    """Return the known data with the measured configurations in place of older ones.

    Ranks compare all configurations, so they are kept where the measured ones lack any.
    """
    order = [(engine, preset) for engine in ENGINES for preset in presets_of(engine)]
    rows = {(one["engine"], one["preset"]): one for one in (*known["configurations"], *measured["configurations"])}
    is_complete = len(measured["configurations"]) == len(rows)
    return {
        "configurations": [rows[one] for one in order if one in rows],
        "grades": measured["grades"] if is_complete else known["grades"],
    }


def checked_again(configuration: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return a configuration with the present outcome of one check, which all configurations had measured."""
    (result,) = run_checks(
        configuration["engine"], settings=settings_of(configuration["engine"], configuration["preset"]), only=[name]
    )
    print(f"{name_of(configuration['engine'], configuration['preset'])}: {name} {result.status}, {result.measured}")
    known = configuration["conformance"]
    before = next((key for key in ("failed", "declined") if name in known[key]), "passed")
    now = {"fail": "failed", "error": "failed", "declined": "declined", "pass": "passed"}[result.status]
    if now == before:
        return dict(configuration)
    passed = known["passed"] + (now == "passed") - (before == "passed")
    failed, declined = (
        [one for one in known[key] if one != name] + [name] * (now == key) for key in ("failed", "declined")
    )
    return {**configuration, "conformance": {"passed": passed, "failed": failed, "declined": declined}}


def folder_of(results: Path, engine: str, preset: str) -> Path:
    """Return the folder of a configuration."""
    return results / "-".join(filter(None, (engine, preset)))


# --- the page --------------------------------------------------------------------------------------------------------


def percent(ratio: float | None) -> str:
    """Return a ratio as a difference in per cent."""
    return "" if ratio is None else f"{100.0 * (ratio - 1.0):+.2f}"


def with_interval(one: Mapping[str, Any], metric: str) -> str:
    """Return a score with its 95 % interval, or the outcome of an episode without it."""
    if metric not in one:
        return "" if one["outcome"] == Outcome.FINISHED.value else one["outcome"]
    interval = one.get(f"{metric}_95")
    return f"{one[metric]:.2f}" + (f" [{interval[0]:.2f}, {interval[1]:.2f}]" if interval else "")


def number(value: float | None, digits: int) -> str:
    """Return a number with so many decimal places, empty for None."""
    return "" if value is None else f"{value:.{digits}f}"


def page(data: Mapping[str, Any]) -> str:
    """Return the generated part of the page: the main numbers of each configuration."""
    rows = [(name_of(one["engine"], one["preset"]), one) for one in data["configurations"]]
    ranks = {grade["grade"]: {one["configuration"]: one for one in grade["scores"]} for grade in data["grades"]}
    counts = [f"{len(grade['ids'])} ids of grade `{grade['grade']}`" for grade in data["grades"]]
    lines = [
        f"Measured with {versions(data)}.",
        "",
        "### Closed forms and cost",
        "",
        "Checks that passed, failed and were declined; difference from the law in per cent; *loss* is the energy that "
        "a pendulum loses in 3 s, in per cent. *Cost* is the wall time over that of MuJoCo's default preset, the "
        f"geometric mean over those of {len(TIMED)} episodes that ran.",
        "",
        *markdown_table(
            ("configuration", "checks", "slide", "e = 0.5", "period", "loss", "cost"),
            ((name, *main_cells(one)) for name, one in rows),
        ),
        "",
        "### Ranks",
        "",
        "Rank, and mean of the primary score with its 95 % interval, over "
        f"{', '.join(counts)}. A rank is one more than "
        "the number of configurations with a distinguishably lower mean.",
        "",
        *markdown_table(
            ("configuration", *ranks),
            ((name, *(ranked_text(scores.get(name)) for scores in ranks.values())) for name, _ in rows),
        ),
    ]
    return "\n".join(lines)


def versions(data: Mapping[str, Any]) -> str:
    """Return the versions of all engines."""
    found = {f"{name} {text}" for one in data["configurations"] for name, text in one["versions"].items()}
    return ", ".join(sorted(found))


def main_cells(one: Mapping[str, Any]) -> list[str]:
    """Return the main closed forms of a configuration, and its cost."""
    checks, laws = one["conformance"], one["laws"]
    counts = f"{checks['passed']}, {len(checks['failed'])}, {len(checks['declined'])}"
    ratios = [ratio for variant in TIMED if (ratio := one["wall_ratios"].get(variant))]
    cost = f"{np.exp(np.mean(np.log(ratios))):.2g}" if ratios else ""
    return [counts, *(percent(laws[name]) for name in MAIN_RATIOS), number(laws["energy loss"], 3), cost]


def ranked_text(score: Mapping[str, Any] | None) -> str:
    """Return the rank of a configuration in a grade with its mean score."""
    return (
        ""
        if score is None
        else "{}: {:.2f} [{:.2f}, {:.2f}]".format(score["rank"], score["mean"], *score["interval_95"])
    )


# --- all tables ------------------------------------------------------------------------------------------------------


def tables(data: Mapping[str, Any]) -> Iterator[str]:
    """Yield the lines of all tables of the data."""
    rows = [(name_of(one["engine"], one["preset"]), one) for one in data["configurations"]]
    yield f"Measured with {versions(data)}."
    yield from ("", "### Closed forms", "")
    yield from (
        "Difference from the law in per cent; *loss* is the energy that a pendulum loses in 3 s, in per cent.",
        "",
    )
    head = (
        "configuration",
        "passed",
        "failed",
        "declined",
        "slide wood / plastic / metal",
        *RATIOS,
        "loss",
        "ball's e",
    )
    yield from markdown_table(head, ((name, *closed_forms(one)) for name, one in rows))
    yield ""
    for name, one in rows:
        for status in ("failed", "declined"):
            if checks := ", ".join(f"`{check}`" for check in one["conformance"][status]):
                yield f"- {name}, {status}: {checks}"
    yield from ("", "### Scores against real trials", "")
    yield from ("Normalized RMSE with 95 % interval: slides aligned in time, then raw; the ball raw.", "")
    heads = [f"{name.rsplit('-', 1)[1]}, {kind}" for kind in ("aligned", "raw") for name in SLIDES]
    yield from markdown_table(("configuration", *heads, "ball"), ((name, *trial_cells(one)) for name, one in rows))
    yield from ("", "### Scores against recordings and laws, and events", "")
    yield from ("Normalized RMSE; momentum transfer of the cradle, period over the real one, outcome of the wall.", "")
    head = ("configuration", *RECORDINGS, "largest of 6 laws", "cradle, MTE", "pendulum, PD", "wall")
    yield from markdown_table(head, ((name, *other_cells(one)) for name, one in rows))
    yield from ("", "### Cost", "")
    yield from ("Wall time as a ratio to MuJoCo's default preset in the same run, faster of two runs.", "")
    costs = ((name, *(number(one["wall_ratios"].get(variant), 2) for variant in TIMED)) for name, one in rows)
    yield from markdown_table(("configuration", *TIMED), costs)


def closed_forms(one: Mapping[str, Any]) -> list[str]:
    """Return the cells of the table of closed forms."""
    checks, laws = one["conformance"], one["laws"]
    slides = " / ".join(percent(laws[f"slide {name.rsplit('-', 1)[1]}"]) or "-" for name in SLIDES)
    counts = [str(checks["passed"]), str(len(checks["failed"])), str(len(checks["declined"]))]
    ratios = [percent(laws[column]) for column in RATIOS]
    loss = laws["energy loss"]
    return [*counts, slides, *ratios, number(loss, 3), percent(laws["rebound"])]


def trial_cells(one: Mapping[str, Any]) -> list[str]:
    """Return the cells of the table of real trials."""
    episodes = one["episodes"]
    metrics = ("rmse_aligned_normalized", "rmse_normalized")
    slides = [with_interval(episodes[name], metric) for metric in metrics for name in SLIDES]
    return [*slides, with_interval(episodes[BALL], "rmse_normalized")]


def other_cells(one: Mapping[str, Any]) -> list[str]:
    """Return the cells of the table of recordings, laws and events."""
    episodes = one["episodes"]
    laws = [episodes[name].get("rmse_normalized") for name in LAWS]
    known = [value for value in laws if value is not None]
    return [
        *(with_interval(episodes[name], "rmse_normalized") for name in RECORDINGS),
        f"{max(known):.2f}" + ("" if len(known) == len(laws) else f" of {len(known)}") if known else "",
        with_interval(episodes[CRADLE], "mte"),
        with_interval(episodes[PENDULUM], "pd_normalized"),
        episodes[WALL]["outcome"],
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the script; return its exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    mode = parser.add_mutually_exclusive_group(required=True)
    mode.add_argument("--results", type=Path, help="folder of the results")
    mode.add_argument("--again", metavar="CHECK", help="conformance check to run again")
    mode.add_argument("--docs", action="store_true", help="write the page from the data file")
    mode.add_argument("--tables", action="store_true", help="print all tables of the data file")
    mode.add_argument("--check", action="store_true", help="fail if the page is not current")
    parser.add_argument("--engine", action="append", help="measure this engine only; repeatable")
    parser.add_argument("--grades", action="store_true", help="run what the ranks need, and write the ranks alone")
    options = parser.parse_args(arguments)
    every = [(engine, preset) for engine in ENGINES for preset in presets_of(engine)]
    if options.results and options.grades:
        for engine, preset in every:
            if engine in (options.engine or ENGINES):
                run_graded(engine, preset, folder_of(options.results, engine, preset))
        known = json.loads(DATA.read_text(encoding="utf-8"))
        data = json_ready({**known, "grades": ranked(options.results, every)})
        write_whole(DATA, (json.dumps(data, indent=1) + "\n").encode())
    elif options.results:
        for engine in options.engine or ENGINES:
            for preset in presets_of(engine):
                measure(engine, preset, folder_of(options.results, engine, preset), VARIANTS)
        present = [one for one in every if (folder_of(options.results, *one) / "conformance.jsonl").is_file()]
        known = json.loads(DATA.read_text(encoding="utf-8"))
        data = json_ready(merged(known, gather(options.results, present)))
        write_whole(DATA, (json.dumps(data, indent=1) + "\n").encode())
    elif options.again:
        data = json.loads(DATA.read_text(encoding="utf-8"))
        data["configurations"] = [
            checked_again(one, options.again) if one["engine"] in (options.engine or ENGINES) else one
            for one in data["configurations"]
        ]
        write_whole(DATA, (json.dumps(data, indent=1) + "\n").encode())
    data = json.loads(DATA.read_text(encoding="utf-8"))
    if options.tables:
        print("\n".join(tables(data)))
        return 0
    text = with_part(PAGE.read_text(encoding="utf-8"), "engines", SCRIPT, page(data))
    return settle({PAGE: text}, f"{SCRIPT} --docs", check=options.check)


if __name__ == "__main__":
    sys.exit(main())
