"""An experiment of the user: a task file with a band next to it, by path or by `GAUGE_TASKS`.

The example is a crate that slides down 25 degrees with friction 0.3; its band and its motion are the closed form.
"""

import os
import re
import shutil

import gymnasium as gym
import numpy as np
import pytest
from episodes import run_to_end
from places import ROOT
from texts import changed_text

import gauge_envs
from gauge_envs import GaugeEnv, load_experiment, reference_band
from gauge_envs.errors import (
    ParameterError,
    ReferenceFileError,
    TaskFileError,
)
from gauge_envs.experiments.variants import (
    find_variant,
    task_path,
    user_variants,
    variants,
)
from gauge_envs.scoring.recorded_events import EVENTS

EXAMPLE = ROOT / "examples" / "own_experiment"
NAME = "CrateSlide-pine"
G, TILT, FRICTION = 9.80665, np.radians(25.0), 0.3
ACCELERATION = G * (np.sin(TILT) - FRICTION * np.cos(TILT))
DOWNHILL = np.array([np.cos(TILT), 0.0, -np.sin(TILT)])


@pytest.fixture
def example(tmp_path, monkeypatch):
    """A copy of the example in the working directory; its id leaves Gymnasium afterwards."""
    shutil.copytree(EXAMPLE, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    gym.registry.pop(f"GAUGE/{NAME}", None)


def test_the_crate_and_its_band_slide_as_coulomb_says(example):
    env = GaugeEnv("crate.toml")
    _, info = run_to_end(env)
    assert info["reference"] == "analytic"
    trajectory = env.trajectory()
    path_m = 1e-3 * trajectory.samples @ DOWNHILL
    course = 0.5 * trajectory.times_s**2
    fitted = course @ (path_m - path_m[0]) / (course @ course)
    assert fitted == pytest.approx(ACCELERATION, rel=1e-3)
    assert env.score().solves == "yes"
    start_m = np.array(env.experiment.scene.body("crate").pose.position_m)
    times_s = np.arange(31) / 30.0
    mean_mm = 1e3 * (DOWNHILL @ start_m + 0.5 * ACCELERATION * times_s**2)
    np.testing.assert_allclose(env.band.mean[:, 0], mean_mm, atol=1e-6)
    sigma_mm = np.hypot(1.0, 1e3 * 0.5 * G * np.cos(TILT) * 0.01 * times_s**2)
    np.testing.assert_allclose(env.band.sigma[:, 0], sigma_mm, atol=1e-6)


def test_a_path_is_run_in_another_process_and_its_result_is_read_again(
    example, gauge, monkeypatch
):
    assert "A pine crate slides" in gauge("show", "crate.toml").stdout
    done = gauge("run", "crate.toml", "--isolate")
    assert not done.exit_code, done.stdout + done.stderr
    compared = gauge("compare", "results").stdout
    assert "analytic: closed form" in compared
    assert NAME in compared
    monkeypatch.setenv("GAUGE_TASKS", "")
    assert NAME in gauge("compare", "results").stdout
    monkeypatch.setenv("GAUGE_TASKS", "")
    (example / "crate.toml").rename(example / "moved.toml")
    file = f"results/{NAME}.mujoco.published.json"
    for words in (("compare", "results"), ("score", file)):
        gone = gauge(*words)
        assert gone.exit_code
        stated = f"{example / 'crate.toml'}: it has GAUGE/{NAME} and is gone"
        assert stated in " ".join(gone.stderr.split())
    (example / "moved.toml").rename(example / "crate.toml")
    assert "1 of 1 solve their scene" in gauge("score", file).stdout
    monkeypatch.setenv("GAUGE_TASKS", "")
    changed_text(example / "crate.toml", ('"CrateSlide"', '"BoxSlide"'))
    renamed = gauge("compare", "results")
    assert renamed.exit_code
    assert f"it has GAUGE/BoxSlide-pine, not GAUGE/{NAME}" in renamed.stderr


def test_an_event_that_is_unknown_or_does_not_fit_is_named(example):
    """A crate has no ball, joint, marker or driver. Unknown names are each known one without an end or a beginning."""
    env = GaugeEnv("crate.toml")
    run_to_end(env)
    file = example / f"{NAME}.band.toml"
    band = file.read_text()
    known = {"slide_acceleration_m_per_s2"}
    unfit = (
        "cloth_lag_deg",
        "foot_lag_mm",
        "restitution",
        "strain_zz",
        "turning_ratio",
    )
    facts = 'unit = "1"\nvalue = 1.0\nstandard_uncertainty = 1.0\nsource = ""'
    wrong = [name for event in EVENTS for name in (event[:-1], event[2:])]
    for time_ns, name in enumerate((*wrong, *unfit, *known)):
        file.write_text(f'{band}\n[[events]]\nname = "{name}"\n{facts}\n')
        os.utime(file, ns=(0, time_ns))
        if name in known:
            assert set(env.score().events) == known
            continue
        reason = "has not" if name in EVENTS else "no event .*; did you mean"
        place = rf"{file.name}: events\.{name}: "
        with pytest.raises(ReferenceFileError, match=f"{place}.*{reason}"):
            env.score()


def test_a_restitution_without_effect_is_named(example, gauge):
    changed_text(example / "crate.toml", ("restitution = 0.0", "restitution = 0.5"))
    for command in ("show", "run"):
        noted = gauge(command, "crate.toml").stderr
        assert "no effect in sustained contacts (crate/ramp 0.5)" in noted
    contact = 'constants_of = "crate"'
    changed_text(example / "crate.toml", (contact, f'{contact}\nmode = "impact"'))
    assert "no effect" not in gauge("run", "crate.toml").stderr
    given = ("run", "SlopeSlider-2-wood", "-p", "cube.restitution=0.9")
    assert "cube/board 0.9" in gauge(*given).stderr
    assert "no effect" not in gauge(*given[:2]).stderr


def test_a_folder_makes_its_ids_known_and_the_benchmark_stays(
    example, gauge, monkeypatch
):
    # A sweep in the folder is no task file.
    (example / "sweep.toml").write_text('variants = ["crate.toml"]\n')
    monkeypatch.setenv("GAUGE_TASKS", str(example))
    gauge_envs.register_all()
    assert run_to_end(gym.make(f"GAUGE/{NAME}"))[1]["score"].kind == "analytic"
    assert [variant.name for variant in user_variants()] == [NAME]
    assert len(variants()) == 75
    listed = gauge("list").stdout
    assert f"Of GAUGE_TASKS: {NAME}" in listed
    assert "\n75 ids" in listed


def test_an_edited_file_is_read_again_and_a_damaged_band_raises_an_error(example):
    assert load_experiment("crate.toml").frame_count == 31
    changed_text(example / "crate.toml", ("all = 31", "all = 21"))
    os.utime(example / "crate.toml", ns=(0, 0))
    assert load_experiment("crate.toml").frame_count == 21
    with pytest.raises(ReferenceFileError, match=r"\(31, 3\), but .* are \(21, 3\)"):
        reference_band(load_experiment(NAME))
    changed_text(example / f"{NAME}.band.toml", ('"analytic"', '"guess"'))
    with pytest.raises(ReferenceFileError, match=r"pine\.band\.toml: kind: "):
        reference_band(load_experiment("crate.toml"))


def test_a_wrong_task_file_raises_an_error(example, monkeypatch):
    text = (example / "crate.toml").read_text()
    silent = text.replace("recorded = true", "").replace("CrateSlide", "Silent")
    fixed = text.replace('"dynamic"', '"fixed"').replace("CrateSlide", "Fixed")
    two = text.replace('["pine"]', '["pine", "oak"]')
    for name, content, message in (
        ("two", re.sub("pine = (.*)", r"pine = \1\noak = \1", two), "2 experiments"),
        ("family", text.replace("CrateSlide", "SlopeSlider"), "choose another name"),
        ("silent", silent, "no body is recorded"),
        ("fixed", fixed, r"bodies\.crate: its motion is fixed"),
        ("mass", text.replace("kg = 4.0", "kg = -4.0"), r"crate\.pine\.mass_kg: "),
        ("syntax", "family = [", r"syntax\.toml: not a TOML file: Invalid value"),
    ):
        (example / f"{name}.toml").write_text(content)
        with pytest.raises((TaskFileError, ParameterError), match=message):
            GaugeEnv(f"{name}.toml")
    monkeypatch.setenv("GAUGE_TASKS", "gone")
    with pytest.raises(TaskFileError, match="gone: cannot be read: No such file"):
        find_variant(NAME)
    with pytest.warns(UserWarning, match="gone: cannot be read"):
        gauge_envs.register_all()


GUIDE = ROOT / "docs" / "adding_an_experiment.md"


def test_a_new_material_of_the_guide_runs_without_a_score(tmp_path, monkeypatch):
    rows = re.findall(
        r"^       (glass = .*mass_kg.*)$", GUIDE.read_text(), re.MULTILINE
    )
    text = task_path("SlopeSlider").read_text()
    text = text.replace('"SlopeSlider"', '"GlassSlider"')
    text = text.replace('"metal"]', '"metal", "glass"]')
    text = text.replace("[constants.cube]\n", f"[constants.cube]\n{rows[0]}\n")
    text = re.sub(r"(frames = \{ wood = (\d+),)", r"\1 glass = \2,", text)
    text = text.replace('metal = "video" }', 'metal = "video", glass = "nominal" }')
    initial_tables = r"\[subtasks\.(\d)\.initial\.wood\]\n((?:\w.*\n)+)"
    text = re.sub(initial_tables, r"\g<0>\n[subtasks.\1.initial.glass]\n\2", text)
    (tmp_path / "glass.toml").write_text(text)
    monkeypatch.setenv("GAUGE_TASKS", str(tmp_path / "glass.toml"))
    for subtask in "13":
        env = GaugeEnv(f"GlassSlider-{subtask}-glass")
        assert env.experiment.scene.body("cube").mass_kg == 0.31
        env.reset(seed=0)
        assert env.step(0 * env.action_space.sample())[-1]["reference"] == "none"
