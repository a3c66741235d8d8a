"""`make check` runs the tests that are near to what has changed, nearest first."""

from __future__ import annotations

import os

import pytest
from places import ROOT
from programs import run_python

from scripts.changed_tests import importers, near_tests

NEAREST = {
    "gauge_envs/tools/leaderboard/archive.py": "tests/tools/leaderboard/test_leaderboard.py",
    "gauge_envs/evaluation/metrics/trajectory.py": "tests/evaluation/metrics/test_metrics_trajectory.py",
    "gauge_envs/backends/physx/__init__.py": "tests/backends/physx/test_physx_laws.py",
    "tests/tools/leaderboard/test_leaderboard.py": "tests/tools/leaderboard/test_leaderboard.py",
    "tasks/slope_slider.toml": "tests/experiments/test_revisions.py",
    "docs/leaderboard.md": "tests/docs/test_docs.py",
}


@pytest.fixture(scope="module")
def edges() -> dict[str, set[str]]:
    return importers()


@pytest.mark.slow
@pytest.mark.parametrize(("changed", "test"), NEAREST.items())
def test_a_test_of_what_changed_is_among_the_nearest(
    changed: str, test: str, edges: dict[str, set[str]]
) -> None:
    found = near_tests([changed], edges)
    assert test in found
    assert found[test] <= 2
    assert list(found.values()) == sorted(found.values())


def test_a_file_that_nothing_reads_has_no_tests() -> None:
    assert near_tests(["absent" + ".txt"], {}) == {}


def test_a_test_that_would_begin_too_late_is_named_and_not_run() -> None:
    words = ["-p", "scripts.changed_tests", "tests/test_layers.py"]
    done = run_python(
        *("-m", "pytest", "-p", "no:cacheprovider", *words),
        cwd=ROOT,
        env=os.environ | {"GAUGE_CHECK_END": "0"},
    )
    assert "the time is over; not run:" in done.stdout, done.stderr
    assert "passed" not in done.stdout
