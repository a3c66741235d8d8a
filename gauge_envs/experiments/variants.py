"""List the experiments: family, subtask and material of each.

Bundled experiments are listed in `tasks/index.csv`, because parsing all task files takes longer than the rest of an
import. A test compares the index with the task files. Task files of the user are parsed.
"""

import csv
import os
from collections.abc import Iterable
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache, lru_cache
from pathlib import Path

from gymnasium.envs import registration

from gauge_envs.errors import ParameterError, TaskFileError, UnknownNameError
from gauge_envs.experiments.names import Collection as Collection, Variant as Variant
from gauge_envs.files import data_folder, is_regular_file
from gauge_envs.references.user_data import OWN_TASKS, own_task_files

INDEX_FILE = "index.csv"
"""File in `tasks/` with a row for each experiment of the package."""

GLOB_CHARACTERS = "*?["


@dataclass(frozen=True)
class IndexRow:
    """A variant with the facts that its registration needs.

    Attributes:
        variant: Family, subtask and material.
        file: Task file of the family.
        collection: Origin of the experiment.
        frame_count: Number of frames of an episode, the first included.
    """

    variant: Variant
    file: Path
    collection: Collection
    frame_count: int


@cache
def bundled_rows() -> tuple[IndexRow, ...]:
    """Return the rows of the index of the package."""
    folder = data_folder("tasks")
    with (folder / INDEX_FILE).open(newline="", encoding="utf-8") as stream:
        return tuple(
            IndexRow(
                Variant(row["family"], row["subtask"] or None, row["material"]),
                folder / row["file"],
                Collection(row["collection"]),
                int(row["frames"]),
            )
            for row in csv.DictReader(stream)
        )


OwnRows = tuple[tuple[IndexRow, ...], tuple[TaskFileError, ...]]
"""Rows of task files of the user, and an error for each file that cannot be used."""


def _own_rows(files: tuple[Path, ...]) -> OwnRows:
    times_ns = [
        path.stat().st_mtime_ns if is_regular_file(path) else 0 for path in files
    ]
    return _read_own_rows(files, tuple(times_ns))


@lru_cache(maxsize=8)
def _read_own_rows(files: tuple[Path, ...], times_ns: tuple[int, ...]) -> OwnRows:
    """Read task files of the user; the times of the files distinguish versions in the cache."""
    if not files:
        return (), ()
    from gauge_envs.experiments.task_reader import load_task

    known = {row.variant.family: row.file for row in bundled_rows()}
    rows: list[IndexRow] = []
    faults: list[TaskFileError] = []
    for path in files:
        try:
            spec = load_task(path)
        except TaskFileError as error:
            faults.append(error)
            continue
        if spec.family in known:
            reason = f"{spec.family!r} is the family of {known[spec.family].name}: choose another name"
            faults.append(TaskFileError(path, "family", reason))
            continue
        known[spec.family] = path
        rows += [
            IndexRow(variant, path, Collection.BEYOND, spec.frame_count(variant))
            for variant in spec.variants()
        ]
    return tuple(rows), tuple(faults)


def all_rows() -> tuple[IndexRow, ...]:
    """Return the rows of the package, then those of the user."""
    return (*bundled_rows(), *_own_rows(own_task_files())[0])


def unreadable_task_files() -> tuple[TaskFileError, ...]:
    """Return an error for each task file of the user that cannot be used."""
    return _own_rows(own_task_files())[1]


def variants() -> tuple[Variant, ...]:
    """Return all variants of the benchmark, in the order of the index."""
    return tuple(
        row.variant for row in bundled_rows() if row.collection is Collection.GAUGE
    )


def beyond_variants() -> tuple[Variant, ...]:
    """Return the variants outside the benchmark: those of the package, then those of the user."""
    return tuple(
        row.variant for row in all_rows() if row.collection is Collection.BEYOND
    )


def user_variants() -> tuple[Variant, ...]:
    """Return the variants of the task files in `GAUGE_TASKS`."""
    return tuple(row.variant for row in _own_rows(own_task_files())[0])


