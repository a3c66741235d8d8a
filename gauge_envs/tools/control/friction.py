"""Base of the turntable and the slope task: a cube that only friction holds on a body that turns."""

import math
from dataclasses import replace
from typing import ClassVar

import numpy as np

from gauge_envs.scene import Scene
from gauge_envs.scene.geometry import (
    FloatArray,
    length_of,
    rotation_matrices,
    unit_quaternions,
)
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.control.env import ControlEnv
from gauge_envs.tools.control.limit import Ending
from gauge_envs.tools.control.stage import Stage

CUBE = "cube"

HOLD_S = 1.0
"""Time over which the friction used is averaged for the value that a policy reaches [s]."""

HOLD_FRAMES = round(HOLD_S * FRAME_RATE_HZ)
"""`HOLD_S` in frames."""

SLIP_SPEED_M_PER_S = 0.02
"""Speed on the carrier from which the cube counts as slipping [m/s]: that of its fastest corner, mean over a frame.

The value lies between the creep of a cube that holds and the slip of one that does not. A carried cube creeps because
contacts are not rigid. On the turntable at mu g the speed is half the contact's time constant times mu g: 3.7 mm/s in
MuJoCo with this package's preset, 9.3 mm/s in Newton. A cube that uses 2 % too much friction reaches 20 mm/s after
0.3 s. Slower slips do not count. Where the mean over a frame is 20 mm/s, the speed at its end is up to 30 mm/s, if the
actuator raises the friction used as fast as it can. So a policy can use 30 mm/s / (g HOLD_S) = 0.003 more friction than
the law allows, 0.8 to 1.2 % of it.
"""


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
    QUANTITY = "friction used"
    COMMANDED = ("angular_acceleration",)
    OBSERVED = (
        "angle_rad",
        "rate_rad_per_s",
        "friction_used",
        "slip_over_threshold",
        "time_s",
    )
    _at_time_limit = Ending.HELD
    _stage: Stage
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
        carrier = scene.body(driver.body).pose
        self._stage = Stage(driver, carrier, np.array([math.inf]))
        self._axis = np.array(motion.axis)
        self._across_axis = np.cross(self._axis, np.eye(3))
        self._point_m = np.array(motion.point_m)
        self._corners_m = scene.body(CUBE).shape.corners_m

    def _limit_and_sigma(self) -> tuple[float, float]:
        return self._friction_and_sigma(CUBE, self._stage.body)

    # --- physics ---

    def _accelerate(self, command: FloatArray) -> FloatArray:
        self._acceleration = command * self.ACCELERATION_RAD_PER_S2
        self._cube_m: list[FloatArray] = []
        return self._acceleration

    def _friction_used(self) -> FloatArray:
        """Return the tangential over the normal part of the force that carries the cube, at the samples of the frame.

        Returns:
            Shape [sample_count], without the sample at the start of the frame.
        """
        around_m = (np.array(self._cube_m) - self._point_m) @ self._across_axis
        inward_m = around_m @ self._across_axis
        # In m/s^2, as of a unit of mass: the acceleration of the carrier minus that of gravity.
        forces = self._acceleration * around_m + self._stage.rates[1:] ** 2 * inward_m
        forces[:, 2] += self.experiment.scene.gravity_m_per_s2
        normals = rotation_matrices(self._stage.states[1:, 3:7])[:, :, 2]
        normal = (forces * normals).sum(axis=1)
        tangential = forces - normal[:, None] * normals
        return np.asarray(np.linalg.norm(tangential, axis=1) / normal)

    def _corners(self) -> FloatArray:
        """Return the corners of the cube in the frame of the carrier [m], shape [8, 3]."""
        state, carrier = self._state(CUBE), self._stage.state
        turn = rotation_matrices(unit_quaternions(state[3:7]))
        corners_m = self._corners_m @ turn.T + state[:3] - carrier[:3]
        return corners_m @ rotation_matrices(carrier[3:7])

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
        arm = self._state(CUBE)[:3] - self._point_m
        return length_of(arm - self._axis * (self._axis @ arm))

    # --- task ---

    def _begin(self) -> None:
        self._used: list[float] = []
        self._used_now = self._slip_m_per_s = 0.0
        self._corners_on_carrier = self._corners()

    def _look(self) -> None:
        self._cube_m.append(self._state(CUBE)[:3])

    def _frame_ending(self) -> Ending | None:
        self._used_now = float(self._friction_used().mean())
        self._slip_m_per_s = self._slip()
        # A comparison with NaN is false.
        if not self._slip_m_per_s < SLIP_SPEED_M_PER_S:
            return Ending.SLIPPED
        self._used.append(self._used_now)
        return None

    def _observation(self) -> FloatArray:
        slip = self._slip_m_per_s / SLIP_SPEED_M_PER_S
        angle, rate = float(self._stage.offset[0]), float(self._stage.rate[0])
        return np.array([angle, rate, self._used_now, slip, self.time_s])

    # --- reward ---

    def _earned(self, ending: Ending | None) -> float:
        slipped = ending is Ending.SLIPPED
        return sum(self._used[:-HOLD_FRAMES] if slipped else self._used)

    def _reached(self) -> float:
        if len(self._used) < HOLD_FRAMES:
            return 0.0
        return float(
            np.convolve(
                self._used, np.ones(HOLD_FRAMES) / HOLD_FRAMES, mode="valid"
            ).max()
        )
