"""Driven bodies: they are where the driver says, and carry what rests on them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.checks.conformance.attachments import following_reading
from gauge_envs.checks.conformance.kit import Measurement, Tolerance, check
from gauge_envs.checks.conformance.lab import Lab
from gauge_envs.checks.conformance.parts import body, box, driver, ramp
from gauge_envs.checks.rollout import Course
from gauge_envs.scene import GRAVITY_M_PER_S2, Box, Contact, Motion, Pose, Scene
from gauge_envs.scene.drivers import Driver, TrapezoidProfile

__all__: list[str] = []

PLATE_M = (0.6, 0.4, 0.02)
CUBE_M = 0.05
CARRY_S = 1.5
WAY_M, TURN_RAD_PER_S = 0.3, 2.0
PLATE = body("plate", Box(size_m=PLATE_M), Pose(position_m=(0.0, 0.0, 0.5)), mass_kg=1.0, motion=Motion.KINEMATIC)


def _on_plate(lab: Lab, motion: Driver, *, friction: float, x_m: float, seconds: float) -> Course:
    """A cube on a driven plate."""
    cube = box("cube", (x_m, 0.0, 0.5 + 0.5 * (PLATE_M[2] + CUBE_M)), (CUBE_M,) * 3)
    scene = Scene(
        bodies=(cube, PLATE),
        contacts=(Contact(first=("cube",), second=("plate",), friction=friction, restitution=0.0),),
        drivers=(motion,),
        duration_s=seconds,
    )
    return lab.course(scene, seconds)


def _carry(lab: Lab) -> Course:
    """The plate moves by 0.3 m within 1.2 s, speeding up and braking with 0.94 m/s^2; friction holds 3.9."""
    motion = driver("plate", "translate", (1.0, 0.0, 0.0), ramp(WAY_M, start_s=0.0, duration_s=1.2, ramp_s=0.4))
    return _on_plate(lab, motion, friction=0.4, x_m=-0.1, seconds=CARRY_S)


def _turntable(lab: Lab) -> Course:
    """The plate turns with 2 rad/s, which pulls the cube outward with 0.2 m/s^2; friction holds 3.9."""
    turn = TrapezoidProfile(
        start_s=0.0, duration_s=10.0, accelerate_s=0.5, brake_s=0.0, amount=TURN_RAD_PER_S * (10.0 - 0.25)
    )
    return _on_plate(lab, driver("plate", "rotate", (0.0, 0.0, 1.0), turn), friction=0.4, x_m=0.05, seconds=CARRY_S)


def _on_the_plate(course: Course) -> NDArray[np.float64]:
    """Way of the cube in the frame in which the plate should be [m], shape [sample_count, 3]."""
    (motion,) = course.scene.drivers
    places = [
        course.driven_pose(motion, sample).to_body(position) for sample, position in enumerate(course.position("cube"))
    ]
    return np.array(places) - places[0]


@check(
    "driven-path",
    title="driven body is where its driver says",
    measures="largest distance of a corner of a turning plate, loaded with a cube, from where the driver puts it",
    law="pose = the driver's",
    source="contract (Simulation.drive)",
    unit="mm",
    tolerance=Tolerance(absolute=0.1, rationale="a tenth of the real trials' scatter"),
    diagnosis="the pose is set too early or too late by an interval, contacts push the driven body, or its path is not "
    "integrated with the acceleration that drive() gives",
)
def _driven_path(lab: Lab) -> Measurement:
    course = lab.once(_turntable)
    corners = Box(size_m=PLATE_M).corners_m

    def corners_now(sample: int) -> NDArray[np.float64]:
        state = course.states["plate"][sample]
        turned = Rotation.from_quat(state[3:7], scalar_first=True).apply(corners)
        return np.asarray(turned + state[:3])

    return following_reading(course, corners_now)


@check(
    "driven-velocity",
    title="driven body has its driver's velocity",
    measures="reported speed of a plate driven in a line, while it cruises, over the driver's",
    law="v = the driver's",
    source="contract (Simulation.drive)",
    unit="1",
    tolerance=Tolerance(absolute=0.01, rationale="it is what friction on the plate sees; 1 % as for a slide"),
    diagnosis="the driven body is teleported: it has no velocity, so that it carries nothing",
)
def _driven_velocity(lab: Lab) -> Measurement:
    course = lab.once(_carry)
    cruise = course.scene.drivers[0].motions[0].rate(0.6)
    return Measurement(measured=float(course.velocity("plate")[course.between(0.6, 0.6), 0][0] / cruise), expected=1.0)


CARRY_TOLERANCE = Tolerance(absolute=1.0, rationale="the real trials' scatter is about 1 mm")
CARRY_DIAGNOSIS = (
    "the driven body must have a velocity in every step, so that friction carries the cube; piecewise constant speed "
    "jolts it at each change"
)


@check(
    "carry-line",
    title="plate carries a cube in a line",
    measures="largest way of the cube on the plate while that moves by 0.3 m, speeding up and braking",
    law="0 while the acceleration is below mu g",
    source="Coulomb",
    unit="mm",
    tolerance=CARRY_TOLERANCE,
    diagnosis=CARRY_DIAGNOSIS,
)
def _carry_line(lab: Lab) -> Measurement:
    way = np.linalg.norm(_on_the_plate(lab.once(_carry)), axis=1)
    return Measurement(measured=1e3 * float(way.max()), expected=0.0)


@check(
    "carry-turn",
    title="turntable carries a cube round",
    measures="largest way of the cube on the plate while that turns by 2.5 rad at up to 2 rad/s, 50 mm off its axis",
    law="0 while omega^2 r is below mu g",
    source="Coulomb",
    unit="mm",
    tolerance=CARRY_TOLERANCE,
    diagnosis=CARRY_DIAGNOSIS + "; look at angular velocity's sign and frame, and at outward creep",
)
def _carry_turn(lab: Lab) -> Measurement:
    way = np.linalg.norm(_on_the_plate(lab.once(_turntable)), axis=1)
    return Measurement(measured=1e3 * float(way.max()), expected=0.0)


@check(
    "carry-slip",
    title="plate slips under a cube",
    measures="acceleration of a cube with friction 0.05 on a plate that accelerates with 2 m/s^2, fit over 0.4 s",
    law="a = mu g",
    source="Coulomb",
    unit="m/s^2",
    tolerance=Tolerance(
        relative=0.02, rationale="as for a slide, and as much for the plate's speed changing within an interval"
    ),
    diagnosis="friction on a driven body is not that of the pair, or sees another velocity than the driver's",
)
def _carry_slip(lab: Lab) -> Measurement:
    start = TrapezoidProfile(start_s=0.0, duration_s=0.5, accelerate_s=0.5, brake_s=0.0, amount=0.25)
    motion = driver("plate", "translate", (1.0, 0.0, 0.0), start)
    course = _on_plate(lab, motion, friction=0.05, x_m=0.0, seconds=0.4)
    fit = np.polyfit(course.times_s, course.position("cube")[:, 0], 2)
    return Measurement(measured=float(2.0 * fit[0]), expected=0.05 * GRAVITY_M_PER_S2)
