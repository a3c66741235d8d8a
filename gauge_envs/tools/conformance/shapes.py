"""Shapes in contact: heights at rest of every shape on every other one; rolling and sliding on a leaning plane."""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.scene import (
    GRAVITY_M_PER_S2 as G,
    Box,
    Contact,
    ConvexUnion,
    Cylinder,
    Motion,
    Plane,
    Pose,
    RigidBody,
    Scene,
    Shape,
    Sphere,
    Vector,
)
from gauge_envs.scene.geometry import vector
from gauge_envs.scoring.estimators import slide_friction
from gauge_envs.tools.bench.parts import body, contact, corners, driver, ground, ramp
from gauge_envs.tools.bench.slope import Slope, acceleration_downhill_m_per_s2
from gauge_envs.tools.conformance.lab import Lab
from gauge_envs.tools.conformance.model import Check, Measurement, Tolerance

# --- heights at rest -------------------------------------------------------------------------------------------------

REST_S = 0.3
LYING_DEG = (90.0, 0.0, 0.0)
"""Rotation that turns a cylinder's axis from z to -y."""
ALONG_X_DEG = (0.0, 90.0, 0.0)
"""Rotation that turns a cylinder's axis from z to x."""

PRISM = ConvexUnion(
    pieces_m=(
        corners((-0.02, -0.025, -0.01), (0.03, 0.02, 0.02)),
        corners((-0.02, -0.025, 0.02), (0.03, 0.02, 0.025)),
    )
)
"""Solid of two pieces whose body origin is 10 mm above its lower and 25 mm below its upper face."""
PRISM_CENTRE_M = (0.005, -0.0025)
"""Horizontal place of the solid's centre of mass in its frame [m]."""

UPRIGHT_DEG = (0.0, 0.0, 0.0)

SUPPORTS: dict[str, tuple[Shape, Vector, float]] = {
    # Shape, Euler angles [deg], and height of the highest point over the origin [m].
    "plane": (Plane(), UPRIGHT_DEG, 0.0),
    "box": (Box(size_m=(0.12, 0.12, 0.06)), UPRIGHT_DEG, 0.03),
    "sphere": (Sphere(radius_m=0.06), UPRIGHT_DEG, 0.06),
    "cylinder": (Cylinder(radius_m=0.06, length_m=0.08), UPRIGHT_DEG, 0.04),
    "lying cylinder": (Cylinder(radius_m=0.05, length_m=0.12), ALONG_X_DEG, 0.05),
    "convex solid": (PRISM, UPRIGHT_DEG, 0.025),
}


