"""Where the data folders lie, in a checkout and in an installed wheel alike."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

__all__ = [
    "data_folder",
    "json_ready",
    "versions",
]


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


def json_ready(value: Any) -> Any:
    """Plain containers, None for numbers that are not finite: JSON has neither NaN nor infinity."""
    if isinstance(value, Mapping):
        return {str(key): json_ready(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [json_ready(entry) for entry in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value


def versions() -> dict[str, str]:
    """Versions of gauge-envs, gymnasium, numpy and python."""
    packages = {name: version(name) for name in ("gauge-envs", "gymnasium", "numpy")}
    return packages | {"python": platform.python_version()}
