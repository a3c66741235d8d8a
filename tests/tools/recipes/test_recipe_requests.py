"""Requests of recipes: reached values, materials, wrong requests."""

import json
import math
import re
import shlex

import mujoco
import numpy as np
import pytest
from places import ROOT

from gauge_envs.backends.shared.spring_damper import spring_damper_restitution
from gauge_envs.errors import ParameterError
from gauge_envs.fixtures.recording import UnsupportedError
from gauge_envs.scene import GRAVITY_M_PER_S2 as G
from gauge_envs.tools.recipes import Aim, engine_settings, find_recipe

GOOD = "--backend=mujoco --friction=0.4 --mass=0.5 --set=timestep_s=0.002"
"""A valid request; a later option replaces an earlier option of the same name."""

IN_IMPACTS = {"impact_friction", "slip_restitution"}
"""Values that MuJoCo's contacts miss; `test_recipe_snippets` compares them with a plain engine."""


@pytest.fixture
def values(gauge):
    """Return the JSON object of a recipe."""

    def run(words):
        result = gauge("recipe", *shlex.split(words), "--json")
        assert result.exit_code == 0, result.output
        return json.loads(result.stdout)

    return run


def searched(engine="mujoco", **asked):
    aim = {"friction": 0.4, "mass_kg": 0.5, "timestep_s": 0.002} | asked
    return find_recipe(engine_settings(engine), Aim(**aim))


def test_a_recipe_is_one_json_object(values):
    recipe = values("--backend mujoco --restitution=0.6 --mass=0.5 --set=timestep_s=0.002")  # fmt: skip
    # Friction, depth and creep are not requested.
    assert recipe["error"]["friction"] is recipe["asked"]["friction"] is None
    assert recipe["reached"]["friction"] == pytest.approx(0.5, rel=0.02)
    away = recipe["reached"]["restitution"] - 0.6
    assert recipe["error"]["restitution"] == pytest.approx(away, abs=1e-9)
    assert abs(away) < 0.01 and recipe["misses"] == []


@pytest.mark.slow
def test_torsional_and_rolling_friction_agree_with_a_plain_ball():
    """In plain MuJoCo, the snippet slows a ball by 5/2 g arm / r^2 and 5/7 g arm / r^2."""
    recipe = searched(friction=0.5, torsion_m=0.002, rolling_m=0.001, mass_kg=0.2)
    assert set(recipe.misses) <= IN_IMPACTS and set(recipe.error) >= {
        "torsion_m",
        "rolling_m",
    }

    def losses(snippet):
        model = mujoco.MjModel.from_xml_string(
            f"<mujoco>{snippet}<worldbody><geom name='floor' type='plane' size='9 9 1'/><body pos='0 0 .05'>"
            "<freejoint/><geom name='foot' size='.05' mass='.2'/></body></worldbody></mujoco>"
        )
        model.opt.gravity[2] = -G
        rates = []
        for velocity in ([0, 0, 0, 0, 0, 20.0], [0.5, 0, 0, 0, 10.0, 0]):
            data = mujoco.MjData(model)
            data.qvel[:] = velocity
            mujoco.mj_step(model, data, 100)
            middle = data.qvel.copy()
            mujoco.mj_step(model, data, 200)
            rates.append(float(np.abs(middle - data.qvel)[3:].max()) / 0.4)
        return rates

    expected = [2.5 * G * 0.002 / 0.05**2, G * 0.001 / 1.4 / 0.05**2]
    assert losses(recipe.snippet) == pytest.approx(expected, rel=0.01)


@pytest.mark.slow
def test_the_requested_creep_is_not_exceeded():
    asked = {"friction": 0.5, "mass_kg": 0.2}
    free_m_per_s = searched(**asked).reached["creep_m_s"]
    recipe = searched(**asked, creep_m_s=2.5e-6)
    assert (
        set(recipe.misses) <= IN_IMPACTS
        and recipe.reached["creep_m_s"] < 2.5e-6 < free_m_per_s
    )


def test_an_engine_without_torsional_friction_is_unsupported():
    pytest.importorskip("rapier3d")
    with pytest.raises(UnsupportedError, match="torsional friction"):
        searched("rapier", torsion_m=0.002)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["newton", "pybullet", "genesis"])
def test_engines_reach_torsional_and_rolling_friction(engine):
    pytest.importorskip(engine)
    asked = {"friction": 0.5, "mass_kg": 0.2, "torsion_m": 0.002}
    assert set(searched(engine, **asked, rolling_m=0.001).misses) <= IN_IMPACTS


