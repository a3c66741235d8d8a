"""The finite elements of a block between clamped ends: closed forms, and the forces that they make."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gauge_envs.evaluation.verification import (
    COVERAGE_FACTOR,
    LEAST_FROZEN,
    load_length,
)
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.references.grips import solved_loads
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from scripts.build_grips import frame_means, sample_times_s
from scripts.solid import Block, Punch, held_wrenches

YOUNG_PA = 9e4


def block(size_m, cells, nu, **arguments):
    """Return a block about the origin."""
    edges_m = [
        np.linspace(-0.5 * size, 0.5 * size, count + 1)
        for size, count in zip(size_m, cells, strict=True)
    ]
    return Block(edges_m, YOUNG_PA, nu, **arguments)


def load_of_high_end(body, displacements_m):
    """Return the force on the high end and its torque about the long axis, after a displacement of all nodes."""
    places_m = body.at_rest(body.places_m + displacements_m)
    _, forces_n = body.end_forces_n(places_m)
    x, y, _ = places_m[body.ends[1]].T
    return forces_n.sum(axis=0), float((x * forces_n[:, 1] - y * forces_n[:, 0]).sum())


def pull_share(size_m, cells, nu, strain=1e-4):
    """Return the stiffness of a pulled block over E A / L."""
    body = block(size_m, cells, nu)
    longer_m = np.zeros_like(body.places_m)
    longer_m[:, 2] = strain * body.places_m[:, 2]
    force_n, _ = load_of_high_end(body, longer_m)
    return force_n[2] / (YOUNG_PA * size_m[0] * size_m[1] * strain)


def test_a_block_without_poisson_effect_has_the_stiffness_e_a_over_l_at_any_strain():
    for strain in (1e-4, 0.2):
        share = pull_share((0.05, 0.05, 0.2), (1, 1, 2), 0.0, strain)
        assert share == pytest.approx(1.0, abs=1e-7)


def test_a_slice_between_clamps_is_as_stiff_as_a_layer_that_cannot_narrow():
    nu = 0.3
    constrained = (1.0 - nu) / ((1.0 + nu) * (1.0 - 2.0 * nu))
    share = pull_share((1.0, 1.0, 0.05), (3, 3, 1), nu)
    assert share == pytest.approx(constrained, rel=0.05)


def test_a_block_that_turns_as_a_whole_has_no_forces():
    body = block((0.05, 0.05, 0.2), (1, 1, 2), 0.3)
    angle = 1.0
    turn = np.array(
        [
            [1.0, 0.0, 0.0],
            [0.0, np.cos(angle), -np.sin(angle)],
            [0.0, np.sin(angle), np.cos(angle)],
        ]
    )
    energy_j, forces_n = body.energy_and_forces(body.places_m @ turn.T, np.inf)
    assert energy_j == pytest.approx(0.0, abs=1e-15)
    assert np.abs(forces_n).max() < 1e-12


def test_a_long_block_twists_as_saint_venants_bar():
    """Each further length adds to the twist as T / (0.1406 G a^4): the clamps add nothing to it."""
    side_m, nu, angle = 0.05, 0.25, 1e-3
    softness = []
    for length_m in (0.2, 0.3):
        body = block((side_m, side_m, length_m), (2, 2, 3), nu)
        angles = angle * body.places_m[:, 2] / length_m
        x, y, _ = body.places_m.T
        sideways_m = np.stack([-angles * y, angles * x, 0.0 * x], axis=-1)
        softness.append(angle / load_of_high_end(body, sideways_m)[1])
    shear_pa = 0.5 * YOUNG_PA / (1.0 + nu)
    expected = 0.1 / (0.1406 * shear_pa * side_m**4)
    assert softness[1] - softness[0] == pytest.approx(expected, rel=0.03)


def test_a_long_block_shears_as_timoshenkos_beam():
    """Between clamps that stay parallel: L^3 / (12 E I) + L / (k G A), with k = 10 (1 + nu) / (12 + 11 nu) (Cowper)."""
    side_m, length_m, nu, offset_m = 0.05, 0.4, 0.25, 1e-5
    body = block((side_m, side_m, length_m), (1, 2, 8), nu)
    sideways_m = np.zeros_like(body.places_m)
    sideways_m[:, 1] = offset_m * (body.places_m[:, 2] / length_m + 0.5)
    force_n, _ = load_of_high_end(body, sideways_m)
    shear_pa = 0.5 * YOUNG_PA / (1.0 + nu)
    factor = 10.0 * (1.0 + nu) / (12.0 + 11.0 * nu)
    softness = length_m**3 / (YOUNG_PA * side_m**4)
    softness += length_m / (factor * shear_pa * side_m**2)
    assert force_n[1] == pytest.approx(offset_m / softness, rel=0.03)


def test_a_punch_bends_a_long_block_as_a_beam():
    """Its edges press at a distance b from the ends: b^2 (3 L - 4 b) / (48 E I) + b / (2 k G A) to the middle."""
    side_m, length_m, nu, push_m = 0.05, 0.45, 0.25, 1e-4
    body = block(
        (side_m, side_m, length_m),
        (1, 1, 9),
        nu,
        punch=Punch(axis=1, along_m=(-0.025, 0.025)),
    )
    places_m = body.at_rest(body.places_m, 0.5 * side_m - push_m)
    low_n, high_n = (forces.sum(axis=0) for forces in body.end_forces_n(places_m))
    assert low_n == pytest.approx(high_n * [1.0, 1.0, -1.0], abs=1e-9)
    shear_pa = 0.5 * YOUNG_PA / (1.0 + nu)
    factor = 10.0 * (1.0 + nu) / (12.0 + 11.0 * nu)
    arm_m = 0.5 * length_m - 0.025
    inertia_m4 = side_m**4 / 12.0
    softness = (
        arm_m**2 * (3.0 * length_m - 4.0 * arm_m) / (48.0 * YOUNG_PA * inertia_m4)
    )
    softness += arm_m / (2.0 * factor * shear_pa * side_m**2)
    # The axis between the edges bends on.
    axis_m = -places_m[np.argmin(np.abs(body.places_m).sum(axis=1)), 1]
    assert push_m < axis_m < 1.1 * push_m
    assert low_n[1] + high_n[1] == pytest.approx(axis_m / softness, rel=0.05)


def test_other_scenes_are_no_block():
    for name in ("TextileBending-satin", "CantileverBeam-soft", "StickStack-soft"):
        scene = load_experiment(name).scene
        assert held_wrenches(scene, np.linspace(0.0, 0.1, 3), cells=1) is None


FOAMS = [
    f"Foam{motion}-{foam}"
    for motion in ("Stretching", "Compressing", "Shearing", "Twisting", "Bending")
    for foam in ("soft", "hard")
]


@pytest.mark.slow
@pytest.mark.parametrize("name", FOAMS)
def test_stored_forces_are_those_of_a_block_of_other_cells_and_a_softer_one_is_told(
    name,
):
    """The block of four cells is not among the runs that the forces were made of."""
    scene = load_experiment(name).scene
    (foam,) = scene.deformables
    soft = replace(foam, young_modulus_pa=0.8 * foam.young_modulus_pa)
    loads = solved_loads(name)
    last_frame = max(last for load in loads for _, last in load.windows)
    times_s = sample_times_s(last_frame)
    distances = []
    for body in (foam, soft):
        changed = replace(scene, deformables=(body,))
        found = held_wrenches(changed, times_s, cells=4 if body is foam else 2)
        wrenches = frame_means(found)
        distances.append(
            [
                load_length(load.values(scene.holders, wrenches) - load.mean)
                / load_length(load.uncertainty)
                for load in loads
            ]
        )
    assert max(distances[0]) < COVERAGE_FACTOR
    assert max(distances[1]) > LEAST_FROZEN


@pytest.mark.slow
@pytest.mark.parametrize("name", ["FoamBending-soft", "FoamBending-hard"])
@pytest.mark.parametrize(
    ("engine", "settings", "limit_mm"),
    [
        ("mujoco", {}, 0.15),
        ("mujoco", {"preset": "training"}, 0.15),
        ("mujoco", {"cell_m": 0.0167}, 0.08),
        ("newton", {}, 0.2),
    ],
)
def test_engines_press_foam_as_the_block_is(name, engine, settings, limit_mm):
    """A layer of 0.5 mm in MuJoCo shows 0.25 mm, one of 1 mm in Newton 0.37; contacts faster than two steps 0.35."""
    pytest.importorskip(engine)
    result = run_episode(RunRequest(name, backend=engine, settings=settings))
    verified = result.score.verification
    assert verified.quantity == "positions of 14 markers"
    assert verified.distance < limit_mm
