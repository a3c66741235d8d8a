"""Solve a clamped elastic bar under a small strain along it, by linear finite elements of an own.

Trilinear boxes with eight points of integration (Hughes, "The Finite Element Method", 2000, chapter 3). The ends are
clamped: they neither narrow nor bulge, so that a bar with a Poisson ratio is stiffer than E A / L.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import spsolve

FloatArray = NDArray[np.float64]

CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
"""Corners of the unit cell, z fastest."""


def cell_stiffness(size_m: FloatArray, poisson_ratio: float) -> FloatArray:
    """Return the stiffness of a cell of unit Young modulus, shape [24, 24]; freedoms are x, y, z of each corner."""
    lame = poisson_ratio / ((1.0 + poisson_ratio) * (1.0 - 2.0 * poisson_ratio))
    shear = 0.5 / (1.0 + poisson_ratio)
    law = np.zeros((6, 6))
    law[:3, :3] = lame
    law[np.arange(6), np.arange(6)] += [2.0 * shear] * 3 + [shear] * 3
    total = np.zeros((24, 24))
    for point in CORNERS / np.sqrt(3.0):
        factors = 1.0 + CORNERS * point
        slopes = np.empty((8, 3))
        for axis in range(3):
            others = [other for other in range(3) if other != axis]
            slopes[:, axis] = (
                0.125
                * CORNERS[:, axis]
                * factors[:, others].prod(axis=1)
                * 2.0
                / size_m[axis]
            )
        strains = np.zeros((6, 8, 3))
        for axis in range(3):
            strains[axis, :, axis] = slopes[:, axis]
        for row, (first, second) in enumerate(((0, 1), (1, 2), (0, 2)), 3):
            strains[row, :, first] = slopes[:, second]
            strains[row, :, second] = slopes[:, first]
        flat = strains.reshape(6, 24)
        total += flat.T @ law @ flat * np.prod(size_m) / 8.0
    return total


def axial_factor(
    width_m: float, length_m: float, poisson_ratio: float, *, cells_across: int
) -> float:
    """Return the stiffness of a bar of square section between clamps, over E A / L.

    Args:
        width_m: Side of the section [m].
        length_m: Length between the clamps [m].
        poisson_ratio: Poisson's ratio.
        cells_across: Number of cells across the section; cells are nearly cubes.
    """
    along = round(cells_across * length_m / width_m)
    counts = np.array([cells_across, cells_across, along])
    size_m = np.array([width_m, width_m, length_m]) / counts
    shape = counts + 1
    nodes = np.arange(np.prod(shape)).reshape(shape)
    low = np.array(list(np.ndindex(*counts)))
    corners = ((CORNERS + 1.0) / 2.0).astype(int)
    cells = nodes[tuple((low[:, None] + corners).transpose(2, 0, 1))]
    freedoms = (3 * cells[:, :, None] + np.arange(3)).reshape(len(cells), 24)
    values = np.tile(cell_stiffness(size_m, poisson_ratio).ravel(), len(cells))
    rows = np.repeat(freedoms, 24, axis=1).ravel()
    columns = np.tile(freedoms, (1, 24)).ravel()
    matrix = coo_matrix((values, (rows, columns))).tocsr()

    moved = np.zeros(3 * nodes.size)
    top = nodes[:, :, -1].ravel()
    moved[3 * top + 2] = 1.0
    clamped = np.zeros(3 * nodes.size, dtype=bool)
    ends = np.concatenate([nodes[:, :, 0].ravel(), top])
    clamped[(3 * ends[:, None] + np.arange(3)).ravel()] = True
    free = ~clamped
    moved[free] = spsolve(matrix[free][:, free].tocsc(), -(matrix @ moved)[free])
    force = float((matrix @ moved)[3 * top + 2].sum())
    return force * length_m / width_m**2
