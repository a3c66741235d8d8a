"""The one-dimensional sheet: closed forms, energy, and the references that it makes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gauge_envs import load_experiment
from gauge_envs.evaluation.verification import load_length, verify
from gauge_envs.experiments.variants import variants
from gauge_envs.references.grips import solved_loads
from gauge_envs.references.models import solved_model
from gauge_envs.scene import GRAVITY_M_PER_S2
from scripts.build_grips import loads_of, sheet_wrenches
from scripts.sheet import (
    marker_places_m,
    node_masses_kg_per_m,
    sheet_of,
    solve_sheet,
)

FABRICS = ("rayon", "satin", "uniform", "nylon", "oxford", "leather")
SHEETS = [
    f"{family}-{fabric}"
    for family in ("TextileFlinging", "TextileBending")
    for fabric in FABRICS
]
QUICK = ("TextileFlinging-uniform", "TextileBending-oxford")
MM_PER_M = 1e3


def sheet_and_markers(name):
    experiment = load_experiment(name)
    return sheet_of(experiment.scene), np.asarray(experiment.scene.markers.positions_m)


def hanging(fabric):
    """Return the hanging cloth of TextileFlinging with its rod at rest."""
    sheet, _ = sheet_and_markers(f"TextileFlinging-{fabric}")
    return replace(sheet, end_drivers=dict.fromkeys(sheet.end_drivers))


@pytest.mark.parametrize("fabric", ["satin", "nylon"])
def test_a_hanging_sheet_vibrates_along_its_length_as_the_wave_equation_says(fabric):
    """A bar that gravity stretches from frame 0: its lower end moves as a triangle wave of period 4 L / c.

    The end falls freely until the wave from the clamp arrives. It is lowest after 2 L / c, at twice the static
    elongation rho g L^2 / (2 K), and at rest at its start after 4 L / c.
    """
    sheet = hanging(fabric)
    cloth, length_m = sheet.cloth, sheet.cloth.size_m[0]
    nodes_m, _, _ = solve_sheet(sheet, cells=160, frames=8)
    lower = 0 if "high" in sheet.end_drivers else -1
    found_mm = MM_PER_M * (nodes_m[0, 2, lower] - nodes_m[:, 2, lower])

    stiffness = cloth.stretch_stiffness_n_per_m
    density = cloth.areal_density_kg_per_m2
    wave_m_per_s = np.sqrt(stiffness / density)
    # d'Alembert: free fall, minus the waves that the clamp sends back and the free end reflects.
    times_s = np.arange(8) / 30.0
    phases = np.mod(times_s * wave_m_per_s / length_m, 4.0)
    folded = np.minimum(phases, 4.0 - phases)
    fall = np.where(folded < 1.0, folded**2, 0.0)
    rise = np.where(folded >= 1.0, folded**2 - 2.0 * (folded - 1.0) ** 2, 0.0)
    scale_mm = MM_PER_M * density * GRAVITY_M_PER_S2 * length_m**2 / (2.0 * stiffness)
    expected_mm = scale_mm * (fall + rise)
    np.testing.assert_allclose(found_mm, expected_mm, atol=0.03 * scale_mm)


def test_a_sheet_without_moving_ends_keeps_its_energy():
    sheet, _ = sheet_and_markers("TextileBending-satin")
    still = replace(sheet, end_drivers=dict.fromkeys(sheet.end_drivers))
    nodes_m, energies, _ = solve_sheet(still, cells=40, frames=61)
    cloth = sheet.cloth
    weight_n_per_m = cloth.areal_density_kg_per_m2 * GRAVITY_M_PER_S2 * cloth.size_m[0]
    drop_m = nodes_m[0, 2].mean() - nodes_m[:, 2].mean(axis=1).min()
    assert drop_m > 0.01
    assert np.abs(energies - energies[0]).max() < 0.01 * weight_n_per_m * drop_m


def test_a_small_swing_of_the_sheet_has_the_period_of_a_hanging_chain():
    """Small swings of a hanging chain: angular frequencies of the zeros of J0, 2.4048 / 2 sqrt(g / L) and so on.

    The chain does not stretch, so the sheet is stiffer than any fabric here.
    """
    sheet, _ = sheet_and_markers("TextileFlinging-oxford")
    (side,) = sheet.end_drivers
    driver = sheet.end_drivers[side]
    # A thousandth of the prescribed motion, after which the sheet swings on.
    profiles = tuple(
        replace(profile, amount=1e-3 * profile.amount)
        for profile in driver.motions[0].profiles
    )
    small = replace(driver, motions=(replace(driver.motions[0], profiles=profiles),))
    stiffness = 25.0 * sheet.cloth.stretch_stiffness_n_per_m
    stiff = replace(sheet.cloth, stretch_stiffness_n_per_m=stiffness)
    frames = 121
    nodes_m, _, _ = solve_sheet(
        replace(sheet, cloth=stiff, end_drivers={side: small}), cells=32, frames=frames
    )
    lower = 0 if side == "high" else -1
    swing = nodes_m[42:, 1, lower] - nodes_m[-1, 1, -1 if side == "high" else 0]
    times_s = np.arange(42, frames) / 30.0
    length_m = sheet.cloth.size_m[0]
    zeros = np.array([2.404826, 5.520078, 8.653728])
    modes = 0.5 * zeros * np.sqrt(GRAVITY_M_PER_S2 / length_m)

    def left(factor):
        columns = [np.ones_like(times_s)]
        for mode in factor * modes:
            columns += [np.cos(mode * times_s), np.sin(mode * times_s)]
        matrix = np.column_stack(columns)
        fit = np.linalg.lstsq(matrix, swing, rcond=None)[0]
        return float(np.sqrt(np.square(matrix @ fit - swing).mean()))

    factors = np.linspace(0.97, 1.03, 61)
    best = factors[np.argmin([left(factor) for factor in factors])]
    assert best == pytest.approx(1.0, abs=0.005)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in QUICK else pytest.mark.slow)
        for name in SHEETS
    ],
)
def test_the_reference_is_that_of_a_sheet_of_finer_cells(name):
    """The finer sheet is not among the runs that the reference was made of."""
    sheet, markers_m = sheet_and_markers(name)
    band = solved_model(name).band
    known = np.isfinite(band.points.mean).all(axis=1)
    frames = min(13, int(known.sum()))
    nodes_m, _, _ = solve_sheet(sheet, cells=240, frames=frames)
    found_mm = MM_PER_M * marker_places_m(sheet, nodes_m, markers_m).reshape(frames, -1)
    deviations = found_mm - band.points.mean[:frames]
    uncertainty = band.points.uncertainty[:frames]
    distance = np.sqrt(np.square(deviations).mean())
    assert distance <= 1.96 * np.sqrt(np.square(uncertainty).mean())


def test_every_load_of_the_table_is_solved():
    assert {one.name for one in variants() if loads_of(one.name)} == {
        one.name for one in variants() if solved_loads(one.name)
    }


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in QUICK else pytest.mark.slow)
        for name in SHEETS
    ],
)
def test_stored_forces_are_those_of_a_sheet_of_other_cells(name):
    """The sheet of 56 cells is not among the runs that the forces were made of; a lighter one is told."""
    scene = load_experiment(name).scene
    (cloth,) = scene.deformables
    light = replace(
        cloth,
        areal_density_kg_per_m2=0.8 * cloth.areal_density_kg_per_m2,
        mass_kg=0.8 * cloth.mass_kg,
    )
    loads = solved_loads(name)
    last_frame = max(last for load in loads for _, last in load.windows)
    distances = []
    for body in (cloth, light):
        experiment = replace(
            load_experiment(name), scene=replace(scene, deformables=(body,))
        )
        found = sheet_wrenches(experiment, last_frame + 1, cells=56)
        distances.append(
            [
                load_length(load.values(scene.holders, found) - load.mean)
                / load_length(load.uncertainty)
                for load in loads
            ]
        )
    assert max(distances[0]) < 1.96
    assert max(distances[1]) > 1.96


def test_other_scenes_are_no_sheet():
    for name in ("TextileStretching-satin", "Funnel-satin", "FoamBending-soft"):
        assert sheet_of(load_experiment(name).scene) is None
    assert (
        sheet_of(load_experiment("TextileFlinging-satin", parameters="air").scene)
        is None
    )


@pytest.mark.parametrize("name", ["TextileFlinging-satin", "TextileBending-satin"])
def test_a_frozen_scene_and_a_softer_or_lighter_fabric_differ_from_the_reference(name):
    """Stretch stiffness and density act as K_s / rho: a cloth that hangs or sags from frame 0 vibrates with it."""
    sheet, markers_m = sheet_and_markers(name)
    band = solved_model(name).band
    frames = int(np.isfinite(band.points.mean).all(axis=1).sum())
    cloths = {"as it is": sheet.cloth}
    if "Bending" in name:
        stiffness = sheet.cloth.stretch_stiffness_n_per_m
        density = sheet.cloth.areal_density_kg_per_m2
        cloths |= {
            "soft": replace(sheet.cloth, stretch_stiffness_n_per_m=0.8 * stiffness),
            "light": replace(sheet.cloth, areal_density_kg_per_m2=0.8 * density),
        }
    found = {}
    for title, cloth in cloths.items():
        nodes_m, _, _ = solve_sheet(
            replace(sheet, cloth=cloth), cells=80, frames=frames
        )
        places_m = marker_places_m(sheet, nodes_m, markers_m)
        found[title] = verify(
            band, frames=np.zeros((frames, len(band.coordinates))), markers_m=places_m
        )
    right = found.pop("as it is")
    assert right.scaled < 1.96
    assert right.frozen > 5.0 * right.uncertainty
    assert all(wrong.scaled > 5.0 for wrong in found.values())


def test_a_held_end_changes_the_momentum_of_the_sheet_by_its_force():
    scene = load_experiment("TextileFlinging-satin").scene
    sheet = sheet_of(scene)
    nodes_m, _, loads_n_per_m = solve_sheet(sheet, cells=40, frames=13)
    masses = node_masses_kg_per_m(sheet.cloth, 41)
    # Before the rod moves much the sheet falls and rebounds: over 0.4 s its momentum is small beside its weight.
    places = (masses * nodes_m).sum(axis=2)
    momentum = (places[12] - places[10]) / 2.0 * 30.0
    impulse = loads_n_per_m["high"][1:12].sum(axis=0) / 30.0
    impulse[2] -= masses.sum() * 9.80665 * 11.0 / 30.0
    assert (
        np.abs(impulse - momentum).max() < 0.01 * masses.sum() * 9.80665 * 11.0 / 30.0
    )
