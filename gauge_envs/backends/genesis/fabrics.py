"""Constants of a measured fabric in Genesis's position-based dynamics."""

from gauge_envs.backends.fabric_constants import FabricConstants
from gauge_envs.scene.fabrics import Fabric

SNIPPET = """\
material = gs.materials.PBD.Cloth(rho={density:.6g}, stretch_compliance={stretch_compliance:.6g}, \
bending_compliance={bending_compliance:.6g})
"""


def pbd_constants(fabric: Fabric) -> FabricConstants:
    """Return the constants of Genesis's PBD cloth (distance and dihedral constraints).

    - `stretch_compliance` = 1 / K_s [m/N], of each mesh edge.
    - `bending_compliance` = 1 / K_theta [rad/(N m)], of each hinge.

    There is no shear constant. These constants are nominal: the behaviour of the cloth also depends on mesh, substep,
    relaxation and number of iterations. Converged springs on a square grid with diagonals would have K_s along grid
    lines, and K_s / 2 in shear at fixed extension. A diagonal of length sqrt(2) h in a cell of area h^2 extends by
    gamma h / sqrt(2) and stores an energy of K gamma^2 / 4 per area.

    The backend's default uses other springs, which no constant of `PBD.Cloth` expresses. These constants are for the
    engine's own defaults.

    Source: paper, equation of the Genesis mapping.
    """
    stretch_compliance = 1.0 / fabric.stretch_stiffness_n_per_m
    constants = {
        "stretch_compliance": stretch_compliance,
        "bending_compliance": 1.0 / fabric.bend_stiffness_n_m_per_rad,
    }
    return FabricConstants(
        engine="genesis",
        fabric=fabric,
        constants=constants,
        units={"stretch_compliance": "m/N", "bending_compliance": "rad/(N m)"},
        stretch_stiffness_n_per_m=1.0 / stretch_compliance,
        shear_stiffness_n_per_m=0.5 / stretch_compliance,
        snippet=SNIPPET.format(density=fabric.areal_density_kg_per_m2, **constants),
        has_shear_constant=False,
        settings={"preset": "out_of_box"},
    )
