"""Foam: start, driven face, Young's modulus and Poisson's ratio of a hanging bar, and contact.

The fits ignore nodes within one width of the clamp, which hinders contraction.
"""

from dataclasses import replace

import numpy as np

from gauge_envs.scene import Box, Pose, Region, Scene, SoftBody
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scoring.estimators import hann_mean
from gauge_envs.tools.bench.recording import Recording
from gauge_envs.tools.conformance.deformable import (
    ATTACHED,
    LEVEL_M,
    PLACE_TOLERANCE_M,
    RAMP_S,
    REST,
    START,
    STRIKE,
    clamp_error,
    clamped,
    coefficient,
    edge_error,
    momentum_ratio,
    on_rod,
    rest_error,
    side_by_side,
    start_error,
    stiffness,
    worst_law,
)
from gauge_envs.tools.conformance.lab import Lab
from gauge_envs.tools.conformance.model import Measurement, Tolerance, check

ORIGIN = Pose(position_m=(0.0, 0.0, 0.0))
EDGE_M, LENGTH_M = 0.04, 0.2


def _foam(
    name: str,
    size_m: tuple[float, float, float],
    density: float,
    young_pa: float,
    poisson: float,
) -> SoftBody:
    """Return a block of foam at the origin."""
    return SoftBody(
        name=name,
        shape=Box(size_m=size_m),
        pose=ORIGIN,
        mass_kg=density * float(np.prod(size_m)),
        young_modulus_pa=young_pa,
        poisson_ratio=poisson,
    )


BARS = tuple(
    _foam(f"foam bar {number}", (EDGE_M, EDGE_M, LENGTH_M), *constants)
    for number, constants in enumerate(((100.0, 1e4, 0.3), (1400.0, 1.48e5, 0.2)))
)
"""Bars of different foams, which sag by 2 mm: their largest strain is 2 %, and their period 80 ms."""

SETTLED_S, HUNG_S, LATE_S = 0.25, 0.6, 0.35
WINDOWS_S = ((SETTLED_S, HUNG_S), (HUNG_S + RAMP_S, HUNG_S + RAMP_S + LATE_S))
DEPTHS_M = (0.0, 0.055)
"""Depths of their clamps."""

CUBES = tuple(
    _foam(f"foam cube {number}", size_m, *constants)
    for number, (size_m, constants) in enumerate(
        (
            ((0.04, 0.04, 0.04), (100.0, 2e4, 0.3)),
            ((0.05, 0.04, 0.03), (150.0, 4e4, 0.2)),
            ((0.04, 0.03, 0.05), (60.0, 1e4, 0.4)),
        )
    )
)
"""Blocks of different foams and sizes."""


@check("foam-start", title="foam, start", **START)
def _foam_start(lab: Lab) -> Measurement:
    """Three blocks of foam of different sizes, at three places and orientations.

    Largest distance of the box of the nodes of a block at the start, in its frame, from its faces.
    """
    return start_error(lab, CUBES)


@check(
    "foam-pinned-face",
    title="foam, attached face follows its driven body",
    **ATTACHED,
)
def _foam_pinned_face(lab: Lab) -> Measurement:
    """Two bars of foam that hang from a driven rod, which moves and turns; 0 and 55 mm of them are attached.

    Largest distance of a node of the upper faces from its place on the rod within 0.3 s; or, where that is right, by
    how much the attached nodes end beyond or before the depth.
    """
    rollout = lab.rollout(on_rod(BARS, "z", DEPTHS_M), 0.3)
    edge, clamp = edge_error(rollout), clamp_error(rollout)
    # A clamp may end up to 1 mm from its depth.
    return clamp if edge.measured < 0.1 and clamp.measured > 1.0 else edge


def hanging_bar(bar: SoftBody, depth_m: float = 0.0) -> Scene:
    """Return a bar that hangs from its upper face, or from a part of its length."""
    region = Region(axis="z", side="high", depth_m=depth_m)
    pose = Pose(position_m=(0.0, 0.0, LEVEL_M))
    return clamped(replace(bar, pose=pose), region, duration_s=HUNG_S)


def _hanging(lab: Lab) -> Recording:
    scenes = {
        bar.name: hanging_bar(bar, depth_m)
        for bar, depth_m in zip(BARS, DEPTHS_M, strict=True)
    }
    return lab.rollout(side_by_side(scenes, speed_m_per_s=6.0, late_s=LATE_S))


