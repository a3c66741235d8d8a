"""`gauge show` describes an id on one screen: reference, real events, and detected errors."""

import pytest

from gauge_envs import load_experiment
from gauge_envs.tools.catalog import description as catalog
from gauge_envs.tools.catalog.report import (
    planted_errors_text,
)


@pytest.mark.parametrize(
    ("name", "detected", "missed"),
    [
        ("SlopeSlider-1-wood", [], ["no motion", "40 ms late", "friction 20 % lower"]),
        ("NonsmoothContact-1-wood", ["no motion", "40 ms late"], []),
        # 2.96 mm is inside of 1.96 u, 2.96 + 0.03 mm with a stiffness 20 % higher is so, too.
        ("TableclothPulling-plastic", ["no motion"], ["stiffness 20 % higher"]),
    ],
)
def test_an_error_is_detected_if_it_changes_the_verdict(name, detected, missed):
    reference = catalog.description(load_experiment(name))["reference"]
    scores, _, rest = planted_errors_text(reference).partition("; not detected: ")
    for title in detected:
        assert f", {title} " in scores
    for title in missed:
        assert title in rest.split(", ")


@pytest.mark.parametrize("name", ["SlopeSlider-2-wood", "CantileverBeam-soft"])
def test_no_error_changes_an_answer_that_is_no_already(name):
    reference = catalog.description(load_experiment(name))["reference"]
    assert "fails already" in planted_errors_text(reference)
