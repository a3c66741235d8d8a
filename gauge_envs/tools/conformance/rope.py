"""Ropes and rods: start, length, period, mass, contact, and the bending stiffness of a clamped rod."""

import math
from dataclasses import replace

import numpy as np
from scipy.special import j0, jn_zeros

from gauge_envs.scene import (
    GRAVITY_M_PER_S2 as G,
    Attachment,
    Pose,
    Region,
    Rod,
    Rope,
    Scene,
)
from gauge_envs.scene.geometry import vector
from gauge_envs.scoring.estimators import acceleration_m_per_s2, hann_mean
from gauge_envs.tools.bench.parts import box
from gauge_envs.tools.bench.recording import Recording
from gauge_envs.tools.conformance.deformable import (
    APART_M,
    FRAME,
    LEVEL_M,
    RAMP_S,
    REST,
    START,
    STRIKE,
    cantilever_load_over_stiffness,
    clamped,
    momentum_ratio,
    node_masses_kg,
    placed,
    rest_error,
    side_by_side,
    start_error,
    stiffness,
    worst_law,
)
from gauge_envs.tools.conformance.lab import Lab, worst_ratio
from gauge_envs.tools.conformance.model import Measurement, Tolerance, check

ORIGIN = Pose(position_m=(0.0, 0.0, 0.0))
LEVEL_ROD = Pose.from_euler_deg((0.0, 0.0, 0.0), (0.0, 90.0, 0.0))
LINES = ((0.1, 0.004, 0.01), (0.15, 0.006, 0.03), (0.08, 0.01, 0.008))
"""Length [m], radius [m] and mass [kg] of three lines."""


def _rope(
    name: str, length_m: float, radius_m: float = 0.003, mass_kg: float = 0.02
) -> Rope:
    """Return a rope along x at the origin."""
    return Rope(
        name=name,
        pose=ORIGIN,
        length_m=length_m,
        radius_m=radius_m,
        mass_kg=mass_kg,
        young_modulus_pa=1e6,
    )


def _rod(
    name: str,
    length_m: float,
    radius_m: float,
    mass_kg: float,
    *,
    young_pa: float,
    poisson: float = 0.3,
) -> Rod:
    """Return a rod along x at the origin."""
    return Rod(
        name=name,
        pose=LEVEL_ROD,
        length_m=length_m,
        radius_m=radius_m,
        mass_kg=mass_kg,
        young_modulus_pa=young_pa,
        poisson_ratio=poisson,
    )


ROPES = tuple(_rope(f"rope {number}", *line) for number, line in enumerate(LINES))
RODS = tuple(
    _rod(f"rod {number}", *line, young_pa=young_pa)
    for number, (line, young_pa) in enumerate(zip(LINES, (1e7, 2e7, 5e6), strict=True))
)


def _lines(lab: Lab) -> tuple[Rope | Rod, ...]:
    """Return ropes and rods, or ropes alone for an engine without rods."""
    rods = Scene(bodies=(FRAME,), deformables=RODS, duration_s=0.1)
    return ROPES + RODS if lab.supports(rods) else ROPES


@check("rope-start", title="rope and rod, start", **START)
def _rope_start(lab: Lab) -> Measurement:
    """Three ropes and three rods of different lengths, at three places and orientations.

    Largest distance of the ends of the nodes from those of the axis, x of a rope and z of a rod; 1 m for a wrong order.
    """
    return start_error(lab, _lines(lab))


LENGTHS_M = (0.3, 0.2, 0.25)


PULL_M_PER_S2, PULL_S, BOB_M = 7.0, 1.3, 0.03
BOBS_KG = (0.01, 0.04, 0.02)


def _pulled(lab: Lab) -> Recording:
    """Record three ropes without gravity, each attached to a free block at its end that a force pulls ahead."""
    bobs, lines, wrenches = [], [], {}
    for number, (rope, mass_kg) in enumerate(zip(ROPES, BOBS_KG, strict=True)):
        place_m = np.array([0.0, APART_M * (number - 1), LEVEL_M])
        end_m = vector(np.add(place_m, (0.5 * rope.length_m, 0.0, 0.0)))
        bobs.append(box(f"bob {number}", end_m, (BOB_M, BOB_M, BOB_M), mass_kg=mass_kg))
        lines.append(placed(rope, place_m))
        force_n = (mass_kg + rope.mass_kg) * PULL_M_PER_S2
        wrenches[f"bob {number}"] = (force_n, 0.0, 0.0, 0.0, 0.0, 0.0)
    scene = Scene(
        bodies=tuple(bobs),
        deformables=tuple(lines),
        attachments=tuple(
            Attachment(
                deformable=rope.name,
                region=Region(axis="x", side="high"),
                to=f"bob {number}",
            )
            for number, rope in enumerate(lines)
        ),
        duration_s=PULL_S,
        gravity_m_per_s2=0.0,
    )
    return lab.rollout(scene, wrenches=wrenches)


