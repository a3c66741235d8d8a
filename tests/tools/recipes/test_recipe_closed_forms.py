"""Closed forms of recipes against integration, and the reading of drops and approaches against exact motion."""

import math

import pytest
from scipy.integrate import solve_ivp

from gauge_envs.backends.shared.spring_damper import (
    damping_ratio_of,
    spring_damper_restitution,
)
from gauge_envs.scene import GRAVITY_M_PER_S2 as G
from gauge_envs.tools.recipes.aim import Aim
from gauge_envs.tools.recipes.closed_forms import mujoco_impedance
from gauge_envs.tools.recipes.engines.mujoco import MuJoCoSettings
from gauge_envs.tools.recipes.measure import probe_of


@pytest.mark.parametrize("ratio", [0.05, 0.3, 0.9, 1.0, 2.0])
def test_the_restitution_of_a_spring_and_damper_is_that_of_its_motion(ratio):
    def force(time, state):
        return state[0] + 2.0 * ratio * state[1]

    force.terminal, force.direction = True, -1.0
    found = solve_ivp(
        lambda time, state: [state[1], -state[0] - 2.0 * ratio * state[1]],
        (0.0, 50.0),
        [1e-12, 1.0],
        events=force,
        rtol=1e-10,
        atol=1e-13,
    )
    assert -found.y_events[0][0][1] == pytest.approx(
        spring_damper_restitution(ratio), abs=1e-6
    )


def test_the_damping_ratio_is_the_inverse_of_the_restitution():
    for restitution in (1.0, 0.9, 0.5, math.exp(-2.0), 0.01):
        assert spring_damper_restitution(
            damping_ratio_of(restitution)
        ) == pytest.approx(restitution, abs=1e-9)


@pytest.mark.parametrize(
    ("step_s", "solref"),
    [
        (0.0005, (0.02, 0.3)),
        (0.002, (0.01, 0.5)),
        (0.005, (-1200.0, -240.0)),
        (0.01, (0.05, 0.1)),
        (0.03, (-30.0, -50.0)),
    ],
)
def test_the_rebound_of_mujocos_equation_is_that_of_the_engine(step_s, solref):
    """Also at coarse steps, where speeds at the impact lag by half a step of gravity."""
    settings = MuJoCoSettings(
        timestep_s=step_s, solref=solref, cone="elliptic", friction=0.5
    )
    form = settings.closed_form()
    found = probe_of(settings, 0.5).drop(settings.build(0.5))
    assert form.restitution == pytest.approx(found.mean, abs=5e-4)


def test_the_friction_of_a_plate_that_cannot_turn_is_that_of_its_contacts():
    """Each contact slides with 0.3 (MuJoCo's contact forces), also of free plates, which hop by 4 mm."""
    settings = MuJoCoSettings(
        timestep_s=0.001,
        integrator="implicitfast",
        cone="elliptic",
        impratio=10.0,
        friction=0.3,
        solref=(-9500.0, -1900.0),
        solreffriction=(0.0, -300.0),
        solimp=(0.99, 0.99, 0.001, 0.5, 2.0),
    )
    probe, build = probe_of(settings, 0.2), settings.build(0.2)
    slide, (hopping, hop_m) = probe.slide(build, 0.3), probe.hop(build, 0.3)
    # Without the acceleration off the slope, 0.3010.
    assert (slide.low, slide.high) == pytest.approx((0.3, 0.3), abs=1e-4)
    assert hop_m > 2e-3
    assert hopping.low <= hopping.mean <= hopping.high < 0.3


@pytest.mark.parametrize("step_s", [0.002, 0.01])
def test_what_slides_fast_on_a_hard_contact_stays_down(step_s):
    """A contact that takes the speed in a step lifts it with mu v."""
    settings = MuJoCoSettings.aimed(Aim(friction=0.3, mass_kg=0.5, timestep_s=step_s))
    probe = probe_of(settings, 0.5)
    assert probe.fast_hop_m(settings.build(0.5)) < 0.01
    assert probe.slide(settings.build(0.5), 0.3).mean == pytest.approx(0.3, rel=1e-3)
    stiff = settings.model_copy(
        update={"solref": (2.0 * step_s, 1.0), "solreffriction": (0.0, 0.0)}
    )
    lifted_m = (0.3 * 4.0) ** 2 / (2.0 * G)
    assert probe.fast_hop_m(stiff.build(0.5)) == pytest.approx(lifted_m, rel=0.1)


def test_the_impedance_runs_from_d0_to_dwidth():
    solimp = (0.9, 0.95, 0.001, 0.5, 2.0)
    assert [
        mujoco_impedance(solimp, depth) for depth in (0.0, 5e-4, 1e-3, 1.0)
    ] == pytest.approx([0.9, 0.925, 0.95, 0.95])
