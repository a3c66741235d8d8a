"""Mappings of calibrated fabric constants to the constants of each engine, with their fallbacks and losses.

A fabric is measured as a stretch stiffness `K_s`, a shear stiffness `K_sh` and a bending stiffness `K_theta`. Each
engine has another membrane and another hinge. The mappings match the response at small strain (paper, section "Textile
parameters mapping"). Conversely, `uniaxial_stiffness` and `shear_stiffness` return the stiffness that a test of the
mapped fabric would measure. The paper has no mapping for MuJoCo; that mapping belongs to this package.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any

from gauge_envs.errors import ParameterError
from gauge_envs.scene.scene import GRAVITY_M_PER_S2

ISAAC_POISSON_BELOW = 0.30
"""Poisson ratio in Isaac if the measured stiffnesses correspond to a negative one (paper)."""
ISAAC_POISSON_ABOVE = 0.45
"""Poisson ratio in Isaac if the measured stiffnesses correspond to 0.5 or more (paper)."""
NEWTON_RATIO = 2.7
"""K_s / K_sh in Newton if the measured ratio does not lie between 2 and 4 (paper)."""
MUJOCO_POISSON = 0.0
"""Poisson ratio in MuJoCo; K_s is measured with free transverse edges, and contraction is not measured."""


@dataclass(frozen=True, kw_only=True)
class Fabric:
    """Measured constants of a fabric, all positive.

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
        for field in fields(self):
            _check_positive(field.name, getattr(self, field.name))

    @classmethod
    def of(cls, source: Any) -> Fabric:
        """Return the fabric of a cloth in a scene, or of the constants of one in a task file."""
        return cls(**{field.name: getattr(source, field.name) for field in fields(cls)})


@dataclass(frozen=True, kw_only=True)
class EngineConstants:
    """Constants of a fabric in one engine.

    Attributes:
        engine: Key in `MAPPINGS`.
        fabric: The measured fabric.
        constants: Constants under the engine's names.
        units: Unit of each constant; "1" for a pure number.
        replaced: Names of the constants that a fallback sets.
        fallbacks: Description of each fallback and its reason.
        lost: Description of each measured stiffness that the engine does not reproduce, with its error.
    """

    engine: str
    fabric: Fabric
    constants: dict[str, float]
    units: dict[str, str]
    replaced: tuple[str, ...] = ()
    fallbacks: tuple[str, ...] = ()
    lost: tuple[str, ...] = ()


# --- mappings --------------------------------------------------------------------------------------------------------


def isaac_surface(fabric: Fabric) -> EngineConstants:
    """Return the constants of Isaac Sim's surface deformable (PhysX FEM, an isotropic sheet under plane stress).

    - `youngs_modulus` = K_s / t [Pa].
    - `poissons_ratio` = K_s / (2 K_sh) - 1; 0.30 if that is negative, 0.45 if it is 0.5 or more. A fallback keeps the
      stretch stiffness but not the shear stiffness.
    - `surfaceBendStiffness` = K_theta / (4 t^3) [Pa]. A hinge's stiffness in PhysX is this times t^3 times edge length
      over a third of the mean height of its two triangles (Grinspun 2003): 3 on the legs of a square grid with
      diagonals, 6 on the diagonals, 4 in the mean over edges. Along grid lines, where diagonals do not fold, such a
      sheet has 3/4 of the intended bending stiffness.

    Source: paper, equations of the Isaac Sim mapping.
    """
    youngs_modulus = fabric.stretch_stiffness_n_per_m / fabric.thickness_m
    measured = fabric.stretch_stiffness_n_per_m / (2.0 * fabric.shear_stiffness_n_per_m) - 1.0
    poissons_ratio = measured
    fallbacks: tuple[str, ...] = ()
    if not 0.0 <= measured < 0.5:
        poissons_ratio = ISAAC_POISSON_BELOW if measured < 0.0 else ISAAC_POISSON_ABOVE
        bound = "negative" if measured < 0.0 else "0.5 or more"
        fallbacks = (f"poissons_ratio {poissons_ratio:.2f}, as K_s/(2 K_sh) - 1 = {measured:.3g} is {bound}",)
    return _mapped(
        "isaac",
        fabric,
        {
            "youngs_modulus": (youngs_modulus, "Pa"),
            "poissons_ratio": (poissons_ratio, "1"),
            "surfaceBendStiffness": (fabric.bend_stiffness_n_m_per_rad / (4.0 * fabric.thickness_m**3), "Pa"),
        },
        replaced=("poissons_ratio",) if fallbacks else (),
        fallbacks=fallbacks,
    )