@dataclass(frozen=True, kw_only=True)
class _Resting:
    """A shape that is placed on every kind of support.

    Attributes:
        what: The shape in words.
        shape: The shape.
        euler_deg: Its Euler angles [deg].
        height_m: Height of its origin over its lowest point [m].
        centre_m: Horizontal place of its centre of mass in its rotated frame [m].
        hints: Heights [m] by which a shape of a known wrong size would sink, and the fault.
        supports: Whether the supports are fixed, or driven bodies that stand still.
    """

    what: str
    shape: Shape
    euler_deg: Vector = UPRIGHT_DEG
    height_m: float
    centre_m: tuple[float, float] = (0.0, 0.0)
    hints: tuple[tuple[float, str], ...] = ()
    supports: Motion = Motion.FIXED

    @property
    def kinds(self) -> list[str]:
        """Kinds of support; planes are not driven."""
        return [
            kind
            for kind in SUPPORTS
            if self.supports is Motion.FIXED or kind != "plane"
        ]

    def scene(self, on: list[str]) -> Scene:
        """Return a scene in which copies stand on bodies of the given kinds, each above the centre."""
        bodies: list[RigidBody] = []
        contacts: list[Contact] = []
        for index, kind in enumerate(on):
            support, angles, top_m = SUPPORTS[kind]
            x, z = 0.4 * index, 0.5
            name = f"on {kind}"
            place = (x - self.centre_m[0], -self.centre_m[1], z + top_m + self.height_m)
            bodies.append(
                body(
                    name,
                    self.shape,
                    Pose.from_euler_deg(place, self.euler_deg),
                    mass_kg=0.2,
                )
            )
            under = (x, 0.0, z)
            if isinstance(support, ConvexUnion):
                under = (x - PRISM_CENTRE_M[0], -PRISM_CENTRE_M[1], z)
            mass_kg = 0.0 if isinstance(support, Plane) else 1.0
            pose = Pose.from_euler_deg(under, angles)
            bodies.append(
                body(kind, support, pose, mass_kg=mass_kg, motion=self.supports)
            )
            contacts.append(contact(name, kind, friction=0.5))
        driven = on if self.supports is Motion.KINEMATIC else []
        stay = ramp(0.0, start_s=0.0, duration_s=0.1, ramp_s=0.03)
        still = (driver(name, "translate", (1.0, 0.0, 0.0), stay) for name in driven)
        return Scene(
            bodies=tuple(bodies),
            contacts=tuple(contacts),
            drivers=tuple(still),
            duration_s=REST_S,
        )

    def hint(self, worst: str, heights: dict[str, float]) -> str:
        """Return what the heights [mm] say: a size of the shape, of one support, or a margin of all."""
        value = heights[worst]
        if abs(value) < 1e-9:
            return ""
        spread = max(heights.values()) - min(heights.values())
        for drop_m, text in self.hints:
            if abs(value + 1e3 * drop_m) < 0.2 and spread < 0.3:
                return text
        if spread < 0.1 * abs(value):
            side = "floats above" if value > 0.0 else "sinks into"
            return f"the {self.what} {side} every support by {abs(value):.3g} mm: a margin, or its size"
        wrong = [
            f"{kind} {height:.3g} mm"
            for kind, height in heights.items()
            if abs(height) > 0.2
        ]
        return f"height of the {self.what} on each support that is wrong: {', '.join(wrong)}"


def _rest_check(id: str, resting: _Resting) -> None:
    """Register the check of a shape that rests on every kind of support."""
    what, is_fixed = resting.what, resting.supports is Motion.FIXED
    under, on = (
        ("fixed plane, box", "")
        if is_fixed
        else ("driven, unmoving box", " on driven bodies")
    )

    @Check(
        id,
        title=f"{what} rests at its height" + on,
        scene=f"{what} of 0.2 kg placed on a {under}, sphere, cylinder, lying cylinder and convex solid "
        "each; supports that the backend declines are left out",
        measures=f"height of the {what}'s lowest point over its support, the worst of all supports, 0.2 to 0.3 s after "
        "it was placed there",
        law="height = 0",
        source="sizes of both shapes (scene.Shape)",
        unit="mm",
        tolerance=Tolerance(
            "a fifth of the real trials' scatter; default margins of collision shapes are 0.5 to 40 mm",
            absolute=0.2,
        ),
        diagnosis=f"the {what} or its support has another size in the engine: check half sizes, the cylinder's axis, "
        "collision margins, contact offsets and rounded edges",
    )
    def measure(lab: Lab) -> Measurement:
        kinds = resting.kinds
        if not lab.backend.supports(resting.scene(kinds)):
            kinds = [
                kind for kind in kinds if lab.backend.supports(resting.scene([kind]))
            ] or kinds
        rollout = lab.rollout(resting.scene(kinds))
        last = rollout.between(0.2, REST_S)
        heights = {
            kind: 1e3 * float(rollout.displacement(f"on {kind}")[last, 2].mean())
            for kind in kinds
        }
        worst = max(heights, key=lambda kind: abs(heights[kind]))
        return Measurement(measured=heights[worst], hint=resting.hint(worst, heights))


