"""Start velocities of bodies without gravity and contact: straight flight and free rotation."""

from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gauge_envs.runs.rollout import Rollout
from gauge_envs.scene import (
    Box,
    ConvexUnion,
    Motion,
    Pose,
    RigidBody,
    Scene,
    Shape,
    Sphere,
)
from gauge_envs.scene.geometry import vector
from gauge_envs.tools.bench.parts import box_inertia_kg_m2
from gauge_envs.tools.conformance.lab import Lab
from gauge_envs.tools.conformance.laws import largest_mm, torque_free_orientation
from gauge_envs.tools.conformance.model import Check, Measurement, recorded, rollout_of

FLIGHT_S = 0.5
LINEAR_M_PER_S = (1.2, -0.8, 0.5)
ANGULAR_RAD_PER_S = (2.0, 5.0, -3.0)
POSE = Pose.from_euler_deg((0.2, 0.1, 1.0), (50.0, -20.0, 70.0))
BRICK = Box(size_m=(0.1, 0.06, 0.03))
CENTRE_M = np.array([0.05, 0.03, 0.015])
"""Centre of mass of the brick as a convex solid, whose origin is one of its corners [m]."""
CORNERS_M = tuple(vector(corner) for corner in BRICK.corners_m + CENTRE_M)


def _thrown_scene(shape: Shape) -> Scene:
    thrown = RigidBody(
        name="thrown",
        shape=shape,
        motion=Motion.DYNAMIC,
        pose=POSE,
        mass_kg=0.4,
        linear_velocity_m_per_s=LINEAR_M_PER_S,
        angular_velocity_rad_per_s=ANGULAR_RAD_PER_S,
    )
    return Scene(bodies=(thrown,), duration_s=FLIGHT_S, gravity_m_per_s2=0.0)


BALL = _thrown_scene(Sphere(radius_m=0.03))
_thrown_ball = rollout_of(
    "a ball thrown with rotation, without gravity and contacts", BALL
)
_thrown_brick = rollout_of(
    "a leaning brick of 0.4 kg thrown with rotation, without gravity and contacts",
    _thrown_scene(BRICK),
)
_thrown_solid = rollout_of(
    "the same brick as a convex solid whose origin is one of its corners",
    _thrown_scene(ConvexUnion(pieces_m=(CORNERS_M,))),
)


def _explained(
    error: Callable[[NDArray[np.float64]], float],
    right: NDArray[np.float64],
    explanations: Mapping[str, NDArray[np.float64]],
) -> Measurement:
    """Measure the error of an assumed velocity, with an explanation by another one that leaves less than 5 % of it."""
    errors = {text: error(assumed) for text, assumed in explanations.items()}
    text = min(errors, key=errors.__getitem__)
    measured = error(right)
    return Measurement(
        measured=measured, hint=text if errors[text] < 0.05 * measured else ""
    )


def _off_line_mm(
    moved_m: NDArray[np.float64], rollout: Rollout
) -> Callable[[NDArray[np.float64]], float]:
    """Return the function that gives the largest distance [mm] from a straight line with a velocity."""
    return lambda velocity: largest_mm(moved_m - np.outer(rollout.times_s, velocity))


@_thrown_ball.check("start-velocity")
def _start_velocity(rollout: Rollout) -> Measurement:
    velocity = np.array(LINEAR_M_PER_S)
    explanations = {
        "the ball starts at rest": np.zeros(3),
        "the velocity has the wrong sign": -velocity,
        "the velocity is taken in the body frame": POSE.rotation.apply(velocity),
        "the velocity is taken in mm/s": 1e-3 * velocity,
    }
    return _explained(
        _off_line_mm(rollout.displacement("thrown"), rollout), velocity, explanations
    )


@_thrown_brick.check("start-spin")
def _start_spin(rollout: Rollout) -> Measurement:
    last = rollout.rotation("thrown")[-1]
    spin = np.array(ANGULAR_RAD_PER_S)

    def error_deg(assumed: NDArray[np.float64]) -> float:
        expected = torque_free_orientation(
            start=POSE.rotation,
            spin_rad_per_s=assumed,
            moments=box_inertia_kg_m2(rollout.scene.body("thrown")),
            seconds=FLIGHT_S,
        )
        return float(np.degrees((last * expected.inv()).magnitude()))

    explanations = {
        "the brick starts without rotation": np.zeros(3),
        "the angular velocity has the wrong sign": -spin,
        "the angular velocity is taken in the body frame": POSE.rotation.apply(spin),
        "the angular velocity is taken in degrees": np.radians(spin),
    }
    return _explained(error_deg, spin, explanations)


