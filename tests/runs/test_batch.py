"""Episodes and result files: complete, written whole, resumed only where they are of the very same episode."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from interruption import interrupt_in_episode

from gauge_envs import load_experiment
from gauge_envs.backends.mujoco.simulation import SimulationMuJoCo
from gauge_envs.backends.registry import backend_for
from gauge_envs.envs.rollout import Rollout
from gauge_envs.errors import (
    ParameterError,
    ResultFileError,
    UnknownNameError,
)
from gauge_envs.runs import pool
from gauge_envs.runs.batch import check_requests, run_many
from gauge_envs.runs.episodes import run_episode, run_episodes
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Outcome
from gauge_envs.runs.result_file import load_result, result_file_name, write_result
from gauge_envs.runs.score_file import score_file
from gauge_envs.tools.bench.recording import NotFiniteError, record

NAME = "SlopeSlider-2-wood"
THREE = ["SlopeSlider-2-wood", "SlopeSlider-2-plastic", "SlopeSlider-2-metal"]
SOFT = "FoamBending-soft"


@pytest.fixture(scope="module")
def result():
    return run_episode(RunRequest(NAME))


@pytest.fixture
def run_count(monkeypatch):
    """How many episodes were started, as a list that grows."""
    started = []
    play = Rollout.play

    def counted(self):
        started.append(self)
        play(self)

    monkeypatch.setattr(Rollout, "play", counted)
    return started


def test_a_file_read_back_is_the_same_result_and_scores_the_same(result, tmp_path):
    file = tmp_path / result_file_name(result)
    write_result(result, file)
    assert file.name == "SlopeSlider-2-wood.mujoco.calibrated.json"
    assert load_result(file) == result
    again = score_file(file)[0].score.to_dict()
    for name, value in result.score.to_dict().items():
        if isinstance(value, float | tuple | list):
            # The last digit may depend on the layout of arrays in memory.
            assert again[name] == pytest.approx(value, rel=1e-12)
        else:
            assert again[name] == value
    assert list(tmp_path.iterdir()) == [file]


def test_driven_and_undriven_experiments_take_zero_actions():
    driven = run_episode(RunRequest("SlopeSlider-3-metal"))
    assert driven.driver_provenance == "video"
    assert driven.outcome is Outcome.FINISHED
    assert driven.score.kind == "recording"


def test_file_names_differ_between_requests(result):
    changes = [
        {"parameters": "effective"},
        {"parameters": {"cube.friction": 0.3}},
        {"parameters": {"cube.friction": 0.31}},
        {"settings_given": {"iterations": 50}},
        {"settings_given": {"iterations": 51}},
        {"seed": 1},
        {"backend": "newton"},
    ]
    names = {result_file_name(replace(result, **change)) for change in [{}, *changes]}
    assert len(names) == 8


def test_jobs_at_once_give_the_same_bits_in_the_same_order(tmp_path):
    requests = [RunRequest(name) for name in THREE]
    alone, shared = (
        list(run_many(requests, jobs=jobs, out=tmp_path / str(jobs))) for jobs in (1, 2)
    )
    for one, other in zip(alone, shared, strict=True):
        assert one.id == other.id
        np.testing.assert_array_equal(one.trajectory.samples, other.trajectory.samples)
        assert one.score == other.score
    assert {file.name for file in (tmp_path / "2").iterdir()} == {
        file.name for file in (tmp_path / "1").iterdir()
    }


def test_a_closed_run_of_several_jobs_ends_their_processes(tmp_path, monkeypatch):
    workers = []

    class Counted(pool.Worker):
        def __init__(self, *args, **kwargs):
            super().__init__(*args, **kwargs)
            workers.append(self)

    monkeypatch.setattr(pool, "Worker", Counted)
    results = run_many(
        [RunRequest(name) for name in (*THREE, SOFT)], jobs=2, out=tmp_path
    )
    assert next(results).error is None
    results.close()
    assert len(workers) == 2
    assert all(worker._process is None for worker in workers)


def test_a_request_that_fits_nothing_is_refused_before_anything_runs(run_count):
    for wrong in ({"parameters": "nonsense"}, {"settings": {"nope": 1}}):
        with pytest.raises(ParameterError):
            check_requests([RunRequest(name, **wrong) for name in THREE])
    with pytest.raises(UnknownNameError):
        check_requests([RunRequest(name, backend="warp") for name in THREE])
    assert run_count == []


@pytest.mark.usefixtures("rigid_only")
def test_one_that_cannot_run_does_not_stop_the_others(tmp_path, monkeypatch):
    reset = SimulationMuJoCo.reset

    def fails_for_plastic(self, *arguments):
        if 0.1469 in self.model.body_mass.round(6):
            raise RuntimeError("the engine gave up")
        reset(self, *arguments)

    monkeypatch.setattr(SimulationMuJoCo, "reset", fails_for_plastic)
    results = list(
        run_many([RunRequest(name) for name in (SOFT, *THREE)], out=tmp_path)
    )
    assert [r.outcome.value for r in results] == [
        "declined",
        "finished",
        "failed",
        "finished",
    ]
    assert "deformable" in results[0].error
    assert results[2].error == "RuntimeError: the engine gave up"
    assert results[2].score.kind == "trials"
    assert len(list(tmp_path.iterdir())) == 2


def test_divergence_is_a_result_without_a_score(monkeypatch, tmp_path):
    states = SimulationMuJoCo.body_states

    def exploding(self, names):
        values = states(self, names)
        if self.data.time > 0.2:
            values[..., :3] = np.inf
        return values

    monkeypatch.setattr(SimulationMuJoCo, "body_states", exploding)
    (result,) = run_many([RunRequest(NAME)], out=tmp_path)
    assert (result.outcome, result.diverged, result.frames < 19) == (
        Outcome.DIVERGED,
        True,
        True,
    )
    assert "not finite" in result.diverged_reason
    assert result.score.rmse is None
    (file,) = tmp_path.iterdir()
    assert load_result(file).diverged
    assert "Infinity" not in file.read_text()


def test_repeats_scatter_and_one_episode_does_not(result):
    first, second = run_episodes(RunRequest(NAME, repeats=2))
    assert not result.jitter and first.jitter and first.jitter == second.jitter
    starts = {tuple(one.trajectory.samples[0]) for one in (result, first, second)}
    assert len(starts) == 3


@pytest.mark.parametrize("column", [0, 4, 12])
def test_a_recording_ends_at_one_number_that_is_not_finite(column):
    scene = load_experiment(NAME).scene
    simulation = backend_for("mujoco", None).build(scene)
    states_of = simulation.body_states

    def planted(names):
        states = np.array(states_of(names))
        states[0, list(names).index("cube"), column] = np.nan
        return states

    simulation.body_states = planted
    with pytest.raises(NotFiniteError, match="'cube' is not finite"):
        record(simulation, scene, 0.1)


@pytest.mark.parametrize("out", ["/proc/nowhere", __file__, f"{__file__}/below"])
def test_an_unwritable_folder_is_refused_before_anything_runs(out, run_count):
    with pytest.raises(ResultFileError, match="cannot be written"):
        run_many([RunRequest(NAME)], out=Path(out))
    assert run_count == []


# --- resume ---


def test_resume_goes_on_after_an_interrupt(tmp_path, monkeypatch, run_count):
    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        interrupt_in_episode(patched, 2)
        list(run_many([RunRequest(name) for name in THREE], out=tmp_path))
    assert [f.name for f in tmp_path.iterdir()] == [
        "SlopeSlider-2-wood.mujoco.calibrated.json"
    ]
    run_count.clear()
    results = list(
        run_many([RunRequest(name) for name in THREE], out=tmp_path, resume=True)
    )
    assert [r.outcome for r in results] == [Outcome.FINISHED] * 3
    assert len(run_count) == 2
    assert results == list(
        run_many([RunRequest(name) for name in THREE], out=tmp_path, resume=True)
    )
    assert len(run_count) == 2


def test_a_crash_while_writing_leaves_no_result_file(tmp_path, monkeypatch, result):
    def crash(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("gauge_envs.files.Path.write_bytes", crash)
    with pytest.raises(ResultFileError, match="No space left"):
        write_result(result, tmp_path / "a.json")
    assert list(tmp_path.iterdir()) == []


def test_without_resume_everything_runs_again(tmp_path, run_count):
    for _ in range(2):
        list(run_many([RunRequest(NAME)], out=tmp_path))
    assert len(run_count) == 2


@pytest.mark.parametrize(
    "request_",
    [
        {"seed": 1},
        {"settings": {"iterations": 50}},
        {"parameters": {"cube.friction": 0.3}},
    ],
)
def test_resume_takes_no_result_of_another_request(tmp_path, run_count, request_):
    list(run_many([RunRequest(NAME)], out=tmp_path))
    for _ in range(2):
        list(run_many([RunRequest(NAME, **request_)], out=tmp_path, resume=True))
    assert len(run_count) == 2
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.parametrize(
    ("key", "value", "note"),
    [
        ("task_sha256", "0" * 64, "task_sha256 differs"),
        ("seed", 5, "seed differs"),
        (
            "versions",
            {"mujoco": "3.0.0", "gauge-envs": "0.1.0"},
            "made with mujoco 3.0.0",
        ),
    ],
)
def test_resume_runs_stale_results_again_and_says_so(
    tmp_path, run_count, key, value, note
):
    (result,) = run_many([RunRequest(NAME)], out=tmp_path)
    (file,) = tmp_path.iterdir()
    file.write_text(json.dumps(result.to_dict() | {key: value}))
    notes = []
    list(run_many([RunRequest(NAME)], out=tmp_path, resume=True, notify=notes.append))
    assert len(run_count) == 2
    assert note in notes[0]
    assert file.name in notes[0]


def damage(text, kind):
    values = json.loads(text)
    if kind == "cut":
        return text[: len(text) // 2]
    if kind == "no score":
        del values["score"]
    if kind == "uneven":
        values["trajectory"]["times_s"].pop()
    if kind == "type":
        values["frames"] = "many"
    if kind == "id":
        values["id"] = "GAUGE/Nothing"
    return {"list": "[]", "empty": ""}.get(kind, json.dumps(values))


@pytest.mark.parametrize(
    "kind", ["cut", "empty", "list", "no score", "uneven", "type", "id"]
)
def test_a_damaged_file_is_named_and_its_episode_runs_again(tmp_path, kind, result):
    file = tmp_path / result_file_name(result)
    file.write_text(damage(json.dumps(result.to_dict()), kind))
    with pytest.raises(ResultFileError, match="not a result file"):
        load_result(file)
    notes = []
    (again,) = run_many(
        [RunRequest(NAME)], out=tmp_path, resume=True, notify=notes.append
    )
    assert again.score == load_result(file).score == result.score
    assert list(tmp_path.iterdir()) == [file]
    assert len(notes) == 1 and file.name in notes[0] and "run again" in notes[0]
