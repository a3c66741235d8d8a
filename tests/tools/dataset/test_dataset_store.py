"""What an import reads: links, folders that cannot be read, doubled frames."""

import os
from pathlib import Path

import pytest
from dataset_writer import AMOUNTS, synthetic_trials, trial_folder, write_synthetic
from imports import import_contents, imported as imported_trials

from gauge_envs.errors import DatasetError
from gauge_envs.references.user_data import user_data_folder
from gauge_envs.tools.dataset.layout import find_trials

NAME = "SlopeSlider-1-wood"


def test_links_of_a_download_cache_are_read(tmp_path):
    root = tmp_path / "snapshots" / "abc"
    write_synthetic(root, NAME)
    (tmp_path / "blobs").mkdir()
    for number, file in enumerate(sorted((root / trial_folder(NAME)).iterdir())):
        file.rename(tmp_path / "blobs" / str(number))
        file.symlink_to(tmp_path / "blobs" / str(number))
    one = imported_trials(root)[NAME]
    assert (one.used, one.left_out) == (4, 0)


def test_a_folder_that_cannot_be_read_is_reported(tmp_path, monkeypatch):
    write_synthetic(tmp_path, NAME)
    closed = tmp_path / trial_folder("SlopeSlider-1-metal")
    closed.mkdir(parents=True)
    scandir = os.scandir

    def refused(path="."):
        if Path(path) == closed:
            raise PermissionError(13, "Permission denied", str(path))
        return scandir(path)

    # The owner of a container's files may read all of them, whatever their mode.
    monkeypatch.setattr(os, "scandir", refused)
    (finding,) = find_trials(tmp_path).findings
    assert finding.file == closed.relative_to(tmp_path).as_posix()
    assert (
        finding.problem == "it cannot be read: Permission denied" and finding.left_out
    )


@pytest.mark.parametrize("first", [0, 1])
def test_a_trial_of_doubled_frames_is_noted(first, tmp_path):
    contents = synthetic_trials(NAME, [*AMOUNTS, 0.3]).contents
    cube = contents[-1]["cube"]
    contents[-1]["cube"] = {
        key: [*values[:first], *(value for value in values for _ in range(2))]
        for key, values in cube.items()
    }
    one = import_contents(tmp_path, NAME, contents)
    assert (one.used, one.left_out) == (5, 0)
    (finding,) = one.findings
    assert finding.problem == "every frame occurs twice" and not finding.left_out


def test_the_home_of_nobody_is_an_error(monkeypatch):
    monkeypatch.setenv("GAUGE_DATA_DIR", "~nosuchuser/x")
    with pytest.raises(
        DatasetError, match="GAUGE_DATA_DIR=~nosuchuser/x: the home folder is unknown"
    ):
        user_data_folder()
