"""Settings and presets of Genesis's position-based dynamics (PBD), its solver of cloth, and the cloth's springs."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from math import ceil
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from gauge_envs.backends.genesis.settings import SettingsGenesis
from gauge_envs.backends.shared.cells import CellSize
from gauge_envs.backends.shared.cloth_grid import ClothGrid
from gauge_envs.scene import Cloth, Cylinder, Scene, Sphere
from gauge_envs.scene.timing import DRIVE_INTERVAL_S

CLOTH_CELL_M = 0.025
"""Edge of the cells of a cloth [m]."""

CELL_PER_RADIUS = 1.4
"""Largest edge of the cells over the radius of a round body that touches the cloth: slightly below the root of 2."""

FINEST_CELL_M = 0.005
"""Smallest edge of the cells that the contacts of a cloth ask for [m]."""

SHORTEST_STEPS = 20
"""Least number of steps in 1/180 s."""

STIFFNESS_LIMIT = 0.5
"""Largest stiffness of a spring over the one that closes it in a single step."""


class SettingsPBD(SettingsGenesis):
    """Settings of Genesis's PBD solver.

    Attributes:
        solver: Genesis's name of the solver.
        mesh: `grid`, a regular mesh with springs along both diagonals of each cell, or `remeshed`, the mesh that
            Genesis makes of it, with a spring on each edge.
        cell_m: Desired edge of the cells; None gives 25 mm, less where narrow bodies touch the cloth.
        stiffness: `nominal`, the paper's mapping, compliances 1 / K_s and 1 / K_theta, or `effective`, compliances with
            which the sheet has K_s, K_sh and K_theta after one iteration.
        exact_hinges: Multiply the compliance of each hinge by the squared sine of its angle before each solve. Without
            it, the torque of Genesis's hinge falls with the cube of the angle, and cloth does not resist bending.
        particle_size_m: Diameter of particles: they touch bodies at half this distance and each other at this one. None
            gives the cloth's thickness.
        stretch_iterations: Iterations over the springs in a step.
        bending_iterations: Iterations over the hinges in a step.
        stretch_relaxation: Share of the correction of a spring.
        bending_relaxation: Share of the correction of a hinge.
        air_resistance: Drag of a particle over its squared speed [kg/m].
        body_friction: Apply Coulomb's friction between cloth and rigid bodies, which Genesis leaves out.
        self_contact: Collide the particles of cloth with each other: `scene`, where the scene's contacts have cloth
            with cloth, or `always`, as Genesis does.
    """

    solver: Literal["PBD"] = "PBD"
    mesh: Literal["grid", "remeshed"] = "grid"
    cell_m: CellSize = None
    stiffness: Literal["effective", "nominal"] = "effective"
    exact_hinges: bool = True
    particle_size_m: float | None = Field(default=None, gt=0.0)
    stretch_iterations: int = Field(default=1, ge=1)
    bending_iterations: int = Field(default=1, ge=1)
    stretch_relaxation: float = Field(default=1.0, gt=0.0)
    bending_relaxation: float = Field(default=1.0, gt=0.0)
    air_resistance: float = Field(default=0.0, ge=0.0)
    body_friction: bool = True
    self_contact: Literal["scene", "always"] = "scene"

    @model_validator(mode="after")
    def _stiffness_fits(self) -> SettingsPBD:
        if self.stiffness == "effective" and (self.stretch_iterations, self.stretch_relaxation) != (1, 1.0):
            raise ValueError("must be 'nominal' unless stretch_iterations and stretch_relaxation are 1")
        if self.stiffness == "effective" and self.mesh == "remeshed":
            raise ValueError("must be 'nominal' with mesh 'remeshed'")
        return self


def pbd_presets(scene: Scene) -> Mapping[str, SettingsPBD]:
    """Return the presets of a scene with cloth, by name."""
    cell_m = cloth_cell_m(scene)
    cloths = [body for body in scene.deformables if isinstance(body, Cloth)]
    longest = min(longest_timestep_s(cloth, cell_m=cell_m) for cloth in cloths)
    steps = max(SHORTEST_STEPS, ceil(DRIVE_INTERVAL_S / longest - 1e-9))
    # Genesis's defaults with the paper's mapping, at the paper's rate of textiles.
    out_of_box = SettingsPBD(
        preset="out_of_box",
        timestep_s=DRIVE_INTERVAL_S,
        precision=32,
        mesh="remeshed",
        cell_m=0.01,
        stiffness="nominal",
        exact_hinges=False,
        particle_size_m=0.01,
        stretch_iterations=4,
        stretch_relaxation=0.3,
        bending_relaxation=0.1,
        air_resistance=1e-3,
        body_friction=False,
        self_contact="always",
    )
    return {
        "default": SettingsPBD(preset="default", timestep_s=DRIVE_INTERVAL_S / steps),
        "out_of_box": out_of_box,
        # The paper states the mapping and 180 Hz, and that all other settings are defaults.
        "paper": out_of_box.model_copy(update={"preset": "paper"}),
    }


def cloth_cell_m(scene: Scene) -> float:
    """Return the default edge of the cells [m]: 25 mm, or less where narrow round bodies touch the cloth.

    Only particles collide. With cells of 1.4 times the radius of a body, a particle is within that radius of any place.
    """
    cloths = {body.name for body in scene.deformables}
    rigid = {body.name: body for body in scene.bodies}
    touching = {
        name
        for contact in scene.contacts
        if cloths & {*contact.first, *contact.second}
        for name in {*contact.first, *contact.second} & set(rigid)
    }
    shapes = [rigid[name].shape for name in touching]
    radii = [shape.radius_m for shape in shapes if isinstance(shape, Cylinder | Sphere)]
    return max(FINEST_CELL_M, min([CLOTH_CELL_M, *(CELL_PER_RADIUS * radius for radius in radii)]))


# --- springs ----------------------------------------------------------------------------------------------------------


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
