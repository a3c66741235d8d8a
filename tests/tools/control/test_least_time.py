"""Carry and push: no motion beats friction's least time, the law's policy comes near it, and a wrong friction shows."""

import math

import gymnasium
import numpy as np
import pytest
from scipy.optimize import linprog

from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.control.carry import CarryLimit
from gauge_envs.tools.control.least_time import REST_M_PER_S, TOLERANCE_M, TOLERANCE_RAD
from gauge_envs.tools.control.limit import Ending, pair_friction
from gauge_envs.tools.control.play import play, play_paid
from gauge_envs.tools.control.push import PushLimit
from gauge_envs.tools.control.stage import FRAME_S, acceleration_to_rest

FAST = {"timestep_s": 1 / 1080}
"""The longest step that the default contacts allow, where the accuracy of the engine is not what is tested."""
SLIDING = {"timestep_s": 1 / 3600}
"""With longer steps a cube that slides fast turns and is braked by less than mu g: 2.58 of 2.68 m/s^2 at 1/1080 s."""
SETTINGS = {CarryLimit: FAST, PushLimit: SLIDING}


def by_law(env, fraction=1.0, *, seed=0):
    """Return the sum of the rewards of the law's policy, and its report."""
    return play_paid(env, lambda _: env.law_action(fraction), seed=seed)


# --- the law ---


def least_time_s(task, distance_m, most, speed=0.0):
    """The least time from rest over a distance, with friction's mu g and the speed left at the end."""
    if task is PushLimit:  # Friction brakes all the way.
        return (math.sqrt(speed**2 + 2.0 * most * distance_m) - speed) / most
    return (2.0 * math.sqrt(most * distance_m + 0.5 * speed**2) - speed) / most


@pytest.mark.parametrize("task", [CarryLimit, PushLimit])
@pytest.mark.parametrize("speed", [0.0, 0.02, 0.3])
def test_least_time_and_least_friction_are_inverse(task, speed):
    time_s = least_time_s(task, 0.5, 3.2, speed)
    assert task.least_deceleration_m_per_s2(0.5, time_s, speed) == pytest.approx(3.2)
    assert task.least_deceleration_m_per_s2(0.5, 1.1 * time_s, speed) < 3.2


@pytest.mark.parametrize("speed", [0.0, 0.3])
def test_linear_programs_find_no_shorter_carry(speed):
    """The longest way in the law's time, over all accelerations of 400 pieces with |a| <= mu g, is the law's way."""
    most, count = 3.2, 400
    time_s = least_time_s(CarryLimit, 0.5, most, speed)
    piece = time_s / count
    left = time_s - (np.arange(count) + 0.5) * piece
    found = linprog(
        -left * piece,
        A_eq=np.full((1, count), piece),
        b_eq=[speed],
        bounds=(-most, most),
    )
    assert -found.fun == pytest.approx(0.5, rel=1e-4)


def test_a_frame_on_the_way_to_rest_leaves_the_braking_distance():
    place, speed, times = 0.0, 0.0, 0
    while abs(place - 0.5) > 1e-3:
        acceleration = acceleration_to_rest(0.5 - place, speed, 3.0)
        assert abs(acceleration) <= 3.0
        place += speed * FRAME_S + 0.5 * acceleration * FRAME_S**2
        speed += acceleration * FRAME_S
        times += 1
        assert place + speed**2 / 6.0 <= 0.5 + 1e-9
    assert times <= 1 + math.ceil(least_time_s(CarryLimit, 0.5, 3.0) / FRAME_S)
    assert acceleration_to_rest(-0.2, 0.1, 3.0) == -acceleration_to_rest(0.2, -0.1, 3.0)


@pytest.mark.parametrize(
    ("distance", "speed"), [(0.5, 0.0), (0.2, 1.0), (0.1, 1.0), (0.3, -0.5)]
)
def test_time_to_go_is_that_of_the_fastest_motion(distance, speed):
    """By integration of the motion with the switching curve v |v| = 2 a x, which is time-optimal."""
    most, step = 3.2, 1e-5
    place, rate, time_s = distance, speed, 0.0
    while time_s < 5.0 and (place**2 + rate**2) > 1e-6:
        acceleration = most if 2.0 * most * place > rate * abs(rate) else -most
        rate, place, time_s = (
            rate + acceleration * step,
            place - (rate + 0.5 * acceleration * step) * step,
            time_s + step,
        )
    assert CarryLimit.time_to_go_s(distance, speed, most) == pytest.approx(
        time_s, abs=2e-3
    )


# --- carry ---


@pytest.mark.parametrize("material", ["wood", "plastic", "metal"])
def test_carry_at_the_law(material):
    env = CarryLimit(material, settings=FAST)
    for seed in range(2):
        paid, report = by_law(env, seed=seed)
        assert report.ending is Ending.REACHED
        # Arrival is seen each 1/180 s and the change of the acceleration takes a frame.
        assert 0.95 < report.ratio <= 1.0
        assert 0.96 < paid <= 1.0
    for more in (1.05, 1.2):
        paid, report = by_law(env, more)  # it slips, and arrives later
        assert report.ratio <= 1.0
        assert paid <= 1.0
    assert report.ratio < 0.8
    assert env.limit.value == pair_friction(env.experiment.scene, "cube", "plate")


def test_the_goal_is_drawn_by_the_seed():
    env = CarryLimit("wood", settings=FAST)
    goals = []
    for seed in (0, 1, 0):
        observation, _ = env.reset(seed=seed)
        goals.append(observation[:2])
        assert np.linalg.norm(observation[:2]) == pytest.approx(0.5)
    assert np.array_equal(goals[0], goals[2])
    assert not np.allclose(goals[0], goals[1])


