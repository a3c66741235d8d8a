"""Find the trial files of a dataset folder, and the variant of each.

The published layout is

    data/<rigid|rope|textile|deformable>/<task>/json/<material>/[task-N/]<trial>.json

Its irregularities are read too:

- Some task folders differ from the metadata's spelling (`foam compression`).
- Materials have the metadata's names (`cotton` is the rayon of this package).
- A task with one material may have no material folder (bouncing ball).
- The nonsmooth contacts are in `task-1` to `task-3`, which the metadata calls task-3 to task-5: subtasks 1 to 3.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path

from gauge_envs.errors import DatasetError, UnknownNameError
from gauge_envs.experiments.task_files import task_file_faults, task_spec
from gauge_envs.experiments.task_format import Group, TaskSpec
from gauge_envs.experiments.variants import Variant, variants
from gauge_envs.files import MEGABYTE, json_document, printable, read_regular
from gauge_envs.tools.dataset.trial import ImportFinding

REVISION_FILE = "gauge-dataset.json"
"""File at the top of a downloaded dataset that states its revision."""

FOLDER_SPELLINGS = {"foam compression": "foam compressing"}
"""Task folders whose spelling differs from the metadata's."""

SUBTASK_FOLDER = re.compile(r"task\W*_?(\w+)", re.IGNORECASE)


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Trial files of a dataset folder.

    Attributes:
        root: Folder of the dataset.
        revision: Revision of the dataset; None if the folder does not state it.
        files: Trial files by variant, in the order of the variants and of the file names.
        findings: Folders that belong to no known experiment.
    """

    root: Path
    revision: str | None
    files: Mapping[Variant, tuple[Path, ...]]
    findings: tuple[ImportFinding, ...]

    def holds(self, path: Path) -> bool:
        """Return whether a file, with its links resolved, is in the dataset's folder or in its download cache."""
        folder = self.root.resolve()
        # The client of the dataset's host links the files of a snapshot to a folder beside all snapshots.
        top = folder.parent.parent if folder.parent.name == "snapshots" else folder
        return path.resolve().is_relative_to(top)

    @property
    def count(self) -> int:
        """Number of trial files."""
        return sum(map(len, self.files.values()))

    def relative(self, path: Path) -> str:
        """Return the path below the dataset's folder, with forward slashes."""
        return printable(path.relative_to(self.root).as_posix())


def find_trials(root: Path, *, only: Sequence[str] = ("*",)) -> Layout:
    """Find the trial files of a dataset.

    Args:
        root: Folder of the dataset, which contains `data`; or the folder `data` itself.
        only: Patterns of variants to find, as `SlopeSlider-*`, with or without `GAUGE/`.
    """
    wanted = _wanted(only)
    found: dict[Variant, list[Path]] = {}
    findings: list[ImportFinding] = []
    try:
        data = _data_folder(root)
        for group in _folders(data):
            if not _is_group(group):
                findings.append(_finding(root, group, "it is not a group of experiments", f"one of {', '.join(Group)}"))
                continue
            for task in _folders(group):
                _read_task(root, task, found, findings)
        revision = _revision(root)
    except OSError as error:
        raise DatasetError(f"{error.filename or root}: cannot be read: {error.strerror or error}") from error
    files = {variant: tuple(sorted(found[variant], key=_natural)) for variant in wanted if variant in found}
    if not files:
        of = "" if len(wanted) == len(variants()) else f" of {', '.join(only)}"
        raise DatasetError(
            f"{data}: contains no trial{of}; data/<group>/<task>/json/<material>/<trial>.json is expected"
        )
    return Layout(
        root=root,
        revision=revision,
        files=files,
        findings=tuple(findings),
    )


def write_revision(root: Path, revision: str) -> None:
    """State the revision in a dataset's folder."""
    (root / REVISION_FILE).write_text(json.dumps({"revision": revision}) + "\n", encoding="utf-8")


def _revision(root: Path) -> str | None:
    """Return the stated revision, or None; nothing is computed from it, so a damaged file is no error."""
    for folder in (root, root.parent):
        try:
            revision = json_document(read_regular(folder / REVISION_FILE, MEGABYTE))["revision"]
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
        raise DatasetError(f"{root}: is not a folder; the folder of the dataset, which contains 'data', is expected")
    for folder in (root / "data", root):
        if folder.is_dir() and any(map(_is_group, folder.iterdir())):
            return folder
    raise DatasetError(f"{root}: is not a GAUGE dataset; data/{'|'.join(Group)} is expected below it")


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
        findings.append(_finding(root, task, "it is not a known task", hint))
        return
    sources = [folder for folder in _folders(task) if folder.name.lower() == "json"]
    if not sources:
        findings.append(_finding(root, task, "it has no folder 'json'", "trials are in <task>/json/<material>"))
    for source in sources:
        for path in _json_files(root, source, findings):
            place = _variant(task_spec(family), path.relative_to(source).parts[:-1])
            if isinstance(place, Variant):
                found.setdefault(place, []).append(path)
            elif not any(f.file == _finding(root, path.parent, "", "").file for f in findings):
                findings.append(_finding(root, path.parent, *place))


def _json_files(root: Path, folder: Path, findings: list[ImportFinding]) -> Iterator[Path]:
    """Yield the JSON files below a folder; add a finding for each folder that cannot be read."""

    def unreadable(error: OSError) -> None:
        problem = f"it cannot be read: {error.strerror or error}"
        findings.append(_finding(root, Path(error.filename), problem, "a readable folder is expected"))

    found: list[Path] = []
    for parent, folders, files in os.walk(folder, onerror=unreadable):
        folders[:] = [name for name in folders if not name.startswith(".")]
        names = [*files, *folders]
        found += [Path(parent, name) for name in names if name.lower().endswith(".json") and not name.startswith(".")]
    yield from sorted(found)


def _variant(spec: TaskSpec, folders: Sequence[str]) -> Variant | tuple[str, str]:
    """Return the variant of the folders between `json` and a trial, or what is wrong and what is expected."""
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
    """Return the family of each task folder, by the folder's letters and digits in lower case."""
    families = {}
    wrong = task_file_faults()
    for family in dict.fromkeys(variant.family for variant in variants() if variant.family not in wrong):
        metadata = task_spec(family).source.metadata
        name = metadata.partition(".json")[0].rpartition("/")[2]
        families[_plain(name)] = family
    for spelling, name in FOLDER_SPELLINGS.items():
        if _plain(name) not in families:
            continue
        families[_plain(spelling)] = families[_plain(name)]
    return families


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


def _natural(path: Path) -> tuple[list[tuple[int, str]], str]:
    """Return a sort key that puts trial-2 before trial-10."""
    parts = re.split(r"(\d+)", path.as_posix())
    return [(int(part), "") if part.isdecimal() else (0, part) for part in parts], path.as_posix()


def _finding(root: Path, path: Path, problem: str, expected: str) -> ImportFinding:
    file = printable(path.relative_to(root).as_posix())
    return ImportFinding(file=file, key="(folder)", problem=printable(problem), expected=expected)