def task_path(family: str) -> Path:
    """Return the path of a family's task file."""
    files = {row.variant.family: row.file for row in all_rows()}
    if family not in files:
        raise _unknown("family", family, files)
    return files[family]


# --- names, patterns and files ---------------------------------------------------------------------------------------


def is_glob(pattern: str) -> bool:
    """Return whether a text is a pattern, not an id."""
    return any(character in pattern for character in GLOB_CHARACTERS)


def is_task_path(name: str) -> bool:
    """Return whether a text is the path of a task file, not an id."""
    return name.endswith(".toml")


def find_variant(name: str) -> Variant:
    """Return the variant of a name, a Gymnasium id, or a task file with one variant.

    Raises:
        UnknownNameError: There is no such variant.
        ParameterError: The task file has several variants.
        TaskFileError: A task file of the user cannot be used.
    """
    if is_task_path(name):
        file_variants = _variants_of_file(Path(name))
        if len(file_variants) > 1:
            names = ", ".join(variant.name for variant in file_variants)
            raise ParameterError(
                f"{name} has {len(file_variants)} experiments: {names}. Set {OWN_TASKS}={name} and give one id"
            )
        return file_variants[0]
    plain = name.removeprefix("GAUGE/")
    known = {row.variant.name: row.variant for row in all_rows()}
    if plain not in known:
        raise _unknown("experiment", name, known)
    return known[plain]


def recorded_variant(name: str, file: str | None) -> Variant:
    """Return the variant of a result; the task file in it names the experiment, wherever the result is read.

    Args:
        name: Id in the result.
        file: Path of the user's task file in the result; None for an id of the package.

    Raises:
        UnknownNameError: There is no such variant.
        TaskFileError: The task file is gone, cannot be used, or has other experiments.
    """
    known = {row.variant.id for row in all_rows()}
    if file is not None and name not in known:
        path = Path(file)
        if not is_regular_file(path):
            reason = f"it has {name} and is gone: put it back, or set {OWN_TASKS} to the file or its folder"
            raise TaskFileError(path, None, reason)
        ids = [variant.id for variant in _variants_of_file(path)]
        if name not in ids:
            raise TaskFileError(path, None, f"it has {', '.join(ids)}, not {name}")
    return find_variant(name)


def matching_variants(pattern: str) -> list[Variant]:
    """Return the variants of an id, a pattern or a task file.

    A pattern matches variants of the benchmark; if it matches none, it matches variants outside the benchmark.
    """
    if is_task_path(pattern):
        return _variants_of_file(Path(pattern))
    if not is_glob(pattern):
        return [find_variant(pattern)]
    plain = pattern.removeprefix("GAUGE/")
    for known in (variants(), beyond_variants()):
        matches = [variant for variant in known if fnmatchcase(variant.name, plain)]
        if matches:
            return matches
    raise _unknown("experiment", pattern, (row.variant.name for row in all_rows()))


def _variants_of_file(path: Path) -> list[Variant]:
    """Register a task file in this process and its child processes, and return its variants."""
    path, known = path.absolute(), own_task_files()
    files = known if path in known else (*known, path)
    rows, faults = _own_rows(files)
    for fault in faults:
        if fault.file == path:
            raise fault
    os.environ[OWN_TASKS] = os.pathsep.join(map(str, files))
    return [row.variant for row in rows if row.file == path]


def _unknown(
    kind: str, name: str, known: Iterable[str]
) -> TaskFileError | UnknownNameError:
    """Return the error for an unknown name; an unusable task file has priority, because it may define the name."""
    faults = unreadable_task_files()
    if faults:
        return faults[0]
    plain = name.removeprefix("GAUGE/")
    hint = ""
    if len(plain.split()) > 1:
        hint = "separate names by commas"
    if f"GAUGE/{plain}" in registration.registry:
        hint = f"it is a control task: use gymnasium.make('GAUGE/{plain}') or gauge show {plain}"
    return UnknownNameError(kind, name, known, hint)
