"""Every installed engine has the results of the conformance checks that `scoring/conformance.json` publishes.

The default run has checks that meet each method of an adapter once, but for contacts and driven motion, which
`test_constants.py` and `test_contract.py` have; `-m slow` runs all checks.
"""

import json

import pytest
from places import ROOT

from gauge_envs.tools.conformance import Status, checks, run_checks

MODULES = {
    "mujoco": "mujoco",
    "rapier": "rapier3d",
    "physx": "sapien",
    "pybullet": "pybullet",
    "newton": "newton",
    "drake": "pydrake",
    "genesis": "genesis.version",
}
QUICK = (
    "start-position",
    "start-orientation",
    "settings-step",
    "glide-reports",
    "free-fall",
    "spin-momentum",
    "wrench-force",
    "inertia",
    "stated-inertia",
    "contact-force",
    "tether-length",
    "wrench-reset",
    "restart-after-nan",
    "worlds-wrench",
    "torsion",
    "drop-energy",
    "cloth-start",
    "foam-start",
    "rope-start",
)
LATE = {
    "newton": {*QUICK}
    - {"start-position", "wrench-force", "worlds-wrench", "cloth-start", "rope-start"},
    "pybullet": {"worlds-wrench", "glide-reports"},
}
"""Checks that only the slow run has on an engine, whose scenes take long to build."""

PUBLISHED = {
    column["backend"]: column["results"]
    for column in json.loads((ROOT / "scoring" / "conformance.json").read_text())[
        "columns"
    ]
    if column["name"] == "default"
}
"""Published results of all checks with the default configuration of each engine, by its name and their ids."""


def agrees(engine, only):
    pytest.importorskip(MODULES[engine])
    results = list(run_checks(engine, only=only))
    assert {result.check for result in results} == set(only)
    moved = [
        f"{result.check}: {result.status} {result.measured} {result.diagnosis} {result.missing}"
        for result in results
        if result.status != Status(PUBLISHED[engine][result.check]["status"])
    ]
    assert moved == [], "scoring/conformance.json has other results"


@pytest.mark.parametrize("engine", MODULES)
def test_an_adapter_has_the_published_results(engine):
    late = LATE.get(engine, ())
    agrees(engine, [name for name in QUICK if name not in late])


@pytest.mark.slow
@pytest.mark.parametrize("engine", MODULES)
def test_an_engine_has_all_published_results(engine):
    agrees(engine, [check.id for check in checks()])


def test_published_results_are_those_of_the_current_checks():
    """A result of an earlier revision would be left out of the pages without a word."""
    current = {check.id: check.fingerprint for check in checks()}
    for engine, results in PUBLISHED.items():
        stored = {name: result["fingerprint"] for name, result in results.items()}
        assert stored.items() <= current.items(), engine
