"""The list of experiments: its table, and its rows as they were stored when the package was made.

To compute the rows takes seconds: each scene is built, and each engine is asked for what it lacks.
"""

import hashlib
import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from gauge_envs.errors import MissingExtraError
from gauge_envs.experiments.variants import Variant, task_files
from gauge_envs.pages.table import Column, Table
from gauge_envs.pages.text import short_id, shortened
from gauge_envs.references.user_data import has_import
from gauge_envs.registry import engine_points, is_installed

STORED = Path(__file__).with_name("overview.json")


def inputs() -> dict[str, str]:
    """Return what the stored rows depend on and a user may change: the task files, and the version of MuJoCo."""
    content = hashlib.sha256(b"".join(file.read_bytes() for file in task_files()))
    try:
        mujoco = version("mujoco").partition(".")[0]
    except PackageNotFoundError:
        mujoco = ""
    return {"tasks": content.hexdigest(), "mujoco": mujoco}


def stored_rows(variants: Iterable[Variant]) -> list[dict[str, Any]] | None:
    """Return the rows of `list_rows` from the file; None where a task file or an engine is another one.

    Whether an engine is installed is looked up, and not whether it works.
    """
    stored = json.loads(STORED.read_bytes())
    variants = tuple(variants)
    if (
        stored["inputs"] != inputs()
        or any(variant.id not in stored["facts"] for variant in variants)
        or {point.name: point.value for point in engine_points()} != stored["engines"]
    ):
        return None
    absent = {}
    for name, modules in stored["modules"].items():
        missing = next((module for module in modules if not is_installed(module)), None)
        if missing is not None:
            error = MissingExtraError(
                f"backend {name!r}", name, ModuleNotFoundError(name=missing)
            )
            absent[name] = [str(error)]
    return [
        stored["facts"][variant.id]
        | {
            "imported": has_import(variant.name),
            "backends": stored["lacks"][variant.id] | absent,
        }
        for variant in variants
    ]


def list_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Return the rows of `list_rows` as a table."""
    imported = [short_id(row["id"]) for row in rows if row["imported"]]
    # An engine that runs nothing is not installed or broken; it is no exception in each row.
    working = {
        name for row in rows for name, lacks in row["backends"].items() if not lacks
    }
    return Table(
        columns=(
            Column("id", "id"),
            Column("group", "group", wide_only=True),
            Column("observable", "observable", wide_only=True),
            Column("frames", "frames", is_number=True, wide_only=True),
            Column("kind", "kind"),
            Column(
                "imported",
                "imported trials",
                lambda known: "yes" if known else "no",
                wide_only=True,
            ),
            Column("backends", "runs on", partial(_usable_text, working=working)),
        ),
        rows=rows,
        notes=(f"Real trials imported for {shortened(imported)}.",) if imported else (),
    )


def _usable_text(
    backends: Mapping[str, Sequence[str]], *, working: Collection[str]
) -> str:
    """Return the engines that run an experiment, of those that run any."""
    usable = [name for name, lacks in backends.items() if not lacks]
    others = [name for name, lacks in backends.items() if lacks and name in working]
    if len(usable) > 2 and len(others) < 2:
        return f"all {len(usable)}" if not others else f"all but {others[0]}"
    return ", ".join(usable) or "none"
