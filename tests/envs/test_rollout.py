"""Episodes that are recorded, judged and scored on a device are those of stepping, on Warp's CPU device."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from test_at_once import zeros
from together import Together

from gauge_envs.backends.base import Recording
from gauge_envs.backends.mujoco import BackendMuJoCo
from gauge_envs.backends.newton.recordings import WarpKernels, device_array
from gauge_envs.envs.divergence import RigidBoundsOfWorlds
from gauge_envs.envs.vector import GaugeVectorEnv
from gauge_envs.errors import ActionError, BackendError, EpisodeError
from gauge_envs.experiments.resolve import load_experiment

pytest.importorskip("warp")

Plant = Callable[[np.ndarray, np.ndarray], None]


class Recorded(Together):
    """MuJoCo simulations that record in arrays, as an engine does on its device."""

    can_record = True
    on_device = False
    plant: Plant | None = None

    def record(self, names, *, frame_count, samples, interval_s):
        count = (frame_count - 1) * samples + 1
        states = np.empty((count, len(self.worlds), len(names), 13))
        states[0] = self.body_states(names)
        for sample in range(1, count):
            self.advance(interval_s)
            states[sample] = self.body_states(names)
        positions, frames = states[..., :3].copy(), states[::samples].copy()
        if self.plant is not None:
            self.plant(positions, frames)
        if self.on_device:
            positions, frames = device_array(positions), device_array(frames)
        kernels = WarpKernels() if self.on_device else None
        return Recording(
            device="cpu", positions_m=positions, states=frames, kernels=kernels
        )


@pytest.fixture(params=["numpy", "kernels"])
def together(monkeypatch, request):
    monkeypatch.setattr(Recorded, "on_device", request.param == "kernels")

    def build_worlds(self, scenes, settings=None):
        return Recorded([self.build(scene, settings) for scene in scenes])

    monkeypatch.setattr(BackendMuJoCo, "build_worlds", build_worlds)
    yield
    Recorded.plant = None


def made(name, count=4, **arguments):
    envs = gymnasium.make_vec(
        f"GAUGE/{name}", num_envs=count, score_arrays=True, **arguments
    ).unwrapped
    assert isinstance(envs, GaugeVectorEnv)
    return envs


def stepped(envs, disturb=lambda _: None):
    over, frame = False, 0
    while not over:
        disturb(frame)
        *_, terminations, truncations, _ = envs.step(zeros(envs))
        over, frame = bool((terminations | truncations).all()), frame + 1
    return envs.score_arrays()


def assert_scores(one, other):
    assert one.keys() == other.keys()
    for key, values in one.items():
        np.testing.assert_allclose(
            values, other[key], rtol=1e-9, atol=1e-9, err_msg=key
        )


def assert_same_records(one, other):
    for first, second in zip(one.episodes, other.episodes, strict=True):
        mine, its = first.trajectory(), second.trajectory()
        for key in vars(mine):
            assert np.array_equal(getattr(mine, key), getattr(its, key)), key
        assert (first.frame, first.fault) == (second.frame, second.fault)
    for key, values in one.score_arrays().items():
        assert np.array_equal(values, other.score_arrays()[key], equal_nan=True), key
    assert all(
        np.array_equal(a, b)
        for a, b in zip(one._lockstep.flags(), other._lockstep.flags(), strict=True)
    )


@pytest.mark.parametrize(
    "name", ["SlopeSlider-2-wood", "BouncingBall-rubber", "NonsmoothContact-1-wood"]
)
def test_a_rollout_is_stepping(name, together):
    rolled, loop = made(name), made(name)
    for envs in (rolled, loop):
        envs.reset(seed=3, options={"jitter": True})
    result = rolled.rollout(keep=True)
    scores = stepped(loop)
    assert result.device == "cpu"
    assert not result.diverged
    assert (result.frames == loop.experiment.frame_count - 1).all()
    assert np.isfinite(result.scores["rmse"]).all()
    assert_scores(result.scores, scores)
    assert_same_records(rolled, loop)
    # The next step starts the next episode, as after stepping.
    first, second = rolled.step(zeros(rolled)), loop.step(zeros(loop))
    assert np.array_equal(first[0]["bodies"], second[0]["bodies"])
    assert first[4]["frame"].tolist() == [0] * 4


def test_worlds_that_diverge_are_found_in_the_frame_of_stepping(together):
    rolled, loop = made("BouncingBall-rubber"), made("BouncingBall-rubber")
    for envs in (rolled, loop):
        envs.reset(seed=0)

    def kick(envs, world):
        envs.worlds.worlds[world].simulation.data.qvel[0] = 900.0

    # World 1 is kicked before its first frame, and world 2 before its fifth.
    kicks = {0: 1, 4: 2}
    scores = stepped(
        loop, lambda frame: kick(loop, kicks[frame]) if frame in kicks else None
    )
    advance, calls = rolled.worlds.advance, []

    def kicked(seconds):
        if len(calls) % 6 == 0 and len(calls) // 6 in kicks:
            kick(rolled, kicks[len(calls) // 6])
        calls.append(seconds)
        advance(seconds)

    rolled.worlds.advance = kicked
    result = rolled.rollout(keep=True)
    assert sorted(result.diverged) == [1, 2]
    assert result.frames.tolist() == [17, 1, 5, 17]
    assert result.diverged == {number: loop.episodes[number].fault for number in (1, 2)}
    assert_scores(result.scores, scores)
    assert_same_records(rolled, loop)


@pytest.mark.parametrize("fault", ["position", "speed", "sample"])
def test_a_world_that_diverges_after_its_last_frame_is_aligned_less(fault, together):
    last = load_experiment("SlopeSlider-2-wood").frame_count - 1

    def plant(positions, states):
        if fault == "sample":
            positions[(last + 2) * 6 + 3, 1] = np.nan
        else:
            states[last + 3, 1, 0, 0 if fault == "position" else 8] = (
                np.nan if fault == "position" else 1e6
            )

    Recorded.plant = staticmethod(plant)
    envs = made("SlopeSlider-2-wood")
    envs.reset(seed=0)
    result = envs.rollout(keep=True)
    assert not result.diverged
    assert [len(episode.trajectory().later_times_s) for episode in envs.episodes] == [
        60,
        12,
        60,
        60,
    ]
    assert_scores(result.scores, envs.score_arrays())


def test_a_planted_fault_in_one_world_changes_its_score_alone(together):
    envs = made("SlopeSlider-2-wood")
    envs.reset(seed=0, options={"jitter": True})
    right = envs.rollout().scores
    Recorded.plant = staticmethod(
        lambda positions, _: positions.__setitem__(
            (slice(1, None), 2), positions[:-1, 2]
        )
    )
    envs.reset(seed=0, options={"jitter": True})
    wrong = envs.rollout().scores
    for key in ("rmse", "release_offset_s"):
        assert np.flatnonzero(wrong[key] != right[key]).tolist() == [2]


def test_without_a_record_on_the_host_a_reset_must_follow(together):
    envs = made("SlopeSlider-2-wood", 2)
    with pytest.raises(EpisodeError, match="call reset before rollout"):
        envs.rollout()
    envs.reset(seed=0)
    envs.rollout()
    for call in (
        lambda: envs.step(zeros(envs)),
        envs.rollout,
        envs.score_arrays,
        envs.scores,
        envs.deformations,
    ):
        with pytest.raises(EpisodeError, match="call reset before"):
            call()
    envs.reset(seed=0)
    envs.step(zeros(envs))
    with pytest.raises(EpisodeError, match="starts at frame 0"):
        envs.rollout()


def test_actions_are_checked(together):
    envs = made("SlopeSlider-2-wood", 2)
    envs.reset(seed=0)
    for actions in (np.ones((18, 2), dtype=int), np.zeros((17, 2), dtype=int)):
        with pytest.raises(ActionError):
            envs.rollout(actions)
    assert envs.rollout(np.zeros((18, 2), dtype=int)).device == "cpu"


def test_an_engine_that_records_nothing_is_stepped_and_says_so():
    envs = made("SlopeSlider-2-wood", 2)
    envs.reset(seed=0)
    result = envs.rollout()
    assert result.device is None
    assert all(
        np.array_equal(result.scores[key], values)
        for key, values in envs.score_arrays().items()
    )
    with pytest.raises(BackendError, match="records nothing"):
        Together([]).record(["cube"], frame_count=2, samples=6, interval_s=1 / 180)


def test_a_driven_experiment_is_stepped_with_its_actions():
    actions = np.full(
        (load_experiment("SlopeSlider-3-wood").frame_count - 1, 1, 1), 0.5
    )
    rolled, loop = made("SlopeSlider-3-wood", 1), made("SlopeSlider-3-wood", 1)
    for envs in (rolled, loop):
        envs.reset(seed=0)
    if rolled.band is None:
        with pytest.raises(EpisodeError, match="no reference"):
            rolled.rollout(actions)
        return
    result = rolled.rollout(actions)
    for one in actions:
        loop.step(one)
    assert result.device is None
    assert all(
        np.array_equal(result.scores[key], values)
        for key, values in loop.score_arrays().items()
    )


def test_each_world_is_judged_by_its_own_masses():
    scene = load_experiment("BouncingBall-rubber").scene
    heavy = replace(
        scene,
        bodies=tuple(
            replace(one, mass_kg=1e3 * one.mass_kg)
            if one in scene.dynamic_bodies
            else one
            for one in scene.bodies
        ),
    )
    states = np.zeros((2, 1, 13))
    states[:, 0, 3] = 1.0
    own, of_the_first = (
        RigidBoundsOfWorlds([scene, heavy]),
        RigidBoundsOfWorlds([scene, scene]),
    )
    of_the_first.energies_j = own.energies_j
    # Twice the energy that the heavy ball may have.
    states[1, 0, 7] = 2.0 * np.sqrt(own.energies_j[1] / heavy.dynamic_bodies[0].mass_kg)
    assert own.suspects(states).tolist() == [False, True]
    assert of_the_first.suspects(states).tolist() == [False, False]


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["SlopeSlider-2-wood", "NonsmoothContact-3-wood", "BouncingBall-rubber"]
)
def test_newton_records_what_it_steps(name):
    pytest.importorskip("newton")
    rolled, loop = made(name, 3, backend="newton"), made(name, 3, backend="newton")
    for envs in (rolled, loop):
        envs.reset(seed=2, options={"jitter": True})
    result = rolled.rollout(keep=True)
    assert result.device == "cpu"
    assert_scores(result.scores, stepped(loop))
    assert_same_records(rolled, loop)
    rolled.reset(seed=2)
    loop.reset(seed=2)
    assert_scores(rolled.rollout().scores, stepped(loop))
