"""`gauge reference`: a scene whose motion has a closed form shows what the uncertainty of a solution covers."""

import shutil

import gymnasium as gym
import numpy as np
import pytest
from places import ROOT
from texts import changed_text

from gauge_envs import load_experiment, reference_band
from gauge_envs.backends.mujoco import BackendMuJoCo
from gauge_envs.experiments.variants import task_path
from gauge_envs.references.band import load_band, read_band_file
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.tools.reference.solution import (
    length,
    softened,
    solution,
    write_solution,
)

NAME = "CrateSlide-pine"
FILE = f"{NAME}.band.toml"
G, TILT = 9.80665, np.radians(25.0)
SLIDE = G * (np.sin(TILT) - 0.3 * np.cos(TILT))
DOWNHILL = np.array([np.cos(TILT), 0.0, -np.sin(TILT)])
START_M = "-0.571022712, 0.0, 1.431778951"


@pytest.fixture
def crate(tmp_path, monkeypatch):
    """The task file of a crate on a ramp, without its band; its id leaves Gymnasium afterwards."""
    monkeypatch.chdir(tmp_path)
    shutil.copy(ROOT / "examples" / "own_experiment" / "crate.toml", tmp_path)
    yield tmp_path / "crate.toml"
    gym.registry.pop(f"GAUGE/{NAME}", None)


def falling(file):
    """Make the crate fall for 0.2 s, from a metre above the ramp."""
    start = START_M.replace("1.431", "2.431")
    changed_text(file, (START_M, start), ("all = 31", "all = 7"))


def solves(**settings):
    return run_episode(RunRequest("crate.toml", settings=settings)).score.solves


@pytest.mark.parametrize(
    ("change", "course"),
    [
        (lambda file: None, SLIDE * DOWNHILL),
        (falling, np.array([0.0, 0.0, -G])),
    ],
    ids=["slide", "fall"],
)
def test_u_covers_the_true_error_and_the_reference_scores_runs(
    crate, gauge, change, course
):
    change(crate)
    done = gauge("reference", "crate.toml")
    assert not done.exit_code, done.stderr
    assert "a second engine (--against)" in done.stdout
    assert "about 0.0 min" in done.stderr
    band = reference_band(load_experiment("crate.toml"))
    assert band.kind == "numerical"
    assert f"u = {band.standard_uncertainty:.3g} mm" in " ".join(done.stdout.split())
    times_s = np.arange(len(band.mean))[:, None] / 30.0
    exact_mm = band.mean[0] + 1e3 * 0.5 * course * times_s**2
    error_mm = np.linalg.norm(band.mean - exact_mm, axis=1)
    u_mm = np.linalg.norm(band.uncertainty, axis=1)
    assert np.mean(error_mm <= 1.96 * u_mm + 1e-9) > 0.75
    assert np.sqrt(np.mean(error_mm**2)) <= 1.96 * band.standard_uncertainty
    assert solves() == "yes"
    # Semi-implicit steps fall by a relative h / t too far, here more than 2 %.
    assert solves(timestep_s=1 / 180) == ("no" if change is falling else "yes")


@pytest.mark.slow
@pytest.mark.parametrize("material", ["wood", "plastic", "metal"])
def test_u_covers_the_creep_of_soft_contacts(material, gauge, tmp_path):
    """Coulomb's law holds a cube on a slow turntable; in MuJoCo it creeps outward, in proportion to the softness."""
    name = f"Turntable-1-{material}"
    done = gauge("reference", name, "--out", str(tmp_path))
    assert "twice the softness of contacts" in " ".join(done.stderr.split())
    assert "order 1.00 in the softness" in " ".join(done.stdout.split())
    solved, exact = np.load(tmp_path / f"{name}.band.npz"), load_band(name)
    u_mm = exact.length(solved["uncertainty"])
    assert exact.length(solved["mean"] - exact.mean) <= u_mm
    assert u_mm < 0.002 * exact.zero_motion_distance


@pytest.mark.parametrize(
    "name",
    ["SlopeSlider-3-wood", "SlopeContact-wood", "NonsmoothContact-1-wood"],
)
def test_a_bundled_reference_made_again_agrees_within_u(name, gauge, tmp_path):
    assert not gauge("reference", name, "--out", str(tmp_path)).exit_code
    solved, bundled = np.load(tmp_path / f"{name}.band.npz"), load_band(name)
    in_band = bundled.projection.T
    apart = bundled.length(solved["mean"] @ in_band - bundled.mean)
    u = bundled.length(np.sqrt(solved["uncertainty"] ** 2 @ in_band**2))
    assert apart <= np.hypot(u, bundled.standard_uncertainty)
    assert u < 0.01 * bundled.zero_motion_distance


def test_an_engine_without_a_softness_of_contacts_leaves_it_out(
    crate, gauge, monkeypatch
):
    monkeypatch.setattr(BackendMuJoCo, "contact_softness", {})
    stdout = gauge("reference", "crate.toml").stdout
    assert "softness of contacts, tolerance" in " ".join(stdout.split())


def test_the_softness_of_both_formats_of_solref():
    """(time constant T, ratio) has the stiffness 1 / T^2 and the damping 2 / T of the direct format."""
    settings = {"sustained_solref": (0.02, 1.0), "contact_solref": (-2500.0, -100.0)}
    request = RunRequest("SlopeSlider-2-wood", settings=settings)
    coarse, scene = run_episode(request), request.experiment().scene
    stiffer = softened(coarse, scene, halvings=1)
    assert stiffer["sustained_solref"] == [0.01, 1.0]
    assert stiffer["contact_solref"] == [-10000.0, -200.0]
    softer = softened(coarse, scene, halvings=-1)
    assert softer["sustained_solref"] == [0.04, 1.0]
    assert softer["contact_solref"] == [-625.0, -50.0]


