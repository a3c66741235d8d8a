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
    MAPPED,
    Case,
    G,
    Options,
    Push,
    acceleration,
    braking_share,
    feet,
    force_acceleration,
    speed_share,
    start_from,
)

STUDY = Path(few_iterations.__file__).parent
CUBE = CASES[0]


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


@pytest.mark.parametrize("body", MAPPED)
@pytest.mark.parametrize(
    "push", [Push(1.25, 0.0), Push(1.5, 1.0), Push(3.0, 3.0)], ids=str
)
def test_one_iteration_holds_at_all_speeds_and_loads(body: str, push: Push) -> None:
    assert speed_share(MAPPED[body](), Options(), push) < few_iterations.STICKS
    assert (
        speed_share(MAPPED[body](), Options(iterations=4), push) > few_iterations.SLIDES
    )


@pytest.mark.parametrize("body", MAPPED)
def test_one_iteration_stops_a_sliding_body_too_early(body: str) -> None:
    assert braking_share(MAPPED[body](), Options(), 1.0) < 0.2
    assert braking_share(MAPPED[body](), Options().converged, 1.0) == pytest.approx(
        1.0, abs=0.05
    )


@pytest.mark.parametrize(
    "change", [{"ls_iterations": 50}, {"warmstart": False}], ids=str
)
def test_neither_line_search_nor_warm_start_is_responsible(
    change: dict[str, object],
) -> None:
    assert acceleration(CUBE, replace(Options(), **change)) < 0.05 * CUBE.law


def test_start_of_the_solver_is_responsible() -> None:
    assert start_from(CUBE, Options(), given_s=np.inf) == pytest.approx(
        CUBE.law, rel=0.05
    )
    assert start_from(CUBE, Options(), given_s=0.1) < 0.05 * CUBE.law


def test_body_that_is_held_disobeys_its_contact_forces() -> None:
    assert force_acceleration(CUBE, Options()) > 2.0 * CUBE.law
    converged = Options().converged
    assert force_acceleration(CUBE, converged) == pytest.approx(
        acceleration(CUBE, converged), rel=1e-6
    )


def test_integrator_that_moves_by_forces_lets_the_cube_slide() -> None:
    assert acceleration(CUBE, Options(integrator="implicitfast")) > 0.9 * CUBE.law


def test_the_study_has_the_table_of_cases() -> None:
    with (STUDY / "cases_mujoco.csv").open(encoding="utf-8", newline="") as file:
        quoted = {row[0]: row[1:] for row in csv.reader(file)}
    for case in CASES:
        law, *found = map(float, quoted[case.title])
        assert law == pytest.approx(case.law, abs=0.005)
        # Bodies that slide with a pyramidal cone bounce a little, which rounding changes.
        expected = [acceleration(case, options) for options in COLUMNS.values()]
        assert found == pytest.approx(expected, abs=0.1)
