"""Every installed engine passes, fails and declines the conformance checks as published in `scoring/conformance.json`.

One run for each engine states the laws of mechanics, so that the tests of an engine need not. The default run has the
checks that are published to take little time; `-m slow` runs all.
"""

import json

import pytest
from places import ROOT

from gauge_envs.tools.conformance import checks, run_checks

SHORT_S = 0.15
"""Published CPU time of a check up to which the default run has it [s]."""

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
    """Return the ids of the checks of the default run: all that take little, and one that any engine runs."""
    found = PUBLISHED[engine]
    ids = [one.id for one in checks()]
    return [one for one in ids if one in found and (found[one]["cpu_s"] or 0) < SHORT_S]


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
