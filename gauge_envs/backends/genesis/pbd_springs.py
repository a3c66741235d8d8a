"""Springs of a cloth on a regular grid: their ends, their stiffnesses, and the longest step that they allow."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.shared.cloth_grid import ClothGrid
from gauge_envs.scene import Cloth

STIFFNESS_LIMIT = 0.5
"""Largest stiffness of a spring over the one that closes it in a single step."""


def spring_stiffnesses(cloth: Cloth) -> tuple[float, float]:
    """Return the stiffnesses of springs along the grid and of those along diagonals on a square grid [N/m].

    With springs k along the grid and s along both diagonals of each cell, the sheet's shear stiffness is s, and its
    stretch stiffness with free transverse edges is k + k s / (k + s).
    """
    stretch, shear = cloth.stretch_stiffness_n_per_m, cloth.shear_stiffness_n_per_m
    free = stretch - 2.0 * shear
    return 0.5 * (free + float(np.sqrt(free**2 + 4.0 * stretch * shear))), shear


def grid_springs(grid: ClothGrid) -> NDArray[np.intp]:
    """Return the ends of springs along the grid's lines and along both diagonals of each cell, shape [count, 2]."""
    columns = len(np.unique(grid.plane_m[:, 0]))
    index = np.arange(len(grid.plane_m)).reshape(columns, -1)
    pairs = (
        (index[:-1], index[1:]),
        (index[:, :-1], index[:, 1:]),
        (index[:-1, :-1], index[1:, 1:]),
        (index[1:, :-1], index[:-1, 1:]),
    )
    return np.concatenate([np.stack([first.ravel(), second.ravel()], axis=-1) for first, second in pairs])


def grid_stiffnesses(cloth: Cloth, grid: ClothGrid, springs: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return the stiffness of each spring [N/m]; those on the border of the cloth belong to half a cell.

    Args:
        cloth: The cloth.
        grid: Its mesh.
        springs: Ends of the springs, shape [count, 2].
    """
    along, diagonal = spring_stiffnesses(cloth)
    step = np.abs(np.diff(grid.plane_m[springs], axis=1))[:, 0]
    stiffnesses = np.empty(len(springs))
    cell = grid.cell_m
    for axis in range(2):
        other = 1 - axis
        rows = step[:, other] < 1e-9 * cell[other]
        width = np.full(rows.sum(), cell[other])
        places = np.abs(grid.plane_m[springs[rows, 0], other])
        width[places > 0.5 * cloth.size_m[other] - 1e-6 * cell[other]] *= 0.5
        stiffnesses[rows] = along * width / cell[axis]
    crossing = (step > 1e-9 * min(cell)).all(axis=1)
    # On a square cell this is the diagonal's stiffness; on others it keeps the shear stiffness.
    stiffnesses[crossing] = diagonal * (cell[0] ** 2 + cell[1] ** 2) / (2.0 * cell[0] * cell[1])
    return stiffnesses


def inverse_masses(masses_kg: NDArray[np.float64], held: Collection[int]) -> NDArray[np.float64]:
    """Return the inverse masses of particles [1/kg], 0 for held ones.

    Args:
        masses_kg: Masses, shape [particle_count].
        held: Indices of the held particles.
    """
    inverse = 1.0 / masses_kg
    inverse[list(held)] = 0.0
    return inverse


def longest_timestep_s(cloth: Cloth, *, cell_m: float) -> float:
    """Return the longest time step [s] of stiffness `effective`, for a cloth whose corners are free.

    A spring k between masses m1 and m2 closes in one step h if k (1 / m1 + 1 / m2) h^2 = 1. Corners have a quarter of
    the mass of other particles and set the step. Held corners would allow a longer one for this spring alone. But the
    fastest vibration of the sheet, at w, then grows where (w h)^2 passes 4 / 3; with this step it is at most 1.01 in
    the six fabrics.

    Args:
        cloth: The cloth.
        cell_m: Desired edge of the cells [m].
    """
    grid = ClothGrid(cloth, cell_m)
    springs = grid_springs(grid)
    inverse = inverse_masses(cloth.areal_density_kg_per_m2 * grid.vertex_areas_m2(), ())
    rates = grid_stiffnesses(cloth, grid, springs) * inverse[springs].sum(axis=1)
    return float(np.sqrt(STIFFNESS_LIMIT / rates.max()))