@pytest.mark.parametrize(
    "place", [0, *(pytest.param(n, marks=pytest.mark.slow) for n in (1, 2))]
)
def test_the_command_prints_the_examples_of_the_pages(place, gauge):
    pages = [ROOT / "docs" / name for name in ("recipes.md", "fabrics.md")]
    command, printed = re.findall(
        r"```sh\n([^\n]*)\n```\n\n```text\n(.*?)```",
        "".join(page.read_text() for page in pages),
        re.DOTALL,
    )[place]
    # The page leaves out the wall time.
    output = gauge(*shlex.split(command)[1:]).output
    words = re.sub(r"\d+\.\d s\n", "", output).split()
    assert words[: len(printed.split())] == printed.split()


@pytest.mark.slow
def test_a_stiffness_is_reached_as_a_depth_and_a_damping_as_a_rebound():
    """The body has 0.5 kg, on 5000 N/m and 20 N s/m."""
    recipe = searched(stiffness_n_per_m=5000.0, damping_n_s_per_m=20.0)
    ratio = 20.0 / (2.0 * math.sqrt(5000.0 * 0.5))
    assert recipe.reached["penetration_m"] == pytest.approx(0.5 * G / 5000.0, rel=0.01)
    rebound = spring_damper_restitution(ratio)
    assert recipe.reached["restitution"] == pytest.approx(rebound, abs=0.01)
    assert set(recipe.misses) <= IN_IMPACTS


def test_a_miss_has_its_reason():
    """With steps of 10 ms, MuJoCo reaches a restitution of 0.6 or a depth of 10 micrometres, not both."""
    asked = {"penetration_m": 1e-5, "timestep_s": 0.01}
    assert searched(**asked).reached["penetration_m"] <= 1e-5
    recipe = searched(**asked, restitution=0.6)
    assert set(recipe.misses) - IN_IMPACTS == {"penetration_m"}
    assert "impedance d is at most 0.9999" in recipe.explanation


# --- materials -------------------------------------------------------------------------------------------------------


def test_the_list_of_materials_has_sources_and_uncertainties(gauge):
    """Real drops rebound 0.160 above the published restitution of the rubber ball."""
    lines = gauge("list", "materials", "--json").stdout.splitlines()
    pairs = {pair["name"]: pair for pair in map(json.loads, lines)}
    assert all(pair["source"] for pair in pairs.values())
    rubber = pairs["rubber-on-wood"]
    recorded = pairs["rubber-on-wood-recorded"]
    change = recorded["restitution"] - rubber["restitution"]
    assert rubber["restitution_std"] == pytest.approx(change, rel=1e-3)


# --- wrong requests --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--restitution=1.5", "restitution 1.5: expected 0 to 1"),
        ("--set=iterations=3", "takes only the time step"),
        ("--stiffness=3", "depth of 1.63 m: expected 1e-07 to 0.01"),
        ("--damping=3", "give a stiffness"),
        ("wood-on-wod", "did you mean wood-on-wood"),
        ("satin", "leave out the rest"),
        ("'--explain=solref=1 1'", "leave out the rest"),
    ],
)
def test_a_wrong_request_is_an_error_with_the_reason(words, message, gauge):
    result = gauge("recipe", *shlex.split(f"{GOOD} {words}"))
    assert result.exit_code == 2
    assert message in " ".join(result.output.split())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("solrf=0.02 1", "'solrf': unknown setting"),
        ("solref=0.02 -1", "both numbers must be positive"),
        ("0.02 1", "expected names=values"),
    ],
)
def test_wrong_settings_are_rejected(text, message):
    with pytest.raises(ParameterError, match=message):
        engine_settings("mujoco").parsed(text, 0.002)


def test_a_divergence_is_an_outcome_with_its_cause(monkeypatch, gauge):
    """Plant a damping that reverses and doubles the speed at each step."""
    cls = engine_settings("mujoco")
    aimed = cls.aimed

    def unstable(aim):
        return aimed(aim).model_copy(update={"solref": (-1e7, -5.0 / aim.timestep_s)})

    monkeypatch.setattr(cls, "aimed", unstable)
    result = gauge("recipe", *GOOD.split(), "--json")
    assert result.exit_code == 1
    recipe = json.loads(result.stdout)
    assert set(recipe["reached"].values()) == {None}
    assert "diverges" in recipe["explanation"]
