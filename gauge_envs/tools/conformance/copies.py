"""Copies of a small scene that all move alike: turned, mirrored and listed in reverse, and twice as large.

Laws of mechanics prefer no direction, no handedness, no name and no order. Without gravity they have no scale either:
with all lengths times l and masses times m, a scene moves l times as far in the same time. So each
copy moves as the others, whatever the engine's model of contact is.

A copy is placed by x' = l M x + c, M a rotation or a reflection. A reflection turns the orientation R of a body into
M R D, D = diag(1, 1, -1), which fits bodies that are symmetric about the x-y plane of their frame. Axes of rotation
become det(M) M a.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.scene import (
    Box,
    Contact,
    ConvexUnion,
    Hinge,
    Pose,
    RigidBody,
    Scene,
    Shape,
    Sphere,
    Tether,
)
from gauge_envs.scene.drivers import Driver, DriverMotion
from gauge_envs.scene.geometry import FloatArray, vector
from gauge_envs.tools.bench.parts import (
    ball,
    body,
    box,
    contact,
    corners,
    driven_box,
    fixed_box,
    ramp,
)
from gauge_envs.tools.bench.recording import Recording
from gauge_envs.tools.conformance.lab import Lab
from gauge_envs.tools.conformance.model import Measurement, recorded
from gauge_envs.tools.conformance.rich import thrown

FLIPPED = np.diag([1.0, 1.0, -1.0])
"""Reflection in the frame of a body to which all shapes of the scene are symmetric."""


@dataclass(frozen=True)
class _Copy:
    """A copy of the scene.

    Attributes:
        matrix: Rotation or reflection M, shape [3, 3].
        centre_m: Its place c [m], shape [3].
        is_reversed: Whether bodies are listed in reverse, pairs with the other body first, hinges with the opposite
            axis, and quaternions with the opposite sign.
        length_factor: Factor l of all lengths.
        mass_factor: Factor m of all masses.
    """

    matrix: FloatArray
    centre_m: FloatArray
    is_reversed: bool = False
    length_factor: float = 1.0
    mass_factor: float = 1.0

    @property
    def handedness(self) -> float:
        """Determinant of the matrix, 1 or -1."""
        return float(np.linalg.det(self.matrix))

    @property
    def inner(self) -> FloatArray:
        """Map of a body's frame, shape [3, 3]."""
        return np.eye(3) if self.handedness > 0.0 else FLIPPED

    def place(self, point_m: Any) -> FloatArray:
        """Return the place of a point [m]."""
        return np.asarray(self.length_factor * self.matrix @ point_m + self.centre_m)

    def axis(self, axis: Any) -> FloatArray:
        """Return the direction of an axis of rotation, or an angular velocity."""
        return np.asarray(self.handedness * self.matrix @ axis)

    def rotations(self, rotations: Rotation) -> Rotation:
        """Return orientations of bodies."""
        return Rotation.from_matrix(self.matrix @ rotations.as_matrix() @ self.inner)


LEANING = Rotation.from_euler("xyz", [140.0, 30.0, -70.0], degrees=True).as_matrix()
MIRROR_NORMAL = np.array([0.48, -0.6, 0.64])
MIRROR = np.eye(3) - 2.0 * np.outer(MIRROR_NORMAL, MIRROR_NORMAL)
COPIES = {
    "upright": _Copy(np.eye(3), np.array([-1.0, -1.0, 1.0])),
    "turned": _Copy(LEANING, np.array([1.0, -1.0, 1.0])),
    "mirrored": _Copy(MIRROR, np.array([1.0, 1.0, 1.0]), is_reversed=True),
    "large": _Copy(
        np.eye(3), np.array([-1.0, 1.0, 1.0]), length_factor=2.0, mass_factor=8.0
    ),
}
CAUSES = {
    "turned": "a frame or an axis",
    "mirrored": "an axis, a sign, or the order of bodies and pairs",
    "large": "a length, a mass, a limit of force, torque or speed, or what is last",
    "upright": "what is listed first",
}
"""What sets a copy apart from the others."""

PARTS = {
    "brick": "contact with a fixed body",
    "ball": "contact with a driven body",
    "bar": "hinge",
    "bob": "string",
}
"""What acts on each dynamic body."""

BRICK_M = (0.12, 0.08, 0.05)
AXIS, ANCHOR_M = np.array([0.36, 0.48, 0.8]), np.array([0.0, 0.5, 0.1])
STRING_M, STRING_END_M = 0.25, np.array([0.5, 0.0, 0.3])
SECONDS = 0.5


