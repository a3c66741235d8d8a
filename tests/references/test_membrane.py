"""The finite elements of a cloth that a rod pushes, against closed forms and a scaling law."""

from dataclasses import replace

import numpy as np
import pytest

from gauge_envs.experiments.resolve import load_experiment
from scripts.membrane import ProbedSheet, held_forces_n, probed_sheet_of

SHEET = ProbedSheet(
    size_m=(0.4, 0.4),
    stretch_n_per_m=1000.0,
    shear_n_per_m=500.0,
    weight_n_per_m2=0.0,
    weight_direction=(-1.0, 0.0, 0.0),
    tip_m=(0.0, 0.0),
    tip_radius_m=0.005,
)


def force_n(sheet, push_m, *, rings=8, sticks=False):
    return held_forces_n(
        sheet, np.array([push_m]), rings=rings, sticks=sticks, folds=True
    )[0]


def test_the_force_of_a_weightless_sheet_is_the_cube_of_the_push_and_follows_its_stiffness():
    force = force_n(SHEET, 0.002)[2]
    soft = replace(SHEET, stretch_n_per_m=800.0, shear_n_per_m=400.0)
    assert force_n(soft, 0.002)[2] == pytest.approx(0.8 * force, rel=1e-4)
    assert force_n(SHEET, 0.004)[2] == pytest.approx(8.0 * force, rel=0.01)


def test_a_membrane_that_a_point_pushes_is_between_two_closed_forms():
    """F = (q w / a)^3 K a of a round sheet, q = 1 / 1.049 for nu = 0 (Komaragiri, Begley and Simmonds, J. Appl. Mech.,
    2005, p. 203). A square is softer than its inner circle, and stiffer than its outer one."""
    small = replace(SHEET, tip_radius_m=0.0005)
    force = -force_n(small, 0.01, rings=14)[2]
    inner = 1000.0 * (0.01 / 1.049) ** 3 / 0.2**2
    assert 0.5 * inner < force < inner


def test_a_rim_carries_the_weight_of_its_cloth():
    heavy = replace(SHEET, weight_n_per_m2=10.0)
    assert force_n(heavy, 0.01)[0] == pytest.approx(1.6, rel=1e-5)


def test_material_that_sticks_pulls_more_than_material_that_slides():
    assert -force_n(SHEET, 0.02, sticks=True)[2] > -force_n(SHEET, 0.02)[2]


def test_only_a_pushed_cloth_in_a_frame_is_one():
    assert probed_sheet_of(load_experiment("TextileFlinging-satin").scene) is None
    sheet, gap_m, _ = probed_sheet_of(load_experiment("TextileStretching-satin").scene)
    # Published places: the middle of the rod 105.36 mm before the cloth, half of its length 100 mm.
    assert gap_m == pytest.approx(0.00536 - 0.00007, abs=1e-6)
    assert sheet.tip_m == pytest.approx((-0.00057, 0.00161), abs=1e-6)
