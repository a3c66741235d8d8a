"""Carry and push: no motion beats friction's least time, the law's policy comes near it, and a wrong friction shows."""

import math

import numpy as np
import pytest
from control_episodes import FAST, by_law, make, with_limit_of

from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.control.env import play_paid
from gauge_envs.tools.control.least_time import (
    REST_M_PER_S,
    TOLERANCE_M,
    TOLERANCE_RAD,
    CarryLimit,
    PushLimit,
)
from gauge_envs.tools.control.task import Ending

SLIDING = {"timestep_s": 1 / 3600}
"""With longer steps a cube that slides fast turns and is braked by less than mu g: 2.58 of 2.68 m/s^2 at 1/1080 s."""

both = pytest.mark.parametrize("task", [CarryLimit, PushLimit])


def made(task, material="wood", **options):
    settings = FAST if task is CarryLimit else SLIDING
    return make(f"{task.FAMILY}-Limit-{material}", settings=settings, **options)


# --- the law ---


@pytest.mark.parametrize(
    ("distance", "speed"), [(0.5, 0.0), (0.2, 1.0), (0.1, 1.0), (0.3, -0.5)]
)
def test_time_to_go_is_that_of_the_fastest_motion(distance, speed):
    """By integration of the motion with the switching curve v |v| = 2 a x, which is time-optimal."""
    limit, step = 3.2, 1e-4
    place, rate, time_s = distance, speed, 0.0
    while time_s < 5.0 and (place**2 + rate**2) > 1e-5:
        acceleration = limit if 2.0 * limit * place > rate * abs(rate) else -limit
        place -= (rate + 0.5 * acceleration * step) * step
        rate += acceleration * step
        time_s += step
    expected = pytest.approx(time_s, abs=4e-3)
    assert CarryLimit.time_to_go_s(distance, speed, limit) == expected


# --- episodes ---


@pytest.mark.parametrize("material", ["wood", "metal"])
def test_carry_at_the_law(material):
    env = made(CarryLimit, material)
    paid, report = by_law(env)
    assert report.ending is Ending.REACHED
    # Arrival is seen each 1/180 s and the change of the acceleration takes a frame.
    assert 0.95 < report.ratio <= 1.0
    assert 0.96 < paid <= 1.0
    # With more than the friction the cube slips, and arrives later.
    assert by_law(env, 1.2)[1].ratio < 0.8
    by_law(env, 0.9)
    last = env.trajectory()[-1]
    assert math.hypot(*last[:2]) <= TOLERANCE_M
    assert math.hypot(*last[2:4]) <= REST_M_PER_S
    assert abs(last[4]) < TOLERANCE_RAD


@pytest.mark.parametrize("material", ["wood", "metal"])
def test_push_at_the_law(material):
    env = made(PushLimit, material)
    paid, report = by_law(env)
    assert report.ending is Ending.REACHED
    # A pusher of 20 m/s^2 in contact needs sqrt(1 + mu g / A) times the least time.
    share = env.task.limits[0] * GRAVITY_M_PER_S2 / env.task.ACCELERATION
    assert report.ratio == pytest.approx(1.0 / (1.0 + share), abs=0.06)
    assert 0.7 < paid <= 1.0


def test_yaw_is_relative_to_the_start():
    env = made(CarryLimit)
    observation, _ = env.reset(seed=0, options={"jitter": True})
    assert abs(env.rollout.poses()["cube"][6]) > 1e-4
    assert observation[env.OBSERVED.index("cube_yaw_rad")] == pytest.approx(
        0.0, abs=1e-12
    )


@both
@pytest.mark.parametrize(
    ("action", "ending"), [((0.0, 0.0), Ending.MISSED), ((1.0, 1.0), Ending.LOST)]
)
def test_an_episode_without_an_arrival_earns_less_than_a_third(task, action, ending):
    env = make(f"{task.FAMILY}-Limit-wood", settings=FAST)
    paid, report = play_paid(env, lambda _: np.array(action))
    assert report.ending is ending
    assert report.reached == 0.0
    assert paid < 1.0 / 3.0
    # A cube that stays has as far to go as at the start.
    assert paid == pytest.approx(0.0, abs=1e-4) or ending is Ending.LOST


@both
def test_no_motion_beats_the_law(task):
    """Policies about the law's, with noise on the first actions: none needs more friction than there is."""
    env = made(task)
    random = np.random.default_rng(0)
    arrived = 0
    for seed in range(6):
        share, noise = random.uniform(0.9, 1.1), random.uniform(0.0, 0.1)

        def policy(_, share=share, noise=noise):
            noisy = random.normal(
                0.0, noise if env.rollout.times_s[0] < 0.2 else 0.0, 2
            )
            return np.clip(env.law_action(share) + noisy, -1.0, 1.0)

        paid, report = play_paid(env, policy, seed=seed)
        assert np.linalg.norm(env.task.goals_m) == pytest.approx(env.task.DISTANCE_M)
        arrived += report.ending is Ending.REACHED
        assert report.ratio <= 1.0
        assert paid <= 1.0
    assert arrived >= 2


def test_carry_with_more_friction_than_the_law_knows_is_seen():
    """A planted fault: the simulated friction is 1.2 times the friction of the limit."""
    slippery = made(CarryLimit, parameters={"cube.friction": 1.2 * 0.378789})
    paid, report = by_law(with_limit_of(slippery, made(CarryLimit)), 1.17)
    assert report.ratio > 1.08
    assert paid > 1.02
