"""Write the references of the ids: by kind in `docs/coverage.md`, as counts in `README.md`; and what fabrics show.

The tables leave out imported trials, which differ between users: `gauge list references` reports those.
"""

from __future__ import annotations

import csv
from collections import Counter
from itertools import groupby
from pathlib import Path

from gauge_envs import load_experiment, reference_band
from gauge_envs.experiments.variants import Variant, variants
from gauge_envs.references.kind import Kind
from scripts.generated import ROOT, SCORING, markdown_table, page_part, with_part

SCRIPT = f"scripts/{Path(__file__).name}"
PAGE = ROOT / "docs" / "coverage.md"
ANSWERS = SCORING / "answers.csv"

REFERENCES = {
    Kind.TRIALS: "several measured motions: slides, drops",
    Kind.RECORDING: "one measured motion",
    Kind.PUBLISHED: "a motion from published numbers: a cradle, a cube that holds",
    Kind.ANALYTIC: "an analytical solution: turntables, pendulum, ramps, foam, funnel",
    Kind.NUMERICAL: "a numerical solution: most cloth, foam, rope",
    Kind.NONE: "nothing: cloth that a ball turns",
}
"""Text of the reference, by kind."""


SMALL = 1
"""Percent below which a sensitivity is not shown."""


def reference_kind(variant: Variant) -> Kind:
    """Return the kind of the bundled reference of a variant."""
    band = reference_band(load_experiment(variant))
    return Kind.NONE if band is None else band.kind


def experiments_of(names: list[str]) -> str:
    """Return the experiments of ids without their materials, each with its number of ids."""
    counts = Counter(name.rpartition("-")[0] for name in names)
    return ", ".join(f"{experiment} ({count})" for experiment, count in counts.items())


def answers_table() -> str:
    """Return the answers of MuJoCo to each id, as `studies/solutions/answers.py` stored them."""
    with ANSWERS.open(encoding="utf-8", newline="") as stream:
        rows = [list(row.values()) for row in csv.DictReader(stream)]
    head = ("id", "solves", "distance", "motion", "unit", "like reality", "because")
    return "\n".join(markdown_table(head, rows))


def is_seen(row: dict[str, str], column: str) -> bool:
    """Return whether an id shows a change: 2 % of its motion, and three times what the solver makes of nothing.

    Of four such changes of Funnel-satin, the largest was twice the smallest.
    """
    return float(row[column]) >= max(2.0, 3.0 * float(row["noise"]))


def sensitivity_range(rows: list[dict[str, str]], column: str) -> str:
    """Return the least and the largest number of the ids of an experiment, bold where they are seen."""
    known = [row for row in rows if row[column] != "-"]
    if not known:
        return "-"
    known.sort(key=lambda row: float(row[column]))
    ends = []
    for row in (known[0], known[-1]):
        number = row[column] if float(row[column]) >= SMALL else f"<{SMALL}"
        is_bold = column != "noise" and is_seen(row, column)
        ends.append(f"**{number}**" if is_bold else number)
    return " to ".join(dict.fromkeys(ends))


def sensitivity_table() -> str:
    """Return what changes of a fabric do to motions, as `studies/models/sensitivity.py` stored it, by experiment."""
    file = ROOT / "studies" / "models" / "sensitivity.csv"
    with file.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    columns = list(rows[0])[2:]
    cells = []
    for name, ids in groupby(rows, lambda row: row["id"].rpartition("-")[0]):
        measured = list(ids)
        cells.append(
            [name, *(sensitivity_range(measured, column) for column in columns)]
        )
    return "\n".join(markdown_table(["experiment", *columns], cells))


def contents() -> dict[Path, str]:
    """Return the pages with their generated parts replaced."""
    names: dict[Kind, list[str]] = {kind: [] for kind in REFERENCES}
    for variant in variants():
        names[reference_kind(variant)].append(variant.name)
    counts = [[str(len(names[kind])), text] for kind, text in REFERENCES.items()]
    rows = [
        [kind.value, text, str(len(names[kind])), experiments_of(names[kind])]
        for kind, text in REFERENCES.items()
    ]
    head = ("kind", "compared with", "ids", "experiments (ids)")
    coverage = "\n".join(markdown_table(head, rows))
    references = "\n".join(markdown_table(("ids", "compared with"), counts))
    page = with_part(PAGE.read_text(encoding="utf-8"), "coverage", SCRIPT, coverage)
    pages = {PAGE: with_part(page, "answers", SCRIPT, answers_table())}
    pages |= page_part(ROOT / "README.md", "references", SCRIPT, references)
    file = ROOT / "docs" / "fabrics.md"
    return pages | page_part(file, "sensitivity", SCRIPT, sensitivity_table())
