"""Solve FoamBending's block with cells that grow from the edge of the cube, and extrapolate it.

A quarter of the block of `scripts/solid.py`: both middle planes are mirrors. The cube is rigid and has no friction. As
it sinks in, up to 1.6 mm of the surface slide inward under its edge, where the pressure is largest. So the cells are
smallest there, and contact follows the surface: its force is normal to a cube with rounded edges. The radius of the
edges and the softness of the contact are refined to zero, like cells and places of the cube.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator, RegularGridInterpolator
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.linalg import splu

from gauge_envs.scene import Box, Scene, SoftBody
from gauge_envs.scene.geometry import FloatArray
from scripts import solid
from scripts.solid import Block, Punch

CELLS = 6
"""Cells about the edge of the cube along the block, and across it; a third of them lie over its half width."""

FINE_M = (0.024, 0.0275)
"""Place of the smallest cells along the block, from its middle [m]; they hold the edge of the cube at all pushes."""

GROWTH = 1.65
"""Size of a cell along the block over that of the one nearer to the edge."""

THINNING = 0.7
"""Size of a cell across the block over that of the one below it."""

EDGE_RADIUS_M = 0.5e-3
"""Radius of the edges of the cube [m]."""

CONTACT_STIFFNESS = 1000.0
"""Stiffness of the contact per area, over Young's modulus and the width of the block."""

PLACES = 10
"""Places of the cube at which the block is solved."""

STEEPEST = 0.2
"""Depth over the radius up to which the curvature of the edge is part of the stiffness of Newton's method."""

MOST_STEPS = 30

ROUND_OFF = 1e-12
"""Share of the energy by which a step of Newton's method may raise it."""

RAMPS = 8
"""Smaller steps of the cube to its first place, and where Newton's method fails."""


