"""Foam: start, clamps, Young's modulus and Poisson's ratio of a hanging bar, and contact.

The fits ignore nodes within one width of the clamp, which hinders contraction.
"""

import math

import numpy as np

from gauge_envs.fixtures.recording import Recording
from gauge_envs.scene import Box, Region, Scene, SoftBody
from gauge_envs.tools.conformance.deformable import (
    ATTACHED,
    LEVEL,
    PLACE_TOLERANCE_M,
    REST,
    START,
    STRIKE,
    Equilibrium,
    attachment_error,
    clamped,
    coefficient,
    momentum_ratio,
    rest_error,
    side_by_side,
    start_error,
    stiffness,
    worst_law,
)
from gauge_envs.tools.conformance.lab import Lab, Measurement
from gauge_envs.tools.conformance.model import Checks, Level, Tolerance

check = Checks(Level.FOAM)


EDGE_M, LENGTH_M = 0.04, 0.2


def _foam(
    name: str,
    size_m: tuple[float, float, float],
    density: float,
    young_pa: float,
    poisson_ratio: float,
) -> SoftBody:
    """Return a block of foam."""
    return SoftBody(
        name=name,
        shape=Box(size_m=size_m),
        pose=LEVEL,
        mass_kg=density * math.prod(size_m),
        young_modulus_pa=young_pa,
        poisson_ratio=poisson_ratio,
    )


BAR_M = (EDGE_M, EDGE_M, LENGTH_M)
BAR = _foam("light foam bar", BAR_M, 100.0, 1e4, 0.3)
OTHER_BAR = _foam("heavy foam bar", BAR_M, 1400.0, 1.48e5, 0.2)
"""Bars of different foams, which sag by 2 mm: their largest strain is 2 %, and their period 80 ms."""

BLOCKS = (
    _foam("foam block 0", (0.05, 0.04, 0.03), 150.0, 4e4, 0.2),
    _foam("foam block 1", (0.04, 0.03, 0.05), 60.0, 1e4, 0.4),
)
"""Blocks of different foams and sizes."""


@check("foam-start", title="foam, start", **START)
def _foam_start(lab: Lab) -> Measurement:
    """Two blocks of foam of different sizes, at two places and orientations.

    Largest distance of the box of the nodes of a block at the start, in its frame, from its faces.

    Source: contract (Simulation.nodes).
    """
    # Engines mesh boxes along the axes of the world.
    return start_error(lab, BLOCKS, turn_deg=(90.0, 0.0, -90.0))


SETTLED_S, HUNG_S = 0.25, 0.6


def hanging_bar(bar: SoftBody, depth_m: float) -> Scene:
    """Return a bar that hangs from its upper face, or from a part of its length."""
    region = Region(axis="z", side="high", depth_m=depth_m)
    return clamped(bar, region, duration_s=HUNG_S)


def _hanging(lab: Lab) -> Recording:
    bars = (hanging_bar(BAR, 0.0), hanging_bar(OTHER_BAR, 0.055))
    return lab.rollout(side_by_side(bars, HUNG_S - SETTLED_S))


@check("foam-pinned-face", title="foam, clamps follow their driven body", **ATTACHED)
def _foam_pinned_face(lab: Lab) -> Measurement:
    """Two bars of foam that hang from their upper face and from 55 mm on a frame, which moves up and then turns.

    Largest distance of an attached node from its place on the frame, or of a deeper node that keeps its place from
    the clamp.

    Source: contract (scene.Attachment, scene.Region).
    """
    return attachment_error(lab.once(_hanging))


def _strain(hung: Equilibrium) -> tuple[float, float]:
    """Return the growth with the height of the axial strain of a bar and of its contraction [1/m].

    With z from the lower end, u_z = (rho g / 2E) (z^2 + nu r^2 - L^2) and u_x = -nu (rho g / E) z x.
    """
    free_m = 0.5 * LENGTH_M - hung.depth_m - EDGE_M + PLACE_TOLERANCE_M
    free = hung.rest_m[:, 2] < free_m
    rest_m, moved_m = hung.rest_m[free], hung.moved_m[free]
    height_m, across_m = rest_m[:, 2] + 0.5 * LENGTH_M, rest_m[:, :2]
    columns = (0.5 * height_m**2, np.ones(len(rest_m)), np.square(across_m).sum(axis=1))
    rate = coefficient(moved_m[:, 2], *columns)
    lever_m2 = (height_m[:, None] * across_m).ravel()
    return rate, -coefficient(moved_m[:, :2].ravel(), lever_m2)


def young(hung: Equilibrium) -> Measurement:
    """Measure Young's modulus [Pa] of a hanging bar."""
    bar = hung.body
    load = bar.mass_kg / math.prod(bar.shape.size_m) * hung.gravity_m_per_s2
    return stiffness(load, _strain(hung)[0], bar.young_modulus_pa)


def poisson(hung: Equilibrium) -> Measurement:
    """Measure Poisson's ratio of a hanging bar."""
    rate, contraction = _strain(hung)
    return Measurement(measured=contraction / rate, expected=hung.body.poisson_ratio)


@check(
    "foam-tension",
    title="foam, Young's modulus and Poisson's ratio",
    law="u_z = rho g (z^2 + nu r^2 - L^2) / (2 E), u_x = -nu rho g z x / E",
    tolerance=Tolerance(
        "laws differ by the largest strain: 2 % in equilibrium, 4 % at the lowest point",
        relative=0.05,
    ),
    cause="the engine's constants are not those of E and nu, the nodes lack mass, or its elements lock",
)
def _foam_tension(lab: Lab) -> Measurement:
    """Two bars of two foams, 40 mm by 40 mm by 0.2 m, that hang on a frame at rest, which then moves up with 2 m/s.

    E from the mean sag, and Poisson's ratio from contraction over stretch, at rest and on the moving frame, over those
    of the scene; the worst.

    Source: prismatic bar under its weight (Timoshenko and Goodier).
    """
    measurements = (
        worst_law(lab.once(_hanging), law, what, SETTLED_S, HUNG_S)
        for what, law in (("E", young), ("Poisson's ratio", poisson))
    )
    return max(measurements, key=lambda measurement: abs(measurement.measured - 1.0))


@check("foam-rests-on", title="foam stands on bodies", law="height = 0", **REST)
def _foam_rests_on(lab: Lab) -> Measurement:
    """Two blocks of foam: on a fixed slab, and on a driven slab that stands still.

    Mean height of the lowest node over the slab from 60 to 80 ms; the worst.

    Source: contact (scene.Contact).
    """
    # Without contact, a block falls by 18 mm within 60 ms.
    return rest_error(lab, BLOCKS, 0.08)


@check("foam-strike", title="foam takes the momentum of a body", **STRIKE)
def _foam_strike(lab: Lab) -> Measurement:
    """Two blocks of different foams without gravity, each struck by a free block.

    Momentum of foam and block over that of the block at the start, from 0.05 to 0.2 s; the worst.

    Source: Newton.
    """
    return momentum_ratio(lab, BLOCKS, 0.2)
