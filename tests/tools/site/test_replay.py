"""Replays of results: poses of the same run, or a reason."""

from dataclasses import replace

import numpy as np
import pytest

from gauge_envs.errors import GaugeError
from gauge_envs.runs.batch import run_many
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result_file import load_result
from gauge_envs.scene.jitter import Jitter
from gauge_envs.tools.site.replay import replay


@pytest.fixture(scope="module")
def slide():
    return run_episode(RunRequest("SlopeSlider-2-wood"))


def test_poses_are_those_of_the_trajectory(slide):
    made = replay(slide)
    _, values = slide.trajectory.arrays()
    # 180 samples a second in the result, 60 views a second in the replay, single precision.
    assert made.rate_hz == 60.0
    assert made.bodies == ("cube",)
    np.testing.assert_allclose(1e3 * made.poses[:, 0, :3], values[::3], atol=1e-4)


@pytest.mark.parametrize(
    "name", ["Pendulum-metal", "SlopeSlider-3-metal", "BouncingBall-rubber"]
)
def test_tethered_driven_and_colliding_bodies_have_poses(name):
    request = RunRequest(
        name, settings={"timestep_s": 1 / 360} if name.startswith("Pendulum") else None
    )
    made = replay(run_episode(request))
    assert made.poses.shape[1] == len(made.bodies)


def test_a_jittered_repeat_starts_where_it_started(tmp_path):
    list(
        run_many(
            [
                RunRequest(
                    "SlopeSlider-2-wood", repeats=2, jitter=Jitter(position_m=0.002)
                )
            ],
            out=tmp_path,
        )
    )
    results = [load_result(file) for file in sorted(tmp_path.glob("*.json"))]
    starts = [replay(result).poses[0, 0, :3] for result in results]
    assert np.linalg.norm(starts[0] - starts[1]) > 1e-4


MODEL = {
    "file": "slide.xml",
    "kind": "model",
    "sha256": "0" * 64,
    "edited": True,
    "changes": [],
}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"versions": {"mujoco": "0.1"}}, r"made with mujoco 0\.1, not "),
        ({"backend": None}, "trajectory file"),
        ({"backend": "nowhere"}, "nowhere"),
        ({"asset": MODEL}, r"slide\.xml"),
    ],
)
def test_what_cannot_run_again_has_no_replay(changes, message, slide):
    with pytest.raises(GaugeError, match=message):
        replay(replace(slide, **changes))
