"""List the variants of the package: family, subtask and material.

The names of the experiments are in `tasks/index.csv`, because parsing all task files takes longer than the rest
of an import. A test compares the index with the task files.
"""

import csv
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path

from gauge_envs.errors import ParameterError, TaskFileError, UnknownNameError
from gauge_envs.files import data_folder, toml_document


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


OWN_TASKS = "GAUGE_TASKS"
"""Environment variable with folders of task files outside the package, or single ones, as `PATH` lists folders."""


INDEX_FILE = "index.csv"
"""File of the names of the package's experiments, which importing the package reads in place of all task files."""


@dataclass(frozen=True)
class ListedVariant:
    """A variant with what its registration needs.

    Attributes:
        variant: Family, subtask and material.
        file: Task file of the family.
        collection: Where the experiment is from.
        frame_count: Number of frames of an episode, or None where the task file gives none.
    """

    variant: Variant
    file: Path
    collection: Collection
    frame_count: int | None


def task_files() -> tuple[Path, ...]:
    """Return all task files of the package, sorted by name."""
    return tuple(sorted(data_folder("tasks").glob("*.toml")))


def user_task_files() -> tuple[Path, ...]:
    """Return the task files that `GAUGE_TASKS` names, and entries that do not exist, in its order."""
    found: dict[Path, None] = {}
    for entry in os.environ.get(OWN_TASKS, "").split(os.pathsep):
        if not entry.strip():
            continue
        path = Path(entry).expanduser().absolute()
        inside = sorted(path.glob("*.toml")) if path.is_dir() else [path]
        found |= dict.fromkeys(
            one for one in inside if one == path or is_task_file(one)
        )
    return tuple(found)


def is_task_file(path: Path) -> bool:
    """Return whether a TOML file states a family of experiments; an experiment file states a name and a USD layer."""
    with suppress(OSError, ValueError):
        return "family" in toml_document(path.read_bytes())
    return False


def use_task_file(path: Path) -> tuple[Variant, ...]:
    """Make a task file known to this process and to those that it starts, and return its variants.

    Raises:
        TaskFileError: The file cannot be read, or its family is one of the package.
    """
    path = path.absolute()
    if path not in user_task_files():
        if os.pathsep in str(path):
            raise TaskFileError(
                path,
                None,
                f"a path with {os.pathsep!r} cannot be used: move the file",
            )
        known = os.environ.get(OWN_TASKS, "")
        os.environ[OWN_TASKS] = os.pathsep.join(filter(None, (known, str(path))))
        for cached in (_read_files, variants, beyond_variants):
            cached.cache_clear()
    for fault in unreadable_task_files():
        if fault.file == path:
            raise fault
    return tuple(
        variant for variant in beyond_variants() if task_path(variant.family) == path
    )


def find_subject(name: str) -> Variant | str:
    """Return the variant of a name, an id or a task file with one variant, or the path of an experiment file."""
    path = Path(name)
    if not is_experiment_file(path):
        return find_variant(name)
    if not is_task_file(path):
        _check_experiment_file(path)
        return name
    found = use_task_file(path)
    if len(found) != 1:
        names = ", ".join(one.name for one in found)
        raise ParameterError(
            f"{name} states {len(found)} experiments: {names}. Set {OWN_TASKS}={name} and give the id of one"
        )
    return found[0]


def _check_experiment_file(path: Path) -> None:
    """Raise an error for a TOML file that is no experiment file either; what is wrong inside is said on loading it."""
    try:
        stated = toml_document(path.read_bytes())
    except FileNotFoundError as error:
        # Loading needs packages of another extra.
        raise TaskFileError(path, None, f"cannot be read: {error.strerror}") from None
    except (OSError, ValueError):
        return
    if not {"name", "usd"} & stated.keys():
        reason = "it states no family, as a task file does, and no name and usd, as an experiment file"
        raise TaskFileError(path, None, reason)


def user_variants() -> tuple[Variant, ...]:
    """Return the variants of task files outside the package."""
    user_files = user_task_files()
    return tuple(
        variant
        for variant in beyond_variants()
        if task_path(variant.family) in user_files
    )


