"""Swing a hanging cloth as high as a budget of the rod's speed allows."""

import math
from collections.abc import Sequence
from functools import partial

import numpy as np

from gauge_envs.backends.simulation import Sampler
from gauge_envs.observables.observer import material_points
from gauge_envs.scene import Cloth, Scene
from gauge_envs.scene.geometry import FloatArray, IntArray
from gauge_envs.scene.profiles import CosineProfile
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S
from gauge_envs.tools.control.stage import FRAME_S, Stage
from gauge_envs.tools.control.task import (
    ControlTask,
    Ending,
    FrameSamples,
    Limit,
)

SPEED_SIGMA = 0.05 / 0.67
"""Relative uncertainty of the rod's speed in the recording (0.67 +- 0.05 m/s, tasks/textile_flinging.toml)."""
CELLS = (20, 16)
"""Number of parts of the cloth along warp and weft, whose middles give the centre of mass."""
LINES = {"upper": 1 / 3, "lower": 2 / 3, "hem": 1.0}
"""Observed lines across the cloth: their distance from the rod over the cloth's length."""
PLACES = ("centre", *LINES)
PUSHES = 5
"""Number of pushes in which the law's policy spends the speed: more swing higher, and take longer."""


class FlingLimit(ControlTask):
    """Swing a hanging cloth up by moving its rod sideways, in the scene of TextileFlinging.

    **Law.** Let U be the sum of all changes of the rod's speed. Relative to the rod, only the inertial force gives
    energy E to the cloth of mass M. Its power is at most M |a| v with v = sqrt(2 E / M). So v grows by |a| dt at most,
    and the centre of mass rises by at most U^2 / (2 g), with any fabric and any motion of the rod.

    **Task.** The rod has speed, acceleration and stroke of the recorded motion, and starts in the middle of the stroke.
    U is taken from the recorded motion: when it is spent, the rod moves on without acceleration. The episode then ends
    when the centre of mass begins to fall. It also ends, as lost, when the rod is at an end of its stroke.

    **Reward.** The gain of the largest height so far, over the law's gain. No policy earns more than 1.

    **Reached** is the largest height of the centre of mass above its start, in m; 0 unless U was spent.

    **Action.** Acceleration of the rod along y, in units of the recorded motion's largest, 1.62 m/s^2.

    Places and velocities of centre and lines are relative to the rod. All places are also relative to the start.

    Args:
        material: Fabric: `satin`.

    The other arguments are those of `ControlTask`.
    """

    SCENE = "TextileFlinging"
    LIMIT = Limit(
        quantity="rise of the centre of mass",
        unit="m",
        law="relative to the rod, sqrt(2 E / M) grows by |dv| at most, so g h <= U^2 / 2; U is the sum of all |dv|",
        sigma_source="the rod's largest speed in the recording, half of U: 0.67 +- 0.05 m/s",
    )
    FAMILY = "Fling"
    """Time of an episode; the law's policy takes 2.7 s."""
    COMMANDED = ("acceleration_y",)
    OBSERVED = (
        *(f"{place}_{axis}_m" for place in PLACES for axis in "yz"),
        *(f"{place}_velocity_{axis}_m_per_s" for place in PLACES for axis in "yz"),
        "rod_y_m",
        "rod_velocity_y_m_per_s",
        "speed_left_m_per_s",
        "highest_over_limit",
        "time_s",
    )
    _stage: Stage

    # --- scene and limit ---

    def _prepare(self, scene: Scene) -> tuple[float, float]:
        (recorded,) = self.published_scene.drivers[0].motions[0].profiles
        (cloth,) = scene.deformables
        assert isinstance(recorded, CosineProfile) and isinstance(cloth, Cloth)
        self._acceleration_m_per_s2 = (
            recorded.largest_rate * math.pi / recorded.duration_s
        )
        self._stroke_m = 0.5 * abs(recorded.amount)
        # The rod speeds up to its largest speed and brakes.
        self._speed_m_per_s = 2.0 * recorded.largest_rate
        self._stage = Stage(
            scene,
            self._acceleration_m_per_s2,
            self.world_count,
            max_rate=recorded.largest_rate,
            strokes=(self._stroke_m,),
            speed_change=self._speed_m_per_s,
        )
        self._cloth = cloth.name
        rest_m = self.simulation.nodes(cloth.name)[0].copy()
        self._weights = place_weights(cloth, rest_m)
        shape = self.world_count, len(PLACES), 2
        count = 2 * len(PLACES)
        self._start_m = np.zeros(shape)
        self._places_m = self._entries("centre_y_m", count).reshape(shape)
        self._velocities = self._entries("centre_velocity_y_m_per_s", count).reshape(
            shape
        )
        self._rod_m = self._entry("rod_y_m")
        self._rod_velocity = self._entry("rod_velocity_y_m_per_s")
        self._left_m_per_s = self._entry("speed_left_m_per_s")
        self._highest = self._entry("highest_over_limit")
        value = 0.5 * self._speed_m_per_s**2 / self.gravity_m_per_s2
        return value, 2.0 * SPEED_SIGMA * value

    # --- episode ---

    def _read(self) -> FloatArray:
        """Return y and z of centre and lines [m], shape [N, 1 + line_count, 2]."""
        return (self._weights @ self.simulation.nodes(self._cloth))[..., 1:]

    def _samples(self) -> FrameSamples:
        return FrameSamples(self._read, partial(Sampler, self._read), has_states=False)

    def _begin(self, worlds: IntArray, randoms: Sequence[np.random.Generator]) -> None:
        self._start_m[worlds] = self._frame.values[-1, worlds]
        self._left_m_per_s[worlds] = self._speed_m_per_s

    def _after_frame(self) -> None:
        stage = self._stage
        places_m = self._frame.values - self._start_m
        # Relative to the rod.
        places_m[..., 0] -= stage.offsets
        velocities = (places_m[1:] - places_m[:-1]) / SAMPLE_INTERVAL_S
        rises = velocities[:, :, 0, 1] > 0.0
        rose = np.concatenate([self._velocities[None, :, 0, 1] > 0.0, rises[:-1]])
        is_lost = np.abs(stage.offsets[1:, :, 0]) >= self._stroke_m
        counted = np.where(is_lost, -np.inf, places_m[1:, :, 0, 1] / self.limits)
        counted[0] = np.maximum(counted[0], self._highest)
        left = stage.speed_changes_left[1:]
        # The rest after the last push is a rounding error.
        is_top = (left < 1e-9) & rose & ~rises
        last = self._end({Ending.LOST: is_lost, Ending.REACHED: is_top})
        self._places_m[:], self._velocities[:] = places_m[1:][last], velocities[last]
        self._rod_m[:] = stage.offsets[1:, :, 0][last]
        self._rod_velocity[:] = stage.rates[1:, :, 0][last]
        self._left_m_per_s[:] = left[last]
        self._highest[:] = np.maximum.accumulate(counted)[last]

    def _total_reward(self) -> FloatArray:
        return self._highest.copy()

    def _reached(self, world: int) -> float:
        return float(self._highest[world] * self.limits[world])

    # --- policy of the law ---

    def _law_command(self, fraction: float, world: int) -> float:
        """Return the action that turns the rod's speed, fraction U / 9, against the swing at its lowest point."""
        speed = fraction * self._speed_m_per_s / (2 * PUSHES - 1)
        place_m = float(self._places_m[world, 0, 0])
        velocity = float(self._velocities[world, 0, 0])
        swings_up = place_m * velocity >= 0.0
        is_low = abs(place_m) <= abs(velocity) * speed / self._acceleration_m_per_s2
        wanted = math.copysign(speed, -velocity if swings_up or is_low else velocity)
        change = wanted - float(self._rod_velocity[world])
        return change / FRAME_S / self._acceleration_m_per_s2


def place_weights(cloth: Cloth, nodes_m: FloatArray) -> FloatArray:
    """Return the weights of nodes that give the centre of mass, and the middles of `LINES`.

    Args:
        cloth: The cloth, which hangs from the end of its warp, x.
        nodes_m: Its nodes at the start [m], shape [node_count, 3].

    Returns:
        Weights, shape [1 + line_count, node_count].
    """
    along, across = ((np.arange(count) + 0.5) / count - 0.5 for count in CELLS)
    weights = np.zeros((len(PLACES), len(nodes_m)))
    lines = [np.array([0.5 - depth]) for depth in LINES.values()]
    for row, places in zip(weights, [along, *lines], strict=True):
        points = np.array([(x, y, 0.0) for x in places for y in across])
        nodes, shares = material_points(
            cloth.pose.to_world(points * [*cloth.size_m, 1.0]),
            {cloth.name: nodes_m},
            {cloth.name: cloth},
        )
        np.add.at(row, nodes, shares / len(points))
    return weights
