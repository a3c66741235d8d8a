"""Random start poses and velocities of a scene, like the scatter of manual set-ups of real trials."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gauge_envs.errors import ParameterError
from gauge_envs.scene.bodies import (
    Cloth,
    Hinge,
    Markers,
    RigidBody,
    Tether,
)
from gauge_envs.scene.contact_faces import (
    TouchingGroup,
    blocked_directions,
    face_normal,
)
from gauge_envs.scene.geometry import (
    FloatArray,
    Pose,
    Sphere,
    Vector,
    quaternion_products,
    rotation_matrices,
    unit_quaternions,
    vector,
    vector_quaternion,
)
from gauge_envs.scene.scene import Scene

JITTER_FORMAT = 3
"""Number of this way to draw a start; another way gets another number, so that a sweep runs its repeats again."""


@dataclass(frozen=True, kw_only=True)
class Jitter:
    """Standard deviations of start poses and velocities.

    Attributes:
        position_m: Standard deviation of each coordinate of a position [m]. The heights of 22 real drops of a ball
            scatter by 1.0 mm. Cubes at rest on a slope of 10 degrees, whose scatter is that of their start, lie 0.6 to
            1.9 mm from their mean (paper, Table 5).
        angle_rad: Standard deviation of a rotation [rad]. It has not been measured; 0.5 degrees is 0.2 mm at the edge
            of a cube of 50 mm.
        velocity_m_per_s: Standard deviation of each coordinate of a linear velocity [m/s].
        angular_velocity_rad_per_s: Standard deviation of each coordinate of an angular velocity [rad/s].

    Raises:
        ParameterError: A value is negative or not a number.
    """

    position_m: float = 1.0e-3
    angle_rad: float = math.radians(0.5)
    velocity_m_per_s: float = 0.0
    angular_velocity_rad_per_s: float = 0.0

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            if not (is_number and math.isfinite(value) and value >= 0.0):
                raise ParameterError(
                    f"jitter {name} is {value!r}: give a finite number of 0 or more"
                )

    def to_dict(self) -> dict[str, float]:
        """Return the standard deviations for a result, without those of velocities that are zero."""
        return {
            name: value
            for name, value in asdict(self).items()
            if value or name in ("position_m", "angle_rad")
        }


def jittered(scene: Scene, jitter: Jitter, *, seed: int) -> Scene:
    """Return the scene with random start poses and velocities that keep the contacts of the start.

    - A dynamic body translates in the plane of the face at which it touches another one, and rotates about the normal
      of that face. Where it touches none, the normal is the body axis that is closest to vertical. Where it touches
      faces of several directions, it translates along all of them, and does not rotate.
    - Bodies that touch one another, as the bricks of a wall, move as one.
    - A ball translates in all three coordinates.
    - A hinged body rotates about its hinge. A tethered body swings with a tight string.
    - A cloth without attachments translates and rotates in its plane, with markers if it alone has any.

    Random velocities are added to those of the scene, in the same directions: in the plane of the face and about its
    normal, about a hinge, or about the anchor of a string. The velocity of a hinged or a tethered body rotates with its
    pose. Poses do not depend on the standard deviations of velocities.

    Fixed and driven bodies and the bodies attached to them do not move: their start poses belong to the set-up.

    Args:
        scene: The scene.
        jitter: Standard deviations of the start.
        seed: Seed of the random numbers, 0 or more.
    """
    random = np.random.default_rng(seed)
    attached = {attachment.deformable for attachment in scene.attachments}
    is_pushed = jitter.velocity_m_per_s or jitter.angular_velocity_rad_per_s
    pushes = np.random.default_rng((seed, 1)) if is_pushed else None
    groups = _Groups(scene, jitter, random, pushes)
    is_moved = bool(scene.free)
    bodies = [groups.started(one) for one in scene.bodies]
    deformables: list[Any] = []
    markers = scene.markers
    for deformable in scene.deformables:
        if isinstance(deformable, Cloth) and deformable.name not in attached:
            is_moved = True
            pose = deformable.pose
            move = _drawn(pose.position_m, face_normal(pose)[None], jitter, random)
            deformable = replace(deformable, pose=move(pose))
            if markers is not None and markers.bodies == (deformable.name,):
                markers = _carried(markers, move.place)
        deformables.append(deformable)
    if not is_moved:
        raise ParameterError(
            "nothing to jitter: every body of this scene is fixed, driven, or attached to one that is"
        )
    return scene.started(
        bodies=tuple(bodies),
        deformables=tuple(deformables),
        markers=markers,
    )


def scattered(scene: Scene, jitter: Jitter, *, seed: int) -> Scene:
    """Return the scene as `jittered` does; where nothing starts free, with driven bodies that are misplaced at random.

    So a person fixes a cloth or a foam in a clamp.
    """
    try:
        return jittered(scene, jitter, seed=seed)
    except ParameterError:
        if not scene.drivers:
            raise
    random = np.random.default_rng(seed)
    drawn = {one.body: random.standard_normal(6) for one in scene.drivers}
    return misplaced(scene, jitter, drawn)


def misplaced(scene: Scene, jitter: Jitter, drawn: Mapping[str, FloatArray]) -> Scene:
    """Return the scene with driven bodies that are not at their places, during the whole motion.

    The place of the only body that a cloth or a foam touches is that of the whole scene: then all of it leans.

    Args:
        scene: The scene.
        jitter: Standard deviations of places and angles.
        drawn: Displacement along the world's axes and rotation about them, by the name of the body, over these standard
            deviations, shape [6].
    """
    touched = {name for one in scene.contacts for name in (*one.first, *one.second)}
    touched -= {one.name for one in scene.deformables}
    if len({*scene.holders, *touched}) == 1:
        (driver,) = scene.drivers
        turn_rad = jitter.angle_rad * drawn[driver.body][3:]
        if not turn_rad.any():
            return scene
        leaning = tilted(scene, turn_rad, scene.body(driver.body).pose.position_m)
        vars(leaning)["stated"] = scene.stated or scene
        return leaning
    drivers = []
    for driver in scene.drivers:
        shift_m = jitter.position_m * drawn[driver.body][:3]
        turn_rad = jitter.angle_rad * drawn[driver.body][3:]
        drivers.append(
            replace(driver, shift_m=vector(shift_m), turn_rad=vector(turn_rad))
        )
    return replace(scene, drivers=tuple(drivers))


@dataclass(frozen=True)
class _Move:
    """A rotation about a point, and a translation.

    Attributes:
        turn: Unit quaternion w, x, y, z of the rotation, shape [4].
        point_m: The point [m], shape [3].
        shift_m: The translation [m], shape [3].
    """

    turn: FloatArray
    point_m: FloatArray
    shift_m: FloatArray | float = 0.0

    def place(self, point_m: ArrayLike) -> Vector:
        """Return a point after the move [m]."""
        arm_m = rotation_matrices(self.turn) @ (np.asarray(point_m) - self.point_m)
        return vector(arm_m + self.point_m + self.shift_m)

    def __call__(self, pose: Pose) -> Pose:
        position_m = self.place(pose.position_m)
        now = unit_quaternions(np.array(pose.quaternion))
        w, x, y, z = unit_quaternions(quaternion_products(self.turn, now)).tolist()
        return Pose(position_m=position_m, quaternion=(w, x, y, z))


def _drawn(
    point_m: Any,
    blocked: FloatArray,
    jitter: Jitter,
    random: np.random.Generator,
    *,
    is_ball: bool = False,
) -> _Move:
    """Return a random move about a point that keeps the contacts with faces of given normals; a ball has none."""
    shift = jitter.position_m * random.standard_normal(3)
    angle_rad = jitter.angle_rad * random.standard_normal()
    if not is_ball:
        shift = _along(shift, blocked)
    turn = angle_rad * blocked[0] if len(blocked) == 1 else np.zeros(3)
    return _Move(_turn(turn), np.asarray(point_m), shift)


def _carried(markers: Markers, place: Callable[[ArrayLike], Vector]) -> Markers:
    """Return markers that have moved."""
    return replace(markers, positions_m=tuple(map(place, markers.positions_m)))


def _along(vector_3: FloatArray, blocked: FloatArray) -> FloatArray:
    """Return the part of a vector that is across no blocked direction."""
    for direction in blocked:
        vector_3 = vector_3 - (vector_3 @ direction) * direction
    return vector_3


class _Groups:
    """The bodies that can start elsewhere; those that touch one another have one move and one push.

    Args:
        scene: The scene.
        jitter: Standard deviations of the start.
        random: Random numbers of the places.
        pushes: Random numbers of the velocities; None keeps those of the scene.
    """

    def __init__(
        self,
        scene: Scene,
        jitter: Jitter,
        random: np.random.Generator,
        pushes: np.random.Generator | None,
    ) -> None:
        self._scene = scene
        self._jitter = jitter
        self._random = random
        self._random_push = pushes
        self._joints = {joint.body: joint for joint in scene.joints}
        self._moves: dict[TouchingGroup, _Move] = {}
        self._pushes: dict[TouchingGroup, FloatArray] = {}

    def started(self, body: RigidBody) -> RigidBody:
        """Return a body at its random start; one that cannot start elsewhere as it is."""
        if body.name not in self._scene.free:
            return body
        jitter, joint = self._jitter, self._joints.get(body.name)
        random = self._random_push
        if joint is None:
            body = self._moved(body)
            return body if random is None else self._pushed(body, random)
        if isinstance(joint, Hinge):
            angles_rad = jitter.angle_rad * self._random.standard_normal(1) * joint.axis
        else:
            angles_rad = jitter.angle_rad * self._random.standard_normal(3)
        body = swung(body, _turn(angles_rad), np.asarray(joint.anchor_m))
        return body if random is None else _swinging(body, joint, jitter, random)

    def _moved(self, body: RigidBody) -> RigidBody:
        group = self._scene.touching_groups[body.name]
        if group not in self._moves:
            self._moves[group] = _drawn(
                group.centre_m,
                group.blocked,
                self._jitter,
                self._random,
                is_ball=isinstance(body.shape, Sphere),
            )
        return replace(body, pose=self._moves[group](body.pose))

    def _pushed(self, body: RigidBody, random: np.random.Generator) -> RigidBody:
        """Return a body that has moved, with a random velocity in addition to its own."""
        group = self._scene.touching_groups[body.name]
        if group not in self._pushes:
            self._pushes[group] = random.standard_normal((2, 3))
        linear = self._jitter.velocity_m_per_s * self._pushes[group][0]
        angular = self._jitter.angular_velocity_rad_per_s * self._pushes[group][1]
        if not isinstance(body.shape, Sphere):
            normals = self._scene.contact_faces.normals(group.members)
            blocked = blocked_directions(body.pose, normals)
            linear = _along(linear, blocked)
            angular = (
                (angular @ blocked[0]) * blocked[0]
                if len(blocked) == 1
                else np.zeros(3)
            )
        if len(group.members) > 1:
            centre_m = group.centre_m + self._moves[group].shift_m
            linear = linear + np.cross(
                angular, np.asarray(body.pose.position_m) - centre_m
            )
        return _faster(body, linear, angular)


def swung(body: RigidBody, turn: FloatArray, point_m: FloatArray) -> RigidBody:
    """Return a body whose pose and velocities are rotated about a world point, by a unit quaternion w, x, y, z."""
    pose = _Move(turn, point_m)(body.pose)
    if body.starts_at_rest:
        return replace(body, pose=pose)
    matrix = rotation_matrices(turn)
    return replace(
        body,
        pose=pose,
        linear_velocity_m_per_s=vector(matrix @ body.linear_velocity_m_per_s),
        angular_velocity_rad_per_s=vector(matrix @ body.angular_velocity_rad_per_s),
    )


def _swinging(
    body: RigidBody, joint: Hinge | Tether, jitter: Jitter, random: np.random.Generator
) -> RigidBody:
    """Return a body on a joint with a random velocity in addition to its own."""
    linear = jitter.velocity_m_per_s * random.standard_normal(3)
    angular = jitter.angular_velocity_rad_per_s * random.standard_normal(3)
    arm = np.subtract(body.pose.position_m, joint.anchor_m)
    if isinstance(joint, Hinge):
        axis = np.asarray(joint.axis)
        # A linear velocity along the circle is also a rate of rotation.
        radius_m = float(np.linalg.norm(np.cross(axis, arm)))
        along = np.cross(axis, arm) @ linear / radius_m**2 if radius_m else 0.0
        angular = (angular @ axis + along) * axis
        linear = np.cross(angular, arm)
    else:
        length = float(np.linalg.norm(arm))
        linear = linear - arm * (arm @ linear) / length**2 + np.cross(angular, arm)
    return _faster(body, linear, angular)


def _faster(body: RigidBody, linear: FloatArray, angular: FloatArray) -> RigidBody:
    """Return a body with velocities in addition to its own."""
    return replace(
        body,
        linear_velocity_m_per_s=vector(linear + body.linear_velocity_m_per_s),
        angular_velocity_rad_per_s=vector(angular + body.angular_velocity_rad_per_s),
    )


def _turn(rotation_rad: ArrayLike) -> FloatArray:
    """Return the unit quaternion w, x, y, z of a rotation vector [rad], shape [4]."""
    return vector_quaternion(np.asarray(rotation_rad).tolist())


# --- tilt ----------------------------------------------------------------------------------------------------------
# A scene that leans as a whole is the same as another direction of gravity.


def tilted(scene: Scene, rotation_rad: ArrayLike, about_m: ArrayLike) -> Scene:
    """Return a scene that is rotated as a whole about a point.

    Gravity stays vertical. In the rotated frame, the motion is that of the original scene with leaning gravity.

    Args:
        scene: The scene.
        rotation_rad: Rotation vector [rad], shape [3].
        about_m: Fixed point of the rotation [m], shape [3].
    """
    turn, centre = _turn(rotation_rad), np.asarray(about_m, dtype=np.float64)
    matrix = rotation_matrices(turn)

    def place(point_m: ArrayLike) -> Vector:
        return vector(matrix @ (np.asarray(point_m) - centre) + centre)

    def turned(part: Any) -> Any:
        """Return a joint or a motion after the rotation."""
        changes = {
            name: place(getattr(part, name))
            for name in ("anchor_m", "point_m")
            if hasattr(part, name)
        }
        if hasattr(part, "axis"):
            changes["axis"] = vector(matrix @ part.axis)
        return replace(part, **changes)

    markers = scene.markers
    return replace(
        scene,
        bodies=tuple(swung(body, turn, centre) for body in scene.bodies),
        deformables=tuple(
            replace(body, pose=_Move(turn, centre)(body.pose))
            for body in scene.deformables
        ),
        joints=tuple(map(turned, scene.joints)),
        drivers=tuple(
            replace(one, motions=tuple(map(turned, one.motions)))
            for one in scene.drivers
        ),
        markers=None if markers is None else _carried(markers, place),
    )