@check(
    "rope-length",
    title="rope does not stretch",
    law="length = L",
    source="inextensible (scene.Rope)",
    tolerance=Tolerance("1 % of the length is 0.5 % of the period", relative=0.01),
    cause="distance constraints are too soft, or Young's modulus is taken for the stretch stiffness",
)
def _rope_length(lab: Lab) -> Measurement:
    """Three horizontal ropes, attached to a fixed body at one end and released, which swing for 1 s.

    Length along the nodes over that of the scene, at its largest error; the worst.
    """
    swinging = side_by_side(
        {
            f"rope of {length_m:g} m": clamped(
                placed(_rope("rope", length_m), (0.0, 0.0, LEVEL_M)),
                Region(axis="x", side="low"),
                duration_s=1.0,
            )
            for length_m in LENGTHS_M
        }
    )
    rollout = lab.rollout(swinging)
    ratios = {}
    for (name, nodes_m), length_m in zip(
        rollout.nodes_m.items(), LENGTHS_M, strict=True
    ):
        lengths_m = np.linalg.norm(np.diff(nodes_m, axis=1), axis=2).sum(axis=1)
        furthest_m = lengths_m[np.abs(lengths_m - length_m).argmax()]
        ratios[name] = float(furthest_m / length_m)
    measured, hint = worst_ratio(ratios, "length")
    return Measurement(measured=measured, expected=1.0, hint=hint)


LEAN_DEG = 4.0
FIRST_ZERO = float(jn_zeros(0, 1)[0])


@check(
    "rope-period",
    title="rope, period of a hanging rope",
    law="T = 4 pi sqrt(L / g) / j_0, j_0 = 2.405 (first zero of J_0)",
    source="Daniel Bernoulli's hanging chain",
    tolerance=Tolerance(
        "a chain of ten segments is 0.3 % slow, an end of twice its mass 0.8 %",
        relative=0.005,
    ),
    cause="the mass at the ends is not half a segment's, or there is damping or bending stiffness",
)
def _rope_period(lab: Lab) -> Measurement:
    """Three straight ropes of 0.3, 0.2 and 0.25 m that hang from one end, released at 4 degrees.

    Period of the first mode, twice the time between its first two zeros, over that of the law; the worst.
    """
    pose = Pose.from_euler_deg((0.0, 0.0, LEVEL_M), (0.0, 90.0 - LEAN_DEG, 0.0))
    hanging = {
        f"rope of {length_m:g} m": clamped(
            replace(_rope("rope", length_m), pose=pose),
            Region(axis="x", side="low"),
            duration_s=0.75,
        )
        for length_m in LENGTHS_M
    }
    rollout = lab.rollout(side_by_side(hanging))
    ratios = {}
    for rope, length_m in zip(rollout.scene.deformables, LENGTHS_M, strict=True):
        nodes_m = rollout.nodes_m[rope.name]
        s_m = np.linalg.norm(nodes_m[0] - nodes_m[0, -1], axis=1)
        mode = j0(FIRST_ZERO * np.sqrt(s_m / length_m))
        mode = mode * node_masses_kg(rope, nodes_m[0])
        swing = (nodes_m[:, :, 0] - nodes_m[:, :1, 0]) @ mode
        before = np.flatnonzero(swing[:-1] * swing[1:] < 0.0)
        share = swing[before] / (swing[before] - swing[before + 1])
        zeros_s = rollout.times_s[before] + share * rollout.interval_s
        period_s = 2.0 * float(zeros_s[1] - zeros_s[0]) if len(zeros_s) > 1 else np.inf
        law_s = 4.0 * math.pi * math.sqrt(length_m / G) / FIRST_ZERO
        ratios[rope.name] = period_s / law_s
    measured, hint = worst_ratio(ratios, "the period")
    return Measurement(measured=measured, expected=1.0, hint=hint)


@check(
    "rope-mass",
    title="rope, mass that a force moves",
    law="F = (M + m) a, m = Rope.mass_kg",
    source="Newton",
    tolerance=Tolerance(
        "a mesh of ten cells may leave half a cell of the rope out, at the end that the block holds",
        relative=0.05,
    ),
    cause="the mass of the nodes is not mass_kg, or the rope does not pull the free body that it is attached to",
)
def _rope_mass(lab: Lab) -> Measurement:
    """Three ropes without gravity, each attached to a free block that a force pulls ahead, up to 9 m/s.

    Force over the acceleration of the free end of the rope, over the mass of rope and block; the worst.
    """
    rollout = _pulled(lab)
    ratios = {}
    for name, nodes_m in rollout.nodes_m.items():
        found = acceleration_m_per_s2(rollout.times_s, nodes_m[:, 0, 0])
        ratios[name] = PULL_M_PER_S2 / found if found > 0.0 else math.inf
    measured, hint = worst_ratio(ratios, "the mass")
    if measured > 1e3:
        hint = "a rope stays behind: its attachment to the free block is missing"
    return Measurement(measured=measured, expected=1.0, hint=hint)


