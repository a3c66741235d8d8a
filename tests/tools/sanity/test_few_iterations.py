"""Too few solver iterations stop sliding: the study that shows it, and its table."""

import csv
from pathlib import Path

import pytest

from studies.few_iterations import few_iterations
from studies.few_iterations.few_iterations import CASES, COLUMNS, acceleration

STUDY = Path(few_iterations.__file__).parent


def test_the_study_has_the_table_of_cases():
    with (STUDY / "cases_mujoco.csv").open(encoding="utf-8", newline="") as file:
        quoted = {row[0]: row[1:] for row in csv.reader(file)}
    for case in CASES:
        law, *found = map(float, quoted[case.title])
        assert law == pytest.approx(case.law, abs=0.005)
        # Bodies that slide with a pyramidal cone bounce a little, which rounding changes.
        expected = [acceleration(case, options) for options in COLUMNS.values()]
        assert found == pytest.approx(expected, abs=0.1)
