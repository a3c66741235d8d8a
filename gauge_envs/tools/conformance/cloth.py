"""Cloth: stretch, shear and bending stiffness, a driven edge, energy. The recipes of fabrics use its strips too.

The contract has no forces, so the load is the sheet's own weight. Engines differ in damping: a sheet may oscillate
about its equilibrium or creep towards it. The mean displacement under a Hann window (`laws.hann_mean`), over at least
four periods after the start, is the equilibrium in both cases. Strains are at most 1 %, or slopes 0.1, so that
differences between laws of large strain do not matter. The closed form is fitted to the equilibrium displacements, and
the clamp's place (in bending also its slope) is a free parameter, since the clamp of a mesh can be off by up to one
cell. In tension the fit ignores nodes within one width of the clamp, which hinders contraction.

K_s / K_sh is 2.7 in all scenes (`lab.STRETCH_OVER_SHEAR`), so that every engine can represent the fabric.
"""

import math
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from gauge_envs.scene import GRAVITY_M_PER_S2 as G, Cloth, Pose, Region, Scene
from gauge_envs.scene.fabrics import Fabric
from gauge_envs.scene.geometry import FloatArray, vector
from gauge_envs.scoring.estimators import acceleration_m_per_s2, hann_mean
from gauge_envs.tools.bench.parts import contact, fixed_box
from gauge_envs.tools.bench.recording import Recording
from gauge_envs.tools.conformance.lab import (
    LIGHT_FABRIC,
    STRIP_ON_ROD,
    Lab,
    clamped,
    fabric,
    sheet,
    strip_on_rod,
)
from gauge_envs.tools.conformance.laws import (
    ATTACHED,
    NODES,
    PLACE_TOLERANCE_M,
    SLIDE_SLOPE_DEG,
    attachment_error,
    bounds_error,
    cantilever_load_over_stiffness,
    coefficient,
    slide_acceleration,
    stiffness,
)
from gauge_envs.tools.conformance.lift import Lift
from gauge_envs.tools.conformance.model import Check, Measurement, recorded

HANG_M, HANG_WIDTH_M = 0.3, 0.075

CLAMP_SHARE, WIDTH_SHARE = 1.0 / 3.0, 2.0 / 3.0
BENT_FREE_M = 0.15
"""Free length of the cantilever of the conformance checks [m]."""

BENT_S, SETTLED_SHARE = 1.3, 0.35 / 1.3
BENT_GRAVITY = 0.2 * G


BENT_FABRIC = fabric(0.2, 110.0, 6.2e-3)
"""Fabric of the check of bending: at a fifth of gravity it sags by 4 mm on 150 mm, with a period of 0.23 s.

At full gravity its slope would reach 0.5, and the moment of its weight near the tip would be a fifth too small.
"""


def strip_of(rollout: Recording) -> Cloth:
    """Return the strip of a scene of this module."""
    (cloth,) = rollout.scene.deformables
    assert isinstance(cloth, Cloth), "the scene has a strip alone"
    return cloth


def local_nodes(rollout: Recording) -> FloatArray:
    """Return nodes in the cloth's frame [m], shape [sample_count, node_count, 3]."""
    return np.array(
        [strip_of(rollout).pose.to_body(nodes) for nodes in rollout.nodes_m["cloth"]]
    )


def equilibrium(rollout: Recording, settled_s: float) -> tuple[FloatArray, FloatArray]:
    """Return nodes at the start and in equilibrium, in the cloth's frame [m], each of shape [node_count, 3]."""
    local = local_nodes(rollout)
    return local[0], hann_mean(
        local[rollout.between(settled_s, float(rollout.times_s[-1]))]
    )


def node_shares(rest_m: FloatArray, size_m: tuple[float, float]) -> FloatArray:
    """Return the share of the sheet's area that is nearest to each node, for any mesh, shape [node_count]."""
    x, y = ((np.arange(400) + 0.5) / 400 * size - 0.5 * size for size in size_m)
    points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    nearest = cKDTree(rest_m[:, :2]).query(points)[1]
    return np.bincount(nearest, minlength=len(rest_m)) / len(points)


def hanging_strip(made_of: Fabric) -> Scene:
    """Return a strip of 0.3 m by 0.075 m that hangs from its upper edge, warp downward."""
    pose = Pose.from_euler_deg((0.0, 0.0, 1.0), (0.0, -90.0, 0.0))
    cloth = sheet(made_of, pose, (HANG_M, HANG_WIDTH_M))
    return clamped(cloth, Region(axis="x", side="high"), duration_s=0.8)


