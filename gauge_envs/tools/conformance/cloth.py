"""Cloth: start, clamp, stretch, shear and bending stiffness, contact and air. The recipes of fabrics use its strips.

Strains are at most 1 %, or slopes 0.1, so that differences between laws of large strain do not matter. In tension the
fit ignores nodes within one width of the clamp, which hinders contraction.
"""

import math
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from gauge_envs.scene import (
    GRAVITY_M_PER_S2 as G,
    Air,
    Attachment,
    Pose,
    Region,
    Scene,
)
from gauge_envs.scene.fabrics import Fabric
from gauge_envs.scene.geometry import FloatArray, vector
from gauge_envs.scoring.estimators import acceleration_m_per_s2, slide_friction
from gauge_envs.tools.bench.parts import contact, driven_box, driver, fixed_box, ramp
from gauge_envs.tools.bench.recording import Recording
from gauge_envs.tools.conformance.deformable import (
    ATTACHED,
    FRAME,
    LEVEL,
    LEVEL_M,
    PLACE_TOLERANCE_M,
    RAMP_S,
    REST,
    START,
    STRIKE,
    attachment_error,
    cantilever_load_over_stiffness,
    clamped,
    coefficient,
    equilibrium,
    fabric,
    momentum_ratio,
    node_masses_kg,
    rest_error,
    sheet,
    side_by_side,
    start_error,
    stiffness,
    worst_law,
)
from gauge_envs.tools.conformance.lab import Lab, largest_mm, ratio
from gauge_envs.tools.conformance.model import Measurement, Tolerance, check

LIGHT_FABRIC = fabric(0.2, 110.0, 1e-4)
"""Fabric of sheets whose stiffness does not matter."""

SHEETS = tuple(
    replace(
        sheet(made_of, LEVEL, size_m), name=f"sheet {number}", thickness_m=thickness_m
    )
    for number, (made_of, thickness_m, size_m) in enumerate(
        (
            (LIGHT_FABRIC, 2e-3, (0.1, 0.1)),
            (fabric(0.4, 80.0, 1e-4), 6e-3, (0.15, 0.1)),
            (fabric(0.1, 150.0, 1e-4), 1.2e-2, (0.1, 0.13)),
        )
    )
)
"""Sheets of different fabrics, thicknesses and sizes."""


@check("cloth-start", title="cloth, start", **START)
def _cloth_start(lab: Lab) -> Measurement:
    """Three sheets of cloth of different sizes, at three places and orientations.

    Largest distance of the box of the nodes of a sheet at the start, in its frame, from the sheet's edges.
    """
    return start_error(lab, SHEETS)


# --- stiffness -------------------------------------------------------------------------------------------------------


def _along_weft(scene: Scene) -> Scene:
    """Return the scene of a clamped strip whose length lies along the weft."""
    cloth: Any = scene.deformables[0]
    (attachment,) = scene.attachments
    # A quarter turn about the normal takes the strip's y axis to where its x axis was.
    quarter = Rotation.from_euler("z", -90.0, degrees=True)
    pose = Pose.from_rotation(cloth.pose.position_m, cloth.pose.rotation * quarter)
    region = replace(attachment.region, axis="y")
    return replace(
        scene,
        deformables=(replace(cloth, pose=pose, size_m=cloth.size_m[::-1]),),
        attachments=(replace(attachment, region=region),),
    )


HANG_M, HANG_WIDTH_M, HANG_SETTLED_S = 0.3, 0.075, 0.2


def hanging_strip(made_of: Fabric, depth_m: float = 0.0) -> Scene:
    """Return a strip of 0.3 m by 0.075 m that hangs from its upper edge or a part of its length, warp downward."""
    pose = Pose.from_euler_deg(LEVEL.position_m, (0.0, -90.0, 0.0))
    cloth = sheet(made_of, pose, (HANG_M, HANG_WIDTH_M))
    region = Region(axis="x", side="high", depth_m=depth_m)
    return clamped(cloth, region, duration_s=0.8)


