"""Requests of recipes: what is reached beside friction and rebound, what settings mean, wrong requests."""

import json
import math
import re
import shlex
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from approval import refused_commands
from places import ROOT
from typer.testing import CliRunner

from gauge_envs.backends import backend
from gauge_envs.backends.shared.spring_damper import spring_damper_restitution
from gauge_envs.cli.app import app
from gauge_envs.errors import MissingExtraError, ParameterError, UnsupportedSceneError
from gauge_envs.experiments.task_files import fabrics
from gauge_envs.scene import GRAVITY_M_PER_S2 as G
from gauge_envs.tools.recipes import Aim, engine_settings, find_recipe
from gauge_envs.tools.recipes.explain import explain, parsed_contact
from gauge_envs.tools.recipes.materials import material_pairs, published_pairs
from gauge_envs.tools.recipes.words import PUBLISHED
from gauge_envs.tools.sanity import Verdict
from gauge_envs.tools.sanity.measure import Measurements
from gauge_envs.tools.sanity.phenomena import phenomenon

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


# --- forward ---------------------------------------------------------------------------------------------------------


def test_a_recipe_is_one_json_object(values):
    found = values(f"{GOOD} --restitution=0.6")
    assert list(found) == [
        *("engine", "asked", "settings", "snippet", "reached", "error"),
        *("misses", "detail", "wall_s", "explanation", "versions"),
    ]
    names = {
        "friction",
        "friction_hopping",
        "restitution",
        "penetration_m",
        "creep_m_s",
    }
    assert set(found["reached"]) == names
    away = found["reached"]["friction"] - 0.4
    assert found["error"]["friction"] == pytest.approx(away)
    assert found["error"]["penetration_m"] is None
    assert found["engine"] == "mujoco" and "mujoco" in found["versions"]


def test_torsional_and_rolling_friction_are_those_of_a_plain_ball():
    """The pasted pair slows a ball in plain MuJoCo by 5/2 and 5/7 g arm / r^2; with condim 3 it does not."""
    found = searched(friction=0.5, torsion_m=0.002, rolling_m=0.001, mass_kg=0.2)
    assert found.misses == () and set(found.error) >= {"torsion_m", "rolling_m"}

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

    assert losses(found.snippet) == pytest.approx(
        [2.5 * G * 0.002 / 0.05**2, G * 0.001 / 1.4 / 0.05**2], rel=0.01
    )
    assert max(losses(found.snippet.replace('condim="6"', 'condim="3"'))) < 0.01


@pytest.mark.slow
def test_a_creep_that_is_asked_is_not_exceeded():
    asked = {"friction": 0.5, "mass_kg": 0.2}
    free, slow = searched(**asked), searched(**asked, creep_m_s=2.5e-6)
    assert free.reached["creep_m_s"] > 2.5e-6 > slow.reached["creep_m_s"]
    assert slow.misses == ()
    # A box that pads hold creeps faster than the plate, in both by the same factor, and then within its limit.
    held = [
        Measurements(backend("mujoco")).measure(
            phenomenon("grasp-creep"), one.settings.build(0.2).settings
        )
        for one in (free, slow)
    ]
    assert [one.verdict for one in held] == [Verdict.WRONG, Verdict.INSIDE]
    factors = [
        one.value / found.reached["creep_m_s"]
        for one, found in zip(held, (free, slow), strict=True)
    ]
    assert factors == pytest.approx([3.44e6, 3.44e6], rel=0.01)


def test_an_engine_without_torsional_friction_says_so():
    pytest.importorskip("rapier3d")
    words = r"rapier cannot simulate the recipe: .* torsional friction"
    with pytest.raises(UnsupportedSceneError, match=words):
        searched("rapier", torsion_m=0.002)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["newton", "pybullet", "genesis"])
def test_torsional_and_rolling_friction_of_other_engines(engine):
    pytest.importorskip(engine)
    for rolling_m in (None, 0.001):
        found = searched(
            engine, friction=0.5, mass_kg=0.2, torsion_m=0.002, rolling_m=rolling_m
        )
        assert found.misses == ()


@pytest.mark.parametrize("place", [0, 1])
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
    assert found.misses == ()


def test_an_allowed_depth_is_kept():
    depth_m = searched(penetration_m=2e-6).reached["penetration_m"]
    assert depth_m is not None and depth_m <= 2e-6


def test_a_miss_has_its_reason_and_the_step_that_reaches_it():
    """At 10 ms MuJoCo rebounds with 0.6 or rests 10 micrometres deep, not both."""
    found = searched(restitution=0.6, penetration_m=1e-5, timestep_s=0.01)
    assert found.misses == ("penetration_m",)
    assert "impedance d is at most 0.9999" in found.explanation
    assert "With a time step of 0.005 s the same search reaches" in found.explanation


