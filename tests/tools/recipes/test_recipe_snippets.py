"""Snippets of recipes give what is said in a plain loop of the engine."""

from functools import cache

import pytest
from plain_loops import FEW_DROPS, LOOPS, PHASES, PLATE, SLIDES, rebound, slide

from gauge_envs.tools.recipes import Aim, engine_settings, find_recipe
from gauge_envs.tools.recipes.search import FRICTION_SHARE

FRICTION, RESTITUTION, MASS_KG, STEP_S = 0.4, 0.6, 0.5, 0.002
MODULES = {
    "mujoco": "mujoco",
    "rapier": "rapier3d",
    "physx": "sapien",
    "pybullet": "pybullet",
    "drake": "pydrake",
    "newton": "newton",
    # A folder of tests is a namespace package `genesis`.
    "genesis": "genesis.version",
}
HEAVY = ("pybullet", "drake", "newton", "genesis")
ENGINES = [
    pytest.param(name, marks=[pytest.mark.slow] if name in HEAVY else [])
    for name in MODULES
]


@cache
def recipe(engine, friction=FRICTION, restitution=RESTITUTION, step_s=STEP_S):
    pytest.importorskip(MODULES[engine])
    aim = Aim(
        friction=friction, restitution=restitution, mass_kg=MASS_KG, timestep_s=step_s
    )
    return find_recipe(engine_settings(engine), aim)


def looped(engine, snippet, **options):
    """Friction and restitution in a plain loop."""
    loop = LOOPS[engine]
    count = 2 if engine in FEW_DROPS else PHASES
    return (
        slide(loop, snippet, FRICTION, MASS_KG, STEP_S, **options),
        rebound(loop, snippet, MASS_KG, STEP_S, count=count, **options),
    )


@pytest.mark.parametrize("engine", ENGINES)
def test_the_snippet_gives_what_is_said_and_what_is_asked(engine):
    found = recipe(engine)
    assert found.misses == ()
    assert found.reached["friction"] == pytest.approx(FRICTION, rel=FRICTION_SHARE)
    assert found.reached["restitution"] == pytest.approx(RESTITUTION, abs=0.01)
    friction, restitution = looped(engine, found.snippet)
    # The plain plate has its edges along the slope, and starts level; single drops scatter between phases.
    assert friction == pytest.approx(found.found.slide.mean, rel=0.005)
    assert restitution == pytest.approx(found.reached["restitution"], abs=0.01)


@pytest.mark.parametrize(
    ("right", "wrong", "stepped"),
    [
        ("", "", 2.0),
        ('friction="0.4 0.4', 'friction="40 40', 1.0),
        ("-800", "-0.8", 1.0),
    ],
    ids=["twice the step", "friction in per cent", "damping per millisecond"],
)
def test_a_loop_or_a_snippet_with_a_wrong_unit_is_noticed(right, wrong, stepped):
    """Planted faults: one number of the snippet is in another unit, or the step of the loop is not the recipe's."""
    snippet = recipe("mujoco").snippet
    assert right in snippet
    found = looped("mujoco", snippet.replace(right, wrong), stepped=stepped)
    errors = [abs(found[0] - FRICTION), abs(found[1] - RESTITUTION)]
    assert (errors[1] if stepped > 1.0 else max(errors)) > 0.1


# --- bodies that hold contact, and bodies that hop -------------------------------------------------------------------

STEEP = {"friction": 0.9, "restitution": 0.75, "step_s": 0.001}
"""A contact on which MuJoCo's plates hop by 10 mm."""

CUBE = (0.1, 0.1, 0.1)

BODIES = {
    "plate": (PLATE, 0.5, 10.0),
    "slow light plate": (PLATE, 0.02, 3.0),
    "heavy cube": (CUBE, 50.0, 10.0),
}
TURNS_DEG = (0.0, 15.0, 30.0, 45.0)


def steep_slide(engine, mass_kg=MASS_KG, **options):
    snippet = recipe(engine, **STEEP).snippet
    return slide(LOOPS[engine], snippet, 0.9, mass_kg, STEEP["step_s"], **options)


@pytest.mark.parametrize("engine", SLIDES)
@pytest.mark.parametrize("body", BODIES)
def test_a_body_that_holds_contact_has_the_asked_friction_in_a_plain_loop(engine, body):
    """A body that cannot turn, at four angles to the slope."""
    size_m, mass_kg, beyond_deg = BODIES[body]
    shape = {"size_m": size_m, "beyond_deg": beyond_deg, "is_free": False}
    for turn_deg in TURNS_DEG:
        friction = steep_slide(engine, mass_kg, turn_deg=turn_deg, **shape)
        assert friction == pytest.approx(0.9, rel=FRICTION_SHARE)


def test_a_wide_free_plate_does_not_tip_and_has_the_asked_friction():
    """Without a lock: a plate twenty times as wide as high, on which friction hardly shifts the load."""
    for turn_deg in TURNS_DEG:
        friction = steep_slide("mujoco", turn_deg=turn_deg, size_m=(0.6, 0.6, 0.03))
        assert friction == pytest.approx(0.9, rel=FRICTION_SHARE)


def test_a_coefficient_that_makes_up_for_hops_is_noticed():
    """A planted fault: with 0.9173 the mean of two plates that hop is 0.9, and a body that holds has 1.9 % too much."""
    snippet = recipe("mujoco", **STEEP).snippet
    assert 'friction="0.9 0.9' in snippet
    snippet = snippet.replace('friction="0.9 0.9', 'friction="0.917335 0.917335')
    loop = LOOPS["mujoco"]
    friction = slide(loop, snippet, 0.9, MASS_KG, 0.001, turn_deg=30.0, is_free=False)
    assert friction == pytest.approx(0.917335, rel=1e-3)
    assert friction != pytest.approx(0.9, rel=FRICTION_SHARE)


def test_plates_that_hop_have_the_smaller_friction_that_stands_beside():
    """Free plates in a plain loop, tipped by a thousandth at the start: their mean, and a scatter of about 1 %."""
    found = recipe("mujoco", **STEEP)
    frictions = [
        steep_slide("mujoco", turn_deg=turn_deg, tip=tip)
        for turn_deg in (5.0, 15.0, 25.0, 35.0)
        for tip in ((1e-3, 4e-4), (-3e-4, 1e-3), (5e-4, -8e-4))
    ]
    mean = sum(frictions) / len(frictions)
    assert found.reached["friction_hopping"] == pytest.approx(mean, rel=0.015)
    assert max(frictions) < 0.9 * (1.0 - FRICTION_SHARE)
    comment, *_ = found.snippet.splitlines()
    assert comment.startswith("<!-- Friction: 0.9 of bodies that hold contact, 0.8")


def test_a_rigid_contact_does_not_hop():
    """Rapier's plates have one friction, free or not."""
    found = recipe("rapier", **STEEP)
    assert found.reached["friction_hopping"] == pytest.approx(0.9, rel=1e-3)
    assert steep_slide("rapier", turn_deg=30.0) == pytest.approx(0.9, rel=1e-3)
    words = "# Friction: 0.9 of bodies that hold contact, 0.9 of plates"
    assert found.snippet.startswith(words)
