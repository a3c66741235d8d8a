"""Air around cloth: drag and lift on each triangle of its mesh.

The law is quasi-steady: the force depends only on the present velocity of a triangle relative to the air,
u = v - wind. n is the unit normal of the triangle (either side), A its area, and rho the density of the air. With
u_n = u . n and u_t = u - u_n n:

    pressure    -1/2 rho A C_n |u_n| u_n n
    friction    -1/2 rho A C_t |u_t| u_t
    lift        -1/2 rho A C_l (|u| u_n n - u_n^2 u / |u|)

Pressure and friction are the normal and tangential forces of Wejchert and Haumann ("Animation aerodynamics", SIGGRAPH
1991), here quadratic in the speed. The lift is perpendicular to u. Its size is 1/2 rho A C_l |u|^2 sin(a) cos(a), where
a is the angle between u and the plane of the triangle. For small angles this is a flat plate with the lift slope C_l.
No part does positive work on the motion relative to the air.

The cloth does not move the air: there is no added mass and no wake, and no triangle shields another one.
"""

import math
from dataclasses import dataclass

import numpy as np

from gauge_envs.scene.geometry import FloatArray, NonNegative, Positive, Vector


@dataclass(frozen=True, kw_only=True)
class Air:
    """Air of uniform density that acts on the cloth of a scene by the law of this module.

    Attributes:
        density_kg_per_m3: Density rho [kg/m^3].
        normal_coefficient: C_n, pressure drag of a plate that moves along its normal.
        tangential_coefficient: C_t, skin friction of both sides of a plate that moves in its own plane.
        lift_coefficient: C_l, slope of the lift over the angle of incidence [1/rad].
        wind_m_per_s: Velocity of the air [m/s], in the world frame.
    """

    density_kg_per_m3: Positive
    normal_coefficient: NonNegative
    tangential_coefficient: NonNegative = 0.0
    lift_coefficient: NonNegative = 0.0
    wind_m_per_s: Vector = (0.0, 0.0, 0.0)

    def forces_n(
        self, areas_m2: FloatArray, velocities_m_per_s: FloatArray
    ) -> FloatArray:
        """Return the forces on triangles [N], shape [triangle_count, 3].

        Args:
            areas_m2: Vector areas: area times unit normal, of either sign [m^2], shape [triangle_count, 3].
            velocities_m_per_s: Velocities of the triangles [m/s], shape [triangle_count, 3].
        """
        moving = velocities_m_per_s - np.asarray(self.wind_m_per_s)
        area = np.sqrt(np.einsum("ij,ij->i", areas_m2, areas_m2))
        normal = areas_m2 / np.maximum(area, np.finfo(np.float64).tiny)[:, None]
        along = np.einsum("ij,ij->i", moving, normal)
        speed = np.sqrt(np.einsum("ij,ij->i", moving, moving))
        tangential = moving - along[:, None] * normal
        sliding = np.sqrt(np.einsum("ij,ij->i", tangential, tangential))
        turned = np.divide(along**2, speed, out=np.zeros_like(speed), where=speed > 0.0)
        on_normal = (
            self.normal_coefficient * np.abs(along) + self.lift_coefficient * speed
        ) * along
        force = on_normal[:, None] * normal
        force += (self.tangential_coefficient * sliding)[:, None] * tangential
        force -= (self.lift_coefficient * turned)[:, None] * moving
        return np.asarray((-0.5 * self.density_kg_per_m3 * area)[:, None] * force)

    def stable_speed_m_per_s(
        self, *, areal_density_kg_per_m2: float, timestep_s: float
    ) -> float:
        """Return the largest relative speed at which explicit steps do not overshoot [m/s].

        The force changes with the speed at the rate rho C |u| A. An explicit step keeps the sign of a deviation while
        the rate times the step over the mass is at most 1. C is the larger drag coefficient plus the lift coefficient,
        an upper bound in all directions.

        Args:
            areal_density_kg_per_m2: Mass per area of the cloth [kg/m^2].
            timestep_s: Step of the engine [s].
        """
        largest = (
            max(self.normal_coefficient, self.tangential_coefficient)
            + self.lift_coefficient
        )
        if largest == 0.0:
            return math.inf
        return areal_density_kg_per_m2 / (self.density_kg_per_m3 * largest * timestep_s)
