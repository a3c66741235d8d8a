"""Snippets of recipes give what is said in a plain loop of the engine."""

import math

import pytest
from plain_loops import DROP_M, LOOPS, G, rebound, slide

from gauge_envs.backends.drake.contacts import rebound as drake_rebound
from gauge_envs.tools.recipes import Aim, engine_settings, find_recipe
from gauge_envs.tools.recipes.engines.genesis import rebounds

FRICTION, RESTITUTION, MASS_KG, STEP_S = 0.4, 0.6, 0.5, 0.002
MODULES = {
    "mujoco": "mujoco",
    "rapier": "rapier3d",
    "physx": "sapien",
    "pybullet": "pybullet",
}


@pytest.mark.parametrize("engine", MODULES)
def test_the_snippet_gives_what_is_said_and_what_is_asked(engine):
    pytest.importorskip(MODULES[engine])
    aim = Aim(
        friction=FRICTION, restitution=RESTITUTION, mass_kg=MASS_KG, timestep_s=STEP_S
    )
    found = find_recipe(engine_settings(engine), aim)
    assert not found.misses
    assert found.reached["friction"] == pytest.approx(FRICTION, rel=0.005)
    assert found.reached["restitution"] == pytest.approx(RESTITUTION, abs=0.01)
    loop = LOOPS[engine]
    friction = slide(loop, found.snippet, FRICTION, MASS_KG, STEP_S)
    restitution = rebound(loop, found.snippet, MASS_KG, STEP_S)
    # The plain plate has its edges along the slope, and starts level; single drops scatter between phases.
    assert friction == pytest.approx(found.reached["friction"], rel=0.005)
    assert restitution == pytest.approx(found.reached["restitution"], abs=0.01)


@pytest.mark.parametrize("restitution", [0.2, 0.7])
def test_proposals_of_engines_that_may_be_absent_rebound_by_their_equations(
    restitution,
):
    """Drake's scheme is repeated in its backend. Both snippets are Python."""
    aim = Aim(restitution=restitution, mass_kg=MASS_KG, timestep_s=STEP_S)
    genesis = engine_settings("genesis").aimed(aim)
    time_s, ratio, impedance, *_ = genesis.sol_params
    means = rebounds(1.0 / (time_s * ratio), ratio, impedance, STEP_S)
    assert means.mean() == pytest.approx(restitution, abs=2e-3)
    drake = engine_settings("drake").aimed(aim)
    settings = drake.backend_settings(MASS_KG)
    weight = G * STEP_S / math.sqrt(2.0 * G * DROP_M)
    constants = (settings["sustained_rate"], settings["sustained_relaxation_steps"])
    mean = drake_rebound("relaxation", *constants, weight).mean()
    assert mean == pytest.approx(restitution, abs=2e-3)
    for contact in (genesis, drake):
        compile(contact.snippet(), "snippet", "exec")
