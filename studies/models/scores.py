"""Score every engine on the models, with its default settings and out of the box, and write `scores.csv`.

    python studies/models/scores.py run --out FOLDER [--ids 'Foam*'] [--engine newton] [--solved RUNS]
    python studies/models/scores.py write --out FOLDER

`run` keeps each episode in FOLDER, and runs what it lacks; an engine of another environment runs there. Default
episodes come from the runs of `scripts/build_models.py solve` with `--solved`. `write` scores them on the references.
"""

from __future__ import annotations

import argparse
import csv
import io
import shutil
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np

from gauge_envs.backends import backend, backend_names, is_bundled
from gauge_envs.errors import MissingExtraError
from gauge_envs.evaluation.deviation import Deviation, band_deviations
from gauge_envs.evaluation.reference import band_grade, reference_band
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.variants import variants
from gauge_envs.files import write_whole
from gauge_envs.references.grades import BandGrade
from gauge_envs.references.models import solved_model
from gauge_envs.references.published import published_baselines
from gauge_envs.scene.timing import FRAME_RATE_HZ

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts"))
from scripts.build_convergence import supported
from build_models import Level, digits, solve

PRESETS = ("default", "out_of_box")
COLUMNS = (
    "id",
    "engine",
    "preset",
    "rmse",
    "low_95",
    "high_95",
    "unit",
    "frames",
    "rmse_without",
    "scatter",
)
TABLE = Path(__file__).with_name("scores.csv")


def scored_ids(patterns: Sequence[str]) -> Iterator[str]:
    """Yield the ids whose reference is a model."""
    for variant in variants():
        is_wanted = any(fnmatchcase(variant.name, one) for one in patterns)
        if is_wanted and band_grade(variant.name) is BandGrade.MODEL:
            yield variant.name


def installed() -> list[str]:
    """Return the engines of this environment."""
    found = []
    for name in filter(is_bundled, backend_names()):
        with suppress(MissingExtraError):
            found.append(backend(name).name)
    return found


def run(options: argparse.Namespace) -> int:
    """Run the episodes that the folder lacks."""
    for name in scored_ids(options.ids):
        for engine in options.engine or installed():
            if not supported(name, engine):
                continue
            for preset in PRESETS:
                file = options.out / name / f"{engine}-{preset}.npz"
                if file.exists():
                    continue
                file.parent.mkdir(parents=True, exist_ok=True)
                done = options.solved and options.solved / name / f"{engine}-base-1.npz"
                if preset == "default" and done and done.exists():
                    shutil.copy(done, file)
                    continue
                settings = (
                    {}
                    if preset == "default"
                    else backend(engine).configurations[preset]
                )
                level = Level(parameter="preset", factor=1.0, settings=settings)
                try:
                    values = solve(
                        load_experiment(name), engine, level, limit_s=options.limit_s
                    )
                except Exception as error:  # An engine that fails is a result.
                    values = {
                        "fault": f"{type(error).__name__}: {error}".splitlines()[0]
                    }
                content = io.BytesIO()
                np.savez_compressed(content, **values)
                write_whole(file, content.getvalue())
                print(
                    f"{name}, {engine} {preset}: {values.get('processor_s', 0):.0f} s {values['fault']}",
                    flush=True,
                )
    return 0


def score(
    name: str, engine: str, file: Path
) -> tuple[Deviation | None, dict[str, Any]]:
    """Return the deviation of an episode and its row; None and a row with the fault if it did not end."""
    experiment = load_experiment(name)
    band, model = reference_band(experiment), solved_model(name)
    assert band is not None
    with np.load(file) as archive:
        fault, frames = (
            str(archive["fault"]),
            np.asarray(archive["frames"]) if "frames" in archive.files else None,
        )
    row: dict[str, Any] = {"id": name, "engine": engine, "unit": band.unit}
    if fault or frames is None:
        return None, row | {"rmse": fault or "no frames"}
    times_s = np.arange(len(frames)) / FRAME_RATE_HZ
    deviation = band_deviations(experiment, band, times_s=times_s, values=frames).raw
    low, high = deviation.interval or (float("nan"), float("nan"))
    row |= {
        "rmse": digits(deviation.rmse),
        "low_95": digits(low),
        "high_95": digits(high),
    }
    row["frames"] = int(np.isfinite(band.mean).any(axis=1).sum())
    if model is not None and engine in model.others:
        apart = band.project(frames) - model.others[engine]
        row["rmse_without"] = digits(
            float(np.sqrt(np.nanmean(np.square(apart).sum(axis=1))))
        )
    baseline = published_baselines(name).get("rmse")
    if baseline is not None and baseline.mean:
        row["scatter"] = digits(deviation.rmse / baseline.mean)
    return deviation, row


def write(options: argparse.Namespace) -> int:
    """Write the table of scores, and print which differences the uncertainty of the references does not explain."""
    rows, apart = [], {preset: [0, 0] for preset in ("default", "out_of_box", "both")}
    for name in scored_ids(options.ids):
        found: dict[tuple[str, str], Deviation] = {}
        for engine in filter(is_bundled, backend_names()):
            for preset in PRESETS:
                file = options.out / name / f"{engine}-{preset}.npz"
                if not file.exists():
                    continue
                deviation, row = score(name, engine, file)
                rows.append(row | {"preset": preset})
                if deviation is not None:
                    found[engine, preset] = deviation
        keys = list(found)
        for place, one in enumerate(keys):
            for other in keys[place + 1 :]:
                kind = (
                    one[1]
                    if one[1] == other[1]
                    else "both"
                    if one[0] == other[0]
                    else None
                )
                if kind is not None:
                    apart[kind][0] += differ(found[one], found[other])
                    apart[kind][1] += 1
    with options.table.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, COLUMNS, lineterminator="\n", restval="")
        writer.writeheader()
        writer.writerows(rows)
    for kind, (count, total) in apart.items():
        print(f"{kind}: {count} of {total} pairs differ")
    return 0


def differ(one: Deviation, other: Deviation) -> bool:
    """Return whether 95 % of the draws of the reference leave the same episode closer."""
    difference = one.errors.draws(one.values) - other.errors.draws(other.values)
    low, high = np.quantile(difference, [0.025, 0.975])
    return bool(low > 0.0 or high < 0.0)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the script and return its exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("action", choices=("run", "write"))
    parser.add_argument(
        "--out", type=Path, required=True, help="folder of the episodes"
    )
    parser.add_argument("--ids", nargs="*", default=["*"], help="variants or patterns")
    parser.add_argument("--engine", nargs="*", help="only these engines")
    parser.add_argument(
        "--solved", type=Path, help="runs of scripts/build_models.py solve"
    )
    parser.add_argument(
        "--limit-s",
        type=float,
        default=600.0,
        help="processor time of an episode at most",
    )
    parser.add_argument("--table", type=Path, default=TABLE, help="table to write")
    options = parser.parse_args(arguments)
    return run(options) if options.action == "run" else write(options)


if __name__ == "__main__":
    sys.exit(main())
