"""Solve a cloth that moves alike at all places across its width: a one-dimensional sheet without damping.

The cloths of TextileFlinging and TextileBending are held along whole edges across the warp, by rods that move in the
plane of the warp and of gravity. With a Poisson ratio of 0, every warp thread then moves alike and no thread shears. A
chain of nodes in the world stands for all of them. Its energy per width is, over the cells of length h,

    K_s h / 2 (l / h - 1)^2  +  D / (2 h^3) |x[i+1] - 2 x[i] + x[i-1]|^2  +  m |v|^2 / 2  +  m g z

with the length l of a cell, K_s of the fabric, D = K_theta (`plate_bending_stiffness`) and the mass m = rho h of a
node, half of it at a free end. The leapfrog (Hairer, Lubich and Wanner, "Geometric Numerical Integration", 2006,
section I.1.4) is symplectic: it damps nothing, as the scene has no damping. Contact of the cloth with itself is left
out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gauge_envs.scene import Cloth, Scene
from gauge_envs.scene.drivers import Driver
from gauge_envs.scene.fabrics import plate_bending_stiffness
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.scene import GRAVITY_M_PER_S2
from gauge_envs.scene.timing import FRAME_RATE_HZ

COURANT = 0.8
"""Time step over the longest stable one, at which a membrane wave passes a cell."""

TOLERANCE = 1e-9
"""Largest component of a unit vector that counts as none."""


@dataclass(frozen=True, kw_only=True)
class Sheet:
    """A cloth that moves alike across its width.

    Attributes:
        cloth: The cloth.
        end_drivers: Driver that moves each held end, or None where that end stands still; by `low` and `high`.
    """

    cloth: Cloth
    end_drivers: dict[str, Driver | None]


def sheet_of(scene: Scene) -> Sheet | None:
    """Return the sheet of a scene, or None for a scene whose motion varies across the width of its cloth."""
    if len(scene.deformables) != 1 or scene.air is not None or not scene.attachments:
        return None
    (cloth,) = scene.deformables
    if not isinstance(cloth, Cloth):
        return None
    if any(
        {*contact.first, *contact.second} != {cloth.name} for contact in scene.contacts
    ):
        return None
    across = cloth.pose.to_world(np.eye(3))[1] - np.asarray(cloth.pose.position_m)
    if abs(across[2]) > TOLERANCE:
        return None
    drivers = {driver.body: driver for driver in scene.drivers}
    end_drivers: dict[str, Driver | None] = {}
    for attachment in scene.attachments:
        driver = drivers.get(attachment.to)
        region = attachment.region
        if region.axis != "x" or region.depth_m > 0.0:
            return None
        for motion in driver.motions if driver is not None else ():
            sideways = abs(float(np.dot(motion.axis, across)))
            if motion.kind != "translate" or sideways > TOLERANCE:
                return None
        end_drivers[region.side] = driver
    return Sheet(cloth=cloth, end_drivers=end_drivers)


def end_place_m(driver: Driver | None, time_s: float) -> FloatArray:
    """Return how far a held end has moved at a time [m], shape [3]."""
    moved = np.zeros(3)
    for motion in driver.motions if driver is not None else ():
        moved += motion.value(time_s) * np.asarray(motion.axis)
    return moved


def end_velocity_m_per_s(driver: Driver | None, time_s: float) -> FloatArray:
    """Return the velocity of a held end at a time [m/s], shape [3], by central differences."""
    moved = end_place_m(driver, time_s + 1e-5) - end_place_m(driver, time_s - 1e-5)
    return moved / 2e-5


def energy_j_per_m(
    cloth: Cloth, places_m: FloatArray, velocities_m_per_s: FloatArray, free: FloatArray
) -> float:
    """Return the energy per width of a state [J/m]; arrays have shape [3, node_count], `free` [node_count]."""
    cell_m = cloth.size_m[0] / (places_m.shape[1] - 1)
    masses = node_masses_kg_per_m(cloth, places_m.shape[1])
    lengths = np.linalg.norm(np.diff(places_m, axis=1), axis=0)
    strains = lengths / cell_m - 1.0
    curves = np.diff(places_m, n=2, axis=1)
    bending = bending_stiffness_n_m(cloth)
    return float(
        0.5 * cloth.stretch_stiffness_n_per_m * cell_m * np.square(strains).sum()
        + 0.5 * bending / cell_m**3 * np.square(curves).sum()
        + 0.5 * (masses * free * np.square(velocities_m_per_s)).sum()
        + GRAVITY_M_PER_S2 * (masses * free * places_m[2]).sum()
    )


def bending_stiffness_n_m(cloth: Cloth) -> float:
    """Return the plate bending stiffness D of a cloth [N m]."""
    return plate_bending_stiffness(
        hinge_stiffness_n_m_per_rad=cloth.bend_stiffness_n_m_per_rad
    )


def node_masses_kg_per_m(cloth: Cloth, node_count: int) -> FloatArray:
    """Return the mass of each node per width [kg/m]."""
    masses = np.full(
        node_count,
        cloth.areal_density_kg_per_m2 * cloth.size_m[0] / (node_count - 1),
    )
    masses[[0, -1]] *= 0.5
    return masses


def solve_sheet(
    sheet: Sheet, *, cells: int, frames: int, step_factor: float = 1.0
) -> tuple[FloatArray, FloatArray, dict[str, FloatArray]]:
    """Return the nodes of a sheet at 30 Hz.

    Args:
        sheet: The sheet.
        cells: Number of cells along the warp.
        frames: Number of frames, from rest at the start.
        step_factor: Factor on the time step of `COURANT`.

    Returns:
        Places of the nodes [m], shape [frames, 3, cells + 1]; the energy per width at the frames [J/m]; and the force
        per width on each held end in the mean over each frame [N/m], shape [frames, 3] by side, NaN at frame 0.
    """
    cloth = sheet.cloth
    length_m = cloth.size_m[0]
    cell_m = length_m / cells
    wave_m_per_s = math.sqrt(
        cloth.stretch_stiffness_n_per_m / cloth.areal_density_kg_per_m2
    )
    wanted_s = step_factor * COURANT * cell_m / wave_m_per_s
    steps = math.ceil(1.0 / (FRAME_RATE_HZ * wanted_s))
    step_s = 1.0 / (FRAME_RATE_HZ * steps)

    along = np.linspace(-0.5 * length_m, 0.5 * length_m, cells + 1)
    rest_m = np.column_stack([along, np.zeros((cells + 1, 2))])
    places = np.ascontiguousarray(cloth.pose.to_world(rest_m).T)
    velocities = np.zeros_like(places)
    ends = {"low": 0, "high": cells}
    free = np.ones(cells + 1)
    for side in sheet.end_drivers:
        free[ends[side]] = 0.0
    starts = {side: places[:, ends[side]].copy() for side in sheet.end_drivers}
    moved = {
        side: driver for side, driver in sheet.end_drivers.items() if driver is not None
    }

    masses = node_masses_kg_per_m(cloth, cells + 1)
    per_force = step_s * free / masses
    fall = np.zeros_like(places)
    fall[2] = -step_s * GRAVITY_M_PER_S2 * free
    stretch = cloth.stretch_stiffness_n_per_m
    bend = bending_stiffness_n_m(cloth) / cell_m**3

    end_loads_n_per_m = {
        side: np.full((frames, 3), np.nan) for side in sheet.end_drivers
    }
    found = np.empty((frames, *places.shape))
    energies = np.empty(frames)
    found[0] = places
    energies[0] = energy_j_per_m(cloth, places, velocities, free)
    forces = np.empty_like(places)
    share = 0.5  # The first kick takes velocities from 0 to half a step.
    for frame in range(1, frames):
        pulls = {side: np.zeros(3) for side in sheet.end_drivers}
        for step in range(steps):
            edges = places[:, 1:] - places[:, :-1]
            lengths = np.sqrt(np.einsum("kn,kn->n", edges, edges))
            edges *= stretch * (1.0 / cell_m - 1.0 / lengths)
            curves = bend * (places[:, 2:] - 2.0 * places[:, 1:-1] + places[:, :-2])
            forces[:, 0] = edges[:, 0]
            forces[:, 1:-1] = edges[:, 1:] - edges[:, :-1] + 2.0 * curves
            forces[:, -1] = -edges[:, -1]
            forces[:, :-2] -= curves
            forces[:, 2:] -= curves
            for side, pull in pulls.items():
                pull -= forces[:, ends[side]] / steps
            forces *= per_force
            forces += fall
            velocities += share * forces
            share = 1.0
            places += step_s * velocities
            time_s = (frame - 1) / FRAME_RATE_HZ + (step + 1) * step_s
            for side, driver in moved.items():
                places[:, ends[side]] = starts[side] + end_place_m(driver, time_s)
        for side, pull in pulls.items():
            # The end of the chain has half a cell of mass, which its holder carries and accelerates.
            gained = end_velocity_m_per_s(
                sheet.end_drivers[side], frame / FRAME_RATE_HZ
            )
            gained -= end_velocity_m_per_s(
                sheet.end_drivers[side], (frame - 1) / FRAME_RATE_HZ
            )
            gained[2] += GRAVITY_M_PER_S2 / FRAME_RATE_HZ
            end_loads_n_per_m[side][frame] = (
                pull + masses[ends[side]] * FRAME_RATE_HZ * gained
            )
        found[frame] = places
        # Velocities lag by half a step, which is no more than the error of the leapfrog.
        energies[frame] = energy_j_per_m(cloth, places, velocities, free)
    return found, energies, end_loads_n_per_m


def marker_places_m(
    sheet: Sheet, nodes_m: FloatArray, markers_m: FloatArray
) -> FloatArray:
    """Return the markers at the frames [m], shape [frames, marker_count, 3].

    Args:
        sheet: The sheet.
        nodes_m: Nodes from `solve_sheet`, shape [frames, 3, node_count].
        markers_m: Markers at the start [m], shape [marker_count, 3].
    """
    pose = sheet.cloth.pose
    local = pose.to_body(markers_m)
    across = pose.to_world(np.eye(3))[1] - np.asarray(pose.position_m)
    cells = nodes_m.shape[2] - 1
    place = (local[:, 0] / sheet.cloth.size_m[0] + 0.5) * cells
    low = np.clip(np.floor(place + 1e-9).astype(int), 0, cells - 1)
    share = place - low
    between = (1.0 - share) * nodes_m[:, :, low] + share * nodes_m[:, :, low + 1]
    return between.transpose(0, 2, 1) + local[:, 1:2] * across
