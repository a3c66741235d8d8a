"""Uncertainties of published constants: their distance from real trials, whose statistics are in `scoring/facts`."""

import math
import tomllib

import pytest

from gauge_envs import load_experiment
from gauge_envs.files import data_folder
from gauge_envs.references.uncertainties import RESTITUTION_SHARE, friction_std


def distance_share(published, real, trial_count):
    """Return the root mean square distance of single trials from a published value, over it."""
    square = real["std"] ** 2 * (trial_count - 1) / trial_count
    return math.hypot(math.sqrt(square), real["mean"] - published) / published


def summary(name):
    file = data_folder("scoring") / "facts" / f"{name}_summary.toml"
    return tomllib.loads(file.read_text())


def test_uncertainties_are_distances_from_single_trials():
    shares = []
    for material, real in summary("slope_slider_30deg").items():
        scene = load_experiment(f"SlopeSlider-2-{material}").scene
        published = scene.contacts[0].friction
        share = distance_share(published, real["friction"], real["trial_count"])
        assert friction_std(2.0, material) == pytest.approx(2.0 * share, rel=0.02)
        shares.append(share)
    rms = math.hypot(*shares) / math.sqrt(3.0)
    assert friction_std(2.0, "rubber") == pytest.approx(2.0 * rms, rel=0.02)
    scene = load_experiment("BouncingBall-rubber").scene
    real = summary("bouncing_ball")["rebound_ratio"]
    share = distance_share(scene.contacts[0].restitution, real, 22)
    assert pytest.approx(share, rel=0.01) == RESTITUTION_SHARE
