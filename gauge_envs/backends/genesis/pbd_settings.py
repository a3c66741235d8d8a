"""Settings and presets of Genesis's position-based dynamics (PBD), its solver of cloth."""

from __future__ import annotations

from collections.abc import Mapping
from math import ceil
from typing import Literal

from pydantic import Field, model_validator

from gauge_envs.backends.genesis.pbd_springs import longest_timestep_s
from gauge_envs.backends.genesis.settings import SettingsGenesis
from gauge_envs.backends.shared.cells import CellSize
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
