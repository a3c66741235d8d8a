"""MuJoCo scenes against closed forms: what a rigid body must do, whatever the score says."""

import numpy as np
import pytest


def test_tilting_board_lets_go_at_the_friction_angle(rollout):
    env, trajectory, _ = rollout("SlopeSlider-3-metal")
    driver, start = (
        env.experiment.scene.drivers[0],
        env.experiment.scene.body("board").pose,
    )
    poses = [driver.pose(start, t) for t in trajectory.times_s]
    along_board = np.array(
        [p.to_body(1e-3 * g)[0] for p, g in zip(poses, trajectory.samples, strict=True)]
    )
    first = int(np.flatnonzero(along_board - along_board[0] > 2e-4)[0])
    tilt_deg = np.degrees(driver.motions[0].value(trajectory.times_s[first]))
    friction = env.experiment.scene.contacts[0].friction
    # 0.2 mm of slip at the growing acceleration takes about 0.05 s, which is 0.7 degrees of tilt.
    assert (
        np.degrees(np.arctan(friction))
        < tilt_deg
        < np.degrees(np.arctan(friction)) + 1.2
    )


@pytest.mark.slow
def test_cradle_with_calibrated_restitution_repeats_the_papers_finding(rollout):
    *_, info = rollout("NewtonsCradle-metal")
    assert 0.2 <= info["score"].mte_normalized <= 0.3
    assert info["score"].lsd_normalized < 0.2


@pytest.mark.slow
def test_cradle_with_effective_restitution_is_the_real_one(rollout):
    _, trajectory, info = rollout("NewtonsCradle-metal", parameters="effective")
    assert info["score"].mte == pytest.approx(0.93, abs=0.01)
    assert info["score"].lsd_s > 0.2
    height = trajectory.frames[:90, 2] - trajectory.frames[0, 2]
    in_row = height < 1.0
    rests = np.flatnonzero(np.diff(in_row.astype(int)) == 1)
    assert len(rests) >= 3


@pytest.mark.slow
def test_wall_stands_until_it_is_hit(rollout):
    env, trajectory, info = rollout("WallBreaking-wood")
    bricks = trajectory.frames.reshape(len(trajectory.frames), -1, 3)
    moved = np.linalg.norm(bricks - bricks[0], axis=2)
    assert bricks.shape[1] == 118
    assert "diverged" not in info
    # The ball falls freely on its string for at least 0.2 s.
    assert moved[:7].max() < 1.0
    assert moved[-1].max() > 50.0
    assert env.rollout.simulation.settings["preset"] == "stack"
