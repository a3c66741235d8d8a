"""A cube that friction alone holds on a body that turns: what turntable and slope have in common."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.envs.control.env import ControlEnv
from gauge_envs.envs.control.limit import Ending, Limit, friction_uncertainty, pair_friction
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.scene import Scene
from gauge_envs.scene.drivers import Driver, mean_velocity
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLE_INTERVAL_S, SAMPLES_PER_FRAME

__all__ = [
    "HOLD_S",
    "SLIP_SPEED_M_PER_S",
    "FrictionLimit",
]

CUBE = "cube"

HOLD_S = 1.0
"""What is reached is the mean of the friction used over this time [s]; see `SLIP_SPEED_M_PER_S`."""

HOLD_FRAMES = round(HOLD_S * FRAME_RATE_HZ)
"""The same in frames."""

SLIP_SPEED_M_PER_S = 0.02
"""Speed on the carrier from which the cube counts as slipping [m/s], mean over a frame, of its fastest corner.

Between what engines do to a cube that holds and what physics does to one that does not. A carried cube creeps, since
contacts are not rigid: on the turntable at mu g by half the contact's time constant times mu g, 3.7 mm/s in MuJoCo's
default and 9.3 mm/s in Newton's. One that uses 2 % too much friction is at 20 mm/s after 0.3 s. Slower slips are
not seen, which lets a policy use 20 mm/s / (g HOLD_S) = 0.002 more friction than there is, 0.5 to 0.9 % of it.
"""


class FrictionLimit(ControlEnv):
    """Use as much of the friction of a cube on a driven body as there is, and no more.

    **Law.** Carrying the cube takes a specific force f = a - g, with a the acceleration of the place where it stands.
    Across the face that it stands on, f has the parts f_n and f_t. Friction holds while the *friction used*, f_t / f_n,
    is at most mu.

    **Reward.** The friction used, mean over the frame. A slip ends the episode and takes back what the last `HOLD_S`
    paid. Along f_t the cube on its carrier accelerates with (used - mu) f_n at least while it slips. With v_s the speed
    at which a slip is seen, the impulse over any time T without one gives

        integral of used dt <= mu T + v_s / f_n,

    in whatever way a policy goes to and fro across the limit. So no policy earns more than mu a step, but for one v_s;
    and using mu all the time earns just that. The optimum of the reward is the law's limit, reached as soon as the
    actuator allows, held to the end.

    **Reached** is the largest mean of the friction used over `HOLD_S` without slip: at most mu + v_s / (g HOLD_S).

    **Action.** Angular acceleration of the carrier, in units of `ACCELERATION_RAD_PER_S2`.

    Args:
        material: Material of the cube: `wood`, `plastic` or `metal`.
        **options: As of `ControlEnv`: `backend`, `parameters`, `settings`, `render_mode`, `width`, `height`.

    Attributes:
        SUBTASK: Subtask of the experiment whose scene it is.
        ACCELERATION_RAD_PER_S2: Angular acceleration that an action of 1 commands.
    """

    SUBTASK: ClassVar[str]
    ACCELERATION_RAD_PER_S2: ClassVar[float]
    OBSERVED: ClassVar[tuple[str, ...]] = (
        "angle_rad",
        "rate_rad_per_s",
        "friction_used",
        "slip_over_threshold",
        "time_s",
    )
    _at_time_limit = Ending.HELD

    def __init__(self, material: str, **options: Any) -> None:
        super().__init__(f"{self.FAMILY}-{self.SUBTASK}-{material}", **options)
        scene = self.experiment.scene
        self._driver = scene.drivers[0]
        motion, carrier = self._driver.motions[0], scene.body(self._driver.body)
        self._start = carrier.pose
        self._axis, self._point_m = np.asarray(motion.axis), np.asarray(motion.point_m)
        # The matrix of the cross product with the axis.
        self._turning = np.cross(np.eye(3), self._axis)
        self._gravity = np.array([0.0, 0.0, -scene.gravity_m_per_s2])
        self._corners_m = scene.body(CUBE).shape.corners_m

    def _drivers(self, scene: Scene) -> tuple[Driver, ...]:
        """The carrier's driver, which turns about the same axis as the experiment's, as the action says."""
        driver = scene.drivers[0]
        fastest = self.ACCELERATION_RAD_PER_S2 * self.DURATION_S
        motion = replace(driver.motions[0], profiles=(), residual_rate=fastest)
        return (replace(driver, motions=(motion,), provenance="action"),)

    def _limit(self) -> Limit:
        scene, variant = self.experiment.scene, self.experiment.variant
        carrier = scene.drivers[0].body
        # How well a coefficient is known does not depend on the one that an override puts in its place.
        calibrated = pair_friction(load_experiment(variant).scene, CUBE, carrier)
        return Limit(
            quantity="friction used",
            unit="1",
            value=pair_friction(scene, CUBE, carrier),
            sigma=friction_uncertainty(variant.material) * calibrated,
            law=self.LAW,
            sigma_source=self.SIGMA_SOURCE,
        )

    # --- course ---

    def _begin(self) -> None:
        self._angle = self._rate = 0.0
        self._pose = self._start
        self._velocity = np.zeros(6)
        self._used: list[float] = []
        self._used_now = 0.0
        self._slip_m_per_s = 0.0
        self._corners_on_carrier = self._corners()

    def _advance(self, command: float) -> tuple[float, Ending | None]:
        acceleration = command * self.ACCELERATION_RAD_PER_S2
        used = [self._advance_sample(acceleration) for _ in range(SAMPLES_PER_FRAME)]
        self._used_now = sum(used) / len(used)
        self._slip_m_per_s = self._slip()
        if not self._slip_m_per_s < SLIP_SPEED_M_PER_S:
            return -sum(self._used[-HOLD_FRAMES:]), Ending.SLIPPED
        self._used.append(self._used_now)
        return self._used_now, None

    def _advance_sample(self, acceleration: float) -> float:
        """Turn the carrier for 1/180 s with a uniform acceleration; friction used at the end."""
        step = SAMPLE_INTERVAL_S
        self._angle += (self._rate + 0.5 * acceleration * step) * step
        self._rate += acceleration * step
        pose, velocity = self._driver.state(self._start, 0.0, np.array([self._angle]), np.array([self._rate]))
        # Uniformly accelerated to the end pose, exactly.
        mean = mean_velocity(self._pose, pose, step)
        self.simulation.drive(self._driver.body, self._pose, self._velocity, 2.0 / step * (mean - self._velocity))
        self.simulation.advance(step)
        self._pose, self._velocity = pose, velocity
        return self._friction_used(acceleration)

    def _friction_used(self, acceleration: float) -> float:
        """Tangential over normal part of the specific force that carries the cube where it is now."""
        around = self._turning @ (self.simulation.body_states((CUBE,))[0, :3] - self._point_m)
        force = acceleration * around + self._rate**2 * (self._turning @ around) - self._gravity
        normal = self._pose.rotation.apply((0.0, 0.0, 1.0))
        held = float(force @ normal)
        return math.sqrt(max(float(force @ force) - held**2, 0.0)) / held

    def _corners(self) -> NDArray[np.float64]:
        """Corners of the cube in the frame of the carrier [m], shape [8, 3]."""
        state = self.simulation.body_states((CUBE,))[0]
        turn = Rotation.from_quat(state[3:7], scalar_first=True)
        return self._pose.to_body(turn.apply(self._corners_m) + state[:3])

    def _slip(self) -> float:
        """Mean speed of the cube's fastest corner on the carrier over the last frame [m/s]."""
        corners = self._corners()
        way = np.linalg.norm(corners - self._corners_on_carrier, axis=1).max()
        self._corners_on_carrier = corners
        return float(way) * FRAME_RATE_HZ

    def _observation(self) -> NDArray[np.float64]:
        slip = self._slip_m_per_s / SLIP_SPEED_M_PER_S
        return np.array([self._angle, self._rate, self._used_now, slip, self.time_s])

    def _reached(self) -> float:
        if len(self._used) < HOLD_FRAMES:
            return 0.0
        return float(np.convolve(self._used, np.ones(HOLD_FRAMES) / HOLD_FRAMES, mode="valid").max())

    @property
    def _cube_radius_m(self) -> float:
        """Distance of the cube from the axis now."""
        arm = self.simulation.body_states((CUBE,))[0, :3] - self._point_m
        return float(np.linalg.norm(arm - self._axis * (self._axis @ arm)))
