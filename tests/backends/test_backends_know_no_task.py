"""A backend receives a scene and never the name of an experiment; no backend may treat an experiment specially."""

import re
from pathlib import Path

import pytest

import gauge_envs.backends
from gauge_envs.experiments.variants import task_files, variants

SOURCES = sorted(Path(gauge_envs.backends.__file__).parent.rglob("*.py"))
NAMES = sorted({variant.family for variant in variants()} | {path.stem for path in task_files() if "_" in path.stem})
"""Families, and the names of their files unless they are single English words."""


def test_the_search_finds_a_name() -> None:
    assert len(NAMES) > 20 and len(SOURCES) > 30
    assert named("if scene.name == 'SlopeSlider-2-wood':") == ["SlopeSlider"]


def named(text: str) -> list[str]:
    return [name for name in NAMES if re.search(rf"\b{name}\b", text)]


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.relative_to(SOURCES[0].parent).as_posix())
def test_no_source_file_names_a_task(path: Path) -> None:
    assert named(path.read_text(encoding="utf-8")) == []