def _bodies() -> list[RigidBody]:
    """Return the bodies of the scene before they are copied."""
    slab = fixed_box("slab", (0.0, 0.0, -0.05), (0.6, 0.5, 0.1))
    # It meets the slab with one corner, under its centre, and rebounds before another one comes down.
    on_corner, _ = Rotation.align_vectors([[0.0, 0.0, -1.0]], [BRICK_M])
    start = Pose.from_rotation((-0.1, 0.05, 0.25), on_corner)
    brick = thrown(
        body("brick", Box(size_m=BRICK_M), start), (0.7, -0.4, -1.5), (0.6, -1.0, 0.5)
    )
    paddle = driven_box(
        "paddle", (-0.5, 0.1, 0.2), (0.2, 0.16, 0.04), euler_deg=(15.0, 10.0, 0.0)
    )
    struck = ball("ball", (-0.48, 0.12, 0.34), radius_m=0.04)
    struck = thrown(struck, np.zeros(3), (6.0, 4.0, -3.0))
    bar = box(
        "bar",
        (0.1, 0.5, 0.1),
        (0.3, 0.04, 0.03),
        euler_deg=(20.0, 0.0, 30.0),
        mass_kg=0.1,
    )
    arm_m = np.array(bar.pose.position_m) - ANCHOR_M
    bar = thrown(bar, np.cross(3.0 * AXIS, arm_m), 3.0 * AXIS)
    # Its centre of mass is 40 mm from its origin, at which the string ends.
    beam = ConvexUnion(pieces_m=(corners((0.0, -0.02, -0.015), (0.08, 0.02, 0.015)),))
    along = np.array([0.6, 0.0, -0.8])
    end = Pose(position_m=vector(STRING_END_M + STRING_M * along))
    bob = thrown(body("bob", beam, end), (0.8, 0.5, 0.6), (1.0, -4.0, 2.0))
    return [slab, brick, paddle, struck, bar, bob]


def _scaled(shape: Any, copy: _Copy) -> Shape:
    """Return the shape of a body of a copy."""
    if isinstance(shape, Box):
        return Box(size_m=vector(copy.length_factor * np.array(shape.size_m)))
    if isinstance(shape, Sphere):
        return Sphere(radius_m=copy.length_factor * shape.radius_m)
    (piece,) = shape.pieces_m
    inner = copy.length_factor * copy.inner
    return ConvexUnion(pieces_m=(tuple(vector(inner @ at) for at in piece),))


def _copied(one: RigidBody, name: str, copy: _Copy) -> RigidBody:
    """Return a body of a copy."""
    turn = copy.rotations(one.pose.rotation)
    pose = Pose.from_rotation(vector(copy.place(one.pose.position_m)), turn)
    if copy.is_reversed:
        w, x, y, z = pose.quaternion
        pose = replace(pose, quaternion=(-w, -x, -y, -z))
    return replace(
        one,
        name=f"{name} {one.name}",
        shape=_scaled(one.shape, copy),
        pose=pose,
        mass_kg=copy.mass_factor * one.mass_kg,
        linear_velocity_m_per_s=vector(
            copy.length_factor * copy.matrix @ one.linear_velocity_m_per_s
        ),
        angular_velocity_rad_per_s=vector(copy.axis(one.angular_velocity_rad_per_s)),
    )


def _hinge(name: str, copy: _Copy) -> Hinge:
    """Return the hinge of the bar."""
    sign = -1.0 if copy.is_reversed else 1.0
    return Hinge(
        body=f"{name} bar",
        anchor_m=vector(copy.place(ANCHOR_M)),
        axis=vector(sign * copy.axis(AXIS)),
    )


def _driver(name: str, copy: _Copy) -> Driver:
    """Return the motion of the paddle, which turns and rises against the ball."""
    turn = DriverMotion(
        kind="rotate",
        axis=vector(copy.axis([0.0, 0.6, 0.8])),
        point_m=vector(copy.place([-0.5, 0.2, 0.2])),
        profiles=(ramp(0.6, start_s=0.0, duration_s=0.4, ramp_s=0.1),),
    )
    rise = DriverMotion(
        kind="translate",
        axis=vector(copy.matrix @ [0.0, 0.28, 0.96]),
        profiles=(
            ramp(0.25 * copy.length_factor, start_s=0.0, duration_s=0.3, ramp_s=0.1),
        ),
    )
    return Driver(body=f"{name} paddle", motions=(turn, rise), provenance="nominal")


