"""The order of the published rotations is an assumption: where it matters, the task says so."""

import csv

import numpy as np
import pytest
from places import ROOT
from scipy.spatial.transform import Rotation

from gauge_envs import load_experiment
from gauge_envs.tools.catalog.description import description
from studies.euler_order import euler_order

ORDERS = list(euler_order.other_orders())


def test_only_the_tilted_bodies_have_more_than_one_published_angle():
    assert [order.variant for order in ORDERS] == [
        f"NonsmoothContact-{subtask}-{material}"
        for subtask in "123"
        for material in ("wood", "plastic")
    ]


@pytest.mark.parametrize("order", ORDERS, ids=lambda order: order.variant)
def test_the_other_order_is_the_product_the_other_way_round(order):
    x, y, z = order.euler_deg
    assert z == 0.0
    about_x, about_y = (
        Rotation.from_euler("x", x, degrees=True),
        Rotation.from_euler("y", y, degrees=True),
    )
    assumed = load_experiment(order.variant).scene.body(order.body).pose.rotation
    assert (assumed.inv() * (about_y * about_x)).magnitude() < 1e-9
    other = (
        load_experiment(order.variant, {f"{order.body}.euler_deg": order.other_deg})
        .scene.body(order.body)
        .pose
    )
    assert (other.rotation.inv() * (about_x * about_y)).magnitude() < 1e-9
    # To second order the two differ by the product of the angles, about the third axis.
    assert order.apart_deg == pytest.approx(
        np.rad2deg(np.deg2rad(abs(x)) * np.deg2rad(abs(y))), rel=0.02
    )


@pytest.mark.parametrize("order", ORDERS, ids=lambda order: order.variant)
def test_the_task_and_the_study_state_what_the_order_does(order):
    decisions = " ".join(description(load_experiment(order.variant))["decisions"])
    assert "no order of the published rotations" in decisions
    assert order.corner_mm < 1.2
    assert f"{order.apart_deg:.1f}" in decisions
    with (ROOT / "studies" / "euler_order" / "orders.csv").open(
        encoding="utf-8", newline=""
    ) as file:
        stated = {row["id"]: list(row.values())[1:4] for row in csv.DictReader(file)}
    angles = " / ".join(f"{angle:g}" for angle in order.euler_deg)
    assert stated[order.variant] == [
        angles,
        f"{order.apart_deg:.2f}",
        f"{order.corner_mm:.2f}",
    ]
