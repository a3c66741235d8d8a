"""Soft solids: Young's modulus and Poisson's ratio from a hanging bar, a driven face.

As in `cloth`: own weight for lack of forces, the centre of the oscillation for lack of a common damping, small strain,
and a fit of the closed form that leaves out what is within one width of the clamp, which hinders contraction.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gauge_envs.checks.conformance.attachments import pinned_reading
from gauge_envs.checks.conformance.kit import Measurement, Tolerance, check
from gauge_envs.checks.conformance.lab import Lab
from gauge_envs.checks.conformance.laws import PLACE_TOLERANCE_M, hann_mean
from gauge_envs.checks.conformance.parts import body, driver, fixed_box, ramp
from gauge_envs.checks.rollout import Course
from gauge_envs.scene import GRAVITY_M_PER_S2, Attachment, Box, Motion, Pose, Region, Scene, SoftBody

__all__: list[str] = []

EDGE_M, LENGTH_M = 0.04, 0.2
DENSITY_KG_PER_M3, YOUNG_PA, POISSON = 100.0, 1e4, 0.3
LOAD_N_PER_M3 = DENSITY_KG_PER_M3 * GRAVITY_M_PER_S2
HANG_S, SETTLED_S = 0.8, 0.25
CENTRE = Pose(position_m=(0.0, 0.0, 1.0))


def _bar() -> SoftBody:
    return SoftBody(
        name="foam",
        shape=Box(size_m=(EDGE_M, EDGE_M, LENGTH_M)),
        pose=CENTRE,
        mass_kg=DENSITY_KG_PER_M3 * EDGE_M**2 * LENGTH_M,
        young_modulus_pa=YOUNG_PA,
        poisson_ratio=POISSON,
    )


def _glue(to: str) -> tuple[Attachment]:
    return (Attachment(deformable="foam", region=Region(axis="z", side="high"), to=to),)


def _hanging(lab: Lab) -> Course:
    """A bar that hangs from its upper face: sag 2 mm, largest strain 2 %, period 80 ms."""
    scene = Scene(
        bodies=(fixed_box("frame", (0.0, 0.0, 3.0), (0.1, 0.1, 0.1)),),
        deformables=(_bar(),),
        attachments=_glue("frame"),
        duration_s=HANG_S,
    )
    return lab.course(scene, HANG_S)


def _equilibrium(course: Course) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Nodes at the start and their mean displacement, one width below the clamp and further [m], [node_count, 3]."""
    nodes = course.nodes_m["foam"] - np.asarray(CENTRE.position_m)
    moved = hann_mean(nodes[course.between(SETTLED_S, HANG_S)]) - nodes[0]
    free = nodes[0, :, 2] < 0.5 * LENGTH_M - EDGE_M + PLACE_TOLERANCE_M
    return nodes[0, free], moved[free]


def _strain_rate_per_m(rest: NDArray[np.float64], moved: NDArray[np.float64]) -> float:
    """Growth of the axial strain with the distance from the lower end [1/m]: rho g / E.

    The exact field of a hanging bar has u_z = (rho g / 2E) (z^2 + nu r^2 - L^2), z from its lower end.
    """
    height = rest[:, 2] + 0.5 * LENGTH_M
    columns = np.column_stack([0.5 * height**2, np.ones(len(rest)), np.square(rest[:, :2]).sum(axis=1)])
    return float(np.linalg.lstsq(columns, moved[:, 2], rcond=None)[0][0])


@check(
    "foam-start",
    title="foam, start",
    measures="largest distance of a side of the nodes' bounding box from the bar's faces, at the start",
    law="SoftBody.shape, SoftBody.pose",
    source="contract (Simulation.nodes)",
    unit="mm",
    tolerance=Tolerance(absolute=0.01, rationale="a float's rounding at 1 m is 0.1 um"),
    diagnosis="nodes are world positions in metres and reach the body's surface",
)
def _foam_start(lab: Lab) -> Measurement:
    nodes = lab.once(_hanging).nodes_m["foam"][0] - np.asarray(CENTRE.position_m)
    half = 0.5 * np.array([EDGE_M, EDGE_M, LENGTH_M])
    miss = float(np.abs(np.concatenate([nodes.min(axis=0) + half, nodes.max(axis=0) - half])).max())
    return Measurement(measured=1e3 * miss, expected=0.0)


