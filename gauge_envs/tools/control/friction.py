"""Turn a turntable or tilt a board as far as a cube that only friction holds allows."""

import math
from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from gauge_envs.references.uncertainties import friction_std
from gauge_envs.scene import Scene
from gauge_envs.scene.geometry import (
    FloatArray,
    IntArray,
    length_of,
    rotation_matrices,
)
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLES_PER_FRAME
from gauge_envs.tools.control.stage import Stage
from gauge_envs.tools.control.task import ControlTask, Ending, Limit

CUBE = "cube"

HOLD_S = 1.0
"""Time over which the friction used is averaged for the value that a policy reaches [s]."""

HOLD_FRAMES = round(HOLD_S * FRAME_RATE_HZ)
"""`HOLD_S` in frames."""

SLIP_SPEED_M_PER_S = 0.02
"""Speed on the carrier from which the cube counts as slipping [m/s]: the mean speed of its fastest corner in a frame.

The value lies between the creep of a cube that holds and the slip of a cube that slides. A carried cube creeps because
contacts are not rigid. On the turntable at mu g the speed is half the contact's time constant times mu g: 3.7 mm/s in
MuJoCo with this package's preset, 9.3 mm/s in Newton. A cube that uses 2 % too much friction reaches 20 mm/s after
0.3 s. Slower slips do not count. If the actuator raises the friction as fast as it can, a mean of 20 mm/s in a frame
ends at up to 30 mm/s. So a policy can use 30 mm/s / (g HOLD_S) = 0.003 more friction than the law allows, 0.8 to 1.2 %
of it.
"""

TURNTABLE_APPROACH_S = 2.0 / FRAME_RATE_HZ
"""Time constant with which the law's policy approaches its speed; two steps is the shortest that is smooth."""

SLOPE_RAMP_S = 3.0
"""Time in which the law's policy tilts; its acceleration uses only 0.4 % of the friction."""


def _rotation_form() -> FloatArray:
    """Return the matrix from all products of two entries of a quaternion to its rotation matrix, shape [16, 9]."""
    units = np.eye(4)
    sums = rotation_matrices((units[:, None] + units).reshape(16, 4)).reshape(4, 4, 9)
    squares = rotation_matrices(units).reshape(4, 9)
    # A rotation matrix is a quadratic form of its quaternion; this is the polar form.
    return 0.5 * (sums - squares[:, None] - squares).reshape(16, 9)


ROTATION_FORM = _rotation_form()


class CubeLimit(ControlTask):
    """A cube on a level or tilted face, which only friction holds; the limit is the friction coefficient.

    Attributes:
        ACCELERATION: Acceleration of the driven body that an action of 1 commands [m/s^2 or rad/s^2].
    """

    ACCELERATION: ClassVar[float]
    _stage: Stage

    def _prepare(self, scene: Scene) -> tuple[float, float]:
        self._stage = Stage(scene, self.ACCELERATION, self.world_count)
        # The first contact of each scene is the contact of the cube with the face below it. The uncertainty belongs to
        # the published coefficient, also if an override replaces the coefficient.
        published = self.published_scene.contacts[0].friction
        std = friction_std(published, self._variant.material)
        return scene.contacts[0].friction, std


