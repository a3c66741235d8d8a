"""Cloth: start, clamp, stretch, shear and bending stiffness, contact and air. The recipes of fabrics use its strips.

Strains are at most 1 %, or slopes 0.1, so that differences between laws of large strain do not matter. In tension the
fit ignores nodes within one width of the clamp, which hinders contraction.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.scene import (
    GRAVITY_M_PER_S2 as G,
    Air,
    Attachment,
    Cloth,
    Pose,
    Region,
    Scene,
)
from gauge_envs.scene.fabrics import Fabric
from gauge_envs.scene.geometry import FloatArray, vector
from gauge_envs.scoring.estimators import (
    acceleration_m_per_s2,
    hann_mean,
    slide_friction,
    steady_speed_m_per_s,
)
from gauge_envs.tools.bench.parts import contact, driven_box, driver, fixed_box, ramp
from gauge_envs.tools.bench.recording import Recording
from gauge_envs.tools.conformance.deformable import (
    ATTACHED,
    FRAME,
    LEVEL_M,
    PLACE_TOLERANCE_M,
    RAMP_S,
    REST,
    START,
    STRIKE,
    cantilever_load_over_stiffness,
    clamp_error,
    clamped,
    coefficient,
    edge_error,
    fabric,
    momentum_ratio,
    node_masses_kg,
    on_rod,
    rest_error,
    sheet,
    side_by_side,
    start_error,
    stiffness,
    worst_law,
)
from gauge_envs.tools.conformance.lab import Lab, largest_mm, worst_ratio
from gauge_envs.tools.conformance.model import Measurement, Tolerance, check

LIGHT_FABRIC = fabric(0.2, 110.0, 1e-4)
"""Fabric of sheets whose stiffness does not matter."""

ORIGIN = Pose(position_m=(0.0, 0.0, 0.0))
UPRIGHT = Pose.from_euler_deg((0.0, 0.0, 0.0), (0.0, -90.0, 0.0))
"""Pose of a sheet whose warp points upward."""

SHEETS = tuple(
    replace(
        sheet(replace(made_of, thickness_m=thickness_m), ORIGIN, size_m),
        name=f"sheet {number}",
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


# --- clamps ----------------------------------------------------------------------------------------------------------

DEPTHS_M = (0.053, 0.041, 0.028)
"""Depths of three clamps: with cells of 25 mm, each of them or its error by 1.25 or 0.8 holds another line of nodes."""


def _strips_on_rod(lab: Lab) -> Recording:
    strips = [replace(one, pose=UPRIGHT, size_m=(0.15, 0.1)) for one in SHEETS]
    return lab.rollout(on_rod(strips, "x", DEPTHS_M))


@check(
    "cloth-pinned-edge",
    title="cloth, attached edge follows its driven body",
    **ATTACHED,
)
def _cloth_pinned_edge(lab: Lab) -> Measurement:
    """Three strips of cloth that hang from a driven rod, which moves by 1.1 m and turns by 0.6 rad within 1.2 s.

    Largest distance of a node of the attached edges from its place on the rod.
    """
    return edge_error(lab.once(_strips_on_rod))


CLAMP: dict[str, Any] = {
    "law": "nodes within Region.depth_m of the side are attached, and no others",
    "source": "contract (scene.Region)",
    "unit": "mm",
    "tolerance": Tolerance("free nodes 1 mm beyond the clamp move", absolute=1.0),
    "cause": "the clamp holds a line of nodes too many or too few (Region.depth_m)",
}


@check("cloth-clamp", title="cloth, depth of the clamp", **CLAMP)
def _cloth_clamp(lab: Lab) -> Measurement:
    """Three strips of cloth that hang from a driven rod, of which 53, 41 and 28 mm are clamped.

    Depth of the deepest node that follows the rod beyond the clamp, or of the clamp beyond the first that does not.
    """
    return clamp_error(lab.once(_strips_on_rod))


# --- stiffness -------------------------------------------------------------------------------------------------------


def _cloth_of(rollout: Recording) -> Cloth:
    """Return the only sheet of a recording."""
    (cloth,) = rollout.scene.deformables
    assert isinstance(cloth, Cloth), "the scene has a sheet alone"
    return cloth


def _equilibrium(rollout: Recording, settled_s: float) -> tuple[FloatArray, FloatArray]:
    """Return nodes at the start and in equilibrium, in the cloth's frame [m], each of shape [node_count, 3]."""
    cloth = _cloth_of(rollout)
    nodes_m = np.array(
        [cloth.pose.to_body(nodes) for nodes in rollout.nodes_m[cloth.name]]
    )
    return nodes_m[0], hann_mean(nodes_m[rollout.between(settled_s, np.inf)])


