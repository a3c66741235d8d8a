"""Air: the force on a triangle at all angles, its invariances, the stable speed, and the scene that states it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from texts import changed_text

from gauge_envs import load_experiment
from gauge_envs.backends import Backend, Support, backend_names, support_of
from gauge_envs.backends.base import scene_support
from gauge_envs.errors import (
    AssetError,
    MissingExtraError,
    ParameterError,
    UnsupportedSceneError,
)
from gauge_envs.scene import Air
from gauge_envs.scene.diff import scene_changes
from gauge_envs.tools.assets.export import mjcf_text
from gauge_envs.tools.catalog.description import description
from gauge_envs.tools.usd.reader import from_usd
from gauge_envs.tools.usd.writer import to_usd

AIR = Air(
    density_kg_per_m3=1.2,
    normal_coefficient=1.1,
    tangential_coefficient=0.2,
    lift_coefficient=0.7,
)
SATIN = "TextileFlinging-satin"


@pytest.mark.parametrize("degrees", range(0, 91, 10))
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_force_on_a_triangle_follows_the_angle_of_incidence(degrees, side):
    """Drag and lift of a plate that moves along x, which its plane meets at an angle, written with the angle alone."""
    angle, speed, area = math.radians(degrees), 3.0, 0.02
    normal = np.array([math.sin(angle), 0.0, math.cos(angle)])
    (force,) = AIR.forces_n(side * area * normal[None], np.array([[speed, 0.0, 0.0]]))
    sine, cosine = math.sin(angle), math.cos(angle)
    drag = 1.1 * sine**3 + 0.2 * cosine**3
    lift = 1.1 * sine**2 * cosine - 0.2 * cosine**2 * sine + 0.7 * sine * cosine
    assert force == pytest.approx(
        0.5 * 1.2 * area * speed**2 * np.array([-drag, 0.0, -lift]), abs=1e-15
    )


def test_air_that_moves_with_the_cloth_gives_no_force():
    random = np.random.default_rng(0)
    areas, speeds, wind = (
        random.normal(size=(50, 3)),
        random.normal(size=(50, 3)),
        (0.3, -2.0, 1.0),
    )
    blown = replace(AIR, wind_m_per_s=wind)
    assert not blown.forces_n(areas, np.tile(wind, (50, 1))).any()
    assert blown.forces_n(areas, speeds + wind) == pytest.approx(
        AIR.forces_n(areas, speeds)
    )


def test_still_air_takes_energy_and_lift_does_no_work():
    random = np.random.default_rng(1)
    areas, speeds = random.normal(size=(1000, 3)), random.normal(size=(1000, 3))
    assert (np.einsum("ij,ij->i", AIR.forces_n(areas, speeds), speeds) < 0.0).all()
    lift = Air(
        density_kg_per_m3=1.2, normal_coefficient=0.0, lift_coefficient=2.0
    ).forces_n(areas, speeds)
    assert np.linalg.norm(lift, axis=1).min() > 0.0
    assert np.einsum("ij,ij->i", lift, speeds) == pytest.approx(
        np.zeros(1000), abs=1e-12
    )


def test_a_triangle_without_area_or_motion_feels_nothing():
    assert not AIR.forces_n(np.zeros((1, 3)), np.ones((1, 3))).any()
    assert not AIR.forces_n(np.ones((1, 3)), np.zeros((1, 3))).any()


def test_no_step_overshoots_below_the_stable_speed():
    """An explicit step of the deviation from a motion of that speed keeps its sign; beyond it, it does not."""
    density, step = 0.1, 1e-3
    air = Air(density_kg_per_m3=1.2, normal_coefficient=1.5)
    stable = air.stable_speed_m_per_s(areal_density_kg_per_m2=density, timestep_s=step)

    def after(speed):
        (force,) = air.forces_n(
            np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 0.0, speed]])
        )
        return float(speed + step * force[2] / density)

    small = 1e-3 * stable
    assert after(0.9 * stable + small) > after(0.9 * stable)
    assert after(1.1 * stable + small) < after(1.1 * stable)
    assert (
        Air(density_kg_per_m3=1.0, normal_coefficient=0.0).stable_speed_m_per_s(
            areal_density_kg_per_m2=1.0, timestep_s=1.0
        )
        == math.inf
    )


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"density_kg_per_m3": 0.0}, "positive density"),
        ({"normal_coefficient": -1.0}, "normal_coefficient is -1.0"),
        ({"wind_m_per_s": (0.0, math.nan, 0.0)}, "finite"),
    ],
)
def test_wrong_numbers_are_refused(changes, reason):
    with pytest.raises(ParameterError, match=reason):
        replace(AIR, **changes)


@pytest.mark.parametrize(
    ("name", "overrides", "reason"),
    [
        (
            "SlopeSlider-2-wood",
            {"air.density_kg_per_m3": 1.2, "air.normal_coefficient": 1.0},
            "air acts on cloth, and the scene has none",
        ),
        (SATIN, {"air.density_kg_per_m3": 1.2}, r"air\.normal_coefficient"),
        (SATIN, {"air.viscosity": 1.2}, "known: density_kg_per_m3"),
        (
            SATIN,
            {"air.density_kg_per_m3": -1.2, "air.normal_coefficient": 1.0},
            r"air\.density_kg_per_m3",
        ),
    ],
)
def test_wrong_overrides_name_what_is_wrong(name, overrides, reason):
    with pytest.raises(ParameterError, match=reason):
        load_experiment(name, overrides)


def test_air_is_off_by_default_and_a_parameter_set_of_the_fling():
    calibrated, experiment = load_experiment(SATIN), load_experiment(SATIN, "air")
    assert calibrated.scene.air is None
    assert experiment.scene.air == Air(
        density_kg_per_m3=1.204,
        normal_coefficient=1.17,
        tangential_coefficient=0.015,
        lift_coefficient=1.26,
    )
    assert replace(experiment.scene, air=None) == calibrated.scene
    assert list(scene_changes(calibrated.scene, experiment.scene)) == [
        "scene: air None -> Air"
    ]
    assert description(experiment)["air"]["normal_coefficient"] == 1.17
    windy = load_experiment(
        SATIN, {**experiment.overrides, "air.wind_m_per_s": [1.0, 0.0, 0.0]}
    ).scene
    assert windy.air.wind_m_per_s == (1.0, 0.0, 0.0)
    assert list(scene_changes(experiment.scene, windy)) == [
        "scene: air.wind_m_per_s (0, 0, 0) -> (1, 0, 0)"
    ]


class _Older(Backend):
    """An engine that was written before scenes had air."""

    name = "older"

    def versions(self):
        return {}

    def supports(self, scene):
        return Support()

    def build(self, scene, settings=None):
        raise NotImplementedError


def test_engines_that_do_not_apply_air_decline_the_scene():
    scene = load_experiment(SATIN, "air").scene
    assert "air around its cloth" in scene_support(_Older(), scene).missing[-1]
    assert scene_support(_Older(), replace(scene, air=None))
    for name in backend_names():
        try:
            missing = support_of(name, scene).missing
        except MissingExtraError:
            continue
        assert ("air" in " ".join(missing)) == (name != "mujoco")


def test_formats_without_air_refuse_it():
    with pytest.raises(UnsupportedSceneError, match="MJCF cannot express the air"):
        mjcf_text(load_experiment(SATIN, "air"))


def test_a_usd_layer_restores_the_air(tmp_path):
    scene = load_experiment(SATIN, "air").scene
    assert scene.air is not None
    windy = replace(scene, air=replace(scene.air, wind_m_per_s=(0.1, -0.2, 1.0 / 3.0)))
    to_usd(windy, tmp_path / "air.usda")
    assert from_usd(tmp_path / "air.usda") == windy


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("gauge:air:lift_coefficient", "gauge:air:lift", "argument 'lift'"),
        (
            "gauge:air:density_kg_per_m3 = 1.204",
            "gauge:air:density_kg_per_m3 = -1",
            "density_kg_per_m3 is -1",
        ),
        (
            "custom double gauge:air:normal_coefficient = 1.17",
            "",
            "argument: 'normal_coefficient'",
        ),
    ],
)
def test_wrong_air_in_a_usd_layer_is_named(tmp_path, old, new, reason):
    path = tmp_path / "air.usda"
    to_usd(load_experiment(SATIN, "air").scene, path)
    changed_text(path, (old, new))
    with pytest.raises(AssetError, match=reason):
        from_usd(path)
