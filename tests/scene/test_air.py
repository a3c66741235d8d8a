"""Air: the force on a triangle at all angles, its invariances, the stable speed, and the scenes that have it."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gauge_envs import load_experiment
from gauge_envs.backends import backend_names, support_of
from gauge_envs.errors import (
    MissingExtraError,
    UnsupportedSceneError,
)
from gauge_envs.formats.usd.reader import from_usd
from gauge_envs.formats.usd.writer import to_usd
from gauge_envs.scene import Air
from gauge_envs.scene.diff import scene_changes
from gauge_envs.tools.assets.export import mjcf_text

AIR = Air(
    density_kg_per_m3=1.2,
    normal_coefficient=1.1,
    tangential_coefficient=0.2,
    lift_coefficient=0.7,
)
SATIN = "TextileFlinging-satin"


@pytest.mark.parametrize("degrees", [0, 20, 50, 90])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_force_on_a_triangle_follows_the_angle_of_incidence(degrees, side):
    """The plate moves along x at an angle to its plane; drag and lift are written with this angle."""
    angle, speed, area = math.radians(degrees), 3.0, 0.02
    normal = np.array([math.sin(angle), 0.0, math.cos(angle)])
    (force,) = AIR.forces_n(side * area * normal[None], np.array([[speed, 0.0, 0.0]]))
    sine, cosine = math.sin(angle), math.cos(angle)
    drag = 1.1 * sine**3 + 0.2 * cosine**3
    lift = 1.1 * sine**2 * cosine - 0.2 * cosine**2 * sine + 0.7 * sine * cosine
    pressure_n = 0.5 * 1.2 * area * speed**2
    expected = pressure_n * np.array([-drag, 0.0, -lift])
    assert force == pytest.approx(expected, abs=1e-15)


def test_air_takes_energy_and_lift_does_no_work_relative_to_the_wind():
    random = np.random.default_rng(0)
    areas, speeds = random.normal(size=(200, 3)), random.normal(size=(200, 3))
    wind = (0.3, -2.0, 1.0)
    blown = replace(AIR, wind_m_per_s=wind)
    forces = AIR.forces_n(areas, speeds)
    assert blown.forces_n(areas, speeds + wind) == pytest.approx(forces)
    assert ((forces * speeds).sum(axis=1) < 0.0).all()
    lift = Air(density_kg_per_m3=1.2, normal_coefficient=0.0, lift_coefficient=2.0)
    forces = lift.forces_n(areas, speeds)
    assert np.linalg.norm(forces, axis=1).min() > 0.0
    assert (forces * speeds).sum(axis=1) == pytest.approx(np.zeros(200), abs=1e-12)
    for nothing in ((0.0 * areas, speeds), (areas, 0.0 * speeds)):
        assert not AIR.forces_n(*nothing).any()


def test_no_step_overshoots_below_the_stable_speed():
    """Below this speed an explicit step keeps the sign of a deviation; above it, the sign changes."""
    density, step = 0.1, 1e-3
    air = Air(density_kg_per_m3=1.2, normal_coefficient=1.5)
    given = {"areal_density_kg_per_m2": density, "timestep_s": step}
    stable = air.stable_speed_m_per_s(**given)

    def after(speed):
        velocity = np.array([[0.0, 0.0, speed]])
        (force,) = air.forces_n(np.array([[0.0, 0.0, 1.0]]), velocity)
        return float(speed + step * force[2] / density)

    small = 1e-3 * stable
    assert after(0.99 * stable + small) > after(0.99 * stable)
    assert after(1.01 * stable + small) < after(1.01 * stable)
    assert AIR.stable_speed_m_per_s(**given) == pytest.approx(100.0 / (1.2 * 1.8))
    still = Air(density_kg_per_m3=1.0, normal_coefficient=0.0)
    assert still.stable_speed_m_per_s(**given) == math.inf


def test_air_is_a_parameter_set_that_usd_stores_and_other_formats_do_not_support(
    tmp_path,
):
    published, experiment = load_experiment(SATIN), load_experiment(SATIN, "air")
    scene = experiment.scene
    (change,) = scene_changes(published.scene, scene)
    assert str(change) == "scene: air None -> Air"
    assert scene.air.normal_coefficient == 1.17
    overrides = experiment.overrides | {"air.wind_m_per_s": [0.1, -0.2, 1.0 / 3.0]}
    windy = load_experiment(SATIN, overrides).scene
    (change,) = scene_changes(scene, windy)
    assert str(change) == "air: wind_m_per_s (0, 0, 0) -> (0.1, -0.2, 0.3333333333)"
    to_usd(windy, tmp_path / "air.usda")
    assert from_usd(tmp_path / "air.usda") == windy
    with pytest.raises(UnsupportedSceneError, match="MJCF cannot express the air"):
        mjcf_text(experiment)
    for name in backend_names():
        try:
            missing = support_of(name, scene).missing
        except MissingExtraError:
            continue
        assert ("air" in " ".join(missing)) == (name != "mujoco")
