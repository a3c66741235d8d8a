"""What docs/engines/comparison.md says of the ranks, against the data that its tables are made from."""

from __future__ import annotations

import json
from typing import Any

import pytest

from gauge_envs.files import data_folder
from scripts.build_engine_table import failed_checks

SLIDES = tuple(
    f"GAUGE/SlopeSlider-2-{material}" for material in ("wood", "plastic", "metal")
)
BALL = "GAUGE/BouncingBall-rubber"


@pytest.fixture(scope="module")
def data() -> dict[str, Any]:
    return dict(
        json.loads(
            (data_folder("scoring") / "engines.json").read_text(encoding="utf-8")
        )
    )


def grade(data: dict[str, Any], constants: str) -> dict[str, Any]:
    (found,) = (
        one
        for one in data["grades"]
        if (one["grade"], one["constants"]) == ("trials", constants)
    )
    return dict(found)


def scores(data: dict[str, Any], kind: str) -> dict[str, float]:
    ranked = [one for one in data["configurations"] if not failed_checks(one)]
    return {
        one["engine"]: one[kind]["BouncingBall-rubber"]["rmse_aligned_normalized"]
        for one in ranked
    }


def test_only_what_fails_no_check_is_ranked(data: dict[str, Any]) -> None:
    passing = {one["engine"] for one in data["configurations"] if not one["preset"]}
    for one in data["grades"]:
        assert {row["configuration"] for row in one["ranked"]} in (passing, set())
    assert all(
        bool(failed_checks(one)) == bool(one["preset"])
        for one in data["configurations"]
    )


def test_newton_is_closer_than_all_but_two_with_two_errors_that_cancel(
    data: dict[str, Any],
) -> None:
    published = grade(data, "calibrated")
    assert sorted(published["ids"]) == sorted((BALL, *SLIDES))
    others = {"physx", "pybullet", "rapier", "drake"}
    assert {tuple(pair) for pair in published["apart"]} == {
        ("newton", other) for other in others
    }
    (newton,) = (
        one
        for one in data["configurations"]
        if (one["engine"], one["preset"]) == ("newton", "")
    )
    assert (
        newton["laws"]["slide wood"] > 1.005 and newton["laws"]["slide plastic"] > 1.005
    )


def test_with_the_constants_of_the_trials_only_the_ball_tells_apart(
    data: dict[str, Any],
) -> None:
    effective = grade(data, "effective")
    assert effective["apart"] == []
    assert [effective["pairs_apart"][name][0] for name in SLIDES] == [0, 0, 0]
    ranks = [
        {
            one["configuration"]: one["ranks"][BALL]
            for one in grade(data, constants)["ranked"]
        }
        for constants in ("calibrated", "effective")
    ]
    assert ranks[1]["genesis"] == pytest.approx([1, 1], abs=0.01)
    assert ranks[0]["genesis"] == pytest.approx([2, 6], abs=0.01)


def test_constants_change_the_score_of_the_ball_by_more_than_engines_differ(
    data: dict[str, Any],
) -> None:
    published, effective = scores(data, "episodes"), scores(data, "effective")
    change = min(published[engine] - effective[engine] for engine in published)
    for one in (published, effective):
        assert change > 10.0 * (max(one.values()) - min(one.values()))
