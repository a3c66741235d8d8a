"""Plans: each content once, keys that follow the content, and requests that would fail every episode."""

from dataclasses import replace

import pytest
from sweep_workers import needs_rapier

from gauge_envs.backends import backend
from gauge_envs.backends.mujoco import BackendMuJoCo
from gauge_envs.backends.mujoco.settings import settings_for
from gauge_envs.errors import ParameterError
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.tools.sweep.plan import (
    content_sha256,
    experiment_sha256,
    plan_sweep,
    remaining_tasks,
    shard,
)
from gauge_envs.tools.sweep.spec import sweep_spec

WOOD = "SlopeSlider-2-wood"


def planned(**values):
    return plan_sweep(sweep_spec({"variants": [WOOD]} | values))


def names(plan):
    return {run.file_name(seed) for run in plan.runs for seed in run.request.seeds}


# --- keys ---


def test_equal_sweeps_have_equal_names():
    first, second = (
        planned(repeats=2, settings={"iterations": [5, 10]}),
        planned(repeats=2, settings={"iterations": [10, 5]}),
    )
    assert names(first) == names(second) and len(names(first)) == 4


@pytest.mark.parametrize(
    "other",
    [
        {"variants": ["SlopeSlider-2-metal"]},
        pytest.param({"backends": ["rapier"]}, marks=needs_rapier),
        {"parameters": [{"cube.friction": 0.3}]},
        {"seed": 5},
        {"jitter": {"position_m": 0.002}},
        {"jitter": {"velocity_m_per_s": 0.1}},
        {"settings": {"timestep_s": [1 / 3600]}},
        {"settings": {"tolerance": [1e-12]}},
        {"presets": ["stack"]},
    ],
)
def test_any_other_content_has_other_names(other):
    assert not names(planned(repeats=2)) & names(planned(**{"repeats": 2} | other))


def test_the_versions_of_engine_and_package_belong_to_the_key(monkeypatch):
    before = names(planned())
    monkeypatch.setattr(BackendMuJoCo, "versions", lambda self: {"mujoco": "99.0"})
    assert not before & names(planned())


def test_more_repeats_keep_the_names_of_the_first_ones():
    jitter = {"position_m": 0.001}
    assert names(planned(repeats=2, jitter=jitter)) < names(
        planned(repeats=5, jitter=jitter)
    )


def test_settings_that_resolve_to_the_same_run_once():
    experiment = load_experiment(WOOD)
    default = settings_for(experiment.scene)
    plan = planned(
        settings={
            "timestep_s": [default.timestep_s, 1 / 3600, 1 / 3600],
            "iterations": [default.iterations],
        }
    )
    assert plan.episode_count == 2 and plan.duplicates == 1
    assert names(planned()) < names(plan)


@pytest.mark.parametrize("name", ["mujoco", pytest.param("rapier", marks=needs_rapier)])
def test_resolved_settings_are_those_in_force(name):
    engine, scene = backend(name), load_experiment(WOOD).scene
    simulation = engine.build(scene, {"timestep_s": 1 / 720})
    resolved = engine.resolved_settings(scene, {"timestep_s": 1 / 720})
    assert resolved["timestep_s"] == 1 / 720
    assert dict(simulation.settings).items() <= dict(resolved).items()
    simulation.close()


def test_the_scene_belongs_to_the_hash_of_an_experiment():
    experiment = load_experiment(WOOD)
    heavier = replace(experiment, scene=replace(experiment.scene, gravity_m_per_s2=9.8))
    assert experiment_sha256(experiment) == experiment_sha256(load_experiment(WOOD))
    assert experiment_sha256(heavier) != experiment_sha256(experiment)


def test_every_experiment_has_a_hash_of_its_own():
    plan = planned(variants=["*"])
    assert len(plan.runs) == 75 == len({run.sha256 for run in plan.runs})


def test_what_has_no_content_hash_is_refused():
    assert (
        content_sha256({"a": (1, 2.5)})
        == content_sha256({"a": [1, 2.5]})
        != content_sha256({"a": [1, 2]})
    )
    with pytest.raises(TypeError, match="set has no content hash"):
        content_sha256({1, 2})


# --- plans ---


@needs_rapier
def test_a_setting_of_one_engine_stands_in_its_table():
    plan = planned(
        backends=["mujoco", "rapier"],
        settings={"mujoco": {"noslip_iterations": [0, 5]}},
    )
    assert [run.request.backend for run in plan.runs] == ["mujoco", "mujoco", "rapier"]


@needs_rapier
def test_declined_episodes_are_planned_with_the_reason():
    (run,) = planned(backends=["rapier"], variants=["FoamBending-soft"]).runs
    assert run.declined is not None and "rigid bodies only" in run.declined


def test_default_jitter_is_that_of_a_run():
    assert planned().runs[0].request.jitter is None
    jitter = planned(repeats=2).runs[0].request.jitter
    assert jitter.position_m == 0.001


# --- tasks ---


def test_only_engines_that_advance_worlds_at_once_run_repeats_together():
    pytest.importorskip("newton")
    plan = planned(backends=["mujoco", "newton"], repeats=4)
    assert [list(task.seeds) for task in remaining_tasks(plan, ())] == [
        [0],
        [1],
        [2],
        [3],
        [0, 1, 2, 3],
    ]
    mujoco, newton = plan.runs
    done = {newton.file_name(2)} | {mujoco.file_name(seed) for seed in range(4)}
    tasks = list(remaining_tasks(plan, done))
    assert [list(task.seeds) for task in tasks] == [[0, 1], [3]]
    assert tasks[0].file_names == [newton.file_name(0), newton.file_name(1)]
    assert (
        tasks[0].request.seed,
        tasks[0].request.repeats,
        tasks[0].request.jitter,
    ) == (0, 2, newton.request.jitter)


@needs_rapier
def test_parts_are_the_whole():
    plan = planned(variants=["SlopeSlider-*"], backends=["mujoco", "rapier"])
    parts = [shard(plan, number, 4) for number in range(4)]
    assert [run for part in parts for run in part.runs] == list(plan.runs)
    with pytest.raises(
        ParameterError, match="shard 4/4: expected a number from 0 to 3"
    ):
        shard(plan, 4, 4)
