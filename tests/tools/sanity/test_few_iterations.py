"""Too few solver iterations stop sliding: the study that shows it, and its table."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from studies.few_iterations import few_iterations
from studies.few_iterations.few_iterations import (
    CASES,
    COLUMNS,
    Case,
    G,
    Options,
    acceleration,
    feet,
)

STUDY = Path(few_iterations.__file__).parent


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.title)
def test_bodies_stick_with_one_iteration_and_slide_with_enough(case: Case) -> None:
    assert abs(acceleration(case, Options())) < 0.06 * case.law
    assert acceleration(case, Options().converged) == pytest.approx(case.law, rel=0.05)


@pytest.mark.parametrize(
    ("cone", "ls_iterations"), [("pyramidal", 8), ("elliptic", 20)]
)
@pytest.mark.parametrize("step", [0.002, 0.004, 0.005, 0.01])
def test_four_iterations_give_the_converged_acceleration(
    cone: str, ls_iterations: int, step: float
) -> None:
    options = Options(cone=cone, timestep=step)
    for case in CASES:
        few = acceleration(
            case, replace(options, iterations=4, ls_iterations=ls_iterations)
        )
        assert few == pytest.approx(acceleration(case, options.converged), abs=0.02)


def test_law_is_coulombs() -> None:
    assert CASES[0].law == pytest.approx(G * (0.5 - 0.274 * np.sqrt(0.75)))
    assert Case("held", feet(), slope=np.radians(20.0)).law == 0.0


def test_the_study_has_the_table_of_cases() -> None:
    with (STUDY / "cases_mujoco.csv").open(encoding="utf-8", newline="") as file:
        quoted = {row[0]: row[1:] for row in csv.reader(file)}
    for case in CASES:
        law, *found = map(float, quoted[case.title])
        assert law == pytest.approx(case.law, abs=0.005)
        # Bodies that slide with a pyramidal cone bounce a little, which rounding changes.
        expected = [acceleration(case, options) for options in COLUMNS.values()]
        assert found == pytest.approx(expected, abs=0.1)
