"""Settings and presets of Genesis's finite elements (FEM) and of its material point method (MPM)."""

from __future__ import annotations

from collections.abc import Mapping
from math import ceil, sqrt
from typing import Literal

from pydantic import Field

from gauge_envs.backends.genesis.settings import SettingsGenesis
from gauge_envs.backends.shared.cells import CellSize
from gauge_envs.backends.shared.soft_rows import lame_constants
from gauge_envs.scene import Scene, SoftBody
from gauge_envs.scene.timing import DRIVE_INTERVAL_S

SOFT_CELL_M = 0.0125
"""Largest edge of a cell of five tetrahedra [m]: a quarter of the width of the benchmark's foam."""

VOXEL_M = 0.0125
"""Edge of a voxel of the material point method [m]."""

SOFT_PRESETS = ("default", "mpm", "paper", "out_of_box")
"""Names of the presets of scenes with soft bodies."""

COURANT_LIMIT = 0.4
"""Longest step of the material point method, over the time of sound through a voxel."""


class SettingsFEM(SettingsGenesis):
    """Settings of Genesis's implicit finite elements, linear corotational tetrahedra.

    Attributes:
        solver: Genesis's name of the solver.
        cell_m: Largest edge of a cell of five tetrahedra; None gives 12.5 mm. There a bar is 1 % too stiff in tension,
            14 % in shear and 28 % in torsion.
        newton_iterations: Linear solves in a step. The rotations of elements are those at its start, so one is exact.
        pcg_iterations: Iterations of each linear solve. Genesis runs all of them, so they determine the cost.
        pcg_residual_n2: Squared norm of the residual forces at which a linear solve changes no more [N^2].
        damping_alpha_per_s: Rayleigh's damping by mass.
        damping_beta_s: Rayleigh's damping by stiffness.
        contact_margin_m: Distance from a box, sphere or cylinder at which contact starts. A cube as wide as the foam
            pushes the nodes at its edges sideways without it.
        contact_softness_m: Distance over which a rigid body's velocity decays in front of it.
    """

    solver: Literal["FEM"] = "FEM"
    cell_m: CellSize = None
    newton_iterations: int = Field(default=1, ge=1)
    pcg_iterations: int = Field(default=40, ge=1)
    pcg_residual_n2: float = Field(default=1e-20, gt=0.0)
    damping_alpha_per_s: float = Field(default=0.0, ge=0.0)
    damping_beta_s: float = Field(default=0.0, ge=0.0)
    contact_margin_m: float = Field(default=1e-3, ge=0.0)
    contact_softness_m: float = Field(default=5e-4, gt=0.0)


class SettingsMPM(SettingsGenesis):
    """Settings of Genesis's explicit material point method.

    Attributes:
        solver: Genesis's name of the solver.
        cell_m: Desired edge of a voxel of the grid; None gives 12.5 mm.
        points_per_voxel_edge: Material points along the edge of a voxel; Genesis's default size gives 1.5625.
        model: Law of elasticity, under Genesis's name.
        contact_softness_m: Distance over which a rigid body's velocity decays in front of it.
    """

    solver: Literal["MPM"] = "MPM"
    cell_m: CellSize = None
    points_per_voxel_edge: float = Field(default=2.0, ge=1.0)
    model: Literal["corotation", "neohooken"] = "corotation"
    contact_softness_m: float = Field(default=2e-3, gt=0.0)


def soft_presets(scene: Scene) -> Mapping[str, SettingsGenesis]:
    """Return the presets of a scene with soft bodies, by name."""
    bodies = [body for body in scene.deformables if isinstance(body, SoftBody)]
    steps = ceil(DRIVE_INTERVAL_S / min(longest_mpm_timestep_s(body, VOXEL_M) for body in bodies) - 1e-9)
    # Genesis's defaults: 64 voxels per metre and points of 10 mm. Its default step of 10 ms does not divide the drive
    # interval, and one step in each interval is the longest that does.
    out_of_box = SettingsMPM(
        preset="out_of_box",
        timestep_s=DRIVE_INTERVAL_S,
        precision=32,
        cell_m=1 / 64,
        points_per_voxel_edge=1 / (64 * 0.01),
    )
    return {
        "default": SettingsFEM(preset="default", timestep_s=1 / 900),
        "mpm": SettingsMPM(preset="mpm", timestep_s=DRIVE_INTERVAL_S / steps),
        # The paper states 900 Hz, and that all other settings are defaults.
        "paper": out_of_box.model_copy(update={"preset": "paper", "timestep_s": 1 / 900}),
        "out_of_box": out_of_box,
    }


def longest_mpm_timestep_s(body: SoftBody, voxel_m: float) -> float:
    """Return the longest time step [s] of the explicit method: a share of the time of sound through a voxel."""
    return COURANT_LIMIT * sound_time_s(body, voxel_m)


def sound_time_s(body: SoftBody, voxel_m: float) -> float:
    """Return the time that sound takes through a voxel [s]: its edge over sqrt((lambda + 2 mu) / density)."""
    mu, lame = lame_constants(body)
    density = body.mass_kg / body.shape.volume_m3
    return voxel_m * sqrt(density / (lame + 2.0 * mu))
