"""One wrong task file is named, and the others stay usable; a scene that cannot be built is found when it is loaded."""

import json
import shutil

import pytest
from places import ROOT

from gauge_envs import load_experiment, load_experiment_file
from gauge_envs.errors import ReferenceFileError, TaskFileError, UnknownNameError
from gauge_envs.experiments import variants as module
from gauge_envs.experiments.task_files import load_task, task_file_faults, task_spec
from gauge_envs.experiments.variants import task_path, variants
from gauge_envs.tools.catalog import overview

EXAMPLE = ROOT / "examples" / "usd_experiment"


def test_a_scene_that_cannot_be_built_is_found(tmp_path):
    text = task_path("SlopeSlider").read_text()
    file = tmp_path / "slope_slider.toml"
    file.write_text(text.replace('board = "kinematic"', 'board = "dynamic"'))
    assert file.read_text() != text
    with pytest.raises(
        TaskFileError,
        match=r"slope_slider\.toml: drivers: 'board' is driven but dynamic",
    ):
        load_task(file)


@pytest.fixture
def tasks(tmp_path, monkeypatch):
    """A copy of the folder of task files, which is read in place of the package's."""
    folder = tmp_path / "tasks"
    shutil.copytree(task_path("Pendulum").parent, folder)
    for reader in (module, overview):
        monkeypatch.setattr(
            reader, "task_files", lambda: tuple(sorted(folder.glob("*.toml")))
        )
    cached = (module._read_files, variants, task_spec)
    for function in cached:
        function.cache_clear()
    yield folder
    monkeypatch.undo()
    for function in cached:
        function.cache_clear()


# How the file is broken, and what the error says.
BREAKS = {
    "no TOML": (b"family = ", "cannot be read: "),
    "no text": (b"\xff", "cannot be read: "),
    "no materials": (
        b'family = "Pendulum"',
        "cannot be read: materials: a list of names is expected",
    ),
    "no family": (b"family = 3", "cannot be read: family: a name is expected"),
    "no task": (b'family = "Pendulum"\nmaterials = ["metal"]', "missing key"),
    "deep": (b"a = " + b"[" * 9999, "nested too deeply"),
}


def test_a_list_names_a_wrong_file_and_has_the_others(tasks, gauge):
    (tasks / "pendulum.toml").write_bytes(b"family = ")
    result = gauge("list", "--json")
    assert result.exit_code == 1
    families = {json.loads(line)["family"] for line in result.stdout.splitlines()}
    assert len(families) == 21 and "Pendulum" not in families
    assert "skipped:" in result.stderr and "pendulum.toml" in result.stderr


@pytest.mark.parametrize("broken", BREAKS)
def test_one_wrong_file_is_named_and_the_others_are_of_use(broken, tasks):
    content, reason = BREAKS[broken]
    (tasks / "pendulum.toml").write_bytes(content)
    (fault,) = task_file_faults().values()
    assert "pendulum.toml" in str(fault) and reason in str(fault)
    assert load_experiment("SlopeSlider-2-wood").frame_count == 19
    with pytest.raises(TaskFileError, match=r"pendulum\.toml"):
        load_experiment("Pendulum-metal")
    with pytest.raises(UnknownNameError):
        load_experiment("Nothing-wood")


# --- experiment files ------------------------------------------------------------------------------------------------


@pytest.fixture
def crate(tmp_path):
    """A copy of the example."""
    shutil.copytree(EXAMPLE, tmp_path / "example")
    return tmp_path / "example" / "crate.toml"


@pytest.mark.parametrize("frames", [18_001, 10**9, 10**30])
def test_the_number_of_frames_is_limited(frames, crate):
    lines = [
        line if not line.startswith("frames") else f"frames = {frames}"
        for line in crate.read_text().splitlines()
    ]
    crate.write_text("\n".join(lines))
    with pytest.raises(TaskFileError, match=r"crate\.toml: frames: "):
        load_experiment_file(crate)


def test_a_number_that_python_cannot_write_is_an_error(crate):
    crate.write_text(
        crate.read_text().replace("frames = ", f"frames = 0x{'f' * 9000} # ")
    )
    with pytest.raises(TaskFileError, match=r"crate\.toml: frames: "):
        load_experiment_file(crate)


def test_an_error_of_a_band_prints_no_text_of_the_file(crate, tmp_path):
    private = tmp_path / "private.csv"
    private.write_text("root:secret:0,frame\n1,2\n")
    band = next(
        line for line in crate.read_text().splitlines() if line.startswith("file = ")
    )
    crate.write_text(crate.read_text().replace(band, f'file = "{private}"'))
    with pytest.raises(ReferenceFileError) as caught:
        load_experiment_file(crate)
    assert "columns are frame and 1 unknown ones" in str(
        caught.value
    ) and "secret" not in str(caught.value)
