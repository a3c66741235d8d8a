"""Cloth: stretch, shear and bending stiffness, a driven edge, energy.

The contract has no forces, so a sheet's own weight loads it. Engines damp as they like: one sheet swings about its
equilibrium for ever, another creeps into it. The mean displacement under a Hann window (`laws.hann_mean`), over at
least four periods and after the start, is the equilibrium of both. Strains are 1 % at most, or slopes 0.1, so that
laws of large strain, in which engines differ, do not matter. Equilibrium displacements are fitted to the closed form
with the clamp's place (and slope, in bending) left free: depending on the mesh, a clamp acts up to a cell away from
where it should. In tension, nodes within one width of it are left out, as it hinders contraction.

K_s / K_sh is 2.7 throughout (`parts.STRETCH_OVER_SHEAR`), so that every engine can represent the fabric.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gauge_envs.checks.conformance.attachments import pinned_reading
from gauge_envs.checks.conformance.kit import Measurement, Tolerance, check
from gauge_envs.checks.conformance.lab import Lab
from gauge_envs.checks.conformance.laws import PLACE_TOLERANCE_M, cantilever_load_over_stiffness, hann_mean
from gauge_envs.checks.conformance.parts import STRETCH_OVER_SHEAR, fixed_box, sheet, strip_on_rod
from gauge_envs.checks.rollout import Course
from gauge_envs.scene import GRAVITY_M_PER_S2, Attachment, Cloth, Contact, Pose, Region, Scene

__all__: list[str] = []

G = GRAVITY_M_PER_S2
FRAME = fixed_box("frame", (0.0, 0.0, 3.0), (0.1, 0.1, 0.1))
"""What clamped edges are glued to; where it is does not matter, so it is out of the way."""


def _clamped(cloth: Cloth, *regions: Region, seconds: float, gravity: float = G) -> Scene:
    glue = tuple(Attachment(deformable=cloth.name, region=region, to="frame") for region in regions)
    return Scene(bodies=(FRAME,), deformables=(cloth,), attachments=glue, duration_s=seconds, gravity_m_per_s2=gravity)


def _local(course: Course) -> NDArray[np.float64]:
    """Nodes in the cloth's frame [m], shape [sample_count, node_count, 3]."""
    return np.array([course.scene.deformables[0].pose.to_body(nodes) for nodes in course.nodes_m["cloth"]])