@cache
def _read_files() -> tuple[dict[Variant, ListedVariant], tuple[TaskFileError, ...]]:
    """Return the variants of all task files, and the errors of user files that cannot be read.

    A file is validated when one of its variants is loaded.
    """
    listed = list(_indexed_variants())
    files = {entry.variant.family: entry.file for entry in listed}
    faults: list[TaskFileError] = []
    for path in user_task_files():
        try:
            entries = variants_of_file(path, Collection.BEYOND)
            family = entries[0].variant.family
            if family in files:
                known = files[family].name
                raise ValueError(
                    f"family {family!r} is that of {known}: choose another name"
                )
            files[family] = path
            listed.extend(entries)
        except (OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) else error
            if isinstance(error, FileNotFoundError):
                reason = f"{OWN_TASKS} names it, and it does not exist"
            message = f"cannot be read: {reason}; correct or remove the file"
            faults.append(TaskFileError(path, None, message))
    return {entry.variant: entry for entry in listed}, tuple(faults)


def _indexed_variants() -> Iterator[ListedVariant]:
    """Yield the variants of the package."""
    folder = data_folder("tasks")
    with (folder / INDEX_FILE).open(newline="", encoding="utf-8") as stream:
        for row in csv.DictReader(stream):
            yield ListedVariant(
                Variant(row["family"], row["subtask"] or None, row["material"]),
                folder / row["file"],
                Collection(row["collection"]),
                int(row["frames"]),
            )


def variants_of_file(path: Path, collection: Collection) -> list[ListedVariant]:
    """Return the variants of a task file, of which names and frames alone are checked.

    Args:
        path: The task file.
        collection: Collection of the experiments.

    Raises:
        OSError: The file cannot be read.
        ValueError: It is no TOML file, or it lacks the names of its variants.
    """
    raw = toml_document(path.read_bytes())
    family, materials = raw.get("family"), raw.get("materials")
    subtasks = raw.get("subtasks", {})
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
    listed = []
    for subtask in subtasks or {None: None}:
        frames = {
            **raw.get("frames", {}),
            **subtasks.get(subtask or "", {}).get("frames", {}),
        }
        for material in materials:
            count = frames.get(material, frames.get("all"))
            # A wrong number of frames is an error of the file when the variant is loaded.
            is_count = isinstance(count, int) and count > 1
            variant = Variant(family, subtask, material)
            listed.append(
                ListedVariant(variant, path, collection, count if is_count else None)
            )
    return listed


def episode_steps(variant: Variant) -> int | None:
    """Return the number of steps of an episode, one less than its frames; None where the task file gives none."""
    frame_count = _read_files()[0][variant].frame_count
    return None if frame_count is None else frame_count - 1


def unreadable_task_files() -> tuple[TaskFileError, ...]:
    """Return an error for each task file whose names cannot be read; the variants of the others are listed."""
    return _read_files()[1]


def _unknown(
    kind: str, name: str, known: Iterable[str]
) -> TaskFileError | UnknownNameError:
    """Return the error for an unknown name: that of the unreadable task file which may define it, if there is one."""
    plain = name.removeprefix("GAUGE/").lower()
    user_files = user_task_files()
    for fault in unreadable_task_files():
        if fault.file in user_files or plain.startswith(
            fault.file.stem.replace("_", "").lower()
        ):
            return fault
    return UnknownNameError(kind, name, known)


def task_path(family: str) -> Path:
    """Return the path of a family's task file."""
    files = {variant.family: entry.file for variant, entry in _read_files()[0].items()}
    if family not in files:
        raise _unknown("family", family, files)
    return files[family]


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
    listed = _read_files()[0].values()
    return tuple(entry.variant for entry in listed if entry.collection == collection)


def find_variant(name: str) -> Variant:
    """Return the variant of a name or Gymnasium id, of the benchmark or beyond it.

    Raises:
        UnknownNameError: There is no such variant.
        TaskFileError: The task file of its family cannot be read.
    """
    wanted = name.removeprefix("GAUGE/")
    every = (*variants(), *beyond_variants())
    for variant in every:
        if wanted.startswith(variant.family) and variant.name == wanted:
            return variant
    raise _unknown("experiment", name, [variant.name for variant in every])


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
    """Return the variants of an id, a pattern or a task file, or the path of an experiment file."""
    path = Path(pattern)
    if not is_experiment_file(path):
        return matching_variants(pattern)
    return use_task_file(path) if is_task_file(path) else [pattern]
