"""The guard against hops and lost impacts: closed forms, and MuJoCo's stiff and soft contacts."""

import mujoco
import numpy as np
import pytest

from gauge_envs.scene import GRAVITY_M_PER_S2 as G
from gauge_envs.tools.recipes import Aim, engine_settings, find_recipe
from gauge_envs.tools.sanity import check
from gauge_envs.tools.sanity.fixes.harm import (
    FAST_M_PER_S,
    FRICTION,
    block,
    changes_rebound,
    hops_more,
)


@pytest.mark.parametrize(
    ("cone", "impratio"), [("pyramidal", 1.0), ("elliptic", 100.0)]
)
def test_time_constants_of_two_steps_lift_what_slides(cone, impratio):
    soft, stiff, short = (
        block(
            {"cone": cone, "impratio": impratio, "contact_solref": (time_s, 1.0)}
        ).hop_mm(FAST_M_PER_S)
        for time_s in (0.02, 0.004, 0.002)
    )
    lifted = 1e3 * (FRICTION * FAST_M_PER_S) ** 2 / (2.0 * G)
    assert stiff == pytest.approx(lifted, rel=0.15 if cone == "elliptic" else 0.35)
    # MuJoCo raises shorter time constants to two steps.
    assert short == stiff
    assert 1.0 < soft < 0.2 * lifted
    assert hops_more(soft, stiff) and not hops_more(stiff, soft)


@pytest.mark.parametrize("solref", [(0.002, 1.0), (-1e5, -100.0), (-1e6, -1.0)])
def test_a_block_that_does_not_stay_on_the_ground_is_harm(solref):
    diverging = block({"timestep_s": 0.01, "refsafe": False, "contact_solref": solref})
    assert hops_more(5.0, diverging.hop_mm(FAST_M_PER_S))


# --- impacts and recipes ---------------------------------------------------------------------------------------------

BOUNCY = {
    "cone": "elliptic",
    "impratio": 10.0,
    "contact_solref": (-4000.0, -800.0),
    "contact_solimp": (0.99, 0.99, 0.001, 0.5, 2.0),
}
"""A recipe's contact for a restitution of 0.6 at a step of 2 ms, without its tangential damping."""


def test_a_soft_contact_in_place_of_a_rebound_is_harm():
    """One step reverses u to (1 - 800 * 0.002) u; MuJoCo's default contact takes nearly all of it."""
    rebound, _ = block(BOUNCY).impacts()
    soft, _ = block({}).impacts()
    assert rebound == pytest.approx(0.6, abs=0.03) and soft < 0.15
    assert changes_rebound(rebound, soft, BOUNCY["contact_solref"])
    assert changes_rebound(soft, rebound) and not changes_rebound(0.42, 0.13)


def test_friction_in_impacts_that_leaves_coulombs_law_is_harm():
    """Tangential damping over five steps takes a fifth of the slip in an impact of one step."""
    _, usual = block(BOUNCY | {"contact_solreffriction": (0.0, -475.0)}).impacts()
    damped = BOUNCY | {"contact_solreffriction": (0.0, -100.0)}
    _, ratios = block(damped).impacts()
    assert [*usual.values()] == pytest.approx([1.0] * 3, abs=0.1)
    assert ratios["steep"] == pytest.approx(0.2, abs=0.05)


@pytest.mark.parametrize(
    "seed",
    [0, *(pytest.param(n, marks=pytest.mark.slow) for n in range(1, 30))],
)
def test_the_lines_of_a_recipe_stay(seed):
    """Their options and pair are in no change that is offered, although cones and solref would resolve checks."""
    random = np.random.default_rng(1000 + seed)
    aim = Aim(
        friction=round(float(random.uniform(0.1, 1.2)), 2),
        restitution=random.choice([None, round(float(random.uniform(0.1, 0.9)), 2)]),
        mass_kg=float(f"{10 ** random.uniform(-2, 1.5):.2g}"),
        timestep_s=float(random.choice([0.002, 0.004, 0.005])),
    )
    recipe = find_recipe(engine_settings("mujoco"), aim)
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco>{recipe.snippet}<worldbody><geom name='floor' type='plane' size='9 9 1'/><body pos='0 0 .05'>"
        f"<freejoint/><geom name='foot' size='.05' mass='{aim.mass_kg}'/></body></worldbody></mujoco>"
    )
    report = check(model, only=["slide-turned", "rest-height"])
    options = ("timestep", "integrator", "cone", "impratio", "condim", "contact_")
    assert report.fix is None or not [k for k in report.fix.changes if k.startswith(options)]  # fmt: skip
