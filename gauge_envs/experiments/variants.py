"""List the variants of the package: family, subtask and material.

This module reads names alone and imports no pydantic model, so that importing the package is quick.
"""

import os
import re
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import Any

from gauge_envs.errors import ParameterError, TaskFileError, UnknownNameError
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


OWN_TASKS = "GAUGE_TASKS"
"""Environment variable with folders of task files outside the package, or single ones, as `PATH` lists folders."""


FRAME_COUNT = re.compile(rb"([A-Za-z0-9_-]+) = ([1-9][0-9]*)")
"""Line of the frames of a material; others are left to the reader of TOML, which takes as long as all the rest."""

TABLE = re.compile(rb"\[\[?[A-Za-z_]")
"""Begin of the header of a table, as task files write it."""

ODD_TABLE = re.compile(rb"\[\[?\s*[\"'A-Za-z_]")
"""Begin of a header that task files write in another way, or of an array."""

NAMED_SUBTASKS = re.compile(rb"^\s*[\"']?subtasks", re.MULTILINE)
"""Subtasks before the first header, as a key."""


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
        return "family" in toml_document(read_regular(path, MEGABYTE))
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
        stated = toml_document(read_regular(path, MEGABYTE))
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
def _read_files() -> tuple[
    dict[str, tuple[Path, dict[str, Any]]], tuple[TaskFileError, ...]
]:
    """Return path and names of every task file, by family, and the errors of files that cannot be read.

    A file is validated when one of its variants is loaded.
    """
    headers: dict[str, tuple[Path, dict[str, Any]]] = {}
    faults: list[TaskFileError] = []
    user_files = user_task_files()
    for path in (*task_files(), *user_files):
        try:
            raw = _names_of(read_regular(path, MEGABYTE))
            family = _header(raw)
            if family in headers:
                known = headers[family][0].name
                raise ValueError(
                    f"family {family!r} is that of {known}: choose another name"
                )
            if path in user_files:
                # No count and no average of the benchmark contains it.
                raw["collection"] = Collection.BEYOND
            headers[family] = (path, raw)
        except (OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) else error
            if isinstance(error, FileNotFoundError):
                reason = f"{OWN_TASKS} names it, and it does not exist"
            faults.append(
                TaskFileError(
                    path,
                    None,
                    f"cannot be read: {reason}; correct or remove the file",
                )
            )
    return headers, tuple(faults)


def _names_of(content: bytes) -> dict[str, Any]:
    """Return the names in a task file: family, materials, collection and subtasks, and the frames of their episodes.

    All of it takes twenty times as long to parse, and `import gauge_envs` reads every file.
    """
    top, first, rest = content.partition(b"\n[")
    names = [
        line
        for line in top.splitlines()
        if line.startswith((b"family", b"materials", b"collection"))
    ]
    lines = (first + rest).splitlines()
    frames = (first + rest).partition(b"\n[frames]\n")[2].partition(b"\n[")[0]
    counts = [FRAME_COUNT.fullmatch(line) for line in frames.splitlines() if line]
    if None in counts:
        return toml_document(content)
    subtasks = _subtask_lines(lines)
    if subtasks is not None and not NAMED_SUBTASKS.search(top):
        with suppress(ValueError):
            raw = toml_document(b"\n".join((*names, *subtasks)))
            raw["frames"] = {one[1].decode(): int(one[2]) for one in counts if one}
            _header(raw)
            return raw
    return toml_document(content)


def _subtask_lines(lines: Iterable[bytes]) -> list[bytes] | None:
    """Return the headers of subtasks and their frames; None where only the reader of TOML finds them."""
    found = []
    in_subtask = False
    for line in lines:
        if in_subtask and line.startswith(b"frames = "):
            found.append(line)
        if not line.startswith(b"["):
            continue
        if line.startswith((b"[subtasks.", b"[[subtasks.")):
            in_subtask = True
            found.append(line)
        elif TABLE.match(line):
            in_subtask = False
            if b"subtasks" in line:
                return None
        elif ODD_TABLE.match(line):
            return None
    return found


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


def episode_steps(variant: Variant) -> int | None:
    """Return the number of steps of an episode, one less than its frames; None where the task file states none.

    A wrong number of frames is an error of the file when the variant is loaded.
    """
    raw = _headers()[variant.family][1]
    subtask = raw.get("subtasks", {}).get(variant.subtask or "", {})
    stated = {**raw.get("frames", {}), **subtask.get("frames", {})}
    count = stated.get(variant.material, stated.get("all"))
    return count - 1 if isinstance(count, int) and count > 1 else None


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