@check(
    "foam-tension",
    title="foam, Young's modulus",
    measures="E from the mean sag of a bar under its own weight, one width below its clamped face and further",
    law="u_z = rho g (z^2 + nu r^2 - L^2) / (2 E)",
    source="prismatic bar under its own weight (Timoshenko and Goodier)",
    unit="Pa",
    tolerance=Tolerance(
        relative=0.05,
        rationale="nonlinear laws differ by as much as the largest strain, 2 % at rest, 4 % in full swing",
    ),
    diagnosis="look at how E and nu become the engine's constants, at the mass of the nodes, and at elements that lock",
)
def _foam_tension(lab: Lab) -> Measurement:
    rate = _strain_rate_per_m(*_equilibrium(lab.once(_hanging)))
    if not rate > 0.0:
        return Measurement(measured=float("inf"), expected=YOUNG_PA, hint="it does not stretch under its weight")
    ratio = rate * YOUNG_PA / LOAD_N_PER_M3
    return Measurement(
        measured=LOAD_N_PER_M3 / rate, expected=YOUNG_PA, hint=f"it stretches {ratio:.3g} times as much as it should"
    )


@check(
    "foam-poisson",
    title="foam, Poisson contraction",
    measures="mean contraction across over mean stretch of the hanging bar, from one width below its clamped face on",
    law="u_x = -nu rho g z x / E",
    source="prismatic bar under its own weight (Timoshenko and Goodier)",
    unit="1",
    tolerance=Tolerance(
        relative=0.1, rationale="displacements across are a tenth of a millimetre, and the clamp's reach is one width"
    ),
    diagnosis="look at the engine's second constant (lambda, bulk modulus); with nu = 0 nothing contracts",
)
def _foam_poisson(lab: Lab) -> Measurement:
    rest, moved = _equilibrium(lab.once(_hanging))
    height = rest[:, 2] + 0.5 * LENGTH_M
    lever = height[:, None] * rest[:, :2]
    contraction = -float((lever * moved[:, :2]).sum() / np.square(lever).sum())
    rate = _strain_rate_per_m(rest, moved)
    return Measurement(measured=contraction / rate if rate > 0.0 else float("nan"), expected=POISSON)


@check(
    "foam-pinned-face",
    title="foam, glued face follows its driven body",
    measures="largest distance of a node of the glued face from its place on a turning driven plate, within 0.25 s",
    law="place on the driven body = const",
    source="contract (scene.Attachment)",
    unit="mm",
    tolerance=Tolerance(absolute=0.1, rationale="a tenth of the real trials' scatter"),
    diagnosis="glued nodes lag or lead by an interval, hang on soft springs, or do not turn with the body",
)
def _foam_pinned_face(lab: Lab) -> Measurement:
    plate = body(
        "plate",
        Box(size_m=(0.06, 0.06, 0.01)),
        Pose(position_m=(0.0, 0.0, 1.0 + 0.5 * LENGTH_M + 0.005)),
        mass_kg=1.0,
        motion=Motion.KINEMATIC,
    )
    turn = ramp(0.5, start_s=0.0, duration_s=0.2, ramp_s=0.08)
    scene = Scene(
        bodies=(plate,),
        deformables=(_bar(),),
        attachments=_glue("plate"),
        drivers=(driver("plate", "rotate", (0.0, 0.0, 1.0), turn, point_m=(0.02, 0.0, 0.0)),),
        duration_s=0.25,
    )
    return pinned_reading(lab.course(scene, 0.25), "foam")
