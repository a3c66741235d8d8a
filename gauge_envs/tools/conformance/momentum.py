"""Torque-free spin: angular momentum, orientation and the centre of mass."""

from __future__ import annotations

import numpy as np

from gauge_envs.runs.rollout import Rollout
from gauge_envs.tools.conformance.laws import box_inertia_kg_m2, torque_free_orientation
from gauge_envs.tools.conformance.measurements import inertia_kg_m2, largest_mm
from gauge_envs.tools.conformance.model import Measurement, Tolerance
from gauge_envs.tools.conformance.spin import BRICK, SOLID_ORIGIN_M, if_it_spins, spinning_brick, spinning_solid


@spinning_brick.check(
    "spin-momentum",
    title="torque-free spin, angular momentum",
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
@if_it_spins
def _spin_momentum(rollout: Rollout) -> Measurement:
    momentum = np.einsum("tij,tj->ti", inertia_kg_m2(rollout, "brick"), rollout.angular_velocity("brick"))
    change = np.linalg.norm(momentum - momentum[0], axis=1).max() / np.linalg.norm(momentum[0])
    return Measurement(measured=100.0 * float(change))


@spinning_brick.check(
    "spin-orientation",
    title="torque-free spin, orientation",
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
@if_it_spins
def _spin_orientation(rollout: Rollout) -> Measurement:
    rotations = rollout.rotation("brick")
    expected = torque_free_orientation(
        start=rotations[0],
        spin_rad_per_s=rollout.angular_velocity("brick")[0],
        moments=box_inertia_kg_m2(BRICK),
        seconds=0.5,
    )
    return Measurement(measured=float(np.degrees((rotations[-1] * expected.inv()).magnitude())))


@spinning_solid.check(
    "solid-spin-centre",
    title="convex solid rotates about its centre of mass",
    measures="largest distance of the free solid's centre of mass from a straight line within 0.5 s",
    law="centre of mass moves uniformly",
    source="Newton; uniform density (scene.py)",
    unit="mm",
    tolerance=Tolerance(absolute=0.5, rationale="the real trials' scatter is about 1 mm"),
    diagnosis="the centre of mass is not that of the solid's volume: the engine uses the origin of its frame",
)
@if_it_spins
def _solid_spin_centre(rollout: Rollout) -> Measurement:
    centre, times = rollout.position("brick") + rollout.rotation("brick").apply(-SOLID_ORIGIN_M), rollout.times_s
    line = np.polynomial.polynomial.polyfit(times, centre, 1)
    return Measurement(measured=largest_mm(centre - (line[0] + np.outer(times, line[1]))))
