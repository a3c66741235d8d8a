"""Download the GAUGE dataset; only this module needs a network and the extra `data`."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gauge_envs.errors import DatasetError, needs_extra
from gauge_envs.references.user_data import user_data_folder
from gauge_envs.tools.dataset.layout import write_revision

DATASET = "InternRobotics/GAUGE-Dataset"
"""The dataset on Hugging Face (MIT licence)."""

PINNED_REVISION = "9e0acb7"
"""Short hash of the revision that the bundled facts are from."""

TRIAL_FILES = "data/*/json/*.json"
"""Files that an import reads; a star also matches slashes."""

SHORT_HASH = re.compile(r"[0-9a-f]{4,39}")
FULL_HASH = re.compile(r"[0-9a-f]{40}")


def download_dataset(
    folder: Path | None = None,
    *,
    patterns: Sequence[str] = (TRIAL_FILES,),
    revision: str = PINNED_REVISION,
) -> tuple[Path, str]:
    """Download the dataset, or continue an interrupted download.

    Args:
        folder: Folder to download to; by default a folder in the user's data folder.
        patterns: Shell-style patterns of the files in the dataset.
        revision: Commit, short or in full, branch or tag.

    Returns:
        The folder, in which a file states the revision for the import; and the full hash of the revision.
    """
    hub = _hub()
    commit = resolved_revision(revision)
    folder = (
        folder if folder is not None else user_data_folder() / "dataset" / commit[:12]
    )
    try:
        hub.snapshot_download(
            repo_id=DATASET,
            repo_type="dataset",
            revision=commit,
            local_dir=folder,
            allow_patterns=list(patterns),
        )
        write_revision(folder, commit)
    except Exception as error:  # The client raises the errors of its HTTP library, which differ between versions.
        raise DatasetError(
            f"{DATASET}: cannot be downloaded to {folder}: {_cause(error)}; the same command continues the download"
        ) from error
    return folder, commit


def resolved_revision(revision: str) -> str:
    """Return the full commit hash of a revision.

    The host resolves branches, tags and full hashes. A short hash is looked up among the commits of the main branch.
    Full hashes are resolved too, since without the host the client takes an unfinished folder for a whole download.
    """
    api = _hub().HfApi()
    try:
        if SHORT_HASH.fullmatch(revision):
            commits = [
                commit.commit_id
                for commit in api.list_repo_commits(DATASET, repo_type="dataset")
            ]
            matching = [commit for commit in commits if commit.startswith(revision)]
            if len(matching) == 1:
                return str(matching[0])
            if matching:
                raise DatasetError(
                    f"{DATASET}: revision {revision!r} is ambiguous: {', '.join(matching)}"
                )
        found = api.dataset_info(DATASET, revision=revision).sha
    except DatasetError:
        raise
    except Exception as error:  # As in `download_dataset`.
        raise DatasetError(
            f"{DATASET}: revision {revision!r} cannot be resolved: {_cause(error)}"
        ) from error
    if not isinstance(found, str) or not FULL_HASH.fullmatch(found):
        raise DatasetError(
            f"{DATASET}: revision {revision!r} resolves to {found!r}, which is no commit"
        )
    return found


def _cause(error: Exception) -> str:
    lines = str(error).strip().splitlines()
    return f"{type(error).__name__}: {lines[0]}" if lines else type(error).__name__


def _hub() -> Any:
    with needs_extra("gauge data download", "data"):
        import huggingface_hub
    return huggingface_hub