def _along_weft(scene: Scene) -> Scene:
    """Return the scene of a clamped strip whose length lies along the weft."""
    (cloth,), (attachment,) = scene.deformables, scene.attachments
    assert isinstance(cloth, Cloth), "the scene has a strip alone"
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


def hanging_strip(made_of: Fabric) -> Scene:
    """Return a strip of 0.3 m by 0.075 m that hangs from its upper edge, warp downward."""
    cloth = sheet(
        made_of,
        replace(UPRIGHT, position_m=(0.0, 0.0, LEVEL_M)),
        (HANG_M, HANG_WIDTH_M),
    )
    return clamped(cloth, Region(axis="x", side="high"), duration_s=0.8)


def stretch_stiffness(rollout: Recording) -> Measurement:
    """Measure K_s [N/m] from the sag of a strip, a width or more from its clamp: u = rho g (L s - s^2/2) / K_s."""
    cloth = _cloth_of(rollout)
    rest, now = _equilibrium(rollout, HANG_SETTLED_S)
    axis = int(np.argmax(cloth.size_m))
    s = 0.5 * HANG_M - rest[:, axis]
    free = s > HANG_WIDTH_M - PLACE_TOLERANCE_M
    slope = coefficient(
        (rest - now)[free, axis], (HANG_M * s - 0.5 * s**2)[free], np.ones(free.sum())
    )
    load = cloth.areal_density_kg_per_m2 * rollout.scene.gravity_m_per_s2
    return stiffness(load, slope, cloth.stretch_stiffness_n_per_m)


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
    """Three strips of three fabrics, 0.3 m by 0.075 m, that hang on a frame at rest, which then moves up with 6 m/s.

    K_s from the mean sag, at rest and on the moving frame, over that of the scene; the worst.
    """
    strong, other = fabric(2.4, 1250.0, 2e-4), fabric(0.5, 300.0, 2e-4)
    scene = side_by_side(
        {
            "strip along the warp": hanging_strip(LIGHT_FABRIC),
            "strip along the weft": _along_weft(hanging_strip(strong)),
            "third strip": hanging_strip(other),
        },
        speed_m_per_s=6.0,
        late_s=0.5,
    )
    rollout = lab.rollout(scene)
    windows_s = ((HANG_SETTLED_S, 0.8), (1.3, 1.8))
    return worst_law(rollout, stretch_stiffness, "K_s", *windows_s)


SPAN_M, HEIGHT_M, SHEAR_SETTLED_S = 0.1, 0.4, 0.15


def upright_sheet(made_of: Fabric) -> Scene:
    """Return an upright sheet between two clamped upright edges: sag 0.3 mm, largest shear 1.2 %, period 31 ms.

    Far from the upper and lower edge there is shear, and neither bending nor stretch. A bending stiffness of
    rho g L^3 / 177 (shear buckling of a clamped strip) prevents wrinkles; the sheets have 3.6 times that. A larger one
    would add to the shear of engines whose bending is a quadratic form in all coordinates: D (pi / L)^2, here 0.5 %.
    """
    pose = Pose.from_euler_deg((0.0, 0.0, LEVEL_M), (90.0, 0.0, 0.0))
    return clamped(
        sheet(made_of, pose, (SPAN_M, HEIGHT_M)),
        Region(axis="x", side="low"),
        Region(axis="x", side="high"),
        duration_s=0.6,
    )


def shear_stiffness(rollout: Recording) -> Measurement:
    """Measure K_sh [N/m] from the sag of an upright sheet at middle height: w = rho g (L s - s^2) / (2 K_sh)."""
    cloth = _cloth_of(rollout)
    rest, now = _equilibrium(rollout, SHEAR_SETTLED_S)
    s = 0.5 * SPAN_M + rest[:, 0]
    middle = np.abs(rest[:, 1]) < 0.5 * HEIGHT_M - SPAN_M + PLACE_TOLERANCE_M
    free = middle & (s > PLACE_TOLERANCE_M) & (s < SPAN_M - PLACE_TOLERANCE_M)
    slope = coefficient((rest - now)[free, 1], 0.5 * (SPAN_M * s - s**2)[free])
    load = cloth.areal_density_kg_per_m2 * rollout.scene.gravity_m_per_s2
    return stiffness(load, slope, cloth.shear_stiffness_n_per_m)


