"""Cloth: start, clamp, stretch, shear and bending stiffness, contact and air. The recipes of fabrics use its strips.

Strains are at most 1 %, or slopes 0.1, so that differences between laws of large strain do not matter. In tension the
fit ignores nodes within one width of the clamp, which hinders contraction.
"""

import math
from dataclasses import replace
from typing import Literal

import numpy as np

from gauge_envs.fixtures.parts import contact, driven_box, driver, fixed_box, ramp
from gauge_envs.fixtures.recording import Recording
from gauge_envs.scene import GRAVITY_M_PER_S2 as G, Air, Pose, Region, Scene
from gauge_envs.scene.fabrics import Fabric
from gauge_envs.scene.geometry import vector
from gauge_envs.scoring.estimators import acceleration_m_per_s2, slide_friction
from gauge_envs.tools.conformance.deformable import (
    ATTACHED,
    FRAME,
    LEVEL,
    LEVEL_M,
    PLACE_TOLERANCE_M,
    REST,
    START,
    STRIKE,
    Equilibrium,
    also_attached,
    attachment_error,
    clamped,
    coefficient,
    droop,
    equilibrium,
    fabric,
    momentum_ratio,
    rest_error,
    sheet,
    side_by_side,
    start_error,
    stiffness,
    worst_law,
)
from gauge_envs.tools.conformance.lab import Lab, Measurement, ratio
from gauge_envs.tools.conformance.model import Checks, Level, Tolerance

check = Checks(Level.CLOTH)


LIGHT_FABRIC = fabric(0.2, 110.0, 1e-4)
"""Fabric of sheets whose stiffness does not matter."""

SHEETS = tuple(
    replace(sheet(made_of, LEVEL, size_m), name=f"sheet {number}")
    for number, (made_of, size_m) in enumerate(
        (
            (fabric(0.2, 110.0, 1e-4, 2e-3), (0.1, 0.1)),
            (fabric(0.4, 80.0, 1e-4, 6e-3), (0.15, 0.1)),
            (fabric(0.1, 150.0, 1e-4, 1.2e-2), (0.1, 0.13)),
        )
    )
)
"""Sheets of different fabrics, thicknesses and sizes."""


@check("cloth-start", title="cloth, start", **START)
def _cloth_start(lab: Lab) -> Measurement:
    """Three sheets of cloth of different sizes, at three places and orientations.

    Largest distance of the box of the nodes of a sheet at the start, in its frame, from the sheet's edges.

    Source: contract (Simulation.nodes).
    """
    return start_error(lab, SHEETS)


# --- stiffness -------------------------------------------------------------------------------------------------------


Axis = Literal["x", "y"]


HANG_M, HANG_WIDTH_M = 0.3, 0.075
HANG_SETTLED_S, HANG_S = 0.2, 0.75


def hanging_strip(made_of: Fabric, depth_m: float = 0.0, *, axis: Axis = "x") -> Scene:
    """Return a strip of 0.3 m by 0.075 m that hangs from its upper edge or a part of its length.

    Args:
        made_of: The fabric.
        depth_m: Length that is clamped [m].
        axis: Axis that points up: x, the warp, or y, the weft.
    """
    euler_deg = (0.0, -90.0, 0.0) if axis == "x" else (90.0, 0.0, 0.0)
    pose = Pose.from_euler_deg(LEVEL.position_m, euler_deg)
    size_m = (HANG_M, HANG_WIDTH_M)
    cloth = sheet(made_of, pose, size_m if axis == "x" else size_m[::-1])
    region = Region(axis=axis, side="high", depth_m=depth_m)
    return clamped(cloth, region, duration_s=HANG_S)


def stretch_stiffness(hung: Equilibrium) -> Measurement:
    """Measure K_s [N/m] from the sag of a strip, a width or more from its clamp: u = rho g (L s - s^2/2) / K_s."""
    cloth = hung.body
    s = 0.5 * HANG_M - hung.rest_m[:, int(np.argmax(cloth.size_m))]
    free = s > hung.depth_m + HANG_WIDTH_M - PLACE_TOLERANCE_M
    columns = ((HANG_M * s - 0.5 * s**2)[free], np.ones(free.sum()))
    load = cloth.areal_density_kg_per_m2 * hung.gravity_m_per_s2
    slope = coefficient(-hung.moved_m[free, 2], *columns)
    return stiffness(load, slope, cloth.stretch_stiffness_n_per_m)