class QuarterBlock(Block):
    """A quarter of a block between clamped ends, under a rigid cube with rounded edges.

    Args:
        edges_m: Edges of cells along x and z from the middle planes, and along y [m].
        young_modulus_pa: Young's modulus.
        poisson_ratio: Poisson's ratio.
        weight_n_per_m3: Weight per volume, along y.
        half_width_m: Half the width of the cube [m].
        edge_radius_m: Radius of its edges [m].
        stiffness: Stiffness of the contact per area, over Young's modulus and the width of the block.
    """

    def __init__(
        self,
        edges_m: list[FloatArray],
        young_modulus_pa: float,
        poisson_ratio: float,
        *,
        weight_n_per_m3: float,
        half_width_m: float,
        edge_radius_m: float,
        stiffness: float,
    ) -> None:
        super().__init__(
            edges_m,
            young_modulus_pa,
            poisson_ratio,
            weight_n_per_m3=(0.0, -weight_n_per_m3, 0.0),
            punch=Punch(axis=1, along_m=(0.0, half_width_m)),
        )
        self._punch = None
        self._face_n_per_m *= stiffness / solid.PUNCH_STIFFNESS
        self._half_m = half_width_m
        self._radius_m = edge_radius_m
        places_m = self.places_m
        free = np.ones(places_m.shape, dtype=bool)
        free[self.ends[1]] = False
        free[np.isclose(places_m[:, 0], 0.0), 0] = False
        free[self.ends[0], 2] = False
        self._free = np.flatnonzero(free.ravel())

    def _contact(
        self, places_m: FloatArray, cube_m: float
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return depths of points of the face in the cube [m], their gradients along y and z, and curvatures [1/m]."""
        places = self._face @ places_m
        radius_m = self._radius_m
        outward = np.maximum(places[:, 2] - (self._half_m - radius_m), 0.0)
        is_round = outward > 0.0
        below = cube_m + radius_m - places[:, 1]
        below = np.where(is_round, np.maximum(below, 0.0), below)
        length = np.where(is_round, np.hypot(outward, below), 1.0)
        depths = radius_m - np.where(is_round, length, below)
        gradients = np.stack(
            [np.where(is_round, below / length, 1.0), -outward / length], axis=-1
        )
        curvatures = np.where(is_round, -1.0 / length, 0.0)
        return np.maximum(depths, 0.0), gradients, curvatures

    def energy_and_forces(
        self, places_m: FloatArray, punch_m: float
    ) -> tuple[float, FloatArray]:
        """Return the energy [J] and the forces on the nodes [N], shape [N, 3]; `punch_m` is the face of the cube."""
        energy, forces = super().energy_and_forces(places_m, np.inf)
        depths, gradients, _ = self._contact(places_m, punch_m)
        pushes_n = self._face_n_per_m * depths
        energy += float(0.5 * (pushes_n * depths).sum())
        forces[:, 1:] -= self._face.T @ (pushes_n[:, None] * gradients)
        return energy, forces

    def push_n(self, places_m: FloatArray, punch_m: float) -> float:
        """Return the force of the cube on the whole block [N]."""
        depths, gradients, _ = self._contact(places_m, punch_m)
        return 4.0 * float((self._face_n_per_m * depths * gradients[:, 0]).sum())

    def _stiffness(self, places_m: FloatArray, punch_m: float) -> csr_matrix:
        gradients = self._gradients(places_m)
        left, sizes, right = np.linalg.svd(gradients)
        shape = gradients.shape[:2]
        turns = (left @ right).reshape(*shape, 9)
        # Stress 2 mu (F - R) + lame (tr U - 3) R; R changes by three turns, each over the sum of two stretches.
        law = np.zeros((*shape, 9, 9))
        law[..., range(9), range(9)] = 2.0 * self._shear_pa
        law += self._lame_pa * turns[..., :, None] * turns[..., None, :]
        tension = self._lame_pa * (sizes.sum(axis=-1) - 3.0) - 2.0 * self._shear_pa
        for i, j in ((0, 1), (1, 2), (0, 2)):
            turn = left[..., :, i, None] * right[..., None, j, :]
            turn = turn - left[..., :, j, None] * right[..., None, i, :]
            turn = turn.reshape(*shape, 9)
            share = tension / (sizes[..., i] + sizes[..., j])
            law += share[..., None, None] * turn[..., :, None] * turn[..., None, :]
        law *= self._volumes_m3[..., None, None]
        cells, points = shape
        nodes = self._slopes.shape[2]
        inner = law.reshape(cells, points, 27, 3) @ self._slopes.swapaxes(-1, -2)
        inner = inner.reshape(cells, points, 3, 3, 3, nodes)
        inner = inner.transpose(0, 1, 3, 2, 4, 5).reshape(cells, 3 * points, 9 * nodes)
        outer = self._slopes.transpose(0, 2, 1, 3).reshape(cells, nodes, 3 * points)
        blocks = (outer @ inner).reshape(cells, nodes, 3, 3, nodes)
        size = self.places_m.size
        matrix = coo_matrix(
            (
                blocks.transpose(0, 1, 2, 4, 3).ravel(),
                (self._rows, self._columns),
            ),
            shape=(size, size),
        ).tocsr()
        depths, gradients, curvatures = self._contact(places_m, punch_m)
        touching = np.flatnonzero(depths > 0.0)
        face = self._face.tocsr()[touching]
        curvatures = np.where(
            depths < STEEPEST * self._radius_m, depths * curvatures, 0.0
        )
        for row in range(2):
            for column in range(2):
                product = gradients[:, row] * gradients[:, column]
                weights = product + curvatures * (float(row == column) - product)
                weights = (self._face_n_per_m * weights)[touching]
                pressed = (face.T @ face.multiply(weights[:, None])).tocoo()
                places = (3 * pressed.row + 1 + row, 3 * pressed.col + 1 + column)
                matrix += coo_matrix((pressed.data, places), shape=(size, size))
        return matrix

    def at_rest(self, places_m: FloatArray, punch_m: float = np.inf) -> FloatArray:
        """Return the places at rest [m], shape [N, 3].

        Raises:
            ArithmeticError: No place of rest was found.
        """
        found = places_m.copy()
        energy, forces = self.energy_and_forces(found, punch_m)
        for _ in range(MOST_STEPS):
            left_n = forces.ravel()[self._free]
            if np.abs(left_n).max() < solid.TOLERANCE * self._force_scale_n:
                return found
            stiffness = self._stiffness(found, punch_m).tocsr()
            step = np.zeros(found.size)
            step[self._free] = _solved(stiffness[self._free][:, self._free], left_n)
            moved, share = step.reshape(-1, 3), 1.0
            while True:
                new, pulls = self.energy_and_forces(found + share * moved, punch_m)
                if new <= energy + ROUND_OFF * abs(energy) or share < 1e-4:
                    break
                share *= 0.5
            found, energy, forces = found + share * moved, new, pulls
        raise ArithmeticError("no place of rest")


def _solved(matrix: csr_matrix, values: FloatArray) -> FloatArray:
    """Return the solution of a symmetric system, by PARDISO where it is installed: it is ten times as fast."""
    try:
        from pypardiso import PyPardisoSolver
    except ImportError:
        factors = splu(
            matrix.tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            options={"SymmetricMode": True},
        )
        return factors.solve(values)
    solver = PyPardisoSolver(mtype=11)
    matrix.sort_indices()
    try:
        return solver.solve(matrix, values)
    finally:
        solver.free_memory(everything=True)


def _grown(low: float, high: float, first: float, growth: float) -> FloatArray:
    """Return edges from `low` to `high`, whose cells are about `first` long and grow."""
    edges = [0.0]
    size = first
    while edges[-1] < abs(high - low):
        size *= growth
        edges.append(edges[-1] + size)
    return low + (high - low) * np.array(edges) / edges[-1]


@dataclass(frozen=True, kw_only=True)
class PressedBlock:
    """A pressed block at rest at some places of the cube.

    Attributes:
        solid: The body of the scene.
        block: A quarter of it.
        faces_m: Places of the face of the cube, in the frame of the body; the block is solved there.
        places_m: Places of the nodes there, shape [place_count, node_count, 3].
        pushes_n: Forces of the cube there.
        half_width_m: Half the width of the block [m].
    """

    solid: SoftBody
    block: QuarterBlock
    faces_m: FloatArray
    places_m: FloatArray
    pushes_n: FloatArray
    half_width_m: float

    def at(self, faces_m: FloatArray, values: FloatArray) -> FloatArray:
        """Return values at other places of the cube; axis 0 is that of the places."""
        between = PchipInterpolator(-self.faces_m, values)
        return between(np.maximum(-faces_m, -self.half_width_m))

    def points_m(self, faces_m: FloatArray, points_m: FloatArray) -> FloatArray:
        """Return where points of the block are [m], shape [len(faces_m), point_count, 3].

        Args:
            faces_m: Places of the face of the cube.
            points_m: The points at the start, in the world, shape [point_count, 3].
        """
        starts_m = self.block.places_m
        lines = [np.unique(starts_m[:, axis]) for axis in range(3)]
        shape = (*(len(line) for line in lines), 3)
        local_m = self.solid.pose.to_body(points_m)
        mirrored = np.where(local_m < 0.0, -1.0, 1.0)
        mirrored[:, 1] = 1.0
        inside_m = np.clip(
            local_m * mirrored, starts_m.min(axis=0), starts_m.max(axis=0)
        )
        found = []
        for places_m in self.places_m:
            moved_m = (places_m - starts_m).reshape(shape)
            change_m = mirrored * RegularGridInterpolator(lines, moved_m)(inside_m)
            found.append(points_m + self.solid.pose.rotation.apply(change_m))
        return self.at(faces_m, np.array(found))


def faces_of(scene: Scene, times_s: FloatArray) -> FloatArray:
    """Return the places of the face of the cube at some times, in the frame of the block [m]."""
    (body,), (driver,) = scene.deformables, scene.drivers
    cube = scene.body(driver.body)
    assert isinstance(cube.shape, Box)
    heights_m = [driver.state(cube.pose, time_s)[0].position_m[2] for time_s in times_s]
    half_m = 0.5 * cube.shape.size_m[2]
    return np.array(heights_m) - half_m - body.pose.position_m[2]


def pressed_block(
    scene: Scene,
    last_s: float,
    *,
    cells: float = 1.0,
    edge: float = 1.0,
    layer: float = 1.0,
    places: int = PLACES,
) -> PressedBlock:
    """Return the block of FoamBending at rest, up to the place of the cube at a time.

    Args:
        scene: The scene.
        last_s: The time [s].
        cells: Factor on the size of the cells.
        edge: Factor on the radius of the edges of the cube.
        layer: Factor on the softness of the contact.
        places: Number of places of the cube at which the block is solved.
    """
    (body,), (driver,) = scene.deformables, scene.drivers
    cube = scene.body(driver.body)
    assert isinstance(body, SoftBody)
    assert isinstance(cube.shape, Box)
    width_m, depth_m, length_m = body.shape.size_m
    depths_m = {one.region.depth_m for one in scene.attachments}
    (held_m,) = depths_m
    end_m = 0.5 * length_m - held_m
    count = round(CELLS / cells)
    growth, thinning = GROWTH**cells, THINNING**cells
    fine = np.linspace(*FINE_M, count + 1)
    size = fine[1] - fine[0]
    across = thinning ** np.arange(count)
    across = np.concatenate([[0.0], np.cumsum(across)]) / across.sum()
    edges_m = [
        np.linspace(0.0, 0.5 * width_m, max(round(CELLS / cells / 3.0), 1) + 1),
        depth_m * (across - 0.5),
        np.concatenate(
            [
                _grown(FINE_M[0], 0.0, size, growth)[:0:-1],
                fine,
                _grown(FINE_M[1], end_m, size, growth)[1:],
            ]
        ),
    ]
    density = body.mass_kg / (width_m * depth_m * length_m)
    block = QuarterBlock(
        edges_m,
        body.young_modulus_pa,
        body.poisson_ratio,
        weight_n_per_m3=density * scene.gravity_m_per_s2,
        half_width_m=0.5 * cube.shape.size_m[0],
        edge_radius_m=edge * EDGE_RADIUS_M,
        stiffness=CONTACT_STIFFNESS / layer,
    )
    (last_m,) = faces_of(scene, np.array([last_s]))
    faces_m = np.linspace(0.5 * depth_m, last_m, places)
    found: list[FloatArray] = []
    for number, face_m in enumerate(faces_m):
        before = found[-1] if found else block.places_m
        guess = 2.0 * found[-1] - found[-2] if number > 1 else before
        places_m = None
        if number != 1:
            with suppress(ArithmeticError):
                places_m = block.at_rest(guess, face_m)
        if places_m is None:
            # A first push of more than the radius would leave the surface beside the cube.
            places_m = before
            for ramp_m in np.linspace(faces_m[number - 1], face_m, RAMPS + 1)[1:]:
                places_m = block.at_rest(places_m, ramp_m)
        found.append(places_m)
    pushes_n = [
        block.push_n(places_m, face_m)
        for places_m, face_m in zip(found, faces_m, strict=True)
    ]
    return PressedBlock(
        solid=body,
        block=block,
        faces_m=faces_m,
        places_m=np.array(found),
        pushes_n=np.array(pushes_n),
        half_width_m=0.5 * depth_m,
    )


LEVELS: Mapping[str, tuple[tuple[float, dict[str, Any]], ...]] = {
    "base": ((1.0, {}),),
    "cell": ((2.0, {"cells": 2.0}),),
    "edge": ((2.0, {"edge": 2.0}), (0.5, {"edge": 0.5})),
    "layer": ((4.0, {"layer": 4.0}), (2.0, {"layer": 2.0})),
    "step": ((0.5, {"places": 2 * PLACES}),),
}
"""Factors of each parameter beside that of the default settings, and the arguments of `pressed_block` for it."""
