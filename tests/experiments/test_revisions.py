"""A change of what decides scores raises the revision of its experiment."""

import json

import pytest

from gauge_envs.experiments.task_files import task_spec
from gauge_envs.files import data_folder
from scripts.build_revisions import LEDGER, current
from scripts.generated import not_raised
from scripts.inputs import task_digest


def test_what_decides_scores_changes_only_with_the_revision():
    stated, found = json.loads(LEDGER.read_text()), current()
    assert not_raised(stated, found, "revision") == [], (
        "scores may change: raise `revision` in the task file"
    )
    assert stated == found, "run `python -m scripts build revisions`"


def test_a_change_without_a_raise_is_found():
    found = current()
    revision = found["SlopeSlider"]["revision"]
    earlier = {"SlopeSlider": {"revision": revision, "digest": "0"}}
    assert not_raised(earlier, found, "revision") == ["SlopeSlider"]
    raised = found | {"SlopeSlider": {"revision": revision + 1, "digest": "1"}}
    assert not_raised(earlier, raised, "revision") == []


@pytest.mark.parametrize(
    ("old", "new", "changes"),
    [
        ("friction = 0.273673", "friction = 0.28", True),
        ("wood = 46", "wood = 47", True),
        ('title = "Slope slider"', 'title = "Slope"', False),
    ],
)
def test_the_digest_knows_numbers_from_texts(old, new, changes, tmp_path):
    task = data_folder("tasks") / "slope_slider.toml"
    text = task.read_text()
    assert old in text
    edited = tmp_path / "slope_slider.toml"
    edited.write_text(text.replace(old, new, 1))
    assert (task_digest(edited) != task_digest(task)) is changes


def test_a_task_file_states_its_revision():
    assert task_spec("SlopeSlider").revision == current()["SlopeSlider"]["revision"]
