"""Soft bodies in PyBullet: linear tetrahedra with Bullet's Neo-Hookean energy, in its deformable world."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.pybullet.settings import SOFT_CELL_M
from gauge_envs.backends.pybullet.world import BulletWorld
from gauge_envs.backends.shared.attachments import rigid_attachments
from gauge_envs.backends.shared.soft_rows import lame_constants
from gauge_envs.scene import Motion, Region, SoftBody
from gauge_envs.scene.meshes import nodes_in, tetrahedra

GROUND = -1
"""Number of the body that holds anchors in the world."""


def add_soft_body(world: BulletWorld, body: SoftBody, file: Path, *, cell_m: float | None) -> int:
    """Add a soft body, attach its regions, and return PyBullet's number; rigid bodies exist already.

    Bullet's energy is the stable Neo-Hookean one, which equals linear elasticity at small strain for mu' = 4/3 mu and
    lambda' = lambda + 5/6 mu.

    Args:
        world: The world.
        body: The soft body.
        file: File to write its mesh to, the only form in which PyBullet takes tetrahedra.
        cell_m: Desired edge of the cells [m], or None for the default.
    """
    attachments = rigid_attachments(world.scene, body.name)
    nodes_m = _write_mesh(file, body, [one.region for one in attachments], cell_m or SOFT_CELL_M, world.scale)
    shear, lame = lame_constants(body)
    number = world.call(
        "loadSoftBody",
        str(file),
        simFileName=str(file),
        basePosition=(world.scale * np.asarray(body.pose.position_m)).tolist(),
        baseOrientation=body.pose.rotation.as_quat().tolist(),
        mass=body.mass_kg,
        useNeoHookean=1,
        # A pressure is a force over an area: its number falls with the unit of length.
        NeoHookeanMu=4.0 / 3.0 * shear / world.scale,
        NeoHookeanLambda=(lame + 5.0 / 6.0 * shear) / world.scale,
        NeoHookeanDamping=0.0,
        useSelfCollision=0,
    )
    for attachment in attachments:
        # An anchor keeps the node where it now is in the frame of the body.
        held_by = GROUND if attachment.motion is Motion.FIXED else world.handles[attachment.body].body
        for node in nodes_in(nodes_m, attachment.region).tolist():
            world.call("createSoftBodyAnchor", number, node, held_by, -1)
    return int(number)


def _places_m(edge_m: float, axis: str, regions: Sequence[Region], cell_m: float) -> NDArray[np.float64]:
    """Return the places of nodes along an edge [m], with a layer of cells for each attached region of some depth."""
    depth = {region.side: region.depth_m for region in regions if region.axis == axis}
    low, high = -0.5 * edge_m + depth.get("low", 0.0), 0.5 * edge_m - depth.get("high", 0.0)
    inner = np.linspace(low, high, max(1, round((high - low) / cell_m)) + 1)
    return np.unique(np.concatenate([[-0.5 * edge_m], inner, [0.5 * edge_m]]))


def _write_mesh(
    file: Path, body: SoftBody, regions: Sequence[Region], cell_m: float, scale: float
) -> NDArray[np.float64]:
    """Write a VTK file with the tetrahedra of a soft body and return its nodes in the body frame [m]."""
    axes = [_places_m(edge, axis, regions, cell_m) for edge, axis in zip(body.shape.size_m, "xyz", strict=True)]
    nodes_m = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    cells = tetrahedra((len(axes[0]), len(axes[1]), len(axes[2])))
    lines = ["# vtk DataFile Version 2.0", "soft body", "ASCII", "DATASET UNSTRUCTURED_GRID"]
    lines.append(f"POINTS {len(nodes_m)} double")
    lines += [f"{x!r} {y!r} {z!r}" for x, y, z in (scale * nodes_m).tolist()]
    lines.append(f"CELLS {len(cells)} {5 * len(cells)}")
    lines += ["4 " + " ".join(map(str, cell)) for cell in cells.tolist()]
    lines.append(f"CELL_TYPES {len(cells)}")
    lines += ["10"] * len(cells)
    file.write_text("\n".join(lines) + "\n")
    return nodes_m
