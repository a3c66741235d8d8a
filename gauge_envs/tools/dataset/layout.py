"""Find the trial files of a dataset folder, and the variant of each.

The published layout is

    data/<rigid|rope|textile|deformable>/<task>/json/<material>/[task-N/]<trial>.json

Folders are read by their names, in any order, spelling and depth: a task, a material, a subtask, and words that say
nothing about a trial (`NEUTRAL`). Irregularities of the published folders are read too:

- A task folder differs from the metadata's spelling (`foam compression`).
- Materials have the metadata's names (`cotton` is the rayon of this package).
- A task with one material may have no material folder (bouncing ball).

Trials in a folder of any other name may not be the published ones: they are left out and reported.
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
from gauge_envs.experiments.task_format import Group
from gauge_envs.experiments.variants import Variant, matching_variants, variants
from gauge_envs.files import json_document, printable
from gauge_envs.tools.dataset.findings import ImportFinding

LAYOUT = "data/<group>/<task>/json/<material>/[task-N/]<trial>.json"
"""The published layout in messages."""

REVISION_FILE = "gauge-dataset.json"
"""File at the top of a downloaded dataset that states its revision."""

FOLDER_SPELLINGS = {"foamcompression": "foamcompressing"}
"""Letters of task folders whose spelling differs from the metadata's."""

NEUTRAL = {*Group, "data", "json", "mocap", "trials", "trajectories"}
"""Names of folders that say nothing about a trial."""


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
    found: dict[Variant, list[Path]] = {}
    findings = []
    for folder, paths in _json_files(root).items():
        variant = _variant(root, folder)
        if variant is not None:
            found.setdefault(variant, []).extend(paths)
            continue
        below = folder.relative_to(root)
        finding = ImportFinding(
            file=printable(below.as_posix()),
            key="(folder)",
            problem="it names no known task, material and subtask",
            expected=f"{LAYOUT} is expected",
            # Other files beside the published ones may be anything.
            left_out="json" in below.parts,
        )
        findings.append(finding)
    files = {
        variant: sorted(found[variant], key=_numeric_order)
        for variant in variants()
        if variant in wanted and variant in found
    }
    if not files:
        reasons = "".join(f"\n  {finding}" for finding in findings[:5])
        raise DatasetError(
            f"{root}: contains no trial of {', '.join(only)}; {LAYOUT} is expected{reasons}"
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


def _json_files(root: Path) -> dict[Path, list[Path]]:
    """Return the JSON files below a folder that are not hidden, by their folders."""
    folders: dict[Path, list[Path]] = {}
    for path in sorted(root.rglob("*.json")):
        below = path.relative_to(root)
        is_hidden = any(part.startswith(".") for part in below.parts)
        if not is_hidden and path.name != REVISION_FILE:
            folders.setdefault(path.parent, []).append(path)
    return folders


def _variant(root: Path, folder: Path) -> Variant | None:
    """Return the variant of the trials in a folder, or None."""
    names = {plain_name(part) for part in folder.relative_to(root).parts}
    return _folder_names().get(frozenset(names - NEUTRAL))


@cache
def _folder_names() -> dict[frozenset[str], Variant]:
    """Return the variants by the names of their folders."""
    found = {}
    for variant in variants():
        spec = task_spec(variant.family)
        metadata = Path(spec.source.metadata.partition(".json")[0])
        names = {plain_name(metadata.name)}
        if variant.subtask:
            names.add(f"task{variant.subtask}")
        if len(spec.materials) == 1:
            found[frozenset(names)] = variant
        for published in (
            variant.material,
            spec.metadata_materials.get(variant.material, variant.material),
        ):
            found[frozenset({*names, published})] = variant
    return found


def plain_name(name: str) -> str:
    """Return the letters and digits of a name in lower case."""
    plain = re.sub(r"[^a-z0-9]", "", name.lower())
    return FOLDER_SPELLINGS.get(plain, plain)


def _numeric_order(path: Path) -> list[int | str]:
    """Return a sort key that puts trial-2 before trial-10."""
    parts = re.split(r"([0-9]+)", path.as_posix())
    return [int(part) if index % 2 else part for index, part in enumerate(parts)]
