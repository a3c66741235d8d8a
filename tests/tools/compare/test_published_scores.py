"""The comparison of an engine with the published scores of an engine."""

import pytest

from gauge_envs.references.published import published_baselines
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from studies.published_scores.published_scores import Repeated, comparable, compare


def test_rows_have_a_published_score_and_a_reference():
    found = dict(comparable("genesis"))
    assert set(found["SlopeSlider-2-wood"]) == {"rmse", "dtw"}
    assert set(found["Pendulum-metal"]) == {"pd", "el"}
    # Genesis has no valid cradle, textiles have no band, and the law of NonsmoothContact ends before the impact.
    assert not {
        "NewtonsCradle-metal",
        "TextileBending-satin",
        "NonsmoothContact-1-wood",
    } & set(found)


def test_rows_hold_the_score_of_the_run():
    rows = {
        row.metric: row
        for row in compare("mujoco", "contact", "newton", "BouncingBall-*")
    }
    score = run_episode(
        RunRequest("BouncingBall-rubber", settings={"preset": "contact"})
    ).score
    assert rows["rmse"].reached == score.validation.rmse_normalized
    assert rows["dtw"].reached == score.validation.dtw_normalized
    assert (
        rows["rmse"].published
        == published_baselines("BouncingBall-rubber")["rmse"].engines["newton"]
    )
    assert {row.grade for row in rows.values()} == {"trials"}


@pytest.mark.parametrize(
    ("reached", "repeated"), [(2.05, True), (1.95, True), (2.07, False), (None, False)]
)
def test_a_score_within_3_percent_is_repeated(reached, repeated):
    row = Repeated(
        variant="A-wood",
        metric="rmse",
        grade="trials",
        driver=None,
        published=2.0,
        reached=reached,
    )
    assert row.is_repeated is repeated
    assert row.cells()[-1] == ("yes" if repeated else "no")
