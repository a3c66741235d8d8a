"""Compare measured and proposed values of recipes with documented contact equations."""

import math

import pytest

from gauge_envs.backends.drake.contacts import rebound
from gauge_envs.backends.shared.spring_damper import spring_damper_restitution
from gauge_envs.scene import GRAVITY_M_PER_S2 as G
from gauge_envs.tools.recipes import Aim, engine_settings, search
from gauge_envs.tools.recipes.search import explain

MUJOCO = engine_settings("mujoco")


@pytest.mark.parametrize(
    ("impedance", "impratio", "time_s"),
    [(0.9, 3.0, 0.02), pytest.param(0.5, 1.0, 0.05, marks=pytest.mark.slow)],
)
def test_depth_and_creep_agree_with_mujocos_equation(impedance, impratio, time_s):
    """On n contacts, (1 - d) g = n k r. On a slope, damping balances the soft share of the load."""
    text = f"solref={time_s} 1 solimp={impedance} {impedance} 0.001 cone=elliptic impratio={impratio} friction=0.5"
    reached = explain(MUJOCO.parsed(text, 0.002), 2.0).reached
    depth_m = (1.0 - impedance) * G * time_s**2 / 4.0
    assert reached["friction"] == pytest.approx(0.5, rel=0.01)
    assert reached["penetration_m"] == pytest.approx(depth_m, rel=1e-3)
    load_m_per_s2 = (1.0 - impedance) * G * math.sin(math.atan(0.25))
    creep_m_per_s = load_m_per_s2 * time_s / (2.0 * 4.0 * impratio)
    assert reached["creep_m_s"] == pytest.approx(creep_m_per_s, rel=0.01)


class ImplicitDrop:
    """Drops by the implicit scheme of Drake, averaged over all phases."""

    def __init__(self, settings, mass_kg):
        constants = settings.backend_settings(mass_kg)
        rate, steps = (
            constants[f"sustained_{name}"] for name in ("rate", "relaxation_steps")
        )
        weight = G * settings.timestep_s / math.sqrt(2.0 * G * 0.2)
        self.restitution = rebound("relaxation", rate, steps, weight).mean()

    def drop(self):
        return {"restitution": self.restitution}


@pytest.mark.parametrize(
    ("restitution", "step_s"), [(0.1, 0.005), (0.3, 0.001), (0.6, 0.002), (0.8, 0.001)]
)
def test_the_search_reaches_a_restitution_by_the_scheme_of_drake(
    monkeypatch, restitution, step_s
):
    """At 0.1, plain corrections overshoot, so the search must halve its range."""
    monkeypatch.setattr(search, "Probe", ImplicitDrop)
    drake = engine_settings("drake")
    aim = Aim(restitution=restitution, mass_kg=0.5, timestep_s=step_s)
    if restitution > 0.5:
        proposed = drake.aimed(aim)
        # Implicit steps dissipate enough without relaxation.
        assert proposed.relaxation_time == pytest.approx(0.0, abs=1e-9)
        first = ImplicitDrop(proposed, 0.5).restitution
        assert first == pytest.approx(restitution, abs=0.05)
    contact = drake.aimed(search._rebounding(drake, aim))
    reached = ImplicitDrop(contact, 0.5).restitution
    assert reached == pytest.approx(restitution, abs=0.01)
    compile(contact.snippet(), "snippet", "exec")


def test_the_proposal_of_genesis_has_the_damping_of_its_rebound():
    genesis = engine_settings("genesis")
    contact = genesis.aimed(Aim(restitution=0.6, mass_kg=0.5, timestep_s=0.002))
    time_s, ratio, *_ = contact.sol_params
    assert spring_damper_restitution(ratio) == pytest.approx(0.6, abs=1e-5)
    # Half a period of the spring lasts 16 steps.
    assert math.pi * ratio * time_s == pytest.approx(16 * 0.002, rel=1e-5)
    compile(contact.snippet(), "snippet", "exec")