DEPTHS_M = (0.041, 0.028, 0.053)
"""Depths of three clamps: with cells of 25 mm, an error by 1.25 or 0.8 holds another line of nodes of some strip."""


def _hanging(lab: Lab) -> Recording:
    strong, weak = fabric(2.4, 1250.0, 2e-4), fabric(0.5, 300.0, 2e-4)
    first, second, third = DEPTHS_M
    scenes = (
        hanging_strip(LIGHT_FABRIC, first),
        hanging_strip(strong, second, axis="y"),
        hanging_strip(weak, third),
    )
    return lab.rollout(side_by_side(scenes, HANG_S - HANG_SETTLED_S))


@check("cloth-pinned-edge", title="cloth, clamps follow their driven body", **ATTACHED)
def _cloth_pinned_edge(lab: Lab) -> Measurement:
    """Three strips of cloth that hang from 41, 28 and 53 mm on a frame, which moves up with 2 m/s and then turns.

    Largest distance of an attached node from its place on the frame, or of a deeper node that keeps its place from
    the clamp.

    Source: contract (scene.Attachment, scene.Region).
    """
    return attachment_error(lab.once(_hanging))


@check(
    "cloth-stretch",
    title="cloth, stretch stiffness K_s",
    law="u(s) = rho g (L s - s^2 / 2) / K_s",
    tolerance=Tolerance(
        "laws differ by the largest strain: 0.5 % in equilibrium, 1 % at the lowest point",
        relative=0.02,
    ),
    cause="K_s is not 4 mu (lambda + mu) / (lambda + 2 mu), the nodes lack mass, or the solver does not converge",
)
def _cloth_stretch(lab: Lab) -> Measurement:
    """Three strips of three fabrics, 0.3 m by 0.075 m, that hang on a frame at rest, which then moves up with 2 m/s.

    K_s from the mean sag, at rest and on the moving frame, over that of the scene; the worst.

    Source: uniaxial tension with free transverse edges (scene.Cloth).
    """
    rollout = lab.once(_hanging)
    return worst_law(rollout, stretch_stiffness, "K_s", HANG_SETTLED_S, HANG_S)


SPAN_M, HEIGHT_M = 0.1, 0.4
SHEAR_SETTLED_S, SHEAR_S = 0.15, 0.6


def upright_sheet(made_of: Fabric) -> Scene:
    """Return an upright sheet between two clamped upright edges: sag 0.3 mm, largest shear 1.2 %, period 31 ms.

    Far from the upper and lower edge there is shear, and neither bending nor stretch. A bending stiffness of
    rho g L^3 / 177 (shear buckling of a clamped strip) prevents wrinkles; the sheets have 3.6 times that value. A
    larger stiffness would add D (pi / L)^2, here 0.5 %, to the shear of engines whose bending is a quadratic form in
    all coordinates.
    """
    pose = Pose.from_euler_deg(LEVEL.position_m, (90.0, 0.0, 0.0))
    edges = (Region(axis="x", side="low"), Region(axis="x", side="high"))
    return clamped(sheet(made_of, pose, (SPAN_M, HEIGHT_M)), *edges, duration_s=SHEAR_S)


def shear_stiffness(hung: Equilibrium) -> Measurement:
    """Measure K_sh [N/m] from the sag of an upright sheet at middle height: w = rho g (L s - s^2) / (2 K_sh)."""
    inside = np.abs(hung.rest_m[:, :2]) - (0.5 * SPAN_M, 0.5 * HEIGHT_M - SPAN_M)
    free = (inside < (-PLACE_TOLERANCE_M, PLACE_TOLERANCE_M)).all(axis=1)
    s = 0.5 * SPAN_M + hung.rest_m[free, 0]
    slope = coefficient(-hung.moved_m[free, 2], 0.5 * (SPAN_M * s - s**2))
    load = hung.body.areal_density_kg_per_m2 * hung.gravity_m_per_s2
    return stiffness(load, slope, hung.body.shear_stiffness_n_per_m)


