"""Cells of deformable bodies, for every engine: points of a grid, and the setting of the size with its checks."""

from collections.abc import Mapping
from math import inf, prod
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from gauge_envs.errors import ParameterError
from gauge_envs.scene import Cloth, Deformable, Rod, Rope, Scene, SoftBody
from gauge_envs.scene.geometry import FloatArray

CellSize = Annotated[float, Field(ge=5e-4, le=1.0)] | None
"""Setting `cell_m`: edge of the cells of cloth and soft bodies, and length of the segments of ropes and rods [m]."""

FEWEST_ACROSS = 2
"""Smallest number of default cells across a cloth, so that a narrow strip can bend; an odd number would twist it."""

FEWEST_SEGMENTS: dict[type[Deformable], int] = {Rope: 2, Rod: 4}


def grid_points(*lines: NDArray[np.floating]) -> FloatArray:
    """Return the points of a grid with the given places along each axis, the last axis fastest.

    Returns:
        Shape [point_count, axis_count].
    """
    return np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, len(lines))


def check_cells(
    engine: str,
    scene: Scene,
    cell_m: float,
    *,
    node_limit: int,
    soft_nodes_per_edge: int = 1,
) -> None:
    """Raise an error if cells of a requested size do not fit the deformable bodies of a scene.

    Args:
        engine: Name of the engine, for messages.
        scene: The scene.
        cell_m: Requested size [m].
        node_limit: Largest number of nodes of one body.
        soft_nodes_per_edge: Nodes of a soft body along the edge of a cell, without the last node.
    """
    for body in scene.deformables:
        sides = _sides_m(body)
        largest_m = max(sides) / FEWEST_SEGMENTS.get(type(body), 1)
        if cell_m > largest_m * (1.0 + 1e-9):
            raise ParameterError(
                f"{engine} setting 'cell_m' is {1e3 * cell_m:.4g} mm, more than the {1e3 * largest_m:.4g} mm that "
                f"{body.name!r} allows: choose a smaller cell_m"
            )
        per_edge = soft_nodes_per_edge if isinstance(body, SoftBody) else 1
        count = prod(max(1, round(side / cell_m)) * per_edge + 1 for side in sides)
        if count > node_limit:
            raise ParameterError(
                f"{engine} setting 'cell_m' is {1e3 * cell_m:.4g} mm, which gives {body.name!r} about {count} nodes, "
                f"more than {node_limit}: choose a larger cell_m"
            )


def common_cell_m(
    scene: Scene, defaults: Mapping[type[Deformable], float]
) -> float | None:
    """Return the default size of cells [m], or None if the kinds of body in a scene differ in it.

    Args:
        scene: The scene.
        defaults: Default size for each kind of body that has one [m]; a narrow cloth has smaller cells.
    """
    sizes_m = {defaults.get(type(body)) for body in scene.deformables}
    cell_m = sizes_m.pop() if len(sizes_m) == 1 else None
    return cell_m and min(cell_m, narrow_cell_m(scene))


def narrow_cell_m(scene: Scene) -> float:
    """Return the largest default cell of the cloths of a scene [m]; infinite without cloth."""
    cloths = [body for body in scene.deformables if isinstance(body, Cloth)]
    widths_m = (min(cloth.size_m) for cloth in cloths)
    return min(widths_m, default=inf) / FEWEST_ACROSS


def _sides_m(body: Deformable) -> tuple[float, ...]:
    if isinstance(body, Cloth):
        return body.size_m
    return body.shape.size_m if isinstance(body, SoftBody) else (body.length_m,)
