"""Every installed engine passes, fails and declines the conformance checks as published in `scoring/conformance.json`.

One run for each engine states the laws of mechanics, so that the tests of an engine need not. The default run has the
checks that are published to take little time; `-m slow` runs all.
"""

import json
from itertools import accumulate

import pytest
from places import ROOT

from gauge_envs.tools.conformance import checks, run_checks

BUDGET_S = 3.0
"""CPU time of the default run of an engine, as published [s]."""

LEAST = 4
"""Number of checks that run on any engine."""

MODULES = {
    "mujoco": "mujoco",
    "rapier": "rapier3d",
    "physx": "sapien",
    "pybullet": "pybullet",
    "newton": "newton",
    "drake": "pydrake",
    "genesis": "genesis.version",
}
PUBLISHED = {
    column["backend"]: column["findings"]
    for column in json.loads((ROOT / "scoring" / "conformance.json").read_text())[
        "columns"
    ]
    if column["name"] == "default"
}
"""Published results of all checks with the default configuration of each engine, by its name and their ids."""


def short(engine):
    """Return the ids of the checks of the default run: the quickest ones, within the budget."""
    found = PUBLISHED[engine]
    quickest = sorted(found, key=lambda name: found[name]["cpu_s"] or 0.0)
    spent_s = list(accumulate(found[name]["cpu_s"] or 0.0 for name in quickest))
    count = max(LEAST, sum(seconds < BUDGET_S for seconds in spent_s))
    return [one.id for one in checks() if one.id in quickest[:count]]


RUNS = [
    *(pytest.param(name, short(name), id=name) for name in MODULES),
    *(
        pytest.param(name, [], id=f"{name}, all checks", marks=pytest.mark.slow)
        for name in MODULES
    ),
]


@pytest.mark.parametrize(("engine", "only"), RUNS)
def test_the_engine_obeys_the_laws(engine, only):
    pytest.importorskip(MODULES[engine])
    published = PUBLISHED[engine]
    results = list(run_checks(engine, only=only))
    assert [one.check for one in results] == (only or [one.id for one in checks()])
    moved = [
        f"{one.check}: {one.status} {one.measured} {one.diagnosis} {one.missing}"
        for one in results
        if one.status != published[one.check]["status"]
    ]
    assert moved == [], "scoring/conformance.json has other results"
