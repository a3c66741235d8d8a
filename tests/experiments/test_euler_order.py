"""The order of the published rotations is an assumption: where it matters, the task says so."""

import math

import pytest
from scipy.spatial.transform import Rotation

from gauge_envs import load_experiment
from gauge_envs.tools.catalog.description import description

TILTED_DEG = {"1": 10.0, "2": 10.0, "3": 5.0}
"""Size of both published angles of the body of a subtask."""


@pytest.mark.parametrize("material", ["wood", "plastic"])
@pytest.mark.parametrize("subtask", TILTED_DEG)
def test_a_body_turns_about_the_fixed_x_axis_first(subtask, material):
    name, tilt_deg = f"NonsmoothContact-{subtask}-{material}", TILTED_DEG[subtask]
    experiment = load_experiment(name)
    body = experiment.scene.dynamic_bodies[0]
    about_x = Rotation.from_euler("x", -tilt_deg, degrees=True)
    about_y = Rotation.from_euler("y", tilt_deg, degrees=True)
    assumed = body.pose.rotation
    assert (assumed.inv() * (about_y * about_x)).magnitude() < 1e-9
    # To second order the other order is away by the product of the angles.
    apart_deg = math.degrees((assumed.inv() * (about_x * about_y)).magnitude())
    product_deg = math.degrees(math.radians(tilt_deg) ** 2)
    assert apart_deg == pytest.approx(product_deg, rel=0.02)
    decisions = " ".join(description(experiment)["decisions"])
    assert "no order of the published rotations" in decisions
    assert f"{apart_deg:.1f}" in decisions
