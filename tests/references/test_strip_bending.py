"""StripBending against a chain of rigid links, which has the least energy, and Peirce's law of small angles."""

import numpy as np
import pytest
from scipy.optimize import minimize

from gauge_envs import load_experiment
from gauge_envs.backends.shared.cloth_grid import ClothGrid
from gauge_envs.experiments.task_files import fabrics
from gauge_envs.references.band import load_band
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.scene.fabrics import Fabric, bending_length_m

LENGTH_M, LINKS = 0.03, 120
PLACES_MM = 5.0 * np.arange(1, 7)


def hanging_chain(bending_length, clamp_rad):
    """Return x and z of the joints of a chain with a spring in each, from the clamp [m], shape [LINKS + 1, 2]."""
    link_m = LENGTH_M / LINKS
    stiffness = bending_length**3 / link_m
    beyond_m = link_m**2 * (LINKS - np.arange(LINKS) - 0.5)

    def energy(angles):
        """Energy over the weight per length, and its slope. The spring in the clamp has half a link."""
        turns = np.diff(angles, prepend=clamp_rad)
        springs = np.full(LINKS, stiffness)
        springs[0] *= 2.0
        torques = springs * turns
        slope = beyond_m * np.cos(angles) + torques - np.append(torques[1:], 0.0)
        value = beyond_m @ np.sin(angles) + 0.5 * torques @ turns
        return value / stiffness, slope / stiffness

    found = minimize(
        energy, np.full(LINKS, -0.7), jac=True, method="BFGS", options={"gtol": 1e-9}
    )
    steps_m = link_m * np.column_stack([np.cos(found.x), np.sin(found.x)])
    return np.concatenate([np.zeros((1, 2)), steps_m.cumsum(axis=0)])


def test_a_stiff_chain_droops_as_peirce_says():
    """w L^4 / 8 B, less 1 % at a slope of 0.01."""
    bending_length = 3.0 * LENGTH_M
    droop_m = -hanging_chain(bending_length, 0.0)[-1, 1]
    assert droop_m == pytest.approx(LENGTH_M / 8.0 / 3.0**3, rel=2e-3)


@pytest.mark.parametrize("material", fabrics("StripBending"))
def test_the_reference_is_the_chain_of_least_energy(material):
    """At half of the turn, of -45 degrees, and level. Links of 0.25 mm are 2 um from the elastica."""
    variant = f"StripBending-{material}"
    band, scene = load_band(variant), load_experiment(variant).scene
    bending_length = bending_length_m(Fabric.of(scene.deformables[0]))
    for frame, clamp_rad in ((45, -0.25 * np.pi), (105, 0.0)):
        chain_m = hanging_chain(bending_length, clamp_rad)[LINKS // 6 :: LINKS // 6]
        edge_m = 0.00125 * np.array([np.cos(clamp_rad), np.sin(clamp_rad)])
        markers_mm = band.mean[frame].reshape(6, 3)[:, [0, 2]]
        assert np.abs(1e3 * (chain_m + edge_m) - markers_mm).max() < 5e-3
    np.testing.assert_allclose(
        band.mean[0].reshape(6, 3)[:, 2], -1.25 - PLACES_MM, atol=1e-6
    )
    assert band.standard_uncertainty < 2e-3 * band.zero_motion_distance


def test_folds_where_a_clamp_ends_are_twice_as_stiff():
    """A clamp of one cell of a strip of four by two: the two folds between its cells and the free ones."""
    cloth = load_experiment("StripBending-satin").scene.deformables[0]
    grid = ClothGrid(cloth, 0.5 * cloth.size_m[1])
    edges = {}
    for triangle in grid.triangles:
        for corner in range(3):
            first, second, other = np.roll(triangle, corner)
            edges.setdefault(frozenset((first, second)), []).append(other)
    folds = np.array([sorted(edge) for edge in edges])
    opposite = np.array(
        [
            (others * 2)[:2] if len(others) > 1 else (others[0], -1)
            for others in edges.values()
        ]
    )
    held = np.flatnonzero(
        grid.plane_m[:, 0] < grid.plane_m[:, 0].min() + 1.5 * grid.cell_m[0]
    )
    stiff = grid.fold_stiffening(folds, opposite, held.tolist()) == 2.0
    is_inner = opposite[:, 1] >= 0
    places_m = grid.plane_m[folds[stiff & is_inner]][..., 0]
    assert len(places_m) == 2
    np.testing.assert_allclose(places_m, grid.plane_m[held, 0].max())


@pytest.mark.slow
@pytest.mark.parametrize("material", fabrics("StripBending"))
def test_a_fifth_of_the_bending_stiffness_changes_the_answer_of_mujoco(material):
    name = f"StripBending-{material}"
    band = load_band(name)
    nominal = run_episode(RunRequest(name))
    assert nominal.score.solves == "yes"
    bend = load_experiment(name).scene.deformables[0].bend_stiffness_n_m_per_rad
    for share in (0.8, 1.2):
        parameters = {"strip.bend_stiffness_n_m_per_rad": share * bend}
        other = run_episode(RunRequest(name, parameters=parameters))
        deviation = other.trajectory.markers_mm - band.mean
        assert band.length(deviation) > 2.0 * 0.02 * band.zero_motion_distance
