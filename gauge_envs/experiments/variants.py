"""List the variants of the package: family, subtask and material.

This module reads names alone and imports no pydantic model, so that importing the package is quick.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from gauge_envs.errors import TaskFileError, UnknownNameError
from gauge_envs.files import data_folder

__all__ = ["Variant", "find_variant", "task_files", "task_path", "variants"]


@dataclass(frozen=True, order=True)
class Variant:
    """Family, subtask and material; the subtask is None for a family with one experiment."""

    family: str
    subtask: str | None
    material: str

    @property
    def name(self) -> str:
        """Name, as `SlopeSlider-2-wood`."""
        return "-".join(part for part in (self.family, self.subtask, self.material) if part)

    @property
    def id(self) -> str:
        """Gymnasium id, as `GAUGE/SlopeSlider-2-wood`."""
        return f"GAUGE/{self.name}"


def task_files() -> tuple[Path, ...]:
    """Return all task files, sorted by name."""
    return tuple(sorted(data_folder("tasks").glob("*.toml")))


@cache
def _headers() -> dict[str, tuple[Path, dict[str, Any]]]:
    """Return path and raw content of every task file, by family, without validation."""
    headers = {}
    for path in task_files():
        try:
            raw = tomllib.loads(path.read_text(encoding="utf-8"))
            headers[raw["family"]] = (path, raw)
        except (tomllib.TOMLDecodeError, KeyError) as error:
            raise TaskFileError(path, "family", f"cannot be read: {error}") from error
    return headers


def task_path(family: str) -> Path:
    """Return the path of a family's task file.

    Raises:
        UnknownNameError: No such family.
    """
    try:
        return _headers()[family][0]
    except KeyError:
        raise UnknownNameError("family", family, _headers()) from None


@cache
def variants() -> tuple[Variant, ...]:
    """Return all variants, in the order of the task files; a file is validated when one of its variants is loaded."""
    return tuple(
        Variant(family, subtask, material)
        for family, (_, raw) in _headers().items()
        for subtask in raw.get("subtasks") or {None: None}
        for material in raw["materials"]
    )


def find_variant(name: str) -> Variant:
    """Return the variant of a name or Gymnasium id.

    Raises:
        UnknownNameError: There is no such variant.
    """
    by_name = {variant.name: variant for variant in variants()}
    try:
        return by_name[name.removeprefix("GAUGE/")]
    except KeyError:
        raise UnknownNameError("experiment", name, by_name) from None
