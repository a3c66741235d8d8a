"""Soft solids, ropes and rods: stiffness of a hanging bar and a clamped rod, length of a rope, and a driven face.

The method is that of `cloth`: the body's own weight is the load, the centre of the oscillation is the equilibrium, and
strains are small. The fit ignores nodes within one width of the clamp, which hinders contraction.
"""

from dataclasses import replace

import numpy as np
from scipy.special import j0, jn_zeros

from gauge_envs.scene import (
    GRAVITY_M_PER_S2 as G,
    Attachment,
    Box,
    Pose,
    Region,
    Rod,
    Rope,
    Scene,
    SoftBody,
)
from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S
from gauge_envs.scoring.estimators import hann_mean
from gauge_envs.tools.bench.parts import driven_box, driver, ramp
from gauge_envs.tools.bench.recording import Recording
from gauge_envs.tools.conformance.lab import Lab, clamped
from gauge_envs.tools.conformance.laws import (
    ATTACHED,
    NODES,
    PLACE_TOLERANCE_M,
    attachment_error,
    bounds_error,
    cantilever_load_over_stiffness,
    coefficient,
    largest_mm,
    stiffness,
)
from gauge_envs.tools.conformance.lift import Lift
from gauge_envs.tools.conformance.model import (
    COUNT,
    Check,
    Measurement,
    rollout_of,
)

EDGE_M, LENGTH_M = 0.04, 0.2
DENSITY_KG_PER_M3, YOUNG_PA, POISSON = 100.0, 1e4, 0.3
CENTRE_M = (0.0, 0.0, 1.0)

BAR = SoftBody(
    name="foam",
    shape=Box(size_m=(EDGE_M, EDGE_M, LENGTH_M)),
    pose=Pose(position_m=CENTRE_M),
    mass_kg=DENSITY_KG_PER_M3 * EDGE_M**2 * LENGTH_M,
    young_modulus_pa=YOUNG_PA,
    poisson_ratio=POISSON,
)
OTHER_BAR = replace(
    BAR,
    mass_kg=14.0 * BAR.mass_kg,
    young_modulus_pa=14.8 * YOUNG_PA,
    poisson_ratio=0.2,
)
"""Bar that is heavier and stiffer than those of most ids, and sags as the first."""
UPPER_FACE = Region(axis="z", side="high")
UPPER_END = Region(axis="z", side="high", depth_m=0.045)


_foam_lift = Lift(
    {
        "first bar": clamped(BAR, UPPER_FACE, duration_s=0.8),
        "second bar": clamped(OTHER_BAR, UPPER_END, duration_s=0.8),
    },
    speed_m_per_s=13.0,
    late_s=0.6,
)
_hanging = _foam_lift.recorded(
    "two bars of foam, 40 mm by 40 mm by 0.2 m, of two materials, that hang from their upper face, and from 45 mm"
)
"""They sag by 2 mm, their largest strain is 2 %, and their period 80 ms."""


def _bar(rollout: Recording) -> SoftBody:
    """Return the only bar of a scene."""
    (bar,) = rollout.scene.deformables
    assert isinstance(bar, SoftBody), "the scene has a bar alone"
    return bar


def _equilibrium(rollout: Recording) -> tuple[FloatArray, FloatArray]:
    """Return start and mean displacement of nodes at least one width from the clamp [m], shapes [node_count, 3]."""
    nodes = rollout.nodes_m["foam"] - np.asarray(CENTRE_M)
    displacement = hann_mean(nodes[rollout.between(0.25, np.inf)]) - nodes[0]
    (attachment,) = rollout.scene.attachments
    end_m = 0.5 * LENGTH_M - attachment.region.depth_m - EDGE_M
    free = nodes[0, :, 2] < end_m + PLACE_TOLERANCE_M
    return nodes[0, free], displacement[free]


def _strain_rate_per_m(rest: FloatArray, displacement: FloatArray) -> float:
    """Return the growth of the axial strain with the distance from the lower end [1/m]: rho g / E.

    The exact field of a hanging bar has u_z = (rho g / 2E) (z^2 + nu r^2 - L^2), z from its lower end.
    """
    height = rest[:, 2] + 0.5 * LENGTH_M
    return coefficient(
        displacement[:, 2],
        0.5 * height**2,
        np.ones(len(rest)),
        np.square(rest[:, :2]).sum(axis=1),
    )


@_hanging.check("foam-start", **NODES)
def _foam_start(rollout: Recording) -> Measurement:
    nodes = _foam_lift.at_rest(rollout).nodes_m["foam"][0] - np.asarray(CENTRE_M)
    return bounds_error(nodes, BAR.shape.size_m)


