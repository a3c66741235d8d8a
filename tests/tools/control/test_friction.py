"""Turntable and SlopeSlider: engines that obey the law let a policy use the friction that it allows, and no more."""

import math

import mujoco
import numpy as np
import pytest
from control_episodes import FAST, by_law, make, play

from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.scene.geometry import rotation_matrices
from gauge_envs.tools.control.friction import HOLD_S, SLIP_SPEED_M_PER_S
from gauge_envs.tools.control.task import Ending

GOOD = (Ending.HELD, Ending.REACHED)
WOOD = ("Turntable-Limit-wood", "SlopeSlider-Limit-wood")


@pytest.mark.parametrize("name", [*WOOD, "Pendulum-Limit-metal"])
def test_law_holds_at_98_percent_and_not_at_102(name):
    env = make(name)
    below = by_law(env, 0.98)[1]
    assert below.ending in GOOD
    assert below.ratio == pytest.approx(0.98, abs=0.005)
    assert by_law(env, 1.02)[1].ending not in GOOD


@pytest.mark.parametrize("name", WOOD)
def test_friction_used_is_that_of_the_contact_forces(name):
    """The engine's contact forces on the cube, tangential over normal, agree with the kinematics."""
    # The force at one instant scatters by 1 % with the slope's own step, 1/1800 s.
    env = make(name, settings={"timestep_s": 1 / 9000})
    env.reset()
    for step in range(30):
        # Strongly accelerated all the time, both ways, so that the sign of each term matters.
        observation = env.step(np.array([0.4 if step < 20 else -0.8]))[0]
        data = env.rollout.simulation.data
        total, wrench = np.zeros(3), np.zeros(6)
        for index, contact in enumerate(data.contact):
            mujoco.mj_contactForce(env.rollout.simulation.model, data, index, wrench)
            total += contact.frame.reshape(3, 3).T @ wrench[:3]
        stage = env.task._stage
        pose = env.rollout.poses()[stage.body]
        assert stage.poses[-1, 0] == pytest.approx(pose, abs=1e-6)
        normal = rotation_matrices(pose[3:])[:, 2]
        used = np.linalg.norm(total - normal * (total @ normal)) / abs(total @ normal)
        if step % 20 > 5:
            # The observation is the mean over the frame, the forces are those at its end.
            change = abs(observation[2] - env.trajectory()[-2][2])
            assert used == pytest.approx(observation[2], abs=change + 2e-3)


@pytest.mark.parametrize("name", WOOD)
def test_reward_is_the_friction_used_and_slipping_takes_it_back(name):
    env = make(name, settings=FAST)
    holding, _ = by_law(env, 0.95)
    assert holding == pytest.approx(env.trajectory()[1:, 2].sum())
    closer, _ = by_law(env, 0.99)
    assert holding < closer < env.task.limits[0] * (env.experiment.frame_count - 1)
    slipped, report = by_law(env, 1.05)
    assert report.ending is Ending.SLIPPED
    used = env.trajectory()[1:-1, 2]
    assert slipped == pytest.approx(used[: -round(HOLD_S * 30)].sum())


@pytest.mark.parametrize("name", WOOD)
def test_no_policy_earns_more_than_the_law(name):
    """Dithering about the limit: what exceeds it in one frame is lost in the next."""
    env = make(name, settings=FAST)
    random = np.random.default_rng(0)

    def dither(_):
        share = 0.97 if env.rollout.times_s[0] < 3.0 else random.uniform(0.92, 1.06)
        return env.law_action(share)

    slip = SLIP_SPEED_M_PER_S / (math.cos(0.27) * GRAVITY_M_PER_S2 * HOLD_S)
    for _ in range(3):
        assert 0.0 < play(env, dither).reached <= env.task.limits[0] + slip