def stretch_stiffness(
    rollout: Recording,
    name: str = "cloth",
    start_s: float = HANG_SETTLED_S,
    end_s: float = math.inf,
) -> Measurement:
    """Measure K_s [N/m] from the sag of a strip, a width or more from its clamp: u = rho g (L s - s^2/2) / K_s."""
    cloth, depth_m, rest, now = equilibrium(rollout, name, start_s, end_s)
    axis = int(np.argmax(cloth.size_m))
    s = 0.5 * HANG_M - rest[:, axis]
    free = s > depth_m + HANG_WIDTH_M - PLACE_TOLERANCE_M
    slope = coefficient(
        (rest - now)[free, axis], (HANG_M * s - 0.5 * s**2)[free], np.ones(free.sum())
    )
    load = cloth.areal_density_kg_per_m2 * rollout.scene.gravity_m_per_s2
    return stiffness(load, slope, cloth.stretch_stiffness_n_per_m)


DEPTHS_M = (0.041, 0.028, 0.053)
"""Depths of three clamps: with cells of 25 mm, an error by 1.25 or 0.8 holds another line of nodes of some strip."""


def _hanging(lab: Lab) -> Recording:
    strong, other = fabric(2.4, 1250.0, 2e-4), fabric(0.5, 300.0, 2e-4)
    first, second, third = DEPTHS_M
    scenes = {
        "strip along the warp": hanging_strip(LIGHT_FABRIC, first),
        "strip along the weft": _along_weft(hanging_strip(strong, second)),
        "third strip": hanging_strip(other, third),
    }
    return lab.rollout(side_by_side(scenes, speed_m_per_s=3.0, late_s=0.5))


@check("cloth-pinned-edge", title="cloth, clamps follow their driven body", **ATTACHED)
def _cloth_pinned_edge(lab: Lab) -> Measurement:
    """Three strips of cloth that hang from 41, 28 and 53 mm on a frame, which moves up with 3 m/s and then turns.

    Largest distance of an attached node from its place on the frame, or of a deeper node that keeps its place from
    the clamp.
    """
    return attachment_error(lab.once(_hanging))


@check(
    "cloth-stretch",
    title="cloth, stretch stiffness K_s",
    law="u(s) = rho g (L s - s^2 / 2) / K_s",
    source="uniaxial tension with free transverse edges (scene.Cloth)",
    tolerance=Tolerance(
        "laws differ by the largest strain: 0.5 % in equilibrium, 1 % at the lowest point",
        relative=0.02,
    ),
    cause="K_s is not 4 mu (lambda + mu) / (lambda + 2 mu), the nodes lack mass, or the solver does not converge",
)
def _cloth_stretch(lab: Lab) -> Measurement:
    """Three strips of three fabrics, 0.3 m by 0.075 m, that hang on a frame at rest, which then moves up with 3 m/s.

    K_s from the mean sag, at rest and on the moving frame, over that of the scene; the worst.
    """
    windows_s = ((HANG_SETTLED_S, 0.8), (1.3, 1.8))
    return worst_law(lab.once(_hanging), stretch_stiffness, "K_s", *windows_s)


SPAN_M, HEIGHT_M, SHEAR_SETTLED_S = 0.1, 0.4, 0.15


def upright_sheet(made_of: Fabric) -> Scene:
    """Return an upright sheet between two clamped upright edges: sag 0.3 mm, largest shear 1.2 %, period 31 ms.

    Far from the upper and lower edge there is shear, and neither bending nor stretch. A bending stiffness of
    rho g L^3 / 177 (shear buckling of a clamped strip) prevents wrinkles; the sheets have 3.6 times that. A larger one
    would add to the shear of engines whose bending is a quadratic form in all coordinates: D (pi / L)^2, here 0.5 %.
    """
    pose = Pose.from_euler_deg(LEVEL.position_m, (90.0, 0.0, 0.0))
    edges = (Region(axis="x", side="low"), Region(axis="x", side="high"))
    return clamped(sheet(made_of, pose, (SPAN_M, HEIGHT_M)), *edges, duration_s=0.6)