@_thrown_solid.check("start-velocity-of-origin")
def _start_velocity_of_origin(rollout: Rollout) -> Measurement:
    moved = rollout.position("thrown") + rollout.rotation("thrown").apply(CENTRE_M)
    moved -= POSE.to_world(CENTRE_M)
    of_origin = np.array(LINEAR_M_PER_S)
    of_centre = of_origin + np.cross(ANGULAR_RAD_PER_S, POSE.rotation.apply(CENTRE_M))
    explanations = {
        "the velocity is given to the centre of mass instead of the origin": of_origin
    }
    return _explained(_off_line_mm(moved, rollout), of_centre, explanations)


@Check("start-velocity-reset")
def _start_velocity_reset(lab: Lab) -> Measurement:
    with closing(lab.build(BALL)) as simulation:
        simulation.reset(0)
        simulation.advance(0.1)
        simulation.reset(0)
        reported = simulation.body_states(["thrown"])[0, 7:]
        error = float(np.abs(reported - [*LINEAR_M_PER_S, *ANGULAR_RAD_PER_S]).max())
        return Measurement(measured=error, hint=_reported_hint(reported))


def _reported_hint(reported: NDArray[np.float64]) -> str:
    """Return what is wrong with velocities that should be those of the scene, shape [6]; empty if it is not known."""
    if not reported.any():
        return "the ball is at rest after the reset"
    found = []
    for what, values, right in (
        ("linear", reported[:3], np.array(LINEAR_M_PER_S)),
        ("angular", reported[3:], np.array(ANGULAR_RAD_PER_S)),
    ):
        forms = {
            "": right,
            "is in the body frame": POSE.rotation.apply(right, inverse=True),
            "has the wrong sign": -right,
            "is in degrees": np.degrees(right),
            "is in mm/s": 1e3 * right,
        }
        text = next(
            (
                text
                for text, form in forms.items()
                if np.allclose(values, form, rtol=1e-3)
            ),
            "",
        )
        found += [f"the reported {what} velocity {text}"] if text else []
    return "; ".join(found)


SPIN_RAD_PER_S, SLOW_M_PER_S = 200.0, 0.003


@recorded(
    "a ball thrown with 3 mm/s and a spin of 200 rad/s, without gravity and contacts"
)
def _extremes(lab: Lab) -> Rollout:
    thrown = replace(BALL.bodies[0], linear_velocity_m_per_s=(SLOW_M_PER_S, 0.0, 0.0))
    axis = np.array([1.0, 2.0, 2.0]) / 3.0
    thrown = replace(thrown, angular_velocity_rad_per_s=vector(SPIN_RAD_PER_S * axis))
    slow = replace(
        BALL.bodies[0], name="slow", linear_velocity_m_per_s=(0.0, SLOW_M_PER_S, 0.0)
    )
    slow = replace(
        slow,
        pose=replace(POSE, position_m=(1.0, 0.0, 1.0)),
        angular_velocity_rad_per_s=(0.0, 0.0, 0.0),
    )
    return lab.rollout(
        Scene(bodies=(thrown, slow), duration_s=2.0, gravity_m_per_s2=0.0)
    )


@_extremes.check("spin-fast")
def _spin_fast(rollout: Rollout) -> Measurement:
    rotations = rollout.rotation("thrown")
    turned = (rotations[1:] * rotations[:-1].inv()).magnitude()
    reported = float(np.linalg.norm(rollout.angular_velocity("thrown")[-1]))
    rate = float(turned.sum() / rollout.times_s[-1])
    return Measurement(
        measured=rate,
        expected=SPIN_RAD_PER_S,
        hint=f"it reports {reported:.4g} rad/s at the end",
    )


@_extremes.check("orientation-unit")
def _orientation_unit(rollout: Rollout) -> Measurement:
    lengths = np.linalg.norm(rollout.states["thrown"][:, 3:7], axis=1)
    return Measurement(
        measured=float(lengths[np.abs(lengths - 1.0).argmax()]), expected=1.0
    )


@_extremes.check("slow-drift")
def _slow_drift(rollout: Rollout) -> Measurement:
    moved = float(rollout.displacement("slow")[-1, 1])
    return Measurement(
        measured=1e3 * moved, expected=1e3 * SLOW_M_PER_S * float(rollout.times_s[-1])
    )
