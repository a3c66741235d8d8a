"""The summary of `gauge run` fits a screen, explains motions, and separates engine errors from constants."""

from dataclasses import replace

import pytest
from rich.console import Console

from gauge_envs.pages.terminal import Terminal
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.scoring.answers import Answer, DistanceCause
from gauge_envs.scoring.estimates import ComparedQuantity
from gauge_envs.scoring.score import Score
from gauge_envs.tools.run.report import cause_text, motion_text, summary_document


def measured(value, unit, real, real_uncertainty):
    return ComparedQuantity(
        value=value, unit=unit, real=real, real_uncertainty=real_uncertainty
    )


NONE = Score(kind="none", unit="mm")

SLIDE = Score(
    kind="trials",
    unit="mm",
    distance_unit="mm",
    solves=Answer.YES,
    like_reality=Answer.NO,
    solution_distance=0.01,
    solution_motion=212.0,
    exact=5.09,
    rmse_aligned=3.33,
    rmse_aligned_normalized=4.95,
    real_limit=1.0,
    estimates={"friction": measured(0.27318, "1", 0.25702, 0.0061)},
)

SWING = Score(
    kind="analytic",
    unit="mm",
    distance_unit="mm",
    solves=Answer.NO,
    like_reality=Answer.NO,
    solution_distance=86.3,
    solution_motion=300.0,
    rmse=86.3,
    events={
        "pd": measured(1.23, "s", 1.14, 0.015),
        "el": ComparedQuantity(value=0.0, unit="1", real=0.0),
        "turning_ratio": measured(1.0, "1", 0.925, 0.034),
    },
)


def result(score, **changes):
    values = {"id": "GAUGE/SlopeSlider-2-wood", "outcome": Outcome.FINISHED}
    values |= {"parameters": "published", "backend": "mujoco", "seed": 0}
    return Result(**(values | {"score": score, "task_sha256": ""} | changes))


def shown(results, *, width=120, details=False):
    console = Console(width=width, no_color=True)
    with console.capture() as captured:
        console.print(Terminal(summary_document(results, details=details)))
    return captured.get()


@pytest.mark.parametrize(
    ("score", "text"),
    [
        (SLIDE, "slides as with friction 0.273; real trials 0.257 +- 0.0061"),
        (SWING, "swings in 1.23 s; real trials 1.14 +- 0.015 s"),
        (NONE, None),
    ],
)
def test_the_summary_shows_the_quantity_farthest_from_reality(score, text):
    assert motion_text(score) == text


@pytest.mark.parametrize(
    ("cause", "text"),
    [
        (
            DistanceCause.CONSTANTS,
            "An exact solver is also 3.42 mm off: the published friction is wrong, not the engine.",
        ),
        (
            DistanceCause.ENGINE,
            "An exact solver is 3.42 mm off: the engine or its settings are wrong, not the constants.",
        ),
        (
            DistanceCause.BOTH,
            "An exact solver is 3.42 mm off: both the engine and the constants are wrong.",
        ),
        (DistanceCause.NONE, None),
    ],
)
def test_the_cause_of_a_distance_is_a_sentence(cause, text):
    assert cause_text(replace(SLIDE, cause=cause), "published") == text
    without_exact = replace(SLIDE, exact=None, cause=None)
    assert cause_text(without_exact, "published") is None


def test_a_cause_names_the_constants_that_differ_from_reality():
    score = replace(SLIDE, cause=DistanceCause.CONSTANTS)
    assert "the given friction is wrong" in cause_text(score, {"cube.friction": 0.1})
    right = measured(0.26, "1", 0.257, 0.006)
    score = replace(score, estimates={"friction": right})
    text = "the constants or the start of the scene are wrong"
    assert text in cause_text(score, "measured")


def test_the_summary_gives_reasons_for_rejected_and_diverged_results():
    reason = "no score: the trials reference holds for the real scene"
    refused = result(replace(NONE, kind="trials", refused=reason))
    diverged = result(NONE, diverged=True, outcome=Outcome.DIVERGED)
    text = shown([refused, diverged])
    assert reason in text
    assert "no real data" in text
    # The first line does not leave out what diverged.
    assert text.startswith("1 of 2 diverged; ")
    assert "diverged" in text


def test_the_summary_reports_scores_of_few_frames():
    few = replace(SWING, compared_frames=6)
    assert "s; compared at 6 of 302 frames" in shown([result(few, frames=302)])
    assert "compared at" not in shown([result(few, frames=6)])


def test_details_have_all_numbers_of_a_score():
    text = " ".join(shown([result(SLIDE)], details=True).split())
    for name in ("rmse_aligned", "real_limit", "friction 0.273, real 0.257"):
        assert name in text
    assert "real_limit" not in shown([result(SLIDE)])
