"""Rolling and sliding on a leaning plane."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.scene import GRAVITY_M_PER_S2 as G
from gauge_envs.scene import Box, Cylinder, Pose, Scene, Shape, Sphere
from gauge_envs.scene.geometry import vector
from gauge_envs.tools.conformance.lab import Lab
from gauge_envs.tools.conformance.measurements import acceleration_m_per_s2
from gauge_envs.tools.conformance.model import Check, Measurement, Tolerance
from gauge_envs.tools.conformance.scene_parts import body, contact, ground

LEAN_DEG = (3.0, 2.0, 0.0)
LEANING = Pose.from_euler_deg((0.2, -0.1, 1.0), LEAN_DEG)
STEEP = Pose.from_euler_deg((0.2, -0.1, 1.0), (-25.0, 20.0, 0.0))
SLIDE_FRICTION = 0.2
ROLL_S = 0.6


def _sine(pose: Pose) -> float:
    """Return the sine of the angle by which a plane leans."""
    return float(np.linalg.norm(pose.rotation.apply([0.0, 0.0, 1.0])[:2]))


def _downhill(pose: Pose) -> NDArray[np.float64]:
    """Return the unit vector along which a plane falls most steeply, in the world."""
    normal = pose.rotation.apply([0.0, 0.0, 1.0])
    along = np.array([0.0, 0.0, -1.0]) + normal[2] * normal
    return np.asarray(along / np.linalg.norm(along))


def _down_acceleration(lab: Lab, shape: Shape, height_m: float, plane: Pose, friction: float) -> float:
    """Return the acceleration downhill of a body on a leaning plane [m/s^2]; a cylinder lies across the slope."""
    down = _downhill(plane)
    normal = plane.rotation.apply([0.0, 0.0, 1.0])
    axes = np.column_stack([down, normal, np.cross(down, normal)])
    start = np.asarray(plane.position_m) + height_m * normal
    pose = Pose.from_rotation(vector(start), Rotation.from_matrix(axes))
    scene = Scene(
        bodies=(body("roller", shape, pose), replace(ground(), name="plane", pose=plane)),
        contacts=(contact("roller", "plane", friction=friction),),
        duration_s=ROLL_S,
    )
    rollout = lab.rollout(scene)
    window = rollout.between(0.1, ROLL_S)
    along = rollout.displacement("roller") @ down
    return acceleration_m_per_s2(rollout.times_s[window], along[window])


def _roll_check(id: str, what: str, shape: Shape, radius_m: float, share: float, law: str) -> None:
    """Register the check of a body that rolls down a leaning plane."""

    @Check(
        id,
        title=f"{what} rolls without rolling friction",
        scene=f"a {what} of 0.1 kg and radius {1e3 * radius_m:g} mm on a fixed plane that leans by 3.6 degrees about a "
        "diagonal; friction 0.5",
        measures=f"acceleration downhill of the {what}, quadratic fit from 0.1 to 0.6 s",
        law=law,
        source="rolling without slip; contract (Contact.friction is no rolling friction)",
        unit="m/s^2",
        tolerance=Tolerance(relative=0.01, rationale="as for a slide; a rolling friction of 0.01 takes 10 % and more"),
        diagnosis="rolling or torsional friction of the engine is not 0, the inertia or the radius is wrong, or "
        "the body is damped",
    )
    def measure(lab: Lab) -> Measurement:
        measured, sine = _down_acceleration(lab, shape, radius_m, LEANING, 0.5), _sine(LEANING)
        return Measurement(measured=measured, expected=share * G * sine, hint=_roll_hint(measured, share, sine))


def _roll_hint(measured: float, share: float, sine: float) -> str:
    if abs(measured) < 0.02 * G * sine:
        return "it does not roll: the leaning plane is level in the engine, or rolling friction holds it"
    if abs(measured - G * sine) < 0.02 * G * sine:
        return "it slides without rolling: friction has no effect"
    inertia = G * sine / measured - 1.0
    return (
        f"it rolls as if rolling friction were {(share * G * sine - measured) / (share * G):.3g} of its weight, or as "
        f"if its inertia were {inertia:.3g} m r^2 instead of {1.0 / share - 1.0:.3g} m r^2"
    )


_roll_check("roll-ball", "ball", Sphere(radius_m=0.03), 0.03, 5.0 / 7.0, "a = 5/7 g sin(slope)")
_roll_check(
    "roll-cylinder", "cylinder", Cylinder(radius_m=0.03, length_m=0.06), 0.03, 2.0 / 3.0, "a = 2/3 g sin(slope)"
)


@Check(
    "slide-plane",
    title="plane leans",
    scene="a brick of 0.1 kg on a fixed plane that leans by 32 degrees about a diagonal; friction 0.2",
    measures="acceleration of the brick along the plane's steepest direction, quadratic fit from 0.1 to 0.6 s",
    law="a = g (sin - mu cos)",
    source="Coulomb; scene.Plane (body z is the normal)",
    unit="m/s^2",
    tolerance=Tolerance(relative=0.01, rationale="as for a slide on a box"),
    diagnosis="check the friction cone (a pyramid has less friction between its axes), how friction is combined, and "
    "that the plane leans: its normal is the body's z axis",
)
def _slide_plane(lab: Lab) -> Measurement:
    brick = Box(size_m=(0.06, 0.03, 0.05))
    measured, sine = _down_acceleration(lab, brick, 0.015, STEEP, SLIDE_FRICTION), _sine(STEEP)
    expected = G * (sine - SLIDE_FRICTION * float(np.sqrt(1.0 - sine**2)))
    return Measurement(measured=measured, expected=expected, hint=_slide_hint(measured, sine))


def _slide_hint(measured: float, sine: float) -> str:
    if abs(measured) < 0.02 * G * sine:
        return "it does not slide: the leaning plane is level in the engine, or friction holds the brick"
    friction = (sine - measured / G) / float(np.sqrt(1.0 - sine**2))
    if friction < -0.02:
        return "it slides faster than without friction: the plane leans otherwise in the engine"
    return f"it slides as if the friction were {friction:.3g} instead of {SLIDE_FRICTION:.3g}"
