"""Approved outputs: what counts as a difference, and that each file has a test."""

from __future__ import annotations

import ast
from pathlib import Path

import approval
import pytest
from places import ROOT


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder of approved files with the file `one`."""
    monkeypatch.setattr(approval, "FOLDER", tmp_path)
    (tmp_path / "one.txt").write_text("wood   0.412 mm, 3 trials\n")
    return tmp_path


@pytest.mark.parametrize(
    ("text", "is_same"),
    [
        ("wood   0.413 mm, 3 trials\n", True),
        ("wood   0.415 mm, 3 trials\n", False),
        ("wood   0.412 mm, 4 trials\n", False),
        ("wood  0.412 mm, 3 trials\n", False),
        ("Wood   0.412 mm, 3 trials\n", False),
    ],
)
def test_a_text_differs_by_words_and_numbers(folder, text, is_same):
    assert (approval.difference("one", text, approve=False) == "") == is_same


def test_a_new_text_is_written_on_approval_alone(folder):
    assert "+new" in approval.difference("a/two", "new\n", approve=False)
    assert not (folder / "a").exists()
    assert approval.difference("a/two", "new\n", approve=True) == ""
    assert approval.difference("a/two", "new\n", approve=False) == ""


def test_a_text_does_not_depend_on_the_machine():
    text = '/home/me/x.csv  \ngauge-envs 0.2.0: {"wall_s": 1.5e-02, "versions": {"numpy": "2.1"}}\n\n'
    assert approval.without_machine(text, {"HOME": Path("/home/me")}) == (
        'HOME/x.csv\ngauge-envs VERSION: {"wall_s": ..., "versions": {...}}\n'
    )


def test_every_approved_file_has_a_test():
    words = {
        node.value.rpartition("/")[2]
        for file in (ROOT / "tests").rglob("*.py")
        for node in ast.walk(ast.parse(file.read_text()))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }
    files = approval.FOLDER.rglob("*.txt")
    assert [str(file) for file in files if file.stem not in words] == []
