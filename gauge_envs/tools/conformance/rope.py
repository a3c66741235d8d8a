"""Ropes and rods: start, length, contact, and the bending stiffness of a clamped rod."""

import math
from collections.abc import Sequence

import numpy as np

from gauge_envs.fixtures.parts import box
from gauge_envs.scene import GRAVITY_M_PER_S2 as G, Pose, Region, Rod, Rope, Scene
from gauge_envs.tools.conformance.deformable import (
    FRAME,
    LEVEL,
    LEVEL_M,
    REST,
    START,
    STRIKE,
    Equilibrium,
    also_attached,
    clamped,
    droop,
    momentum_ratio,
    rest_error,
    side_by_side,
    start_error,
    stiffness,
    worst_law,
)
from gauge_envs.tools.conformance.lab import Lab, Measurement, ratio
from gauge_envs.tools.conformance.model import Checks, Level, Tolerance

check = Checks(Level.ROPE)


LEVEL_ROD = Pose.from_euler_deg(LEVEL.position_m, (0.0, 90.0, 0.0))


def _line(
    kind: type[Rope] | type[Rod],
    name: str,
    length_m: float,
    radius_m: float,
    mass_kg: float,
    young_pa: float = 1e7,
) -> Rope | Rod:
    """Return a rope or a rod along x."""
    constants = {} if kind is Rope else {"poisson_ratio": 0.3}
    return kind(
        name=name,
        pose=LEVEL if kind is Rope else LEVEL_ROD,
        length_m=length_m,
        radius_m=radius_m,
        mass_kg=mass_kg,
        young_modulus_pa=young_pa,
        **constants,
    )


LINES = ((0.1, 0.004, 0.01), (0.15, 0.006, 0.03), (0.08, 0.01, 0.008))
"""Length [m], radius [m] and mass [kg] of three lines."""

ROPES = tuple(_line(Rope, f"rope {at}", *line) for at, line in enumerate(LINES))
RODS = tuple(_line(Rod, f"rod {at}", *line) for at, line in enumerate(LINES))


def _lines(lab: Lab) -> Sequence[Rope | Rod]:
    """Return ropes and rods, or ropes alone for an engine without rods."""
    return lab.buildable(
        ROPES + RODS,
        lambda lines: Scene(bodies=(FRAME,), deformables=tuple(lines), duration_s=0.1),
    )


@check("rope-start", title="rope and rod, start", **START)
def _rope_start(lab: Lab) -> Measurement:
    """Three ropes and three rods of different lengths, at three places and orientations.

    Largest distance of the ends of the nodes from those of the axis, x of a rope and z of a rod; 1 m for a wrong order.

    Source: contract (Simulation.nodes).
    """
    return start_error(lab, _lines(lab))


LENGTHS_M = (0.3, 0.2, 0.25)


@check(
    "rope-length",
    title="rope does not stretch",
    law="length = L",
    tolerance=Tolerance("1 % of the length is 0.5 % of the period", relative=0.01),
    cause="distance constraints are too soft, or the rope does not hold the block that it is attached to",
)
def _rope_length(lab: Lab) -> Measurement:
    """Three horizontal ropes between a fixed body and a free block at their end, which fall and swing for 0.6 s.

    Length along the nodes to the block over that of the scene, at its largest error; the worst.

    Source: inextensible (scene.Rope).
    """
    ratios = {}
    for length_m in LENGTHS_M:
        rope = _line(Rope, "rope", length_m, 0.003, 0.02)
        end_m = (0.5 * length_m, 0.0, LEVEL_M)
        block = box("block", end_m, (0.02, 0.02, 0.02), mass_kg=0.01)
        hung = clamped(rope, Region(axis="x", side="low"), duration_s=0.6)
        scene = also_attached(hung, block, Region(axis="x", side="high"))
        rollout = lab.rollout(scene)
        path_m = rollout.nodes_m["rope"].copy()
        path_m[:, -1] = rollout.position("block")
        lengths = np.linalg.norm(np.diff(path_m, axis=1), axis=2).sum(axis=1)
        shares = lengths / length_m
        worst = np.abs(shares - 1.0).argmax()
        ratios[f"a rope of {length_m:g} m"] = float(shares[worst])
    return ratio(ratios, "the length")


@check("rope-rests-on", title="rope and rod lie on bodies", law="height = r", **REST)
def _rope_rests_on(lab: Lab) -> Measurement:
    """Three ropes and three rods of r = 4, 6 and 10 mm: on fixed slabs, and on driven ones that stand still.

    Mean height of the lowest node over the slab in the last quarter of 1 s, minus the radius; the worst.

    Source: contact (scene.Contact).
    """
    return rest_error(lab, _lines(lab), 1.0)


@check("rope-strike", title="rope and rod take the momentum of a body", **STRIKE)
def _rope_strike(lab: Lab) -> Measurement:
    """Three ropes and three rods of different masses without gravity, each struck across its length by a free block.

    Momentum of line and block over that of the block at the start, after the impact; the worst.

    Source: Newton.
    """
    return momentum_ratio(lab, _lines(lab), 1.3)


CLAMP_M, FREE_M = 0.02, 0.15
ROD_SETTLED_S, BENT_S = 0.3, 1.1

BENT_RODS = tuple(
    _line(Rod, "rod", CLAMP_M + FREE_M, *constants)
    for constants in (
        (0.005, 0.01582, 9.48e6),
        (0.0019, 0.02111, 6.07e8),
        (0.009, 0.02076, 1.185e6),
    )
)
"""Rods that sag by 2.5 mm at a fifth of gravity, with a period of 0.18 s."""


def clamped_rod(rod: Rope | Rod) -> Scene:
    """Return a horizontal rod clamped at one end, at a fifth of gravity."""
    clamp = Region(axis="z", side="low", depth_m=CLAMP_M)
    return clamped(rod, clamp, duration_s=BENT_S, gravity_m_per_s2=0.2 * G)


def rod_stiffness(hung: Equilibrium) -> Measurement:
    """Measure the bending stiffness E I of a clamped rod [N m^2]: E I w'' = rho A g (L - s)^2 / 2."""
    rod = hung.body
    load = rod.mass_kg / rod.length_m * hung.gravity_m_per_s2
    expected = rod.young_modulus_pa * 0.25 * math.pi * rod.radius_m**4
    return stiffness(load, droop(hung), expected)


@check(
    "rod-bending",
    title="rod, bending stiffness",
    law="E I w'' = rho A g (L - s)^2 / 2, I = pi r^4 / 4",
    tolerance=Tolerance(
        "a mesh's clamp is off by half a segment, 3 % of the length", relative=0.1
    ),
    cause="the bending constant is not that of E and radius, the nodes lack mass, or the clamp lets the slope go",
)
def _rod_bending(lab: Lab) -> Measurement:
    """Three horizontal rods of 0.15 m, clamped to a frame at rest, which then moves up with 2 m/s; a fifth of gravity.

    E I from the mean droop, at rest and on the moving frame, over that of the scene; the worst.

    Source: Euler and Bernoulli.
    """
    rods = [clamped_rod(rod) for rod in BENT_RODS]
    rollout = lab.rollout(side_by_side(rods, BENT_S - ROD_SETTLED_S))
    return worst_law(rollout, rod_stiffness, "E I", ROD_SETTLED_S, BENT_S)