def test_a_contact_without_stiffness_says_so():
    pytest.importorskip("sapien")
    found = searched("physx", stiffness_n_per_m=5000.0, timestep_s=0.005)
    assert found.misses == ("penetration_m",)
    assert "no stiffness" in found.explanation


# --- back ------------------------------------------------------------------------------------------------------------


def explained(text, engine="mujoco"):
    """Settings of a contact, as they are read."""
    return parsed_contact(engine_settings(engine), text, 0.002)


STIFF = "solref=-4000 -800 solreffriction=0 -500 solimp=0.99 0.99 0.001 cone=elliptic friction=0.5"


@pytest.mark.parametrize(
    "contact",
    [
        "solref=0.02 1 solimp=0.9 0.95 0.001 cone=elliptic friction=0.5",
        'solref="0.02 1" friction="0.5 0.005 0.0001" cone=elliptic impratio=3 integrator=implicitfast',
        "solref=0.01 0.5 friction=0.8 cone=elliptic",
        # MuJoCo keeps the time constant at two steps or more.
        "solref=0.002 1 solimp=0.9 0.95 0.001 cone=elliptic friction=0.5",
        f"{STIFF} impratio=10",
        "solref=0.02 1 friction=0.5",
    ],
)
def test_mujoco_gives_what_its_documented_equation_gives(contact):
    """With a pyramid of friction the creep is approximate."""
    meaning = explain(explained(contact), 2.0)
    reached, expected = meaning.reached, meaning.expected
    is_elliptic = "elliptic" in contact
    shares = {"penetration_m": 1e-3, "creep_m_s": 1e-3 if is_elliptic else 0.06}
    if is_elliptic:
        shares |= {"friction": 0.01, "time_constant_s": 0.01}
        assert reached["restitution"] == pytest.approx(
            expected["restitution"], abs=0.005
        )
    if expected["time_constant_s"] is None:
        shares = {"penetration_m": 1e-3, "friction": 0.01}
    for key, share in shares.items():
        assert reached[key] == pytest.approx(expected[key], rel=share), key


def test_twice_the_step_is_noticed_by_the_closed_form():
    """A planted fault: the closed form is that of another step."""
    settings = explained(STIFF)
    doubled = settings.model_copy(update={"timestep_s": 0.004}).closed_form()
    reached = explain(settings, 2.0).reached["restitution"]
    assert abs(doubled.restitution - reached) > 0.1


def test_newtons_stiffness_and_damping_are_a_time_constant_and_a_ratio():
    settings = explained("ke=2500 kd=100 mu=0.5", "newton")
    assert settings.model_dump()["solref"] == (0.02, 1.0)


def closed_form(text):
    return explained(text).closed_form()


def test_the_closed_form_has_the_impedance_that_mujoco_makes_of_a_stated_one():
    # MuJoCo documents the limits; without them the first is a division by zero.
    assert closed_form("solimp=0 0 0 0 0") == closed_form("solimp=1e-4 1e-4 0 1e-4 1")
    assert closed_form("solimp=2 2 0.001 0.5 2") == closed_form(
        "solimp=0.9999 0.9999 0.001 0.5 2"
    )
    assert (mujoco.mjMINIMP, mujoco.mjMAXIMP) == (1e-4, 0.9999)
    assert closed_form("solref=0 0").time_constant_s is None


def test_settings_are_explained_on_the_command_line(values):
    contact = "solref=0.02 1 solimp=0.9 0.95 0.001"
    words = f"--backend mujoco --explain '{contact}' --mass=2 --set=timestep_s=0.002"
    found = values(words)
    depth = found["closed_form"]["penetration_m"]
    assert found["reached"]["penetration_m"] == pytest.approx(depth, rel=1e-3)


def test_friction_need_not_be_asked(values):
    words = "--backend mujoco --restitution=0.6 --mass=0.5 --set=timestep_s=0.002"
    found = values(words)
    assert found["asked"]["friction"] is None and found["error"]["friction"] is None
    assert found["misses"] == []
    assert found["reached"]["friction"] == pytest.approx(0.5, rel=0.02)
    assert found["reached"]["restitution"] == pytest.approx(0.6, abs=0.01)


def test_an_engine_with_half_the_friction_is_found(monkeypatch):
    """A planted fault: the engine halves the friction that it is given, whatever the search tries."""
    cls = engine_settings("mujoco")
    kept = cls.build

    def halved(self, mass_kg):
        build = kept(self, mass_kg)
        return replace(build, friction=min(0.5 * build.friction, 0.2))

    monkeypatch.setattr(cls, "build", halved)
    found = searched(friction=0.6)
    assert found.misses == ("friction",)
    assert found.reached["friction"] == pytest.approx(0.2, rel=0.02)
    assert "friction: 0.2 is reached" in found.explanation


# --- materials and fabrics -------------------------------------------------------------------------------------------


