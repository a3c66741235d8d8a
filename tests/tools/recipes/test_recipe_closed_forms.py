"""What recipes measure and propose, against MuJoCo's documented contact equation."""

import math

import pytest

from gauge_envs.backends.shared.spring_damper import (
    damping_ratio_of,
    spring_damper_restitution,
)
from gauge_envs.scene import GRAVITY_M_PER_S2 as G
from gauge_envs.tools.recipes import Aim, Probe, engine_settings
from gauge_envs.tools.recipes.engines.genesis import rebounds
from gauge_envs.tools.recipes.search import explain

MUJOCO = engine_settings("mujoco")


@pytest.mark.parametrize("ratio", [0.05, 0.9, 1.0, 2.0])
def test_the_restitution_of_a_spring_and_damper_is_that_of_its_motion(ratio):
    """By steps of the equation x'' = -x - 2 z x', until the force is zero."""
    position, speed, step = 0.0, 1.0, 1e-4
    while (force := position + 2.0 * ratio * speed) > 0.0:
        speed -= step * force
        position += step * speed
    assert -speed == pytest.approx(spring_damper_restitution(ratio), abs=1e-3)
    assert damping_ratio_of(-speed) == pytest.approx(ratio, rel=0.01)


@pytest.mark.parametrize(
    ("impedance", "impratio", "time_s"), [(0.9, 3.0, 0.02), (0.5, 1.0, 0.05)]
)
def test_depth_and_creep_are_those_of_mujocos_equation(impedance, impratio, time_s):
    """With n contacts (1 - d) g = n k r, and damping balances the soft share of the load on a slope."""
    text = f"solref={time_s} 1 solimp={impedance} {impedance} 0.001 cone=elliptic impratio={impratio} friction=0.5"
    reached = explain(MUJOCO.parsed(text, 0.002), 2.0).reached
    depth_m = (1.0 - impedance) * G * time_s**2 / 4.0
    assert reached["friction"] == pytest.approx(0.5, rel=0.01)
    assert reached["penetration_m"] == pytest.approx(depth_m, rel=1e-3)
    load_m_per_s2 = (1.0 - impedance) * G * math.sin(math.atan(0.25))
    creep_m_per_s = load_m_per_s2 * time_s / (2.0 * 4.0 * impratio)
    assert reached["creep_m_s"] == pytest.approx(creep_m_per_s, rel=0.01)


@pytest.mark.parametrize(
    ("step_s", "frequency_per_s", "ratio"), [(0.0005, 170.0, 0.3), (0.01, 40.0, 0.1)]
)
def test_rebounds_are_those_of_mujoco(step_s, frequency_per_s, ratio):
    """Also at coarse steps, where speeds at the impact lag by half a step of gravity."""
    time_s = 1.0 / (ratio * frequency_per_s)
    text = f"solref={time_s} {ratio} solimp=0.9 0.9 0.001 cone=elliptic friction=0.5"
    drop = Probe(settings=MUJOCO.parsed(text, step_s), mass_kg=0.7).drop()
    expected = rebounds(frequency_per_s, ratio, 0.9, step_s)
    assert drop["restitution"] == pytest.approx(expected.mean(), abs=2e-3)


def test_what_slides_fast_on_a_hard_contact_stays_down():
    """A contact that takes the sliding speed in a step lifts the body with mu v; a recipe does not."""
    contact = MUJOCO.aimed(Aim(friction=0.3, mass_kg=0.5, timestep_s=0.01))
    stiff = contact.model_copy(
        update={"solref": (0.02, 1.0), "solreffriction": (0.0, 0.0)}
    )
    hops_m = [
        Probe(settings=one, mass_kg=0.5).fast_hop()["fast_hop_m"]
        for one in (contact, stiff)
    ]
    lifted_m = (0.3 * 4.0) ** 2 / (2.0 * G)
    assert hops_m[0] < 0.01 and hops_m[1] == pytest.approx(lifted_m, rel=0.1)