@check(
    "cloth-shear",
    title="cloth, shear stiffness K_sh",
    law="w(s) = rho g (L s - s^2) / (2 K_sh)",
    tolerance=Tolerance(
        "free edges and the mesh's diagonals contribute a few per cent", relative=0.05
    ),
    cause="the membrane's shear constant is not K_sh: springs along edges alone give K_s / 2 or less",
)
def _cloth_shear(lab: Lab) -> Measurement:
    """Three upright sheets, 0.1 m by 0.4 m, clamped along both upright edges to a frame at rest, which then moves.

    K_sh from the mean sag at middle height, at rest and on the moving frame, over that of the scene; the worst.

    Source: simple shear of a wide sheet (scene.Cloth).
    """
    scenes = (
        upright_sheet(fabric(0.25, 27.5, 5e-5)),
        upright_sheet(fabric(0.35, 44.0, 8e-5)),
        upright_sheet(fabric(0.6, 66.0, 1.2e-4)),
    )
    rollout = lab.rollout(side_by_side(scenes, SHEAR_S - SHEAR_SETTLED_S))
    return worst_law(rollout, shear_stiffness, "K_sh", SHEAR_SETTLED_S, SHEAR_S)


CLAMP_SHARE, WIDTH_SHARE = 1.0 / 3.0, 2.0 / 3.0
BENT_FREE_M = 0.15
"""Free length of the cantilever of the conformance checks [m]."""

BENT_SETTLED_S, BENT_S = 0.35, 1.3
BENT_GRAVITY = 0.2 * G

BENT_FABRIC = fabric(0.2, 110.0, 6.2e-3)
"""Fabric of the check of bending: at a fifth of gravity it sags by 4 mm on 150 mm, with a period of 0.23 s.

At full gravity its slope would reach 0.5, and the moment of its weight near the tip would be a fifth too small.
"""


def cantilever_strip(
    made_of: Fabric,
    free_m: float = BENT_FREE_M,
    *,
    height_m: float = LEVEL_M,
    axis: Axis = "x",
) -> Scene:
    """Return a horizontal strip that is clamped at one end.

    Gravity makes rho g L^3 / D the same for every fabric and length, so that the slope of the tip is 0.04. The duration
    has the same number of periods.

    Args:
        made_of: The fabric.
        free_m: Free length L [m]; the clamp is a third of it, and the width two thirds.
        height_m: Height of the strip [m]. Single precision rounds small displacements least at 0.
        axis: Axis of its length: x, the warp, or y, the weft.
    """
    scale = free_m / BENT_FREE_M
    density = BENT_FABRIC.areal_density_kg_per_m2 / made_of.areal_density_kg_per_m2
    bend = made_of.bend_stiffness_n_m_per_rad / BENT_FABRIC.bend_stiffness_n_m_per_rad
    gravity = BENT_GRAVITY * density * bend / scale**3
    pose = Pose(position_m=(0.0, 0.0, height_m))
    size_m = ((1.0 + CLAMP_SHARE) * free_m, WIDTH_SHARE * free_m)
    return clamped(
        sheet(made_of, pose, size_m if axis == "x" else size_m[::-1]),
        Region(axis=axis, side="low", depth_m=CLAMP_SHARE * free_m),
        duration_s=BENT_S * math.sqrt(scale * BENT_GRAVITY / gravity),
        gravity_m_per_s2=gravity,
    )


def strip_stiffness(hung: Equilibrium) -> Measurement:
    """Measure the bending stiffness per width [N m] from the droop of a clamped strip: D w'' = rho g (L - s)^2 / 2."""
    load = hung.body.areal_density_kg_per_m2 * hung.gravity_m_per_s2
    return stiffness(load, droop(hung), hung.body.bend_stiffness_n_m_per_rad)


def bending_stiffness(rollout: Recording) -> Measurement:
    """Measure the bending stiffness per width [N m] of the strip of `cantilever_strip`."""
    settled_s = BENT_SETTLED_S / BENT_S * rollout.scene.duration_s
    return strip_stiffness(equilibrium(rollout, "cloth", settled_s))


@check(
    "cloth-bending",
    title="cloth, bending stiffness",
    law="D w'' = rho g (L - s)^2 / 2",
    tolerance=Tolerance(
        "triangulations distribute K_theta differently: the paper's mapping gives 0.88 along grid lines",
        relative=0.2,
    ),
    cause="the constant of an edge is not that of K_theta, or the clamp of 50 mm does not hold the slope",
)
def _cloth_bending(lab: Lab) -> Measurement:
    """Three horizontal strips, 0.15 m free, clamped to a frame at rest, which then moves; a fifth of gravity.

    Bending stiffness per width from the mean droop, at rest and on the moving frame, over that of the scene; the worst.

    Source: heavy elastica at small slope; D = K_theta on a square grid (scene/fabrics.py).
    """
    light, heavy = fabric(0.15, 140.0, 4.65e-3), fabric(0.8, 400.0, 2.48e-2)
    scenes = (
        cantilever_strip(BENT_FABRIC),
        cantilever_strip(light, axis="y"),
        cantilever_strip(heavy),
    )
    rollout = lab.rollout(side_by_side(scenes, BENT_S - BENT_SETTLED_S))
    return worst_law(rollout, strip_stiffness, "D", BENT_SETTLED_S, BENT_S)


