"""Ropes and rods: a rope's length, a rod's bending stiffness, energy. Methods as in `cloth`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gauge_envs.checks.conformance.kit import Measurement, Tolerance, check
from gauge_envs.checks.conformance.lab import Lab
from gauge_envs.checks.conformance.laws import cantilever_load_over_stiffness, hann_mean
from gauge_envs.checks.conformance.parts import fixed_box
from gauge_envs.checks.rollout import Course
from gauge_envs.scene import GRAVITY_M_PER_S2, Attachment, Deformable, Pose, Region, Rod, Rope, Scene

__all__: list[str] = []

G = GRAVITY_M_PER_S2


def _held(line: Deformable, region: Region, *, seconds: float, gravity: float = G) -> Scene:
    """A line with one end glued to a fixed body."""
    return Scene(
        bodies=(fixed_box("frame", (0.0, 0.0, 3.0), (0.1, 0.1, 0.1)),),
        deformables=(line,),
        attachments=(Attachment(deformable=line.name, region=region, to="frame"),),
        duration_s=seconds,
        gravity_m_per_s2=gravity,
    )


# --- rope ------------------------------------------------------------------------------------------------------------

ROPE_M, ROPE_S = 0.3, 0.5


def _falling_rope(lab: Lab) -> Course:
    """A horizontal rope held at one end and let go: it swings through its lowest place at about 0.25 s."""
    rope = Rope(
        name="rope",
        pose=Pose(position_m=(0.0, 0.0, 1.0)),
        length_m=ROPE_M,
        radius_m=0.003,
        mass_kg=0.02,
        young_modulus_pa=1e6,
    )
    return lab.course(_held(rope, Region(axis="x", side="low"), seconds=ROPE_S), ROPE_S)


def _along(course: Course) -> NDArray[np.float64]:
    """Nodes from one end to the other [m], shape [sample_count, node_count, 3]."""
    nodes = course.nodes_m["rope"]
    return np.asarray(nodes[:, np.argsort(nodes[0, :, 0])])


@check(
    "rope-length",
    title="rope does not stretch",
    measures="length along a rope that swings from one end, furthest from its own within 0.5 s",
    law="L",
    source="inextensible (scene.Rope)",
    unit="mm",
    tolerance=Tolerance(relative=0.01, rationale="1 % of the length is 0.5 % of a swing's period"),
    diagnosis="distance constraints are too soft, or the rope has its Young's modulus as stretch stiffness",
)
def _rope_length(lab: Lab) -> Measurement:
    lengths = np.linalg.norm(np.diff(_along(lab.once(_falling_rope)), axis=1), axis=2).sum(axis=1)
    return Measurement(measured=1e3 * float(lengths[np.abs(lengths - ROPE_M).argmax()]), expected=1e3 * ROPE_M)


@check(
    "rope-energy",
    title="rope gains no energy",
    measures="largest gain of kinetic and potential energy of the swinging rope, over the potential energy it gives up",
    law="T + V <= its start",
    source="an inextensible rope stores nothing",
    unit="%",
    tolerance=Tolerance(
        absolute=5.0, rationale="speeds are differences over 11 ms, and masses are those of equal pieces"
    ),
    diagnosis="the solver makes energy: step too long, iterations capped, or constraints corrected with speed",
)
def _rope_energy(lab: Lab) -> Measurement:
    course = lab.once(_falling_rope)
    nodes = _along(course)
    shares = np.gradient(nodes[0, :, 0])
    shares[[0, -1]] *= 0.5
    shares /= shares.sum()
    speed = np.gradient(nodes, course.times_s, axis=0)
    potential = G * (nodes[:, :, 2] - nodes[0, :, 2]) @ shares
    total = potential + 0.5 * np.square(speed).sum(axis=2) @ shares
    return Measurement(measured=100.0 * float(total.max() / max(-potential.min(), 1e-12)), expected=0.0)


# --- rod -------------------------------------------------------------------------------------------------------------

GRIP_M, FREE_M, RADIUS_M = 0.02, 0.15, 0.005
ROD_DENSITY, YOUNG_PA = 1250.0, 1e7
ROD_GRAVITY = 0.2 * G
ROD_S, SETTLED_S = 1.1, 0.3
SECTION_M2, INERTIA_M4 = np.pi * RADIUS_M**2, 0.25 * np.pi * RADIUS_M**4


def _drooping_rod(lab: Lab) -> Course:
    """A horizontal rod clamped at one end, at a fifth of gravity: sag 2.5 mm on 150 mm, period 0.18 s."""
    rod = Rod(
        name="rod",
        pose=Pose.from_euler_deg((0.0, 0.0, 1.0), (0.0, 90.0, 0.0)),
        length_m=GRIP_M + FREE_M,
        radius_m=RADIUS_M,
        mass_kg=float(ROD_DENSITY * SECTION_M2 * (GRIP_M + FREE_M)),
        young_modulus_pa=YOUNG_PA,
        poisson_ratio=0.49,
    )
    grip = Region(axis="z", side="low", depth_m=GRIP_M)
    return lab.course(_held(rod, grip, seconds=ROD_S, gravity=ROD_GRAVITY), ROD_S)


@check(
    "rod-bending",
    title="rod, bending stiffness",
    measures="bending stiffness from the mean droop of a rod clamped at one end",
    law="E I w'' = rho A g (L - s)^2 / 2, I = pi r^4 / 4",
    source="Euler and Bernoulli",
    unit="N m^2",
    tolerance=Tolerance(relative=0.1, rationale="a mesh's clamp acts up to half a segment off, 3 % of the length"),
    diagnosis="look at how E and the radius become the engine's bending constant, and whether the grip holds the slope",
)
def _rod_bending(lab: Lab) -> Measurement:
    course = lab.once(_drooping_rod)
    nodes = course.nodes_m["rod"]
    droop = (nodes[0] - hann_mean(nodes[course.between(SETTLED_S, ROD_S)]))[:, 2]
    s = nodes[0, :, 0] + 0.5 * (GRIP_M + FREE_M) - GRIP_M
    slope = cantilever_load_over_stiffness(s, droop, length_m=FREE_M, weights=np.ones(len(s)))
    load, expected = ROD_DENSITY * SECTION_M2 * ROD_GRAVITY, YOUNG_PA * INERTIA_M4
    if not slope > 0.0:
        return Measurement(measured=float("inf"), expected=expected, hint="under its weight, it does not bend")
    hint = f"it bends {expected * slope / load:.3g} times as much as it should"
    return Measurement(measured=float(load / slope), expected=float(expected), hint=hint)
