"""Worlds on a device: the numbers of worlds on the host, without a copy to it."""

import gc
import sys

import gymnasium
import numpy as np
import pytest
from refusing import DriftingWorlds, Refusing, values_of

from gauge_envs.backends.mujoco import BackendMuJoCo
from gauge_envs.envs import vector
from gauge_envs.errors import (
    BackendError,
    EpisodeError,
    ParameterError,
    UnsupportedSceneError,
)

DRIVEN, PASSIVE = "GAUGE/SlopeSlider-3-metal", "GAUGE/SlopeSlider-2-wood"


@pytest.fixture
def drifting(monkeypatch):
    monkeypatch.setattr(BackendMuJoCo, "worlds_mix_constants", True)
    monkeypatch.setattr(
        BackendMuJoCo,
        "build_worlds",
        lambda self, scenes, settings=None: DriftingWorlds(scenes),
    )
    monkeypatch.setattr(Refusing, "copies", 0)
    monkeypatch.setattr(vector, "START_COUNT", 16)


def actions_of(envs, steps):
    random = np.random.default_rng(1)
    shape = envs.action_space.shape
    if envs.action_space.dtype.kind == "i":
        return np.zeros((steps, *shape), dtype=np.int64)
    return random.uniform(-1.0, 1.0, (steps, *shape)).astype(np.float32)


@pytest.mark.parametrize("name", [DRIVEN, PASSIVE])
def test_worlds_on_a_device_have_the_numbers_of_the_host(name, drifting):
    """Observations, rewards, flags and scores, with scattered starts and actions."""
    host = gymnasium.make_vec(name, num_envs=3, score_arrays=True)
    there = gymnasium.make_vec(name, num_envs=3, mode="device")
    options = {"jitter": {"position_m": 0.01, "angle_rad": 0.1}}
    steps = host.unwrapped.experiment.frame_count - 1
    pairs = [
        (host.reset(seed=4, options=options), there.reset(seed=4, options=options))
    ]
    pairs += [(host.step(one), there.step(one)) for one in actions_of(host, steps)]
    for expected, found in pairs:
        assert_close(values_of(found[0]), expected[0])
        for one, other in zip(found[1:-1], expected[1:-1], strict=True):
            assert np.allclose(values_of(one), other, rtol=1e-9, atol=1e-9)
    expected, found = pairs[-1][0][-1], values_of(pairs[-1][1][-1])
    scores = {key for key in found if f"_{key}" in expected and "rmse" in key}
    assert_close(
        {key: found[key] for key in scores}, {key: expected[key] for key in scores}
    )
    # The time alignment and references without trials need the host.
    # Only the host aligns motions in time.
    assert scores == {"rmse", "rmse_normalized"}


def assert_close(here, there):
    assert here.keys() == there.keys()
    for key, values in there.items():
        assert np.allclose(here[key], values, rtol=1e-9, atol=1e-9), key


def calls_of_a_step(envs, action):
    """Number of Python functions that a step calls."""
    count = 0

    def note(_, event, __):
        nonlocal count
        count += event == "call"

    # The collector calls finalizers at any time.
    gc.disable()
    sys.setprofile(note)
    try:
        envs.step(action)
    finally:
        sys.setprofile(None)
        gc.enable()
    return count


@pytest.mark.parametrize("worlds", [9, pytest.param(4096, marks=pytest.mark.slow)])
def test_no_step_copies_to_the_host(worlds, drifting):
    """Nor does a reset in a step; the number of Python calls does not depend on the number of worlds."""
    envs = gymnasium.make_vec(DRIVEN, num_envs=worlds, mode="device")
    few = gymnasium.make_vec(DRIVEN, num_envs=2, mode="device")
    # What is computed once for all episodes is not counted.
    few.reset(seed=0)
    for action in actions_of(few, 100):
        few.step(Refusing(action))
    few.reset(seed=0, options={"jitter": True})
    first, _ = envs.reset(seed=0, options={"jitter": True})
    starts = [first["observable"]]
    for action in actions_of(envs, 100):
        calls = calls_of_a_step(envs, Refusing(action))
        assert calls == calls_of_a_step(few, Refusing(action[:2]))
        if envs.unwrapped._lockstep._frame == 0:
            starts.append(envs.unwrapped._lockstep.observation()["observable"])
    assert Refusing.copies == 0
    # Each world starts elsewhere, and in its next episode too.
    first, second = map(values_of, starts)
    assert len(np.unique(first, axis=0)) == len(np.unique(second, axis=0)) == worlds
    assert (first != second).any(axis=1).mean() > 0.5


