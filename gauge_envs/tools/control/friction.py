"""Base of the turntable and the slope task: a cube that only friction holds on a body that turns."""

import math
from dataclasses import replace
from operator import add, sub
from typing import ClassVar

import numpy as np

from gauge_envs.scene import Scene
from gauge_envs.scene.geometry import (
    FloatArray,
    Pose,
    length_of,
    rotation_matrices,
    unit_quaternions,
)
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLE_INTERVAL_S
from gauge_envs.tools.control.env import ControlEnv
from gauge_envs.tools.control.limit import Ending, Limit

CUBE = "cube"

HOLD_S = 1.0
"""Time over which the friction used is averaged for the value that a policy reaches [s]."""

HOLD_FRAMES = round(HOLD_S * FRAME_RATE_HZ)
"""`HOLD_S` in frames."""

USED_OVER_FRICTION = 10.0
"""Bound on the friction used over the friction, or over 1 if that is larger, in the observation."""

SLIP_SPEED_M_PER_S = 0.02
"""Speed on the carrier from which the cube counts as slipping [m/s]: that of its fastest corner, mean over a frame.

The value lies between the creep of a cube that holds and the slip of one that does not. A carried cube creeps because
contacts are not rigid. On the turntable at mu g the speed is half the contact's time constant times mu g: 3.7 mm/s in
MuJoCo with this package's preset, 9.3 mm/s in Newton. A cube that uses 2 % too much friction reaches 20 mm/s after
0.3 s. Slower slips do not count. Where the mean over a frame is 20 mm/s, the speed at its end is up to 30 mm/s, if the
actuator raises the friction used as fast as it can. So a policy can use 30 mm/s / (g HOLD_S) = 0.003 more friction than
the law allows, 0.8 to 1.2 % of it.
"""


class _Turned:
    """A vector that turns about an axis. In numbers of Python, which for three of them are faster than arrays."""

    def __init__(self, axis: FloatArray, start: FloatArray) -> None:
        along = axis * (axis @ start)
        across, aside = start - along, np.cross(axis, start)
        self._parts = list(
            zip(along.tolist(), across.tolist(), aside.tolist(), strict=True)
        )

    def at(self, angle_rad: float) -> list[float]:
        """Return the vector at an angle, three numbers."""
        cosine, sine = math.cos(angle_rad), math.sin(angle_rad)
        return [
            along + cosine * across + sine * aside
            for along, across, aside in self._parts
        ]

    def rate(self, angle_rad: float) -> list[float]:
        """Return its derivative by the angle, three numbers."""
        cosine, sine = math.cos(angle_rad), math.sin(angle_rad)
        return [cosine * aside - sine * across for _, across, aside in self._parts]


