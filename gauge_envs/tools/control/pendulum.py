"""Swing the pendulum to a height with the least work."""

import math
from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from gauge_envs.scene import Hinge, Scene, Sphere
from gauge_envs.scene.geometry import FloatArray, IntArray
from gauge_envs.tools.control.stage import FRAME_S
from gauge_envs.tools.control.task import ControlTask, Ending, Limit

BALL = "ball"

TARGET_RAD = math.radians(60.0)
"""Target angle of the ball [rad]: at half the height of the axle, and well below the published release, 90 degrees."""
TORQUE_SHARE = 0.15
"""Largest torque over weight times length; it cannot lift the ball at once, so the policy must swing it up."""
LENGTH_SIGMA = 0.004 / 0.270
"""Relative uncertainty of the effective length, from the recorded period (0.270 +- 0.004 m, tasks/pendulum.toml)."""
MASS_SIGMA_KG = 1e-4 / math.sqrt(12.0)
"""Uncertainty of the mass [kg]: rounding, as it is published to 0.1 g."""


class PendulumLimit(ControlTask):
    """Swing a hanging ball to a height with the least work, in the scene of Pendulum.

    **Law.** To raise the ball by h, the motor does at least the work m g h: W >= m g h.

    **Reward.** In each frame 2 d(h_max) / h_t - dW / (m g h_t). Here h_t is the target, h_max the largest height so
    far, and W the work of the motor; braking returns no work. An episode earns 2 x - W / (m g h_t) with x = h_max /
    h_t. By the law this is at most x, so at most 1. A policy earns 1 only if it reaches the target at rest and never
    brakes. The episode ends at the target.

    W is the sum of torque times rotation over the samples with a positive product. It is at least the sum over all
    samples, which the law bounds.

    **Reached** is the height of the target over the work, in m/J, or 0 if the ball did not reach it; the limit is
    1 / (m g). The height follows from the angle, so the uncertainty of the length counts.

    **Action.** Torque about the axle, in units of 0.15 times weight times length.

    Args:
        material: Material of the ball: `metal`.

    The other arguments are those of `ControlTask`.
    """

    SCENE = "Pendulum"
    LIMIT = Limit(
        quantity="height over work",
        unit="m/J",
        law="W >= m g h, so h / W <= 1 / (m g)",
        sigma_source="length from the recorded period, 0.270 +- 0.004 m, which gives the height at an angle; mass to "
        "0.1 g",
    )
    FAMILY = "Pendulum"
    """Time of five full swings; at full torque three are enough."""
    MUJOCO_TIMESTEPS_S: ClassVar = {"default": 1 / 180, "training": 1 / 180}
    PARAMETERS: ClassVar = {f"{BALL}.euler_deg": (0.0, 0.0, 0.0)}
    """The ball hangs straight down at the start."""
    CAMERA: ClassVar = {"target_m": (0.37, 0.49, 0.3), "distance_m": 1.97}
    COMMANDED = ("torque",)
    OBSERVED = (
        "angle_rad",
        "rate_rad_per_s",
        "highest_over_target",
        "work_over_least",
        "time_s",
    )

    # --- scene and limit ---

    def _prepare(self, scene: Scene) -> tuple[float, float]:
        hinge, ball = scene.joints[0], scene.body(BALL)
        assert isinstance(hinge, Hinge) and isinstance(ball.shape, Sphere)
        length_m = math.dist(ball.pose.position_m, hinge.anchor_m)
        self._anchor_m = np.asarray(hinge.anchor_m)
        self._axis = np.asarray(hinge.axis)
        # Angles and heights are relative to hanging straight down, wherever the ball starts.
        self._hanging = np.array([0.0, 0.0, -length_m])
        self._sideways = np.cross(self._axis, self._hanging)
        self._length_m = length_m
        self._weight_n = ball.mass_kg * scene.gravity_m_per_s2
        # Steiner's theorem for a solid ball.
        self._inertia_kg_m2 = ball.mass_kg * (
            length_m**2 + 0.4 * ball.shape.radius_m**2
        )
        self._max_torque_n_m = TORQUE_SHARE * self._weight_n * length_m
        self._target_m = length_m * (1.0 - math.cos(TARGET_RAD))
        self._least_work_j = self._weight_n * self._target_m
        self._angle = self._entry("angle_rad")
        self._rate = self._entry("rate_rad_per_s")
        self._highest = self._entry("highest_over_target")
        self._work = self._entry("work_over_least")
        value = 1.0 / self._weight_n
        return value, value * math.hypot(LENGTH_SIGMA, MASS_SIGMA_KG / ball.mass_kg)

    # --- episode ---

    def _begin(self, worlds: IntArray, randoms: Sequence[np.random.Generator]) -> None:
        angles, rates = self._swing()
        self._angle[worlds] = angles[-1, worlds]
        self._rate[worlds] = rates[-1, worlds]

    def _before_step(self, commands: FloatArray) -> None:
        self._torque_n_m = commands[:, 0] * self._max_torque_n_m
        wrenches = np.zeros((self.world_count, 6))
        wrenches[:, 3:] = self._torque_n_m[:, None] * self._axis
        self.simulation.apply_wrench(BALL, wrenches)

    def _after_frame(self) -> None:
        angles, rates = self._swing()
        turned = angles[1:] - angles[:-1]
        work = np.maximum(turned * (self._torque_n_m / self._least_work_j), 0.0)
        work = self._work + work.cumsum(axis=0)
        heights = (1.0 - np.cos(angles[1:])) * (self._length_m / self._target_m)
        heights[0] = np.maximum(heights[0], self._highest)
        highest = np.minimum(np.maximum.accumulate(heights), 1.0)
        last = self._end({Ending.REACHED: highest == 1.0})
        self._angle[:], self._rate[:] = angles[1:][last], rates[1:][last]
        self._work[:], self._highest[:] = work[last], highest[last]

    def _swing(self) -> tuple[FloatArray, FloatArray]:
        """Return the angles from hanging [rad] and their rates [rad/s] at the seven samples, shape [7, N]."""
        states = self._frame.values[:, :, 0]
        arms = states[..., :3] - self._anchor_m
        angles = np.arctan2(arms @ self._sideways, arms @ self._hanging)
        return angles, states[..., 10:] @ self._axis

    def _total_reward(self) -> FloatArray:
        return 2.0 * self._highest - self._work

    def _reached(self, world: int) -> float:
        work_j = float(self._work[world]) * self._least_work_j
        return self._target_m / work_j

    # --- policy of the law ---

    def _law_command(self, fraction: float, world: int) -> float:
        """Return a torque along the swing until the work is m g h_t / fraction, and then 0.

        A `fraction` below 1 does more than the least work and reaches the target; a `fraction` above 1 does not.
        """
        angle, now = float(self._angle[world]), float(self._rate[world])
        work = float(self._work[world])
        left_j = self._least_work_j * (1.0 / fraction - work)
        has_begun = work > 0.0
        direction = math.copysign(1.0, now) if has_begun else 1.0
        torque = direction * self._max_torque_n_m
        rate = now + self._acceleration(torque, angle) * FRAME_S
        turned = self._turned(torque, angle, now)
        # Near a turning point a push would brake in the second half of the frame.
        turns = turned * direction <= 0.0 or rate * direction <= 0.0
        if left_j <= 0.0 or (has_begun and turns):
            return 0.0
        for _ in range(5):
            needed = left_j / abs(self._turned(torque, angle, now))
            torque = direction * min(self._max_torque_n_m, needed)
        return torque / self._max_torque_n_m

    def _acceleration(self, torque_n_m: float, angle_rad: float) -> float:
        """Return the angular acceleration [rad/s^2]."""
        gravity = self._weight_n * self._length_m * math.sin(angle_rad)
        return (torque_n_m - gravity) / self._inertia_kg_m2

    def _turned(self, torque_n_m: float, angle_rad: float, rate: float) -> float:
        """Return the rotation in the next frame [rad], to second order, from a rate [rad/s]."""
        acceleration = self._acceleration(torque_n_m, angle_rad)
        return (rate + 0.5 * acceleration * FRAME_S) * FRAME_S