_rest_check(
    "rest-box",
    _Resting(what="box", shape=Box(size_m=(0.06, 0.05, 0.04)), height_m=0.02),
)
_rest_check(
    "rest-driven",
    _Resting(
        what="box",
        shape=Box(size_m=(0.06, 0.05, 0.04)),
        height_m=0.02,
        supports=Motion.KINEMATIC,
    ),
)
_rest_check(
    "rest-sphere",
    _Resting(
        what="sphere",
        shape=Sphere(radius_m=0.02),
        height_m=0.02,
        hints=(
            (0.01, "its radius is half of that in the scene"),
            (-0.02, "its radius is taken for a diameter"),
        ),
    ),
)
_rest_check(
    "rest-cylinder",
    _Resting(
        what="upright cylinder",
        shape=Cylinder(radius_m=0.025, length_m=0.05),
        height_m=0.025,
        hints=(
            (
                0.0125,
                "its length is half of that in the scene: length_m is the full length",
            ),
            (
                -0.025,
                "its length is twice that in the scene: the engine's half length was given length_m",
            ),
        ),
    ),
)
_rest_check(
    "rest-lying-cylinder",
    _Resting(
        what="lying cylinder",
        shape=Cylinder(radius_m=0.025, length_m=0.08),
        euler_deg=LYING_DEG,
        height_m=0.025,
        hints=(
            (0.0125, "its radius is half of that in the scene"),
            (-0.025, "its radius is twice that in the scene"),
            (-0.015, "its axis is not body z"),
        ),
    ),
)
_rest_check(
    "rest-convex",
    _Resting(what="convex solid", shape=PRISM, height_m=0.01, centre_m=PRISM_CENTRE_M),
)


# --- leaning planes --------------------------------------------------------------------------------------------------

LEAN_DEG = (3.0, 2.0, 0.0)
LEANING = Pose.from_euler_deg((0.2, -0.1, 1.0), LEAN_DEG)
STEEP = Pose.from_euler_deg((0.2, -0.1, 1.0), (-25.0, 20.0, 0.0))
SLIDE_FRICTION = 0.2
ROLL_S = 0.6


def _sine(plane: Pose) -> float:
    """Return the sine of the angle by which a plane leans."""
    return math.sin(Slope.of(plane).angle_rad)


def _down_acceleration(
    lab: Lab, shape: Shape, height_m: float, plane: Pose, friction: float
) -> float:
    """Return the acceleration downhill of a body on a leaning plane [m/s^2]; a cylinder lies across the slope."""
    downhill, across, normal = Slope.of(plane).axes
    start = np.asarray(plane.position_m) + height_m * normal
    frame = Rotation.from_matrix(np.column_stack([downhill, normal, -across]))
    pose = Pose.from_rotation(vector(start), frame)
    scene = Scene(
        bodies=(
            body("roller", shape, pose),
            replace(ground(), name="plane", pose=plane),
        ),
        contacts=(contact("roller", "plane", friction=friction),),
        duration_s=ROLL_S,
    )
    rollout = lab.rollout(scene)
    return acceleration_downhill_m_per_s2(rollout, "roller", "plane", start_s=0.1)


def _roll_check(id: str, shape: Shape, radius_m: float, share: float) -> None:
    """Register the check of a body that rolls down a leaning plane."""

    @Check(id)
    def measure(lab: Lab) -> Measurement:
        measured, sine = (
            _down_acceleration(lab, shape, radius_m, LEANING, 0.5),
            _sine(LEANING),
        )
        return Measurement(
            measured=measured,
            expected=share * G * sine,
            hint=_roll_hint(measured, share, sine),
        )


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


_roll_check("roll-ball", Sphere(radius_m=0.03), 0.03, 5.0 / 7.0)
_roll_check("roll-cylinder", Cylinder(radius_m=0.03, length_m=0.06), 0.03, 2.0 / 3.0)


@Check("slide-plane")
def _slide_plane(lab: Lab) -> Measurement:
    brick = Box(size_m=(0.06, 0.03, 0.05))
    measured, sine = (
        _down_acceleration(lab, brick, 0.015, STEEP, SLIDE_FRICTION),
        _sine(STEEP),
    )
    expected = G * (sine - SLIDE_FRICTION * float(np.sqrt(1.0 - sine**2)))
    return Measurement(
        measured=measured, expected=expected, hint=_slide_hint(measured, sine)
    )


def _slide_hint(measured: float, sine: float) -> str:
    if abs(measured) < 0.02 * G * sine:
        return "it does not slide: the leaning plane is level in the engine, or friction holds the brick"
    friction = slide_friction(measured, math.asin(sine), gravity_m_per_s2=G)
    if friction < -0.02:
        return "it slides faster than without friction: the plane leans otherwise in the engine"
    return f"it slides as if the friction were {friction:.3g} instead of {SLIDE_FRICTION:.3g}"
