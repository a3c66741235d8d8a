"""Find the trial files of a dataset folder, and the variant of each.

The published layout is

    data/<rigid|rope|textile|deformable>/<task>/json/<material>/[task-N/]<trial>.json

Its irregularities are read too:

- Some task folders differ from the metadata's spelling (`foam compression`).
- Materials have the metadata's names (`cotton` is the rayon of this package).
- A task with one material may have no material folder (bouncing ball).
- The nonsmooth contacts are in `task-1` to `task-3`, which the metadata calls task-3 to task-5: subtasks 1 to 3.

Other layouts are read by the names of folders, in any order and depth: a task, a material, a subtask, and words that
say nothing about a trial (`NEUTRAL`). A folder of any other name is left out and reported, as its trials may not be
real ones; a user who knows better gives it as the dataset's folder. A trial that is there in several forms counts once,
in the published form if that is there.
"""

import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path

from gauge_envs.errors import DatasetError, UnknownNameError
from gauge_envs.experiments.task_files import task_file_faults, task_spec
from gauge_envs.experiments.task_format import Group, TaskSpec
from gauge_envs.experiments.variants import Variant, variants
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
    "npz",
    "mocap",
    "motion",
    "trial",
    "trials",
    "trajectory",
    "trajectories",
}
"""Names of folders that say nothing about a trial."""

TRIAL_FOLDER = re.compile(r"(trial|run|take)\W*_?\d+", re.IGNORECASE)
DOCUMENTS = ("", ".md", ".txt")
MOST_FILES = 200_000

UNREAD = {
    **dict.fromkeys(
        (".mp4", ".avi", ".mov", ".webm", ".png", ".jpg"), "pictures hold no positions"
    ),
    **dict.fromkeys((".obj", ".stl", ".usd", ".xml"), "models hold no motion"),
    ".parquet": "pandas.read_parquet(file).to_csv makes a CSV file of it",
}
"""Why files of a suffix are not read, or what makes them readable."""

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
    known = variants()
    for pattern in patterns:
        if not any(
            fnmatchcase(variant.name, pattern.removeprefix("GAUGE/"))
            for variant in known
        ):
            raise UnknownNameError(
                "experiment", pattern, (variant.name for variant in known)
            )
    return [
        v
        for v in known
        if any(
            fnmatchcase(v.name, pattern.removeprefix("GAUGE/")) for pattern in patterns
        )
    ]


def _read_folders(
    root: Path, found: dict[Variant, list[Path]], findings: list[ImportFinding]
) -> None:
    """Find the trial files in a folder; add a finding for each other folder, and for each suffix that is not read."""

    def unreadable(error: OSError) -> None:
        problem = f"it cannot be read: {error.strerror or error}"
        findings.append(
            _finding(
                root, Path(error.filename), problem, "a readable folder is expected"
            )
        )

    places: dict[Path, Variant | ImportFinding] = {}
    others: dict[str, list[Path]] = {}
    count = 0
    for parent, folders, names in os.walk(root, onerror=unreadable):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        count += len(names)
        if count > MOST_FILES:
            raise DatasetError(
                f"{root}: has more than {MOST_FILES} files; the folder of the dataset is expected"
            )
        for path in sorted(
            Path(parent, name)
            for name in [*names, *folders]
            if not name.startswith(".")
        ):
            suffix, is_folder = path.suffix.lower(), path.name in folders
            if suffix in FORMS and path.name != REVISION_FILE:
                place = places.setdefault(path.parent, _place(root, path.parent))
                if isinstance(place, Variant):
                    found.setdefault(place, []).append(path)
            elif not is_folder and suffix not in DOCUMENTS:
                others.setdefault(suffix, []).append(path)
    findings += [place for place in places.values() if not isinstance(place, Variant)]
    for suffix, files in sorted(others.items()):
        why = UNREAD.get(suffix, f"trials are {', '.join(FORMS)}")
        problem = f"{len(files)} files {suffix} are not read"
        findings.append(
            replace(_finding(root, files[0].parent, problem, why), left_out=False)
        )


def _place(root: Path, folder: Path) -> Variant | ImportFinding:
    """Return the variant of the trials in a folder, or why they are left out."""
    families = _families()
    parts = list(folder.relative_to(root).parts)
    if not any(_plain(part) in families for part in parts):
        # The folder of a task, or one below it, was given as that of the dataset.
        above = root.resolve().parts
        task = next(
            (number for number, part in enumerate(above) if _plain(part) in families),
            len(above),
        )
        parts = [*(part for part in above[task:] if _is_known(part)), *parts]
    family = next(
        (families[_plain(part)] for part in parts if _plain(part) in families), None
    )
    if family is not None:
        others = [part for part in parts if families.get(_plain(part)) != family]
        variant = _variant(
            task_spec(family), [part for part in others if _plain(part) not in NEUTRAL]
        )
        if isinstance(variant, Variant):
            return variant
        # Where the published form is, folders of unknown names beside it are extra ones.
        is_named = all(_plain(part) in NEUTRAL or _is_known(part) for part in others)
        is_extra = (
            not is_named
            and "json" not in map(_plain, parts)
            and (root / "data").is_dir()
        )
        return replace(_finding(root, folder, *variant), left_out=not is_extra)
    near = [
        hit for part in parts for hit in get_close_matches(_plain(part), families, n=1)
    ]
    hint = (
        f"did you mean that of {families[near[0]]}?"
        if near
        else f"that of a task below {', '.join(Group)}"
    )
    is_data = bool(parts) and _plain(parts[0]) in NEUTRAL
    return replace(
        _finding(root, folder, "no folder above it is a known task", hint),
        left_out=is_data,
    )


def _is_known(part: str) -> bool:
    """Return whether a folder's name is that of a task, a material or a subtask."""
    plain = _plain(part)
    specs = [task_spec(family) for family in set(_families().values())]
    materials = {
        _plain(name)
        for spec in specs
        for name in (*spec.materials, *spec.metadata_materials.values())
    }
    return (
        plain in _families()
        or plain in materials
        or SUBTASK_FOLDER.fullmatch(part) is not None
    )


def _one_form(
    root: Path, variant: Variant, files: list[Path], findings: list[ImportFinding]
) -> tuple[Path, ...]:
    """Return the files of the first form and place of a variant's trials; add a finding for each other one."""
    places: dict[tuple[bool, int, tuple[str, ...]], list[Path]] = {}
    for path in files:
        words = tuple(
            part
            for part in path.parent.relative_to(root).parts
            if _plain(part) in NEUTRAL
        )
        is_published = path.suffix.lower() == ".json" and "json" in map(_plain, words)
        places.setdefault(
            (not is_published, FORMS.index(path.suffix.lower()), words), []
        ).append(path)
    first, *others = sorted(places)
    for place in others:
        problem = f"{len(places[place])} files {places[place][0].suffix} of {variant.name} are not read"
        kept = printable(places[first][0].relative_to(root).parent.as_posix())
        finding = _finding(
            root, places[place][0].parent, problem, f"its trials in {kept} count"
        )
        findings.append(replace(finding, left_out=False))
    return tuple(sorted(places[first], key=_natural))


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
        elif not TRIAL_FOLDER.fullmatch(folder):
            return f"{folder!r} is neither a material nor a subtask of {spec.family}", (
                f"materials are {', '.join(names.values())}; subtasks: {subtasks}; "
                "if its trials are real ones, give the folder itself"
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
    wrong = task_file_faults()
    for family in dict.fromkeys(
        variant.family for variant in variants() if variant.family not in wrong
    ):
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
