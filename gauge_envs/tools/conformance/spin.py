"""Torque-free spin: the reported velocities."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import wraps

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.runs.rollout import Rollout
from gauge_envs.scene import Box, ConvexUnion, Motion, RigidBody, Scene, Vector
from gauge_envs.scene.geometry import vector
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S
from gauge_envs.tools.bench.parts import ball, box, contact, driver, ramp
from gauge_envs.tools.conformance.lab import Lab
from gauge_envs.tools.conformance.laws import spin_from_orientations
from gauge_envs.tools.conformance.model import Measurement, Tolerance, recorded

# The contract has no start velocities, so a driven ball hits a floating brick off its centre and withdraws.

BRICK_M = (0.1, 0.06, 0.03)
BRICK_KG = 0.4
HIT_S, SPIN_END_S = 0.25, 0.75
HAMMER_RADIUS_M, GAP_M = 0.02, 0.03


def _struck(lab: Lab, brick: RigidBody, point_m: Vector) -> Rollout:
    """Record a floating body after a driven ball has hit a point of its upper z face, along that face's normal."""
    inward = brick.pose.rotation.apply([0.0, 0.0, -1.0])
    start = (
        brick.pose.to_world(np.asarray(point_m)) - (HAMMER_RADIUS_M + GAP_M) * inward
    )
    hammer = ball("hammer", vector(start), radius_m=HAMMER_RADIUS_M, mass_kg=1.0)
    stroke = ramp(0.05, start_s=0.0, duration_s=0.08, ramp_s=0.03)
    back = ramp(-0.35, start_s=0.08, duration_s=0.4, ramp_s=0.05)
    scene = Scene(
        bodies=(brick, replace(hammer, motion=Motion.KINEMATIC)),
        contacts=(contact(brick.name, "hammer", friction=0.0),),
        drivers=(driver("hammer", "translate", vector(inward), stroke, back),),
        duration_s=SPIN_END_S,
        gravity_m_per_s2=0.0,
    )
    return lab.rollout(scene).cut(HIT_S, SPIN_END_S)


BRICK = box(
    "brick", (0.2, 0.1, 1.0), BRICK_M, euler_deg=(50.0, -20.0, 70.0), mass_kg=BRICK_KG
)


@recorded(
    "a floating brick of 0.4 kg that a driven ball hits off its centre; no gravity"
)
def spinning_brick(lab: Lab) -> Rollout:
    """Record a brick after a hit off its centre."""
    return _struck(lab, BRICK, (0.035, 0.018, 0.015))


SOLID_ORIGIN_M = np.array([-0.05, -0.03, -0.015])
"""Body origin of the same brick as a convex solid, in the frame of the brick: one of its corners."""


@recorded(
    "the same brick as a convex solid whose body origin is one of its corners, hit by a driven ball; no gravity"
)
def spinning_solid(lab: Lab) -> Rollout:
    """Record the same brick as a convex solid about one of its corners."""
    corners = tuple(
        vector(corner) for corner in Box(size_m=BRICK_M).corners_m - SOLID_ORIGIN_M
    )
    solid = replace(BRICK, shape=ConvexUnion(pieces_m=(corners,)))
    return _struck(lab, solid, vector(np.array([0.035, 0.018, 0.015]) - SOLID_ORIGIN_M))


def if_it_spins(
    measure: Callable[[Rollout], Measurement],
) -> Callable[[Rollout], Measurement]:
    """Return a measurement that fails if the hit made no body spin."""

    @wraps(measure)
    def measure_spin(rollout: Rollout) -> Measurement:
        rotations = rollout.rotation("brick")
        turned = float(
            np.degrees((rotations[1:] * rotations[:-1].inv()).magnitude().sum())
        )
        if turned > 60.0:
            return measure(rollout)
        hint = (
            f"the driven ball did not make the body spin: it rotated by {turned:.2g} degrees within 0.5 s. "
            "The pair does not collide, or is soft"
        )
        return Measurement(measured=float("nan"), hint=hint)

    return measure_spin


def _vector_error(
    reported: NDArray[np.float64],
    actual: NDArray[np.float64],
    explanations: Mapping[str, NDArray[np.float64]],
) -> Measurement:
    """Measure the largest error [%] of vectors over their mean size; explanations are vectors of known faults."""
    size = np.linalg.norm(actual, axis=1).mean()

    def error(values: NDArray[np.float64]) -> float:
        return float(np.linalg.norm(values - actual, axis=1).max() / size)

    hint = next(
        (text for text, values in explanations.items() if error(values) < 0.03), ""
    )
    return Measurement(measured=100.0 * error(reported), hint=hint)


DERIVATIVE_TOLERANCE = Tolerance(
    "central differences over 11 ms are 0.3 % off at this spin; a wrong frame or sign gives 10 to 200 %",
    absolute=2.0,
)


@spinning_brick.check("angular-velocity", tolerance=DERIVATIVE_TOLERANCE)
@if_it_spins
def _angular_velocity(rollout: Rollout) -> Measurement:
    states = rollout.states["brick"]
    rotations = rollout.rotation("brick")
    actual = spin_from_orientations(rotations, SAMPLE_INTERVAL_S)
    reported = states[1:-1, 10:]
    explanations = {
        "it has the wrong sign": -reported,
        "it is in the body frame": rotations[1:-1].apply(reported),
        "it is in degrees": np.radians(reported),
    }
    found = _vector_error(reported, actual, explanations)
    return (
        found
        if found.hint
        else replace(found, hint=_quaternion_hint(states[:, 3:7], reported))
    )


def _quaternion_hint(
    quaternions: NDArray[np.float64], spin: NDArray[np.float64]
) -> str:
    """Return the wrong convention of quaternions w, x, y, z, [sample_count, 4], to which a spin [rad/s] fits; or ""."""
    conventions = {
        "it fits the quaternion with its scalar first and last exchanged: the engine has another order inside": (
            np.roll(quaternions, 1, axis=1),
            np.roll(quaternions, -1, axis=1),
        ),
        "it fits the inverse of the quaternion: the engine rotates from the world to the body": (
            quaternions * [1.0, -1.0, -1.0, -1.0],
        ),
    }
    for text, candidates in conventions.items():
        for candidate in candidates:
            actual = spin_from_orientations(
                Rotation.from_quat(candidate, scalar_first=True), SAMPLE_INTERVAL_S
            )
            if _vector_error(spin, actual, {}).measured < 3.0:
                return text
    return ""


@spinning_solid.check("velocity-of-origin", tolerance=DERIVATIVE_TOLERANCE)
@if_it_spins
def _velocity_of_origin(rollout: Rollout) -> Measurement:
    states = rollout.states["brick"]
    actual = (states[2:, :3] - states[:-2, :3]) / (2.0 * SAMPLE_INTERVAL_S)
    reported = states[1:-1, 7:10]
    rotations = rollout.rotation("brick")[1:-1]
    arm = rotations.apply(-SOLID_ORIGIN_M)
    explanations = {
        "it is the velocity of the centre of mass": reported
        - np.cross(states[1:-1, 10:], arm),
        "it is in the body frame": rotations.apply(reported),
        "it has the wrong sign": -reported,
        "it is in mm/s": 1e-3 * reported,
    }
    return _vector_error(reported, actual, explanations)
