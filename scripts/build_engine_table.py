"""Measure every installed engine with its presets, and write the tables of `docs/engines/comparison.md`.

The folder of results keeps the result files, one folder for each configuration, so that the builder can be
stopped at any time. Wall times are ratios to MuJoCo's default preset, which runs right before each episode.
Checks are those of `scoring/conformance.json`.

Ranks compare the configurations that fail no conformance check of what a ranked experiment has (`UNRANKED` are the
others); the others stand apart with their scores. They run with the published constants, and where the reference is
the mean of real trials with the parameter set `effective`. An engine of another environment runs there, with
`--engine` and the same folder; ranks are written where all configurations are complete.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from gauge_envs.backends.registry import backend_title, uninstalled_backend
from gauge_envs.evaluation.reference import reference_band
from gauge_envs.files import json_ready, write_whole
from gauge_envs.runs.batch import run_many
from gauge_envs.runs.configuration import RunConfiguration
from gauge_envs.runs.episodes import rescored
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Result
from gauge_envs.runs.result_file import (
    load_result,
    recorded_experiment,
    result_file_name,
    write_result,
)
from gauge_envs.tools.compare import PUBLISHED, Comparison, GradeComparison, compare
from gauge_envs.tools.compare.significance import NEGLIGIBLE
from gauge_envs.tools.conformance import Status
from gauge_envs.tools.conformance.matrix import MatrixColumn, read_columns
from scripts.generated import (
    ROOT,
    SCORING,
    Request,
    markdown_table,
    page_part,
    stale_note,
)

DATA = SCORING / "engines.json"
CONFORMANCE = SCORING / "conformance.json"
PAGE = ROOT / "docs" / "engines" / "comparison.md"
SCRIPT = f"scripts/{Path(__file__).name}"

ENGINES = ("mujoco", "newton", "physx", "pybullet", "rapier", "drake", "genesis")
MORE_PRESETS = {
    "physx": ("isaac", "paper"),
    "newton": ("paper",),
    "genesis": ("paper",),
}
"""Presets beside the default one, which is the empty text, and `out_of_box`."""

SHORT_S = 5.0
"""Wall time below which an episode runs twice, for the faster time [s]."""

SLIDES = ("SlopeSlider-2-wood", "SlopeSlider-2-plastic", "SlopeSlider-2-metal")
LAWS = ("SlopeSlider-1-wood", "SlopeSlider-1-plastic", "SlopeSlider-1-metal")
LAWS += ("Turntable-1-wood", "Turntable-1-plastic", "Turntable-1-metal")
RECORDINGS = ("SlopeSlider-3-metal", "Turntable-3-metal")
BALL, CRADLE, PENDULUM, WALL = (
    "BouncingBall-rubber",
    "NewtonsCradle-metal",
    "Pendulum-metal",
    "WallBreaking-wood",
)
VARIANTS = (
    *SLIDES,
    BALL,
    *LAWS,
    *RECORDINGS,
    "Turntable-2-wood",
    CRADLE,
    PENDULUM,
    WALL,
)
TRIALS = (*SLIDES, BALL)
"""Variants whose reference is the mean of real trials; they run with the constants of these trials too."""

GRADED = (*TRIALS, *LAWS, *RECORDINGS)
"""Variants with a reference, which the ranks compare."""

EFFECTIVE = "effective"
"""Parameter set with the constants that the real trials show."""

TIMED = ("SlopeSlider-2-wood", BALL, "Turntable-2-wood", CRADLE, PENDULUM, WALL)

RATIOS = {
    "slide": "slide",
    "e = 0.5": "rebound-0.5",
    "period": "pendulum-period",
}
"""Columns of measured over expected values, and their conformance checks."""


def presets_of(engine: str) -> tuple[str, ...]:
    """Return the presets of an engine that the page compares."""
    return ("", "out_of_box", *MORE_PRESETS.get(engine, ()))


def name_of(engine: str, preset: str) -> str:
    """Return the name of a configuration."""
    return f"{engine}, `{preset}`" if preset else engine


def settings_of(engine: str, preset: str) -> dict[str, Any]:
    """Return the settings that select a preset."""
    return {"preset": preset} if preset else {}


@cache
def columns() -> Mapping[tuple[str, str], MatrixColumn]:
    """Return the conformance checks of all configurations, by engine and preset."""
    return {
        (one.backend, "" if one.name == "default" else one.name): one
        for one in read_columns(CONFORMANCE)
    }


def episode(engine: str, preset: str, variant: str) -> tuple[Result, float]:
    """Run one episode; return its result and its wall time [s], the faster of two runs if they are short."""
    request = RunRequest(variant, backend=engine, settings=settings_of(engine, preset))
    (result,) = run_many([request])
    wall_s = result.wall_s or 0.0
    if 0.0 < wall_s < SHORT_S:
        (again,) = run_many([request])
        wall_s = min(wall_s, again.wall_s or wall_s)
    return result, wall_s


def run_timed(engine: str, preset: str, folder: Path, variants: Sequence[str]) -> None:
    """Run the episodes of a configuration that its folder lacks."""
    folder.mkdir(parents=True, exist_ok=True)
    ratios_file = folder / "ratios.json"
    ratios = (
        json.loads(ratios_file.read_text(encoding="utf-8"))
        if ratios_file.is_file()
        else {}
    )
    declined_file = folder / "declined.json"
    declined = (
        json.loads(declined_file.read_text(encoding="utf-8"))
        if declined_file.is_file()
        else {}
    )
    for variant in variants:
        if variant in ratios:
            continue
        started = time.perf_counter()
        _, reference_s = (
            episode("mujoco", "", variant) if variant in TIMED else (None, 0.0)
        )
        result, wall_s = episode(engine, preset, variant)
        if result.error is None:
            write_result(result, folder / result_file_name(result))
        else:
            declined[variant] = {
                "outcome": result.outcome.value,
                "reason": result.error,
            }
            write_whole(declined_file, json.dumps(declined, indent=1).encode())
        ratios[variant] = (
            wall_s / reference_s if reference_s and result.error is None else None
        )
        write_whole(ratios_file, json.dumps(ratios, indent=1).encode())
        print(
            f"{name_of(engine, preset)}: {variant} {result.outcome.value}, {time.perf_counter() - started:.0f} s"
        )


def record(engine: str, preset: str, folder: Path) -> dict[str, Any]:
    """Return what the page states about one configuration, JSON-ready."""
    results = {
        one.id.removeprefix("GAUGE/"): one
        for one in loaded(folder)
        if one.parameters == PUBLISHED
    }
    ratios = json.loads((folder / "ratios.json").read_text(encoding="utf-8"))
    return {
        "engine": engine,
        "preset": preset,
        "versions": engine_versions(results.values()),
        "episodes": {name: episode_record(one) for name, one in results.items()}
        | not_run(folder),
        "wall_ratios": ratios,
    }


def not_run(folder: Path) -> dict[str, Any]:
    """Return the episodes of a configuration that did not run, with their reasons."""
    file = folder / "declined.json"
    return dict(json.loads(file.read_text(encoding="utf-8"))) if file.is_file() else {}


def engine_versions(results: Iterable[Result]) -> dict[str, str]:
    """Return the versions of the engine's packages in results."""
    return next(
        (
            dict(RunConfiguration.of(one).engine_versions)
            for one in results
            if one.error is None
        ),
        {},
    )