def test_every_material_has_a_source():
    for pair in material_pairs():
        assert pair.source
        assert bool(pair.uncertainty_sources) == (
            pair.friction_std is not None or pair.restitution_std is not None
        )


def test_a_material_is_looked_up_in_the_task_files(values):
    found = values("wood-on-wood --set=timestep_s=0.002 --backend mujoco")
    (pair,) = [pair for pair in material_pairs() if pair.name == "wood-on-wood"]
    for key in ("friction", "restitution", "mass_kg"):
        assert found["asked"][key] == getattr(pair, key)
    assert found["material"]["friction_std"] == pair.friction_std > 0.0


def test_materials_are_listed(gauge):
    lines = gauge("list", "materials", "--json").stdout.splitlines()
    assert [json.loads(line)["name"] for line in lines] == [
        *(pair.name for pair in material_pairs()),
        *(pair["name"] for pair in published_pairs()),
        *fabrics("TextileFlinging"),
    ]


def test_published_friction_names_a_source_that_the_list_explains():
    explained = " ".join(PUBLISHED)
    for pair in published_pairs():
        assert pair["source"].split(",")[0] in explained
        numbers = [
            float(one)
            for key in ("static", "dynamic")
            for one in pair[key].split(" to ")
            if one != "-"
        ]
        assert all(0.05 <= one <= 1.5 for one in numbers)
        assert numbers or float(pair["rolling_mm"]) > 0.0


@pytest.mark.slow
def test_a_fabric_states_what_its_mapping_loses(values):
    """One modulus of Newton gives the stretch and, at a third and more of it, a shear that satin does not have."""
    pytest.importorskip("newton")
    found, satin = values("satin --backend newton"), fabrics("TextileFlinging")["satin"]
    shear = found["settings"]["tri_ke"]
    stretch = satin.stretch_stiffness_n_per_m
    assert found["reached"]["stretch_n_per_m"] == pytest.approx(stretch, rel=0.02)
    words = f"shear: {shear:.4g} N/m instead of {satin.shear_stiffness_n_per_m:.4g}"
    assert words in found["explanation"]
    assert f"tri_ke={shear:.6g}" in found["snippet"]


@pytest.mark.parametrize("width", ["40", "140"])
def test_a_terminal_does_not_cut_what_is_to_be_pasted(width, values):
    words = ["recipe", "satin", "--backend", "isaac"]
    text = CliRunner(env={"COLUMNS": width}).invoke(app, words).stdout
    assert text.endswith(values("satin --backend isaac")["snippet"])


# --- wrong requests --------------------------------------------------------------------------------------------------


def asked(word):
    """Return the good request with a word, in place of its value for the same option."""
    option = word.partition("=")[0]
    others = [one for one in GOOD.split() if one.partition("=")[0] != option]
    return " ".join([*others, repr(word)])


WRONG_WORDS = """
--mass=-1  --mass=nan  --restitution=1.5  --friction=0  --friction=-1  --friction=1e9
--set=timestep_s=1  --set=timestep_s=0  --set=iterations=3  --set=timestep_s=fast
--penetration=1  --stiffness=1e-3  --damping=3  --backend=bullet  wood-on-wod  satin  sattin
'--explain=solref=1 1'
"""


def test_wrong_requests_end_with_their_reasons(gauge, approved):
    requests = [f"{asked(word)!s}" for word in shlex.split(WRONG_WORDS)]
    words = GOOD.split()
    requests += [" ".join(words[:k] + words[k + 1 :]) for k in range(len(words))]
    commands = [f"recipe {request}" for request in requests]
    approved("recipes/wrong_requests", refused_commands(gauge, *commands))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("solrf=0.02 1", "'solrf': unknown setting"),
        ("solref=0.02 -1", "both numbers must be positive"),
        ("solref=0.02", "solref"),
        ("0.02 1", "expected settings as name=values"),
        ("solref=0.02 1 solref=0.01 1", "stated twice"),
        ("timestep_s=1", "stands beside the settings"),
        ("cone=round", "cone"),
        ("f" * 100_000, "100000 characters, at most 1000 are read"),
        ("solref=0.02 1e300", "its equation overflows with these numbers"),
        ("solref=100 1e-300", "its equation overflows with these numbers"),
        ("solimp=0.9 0.95 0.001 0.5 1e300", "its equation overflows"),
    ],
)
def test_wrong_settings_are_refused(text, message):
    with pytest.raises(ParameterError, match=message):
        explain(explained(text), 2.0)


def test_an_engine_that_is_not_installed_is_named(monkeypatch, gauge):
    def absent():
        gone = ModuleNotFoundError(name="rapier3d")
        raise MissingExtraError("backend 'rapier'", "rapier", gone)

    monkeypatch.setattr(engine_settings("rapier"), "backend", absent)
    result = gauge("recipe", *shlex.split(asked("--backend=rapier")))
    assert result.exit_code == 2
    assert "pip install 'gauge-envs[rapier]'" in result.stderr


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