class FrictionLimit(CubeLimit):
    """Use as much of the friction of a cube on a driven body as the law allows.

    **Law.** The force that carries the cube, over its mass, is f = a - g. Here a is the acceleration of the carrier at
    the cube. Normal and tangential to the face under the cube, f has the parts f_n and f_t. Friction holds while the
    *friction used*, f_t / f_n, is at most mu.

    **Reward.** The friction used, mean over the frame. A slip ends the episode, and the rewards of the last
    `HOLD_S` are subtracted. While the cube slips, it accelerates on its carrier along f_t by at least (used - mu)
    f_n. With v_s the speed from which a slip counts, the impulse over any time T without a slip gives

        integral of used dt <= mu T + v_s / f_n,

    also if a policy crosses the limit repeatedly. So no policy earns more than mu for each step, apart from one v_s.
    A policy that always uses mu earns mu for each step. The optimum of the reward is the law's limit, reached as soon
    as the actuator allows and kept to the end.

    **Reached** is the largest mean of the friction used over `HOLD_S` without slip: at most mu + v_s / (g HOLD_S).

    This holds for a force of one direction on the carrier, as on the slope. On the turntable the direction can change.
    A plate that accelerates to and fro uses sqrt(mu^2 + (alpha r / g)^2) on average, 1.0 to 1.4 % more, while friction
    holds the mean force. The Coriolis force also supports a slip outward, by 0.3 % at 20 mm/s.

    **Action.** Angular acceleration of the carrier, in units of `ACCELERATION`, in rad/s^2.

    Args:
        material: Material of the cube: `wood`, `plastic` or `metal`.

    The other arguments are those of `ControlTask`.
    """

    COMMANDED = ("angular_acceleration",)
    OBSERVED = (
        "angle_rad",
        "rate_rad_per_s",
        "friction_used",
        "slip_over_threshold",
        "time_s",
    )
    TIME_LIMIT_ENDING = Ending.HELD

    def _prepare(self, scene: Scene) -> tuple[float, float]:
        (driver,) = scene.drivers
        (rotation,) = driver.motions
        self._point_m = np.array(rotation.point_m)
        self._across = rotation.cross_product
        # The two cross products with the axis, one after the other.
        self._around_and_inward = np.hstack([self._across, self._across @ self._across])
        normal = scene.body(driver.body).pose.matrix[:, 2]
        around, inward = np.split(normal @ self._around_and_inward, 2)
        # By Rodrigues' formula, the normal after a rotation by t is along + cos t inward + sin t around.
        self._normal_parts = np.array([normal + inward, -inward, around])
        corners_m = scene.body(CUBE).shape.corners_m
        self._corners_m = np.column_stack([corners_m, np.ones(len(corners_m))])
        count = self.world_count
        self._used_now = self._entry("friction_used")
        self._slip = self._entry("slip_over_threshold")
        self._angle_and_rate = self._entries("angle_rad", 2)
        self._paid = np.zeros(count)
        # The friction used in each frame, and the number of frames with one.
        self._used = np.zeros((self.experiment.frame_count, count))
        self._counts = np.zeros(count, dtype=np.intp)
        self._on_carrier = np.zeros((count, 4, 3))
        self._turned = np.ones((SAMPLES_PER_FRAME, count, 3))
        return super()._prepare(scene)

    def return_limit(self, world: int = 0) -> float:
        """Return mu for each step."""
        return float(self.limits[world]) * (self.experiment.frame_count - 1)

    # --- episode ---

    def _begin(self, worlds: IntArray, randoms: Sequence[np.random.Generator]) -> None:
        self._paid[worlds] = self._counts[worlds] = 0
        self._on_carrier[worlds] = self._cubes_on_carriers()[worlds]

    def _after_frame(self) -> None:
        self._angle_and_rate[:] = self._stage.coordinates[-1]
        self._used_now[:] = used = self._friction_used().sum(axis=0) / SAMPLES_PER_FRAME
        on_carrier = self._cubes_on_carriers()
        moved_m = self._corners_m @ (on_carrier - self._on_carrier)
        self._on_carrier = on_carrier
        fastest_m = np.sqrt((moved_m * moved_m).sum(axis=-1).max(axis=-1))
        self._slip[:] = fastest_m * (FRAME_RATE_HZ / SLIP_SPEED_M_PER_S)
        # A comparison with NaN is false.
        holds = self._slip < 1.0
        self._used[self._counts, self._worlds] = used
        self._counts += holds
        self._paid += used
        if holds.all():
            return
        for world in np.flatnonzero(~holds).tolist():
            held = max(self._counts[world] - HOLD_FRAMES, 0)
            self._paid[world] = self._used[:held, world].sum()
            self.endings[world] = Ending.SLIPPED

    def _friction_used(self) -> FloatArray:
        """Return the tangential over the normal part of the force that carries the cube.

        Returns:
            Values at the ends of the intervals of the frame, shape [6, N].
        """
        stage = self._stage
        arms_m = self._frame.values[1:, :, 0, :3] - self._point_m
        products_m = arms_m @ self._around_and_inward
        # Force per mass [m/s^2]: the acceleration of the carrier, alpha x r + omega^2 r inward, minus gravity.
        forces = stage.acceleration * products_m[..., :3]
        forces += stage.rates[1:] ** 2 * products_m[..., 3:]
        forces[..., 2] += self.gravity_m_per_s2
        np.cos(stage.offsets[1:], out=self._turned[..., 1:2])
        np.sin(stage.offsets[1:], out=self._turned[..., 2:])
        normals = self._turned @ self._normal_parts
        normal = (forces * normals).sum(axis=-1)
        forces -= normal[..., None] * normals
        return np.asarray(np.sqrt((forces * forces).sum(axis=-1)) / normal)

    def _cubes_on_carriers(self) -> FloatArray:
        """Return the axes of the cubes and their centres [m] in the frames of their carriers now, shape [N, 4, 3]."""
        states, carriers = self._frame.values[-1, :, 0], self._stage.poses[-1]
        quaternions = np.concatenate([states[:, 3:7], carriers[:, 3:]])
        products = quaternions[:, :, None] * quaternions[:, None]
        matrices = np.einsum("nk,kj->nj", products.reshape(-1, 16), ROTATION_FORM)
        # The quaternions of an engine are units to its precision.
        matrices /= (quaternions * quaternions).sum(axis=1, keepdims=True)
        cubes, plates = matrices.reshape(2, -1, 3, 3)
        rows = np.empty((self.world_count, 4, 3))
        rows[:, :3] = cubes.swapaxes(1, 2)
        rows[:, 3] = states[:, :3] - carriers[:, :3]
        return rows @ plates

    def _total_reward(self) -> FloatArray:
        return self._paid.copy()

    def _reached(self, world: int) -> float:
        count = int(self._counts[world])
        if count < HOLD_FRAMES:
            return 0.0
        window = np.ones(HOLD_FRAMES) / HOLD_FRAMES
        means = np.convolve(self._used[:count, world], window, mode="valid")
        return float(means.max())


