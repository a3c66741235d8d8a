"""Bundled or imported data: the choice, and the folder of imports, in a module that imports nothing heavy."""

import os
from enum import StrEnum
from pathlib import Path

from gauge_envs.errors import DatasetError


class DataSource(StrEnum):
    """Source of driven motion or of the band. An argument selects it; an import alone changes nothing."""

    BUNDLED = "bundled"
    """The package: the task file's drivers, the bundled bands and laws."""
    IMPORTED = "imported"
    """The real trials that `gauge data import` read."""
    ACTION = "action"
    """No recorded motion: driven bodies rest until actions move them. A band has no such source."""


BUNDLED_DATA = {
    "drivers": DataSource.BUNDLED.value,
    "reference": DataSource.BUNDLED.value,
}
"""Data sources of a result that uses no import."""


def user_data_folder() -> Path:
    """Return the folder of imported data, which need not exist."""
    given = os.environ.get("GAUGE_DATA_DIR")
    if not given:
        from platformdirs import user_data_path

        return user_data_path("gauge-envs", appauthor=False)
    try:
        return Path(given).expanduser()
    except RuntimeError:
        raise DatasetError(
            f"GAUGE_DATA_DIR={given}: the home folder is unknown. Set the full path."
        ) from None


def trials_folder() -> Path:
    """Return the folder of imported trials, which need not exist."""
    return user_data_folder() / "trials"


def has_import(variant: str) -> bool:
    """Return whether trials of a variant were imported, without reading them."""
    return (trials_folder() / f"{variant}.toml").is_file()
