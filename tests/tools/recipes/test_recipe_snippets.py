"""Snippets of recipes give what is said in a plain loop of the engine."""

from __future__ import annotations

from functools import cache

import plain_loops
import pytest

from gauge_envs.tools.recipes import Aim, Recipe, engine_settings, find_recipe

FRICTION, RESTITUTION, MASS_KG, STEP_S = 0.4, 0.6, 0.5, 0.002
MODULES = {
    "mujoco": "mujoco",
    "rapier": "rapier3d",
    "physx": "sapien",
    "pybullet": "pybullet",
    "drake": "pydrake",
    "newton": "newton",
    "mujoco_warp": "mujoco_warp",
    "genesis": "genesis",
}
HEAVY = ("pybullet", "drake", "newton", "mujoco_warp", "genesis")
ENGINES = [pytest.param(name, marks=[pytest.mark.slow] if name in HEAVY else []) for name in MODULES]


@cache
def recipe(engine: str) -> Recipe:
    pytest.importorskip(MODULES[engine])
    aim = Aim(friction=FRICTION, restitution=RESTITUTION, mass_kg=MASS_KG, timestep_s=STEP_S)
    return find_recipe(engine_settings(engine), aim)


@pytest.mark.parametrize("engine", ENGINES)
def test_the_snippet_gives_what_is_said_in_a_plain_loop(engine: str) -> None:
    found = recipe(engine)
    friction, restitution = getattr(plain_loops, engine)(found.settings.snippet(MASS_KG), FRICTION, MASS_KG, STEP_S)
    assert found.found is not None
    # The plain plate has its edges along the slope; single drops scatter between phases.
    assert friction == pytest.approx(found.found.slide.along, rel=0.005)
    assert restitution == pytest.approx(found.reached["restitution"], abs=0.01)


@pytest.mark.parametrize("engine", ENGINES)
def test_what_is_said_is_what_is_asked(engine: str) -> None:
    found = recipe(engine)
    assert found.misses == ()
    assert found.reached["friction"] == pytest.approx(FRICTION, rel=0.01)
    assert found.reached["restitution"] == pytest.approx(RESTITUTION, abs=0.01)


def test_a_plain_loop_with_twice_the_step_is_noticed() -> None:
    """A planted fault: the step of the loop is not that of the recipe."""
    snippet = recipe("mujoco").settings.snippet(MASS_KG)
    _, restitution = plain_loops.mujoco(snippet, FRICTION, MASS_KG, STEP_S, stepped=2.0)
    assert abs(restitution - RESTITUTION) > 0.1


@pytest.mark.parametrize(
    ("right", "wrong"),
    [('friction="0.404329 0.404329', 'friction="40.4329 40.4329'), ("-800", "-0.8")],
    ids=["friction in per cent", "damping per millisecond"],
)
def test_a_snippet_with_a_wrong_unit_is_noticed(right: str, wrong: str) -> None:
    """Planted faults: one number of the snippet is in another unit."""
    snippet = recipe("mujoco").settings.snippet(MASS_KG)
    assert right in snippet
    friction, restitution = plain_loops.mujoco(snippet.replace(right, wrong), FRICTION, MASS_KG, STEP_S)
    assert max(abs(friction - FRICTION), abs(restitution - RESTITUTION)) > 0.1
