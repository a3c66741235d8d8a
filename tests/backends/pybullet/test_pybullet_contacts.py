"""Contact constants of bodies from those of pairs, by products. Needs no engine."""

import sys

import pytest

from gauge_envs import load_experiment
from gauge_envs.backends import backend
from gauge_envs.backends.pybullet import BackendPyBullet
from gauge_envs.backends.pybullet.contacts import (
    impact_bodies,
    moved_values,
    pushing_bodies,
    surfaces,
)
from gauge_envs.backends.pybullet.settings import settings_for
from gauge_envs.backends.shared import bundled
from gauge_envs.errors import MissingExtraError, UnsupportedSceneError
from gauge_envs.scene import (
    Motion,
    Pose,
    RigidBody,
    Scene,
    Sphere,
)
from gauge_envs.tools.bench.parts import contact


def test_products_of_bodies_are_the_values_of_pairs():
    pairs = {("a", "b"): 0.3, ("b", "c"): 0.1, ("c", "d"): 0.8, ("a", "d"): 2.4}
    values = moved_values(pairs, set(), "friction")
    assert {pair: values[pair[0]] * values[pair[1]] for pair in pairs} == pytest.approx(
        pairs, rel=1e-9
    )


def test_pair_of_value_zero_gets_a_millionth_beside_a_positive_pair():
    pairs = {
        ("ball", "brick-1"): 0.22,
        ("ball", "brick-2"): 0.22,
        ("brick-1", "brick-2"): 0.0,
    }
    values = moved_values(pairs, set(), "restitution")
    assert values["ball"] * values["brick-1"] == pytest.approx(0.22, rel=1e-9)
    assert values["brick-1"] * values["brick-2"] <= 1.000001e-6


def test_body_whose_pairs_are_all_zero_has_the_value_zero():
    pairs = {("cube", "brick"): 0.0, ("cube", "ground"): 0.25}
    assert moved_values(pairs, {"ground"}, "restitution") == {"brick": 0.0, "cube": 1.0}


def test_values_without_products_name_a_pair():
    pairs = {("a", "b"): 0.5, ("c", "d"): 0.5, ("a", "c"): 0.5, ("b", "d"): 0.1}
    with pytest.raises(
        UnsupportedSceneError, match=r"'a' and 'b' has the friction 0\.5"
    ):
        moved_values(pairs, set(), "friction")


def test_wall_is_representable():
    scene = load_experiment("WallBreaking-wood").scene
    values = {name: value for name, ((_, value),) in surfaces(scene).items()}
    ball, bricks, _, _ = scene.contacts
    assert values["ball"] * values["brick-7"] == pytest.approx(
        ball.restitution, rel=1e-9
    )
    assert values["brick-7"] * values["brick-8"] < 1.1e-6
    assert (
        bricks.restitution > 0.0
    )  # The pair is sustained, so that its restitution has no effect.
    assert list(backend("pybullet").unsupported(scene)) == []


def pair_contact(first, second, friction):
    return contact(first, second, friction=friction)


def test_bodies_that_contacts_do_not_move_get_a_copy_for_each_surface():
    motions = {
        "one": "dynamic",
        "two": "dynamic",
        "board": "fixed",
        "plate": "kinematic",
    }
    bodies = tuple(
        RigidBody(
            name=name,
            shape=Sphere(radius_m=0.1),
            motion=Motion(motion),
            pose=Pose(position_m=(0.0, 0.0, 0.0)),
            mass_kg=1.0,
        )
        for name, motion in motions.items()
    )
    contacts = (
        pair_contact("one", "two", 0.5),
        pair_contact("one", "board", 0.1),
        pair_contact("two", "board", 0.9),
        pair_contact("one", "plate", 0.3),
        pair_contact("two", "plate", 0.3),
    )
    found = surfaces(Scene(bodies=bodies, contacts=contacts, duration_s=1.0))
    assert [len(found[name]) for name in ("one", "two")] == [1, 1]
    assert 3 <= len(found["board"]) + len(found["plate"]) <= 4
    for touch in contacts:
        (one,), (other,) = touch.first, touch.second
        (first,) = [value for (value, _), names in found[one].items() if other in names]
        (second,) = [
            value for (value, _), names in found[other].items() if one in names
        ]
        assert first * second == pytest.approx(touch.friction, rel=1e-9)


@pytest.mark.parametrize(
    ("name", "late"),
    [
        ("BouncingBall-rubber", {"ball", "ground"}),
        ("SlopeSlider-1-wood", {"ground"}),
        ("WallBreaking-wood", {"ball"}),
    ],
)
def test_every_impact_has_a_late_body_and_sustained_pairs_have_few(name, late):
    assert impact_bodies(load_experiment(name).scene) == late


def test_fixed_and_driven_bodies_that_touch_one_body_together_need_the_cone():
    motions = {
        "cube": "dynamic",
        "ball": "dynamic",
        "board": "fixed",
        "bar": "kinematic",
        "ground": "fixed",
    }
    bodies = tuple(
        RigidBody(
            name=name,
            shape=Sphere(radius_m=0.1),
            pose=Pose(position_m=(0, 0, 0)),
            motion=Motion(motion),
            mass_kg=1.0,
        )
        for name, motion in motions.items()
    )

    def impact(first, second):
        return contact(first, second, friction=0.3, restitution=0.2)

    def found(*contacts):
        return pushing_bodies(Scene(bodies=bodies, contacts=contacts, duration_s=1.0))

    held, pushed = pair_contact("cube", "board", 0.3), pair_contact("cube", "bar", 0.3)
    assert found(held, pushed, impact("cube", "ground")) == {"board", "bar"}
    assert found(held, pushed, impact("ball", "bar")) == {"board"}
    assert found(held, pair_contact("ball", "bar", 0.3)) == set()
    assert found(held, pair_contact("cube", "ball", 0.3)) == set()


@pytest.mark.parametrize(
    "name",
    [
        "SlopeSlider-3-wood",
        "Turntable-1-wood",
        "WallBreaking-wood",
        "SlopeContact-wood",
    ],
)
def test_no_body_of_the_benchmark_needs_the_cone(name):
    assert pushing_bodies(load_experiment(name).scene) == set()


def test_step_of_foam_is_below_the_time_of_a_wave_through_a_tetrahedron():
    scene = load_experiment("FoamStretching-soft").scene
    # A pressure wave of 87 m/s takes 136 us through 16.7 mm / sqrt(2).
    assert settings_for(scene).timestep_s == 1 / 18000
    assert settings_for(scene, {"cell_m": 0.0334}).timestep_s == 1 / 9000
    assert settings_for(scene, {"timestep_s": 1 / 1800}).timestep_s == 1 / 1800


@pytest.mark.parametrize("version", [(3, 11), (3, 12)])
def test_missing_engine_names_the_extra_and_the_python_with_wheels(
    monkeypatch, version
):
    monkeypatch.setattr(
        bundled,
        "is_installed",
        lambda name: name != "pybullet",
    )
    monkeypatch.setattr(sys, "version_info", (*version, 0, "final", 0))
    with pytest.raises(
        MissingExtraError, match=r"pip install 'gauge-envs\[pybullet\]'"
    ) as found:
        BackendPyBullet()
    assert ("on Python 3.11" in str(found.value)) == (version == (3, 12))
