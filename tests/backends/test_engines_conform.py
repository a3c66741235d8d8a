"""Every installed engine passes, fails and declines the conformance checks as published in `scoring/conformance.json`.

One run for each engine states the laws of mechanics, so that the tests of an engine need not. The default run leaves
out what takes seconds on the engine; `-m slow` runs all checks.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import pytest
from places import ROOT

from gauge_envs.tools.conformance import checks, run_checks

PUBLISHED = {
    column["backend"]: column["findings"]
    for column in json.loads((ROOT / "scoring" / "conformance.json").read_text())[
        "columns"
    ]
    if column["name"] == "default"
}
"""Published results of all checks with the default configuration of each engine, by its name and their ids."""


@dataclass(frozen=True, kw_only=True)
class Engine:
    """An engine, and what it runs by default.

    Attributes:
        name: Name of the backend.
        module: Module of the engine.
        quick: Patterns of the checks of the default run, beside those that it is published to decline.
        long: Patterns of checks that take too long for it.
    """

    name: str
    module: str
    quick: Sequence[str] = ("*",)
    long: Sequence[str] = ()

    def allowed(self, check):
        """Return how a check may end: as published."""
        published = PUBLISHED[self.name].get(check)
        if published is None:  # The check is new.
            return {"pass", "declined"}
        return {published["status"]}

    def chosen(self):
        """Return the ids of the checks of the default run."""
        return [
            one.id
            for one in checks()
            if self.allowed(one.id) == {"declined"}
            or (
                any(fnmatchcase(one.id, pattern) for pattern in self.quick)
                and not any(fnmatchcase(one.id, pattern) for pattern in self.long)
            )
        ]


CORE = (
    *(
        "start-*",
        "starts-*",
        "order-of-names",
        "time",
        "free-fall*",
        "pendulum-*",
        "spin-*",
        "angular-velocity",
        "velocity-*",
    ),
    *(
        "wrench-frame",
        "wrench-force",
        "inertia-box",
        "stated-inertia",
        "inertia-union",
        "contact-*",
        "slide",
    ),
    *("slide-of-pair", "hold", "rebound-0.5", "roll-ball"),
)
"""Checks of every kind of law that a heavy engine runs by default."""

LONG = (
    *(
        "determinism",
        "driven-*",
        "pushed-ball",
    ),
    *("rebound-slow", "pile-*"),
    *(
        "carry-line",
        "carry-turn",
        "reset-start",
        "finite",
        "grasp-*",
    ),
)
"""Checks that take a quarter of a second or more, each beside a shorter one of the same law or contract."""

ENGINES = (
    Engine(
        name="mujoco",
        module="mujoco",
        long=(
            *LONG,
            *(
                "foam-*",
                "*-rests-on",
                "*-strike",
            ),
            *("rope-mass", "rope-nodes", "rope-pulled-*", "rope-start", "rod-start"),
            *("cloth-clamp", "cloth-held", "air-friction"),
        ),
    ),
    Engine(
        name="rapier",
        module="rapier3d",
        quick=(*CORE, "wrench-hinged", "tether-*", "roll-cylinder"),
        long=LONG,
    ),
    Engine(
        name="physx",
        module="sapien",
        quick=(*CORE, "wrench-hinged"),
        long=LONG,
    ),
    Engine(
        name="pybullet",
        module="pybullet",
        quick=(*CORE, "force-*", "rope-period", "torsion", "rolling"),
    ),
    Engine(
        name="newton",
        module="newton",
        quick=(*CORE, "force-*", "cloth-slide", "foam-pinned-face"),
    ),
    Engine(
        name="drake",
        module="pydrake",
        quick=(*CORE, "carry-line"),
    ),
    Engine(
        name="genesis",
        module="genesis.version",
        quick=(
            "free-fall",
            "slide",
            "slide-of-pair",
            "carry-line",
            "rebound-0.5",
            "rebound-0.95",
            "tether-*",
        ),
    ),
)
RUNS = [
    *(pytest.param(one, one.chosen(), id=one.name) for one in ENGINES),
    *(
        pytest.param(one, [], id=f"{one.name}, all checks", marks=pytest.mark.slow)
        for one in ENGINES
    ),
]


@pytest.mark.parametrize(("engine", "only"), RUNS)
def test_the_engine_obeys_the_laws(engine, only):
    pytest.importorskip(engine.module)
    results = list(run_checks(engine.name, only=only))
    assert [one.check for one in results] == (only or [one.id for one in checks()])
    moved = [
        f"{one.check}: {one.status.value} {one.measured} {one.diagnosis} {one.missing}"
        for one in results
        if one.status.value not in engine.allowed(one.check)
    ]
    assert moved == [], "scoring/conformance.json has other results"
