"""Ropes and rods: start, length, period, contact, and the bending stiffness of a clamped rod."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

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
from gauge_envs.tools.bench.parts import box
from gauge_envs.tools.bench.recording import Recording
from gauge_envs.tools.conformance.deformable import (
    FRAME,
    LEVEL,
    RAMP_S,
    REST,
    START,
    STRIKE,
    cantilever_load_over_stiffness,
    clamped,
    equilibrium,
    momentum_ratio,
    node_masses_kg,
    rest_error,
    side_by_side,
    start_error,
    stiffness,
    worst_law,
)
from gauge_envs.tools.conformance.lab import Lab, ratio
from gauge_envs.tools.conformance.model import Measurement, Tolerance, check

LEVEL_ROD = Pose.from_euler_deg(LEVEL.position_m, (0.0, 90.0, 0.0))


def _line(
    kind: type[Rope] | type[Rod],
    name: str,
    length_m: float,
    radius_m: float,
    mass_kg: float,
    young_pa: float = 1e6,
    pose: Pose = LEVEL,
) -> Rope | Rod:
    """Return a rope or a rod, along x if the pose is level."""
    constants = {} if kind is Rope else {"poisson_ratio": 0.3}
    return kind(
        name=name,
        pose=pose,
        length_m=length_m,
        radius_m=radius_m,
        mass_kg=mass_kg,
        young_modulus_pa=young_pa,
        **constants,
    )


LINES = ((0.1, 0.004, 0.01), (0.15, 0.006, 0.03), (0.08, 0.01, 0.008))
"""Length [m], radius [m] and mass [kg] of three lines."""

ROPES = tuple(_line(Rope, f"rope {at}", *line) for at, line in enumerate(LINES))
RODS = tuple(
    _line(Rod, f"rod {at}", *line, young_pa=1e7, pose=LEVEL_ROD)
    for at, line in enumerate(LINES)
)


def _lines(lab: Lab) -> Sequence[Rope | Rod]:
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


def _swinging(lean_deg: float, duration_s: float) -> Scene:
    """Return ropes of three lengths that are attached at an end, from a slope downward."""
    pose = Pose.from_euler_deg(LEVEL.position_m, (0.0, lean_deg, 0.0))
    end = Region(axis="x", side="low")
    ropes = {
        f"rope of {length_m:g} m": clamped(
            _line(Rope, "rope", length_m, 0.003, 0.02, pose=pose),
            end,
            duration_s=duration_s,
        )
        for length_m in LENGTHS_M
    }
    return side_by_side(ropes)


@check(
    "rope-length",
    title="rope does not stretch",
    law="length = L",
    source="inextensible (scene.Rope)",
    tolerance=Tolerance("1 % of the length is 0.5 % of the period", relative=0.01),
    cause="distance constraints are too soft, or the rope does not hold the block that it is attached to",
)
def _rope_length(lab: Lab) -> Measurement:
    """Three horizontal ropes between a fixed body and a free block at their end, which fall and swing for 0.6 s.

    Length along the nodes to the block over that of the scene, at its largest error; the worst.
    """
    scene = _swinging(0.0, 0.6)
    ropes: Any = scene.deformables
    ends_m = [one.pose.to_world([0.5 * one.length_m, 0.0, 0.0]) for one in ropes]
    blocks = tuple(
        box(f"block {at}", vector(end_m), (0.02, 0.02, 0.02), mass_kg=0.01)
        for at, end_m in enumerate(ends_m)
    )
    hung = tuple(
        Attachment(
            deformable=one.name, region=Region(axis="x", side="high"), to=block.name
        )
        for one, block in zip(ropes, blocks, strict=True)
    )
    rollout = lab.rollout(
        replace(
            scene,
            bodies=scene.bodies + blocks,
            attachments=scene.attachments + hung,
        )
    )
    ratios = {}
    for one, block in zip(ropes, blocks, strict=True):
        inner_m = rollout.nodes_m[one.name][:, :-1]
        path_m = np.concatenate([inner_m, rollout.position(block.name)[:, None]], 1)
        lengths_m = np.linalg.norm(np.diff(path_m, axis=1), axis=2).sum(axis=1)
        furthest_m = lengths_m[np.abs(lengths_m - one.length_m).argmax()]
        ratios[one.name] = float(furthest_m / one.length_m)
    return ratio(ratios, "the length")


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
    """Three straight ropes of 0.3, 0.2 and 0.25 m that hang from an end, released at 4 degrees.

    Period of the first mode, twice the time between its first two zeros, over that of the law; the worst.
    """
    ratios = {}
    rollout = lab.rollout(_swinging(86.0, 0.75))
    for rope, length_m in zip(rollout.scene.deformables, LENGTHS_M, strict=True):
        nodes_m = rollout.nodes_m[rope.name]
        s_m = np.linalg.norm(nodes_m[0] - nodes_m[0, -1], axis=1)
        mode = j0(FIRST_ZERO * np.sqrt(s_m / length_m))
        mode = mode * node_masses_kg(rope, nodes_m[0])
        swing = (nodes_m[:, :, 0] - nodes_m[:, :1, 0]) @ mode
        before = np.flatnonzero(swing[:-1] * swing[1:] < 0.0)
        zeros = before + swing[before] / (swing[before] - swing[before + 1])
        half_s = np.diff(zeros[:2]).sum() * rollout.interval_s
        law_s = 4.0 * math.pi * math.sqrt(length_m / G) / FIRST_ZERO
        ratios[rope.name] = float(2.0 * half_s / law_s)
    return ratio(ratios, "the period")


@check("rope-rests-on", title="rope and rod lie on bodies", law="height = r", **REST)
def _rope_rests_on(lab: Lab) -> Measurement:
    """Three ropes and three rods of r = 4, 6 and 10 mm: on a fixed, a driven (still) and a free slab.

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
    _line(Rod, f"rod {at}", CLAMP_M + FREE_M, *constants, pose=LEVEL_ROD)
    for at, constants in enumerate(
        ((0.005, 0.01582, 9.48e6), (0.0019, 0.02111, 6.07e8), (0.009, 0.02076, 1.185e6))
    )
)
"""Rods that sag by 2.5 mm at a fifth of gravity, with a period of 0.18 s."""


def clamped_rod(rod: Rope | Rod = BENT_RODS[0]) -> Scene:
    """Return a horizontal rod clamped at one end, at a fifth of gravity."""
    clamp = Region(axis="z", side="low", depth_m=CLAMP_M)
    return clamped(rod, clamp, duration_s=BENT_S, gravity_m_per_s2=0.2 * G)


def rod_stiffness(
    rollout: Recording, name: str, start_s: float, end_s: float
) -> Measurement:
    """Measure the bending stiffness E I of a clamped rod [N m^2]: E I w'' = rho A g (L - s)^2 / 2."""
    rod, _, rest_m, now_m = equilibrium(rollout, name, start_s, end_s)
    slope = cantilever_load_over_stiffness(
        rest_m[:, 2] + 0.5 * rod.length_m - CLAMP_M,
        (now_m - rest_m)[:, 0],
        length_m=FREE_M,
        weights=np.ones(len(rest_m)),
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
    late_s = BENT_S + RAMP_S
    windows_s = ((ROD_SETTLED_S, BENT_S), (late_s, late_s + 0.8))
    return worst_law(rollout, rod_stiffness, "E I", *windows_s)