def _young(rollout: Recording) -> Measurement:
    bar = _bar(rollout)
    rate = _strain_rate_per_m(*_equilibrium(rollout))
    load = bar.mass_kg / (EDGE_M**2 * LENGTH_M) * G
    return stiffness(load, rate, bar.young_modulus_pa, "stretches")


_hanging.check("foam-tension")(_foam_lift.ratio(_young, "Young's modulus is"))


@_hanging.check("foam-clamp")
def _foam_clamp(rollout: Recording) -> Measurement:
    return _foam_lift.clamp_excess(rollout)


@_hanging.check("foam-held", **ATTACHED)
def _foam_held(rollout: Recording) -> Measurement:
    return _foam_lift.held_error(rollout)


def _poisson(rollout: Recording) -> Measurement:
    rest, displacement = _equilibrium(rollout)
    height = rest[:, 2] + 0.5 * LENGTH_M
    lever = height[:, None] * rest[:, :2]
    contraction = -float((lever * displacement[:, :2]).sum() / np.square(lever).sum())
    rate = _strain_rate_per_m(rest, displacement)
    return Measurement(
        measured=contraction / rate if rate > 0.0 else float("nan"),
        expected=_bar(rollout).poisson_ratio,
    )


_hanging.check("foam-poisson")(_foam_lift.ratio(_poisson, "Poisson's ratio nu is"))


@Check("foam-pinned-face", **ATTACHED)
def _foam_pinned_face(lab: Lab) -> Measurement:
    rotation = ramp(0.5, start_s=0.0, duration_s=0.2, ramp_s=0.08)
    scene = Scene(
        bodies=(
            driven_box(
                "plate", (0.0, 0.0, 1.0 + 0.5 * LENGTH_M + 0.005), (0.06, 0.06, 0.01)
            ),
        ),
        deformables=(BAR,),
        attachments=(Attachment(deformable="foam", region=UPPER_FACE, to="plate"),),
        drivers=(
            driver(
                "plate", "rotate", (0.0, 0.0, 1.0), rotation, point_m=(0.02, 0.0, 0.0)
            ),
        ),
        duration_s=0.25,
    )
    return attachment_error(lab.rollout(scene), "foam")


# --- rope ------------------------------------------------------------------------------------------------------------

ROPE_M = 0.3


ROPE = Rope(
    name="rope",
    pose=Pose(position_m=CENTRE_M),
    length_m=ROPE_M,
    radius_m=0.003,
    mass_kg=0.02,
    young_modulus_pa=1e6,
)
_falling_rope = rollout_of(
    "a horizontal rope of 0.3 m, held at one end and released, which swings for 2.3 s",
    clamped(ROPE, Region(axis="x", side="low"), duration_s=2.3),
)


def _along(rollout: Recording) -> FloatArray:
    """Return the nodes in their order along the rope [m], shape [sample_count, node_count, 3]."""
    nodes = rollout.nodes_m["rope"]
    return np.asarray(nodes[:, np.argsort(nodes[0, :, 0])])


def _start_error(rollout: Recording) -> Measurement:
    """Measure the distance of the last node of the only line of a scene from its end [mm]."""
    (line,) = rollout.scene.deformables
    assert isinstance(line, Rope | Rod)
    along = [1.0, 0.0, 0.0] if isinstance(line, Rope) else [0.0, 0.0, 1.0]
    nodes_m = rollout.nodes_m[line.name][0]
    end = line.pose.to_world(0.5 * line.length_m * np.array(along))
    error_mm = largest_mm(nodes_m[-1:] - end)
    length_m = length_of(nodes_m[-1] - nodes_m[0])
    hint = "its length is right: it has another position or orientation"
    if abs(length_m - line.length_m) > 1e-4 * error_mm:
        hint = (
            f"it is {1e3 * length_m:.4g} mm long instead of {1e3 * line.length_m:g} mm"
        )
    return Measurement(measured=error_mm, hint=hint)


_falling_rope.check("rope-start", **NODES)(_start_error)


@_falling_rope.check("rope-nodes", tolerance=COUNT)
def _rope_nodes(rollout: Recording) -> Measurement:
    along = rollout.nodes_m["rope"][0, :, 0]
    return Measurement(measured=float((np.diff(along) <= 0.0).sum()))


@_falling_rope.check("rope-length")
def _rope_length(rollout: Recording) -> Measurement:
    lengths = np.linalg.norm(np.diff(_along(rollout), axis=1), axis=2).sum(axis=1)
    measured_m = float(lengths[np.abs(lengths - ROPE_M).argmax()])
    hint = f"its length becomes {1e3 * measured_m:.4g} mm"
    return Measurement(measured=1e3 * measured_m, expected=1e3 * ROPE_M, hint=hint)


