"""Constants of a measured fabric in Newton's vertex block descent."""

from gauge_envs.backends.fabric_constants import FabricConstants
from gauge_envs.scene.fabrics import Fabric

STRETCH_OVER_SHEAR = 2.7
"""K_s / K_sh if the measured ratio does not lie between 2 and 4 (paper)."""

SNIPPET = """\
builder.add_cloth_mesh(
    ...,
    density={density:.6g},
    tri_ke={tri_ke:.6g},
    tri_ka={tri_ka:.6g},
    edge_ke={edge_ke_times_mean_edge_length:.6g} / mean_edge_length,  # mean length of the edges of your mesh [m]
)
"""


def vbd_constants(fabric: Fabric) -> FabricConstants:
    """Return the constants of Newton's VBD cloth (stable Neo-Hookean membrane, two-dimensional Lame coefficients).

    - `tri_ke` = mu = K_sh [N/m].
    - `tri_ka` = lambda = 2 K_sh (K_s - 2 K_sh) / (4 K_sh - K_s) [N/m].
    - `edge_ke_times_mean_edge_length` = K_theta [N m/rad]; `edge_ke` is this over the mesh's mean rest edge length.

    lambda is positive and finite only for 2 < K_s / K_sh < 4; otherwise K_s / 2.7 replaces K_sh. This fallback keeps
    the stretch stiffness but not the shear stiffness. The stiffness of a hinge is proportional to its edge length. On a
    square grid with diagonals the paper's mean edge length gives 3 / (2 + sqrt 2) = 0.88 of the bending stiffness along
    grid lines, so the backend divides by the cell's edge instead.

    The membrane has the uniaxial stiffness 4 mu (lambda + mu) / (lambda + 2 mu) and the shear stiffness mu.

    Source: paper, equations of the Newton mapping.
    """
    stretch = fabric.stretch_stiffness_n_per_m
    shear = fabric.shear_stiffness_n_per_m
    fallbacks: tuple[str, ...] = ()
    if not 2.0 * shear < stretch < 4.0 * shear:
        reason = f"as K_s/K_sh = {stretch / shear:.3g} is not in (2, 4)"
        fallbacks = (f"tri_ke and tri_ka from K_s/{STRETCH_OVER_SHEAR}, {reason}",)
        shear = stretch / STRETCH_OVER_SHEAR
    lame = 2.0 * shear * (stretch - 2.0 * shear) / (4.0 * shear - stretch)
    constants = {
        "tri_ke": shear,
        "tri_ka": lame,
        "edge_ke_times_mean_edge_length": fabric.bend_stiffness_n_m_per_rad,
    }
    return FabricConstants(
        engine="newton",
        fabric=fabric,
        constants=constants,
        units={
            "tri_ke": "N/m",
            "tri_ka": "N/m",
            "edge_ke_times_mean_edge_length": "N m/rad",
        },
        stretch_stiffness_n_per_m=4.0 * shear * (lame + shear) / (lame + 2.0 * shear),
        shear_stiffness_n_per_m=shear,
        snippet=SNIPPET.format(density=fabric.areal_density_kg_per_m2, **constants),
        replaced=("tri_ke", "tri_ka") if fallbacks else (),
        fallbacks=fallbacks,
    )
