"""An experiment of one's own: a task file with a band beside it, by path or by `GAUGE_TASKS`."""

import os
import re
import shutil

import gymnasium as gym
import numpy as np
import pytest
from places import ROOT
from programs import printed
from texts import changed_text, fenced

import gauge_envs
from gauge_envs import GaugeEnv, load_experiment, reference_band
from gauge_envs.errors import ParameterError, ReferenceFileError, TaskFileError
from gauge_envs.experiments.variants import (
    find_variant,
    task_path,
    user_variants,
    variants,
)

EXAMPLE = ROOT / "examples" / "own_experiment"
CRATE = EXAMPLE / "crate.toml"
NAME = "CrateSlide-pine"

G, TILT, FRICTION = 9.80665, np.radians(25.0), 0.3
ACCELERATION = G * (np.sin(TILT) - FRICTION * np.cos(TILT))


@pytest.fixture
def example(tmp_path, monkeypatch):
    """A copy of the example, in the working directory; its id leaves Gymnasium afterwards."""
    shutil.copytree(EXAMPLE, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    gym.registry.pop(f"GAUGE/{NAME}", None)


def test_the_band_of_the_example_is_the_closed_form():
    band = reference_band(load_experiment(str(CRATE)))
    start_m = np.array(load_experiment(NAME).scene.body("crate").pose.position_m)
    downhill = np.array([np.cos(TILT), 0.0, -np.sin(TILT)])
    times_s = np.arange(31) / 30.0
    mean = 1e3 * (downhill @ start_m + 0.5 * ACCELERATION * times_s**2)
    np.testing.assert_allclose(band.mean[:, 0], mean, atol=1e-6)
    sigma = np.hypot(1.0, 1e3 * 0.5 * G * np.cos(TILT) * 0.01 * times_s**2)
    np.testing.assert_allclose(band.sigma[:, 0], sigma, atol=1e-6)


def test_a_path_is_run_and_scored_and_its_result_is_read_again(
    example, gauge, monkeypatch
):
    assert "A pine crate slides" in gauge("show", "crate.toml").stdout
    assert not gauge("run", "crate.toml").exit_code
    compared = gauge("compare", "results").stdout
    assert "analytic: closed form" in compared
    assert NAME in compared
    monkeypatch.setenv("GAUGE_TASKS", "")
    unknown = gauge("compare", "results")
    assert unknown.exit_code
    assert "If a task file of yours states it, set GAUGE_TASKS" in unknown.stderr


def test_the_crate_slides_as_the_law_says(example):
    env = GaugeEnv("crate.toml")
    env.reset(seed=0)
    for _ in range(30):
        *_, info = env.step(0)
    times_s, samples = env.trajectory().dense
    way_m = 1e-3 * samples @ [np.cos(TILT), 0.0, -np.sin(TILT)]
    course = 0.5 * times_s**2
    found = course @ (way_m - way_m[0]) / (course @ course)
    assert found == pytest.approx(ACCELERATION, rel=1e-3)
    assert info["reference"] == "analytic"


def test_a_folder_makes_its_ids_known_and_the_benchmark_stays(
    example, gauge, monkeypatch
):
    # A sweep beside it is no task file.
    (example / "sweep.toml").write_text('variants = ["crate.toml"]\n')
    monkeypatch.setenv("GAUGE_TASKS", str(example))
    gauge_envs.register_all()
    env = gym.make(f"GAUGE/{NAME}")
    env.reset(seed=0)
    truncated = False
    while not truncated:
        *_, truncated, info = env.step(0)
    assert info["score"].over_uncertainty < 1.96
    assert [variant.name for variant in user_variants()] == [NAME]
    assert len(variants()) == 75
    listed = gauge("list").stdout
    assert f"Of GAUGE_TASKS: {NAME}" in listed
    assert "75 ids in 22 families" in listed


def test_another_process_knows_the_file(example, gauge, real_children):
    done = gauge("run", "crate.toml", "--isolate")
    assert not done.exit_code, done.stdout + done.stderr
    env = os.environ | {"GAUGE_TASKS": "crate.toml", "PYTHONPATH": str(ROOT)}
    printed(
        "-c", f"import gymnasium, gauge_envs; gymnasium.make('GAUGE/{NAME}')", env=env
    )


def test_an_edited_file_is_read_again(example):
    assert load_experiment("crate.toml").frame_count == 31
    changed_text(example / "crate.toml", ("all = 31", "all = 21"))
    os.utime(example / "crate.toml", ns=(0, 0))
    assert load_experiment("crate.toml").frame_count == 21
    with pytest.raises(ReferenceFileError, match=r"\(31, 3\), and .* has \(21, 3\)"):
        reference_band(load_experiment(NAME))


def test_a_damaged_band_is_an_error_with_its_file(example):
    changed_text(example / f"{NAME}.band.toml", ('"analytic"', '"guess"'))
    with pytest.raises(ReferenceFileError, match=r"pine\.band\.toml: kind: "):
        reference_band(load_experiment("crate.toml"))


def test_what_is_wrong_with_a_task_file_is_said(example, monkeypatch, approved):
    text = CRATE.read_text()
    two = text.replace('["pine"]', '["pine", "oak"]')
    files = {
        "two.toml": re.sub("pine = (.*)", r"pine = \1\noak = \1", two),
        "family.toml": text.replace("CrateSlide", "SlopeSlider"),
        "mass.toml": text.replace("mass_kg = 4.0", "mass_kg = -4.0"),
        "syntax.toml": "family = [",
        "neither.toml": 'title = "x"\n',
    }
    lines = []
    for file, content in files.items():
        (example / file).write_text(content)
        with pytest.raises((TaskFileError, ParameterError)) as caught:
            GaugeEnv(file)
        lines.append(f"{file}\n    {caught.value}")
    monkeypatch.setenv("GAUGE_TASKS", "gone")
    with pytest.raises(TaskFileError) as caught:
        find_variant(NAME)
    lines.append(f"GAUGE_TASKS=gone\n    {caught.value}")
    with pytest.warns(UserWarning, match="gone: cannot be read"):
        gauge_envs.register_all()
    approved("experiments/own_experiment", "\n".join(lines))


def test_a_new_material_runs_without_a_score(tmp_path):
    """A glass cube, as the guide adds it, in a copy of the file under another name."""
    (block,) = [
        text
        for text in re.findall(r"^       (glass = .*)$", GUIDE, re.MULTILINE)
        if "mass_kg" in text
    ]
    text = task_path("SlopeSlider").read_text()
    text = text.replace('"SlopeSlider"', '"GlassSlider"').replace(
        '"metal"]', '"metal", "glass"]'
    )
    text = text.replace("[constants.cube]\n", f"[constants.cube]\n{block}\n")
    text = re.sub(r"(frames = \{ wood = (\d+),)", r"\1 glass = \2,", text)
    text = text.replace('metal = "video" }', 'metal = "video", glass = "nominal" }')
    starts = r"\[subtasks\.(\d)\.initial\.wood\]\n((?:\w.*\n)+)"
    text = re.sub(starts, r"\g<0>\n[subtasks.\1.initial.glass]\n\2", text)
    (tmp_path / "glass.toml").write_text(text)
    os.environ["GAUGE_TASKS"] = str(tmp_path / "glass.toml")
    for subtask in "123":
        env = GaugeEnv(f"GlassSlider-{subtask}-glass")
        assert env.experiment.scene.body("cube").mass_kg == 0.31
        env.reset(seed=0)
        assert env.step(0 * env.action_space.sample())[-1]["reference"] == "none"


GUIDE = (ROOT / "docs" / "adding_an_experiment.md").read_text()


def test_the_file_of_the_guide_runs(tmp_path):
    (text, *_) = fenced(ROOT / "docs" / "adding_an_experiment.md", "toml")
    (tmp_path / "puck_slide.toml").write_text(text)
    experiment = load_experiment(str(tmp_path / "puck_slide.toml"))
    assert (experiment.name, experiment.frame_count) == ("PuckSlide-steel", 16)
