"""Requests of recipes: what is reached beside friction and rebound, materials, wrong requests."""

import json
import math
import re
import shlex

import mujoco
import numpy as np
import pytest
from places import ROOT
from typer.testing import CliRunner

from gauge_envs.backends.shared.spring_damper import spring_damper_restitution
from gauge_envs.cli.app import app
from gauge_envs.errors import ParameterError
from gauge_envs.experiments.task_files import fabrics
from gauge_envs.scene import GRAVITY_M_PER_S2 as G
from gauge_envs.tools.bench.recording import DeclinedError
from gauge_envs.tools.recipes import Aim, engine_settings, find_recipe
from gauge_envs.tools.recipes.materials import material_pairs

GOOD = "--backend=mujoco --friction=0.4 --mass=0.5 --set=timestep_s=0.002"
"""A request that is met; a word replaces an earlier one of the same name."""


@pytest.fixture
def values(gauge):
    """The line of a recipe as JSON."""

    def run(words):
        result = gauge("recipe", *shlex.split(words), "--json")
        assert result.exit_code == 0, result.output
        return json.loads(result.stdout)

    return run


def searched(engine="mujoco", **asked):
    aim = {"friction": 0.4, "mass_kg": 0.5, "timestep_s": 0.002} | asked
    return find_recipe(engine_settings(engine), Aim(**aim))


def test_a_recipe_is_one_json_object(values):
    found = values("--backend mujoco --restitution=0.6 --mass=0.5 --set=timestep_s=0.002")  # fmt: skip
    # Friction, depth and creep are not asked.
    assert found["error"]["friction"] is found["asked"]["friction"] is None
    assert found["reached"]["friction"] == pytest.approx(0.5, rel=0.02)
    away = found["reached"]["restitution"] - 0.6
    assert found["error"]["restitution"] == pytest.approx(away, abs=1e-9)
    assert abs(away) < 0.01 and found["misses"] == []


def test_torsional_and_rolling_friction_are_those_of_a_plain_ball():
    """The pasted pair slows a ball in plain MuJoCo by 5/2 and 5/7 g arm / r^2."""
    found = searched(friction=0.5, torsion_m=0.002, rolling_m=0.001, mass_kg=0.2)
    assert not found.misses and set(found.error) >= {"torsion_m", "rolling_m"}

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
    assert losses(found.snippet) == pytest.approx(expected, rel=0.01)


def test_a_creep_that_is_asked_is_not_exceeded():
    asked = {"friction": 0.5, "mass_kg": 0.2}
    free_m_per_s = searched(**asked).reached["creep_m_s"]
    found = searched(**asked, creep_m_s=2.5e-6)
    assert not found.misses and found.reached["creep_m_s"] < 2.5e-6 < free_m_per_s


def test_an_engine_without_torsional_friction_says_so():
    pytest.importorskip("rapier3d")
    with pytest.raises(DeclinedError, match="torsional friction"):
        searched("rapier", torsion_m=0.002)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["newton", "pybullet", "genesis"])
def test_torsional_and_rolling_friction_of_other_engines(engine):
    pytest.importorskip(engine)
    asked = {"friction": 0.5, "mass_kg": 0.2, "torsion_m": 0.002}
    assert not searched(engine, **asked, rolling_m=0.001).misses


@pytest.mark.parametrize("place", [0, 1, 2])
def test_an_example_of_the_page_is_what_the_command_prints(place, gauge):
    page = (ROOT / "docs" / "recipes.md").read_text()
    command, printed = re.findall(
        r"```sh\n([^\n]*)\n```\n\n```text\n(.*?)```", page, re.DOTALL
    )[place]
    # The page leaves out the wall time.
    output = gauge(*shlex.split(command)[1:]).output
    found = re.sub(r"\d+\.\d s\n", "", output).split()
    assert found[: len(printed.split())] == printed.split()


