"""Result files are complete, are read back without change, and resume only the same episode.

A fault of an engine, a disk or a file loses only its episode and is named.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from episodes import run_to_end
from interruption import interrupt_in_episode
from sweep_workers import plain

from gauge_envs import (
    GaugeEnv,
    ScoreEpisode,
)
from gauge_envs.backends.mujoco.simulation import SimulationMuJoCo
from gauge_envs.envs.rollout import Rollout
from gauge_envs.errors import ParameterError, ResultFileError
from gauge_envs.runs.batch import run_many
from gauge_envs.runs.episodes import episode_result, run_episode, run_episodes
from gauge_envs.runs.motion import motion_file
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Outcome
from gauge_envs.runs.result_file import load_result, result_file_name, write_result
from gauge_envs.runs.score_file import score_file

NAME = "SlopeSlider-2-wood"
THREE = [
    RunRequest(f"SlopeSlider-2-{material}") for material in ("wood", "plastic", "metal")
]


@pytest.fixture(scope="module")
def result():
    return run_episode(RunRequest(NAME))


@pytest.fixture
def played(monkeypatch):
    """List of the episodes that have run."""
    rollouts = []
    play = Rollout.play

    def counted(self, *arguments):
        rollouts.append(self)
        play(self, *arguments)

    monkeypatch.setattr(Rollout, "play", counted)
    return rollouts


# --- requests ---


@pytest.mark.parametrize(
    "changes", [{"seed": "x"}, {"seed": -1}, {"repeats": 0}, {"jitter": 1}]
)
def test_an_impossible_request_raises_an_error(changes):
    with pytest.raises(ParameterError, match=f"{next(iter(changes))} is "):
        RunRequest(NAME, **changes)


@pytest.mark.parametrize("name", [NAME, "SlopeSlider-3-wood", "CubeToss-acrylic"])
def test_a_run_equals_an_episode_of_the_environment(name):
    changes = {"settings": {"timestep_s": 1 / 3600}, "marker_proxy": "node"}
    env = ScoreEpisode(GaugeEnv(name, **changes))
    _, info = run_to_end(env, seed=3)
    run = run_episode(RunRequest(name, seed=3, **changes))
    assert plain(run) == plain(episode_result(env, info))
    assert run.outcome is Outcome.FINISHED
    assert run.driver_provenance == ("nominal" if "-3-" in name else None)


def test_a_folder_that_is_not_writable_raises_an_error_before_a_run(played):
    for out in ("/proc/nowhere", __file__, f"{__file__}/below"):
        with pytest.raises(ResultFileError, match="cannot be written"):
            run_many(THREE, out=Path(out))
    assert played == []


# --- results ---


def test_a_result_is_read_back_and_scored_again_without_change(result, tmp_path):
    file = tmp_path / result_file_name(result)
    assert file.name == "SlopeSlider-2-wood.mujoco.published.json"
    write_result(result, file)
    assert set(tmp_path.iterdir()) == {file, motion_file(file)}
    assert load_result(file) == result
    again = score_file(file)[0].score.to_dict()
    for name, value in result.score.to_dict().items():
        is_number = isinstance(value, float | tuple | list)
        assert again[name] == (pytest.approx(value, rel=1e-12) if is_number else value)


def test_file_names_differ_between_requests(result):
    changes = [
        {},
        {"parameters": "measured"},
        {"parameters": {"cube.friction": 0.3}},
        {"parameters": {"cube.friction": 0.31}},
        {"settings_given": {"iterations": 50}},
        {"settings_given": {"iterations": 51}},
        {"seed": 1},
        {"jitter": {"trial": 0}},
        {"backend": "newton"},
    ]
    names = {result_file_name(replace(result, **change)) for change in changes}
    assert len(names) == len(changes)


def test_repeats_have_noise_and_one_episode_has_none(result):
    first, second = run_episodes(RunRequest(NAME, repeats=2))
    assert not result.jitter and first.jitter and first.jitter == second.jitter
    places = {tuple(run.trajectory.samples[0]) for run in (result, first, second)}
    assert len(places) == 3


def test_parallel_jobs_give_the_same_results_in_the_same_order(tmp_path):
    sequential, parallel = (
        list(run_many(THREE, jobs=jobs, out=tmp_path / str(jobs))) for jobs in (1, 2)
    )
    assert list(map(plain, sequential)) == list(map(plain, parallel))
    names = [sorted(file.name for file in (tmp_path / n).glob("*.json")) for n in "12"]
    assert names[0] == names[1]
    assert len(names[0]) == 3


@pytest.mark.usefixtures("rigid_only")
def test_an_episode_that_cannot_run_does_not_stop_the_others(tmp_path, monkeypatch):
    reset = SimulationMuJoCo.reset

    def fails_for_plastic(self, *arguments):
        if 0.1469 in self.model.body_mass.round(6):
            raise RuntimeError("the engine gave up")
        reset(self, *arguments)

    monkeypatch.setattr(SimulationMuJoCo, "reset", fails_for_plastic)
    results = list(run_many([RunRequest("FoamBending-soft"), *THREE], out=tmp_path))
    outcomes = [result.outcome.value for result in results]
    assert outcomes == ["unsupported", "finished", "failed", "finished"]
    assert "deformable" in results[0].error
    assert results[2].error == "RuntimeError: the engine gave up"
    assert len(list(tmp_path.glob("*.json"))) == 2


def test_a_diverged_episode_has_a_result_without_a_score(monkeypatch, tmp_path):
    states = SimulationMuJoCo.body_states

    def exploding(self, names):
        values = states(self, names)
        if self.data.time > 0.2:
            values[..., :3] = np.inf
        return values

    monkeypatch.setattr(SimulationMuJoCo, "body_states", exploding)
    (result,) = run_many([RunRequest(NAME)], out=tmp_path)
    assert result.outcome is Outcome.DIVERGED
    assert result.frames < 19
    assert "not finite" in result.diverged_reason
    assert result.score.rmse is None
    (file,) = tmp_path.glob("*.json")
    assert load_result(file).diverged
    assert "Infinity" not in file.read_text()


# --- damaged files ---


@pytest.mark.parametrize(
    ("key", "value", "reason"),
    [
        ("asset", {"edited": True}, "file"),
        ("marker_proxy", "ghost", "marker_proxy is 'ghost'"),
        ("frames", "many", "frames"),
        ("score.kind", "gold", "score.kind is 'gold'"),
        ("trajectory", None, "no trajectory"),
        ("trajectory.samples", [], "times but 0 samples"),
        ("id", "GAUGE/../../x", "unknown experiment"),
        ("trajectory.samples", [[1e308] * 3] * 109, "amounts of at most 1e+12"),
    ],
)
def test_a_damaged_result_raises_an_error(key, value, reason, result, tmp_path):
    content = json.loads(json.dumps(result.to_dict()))
    place = content
    *path, last = key.split(".")
    for part in path:
        place = place[part]
    place[last] = value
    (tmp_path / "a.json").write_text(json.dumps(content))
    with pytest.raises(ResultFileError, match="not a result file") as caught:
        load_result(tmp_path / "a.json")
    assert reason in str(caught.value)


def test_removed_keys_of_release_0_3_are_ignored(result, tmp_path):
    old = json.loads(json.dumps(result.to_dict()))
    old["scatter"] = {"unit": "mm", "run_count": 40, "spreads": [], "verdict": "none"}
    old["score"]["explained"] = [{"name": "friction cube/board", "left": 0.5}]
    (tmp_path / "old.json").write_text(json.dumps(old))
    assert load_result(tmp_path / "old.json") == result


# --- resume ---


def test_an_interrupt_keeps_finished_repeats_and_resume_runs_the_others(
    tmp_path, monkeypatch, played
):
    request = RunRequest(NAME, repeats=5, seed=3)
    whole = list(map(plain, run_many([request])))
    with monkeypatch.context() as patched:
        interrupt_in_episode(patched, 3)
        with pytest.raises(KeyboardInterrupt):
            list(run_many([request], out=tmp_path))
    assert len(list(tmp_path.glob("*.json"))) == 2
    for missing in (3, 1, 0):
        played.clear()
        resumed = run_many([request], out=tmp_path, resume=True)
        assert list(map(plain, resumed)) == whole
        assert len(played) == missing
        (lost, *_) = tmp_path.glob("*.seed-5.json")
        lost.unlink() if missing == 3 else None
    list(run_many([request], out=tmp_path))
    assert len(played) == 5


@pytest.mark.parametrize("together", [True, False])
def test_repeats_in_one_simulation_are_one_request(together):
    request = RunRequest(NAME, repeats=6, seed=10)
    parts = request.parts({12, 13}, together=together)
    assert [[*part.seeds] for part in parts] == (
        [[10, 11], [14, 15]] if together else [[10], [11], [14], [15]]
    )


@pytest.mark.parametrize(
    ("change", "note"),
    [
        ({"task_sha256": "0" * 64}, "task_sha256 differs"),
        ({"seed": 5}, "seed differs"),
        ({"versions": {"mujoco": "3.0.0"}}, "made with mujoco 3.0.0"),
        ({"score": None}, "not a result file"),
        (None, "not a result file"),
    ],
)
def test_resume_runs_a_stale_or_damaged_result_again_with_a_note(
    tmp_path, played, result, change, note
):
    file = tmp_path / result_file_name(result)
    text = json.dumps(result.to_dict() | (change or {}))
    file.write_text(text if change else text[: len(text) // 2])
    notes = []
    (again,) = run_many(
        [RunRequest(NAME)], out=tmp_path, resume=True, notify=notes.append
    )
    assert len(played) == 1
    (line,) = notes
    assert note in line and file.name in line and "run again" in line
    assert again.score == load_result(file).score == result.score
