"""A plan has each content once, file names depend on the content, and errors name the wrong key."""

import pytest
from sweep_workers import planned

from gauge_envs.backends.mujoco import BackendMuJoCo
from gauge_envs.backends.mujoco.settings import settings_for
from gauge_envs.errors import GaugeError, SweepFileError
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.tools.run.options import RunOptions
from gauge_envs.tools.run.plan import plan_runs, remaining_tasks
from gauge_envs.tools.run.spec import load_sweep_file, run_spec

WOOD = "SlopeSlider-2-wood"
SLIDE = 'variants = ["SlopeSlider-2-*"]\n'
WHOLE = """
backends = ["mujoco", "rapier"]
variants = ["SlopeSlider-2-*", "crate.toml"]
presets = ["contact", "stack"]

[settings]
timestep_s = [0.001, 0.0005]
iterations = [10]

[settings.mujoco]
iterations = [20, 50, 100]
"""


def names(plan):
    return {name for run in plan for name in run.file_names}


def test_a_table_of_an_engine_replaces_the_common_list(tmp_path):
    (tmp_path / "sweep.toml").write_text(WHOLE)
    spec = run_spec(load_sweep_file(tmp_path / "sweep.toml"))
    assert spec.setting_lists("mujoco") == {
        "preset": ["contact", "stack"],
        "timestep_s": [0.001, 0.0005],
        "iterations": [20, 50, 100],
    }
    assert spec.setting_lists("rapier")["iterations"] == [10]
    # A task file is in the folder of the sweep file.
    assert spec.variants[1] == str(tmp_path / "crate.toml")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("backends = [", "not a TOML file"),
        (SLIDE + "backend = ['mujoco']", "backend: unknown key; keys: backends"),
        (SLIDE + "[settings]\ntimestep_s = 0.1", "timestep_s: expected a list"),
        (
            SLIDE + "[settings.bullet]\niterations = [1]",
            "settings.bullet: expected a table",
        ),
    ],
)
def test_an_error_names_the_wrong_file_key_and_reason(tmp_path, text, message):
    file = tmp_path / "sweep.toml"
    file.write_text(text)
    with pytest.raises(SweepFileError) as caught:
        load_sweep_file(file)
    assert str(caught.value).startswith(str(file))
    assert message in str(caught.value)


def test_file_names_depend_on_the_content(monkeypatch):
    friction, mass = ("cube.friction", 0.3), ("cube.mass_kg", 0.1)
    first, second = (
        names(planned(parameters=[dict(pairs)]))
        for pairs in ((friction, mass), (mass, friction))
    )
    assert first == second
    before = names(planned(repeats=2))
    assert names(planned(repeats=2)) == before
    for change in (
        {"variants": ["SlopeSlider-2-metal"]},
        {"parameters": [{"cube.friction": 0.3}]},
        {"seed": 5},
        {"jitter": {"position_m": 0.002}},
        {"settings": {"timestep_s": [1 / 3600]}},
    ):
        assert not before & names(planned(**{"repeats": 2} | change))
    monkeypatch.setattr(BackendMuJoCo, "versions", lambda self: {"mujoco": "99.0"})
    assert not before & names(planned(repeats=2))


def test_equal_resolved_settings_run_once():
    default = settings_for(load_experiment(WOOD).scene)
    steps = [default.timestep_s, 1 / 3600, 1 / 3600]
    plan = planned(settings={"timestep_s": steps, "iterations": [default.iterations]})
    assert len(plan) == 2
    assert names(planned()) < names(plan)


def test_only_engines_with_batched_worlds_run_repeats_together():
    pytest.importorskip("newton")
    plan = planned(backends=["mujoco", "newton"], repeats=4)
    seeds = [list(task.request.seeds) for task in remaining_tasks(plan, ())]
    assert seeds == [[0], [1], [2], [3], [0, 1, 2, 3]]
    mujoco, newton = plan
    done = {newton.file_names[2], *mujoco.file_names}
    tasks = list(remaining_tasks(plan, done))
    assert [list(task.request.seeds) for task in tasks] == [[0, 1], [3]]
    assert tasks[0].file_names == newton.file_names[:2]


def test_settings_are_checked_in_the_process_of_the_engine(installed):
    installed("well")
    with pytest.raises(GaugeError, match="MuJoCo setting 'nope'"):
        planned(backends=["well"], settings={"nope": [1]})


def test_an_engine_that_crashes_in_the_plan_leaves_the_others(installed):
    installed("supports-crash")
    crashed, mujoco = planned(backends=["supports-crash", "mujoco"])
    assert (crashed.backend, mujoco.backend) == ("supports-crash", "mujoco")
    assert crashed.unsupported == ""


def test_one_combination_is_a_run():
    options = RunOptions(settings=["iterations=50"], repeats=2, marker_proxy="node")
    (run,) = plan_runs(options.spec([WOOD]))
    assert run.request.settings == {"iterations": 50}
    assert run.request.marker_proxy == "node"
    assert list(run.request.seeds) == [0, 1]
    (plain,) = planned(settings={"iterations": [50]}, repeats=2)
    assert not names([run]) & names([plain])
