"""Download the GAUGE dataset; this module needs a network and the extra `data`."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from gauge_envs.errors import DatasetError
from gauge_envs.optional import needs_extra
from gauge_envs.references.user_data import user_data_folder
from gauge_envs.tools.dataset.layout import write_revision

DATASET = "InternRobotics/GAUGE-Dataset"
"""The dataset on Hugging Face (MIT licence)."""

PINNED_REVISION = "9e0acb7"
"""Short hash of the revision of the bundled facts."""

TRIAL_FILES = "data/*/json/*.json"
"""Files of an import; a star also matches slashes."""


def download_dataset(commit: str, folder: Path | None, patterns: Sequence[str]) -> Path:
    """Download the dataset, or continue an interrupted download.

    Args:
        commit: Full hash of the revision, from `resolved_revision`.
        folder: Folder of the download; by default a folder in the user's data folder.
        patterns: Shell-style patterns of the files in the dataset.

    Returns:
        The folder, with a file that names the revision.

    Raises:
        DatasetError: The download fails; the same call continues it.
        MissingExtraError: The client of the host is not installed.
    """
    folder = folder or user_data_folder() / "dataset" / commit[:12]
    client = _client()
    with _errors(
        f"cannot be downloaded to {folder}", "the same command continues the download"
    ):
        client.snapshot_download(
            repo_id=DATASET,
            repo_type="dataset",
            revision=commit,
            local_dir=folder,
            allow_patterns=list(patterns),
        )
        write_revision(folder, commit)
    return folder


def resolved_revision(revision: str) -> str:
    """Return the full commit hash of a revision.

    A short or full hash is looked up among the commits of the main branch. The host resolves branches and tags. Full
    hashes are resolved too: without the host, the client accepts an incomplete folder as a complete download.

    Args:
        revision: Commit, short or in full, branch or tag.

    Raises:
        DatasetError: The host does not know the revision, or cannot be reached.
        MissingExtraError: The client of the host is not installed.
    """
    api = _client().HfApi()
    with _errors(f"revision {revision!r} cannot be resolved", "check name and network"):
        commits = api.list_repo_commits(DATASET, repo_type="dataset")
        hashes = [str(commit.commit_id) for commit in commits]
        matching = [name for name in hashes if name.startswith(revision)]
        if len(matching) == 1:
            return matching[0]
        return str(api.dataset_info(DATASET, revision=revision).sha)


@contextmanager
def _errors(problem: str, advice: str) -> Iterator[None]:
    """Raise a DatasetError instead of any error, because errors of the client vary with its HTTP library."""
    try:
        yield
    except Exception as error:
        lines = str(error).strip().splitlines()
        cause = ": ".join([type(error).__name__, *lines[:1]])
        raise DatasetError(f"{DATASET}: {problem}: {cause}; {advice}") from error


def _client() -> Any:
    with needs_extra("gauge data download", "data"):
        import huggingface_hub
    return huggingface_hub
