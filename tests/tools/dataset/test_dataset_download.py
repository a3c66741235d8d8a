"""Requests and errors of a download of the dataset from a simulated host."""

import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from dataset_writer import write_synthetic

from gauge_envs.errors import DatasetError, MissingExtraError
from gauge_envs.references.user_data import user_data_folder
from gauge_envs.tools.dataset.download import (
    DATASET,
    PINNED_REVISION,
    resolved_revision,
)
from gauge_envs.tools.dataset.layout import find_trials

COMMIT = PINNED_REVISION + 33 * "1"
HEAD = 40 * "2"


class FakeHub:
    """Replacement for the package `huggingface_hub`; a snapshot writes the synthetic trials of one experiment."""

    def __init__(self):
        self.calls = []
        self.commits = [HEAD, COMMIT]
        self.error = None

    def HfApi(self):  # noqa: N802  # name in the package
        return SimpleNamespace(list_repo_commits=self._commits, dataset_info=self._info)

    def _commits(self, repo_id, *, repo_type):
        assert (repo_id, repo_type) == (DATASET, "dataset")
        return [SimpleNamespace(commit_id=commit) for commit in self.commits]

    def _info(self, repo_id, *, revision):
        return SimpleNamespace(sha={"main": HEAD, HEAD: HEAD}[revision])

    def snapshot_download(self, **arguments):
        self.calls.append(arguments)
        if self.error is not None:
            raise self.error
        write_synthetic(arguments["local_dir"], "SlopeSlider-1-wood")


@pytest.fixture
def hub(monkeypatch):
    fake = FakeHub()
    monkeypatch.setitem(sys.modules, "huggingface_hub", fake)
    return fake


def test_the_pinned_revision_is_downloaded_and_noted(hub, gauge):
    result = gauge("data", "download")
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
    assert find_trials(folder).revision == COMMIT
    assert find_trials(folder / "data").revision == COMMIT


def test_an_interrupted_download_continues_with_the_same_command(hub, tmp_path, gauge):
    words = ("data", "download", "metadata/*", f"--revision={HEAD}", "--out", tmp_path)
    hub.error = ConnectionError("the host is gone")
    result = gauge(*words)
    assert result.exit_code == 2
    assert "host is gone; the same command continues the download" in result.stderr
    hub.error = None
    assert gauge(*words).exit_code == 0
    assert hub.calls[0] == hub.calls[1]
    assert (call := hub.calls[0])["local_dir"] == tmp_path
    assert (call["revision"], call["allow_patterns"]) == (HEAD, ["metadata/*"])


def test_revisions_are_resolved_to_full_hashes(hub, monkeypatch):
    assert resolved_revision("9e0acb7") == COMMIT
    assert resolved_revision("main") == HEAD
    hub.commits.append(PINNED_REVISION + 33 * "3")
    for unknown in ("v9", PINNED_REVISION):
        with pytest.raises(DatasetError, match=f"'{unknown}' cannot be resolved"):
            resolved_revision(unknown)
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    with pytest.raises(MissingExtraError, match=r"pip install .*\[data\]'"):
        resolved_revision("main")
