"""Sweep files: what they cover, and a clear message for each wrong one."""

import pytest

from gauge_envs.errors import ParameterError, SweepFileError
from gauge_envs.tools.sweep.spec import load_sweep_file, sweep_spec

SLIDE = 'variants = ["SlopeSlider-2-*"]\n'

WHOLE = """
backends = ["mujoco", "rapier"]
variants = ["SlopeSlider-2-*", "BouncingBall-rubber"]
presets = ["contact", "stack"]
parameters = ["calibrated", { "cube.friction" = 0.3 }]
repeats = 4
seed = 7

[jitter]
position_m = 0.002

[settings]
timestep_s = [0.001, 0.0005]
iterations = [10]

[settings.mujoco]
iterations = [20, 50, 100]
"""


def spec_of(folder, text):
    file = folder / "sweep.toml"
    file.write_text(text)
    return sweep_spec(load_sweep_file(file))


def test_a_table_of_an_engine_replaces_the_common_list(tmp_path):
    spec = spec_of(tmp_path, WHOLE)
    assert spec.setting_lists("mujoco") == {
        "preset": ["contact", "stack"],
        "timestep_s": [0.001, 0.0005],
        "iterations": [20, 50, 100],
    }
    assert spec.setting_lists("rapier")["iterations"] == [10]
    assert len(list(spec.setting_choices("mujoco"))) == 2 * 2 * 3


def test_the_count_is_the_product_of_all_lists(tmp_path):
    spec = spec_of(tmp_path, WHOLE)
    assert spec.episode_count() == (2 * 2 * 3 + 2 * 2 * 1) * 4 * 2 * 4
    jitter = spec.start_jitter
    assert (
        jitter is not None
        and jitter.position_m == 0.002
        and jitter.velocity_m_per_s == 0.0
    )


def test_a_task_file_is_beside_the_sweep_file(tmp_path):
    assert spec_of(tmp_path, 'variants = ["crate.toml"]').variants == [
        str(tmp_path / "crate.toml")
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("backends = [", "not a TOML file"),
        ("\x00", "not a TOML file"),
        (
            SLIDE + "backend = ['mujoco']",
            "backend: unknown key; keys: backends, variants, presets",
        ),
        ("repeats = 2", "variants: missing key; keys: backends"),
        (SLIDE + "backends = 'mujoco'", "backends: "),
        (SLIDE + "backends = []", "backends: "),
        ("variants = []", "variants: "),
        (SLIDE + "presets = []", "presets: "),
        (SLIDE + "parameters = []", "parameters: "),
        (
            SLIDE + "parameters = [3]",
            "parameters: 3: the name of a parameter set is expected",
        ),
        (SLIDE + "repeats = '4'", "repeats: "),
        (SLIDE + "repeats = true", "repeats: "),
        (SLIDE + "repeats = 0", "repeats: "),
        (SLIDE + "seed = -1", "seed: "),
        (SLIDE + "jitter = 1", "jitter: "),
        (
            SLIDE + "[jitter]\nposition_mm = 1.0",
            "jitter.position_mm: unknown key; keys: position_m, angle_rad",
        ),
        (SLIDE + "[jitter]\nposition_m = nan", "jitter.position_m: "),
        (
            SLIDE + "[settings]\ntimestep_s = 0.1",
            "settings.timestep_s: a list of one or more values is expected",
        ),
        (
            SLIDE + "[settings]\ntimestep_s = []",
            "settings.timestep_s: a list of one or more values is expected",
        ),
        (
            SLIDE + "[settings]\ntimestep_s = [nan]",
            "settings.timestep_s: nan is no finite number",
        ),
        (
            SLIDE + "[settings]\ntimestep_s = [{ a = 1 }]",
            "settings.timestep_s: {'a': 1} is no finite number",
        ),
        (
            SLIDE + "[settings.bullet]\niterations = [1]",
            "settings.bullet: a table of an engine that backends does not",
        ),
        (
            SLIDE + "[settings.mujoco]\niterations = 1",
            "settings.mujoco.iterations: a list of one or more values",
        ),
    ],
)
def test_a_wrong_file_is_named_with_key_and_reason(tmp_path, text, message):
    with pytest.raises(SweepFileError) as caught:
        spec_of(tmp_path, text)
    assert str(caught.value).startswith(str(tmp_path / "sweep.toml"))
    assert message in str(caught.value)


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    for path in (tmp_path / "none.toml", tmp_path):
        with pytest.raises(SweepFileError, match="cannot be read"):
            load_sweep_file(path)


def test_keywords_are_checked_as_a_file_is():
    with pytest.raises(ParameterError, match="unknown key; keys: backends"):
        sweep_spec({"variants": ["SlopeSlider-2-wood"], "engines": ["mujoco"]})
