"""Solve CantileverBeam: a row of foam and rubber blocks that is let go, by finite elements of its own.

    python studies/solutions/beam.py [FOLDER]

The blocks are linear elastic in a co-rotated frame, with the energy density mu |S - I|^2 + lambda (tr S - 3)^2 / 2 and
the stretch S of the polar decomposition F = R S. Elements have 27 nodes, so rubber does not lock. One half of the row
is solved, as it is symmetric across its width. The generalized alpha method (Chung and Hulbert 1993, J. Appl. Mech. 60,
371) with a spectral radius of 0.8 damps waves within the rubber and not the swing.

The script prints the angle of the line of the two recorded markers for each mesh and step. The finest solution is the
reference. u is its change from the next mesh, as corners between foam and rubber converge by order 1, and from a longer
step.
"""

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu
from store import store_solution

from gauge_envs import load_experiment
from gauge_envs.files import data_folder
from gauge_envs.scene import Box, Scene
from gauge_envs.scene.timing import FRAME_RATE_HZ

FOAMS = ("soft", "hard")
MESHES = ((1, 1, 1), (1, 2, 2), (1, 3, 3))
"""Elements of one block across half of its width, along the row, and upwards."""

STEPS_PER_FRAME = 12
FRAME_COUNT = 31
SPECTRAL_RADIUS = 0.8
RECORDED = (13, 15)
"""Markers of the recorded line."""

Array = NDArray[np.float64]

LEVI_CIVITA = np.zeros((3, 3, 3))
for first, second, third in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    LEVI_CIVITA[first, second, third] = 1.0
    LEVI_CIVITA[first, third, second] = -1.0


@dataclass(frozen=True)
class Elements:
    """Finite elements of half of a row.

    Attributes:
        nodes_m: Places of the nodes, x from the middle plane, y along the row, z upwards, shape [N, 3].
        of_element: Nodes of each element, shape [E, 27].
        block: Block of each element, shape [E].
        slopes: Map from the 81 displacements of an element to the displacement gradient, shape [27, 9, 81].
        shapes: Values of the shape functions at the points of integration, shape [27, 27].
        weights_m3: Weights of these points, shape [27].
    """

    nodes_m: Array
    of_element: NDArray[np.int64]
    block: NDArray[np.int64]
    slopes: Array
    shapes: Array
    weights_m3: Array

    @property
    def places(self) -> NDArray[np.int64]:
        """Places of the displacements of each element in the vector of all, shape [E, 81]."""
        parts = 3 * self.of_element[:, :, None] + np.arange(3)
        return parts.reshape(len(self.of_element), 81)

    def matrix(self, of_elements: Array) -> csc_matrix:
        """Return the sum of matrices of elements, shape [E, 81, 81], as a sparse matrix."""
        places, count = self.places, self.nodes_m.size
        rows = np.repeat(places, 81, axis=1).ravel()
        columns = np.tile(places, (1, 81)).ravel()
        return csc_matrix((of_elements.ravel(), (rows, columns)), shape=(count, count))

    def vector(self, of_elements: Array) -> Array:
        """Return the sum of vectors of elements, shape [E, 81], as a vector, shape [3 N]."""
        return np.bincount(
            self.places.ravel(), of_elements.ravel(), minlength=self.nodes_m.size
        )


def quadratic(place: float) -> tuple[Array, Array]:
    """Return the three shape functions on a line from -1 to 1, and their slopes."""
    values = [0.5 * place * (place - 1.0), 1.0 - place**2, 0.5 * place * (place + 1.0)]
    return np.array(values), np.array([place - 0.5, -2.0 * place, place + 0.5])