class TurntableLimit(FrictionLimit):
    """Turn as fast as possible without a slip of the cube, in the scene of Turntable-1.

    A level plate has the angular velocity omega and the angular acceleration alpha. A cube at the radius r then uses
    the friction sqrt((omega^2 r)^2 + (alpha r)^2) / g. So the law at a steady speed is omega^2 r = mu g: 6.5 to 7.0
    rad/s here. The cube slips before it tips, because it is as wide as it is high and mu is below 1. See
    `FrictionLimit` for reward and proof.

    A simulated cube creeps outward, so a constant speed uses more and more friction. The observation holds the friction
    used at the current place of the cube.
    """

    SCENE = "Turntable-1"
    LIMIT = Limit(
        quantity="friction used",
        law="sqrt((omega^2 r)^2 + (alpha r)^2) / g <= mu, so at a steady speed omega^2 r = mu g",
        sigma_source="relative uncertainty of the same cube's friction on the slope, from published coefficients and "
        "19 or 20 trials by the same method; no trial shows where cubes slip on the turntable",
    )
    FAMILY = "Turntable"
    """Time of an episode: 1.2 s to the limit at full acceleration, and three times as long to hold it."""
    MUJOCO_TIMESTEPS_S: ClassVar = {"training": 1 / 180}
    ACCELERATION = 6.0
    """This acceleration reaches the limit in 1.2 s. It uses a friction of 0.046, which adds under 1 % to the limit."""

    def _law_command(self, fraction: float, world: int) -> float:
        """Return the action that approaches omega = sqrt(fraction mu g / r), with r the current radius of the cube."""
        arm_m = self._frame.values[-1, world, 0, :3] - self._point_m
        radius_m = length_of(arm_m @ self._across)
        limit_m_per_s2 = fraction * self.limits[world] * self.gravity_m_per_s2
        wanted = math.sqrt(limit_m_per_s2 / radius_m)
        change = wanted - float(self._angle_and_rate[world, 1])
        return change / TURNTABLE_APPROACH_S / self.ACCELERATION


class SlopeSliderLimit(FrictionLimit):
    """Tilt as far as possible without a slip of the cube, in the scene of SlopeSlider-3.

    At rest at the tilt theta the cube uses the friction tan theta. So the law is tan theta = mu: 14.7 to 15.4 degrees
    here. The axle is 38 mm below the board's centre and 0.24 m from the cube. An acceleration of the tilt therefore
    changes the friction used, by up to 3 % of the limit; `FrictionLimit` includes that. See there for reward and proof.
    """

    SCENE = "SlopeSlider-3"
    LIMIT = Limit(
        quantity="friction used",
        law="tan(theta) <= mu at rest; while the board accelerates, tangential over normal specific force <= mu",
        sigma_source="friction of the same cube on the same board in 19 or 20 real trials at 30 degrees: root mean "
        "square distance from the published coefficient",
    )
    FAMILY = "SlopeSlider"
    """Time of an episode: 1.0 s to the limit at full acceleration and braking, and 4 s to hold it."""
    MUJOCO_TIMESTEPS_S: ClassVar = {"default": 1 / 1800, "training": 1 / 180}
    ACCELERATION = 1.0
    """This acceleration reaches the limit in 1.0 s; the real motor takes 1.2 s to 15 degrees."""

    def _law_command(self, fraction: float, world: int) -> float:
        """Return the action that tilts to tan theta = fraction mu along two parabolas, and stays there."""
        half_s = 0.5 * SLOPE_RAMP_S
        tilt_rad = math.atan(fraction * self.limits[world])
        command = tilt_rad / half_s**2 / self.ACCELERATION
        time_s = self.rollout.times_s[world]
        if time_s < half_s:
            return command
        return -command if time_s < SLOPE_RAMP_S else 0.0
