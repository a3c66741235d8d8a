"""Solve a cloth at rest that is clamped along its rim and pushed out of its plane by the flat tip of a rod.

A membrane of the St. Venant-Kirchhoff law, whose energy per area is K_s (Exx^2 + Eyy^2) / 2 + 2 K_sh Exy^2 with
Green's strain E in the axes of warp and weft, by bilinear finite elements of an own on rings about the tip, and
Newton's method (Bathe, "Finite Element Procedures", 2014, section 6.3). The tip is a disc: the material on it keeps
its plane. What it leaves open has two bounds each, and the truth lies between:

- Friction: the material on the tip slides without friction, or it sticks where it was touched.
- The edge of the tip: it is as wide as the tip, or wider by half the thickness of the cloth, over which its middle
  bends around the edge, and by half the layer sqrt(D / tension) in which a bent sheet leaves an edge.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.sparse import coo_matrix, identity
from scipy.sparse.linalg import spsolve

from gauge_envs.scene import Cloth, Cylinder, Scene
from gauge_envs.scene.drivers import Driver
from gauge_envs.scene.fabrics import plate_bending_stiffness
from gauge_envs.scene.geometry import BoolArray, FloatArray, IntArray
from gauge_envs.scene.scene import GRAVITY_M_PER_S2

CORNERS = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
"""Corners of the unit cell, in turn."""

CENTRE_SHARE = 0.05
"""Radius of the hole in the middle of the disc over that of the disc; nothing there is strained unevenly."""

DAMPING = 1e-2
"""First damping of Newton's method, over the largest stiffness of the cloth; it falls as steps succeed."""

MOST_STEPS = 200

TOLERANCE = 3e-9
"""Largest force on a free node at rest, over the largest stiffness of the cloth [m]."""

RINGS = (8, 14)
"""Numbers of cells from the tip to the rim of two meshes."""

PUSHES = 6
"""Number of pushes that are solved, between which forces are interpolated."""

POINT_PUSHES = 6
"""Number of pushes at which places of points are solved; between them, and from no push on, they are interpolated."""

NORMAL = 1e-9
"""Largest component of a unit vector that counts as none."""


@dataclass(frozen=True, kw_only=True)
class ProbedSheet:
    """A rectangular cloth whose rim is clamped.

    Attributes:
        size_m: Sides [m], along warp and weft.
        stretch_n_per_m: K_s.
        shear_n_per_m: K_sh.
        weight_n_per_m2: Weight per area.
        weight_direction: Direction of the weight in the axes of warp, weft and push; a unit vector.
        tip_m: Place of the tip, from the middle of the cloth along warp and weft [m].
        tip_radius_m: Radius of the tip [m].
    """

    size_m: tuple[float, float]
    stretch_n_per_m: float
    shear_n_per_m: float
    weight_n_per_m2: float
    weight_direction: tuple[float, float, float]
    tip_m: tuple[float, float]
    tip_radius_m: float


@dataclass(frozen=True)
class _Mesh:
    places_m: FloatArray  # At rest, shape [node_count, 2].
    cells: IntArray  # Nodes of each cell in turn, shape [cell_count, 4].
    on_tip: IntArray
    on_rim: IntArray