def genesis_pbd(fabric: Fabric) -> EngineConstants:
    """Return the constants of Genesis's PBD cloth (distance and dihedral constraints).

    - `stretch_compliance` = 1 / K_s [m/N], of each mesh edge.
    - `bending_compliance` = 1 / K_theta [rad/(N m)], of each hinge.

    There is no shear constant. These constants are nominal: the behaviour of the cloth also depends on mesh, substep,
    relaxation and number of iterations. Converged springs on a square grid with diagonals would have K_s along grid
    lines, and K_s / 2 in shear at fixed extension.

    Source: paper, equation of the Genesis mapping.
    """
    return _mapped(
        "genesis",
        fabric,
        {
            "stretch_compliance": (1.0 / fabric.stretch_stiffness_n_per_m, "m/N"),
            "bending_compliance": (1.0 / fabric.bend_stiffness_n_m_per_rad, "rad/(N m)"),
        },
        has_shear_constant=False,
    )


def newton_vbd(fabric: Fabric) -> EngineConstants:
    """Return the constants of Newton's VBD cloth (stable Neo-Hookean membrane, two-dimensional Lame coefficients).

    - `tri_ke` = mu = K_sh [N/m].
    - `tri_ka` = lambda = 2 K_sh (K_s - 2 K_sh) / (4 K_sh - K_s) [N/m].
    - `edge_ke_times_mean_edge_length` = K_theta [N m/rad]; `newton_edge_ke` divides by the mesh's mean edge length.

    lambda is positive and finite only for 2 < K_s / K_sh < 4; otherwise K_s / 2.7 replaces K_sh. This fallback keeps
    the stretch stiffness but not the shear stiffness. The stiffness of a hinge is proportional to its edge length, so a
    square grid with diagonals has 3 / (2 + sqrt 2) = 0.88 of the intended bending stiffness along grid lines.

    Source: paper, equations of the Newton mapping.
    """
    stretch, shear = fabric.stretch_stiffness_n_per_m, fabric.shear_stiffness_n_per_m
    fallbacks: tuple[str, ...] = ()
    if not 2.0 * shear < stretch < 4.0 * shear:
        fallbacks = (
            f"tri_ke and tri_ka from K_s/{NEWTON_RATIO}, as K_s/K_sh = {stretch / shear:.3g} is not in (2, 4)",
        )
        shear = stretch / NEWTON_RATIO
    return _mapped(
        "newton",
        fabric,
        {
            "tri_ke": (shear, "N/m"),
            "tri_ka": (2.0 * shear * (stretch - 2.0 * shear) / (4.0 * shear - stretch), "N/m"),
            "edge_ke_times_mean_edge_length": (fabric.bend_stiffness_n_m_per_rad, "N m/rad"),
        },
        replaced=("tri_ke", "tri_ka") if fallbacks else (),
        fallbacks=fallbacks,
    )


def mujoco_flex(fabric: Fabric) -> EngineConstants:
    """Return the constants of MuJoCo's two-dimensional flex.

    One Young's modulus and one thickness determine both membrane and bending. Mass and collision radius are separate,
    so the thickness is free. With the plate bending stiffness D of `plate_bending_stiffness` and nu = 0,

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
    plate = plate_bending_stiffness(hinge_stiffness_n_m_per_rad=fabric.bend_stiffness_n_m_per_rad)
    thickness = math.sqrt(12.0 * plate * (1.0 - MUJOCO_POISSON**2) / stretch)
    return _mapped(
        "mujoco",
        fabric,
        {
            "young": (stretch / thickness, "Pa"),
            "poisson": (MUJOCO_POISSON, "1"),
            "thickness": (thickness, "m"),
            "membrane_warp": (stretch, "N/m"),
            "membrane_weft": (stretch, "N/m"),
            "membrane_shear": (fabric.shear_stiffness_n_per_m, "N/m"),
        },
    )


MAPPINGS: dict[str, Callable[[Fabric], EngineConstants]] = {
    "isaac": isaac_surface,
    "genesis": genesis_pbd,
    "newton": newton_vbd,
    "mujoco": mujoco_flex,
}
"""Mapping of each engine."""


def _mapped(
    engine: str,
    fabric: Fabric,
    entries: Mapping[str, tuple[float, str]],
    *,
    replaced: tuple[str, ...] = (),
    fallbacks: tuple[str, ...] = (),
    has_shear_constant: bool = True,
) -> EngineConstants:
    """Return the constants with units and the error of the engine's shear stiffness."""
    constants = {name: value for name, (value, _) in entries.items()}
    shear, measured = _MEMBRANES[engine](constants, fabric.thickness_m)[1], fabric.shear_stiffness_n_per_m
    lost: tuple[str, ...] = ()
    if not (has_shear_constant and math.isclose(shear, measured, rel_tol=1e-9)):
        why = "" if has_shear_constant else "no such constant, "
        lost = (f"shear: {why}{shear:.4g} N/m instead of {measured:.4g} ({shear / measured - 1.0:+.0%})",)
    units = {name: unit for name, (_, unit) in entries.items()}
    return EngineConstants(
        engine=engine,
        fabric=fabric,
        constants=constants,
        units=units,
        replaced=replaced,
        fallbacks=fallbacks,
        lost=lost,
    )