def shear_stiffness(
    rollout: Recording, name: str, start_s: float, end_s: float
) -> Measurement:
    """Measure K_sh [N/m] from the sag of an upright sheet at middle height: w = rho g (L s - s^2) / (2 K_sh)."""
    cloth, _, rest, now = equilibrium(rollout, name, start_s, end_s)
    inside = np.abs(rest[:, :2]) - (0.5 * SPAN_M, 0.5 * HEIGHT_M - SPAN_M)
    free = (inside < (-PLACE_TOLERANCE_M, PLACE_TOLERANCE_M)).all(axis=1)
    s = 0.5 * SPAN_M + rest[free, 0]
    slope = coefficient((rest - now)[free, 1], 0.5 * (SPAN_M * s - s**2))
    load = cloth.areal_density_kg_per_m2 * rollout.scene.gravity_m_per_s2
    return stiffness(load, slope, cloth.shear_stiffness_n_per_m)


@check(
    "cloth-shear",
    title="cloth, shear stiffness K_sh",
    law="w(s) = rho g (L s - s^2) / (2 K_sh)",
    source="simple shear of a wide sheet (scene.Cloth)",
    tolerance=Tolerance(
        "free edges and the mesh's diagonals contribute a few per cent", relative=0.05
    ),
    cause="the membrane's shear constant is not K_sh: springs along edges alone give K_s / 2 or less",
)
def _cloth_shear(lab: Lab) -> Measurement:
    """Three upright sheets, 0.1 m by 0.4 m, clamped along both upright edges to a frame at rest, which then moves.

    K_sh from the mean sag at middle height, at rest and on the moving frame, over that of the scene; the worst.
    """
    scenes = {
        "light sheet": upright_sheet(fabric(0.25, 27.5, 5e-5)),
        "sheet": upright_sheet(fabric(0.35, 44.0, 8e-5)),
        "stiff sheet": upright_sheet(fabric(0.6, 66.0, 1.2e-4)),
    }
    rollout = lab.rollout(side_by_side(scenes, speed_m_per_s=3.0, late_s=0.4))
    windows_s = ((SHEAR_SETTLED_S, 0.6), (1.1, 1.5))
    return worst_law(rollout, shear_stiffness, "K_sh", *windows_s)


CLAMP_SHARE, WIDTH_SHARE = 1.0 / 3.0, 2.0 / 3.0
BENT_FREE_M = 0.15
"""Free length of the cantilever of the conformance checks [m]."""

BENT_S, SETTLED_SHARE = 1.3, 0.35 / 1.3
BENT_GRAVITY = 0.2 * G

BENT_FABRIC = fabric(0.2, 110.0, 6.2e-3)
"""Fabric of the check of bending: at a fifth of gravity it sags by 4 mm on 150 mm, with a period of 0.23 s.

At full gravity its slope would reach 0.5, and the moment of its weight near the tip would be a fifth too small.
"""


def cantilever_strip(
    made_of: Fabric, free_m: float = BENT_FREE_M, *, height_m: float = LEVEL_M
) -> Scene:
    """Return a horizontal strip that is clamped at one end.

    Gravity is that with which rho g L^3 / D is the same for every fabric and length, so that the tip's slope is 0.04.
    The duration has the same number of periods.

    Args:
        made_of: The fabric.
        free_m: Free length L [m]; the clamp is a third of it, and the width two thirds.
        height_m: Height of the strip [m]. Single precision rounds small displacements least at 0.
    """
    scale = free_m / BENT_FREE_M
    density = BENT_FABRIC.areal_density_kg_per_m2 / made_of.areal_density_kg_per_m2
    bend = made_of.bend_stiffness_n_m_per_rad / BENT_FABRIC.bend_stiffness_n_m_per_rad
    gravity = BENT_GRAVITY * density * bend / scale**3
    size_m = ((1.0 + CLAMP_SHARE) * free_m, WIDTH_SHARE * free_m)
    return clamped(
        sheet(made_of, Pose(position_m=(0.0, 0.0, height_m)), size_m),
        Region(axis="x", side="low", depth_m=CLAMP_SHARE * free_m),
        duration_s=BENT_S * math.sqrt(scale * BENT_GRAVITY / gravity),
        gravity_m_per_s2=gravity,
    )


