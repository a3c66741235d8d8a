"""`gauge show` describes an id on one screen: reference, real events, and detected errors."""

import pytest
from rich.console import Console

from gauge_envs import load_experiment
from gauge_envs.pages.terminal import Terminal
from gauge_envs.tools.catalog import description as catalog
from gauge_envs.tools.catalog.report import (
    events_text,
    experiment_document,
    planted_errors_text,
    reference_text,
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


def test_a_reference_is_described_in_a_line():
    reference = catalog.description(load_experiment("SlopeSlider-2-wood"))["reference"]
    text = (
        "mean and standard deviation of the real trials at each frame; 20 trials; "
        "standard uncertainty u = 5.41 mm; "
        "if nothing moved, the error would be 212 mm"
    )
    assert reference_text(reference, frames=19) == text
    assert reference_text(reference, frames=20) == f"{text}; known at 19 of 20 frames"


def test_an_experiment_has_real_events_or_says_that_it_has_no_reference():
    reference = catalog.description(load_experiment("CantileverBeam-soft"))["reference"]
    assert (
        events_text(reference["events"])
        == "swing frequency: 1.68 +- 0.08 Hz; mean angle: 25.5 +- 5.3 deg"
    )
    none = catalog.description(load_experiment("RotatingBall-satin"))["reference"]
    text = "no reference motion; events may have real values"
    assert reference_text(none, frames=90) == text


@pytest.mark.parametrize("name", ["SlopeSlider-2-wood", "TextileFlinging-satin"])
def test_an_id_fits_a_screen(name):
    console = Console(width=80, no_color=True)
    values = catalog.description(load_experiment(name))
    with console.capture() as captured:
        console.print(Terminal(experiment_document(values)))
    assert len(captured.get().splitlines()) <= 34