@check(
    "rope-rests-on",
    title="rope and rod lie on fixed, driven and free bodies",
    law="height = radius",
    **REST,
)
def _rope_rests_on(lab: Lab) -> Measurement:
    """Three ropes and three rods of 4, 6 and 10 mm radius: on a fixed slab, a driven one that stands still, a free one.

    Mean height of the lowest node over the slab in the last quarter of 1 s, minus the radius; the worst.
    """
    return rest_error(lab, _lines(lab), 1.0)


@check("rope-strike", title="rope and rod take the momentum of a body", **STRIKE)
def _rope_strike(lab: Lab) -> Measurement:
    """Three ropes and three rods of different masses without gravity, each struck across its length by a free block.

    Momentum of line and block over that of the block at the start, in spans of 1.3 s; the worst.
    """
    return momentum_ratio(lab, _lines(lab), 1.3)


CLAMP_M, FREE_M = 0.02, 0.15
ROD_SETTLED_S, BENT_S = 0.3, 1.1

BENT_RODS = tuple(
    _rod(
        f"rod {number}",
        CLAMP_M + FREE_M,
        radius_m,
        density * math.pi * radius_m**2 * (CLAMP_M + FREE_M),
        young_pa=young_pa,
        poisson=0.49,
    )
    for number, (density, radius_m, young_pa) in enumerate(
        ((1185.0, 0.005, 9.48e6), (10950.0, 0.0019, 6.07e8), (480.0, 0.009, 1.185e6))
    )
)
"""Rods that sag by 2.5 mm at a fifth of gravity, with a period of 0.18 s."""


def clamped_rod(rod: Rod) -> Scene:
    """Return a horizontal rod clamped at one end, at a fifth of gravity."""
    clamp = Region(axis="z", side="low", depth_m=CLAMP_M)
    level = placed(rod, (0.0, 0.0, LEVEL_M))
    return clamped(level, clamp, duration_s=BENT_S, gravity_m_per_s2=0.2 * G)


def rod_stiffness(rollout: Recording) -> Measurement:
    """Measure the bending stiffness E I of a clamped rod [N m^2]: E I w'' = rho A g (L - s)^2 / 2."""
    (rod,) = rollout.scene.deformables
    assert isinstance(rod, Rod), "the scene has a rod alone"
    nodes_m = rollout.nodes_m[rod.name]
    settled_m = hann_mean(nodes_m[rollout.between(ROD_SETTLED_S, np.inf)])
    s_m = nodes_m[0, :, 0] + 0.5 * rod.length_m - CLAMP_M
    slope = cantilever_load_over_stiffness(
        s_m,
        (nodes_m[0] - settled_m)[:, 2],
        length_m=FREE_M,
        weights=np.ones(len(s_m)),
    )
    load = rod.mass_kg / rod.length_m * rollout.scene.gravity_m_per_s2
    expected = rod.young_modulus_pa * 0.25 * math.pi * rod.radius_m**4
    return stiffness(load, slope, expected)


@check(
    "rod-bending",
    title="rod, bending stiffness",
    law="E I w'' = rho A g (L - s)^2 / 2, I = pi r^4 / 4",
    source="Euler and Bernoulli",
    tolerance=Tolerance(
        "a mesh's clamp is off by half a segment, 3 % of the length", relative=0.1
    ),
    cause="the bending constant is not that of E and radius, the nodes lack mass, or the clamp lets the slope go",
)
def _rod_bending(lab: Lab) -> Measurement:
    """Three horizontal rods of 0.15 m, clamped to a frame at rest, which then moves up with 2 m/s; a fifth of gravity.

    E I from the mean droop, at rest and on the moving frame, over that of the scene; the worst.
    """
    scenes = {rod.name: clamped_rod(rod) for rod in BENT_RODS}
    rollout = lab.rollout(side_by_side(scenes, speed_m_per_s=2.0, late_s=0.8))
    windows_s = ((ROD_SETTLED_S, BENT_S), (BENT_S + RAMP_S, BENT_S + RAMP_S + 0.8))
    return worst_law(rollout, rod_stiffness, "E I", *windows_s)
