"""Find the trial files of a dataset folder, and the variant of each.

The published layout is

    data/<rigid|rope|textile|deformable>/<task>/json/<material>/[task-N/]<trial>.json

Its irregularities are read too:

- Some task folders differ from the metadata's spelling (`foam compression`).
- Materials have the metadata's names (`cotton` is the rayon of this package).
- A task with one material may have no material folder (bouncing ball).
- The nonsmooth contacts are in `task-1` to `task-3`, which the metadata calls task-3 to task-5: subtasks 1 to 3.

Folders are read by their names, in any order and depth: a task, a material, a subtask, and words that say nothing about
a trial (`NEUTRAL`). Trials in a folder of any other name may not be the published ones: they are left out and reported.
A trial that is there in two forms counts once, in the published form.
"""

import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from gauge_envs.errors import DatasetError
from gauge_envs.experiments.task_files import task_spec
from gauge_envs.experiments.task_format import Group, TaskSpec
from gauge_envs.experiments.variants import Variant, matching_variants, variants
from gauge_envs.files import json_document, printable
from gauge_envs.tools.dataset.findings import ImportFinding
from gauge_envs.tools.dataset.forms import FORMS

REVISION_FILE = "gauge-dataset.json"
"""File at the top of a downloaded dataset that states its revision."""

FOLDER_SPELLINGS = {"foam compression": "foam compressing"}
"""Task folders whose spelling differs from the metadata's."""

NEUTRAL = {
    *Group,
    "data",
    "json",
    "csv",
    "mocap",
    "trials",
    "trajectories",
}
"""Names of folders that say nothing about a trial."""

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
    if not root.is_dir():
        raise DatasetError(
            f"{root}: is not a folder; the folder of the dataset is expected"
        )
    try:
        _read_folders(root, found, findings)
        revision = _revision(root)
    except OSError as error:
        raise DatasetError(
            f"{error.filename or root}: cannot be read: {error.strerror or error}"
        ) from error
    files = {v: _one_form(root, v, found[v], findings) for v in wanted if v in found}
    if not files:
        of = "" if len(wanted) == len(variants()) else f" of {', '.join(only)}"
        why = "".join(f"\n  {finding}" for finding in findings[:5])
        raise DatasetError(
            f"{root}: contains no trial{of}; data/<group>/<task>/json/<material>/<trial>.json is expected{why}"
        )
    return Layout(root=root, revision=revision, files=files, findings=tuple(findings))


def write_revision(root: Path, revision: str) -> None:
    """State the revision in a dataset's folder."""
    (root / REVISION_FILE).write_text(
        json.dumps({"revision": revision}) + "\n", encoding="utf-8"
    )


def _revision(root: Path) -> str | None:
    """Return the stated revision, or None; nothing is computed from it, so a damaged file is no error."""
    for folder in (root, root.parent):
        try:
            revision = json_document((folder / REVISION_FILE).read_bytes())["revision"]
        except (OSError, ValueError, TypeError, KeyError):
            continue
        if isinstance(revision, str) and revision:
            return printable(revision)
    return None


def _wanted(patterns: Sequence[str]) -> list[Variant]:
    """Return the variants of some patterns, in their order; each pattern must match one."""
    wanted = {
        variant.name for pattern in patterns for variant in matching_variants(pattern)
    }
    return [one for one in variants() if one.name in wanted]


def _read_folders(
    root: Path, found: dict[Variant, list[Path]], findings: list[ImportFinding]
) -> None:
    """Find the trial files in a folder; add a finding for each folder of files that belong to no variant."""

    def unreadable(error: OSError) -> None:
        problem = f"it cannot be read: {error.strerror or error}"
        expected = "a readable folder is expected"
        findings.append(_finding(root, Path(error.filename), problem, expected))

    for parent, folders, names in os.walk(root, onerror=unreadable):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        files = [
            Path(parent, name)
            for name in [*names, *folders]
            if Path(name).suffix.lower() in FORMS
            and not name.startswith(".")
            and name != REVISION_FILE
        ]
        if not files:
            continue
        place = _place(root, Path(parent))
        if isinstance(place, Variant):
            found.setdefault(place, []).extend(files)
        else:
            findings.append(place)


