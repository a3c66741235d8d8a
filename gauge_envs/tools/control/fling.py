"""Swing a hanging cloth as high as a budget of the rod's speed allows."""

import math

import numpy as np

from gauge_envs.observables.observer import material_points
from gauge_envs.scene import Cloth, Scene
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.profiles import CosineProfile
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S
from gauge_envs.tools.control.env import ControlEnv, Ending, Limit
from gauge_envs.tools.control.stage import FRAME_S, Stage

SPEED_SIGMA = 0.05 / 0.67
"""Relative uncertainty of the rod's speed in the recording (0.67 +- 0.05 m/s, tasks/textile_flinging.toml)."""
CELLS = (20, 16)
"""Number of parts of the cloth along warp and weft, whose middles give the centre of mass."""
LINES = {"upper": 1 / 3, "lower": 2 / 3, "hem": 1.0}
"""Observed lines across the cloth: their distance from the rod over the cloth's length."""
PLACES = ("centre", *LINES)
PUSHES = 5
"""Number of pushes in which the law's policy spends the speed: more swing higher, and take longer."""


class FlingLimit(ControlEnv):
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

    The other arguments are those of `ControlEnv`.
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
            max_rate=recorded.largest_rate,
            strokes=(self._stroke_m,),
            speed_change=self._speed_m_per_s,
        )
        self._weights = place_weights(cloth, self.rollout.rest_nodes_m[cloth.name])
        value = 0.5 * self._speed_m_per_s**2 / self.gravity_m_per_s2
        return value, 2.0 * SPEED_SIGMA * value

    # --- episode ---

    def _begin(self) -> None:
        self._start_m = self._seen_m()
        self._places_m, self._velocities = np.zeros((2, *self._start_m.shape))
        self._left_m_per_s = self._speed_m_per_s
        self._highest_m = 0.0

    def _seen_m(self) -> FloatArray:
        """Return y and z of centre and lines relative to the rod [m], shape [1 + line_count, 2]."""
        (nodes_m,) = self.rollout.recording.nodes_m().values()
        return (self._weights @ nodes_m)[:, 1:] - [self._stage.offset[0], 0.0]

    def _after_interval(self) -> Ending | None:
        stage = self._stage
        rose = self._velocities[0, 1] > 0.0
        places_m = self._seen_m() - self._start_m
        self._velocities = (places_m - self._places_m) / SAMPLE_INTERVAL_S
        self._places_m = places_m
        if abs(stage.offset[0]) >= self._stroke_m:
            return Ending.LOST
        self._left_m_per_s = stage.speed_changes_left[stage.sample]
        self._highest_m = max(self._highest_m, float(places_m[0, 1]))
        # The rest after the last push is a rounding error.
        if self._left_m_per_s < 1e-9 and rose and self._velocities[0, 1] <= 0.0:
            return Ending.REACHED
        return None

    def _total_reward(self) -> float:
        return self._highest_m / self.limit.value

    def _observation(self) -> list[float]:
        return [
            *self._places_m.ravel(),
            *self._velocities.ravel(),
            *self._stage.offset,
            *self._stage.rate,
            self._left_m_per_s,
            self._highest_m / self.limit.value,
            self.time_s,
        ]

    def _reached(self) -> float:
        return self._highest_m

    # --- policy of the law ---

    def _law_command(self, fraction: float) -> float:
        """Return the action that turns the rod's speed, fraction U / 9, against the swing at its lowest point."""
        speed = fraction * self._speed_m_per_s / (2 * PUSHES - 1)
        place_m, velocity = float(self._places_m[0, 0]), float(self._velocities[0, 0])
        swings_up = place_m * velocity >= 0.0
        is_low = abs(place_m) <= abs(velocity) * speed / self._acceleration_m_per_s2
        wanted = math.copysign(speed, -velocity if swings_up or is_low else velocity)
        change = wanted - float(self._stage.rate[0])
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