def test_carry_with_more_friction_than_the_law_knows_is_seen():
    """A planted fault: the simulated friction is 1.2 times that of the limit."""
    env = CarryLimit(
        "wood", settings=FAST, parameters={"cube.friction": 1.2 * 0.378789}
    )
    env.limit = CarryLimit("wood").limit
    paid, report = by_law(env, 1.17)
    assert report.ratio > 1.08
    assert paid > 1.02


def test_a_plate_that_leaves_loses_the_cube():
    env = CarryLimit("wood", settings=FAST)
    report = play(env, lambda _: np.array([1.0, 1.0]))
    assert report.ending is Ending.LOST
    assert report.reached == 0.0


# --- push ---


@pytest.mark.parametrize("material", ["wood", "plastic", "metal"])
def test_push_at_the_law(material):
    env = PushLimit(material, settings=SLIDING)
    for seed in range(2):
        paid, report = by_law(env, seed=seed)
        assert report.ending is Ending.REACHED
        # A pusher of 20 m/s^2 in contact needs sqrt(1 + mu g / A) times the least time.
        most = 1.0 / (
            1.0 + env.limit.value * GRAVITY_M_PER_S2 / env.ACCELERATION_M_PER_S2
        )
        assert most - 0.06 < report.ratio < most + 0.02
        assert 0.7 < paid <= 1.0


def test_a_cube_coasts_as_far_as_friction_lets_it():
    """After one push, the way to rest is v^2 / (2 mu g)."""
    env = PushLimit("wood", settings=SLIDING)
    env.reset(seed=0)
    env.goal_m = np.array([10.0, 0.0])  # not to be reached
    for action in (1.0, 0.3, -1.0, -0.3, *[0.0] * 25):
        env.step(np.array([action, 0.0]))
    observed = env.trajectory()
    # The pusher is off the cube from step 4 on. A speed is the mean over the last 1/180 s.
    braking = env.limit.value * GRAVITY_M_PER_S2
    speed = observed[4, 2] - braking / 360.0
    assert speed > 0.5
    assert observed[-1, 2] == pytest.approx(0.0, abs=1e-3)
    assert observed[4, 0] - observed[-1, 0] == pytest.approx(
        speed**2 / (2.0 * braking), rel=0.02
    )


def test_a_pusher_that_passes_the_cube_ends_the_episode():
    env = PushLimit("wood", settings=FAST)
    aside = iter([*[np.array([0.0, 1.0])] * 5, *[np.array([1.0, -1.0])] * 60])
    report = play(env, lambda _: next(aside))
    assert report.ending is Ending.LOST


# --- both ---


@pytest.mark.parametrize("task", [CarryLimit, PushLimit])
@pytest.mark.parametrize("share", [0.6, 0.8, 1.0])
def test_the_time_to_go_cancels_over_an_arrival(task, share):
    """Its decreases pay 1/3 whatever the way, and the rest is two thirds of the ratio."""
    paid, report = by_law(task("wood", settings=SETTINGS[task]), share, seed=3)
    assert report.ending is Ending.REACHED
    assert paid == pytest.approx((1.0 + 2.0 * report.ratio) / 3.0, abs=1e-12)


@pytest.mark.parametrize("task", [CarryLimit, PushLimit])
def test_without_an_arrival_the_place_at_the_end_is_paid(task):
    env = task("wood", settings=FAST)
    for action, ending in (
        ((0.0, 0.0), Ending.MISSED),
        ((0.1, 0.0), None),
        ((1.0, 1.0), Ending.LOST),
    ):
        paid, report = play_paid(env, lambda _, action=action: np.array(action))
        assert ending in (None, report.ending)
        way, velocity = np.split(env.trajectory()[-1, :4], 2)
        left_m = float(np.linalg.norm(way))
        ahead = float(velocity @ way) / left_m
        across = math.sqrt(max(float(velocity @ velocity) - ahead**2, 0.0))
        most = env.limit.value * GRAVITY_M_PER_S2
        to_go_s = task.time_to_go_s(left_m, ahead, most) + across / most
        assert paid == pytest.approx(
            (1.0 - to_go_s / task.time_to_go_s(env.DISTANCE_M, 0.0, most)) / 3.0,
            abs=1e-9,
        )
        assert paid < 1.0 / 3.0


@pytest.mark.parametrize("task", [CarryLimit, PushLimit])
def test_no_motion_beats_the_law(task):
    """Policies about the law's, with noise on the first actions: none needs more friction than there is."""
    env = task("wood", settings=SETTINGS[task])
    random = np.random.default_rng(0)
    arrived = 0
    for seed in range(8):
        share, noise = random.uniform(0.9, 1.1), random.uniform(0.0, 0.1)

        def policy(_, share=share, noise=noise):
            noisy = random.normal(0.0, noise if env.time_s < 0.2 else 0.0, 2)
            return np.clip(env.law_action(share) + noisy, -1.0, 1.0)

        paid, report = play_paid(env, policy, seed=seed)
        arrived += report.ending is Ending.REACHED
        assert report.ratio <= 1.0
        assert paid <= 1.0
    assert arrived >= 3


def test_arrival_is_near_at_rest_and_not_turned():
    env = gymnasium.make("GAUGE/Carry-Limit-metal", settings=FAST).unwrapped
    assert isinstance(env, CarryLimit)
    by_law(env, 0.9)
    observation = env.trajectory()[-1]
    assert math.hypot(*observation[:2]) <= TOLERANCE_M
    assert math.hypot(*observation[2:4]) <= REST_M_PER_S
    assert abs(observation[4]) < TOLERANCE_RAD
