"""Where the data folders lie, in a checkout and in an installed wheel alike."""

from __future__ import annotations

from pathlib import Path

__all__ = ["data_folder"]


def data_folder(name: str) -> Path:
    """Folder `tasks`, `scoring` or `assets`: inside the installed package, or beside it in a checkout.

    Raises:
        FileNotFoundError: The installation lacks the folder.
    """
    package = Path(__file__).parent
    for folder in (package / name, package.parent / name):
        if folder.is_dir() and not (folder / "__init__.py").exists():
            return folder
    raise FileNotFoundError(f"gauge-envs is installed without its {name!r} folder (looked in {package} and beside it)")
