"""Published recordings and trials of real motions give the known constants."""

import csv
import tomllib
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cv2")

from clips import track_of

from gauge_envs.tools.video import score_track, video_task

FACTS = Path(__file__).parents[3] / "scoring" / "facts"


def rows_of(file):
    with file.open() as stream:
        lines = [line for line in stream if not line.startswith("#")]
    return list(csv.DictReader(lines))


def test_the_recorded_pendulum_has_its_period():
    recorded = rows_of(FACTS / "recordings" / "pendulum.csv")
    rows = [row for row in recorded if row["used"] == "1"]
    time_s, x_mm, z_mm = (
        np.array([float(row[key]) for row in rows])
        for key in ("time_s", "x_mm", "z_mm")
    )
    # The camera looks along -y, so right is -x. The pivot is 463.4 mm above the ground, within 8 mm.
    task = video_task("Pendulum-metal")
    arms_m = 1e-3 * np.column_stack([359.5 - x_mm, 463.4 - z_mm])
    track = track_of(task.pivot_px + arms_m / task.scale_m_per_px, 18.0)
    track = replace(track, times_s=np.round(time_s * 18.0) / 18.0)
    low, high = score_track(track, task).uncertainty["pd"]
    # The published 1.06 s has another amplitude: this swing is about 16 % slower than a small swing.
    assert 1.06 < low < 1.201 < high


@pytest.mark.slow
@pytest.mark.parametrize("material", ["wood", "plastic", "metal"])
def test_real_slides_have_their_acceleration(material):
    """The trials begin with the fourth frame after the release; the fit finds the release."""
    task = video_task(f"SlopeSlider-2-{material}")
    facts = tomllib.loads((FACTS / "slope_slider_30deg_summary.toml").read_text())
    trials = defaultdict(list)
    for row in rows_of(FACTS / "slope_slider_30deg.csv"):
        if row["material"] == material:
            trials[row["trial"]].append(1e-3 * float(row["downhill_mm"]))
    accelerations = []
    for along_m in trials.values():
        along_px = np.subtract(along_m, along_m[0]) / task.scale_m_per_px
        places_px = task.centre_px + np.outer(along_px, task.direction)
        metrics = score_track(track_of(places_px, 30.0), task).metrics
        accelerations.append(metrics["acceleration_m_s2"])
    facts_of_real = facts[material]["acceleration_m_s2"]
    assert task.real["a"] == (facts_of_real["mean"], facts_of_real["std"])
    expected = facts_of_real["median"]
    assert len(accelerations) == facts[material]["trial_count"]
    assert np.median(accelerations) == pytest.approx(expected, rel=0.02)