def bending_stiffness(
    rollout: Recording,
    name: str = "cloth",
    start_s: float | None = None,
    end_s: float = math.inf,
) -> Measurement:
    """Measure the bending stiffness per width [N m] from the droop of a clamped strip: D w'' = rho g (L - s)^2 / 2."""
    if start_s is None:
        start_s = SETTLED_SHARE * rollout.scene.duration_s
    cloth, _, rest, now = equilibrium(rollout, name, start_s, end_s)
    axis = int(np.argmax(cloth.size_m))
    free_m = cloth.size_m[axis] / (1.0 + CLAMP_SHARE)
    s = rest[:, axis] + 0.5 * cloth.size_m[axis] - CLAMP_SHARE * free_m
    # Nodes are weighted by area, like the load, since a mesh's diagonals make its lines of nodes wavy.
    weights = node_masses_kg(cloth, rollout.nodes_m[name][0])
    slope = cantilever_load_over_stiffness(
        s, (rest - now)[:, 2], length_m=free_m, weights=weights
    )
    load = cloth.areal_density_kg_per_m2 * rollout.scene.gravity_m_per_s2
    return stiffness(load, slope, cloth.bend_stiffness_n_m_per_rad)


@check(
    "cloth-bending",
    title="cloth, bending stiffness",
    law="D w'' = rho g (L - s)^2 / 2",
    source="heavy elastica at small slope; D = K_theta on a square grid (scene/fabrics.py)",
    tolerance=Tolerance(
        "triangulations distribute K_theta differently: the paper's mapping gives 0.88 along grid lines",
        relative=0.2,
    ),
    cause="the constant of an edge is not that of K_theta, or the clamp of 50 mm does not hold the slope",
)
def _cloth_bending(lab: Lab) -> Measurement:
    """Three horizontal strips, 0.15 m free, clamped to a frame at rest, which then moves; a fifth of gravity.

    Bending stiffness per width from the mean droop, at rest and on the moving frame, over that of the scene; the worst.
    """
    light, heavy = fabric(0.15, 140.0, 4.65e-3), fabric(0.8, 400.0, 2.48e-2)
    scenes = {
        "strip along the warp": cantilever_strip(BENT_FABRIC),
        "strip along the weft": _along_weft(cantilever_strip(light)),
        "third strip": cantilever_strip(heavy),
    }
    rollout = lab.rollout(side_by_side(scenes, speed_m_per_s=2.0, late_s=0.9))
    late_s = BENT_S + RAMP_S
    windows_s = ((0.35, BENT_S), (late_s, late_s + 0.9))
    return worst_law(rollout, bending_stiffness, "D", *windows_s)


# --- contact ---------------------------------------------------------------------------------------------------------

SLAB_M, SLOPE_DEG = (1.0, 0.4, 0.02), 30.0


def _friction(lab: Lab, slope_deg: float, friction: float) -> float:
    """Return the friction over that of the scene of a sheet on a fixed slope, or on a level slab that is driven."""
    is_fixed = slope_deg > 0.0
    slope = Pose.from_euler_deg(LEVEL.position_m, (0.0, slope_deg, 0.0))
    above_m = 0.5 * SLAB_M[2] + 0.5 * LIGHT_FABRIC.thickness_m
    start_m = vector(slope.to_world(np.array([0.1, 0.0, above_m])))
    make = fixed_box if is_fixed else driven_box
    slab = make("slab", LEVEL.position_m, SLAB_M, euler_deg=(0.0, slope_deg, 0.0))
    profile = ramp(0.9, start_s=0.0, duration_s=0.6, ramp_s=0.3)
    pull = driver("slab", "translate", (1.0, 0.0, 0.0), profile)
    cloth = sheet(LIGHT_FABRIC, replace(slope, position_m=start_m), (0.15, 0.15))
    pair = ("cloth", "slab") if is_fixed else ("slab", "cloth")
    scene = Scene(
        bodies=(slab,),
        deformables=(cloth,),
        contacts=(contact(*pair, friction=friction),),
        drivers=() if is_fixed else (pull,),
        duration_s=0.3,
    )
    rollout = lab.rollout(scene).cut(0.05, 0.3)
    mean_m = slope.to_body(rollout.nodes_m["cloth"].mean(axis=1))[:, 0]
    acceleration = acceleration_m_per_s2(rollout.times_s, mean_m)
    slope_rad = math.radians(slope_deg)
    found = slide_friction(acceleration, slope_rad, gravity_m_per_s2=G)
    # The driven slab takes the sheet forward: its friction has the other sign.
    return (found if is_fixed else -found) / friction


