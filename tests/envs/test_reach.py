"""Bounds of observations: what holds a body bounds its place, and no episode that was measured leaves them."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gauge_envs import load_experiment
from gauge_envs.envs.reach import GIVE, START_M, Reach
from gauge_envs.envs.spaces import observation_space_of
from gauge_envs.experiments.variants import variants
from gauge_envs.tools.catalog.spaces import observation_rows

SEEN = Path(__file__).with_name("largest_values.csv")
"""Largest values in episodes with zero actions; those with deformable bodies end after 1 s."""


def test_a_pendulum_stays_within_its_length_of_the_anchor():
    scene = load_experiment("Pendulum-metal").scene
    (hinge,), ball = scene.joints, scene.dynamic_bodies[0]
    radius_m = GIVE * np.linalg.norm(np.subtract(ball.pose.position_m, hinge.anchor_m))
    low_m, high_m = Reach(scene).box_m(ball.name)
    assert high_m - low_m == pytest.approx(2.0 * (radius_m + START_M))
    assert low_m + high_m == pytest.approx(2.0 * np.array(hinge.anchor_m))


def test_what_nothing_holds_is_bounded_by_speed_and_duration():
    scene = load_experiment("Pendulum-metal").scene
    free = replace(scene, joints=())
    _, high_m = Reach(free).box_m(scene.dynamic_bodies[0].name)
    assert high_m == pytest.approx(np.full(3, free.distance_limit_m))


def test_a_cloth_goes_with_its_holder_and_actions_widen_the_bound():
    scene = load_experiment("TextileFlinging-satin").scene
    (driver,), (cloth,) = scene.drivers, scene.deformables
    (motion,) = driver.motions
    still = replace(
        scene,
        drivers=(replace(driver, motions=(replace(motion, residual_rate=0.0),)),),
    )
    wide, narrow = (Reach(one).box_m(cloth.name)[1] for one in (scene, still))
    assert wide - narrow == pytest.approx(motion.residual_rate * scene.duration_s)
    assert (wide < 0.1 * scene.distance_limit_m).all()
    loose = replace(scene, attachments=())
    assert Reach(loose).box_m(cloth.name)[1] == pytest.approx(scene.distance_limit_m)


@pytest.mark.parametrize("variant", variants(), ids=lambda one: one.name)
def test_no_measured_episode_leaves_its_bounds(variant):
    experiment = load_experiment(variant)
    bounds = {row["name"]: row for row in observation_rows(experiment)}
    with SEEN.open(encoding="utf-8") as text:
        measured = [
            row for row in csv.DictReader(text) if row["variant"] == variant.name
        ]
    for row in measured:
        bound = bounds[row["entry"]]
        assert row["unit"] == bound["unit"]
        assert float(row["largest"]) <= 1.001 * max(abs(bound["low"]), bound["high"])


def test_all_bounds_are_finite_and_none_is_empty():
    for variant in variants():
        space = observation_space_of(load_experiment(variant))
        for box in space.values():
            assert np.isfinite([box.low, box.high]).all()
            assert (box.low < box.high).all()
