"""Experiments differ only in data: the core treats none specially, and a backend does not see names."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

import gauge_envs
from gauge_envs.experiments.variants import beyond_variants, variants
from gauge_envs.files import data_folder

PACKAGE = Path(gauge_envs.__file__).parent
FAMILIES = sorted({variant.family for variant in (*variants(), *beyond_variants())})
NAMES = sorted(
    {*FAMILIES, *(path.stem for path in data_folder("tasks").glob("*_*.toml"))}
)
"""Families, and the names of their files unless they are single English words."""

BACKENDS = sorted((PACKAGE / "backends").rglob("*.py"))
CORE_ROOMS = (
    "scene",
    "references",
    "observables",
    "experiments",
    "scoring",
    "envs",
    "runs",
    "pages",
    "cli",
)
CORE = sorted(file for room in CORE_ROOMS for file in (PACKAGE / room).rglob("*.py"))
ID = re.compile(rf"(GAUGE/)?({'|'.join(FAMILIES)})(-[\w*-]*)?")


def named(text):
    return [name for name in NAMES if re.search(rf"\b{name}\b", text)]


def ids_in_code(text):
    """Strings that are the name of a family or an id; names in sentences are examples of messages."""
    for node in ast.walk(ast.parse(text)):
        if (
            isinstance(node, ast.Constant)
            and isinstance(node.value, str)
            and ID.fullmatch(node.value)
        ):
            yield node.value


@pytest.mark.parametrize(
    "path", BACKENDS, ids=lambda path: path.relative_to(PACKAGE).as_posix()
)
def test_no_backend_names_a_task(path):
    assert named(path.read_text()) == []


def test_the_core_treats_no_task_specially():
    ids_by_file = {path.name: list(ids_in_code(path.read_text())) for path in CORE}
    assert {name: ids for name, ids in ids_by_file.items() if ids} == {}