@check(
    "cloth-slide",
    title="friction of cloth",
    law="a = g (sin 30 - mu cos 30) on the slope, a = mu g on the driven slab",
    source="Coulomb",
    tolerance=Tolerance(
        "the many light contacts of a sheet flutter, and some are open", relative=0.05
    ),
    cause="friction of cloth comes from a global constant, or is combined otherwise than that of rigid pairs",
)
def _cloth_slide(lab: Lab) -> Measurement:
    """A sheet on a fixed slab that leans by 30 degrees, friction 0.3; and on a slab driven by 10 m/s^2, friction 0.2.

    Friction from the mean acceleration of the nodes, quadratic fit, over that of the scene; the worse.
    """
    ratios = {
        "the fixed slope": _friction(lab, SLOPE_DEG, 0.3),
        "the driven slab": _friction(lab, 0.0, 0.2),
    }
    return ratio(ratios, "friction")


@check("cloth-rests-on", title="cloth lies on bodies", law="height = h / 2", **REST)
def _cloth_rests_on(lab: Lab) -> Measurement:
    """Three sheets, h = 2, 6 and 12 mm thick: on a fixed slab, a driven slab that stands still, and a free slab.

    Mean height of the lowest node over the slab in the last quarter of 1.3 s, minus half the thickness; the worst.
    """
    return rest_error(lab, SHEETS, 1.3)


@check("cloth-strike", title="cloth takes the momentum of a body", **STRIKE)
def _cloth_strike(lab: Lab) -> Measurement:
    """Three sheets of different fabrics without gravity, each struck by a free block across its surface.

    Momentum of sheet and block over that of the block at the start, in spans of 1.3 s; the worst.
    """
    return momentum_ratio(lab, SHEETS, 1.3)


HALF_M, FOLD_S, FOLDED_S = 0.15, 0.6, 1.0
EDGE_M = (-0.135, 0.01)
"""Where the rod lays the strip's end: along the strip from the fold, and over the clamped half [m]."""

SUPPLE_FABRIC = replace(fabric(0.2, 110.0, 1e-6), thickness_m=3e-3)
"""Fabric that sags by 22 mm between the fold and the rod, where nothing is under it."""


