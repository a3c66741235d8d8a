"""Throw: the law's height is that of an ideal ball on the best plate, and engines let the law's policy have it."""

import math

import numpy as np
import pytest

from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.control.limit import Ending
from gauge_envs.tools.control.play import play, play_paid
from gauge_envs.tools.control.throw import (
    SPEED_M_PER_S,
    STROKE_M,
    ThrowLimit,
    highest_m,
)


def test_height_after_one_impact_on_a_plate_without_stroke_or_speed():
    """A plate at rest in its middle gives e^2 h; the law's best place and speed give more."""
    assert highest_m(0.5, 0.6, GRAVITY_M_PER_S2, impacts=0) == 0.5
    assert highest_m(0.5, 0.6, GRAVITY_M_PER_S2, impacts=1) > 0.36 * 0.5


@pytest.mark.parametrize("restitution", [0.3, 0.576733, 0.9])
def test_height_is_the_best_of_all_places(restitution):
    """Against all combinations of 101 places at each of two impacts."""
    places = np.linspace(-STROKE_M, STROKE_M, 101)
    heights = np.array([0.26])
    for _ in range(2):
        comes = np.sqrt(
            2.0 * GRAVITY_M_PER_S2 * np.clip(heights[:, None] - places, 0.0, None)
        )
        leaves = restitution * comes + (1.0 + restitution) * SPEED_M_PER_S
        heights = (places + leaves**2 / (2.0 * GRAVITY_M_PER_S2)).ravel()
    assert highest_m(0.26, restitution, GRAVITY_M_PER_S2, impacts=2) == pytest.approx(
        heights.max(), rel=1e-4
    )


def test_uncertainty_is_that_of_restitution_and_start():
    limit = ThrowLimit("rubber").limit
    known = 0.576733
    drop = 0.451023 - 0.013297 - 0.15 - 0.03
    by_restitution = highest_m(drop, known + 0.1602, GRAVITY_M_PER_S2) - limit.value
    by_start = highest_m(drop + 0.001, known, GRAVITY_M_PER_S2) - limit.value
    assert limit.sigma == pytest.approx(math.hypot(by_restitution, by_start), rel=1e-3)
    assert limit.value == pytest.approx(highest_m(drop, known, GRAVITY_M_PER_S2))


def test_the_laws_policy_throws_nearly_as_high():
    env = ThrowLimit("rubber")
    paid, report = play_paid(env, lambda _: env.law_action(1.0))
    assert report.ending is Ending.REACHED
    # It meets the ball 2 cm below the top of the stroke, and starts its stroke at a frame.
    assert 0.95 < report.ratio < 1.0
    assert paid == pytest.approx(
        (report.reached - 0.257726) / (report.limit.value - 0.257726), abs=1e-4
    )


def test_a_higher_restitution_than_the_law_knows_is_seen():
    """A planted fault: the simulated restitution is 0.7 instead of 0.577."""
    env = ThrowLimit("rubber", parameters={"ball.restitution": 0.7})
    env.limit = ThrowLimit("rubber").limit
    assert play(env, lambda _: env.law_action(1.0)).ratio > 1.1


def test_no_motion_beats_the_law():
    env = ThrowLimit("rubber", settings={"timestep_s": 1 / 1800})
    random = np.random.default_rng(1)
    reached = 0
    for _ in range(6):
        noise = random.uniform(0.0, 0.15)
        report = play(
            env,
            lambda _, noise=noise: np.clip(
                env.law_action(1.0) + random.normal(0.0, noise, 2), -1.0, 1.0
            ),
        )
        reached += report.ending is Ending.REACHED
        assert report.ratio < 1.0
    assert reached >= 3


def test_a_plate_that_stays_beside_the_ball_loses_it():
    env = ThrowLimit("rubber")
    report = play(env, lambda _: np.zeros(2))
    assert report.ending is Ending.LOST
    assert report.reached == 0.0


def edge_gain(offset, comes, restitution):
    """Return the height over that of a flat impact after an impact on the plate's edge, an ideal one.

    Args:
        offset: Place of the ball beside the edge, over its radius: the sine of the normal's angle from the vertical.
        comes: Speed at which the ball falls [m/s].
        restitution: Coefficient of restitution.
    """
    normal = np.array([offset, math.sqrt(1.0 - offset**2)])
    plate = np.array([SPEED_M_PER_S, SPEED_M_PER_S])
    closing = (plate - np.array([0.0, -comes])) @ normal
    leaves = -comes + (1.0 + restitution) * closing * normal[1]
    return float(
        (leaves / (restitution * comes + (1.0 + restitution) * SPEED_M_PER_S)) ** 2
    )


def test_an_ideal_edge_throws_higher_than_the_law():
    """Why an impact at an edge ends the episode: the plate's speed along x throws too."""
    assert edge_gain(0.0, 2.0, 0.576733) == pytest.approx(1.0)
    assert (
        max(edge_gain(offset, 2.0, 0.576733) for offset in np.linspace(0.0, 0.4, 41))
        > 1.09
    )


@pytest.mark.parametrize("aside_m", [0.0, 0.08, 0.096, 0.103])
def test_an_impact_at_an_edge_loses_the_ball(aside_m):
    """The law's policy, with the ball beside the middle of the plate by a distance."""
    env = ThrowLimit("rubber", settings={"timestep_s": 1 / 1800})

    def aside(_):
        env._from_plate_m -= aside_m
        action = env.law_action(1.0)
        env._from_plate_m += aside_m
        return action

    report = play(env, aside)
    assert (report.ending is Ending.LOST) is (aside_m > 0.09)
