"""Constants of a measured fabric in MuJoCo's two-dimensional flex. This mapping is the package's, not the paper's."""

import math

from gauge_envs.backends.fabric_constants import FabricConstants
from gauge_envs.scene.fabrics import Fabric

POISSON = 0.0
"""Poisson ratio; K_s is measured with free transverse edges, and contraction is not measured."""

SNIPPET = """\
<elasticity young="{young:.6g}" poisson="{poisson:.6g}" thickness="{thickness:.6g}" elastic2d="both"/>
<!-- MJCF states no shear stiffness: this flex has half of the stretch stiffness. -->
"""


def flex_constants(fabric: Fabric) -> FabricConstants:
    """Return the constants of MuJoCo's two-dimensional flex.

    One Young's modulus and one thickness determine both membrane and bending. Mass and collision radius are separate,
    so the thickness is free. With the plate bending stiffness D of `Fabric` and nu = 0,

    - `thickness` = sqrt(12 D (1 - nu^2) / K_s) [m], not the fabric's own,
    - `young` = K_s / thickness [Pa],
    - `poisson` = nu,

    so that young * thickness = K_s and young * thickness^3 / (12 (1 - nu^2)) = D. MuJoCo's XML has no constant for
    shear, so the shear stiffness of this flex would be K_s / 2. The compiled model, however, has a stiffness matrix for
    each triangle. The orthotropic membrane to write there, in the axes of the cloth, is

    - `membrane_warp` = `membrane_weft` = K_s, `membrane_shear` = K_sh [N/m], without coupling.

    This reproduces all three measured stiffnesses.
    """
    stretch = fabric.stretch_stiffness_n_per_m
    shear = fabric.shear_stiffness_n_per_m
    plate = fabric.bend_stiffness_n_m_per_rad
    thickness = math.sqrt(12.0 * plate * (1.0 - POISSON**2) / stretch)
    constants = {
        "young": stretch / thickness,
        "poisson": POISSON,
        "thickness": thickness,
        "membrane_warp": stretch,
        "membrane_weft": stretch,
        "membrane_shear": shear,
    }
    return FabricConstants(
        engine="mujoco",
        fabric=fabric,
        constants=constants,
        units={
            "young": "Pa",
            "poisson": "1",
            "thickness": "m",
            "membrane_warp": "N/m",
            "membrane_weft": "N/m",
            "membrane_shear": "N/m",
        },
        stretch_stiffness_n_per_m=stretch,
        shear_stiffness_n_per_m=shear,
        snippet=SNIPPET.format(**constants),
    )
