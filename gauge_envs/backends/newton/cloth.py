"""Cloth for Newton's VBD: a triangle mesh with a stable Neo-Hookean membrane and dihedral hinges."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import newton
import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from gauge_envs.backends.newton.pins import Pin
from gauge_envs.backends.shared.attachments import RigidAttachment
from gauge_envs.backends.shared.cloth_grid import ClothGrid, held_vertices
from gauge_envs.scene import Cloth, Motion
from gauge_envs.scene.fabrics import Fabric, newton_edge_ke, newton_vbd


class ClothPartNewton:
    """A cloth among the particles of a model.

    Attributes:
        name: Name of the cloth.
        rest_m: World positions of the vertices at the start [m], shape [vertex_count, 3]; y of the cloth runs fastest.
        triangles: Vertex indices within the cloth, shape [triangle_count, 3].
        particles: Its particles in the model.
        pins: Vertices that kinematic bodies hold, for `StepperVBD`.
    """

    def __init__(
        self,
        cloth: Cloth,
        *,
        rest_m: NDArray[np.float64],
        triangles: NDArray[np.intp],
        start: int,
        pins: Sequence[Pin],
    ) -> None:
        self.name = cloth.name
        self.rest_m = rest_m
        self.triangles = triangles
        self.particles = slice(start, start + len(rest_m))
        self.pins = tuple(pins)

    def nodes(self, state: newton.State) -> NDArray[np.float64]:
        """Return the world positions of the vertices in a state [m], shape [vertex_count, 3], in single precision."""
        return state.particle_q.numpy()[self.particles].astype(np.float64)

    def track(self, points_m: ArrayLike) -> None:
        """Return None, since interpolation between the nodes locates material points."""
        return None


def add_cloth(
    builder: newton.ModelBuilder,
    cloth: Cloth,
    *,
    attachments: Sequence[RigidAttachment] = (),
    bodies: Mapping[str, int] | None = None,
    cell_m: float,
    stretch_damping_n_s_per_m: float = 0.0,
    bend_damping_n_s: float = 0.0,
) -> ClothPartNewton:
    """Add a cloth to a model builder; `SurfaceContacts` determines its contacts.

    The mapping `scene.fabrics.newton_vbd` gives its constants. Attached vertices have no mass and are placed on their
    body. They are exact in single precision: 0.06 micrometres within 1 m of the origin.

    Args:
        builder: Model builder that contains the rigid bodies.
        cloth: The cloth.
        attachments: Attached regions; a vertex in two regions belongs to the first.
        bodies: Model index of each kinematic body that holds the cloth, by name.
        cell_m: Desired edge length of the cells [m]; the nearest length that divides a side is used.
        stretch_damping_n_s_per_m: Newton's `tri_kd`: viscosity of the membrane per rate of twice Green's strain.
        bend_damping_n_s: Newton's `edge_kd`: torque of a hinge per rate of its angle and per length.
    """
    grid = ClothGrid(cloth, cell_m)
    rest = cloth.pose.to_world(np.column_stack([grid.plane_m, np.zeros(len(grid.plane_m))]))
    held = held_vertices(grid, cloth, attachments)
    constants = newton_vbd(Fabric.of(cloth)).constants
    start = len(builder.particle_q)
    builder.add_cloth_mesh(
        pos=wp.vec3(0.0, 0.0, 0.0),
        rot=wp.quat_identity(),
        scale=1.0,
        vel=wp.vec3(0.0, 0.0, 0.0),
        vertices=[wp.vec3(*point) for point in rest],
        indices=grid.triangles.ravel().tolist(),
        density=cloth.areal_density_kg_per_m2,
        tri_ke=constants["tri_ke"],
        tri_ka=constants["tri_ka"],
        tri_kd=stretch_damping_n_s_per_m,
        edge_ke=newton_edge_ke(
            bend_stiffness_n_m_per_rad=constants["edge_ke_times_mean_edge_length"],
            mean_edge_length_m=grid.mean_edge_length_m(),
        ),
        edge_kd=bend_damping_n_s,
        particle_radius=0.5 * cloth.thickness_m,
        label=cloth.name,
    )
    masses = cloth.areal_density_kg_per_m2 * grid.vertex_areas_m2()
    masses[list(held)] = 0.0
    builder.particle_mass[start : start + len(rest)] = masses.tolist()
    pins = [
        Pin(
            particle=start + index,
            body=(bodies or {})[attachment.body],
            place_m=tuple(attachment.pose.to_body(rest[index]).tolist()),
        )
        for index, attachment in held.items()
        if attachment.motion is Motion.KINEMATIC
    ]
    return ClothPartNewton(cloth, rest_m=rest, triangles=grid.triangles, start=start, pins=pins)