def law_ratio(one: Mapping[str, Any], check: str) -> float | None:
    """Return the measured over the expected value of a check that ran."""
    found = columns()[one["engine"], one["preset"]].findings[check]
    ratio = (
        np.nan
        if found.measured is None
        else found.measured / (found.expected or np.nan)
    )
    return float(ratio) if np.isfinite(ratio) else None


def energy_loss(one: Mapping[str, Any]) -> str:
    """Return the energy that a pendulum loses [%], empty if the check did not run."""
    return number(
        columns()[one["engine"], one["preset"]].findings["pendulum-energy"].measured, 3
    )


def checks_with(one: Mapping[str, Any], *statuses: Status) -> list[str]:
    """Return the conformance checks of a configuration with some statuses; refused ones count as declined."""
    column = columns()[one["engine"], one["preset"]]
    refused = column.refused if Status.DECLINED in statuses else ()
    return [
        *(name for name, found in column.findings.items() if found.status in statuses),
        *refused,
    ]


def episode_record(result: Result) -> dict[str, Any]:
    """Return outcome and scores of one episode, JSON-ready; scores that do not apply are absent."""
    events = ("mte", "lsd_normalized", "pd_normalized", "el")
    values = {name: getattr(result.score, name) for name in events}
    if (real := result.score.validation) is not None:
        values |= {
            "rmse_normalized": real.rmse_normalized,
            "rmse_normalized_95": real.rmse_normalized_95,
            "rmse_aligned_normalized": real.rmse_aligned_normalized,
            "rmse_aligned_normalized_95": real.rmse_aligned_normalized_95,
        }
    if (solved := result.score.verification) is not None:
        values |= {"distance": solved.scaled, "distance_unit": solved.scale_unit}
    return {
        "outcome": result.outcome.value,
        "grade": result.score.grade,
        "primary": result.score.primary,
        "reason": result.error or result.diverged_reason,
    } | {name: value for name, value in values.items() if value is not None}


