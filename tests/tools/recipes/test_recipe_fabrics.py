"""Recipes of fabrics: stiffness by the law of an engine, a simulated strip, and a snippet in plain MuJoCo."""

import csv
import json
import math
import re
import shlex
import tomllib
from dataclasses import asdict, replace

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from places import ROOT
from scipy.integrate import solve_bvp
from texts import fenced

from gauge_envs import load_experiment
from gauge_envs.errors import ParameterError
from gauge_envs.experiments.task_files import fabrics
from gauge_envs.fixtures.recording import DivergedError
from gauge_envs.scene.fabrics import Fabric
from gauge_envs.scoring.estimators import hann_mean
from gauge_envs.tools.recipes import fabrics as recipes
from gauge_envs.tools.recipes.fabrics import (
    NOTHING_LOST,
    fabric_constants,
    fabric_of_tests,
    fabric_recipe,
)
from scripts.build_coverage import is_seen

SATIN = fabrics("TextileFlinging")["satin"]
STRETCH = SATIN.stretch_stiffness_n_per_m
G = 9.80665


@pytest.fixture(scope="module")
def recipe():
    """Return the recipe of satin in MuJoCo."""
    return fabric_recipe(SATIN, "mujoco")


def test_satin_reaches_the_measured_stiffness(recipe):
    assert not recipe.misses and recipe.explanation == NOTHING_LOST
    assert recipe.reached["stretch_n_per_m"] == pytest.approx(STRETCH, rel=1e-9)
    bend = SATIN.bend_stiffness_n_m_per_rad
    assert recipe.reached["bend_n_m"] == pytest.approx(bend, rel=0.2)


def test_isaac_has_a_shear_stiffness_but_no_simulation():
    """An isotropic sheet with Poisson's ratio 0.45 has the shear modulus E / 2.9."""
    recipe = fabric_recipe(SATIN, "isaac")
    shear = STRETCH / (2.0 * 1.45)
    assert recipe.reached["shear_n_per_m"] == pytest.approx(shear, rel=1e-6)
    assert recipe.reached["bend_n_m"] is None and not recipe.diverges
    assert "does not simulate" in recipe.explanation


def test_the_page_has_the_shear_stiffness_of_the_published_mappings():
    """Over the measured one: K / (2 (1 + nu)) of an isotropic sheet, K / 2 of springs along both diagonals."""
    text = (ROOT / "docs" / "fabrics.md").read_text()
    rows = dict(re.findall(r"^\| (Newton|Isaac Sim|Genesis) \| (.*) \|$", text, re.M))
    for column, fabric in enumerate(fabrics("TextileFlinging").values()):
        stretch = fabric.stretch_stiffness_n_per_m
        mapped = fabric_constants(fabric)
        poisson = mapped["isaac"].constants["poissons_ratio"]
        shear = {
            "Newton": mapped["newton"].constants["tri_ke"],
            "Isaac Sim": stretch / (2.0 * (1.0 + poisson)),
            "Genesis": stretch / 2.0,
        }
        for name, row in rows.items():
            shown = float(row.split(" | ")[column])
            ratio = shear[name] / fabric.shear_stiffness_n_per_m
            assert shown == pytest.approx(ratio, rel=0.02)


@pytest.mark.slow
def test_the_recipe_of_a_fabric_names_the_loss_of_its_mapping():
    """Newton has one modulus for stretch and shear, so the shear of satin is too stiff."""
    pytest.importorskip("newton")
    recipe = fabric_recipe(SATIN, "newton")
    shear = recipe.settings["tri_ke"]
    words = f"shear: {shear:.4g} N/m instead of {SATIN.shear_stiffness_n_per_m:.4g}"
    assert words in recipe.explanation
    assert f"tri_ke={shear:.6g}" in recipe.snippet


@pytest.mark.slow
def test_a_hinge_of_half_the_stiffness_is_a_miss(monkeypatch):
    """Plant a measurement: the strip bends by twice as much."""
    measure = recipes.bending_stiffness

    def halved(rollout):
        measurement = measure(rollout)
        return replace(measurement, measured=0.5 * measurement.measured)

    monkeypatch.setattr(recipes, "bending_stiffness", halved)
    recipe = fabric_recipe(SATIN, "mujoco")
    assert recipe.misses == ["bend_n_m"]
    # The bending length is proportional to the cube root of the stiffness.
    lengths = (recipe.asked["bending_length_m"], recipe.reached["bending_length_m"])
    stiffness = recipe.reached["bend_n_m"] / recipe.asked["bend_n_m"]
    assert lengths[1] / lengths[0] == pytest.approx(stiffness ** (1 / 3), rel=1e-6)