def _place(root: Path, folder: Path) -> Variant | ImportFinding:
    """Return the variant of the trials in a folder, or why they are left out."""
    families = _families()
    parts = list(folder.relative_to(root).parts)
    if not any(_plain(part) in families for part in parts):
        # The folder of a task, or one below it, was given as that of the dataset.
        above = [*map(_plain, root.resolve().parts)]
        tasks = [number for number, part in enumerate(above) if part in families]
        parts = [*root.resolve().parts[tasks[-1] if tasks else len(above) :], *parts]
    named = [part for part in parts if _plain(part) in families]
    if named:
        family = families[_plain(named[0])]
        others = {*NEUTRAL, *map(_plain, named)}
        rest = [part for part in parts if _plain(part) not in others]
        variant = _variant(task_spec(family), rest)
        if isinstance(variant, Variant):
            return variant
        problem, expected = variant
    else:
        problem = "no folder above it is a known task"
        expected = f"that of a task below {', '.join(Group)} is expected"
    # Trials of the published form count, other files beside them may be anything.
    is_published = "json" in map(_plain, parts)
    return replace(_finding(root, folder, problem, expected), left_out=is_published)


def _one_form(
    root: Path, variant: Variant, files: list[Path], findings: list[ImportFinding]
) -> tuple[Path, ...]:
    """Return the files of the first form of a variant's trials; add a finding for those of another form."""
    forms = {
        suffix: [p for p in files if p.suffix.lower() == suffix] for suffix in FORMS
    }
    first, *others = filter(None, forms.values())
    for other in others:
        problem = f"{len(other)} files {other[0].suffix} of {variant.name} are not read"
        expected = f"those of {first[0].suffix} count"
        finding = _finding(root, other[0].parent, problem, expected)
        findings.append(replace(finding, left_out=False))
    return tuple(sorted(first, key=_natural))


def _variant(spec: TaskSpec, folders: Sequence[str]) -> Variant | tuple[str, str]:
    """Return the variant of the folders around a trial, or what is wrong and what is expected."""
    material, subtask = None, None
    names = {_plain(name): name for name in spec.materials}
    names |= {
        _plain(dataset_name): material
        for material, dataset_name in spec.metadata_materials.items()
    }
    subtasks = ", ".join(f"task-{name}" for name in spec.subtasks) or "no task folder"
    for folder in folders:
        if _plain(folder) in names and material is None:
            material = names[_plain(folder)]
        elif (match := SUBTASK_FOLDER.fullmatch(folder)) and subtask is None:
            subtask = match[1]
        else:
            return (
                f"{folder!r} is neither a material nor a subtask of {spec.family}",
                f"materials are {', '.join(names.values())}; subtasks: {subtasks}",
            )
    if material is None and len(spec.materials) == 1:
        material = spec.materials[0]
    if material is None:
        return (
            f"it names no material of {spec.family}",
            f"a folder of {', '.join(names)} is expected",
        )
    if subtask not in (spec.subtasks or (None, "1")):
        return (
            f"{spec.family} has no subtask {subtask!r} in the data",
            f"{subtasks} is expected",
        )
    return Variant(spec.family, subtask if spec.subtasks else None, material)


@cache
def _families() -> dict[str, str]:
    """Return the family of each task folder, by the folder's letters and digits in lower case."""
    families = {}
    for family in dict.fromkeys(variant.family for variant in variants()):
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
    return [
        (int(part), "") if part.isdecimal() else (0, part) for part in parts
    ], path.as_posix()


def _finding(root: Path, path: Path, problem: str, expected: str) -> ImportFinding:
    file = printable(path.relative_to(root).as_posix())
    return ImportFinding(
        file=file, key="(folder)", problem=printable(problem), expected=expected
    )
