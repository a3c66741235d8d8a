"""`gauge show` states the reference of an id in a few lines, with its recorded events and what its score can see."""

import pytest

from gauge_envs import load_experiment
from gauge_envs.files import json_ready
from gauge_envs.tools.catalog import description as catalog
from gauge_envs.tools.catalog.words import (
    SEEN,
    events_text,
    reference_text,
    sees_text,
)

SEES = f"""id,metric,unit,{",".join(SEEN)}
SlopeSlider-2-wood,rmse_aligned,mm,3.327,211,3.33,5.53,13.6,,
NewtonsCradle-metal,rmse,mm,86.3,107,85.8,,,,
NewtonsCradle-metal,lsd,s,0.0667,0,0.0667,,,,
"""


@pytest.mark.parametrize(
    ("name", "line"),
    [
        (
            "SlopeSlider-2-wood",
            "rmse aligned [mm]: MuJoCo 3.33, frozen 211, 40 ms late 3.33, friction 20 % lower 5.53, 20 % higher 13.6",
        ),
        (
            "NewtonsCradle-metal",
            "RMSE [mm]: MuJoCo 86.3, frozen 107, 40 ms late 85.8; LSD [s]: MuJoCo 0.0667, frozen 0, 40 ms late 0.0667",
        ),
        ("Funnel-satin", ""),
    ],
)
def test_what_a_score_sees_is_one_line(tmp_path, monkeypatch, name, line):
    (tmp_path / "sees.csv").write_text(SEES)
    monkeypatch.setattr(catalog, "data_folder", lambda _: tmp_path)
    assert sees_text(json_ready(catalog.seen_changes(name))) == line


def test_the_reference_is_stated_in_a_line():
    experiment = load_experiment("SlopeSlider-2-wood")
    reference = catalog.description(experiment)["reference"]
    text = "trials (20), u 5.41 mm, a frozen scene is off by 212 mm"
    exact = {"calibrated": 5.0912, "effective": 1.2}
    assert reference_text(reference | {"exact": {}}, frames=19) == text
    more = (
        "an exact solution scores 5.09 (calibrated), 1.20 (effective) over real trials"
    )
    assert (
        reference_text(reference | {"exact": exact}, frames=20)
        == f"{text}, known at 19 of 20 frames, {more}"
    )


def test_recorded_events_are_stated_where_no_motion_is_known():
    reference = catalog.description(load_experiment("CantileverBeam-soft"))["reference"]
    assert (
        events_text(reference["events"])
        == "swing frequency: 1.68 +- 0.08 Hz; mean angle: 25.5 +- 5.3 deg"
    )
    text = "none: no reference motion; events may have real values"
    assert reference_text(reference, frames=90) == text
