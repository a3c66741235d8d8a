"""Generated files are current, and the table `scripts/generated.toml` names each of them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import check_generated
import numpy as np
import pytest
from generated import same_arrays, same_text, settle, with_part
from places import ROOT

ENTRIES = check_generated.entries()
SLOW = "scoring/bands/events.toml"


def named(entry: Mapping[str, Any]) -> set[Path]:
    return {file for pattern in entry["files"] for file in ROOT.glob(pattern)}


@pytest.mark.parametrize(
    "entry",
    [
        pytest.param(one, marks=[pytest.mark.slow] if one["files"][0] == SLOW else [])
        for one in ENTRIES
    ],
    ids=lambda entry: f"{entry['script']}-{entry['files'][0]}",
)
def test_generated_files_are_current(entry: Mapping[str, Any]) -> None:
    assert check_generated.faults(entry) == []
    assert sum(key in entry for key in ("check", "inputs", "measured")) == 1


def test_a_changed_input_and_a_missing_file_are_named() -> None:
    entry = {
        "script": "a.py",
        "files": ["docs/none.png"],
        "inputs": ["README.md"],
        "sha256": "0",
    }
    missing, changed = check_generated.faults(entry)
    assert missing == "docs/none.png: no such file"
    assert changed.startswith(
        "docs/none.png: README.md changed. Run a.py, then set sha256 to "
    )


def test_every_script_that_builds_is_in_the_table() -> None:
    scripts = {
        str(file.relative_to(ROOT)) for file in (ROOT / "scripts").glob("build_*.py")
    }
    assert scripts <= {entry["script"] for entry in ENTRIES}
    assert all(
        (ROOT / entry["script"]).is_file()
        for entry in ENTRIES
        if entry["script"].endswith(".py")
    )


def test_files_that_name_their_script_are_in_its_row() -> None:
    by_script: dict[str, set[Path]] = {}
    for entry in ENTRIES:
        by_script.setdefault(entry["script"], set()).update(named(entry))
    marked = 0
    copies = ROOT / "docs" / "studies"  # Of a build of the docs.
    for folder in ("docs", "scoring", "studies"):
        for file in (ROOT / folder).rglob("*"):
            if (
                file.suffix in (".md", ".toml", ".csv")
                and "_build" not in file.parts
                and file.parent != copies
            ):
                for script in re.findall(
                    r"ritten by (scripts/\w+\.py)", file.read_text(encoding="utf-8")
                ):
                    marked += 1
                    assert file in by_script[script], f"{file} names {script}"
    assert marked > 40


def test_a_part_of_a_page_is_replaced_and_its_marks_are_needed_once() -> None:
    page = "a\n<!-- x, written by scripts/s.py -->\nold\n<!-- end of x -->\nb\n"
    assert with_part(page, "x", "s.py", "new\n") == page.replace("old", "\nnew\n")
    for wrong in (page.replace("end of x", "end"), page + page, "a"):
        with pytest.raises(ValueError, match="needs the lines"):
            with_part(wrong, "x", "s.py", "new")


PRINTED = (
    "frame,mean\n12,501.235,-0.0274632,0.5,8.1e-05,0.030000000000000013\n"
    "sha256 = 1e5f, version 3.11.0, 17.5 mm.\n"
)


@pytest.mark.parametrize(
    ("stored", "generated"),
    [
        ("501.235", "501.236"),
        ("-0.0274632", "-0.0274633"),
        ("8.1e-05", "8.11e-05"),
        ("8.1e-05", "8.0e-05"),
        ("0.030000000000000013", "0.03"),
        ("0.030000000000000013", "0.03000000000000032"),
    ],
)
def test_the_last_printed_place_of_a_number_is_that_of_another_processor(
    stored: str, generated: str
) -> None:
    assert same_text(PRINTED, PRINTED.replace(stored, generated))
    assert same_text(PRINTED.replace(stored, generated), PRINTED)


@pytest.mark.parametrize(
    ("stored", "generated"),
    [
        ("12", "13"),
        ("501.235", "501.237"),
        ("501.235", "501"),
        ("-0.0274632", "-0.0274634"),
        ("-0.0274632", "0.0274632"),
        ("0.5", "0.6"),
        ("0.5", "5"),
        ("17.5", "17.6"),
        ("8.1e-05", "8.1e-04"),
        ("8.1e-05", "8.3e-05"),
        ("0.030000000000000013", "0.0300000001"),
        ("mean", "means"),
        ("version", "Version"),
        ("1e5f", "1e6f"),
        ("3.11.0", "3.11.1"),
        (",501.235", ", 501.235"),
        (",501.235", ""),
        (",501.235", ",501.235,501.235"),
        ("12,", "11,0.0\n12,"),
        ("mm.\n", "mm."),
        ("mm.\n", "mm.\n\n"),
    ],
)
def test_every_other_difference_of_a_generated_file_is_found(
    stored: str, generated: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "a.csv"
    file.write_text(PRINTED.replace(stored, generated), encoding="utf-8")
    assert settle({file: PRINTED}, "s.py", check=True) == 1
    assert f"{file} is not current: run python scripts/s.py" in capsys.readouterr().err
    assert settle({file: PRINTED}, "s.py", check=False) == 0
    assert settle({file: PRINTED}, "s.py", check=True) == 0


def test_arrays_differ_by_a_count_and_fits_in_their_last_digits() -> None:
    stored = {
        "first": np.arange(3),
        "angle": np.array([5, -7], np.int16),
        "start": np.array([0.25, 1.5], np.float32),
    }
    one = np.array([1, 0], np.int16)
    assert same_arrays(stored, {**stored, "angle": stored["angle"] + one})
    assert same_arrays(
        stored, {**stored, "start": np.nextafter(stored["start"], np.float32(9.0))}
    )
    changed = {
        "first": np.array([0, 1, 3]),
        "angle": stored["angle"] + 2 * one,
        "start": stored["start"] * np.float32(1.0001),
        "more": stored["first"],
    }
    for name, array in changed.items():
        assert not same_arrays(stored, {**stored, name: array}), name
    assert not same_arrays(stored, {**stored, "angle": stored["angle"][:1]})
    assert not same_arrays(
        stored, {**stored, "angle": stored["angle"].astype(np.int32)}
    )