def test_a_world_that_diverges_keeps_its_observation(drifting):
    envs = gymnasium.make_vec(PASSIVE, num_envs=2, mode="device")
    envs.reset(seed=0)
    worlds = envs.unwrapped._lockstep.device
    states = values_of(worlds.body_states(["cube"])).copy()
    zeros = np.zeros(2, dtype=np.int64)
    states[1, 0, 7:10] = 900.0
    worlds.begin(Refusing(states))
    first = envs.step(zeros)
    last = [envs.step(zeros) for _ in range(17)][-1]
    kept = values_of(last[0])
    shown = values_of(first[0])
    np.testing.assert_array_equal(kept["bodies"][1], shown["bodies"][1])
    assert values_of(first[2]).tolist() == values_of(last[2]).tolist() == [False, True]
    assert values_of(last[3]).tolist() == [True, False]
    assert values_of(last[1])[1] == 0.0
    assert kept["time"][:, 0].tolist() == pytest.approx([18 / 30, 0.0])
    assert np.isnan(values_of(last[4]["rmse"])).tolist() == [False, True]


def test_what_a_device_cannot_do_is_refused(drifting, monkeypatch):
    envs = gymnasium.make_vec(PASSIVE, num_envs=2, mode="device")
    envs.reset(seed=0)
    inner = envs.unwrapped
    for call in (inner.scores, inner.score_arrays):
        with pytest.raises(EpisodeError, match="stays on the device"):
            call()
    for name, arguments, error in (
        ("GAUGE/StickStack-soft", {}, UnsupportedSceneError),
        (PASSIVE, {"render_mode": "rgb_array"}, ParameterError),
        (PASSIVE, {"mode": "gpu"}, ParameterError),
    ):
        with pytest.raises(error):
            gymnasium.make_vec(name, num_envs=2, **{"mode": "device"} | arguments)
    monkeypatch.undo()
    with pytest.raises(BackendError, match="no arrays on a device"):
        gymnasium.make_vec(PASSIVE, num_envs=2, mode="device")


@pytest.mark.slow
@pytest.mark.parametrize("name", [PASSIVE, "GAUGE/Turntable-1-wood"])
def test_newton_in_tensors_is_newton_on_the_host(name, monkeypatch):
    """In single precision; and Warp and PyTorch copy nothing in the steps."""
    pytest.importorskip("newton")
    torch = pytest.importorskip("torch")
    wp = pytest.importorskip("warp")
    monkeypatch.setattr(vector, "START_COUNT", 3)
    kinds = {"score_arrays": True}, {"mode": "device"}
    host, there = (
        gymnasium.make_vec(name, num_envs=3, backend="newton", **kind) for kind in kinds
    )
    for envs in (host, there):
        first = envs.reset(seed=4, options={"jitter": True})
    actions = actions_of(host, host.unwrapped.experiment.frame_count)
    expected = [host.step(one) for one in actions[:-1]]
    copies = []
    for owner, call in ((wp.array, "numpy"), (torch.Tensor, "cpu")):
        monkeypatch.setattr(owner, call, lambda *_: copies.append(1))
    found = [there.step(torch.from_numpy(one)) for one in actions]
    assert not copies
    monkeypatch.undo()
    for one, other in zip(found, expected, strict=False):
        # mm of the trajectory and of its score; the driven motion has single precision.
        assert np.abs(one[0]["observable"].numpy() - other[0]["observable"]).max() < 0.1
        assert np.abs(one[1].numpy() - other[1]).max() < 0.05
    assert np.allclose(found[-2][4]["rmse"], expected[-1][4]["rmse"], rtol=0.01)
    assert found[-1][4]["frame"] == 0
    assert np.isfinite(first[0]["observable"].numpy()).all()