SHEAR_FABRICS = (
    fabric(0.25, 27.5, 5e-5),
    fabric(0.35, 44.0, 8e-5),
    fabric(0.6, 66.0, 1.2e-4),
)


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
    scene = side_by_side(
        {
            f"sheet {number}": upright_sheet(one)
            for number, one in enumerate(SHEAR_FABRICS)
        },
        speed_m_per_s=6.0,
        late_s=0.4,
    )
    rollout = lab.rollout(scene)
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
    cloth = sheet(made_of, Pose(position_m=(0.0, 0.0, height_m)), size_m)
    return clamped(
        cloth,
        Region(axis="x", side="low", depth_m=CLAMP_SHARE * free_m),
        duration_s=BENT_S * math.sqrt(scale * BENT_GRAVITY / gravity),
        gravity_m_per_s2=gravity,
    )


def bending_stiffness(rollout: Recording) -> Measurement:
    """Measure the bending stiffness per width [N m] from the droop of a clamped strip: D w'' = rho g (L - s)^2 / 2."""
    cloth = _cloth_of(rollout)
    rest, now = _equilibrium(rollout, SETTLED_SHARE * rollout.scene.duration_s)
    axis = int(np.argmax(cloth.size_m))
    free_m = cloth.size_m[axis] / (1.0 + CLAMP_SHARE)
    s = rest[:, axis] + 0.5 * cloth.size_m[axis] - CLAMP_SHARE * free_m
    # Nodes are weighted by area, like the load, since a mesh's diagonals make its lines of nodes wavy.
    weights = node_masses_kg(cloth, rollout.nodes_m[cloth.name][0])
    slope = cantilever_load_over_stiffness(
        s, (rest - now)[:, 2], length_m=free_m, weights=weights / cloth.mass_kg
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
    scene = side_by_side(
        {
            "strip along the warp": cantilever_strip(BENT_FABRIC),
            "strip along the weft": _along_weft(cantilever_strip(light)),
            "third strip": cantilever_strip(heavy),
        },
        speed_m_per_s=2.0,
        late_s=0.9,
    )
    rollout = lab.rollout(scene)
    windows_s = ((0.35, BENT_S), (BENT_S + RAMP_S, BENT_S + RAMP_S + 0.9))
    return worst_law(rollout, bending_stiffness, "D", *windows_s)


# --- contact ---------------------------------------------------------------------------------------------------------

SLAB_M, SLOPE_DEG = (1.0, 0.4, 0.02), 30.0
ABOVE_M = 0.5 * SLAB_M[2] + 0.5 * LIGHT_FABRIC.thickness_m
SLIDE_FRICTION, CARRY_FRICTION = 0.3, 0.2
SLIDE_S = 0.4


def _slide_friction(lab: Lab) -> float:
    """Return the friction of a sheet that slides down a fixed slab: a = g (sin - mu cos)."""
    slope = Pose.from_euler_deg((0.0, 0.0, LEVEL_M), (0.0, SLOPE_DEG, 0.0))
    place_m = vector(slope.to_world(np.array([-0.3, 0.0, ABOVE_M])))
    pose = Pose(position_m=place_m, quaternion=slope.quaternion)
    slab = fixed_box("slab", slope.position_m, SLAB_M, euler_deg=(0.0, SLOPE_DEG, 0.0))
    scene = Scene(
        bodies=(slab,),
        deformables=(sheet(LIGHT_FABRIC, pose, (0.15, 0.15)),),
        contacts=(contact("cloth", "slab", friction=SLIDE_FRICTION),),
        duration_s=SLIDE_S,
    )
    rollout = lab.rollout(scene)
    window = rollout.between(0.1, SLIDE_S)
    mean_m = slope.to_body(rollout.nodes_m["cloth"][window].mean(axis=1))[:, 0]
    acceleration = acceleration_m_per_s2(rollout.times_s[window], mean_m)
    return slide_friction(acceleration, math.radians(SLOPE_DEG), gravity_m_per_s2=G)


def _carry_friction(lab: Lab) -> float:
    """Return the friction of a sheet on a slab that is driven by 10 m/s^2: a = mu g."""
    pose = Pose(position_m=(0.0, 0.0, LEVEL_M + ABOVE_M))
    pull = ramp(0.9, start_s=0.0, duration_s=0.6, ramp_s=0.3)
    scene = Scene(
        bodies=(driven_box("slab", (0.0, 0.0, LEVEL_M), SLAB_M),),
        deformables=(sheet(LIGHT_FABRIC, pose, (0.1, 0.1)),),
        contacts=(contact("slab", "cloth", friction=CARRY_FRICTION),),
        drivers=(driver("slab", "translate", (1.0, 0.0, 0.0), pull),),
        duration_s=0.3,
    )
    rollout = lab.rollout(scene)
    window = rollout.between(0.05, 0.3)
    mean_m = rollout.nodes_m["cloth"][window, :, 0].mean(axis=1)
    return acceleration_m_per_s2(rollout.times_s[window], mean_m) / G


@check(
    "cloth-slide",
    title="friction of cloth",
    law="a = g (sin 30 - mu cos 30) on the slope, a = mu g on the driven slab",
    source="Coulomb",
    tolerance=Tolerance(
        "the many light contacts of a sheet flutter, and some are open", relative=0.05
    ),
    cause="friction of cloth comes from one global constant, or is combined otherwise than that of rigid pairs",
)
def _cloth_slide(lab: Lab) -> Measurement:
    """A sheet on a fixed slab that leans by 30 degrees, friction 0.3; one on a slab driven by 10 m/s^2, friction 0.2.

    Friction from the mean acceleration of the nodes, quadratic fit, over that of the scene; the worse.
    """
    ratios = {
        "the fixed slope": _slide_friction(lab) / SLIDE_FRICTION,
        "the driven slab": _carry_friction(lab) / CARRY_FRICTION,
    }
    measured, hint = worst_ratio(ratios, "friction")
    return Measurement(measured=measured, expected=1.0, hint=hint)


@check(
    "cloth-rests-on",
    title="cloth lies on fixed, driven and free bodies",
    law="height = thickness / 2",
    **REST,
)
def _cloth_rests_on(lab: Lab) -> Measurement:
    """Three sheets, 2, 6 and 12 mm thick: on a fixed slab, on a driven slab that stands still, and on a free slab.

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
    cloth = sheet(
        SUPPLE_FABRIC, Pose(position_m=(0.0, 0.0, LEVEL_M)), (2.0 * HALF_M, 0.05)
    )
    middle = (0.5 * (HALF_M + EDGE_M[0]), 0.0, LEVEL_M + 0.5 * EDGE_M[1])
    turn = ramp(-math.pi, start_s=0.0, duration_s=FOLD_S, ramp_s=0.2)
    half = Region(axis="x", side="low", depth_m=HALF_M)
    end = Region(axis="x", side="high")
    scene = Scene(
        bodies=(FRAME, driven_box("rod", (HALF_M, 0.0, LEVEL_M), (0.01, 0.06, 0.01))),
        deformables=(cloth,),
        attachments=(
            Attachment(deformable="cloth", region=half, to=FRAME.name),
            Attachment(deformable="cloth", region=end, to="rod"),
        ),
        contacts=(contact("cloth", "cloth", friction=0.1),),
        drivers=(driver("rod", "rotate", (0.0, 1.0, 0.0), turn, point_m=middle),),
        duration_s=FOLDED_S,
    )
    rollout = lab.rollout(scene)
    nodes_m = rollout.nodes_m["cloth"]
    late = rollout.between(FOLDED_S - 0.2, math.inf)
    is_free = nodes_m[0, :, 0] > PLACE_TOLERANCE_M
    free_m = nodes_m[late][:, is_free].mean(axis=0)
    over_m = free_m[free_m[:, 0] < -PLACE_TOLERANCE_M, 2] - LEVEL_M
    lowest_m = float(over_m.min(initial=math.inf))
    hint = ""
    if largest_mm((nodes_m - nodes_m[0])[:, ~is_free]) > 1.0:
        hint = "the clamped half leaves its place: it is not attached to the fixed body"
    measured_mm = 1e3 * (lowest_m - SUPPLE_FABRIC.thickness_m)
    return Measurement(measured=measured_mm, hint=hint)


# --- air -------------------------------------------------------------------------------------------------------------

AIR = Air(density_kg_per_m3=1.2, normal_coefficient=0.0)
AIR_COEFFICIENT = 1.5
AIR_FABRIC = fabric(0.1, 110.0, 1e-4)
RATE_PER_M = (
    0.5 * AIR.density_kg_per_m3 * AIR_COEFFICIENT / AIR_FABRIC.areal_density_kg_per_m2
)
"""k [1/m] of the law du/dt = -k |u| u: 9."""

WIND_M_PER_S, INCIDENCE_DEG = 2.0, 40.0


def _blown(
    lab: Lab, air: Air, seconds: float, *, lean_deg: float, gravity: float
) -> tuple[FloatArray, FloatArray]:
    """Return times [s] and the mean displacement of a free sheet along its first edge and its normal [m]."""
    pose = Pose.from_euler_deg((0.0, 0.0, 2.0), (0.0, lean_deg, 0.0))
    scene = Scene(
        bodies=(FRAME,),
        deformables=(sheet(AIR_FABRIC, pose, (0.15, 0.15)),),
        duration_s=seconds,
        gravity_m_per_s2=gravity,
        air=air,
    )
    rollout = lab.rollout(scene)
    local_m = pose.to_body(rollout.nodes_m["cloth"].mean(axis=1))
    return rollout.times_s, (local_m - local_m[0])[:, [0, 2]]


@check(
    "air-pressure",
    title="air: pressure, friction and lift",
    law="du/dt = -k |u| u along the normal or in the plane; lift: da/dt = -k |u| sin a cos a; k = rho C / (2 m / A)",
    source="quadratic drag, Newton's law of resistance (scene.air)",
    tolerance=Tolerance(
        "a tenth of what is known of drag coefficients; explicit steps of 1 ms are off by 0.7 %",
        relative=0.02,
    ),
    cause="the factor 1/2, the areas of triangles, or the direction of the force is another one (scene.Air)",
    optional=True,
)
def _air_pressure(lab: Lab) -> Measurement:
    """Free sheets of cloth: falling flat, and without gravity in a wind of 2 m/s that meets the plane at 40 degrees.

    k from the terminal speed, and from the relative velocity under pressure, friction and lift alone, over that of
    the law; the worst.
    """
    # A flat sheet under a uniform load does not deform. With u at the start w: 1 / u = 1 / w + k t.
    ratios = {}
    pressure = replace(AIR, normal_coefficient=AIR_COEFFICIENT)
    times_s, moved_m = _blown(lab, pressure, 0.8, lean_deg=0.0, gravity=G)
    late = times_s > 0.6
    speed = steady_speed_m_per_s(times_s[late], moved_m[late, 1])
    # v^2 = g / k
    ratios["the fall"] = G / RATE_PER_M / (speed * abs(speed)) * -1.0
    angle = math.radians(INCIDENCE_DEG)
    wind = WIND_M_PER_S * np.array([math.cos(angle), math.sin(angle)])
    cases = {
        "pressure": (1, 1.2, {"normal_coefficient": AIR_COEFFICIENT}),
        "friction": (0, 1.2, {"tangential_coefficient": AIR_COEFFICIENT}),
        "lift": (0, 0.1, {"lift_coefficient": AIR_COEFFICIENT}),
    }
    for name, (axis, seconds, coefficients) in cases.items():
        air = replace(AIR, wind_m_per_s=(WIND_M_PER_S, 0.0, 0.0), **coefficients)
        times_s, moved_m = _blown(
            lab, air, seconds, lean_deg=INCIDENCE_DEG, gravity=0.0
        )
        relative = wind - np.gradient(moved_m, times_s, axis=0)
        if name == "lift":
            # |u| = w and tan a = tan a0 exp(-k w t); the last sample is no central difference.
            along, across = relative[-2]
            lost = math.log(math.tan(angle) / (across / along))
            ratios[name] = lost / (RATE_PER_M * WIND_M_PER_S * times_s[-2])
            ratios["the speed under lift"] = math.hypot(along, across) / WIND_M_PER_S
            continue
        for start_s, end_s in ((0.0, 0.25), (0.25, 1.15)):
            at = np.searchsorted(times_s, [start_s + 1e-9, end_s])
            growth = 1.0 / relative[at[1], axis] - 1.0 / relative[at[0], axis]
            seconds = times_s[at[1]] - times_s[at[0]]
            ratios[f"{name} from {start_s:g} s"] = growth / seconds / RATE_PER_M
    measured, hint = worst_ratio(ratios, "k")
    return Measurement(measured=measured, expected=1.0, hint=hint)
