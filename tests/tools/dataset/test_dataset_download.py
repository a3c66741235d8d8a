"""Downloading the dataset from a host that is not there: what it is asked for, and what its errors become."""

import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from dataset_writer import trial_folder, write_synthetic

from gauge_envs.errors import DatasetError, MissingExtraError
from gauge_envs.references.user_data import user_data_folder
from gauge_envs.tools.dataset.download import (
    DATASET,
    PINNED_REVISION,
    download_dataset,
    resolved_revision,
)
from gauge_envs.tools.dataset.layout import find_trials

COMMIT = PINNED_REVISION + 33 * "1"
OTHER = 40 * "2"
NAME = "SlopeSlider-1-wood"


class FakeHub:
    """Stands in for the package `huggingface_hub`; a snapshot writes the synthetic trials of one experiment."""

    def __init__(self):
        self.calls = []
        self.commits = [OTHER, COMMIT]
        self.error = None

    def HfApi(self):  # noqa: N802  # the package's own name
        return SimpleNamespace(list_repo_commits=self._commits, dataset_info=self._info)

    def _commits(self, repo_id, *, repo_type):
        assert (repo_id, repo_type) == (DATASET, "dataset")
        return [SimpleNamespace(commit_id=commit) for commit in self.commits]

    def _info(self, repo_id, *, revision):
        commits = {"main": OTHER, OTHER: OTHER, COMMIT: COMMIT}
        if revision not in commits:
            raise ValueError(f"404: no revision {revision}")
        return SimpleNamespace(sha=commits[revision])

    def snapshot_download(self, **arguments):
        self.calls.append(arguments)
        if self.error is not None:
            raise self.error
        write_synthetic(arguments["local_dir"], NAME)
        return str(arguments["local_dir"])


@pytest.fixture
def hub(monkeypatch):
    fake = FakeHub()
    monkeypatch.setitem(sys.modules, "huggingface_hub", fake)
    return fake


@pytest.fixture
def run(gauge):
    return lambda *words: gauge("data", "download", *words)


def test_the_pinned_revision_is_fetched_and_noted(hub, run):
    result = run()
    assert result.exit_code == 0
    assert f"revision {PINNED_REVISION} is {COMMIT}" in result.stderr
    folder = Path(result.stdout.strip())
    assert folder == user_data_folder() / "dataset" / COMMIT[:12]
    (call,) = hub.calls
    assert call == {
        "repo_id": DATASET,
        "repo_type": "dataset",
        "revision": COMMIT,
        "local_dir": folder,
        "allow_patterns": ["data/*/json/*.json"],
    }
    layout = find_trials(folder)
    assert layout.revision == COMMIT and layout.count == 4
    assert find_trials(folder / "data").revision == COMMIT


def test_patterns_revision_and_folder_are_passed_on(hub, tmp_path, run):
    pattern = f"{trial_folder(NAME)}/*"
    assert (
        run(pattern, "metadata/*", f"--revision={OTHER}", "--out", tmp_path).exit_code
        == 0
    )
    (call,) = hub.calls
    assert (call["allow_patterns"], call["revision"], call["local_dir"]) == (
        [pattern, "metadata/*"],
        OTHER,
        tmp_path,
    )


def test_revisions_are_resolved_to_full_hashes(hub):
    assert resolved_revision("9e0acb7") == COMMIT
    assert resolved_revision("main") == OTHER
    assert resolved_revision(OTHER) == OTHER
    for unknown in (40 * "5", "v9", "abcdef0"):
        with pytest.raises(DatasetError, match=f"'{unknown}' cannot be resolved"):
            resolved_revision(unknown)
    hub.commits.append(PINNED_REVISION + 33 * "3")
    with pytest.raises(DatasetError, match="is ambiguous"):
        resolved_revision(PINNED_REVISION)


def test_a_broken_download_says_how_to_go_on(hub, tmp_path, run):
    hub.error = ConnectionError("the host is gone")
    result = run("--out", tmp_path)
    assert result.exit_code == 2
    assert (
        "ConnectionError: the host is gone; the same command continues the download"
        in result.stderr
    )
    hub.error = None
    assert run("--out", tmp_path).exit_code == 0


def test_without_the_client_the_extra_is_named(monkeypatch, run):
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'gauge-envs\[data\]'"):
        download_dataset()
    assert run().exit_code == 2