# --- contact ---------------------------------------------------------------------------------------------------------

SLAB_M, FRICTION = (1.0, 0.4, 0.02), 0.3


@check(
    "cloth-slide",
    title="friction of cloth",
    law="a = g (sin 30 - mu cos 30) on the slope, a = mu g on the driven slab",
    tolerance=Tolerance(
        "the many light contacts of a sheet flutter, and some are open", relative=0.05
    ),
    cause="friction of cloth comes from a global constant, or is combined otherwise than that of rigid pairs",
)
def _cloth_slide(lab: Lab) -> Measurement:
    """A sheet on a fixed slab that leans by 30 degrees, and on a level slab that is driven by 10 m/s^2.

    Friction from the mean acceleration of the nodes, quadratic fit, over that of the scene; the worse.

    Source: Coulomb.
    """
    profile = ramp(0.9, start_s=0.0, duration_s=0.6, ramp_s=0.3)
    pull = driver("slab", "translate", (-1.0, 0.0, 0.0), profile)
    above_m = 0.5 * SLAB_M[2] + 0.5 * LIGHT_FABRIC.thickness_m
    ratios = {}
    for make, slope_deg, drivers in ((fixed_box, 30.0, ()), (driven_box, 0.0, (pull,))):
        euler_deg = (0.0, slope_deg, 0.0)
        slab = make("slab", LEVEL.position_m, SLAB_M, euler_deg=euler_deg)
        start_m = vector(slab.pose.to_world(np.array([0.0, 0.0, above_m])))
        start = replace(slab.pose, position_m=start_m)
        scene = Scene(
            bodies=(slab,),
            deformables=(sheet(LIGHT_FABRIC, start, (0.15, 0.15)),),
            contacts=(contact("slab", "cloth", friction=FRICTION),),
            drivers=drivers,
            duration_s=0.3,
        )
        rollout = lab.rollout(scene).cut(0.05, 0.3)
        mean_m = start.to_body(rollout.nodes_m["cloth"].mean(axis=1))[:, 0]
        friction = slide_friction(
            acceleration_m_per_s2(rollout.times_s, mean_m),
            math.radians(slope_deg),
            gravity_m_per_s2=G,
        )
        ratios[f"a {slab.motion} slab"] = friction / FRICTION
    return ratio(ratios, "friction")


@check("cloth-rests-on", title="cloth lies on bodies", law="height = h / 2", **REST)
def _cloth_rests_on(lab: Lab) -> Measurement:
    """Three sheets, h = 2, 6 and 12 mm thick: on fixed slabs, and on a driven one that stands still.

    Mean height of the lowest node over the slab in the last quarter of 1.3 s, minus half the thickness; the worst.

    Source: contact (scene.Contact).
    """
    return rest_error(lab, SHEETS, 1.3)


@check("cloth-strike", title="cloth takes the momentum of a body", **STRIKE)
def _cloth_strike(lab: Lab) -> Measurement:
    """Three sheets of different fabrics without gravity, each struck by a free block across its surface.

    Momentum of sheet and block over that of the block at the start after the impact; the worst.

    Source: Newton.
    """
    return momentum_ratio(lab, SHEETS, 1.3)


HALF_M, FOLD_S, FOLDED_S = 0.15, 0.6, 1.0
EDGE_M = (-0.135, 0.01)
"""Final place of the strip's end: along the strip from the fold, and above the clamped half [m]."""

SUPPLE_FABRIC = fabric(0.2, 110.0, 1e-6, 3e-3)
"""Fabric that sags by 22 mm between the fold and the rod without support."""