@pytest.mark.slow
def test_a_strip_that_does_not_settle_is_a_divergence_with_its_reason(monkeypatch):
    def unsettled(rollout):
        raise DivergedError("it swings")

    monkeypatch.setattr(recipes, "bending_stiffness", unsettled)
    recipe = fabric_recipe(SATIN, "mujoco")
    assert recipe.diverges and "it swings" in recipe.explanation


def test_the_snippet_stretches_in_a_plain_loop_of_mujoco(recipe):
    """Compare the sag of a plain flex strip with a row of springs that has the mass of its vertices."""
    columns, rows, cell = 13, 4, 0.025
    width = (rows - 1) * cell
    mass = SATIN.areal_density_kg_per_m2 * (columns - 1) * cell * width
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="2e-4" gravity="{G} 0 0"/><worldbody>'
        f'<flexcomp name="cloth" type="grid" dim="2" count="{columns} {rows} 1" spacing="{cell} {cell} {cell}" '
        f'mass="{mass}" radius="1e-4">{recipe.snippet}<contact contype="0" conaffinity="0" selfcollide="none"/>'
        f'<pin gridrange="0 0 0 {rows - 1}"/></flexcomp></worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    start, ends = data.flexvert_xpos[:, 0].copy(), []
    last = start > start.max() - 1e-6
    for _ in range(2000):
        mujoco.mj_step(model, data)
        ends.append(float((data.flexvert_xpos[last, 0] - start[last]).mean()))
    # The spring of column i carries the columns below; all columns have equal mass.
    load = mass * G * sum(range(1, columns)) / columns
    expected = load * cell / (STRETCH * width)
    share = float(hann_mean(np.array(ends))) / expected
    assert share == pytest.approx(1.0, rel=0.02)


def test_an_engine_without_cloth_is_an_error_with_the_supported_engines():
    with pytest.raises(ParameterError, match="choose one of"):
        fabric_recipe(SATIN, "pybullet")


TESTS = {
    "--overhang": "0.042m",
    "--stretch": "600",
    "--shear": "80",
    "--mass-per-area": "0.4",
    "--thickness": "0.0007m",
}


@pytest.mark.parametrize("name", fabrics("TextileFlinging"))
def test_an_overhanging_strip_of_a_tested_fabric_droops_to_the_angle_of_the_test(name):
    """The chord of the heavy elastica is at 41.5 degrees if the strip is as long as the overhang."""
    published = fabrics("TextileFlinging")[name]
    weight = published.areal_density_kg_per_m2 * G
    bending_length_m = np.cbrt(published.bend_stiffness_n_m_per_rad / weight)
    fabric = fabric_of_tests(
        bending_length_m=bending_length_m,
        stretch_n_per_m=published.stretch_stiffness_n_per_m,
        shear_n_per_m=published.shear_stiffness_n_per_m,
        areal_density_kg_per_m2=published.areal_density_kg_per_m2,
        thickness_m=published.thickness_m,
    )
    length_m = 2.0 * bending_length_m
    over = weight / fabric.bend_stiffness_n_m_per_rad
    places_m = np.linspace(0.0, length_m, 41)
    strip = solve_bvp(
        lambda s, y: [y[1], over * (length_m - s) * np.cos(y[0])],
        lambda low, high: [low[0], high[1]],
        places_m,
        [np.sin(0.25 * np.pi * places_m / length_m), 0.0 * places_m],
    )
    angles = strip.sol(places_m)[0]
    droop = -np.trapezoid(np.sin(angles)) / np.trapezoid(np.cos(angles))
    assert np.degrees(np.arctan(droop)) == pytest.approx(41.5, abs=0.5)
    for engine, mapped in fabric_constants(published).items():
        own = fabric_constants(fabric)[engine].constants
        assert own == pytest.approx(mapped.constants, rel=1e-12), engine


def test_tests_give_a_task_file_and_the_constants_of_engines(gauge):
    """By hand: c = 21 mm and w = 0.4 kg/m2 x 9.80665 m/s2, so B = 36.3278 uN m."""
    words = [word for pair in TESTS.items() for word in pair]
    shown = gauge("recipe", "fabrics", *words).stdout
    pasted = tomllib.loads(shown.partition("\n  constant")[0])
    fabric = Fabric(**pasted["constants"]["textile"]["tested"])
    assert fabric.bend_stiffness_n_m_per_rad == pytest.approx(36.3278e-6, rel=1e-5)
    assert "newton loses shear" in shown
    row = json.loads(gauge("recipe", "fabrics", *words, "--json").stdout)["tested"]
    assert {"genesis", "isaac", "mujoco", "newton"} <= row.keys()
    length = ["--bending-length", "0.021", *words[2:]]
    same = json.loads(gauge("recipe", "fabrics", *length, "--json").stdout)["tested"]
    assert same == row


