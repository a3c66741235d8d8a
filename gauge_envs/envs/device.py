"""Worlds of one experiment on an engine's device, for learners there: no step copies anything to the host.

`gymnasium.make_vec(id, num_envs=4096, backend=..., mode="device")` makes a `DeviceVectorEnv`. Commands, driven motions,
starts, observations, rewards, flags and scores are arrays of the engine's library. The Python calls of a step do not
depend on the number of worlds.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from gauge_envs.backends.base import worlds_of
from gauge_envs.backends.device import DeviceWorlds
from gauge_envs.backends.registry import backend_for
from gauge_envs.envs.arguments import EnvArguments, drawn_seed
from gauge_envs.envs.at_once import BatchReward
from gauge_envs.envs.divergence import RigidBoundsOfWorlds
from gauge_envs.envs.episode import Episode
from gauge_envs.envs.vector import GaugeVectorEnv
from gauge_envs.errors import EpisodeError, ParameterError, UnsupportedSceneError
from gauge_envs.evaluation.worlds import score_samples
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.observables.kinds import Observable
from gauge_envs.references.bands import Band
from gauge_envs.scene.driver_path import DriverPathInArrays, motor_commands
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.jitter import Jitter, jittered
from gauge_envs.scene.scene import Scene
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLE_INTERVAL_S, SAMPLES_PER_FRAME

START_COUNT = 1024
"""Smallest number of random starts from which episodes draw theirs."""


class DeviceVectorEnv(GaugeVectorEnv):
    """Worlds of one experiment of rigid bodies in arrays of the engine's device.

    It has the spaces, the starts, the rewards and the scores of `GaugeVectorEnv`, but for rounding in the engine's
    precision. What differs:

    - Observations, rewards, terminations, truncations and scores are arrays of the engine's library. Actions may be;
      they are clipped to -1 and 1.
    - All worlds run to the last frame of the experiment, and start their next episode in the step after it, also with
      random starts. A world that diverges is terminated from then on and keeps its observation; its reward is 0, and
      its scores are NaN. No reason is given.
    - A reset draws a random start for each world, and for 1,024 at least. Each later episode takes one of them
      in each world, without repetition among the worlds.
    - `infos` has `frame` and `time_s`, and at the last frame the arrays of `GaugeVectorEnv.score_arrays`.
    - There are no pictures, trials, or records of single worlds.

    Args:
        variant: Name of the variant, as `SlopeSlider-2-wood`.
        num_envs: Number of worlds.
        **arguments: Other arguments of `GaugeVectorEnv`.

    Raises:
        UnsupportedSceneError: The experiment has deformable bodies, or observes no positions.
        BackendError: The engine has no arrays on a device.
    """

    _lockstep: EpisodesOnDevice  # type: ignore[assignment]  # the parent's other methods that need records raise

    def _build(self, experiments: Sequence[Experiment]) -> None:
        if self.render_mode is not None:
            raise ParameterError("render_mode: worlds on a device have no pictures")
        self._lockstep = EpisodesOnDevice(
            self.arguments, experiments, self.experiment, self.band
        )
        self._starts_m: Any = None
        self._order = np.random.default_rng(0)
        self._is_reset = False

    @property
    def worlds_on_device(self) -> DeviceWorlds:
        """The worlds in arrays of the device."""
        return self._lockstep.device

    def reset(
        self,
        *,
        seed: int | Sequence[int] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start a new episode in every world.

        Args:
            seed: As for `GaugeVectorEnv.reset`; None draws seeds where starts scatter.
            options: `{"jitter": ...}`, as for `GaugeEnv.reset`; it holds for the next episodes.
        """
        self._check_open("reset")
        jitter = self._starts.of_reset(options, seeded=seed is not None)
        if not isinstance(jitter, Jitter | None):
            raise ParameterError(
                f"{self.experiment.id}: trials do not start worlds on a device"
            )
        stated = [None] * self.num_envs if seed is None else self._seeds(seed)
        seeds = [drawn_seed(one, jitter, self._order) for one in stated]
        self._order = np.random.default_rng(seeds[0])
        self.seeds_used, self.jitter = tuple(seeds), jitter
        self._starts_m = None
        if jitter is not None:
            later = range(seeds[-1] + 1, seeds[-1] + 1 + START_COUNT - len(seeds))
            scene = self.experiment.scene
            starts = [
                dynamic_states(jittered(scene, jitter, seed=one))
                for one in (*seeds, *later)
            ]
            self._starts_m = self._lockstep.device.asarray(np.stack(starts))
        self._is_reset = True
        return self._begin(np.arange(self.num_envs))

    def _begin(self, order: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start an episode in all worlds, from random starts of some numbers if starts scatter."""
        starts = self._starts_m
        if starts is not None:
            starts = starts[self._lockstep.device.asarray(order)]
        self._lockstep.start(starts)
        return self._lockstep.observation(), self._lockstep.info()

    def step(
        self, actions: Any
    ) -> tuple[dict[str, Any], Any, Any, Any, dict[str, Any]]:
        """Simulate one frame, 1/30 s, in every world; after the last one, start the next episode of all instead.

        Args:
            actions: Actions of all worlds, shape [num_envs, ...]; on the device, or a NumPy array.
        """
        self._check_started("step", started=self._is_reset)
        episodes = self._lockstep
        if episodes.is_complete:
            count = self.num_envs if self._starts_m is None else len(self._starts_m)
            order = self._order.choice(count, self.num_envs, replace=False)
            observation, info = self._begin(order)
            return observation, *episodes.nothing(), info
        rewards = episodes.advance(actions)
        over = (episodes.diverged, episodes.truncations())
        return episodes.observation(), rewards, *over, episodes.info()

    def _refuse(self, call: str) -> EpisodeError:
        return EpisodeError(
            f"{self.experiment.id}: {call} needs a record, which stays on the device; infos has scores at the end"
        )

    def scores(self) -> tuple[Any, ...]:
        """Raise an error."""
        raise self._refuse("scores")

    def score_arrays(self) -> dict[str, Any]:
        """Raise an error."""
        raise self._refuse("score_arrays")

    def deformations(self) -> tuple[Any, ...]:
        """Raise an error."""
        raise self._refuse("deformations")


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
            backend=arguments.default_backend,
        )
        self.episodes = [first]
        self._experiment, self._band = stated, band
        self._last_frame = stated.frame_count - 1
        self._later_frames = first.later_limit
        self._recorded = tuple(stated.recorded)
        self._dynamic = tuple(body.name for body in scene.dynamic_bodies)
        self._driven = tuple(driver.body for driver in scene.drivers)
        frame_count = stated.frame_count + self._later_frames
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
        commands = motor_commands(scene, frame_count * SAMPLES_PER_FRAME)
        self._commands = device.asarray(commands) if commands.size else None
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
            if self._commands is not None:
                row = self._commands[number : number + 1]
                shape = (len(self._nothing), row.shape[1])
                self.device.command(self.device.arrays.broadcast_to(row, shape))
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
        if self.is_complete and self._band is not None:
            # The release alignment compares the motion after the last frame too.
            for later in range(self._later_frames):
                self._simulate(self._frame + later, self._no_rates)
            scores = score_samples(
                self._experiment, self._band, self._samples, self.device
            )
            where = self.device.arrays.where
            missing = self._nothing + np.nan
            info |= {
                name: where(self.diverged, missing, values)
                for name, values in scores.items()
            }
        return info


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