def loaded(folder: Path) -> list[Result]:
    """Return the results in the folder of a configuration."""
    return [load_result(file) for file in sorted(folder.glob("*-*.json"))]


def name_of_run(one: RunConfiguration) -> str:
    """Return the name of the configuration of a run."""
    return name_of(one.backend or "", one.settings_given.get("preset", ""))


def grade_record(comparison: Comparison, grade: GradeComparison) -> dict[str, Any]:
    """Return the ranks of one grade and what decides them, JSON-ready."""
    names = [name_of_run(one) for one in comparison.configurations]
    return {
        "grade": grade.grade,
        "constants": grade.constants,
        "ids": list(grade.ids),
        "ranked": [
            {
                "configuration": names[one.configuration],
                "rank": one.rank,
                "mean_rank": one.mean_rank.value,
                "mean_rank_95": list(one.mean_rank.interval_95),
                "ranks": {
                    of.id: list(of.ranks[one.configuration].interval_95)
                    for of in grade.experiments
                },
            }
            for one in grade.ranked
            if one.mean_rank is not None
        ],
        "pairs_apart": {
            one.id: [one.distinguishable_count, one.pair_count]
            for one in grade.experiments
        },
        "apart": [
            [names[pair.closer], names[pair.first + pair.second - pair.closer]]
            for pair in grade.common_pairs
            if pair.distinguishable
        ],
    }


def gather(results: Path, configurations: Sequence[tuple[str, str]]) -> dict[str, Any]:
    """Return the measured configurations for the data file, from their folders."""
    return {
        "configurations": [
            record(*one, folder_of(results, *one)) for one in configurations
        ]
    }


def run_graded(engine: str, preset: str, folder: Path) -> None:
    """Run the graded episodes of a configuration that its folder lacks."""
    settings = settings_of(engine, preset)
    requests = [
        RunRequest(variant, backend=engine, settings=settings) for variant in GRADED
    ]
    requests += [
        RunRequest(variant, backend=engine, settings=settings, parameters=EFFECTIVE)
        for variant in TRIALS
    ]
    for result in run_many(requests, out=folder, resume=True):
        of = f"{name_of(engine, preset)}: {result.id} {result.parameters}"
        print(f"{of} {result.outcome.value} {result.error or ''}".rstrip(), flush=True)


