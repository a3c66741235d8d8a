"""List the variants of the package: family, subtask and material.

This module reads names alone and imports no pydantic model, so that importing the package is quick.
"""

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import Any

from gauge_envs.errors import TaskFileError, UnknownNameError
from gauge_envs.files import MEGABYTE, data_folder, read_regular, toml_document


class Collection(StrEnum):
    """Where an experiment is from."""

    GAUGE = "gauge"
    """The GAUGE benchmark."""
    BEYOND = "beyond"
    """Real measurements of other authors; no count and no average of the benchmark contains them."""


@dataclass(frozen=True, order=True)
class Variant:
    """Family, subtask and material; the subtask is None for a family with one experiment."""

    family: str
    subtask: str | None
    material: str

    @property
    def name(self) -> str:
        """Name, as `SlopeSlider-2-wood`."""
        return "-".join(
            part for part in (self.family, self.subtask, self.material) if part
        )

    @property
    def id(self) -> str:
        """Gymnasium id, as `GAUGE/SlopeSlider-2-wood`."""
        return f"GAUGE/{self.name}"


def task_files() -> tuple[Path, ...]:
    """Return all task files, sorted by name."""
    return tuple(sorted(data_folder("tasks").glob("*.toml")))


@cache
def _read_files() -> tuple[
    dict[str, tuple[Path, dict[str, Any]]], tuple[TaskFileError, ...]
]:
    """Return path and names of every task file, by family, and the errors of files that cannot be read.

    A file is validated when one of its variants is loaded.
    """
    headers, faults = {}, []
    for path in task_files():
        try:
            raw = _names_of(read_regular(path, MEGABYTE))
            headers[_header(raw)] = (path, raw)
        except (OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) else error
            faults.append(
                TaskFileError(
                    path,
                    "(file)",
                    f"cannot be read: {reason}; correct or remove the file",
                )
            )
    return headers, tuple(faults)


def _names_of(content: bytes) -> dict[str, Any]:
    """Return the names in a task file: family, materials, collection and subtasks.

    All of it takes twenty times as long to parse, and `import gauge_envs` reads every file.
    """
    top, first, rest = content.partition(b"\n[")
    names = [
        line
        for line in top.splitlines()
        if line.startswith((b"family", b"materials", b"collection"))
    ]
    subtasks = [line for line in (first + rest).splitlines() if b"subtasks" in line]
    if b"subtasks" not in top and all(
        line.startswith((b"[subtasks.", b"[[subtasks.")) for line in subtasks
    ):
        with suppress(ValueError):
            raw = toml_document(b"\n".join((*names, *subtasks)))
            _header(raw)
            return raw
    return toml_document(content)


def _header(raw: dict[str, Any]) -> str:
    """Return the family of a task file, of which the names of its variants can be read."""
    family, materials, subtasks = (
        raw.get("family"),
        raw.get("materials"),
        raw.get("subtasks", {}),
    )
    if not isinstance(family, str):
        raise ValueError("family: a name is expected")
    if not (
        isinstance(materials, list)
        and materials
        and all(isinstance(name, str) for name in materials)
    ):
        raise ValueError("materials: a list of names is expected")
    if not isinstance(subtasks, dict):
        raise ValueError("subtasks: a table is expected")
    if raw.get("collection", Collection.GAUGE) not in tuple(Collection):
        raise ValueError(f"collection: one of {', '.join(Collection)} is expected")
    return family


def _headers() -> dict[str, tuple[Path, dict[str, Any]]]:
    return _read_files()[0]


def unreadable_task_files() -> tuple[TaskFileError, ...]:
    """Return an error for each task file whose names cannot be read; the variants of the others are listed."""
    return _read_files()[1]


def _unknown(
    kind: str, name: str, known: Iterable[str]
) -> TaskFileError | UnknownNameError:
    """Return the error for an unknown name: that of the unreadable task file which may define it, if there is one."""
    plain = name.removeprefix("GAUGE/").lower()
    for fault in unreadable_task_files():
        if plain.startswith(fault.file.stem.replace("_", "").lower()):
            return fault
    return UnknownNameError(kind, name, known)


def task_path(family: str) -> Path:
    """Return the path of a family's task file."""
    try:
        return _headers()[family][0]
    except KeyError:
        raise _unknown("family", family, _headers()) from None


@cache
def variants() -> tuple[Variant, ...]:
    """Return all variants of the benchmark, in the order of the task files.

    A file is validated when one of its variants is loaded.
    """
    return _variants_of(Collection.GAUGE)


@cache
def beyond_variants() -> tuple[Variant, ...]:
    """Return the variants beyond the benchmark, in the order of the task files."""
    return _variants_of(Collection.BEYOND)


def _variants_of(collection: Collection) -> tuple[Variant, ...]:
    return tuple(
        Variant(family, subtask, material)
        for family, (_, raw) in _headers().items()
        if raw.get("collection", Collection.GAUGE) == collection
        for subtask in raw.get("subtasks") or {None: None}
        for material in raw["materials"]
    )


def find_variant(name: str) -> Variant:
    """Return the variant of a name or Gymnasium id, of the benchmark or beyond it.

    Raises:
        UnknownNameError: There is no such variant.
        TaskFileError: The task file of its family cannot be read.
    """
    by_name = {variant.name: variant for variant in (*variants(), *beyond_variants())}
    try:
        return by_name[name.removeprefix("GAUGE/")]
    except KeyError:
        raise _unknown("experiment", name, by_name) from None


# --- names and patterns -----------------------------------------------------------------------------------------------


GLOB_CHARACTERS = "*?["


EXPERIMENT_SUFFIX = ".toml"


def is_experiment_file(path: Path) -> bool:
    """Return whether the suffix of a path is that of an experiment file."""
    return path.suffix == EXPERIMENT_SUFFIX


def is_glob(pattern: str) -> bool:
    """Return whether a text is a pattern, not an id."""
    return any(character in pattern for character in GLOB_CHARACTERS)


def matching_variants(pattern: str) -> list[Variant]:
    """Return the variants of an id or a pattern, with or without `GAUGE/`.

    A pattern matches the benchmark; only one that matches nothing there matches the variants beyond it.
    """
    if not is_glob(pattern):
        return [find_variant(pattern)]
    stem = pattern.removeprefix("GAUGE/")
    for known in (variants(), beyond_variants()):
        found = [variant for variant in known if fnmatchcase(variant.name, stem)]
        if found:
            return found
    raise UnknownNameError(
        "experiment",
        pattern,
        (variant.name for variant in (*variants(), *beyond_variants())),
    )


def matching_subjects(pattern: str) -> Sequence[Variant | str]:
    """Return the variants of an id or a pattern, or the path of an experiment file."""
    return (
        [pattern] if is_experiment_file(Path(pattern)) else matching_variants(pattern)
    )
