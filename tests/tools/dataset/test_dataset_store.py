"""The store of imports: two imports at once, killed imports, links and folders that lead elsewhere."""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from dataset_writer import synthetic_trials, trial_folder, write_synthetic, write_trial

from gauge_envs.errors import DatasetError
from gauge_envs.references import imported
from gauge_envs.references.imported import load_imported
from gauge_envs.references.user_data import user_data_folder
from gauge_envs.tools.dataset.findings import TrialError
from gauge_envs.tools.dataset.importer import import_trials
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


def importing(root: Path, rounds: int) -> subprocess.Popen[str]:
    """Start a process that imports a dataset; it is ready when it has printed a line."""
    command = [sys.executable, "-c", IMPORT, str(root), str(rounds)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline() == "ready\n"
    return process


def stored_files() -> list[str]:
    """Names of the files of the store, without its lock."""
    return sorted(
        file.name
        for file in (user_data_folder() / "trials").iterdir()
        if file.name != ".lock"
    )


@pytest.mark.slow
def test_of_two_imports_at_once_one_counts(tmp_path: Path) -> None:
    means = []
    for number, amounts in enumerate(([0.0, 1.0], [4.0, 5.0])):
        write_synthetic(tmp_path / str(number), NAME, amounts)
        list(import_trials(find_trials(tmp_path / str(number))))
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


def test_an_import_waits_for_the_one_that_writes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second import starts between the two files of the first, where it would remove the first one's numbers."""
    for number, amounts in enumerate(([0.0, 1.0], [4.0, 5.0])):
        write_synthetic(tmp_path / str(number), NAME, amounts)
    second = threading.Thread(
        target=lambda: list(import_trials(find_trials(tmp_path / "1")))
    )
    write_whole = imported.write_whole

    def interrupted(file: Path, content: bytes) -> None:
        if file.suffix == ".json" and second.ident is None:
            second.start()
            second.join(0.5)
        write_whole(file, content)

    monkeypatch.setattr(imported, "write_whole", interrupted)
    list(import_trials(find_trials(tmp_path / "0")))
    second.join(10.0)
    assert load_imported(NAME).record.trial_count == 2
    assert len(stored_files()) == 2


def test_a_killed_import_leaves_the_old_or_the_new_and_no_litter(
    tmp_path: Path,
) -> None:
    """A few killed imports show that the next one cleans up."""
    for name in NAMES:
        write_synthetic(tmp_path, name)
    list(import_trials(find_trials(tmp_path)))
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
    list(import_trials(find_trials(tmp_path, only=[NAMES[1]])))
    assert stored_files() == expected


def test_a_link_that_leaves_the_dataset_is_left_out(tmp_path: Path) -> None:
    write_synthetic(tmp_path / "set", NAME)
    outside = tmp_path / "private.json"
    outside.write_text(json.dumps(synthetic_trials(NAME, [0.3]).contents[0]))
    (tmp_path / "set" / trial_folder(NAME) / "trial-9.json").symlink_to(outside)
    (one,) = import_trials(find_trials(tmp_path / "set"))
    assert (one.used, one.left_out) == (4, 1)
    assert one.findings[0].problem == "it links to a file outside of the dataset"


def test_links_of_a_download_cache_are_read(tmp_path: Path) -> None:
    root = tmp_path / "snapshots" / "abc"
    write_synthetic(root, NAME)
    (tmp_path / "blobs").mkdir()
    for number, file in enumerate(sorted((root / trial_folder(NAME)).iterdir())):
        file.rename(tmp_path / "blobs" / str(number))
        file.symlink_to(tmp_path / "blobs" / str(number))
    (one,) = import_trials(find_trials(root))
    assert (one.used, one.left_out) == (4, 0)


def test_a_folder_that_cannot_be_read_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_synthetic(tmp_path, NAME)
    closed = tmp_path / trial_folder("SlopeSlider-1-metal")
    closed.mkdir(parents=True)
    scandir = os.scandir

    def refused(path: str | Path = ".") -> object:
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


@pytest.mark.parametrize("make", ["fifo", "sparse"])
def test_a_special_file_is_left_out(make: str, tmp_path: Path) -> None:
    write_synthetic(tmp_path, NAME)
    file = tmp_path / trial_folder(NAME) / "trial-9.json"
    if make == "fifo":
        os.mkfifo(file)
    else:
        with file.open("wb") as stream:
            stream.truncate(10**12)
    (one,) = import_trials(find_trials(tmp_path))
    assert (one.used, one.left_out) == (4, 1)
    assert one.findings[0].problem.startswith("it cannot be read: it ")


def test_many_keys_take_little_time() -> None:
    """At most 30 times as long as Python's parser, where a search over all earlier keys would take thousands."""
    content = (
        '{"FPS": 30, ' + ",".join(f'"k{n}": 1' for n in range(200_000)) + ', "k7": 1}'
    ).encode()
    start = time.process_time()
    json.loads(content)
    parsed = time.process_time()
    with pytest.raises(TrialError, match="k7: the key occurs twice"):
        parse_trial(content)
    assert time.process_time() - parsed < 30.0 * (parsed - start)


@pytest.mark.parametrize("first", [0, 1])
def test_a_trial_of_doubled_frames_is_noted(first: int, tmp_path: Path) -> None:
    write_synthetic(tmp_path, NAME)
    (content,) = synthetic_trials(NAME, [0.3]).contents
    content["cube"] = {
        key: [*values[:first], *(value for value in values for _ in range(2))]
        for key, values in content["cube"].items()
    }
    write_trial(tmp_path, NAME, 9, content)
    (one,) = import_trials(find_trials(tmp_path))
    assert (one.used, one.left_out) == (5, 0)
    assert [(finding.problem, finding.left_out) for finding in one.findings] == [
        ("every frame occurs twice", False)
    ]


def test_the_home_of_nobody_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GAUGE_DATA_DIR", "~nosuchuser/x")
    with pytest.raises(
        DatasetError, match="GAUGE_DATA_DIR=~nosuchuser/x: the home folder is unknown"
    ):
        user_data_folder()
