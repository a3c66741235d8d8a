"""The tables of the page of conformance are what their data gives."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

from places import ROOT

from gauge_envs.tools.conformance.matrix import read_columns
from scripts import build_conformance
from scripts.generated import stale_files

DATA = ROOT / "scoring" / "conformance.json"


def test_every_engine_has_its_default_and_its_documented_defaults() -> None:
    columns = read_columns(DATA)
    engines = {column.backend for column in columns}
    assert engines == {
        "mujoco",
        "newton",
        "physx",
        "pybullet",
        "rapier",
        "drake",
        "genesis",
    }
    names = {(column.backend, column.name) for column in columns if column.findings}
    assert names >= {
        (engine, name) for engine in engines for name in ("default", "out_of_box")
    }


def test_a_failure_that_is_planted_in_the_data_makes_the_page_stale(
    tmp_path: Path,
) -> None:
    document = json.loads(DATA.read_text(encoding="utf-8"))
    column = next(
        one
        for one in document["columns"]
        if (one["backend"], one["name"]) == ("rapier", "default")
    )
    column["findings"]["slide"] |= {"status": "fail", "measured": 3.0}
    file = Path(shutil.copy(DATA, tmp_path / DATA.name))
    file.write_text(json.dumps(document), encoding="utf-8")
    contents = build_conformance.contents(tmp_path)
    assert build_conformance.PAGE in stale_files(contents)
    (text,) = (text for page, text in contents.items() if "conformance.md" in str(page))
    assert (
        "- rapier, `slide`: 3, +27.4 % instead of 2.355 +- 0.024 m/s^2. Hints of the check: "
        in text
    )
    assert "| rapier | `default` |  | 122 of 126 |" in text
    (row,) = [line for line in text.splitlines() if line.startswith("| `slide` |")]
    assert row.split(" | ")[2:] == ["✓✓", "✓✓", "✓✓", "✓✗", "✗✓", "✓✓", "✓✗ |"]
