"""Generated files are current, and the table `scripts/generated.toml` names each of them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import check_generated
import pytest
from generated import with_part
from places import ROOT

ENTRIES = check_generated.entries()
SLOW = "scoring/bands/events.toml"


def named(entry: Mapping[str, Any]) -> set[Path]:
    return {file for pattern in entry["files"] for file in ROOT.glob(pattern)}


@pytest.mark.parametrize(
    "entry",
    [pytest.param(one, marks=[pytest.mark.slow] if one["files"][0] == SLOW else []) for one in ENTRIES],
    ids=lambda entry: f"{entry['script']}-{entry['files'][0]}",
)
def test_generated_files_are_current(entry: Mapping[str, Any]) -> None:
    assert check_generated.faults(entry) == []
    assert sum(key in entry for key in ("check", "inputs", "measured")) == 1


def test_a_changed_input_and_a_missing_file_are_named() -> None:
    entry = {"script": "a.py", "files": ["docs/none.png"], "inputs": ["README.md"], "sha256": "0"}
    missing, changed = check_generated.faults(entry)
    assert missing == "docs/none.png: no such file"
    assert changed.startswith("docs/none.png: README.md changed. Run a.py, then set sha256 to ")


def test_every_script_that_builds_is_in_the_table() -> None:
    scripts = {str(file.relative_to(ROOT)) for file in (ROOT / "scripts").glob("build_*.py")}
    assert scripts <= {entry["script"] for entry in ENTRIES}
    assert all((ROOT / entry["script"]).is_file() for entry in ENTRIES if entry["script"].endswith(".py"))


def test_files_that_name_their_script_are_in_its_row() -> None:
    by_script: dict[str, set[Path]] = {}
    for entry in ENTRIES:
        by_script.setdefault(entry["script"], set()).update(named(entry))
    marked = 0
    copies = ROOT / "docs" / "studies"  # Of a build of the docs.
    for folder in ("docs", "scoring", "studies"):
        for file in (ROOT / folder).rglob("*"):
            if file.suffix in (".md", ".toml", ".csv") and "_build" not in file.parts and file.parent != copies:
                for script in re.findall(r"ritten by (scripts/\w+\.py)", file.read_text(encoding="utf-8")):
                    marked += 1
                    assert file in by_script[script], f"{file} names {script}"
    assert marked > 40


def test_a_part_of_a_page_is_replaced_and_its_marks_are_needed_once() -> None:
    page = "a\n<!-- x, written by scripts/s.py -->\nold\n<!-- end of x -->\nb\n"
    assert with_part(page, "x", "s.py", "new\n") == page.replace("old", "\nnew\n")
    for wrong in (page.replace("end of x", "end"), page + page, "a"):
        with pytest.raises(ValueError, match="needs the lines"):
            with_part(wrong, "x", "s.py", "new")