def _equilibrium(course: Course, settled_s: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Nodes at the start and in equilibrium, in the cloth's frame [m], each of shape [node_count, 3]."""
    local = _local(course)
    return local[0], hann_mean(local[course.between(settled_s, float(course.times_s[-1]))])


def _coefficient(values: NDArray[np.float64], *columns: NDArray[np.float64]) -> float:
    """Coefficient of the first column in a least-squares fit."""
    return float(np.linalg.lstsq(np.column_stack(columns), values, rcond=None)[0][0])


# --- stretch ---------------------------------------------------------------------------------------------------------

HANG_M, HANG_WIDTH_M = 0.3, 0.075
HANG_DENSITY, HANG_STRETCH = 0.2, 110.0
HANG_S, HANG_SETTLED_S = 0.8, 0.2


def _hanging(lab: Lab) -> Course:
    """A strip that hangs from its upper edge: sag 0.8 mm, largest strain 0.5 %, period 51 ms."""
    pose = Pose.from_euler_deg((0.0, 0.0, 1.0), (0.0, -90.0, 0.0))
    cloth = sheet(pose, (HANG_M, HANG_WIDTH_M), areal_density=HANG_DENSITY, stretch_n_per_m=HANG_STRETCH, bend_n_m=1e-4)
    return lab.course(_clamped(cloth, Region(axis="x", side="high"), seconds=HANG_S), HANG_S)


@check(
    "cloth-start",
    title="cloth, start",
    measures="largest distance of a side of the nodes' bounding box from the sheet's edges, in its frame, at the start",
    law="Cloth.size_m, Cloth.pose",
    source="contract (Simulation.nodes)",
    unit="mm",
    tolerance=Tolerance(absolute=0.01, rationale="a float's rounding at 1 m is 0.1 um"),
    diagnosis="nodes are world positions in metres; the sheet is centred on its pose, warp along x",
)
def _cloth_start(lab: Lab) -> Measurement:
    course = lab.once(_hanging)
    rest = _local(course)[0]
    half = 0.5 * np.array([HANG_M, HANG_WIDTH_M, 0.0])
    miss = float(np.abs(np.concatenate([rest.min(axis=0) + half, rest.max(axis=0) - half])).max())
    return Measurement(measured=1e3 * miss, expected=0.0, hint="positions are in mm" if miss > 10.0 else "")


@check(
    "cloth-stretch",
    title="cloth, stretch stiffness K_s",
    measures="K_s from the mean sag of a strip under its own weight, one width below its clamped edge and further",
    law="u(s) = rho g (L s - s^2 / 2) / K_s",
    source="uniaxial tension with free transverse edges (scene.Cloth)",
    unit="N/m",
    tolerance=Tolerance(
        relative=0.02,
        rationale="nonlinear laws differ by as much as the largest strain, 0.5 % at rest, 1 % in full swing",
    ),
    diagnosis="look at the membrane's constants (K_s is the uniaxial stiffness: K_s = 4 mu (lambda + mu) / (lambda + "
    "2 mu)), at the mass of the nodes, and at a solver that is not converged, which lets the strip hang too deep",
)
def _cloth_stretch(lab: Lab) -> Measurement:
    rest, now = _equilibrium(lab.once(_hanging), HANG_SETTLED_S)
    s = 0.5 * HANG_M - rest[:, 0]
    free = s > HANG_WIDTH_M - PLACE_TOLERANCE_M
    slope = _coefficient((rest - now)[free, 0], (HANG_M * s - 0.5 * s**2)[free], np.ones(free.sum()))
    return _stiffness(HANG_DENSITY * G, slope, HANG_STRETCH, "it stretches")


def _stiffness(load: float, slope: float, expected: float, verb: str) -> Measurement:
    """Stiffness from a load and a fitted coefficient; infinite where nothing gives way."""
    if not slope > 0.0:
        return Measurement(measured=float("inf"), expected=expected, hint=f"under its weight, {verb} not at all")
    ratio = expected * slope / load
    return Measurement(measured=load / slope, expected=expected, hint=f"{verb} {ratio:.3g} times as much as it should")


# --- shear -----------------------------------------------------------------------------------------------------------

SPAN_M, HEIGHT_M = 0.1, 0.4
SHEAR_DENSITY, SHEAR_STRETCH = 0.25, 27.5
SHEAR_S, SHEAR_SETTLED_S = 0.6, 0.15


def _sheared(lab: Lab) -> Course:
    """An upright sheet between two clamped upright edges: sag 0.3 mm, largest shear 1.2 %, period 31 ms.

    Far from its upper and lower edge nothing depends on the height: each column is sheared and neither bent nor
    stretched. A bending stiffness of rho g L^3 / 177 (shear buckling of a clamped strip) keeps a sheet at rest from
    wrinkling; this one has 3.6 times that, as in full swing it carries twice the load. More would count as shear
    stiffness where bending is a quadratic form in all three coordinates: D (pi / L)^2, here 0.5 %.
    """
    pose = Pose.from_euler_deg((0.0, 0.0, 1.0), (90.0, 0.0, 0.0))
    cloth = sheet(pose, (SPAN_M, HEIGHT_M), areal_density=SHEAR_DENSITY, stretch_n_per_m=SHEAR_STRETCH, bend_n_m=5e-5)
    regions = (Region(axis="x", side="low"), Region(axis="x", side="high"))
    return lab.course(_clamped(cloth, *regions, seconds=SHEAR_S), SHEAR_S)


@check(
    "cloth-shear",
    title="cloth, shear stiffness K_sh",
    measures="K_sh from the mean sag, at middle height, of an upright sheet clamped along both upright edges",
    law="w(s) = rho g (L s - s^2) / (2 K_sh)",
    source="simple shear of a wide sheet (scene.Cloth)",
    unit="N/m",
    tolerance=Tolerance(
        relative=0.05, rationale="a few per cent come from the free edges and from the mesh's diagonals"
    ),
    diagnosis="look at the membrane's shear constant (K_sh = mu of an isotropic one); springs along edges alone give "
    "K_s / 2 or less",
)
def _cloth_shear(lab: Lab) -> Measurement:
    rest, now = _equilibrium(lab.once(_sheared), SHEAR_SETTLED_S)
    s = 0.5 * SPAN_M + rest[:, 0]
    middle = np.abs(rest[:, 1]) < 0.5 * HEIGHT_M - SPAN_M + PLACE_TOLERANCE_M
    free = middle & (s > PLACE_TOLERANCE_M) & (s < SPAN_M - PLACE_TOLERANCE_M)
    if free.sum() < 3:
        return Measurement(measured=float("nan"), expected=SHEAR_STRETCH / STRETCH_OVER_SHEAR, hint="too few nodes")
    slope = _coefficient((rest - now)[free, 1], 0.5 * (SPAN_M * s - s**2)[free])
    return _stiffness(SHEAR_DENSITY * G, slope, SHEAR_STRETCH / STRETCH_OVER_SHEAR, "it shears")


# --- bending ---------------------------------------------------------------------------------------------------------

CLAMP_M, FREE_M, STRIP_WIDTH_M = 0.05, 0.15, 0.1
BEND_DENSITY, BEND_STIFFNESS = 0.2, 6.2e-3
BEND_GRAVITY = 0.2 * G
BEND_S, BEND_SETTLED_S = 1.3, 0.35


def _cantilever(lab: Lab) -> Course:
    """A horizontal strip clamped at one end, at a fifth of gravity: sag 4 mm on 150 mm, period 0.23 s.

    At full gravity it would swing through a slope of 0.5, where the moment of its weight is a fifth less near the tip.
    """
    pose = Pose(position_m=(0.0, 0.0, 1.0))
    cloth = sheet(
        pose,
        (CLAMP_M + FREE_M, STRIP_WIDTH_M),
        areal_density=BEND_DENSITY,
        stretch_n_per_m=110.0,
        bend_n_m=BEND_STIFFNESS,
    )
    clamp = Region(axis="x", side="low", depth_m=CLAMP_M)
    return lab.course(_clamped(cloth, clamp, seconds=BEND_S, gravity=BEND_GRAVITY), BEND_S)


@check(
    "cloth-bending",
    title="cloth, bending stiffness",
    measures="bending stiffness per width from the mean droop of a strip clamped at one end, along the warp",
    law="D w'' = rho g (L - s)^2 / 2",
    source="heavy elastica at small slope; D = K_theta on a square grid (materials.plate_bending_stiffness)",
    unit="N m",
    tolerance=Tolerance(
        relative=0.2,
        rationale="K_theta belongs to a hinge, and triangulations share it out differently: 0.88 along grid lines by "
        "the paper's own mapping",
    ),
    diagnosis="look at how K_theta becomes the constant of an edge (its length, its neighbours' heights), and whether "
    "a clamp of 50 mm holds the slope: it must glue two lines of nodes",
)
def _cloth_bending(lab: Lab) -> Measurement:
    rest, now = _equilibrium(lab.once(_cantilever), BEND_SETTLED_S)
    s = rest[:, 0] + 0.5 * (CLAMP_M + FREE_M) - CLAMP_M
    # Weighed by area, as the load is: a mesh's diagonals make its lines of nodes wavy.
    shares = _node_shares(rest, (CLAMP_M + FREE_M, STRIP_WIDTH_M))
    slope = cantilever_load_over_stiffness(s, (rest - now)[:, 2], length_m=FREE_M, weights=shares)
    return _stiffness(BEND_DENSITY * BEND_GRAVITY, slope, BEND_STIFFNESS, "it bends")


# --- energy ----------------------------------------------------------------------------------------------------------


def _node_shares(rest_m: NDArray[np.float64], size_m: tuple[float, float]) -> NDArray[np.float64]:
    """Share of the sheet's area that is nearest to each node, shape [node_count]: works for any mesh."""
    x, y = ((np.arange(400) + 0.5) / 400 * size - 0.5 * size for size in size_m)
    points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    nearest = cKDTree(rest_m[:, :2]).query(points)[1]
    return np.bincount(nearest, minlength=len(rest_m)) / len(points)


@check(
    "cloth-energy",
    title="cloth gains no energy",
    measures="largest gain of kinetic and potential energy of the drooping strip, over what potential it gives up",
    law="T + V <= its start, as elastic energy is not negative and starts at 0",
    source="elasticity is passive",
    unit="%",
    tolerance=Tolerance(absolute=5.0, rationale="masses and speeds of nodes are estimated from their places"),
    diagnosis="the solver makes energy: step too long, iterations capped, or stiffness taken explicitly",
)
def _cloth_energy(lab: Lab) -> Measurement:
    course = lab.once(_cantilever)
    local = _local(course)
    shares = _node_shares(local[0], (CLAMP_M + FREE_M, STRIP_WIDTH_M))
    speed = np.gradient(local, course.times_s, axis=0)
    potential = BEND_GRAVITY * (local[:, :, 2] - local[0, :, 2]) @ shares
    total = potential + 0.5 * np.square(speed).sum(axis=2) @ shares
    return Measurement(measured=100.0 * float(total.max() / max(-potential.min(), 1e-12)), expected=0.0)


# --- driven edge -----------------------------------------------------------------------------------------------------

ROD_S = 0.5


@check(
    "cloth-pinned-edge",
    title="cloth, glued edge follows its driven body",
    measures="largest distance of a node of the glued edge from its place on the driven rod, within 0.5 s",
    law="place on the driven body = const",
    source="contract (scene.Attachment)",
    unit="mm",
    tolerance=Tolerance(absolute=0.1, rationale="a tenth of the real trials' scatter"),
    diagnosis="glued nodes lag or lead by an interval, hang on soft springs, or do not turn with the body",
)
def _cloth_pinned_edge(lab: Lab) -> Measurement:
    return pinned_reading(lab.course(strip_on_rod(), ROD_S), "cloth")


# --- contact ---------------------------------------------------------------------------------------------------------

SLAB_M, SQUARE_M, FRICTION = (1.0, 0.4, 0.02), 0.15, 0.3
SLOPE = Pose.from_euler_deg((0.0, 0.0, 1.0), (0.0, 30.0, 0.0))
CONTACT_S = 0.4


def _sliding(lab: Lab) -> Course:
    """A sheet on a slab that is tilted by 30 degrees, its mid-plane half its thickness above the slab."""
    x, y, z = SLOPE.to_world(np.array([-0.3, 0.0, 0.5 * SLAB_M[2] + 0.5e-3]))
    pose = Pose(position_m=(float(x), float(y), float(z)), quaternion=SLOPE.quaternion)
    cloth = sheet(pose, (SQUARE_M, SQUARE_M), areal_density=0.2, stretch_n_per_m=110.0, bend_n_m=1e-4)
    scene = Scene(
        bodies=(fixed_box("slab", SLOPE.position_m, SLAB_M, euler_deg=(0.0, 30.0, 0.0)),),
        deformables=(cloth,),
        contacts=(Contact(first=("cloth",), second=("slab",), friction=FRICTION, restitution=0.0),),
        duration_s=CONTACT_S,
    )
    return lab.course(scene, CONTACT_S)


def _on_slab(course: Course) -> NDArray[np.float64]:
    """Nodes in the slab's frame [m], shape [sample_count, node_count, 3]."""
    return np.array([SLOPE.to_body(nodes) for nodes in course.nodes_m["cloth"]])


@check(
    "cloth-slide",
    title="cloth slides on 30 degrees",
    measures="acceleration downhill of a sheet with friction 0.3, mean over its nodes, quadratic fit from 0.1 to 0.4 s",
    law="a = g (sin 30 - mu cos 30)",
    source="Coulomb",
    unit="m/s^2",
    tolerance=Tolerance(
        relative=0.05,
        rationale="a sheet is many light contacts, which flutter: not all touch all the time",
    ),
    diagnosis="look at the friction of cloth against rigid bodies: engines often take it from one global constant, or "
    "combine it otherwise than that of rigid pairs",
)
def _cloth_slide(lab: Lab) -> Measurement:
    course = lab.once(_sliding)
    window = course.between(0.1, CONTACT_S)
    way = _on_slab(course)[window, :, 0].mean(axis=1)
    sine, cosine = np.sin(np.radians(30.0)), np.cos(np.radians(30.0))
    measured = float(2.0 * np.polyfit(course.times_s[window], way, 2)[0])
    effective = (sine - measured / G) / cosine
    hint = f"it slides as if the friction were {effective:.3g} instead of {FRICTION:g}"
    return Measurement(measured=measured, expected=G * (sine - FRICTION * cosine), hint=hint)


@check(
    "cloth-rests",
    title="cloth lies on what it touches",
    measures="largest distance of a node's height over the slab from half the sheet's thickness, 0.3 to 0.4 s",
    law="height = thickness / 2",
    source="contact (scene.Contact), thickness (scene.Cloth)",
    unit="mm",
    tolerance=Tolerance(
        absolute=2.0, rationale="twice the real trials' scatter: folding cloth needs a layer of about 2 mm"
    ),
    diagnosis="it falls through, sinks in, or floats on a collision radius that is larger than the cloth's own",
)
def _cloth_rests(lab: Lab) -> Measurement:
    course = lab.once(_sliding)
    height = _on_slab(course)[course.between(0.3, CONTACT_S), :, 2] - 0.5 * SLAB_M[2] - 0.5e-3
    return Measurement(measured=1e3 * float(np.abs(height).max()), expected=0.0)
