"""Snippets of recipes give what is said in a plain loop of the engine."""

from __future__ import annotations

from functools import cache

import plain_loops
import pytest

from gauge_envs.tools.recipes import Aim, Recipe, engine_settings, find_recipe
from gauge_envs.tools.recipes.search import FRICTION_SHARE

FRICTION, RESTITUTION, MASS_KG, STEP_S = 0.4, 0.6, 0.5, 0.002
MODULES = {
    "mujoco": "mujoco",
    "rapier": "rapier3d",
    "physx": "sapien",
    "pybullet": "pybullet",
    "drake": "pydrake",
    "newton": "newton",
    "mujoco_warp": "mujoco_warp",
    # A folder of tests is a namespace package `genesis`.
    "genesis": "genesis.version",
}
HEAVY = ("pybullet", "drake", "newton", "mujoco_warp", "genesis")
ENGINES = [
    pytest.param(name, marks=[pytest.mark.slow] if name in HEAVY else [])
    for name in MODULES
]


@cache
def recipe(
    engine: str,
    friction: float = FRICTION,
    restitution: float = RESTITUTION,
    step_s: float = STEP_S,
) -> Recipe:
    pytest.importorskip(MODULES[engine])
    aim = Aim(
        friction=friction, restitution=restitution, mass_kg=MASS_KG, timestep_s=step_s
    )
    return find_recipe(engine_settings(engine), aim)


@pytest.mark.parametrize("engine", ENGINES)
def test_the_snippet_gives_what_is_said_in_a_plain_loop(engine: str) -> None:
    found = recipe(engine)
    friction, restitution = getattr(plain_loops, engine)(
        found.snippet, FRICTION, MASS_KG, STEP_S
    )
    assert found.found is not None
    # The plain plate has its edges along the slope, and starts level; single drops scatter between phases.
    assert friction == pytest.approx(found.found.slide.mean, rel=0.005)
    assert restitution == pytest.approx(found.reached["restitution"], abs=0.01)


@pytest.mark.parametrize("engine", ENGINES)
def test_what_is_said_is_what_is_asked(engine: str) -> None:
    found = recipe(engine)
    assert found.misses == ()
    assert found.reached["friction"] == pytest.approx(FRICTION, rel=FRICTION_SHARE)
    assert found.reached["restitution"] == pytest.approx(RESTITUTION, abs=0.01)


def test_a_plain_loop_with_twice_the_step_is_noticed() -> None:
    """A planted fault: the step of the loop is not that of the recipe."""
    snippet = recipe("mujoco").snippet
    _, restitution = plain_loops.mujoco(snippet, FRICTION, MASS_KG, STEP_S, stepped=2.0)
    assert abs(restitution - RESTITUTION) > 0.1


@pytest.mark.parametrize(
    ("right", "wrong"),
    [('friction="0.4 0.4', 'friction="40 40'), ("-800", "-0.8")],
    ids=["friction in per cent", "damping per millisecond"],
)
def test_a_snippet_with_a_wrong_unit_is_noticed(right: str, wrong: str) -> None:
    """Planted faults: one number of the snippet is in another unit."""
    snippet = recipe("mujoco").snippet
    assert right in snippet
    friction, restitution = plain_loops.mujoco(
        snippet.replace(right, wrong), FRICTION, MASS_KG, STEP_S
    )
    assert max(abs(friction - FRICTION), abs(restitution - RESTITUTION)) > 0.1


# --- bodies that hold contact, and bodies that hop -------------------------------------------------------------------

STEEP = {"friction": 0.9, "restitution": 0.75, "step_s": 0.001}
"""A contact on which MuJoCo's plates hop by 10 mm."""

CUBE = (0.1, 0.1, 0.1)

BODIES = [
    pytest.param(*body, id=name, marks=marks)
    for name, body, marks in [
        ("plate", (plain_loops.PLATE, 0.5, 10.0), []),
        ("slow light plate", (plain_loops.PLATE, 0.02, 3.0), []),
        ("heavy cube", (CUBE, 50.0, 10.0), []),
    ]
]