def _scene(with_string: bool = True) -> Scene:
    bodies: list[RigidBody] = []
    contacts: list[Contact] = []
    hinges: list[Hinge | Tether] = []
    drivers = []
    for name, copy in COPIES.items():
        order = -1 if copy.is_reversed else 1
        bodies += [_copied(one, name, copy) for one in _bodies()[::order]]
        pairs = [("brick", "slab"), ("ball", "paddle")]
        for first, second in pairs[::order]:
            pair = (f"{name} {first}", f"{name} {second}")[::order]
            contacts.append(contact(*pair, friction=0.15, restitution=0.5))
        tether = Tether(
            body=f"{name} bob",
            anchor_m=vector(copy.place(STRING_END_M)),
            length_m=copy.length_factor * STRING_M,
        )
        joints: list[Hinge | Tether] = [_hinge(name, copy), tether]
        hinges += joints[::order]
        drivers.append(_driver(name, copy))
    if not with_string:
        bodies = [one for one in bodies if not one.name.endswith("bob")]
        hinges = [one for one in hinges if isinstance(one, Hinge)]
    return Scene(
        bodies=tuple(bodies),
        contacts=tuple(contacts),
        joints=tuple(hinges),
        drivers=tuple(drivers),
        duration_s=SECONDS,
        gravity_m_per_s2=0.0,
    )


def _moved(
    rollout: Recording, name: str, copy: _Copy, part: str
) -> tuple[FloatArray, FloatArray]:
    """Return displacements [m] and steps of rotation [rad] of a body as in the upright copy.

    Shapes are [T, 3] and [T - 1, 3].
    """
    one = f"{name} {part}"
    displacement = rollout.displacement(one) @ copy.matrix / copy.length_factor
    rotations = rollout.rotation(one)
    steps = (rotations[1:] * rotations[:-1].inv()).as_rotvec()
    return displacement, copy.handedness * steps @ copy.matrix


@recorded(
    "four copies of one scene: upright, turned, mirrored and listed in reverse, twice as large and eight times as "
    "heavy: a brick that hits a slab, a ball that a driven paddle hits, a bar that turns on a leaning hinge, a beam "
    "that whirls on a string; no gravity"
)
def _copies(lab: Lab) -> Recording:
    # Some engines start strings at rest: they build the scene without.
    return lab.rollout(lab.first_supported(_scene(), _scene(with_string=False)))


@_copies.check("copies-alike")
def _copies_alike(rollout: Recording) -> Measurement:
    errors, details = {}, {}
    parts = [part for part in PARTS if f"upright {part}" in rollout.states]
    for part in parts:
        moved = {
            name: _moved(rollout, name, copy, part) for name, copy in COPIES.items()
        }
        places = np.array([one for one, _ in moved.values()])
        turns = np.cumsum([one for _, one in moved.values()], axis=1)
        middle_place, middle_turn = np.median(places, axis=0), np.median(turns, axis=0)
        path_m = np.linalg.norm(middle_place, axis=1).max()
        angle_rad = np.linalg.norm(middle_turn, axis=1).max()
        for name, place, turn in zip(COPIES, places, turns, strict=True):
            off_m = np.linalg.norm(place - middle_place, axis=1)
            off_rad = np.linalg.norm(turn - middle_turn, axis=1)
            place_percent = 100.0 * float(off_m.max() / path_m)
            turn_percent = 100.0 * float(off_rad.max() / angle_rad)
            errors[name, part] = max(place_percent, turn_percent)
            begins_s = rollout.times_s[int((off_m > 0.1 * off_m.max()).argmax())]
            details[name, part] = (
                f"place by {place_percent:.3g} %, rotation by {turn_percent:.3g} %, from {begins_s:.2f} s on"
            )
    worst = max(errors, key=lambda one: np.nan_to_num(errors[one], nan=np.inf))
    name, part = worst
    right = [one for one in parts if errors[name, one] < 0.1 * errors[worst]]
    hint = f"the {name} copy of the {part} is off the others ({details[worst]}): {CAUSES[name]}, of the {PARTS[part]}"
    if right:
        hint += f"; right in this copy: {', '.join(right)}"
    return Measurement(measured=errors[worst], hint=hint)
