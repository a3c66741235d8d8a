"""Snippets of recipes give what is said in a plain loop of the engine."""

import pytest
from plain_loops import LOOPS, rebound, slide

from gauge_envs.tools.recipes import Aim, engine_settings, find_recipe

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
