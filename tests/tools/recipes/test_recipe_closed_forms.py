"""Closed forms of recipes against integration and against the engine."""

import math

import mujoco
import pytest
from scipy.integrate import solve_ivp

from gauge_envs.backends.shared.spring_damper import (
    damping_ratio_of,
    spring_damper_restitution,
)
from gauge_envs.scene import GRAVITY_M_PER_S2 as G
from gauge_envs.tools.recipes import Aim, Probe, engine_settings
from gauge_envs.tools.recipes.explain import explain, parsed_contact

MUJOCO = engine_settings("mujoco")


def settings(text, timestep_s=0.002):
    return parsed_contact(MUJOCO, text, timestep_s)


@pytest.mark.parametrize("ratio", [0.05, 0.9, 1.0, 2.0])
def test_the_restitution_of_a_spring_and_damper_is_that_of_its_motion(ratio):
    def force(time, state):
        return state[0] + 2.0 * ratio * state[1]

    force.terminal, force.direction = True, -1.0
    motion = solve_ivp(
        lambda time, state: [state[1], -state[0] - 2.0 * ratio * state[1]],
        (0.0, 50.0),
        [1e-12, 1.0],
        events=force,
        rtol=1e-10,
        atol=1e-13,
    )
    restitution = -motion.y_events[0][0][1]
    assert restitution == pytest.approx(spring_damper_restitution(ratio), abs=1e-6)
    assert damping_ratio_of(restitution) == pytest.approx(ratio, abs=1e-4)


@pytest.mark.parametrize(
    ("step_s", "solref"),
    [(0.0005, "0.02 0.3"), (0.005, "-1200 -240"), (0.01, "0.05 0.1")],
)
def test_the_rebound_of_mujocos_equation_is_that_of_the_engine(step_s, solref):
    """Also at coarse steps, where speeds at the impact lag by half a step of gravity."""
    contact = settings(f"solref={solref} cone=elliptic friction=0.5", step_s)
    probe = Probe(settings=contact, mass_kg=0.7, friction=0.5)
    expected = contact.closed_form()["restitution"]
    assert probe.drop()["restitution"] == pytest.approx(expected, abs=2e-3)


STIFF = "solref=-4000 -800 solreffriction=0 -500 solimp=0.99 0.99 0.001 cone=elliptic friction=0.5"


@pytest.mark.parametrize(
    "contact",
    [
        'solref="0.02 1" friction="0.5 0.005 0.0001" cone=elliptic impratio=3 integrator=implicitfast',
        # MuJoCo keeps the time constant at two steps or more.
        "solref=0.002 1 solimp=0.9 0.95 0.001 cone=elliptic friction=0.5",
        f"{STIFF} impratio=10",
        "solref=0.02 1 friction=0.5 solimp=0.9 0.95 0.0002",
    ],
)
def test_mujoco_gives_what_its_documented_equation_gives(contact):
    """With a pyramid of friction the creep is approximate."""
    meaning = explain(settings(contact), 2.0)
    reached, expected = meaning.reached, meaning.closed_form
    assert reached["penetration_m"] == pytest.approx(expected["penetration_m"], 1e-3)
    if "elliptic" not in contact:
        assert reached["creep_m_s"] == pytest.approx(expected["creep_m_s"], rel=0.06)
        return
    assert reached["friction"] == pytest.approx(0.5, rel=0.01)
    assert reached["restitution"] == pytest.approx(expected["restitution"], abs=0.005)
    # A contact that stops a body in one step has no time constant, and has not settled.
    if expected["time_constant_s"] is not None:
        for name, share in (("creep_m_s", 1e-3), ("time_constant_s", 0.01)):
            assert reached[name] == pytest.approx(expected[name], rel=share)


def test_the_closed_form_has_the_impedance_that_mujoco_makes_of_a_stated_one():
    def form(text):
        return settings(text).closed_form()

    assert form("solimp=0 0 0 0 0") == form("solimp=1e-4 1e-4 0 1e-4 1")
    assert form("solimp=2 2 0.001") == form("solimp=0.9999 0.9999 0.001 0.5 2")
    assert (mujoco.mjMINIMP, mujoco.mjMAXIMP) == (1e-4, 0.9999)


def test_what_slides_fast_on_a_hard_contact_stays_down():
    """A contact that takes the sliding speed in a step lifts the body with mu v; a recipe does not."""
    contact = MUJOCO.aimed(Aim(friction=0.3, mass_kg=0.5, timestep_s=0.01))
    stiff = contact.model_copy(
        update={"solref": (0.02, 1.0), "solreffriction": (0.0, 0.0)}
    )
    hops_m = [
        Probe(settings=one, mass_kg=0.5, friction=0.3).fast_hop()["fast_hop_m"]
        for one in (contact, stiff)
    ]
    lifted_m = (0.3 * 4.0) ** 2 / (2.0 * G)
    assert hops_m[0] < 0.01 and hops_m[1] == pytest.approx(lifted_m, rel=0.1)


def test_newtons_stiffness_and_damping_are_a_time_constant_and_a_ratio():
    newton = engine_settings("newton")
    contact = parsed_contact(newton, "ke=2500 kd=100 mu=0.5", 0.002)
    assert contact.solref == (2.0 / 100.0, 100.0 / (2.0 * math.sqrt(2500.0)))
