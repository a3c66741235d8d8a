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
"""

import json
import os
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from gauge_envs.errors import DatasetError
from gauge_envs.experiments.task_files import task_spec
from gauge_envs.experiments.task_format import Group
from gauge_envs.experiments.variants import Variant, matching_variants, variants
from gauge_envs.files import json_document, printable
from gauge_envs.tools.dataset.findings import ImportFinding, TrialError

REVISION_FILE = "gauge-dataset.json"
"""File at the top of a downloaded dataset that states its revision."""

FOLDER_SPELLINGS = {"foamcompression": "foamcompressing"}
"""Letters of task folders whose spelling differs from the metadata's."""

NEUTRAL = {*Group, "data", "json", "mocap", "trials", "trajectories"}
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
    files: Mapping[Variant, Sequence[Path]]
    findings: Sequence[ImportFinding]

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

    Raises:
        DatasetError: The folder contains no trial of these variants.
        UnknownNameError: A pattern matches no variant.
    """
    wanted = {name for pattern in only for name in matching_variants(pattern)}
    if not root.is_dir():
        raise DatasetError(
            f"{root}: is not a folder; the folder of the dataset is expected"
        )
    found, findings = _read_folders(root)
    files = {
        variant: sorted(found[variant], key=_numeric_order)
        for variant in variants()
        if variant in wanted and variant in found
    }
    if not files:
        of = "" if set(variants()) <= wanted else f" of {', '.join(only)}"
        reasons = "".join(f"\n  {finding}" for finding in findings[:5])
        raise DatasetError(
            f"{root}: contains no trial{of}; data/<group>/<task>/json/<material>/<trial>.json is expected{reasons}"
        )
    return Layout(root=root, revision=_revision(root), files=files, findings=findings)


def write_revision(root: Path, revision: str) -> None:
    """State the revision in a dataset's folder."""
    text = json.dumps({"revision": revision}) + "\n"
    (root / REVISION_FILE).write_text(text, encoding="utf-8")


def _revision(root: Path) -> str | None:
    """Return the stated revision, or None; nothing is computed from it, so a damaged file is no error."""
    for folder in (root, root.parent):
        with suppress(OSError, ValueError, TypeError, KeyError):
            document = json_document((folder / REVISION_FILE).read_bytes())
            return printable(document["revision"])
    return None


def _read_folders(
    root: Path,
) -> tuple[dict[Variant, list[Path]], list[ImportFinding]]:
    """Return the trial files in a folder by variant, and a finding for each folder of files that are not read."""
    found: dict[Variant, list[Path]] = {}
    findings = []

    def report(folder: Path, error: TrialError, *, left_out: bool) -> None:
        file = folder.relative_to(root).as_posix()
        findings.append(error.finding(file, left_out=left_out))

    def report_unreadable(error: OSError) -> None:
        problem = f"it cannot be read: {error.strerror}"
        fault = TrialError("(folder)", problem, "a readable folder is expected")
        report(Path(error.filename), fault, left_out=True)

    for name, folders, names in os.walk(root, onerror=report_unreadable):
        folder = Path(name)
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        files = [
            folder / file
            for file in (*names, *folders)
            if Path(file).suffix.lower() == ".json"
            and not file.startswith(".")
            and file != REVISION_FILE
        ]
        if files:
            try:
                found.setdefault(_variant(root, folder), []).extend(files)
            except TrialError as error:
                # Trials of the published form count, other files beside them may be anything.
                is_published = "json" in map(_plain, folder.relative_to(root).parts)
                report(folder, error, left_out=is_published)
    return found, findings


def _variant(root: Path, folder: Path) -> Variant:
    """Return the variant of the trials in a folder.

    Raises:
        TrialError: The folder is that of no variant.
    """
    families = _families()
    below = folder.relative_to(root).parts
    parts = (*root.resolve().parts, *below)
    tasks = [index for index, part in enumerate(parts) if _plain(part) in families]
    if not tasks:
        problem = "no folder above it is a known task"
        expected = f"that of a task below {', '.join(Group)} is expected"
        raise TrialError("(folder)", problem, expected)
    family = families[_plain(parts[tasks[-1]])]
    # Folders above the dataset have any name; the dataset may be the folder of a task, or below it.
    parts = parts[min(tasks[-1], len(parts) - len(below)) :]
    folders = [part for part in parts if _plain(part) not in {*NEUTRAL, *families}]
    spec = task_spec(family)
    materials = {_plain(name): name for name in spec.materials}
    for name, published in spec.metadata_materials.items():
        materials[_plain(published)] = name
    material = spec.materials[0] if len(spec.materials) == 1 else None
    subtask = None
    is_known = True
    for part in folders:
        if _plain(part) in materials:
            material = materials[_plain(part)]
        elif match := SUBTASK_FOLDER.fullmatch(part):
            subtask = match[1]
        else:
            is_known = False
    if not is_known or not material or subtask not in (spec.subtasks or (None, "1")):
        problem = f"{'/'.join(folders)!r} names no material and subtask of {family}"
        subtasks = ", ".join(f"task-{name}" for name in spec.subtasks)
        expected = f"materials: {', '.join(materials.values())}; subtasks: {subtasks or 'no task folder'}"
        raise TrialError("(folder)", problem, expected)
    return Variant(family, subtask if spec.subtasks else None, material)


@cache
def _families() -> dict[str, str]:
    """Return the family of each task folder, by the folder's letters and digits in lower case."""
    families = {}
    for family in dict.fromkeys(variant.family for variant in variants()):
        metadata = Path(task_spec(family).source.metadata.partition(".json")[0])
        families[_plain(metadata.name)] = family
    for spelling, name in FOLDER_SPELLINGS.items():
        families[spelling] = families[name]
    return families


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


def _numeric_order(path: Path) -> list[int | str]:
    """Return a sort key that puts trial-2 before trial-10."""
    parts = re.split(r"([0-9]+)", path.as_posix())
    return [int(part) if index % 2 else part for index, part in enumerate(parts)]
