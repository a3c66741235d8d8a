"""Finds the trial files of a dataset folder, and the variant that each is of.

The published layout is

    data/<rigid|rope|textile|deformable>/<task>/json/<material>/[task-N/]<trial>.json

with irregularities, all of which are read: spellings that differ from the metadata's (`foam compression`), materials
by the metadata's names (`cotton` is our rayon), no material folder where a task has one material (bouncing ball), and
`task-1`, `-2`, `-3` for the nonsmooth contacts that the metadata calls task-3, 4 and 5: they are subtasks 1, 2 and 3.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path

from gauge_envs.dataset.trial import ImportFinding, printable
from gauge_envs.errors import DatasetError, UnknownNameError
from gauge_envs.experiments.task_files import task_spec
from gauge_envs.experiments.task_format import Group, TaskSpec
from gauge_envs.experiments.variants import Variant, variants

__all__ = [
    "REVISION_FILE",
    "Layout",
    "find_trials",
    "write_revision",
]

REVISION_FILE = "gauge-dataset.json"
"""File at the top of a downloaded dataset that says which revision it is."""

FOLDER_SPELLINGS = {"foam compression": "foam compressing"}
"""Task folders that are spelled otherwise than in the metadata."""

SUBTASK_FOLDER = re.compile(r"task\W*_?(\w+)", re.IGNORECASE)


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Trial files of a dataset folder.

    Attributes:
        root: The dataset's folder.
        revision: Revision of the dataset; None where the folder does not say.
        files: Trial files of each variant that has some, in the order of the variants and of the files' names.
        findings: Folders and files that are of no known experiment.
    """

    root: Path
    revision: str | None
    files: Mapping[Variant, tuple[Path, ...]]
    findings: tuple[ImportFinding, ...]

    @property
    def count(self) -> int:
        """Number of trial files."""
        return sum(map(len, self.files.values()))

    def relative(self, path: Path) -> str:
        """Path below the dataset's folder, with forward slashes."""
        return printable(path.relative_to(self.root).as_posix())


def find_trials(root: Path, *, only: Sequence[str] = ("*",)) -> Layout:
    """Find the trial files of a dataset.

    Args:
        root: Folder of the dataset, which holds `data`; or that `data` folder itself.
        only: Patterns of the variants that are wanted, as `SlopeSlider-*`, with or without `GAUGE/`.

    Raises:
        DatasetError: The folder cannot be read, or holds no trial of any experiment.
        UnknownNameError: A pattern matches no variant.
    """
    wanted = _wanted(only)
    found: dict[Variant, list[Path]] = {}
    findings: list[ImportFinding] = []
    try:
        data = _data_folder(root)
        for group in _folders(data):
            if not _is_group(group):
                findings.append(_finding(root, group, "it is no group of experiments", f"one of {', '.join(Group)}"))
                continue
            for task in _folders(group):
                _read_task(root, task, found, findings)
        revision = _revision(root)
    except OSError as error:
        raise DatasetError(f"{error.filename or root}: cannot be read: {error.strerror or error}") from error
    files = {variant: tuple(sorted(found[variant], key=_natural)) for variant in wanted if variant in found}
    if not files:
        of = "" if len(wanted) == len(variants()) else f" of {', '.join(only)}"
        raise DatasetError(f"{data}: holds no trial{of}; data/<group>/<task>/json/<material>/<trial>.json is expected")
    return Layout(
        root=root,
        revision=revision,
        files=files,
        findings=tuple(findings),
    )


def write_revision(root: Path, revision: str) -> None:
    """Note in a dataset's folder which revision it is."""
    (root / REVISION_FILE).write_text(json.dumps({"revision": revision}) + "\n", encoding="utf-8")


def _revision(root: Path) -> str | None:
    """The noted revision; a note that cannot be read is as good as none, since nothing is computed from it."""
    for folder in (root, root.parent):
        try:
            revision = json.loads((folder / REVISION_FILE).read_bytes())["revision"]
        except (OSError, ValueError, TypeError, KeyError):
            continue
        if isinstance(revision, str) and revision:
            return printable(revision)
    return None


def _wanted(patterns: Sequence[str]) -> list[Variant]:
    known = variants()
    for pattern in patterns:
        if not any(fnmatchcase(variant.name, pattern.removeprefix("GAUGE/")) for variant in known):
            raise UnknownNameError("experiment", pattern, (variant.name for variant in known))
    return [v for v in known if any(fnmatchcase(v.name, pattern.removeprefix("GAUGE/")) for pattern in patterns)]


