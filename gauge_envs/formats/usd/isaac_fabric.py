"""Constants of a measured fabric in Isaac Sim's surface deformable, which layers carry."""

from gauge_envs.backends.fabric_constants import FabricConstants
from gauge_envs.scene.fabrics import Fabric

POISSON_BELOW = 0.30
"""Poisson ratio if the measured stiffnesses correspond to a negative one (paper)."""

POISSON_ABOVE = 0.45
"""Poisson ratio if the measured stiffnesses correspond to 0.5 or more (paper)."""


def surface_constants(fabric: Fabric) -> FabricConstants:
    """Return the constants of Isaac Sim's surface deformable (PhysX FEM, an isotropic sheet under plane stress).

    - `youngs_modulus` = K_s / t [Pa].
    - `poissons_ratio` = K_s / (2 K_sh) - 1; 0.30 if that is negative, 0.45 if it is 0.5 or more. A fallback keeps the
      stretch stiffness but not the shear stiffness.
    - `surfaceBendStiffness` = K_theta / (4 t^3) [Pa]. A hinge's stiffness in PhysX is this times t^3 times edge length
      over a third of the mean height of its two triangles (Grinspun 2003): 3 on the legs of a square grid with
      diagonals, 6 on the diagonals, 4 in the mean over edges. Along grid lines, where diagonals do not fold, such a
      sheet has 3/4 of the intended bending stiffness.

    The sheet has the uniaxial stiffness E t and the shear stiffness E t / (2 (1 + nu)).

    Source: paper, equations of the Isaac Sim mapping.
    """
    thickness = fabric.thickness_m
    youngs_modulus = fabric.stretch_stiffness_n_per_m / thickness
    measured = (
        fabric.stretch_stiffness_n_per_m / (2.0 * fabric.shear_stiffness_n_per_m) - 1.0
    )
    poissons_ratio = measured
    bound = ""
    if measured < 0.0:
        poissons_ratio, bound = POISSON_BELOW, "negative"
    elif measured >= 0.5:
        poissons_ratio, bound = POISSON_ABOVE, "0.5 or more"
    fallback = f"poissons_ratio {poissons_ratio:.2f}, as K_s/(2 K_sh) - 1 = {measured:.3g} is {bound}"
    stretch_stiffness = youngs_modulus * thickness
    return FabricConstants(
        engine="isaac",
        fabric=fabric,
        constants={
            "youngs_modulus": youngs_modulus,
            "poissons_ratio": poissons_ratio,
            "surfaceBendStiffness": fabric.bend_stiffness_n_m_per_rad
            / (4.0 * thickness**3),
        },
        units={
            "youngs_modulus": "Pa",
            "poissons_ratio": "1",
            "surfaceBendStiffness": "Pa",
        },
        stretch_stiffness_n_per_m=stretch_stiffness,
        shear_stiffness_n_per_m=stretch_stiffness / (2.0 * (1.0 + poissons_ratio)),
        replaced=("poissons_ratio",) if bound else (),
        fallbacks=(fallback,) if bound else (),
    )