@pytest.mark.parametrize("name", ["StripBending-satin", "Funnel-rayon"])
def test_the_task_file_of_a_tested_fabric_differs_in_the_fabric_alone(
    name, gauge, tmp_path, monkeypatch
):
    """By hand: the mass is 0.4 kg/m2 times the area of the cloth."""
    monkeypatch.chdir(tmp_path)
    words = [word for pair in TESTS.items() for word in pair]
    done = gauge("recipe", "fabrics", *words, "--id", name, "--out", "denim-2.toml")
    assert not done.exit_code, done.stderr
    copied, own = load_experiment(name), load_experiment("denim-2.toml")
    assert own.name == f"Denim2{copied.variant.family}-tested"
    (cloth,) = own.scene.deformables
    assert cloth.mass_kg == pytest.approx(0.4 * math.prod(cloth.size_m))
    assert cloth.bend_stiffness_n_m_per_rad == pytest.approx(36.3278e-6, rel=1e-5)
    (published,) = copied.scene.deformables
    fabric = asdict(Fabric.of(published)) | {"mass_kg": published.mass_kg}
    assert replace(own.scene, deformables=(replace(cloth, **fabric),)) == copied.scene
    assert own.frame_count == copied.frame_count
    origin = own.spec.provenance_of(f"constants.{cloth.name}.tested.friction")
    assert origin == f"nominal: of {copied.variant.material}"
    gym.registry.pop(own.id, None)


@pytest.mark.parametrize(
    ("more", "text"),
    [
        (["--id", "StripBending-satin"], "needs both"),
        (["--id", "StripBending-satin", "--out", "denim.json"], "ends in .toml"),
        (["--id", "SlopeSlider-2-wood", "--out", "denim.toml"], "has no fabric"),
    ],
)
def test_an_impossible_task_file_is_refused(more, text, gauge, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = [word for pair in TESTS.items() for word in pair]
    refused = gauge("recipe", "fabrics", *words, *more)
    assert refused.exit_code == 2
    assert text in " ".join(refused.stderr.split())
    assert not [*tmp_path.iterdir()]


@pytest.mark.slow
def test_the_commands_of_the_page_compare_engines_on_a_fabric(
    gauge, tmp_path, monkeypatch
):
    """The markers of MuJoCo and Newton are within 2 % of the heavy elastica of the tested fabric."""
    pytest.importorskip("newton")
    monkeypatch.chdir(tmp_path)
    page = ROOT / "docs" / "fabrics.md"
    text = next(b for b in fenced(page, "sh") if "--out denim.toml" in b)
    outputs = [gauge(*shlex.split(line)[1:]) for line in text.splitlines()]
    assert not any(done.exit_code for done in outputs), outputs[-1].stderr
    (row,) = re.findall(r"DenimStripBending-tested &(.*)\\\\", outputs[-1].stdout)
    assert all(float(cell) < 0.02 for cell in row.split("&"))
    gym.registry.pop("GAUGE/DenimStripBending-tested", None)


def test_the_page_says_what_the_stored_sensitivities_show():
    """A change is seen from 2 % of the motion, and from three times what a millionth of a constant makes."""
    file = ROOT / "studies" / "models" / "sensitivity.csv"
    with file.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    seen = {
        column: [
            row["id"] for row in rows if row[column] != "-" and is_seen(row, column)
        ]
        for column in ("stretch", "shear", "bend", "density", "friction", "air")
    }
    experiments = {
        column: {name.rpartition("-")[0] for name in names}
        for column, names in seen.items()
    }
    assert experiments["bend"] == {"StripBending"}
    assert experiments["shear"] == {"BiasStretching", "RotatingBall"}
    assert experiments["friction"] == {"RotatingBall", "TableclothPulling"}
    of_flinging = [
        column for column, names in experiments.items() if "TextileFlinging" in names
    ]
    assert of_flinging == ["air"]
    of_clamped = [
        name for name in seen["stretch"] if name.startswith("TextileStretching")
    ]
    assert of_clamped == ["TextileStretching-satin"]
    assert "TextileBending" in experiments["stretch"]


@pytest.mark.parametrize("left_out", TESTS)
def test_incomplete_and_impossible_tests_are_refused(left_out, gauge):
    given = [word for pair in TESTS.items() if left_out not in pair for word in pair]
    incomplete = gauge("recipe", "fabrics", *given)
    assert incomplete.exit_code == 2
    assert f"add {left_out}" in incomplete.stderr
    assert gauge("recipe", "fabrics", *given, left_out, "0").exit_code == 2
