"""Write `tests/experiments/revisions.json`: the revision of each family, and a digest of what decides its scores.

A change of a task file or of a reference raises `revision` in the task file; a test compares the two.
"""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

from gauge_envs.experiments.variants import task_files
from scripts.generated import ROOT, SCORING, not_raised
from scripts.inputs import references_digest, task_digest

LEDGER = ROOT / "tests" / "experiments" / "revisions.json"


def current(scoring: Path = SCORING) -> dict[str, dict[str, Any]]:
    """Return the revision and the digest of each family."""
    found = {}
    for file in task_files():
        task = tomllib.loads(file.read_text(encoding="utf-8"))
        family = task["family"]
        found[family] = {
            "revision": task.get("revision", 1),
            "digest": f"{task_digest(file)} {references_digest(family, scoring)}",
        }
    return found


def contents(scoring: Path = SCORING) -> dict[Path, str]:
    """Return the ledger.

    Raises:
        ValueError: The numbers of a family changed, and its revision is the same.
    """
    found = current(scoring)
    stated = json.loads(LEDGER.read_text(encoding="utf-8"))
    if kept := not_raised(stated, found, "revision"):
        raise ValueError(f"raise `revision` in the task file of {', '.join(kept)}")
    return {LEDGER: json.dumps(found, indent=1, sort_keys=True) + "\n"}
