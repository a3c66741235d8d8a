"""Independent reference for soft bodies: linear elasticity of a clamped square bar by trilinear hexahedra."""

from __future__ import annotations

from itertools import product

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.sparse.linalg import cg


def element_stiffness(size_m, young_pa, poisson):
    """Stiffness of one box element with two Gauss points a direction, shape [24, 24]."""
    shear = young_pa / (2.0 * (1.0 + poisson))
    law = np.zeros((6, 6))
    law[:3, :3] = young_pa * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson))
    law[range(3), range(3)] += 2.0 * shear
    law[range(3, 6), range(3, 6)] = shear
    corners = np.array(list(product((-1.0, 1.0), repeat=3)))
    stiffness = np.zeros((24, 24))
    for point in product((-1.0, 1.0), repeat=3):
        factors = 1.0 + corners * np.array(point) / np.sqrt(3.0)
        strain = np.zeros((6, 24))
        for index, (corner, factor) in enumerate(zip(corners, factors, strict=True)):
            x, y, z = (
                corner * factor[[1, 0, 0]] * factor[[2, 2, 1]] / 8.0 * 2.0 / size_m
            )
            strain[:, 3 * index : 3 * index + 3] = [
                [x, 0, 0],
                [0, y, 0],
                [0, 0, z],
                [y, x, 0],
                [0, z, y],
                [z, 0, x],
            ]
        stiffness += strain.T @ law @ strain * np.prod(size_m) / 8.0
    return stiffness


def end_force(
    cells,
    *,
    edge_m,
    length_m,
    young_pa,
    poisson,
    axis,
):
    """Force per displacement [N/m] of one clamped end of a bar along z that is moved along an axis, the other held."""
    across, along = cells
    size = np.array([edge_m / across, edge_m / across, length_m / along])
    numbers = np.arange((across + 1) ** 2 * (along + 1)).reshape(
        across + 1, across + 1, along + 1
    )
    i, j, k = np.meshgrid(range(across), range(across), range(along), indexing="ij")
    nodes = np.stack(
        [numbers[i + a, j + b, k + c].ravel() for a, b, c in product((0, 1), repeat=3)],
        axis=1,
    )
    dofs = (3 * nodes[:, :, None] + np.arange(3)).reshape(len(nodes), 24)
    values = np.tile(element_stiffness(size, young_pa, poisson).ravel(), len(nodes))
    matrix = csr_matrix(
        (values, (np.repeat(dofs, 24, axis=1).ravel(), np.tile(dofs, (1, 24)).ravel()))
    )
    low, high = (
        3 * numbers[:, :, end].reshape(-1, 1) + np.arange(3) for end in (0, -1)
    )
    moved = np.zeros(matrix.shape[0])
    moved[high[:, axis]] = 1.0
    held = np.concatenate([low.ravel(), high.ravel()])
    free = np.setdiff1d(np.arange(len(moved)), held)
    inner = matrix[free][:, free]
    moved[free], failed = cg(
        inner, -(matrix[free] @ moved), rtol=1e-8, M=diags(1.0 / inner.diagonal())
    )
    assert not failed
    return float((matrix @ moved)[high[:, axis]].sum())


def extrapolated_end_force(**bar):
    """End force [N/m] of an infinitely fine mesh: the error falls with the square of the cell."""
    coarse, fine = (end_force(cells, **bar) for cells in ((6, 21), (10, 35)))  # type: ignore[arg-type]
    share = (6 / 10) ** 2
    return (fine - share * coarse) / (1.0 - share)
