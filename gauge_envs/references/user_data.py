"""Data of the user: imported trials, and task files with bands; this module imports nothing heavy."""

import os
from contextlib import suppress
from enum import StrEnum
from pathlib import Path

from gauge_envs.errors import DatasetError
from gauge_envs.files import is_folder
from gauge_envs.reading import content_of
from gauge_envs.text import toml_document

OWN_TASKS = "GAUGE_TASKS"
"""Environment variable that lists task files of the user and folders with them, separated as in `PATH`."""


class DataSource(StrEnum):
    """Source of driven motion or of the band. Arguments select it; an import alone changes nothing."""

    BUNDLED = "bundled"
    """The package: the task file's drivers, the bundled bands and laws."""
    IMPORTED = "imported"
    """The real trials that `gauge data import` read."""
    ACTION = "action"
    """No recorded motion: driven bodies rest until actions move them. Bands do not have this source."""


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


def imported_file(variant: str) -> Path:
    """Return the file of the imported trials of a variant, which need not exist."""
    return user_data_folder() / "trials" / f"{variant}.npz"


def has_import(variant: str) -> bool:
    """Return whether trials of a variant were imported, without reading them."""
    return imported_file(variant).is_file()


def own_task_files() -> tuple[Path, ...]:
    """Return the task files in `GAUGE_TASKS`, in its order; a listed file need not exist."""
    paths: dict[Path, None] = {}
    for entry in os.environ.get(OWN_TASKS, "").split(os.pathsep):
        if not entry.strip():
            continue
        path = Path(entry).expanduser().absolute()
        folder_files = filter(_is_task_file, sorted(path.glob("*.toml")))
        paths |= dict.fromkeys(folder_files if is_folder(path) else [path])
    return tuple(paths)


def _is_task_file(path: Path) -> bool:
    """Return whether a TOML file is a task file; its folder may have other TOML files."""
    with suppress(OSError, ValueError):
        return "family" in toml_document(content_of(path))
    return False


def own_band_file(variant: str) -> Path | None:
    """Return the file `<id>.band.toml` next to a task file of the user; None without one."""
    files = (path.with_name(f"{variant}.band.toml") for path in own_task_files())
    return next((file for file in files if file.is_file()), None)
