"""Find the trial files of a dataset folder, and the variant of each.

The published layout is

    data/<rigid|rope|textile|deformable>/<task>/json/<material>/[task-N/]<trial>.json

The names of folders give task, material and subtask, in any order, spelling and depth. Names in `NEUTRAL` are ignored.
Irregular published folders are supported:

- The spelling of a task folder differs from the metadata (`foam compression`).
- Materials have the names of the metadata (`cotton` is the rayon of this package).
- A task with one material may lack a material folder (bouncing ball).

Trials in other folders may not be published trials, so they are left out and reported.
"""

import json
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from gauge_envs.errors import DatasetError
from gauge_envs.experiments.task_files import task_spec
from gauge_envs.experiments.task_format import Matter
from gauge_envs.experiments.variants import Variant, matching_variants, variants
from gauge_envs.files import is_folder
from gauge_envs.reading import content_of
from gauge_envs.text import json_document, printable
from gauge_envs.tools.dataset.findings import ImportFinding, TrialError

LAYOUT = "data/<group>/<task>/json/<material>/[task-N/]<trial>.json"
"""The published layout in messages."""

REVISION_FILE = "gauge-dataset.json"
"""File in the folder of a downloaded dataset that names its revision."""

FOLDER_SPELLINGS = {"foamcompression": "foamcompressing"}
"""Names of task folders with a different spelling in the metadata."""

NEUTRAL = {*Matter, "data", "json", "mocap", "trials", "trajectories"}
"""Ignored names of folders."""


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Trial files of a dataset folder.

    Attributes:
        root: Folder of the dataset.
        revision: Revision of the dataset; None if unknown.
        files: Trial files by variant, in the order of the variants and of the file names.
        findings: Folders of unknown experiments.
    """

    root: Path
    revision: str | None
    files: Mapping[Variant, Sequence[Path]]
    findings: Sequence[ImportFinding]


def find_trials(root: Path, *, only: Sequence[str] = ("*",)) -> Layout:
    """Find the trial files of a dataset.

    Args:
        root: Folder of the dataset, which contains `data`, or the folder `data`.
        only: Patterns of variants, for example `SlopeSlider-*`, with or without `GAUGE/`.

    Raises:
        DatasetError: The folder contains no trial of these variants.
        UnknownNameError: A pattern matches no variant.
    """
    selected = {name for pattern in only for name in matching_variants(pattern)}
    if not is_folder(root):
        raise DatasetError(f"{root}: not a folder; expected the folder of the dataset")
    paths_of: dict[Variant, list[Path]] = {}
    findings = []
    for folder, paths in _json_files(root).items():
        below = folder.relative_to(root)
        names = frozenset(map(plain_name, below.parts))
        variant = _folder_names().get(names - NEUTRAL)
        if variant is not None:
            paths_of.setdefault(variant, []).extend(paths)
            continue
        problem = "unknown task, material or subtask"
        error = TrialError("(folder)", problem, f"expected {LAYOUT}")
        # Files outside of a folder `json` are not trials.
        is_trial = "json" in below.parts
        findings.append(error.finding(below.as_posix(), left_out=is_trial))
    files = {
        variant: sorted(paths_of[variant], key=_numeric_order)
        for variant in variants()
        if variant in selected and variant in paths_of
    }
    if not files:
        raise DatasetError(f"{root}: no trial of {', '.join(only)}; expected {LAYOUT}")
    return Layout(root=root, revision=_revision(root), files=files, findings=findings)


def write_revision(root: Path, revision: str) -> None:
    """Write the revision into the folder of a dataset."""
    text = json.dumps({"revision": revision}) + "\n"
    (root / REVISION_FILE).write_text(text, encoding="utf-8")


def _revision(root: Path) -> str | None:
    """Return the revision, or None if its file is missing or damaged."""
    for folder in (root, root.parent):
        with suppress(OSError, ValueError, TypeError, KeyError):
            document = json_document(content_of(folder / REVISION_FILE))
            return printable(document["revision"])
    return None


def _json_files(root: Path) -> dict[Path, list[Path]]:
    """Return the visible JSON files below a folder, by folder."""
    folders: dict[Path, list[Path]] = {}
    for path in sorted(root.rglob("*.json")):
        below = path.relative_to(root)
        is_hidden = any(part.startswith(".") for part in below.parts)
        if not is_hidden and path.name != REVISION_FILE:
            folders.setdefault(path.parent, []).append(path)
    return folders


@cache
def _folder_names() -> dict[frozenset[str], Variant]:
    """Return the variants by the names of their folders."""
    variant_of = {}
    for variant in variants():
        spec = task_spec(variant.family)
        metadata = Path(spec.source.metadata.partition(".json")[0])
        names = {plain_name(metadata.name)}
        if variant.subtask:
            names.add(f"task{variant.subtask}")
        if len(spec.materials) == 1:
            variant_of[frozenset(names)] = variant
        for published in (
            variant.material,
            spec.metadata_materials.get(variant.material, variant.material),
        ):
            variant_of[frozenset({*names, published})] = variant
    return variant_of


def plain_name(name: str) -> str:
    """Return the letters and digits of a name in lower case."""
    plain = re.sub(r"[^a-z0-9]", "", name.lower())
    return FOLDER_SPELLINGS.get(plain, plain)


def _numeric_order(path: Path) -> list[int | str]:
    """Return a sort key that puts trial-2 before trial-10."""
    parts = re.split(r"([0-9]+)", path.as_posix())
    return [int(part) if index % 2 else part for index, part in enumerate(parts)]