@pytest.mark.parametrize("engine", plain_loops.SLIDES)
@pytest.mark.parametrize(("size", "mass_kg", "beyond_deg"), BODIES)
def test_a_body_that_holds_contact_has_the_asked_friction_in_a_plain_loop(
    engine: str, size: tuple[float, float, float], mass_kg: float, beyond_deg: float
) -> None:
    """A body that cannot turn, at four angles to the slope."""
    found = recipe(engine, **STEEP)
    for turn_deg in (0.0, 15.0, 30.0, 45.0):
        friction = plain_loops.SLIDES[engine](
            found.snippet,
            0.9,
            mass_kg,
            turn_deg=turn_deg,
            size=size,
            beyond_deg=beyond_deg,
        )
        assert friction == pytest.approx(0.9, rel=FRICTION_SHARE)


def test_a_wide_free_plate_does_not_tip_and_has_the_asked_friction() -> None:
    """Without a lock: a plate twenty times as wide as high, on which friction hardly shifts the load."""
    for turn_deg in (0.0, 15.0, 30.0, 45.0):
        friction = plain_loops.mujoco_slide(
            recipe("mujoco", **STEEP).snippet,
            0.9,
            MASS_KG,
            turn_deg=turn_deg,
            size=(0.6, 0.6, 0.03),
            is_free=True,
        )
        assert friction == pytest.approx(0.9, rel=FRICTION_SHARE)


def test_a_coefficient_that_makes_up_for_hops_is_noticed() -> None:
    """A planted fault: with 0.9173 the mean of two plates that hop is 0.9, and a body that holds has 1.9 % too much."""
    snippet = recipe("mujoco", **STEEP).snippet
    assert 'friction="0.9 0.9' in snippet
    snippet = snippet.replace('friction="0.9 0.9', 'friction="0.917335 0.917335')
    friction = plain_loops.mujoco_slide(snippet, 0.9, MASS_KG, turn_deg=30.0)
    assert friction == pytest.approx(0.917335, rel=1e-3)
    assert friction != pytest.approx(0.9, rel=FRICTION_SHARE)


def test_plates_that_hop_have_the_smaller_friction_that_stands_beside() -> None:
    """Free plates in a plain loop, tipped by a thousandth at the start: their mean, and a scatter of about 1 %."""
    found = recipe("mujoco", **STEEP)
    frictions = [
        plain_loops.mujoco_slide(
            found.snippet, 0.9, MASS_KG, turn_deg=turn_deg, tip=tip, is_free=True
        )
        for turn_deg in (5.0, 15.0, 25.0, 35.0)
        for tip in ((1e-3, 4e-4), (-3e-4, 1e-3), (5e-4, -8e-4))
    ]
    assert found.reached["friction_hopping"] == pytest.approx(
        sum(frictions) / len(frictions), rel=0.015
    )
    assert max(frictions) < 0.9 * (1.0 - FRICTION_SHARE)


def test_a_rigid_contact_does_not_hop() -> None:
    """Rapier's plates have one friction, free or not."""
    found = recipe("rapier", **STEEP)
    assert found.reached["friction_hopping"] == pytest.approx(0.9, rel=1e-3)
    friction = plain_loops.rapier_slide(
        found.snippet, 0.9, MASS_KG, turn_deg=30.0, is_free=True
    )
    assert friction == pytest.approx(0.9, rel=1e-3)


def test_the_comment_of_a_snippet_states_both_frictions() -> None:
    found = recipe("mujoco", **STEEP)
    comment, *_ = found.snippet.splitlines()
    assert comment.startswith("<!-- Friction: 0.9 of bodies that hold contact, 0.8")
    assert recipe("rapier", **STEEP).snippet.startswith(
        "# Friction: 0.9 of bodies that hold contact, 0.9 of plates"
    )
