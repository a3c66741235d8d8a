"""Episodes of all worlds on an engine's device, for learners there: no step copies anything to the host.

Commands, driven motions, starts, observations, rewards, flags and scores are arrays of the engine's library. The Python
calls of a step do not depend on the number of worlds.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from gauge_envs.backends.base import worlds_of
from gauge_envs.backends.registry import backend_for
from gauge_envs.envs.arguments import EnvArguments
from gauge_envs.envs.at_once import BatchReward
from gauge_envs.envs.divergence import RigidBoundsOfWorlds
from gauge_envs.envs.episode import Episode
from gauge_envs.errors import ParameterError, UnsupportedSceneError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.observables.kinds import Observable
from gauge_envs.references.band import Band
from gauge_envs.scene.driver_path import DriverPathInArrays
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.scene import Scene
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLE_INTERVAL_S, SAMPLES_PER_FRAME
from gauge_envs.scoring.score import normalizing_baselines


def dynamic_states(scene: Scene) -> FloatArray:
    """Return the states of the dynamic bodies at the start, shape [body_count, 13]; see `World.body_states`."""
    return np.array(
        [
            [
                *body.pose.position_m,
                *body.pose.quaternion,
                *body.linear_velocity_m_per_s,
                *body.angular_velocity_rad_per_s,
            ]
            for body in scene.dynamic_bodies
        ]
    )


class EpisodesOnDevice:
    """Episodes of all worlds in arrays of a device.

    Args:
        arguments: Engine and settings.
        experiments: The experiment of each world; they differ in constants.
        stated: The experiment without the changes of the worlds.
        band: Its band, or None.

    Attributes:
        worlds: The worlds.
        device: Their arrays.
        episodes: An episode that declares the spaces; nothing runs in it.
        diverged: Whether each world has diverged, shape [world_count].
    """

    def __init__(
        self,
        arguments: EnvArguments,
        experiments: Sequence[Experiment],
        stated: Experiment,
        band: Band | None,
    ) -> None:
        scenes = [one.scene for one in experiments]
        scene, count = scenes[0], len(scenes)
        _check_scenes(stated, scenes)
        engine = backend_for(arguments.backend, stated.model_file)
        self.worlds = worlds_of(engine, scenes, arguments.settings)
        device = self.device = self.worlds.on_device()
        first = Episode(
            experiments[0],
            self.worlds.worlds[0],
            band=band,
            marker_proxy=arguments.proxy,
        )
        self.episodes = [first]
        self._experiment, self._band = stated, band
        self._last_frame = stated.frame_count - 1
        self._recorded = tuple(stated.recorded)
        self._dynamic = tuple(body.name for body in scene.dynamic_bodies)
        self._driven = tuple(driver.body for driver in scene.drivers)
        frame_count = stated.frame_count
        self._drivers = [
            DriverPathInArrays(
                driver,
                scene.body(driver.body).pose,
                frame_count,
                count,
                arrays=device.arrays,
                put=device.asarray,
            )
            for driver in scene.drivers
        ]
        motion_count = sum(driver.motion_count for driver in self._drivers)
        self._no_rates = device.asarray(np.zeros((count, motion_count)))
        self._bounds = RigidBoundsOfWorlds(scenes, device)
        self._reward = BatchReward(band, first.is_reward_bounded, device)
        self._nothing = device.asarray(np.zeros(count))
        self._none_diverged = self._nothing > 0.0
        self._start_time = device.asarray(np.zeros((count, 1)))
        self.diverged = self._none_diverged
        self._frame = 0
        self._samples: list[Any] = []
        self._shown: dict[str, Any] = {}

    @property
    def is_complete(self) -> bool:
        """Whether this is the last frame."""
        return self._frame == self._last_frame

    def start(self, states: Any | None) -> None:
        """Start an episode in all worlds; see `DeviceWorlds.begin`."""
        self.device.begin(states)
        # A solution does not score scattered starts; see `scoring.reference.refusal`.
        is_solution = self._band is not None and self._band.kind.is_solution
        self._is_scored = states is None or not is_solution
        for driver in self._drivers:
            driver.reset()
        self._frame = 0
        self.diverged = self._none_diverged
        self._samples = [self._observed()]
        self._show(is_first=True)

    def advance(self, actions: Any) -> Any:
        """Simulate a frame with actions of all worlds, and return the rewards, shape [world_count]."""
        rates = self._no_rates
        if self._drivers:
            given = self.device.asarray(actions).reshape(rates.shape)
            rates = self.device.arrays.clip(given, -1.0, 1.0)
        self._simulate(self._frame, rates)
        self._frame += 1
        self.diverged = self.diverged | self._suspects()
        rewards = self._reward.of(self._samples[-1], self._frame)
        self._show()
        return self.device.arrays.where(self.diverged, self._nothing, rewards)

    def _simulate(self, frame: int, rates: Any) -> None:
        """Drive and advance all worlds from a frame to the next, and keep g(t)."""
        sample = frame * SAMPLES_PER_FRAME
        column = 0
        for driver in self._drivers:
            chosen = rates[:, column : column + driver.motion_count]
            driver.begin_frame(sample, chosen)
            column += driver.motion_count
        for number in range(sample, sample + SAMPLES_PER_FRAME):
            for driver in self._drivers:
                self.device.drive(driver.body, driver.interval(number))
            self.device.advance(SAMPLE_INTERVAL_S)
            self._samples.append(self._observed())

    def _observed(self) -> Any:
        """Return g(t) of all worlds [mm], shape [world_count, width]."""
        positions_m = self.device.body_states(self._recorded)[:, :, :3]
        return 1e3 * positions_m.reshape((len(self._nothing), 3 * len(self._recorded)))

    def _suspects(self) -> Any:
        return self._bounds.suspects(self.device.body_states(self._dynamic))

    def _show(self, *, is_first: bool = False) -> None:
        """Set the observations; worlds that have diverged keep theirs."""
        shown = {
            "bodies": self.device.body_states(self._recorded),
            "observable": self._samples[-1],
            "time": self._start_time + self._frame / FRAME_RATE_HZ,
        }
        if self._driven:
            shown["driver"] = self.device.body_states(self._driven)
        if not is_first:
            where = self.device.arrays.where
            for name, now in shown.items():
                rows = self.diverged.reshape((-1, *[1] * (len(now.shape) - 1)))
                shown[name] = where(rows, self._shown[name], now)
        self._shown = shown

    def observation(self) -> dict[str, Any]:
        """Return the observations of all worlds in arrays of the device, which nothing changes later."""
        return dict(self._shown)

    def truncations(self) -> Any:
        """Return which worlds have ended without divergence, shape [world_count]."""
        return ~self.diverged if self.is_complete else self._none_diverged

    def nothing(self) -> tuple[Any, Any, Any]:
        """Return the rewards and the flags of the step that starts an episode."""
        return self._nothing, self._none_diverged, self._none_diverged

    def info(self) -> dict[str, Any]:
        """Return frame and time, and the scores at the last frame."""
        info: dict[str, Any] = {
            "frame": self._frame,
            "time_s": self._frame / FRAME_RATE_HZ,
        }
        if self.is_complete and self._band is not None and self._is_scored:
            info |= self._scores(self._band)
        return info

    def _scores(self, band: Band) -> dict[str, Any]:
        """Return the distances of all worlds from a reference, on the device; see `score_worlds`."""
        arrays = self.device.arrays
        known = np.isfinite(band.mean)
        weight = self.device.asarray(known[:, None].astype(np.float64))
        mean = self.device.asarray(np.nan_to_num(band.mean)[:, None])
        frames = arrays.stack(self._samples[::SAMPLES_PER_FRAME][: len(known)], axis=0)
        projected = arrays.matmul(frames, self.device.asarray(band.projection.T))
        apart = (projected - mean) * weight
        squares = arrays.einsum("tnc,tnc->n", apart, apart)
        rmse = arrays.sqrt(squares / int(known.any(axis=1).sum()))
        scores = {"rmse": arrays.where(self.diverged, self._nothing + np.nan, rmse)}
        published = normalizing_baselines(self._experiment, band).get("rmse")
        if published is not None:
            scores["rmse_normalized"] = scores["rmse"] / published.mean
        return scores


def _check_scenes(stated: Experiment, scenes: Sequence[Scene]) -> None:
    """Raise an error for worlds that cannot run on a device."""
    is_position = stated.score.observable is Observable.POSITION
    if stated.scene.deformables or not is_position:
        raise UnsupportedSceneError(
            f"{stated.id}: worlds on a device are of rigid bodies whose positions are observed; leave out mode='device'"
        )
    if stated.trial is not None:
        raise ParameterError(f"{stated.id}: trials do not start worlds on a device")
    starts = {tuple(body.pose for body in scene.bodies) for scene in scenes}
    if len(starts) > 1:
        raise ParameterError(
            "world_parameters: worlds on a device differ in masses and contact constants alone"
        )