@check(
    "cloth-touches-itself",
    title="cloth touches itself",
    law="height = thickness",
    unit="mm",
    tolerance=Tolerance(
        "twice the real trials' scatter; without contact it hangs 22 mm below",
        absolute=2.0,
    ),
    cause="the layers pass through each other: a cloth's contact with itself is left out, or its layer is too thin",
)
def _cloth_touches_itself(lab: Lab) -> Measurement:
    """A strip of cloth, one half clamped level; a driven rod lays the end of the other half over it, with slack.

    Mean height of the lowest node of the upper half over the clamped half in the last 0.2 s, minus 3 mm of thickness.

    Source: contact (scene.Contact), thickness (scene.Cloth).
    """
    cloth = sheet(SUPPLE_FABRIC, LEVEL, (2.0 * HALF_M, 0.05))
    middle = (0.5 * (HALF_M + EDGE_M[0]), 0.0, LEVEL_M + 0.5 * EDGE_M[1])
    fold = ramp(-math.pi, start_s=0.0, duration_s=FOLD_S, ramp_s=0.2)
    half = Region(axis="x", side="low", depth_m=HALF_M)
    end = Region(axis="x", side="high")
    rod = driven_box("rod", (HALF_M, 0.0, LEVEL_M), (0.01, 0.06, 0.01))
    flat = clamped(cloth, half, duration_s=FOLDED_S)
    scene = replace(
        also_attached(flat, rod, end),
        contacts=(contact("cloth", "cloth", friction=0.1),),
        drivers=(driver("rod", "rotate", (0.0, 1.0, 0.0), fold, point_m=middle),),
    )
    rollout = lab.rollout(scene)
    nodes_m = rollout.nodes_m["cloth"]
    late_m = nodes_m[rollout.between(FOLDED_S - 0.2, FOLDED_S)].mean(axis=0)
    was_free = nodes_m[0, :, 0] > PLACE_TOLERANCE_M
    is_over = was_free & (late_m[:, 0] < -PLACE_TOLERANCE_M)
    over_m = late_m[is_over, 2] - LEVEL_M
    measured_mm = 1e3 * float(over_m.min(initial=math.inf) - cloth.thickness_m)
    return Measurement(measured=measured_mm)


# --- air -------------------------------------------------------------------------------------------------------------

AIR_DENSITY, AIR_COEFFICIENT = 1.2, 1.5
AIR_FABRIC = fabric(0.1, 110.0, 1e-4)
WIND_M_PER_S, INCIDENCE_DEG, BLOWN_S = 2.0, 40.0, 0.6


@check(
    "air-pressure",
    title="air: pressure, friction and lift",
    law="du/dt = -k u_n^2 n, -k u_t^2 t, or lift k |u_n u_t| perpendicular to u; k = rho C / (2 m / A)",
    tolerance=Tolerance(
        "4 % of a coefficient, less than is known; explicit steps of 1 ms are off by 0.7 %",
        relative=0.02,
    ),
    cause="the factor 1/2, the areas of triangles, or the direction of the force is another one (scene.Air)",
    optional=True,
)
def _air_pressure(lab: Lab) -> Measurement:
    """Free flat sheets of cloth in a wind of 2 m/s at 40 degrees to their plane, no gravity, one coefficient each.

    Displacement after 0.6 s, along the edge by friction, else along the normal, over that of the law; the worst.

    Source: quadratic drag, Newton's law of resistance (scene.air).
    """
    k = 0.5 * AIR_DENSITY * AIR_COEFFICIENT / AIR_FABRIC.areal_density_kg_per_m2
    incidence = math.radians(INCIDENCE_DEG)
    along_m = WIND_M_PER_S * BLOWN_S * math.cos(incidence)
    across_m = WIND_M_PER_S * BLOWN_S * math.sin(incidence)
    laws_m = {
        # The speed through the air decays by du/dt = -k u^2.
        "tangential": along_m - math.log1p(k * along_m) / k,
        "normal": across_m - math.log1p(k * across_m) / k,
        # The lift keeps |u|, and turns u into the plane of the sheet: dt = -d angle / (k |u| sin cos).
        "lift": across_m - math.atanh(math.sin(incidence)) / k,
    }
    pose = Pose.from_euler_deg(LEVEL.position_m, (0.0, INCIDENCE_DEG, 0.0))
    ratios = {}
    for kind, law_m in laws_m.items():
        given = {"normal_coefficient": 0.0, f"{kind}_coefficient": AIR_COEFFICIENT}
        wind = (WIND_M_PER_S, 0.0, 0.0)
        air = Air(density_kg_per_m3=AIR_DENSITY, wind_m_per_s=wind, **given)
        scene = Scene(
            bodies=(FRAME,),
            deformables=(sheet(AIR_FABRIC, pose, (0.15, 0.15)),),
            duration_s=BLOWN_S,
            gravity_m_per_s2=0.0,
            air=air,
        )
        moved_m = pose.to_body(lab.rollout(scene).nodes_m["cloth"][-1].mean(axis=0))
        axis = 0 if kind == "tangential" else 2
        ratios[f"the {kind} force"] = float(moved_m[axis] / law_m)
    return ratio(ratios, "the displacement")
