"""Answers to both questions: limits and guard bands, and wrong motions whose distance follows from closed forms.

`test_cause` asks both questions of over 100 wrong motions of scenes with real trials.
"""

import csv

import pytest
from places import ROOT

from gauge_envs import load_experiment
from gauge_envs.scoring.answers import (
    Answer,
    mattering_distance,
    solves,
    united,
    within,
)
from gauge_envs.scoring.reference import reference_band


def test_an_answer_needs_1_96_standard_uncertainties_on_its_side():
    assert within(1.0, 1.0) is Answer.YES and within(1.01, 1.0) is Answer.NO
    assert within(0.8, 1.0, 0.1) is Answer.YES
    assert within(0.81, 1.0, 0.1) is Answer.CANNOT_TELL
    assert within(1.19, 1.0, 0.1) is Answer.CANNOT_TELL
    assert within(1.2, 1.0, 0.1) is Answer.NO


def test_a_difference_matters_from_2_percent_of_the_motion_or_half_a_real_trial_on():
    assert mattering_distance(200.0, "mm") == pytest.approx(4.0)
    assert mattering_distance(200.0, "mm", of_trials=2.0) == pytest.approx(1.0)
    # Nothing below a tenth of a millimetre matters; an area has no such limit.
    assert mattering_distance(0.0, "mm") == pytest.approx(0.1)
    assert mattering_distance(20.0, "mm^2") == pytest.approx(0.4)


def test_one_no_decides_and_one_doubt_remains():
    assert united([Answer.YES, None, Answer.CANNOT_TELL]) is Answer.CANNOT_TELL
    assert united([Answer.YES, Answer.CANNOT_TELL, Answer.NO]) is Answer.NO
    assert united([Answer.YES, None]) is Answer.YES
    assert united([None]) is None and united([]) is None


def test_coverage_counts_the_solutions_that_are_too_uncertain_for_a_yes():
    """Even the exact motion cannot get a yes where 1.96 u is above the smallest distance that matters."""
    with (ROOT / "scoring" / "answers.csv").open(encoding="utf-8") as stream:
        answers = {row["id"]: row["solves"] for row in csv.DictReader(stream)}
    doubtful = [name for name, answer in answers.items() if answer == "cannot tell"]
    bands = [reference_band(load_experiment(name)) for name in doubtful]
    uncertain = sum(solves(band, 0.0) is Answer.CANNOT_TELL for band in bands)
    text = f'MuJoCo gets {len(doubtful)} "cannot tell" of {len(answers)} ids. In {uncertain} of them'
    assert text in (ROOT / "docs" / "coverage.md").read_text()
