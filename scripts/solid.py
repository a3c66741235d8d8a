"""Solve an elastic block between clamped ends at rest, by finite elements of an own.

Boxes with 27 nodes and 27 points of integration (Hughes, "The Finite Element Method", 2000, chapter 3), and Newton's
method. The ends neither narrow nor bulge. With F = R U, where R turns and U stretches, the energy per volume is that of
linear elasticity in the co-rotated strains U - 1, as soft bodies of the scenes have it.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator, RegularGridInterpolator
from scipy.sparse import coo_matrix, csc_matrix
from scipy.sparse.linalg import splu

from gauge_envs.scene import Box, Pose, Scene, SoftBody
from gauge_envs.scene.geometry import BoolArray, FloatArray

NODES = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=3)))
"""Nodes of the unit cell, z fastest, shape [27, 3]."""

GAUSS = np.sqrt(0.6) * np.array([-1.0, 0.0, 1.0])
GAUSS_WEIGHTS = np.array([5.0, 8.0, 5.0]) / 9.0

FACE_POINTS = 6
"""Points of contact on a side of a cell, along each of its axes."""

PUNCH_STIFFNESS = 200.0
"""Stiffness of the punch per area, over Young's modulus and the width of the block."""

SOLVED_PLACES = 10
"""Places of the driven body at which a block is solved; between them wrenches are interpolated."""

MOST_STEPS = 60

TOLERANCE = 1e-8
"""Largest force on a free node at rest, over Young's modulus times the section."""


