"""Uncertainty of friction coefficients, from the single trials that were published."""

import csv
import math

import numpy as np
import pytest

from gauge_envs import load_experiment
from gauge_envs.files import data_folder
from gauge_envs.references.uncertainties import friction_std
from gauge_envs.scene import GRAVITY_M_PER_S2


@pytest.mark.parametrize("material", ["wood", "plastic", "metal"])
def test_uncertainty_of_friction_is_its_distance_from_single_trials(material):
    path = data_folder("scoring") / "facts" / "slope_slider_30deg.csv"
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    trials = {}
    for row in csv.DictReader(lines):
        if row["material"] == material:
            point = int(row["frame"]) / 30.0, 1e-3 * float(row["downhill_mm"])
            trials.setdefault(row["trial"], []).append(point)
    angle = math.radians(30.0)
    accelerations = [
        2.0 * np.polyfit(*zip(*trial, strict=True), 2)[0] for trial in trials.values()
    ]
    friction = math.tan(angle) - np.array(accelerations) / (
        GRAVITY_M_PER_S2 * math.cos(angle)
    )
    calibrated = load_experiment(f"SlopeSlider-2-{material}").scene.contacts[0].friction
    expected = float(np.sqrt(np.mean((friction - calibrated) ** 2))) / calibrated
    assert friction_std(1.0, material) == pytest.approx(expected, rel=0.02)