def _strain(rollout: Recording) -> tuple[SoftBody, float, float]:
    """Return the bar and the growth with the height of its axial strain and of its contraction [1/m].

    With z from the lower end, u_z = (rho g / 2E) (z^2 + nu r^2 - L^2) and u_x = -nu (rho g / E) z x.
    """
    (bar,) = rollout.scene.deformables
    assert isinstance(bar, SoftBody), "the scene has a bar alone"
    (depth_m,) = (
        one.region.depth_m
        for one in rollout.scene.attachments
        if one.deformable == bar.name
    )
    nodes_m = rollout.nodes_m[bar.name] - np.asarray(bar.pose.position_m)
    moved_m = hann_mean(nodes_m[rollout.between(SETTLED_S, np.inf)]) - nodes_m[0]
    height_m = nodes_m[0, :, 2] + 0.5 * LENGTH_M
    end_m = LENGTH_M - depth_m - EDGE_M
    free = height_m < end_m + PLACE_TOLERANCE_M
    rest_m, moved_m, height_m = nodes_m[0, free], moved_m[free], height_m[free]
    across_m2 = np.square(rest_m[:, :2]).sum(axis=1)
    columns = (0.5 * height_m**2, np.ones(len(rest_m)), across_m2)
    lever: FloatArray = height_m[:, None] * rest_m[:, :2]
    contraction = -float((lever * moved_m[:, :2]).sum() / np.square(lever).sum())
    return bar, coefficient(moved_m[:, 2], *columns), contraction


def young(rollout: Recording) -> Measurement:
    """Measure Young's modulus [Pa] of a hanging bar."""
    bar, rate, _ = _strain(rollout)
    density = bar.mass_kg / (EDGE_M**2 * LENGTH_M)
    load = density * rollout.scene.gravity_m_per_s2
    return stiffness(load, rate, bar.young_modulus_pa)


def poisson(rollout: Recording) -> Measurement:
    """Measure Poisson's ratio of a hanging bar."""
    bar, rate, contraction = _strain(rollout)
    return Measurement(measured=contraction / rate, expected=bar.poisson_ratio)


@check(
    "foam-tension",
    title="foam, Young's modulus",
    law="u_z = rho g (z^2 + nu r^2 - L^2) / (2 E)",
    source="prismatic bar under its weight (Timoshenko and Goodier)",
    tolerance=Tolerance(
        "laws differ by the largest strain: 2 % in equilibrium, 4 % at the lowest point",
        relative=0.05,
    ),
    cause="the engine's constants are not those of E and nu, the nodes lack mass, or its elements lock",
)
def _foam_tension(lab: Lab) -> Measurement:
    """Two bars of two foams, 40 mm by 40 mm by 0.2 m, that hang on a frame at rest, which then moves up with 6 m/s.

    E from the mean sag over that of the scene; the worst.
    """
    return worst_law(lab.once(_hanging), young, "E", *WINDOWS_S)


@check(
    "foam-poisson",
    title="foam, Poisson contraction",
    law="u_x = -nu rho g z x / E",
    source="prismatic bar under its weight (Timoshenko and Goodier)",
    tolerance=Tolerance(
        "displacements are a tenth of a millimetre, and the clamp acts over one width",
        relative=0.1,
    ),
    cause="the engine's second constant (lambda, bulk modulus) is not that of E and nu",
)
def _foam_poisson(lab: Lab) -> Measurement:
    """Two bars of two foams, 40 mm by 40 mm by 0.2 m, that hang on a frame at rest, which then moves up with 6 m/s.

    Mean transverse contraction over mean stretch, over Poisson's ratio of the scene; the worst.
    """
    return worst_law(lab.once(_hanging), poisson, "Poisson's ratio", *WINDOWS_S)


@check(
    "foam-rests-on",
    title="foam stands on fixed, driven and free bodies",
    law="height = 0",
    **REST,
)
def _foam_rests_on(lab: Lab) -> Measurement:
    """Three blocks of foam: on a fixed slab, on a driven slab that stands still, and on a free slab.

    Mean height of the lowest node over the slab from 60 to 80 ms; the worst.
    """
    # What has no contact falls by 18 mm within 60 ms.
    return rest_error(lab, CUBES, 0.08)


@check("foam-strike", title="foam takes the momentum of a body", **STRIKE)
def _foam_strike(lab: Lab) -> Measurement:
    """Three blocks of different foams without gravity, each struck by a free block.

    Momentum of foam and block over that of the block at the start, from 0.05 to 0.2 s; the worst.
    """
    return momentum_ratio(lab, CUBES, 0.2)