def graded_results(engine: str, preset: str, folder: Path) -> list[Result]:
    """Return the graded episodes of a configuration, scored again.

    Raises:
        SystemExit: The folder lacks an episode.
    """
    wanted = {(variant, PUBLISHED) for variant in GRADED} | {
        (variant, EFFECTIVE) for variant in TRIALS
    }
    found = {
        (one.id.removeprefix("GAUGE/"), str(one.parameters)): one
        for one in loaded(folder)
    }
    if missing := wanted - set(found):
        lacking = ", ".join(
            f"{variant} {parameters}" for variant, parameters in sorted(missing)
        )
        raise SystemExit(f"no ranks: {name_of(engine, preset)} lacks {lacking}")
    ranked = []
    for one in sorted(wanted):
        experiment = recorded_experiment(found[one])
        band = reference_band(experiment)
        backend = None if found[one].settings_given else found[one].backend
        ranked.append(rescored(found[one], experiment, band, backend))
    return ranked


COUNTED = ((Status.PASS,), (Status.FAIL, Status.ERROR), (Status.DECLINED,))
"""What the tables count: passed, failed, declined."""

UNRANKED = (
    "oblique-",
    "slide-between",
    "rebound-flat",
    "crossed-edges",
    "cloth-",
    "air-",
    "foam-",
    "rope-",
    "rod-",
    "joint-",
    "grasp-",
    "torsion",
    "rolling",
    "solver-",
    "copies-",
    "tower-",
)
"""Checks of what no ranked experiment has.

Slip in impacts, as that of the copies, rubbing, flat landings, edges, deformable bodies, joints, grasps, and chains,
heaps and towers of more than 40 degrees of freedom.
"""


def failed_checks(known: Mapping[str, Any]) -> int:
    """Return how many checks a configuration fails that keep it from the ranks."""
    return sum(
        not name.startswith(UNRANKED)
        for name in checks_with(known, Status.FAIL, Status.ERROR)
    )


def scored_again(known: Mapping[str, Any], results: Path) -> dict[str, Any]:
    """Return the data with the present scores of all graded episodes, and the ranks of what fails no check."""
    configurations, ranked = [], []
    for one in known["configurations"]:
        name = name_of(one["engine"], one["preset"])
        every = graded_results(
            one["engine"],
            one["preset"],
            folder_of(results, one["engine"], one["preset"]),
        )
        print(f"{name}: scored", flush=True)
        episodes = {
            parameters: {
                result.id.removeprefix("GAUGE/"): episode_record(result)
                for result in every
                if result.parameters == parameters
            }
            for parameters in (PUBLISHED, EFFECTIVE)
        }
        configurations.append(
            {
                **one,
                "episodes": {**one["episodes"], **episodes[PUBLISHED]},
                EFFECTIVE: episodes[EFFECTIVE],
            }
        )
        ranked += [] if failed_checks(one) else every
    comparison = compare(ranked)
    return {
        "configurations": configurations,
        "grades": [grade_record(comparison, one) for one in comparison.grades],
    }


def merged(known: Mapping[str, Any], measured: Mapping[str, Any]) -> dict[str, Any]:
    """Return the known data with the measured configurations in place of older ones; ranks stay."""
    order = [(engine, preset) for engine in ENGINES for preset in presets_of(engine)]
    rows = {(one["engine"], one["preset"]): one for one in known["configurations"]}
    for one in measured["configurations"]:
        place = (one["engine"], one["preset"])
        rows[place] = {**rows.get(place, {}), **one}
    return {
        "configurations": [rows[one] for one in order if one in rows],
        "grades": known["grades"],
    }


def folder_of(results: Path, engine: str, preset: str) -> Path:
    """Return the folder of a configuration."""
    return results / "-".join(filter(None, (engine, preset)))


# --- the page --------------------------------------------------------------------------------------------------------


def percent(ratio: float | None) -> str:
    """Return a ratio as a difference in per cent."""
    return "" if ratio is None else f"{100.0 * (ratio - 1.0):+.2f}"


