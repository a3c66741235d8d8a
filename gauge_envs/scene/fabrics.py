"""Measured constants of fabrics: stretch stiffness `K_s`, shear stiffness `K_sh` and bending stiffness `K_theta`."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

from gauge_envs.errors import ParameterError
from gauge_envs.scene.scene import GRAVITY_M_PER_S2


@dataclass(frozen=True, kw_only=True)
class Fabric:
    """Measured constants of a fabric, all positive.

    The bending stiffness D per width of a plate [N m] equals K_theta. Hinge lines, each a row of hinges of length l,
    divide a mesh into strips of width h. At a curvature kappa about these lines, every hinge rotates by kappa h, with a
    torque K_theta kappa h on its length l. The moment per length of a plate is D kappa, so D = K_theta h / l. On a
    square grid h = l, so D = K_theta for every mesh size. Diagonals do not change this: if the height varies along one
    grid axis only, the two triangles of a cell stay in one plane. At 45 degrees, equal hinges on all edges give 5/2 or
    1/2 of D, by the direction of the diagonals.

    Assumption: the published K_theta is the stiffness of each hinge of a square grid. No publication defines the hinge.
    Two facts support the assumption. Cantilever tests measure K_theta as a stiffness per width. With it, the six
    fabrics have bending lengths of 7 to 17 mm (`bending_length_m`), common for cloth.

    Attributes:
        stretch_stiffness_n_per_m: K_s, force per width over strain of a uniaxial test with free transverse edges.
        shear_stiffness_n_per_m: K_sh, force per width over engineering shear strain.
        bend_stiffness_n_m_per_rad: K_theta, torque over angle of a discrete bending hinge.
        thickness_m: Thickness.
        areal_density_kg_per_m2: Mass per area.
    """

    stretch_stiffness_n_per_m: float
    shear_stiffness_n_per_m: float
    bend_stiffness_n_m_per_rad: float
    thickness_m: float
    areal_density_kg_per_m2: float

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (math.isfinite(value) and value > 0.0):
                raise ParameterError(f"{name} = {value!r}: must be a positive number")

    @classmethod
    def of(cls, source: Any) -> Fabric:
        """Return the fabric of a cloth in a scene, or of its constants in a task file."""
        return cls(**{field.name: getattr(source, field.name) for field in fields(cls)})


def bending_length_m(fabric: Fabric) -> float:
    """Return the length at which weight and bending balance [m], (D / (areal density * g))^(1/3).

    It is about the width of folds, and half the overhang at which a strip droops to 41.5 degrees (ASTM D1388). A mesh
    with much larger cells cannot fold as the fabric does.
    """
    weight_n_per_m2 = fabric.areal_density_kg_per_m2 * GRAVITY_M_PER_S2
    return math.cbrt(fabric.bend_stiffness_n_m_per_rad / weight_n_per_m2)
