"""Task files outside the package: by their path, and by `GAUGE_TASKS`; what is wrong with them is said."""

import os
import re

import gymnasium as gym
import pytest
from places import ROOT
from programs import printed

import gauge_envs
from gauge_envs import GaugeEnv, beyond_variants, variants
from gauge_envs.errors import ParameterError, TaskFileError
from gauge_envs.experiments import variants as module
from gauge_envs.experiments.task_files import task_spec
from gauge_envs.experiments.variants import find_subject, user_variants

PAGE = (ROOT / "docs/adding_an_experiment.md").read_text()
(PUCK,) = re.findall(
    r"^```toml\n(# tasks/puck.*?)^```$", PAGE, re.DOTALL | re.MULTILINE
)
NAME = "PuckSlide-steel"


def forget():
    for cached in (module._read_files, variants, beyond_variants, task_spec):
        cached.cache_clear()


@pytest.fixture
def own(tmp_path, monkeypatch):
    """Sets GAUGE_TASKS to a text, in place of which nothing stays afterwards."""

    def set_to(text):
        monkeypatch.setenv("GAUGE_TASKS", text)
        forget()

    set_to("")
    monkeypatch.chdir(tmp_path)
    yield set_to
    monkeypatch.undo()
    forget()
    for name in [name for name in gym.registry if "PuckSlide" in name]:
        del gym.registry[name]


def test_a_folder_makes_its_ids_known_and_the_benchmark_stays(own, tmp_path, gauge):
    counted = len(variants())
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/puck_slide.toml").write_text(PUCK)
    # A sweep or an experiment file beside it is no task file.
    (tmp_path / "mine/other.toml").write_text('name = "crate"\nusd = "crate.usda"\n')
    own(str(tmp_path / "mine"))
    gauge_envs.register_all()
    env = gym.make(f"GAUGE/{NAME}")
    env.reset(seed=0)
    for _ in range(15):
        *_, truncated, info = env.step(0)
    assert truncated and info["score"].kind == "none"
    assert [one.name for one in user_variants()] == [NAME]
    assert len(variants()) == counted
    listed = gauge("list")
    assert not listed.exit_code
    assert f"Of GAUGE_TASKS: {NAME}" in listed.stdout
    assert "75 ids in 22 families" in listed.stdout
    assert f"GAUGE/{NAME}" in gauge("list", "PuckSlide-*").stdout


def test_a_path_is_shown_and_run_and_its_results_are_read_again(own, tmp_path, gauge):
    (tmp_path / "puck.toml").write_text(PUCK)
    assert "A flat puck slides" in gauge("show", "puck.toml").stdout
    assert not gauge("run", "puck.toml").exit_code
    assert (tmp_path / "results" / f"{NAME}.mujoco.calibrated.json").exists()
    assert NAME in gauge("compare", "results").stdout
    assert GaugeEnv("puck.toml").experiment.id == f"GAUGE/{NAME}"
    own("")
    unknown = gauge("compare", "results")
    assert unknown.exit_code
    assert "If a task file of yours states it, set GAUGE_TASKS" in unknown.stderr


def test_another_process_knows_the_file(own, tmp_path, gauge, real_children):
    (tmp_path / "puck.toml").write_text(PUCK)
    done = gauge("run", "puck.toml", "--isolate")
    assert not done.exit_code, done.stdout + done.stderr
    env = os.environ | {"GAUGE_TASKS": "puck.toml", "PYTHONPATH": str(ROOT)}
    printed(
        "-c", f"import gymnasium, gauge_envs; gymnasium.make('GAUGE/{NAME}')", env=env
    )


def test_what_is_wrong_is_said(own, tmp_path, approved):
    two = PUCK.replace('["steel"]', '["steel", "glass"]').replace(
        "\n[constants.board]",
        "glass = { mass_kg = 0.2, friction = 0.1, restitution = 0.0 }\n\n[constants.board]",
    )
    files = {
        "two.toml": two.replace("PuckSlide", "PuckSlideTwo"),
        "family.toml": PUCK.replace("PuckSlide", "SlopeSlider"),
        "mass.toml": PUCK.replace("mass_kg = 0.44", "mass_kg = -0.44"),
        "syntax.toml": "family = [",
        "neither.toml": 'title = "x"\n',
    }
    lines = []
    for file, text in files.items():
        own("")
        (tmp_path / file).write_text(text)
        with pytest.raises((TaskFileError, ParameterError)) as caught:
            GaugeEnv(file)
        lines.append(f"{file}\n    {caught.value}")
    own("gone")
    with pytest.raises(TaskFileError) as caught:
        find_subject(NAME)
    lines.append(f"GAUGE_TASKS=gone\n    {caught.value}")
    with pytest.warns(UserWarning, match="GAUGE_TASKS names it, and it does not exist"):
        gauge_envs.register_all()
    approved("experiments/user_task_files", "\n".join(lines))