def line_shares(along_m: FloatArray) -> FloatArray:
    """Return the share of the mass at each node of a uniform line, from their places along it [m]."""
    shares = np.gradient(along_m)
    shares[[0, -1]] *= 0.5
    return np.asarray(shares / shares.sum())


LEAN_DEG = 4.0
FIRST_ZERO = float(jn_zeros(0, 1)[0])


@Check("rope-period")
def _rope_period(lab: Lab) -> Measurement:
    hanging = replace(
        ROPE, pose=Pose.from_euler_deg(CENTRE_M, (0.0, 90.0 - LEAN_DEG, 0.0))
    )
    rollout = lab.rollout(
        clamped(hanging, Region(axis="x", side="low"), duration_s=0.75)
    )
    nodes = rollout.nodes_m["rope"]
    tip_first = nodes[:, np.argsort(nodes[0, :, 2])]
    s = np.linalg.norm(tip_first[0] - tip_first[0, 0], axis=1)
    mode = j0(FIRST_ZERO * np.sqrt(s / ROPE_M)) * line_shares(s)
    swing = (tip_first[:, :, 0] - tip_first[:, -1:, 0]) @ mode
    before = np.flatnonzero(swing[:-1] * swing[1:] < 0.0)
    zeros_s = (
        rollout.times_s[before]
        + swing[before] / (swing[before] - swing[before + 1]) * SAMPLE_INTERVAL_S
    )
    measured = (
        2.0 * float(zeros_s[1] - zeros_s[0]) if len(zeros_s) > 1 else float("nan")
    )
    return Measurement(
        measured=measured,
        expected=4.0 * np.pi * float(np.sqrt(ROPE_M / G)) / FIRST_ZERO,
    )


# --- rod -------------------------------------------------------------------------------------------------------------

CLAMP_M, FREE_M, RADIUS_M = 0.02, 0.15, 0.005
ROD_DENSITY, ROD_YOUNG_PA = 1250.0, 1e7
ROD_GRAVITY = 0.2 * G


def _clamped_rod(density: float, radius_m: float, young_pa: float) -> Scene:
    """Return a horizontal rod clamped at one end: sag 2.5 mm on 150 mm, period 0.18 s."""
    rod = Rod(
        name="rod",
        pose=Pose.from_euler_deg(CENTRE_M, (0.0, 90.0, 0.0)),
        length_m=CLAMP_M + FREE_M,
        radius_m=radius_m,
        mass_kg=float(density * np.pi * radius_m**2 * (CLAMP_M + FREE_M)),
        young_modulus_pa=young_pa,
        poisson_ratio=0.49,
    )
    clamp = Region(axis="z", side="low", depth_m=CLAMP_M)
    return clamped(rod, clamp, duration_s=1.1, gravity_m_per_s2=ROD_GRAVITY)


_rod_lift = Lift(
    {
        "first rod": _clamped_rod(ROD_DENSITY, RADIUS_M, ROD_YOUNG_PA),
        "second rod": _clamped_rod(
            8.8 * ROD_DENSITY, 0.38 * RADIUS_M, 60.4 * ROD_YOUNG_PA
        ),
    },
    speed_m_per_s=3.5,
    late_s=1.0,
)
_drooping_rod = _rod_lift.recorded(
    "two horizontal rods of 0.15 m, of two radii, clamped at one end, at a fifth of gravity"
)


@_drooping_rod.check("rod-start", **NODES)
def _rod_start(rollout: Recording) -> Measurement:
    return _start_error(_rod_lift.at_rest(rollout))


def _rod_stiffness(rollout: Recording) -> Measurement:
    (rod,) = rollout.scene.deformables
    assert isinstance(rod, Rod), "the scene has a rod alone"
    nodes = rollout.nodes_m["rod"]
    droop = (nodes[0] - hann_mean(nodes[rollout.between(0.3, np.inf)]))[:, 2]
    s = nodes[0, :, 0] + 0.5 * (CLAMP_M + FREE_M) - CLAMP_M
    slope = cantilever_load_over_stiffness(
        s, droop, length_m=FREE_M, weights=np.ones(len(s))
    )
    load = rod.mass_kg / rod.length_m * ROD_GRAVITY
    expected = float(rod.young_modulus_pa * 0.25 * np.pi * rod.radius_m**4)
    return stiffness(load, slope, expected, "bends")


_drooping_rod.check("rod-bending")(
    _rod_lift.ratio(_rod_stiffness, "the bending stiffness is")
)


@_drooping_rod.check("rod-held", **ATTACHED)
def _rod_held(rollout: Recording) -> Measurement:
    return _rod_lift.held_error(rollout)