def test_a_stiffness_is_reached_as_a_depth_and_a_damping_as_a_rebound():
    """For 0.5 kg on 5000 N/m and 20 N s/m."""
    found = searched(stiffness_n_per_m=5000.0, damping_n_s_per_m=20.0)
    ratio = 20.0 / (2.0 * math.sqrt(5000.0 * 0.5))
    assert found.reached["penetration_m"] == pytest.approx(0.5 * G / 5000.0, rel=0.01)
    rebound = spring_damper_restitution(ratio)
    assert found.reached["restitution"] == pytest.approx(rebound, abs=0.01)
    assert not found.misses


def test_a_miss_has_its_reason():
    """At 10 ms MuJoCo rebounds with 0.6 or rests 10 micrometres deep, not both; without a rebound it rests there."""
    asked = {"penetration_m": 1e-5, "timestep_s": 0.01}
    assert searched(**asked).reached["penetration_m"] <= 1e-5
    found = searched(**asked, restitution=0.6)
    assert found.misses == ["penetration_m"]
    assert "impedance d is at most 0.9999" in found.explanation


# --- materials -------------------------------------------------------------------------------------------------------


def test_a_material_is_looked_up_in_the_task_files(values):
    found = values("wood-on-wood --set=timestep_s=0.002 --backend mujoco")
    (pair,) = [pair for pair in material_pairs() if pair.name == "wood-on-wood"]
    for key in ("friction", "restitution", "mass_kg"):
        assert found["asked"][key] == getattr(pair, key)
    assert found["material"]["friction_std"] == pair.friction_std > 0.0


def test_materials_are_listed_with_their_sources(gauge):
    lines = gauge("list", "materials", "--json").stdout.splitlines()
    names = [json.loads(line)["name"] for line in lines]
    assert names[-6:] == [*fabrics("TextileFlinging")]
    for pair in material_pairs():
        is_uncertain = (pair.friction_std or pair.restitution_std) is not None
        assert pair.source and bool(pair.uncertainty_sources) == is_uncertain


# --- wrong requests --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--restitution=1.5", "restitution 1.5: expected 0 to 1"),
        ("--set=iterations=3", "takes the time step alone"),
        ("--stiffness=3", "depth of 1.63 m: expected 1e-07 to 0.01"),
        ("--damping=3", "give a stiffness"),
        ("wood-on-wod", "did you mean wood-on-wood"),
        ("satin", "leave the others out"),
        ("'--explain=solref=1 1'", "leave the others out"),
    ],
)
def test_a_wrong_request_ends_with_its_reason(words, message, gauge):
    result = gauge("recipe", *shlex.split(f"{GOOD} {words}"))
    assert result.exit_code == 2
    assert message in " ".join(result.output.split())


@pytest.mark.parametrize("option", ["--backend", "--mass", "--set"])
def test_a_request_that_is_incomplete_names_what_is_missing(option, gauge):
    words = [word for word in GOOD.split() if not word.startswith(option)]
    result = gauge("recipe", *words)
    assert result.exit_code == 2 and option in result.output


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("solrf=0.02 1", "'solrf': unknown setting"),
        ("solref=0.02 -1", "both numbers must be positive"),
        ("0.02 1", "expected names=values"),
        ("solref=0.02 1 solref=0.01 1", "each name once"),
    ],
)
def test_wrong_settings_are_refused(text, message):
    with pytest.raises(ParameterError, match=message):
        engine_settings("mujoco").parsed(text, 0.002)


def test_a_divergence_is_an_outcome_with_its_cause(monkeypatch, gauge):
    """A planted fault: damping that reverses and doubles the speed at each step."""
    cls = engine_settings("mujoco")
    kept = cls.aimed

    def unstable(aim):
        return kept(aim).model_copy(update={"solref": (-1e7, -5.0 / aim.timestep_s)})

    monkeypatch.setattr(cls, "aimed", unstable)
    result = gauge("recipe", *GOOD.split(), "--json")
    assert result.exit_code == 1
    found = json.loads(result.stdout)
    assert set(found["reached"].values()) == {None}
    assert "diverges" in found["explanation"]


def test_a_terminal_does_not_cut_what_is_to_be_pasted(values):
    words = ["recipe", "satin", "--backend", "isaac"]
    text = CliRunner(env={"COLUMNS": "40"}).invoke(app, words).stdout
    assert text.endswith(values("satin --backend isaac")["snippet"])
