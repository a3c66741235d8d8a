"""Torque-free spin: angular momentum, orientation and the centre of mass."""

from __future__ import annotations

import numpy as np

from gauge_envs.runs.rollout import Rollout
from gauge_envs.scene import Box
from gauge_envs.tools.conformance.laws import box_inertia_kg_m2, torque_free_orientation, world_inertia_kg_m2
from gauge_envs.tools.conformance.model import Measurement, Tolerance
from gauge_envs.tools.conformance.registry import check
from gauge_envs.tools.conformance.spin import (
    BRICK_KG,
    BRICK_M,
    HIT_S,
    SOLID_ORIGIN_M,
    SPIN_END_S,
    spinning_brick,
    spinning_solid,
    when_spinning,
)


@check(
    "spin-momentum",
    title="torque-free spin, angular momentum",
    scene="a floating brick of 0.4 kg that a driven ball hits off its centre; no gravity",
    measures="largest change of a spinning brick's angular momentum within 0.5 s, over its size",
    law="L = R I R' omega = const",
    source="Euler",
    unit="%",
    tolerance=Tolerance(
        absolute=1.0,
        rationale="a tumbling body falls for about 0.3 s before it lands; 1 % of its rotation is then 2 degrees",
    ),
    diagnosis="check angular damping, the gyroscopic term, the inertia, and the frame of the angular velocity",
)
@when_spinning(spinning_brick)
def _spin_momentum(rollout: Rollout) -> Measurement:
    states = rollout.states["brick"]
    inertia = world_inertia_kg_m2(box_inertia_kg_m2(Box(size_m=BRICK_M), BRICK_KG), rollout.rotation("brick"))
    momentum = np.einsum("tij,tj->ti", inertia, states[:, 10:])
    change = np.linalg.norm(momentum - momentum[0], axis=1).max() / np.linalg.norm(momentum[0])
    return Measurement(measured=100.0 * float(change), expected=0.0)


@check(
    "spin-orientation",
    title="torque-free spin, orientation",
    scene="a floating brick of 0.4 kg that a driven ball hits off its centre; no gravity",
    measures="angle between the spinning brick after 0.5 s and Euler's equations integrated from its start",
    law="I domega/dt + omega x I omega = 0",
    source="Euler, integrated by scipy's DOP853",
    unit="deg",
    tolerance=Tolerance(
        absolute=3.0,
        rationale="it has rotated by several hundred degrees; 1 % is the tolerance of its angular momentum",
    ),
    diagnosis="the gyroscopic term, the inertia, or the sign or frame of the reported angular velocity is wrong",
)
@when_spinning(spinning_brick)
def _spin_orientation(rollout: Rollout) -> Measurement:
    states = rollout.states["brick"]
    rotations = rollout.rotation("brick")
    expected = torque_free_orientation(
        start=rotations[0],
        spin_rad_per_s=states[0, 10:],
        moments=box_inertia_kg_m2(Box(size_m=BRICK_M), BRICK_KG),
        seconds=SPIN_END_S - HIT_S,
    )
    error = float(np.degrees((rotations[-1] * expected.inv()).magnitude()))
    return Measurement(measured=error, expected=0.0)


@check(
    "solid-spin-centre",
    title="convex solid rotates about its centre of mass",
    scene="the same brick as a convex solid whose body origin is one of its corners, hit by a driven ball; no gravity",
    measures="largest distance of the free solid's centre of mass from a straight line within 0.5 s",
    law="centre of mass moves uniformly",
    source="Newton; uniform density (scene.py)",
    unit="mm",
    tolerance=Tolerance(absolute=0.5, rationale="the real trials' scatter is about 1 mm"),
    diagnosis="the centre of mass is not that of the solid's volume: the engine uses the origin of its frame",
)
@when_spinning(spinning_solid)
def _solid_spin_centre(rollout: Rollout) -> Measurement:
    states, times = rollout.states["brick"], rollout.times_s
    centre = states[:, :3] + rollout.rotation("brick").apply(-SOLID_ORIGIN_M)
    line = np.polynomial.polynomial.polyfit(times, centre, 1)
    error = np.linalg.norm(centre - (line[0] + np.outer(times, line[1])), axis=1).max()
    return Measurement(measured=1e3 * float(error), expected=0.0)
