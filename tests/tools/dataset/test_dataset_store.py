"""The store of imports: two imports at once, killed imports, links and folders that lead elsewhere."""

import os
import random
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from dataset_writer import AMOUNTS, synthetic_trials, trial_folder, write_synthetic
from imports import import_contents, imported as imported_trials

from gauge_envs.errors import DatasetError
from gauge_envs.references import imported
from gauge_envs.references.imported import load_imported
from gauge_envs.references.user_data import user_data_folder
from gauge_envs.tools.dataset.findings import TrialError
from gauge_envs.tools.dataset.layout import find_trials
from gauge_envs.tools.dataset.trial import parse_trial

NAMES = ("SlopeSlider-1-wood", "SlopeSlider-2-wood")
NAME = NAMES[0]

IMPORT = """
import sys
from pathlib import Path
from gauge_envs.tools.dataset.importer import import_trials
from gauge_envs.tools.dataset.layout import find_trials
layout = find_trials(Path(sys.argv[1]))
print("ready", flush=True)
for _ in range(int(sys.argv[2])):
    list(import_trials(layout))
"""


def importing(root, rounds):
    """Start a process that imports a dataset; it is ready when it has printed a line."""
    command = [sys.executable, "-c", IMPORT, str(root), str(rounds)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "ready\n"
    return process


def stored_files():
    """Names of the files of the store, without its lock."""
    return sorted(
        file.name
        for file in (user_data_folder() / "trials").iterdir()
        if file.name != ".lock"
    )


@pytest.mark.slow
def test_of_two_imports_at_once_one_counts(tmp_path):
    means = []
    for number, amounts in enumerate(([0.0, 1.0], [4.0, 5.0])):
        write_synthetic(tmp_path / str(number), NAME, amounts)
        imported_trials(tmp_path / str(number))
        means.append(load_imported(NAME).band.mean)
    processes = [importing(tmp_path / str(number), 8) for number in range(2)]
    reads = 0
    while any(process.poll() is None for process in processes):
        mean = load_imported(NAME).band.mean
        assert any(np.array_equal(mean, one) for one in means)
        reads += 1
    assert reads > 0
    assert [process.returncode for process in processes] == [0, 0]
    assert any(np.array_equal(load_imported(NAME).band.mean, one) for one in means)
    assert len(stored_files()) == 2


def test_an_import_waits_for_the_one_that_writes(tmp_path, monkeypatch):
    """The second import starts between the two files of the first, where it would remove the first one's numbers."""
    for number, amounts in enumerate(([0.0, 1.0], [4.0, 5.0])):
        write_synthetic(tmp_path / str(number), NAME, amounts)
    second = threading.Thread(target=lambda: imported_trials(tmp_path / "1"))
    write_whole = imported.write_whole

    def interrupted(file, content):
        if file.suffix == ".json" and second.ident is None:
            second.start()
            second.join(0.5)
        write_whole(file, content)

    monkeypatch.setattr(imported, "write_whole", interrupted)
    imported_trials(tmp_path / "0")
    second.join(10.0)
    assert load_imported(NAME).record.trial_count == 2
    assert len(stored_files()) == 2


def test_a_killed_import_leaves_the_old_or_the_new_and_no_litter(tmp_path):
    """A few killed imports show that the next one cleans up."""
    for name in NAMES:
        write_synthetic(tmp_path, name)
    imported_trials(tmp_path)
    expected, chance = stored_files(), random.Random(0)
    for _ in range(3):
        process = importing(tmp_path, 1000)
        time.sleep(chance.uniform(0.0, 0.2))
        process.kill()
        process.wait()
        for name in NAMES:
            load_imported(name)
    folder = user_data_folder() / "trials"
    (folder / f".{NAME}.json.0123456789abcdef.tmp").write_bytes(b"half")
    (folder / f"{NAME}.0123456789abcdef.npz").write_bytes(b"orphan")
    imported_trials(tmp_path, NAMES[1])
    assert stored_files() == expected


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


def test_many_keys_take_little_time():
    """A search over all earlier keys would take half an hour."""
    keys = ",".join(f'"k{number}": 1' for number in range(200_000))
    content = f'{{"FPS": 30, {keys}, "k7": 1}}'.encode()
    with pytest.raises(TrialError, match="k7: the key occurs twice"):
        parse_trial(content)


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
