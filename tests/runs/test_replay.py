"""Replays of results: poses of the same run, bit for bit, or a reason."""

from dataclasses import replace

import numpy as np
import pytest

from gauge_envs.runs import replay as replay_module
from gauge_envs.runs.batch import run_many
from gauge_envs.runs.replay import (
    ReplayError,
    load_or_replay,
    replay,
    replay_path,
)
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result_file import load_result, write_result
from gauge_envs.scene.jitter import Jitter


def first_file(folder, request):
    list(run_many([request], out=folder))
    return sorted(folder.glob("*.json"))[0]


@pytest.fixture(scope="module")
def slide_file(tmp_path_factory):
    return first_file(
        tmp_path_factory.mktemp("results"), RunRequest("SlopeSlider-2-wood")
    )


@pytest.fixture
def slide(slide_file):
    return load_result(slide_file)


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
def test_tethered_driven_and_colliding_bodies_have_the_same_bits(name, tmp_path):
    request = RunRequest(
        name, settings={"timestep_s": 1 / 360} if name.startswith("Pendulum") else None
    )
    result = load_result(first_file(tmp_path, request))
    made = replay(result)
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


COARSE = {"timestep_s": 1 / 900}
MODEL = {
    "file": "slide.xml",
    "kind": "model",
    "sha256": "0" * 64,
    "edited": True,
    "changes": [],
}


def one_bit(slide):
    samples = slide.trajectory.samples.copy()
    samples[40, 0] = np.nextafter(samples[40, 0], np.inf)
    return {"trajectory": replace(slide.trajectory, samples=samples)}


def shorter(slide):
    trajectory = slide.trajectory
    cut = replace(
        trajectory, times_s=trajectory.times_s[:-6], samples=trajectory.samples[:-6]
    )
    return {"trajectory": cut}


def older(slide):
    versions = slide.versions | {"mujoco": "0.1"}
    return {"versions": versions, "settings_given": COARSE}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (one_bit, "differs from the result by up to .* mm; the versions .* are"),
        (lambda _: {"settings_given": COARSE}, "differs from the result"),
        (older, r"versions: mujoco 0\.1 in the result, .* installed"),
        (shorter, "109 samples of 3 coordinates, the result has 103 of 3"),
        (lambda _: {"backend": None}, "trajectory file"),
        (lambda _: {"backend": "nowhere"}, "nowhere"),
        (lambda _: {"asset": MODEL}, r"slide\.xml"),
    ],
)
def test_a_result_of_another_run_has_no_replay(changes, message, slide):
    with pytest.raises(ReplayError, match=message):
        replay(replace(slide, **changes(slide)))


# --- the file beside the result ---


def forbidden(result):
    raise AssertionError("the episode ran again")


def test_the_file_beside_the_result_spares_the_run(slide_file, monkeypatch):
    result = load_result(slide_file)
    made = load_or_replay(result, slide_file)
    assert replay_path(slide_file).is_file()
    monkeypatch.setattr(replay_module, "replay", forbidden)
    known = load_or_replay(result, slide_file)
    np.testing.assert_array_equal(known.poses, made.poses)
    assert (known.bodies, known.rate_hz) == (made.bodies, made.rate_hz)


@pytest.mark.parametrize("damage", ["other result", "cut", "text"])
def test_a_file_of_another_result_or_a_damaged_one_does_not_count(
    damage, slide_file, tmp_path, monkeypatch
):
    result, file = load_result(slide_file), tmp_path / slide_file.name
    write_result(result, file)
    load_or_replay(result, file)
    path = replay_path(file)
    if damage == "other result":
        write_result(replace(result, seed=1), file)
    elif damage == "cut":
        path.write_bytes(path.read_bytes()[:200])
    else:
        path.write_text("no archive")
    monkeypatch.setattr(replay_module, "replay", forbidden)
    with pytest.raises(AssertionError, match="ran again"):
        load_or_replay(result, file)