# --- bending ---------------------------------------------------------------------------------------------------------


def plate_bending_stiffness(*, hinge_stiffness_n_m_per_rad: float, spacing_over_length: float = 1.0) -> float:
    """Return the bending stiffness per width of a mesh of hinges that bends along grid lines [N m].

    Hinge lines, each a row of hinges of length l, divide the mesh into strips of width h. At a curvature kappa about
    these lines, every hinge rotates by kappa h, with a torque K_theta kappa h on its length l. The moment per length of
    a plate is D kappa, so D = K_theta h / l. On a square grid h = l, so D = K_theta for every mesh size. Diagonals do
    not change this, because the two triangles of a cell stay in one plane if height varies along one grid axis only.
    Diagonals matter for other directions: at 45 degrees, equal hinges on all edges give 5/2 or 1/2 of D, depending on
    the direction of the diagonals.

    Assumption: the calibrated K_theta is the stiffness of each hinge of a square grid, so it equals D. No publication
    defines its hinge. Two facts support the assumption: cantilever tests, which measure K_theta, give a stiffness per
    width, and with it the six fabrics have bending lengths of 7 to 17 mm (`bending_length_m`), common for cloth.

    Args:
        hinge_stiffness_n_m_per_rad: K_theta, torque over angle of one hinge.
        spacing_over_length: h / l, distance between hinge lines over the length of a hinge.
    """
    _check_positive("hinge_stiffness_n_m_per_rad", hinge_stiffness_n_m_per_rad)
    _check_positive("spacing_over_length", spacing_over_length)
    return hinge_stiffness_n_m_per_rad * spacing_over_length


def newton_edge_ke(*, bend_stiffness_n_m_per_rad: float, mean_edge_length_m: float) -> float:
    """Return Newton's `edge_ke` [N/rad], K_theta over the mean rest edge length (paper, Newton's bending)."""
    _check_positive("bend_stiffness_n_m_per_rad", bend_stiffness_n_m_per_rad)
    _check_positive("mean_edge_length_m", mean_edge_length_m)
    return bend_stiffness_n_m_per_rad / mean_edge_length_m


def bending_length_m(fabric: Fabric) -> float:
    """Return the length at which weight and bending balance [m], (D / (areal density * g))^(1/3).

    It is about the width of folds, and half the overhang at which a strip droops to 41.5 degrees (ASTM D1388). A much
    coarser mesh cannot fold as the fabric does.
    """
    plate = plate_bending_stiffness(hinge_stiffness_n_m_per_rad=fabric.bend_stiffness_n_m_per_rad)
    return math.cbrt(plate / (fabric.areal_density_kg_per_m2 * GRAVITY_M_PER_S2))


# --- stiffness of the mapped fabric ----------------------------------------------------------------------------------


def uniaxial_stiffness(mapped: EngineConstants) -> float:
    """Return force per width over strain of the mapped fabric at small strain, transverse edges free [N/m].

    - isaac: E t.
    - genesis: 1 / stretch_compliance, along grid lines of converged springs; nominal.
    - newton: 4 mu (lambda + mu) / (lambda + 2 mu).
    - mujoco: the warp stiffness.
    """
    return _MEMBRANES[mapped.engine](mapped.constants, mapped.fabric.thickness_m)[0]


def shear_stiffness(mapped: EngineConstants) -> float:
    """Return force per width over engineering shear strain of the mapped fabric at small strain [N/m].

    - isaac: E t / (2 (1 + nu)).
    - genesis: 1 / (2 stretch_compliance), from the diagonals of a square grid of converged springs; nominal.
    - newton: mu.
    - mujoco: the shear stiffness of the orthotropic membrane.
    """
    return _MEMBRANES[mapped.engine](mapped.constants, mapped.fabric.thickness_m)[1]


_MEMBRANES: dict[str, Callable[[Mapping[str, float], float], tuple[float, float]]] = {
    "isaac": lambda c, t: (c["youngs_modulus"] * t, c["youngs_modulus"] * t / (2.0 * (1.0 + c["poissons_ratio"]))),
    # A diagonal of length sqrt(2) h in a cell of area h^2 extends by gamma h / sqrt(2): energy K gamma^2 / 4 per area.
    "genesis": lambda c, t: (1.0 / c["stretch_compliance"], 0.5 / c["stretch_compliance"]),
    "newton": lambda c, t: (
        4.0 * c["tri_ke"] * (c["tri_ka"] + c["tri_ke"]) / (c["tri_ka"] + 2.0 * c["tri_ke"]),
        c["tri_ke"],
    ),
    "mujoco": lambda c, t: (c["membrane_warp"], c["membrane_shear"]),
}
"""Uniaxial and shear stiffness [N/m] of each engine's membrane, from its constants and the thickness [m]."""


def _check_positive(name: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0.0):
        raise ParameterError(f"{name} = {value!r}: must be a positive number")
