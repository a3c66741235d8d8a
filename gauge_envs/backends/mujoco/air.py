"""Air on the cloth of a MuJoCo model: the law of `gauge_envs.scene.air`, once in each step.

MuJoCo's own fluid model acts on rigid bodies by their boxes of inertia, and not on a flex.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from gauge_envs.backends.mujoco.cloth import ClothPartMuJoCo
from gauge_envs.errors import ParameterError
from gauge_envs.scene import Air, Scene


class AirOnCloth:
    """Forces of the air on one cloth, as generalized forces on its free vertices.

    A vertex takes the share of each triangle that `ClothGrid.triangle_shares` gives it, and the velocity of a triangle
    is the mean of its corners with the same shares. So the power of a vertex's forces is that of the triangles', and a
    uniform wind accelerates a flat sheet uniformly. The bodies to which a cloth is attached are fixed or driven, so the
    air on attached vertices moves nothing and is left out.

    Args:
        air: The air.
        part: The cloth, bound to the model.
        data: MuJoCo's state.
    """

    def __init__(self, air: Air, part: ClothPartMuJoCo, data: mujoco.MjData) -> None:
        self._air = air
        self._points = part.points
        triangles = part.grid.triangles
        self._first, self._second, self._third = triangles.T
        columns = np.repeat(np.arange(len(triangles)), 3)
        shares = (part.grid.triangle_shares().ravel(), (triangles.ravel(), columns))
        self._to_vertices = csr_array(shares, shape=(len(part.rest_m), len(triangles)))
        self._to_triangles = csr_array(self._to_vertices.T)
        self._to_free = csr_array(self._to_vertices[self._points.free])
        self._forces = data.qfrc_applied

    def triangle_forces_n(self) -> NDArray[np.float64]:
        """Return the forces on the triangles in the current state [N], shape [triangle_count, 3]."""
        places = self._points.positions()
        corner = places[self._first]
        areas = 0.5 * _cross(places[self._second] - corner, places[self._third] - corner)
        return self._air.forces_n(areas, self._to_triangles @ self._points.velocities())

    def apply(self) -> None:
        """Write the forces of the current state, which act during the next step."""
        self._forces[self._points.dofs] = self._to_free @ self.triangle_forces_n()


def check_air_step(scene: Scene, parts: list[ClothPartMuJoCo], timestep_s: float) -> None:
    """Raise an error if the explicit forces of the air could overshoot in a step.

    Args:
        scene: A scene with air.
        parts: Its cloth.
        timestep_s: Step of the simulation [s].
    """
    assert scene.air is not None
    fastest = scene.speed_limit_m_per_s + float(np.linalg.norm(scene.air.wind_m_per_s))
    for part in parts:
        density = part.cloth.areal_density_kg_per_m2
        stable = scene.air.stable_speed_m_per_s(areal_density_kg_per_m2=density, timestep_s=timestep_s)
        if fastest > stable:
            raise ParameterError(
                f"air on cloth {part.name!r}: steps of {timestep_s:.3g} s are stable up to {stable:.3g} m/s relative "
                f"to the air, and the scene allows {fastest:.3g} m/s: reduce timestep_s to "
                f"{timestep_s * stable / fastest:.3g} s or less, or reduce the density or the coefficients of the air"
            )


def _cross(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return cross products, shape [count, 3]; `numpy.cross` takes three times as long on short arrays."""
    product = np.empty_like(first)
    for axis, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        np.subtract(first[:, i] * second[:, j], first[:, j] * second[:, i], out=product[:, axis])
    return product
