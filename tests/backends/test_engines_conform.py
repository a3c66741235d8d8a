"""Every installed engine of this package passes the conformance checks, or declines scenes of kinds that it lacks.

One run for each engine states the laws of mechanics, so that the tests of an engine need not. The default run leaves
out what takes seconds on the engine; `-m slow` runs all checks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import pytest
from mutations import FAILS_ITSELF

from gauge_envs.tools.conformance import Status, checks, run_checks

DEFORMABLE = ("cloth", "air", "foam", "rope", "rod")
TURNING = ("torsion", "rolling")
GUIDES = (
    "slider-fall",
    "slider-line",
    "slider-limit",
    "hinge-limit",
    "ball-joint-cone",
)
MJCF = ("solver-pile", "solver-cloth")


@dataclass(frozen=True, kw_only=True)
class Engine:
    """An engine, and what it runs by default.

    Attributes:
        name: Name of the backend.
        module: Module of the engine.
        lacks: Beginnings of the ids of the checks that it declines.
        quick: Patterns of the checks of the default run.
        long: Patterns of checks that take too long for it.
    """

    name: str
    module: str
    lacks: tuple[str, ...] = ()
    quick: Sequence[str] = ("*",)
    long: Sequence[str] = ()

    def chosen(self):
        """Return the ids of the checks of the default run."""
        return [
            one.id
            for one in checks()
            if any(fnmatchcase(one.id, pattern) for pattern in self.quick)
            and not any(fnmatchcase(one.id, pattern) for pattern in self.long)
        ]


CORE = (
    *(
        "start-*",
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
    *("slide-of-pair", "hold", "rebound-0.5", "roll-ball", "restore"),
)
"""Checks of every kind of law that a heavy engine runs by default."""

LONG = (
    *(
        "restore-impact",
        "restore-rest",
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
        "joint-backlash-cycle",
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
        lacks=(*DEFORMABLE, *TURNING, "force-"),
        quick=(*CORE, *GUIDES, "joint-*", "tether-*", "roll-cylinder"),
        long=LONG,
    ),
    Engine(
        name="physx",
        module="sapien",
        lacks=(*DEFORMABLE, *TURNING, "solver-heap", "force-"),
        quick=(*CORE, *GUIDES, "joint-*"),
        long=LONG,
    ),
    Engine(
        name="pybullet",
        module="pybullet",
        lacks=(
            *("cloth", "air", "rod", "joint-armature", "joint-backlash"),
            *("foam-rests-on", "foam-strike", "rope-rests-on", "rope-strike"),
        ),
        quick=(*CORE, *GUIDES, "force-*", "rope-period", "torsion", "rolling"),
    ),
    Engine(
        name="newton",
        module="newton",
        lacks=("air",),
        quick=(*CORE, *GUIDES, "force-*", "cloth-slide", "foam-pinned-face"),
    ),
    Engine(
        name="drake",
        module="pydrake",
        lacks=(*DEFORMABLE, *TURNING, "solver-heap", "ball-joint"),
        quick=(*CORE, "carry-line"),
    ),
    Engine(
        name="genesis",
        module="genesis.version",
        lacks=("air", "hinged", "rope", "rod", *GUIDES, "force-"),
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
    bad = {
        one.check: f"{one.check}: {one.measured} {one.diagnosis}"
        for one in results
        if one.is_bad
    }
    own = FAILS_ITSELF.get(engine.name, frozenset())
    assert [text for name, text in bad.items() if name not in own] == []
    assert bad.keys() == own & {one.check for one in results}, (
        "a check that failed passes: mend this table"
    )
    declined = {one.check for one in results if one.status is Status.DECLINED}
    lacks = (*engine.lacks, "worlds-device")
    if engine.name != "mujoco":
        lacks += MJCF
    assert declined == {one.check for one in results if one.check.startswith(lacks)}
