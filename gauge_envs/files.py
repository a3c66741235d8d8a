"""Find the data folders of a checkout or a wheel, write files whole, and prepare values for JSON."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from secrets import token_hex
from typing import Any

import numpy as np

__all__ = ["data_folder", "json_ready", "versions", "write_whole"]


def data_folder(name: str) -> Path:
    """Return the folder `tasks`, `scoring` or `assets`, inside the installed package or beside it in a checkout.

    Raises:
        FileNotFoundError: The installation lacks the folder.
    """
    package = Path(__file__).parent
    for folder in (package / name, package.parent / name):
        if folder.is_dir() and not (folder / "__init__.py").exists():
            return folder
    raise FileNotFoundError(f"gauge-envs is installed without its {name!r} folder (looked in {package} and beside it)")


def json_ready(value: Any) -> Any:
    """Return a value in plain containers, with None for NaN and infinity, which JSON lacks."""
    if isinstance(value, Mapping):
        return {str(key): json_ready(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [json_ready(entry) for entry in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value


def versions() -> dict[str, str]:
    """Return the versions of gauge-envs, gymnasium, numpy and python."""
    packages = {name: version(name) for name in ("gauge-envs", "gymnasium", "numpy")}
    return packages | {"python": platform.python_version()}


def write_whole(file: Path, content: bytes) -> None:
    """Write a file whole or not at all: a reader finds the old content or the new one.

    Raises:
        OSError: The file cannot be written; an older one is unchanged.
    """
    part = file.with_name(f".{file.name}.{token_hex(8)}.tmp")
    try:
        with part.open("xb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        part.replace(file)
    finally:
        part.unlink(missing_ok=True)