def _mesh(sheet: ProbedSheet, rings: int) -> _Mesh:
    """Return rings of cells, `rings` of them from the tip to the rim of the cloth."""
    half = 0.5 * np.asarray(sheet.size_m)
    tip = np.asarray(sheet.tip_m)
    # Corners of the cloth are nodes: the same number of spokes to each side.
    side = np.linspace(-1.0, 1.0, rings, endpoint=False)
    one = np.ones_like(side)
    rim = half * np.concatenate(
        [
            np.column_stack(pair)
            for pair in ((side, -one), (one, side), (-side, one), (-one, -side))
        ]
    )
    spokes = rim - tip
    lengths_m = np.linalg.norm(spokes, axis=1)
    directions = spokes / lengths_m[:, None]
    inner = max(2, rings // 4)
    on_disc = sheet.tip_radius_m * np.linspace(CENTRE_SHARE, 1.0, inner + 1)
    shares = np.linspace(0.0, 1.0, rings + 1)[1:, None]
    outer = sheet.tip_radius_m * (lengths_m / sheet.tip_radius_m) ** shares
    radii_m = np.vstack([np.repeat(on_disc[:, None], len(rim), axis=1), outer])
    places = tip + radii_m[:, :, None] * directions
    nodes = np.arange(radii_m.size).reshape(radii_m.shape)
    following = np.roll(nodes, -1, axis=1)
    cells = np.stack(
        [nodes[:-1], nodes[1:], following[1:], following[:-1]], axis=-1
    ).reshape(-1, 4)
    return _Mesh(
        places_m=places.reshape(-1, 2),
        cells=cells,
        on_tip=nodes[: inner + 1].ravel(),
        on_rim=nodes[-1],
    )


@dataclass(frozen=True, kw_only=True)
class _AtRest:
    """A cloth at rest at some pushes of the tip.

    Attributes:
        mesh: Its mesh.
        places_m: Places of the nodes along warp, weft and push, shape [push_count, node_count, 3].
        forces_n: Forces of the rim on the cloth, shape [push_count, 3].
    """

    mesh: _Mesh
    places_m: FloatArray
    forces_n: FloatArray


def _at_rest(
    sheet: ProbedSheet, pushes_m: FloatArray, *, rings: int, sticks: bool, folds: bool
) -> _AtRest:
    """Return a cloth at rest; the arguments are those of `held_forces_n`."""
    mesh = _mesh(sheet, rings)
    count = len(mesh.places_m)
    elements = _Elements(sheet, mesh, folds=folds)
    fixed = np.zeros((count, 3), dtype=bool)
    fixed[mesh.on_rim] = True
    fixed[mesh.on_tip, 2] = True
    flat = np.column_stack([mesh.places_m, np.zeros(count)])
    if sticks:
        # The tip touches the cloth as its weight moved it in its plane.
        flat = _hung(sheet, mesh, folds=False)
        fixed[mesh.on_tip] = True
    free = ~fixed.ravel()
    distances_m = np.linalg.norm(mesh.places_m - np.asarray(sheet.tip_m), axis=1)
    far_m = distances_m[mesh.on_rim].min()
    # A membrane under even tension is a logarithm about the tip; a flat one has no stiffness across its plane.
    cone = np.clip(
        np.log(far_m / np.maximum(distances_m, sheet.tip_radius_m))
        / np.log(far_m / sheet.tip_radius_m),
        0.0,
        1.0,
    )
    places_m = np.empty((len(pushes_m), count, 3))
    forces_n = np.empty((len(pushes_m), 3))
    for found, row, push_m in zip(places_m, forces_n, pushes_m, strict=True):
        places = flat + push_m * cone[:, None] * [0.0, 0.0, 1.0]
        found[:] = elements.at_rest(places, free)
        # The rim carries the weight of its own nodes too.
        row[:] = -elements.forces_n(found)[mesh.on_rim].sum(axis=0)
    return _AtRest(mesh=mesh, places_m=places_m, forces_n=forces_n)


def _hung(sheet: ProbedSheet, mesh: _Mesh, *, folds: bool) -> FloatArray:
    """Return a cloth that its weight moves in its plane, before a tip touches it [m], shape [node_count, 3]."""
    fixed = np.zeros((len(mesh.places_m), 3), dtype=bool)
    fixed[mesh.on_rim] = True
    fixed[:, 2] = True
    flat = np.column_stack([mesh.places_m, np.zeros(len(mesh.places_m))])
    return _Elements(sheet, mesh, folds=folds).at_rest(flat, ~fixed.ravel())


def held_forces_n(
    sheet: ProbedSheet, pushes_m: FloatArray, *, rings: int, sticks: bool, folds: bool
) -> FloatArray:
    """Return the forces of the rim on the cloth at rest [N], shape [push_count, 3].

    Args:
        sheet: The cloth.
        pushes_m: Pushes of the tip [m], not negative, in ascending order.
        rings: Number of cells from the tip to the rim.
        sticks: Whether the material on the tip sticks to it, or slides without friction.
        folds: Whether the cloth folds where it is pressed, without bending stiffness, or stays smooth.
    """
    return _at_rest(sheet, pushes_m, rings=rings, sticks=sticks, folds=folds).forces_n


def _located(mesh: _Mesh, points_m: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the nodes around material points of the plane and their weights, shape [point_count, 4]."""
    nodes, weights = [], []
    corners_m = mesh.places_m[mesh.cells]
    for point_m in points_m:
        far_m = np.linalg.norm(corners_m.mean(axis=1) - point_m, axis=1)
        for cell in np.argsort(far_m):
            at = np.zeros(2)
            for _ in range(20):
                factors = 1.0 + CORNERS * at
                shape = 0.25 * factors.prod(axis=1)
                slopes = corners_m[cell].T @ (0.25 * CORNERS * factors[:, ::-1])
                at = np.clip(
                    at - np.linalg.solve(slopes, shape @ corners_m[cell] - point_m),
                    -3.0,
                    3.0,
                )
            if np.abs(at).max() < 1.0 + 1e-6:
                nodes.append(mesh.cells[cell])
                weights.append(0.25 * (1.0 + CORNERS * at).prod(axis=1))
                break
    return np.array(nodes), np.array(weights)


def probe_points_m(
    scene: Scene, times_s: FloatArray, points_m: FloatArray
) -> tuple[FloatArray, list[FloatArray], int]:
    """Return where points of a probed sheet at rest are [m], what is open of them, and when the tip touches.

    Args:
        scene: A scene of `probed_sheet_of`.
        times_s: Times, at which the cloth is taken to be at rest.
        points_m: The points at the start, shape [point_count, 3].

    Returns:
        Places and what friction, edge of the tip and cells leave open of them, shape [time_count, point_count, 3]; and
        the first time at which the tip touches the cloth.
    """
    found = probed_sheet_of(scene)
    assert found is not None
    sheet, gap_m, driver = found
    (cloth,) = scene.deformables
    assert isinstance(cloth, Cloth)
    (motion,) = (one for one in driver.motions if one.profiles)
    travels_m = np.array([motion.value(time_s) for time_s in times_s]) - gap_m
    pushes_m = travels_m.max() * np.linspace(1.0 / POINT_PUSHES, 1.0, POINT_PUSHES)
    axes = cloth.pose.to_world(np.eye(3)) - np.asarray(cloth.pose.position_m)
    axes = np.vstack([axes[:2], motion.axis])
    local_m = cloth.pose.to_body(points_m)[:, :2]

    def solved(
        radius_m: float, count: int = 1, *, sticks: bool = False, rings: int = RINGS[0]
    ) -> tuple[FloatArray, float]:
        """Return how far points move at the deepest pushes [m], and the force of the last of them [N]."""
        narrow = replace(sheet, tip_radius_m=radius_m)
        rest = _at_rest(
            narrow, pushes_m[-count:], rings=rings, sticks=sticks, folds=True
        )
        mesh = rest.mesh
        nodes, weights = _located(mesh, local_m)
        flat = np.column_stack([mesh.places_m, np.zeros(len(mesh.places_m))])
        places_m = rest.places_m
        if count == len(pushes_m):
            places_m = np.stack([_hung(narrow, mesh, folds=True), *places_m])
        moved_m = np.einsum("pn,tpnx->tpx", weights, (places_m - flat)[:, nodes])
        return moved_m @ axes, abs(float(rest.forces_n[-1, 2]))

    sharp_m = sheet.tip_radius_m
    fine, force_n = solved(sharp_m, POINT_PUSHES, rings=RINGS[1])
    coarse, _ = solved(sharp_m)
    bending = plate_bending_stiffness(
        hinge_stiffness_n_m_per_rad=cloth.bend_stiffness_n_m_per_rad
    )
    # As in `probe_forces_n`. What is open is that at the deepest push, and less in proportion to shallower ones.
    layer_m = np.sqrt(2.0 * np.pi * sharp_m * bending / force_n)
    wide_m = sharp_m + 0.5 * (layer_m + cloth.thickness_m)
    shares = np.linspace(0.0, 1.0, POINT_PUSHES + 1)[:, None, None]
    stick = 0.5 * shares * (solved(sharp_m, sticks=True)[0] - coarse)
    wide = 0.5 * shares * (solved(wide_m)[0] - coarse)
    rest = shares * (fine[-1:] - coarse) / ((RINGS[1] / RINGS[0]) ** 2 - 1.0)
    mean = fine + rest + stick + wide
    parts = [np.abs(stick) / np.sqrt(3.0), np.abs(wide) / np.sqrt(3.0), np.abs(rest)]
    places_m = np.concatenate([[0.0], pushes_m])
    at_m = np.maximum(travels_m, 0.0)
    return (
        points_m + PchipInterpolator(places_m, mean)(at_m),
        [PchipInterpolator(places_m, part)(at_m) for part in parts],
        int(np.argmax(travels_m > 0.0)),
    )


def probed_sheet_of(scene: Scene) -> tuple[ProbedSheet, float, Driver] | None:
    """Return the sheet of a scene, how far its tip is from touching it [m], and the driver; None for another scene."""
    if len(scene.deformables) != 1 or scene.air is not None or len(scene.drivers) != 1:
        return None
    (cloth,), (driver,) = scene.deformables, scene.drivers
    sides = {(one.region.axis, one.region.side) for one in scene.attachments}
    rod = scene.body(driver.body)
    moved = [motion for motion in driver.motions if motion.profiles]
    if not isinstance(cloth, Cloth) or not isinstance(rod.shape, Cylinder):
        return None
    if len(sides) < 4 or len(moved) != 1 or moved[0].kind != "translate":
        return None
    axes = cloth.pose.to_world(np.eye(3)) - np.asarray(cloth.pose.position_m)
    push = np.asarray(moved[0].axis)
    along = rod.pose.to_world(np.eye(3))[2] - np.asarray(rod.pose.position_m)
    if max(*np.abs(axes[:2] @ push), *np.abs(axes[:2] @ along)) > NORMAL:
        return None
    start_m = cloth.pose.to_body(np.asarray(rod.pose.position_m)[None])[0]
    to_tip_m = np.asarray(rod.pose.position_m) + 0.5 * rod.shape.length_m * push
    gap_m = float((np.asarray(cloth.pose.position_m) - to_tip_m) @ push)
    down = np.array([0.0, 0.0, -1.0])
    sheet = ProbedSheet(
        size_m=cloth.size_m,
        stretch_n_per_m=cloth.stretch_stiffness_n_per_m,
        shear_n_per_m=cloth.shear_stiffness_n_per_m,
        weight_n_per_m2=cloth.areal_density_kg_per_m2 * GRAVITY_M_PER_S2,
        weight_direction=(*(axes[:2] @ down).tolist(), float(push @ down)),
        tip_m=(float(start_m[0]), float(start_m[1])),
        tip_radius_m=rod.shape.radius_m,
    )
    return sheet, gap_m - 0.5 * cloth.thickness_m, driver


def probe_forces_n(
    scene: Scene, times_s: FloatArray
) -> tuple[FloatArray, list[FloatArray]] | None:
    """Return the forces of the rim along the push and upward, shape [time_count, 2], and what is open of them.

    Args:
        scene: A scene; None is returned if it is not that of a probed sheet.
        times_s: Times, at which the cloth is taken to be at rest.
    """
    found = probed_sheet_of(scene)
    if found is None:
        return None
    sheet, gap_m, driver = found
    (cloth,) = scene.deformables
    assert isinstance(cloth, Cloth)
    (motion,) = (one for one in driver.motions if one.profiles)
    places_m = np.array([motion.value(time_s) for time_s in times_s]) - gap_m
    pushes_m = np.linspace(0.9 * max(places_m.min(), 0.0), places_m.max(), PUSHES)
    up = -np.asarray(sheet.weight_direction)

    def solved(
        radius_m: float, *, sticks: bool, rings: int = RINGS[0], count: int = PUSHES
    ) -> FloatArray:
        forces_n = held_forces_n(
            replace(sheet, tip_radius_m=radius_m),
            pushes_m[-count:],
            rings=rings,
            sticks=sticks,
            folds=True,
        )
        return np.column_stack([forces_n[:, 2], forces_n @ up])

    sharp_m = sheet.tip_radius_m
    sharp = [solved(sharp_m, sticks=sticks) for sticks in (False, True)]
    # The tension at the edge is at least the force over the edge.
    bending = plate_bending_stiffness(
        hinge_stiffness_n_m_per_rad=cloth.bend_stiffness_n_m_per_rad
    )
    layer_m = np.sqrt(2.0 * np.pi * sharp_m * bending / abs(sharp[0][-1, 0]))
    wide_m = sharp_m + 0.5 * (layer_m + cloth.thickness_m)
    wide = [solved(wide_m, sticks=sticks) for sticks in (False, True)]
    fine = [
        solved(sharp_m, sticks=sticks, rings=RINGS[1], count=1)
        for sticks in (False, True)
    ]
    # Second order in the cells; the share of the force is that at the deepest push.
    gain = (RINGS[1] / RINGS[0]) ** 2 - 1.0
    rates = [
        (new - old[-1:]) * (1.0 + 1.0 / gain)
        for new, old in zip(fine, sharp, strict=True)
    ]
    share = np.divide(
        np.mean(rates, axis=0),
        np.mean([one[-1:] for one in sharp], axis=0),
    )
    corners = np.array([*sharp, *wide]) * (1.0 + share)
    mean = corners.mean(axis=0)
    slide, stick = corners[[0, 2]].mean(axis=0), corners[[1, 3]].mean(axis=0)
    narrow, broad = corners[:2].mean(axis=0), corners[2:].mean(axis=0)
    # Anything between two bounds: their half distance over the square root of 3.
    parts = [
        0.5 * np.abs(stick - slide) / np.sqrt(3.0),
        0.5 * np.abs(broad - narrow) / np.sqrt(3.0),
        np.abs(share * mean) / (1.0 + gain),
    ]
    return (
        CubicSpline(pushes_m, mean)(places_m),
        [CubicSpline(pushes_m, part)(places_m) for part in parts],
    )


@dataclass(frozen=True)
class _States:
    """What the points of integration of cells show; arrays have shape [4, cell_count, ...]."""

    strains: FloatArray  # Exx, Eyy, 2 Exy.
    changes: FloatArray  # Of the strains with the coordinates of the four nodes, [..., 3, 12].
    stresses: FloatArray
    law: FloatArray  # Change of the stresses with the strains, [..., 3, 3].


class _Elements:
    def __init__(self, sheet: ProbedSheet, mesh: _Mesh, *, folds: bool) -> None:
        self._folds = folds
        self._count = len(mesh.places_m)
        self._cells = mesh.cells
        stretch, shear = sheet.stretch_n_per_m, sheet.shear_n_per_m
        self._law = np.array([stretch, stretch, shear])  # On Exx, Eyy, 2 Exy.
        corners_m = mesh.places_m[mesh.cells]
        slopes, areas = [], []
        weights_n = np.zeros(self._count)
        for point in itertools.product((-1.0, 1.0), repeat=2):
            at = np.asarray(point) / np.sqrt(3.0)
            factors = 1.0 + CORNERS * at
            shape = 0.25 * factors.prod(axis=1)
            local = 0.25 * CORNERS * factors[:, ::-1]
            jacobians = np.einsum("nk,cni->cik", local, corners_m)
            slopes.append(np.einsum("nk,cki->cni", local, np.linalg.inv(jacobians)))
            areas.append(np.abs(np.linalg.det(jacobians)))
            np.add.at(
                weights_n,
                mesh.cells,
                sheet.weight_n_per_m2 * areas[-1][:, None] * shape,
            )
        self._slopes = np.array(slopes)  # [4, cell_count, 4, 2]
        self._areas_m2 = np.array(areas)  # [4, cell_count]
        self._loads = weights_n[:, None] * np.asarray(sheet.weight_direction)
        freedoms = (3 * mesh.cells[:, :, None] + np.arange(3)).reshape(-1, 12)
        self._rows = np.repeat(freedoms, 12, axis=1).ravel()
        self._columns = np.tile(freedoms, (1, 12)).ravel()

    def _states(self, places: FloatArray) -> _States:
        tangents = np.einsum("pcni,cnx->pcix", self._slopes, places[self._cells])
        warp, weft = tangents[:, :, 0], tangents[:, :, 1]
        strains = np.stack(
            [
                0.5 * (np.square(warp).sum(axis=-1) - 1.0),
                0.5 * (np.square(weft).sum(axis=-1) - 1.0),
                (warp * weft).sum(axis=-1),
            ],
            axis=-1,
        )
        along, across = self._slopes[..., 0, None], self._slopes[..., 1, None]
        warp, weft = warp[:, :, None], weft[:, :, None]
        changes = np.stack(
            [along * warp, across * weft, along * weft + across * warp], axis=2
        )
        stresses, law = _stresses(strains, self._law, folds=self._folds)
        return _States(
            strains=strains,
            changes=changes.reshape(*changes.shape[:3], 12),
            stresses=stresses,
            law=law,
        )

    def energy_j(self, places: FloatArray) -> float:
        """Return the energy, that of the weight included."""
        states = self._states(places)
        # The law is of the first degree in the strains, also where the cloth folds.
        stored = 0.5 * (states.stresses * states.strains).sum(axis=-1)
        return float(np.vdot(stored, self._areas_m2) - np.vdot(self._loads, places))

    def _forces(self, states: _States) -> FloatArray:
        cells = -np.einsum(
            "pcsf,pcs,pc->cf", states.changes, states.stresses, self._areas_m2
        )
        found = self._loads.copy()
        np.add.at(found, self._cells, cells.reshape(-1, 4, 3))
        return found

    def forces_n(self, places: FloatArray) -> FloatArray:
        """Return the forces on the nodes, weight included [N], shape [node_count, 3]."""
        return self._forces(self._states(places))

    def _stiffness(self, states: _States) -> coo_matrix:
        changes, stresses, areas = states.changes, states.stresses, self._areas_m2
        law = np.einsum(
            "pcsf,pcst,pctg,pc->cfg", changes, states.law, changes, areas, optimize=True
        )
        warp, weft = self._slopes[..., 0], self._slopes[..., 1]
        shared = np.einsum("pcn,pcm->pcnm", warp, weft)
        tension = (
            stresses[..., 0, None, None] * np.einsum("pcn,pcm->pcnm", warp, warp)
            + stresses[..., 1, None, None] * np.einsum("pcn,pcm->pcnm", weft, weft)
            + stresses[..., 2, None, None] * (shared + shared.swapaxes(-1, -2))
        )
        nodes = np.einsum("pcnm,pc->cnm", tension, areas)
        blocks = law.reshape(-1, 4, 3, 4, 3)
        for axis in range(3):
            blocks[:, :, axis, :, axis] += nodes
        size = 3 * self._count
        values = blocks.reshape(-1)
        return coo_matrix((values, (self._rows, self._columns)), shape=(size, size))

    def at_rest(self, places: FloatArray, free: BoolArray) -> FloatArray:
        """Return the places at rest [m], shape [node_count, 3].

        Args:
            places: Places to start from; those of nodes that are not free stay.
            free: Coordinates that are free, shape [3 node_count].
        """
        found = places.copy()
        energy = self.energy_j(found)
        damping = DAMPING * self._law.max()
        for _ in range(MOST_STEPS):
            states = self._states(found)
            forces = self._forces(states).ravel()[free]
            stiffness = self._stiffness(states).tocsr()[free][:, free]
            step = np.zeros(found.size)
            damped = stiffness + damping * identity(len(forces))
            step[free] = spsolve(damped.tocsc(), forces)
            moved, share = step.reshape(-1, 3), 1.0
            while True:
                new = self.energy_j(found + share * moved)
                if new <= energy or share < 1e-6:
                    break
                share *= 0.5
            found, energy = found + share * moved, new
            if share == 1.0:
                damping *= 0.2
            elif share < 0.2:
                damping *= 4.0
            if np.abs(forces).max() < TOLERANCE * self._law.max():
                return found
        raise ArithmeticError("no place of rest")


def _stresses(
    strains: FloatArray, law: FloatArray, *, folds: bool
) -> tuple[FloatArray, FloatArray]:
    """Return stresses and their change with the strains, shape [..., 3] and [..., 3, 3].

    A cloth that folds bears no pressure (Pipkin, "The relaxed energy density for isotropic elastic membranes", 1986):
    it is taut, or pulled along one line, whose direction stores most energy, or slack.
    """
    stresses = strains * law
    changes = np.broadcast_to(np.diag(law), (*strains.shape, 3)).copy()
    if not folds:
        return stresses, changes
    xx, yy, xy = np.moveaxis(stresses, -1, 0)
    pressed = (xx < 0.0) | (yy < 0.0) | (xx * yy < xy * xy)
    bent = strains[pressed]
    angles = np.repeat(np.linspace(0.0, np.pi, 60, endpoint=False)[None], len(bent), 0)
    width = np.pi / 60
    for _ in range(5):
        values = _line_energies(bent, law, angles)
        best = np.take_along_axis(angles, values.argmax(axis=1)[:, None], axis=1)
        angles = best + np.linspace(-width, width, 21)
        width /= 10.0
    line, turning, bending = (one[:, 0] for one in _turned(best))
    compliance = (np.square(line) / law).sum(axis=1)
    turned = 2.0 * (line * turning / law).sum(axis=1)
    twice = 2.0 * ((np.square(turning) + line * bending) / law).sum(axis=1)
    pull = np.maximum((line * bent).sum(axis=1), 0.0)
    pull_1, pull_2 = (turning * bent).sum(axis=1), (bending * bent).sum(axis=1)
    stresses[pressed] = (pull / compliance)[:, None] * line
    # The line turns with the strains, so that it always stores most energy; `curvature` is that of the energy.
    curvature = (
        (pull_1**2 + pull * pull_2) / compliance
        - 2.0 * pull * pull_1 * turned / compliance**2
        + pull**2 * (turned**2 / compliance**3 - 0.5 * twice / compliance**2)
    )
    mixed = (
        pull_1[:, None] * line
        + pull[:, None] * (turning - (turned / compliance)[:, None] * line)
    ) / compliance[:, None]
    shares = np.where(curvature < 0.0, -1.0 / np.minimum(curvature, -1e-300), 0.0)
    changes[pressed] = ((pull > 0.0) / compliance)[:, None, None] * (
        line[:, :, None] * line[:, None, :]
    ) + shares[:, None, None] * mixed[:, :, None] * mixed[:, None, :]
    return stresses, changes


def _turned(angles: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return lines at angles, shape [..., 3], and their first and second derivatives."""
    cos, sin = np.cos(angles), np.sin(angles)
    cos_2, sin_2 = np.cos(2.0 * angles), np.sin(2.0 * angles)
    return (
        np.stack([cos * cos, sin * sin, cos * sin], axis=-1),
        np.stack([-sin_2, sin_2, cos_2], axis=-1),
        2.0 * np.stack([-cos_2, cos_2, -sin_2], axis=-1),
    )


def _line_energies(
    strains: FloatArray, law: FloatArray, angles: FloatArray
) -> FloatArray:
    """Return twice the energy of a pull along lines, shape [N, A]; strains [N, 3], angles [N, A]."""
    lines, _, _ = _turned(angles)
    compliance = (np.square(lines) / law).sum(axis=-1)
    pull = np.maximum(np.einsum("nas,ns->na", lines, strains), 0.0)
    return pull * pull / compliance
