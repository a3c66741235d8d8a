"""The folder of imported data, in a module that imports nothing heavy."""

import os
from pathlib import Path

from platformdirs import user_data_path

from gauge_envs.errors import DatasetError


def user_data_folder() -> Path:
    """Return the folder of imported data, which need not exist."""
    given = os.environ.get("GAUGE_DATA_DIR")
    if not given:
        return user_data_path("gauge-envs", appauthor=False)
    try:
        return Path(given).expanduser()
    except RuntimeError:
        raise DatasetError(f"GAUGE_DATA_DIR={given}: the home folder is unknown. Set the full path.") from None


def trials_folder() -> Path:
    """Return the folder of imported trials, which need not exist."""
    return user_data_folder() / "trials"


def has_import(variant: str) -> bool:
    """Return whether trials of a variant were imported, without reading them."""
    return (trials_folder() / f"{variant}.json").is_file()