def _line_shapes(at: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the three quadratic shape functions on [-1, 1] and their slopes, shape [N, 3]."""
    shapes = np.stack([0.5 * at * (at - 1.0), 1.0 - at * at, 0.5 * at * (at + 1.0)], -1)
    slopes = np.stack([at - 0.5, -2.0 * at, at + 0.5], -1)
    return shapes, slopes


def shapes_at(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the shape functions at points of the unit cell, shape [N, 27], and their slopes, shape [N, 27, 3]."""
    lines = [_line_shapes(points[:, axis]) for axis in range(3)]
    shapes = np.einsum("pi,pj,pk->pijk", *(line for line, _ in lines))
    slopes = []
    for axis in range(3):
        factors = [
            slope if other == axis else line
            for other, (line, slope) in enumerate(lines)
        ]
        slopes.append(np.einsum("pi,pj,pk->pijk", *factors))
    count = len(points)
    return shapes.reshape(count, 27), np.stack(slopes, -1).reshape(count, 27, 3)


@dataclass(frozen=True, kw_only=True)
class Punch:
    """A rigid face without friction that presses on the high side of the block along one axis.

    Attributes:
        axis: Axis of the block along which it presses, 0 or 1.
        along_m: Its extent along the long axis, low and high [m].
    """

    axis: int
    along_m: tuple[float, float]


class Block:
    """A box of an isotropic material.

    Args:
        edges_m: Places of the edges of cells along x, y and z [m].
        young_modulus_pa: Young's modulus.
        poisson_ratio: Poisson's ratio.
        weight_n_per_m3: Weight per volume, shape [3].
        punch: What presses on it; its place is an argument of `at_rest`.
    """

    def __init__(
        self,
        edges_m: Sequence[FloatArray],
        young_modulus_pa: float,
        poisson_ratio: float,
        *,
        weight_n_per_m3: Sequence[float] = (0.0, 0.0, 0.0),
        punch: Punch | None = None,
    ) -> None:
        self._shear_pa = 0.5 * young_modulus_pa / (1.0 + poisson_ratio)
        self._lame_pa = (
            2.0 * self._shear_pa * poisson_ratio / (1.0 - 2.0 * poisson_ratio)
        )
        lines = [_with_middles(edges) for edges in edges_m]
        grid = np.meshgrid(*lines, indexing="ij")
        self.places_m = np.stack(grid, axis=-1).reshape(-1, 3)
        numbers = np.arange(len(self.places_m)).reshape([len(line) for line in lines])
        counts = [len(edges) - 1 for edges in edges_m]
        low = np.array(list(np.ndindex(*counts)))
        within = (NODES + 1.0).astype(int)
        self._cells = numbers[tuple((2 * low[:, None] + within).transpose(2, 0, 1))]
        # Low and high ends along z.
        self.ends = (numbers[:, :, 0].ravel(), numbers[:, :, -1].ravel())
        sizes_m = np.stack(
            [np.diff(edges)[low[:, axis]] for axis, edges in enumerate(edges_m)],
            axis=-1,
        )
        self._force_scale_n = young_modulus_pa * float(
            np.ptp(lines[0]) * np.ptp(lines[1])
        )

        points = np.array(list(itertools.product(GAUSS, repeat=3)))
        weights = np.array(list(itertools.product(GAUSS_WEIGHTS, repeat=3))).prod(
            axis=1
        )
        shapes, slopes = shapes_at(points)
        # [cell, point, node, axis] and [cell, point].
        self._slopes = slopes * (2.0 / sizes_m)[:, None, None, :]
        self._volumes_m3 = weights * (sizes_m.prod(axis=1) / 8.0)[:, None]
        self._weights_n = np.zeros_like(self.places_m)
        shares = np.einsum("cp,pn->cn", self._volumes_m3, shapes)
        np.add.at(
            self._weights_n,
            self._cells,
            shares[:, :, None] * np.asarray(weight_n_per_m3),
        )
        freedoms = (3 * self._cells[:, :, None] + np.arange(3)).reshape(-1, 81)
        self._rows = np.repeat(freedoms, 81, axis=1).ravel()
        self._columns = np.tile(freedoms, (1, 81)).ravel()
        self._punch = punch
        if punch is not None:
            self._set_face(punch, sizes_m, young_modulus_pa)

    def _set_face(
        self, punch: Punch, sizes_m: FloatArray, young_modulus_pa: float
    ) -> None:
        """Lay points of contact on the high side of the block."""
        across_m = self.places_m[self._cells[:, 13], punch.axis]
        is_high = np.isclose(across_m, across_m.max())
        side = np.linspace(-1.0, 1.0, 2 * FACE_POINTS + 1)[1::2]
        places = [side, side, side]
        places[punch.axis] = np.ones(1)
        points = np.array(list(itertools.product(*places)))
        shapes, _ = shapes_at(points)
        others = [axis for axis in range(3) if axis != punch.axis]
        areas_m2 = sizes_m[is_high][:, others].prod(axis=1) / FACE_POINTS**2
        cells = self._cells[is_high]
        count = len(cells) * len(points)
        rows = np.repeat(np.arange(count), 27)
        columns = np.repeat(cells, len(points), axis=0).ravel()
        values = np.tile(shapes, (len(cells), 1)).ravel()
        self._face = csc_matrix(
            (values, (rows, columns)), shape=(count, len(self.places_m))
        )
        width_m = float(np.ptp(self.places_m[:, punch.axis]))
        stiffness = PUNCH_STIFFNESS * young_modulus_pa / width_m
        self._face_n_per_m = stiffness * np.repeat(areas_m2, len(points))
        self._is_under = np.zeros(count, dtype=bool)

    def energy_and_forces(
        self, places_m: FloatArray, punch_m: float
    ) -> tuple[float, FloatArray]:
        """Return the energy [J] and the forces on the nodes by stresses, weight and the punch [N], shape [N, 3]."""
        gradients = self._gradients(places_m)
        energies, stresses = self._stresses(gradients)
        energy = float((self._volumes_m3 * energies).sum())
        energy -= float((self._weights_n * places_m).sum())
        pulls = np.einsum(
            "cpij,cpnj,cp->cni", stresses, self._slopes, self._volumes_m3, optimize=True
        )
        forces = self._weights_n.copy()
        np.add.at(forces, self._cells, -pulls)
        if self._punch is not None:
            depths, _ = self._depths(places_m, punch_m)
            energy += float(0.5 * (self._face_n_per_m * depths**2).sum())
            forces[:, self._punch.axis] -= self._face.T @ (self._face_n_per_m * depths)
        return energy, forces

    def _depths(
        self, places_m: FloatArray, punch_m: float
    ) -> tuple[FloatArray, BoolArray]:
        """Return how deep the points of the face are in the punch [m], and which are in it."""
        assert self._punch is not None
        depths = (self._face @ places_m)[:, self._punch.axis] - punch_m
        is_in = (depths > 0.0) & self._is_under
        return np.where(is_in, depths, 0.0), is_in

    def _gradients(self, places_m: FloatArray) -> FloatArray:
        return np.einsum(
            "cni,cpnj->cpij", places_m[self._cells], self._slopes, optimize=True
        )

    def _stresses(self, gradients: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the energy per volume, and the change of it with the gradient of the places, shape [..., 3, 3]."""
        turns, stretches = _polar(gradients)
        strains = stretches - np.eye(3)
        traces = np.trace(strains, axis1=-2, axis2=-1)
        energies = self._shear_pa * np.square(strains).sum(axis=(-2, -1))
        energies += 0.5 * self._lame_pa * traces**2
        tension = 2.0 * self._shear_pa * strains
        tension += self._lame_pa * traces[..., None, None] * np.eye(3)
        return energies, turns @ tension

    def _stiffness(self, places_m: FloatArray, punch_m: float) -> csc_matrix:
        gradients = self._gradients(places_m)
        columns = [
            self._stress_changes(gradients, one) for one in np.eye(9).reshape(9, 3, 3)
        ]
        # [cell, point, i, j, k, l]: change of stress ij with gradient kl.
        changes = np.stack(columns, axis=-1).reshape(*gradients.shape, 3, 3)
        blocks = np.einsum(
            "cpijkl,cpnj,cpml,cp->cnimk",
            changes,
            self._slopes,
            self._slopes,
            self._volumes_m3,
            optimize=True,
        )
        size = self.places_m.size
        matrix = coo_matrix(
            (blocks.ravel(), (self._rows, self._columns)), shape=(size, size)
        ).tocsc()
        if self._punch is not None:
            _, is_in = self._depths(places_m, punch_m)
            face = self._face.multiply((self._face_n_per_m * is_in)[:, None])
            pressed = (face.T @ self._face).tocoo()
            axis = self._punch.axis
            matrix += coo_matrix(
                (pressed.data, (3 * pressed.row + axis, 3 * pressed.col + axis)),
                shape=(size, size),
            )
        return matrix

    def _stress_changes(self, gradients: FloatArray, change: FloatArray) -> FloatArray:
        """Return the change of the stress with a change of the gradient, shape [..., 3, 3]."""
        turns, stretches = _polar(gradients)
        strains = stretches - np.eye(3)
        # R' = R W, where W is skew: (tr(U) - U) w = axis of the skew part of R^T F'.
        local = np.swapaxes(turns, -1, -2) @ change
        skew = local - np.swapaxes(local, -1, -2)
        axes = np.stack([skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]], -1)
        total = np.trace(stretches, axis1=-2, axis2=-1)[..., None, None]
        spins = np.linalg.solve(total * np.eye(3) - stretches, axes[..., None])
        x, y, z = np.moveaxis(spins[..., 0], -1, 0)
        none = np.zeros_like(x)
        spin = np.stack([none, -z, y, z, none, -x, -y, x, none], -1)
        spin = spin.reshape(gradients.shape)
        strain = local - spin @ stretches
        tension = 2.0 * self._shear_pa * strains
        trace = np.trace(strains, axis1=-2, axis2=-1)[..., None, None]
        tension += self._lame_pa * trace * np.eye(3)
        change_trace = np.trace(strain, axis1=-2, axis2=-1)[..., None, None]
        changed = 2.0 * self._shear_pa * strain
        changed = changed + self._lame_pa * change_trace * np.eye(3)
        return turns @ (spin @ tension + changed)

    def at_rest(self, places_m: FloatArray, punch_m: float = np.inf) -> FloatArray:
        """Return the places at rest [m], shape [N, 3]; the ends stay where they are.

        The points under the punch are those of the places to start from, and then of those found.

        Args:
            places_m: Places to start from.
            punch_m: Place of the punch along its axis [m].

        Raises:
            ArithmeticError: No place of rest was found.
        """
        if self._punch is None:
            return self._at_rest(places_m, punch_m)
        low_m, high_m = self._punch.along_m
        for _ in range(2):
            along_m = (self._face @ places_m)[:, 2]
            self._is_under = (along_m >= low_m) & (along_m <= high_m)
            places_m = self._at_rest(places_m, punch_m)
        return places_m

    def _at_rest(self, places_m: FloatArray, punch_m: float) -> FloatArray:
        is_free = np.ones(places_m.shape, dtype=bool)
        is_free[np.concatenate(self.ends)] = False
        free = is_free.ravel()
        found = places_m.copy()
        energy, forces = self.energy_and_forces(found, punch_m)
        for _ in range(MOST_STEPS):
            if np.abs(forces.ravel()[free]).max() < TOLERANCE * self._force_scale_n:
                return found
            stiffness = self._stiffness(found, punch_m)[free][:, free]
            step = np.zeros(found.size)
            step[free] = splu(
                stiffness.tocsc(),
                permc_spec="MMD_AT_PLUS_A",
                options={"SymmetricMode": True},
            ).solve(forces.ravel()[free])
            moved, share = step.reshape(-1, 3), 1.0
            while True:
                new, pulls = self.energy_and_forces(found + share * moved, punch_m)
                if new <= energy or share < 1e-4:
                    break
                share *= 0.5
            found, energy, forces = found + share * moved, new, pulls
        raise ArithmeticError("no place of rest")

    def end_forces_n(self, places_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the forces of what holds the nodes of the low and of the high end, shape [end_node_count, 3]."""
        _, forces = self.energy_and_forces(places_m, np.inf)
        low, high = self.ends
        return -forces[low], -forces[high]


def _with_middles(edges_m: FloatArray) -> FloatArray:
    """Return edges of cells and their middles, in turn."""
    found = np.empty(2 * len(edges_m) - 1)
    found[::2] = edges_m
    found[1::2] = 0.5 * (edges_m[1:] + edges_m[:-1])
    return found


def _polar(gradients: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the rotation R and the stretch U of F = R U, shape [..., 3, 3] each."""
    left, sizes, right = np.linalg.svd(gradients)
    turns = left @ right
    stretches = np.swapaxes(right, -1, -2) @ (sizes[..., None] * right)
    return turns, stretches


@dataclass(frozen=True, kw_only=True)
class BlockAtRest:
    """A block at rest at some places of the body that drives it.

    Attributes:
        solid: The body of the scene.
        block: The block.
        gap_m: Travel of the driven body up to which nothing changes.
        travels_m: Travels of the driven body at the times that were asked for.
        solved_m: Travels at which the block is solved.
        poses: Poses of the driven body there.
        places_m: Places of the nodes there, in the frame of the body, shape [solved_count, node_count, 3].
    """

    solid: SoftBody
    block: Block
    gap_m: float
    travels_m: FloatArray
    solved_m: FloatArray
    poses: list[Pose]
    places_m: FloatArray

    def at_times(self, values: FloatArray) -> FloatArray:
        """Return values of the solved travels at the times that were asked for; axis 0 is that of the travels."""
        between = PchipInterpolator(self.solved_m, values)
        return between(np.maximum(self.travels_m, self.gap_m))


def is_pressed_block(scene: Scene) -> bool:
    """Return whether a scene is a block between two fixed ends, on which a driven body presses."""
    if len(scene.deformables) != 1 or len(scene.drivers) != 1:
        return False
    (solid,), (driver,) = scene.deformables, scene.drivers
    return isinstance(solid, SoftBody) and driver.body not in scene.holders


def block_at_rest(
    scene: Scene, times_s: FloatArray, *, cells: int, places: int = SOLVED_PLACES
) -> BlockAtRest | None:
    """Return the block of a scene at rest, up to the travel of the driven body at the last time.

    Args:
        scene: A scene; None is returned if it is not that of one block with two held ends and one driven body, which
            holds an end or presses on the block.
        times_s: Times, at which the block is taken to be at rest.
        cells: Number of cells across the block; three times as many lie along it.
        places: Number of places of the driven body at which the block is solved.
    """
    if len(scene.deformables) != 1 or len(scene.drivers) != 1:
        return None
    (solid,), (driver,) = scene.deformables, scene.drivers
    ends = {one.region.side: one for one in scene.attachments if one.region.axis == "z"}
    if not isinstance(solid, SoftBody) or set(ends) != {"low", "high"}:
        return None
    width_m, depth_m, height_m = solid.shape.size_m
    low_m = -0.5 * height_m + ends["low"].region.depth_m
    high_m = 0.5 * height_m - ends["high"].region.depth_m
    axes = solid.pose.to_world(np.eye(3)) - np.asarray(solid.pose.position_m)
    density = solid.mass_kg / (width_m * depth_m * height_m)
    down_n_per_m3 = -density * scene.gravity_m_per_s2 * axes[:, 2]
    mover = scene.body(driver.body)
    is_pressed = driver.body not in scene.holders
    edges_m = [
        np.linspace(-0.5 * size_m, 0.5 * size_m, cells + 1)
        for size_m in (width_m, depth_m)
    ]
    punch, gap_m = None, 0.0
    along_m = np.linspace(low_m, high_m, 3 * cells + 1)
    if is_pressed:
        assert isinstance(mover.shape, Box)
        half_m = 0.5 * mover.shape.size_m[2]
        middle_m = solid.pose.to_body(np.array([mover.pose.position_m]))[0]
        face_m = (middle_m[2] - half_m, middle_m[2] + half_m)
        punch = Punch(axis=int(np.argmax(axes[:, 2])), along_m=face_m)
        gap_m = middle_m[punch.axis] - half_m - 0.5 * solid.shape.size_m[punch.axis]
        # The edges of the face are edges of cells.
        along_m = np.concatenate(
            [
                np.linspace(low_m, face_m[0], cells + 1)[:-1],
                np.linspace(*face_m, cells + 1)[:-1],
                np.linspace(face_m[1], high_m, cells + 1),
            ]
        )
    block = Block(
        [*edges_m, along_m],
        solid.young_modulus_pa,
        solid.poisson_ratio,
        weight_n_per_m3=down_n_per_m3.tolist(),
        punch=punch,
    )
    start = mover.pose
    corners_m = start.to_world(0.05 * np.eye(3))

    def moved(points_m: FloatArray, time_s: float) -> FloatArray:
        """Return where points that move with the driven body at the start are at a time."""
        return driver.state(start, time_s)[0].to_world(start.to_body(points_m))

    travels_m = np.array(
        [
            np.sqrt(np.square(moved(corners_m, one) - corners_m).sum(axis=1).mean())
            for one in times_s
        ]
    )
    # Until it touches the block, a punch changes nothing.
    solved_m = np.linspace(gap_m, travels_m[-1], places)
    solved_s = np.interp(solved_m, travels_m, times_s)
    share = (block.places_m[:, 2] - low_m) / (high_m - low_m)
    if not is_pressed and ends["low"].to == driver.body:
        share = 1.0 - share
    world_m = solid.pose.to_world(block.places_m)
    last_s = 0.0
    poses, found = [], []
    for time_s in solved_s:
        pose, punch_m = driver.state(start, time_s)[0], np.inf
        if punch is None:
            there = driver.state(start, last_s)[0]
            ahead_m = pose.to_world(there.to_body(world_m))
            world_m = world_m + share[:, None] * (ahead_m - world_m)
        else:
            foot_m = np.array([pose.position_m]) - [0.0, 0.0, half_m]
            punch_m = float(solid.pose.to_body(foot_m)[0, punch.axis])
        places_m = block.at_rest(solid.pose.to_body(world_m), punch_m)
        world_m, last_s = solid.pose.to_world(places_m), time_s
        poses.append(pose)
        found.append(places_m)
    return BlockAtRest(
        solid=solid,
        block=block,
        gap_m=gap_m,
        travels_m=travels_m,
        solved_m=solved_m,
        poses=poses,
        places_m=np.array(found),
    )


def held_wrenches(
    scene: Scene, times_s: FloatArray, *, cells: int
) -> FloatArray | None:
    """Return the wrenches of the bodies that hold a block, about their origins, shape [time_count, holder_count, 6].

    The arguments are those of `block_at_rest`, and so is None.
    """
    rest = block_at_rest(scene, times_s, cells=cells)
    if rest is None:
        return None
    found = [
        _wrenches_now(scene, rest.block, places_m, pose)
        for places_m, pose in zip(rest.places_m, rest.poses, strict=True)
    ]
    return rest.at_times(np.array(found))


def block_points_m(
    scene: Scene,
    times_s: FloatArray,
    points_m: FloatArray,
    *,
    cells: int,
    places: int = SOLVED_PLACES,
) -> FloatArray | None:
    """Return where points of a block are [m], shape [time_count, point_count, 3].

    Args:
        scene: A scene as of `block_at_rest`, whose None is returned.
        times_s: Times.
        points_m: The points at the start, shape [point_count, 3].
        cells: Number of cells across the block.
        places: Number of places of the driven body at which the block is solved.
    """
    rest = block_at_rest(scene, times_s, cells=cells, places=places)
    if rest is None:
        return None
    starts_m = rest.block.places_m
    lines = [np.unique(starts_m[:, axis]) for axis in range(3)]
    shape = (*(len(line) for line in lines), 3)
    low_m, high_m = starts_m.min(axis=0), starts_m.max(axis=0)
    # What a grip holds stays where the end is.
    inside_m = np.clip(rest.solid.pose.to_body(points_m), low_m, high_m)
    found = []
    for places_m in rest.places_m:
        moved_m = (places_m - starts_m).reshape(shape)
        turned = rest.solid.pose.rotation.apply(
            RegularGridInterpolator(lines, moved_m)(inside_m)
        )
        found.append(points_m + turned)
    return rest.at_times(np.array(found))


def _wrenches_now(
    scene: Scene, block: Block, places_m: FloatArray, moved_to: Pose
) -> FloatArray:
    """Return the wrenches of the holders, shape [holder_count, 6].

    Args:
        scene: The scene.
        block: Its block.
        places_m: Places of the block at rest, in its frame.
        moved_to: Pose of the driven body.
    """
    (solid,), (driver,) = scene.deformables, scene.drivers
    assert isinstance(solid, SoftBody)
    axes = solid.pose.to_world(np.eye(3)) - np.asarray(solid.pose.position_m)
    world_m = solid.pose.to_world(places_m)
    forces_n = dict(zip(("low", "high"), block.end_forces_n(places_m), strict=True))
    nodes = dict(zip(("low", "high"), block.ends, strict=True))
    found = np.zeros((len(scene.holders), 6))
    for one in scene.attachments:
        side = one.region.side
        pose = moved_to if one.to == driver.body else scene.body(one.to).pose
        pulls_n = forces_n[side] @ axes
        arms_m = world_m[nodes[side]] - np.asarray(pose.position_m)
        row = found[scene.holders.index(one.to)]
        row[:3] = pulls_n.sum(axis=0)
        row[3:] = np.cross(arms_m, pulls_n).sum(axis=0)
        # The holder also carries what sits in it.
        inside_kg = solid.mass_kg * one.region.depth_m / solid.shape.size_m[2]
        row[2] += inside_kg * scene.gravity_m_per_s2
    return found
