"""Soft solids: Young's modulus and Poisson's ratio of a hanging bar, and a driven face.

The method is that of `cloth`: the body's own weight is the load, the centre of the oscillation is the equilibrium, and
strains are small. The fit ignores nodes within one width of the clamp, which hinders contraction.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gauge_envs.runs.rollout import Rollout
from gauge_envs.scene import GRAVITY_M_PER_S2, Attachment, Box, Pose, Region, Scene, SoftBody
from gauge_envs.tools.conformance.lab import Lab, recorded
from gauge_envs.tools.conformance.laws import PLACE_TOLERANCE_M, coefficient, hann_mean
from gauge_envs.tools.conformance.measurements import attachment_error, bounds_error, stiffness
from gauge_envs.tools.conformance.model import Check, Measurement, Tolerance
from gauge_envs.tools.conformance.scene_parts import clamped, driven_box, driver, ramp

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
UPPER_FACE = Region(axis="z", side="high")


@recorded("a bar of foam, 40 mm by 40 mm by 0.2 m, that hangs from its upper face")
def _hanging(lab: Lab) -> Rollout:
    """Record a bar that hangs from its upper face: sag 2 mm, largest strain 2 %, period 80 ms."""
    return lab.rollout(clamped(BAR, UPPER_FACE, duration_s=0.8))


def _equilibrium(rollout: Rollout) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return start and mean displacement of nodes at least one width from the clamp [m], shapes [node_count, 3]."""
    nodes = rollout.nodes_m["foam"] - np.asarray(CENTRE_M)
    displacement = hann_mean(nodes[rollout.between(0.25, 0.8)]) - nodes[0]
    free = nodes[0, :, 2] < 0.5 * LENGTH_M - EDGE_M + PLACE_TOLERANCE_M
    return nodes[0, free], displacement[free]


def _strain_rate_per_m(rest: NDArray[np.float64], displacement: NDArray[np.float64]) -> float:
    """Return the growth of the axial strain with the distance from the lower end [1/m]: rho g / E.

    The exact field of a hanging bar has u_z = (rho g / 2E) (z^2 + nu r^2 - L^2), z from its lower end.
    """
    height = rest[:, 2] + 0.5 * LENGTH_M
    return coefficient(displacement[:, 2], 0.5 * height**2, np.ones(len(rest)), np.square(rest[:, :2]).sum(axis=1))


@_hanging.check(
    "foam-start",
    title="foam, start",
    measures="largest distance between the bar's faces and the bounding box of its nodes, at the start",
    law="SoftBody.shape, SoftBody.pose",
    source="contract (Simulation.nodes)",
    unit="mm",
    tolerance=Tolerance(absolute=0.01, rationale="a float's rounding at 1 m is 0.1 um"),
    diagnosis="nodes are world positions in metres, and the outer ones lie on the body's surface",
)
def _foam_start(rollout: Rollout) -> Measurement:
    return bounds_error(rollout.nodes_m["foam"][0] - np.asarray(CENTRE_M), BAR.shape.size_m)


@_hanging.check(
    "foam-tension",
    title="foam, Young's modulus",
    measures="E from the mean sag of a bar under its own weight, at least one width from its clamped face",
    law="u_z = rho g (z^2 + nu r^2 - L^2) / (2 E)",
    source="prismatic bar under its own weight (Timoshenko and Goodier)",
    unit="Pa",
    tolerance=Tolerance(
        relative=0.05,
        rationale="nonlinear laws differ by the largest strain, 2 % in equilibrium and 4 % at the lowest point",
    ),
    diagnosis="check the conversion of E and nu to the engine's constants, the mass of the nodes, and locking elements",
)
def _foam_tension(rollout: Rollout) -> Measurement:
    rate = _strain_rate_per_m(*_equilibrium(rollout))
    return stiffness(DENSITY_KG_PER_M3 * GRAVITY_M_PER_S2, rate, YOUNG_PA, "stretches")


@_hanging.check(
    "foam-poisson",
    title="foam, Poisson contraction",
    measures="mean transverse contraction over mean stretch of the bar, at least one width from its clamped face",
    law="u_x = -nu rho g z x / E",
    source="prismatic bar under its own weight (Timoshenko and Goodier)",
    tolerance=Tolerance(
        relative=0.1,
        rationale="transverse displacements are a tenth of a millimetre, and the clamp acts over about one width",
    ),
    diagnosis="check the engine's second constant (lambda, bulk modulus); with nu = 0 nothing contracts",
)
def _foam_poisson(rollout: Rollout) -> Measurement:
    rest, displacement = _equilibrium(rollout)
    height = rest[:, 2] + 0.5 * LENGTH_M
    lever = height[:, None] * rest[:, :2]
    contraction = -float((lever * displacement[:, :2]).sum() / np.square(lever).sum())
    rate = _strain_rate_per_m(rest, displacement)
    return Measurement(measured=contraction / rate if rate > 0.0 else float("nan"), expected=POISSON)


@Check(
    "foam-pinned-face",
    title="foam, attached face follows its driven body",
    scene="the same bar attached to a plate that turns by 0.5 rad",
    measures="largest distance of an attached node from its place on a rotating driven plate, within 0.25 s",
    law="position in the driven body's frame = const",
    source="contract (scene.Attachment)",
    unit="mm",
    tolerance=Tolerance(absolute=0.1, rationale="a tenth of the real trials' scatter"),
    diagnosis="attached nodes lag or lead by an interval, hang on soft springs, or do not rotate with the body",
)
def _foam_pinned_face(lab: Lab) -> Measurement:
    rotation = ramp(0.5, start_s=0.0, duration_s=0.2, ramp_s=0.08)
    scene = Scene(
        bodies=(driven_box("plate", (0.0, 0.0, 1.0 + 0.5 * LENGTH_M + 0.005), (0.06, 0.06, 0.01)),),
        deformables=(BAR,),
        attachments=(Attachment(deformable="foam", region=UPPER_FACE, to="plate"),),
        drivers=(driver("plate", "rotate", (0.0, 0.0, 1.0), rotation, point_m=(0.02, 0.0, 0.0)),),
        duration_s=0.25,
    )
    return attachment_error(lab.rollout(scene), "foam")