@check(
    "cloth-touches-itself",
    title="cloth touches itself",
    law="height = thickness",
    source="contact (scene.Contact), thickness (scene.Cloth)",
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
    """
    cloth = sheet(SUPPLE_FABRIC, LEVEL, (2.0 * HALF_M, 0.05))
    middle = (0.5 * (HALF_M + EDGE_M[0]), 0.0, LEVEL_M + 0.5 * EDGE_M[1])
    turn = ramp(-math.pi, start_s=0.0, duration_s=FOLD_S, ramp_s=0.2)
    half = Region(axis="x", side="low", depth_m=HALF_M)
    end = Region(axis="x", side="high")
    rod = driven_box("rod", (HALF_M, 0.0, LEVEL_M), (0.01, 0.06, 0.01))
    folded = replace(
        clamped(cloth, half, duration_s=FOLDED_S),
        bodies=(FRAME, rod),
        contacts=(contact("cloth", "cloth", friction=0.1),),
        drivers=(driver("rod", "rotate", (0.0, 1.0, 0.0), turn, point_m=middle),),
    )
    on_rod = Attachment(deformable="cloth", region=end, to="rod")
    scene = replace(folded, attachments=(*folded.attachments, on_rod))
    rollout = lab.rollout(scene)
    nodes_m = rollout.nodes_m["cloth"]
    is_free = nodes_m[0, :, 0] > PLACE_TOLERANCE_M
    late = rollout.between(FOLDED_S - 0.2, FOLDED_S)
    free_m = nodes_m[late][:, is_free].mean(axis=0)
    over_m = free_m[free_m[:, 0] < -PLACE_TOLERANCE_M, 2] - LEVEL_M
    hint = ""
    if largest_mm((nodes_m - nodes_m[0])[:, ~is_free]) > 1.0:
        hint = "the clamped half leaves its place: it is not attached to the fixed body"
    measured_mm = 1e3 * float(over_m.min(initial=math.inf) - cloth.thickness_m)
    return Measurement(measured=measured_mm, hint=hint)


# --- air -------------------------------------------------------------------------------------------------------------

AIR_DENSITY, AIR_COEFFICIENT = 1.2, 1.5
AIR_FABRIC = fabric(0.1, 110.0, 1e-4)
WIND, INCIDENCE_DEG, BLOWN_S = (2.0, 0.0, 0.0), 40.0, 0.6


def _rate_in_air(
    kind: str, wind: FloatArray, _: float, moved: FloatArray
) -> FloatArray:
    """Return velocity and acceleration of a flat sheet in wind, from displacement and velocity, along edge and normal.

    With k = rho C / (2 mass per area), n the normal and t the edge: pressure -k |u_n| u_n n, friction -k |u_t| u_t t,
    and a lift of the size k |u_n u_t|, perpendicular to u (scene.air).
    """
    k = 0.5 * AIR_DENSITY * AIR_COEFFICIENT / AIR_FABRIC.areal_density_kg_per_m2
    along, across = relative = moved[2:] - wind
    if kind == "lift":
        share = along * across / math.hypot(along, across)
        rate = share * np.array([across, -along])
    else:
        rate = -np.abs(relative) * relative
        rate[0 if kind == "normal" else 1] = 0.0
    return np.concatenate([moved[2:], k * rate])


@check(
    "air-pressure",
    title="air: pressure, friction and lift",
    law="du/dt = g - k |u_n| u_n n - k |u_t| u_t t, or lift k |u| u_n perpendicular to u; k = rho C / (2 m / A)",
    source="quadratic drag, Newton's law of resistance (scene.air)",
    tolerance=Tolerance(
        "4 % of a coefficient, less than is known; explicit steps of 1 ms are off by 0.7 %",
        relative=0.02,
    ),
    cause="the factor 1/2, the areas of triangles, or the direction of the force is another one (scene.Air)",
    optional=True,
)
def _air_pressure(lab: Lab) -> Measurement:
    """Free flat sheets of cloth that fall in a wind of 2 m/s at 40 degrees to their plane, with one coefficient each.

    Displacement along the edge and along the normal after 0.6 s, without the fall, over that of the law; the worst.
    """
    pose = Pose.from_euler_deg(LEVEL.position_m, (0.0, INCIDENCE_DEG, 0.0))
    axes = pose.rotation.as_matrix().T[[0, 2]]
    ratios = {}
    for kind in ("normal", "tangential", "lift"):
        given = {"normal_coefficient": 0.0, f"{kind}_coefficient": AIR_COEFFICIENT}
        air = Air(density_kg_per_m3=AIR_DENSITY, wind_m_per_s=WIND, **given)
        scene = Scene(
            bodies=(FRAME,),
            deformables=(sheet(AIR_FABRIC, pose, (0.15, 0.15)),),
            duration_s=BLOWN_S,
            gravity_m_per_s2=0.0,
            air=air,
        )
        mean_m = lab.rollout(scene).nodes_m["cloth"].mean(axis=1)
        moved_m = axes @ (mean_m[-1] - mean_m[0])
        wind = axes @ np.array(WIND)
        rate = partial(_rate_in_air, kind, wind)
        law = solve_ivp(rate, (0.0, BLOWN_S), np.zeros(4), rtol=1e-8, atol=1e-10)
        law_m = law.y[:2, -1]
        for name, axis in (("along the edge", 0), ("along the normal", 1)):
            if abs(law_m[axis]) > 1e-6:
                ratios[f"the {kind} force {name}"] = float(moved_m[axis] / law_m[axis])
    return ratio(ratios, "the displacement")
