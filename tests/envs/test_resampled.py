"""Steps that do not divide 1/180 s: environments read between them by the stated rule."""

import gymnasium
import numpy as np
import pytest

from gauge_envs import load_experiment
from gauge_envs.backends import backend
from gauge_envs.backends.shared.resampled import in_intervals
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S as INTERVAL_S

AS_DELIVERED = {"preset": "out_of_box"}
G = 9.80665


@pytest.mark.parametrize("step_s", [0.002, 0.004, 0.02])
def test_between_steps_a_fall_is_off_by_the_stated_error(step_s):
    """Steps of Euler's method lie on a parabola; between them the error is at most g h^2 / 8."""
    scene = load_experiment("BouncingBall-rubber").scene
    settings = AS_DELIVERED | {"timestep_s": step_s, "drive_interval_s": step_s}
    fall = in_intervals(backend("mujoco").build(scene, settings), scene)
    assert fall.settings["timestep_s"] == step_s
    assert fall.settings["drive_interval_s"] == INTERVAL_S
    start_m = fall.body_states(["ball"])[0, 0, 2]
    errors_m = []
    for sample in range(1, 37):
        fall.advance(INTERVAL_S)
        time_s = sample * INTERVAL_S
        expected_m = start_m - 0.5 * G * time_s * (time_s + step_s)
        errors_m.append(fall.body_states(["ball"])[0, 0, 2] - expected_m)
    limit_m = G * step_s**2 / 8.0
    assert 0.8 * limit_m < max(np.abs(errors_m)) < limit_m + 1e-9
    # 18 intervals are 0.1 s, a whole number of steps.
    assert abs(errors_m[17]) < 1e-9


def test_a_driven_plate_is_where_its_driver_says():
    settings = AS_DELIVERED | {"timestep_s": 0.004, "drive_interval_s": 0.004}
    envs = [
        gymnasium.make("GAUGE/Turntable-1-wood", settings=one, disable_env_checker=True)
        for one in (settings, {"timestep_s": 1 / 900})
    ]
    for env in envs:
        env.reset(seed=0)
    for _ in range(30):
        found, expected = (env.step([0.5])[0]["driver"] for env in envs)
        # The action of a frame acts at most a step late.
        assert np.allclose(found[:, :7], expected[:, :7], atol=5e-3)


@pytest.mark.parametrize("name", ["SlopeSlider-2-wood", "TextileStretching-satin"])
def test_an_engine_as_delivered_runs_in_worlds_beside_one_another(name):
    settings = AS_DELIVERED | {"integrator": "discrete"}
    envs = gymnasium.make_vec(f"GAUGE/{name}", num_envs=2, settings=settings)
    envs.reset(seed=0)
    action = np.zeros(envs.action_space.shape, dtype=envs.action_space.dtype)
    first, second = envs.step(action)[0]["observable"]
    assert np.isfinite(first).all()
    assert first == pytest.approx(second, abs=1e-9)