def cantilever_strip(
    made_of: Fabric, free_m: float = BENT_FREE_M, *, height_m: float = 1.0
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


# --- checks ----------------------------------------------------------------------------------------------------------


def _along_weft(scene: Scene) -> Scene:
    """Return the scene of a clamped strip whose length lies along the weft."""
    (cloth,) = scene.deformables
    assert isinstance(cloth, Cloth), "the scene has a strip alone"
    # A quarter turn about the normal takes the strip's y axis to where its x axis was.
    quarter = Rotation.from_euler("z", -90.0, degrees=True)
    pose = Pose.from_rotation(cloth.pose.position_m, cloth.pose.rotation * quarter)
    (attachment,) = scene.attachments
    region = replace(attachment.region, axis="y")
    return replace(
        scene,
        deformables=(replace(cloth, pose=pose, size_m=cloth.size_m[::-1]),),
        attachments=(replace(attachment, region=region),),
    )


STRONG_FABRIC = fabric(2.4, 1250.0, 2e-4)
"""Fabric that is heavier and stronger than those of most ids, and sags as the light one."""
WARP, WEFT = "strip along the warp", "strip along the weft"
_hanging_lift = Lift(
    {
        WARP: hanging_strip(LIGHT_FABRIC),
        WEFT: _along_weft(hanging_strip(STRONG_FABRIC)),
    },
    speed_m_per_s=13.0,
    late_s=1.0,
)
_hanging = _hanging_lift.recorded(
    "two strips of cloth, 0.3 m by 0.075 m, that hang from their upper edge, one along the warp and one, of another "
    "fabric, along the weft"
)
"""They sag by 0.8 mm, their largest strain is 0.5 %, and their period 51 ms."""


@_hanging.check("cloth-start", **NODES)
def _cloth_start(rollout: Recording) -> Measurement:
    found = [
        bounds_error(local_nodes(part)[0], (*strip_of(part).size_m, 0.0))
        for _, part in _hanging_lift.parts(rollout)
    ]
    worst = max(found, key=lambda one: one.measured)
    return replace(worst, hint="positions are in mm") if worst.measured > 1e4 else worst


@Check("cloth-pinned-edge", scene=STRIP_ON_ROD, **ATTACHED)
def _cloth_pinned_edge(lab: Lab) -> Measurement:
    return attachment_error(lab.rollout(strip_on_rod(), 0.5), "cloth")


_cantilever_lift = Lift(
    {
        WARP: cantilever_strip(BENT_FABRIC),
        WEFT: _along_weft(cantilever_strip(fabric(0.15, 140.0, 4.65e-3))),
    },
    speed_m_per_s=3.5,
    late_s=1.0,
)
_cantilever = _cantilever_lift.recorded(
    "two horizontal strips of cloth of 0.15 m, clamped at one end, one along the warp and one, of another fabric, "
    "along the weft, at a fifth of gravity"
)


@_cantilever.check("cloth-clamp")
def _cloth_clamp(rollout: Recording) -> Measurement:
    return _cantilever_lift.clamp_excess(rollout)


@_cantilever.check("cloth-held", **ATTACHED)
def _cloth_held(rollout: Recording) -> Measurement:
    return _cantilever_lift.held_error(rollout)


def stretch_stiffness(rollout: Recording) -> Measurement:
    """Measure K_s [N/m] from the sag of a strip, a width or more from its clamp: u = rho g (L s - s^2/2) / K_s."""
    cloth = strip_of(rollout)
    rest, now = equilibrium(rollout, 0.2)
    axis = int(np.argmax(cloth.size_m))
    s = 0.5 * HANG_M - rest[:, axis]
    free = s > HANG_WIDTH_M - PLACE_TOLERANCE_M
    slope = coefficient(
        (rest - now)[free, axis], (HANG_M * s - 0.5 * s**2)[free], np.ones(free.sum())
    )
    load = cloth.areal_density_kg_per_m2 * rollout.scene.gravity_m_per_s2
    return stiffness(load, slope, cloth.stretch_stiffness_n_per_m, "stretches")


_hanging.check("cloth-stretch")(
    _hanging_lift.ratio(stretch_stiffness, "the stretch stiffness K_s is")
)

SPAN_M, HEIGHT_M = 0.1, 0.4
SHEAR_DENSITY, SHEAR_STRETCH = 0.25, 27.5


def _upright(stretch_n_per_m: float, density_kg_per_m2: float) -> Scene:
    """Return an upright sheet between two clamped upright edges: sag 0.3 mm, largest shear 1.2 %, period 31 ms.

    Far from the upper and lower edge nothing depends on the height: there is shear, and neither bending nor stretch. A
    bending stiffness of rho g L^3 / 177 (shear buckling of a clamped strip) prevents wrinkles at rest. This sheet has
    3.6 times that, since an oscillating sheet carries twice the load. A larger one would add to the shear stiffness of
    engines whose bending is a quadratic form in all three coordinates: D (pi / L)^2, here 0.5 %.
    """
    pose = Pose.from_euler_deg((0.0, 0.0, 1.0), (90.0, 0.0, 0.0))
    bend_n_m = 5e-5 * stretch_n_per_m / SHEAR_STRETCH
    made_of = fabric(density_kg_per_m2, stretch_n_per_m, bend_n_m)
    return clamped(
        sheet(made_of, pose, (SPAN_M, HEIGHT_M)),
        Region(axis="x", side="low"),
        Region(axis="x", side="high"),
        duration_s=0.6,
    )


_shear_lift = Lift(
    {
        "first sheet": _upright(SHEAR_STRETCH, SHEAR_DENSITY),
        "second sheet": _upright(1.6 * SHEAR_STRETCH, 1.4 * SHEAR_DENSITY),
    },
    speed_m_per_s=13.0,
    late_s=1.0,
)
_sheared = _shear_lift.recorded(
    "two upright sheets of two fabrics, 0.1 m wide and 0.4 m high, clamped along both upright edges"
)


def _shear_stiffness(rollout: Recording) -> Measurement:
    cloth = strip_of(rollout)
    rest, now = equilibrium(rollout, 0.15)
    s = 0.5 * SPAN_M + rest[:, 0]
    middle = np.abs(rest[:, 1]) < 0.5 * HEIGHT_M - SPAN_M + PLACE_TOLERANCE_M
    free = middle & (s > PLACE_TOLERANCE_M) & (s < SPAN_M - PLACE_TOLERANCE_M)
    expected = cloth.shear_stiffness_n_per_m
    if free.sum() < 3:
        return Measurement(measured=math.nan, expected=expected, hint="too few nodes")
    slope = coefficient((rest - now)[free, 1], 0.5 * (SPAN_M * s - s**2)[free])
    return stiffness(cloth.areal_density_kg_per_m2 * G, slope, expected, "shears")


_sheared.check("cloth-shear")(
    _shear_lift.ratio(_shear_stiffness, "the shear stiffness K_sh is")
)


def bending_stiffness(rollout: Recording) -> Measurement:
    """Measure the bending stiffness per width [N m] from the droop of a clamped strip: D w'' = rho g (L - s)^2 / 2."""
    cloth = strip_of(rollout)
    rest, now = equilibrium(rollout, SETTLED_SHARE * rollout.scene.duration_s)
    axis = int(np.argmax(cloth.size_m))
    free_m = cloth.size_m[axis] / (1.0 + CLAMP_SHARE)
    s = rest[:, axis] + 0.5 * cloth.size_m[axis] - CLAMP_SHARE * free_m
    # Nodes are weighted by area, like the load, since a mesh's diagonals make its lines of nodes wavy.
    shares = node_shares(rest, cloth.size_m)
    slope = cantilever_load_over_stiffness(
        s, (rest - now)[:, 2], length_m=free_m, weights=shares
    )
    load = cloth.areal_density_kg_per_m2 * rollout.scene.gravity_m_per_s2
    return stiffness(load, slope, cloth.bend_stiffness_n_m_per_rad, "bends")


_cantilever.check("cloth-bending")(
    _cantilever_lift.ratio(bending_stiffness, "the bending stiffness K_theta is")
)


SLAB_M, FRICTION = (1.0, 0.4, 0.02), 0.3
SLOPE = Pose.from_euler_deg((0.0, 0.0, 1.0), (0.0, SLIDE_SLOPE_DEG, 0.0))


@recorded("a sheet of cloth on a fixed slab that leans by 30 degrees; friction 0.3")
def _sliding(lab: Lab) -> Recording:
    # The mid-plane starts half the thickness above the slab.
    start = SLOPE.to_world(np.array([-0.3, 0.0, 0.5 * SLAB_M[2] + 0.5e-3]))
    pose = Pose(position_m=vector(start), quaternion=SLOPE.quaternion)
    scene = Scene(
        bodies=(
            fixed_box(
                "slab", SLOPE.position_m, SLAB_M, euler_deg=(0.0, SLIDE_SLOPE_DEG, 0.0)
            ),
        ),
        deformables=(sheet(LIGHT_FABRIC, pose, (0.15, 0.15)),),
        contacts=(contact("cloth", "slab", friction=FRICTION),),
        duration_s=0.4,
    )
    return lab.rollout(scene)


def _on_slab(rollout: Recording) -> FloatArray:
    """Return nodes in the slab's frame [m], shape [sample_count, node_count, 3]."""
    return np.array([SLOPE.to_body(nodes) for nodes in rollout.nodes_m["cloth"]])


@_sliding.check("cloth-slide")
def _cloth_slide(rollout: Recording) -> Measurement:
    window = rollout.between(0.1, 0.4)
    positions = _on_slab(rollout)[window, :, 0].mean(axis=1)
    return slide_acceleration(
        acceleration_m_per_s2(rollout.times_s[window], positions), FRICTION
    )


@_sliding.check("cloth-rests")
def _cloth_rests(rollout: Recording) -> Measurement:
    height = (
        _on_slab(rollout)[rollout.between(0.3, 0.4), :, 2] - 0.5 * SLAB_M[2] - 0.5e-3
    )
    return Measurement(measured=1e3 * float(np.abs(height).max()))
