"""A change of what decides scores raises the revision of its experiment.

`revisions.json` has the revision of each family and a hash of what decides its scores: the task file without its texts,
and the numbers of its references. After a raise, `python tests/experiments/test_revisions.py` writes it again.
"""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from gauge_envs.experiments.task_files import task_spec
from gauge_envs.experiments.variants import task_files
from gauge_envs.files import data_folder

LEDGER = Path(__file__).with_name("revisions.json")
TEXTS = {
    "decisions",
    "evaluates",
    "provenance",
    "revision",
    "source",
    "summary",
    "title",
}
REFERENCES = ("bands", "models", "single_shot", "statistics", "trials")


def numbers(value: Any) -> Any:
    """Return a value without the texts for readers, its keys sorted."""
    if isinstance(value, dict):
        return {
            key: numbers(inner)
            for key, inner in sorted(value.items())
            if key not in TEXTS
        }
    return [numbers(inner) for inner in value] if isinstance(value, list) else value


def reference_files(family: str) -> Iterator[Path]:
    for folder in REFERENCES:
        files = data_folder("scoring").joinpath(folder).glob(f"{family}-*")
        yield from sorted(
            file for file in files if file.suffix in (".csv", ".npz", ".toml")
        )


def fingerprint(task: dict[str, Any]) -> str:
    found = hashlib.sha256(json.dumps(numbers(task)).encode())
    for file in reference_files(task["family"]):
        content = file.read_bytes()
        found.update(
            json.dumps(numbers(tomllib.loads(content.decode()))).encode()
            if file.suffix == ".toml"
            else content
        )
    laws = tomllib.loads(
        (data_folder("scoring") / "bands" / "laws.toml").read_text(encoding="utf-8")
    )["law"]
    own = [numbers(law) for law in laws if law["variants"].startswith(task["family"])]
    found.update(json.dumps(own).encode())
    return found.hexdigest()


def current() -> dict[str, dict[str, Any]]:
    tasks = [tomllib.loads(file.read_text(encoding="utf-8")) for file in task_files()]
    return {
        task["family"]: {
            "revision": task.get("revision", 1),
            "sha256": fingerprint(task),
        }
        for task in tasks
    }


def not_raised(
    stated: dict[str, dict[str, Any]], found: dict[str, dict[str, Any]]
) -> list[str]:
    """Return the families whose numbers changed under the same revision."""
    both = {
        family: (stated[family], one)
        for family, one in found.items()
        if family in stated
    }
    return [
        family
        for family, (earlier, one) in both.items()
        if one["sha256"] != earlier["sha256"] and one["revision"] <= earlier["revision"]
    ]


def test_what_decides_scores_changes_only_with_the_revision() -> None:
    stated, found = json.loads(LEDGER.read_text(encoding="utf-8")), current()
    assert not_raised(stated, found) == [], (
        "scores may change: raise `revision` in the task file"
    )
    assert stated == found, "run `python tests/experiments/test_revisions.py`"


def test_a_change_without_a_raise_is_found() -> None:
    found = current()
    earlier = {"SlopeSlider": {"revision": 1, "sha256": "0" * 64}}
    assert not_raised(earlier, found) == ["SlopeSlider"]
    assert (
        not_raised(
            earlier, found | {"SlopeSlider": {"revision": 2, "sha256": "1" * 64}}
        )
        == []
    )


@pytest.mark.parametrize(
    ("old", "new", "changes"),
    [
        ("friction = 0.273673", "friction = 0.28", True),
        ("wood = 46", "wood = 47", True),
        ('title = "Slope slider"', 'title = "Slope"', False),
    ],
)
def test_the_fingerprint_knows_numbers_from_texts(
    old: str, new: str, changes: bool
) -> None:
    text = (data_folder("tasks") / "slope_slider.toml").read_text(encoding="utf-8")
    assert old in text
    edited = fingerprint(tomllib.loads(text.replace(old, new, 1)))
    assert (edited != fingerprint(tomllib.loads(text))) is changes


def test_a_task_file_states_its_revision() -> None:
    assert task_spec("SlopeSlider").revision == current()["SlopeSlider"]["revision"]


if __name__ == "__main__":
    if LEDGER.exists() and (
        kept := not_raised(json.loads(LEDGER.read_text(encoding="utf-8")), current())
    ):
        raise SystemExit(f"raise `revision` in the task file of {', '.join(kept)}")
    LEDGER.write_text(json.dumps(current(), indent=1) + "\n", encoding="utf-8")