def elements_of(block_m: float, counts: tuple[int, int, int]) -> Elements:
    """Return the elements of four cubes in a row, with some elements along each edge of half a cube."""
    across, along, upwards = counts
    grid = (2 * across + 1, 8 * along + 1, 2 * upwards + 1)
    number = np.arange(np.prod(grid)).reshape(grid)
    axes_m = (
        np.linspace(0.0, 0.5 * block_m, grid[0]),
        np.linspace(0.0, 4.0 * block_m, grid[1]),
        np.linspace(-0.5 * block_m, 0.5 * block_m, grid[2]),
    )
    nodes_m = np.stack(np.meshgrid(*axes_m, indexing="ij"), axis=-1).reshape(-1, 3)
    cells = list(product(range(across), range(4 * along), range(upwards)))
    of_element = [
        number[2 * i : 2 * i + 3, 2 * j : 2 * j + 3, 2 * k : 2 * k + 3].ravel()
        for i, j, k in cells
    ]
    sizes_m = block_m / np.array([2.0 * across, along, upwards])
    points, weights = np.polynomial.legendre.leggauss(3)
    shapes, slopes, weights_m3 = [], [], []
    for place in product(range(3), repeat=3):
        values, rates = zip(*(quadratic(points[axis]) for axis in place), strict=True)
        shapes.append(np.einsum("i,j,k->ijk", *values).ravel())
        gradient = np.zeros((9, 81))
        for axis in range(3):
            factors = [rates[n] if n == axis else values[n] for n in range(3)]
            slope = np.einsum("i,j,k->ijk", *factors).ravel() * 2.0 / sizes_m[axis]
            for part in range(3):
                gradient[3 * part + axis, part::3] = slope
        slopes.append(gradient)
        weights_m3.append(np.prod(weights[list(place)]) * np.prod(sizes_m) / 8.0)
    return Elements(
        nodes_m=nodes_m,
        of_element=np.array(of_element),
        block=np.array([j // along for _, j, _ in cells]),
        slopes=np.array(slopes),
        shapes=np.array(shapes),
        weights_m3=np.array(weights_m3),
    )


class Row:
    """The row of blocks: its masses, its elastic forces and their derivatives."""

    def __init__(self, scene: Scene, counts: tuple[int, int, int]) -> None:
        blocks = scene.deformables
        assert isinstance(blocks[0].shape, Box)
        self.block_m = blocks[0].shape.size_m[0]
        self.elements = elements = elements_of(self.block_m, counts)
        young_pa = np.array([block.young_modulus_pa for block in blocks])
        poisson = np.array([block.poisson_ratio for block in blocks])
        of_element = elements.block
        shear_pa = young_pa / (2.0 * (1.0 + poisson))
        lame_pa = 2.0 * shear_pa * poisson / (1.0 - 2.0 * poisson)
        self.shear_pa = shear_pa[of_element][:, None, None, None]
        self.lame_pa = lame_pa[of_element][:, None, None, None]
        densities = np.array([block.mass_kg for block in blocks]) / self.block_m**3
        of_one = np.einsum(
            "g,ga,gb->ab", elements.weights_m3, elements.shapes, elements.shapes
        )
        masses = densities[of_element][:, None, None] * np.kron(of_one, np.eye(3))
        self.masses_kg = elements.matrix(masses)
        gravity = np.tile([0.0, 0.0, -scene.gravity_m_per_s2], len(elements.nodes_m))
        self.weights_n = self.masses_kg @ gravity
        held = np.zeros((len(elements.nodes_m), 3), dtype=bool)
        held[elements.nodes_m[:, 1] == 0.0] = True
        held[elements.nodes_m[:, 0] == 0.0, 0] = True
        self.free = np.flatnonzero(~held.ravel())

    def forces(self, moved_m: Array) -> tuple[Array, csc_matrix]:
        """Return the elastic forces [N] of displacements, each of shape [3 N], and their derivatives [N/m]."""
        elements = self.elements
        slopes = elements.slopes
        count = len(elements.of_element)
        of_elements = moved_m[elements.places]
        gradient = np.einsum("gij,ej->egi", slopes, of_elements)
        gradient = gradient.reshape(count, 27, 3, 3) + np.eye(3)
        left, _, right = np.linalg.svd(gradient)
        rotation = left @ right
        stretch = np.swapaxes(rotation, -1, -2) @ gradient
        trace = np.trace(stretch, axis1=-2, axis2=-1)[..., None, None]
        volume_pa = self.lame_pa * (trace - 3.0)
        stress_pa = 2.0 * self.shear_pa * (gradient - rotation) + volume_pa * rotation
        weighted = elements.weights_m3[:, None, None] * slopes
        forces_n = np.einsum(
            "gij,egi->ej", weighted, stress_pa.reshape(count, 27, 9), optimize=True
        )
        # dR = R [w]x with (tr(S) I - S) w = a, where [a]x is twice the skew part of R^T dF.
        to_axis = -np.einsum("ijk,eglj->egilk", LEVI_CIVITA, rotation)
        from_axis = -np.einsum("egpr,rqs->egpqs", rotation, LEVI_CIVITA)
        turning = np.linalg.solve(
            trace * np.eye(3) - stretch, to_axis.reshape(count, 27, 3, 9)
        )
        turned = from_axis.reshape(count, 27, 9, 3) @ turning
        flat = rotation.reshape(count, 27, 9)
        modulus_pa = 2.0 * self.shear_pa * (np.eye(9) - turned) + volume_pa * turned
        modulus_pa += self.lame_pa * flat[..., :, None] * flat[..., None, :]
        stiffness = np.zeros((count, 81, 81))
        for point, weight in enumerate(weighted):
            stiffness += weight.T @ (modulus_pa[:, point] @ slopes[point])
        return elements.vector(forces_n), elements.matrix(stiffness)

    def swing_m(self, frame_count: int, steps_per_frame: int) -> Iterator[Array]:
        """Yield the places of the nodes [m] at each frame, shape [N, 3], from rest without load."""
        step_s = 1.0 / (FRAME_RATE_HZ * steps_per_frame)
        share_mass = (2.0 * SPECTRAL_RADIUS - 1.0) / (SPECTRAL_RADIUS + 1.0)
        share_force = SPECTRAL_RADIUS / (SPECTRAL_RADIUS + 1.0)
        gamma = 0.5 - share_mass + share_force
        beta = 0.25 * (1.0 - share_mass + share_force) ** 2
        free = self.free
        masses_kg = self.masses_kg[free][:, free]
        moved = np.zeros(self.elements.nodes_m.size)
        speed, rate = np.zeros_like(moved), np.zeros_like(moved)
        rate[free] = splu(masses_kg).solve(self.weights_n[free])
        before_n, _ = self.forces(moved)
        yield self.elements.nodes_m
        for count in range(1, (frame_count - 1) * steps_per_frame + 1):
            known = moved + step_s * speed + step_s**2 * (0.5 - beta) * rate
            found = known + step_s**2 * beta * rate
            change = np.array([np.inf])
            while np.abs(change).max() > 1e-9:
                new_rate = (found - known) / (beta * step_s**2)
                forces_n, stiffness = self.forces(found)
                mixed_rate = (1.0 - share_mass) * new_rate + share_mass * rate
                mixed_n = (1.0 - share_force) * forces_n + share_force * before_n
                left_n = self.masses_kg @ mixed_rate + mixed_n - self.weights_n
                system = (1.0 - share_mass) / (beta * step_s**2) * masses_kg
                system += (1.0 - share_force) * stiffness[free][:, free]
                change = -splu(system.tocsc()).solve(left_n[free])
                found[free] += change
            new_rate = (found - known) / (beta * step_s**2)
            before_n, _ = self.forces(found)
            speed += step_s * ((1.0 - gamma) * rate + gamma * new_rate)
            moved, rate = found, new_rate
            if count % steps_per_frame == 0:
                yield self.elements.nodes_m + moved.reshape(-1, 3)


def markers_mm(scene: Scene, counts: tuple[int, int, int], steps: int) -> Array:
    """Return the markers at the first frames [mm], shape [FRAME_COUNT, M, 3]."""
    row = Row(scene, counts)
    origin_m = np.array(scene.deformables[0].pose.position_m)
    origin_m[1] -= 0.5 * row.block_m
    places_m = np.array(scene.markers.positions_m) - origin_m
    side = np.where(places_m[:, 0] < 0.0, -1.0, 1.0)
    mirrored_m = places_m * np.column_stack([side, np.ones((len(side), 2))])
    apart_m = np.abs(row.elements.nodes_m - mirrored_m[:, None]).sum(axis=2)
    nodes = apart_m.argmin(axis=1)
    assert apart_m.min(axis=1).max() < 1e-9, "a marker is no node"
    frames_m = np.array([nodes_m[nodes] for nodes_m in row.swing_m(FRAME_COUNT, steps)])
    frames_m[:, :, 0] *= side
    return 1e3 * (frames_m + origin_m)


def solve(folder: Path, foam: str) -> None:
    """Print the convergence of one foam, and write its reference."""
    variant = f"CantileverBeam-{foam}"
    experiment = load_experiment(variant)
    runs = [(mesh, STEPS_PER_FRAME) for mesh in MESHES]
    runs.insert(0, (MESHES[0], STEPS_PER_FRAME // 2))
    found_mm = []
    for mesh, steps in runs:
        motion_mm = markers_mm(experiment.scene, mesh, steps)
        found_mm.append(motion_mm)
        line_mm = motion_mm[:, RECORDED[1]] - motion_mm[:, RECORDED[0]]
        angle_deg = np.degrees(np.arctan2(line_mm[:, 1], -line_mm[:, 2]))
        print(f"{foam} {mesh} {steps} steps: angle [deg]", *np.round(angle_deg, 2))
    coarse, fine, finest = found_mm[1:]
    of_step_mm = np.abs(found_mm[0] - coarse) / 3.0
    of_mesh_mm = np.maximum(np.abs(finest - fine), np.abs(fine - coarse) / 2.0)
    uncertainty_mm = np.hypot(of_step_mm, of_mesh_mm)
    count, width = experiment.frame_count, finest[0].size
    mean = np.full((count, width), np.nan)
    uncertainty = np.full((count, width), np.nan)
    mean[:FRAME_COUNT] = finest.reshape(FRAME_COUNT, -1)
    uncertainty[:FRAME_COUNT] = uncertainty_mm.reshape(FRAME_COUNT, -1)
    store_solution(
        folder / variant,
        kind="numerical",
        coordinates=experiment.coordinates,
        source=(
            "markers of the row as elements with 27 nodes solve it, linear elastic in a co-rotated frame, undamped, "
            "for one second; u is the change from coarser meshes and steps"
        ),
        mean=mean,
        uncertainty=uncertainty,
    )


if __name__ == "__main__":
    target = Path(sys.argv[1]) if sys.argv[1:] else data_folder("scoring") / "bands"
    for name in FOAMS:
        solve(target, name)