def _data_folder(root: Path) -> Path:
    if not root.is_dir():
        raise DatasetError(f"{root}: is no folder; the dataset's folder, which holds 'data', is expected")
    for folder in (root / "data", root):
        if folder.is_dir() and any(map(_is_group, folder.iterdir())):
            return folder
    raise DatasetError(f"{root}: is no GAUGE dataset; data/{'|'.join(Group)} is expected below it")


def _is_group(folder: Path) -> bool:
    return _plain(folder.name) in list(Group)


def _folders(folder: Path) -> list[Path]:
    return sorted(entry for entry in folder.iterdir() if entry.is_dir() and not entry.name.startswith("."))


def _read_task(root: Path, task: Path, found: dict[Variant, list[Path]], findings: list[ImportFinding]) -> None:
    families = _families()
    family = families.get(_plain(task.name))
    if family is None:
        near = get_close_matches(_plain(task.name), families, n=1)
        hint = f"did you mean that of {families[near[0]]}?" if near else "see the folders of the published dataset"
        findings.append(_finding(root, task, "it is no known task", hint))
        return
    sources = [folder for folder in _folders(task) if folder.name.lower() == "json"]
    if not sources:
        findings.append(_finding(root, task, "it has no folder 'json'", "trials are in <task>/json/<material>"))
    for source in sources:
        for path in _json_files(source):
            place = _variant(task_spec(family), path.relative_to(source).parts[:-1])
            if isinstance(place, Variant):
                found.setdefault(place, []).append(path)
            elif not any(f.file == _finding(root, path.parent, "", "").file for f in findings):
                findings.append(_finding(root, path.parent, *place))


def _json_files(folder: Path) -> Iterator[Path]:
    for path in sorted(folder.rglob("*")):
        hidden = any(part.startswith(".") for part in path.relative_to(folder).parts)
        if path.suffix.lower() == ".json" and not hidden:
            yield path


def _variant(spec: TaskSpec, folders: Sequence[str]) -> Variant | tuple[str, str]:
    """The variant of the folders between `json` and a trial; else what is wrong with them, and what would be right."""
    material, subtask = None, None
    names = {_plain(name): name for name in spec.materials}
    names |= {_plain(theirs): ours for ours, theirs in spec.metadata_materials.items()}
    subtasks = ", ".join(f"task-{name}" for name in spec.subtasks) or "no task folder"
    for folder in folders:
        if _plain(folder) in names and material is None:
            material = names[_plain(folder)]
        elif (match := SUBTASK_FOLDER.fullmatch(folder)) and subtask is None:
            subtask = match[1]
        else:
            return f"{folder!r} is neither a material nor a subtask of {spec.family}", (
                f"materials are {', '.join(names.values())}; subtasks: {subtasks}"
            )
    if material is None and len(spec.materials) == 1:
        material = spec.materials[0]
    if material is None:
        return f"it names no material of {spec.family}", f"a folder of {', '.join(names)} is expected"
    if subtask not in (spec.subtasks or (None, "1")):
        return f"{spec.family} has no subtask {subtask!r} in the data", f"{subtasks} is expected"
    return Variant(spec.family, subtask if spec.subtasks else None, material)


@cache
def _families() -> dict[str, str]:
    """Family of each task folder, by its spelling without case, blanks and signs."""
    families = {}
    for family in dict.fromkeys(variant.family for variant in variants()):
        metadata = task_spec(family).source.metadata
        name = metadata.partition(".json")[0].rpartition("/")[2]
        families[_plain(name)] = family
    for spelling, name in FOLDER_SPELLINGS.items():
        families[_plain(spelling)] = families[_plain(name)]
    return families


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


def _natural(path: Path) -> tuple[list[tuple[int, str]], str]:
    """Sorts trial-2 before trial-10."""
    parts = re.split(r"(\d+)", path.as_posix())
    return [(int(part), "") if part.isdecimal() else (0, part) for part in parts], path.as_posix()


def _finding(root: Path, path: Path, what: str, right: str) -> ImportFinding:
    file = printable(path.relative_to(root).as_posix())
    return ImportFinding(file=file, key="(folder)", what=printable(what), right=right)
