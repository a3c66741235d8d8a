"""Ropes and rods: length and energy of a rope, bending stiffness of a rod. The methods are those of `cloth`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gauge_envs.runs.rollout import Rollout
from gauge_envs.scene import GRAVITY_M_PER_S2 as G
from gauge_envs.scene import Pose, Region, Rod, Rope
from gauge_envs.tools.conformance.lab import Lab, recorded
from gauge_envs.tools.conformance.laws import cantilever_load_over_stiffness, hann_mean
from gauge_envs.tools.conformance.measurements import passive_energy_gain, stiffness
from gauge_envs.tools.conformance.model import COUNT, Measurement, Tolerance
from gauge_envs.tools.conformance.scene_parts import clamped

# --- rope ------------------------------------------------------------------------------------------------------------

ROPE_M = 0.3


@recorded("a horizontal rope of 0.3 m, held at one end and released")
def _falling_rope(lab: Lab) -> Rollout:
    """Record a horizontal rope held at one end; it is released and passes its lowest point at about 0.25 s."""
    rope = Rope(
        name="rope",
        pose=Pose(position_m=(0.0, 0.0, 1.0)),
        length_m=ROPE_M,
        radius_m=0.003,
        mass_kg=0.02,
        young_modulus_pa=1e6,
    )
    return lab.rollout(clamped(rope, Region(axis="x", side="low"), duration_s=0.5))


def _along(rollout: Rollout) -> NDArray[np.float64]:
    """Return the nodes in their order along the rope [m], shape [sample_count, node_count, 3]."""
    nodes = rollout.nodes_m["rope"]
    return np.asarray(nodes[:, np.argsort(nodes[0, :, 0])])


@_falling_rope.check(
    "rope-nodes",
    title="rope, order of nodes",
    measures="number of nodes at the start that are not further along the rope's x axis than the node before",
    law="node i + 1 follows node i from -x to +x",
    source="contract (Simulation.nodes)",
    tolerance=COUNT,
    diagnosis="nodes of a rope or rod must lie along its centre line and in order",
)
def _rope_nodes(rollout: Rollout) -> Measurement:
    along = rollout.nodes_m["rope"][0, :, 0]
    return Measurement(measured=float((np.diff(along) <= 0.0).sum()))


@_falling_rope.check(
    "rope-length",
    title="rope does not stretch",
    measures="length of a rope that swings from one end, at its largest change within 0.5 s",
    law="length = L",
    source="inextensible (scene.Rope)",
    unit="mm",
    tolerance=Tolerance(relative=0.01, rationale="1 % of the length is 0.5 % of the period"),
    diagnosis="distance constraints are too soft, or the engine uses Young's modulus for the stretch stiffness",
)
def _rope_length(rollout: Rollout) -> Measurement:
    lengths = np.linalg.norm(np.diff(_along(rollout), axis=1), axis=2).sum(axis=1)
    at_start = abs(lengths[0] - ROPE_M) > 0.005 * ROPE_M
    return Measurement(
        measured=1e3 * float(lengths[np.abs(lengths - ROPE_M).argmax()]),
        expected=1e3 * ROPE_M,
        hint="it is wrong from the start: the rope was built with another length" if at_start else "",
    )


@_falling_rope.check(
    "rope-energy",
    title="rope gains no energy",
    measures="largest gain of kinetic and potential energy of the swinging rope, over the released potential energy",
    law="T + V <= initial T + V",
    source="an inextensible rope stores no energy",
    unit="%",
    tolerance=Tolerance(absolute=5.0, rationale="speeds are differences over 11 ms, and the mass is assumed uniform"),
    diagnosis="the solver makes energy: long steps, too few iterations, or constraint corrections that add speed",
)
def _rope_energy(rollout: Rollout) -> Measurement:
    nodes = _along(rollout)
    shares = np.gradient(nodes[0, :, 0])
    shares[[0, -1]] *= 0.5
    shares /= shares.sum()
    return passive_energy_gain(nodes, rollout.times_s, shares, G)


# --- rod -------------------------------------------------------------------------------------------------------------

CLAMP_M, FREE_M, RADIUS_M = 0.02, 0.15, 0.005
ROD_DENSITY, YOUNG_PA = 1250.0, 1e7
ROD_GRAVITY = 0.2 * G
SECTION_M2, INERTIA_M4 = np.pi * RADIUS_M**2, 0.25 * np.pi * RADIUS_M**4


@recorded("a horizontal rod of 0.15 m, clamped at one end, at a fifth of gravity")
def _drooping_rod(lab: Lab) -> Rollout:
    """Record a horizontal rod clamped at one end, at a fifth of gravity: sag 2.5 mm on 150 mm, period 0.18 s."""
    rod = Rod(
        name="rod",
        pose=Pose.from_euler_deg((0.0, 0.0, 1.0), (0.0, 90.0, 0.0)),
        length_m=CLAMP_M + FREE_M,
        radius_m=RADIUS_M,
        mass_kg=float(ROD_DENSITY * SECTION_M2 * (CLAMP_M + FREE_M)),
        young_modulus_pa=YOUNG_PA,
        poisson_ratio=0.49,
    )
    clamp = Region(axis="z", side="low", depth_m=CLAMP_M)
    return lab.rollout(clamped(rod, clamp, duration_s=1.1, gravity_m_per_s2=ROD_GRAVITY))


@_drooping_rod.check(
    "rod-bending",
    title="rod, bending stiffness",
    measures="bending stiffness from the mean droop of a rod clamped at one end",
    law="E I w'' = rho A g (L - s)^2 / 2, I = pi r^4 / 4",
    source="Euler and Bernoulli",
    unit="N m^2",
    tolerance=Tolerance(relative=0.1, rationale="the clamp of a mesh can be off by half a segment, 3 % of the length"),
    diagnosis="check the conversion of E and radius to the bending constant, the mass of the nodes, and that the "
    "clamp holds the slope",
)
def _rod_bending(rollout: Rollout) -> Measurement:
    nodes = rollout.nodes_m["rod"]
    droop = (nodes[0] - hann_mean(nodes[rollout.between(0.3, 1.1)]))[:, 2]
    s = nodes[0, :, 0] + 0.5 * (CLAMP_M + FREE_M) - CLAMP_M
    slope = cantilever_load_over_stiffness(s, droop, length_m=FREE_M, weights=np.ones(len(s)))
    load, expected = ROD_DENSITY * SECTION_M2 * ROD_GRAVITY, YOUNG_PA * INERTIA_M4
    return stiffness(load, slope, expected, "bends")