def test_a_coarse_reference_cannot_tell(crate, gauge):
    falling(crate)
    assert (
        "order 1.00"
        in gauge("reference", "crate.toml", "--set", "timestep_s=1/180").stdout
    )
    assert solves(timestep_s=1 / 180) == "cannot tell"
    assert not gauge("reference", "crate.toml").exit_code
    assert solves(timestep_s=1 / 180) == "no"


def test_the_events_of_a_renewed_reference_stay(crate):
    experiment = load_experiment("crate.toml")
    solved = solution({"step": [np.zeros((31, 3))] * 3}, 3)
    file = crate.with_name(FILE)
    write_solution(file, experiment, solved, 'a "quoted" source')
    event = '\n[[events]]\nname = "rise"\nunit = "mm"\nvalue = 1.0\nstandard_uncertainty = 0.1\nsource = ""\n'
    file.write_text(file.read_text("utf-8") + event, "utf-8")
    write_solution(file, experiment, solved, "another source")
    renewed = read_band_file(file)
    assert renewed.source == "another source"
    assert [event.name for event in renewed.events] == ["rise"]


def test_a_reference_that_is_no_numerical_solution_stays(crate, gauge):
    shutil.copy(ROOT / "examples" / "own_experiment" / FILE, crate.parent)
    shutil.copy(ROOT / "examples" / "own_experiment" / f"{NAME}.band.npz", crate.parent)
    refused = gauge("reference", "crate.toml")
    assert refused.exit_code == 2
    assert "its kind is analytic" in " ".join(refused.stderr.split())
    assert not gauge("reference", "crate.toml", "--out", "solved").exit_code
    assert (crate.parent / "solved" / FILE).is_file()


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("SlopeSlider-2-wood", "has real trials as its reference"),
        ("CantileverBeam-hard", "give --out FOLDER"),
    ],
)
def test_an_id_of_the_package_is_refused(gauge, name, text):
    refused = gauge("reference", name)
    assert refused.exit_code == 2
    assert text in " ".join(refused.stderr.split())


@pytest.mark.slow
def test_a_soft_scene_needs_the_edge_of_its_cells(gauge):
    refused = gauge("reference", "FoamBending-soft", "--out", "solved")
    assert refused.exit_code == 2
    assert "--set cell_m=" in " ".join(refused.stderr.split())


def test_order_mesh_and_second_engine_make_u():
    """The error of a step h is a h^p; Roache's factors are 1.25 for three levels and 3 for two meshes of order 2."""
    shape = np.linspace(0.0, 1.0, 5)[:, None]
    for order in (0.7, 1.0):
        runs = [shape * (1.0 + 0.08 * 2.0 ** (-order * level)) for level in range(3)]
        solved = solution({"step": runs}, 1)
        assert solved.orders["step"] == pytest.approx(order)
        np.testing.assert_allclose(solved.uncertainty, 1.25 * (runs[2] - shape))
    mesh = [runs[2], runs[2] + 0.3]
    other = mesh[1] + np.sqrt(3.0) * 0.4
    u = solution({"step": runs, "cells": mesh}, 1, other).uncertainty
    np.testing.assert_allclose(u**2, (1.25 * (runs[2] - shape)) ** 2 + 0.3**2 + 0.4**2)
    assert length(np.ones((4, 1 + 6)), 1) == pytest.approx(np.sqrt(3.0))


def test_runs_without_an_order_give_three_times_their_largest_change():
    shape = np.linspace(0.0, 1.0, 5)[:, None]
    for factors in ((1.0, -1.0, 1.0), (0.0, 0.5, 1.5), (1.0, 0.0, 0.1)):
        solved = solution({"step": [factor * shape for factor in factors]}, 1)
        assert solved.orders == {"step": None}
        largest = np.abs(np.diff(factors)).max()
        np.testing.assert_allclose(solved.uncertainty, 3.0 * largest * shape)
    fast = solution({"step": [shape, 0.2 * shape, 0.0 * shape]}, 1)
    assert fast.orders["step"] == pytest.approx(2.0)
    np.testing.assert_allclose(fast.uncertainty, 1.25 * 0.2 * shape)
    still = solution({"step": [shape] * 3}, 1)
    assert still.u == 0.0
    assert not still.orders


@pytest.mark.slow
def test_the_cells_of_an_own_strip_are_refined_and_u_covers_the_elastica(
    tmp_path, gauge, monkeypatch
):
    text = task_path("StripBending").read_text(encoding="utf-8")
    file = tmp_path / "strip.toml"
    file.write_text(text.replace('"StripBending"', '"OwnStrip"'), encoding="utf-8")
    monkeypatch.setenv("GAUGE_TASKS", str(file))
    done = gauge("reference", "OwnStrip-satin")
    assert not done.exit_code, done.stderr
    assert "cell_m=" in done.stderr
    band, exact = map(load_band, ("OwnStrip-satin", "StripBending-satin"))
    apart_mm = exact.length(band.mean - exact.mean)
    assert (
        apart_mm <= 1.96 * band.standard_uncertainty < 0.02 * exact.zero_motion_distance
    )
    assert not gauge("run", "OwnStrip-satin").exit_code
    assert "not ranked" not in gauge("compare", "results").stdout
    gym.registry.pop("GAUGE/OwnStrip-satin", None)
