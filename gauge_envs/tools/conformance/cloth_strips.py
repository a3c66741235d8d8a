"""Two tests of a strip of any fabric: tension of a hanging strip, and droop of a clamped one.

The conformance checks of cloth and the recipes of fabrics have these scenes in common. The load is the strip's own
weight. The mean displacement under a Hann window is the equilibrium, whether the strip oscillates about it or creeps
towards it; see `cloth`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gauge_envs.runs.rollout import Rollout
from gauge_envs.scene import GRAVITY_M_PER_S2 as G
from gauge_envs.scene import Cloth, Pose, Region, Scene
from gauge_envs.scene.fabrics import Fabric
from gauge_envs.tools.conformance.laws import PLACE_TOLERANCE_M, cantilever_load_over_stiffness, coefficient, hann_mean
from gauge_envs.tools.conformance.measurements import stiffness
from gauge_envs.tools.conformance.model import Measurement
from gauge_envs.tools.conformance.scene_parts import LIGHT_FABRIC, clamped, fabric, sheet

HANG_M, HANG_WIDTH_M = 0.3, 0.075

CLAMP_SHARE, WIDTH_SHARE = 1.0 / 3.0, 2.0 / 3.0
BENT_FREE_M = 0.15
"""Free length of the cantilever of the conformance checks [m]."""

BENT_S, SETTLED_SHARE = 1.3, 0.35 / 1.3
BENT_GRAVITY = 0.2 * G


HUNG_FABRIC = LIGHT_FABRIC
"""Fabric of the check of tension: it sags by 0.8 mm, its largest strain is 0.5 %, and its period 51 ms."""

BENT_FABRIC = fabric(0.2, 110.0, 6.2e-3)
"""Fabric of the check of bending: at a fifth of gravity it sags by 4 mm on 150 mm, with a period of 0.23 s.

At full gravity its slope would reach 0.5, and the moment of its weight near the tip would be a fifth too small.
"""


def strip_of(rollout: Rollout) -> Cloth:
    """Return the strip of a scene of this module."""
    (cloth,) = rollout.scene.deformables
    assert isinstance(cloth, Cloth), "the scene has a strip alone"
    return cloth


def local_nodes(rollout: Rollout) -> NDArray[np.float64]:
    """Return nodes in the cloth's frame [m], shape [sample_count, node_count, 3]."""
    return np.array([strip_of(rollout).pose.to_body(nodes) for nodes in rollout.nodes_m["cloth"]])


def equilibrium(rollout: Rollout, settled_s: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return nodes at the start and in equilibrium, in the cloth's frame [m], each of shape [node_count, 3]."""
    local = local_nodes(rollout)
    return local[0], hann_mean(local[rollout.between(settled_s, float(rollout.times_s[-1]))])


def node_shares(rest_m: NDArray[np.float64], size_m: tuple[float, float]) -> NDArray[np.float64]:
    """Return the share of the sheet's area that is nearest to each node, for any mesh, shape [node_count]."""
    x, y = ((np.arange(400) + 0.5) / 400 * size - 0.5 * size for size in size_m)
    points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    nearest = cKDTree(rest_m[:, :2]).query(points)[1]
    return np.bincount(nearest, minlength=len(rest_m)) / len(points)


def hanging_strip(made_of: Fabric) -> Scene:
    """Return a strip of 0.3 m by 0.075 m that hangs from its upper edge, warp downward."""
    pose = Pose.from_euler_deg((0.0, 0.0, 1.0), (0.0, -90.0, 0.0))
    cloth = sheet(made_of, pose, (HANG_M, HANG_WIDTH_M))
    return clamped(cloth, Region(axis="x", side="high"), duration_s=0.8)


def stretch_stiffness(rollout: Rollout) -> Measurement:
    """Measure K_s [N/m] from the sag of a strip, a width or more from its clamp: u = rho g (L s - s^2/2) / K_s."""
    cloth = strip_of(rollout)
    rest, now = equilibrium(rollout, 0.2)
    s = 0.5 * HANG_M - rest[:, 0]
    free = s > HANG_WIDTH_M - PLACE_TOLERANCE_M
    slope = coefficient((rest - now)[free, 0], (HANG_M * s - 0.5 * s**2)[free], np.ones(free.sum()))
    load = cloth.areal_density_kg_per_m2 * rollout.scene.gravity_m_per_s2
    return stiffness(load, slope, cloth.stretch_stiffness_n_per_m, "stretches")


def cantilever_strip(made_of: Fabric, free_m: float = BENT_FREE_M, *, height_m: float = 1.0) -> Scene:
    """Return a horizontal strip that is clamped at one end.

    Gravity is that with which rho g L^3 / D is the same for every fabric and length, so that the tip's slope is 0.04.
    The duration has the same number of periods.

    Args:
        made_of: The fabric.
        free_m: Free length L [m]; the clamp is a third of it, and the width two thirds.
        height_m: Height of the strip [m]. Single precision rounds small displacements least at 0.
    """
    scale = free_m / BENT_FREE_M
    density = BENT_FABRIC.areal_density_kg_per_m2 / made_of.areal_density_kg_per_m2
    bend = made_of.bend_stiffness_n_m_per_rad / BENT_FABRIC.bend_stiffness_n_m_per_rad
    gravity = BENT_GRAVITY * density * bend / scale**3
    size_m = ((1.0 + CLAMP_SHARE) * free_m, WIDTH_SHARE * free_m)
    cloth = sheet(made_of, Pose(position_m=(0.0, 0.0, height_m)), size_m)
    return clamped(
        cloth,
        Region(axis="x", side="low", depth_m=CLAMP_SHARE * free_m),
        duration_s=BENT_S * math.sqrt(scale * BENT_GRAVITY / gravity),
        gravity_m_per_s2=gravity,
    )


def bending_stiffness(rollout: Rollout) -> Measurement:
    """Measure the bending stiffness per width [N m] from the droop of a clamped strip: D w'' = rho g (L - s)^2 / 2."""
    cloth = strip_of(rollout)
    rest, now = equilibrium(rollout, SETTLED_SHARE * rollout.scene.duration_s)
    free_m = cloth.size_m[0] / (1.0 + CLAMP_SHARE)
    s = rest[:, 0] + 0.5 * cloth.size_m[0] - CLAMP_SHARE * free_m
    # Nodes are weighted by area, like the load, since a mesh's diagonals make its lines of nodes wavy.
    shares = node_shares(rest, cloth.size_m)
    slope = cantilever_load_over_stiffness(s, (rest - now)[:, 2], length_m=free_m, weights=shares)
    load = cloth.areal_density_kg_per_m2 * rollout.scene.gravity_m_per_s2
    return stiffness(load, slope, cloth.bend_stiffness_n_m_per_rad, "bends")