def number(value: float | None, digits: int) -> str:
    """Return a number with so many decimal places, empty for None."""
    return "" if value is None else f"{value:.{digits}f}"


def page(data: Mapping[str, Any]) -> str:
    """Return the generated part of the page: the main numbers of each configuration."""
    rows = [
        (name_of(one["engine"], one["preset"]), one) for one in data["configurations"]
    ]
    ran = max(len(column.findings) for column in columns().values())
    lines = [
        *stale_note("engines-data"),
        f"Measured with {versions(data)}.",
        "",
        "### Closed forms and cost",
        "",
        f"Checks that passed, failed and were declined, of [the {ran} that ran](conformance.md#results). Difference "
        "from the law in per cent; *loss* is the energy that a pendulum loses in 3 s, in per cent. *Cost* is the wall "
        f"time over that of MuJoCo's default preset, the geometric mean over those of {len(TIMED)} episodes that ran, "
        "on a busy machine: that of the default preset itself would be 1.",
        "",
        *markdown_table(
            (
                "configuration",
                "physics",
                "checks",
                "slide",
                "e = 0.5",
                "period",
                "loss",
                "cost",
            ),
            ((name, whose_physics(one), *main_cells(one)) for name, one in rows),
        ),
        "",
        "*Physics*: the engine's own defaults, its own options, or corrected by this package:",
        "",
        *(
            f"- {backend_title(engine)}: {'; '.join(uninstalled_backend(engine).corrections) or 'not corrected'}."
            for engine in ENGINES
        ),
        "",
        *rank_lines(data, rows),
    ]
    return "\n".join(lines)


def versions(data: Mapping[str, Any]) -> str:
    """Return the versions of all engines."""
    found = {
        f"{name} {text}"
        for one in data["configurations"]
        for name, text in one["versions"].items()
    }
    return ", ".join(sorted(found))


def whose_physics(one: Mapping[str, Any]) -> str:
    """Return whose physics a configuration shows."""
    return uninstalled_backend(one["engine"]).whose_physics(one["preset"])


def main_cells(one: Mapping[str, Any]) -> list[str]:
    """Return the main closed forms of a configuration, and its cost."""
    counts = ", ".join(str(len(checks_with(one, *statuses))) for statuses in COUNTED)
    ratios = [ratio for variant in TIMED if (ratio := one["wall_ratios"].get(variant))]
    cost = f"{np.exp(np.mean(np.log(ratios))):.2g}" if ratios else ""
    return [
        counts,
        *(percent(law_ratio(one, check)) for check in RATIOS.values()),
        energy_loss(one),
        cost,
    ]