class FrictionLimit(ControlEnv):
    """Use as much of the friction of a cube on a driven body as the law allows.

    **Law.** The force that carries the cube, over its mass, is f = a - g, where a is the acceleration of the carrier at
    the cube. Normal and tangential to the face under the cube, f has the parts f_n and f_t. Friction holds while the
    *friction used*, f_t / f_n, is at most mu.

    **Reward.** The friction used, mean over the frame. A slip ends the episode and takes back the rewards of the last
    `HOLD_S`. While the cube slips, it accelerates on its carrier along f_t by at least (used - mu) f_n. With v_s the
    speed from which a slip counts, the impulse over any time T without a slip gives

        integral of used dt <= mu T + v_s / f_n,

    also if a policy crosses the limit repeatedly. So no policy earns more than mu for each step, apart from one v_s,
    and a policy that always uses mu earns mu for each step. The optimum of the reward is the law's limit, reached as
    soon as the actuator allows and held to the end.

    **Reached** is the largest mean of the friction used over `HOLD_S` without slip: at most mu + v_s / (g HOLD_S).

    This holds for a force of one direction on the carrier, as on the slope. On the turntable it can turn: a plate that
    accelerates to and fro uses sqrt(mu^2 + (alpha r / g)^2) on average where friction holds the mean force, 1.0 to
    1.4 % more. A slip outward is also carried by the Coriolis force, 0.3 % at 20 mm/s.

    **Action.** Angular acceleration of the carrier, in units of `ACCELERATION_RAD_PER_S2`.

    Args:
        material: Material of the cube: `wood`, `plastic` or `metal`.
        **options: Keywords of `ControlEnv`: `backend`, `parameters`, `settings`, `render_mode`, `width`, `height`.

    Attributes:
        ACCELERATION_RAD_PER_S2: Angular acceleration that an action of 1 commands.
    """

    ACCELERATION_RAD_PER_S2: ClassVar[float]
    COMMANDED: ClassVar[tuple[str, ...]] = ("angular_acceleration",)
    OBSERVED: ClassVar[tuple[str, ...]] = (
        "angle_rad",
        "rate_rad_per_s",
        "friction_used",
        "slip_over_threshold",
        "time_s",
    )
    _at_time_limit = Ending.HELD
    _pose: Pose
    _velocity: list[float]
    _corners_on_carrier: FloatArray

    def _scene(self, stated: Scene) -> Scene:
        """Return the scene, in which the carrier turns about the axis of the experiment by actions alone."""
        driver = stated.drivers[0]
        fastest = self.ACCELERATION_RAD_PER_S2 * self.duration_s
        motion = replace(driver.motions[0], profiles=(), residual_rate=fastest)
        return replace(
            stated, drivers=(replace(driver, motions=(motion,), provenance="action"),)
        )

    def _prepare(self, scene: Scene) -> None:
        driver = scene.drivers[0]
        motion = driver.motions[0]
        self._start = scene.body(driver.body).pose
        self._carrier = driver.body
        self._axis = np.asarray(motion.axis)
        self._axis_parts = [*motion.axis]
        self._point_parts_m = motion.point_m
        self._point_m = np.asarray(motion.point_m)
        self._place = _Turned(
            self._axis, np.asarray(self._start.position_m) - self._point_m
        )
        self._normal = _Turned(self._axis, self._start.matrix[:, 2])
        quaternion = np.array(self._start.quaternion)
        # After half a turn: the product of the quaternion (0, axis) and that of the start.
        real, imaginary = quaternion[0], quaternion[1:]
        half_turned = np.array(
            [
                -self._axis @ imaginary,
                *(real * self._axis + np.cross(self._axis, imaginary)),
            ]
        )
        self._quaternions = list(
            zip(quaternion.tolist(), half_turned.tolist(), strict=True)
        )
        self._corners_m = scene.body(CUBE).shape.corners_m

    def _limit(self) -> Limit:
        return self._friction_limit(
            (CUBE, self.experiment.scene.drivers[0].body), "friction used"
        )

    # --- physics ---

    def _drive(self, command: FloatArray) -> None:
        """Turn the carrier with a uniform acceleration."""
        step, before = SAMPLE_INTERVAL_S, self._angle
        self._acceleration = float(command[0]) * self.ACCELERATION_RAD_PER_S2
        self._angle += (self._rate + 0.5 * self._acceleration * step) * step
        self._rate += self._acceleration * step
        pose = self._carrier_pose()
        # A uniform acceleration that ends exactly at the pose. Numbers of Python are faster than arrays of so few.
        moved = list(map(sub, pose.position_m, self._pose.position_m))
        moved += [(self._angle - before) * along for along in self._axis_parts]
        acceleration = [
            2.0 / step * (change / step - speed)
            for change, speed in zip(moved, self._velocity, strict=True)
        ]
        self.world.drive(
            self._carrier,
            self._pose,
            np.array(self._velocity),
            np.array(acceleration),
        )
        self._pose = pose
        arm_rates = self._place.rate(self._angle)
        self._velocity = [self._rate * one for one in arm_rates + self._axis_parts]

    def _carrier_pose(self) -> Pose:
        """Return the pose of the carrier at its angle."""
        cosine, sine = math.cos(0.5 * self._angle), math.sin(0.5 * self._angle)
        w, x, y, z = (
            cosine * start + sine * half_turned
            for start, half_turned in self._quaternions
        )
        x_m, y_m, z_m = map(add, self._point_parts_m, self._place.at(self._angle))
        return Pose(position_m=(x_m, y_m, z_m), quaternion=(w, x, y, z))

    def _friction_used(self) -> float:
        """Return the friction used: tangential over normal part of the force that carries the cube."""
        arm_m = (self.world.body_states((CUBE,))[0, :3] - self._point_m).tolist()
        around_m = _cross(self._axis_parts, arm_m)
        inward_m = _cross(self._axis_parts, around_m)
        # In m/s^2, as of a unit of mass: the acceleration of the carrier minus that of gravity.
        force = [
            self._acceleration * along + self._rate**2 * inward
            for along, inward in zip(around_m, inward_m, strict=True)
        ]
        force[2] += self.experiment.scene.gravity_m_per_s2
        normal = _dot(force, self._normal.at(self._angle))
        return math.sqrt(max(_dot(force, force) - normal**2, 0.0)) / normal

    def _corners(self) -> FloatArray:
        """Return the corners of the cube in the frame of the carrier [m], shape [8, 3]."""
        state = self.world.body_states((CUBE,))[0]
        turn = rotation_matrices(unit_quaternions(state[3:7]))
        return self._pose.to_body(self._corners_m @ turn.T + state[:3])

    def _slip(self) -> float:
        """Return the mean speed of the cube's fastest corner on the carrier over the last frame [m/s]."""
        corners = self._corners()
        displacement_m = np.linalg.norm(
            corners - self._corners_on_carrier, axis=1
        ).max()
        self._corners_on_carrier = corners
        return float(displacement_m) * FRAME_RATE_HZ

    @property
    def _cube_radius_m(self) -> float:
        """Distance of the cube from the axis [m]."""
        arm = self.world.body_states((CUBE,))[0, :3] - self._point_m
        return length_of(arm - self._axis * (self._axis @ arm))

    # --- task ---

    def _begin(self) -> None:
        self._angle = self._rate = 0.0
        self._pose = self._start
        self._velocity = [0.0] * 6
        self._used: list[float] = []
        self._used_in_frame: list[float] = []
        self._used_now = 0.0
        self._slip_m_per_s = 0.0
        self._corners_on_carrier = self._corners()

    def _look(self) -> None:
        self._used_in_frame.append(self._friction_used())

    def _frame_ending(self) -> Ending | None:
        self._used_now = sum(self._used_in_frame) / len(self._used_in_frame)
        self._used_in_frame = []
        self._slip_m_per_s = self._slip()
        # A comparison with NaN is false.
        return None if self._slip_m_per_s < SLIP_SPEED_M_PER_S else Ending.SLIPPED

    def _observation(self) -> FloatArray:
        slip = self._slip_m_per_s / SLIP_SPEED_M_PER_S
        return np.array([self._angle, self._rate, self._used_now, slip, self.time_s])

    def _largest_observation(self) -> list[float]:
        # A cube that slips ends the episode, so no more than some times the friction is used.
        scene, duration_s = self.experiment.scene, self.duration_s
        rate = self.ACCELERATION_RAD_PER_S2 * duration_s
        driven = scene.drivers[0].speed_limit_m_per_s(scene.body(self._carrier))
        slip_m_per_s = scene.speed_limit_m_per_s + driven
        return [
            0.5 * rate * duration_s,
            rate,
            USED_OVER_FRICTION * max(self.limit.value, 1.0),
            slip_m_per_s / SLIP_SPEED_M_PER_S,
            duration_s,
        ]

    # --- reward ---

    def _reward(self, ending: Ending | None) -> float:
        if ending is Ending.SLIPPED:
            return -sum(self._used[-HOLD_FRAMES:])
        self._used.append(self._used_now)
        return self._used_now

    def _reached(self) -> float:
        if len(self._used) < HOLD_FRAMES:
            return 0.0
        return float(
            np.convolve(
                self._used, np.ones(HOLD_FRAMES) / HOLD_FRAMES, mode="valid"
            ).max()
        )


def _cross(one: list[float], other: list[float]) -> list[float]:
    return [
        one[1] * other[2] - one[2] * other[1],
        one[2] * other[0] - one[0] * other[2],
        one[0] * other[1] - one[1] * other[0],
    ]


def _dot(one: list[float], other: list[float]) -> float:
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]
