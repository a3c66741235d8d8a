"""Real motions, whose places are known in metres: the published recordings and trials have their constants."""

import csv
import math
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cv2")

from clips import track_of

from gauge_envs.tools.video import score_track, video_task

SCORING = Path(__file__).parents[3] / "scoring"
FACTS = SCORING / "facts" / "recordings"


def _recorded(name):
    with (FACTS / f"{name}.csv").open() as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    return {
        key: np.array([float(row[key]) if row[key] else math.nan for row in rows])
        for key in rows[0]
    }


def test_the_recorded_pendulum_has_its_period():
    recorded = _recorded("pendulum")
    used = recorded["used"] == 1
    # The camera looks along -y: to the right is -x. The pivot is 463.4 mm above the ground, within 8 mm.
    places = np.column_stack([359.5 - recorded["x_mm"], recorded["z_mm"] - 463.4])
    track = replace(
        track_of(places[used], 18.0),
        frames=np.round(recorded["time_s"][used] * 18.0).astype(np.int64),
        is_metric=True,
    )
    result = score_track(track, video_task("Pendulum-metal"))
    low, high = result.uncertainty["pd"]
    # The published 1.06 s is another amplitude: this swing is about 16 % slower than a small one of the same length.
    assert 1.06 < low < 1.201 < high


# --- real trials -----------------------------------------------------------------------------------------------------


def _trials(name, column):
    """Return one coordinate of all trials of a variant [m], shape [trial_count, frame_count]."""
    with (SCORING / "trials" / f"{name}.csv").open() as file:
        rows = list(csv.DictReader(file))
    names = [key for key in rows[0] if key.endswith(column)]
    return (
        np.array([[float(row[key]) for row in rows if row[key]] for key in names]) / 1e3
    )


@pytest.mark.slow
@pytest.mark.parametrize("material", ["wood", "plastic", "metal"])
def test_real_slides_have_their_acceleration(material):
    task = video_task(f"SlopeSlider-2-{material}")
    assert task.direction is not None
    facts = tomllib.loads(
        (SCORING / "facts" / "slope_slider_30deg_summary.toml").read_text()
    )[material]
    found = []
    for along_m in _trials(task.id, ".downhill"):
        along_px = (along_m - along_m[0]) / task.scale_m_per_px
        places = np.array(task.centre_px) + along_px[:, None] * np.array(task.direction)
        result = score_track(track_of(places, 30.0), task)
        assert result.metrics["acceleration_m_s2"] is not None
        found.append(result.metrics["acceleration_m_s2"])
    assert len(found) == facts["trial_count"]
    # The law starts from rest. Two trials of plastic move at the first frame already, and get 3.3 and 3.4 m/s^2.
    assert np.median(found) == pytest.approx(
        facts["acceleration_m_s2"]["median"], rel=0.01
    )