def rank_lines(
    data: Mapping[str, Any], rows: Sequence[tuple[str, Mapping[str, Any]]]
) -> Iterator[str]:
    """Yield the ranks of each grade, and the scores of configurations that fail a check."""
    titles = {
        ("trials", PUBLISHED): "Validation: real trials, published constants",
        ("trials", EFFECTIVE): "Validation: real trials, constants of these trials",
        ("recording", PUBLISHED): "Validation: one recording, published constants",
        ("law", PUBLISHED): "Verification: laws, published constants",
    }
    passing = sum(not failed_checks(one) for _, one in rows)
    yield from ("### Ranks", "")
    yield (
        f"Among the {passing} configurations that fail no check of these laws. A cell has the score, 1 being a typical "
        "trial, or the error against an exact law in mm. Behind it is the best to worst rank in this experiment: after "
        "those that are distinguishably closer, before those that are distinguishably further, at 5 % for all pairs of "
        "the experiment together (Holm). A difference of at most "
        f"{NEGLIGIBLE} of a score, or {NEGLIGIBLE} mm, counts as none. The mean rank counts each experiment the same."
    )
    by_name = dict(rows)
    for grade in data["grades"]:
        key = (grade["grade"], grade["constants"])
        if key not in titles:
            continue
        yield from ("", f"#### {titles[key]}", "")
        head = (
            "configuration",
            *(name.removeprefix("GAUGE/") for name in grade["ids"]),
            "mean rank",
        )
        yield from markdown_table(
            head, (ranked_cells(one, by_name, grade) for one in grade["ranked"])
        )
        counts = [
            f"{count[0]} of {count[1]}"
            for count in (grade["pairs_apart"][name] for name in grade["ids"])
        ]
        further: dict[str, list[str]] = {}
        for closer, other in grade["apart"]:
            further.setdefault(closer, []).append(other)
        pairs = [
            f"{closer} than {', '.join(others)}" for closer, others in further.items()
        ]
        yield ""
        yield (
            f"Distinguishable pairs in each, in this order: {', '.join(counts)}. Distinguishably closer in more than "
            f"half: {'; '.join(pairs) or 'no configuration'}."
        )
    yield from ("", "#### Not ranked", "")
    yield "These fail conformance checks, so a low score may be two errors that cancel. Primary scores against trials:"
    yield ""
    short = [*(name.rsplit("-", 1)[1] for name in SLIDES), "ball"]
    head = (
        "configuration",
        "",
        *short,
        *(f"{name}, trials' constants" for name in short),
    )
    apart = (
        (name, f"fails {failed_checks(one)} such checks; not ranked", *apart_cells(one))
        for name, one in rows
        if failed_checks(one)
    )
    yield from markdown_table(head, apart)


def ranked_cells(
    score: Mapping[str, Any],
    rows: Mapping[str, Mapping[str, Any]],
    grade: Mapping[str, Any],
) -> list[str]:
    """Return the cells of a configuration in the table of a grade."""
    known = rows[score["configuration"]]
    episodes = (
        known["episodes"] if grade["constants"] == PUBLISHED else known[EFFECTIVE]
    )
    cells = [score["configuration"]]
    for name in grade["ids"]:
        low, high = (round(end) for end in score["ranks"][name])
        place = f"{low}" if low == high else f"{low}-{high}"
        cells.append(f"{primary(episodes[name.removeprefix('GAUGE/')])}; {place}")
    low, high = score["mean_rank_95"]
    return [*cells, f"{score['mean_rank']:.1f} [{low:.1f}, {high:.1f}]"]


def apart_cells(one: Mapping[str, Any]) -> list[str]:
    """Return the scores against real trials, with the published constants and with those of the trials."""
    return [
        primary(episodes[name])
        for episodes in (one["episodes"], one[EFFECTIVE])
        for name in TRIALS
    ]


def primary(episode: Mapping[str, Any]) -> str:
    """Return the primary score of an episode, the distance from its solution, or its outcome."""
    if "distance" in episode:
        return f"{episode['distance']:.3f} {episode['distance_unit']}"
    value = episode.get(f"{episode.get('primary') or 'rmse'}_normalized")
    return episode["outcome"] if value is None else f"{value:.2f}"


def contents(scoring: Path = SCORING) -> dict[Path, str]:
    """Return the page with its generated part replaced."""
    data = json.loads(DATA.read_text(encoding="utf-8"))
    return page_part(PAGE, "engines", SCRIPT, page(data))


def measure(request: Request) -> None:
    """Run what the folder lacks, and write the data; with all engines also the ranks."""
    engines = request.engines or ENGINES
    chosen = [(engine, preset) for engine in engines for preset in presets_of(engine)]
    for engine, preset in chosen:
        folder = folder_of(request.results, engine, preset)
        run_timed(engine, preset, folder, VARIANTS)
        run_graded(engine, preset, folder)
    data = merged(
        json.loads(DATA.read_text(encoding="utf-8")), gather(request.results, chosen)
    )
    if not request.engines:
        data = scored_again(data, request.results)
    write_whole(DATA, (json.dumps(json_ready(data), indent=1) + "\n").encode())
