"""A material that is added to a task file, as the guide describes, gives ids that run without a score."""

import re
import shutil

import pytest

from gauge_envs import GaugeEnv, load_experiment, load_task, reference_band
from gauge_envs.experiments import task_files, variants
from gauge_envs.files import data_folder

EDITS = (
    (
        'materials = ["wood", "plastic", "metal"]',
        'materials = ["wood", "plastic", "metal", "glass"]',
    ),
    (
        "[constants.cube]\n",
        "[constants.cube]\nglass = { mass_kg = 0.31, friction = 0.20, restitution = 0.5 }\n",
    ),
    (
        "{ wood = 19, plastic = 17, metal = 19 }",
        "{ wood = 19, plastic = 17, metal = 19, glass = 19 }",
    ),
    (
        "{ wood = 46, plastic = 46, metal = 60 }",
        "{ wood = 46, plastic = 46, metal = 60, glass = 46 }",
    ),
    ('metal = "video" }', 'metal = "video", glass = "nominal" }'),
    (
        "[provenance]\n",
        '[provenance]\n"constants.cube.glass" = "nominal: a guess for this example"\n',
    ),
)


@pytest.fixture
def tasks_with_glass(tmp_path, monkeypatch):
    """A copy of the task files, with a glass cube on the slope."""
    folder = tmp_path / "tasks"
    shutil.copytree(data_folder("tasks"), folder)
    file = folder / "slope_slider.toml"
    text = file.read_text()
    for old, new in EDITS:
        assert text.count(old) == 1
        text = text.replace(old, new)
    starts = r"\[subtasks\.(\d)\.initial\.wood\]\n((?:\w.*\n)+)"
    text, count = re.subn(starts, r"\g<0>\n[subtasks.\1.initial.glass]\n\2", text)
    assert count == 3
    file.write_text(text)
    with (folder / variants.INDEX_FILE).open("a") as index:
        for subtask, frames in (("1", 9), ("2", 19), ("3", 46)):
            index.write(
                f"slope_slider.toml,SlopeSlider,{subtask},glass,gauge,{frames}\n"
            )
    caches = (
        variants._read_files,
        variants.variants,
        task_files.task_spec,
        task_files.task_sha256,
    )
    monkeypatch.setattr(variants, "data_folder", lambda name: tmp_path / name)
    for cache in caches:
        cache.cache_clear()
    yield folder
    monkeypatch.undo()
    for cache in caches:
        cache.cache_clear()


@pytest.mark.parametrize("subtask", ["1", "2", "3"])
def test_a_new_material_runs_without_a_score(subtask, tasks_with_glass):
    name = f"SlopeSlider-{subtask}-glass"
    assert name in [variant.name for variant in variants.variants()]
    experiment = load_experiment(name)
    assert experiment.scene.body("cube").mass_kg == 0.31
    assert reference_band(experiment) is None
    env = GaugeEnv(name)
    env.reset(seed=0)
    *_, info = env.step(env.action_space.sample() * 0)
    assert info["reference"] == "none"


def test_the_longer_key_states_where_new_numbers_are_from(tasks_with_glass):
    spec = load_task(tasks_with_glass / "slope_slider.toml")
    assert spec.provenance_of("constants.cube.glass.mass_kg").startswith("nominal")
    assert spec.provenance_of("constants.cube.wood.mass_kg") == "metadata"
