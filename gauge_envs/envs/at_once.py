"""Episodes of many worlds in shared arrays: they are observed, judged and rewarded at once.

A loop over worlds in Python costs more than an engine that steps thousands of them on one device. So the records of all
episodes are parts of two arrays, and each sample is one reading of all worlds. Every number is that of `Episode`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from gauge_envs.backends.device import HOST, DeviceWorlds, HostArrays
from gauge_envs.backends.registry import backend_for
from gauge_envs.backends.shared.resampled import worlds_in_intervals
from gauge_envs.backends.worlds import Worlds
from gauge_envs.envs.arguments import EnvArguments, check_support
from gauge_envs.envs.divergence import DeformableBoundsOfWorlds, RigidBoundsOfWorlds
from gauge_envs.envs.episode import Episode
from gauge_envs.envs.lockstep import AddInfo, EpisodesOneByOne, Numbers
from gauge_envs.envs.reward import bounded_reward, reward_terms
from gauge_envs.envs.spaces import Observation
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.observables.observer import MarkersOfWorlds, ObserverMarkers
from gauge_envs.references.band import Band
from gauge_envs.scene.driver_path import DriverPathOfWorlds
from gauge_envs.scene.geometry import BoolArray, FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLE_INTERVAL_S, SAMPLES_PER_FRAME


class EpisodesAtOnce(EpisodesOneByOne):
    """Episodes on worlds of an engine that advances all of them in one call: driven, observed and judged in arrays."""

    def __init__(self, episodes: Sequence[Episode], worlds: Worlds) -> None:
        super().__init__(episodes, worlds)
        first = episodes[0]
        experiment = first.experiment
        scenes = [episode.experiment.scene for episode in episodes]
        count = len(episodes)
        frame_count = experiment.frame_count
        self._recorded = experiment.recorded
        self._dynamic = tuple(body.name for body in scenes[0].dynamic_bodies)
        self._rows = [self._dynamic.index(name) for name in self._recorded]
        # The bounds of each deformable body, over the worlds.
        self._deformable_bounds = [
            DeformableBoundsOfWorlds(bounds)
            for bounds in zip(
                *(episode.deformable_bounds for episode in episodes), strict=True
            )
        ]
        observers = [
            one.observer
            for one in episodes
            if isinstance(one.observer, ObserverMarkers)
        ]
        self._markers = MarkersOfWorlds(observers, worlds) if observers else None
        driven_frames = frame_count + first.later_limit
        self._drivers = [
            DriverPathOfWorlds(driver, scenes, driven_frames)
            for driver in scenes[0].drivers
        ]
        self._driven = tuple(driver.body for driver in scenes[0].drivers)
        # Time comes first, so that a sample of all worlds is one block of memory.
        sample_count, width = first.sample_shape
        self._samples = np.full((sample_count, count, width), np.nan)
        self._bodies = np.full((frame_count, count, len(self._recorded), 13), np.nan)
        self._markers_m = np.full(
            (frame_count, count, *first.observer.markers_m.shape), np.nan
        )
        self._driver_states = np.full((count, len(self._driven), 13), np.nan)
        for number, episode in enumerate(episodes):
            episode.record_in(
                self._samples[:, number],
                self._bodies[:, number],
                self._markers_m[:, number],
            )
        self._every = np.arange(count)
        self._no_rates = np.zeros(
            (count, sum(driver.motion_count for driver in self._drivers))
        )
        self._shown = np.zeros(count, dtype=np.intp)
        # Worlds with other constants may have bands of their own.
        bands = {id(episode.band): episode.band for episode in episodes}
        self._rewards: list[tuple[BatchReward, BoolArray]] = []
        for key, band in bands.items():
            has_band = np.array([id(episode.band) == key for episode in episodes])
            is_bounded = episodes[0].is_reward_bounded
            self._rewards.append((BatchReward(band, is_bounded), has_band))
        self._frame = 0
        self._faults: dict[int, str] = {}
        self._diverged = np.zeros(count, dtype=np.bool_)
        self._is_behind = False

    @property
    def episodes(self) -> Sequence[Episode]:
        """The episode of each world."""
        if self._is_behind:
            self._is_behind = False
            for number, frame in enumerate(self._shown.tolist()):
                self._episodes[number].frame, self._episodes[number].fault = (
                    frame,
                    self._faults.get(number),
                )
        return self._episodes

    @property
    def running(self) -> Numbers:
        """Numbers of the worlds whose episodes are not over."""
        return (
            self.ran[:0]
            if self._frame == len(self._bodies) - 1
            else self.ran[~self._diverged[self.ran]]
        )

    def begin(self, seed: int) -> None:
        """Return all worlds to their starts, and record frame 0."""
        self.worlds.reset(seed)
        self.ran = self._every
        self._frame = 0
        self._faults = {}
        self._is_behind = False
        self._diverged[:] = False
        for driver in self._drivers:
            driver.reset()
        for episode in self._episodes:
            episode.restart()
        self._bounds = RigidBoundsOfWorlds(
            [episode.experiment.scene for episode in self._episodes]
        )
        states = self.worlds.body_states(self._dynamic)
        # As a single world reads its start; an engine may round a place otherwise than a state.
        self._samples[0] = (
            1e3 * states[:, self._rows, :3].reshape(len(states), -1)
            if self._markers is None
            else self._observed(0)
        )
        self._record(self._every, states)

    def step(self, actions: Any) -> None:
        """Run a frame of the episodes that are not over."""
        rates = self._batched_rates(actions)
        self.ran = running = self.running
        states, faults = self._simulated(running, self._frame, rates)
        self._frame += 1
        self._record(running, states)
        self._faults |= faults
        self._diverged[[*faults]] = True
        self._is_behind = True

    def _batched_rates(self, actions: Any) -> FloatArray:
        """Return the residual rates of all worlds, shape [world_count, motion_count]; 0 for those that do not run."""
        is_array = isinstance(actions, np.ndarray) and actions.dtype.kind in "fiu"
        # Episodes without drivers take zeros alone; any other action is an error, which its check states.
        if not self._drivers:
            if not (
                is_array and actions.shape == self._shown.shape and not actions.any()
            ):
                self._rates(actions)
            return self._no_rates
        running = self.running
        rates = np.zeros_like(self._no_rates)
        # A comparison with NaN is false.
        if (
            is_array
            and actions.shape == rates.shape
            and (np.abs(actions[running]) <= 1.0).all()
        ):
            rates[running] = actions[running]
        else:
            for number, one in self._rates(actions).items():
                rates[number] = one
        return rates

    def _simulated(
        self, running: Numbers, frame: int, rates: FloatArray
    ) -> tuple[FloatArray, dict[int, str]]:
        """Drive and advance all worlds from a frame to the next, and record g(t) of some.

        Returns:
            States of the dynamic bodies then, shape [world_count, body_count, 13], and the reason for each of those
            worlds that has diverged.
        """
        for sample in range(frame * SAMPLES_PER_FRAME, (frame + 1) * SAMPLES_PER_FRAME):
            first = 0
            for driver in self._drivers:
                motions = driver.interval(
                    sample, rates[:, first : first + driver.motion_count]
                )
                self.worlds.drive(driver.body, motions, self._every)
                first += driver.motion_count
            self.worlds.advance(SAMPLE_INTERVAL_S)
            g = self._observed(
                frame + 1
                if sample % SAMPLES_PER_FRAME == SAMPLES_PER_FRAME - 1
                else None,
                running,
            )
            # A whole block is copied faster than chosen rows.
            if len(running) == len(g):
                self._samples[sample + 1] = g
            else:
                self._samples[sample + 1, running] = g[running]
        states = self.worlds.body_states(self._dynamic)
        suspects = self._bounds.suspects(states)
        for bounds in self._deformable_bounds:
            suspects |= bounds.suspects(self.worlds.nodes(bounds.name))
        suspects[[*self.worlds.faults()]] = True
        found = {
            number: self._episodes[number].fault_of(states[number])
            for number in running[suspects[running]].tolist()
        }
        return states, {
            number: fault for number, fault in found.items() if fault is not None
        }

    def _observed(
        self, frame: int | None, running: Numbers | None = None
    ) -> FloatArray:
        """Return g(t) of all worlds now, shape [world_count, width]; record the markers of some at a frame, if any."""
        if self._markers is None:
            return 1e3 * self.worlds.body_positions(self._recorded).reshape(
                len(self._every), -1
            )
        markers_m = self._markers.positions()
        if frame is not None and frame < len(self._markers_m):
            chosen = slice(None) if running is None else running
            self._markers_m[frame, chosen] = markers_m[chosen]
        return self._markers.observed(markers_m)

    def _record(self, running: Numbers, states: FloatArray) -> None:
        """Record what the frame shows of some worlds."""
        self._bodies[self._frame, running] = states[running][:, self._rows]
        self._shown[running] = self._frame
        if self._driven:
            self._driver_states[running] = self.worlds.body_states(self._driven)[
                running
            ]

    def run_on(self) -> None:
        """Simulate on past the last frame, as `Episode.run_on` does for one world."""
        episodes = self.episodes
        started = running = np.flatnonzero([episode.runs_on for episode in episodes])
        if not len(running):
            return
        moving = (*self._dynamic, *self._driven)
        poses, counts = (
            self.worlds.body_states(moving)[:, :, :7],
            np.zeros(len(episodes), dtype=np.intp),
        )
        nodes = {
            bounds.name: self.worlds.nodes(bounds.name)
            for bounds in self._deformable_bounds
        }
        for number in started.tolist():
            view = {name: one[number].copy() for name, one in nodes.items()}
            episodes[number].begin_later_frame(
                (dict(zip(moving, poses[number], strict=True)), view)
            )
        for later in range(episodes[started[0]].later_limit):
            first = (self._frame + later) * SAMPLES_PER_FRAME + 1
            _, faults = self._simulated(
                running, int(self._frame) + later, self._no_rates
            )
            is_finite = np.isfinite(
                self._samples[first : first + SAMPLES_PER_FRAME, running]
            ).all(axis=(0, 2))
            running = running[is_finite & ~np.isin(running, [*faults])]
            counts[running] = later + 1
            if not len(running):
                break
        for number in started.tolist():
            episodes[number].count_later_frames(int(counts[number]))

    def observations(self) -> Observation:
        """Return the observations of all worlds in new arrays; a world whose episode is over keeps its last one."""
        every, shown = self._every, self._shown
        found = (
            {"bodies": self._bodies[shown, every]}
            if self._recorded
            else {"markers": self._markers_m[shown, every]}
        )
        if self._driven:
            found["driver"] = self._driver_states.copy()
        observable = self._samples[shown * SAMPLES_PER_FRAME, every]
        return found | {
            "observable": observable,
            "time": (shown / FRAME_RATE_HZ)[:, None],
        }

    def rewards(self) -> FloatArray:
        """Return the reward of each world in this frame, shape [world_count]; 0 for one that did not run."""
        rewards = np.zeros(len(self._every))
        g = self._samples[self._frame * SAMPLES_PER_FRAME]
        for reward, has_band in self._rewards:
            ran = self.ran[has_band[self.ran]]
            here = (
                1e3 * self._markers_m[self._frame, ran].reshape(len(ran), -1)
                if reward.has_points
                else g[ran]
            )
            rewards[ran] = reward.of(here, self._frame)
        return rewards

    def infos(self, add: AddInfo) -> dict[str, Any]:
        """Return the infos of the worlds that ran in the last step, which differ in their divergence alone."""
        ran = self.ran
        first = self._episodes[ran[0]]
        first.frame, first.fault = self._frame, None
        common = first.info()
        self._is_behind = True
        infos = add({}, common, int(ran[0]))
        for key in common:
            infos[key][ran], infos[f"_{key}"][ran] = infos[key][ran[0]], True
        for world in ran[self._diverged[ran]].tolist():
            infos = add(infos, {"diverged": self._faults[world]}, world)
        return infos

    def flags(self) -> tuple[BoolArray, BoolArray]:
        """Return terminations and truncations, shape [world_count] each."""
        return self._diverged.copy(), ~self._diverged & (
            self._frame == len(self._bodies) - 1
        )

    def trajectories(self) -> tuple[FloatArray, FloatArray]:
        """Return times [s] and g(t) of all worlds; samples that a world did not reach are NaN."""
        numbers = np.arange(len(self._samples))
        counts = np.array([episode.sample_count for episode in self.episodes])
        samples = np.where(
            (numbers[:, None] < counts)[:, :, None], self._samples, np.nan
        )
        return SAMPLE_INTERVAL_S * numbers.astype(np.float64), samples.transpose(
            1, 0, 2
        )


class BatchReward:
    """Rewards of many worlds against one band, with the bits of `Episode.reward` on the host.

    Args:
        band: The band, or None.
        is_bounded: Whether rewards are bounded.
        device: Where they are computed.

    Attributes:
        has_points: Whether the positions of markers are compared in place of g(t).
    """

    def __init__(
        self,
        band: Band | None,
        is_bounded: bool,
        device: DeviceWorlds | HostArrays = HOST,
    ) -> None:
        self._is_bounded = is_bounded
        self._arrays = device.arrays
        self.has_points = band is not None and band.points is not None
        self._projection = None
        self._terms: tuple[Any, Any] | None = None
        terms = reward_terms(band, is_bounded=is_bounded)
        if terms is None:
            return
        projection, mean, weight = terms
        # A product with the identity changes no bit of what is finite.
        if not np.array_equal(projection, np.eye(projection.shape[1])):
            self._projection = device.asarray(projection)
        self._terms = device.asarray(mean), device.asarray(weight)

    def of(self, g: Any, frame: int) -> Any:
        """Return the rewards of g(t), or of marker positions [mm], shape [world_count, coordinate_count]."""
        if self._terms is None:
            return self._arrays.zeros_like(g[:, 0])
        mean, weight = self._terms
        product = self._arrays.matmul
        if self._projection is not None:
            # A stack of matrix-vector products gives the bits of a single one; one matrix product would not.
            g = product(self._projection, g[:, :, None])[:, :, 0]
        deviations = self._arrays.abs(g - mean[frame])
        distances = product(deviations[:, None, :], weight[frame][:, None])[:, 0, 0]
        return bounded_reward(distances) if self._is_bounded else -distances


def episodes_in_lockstep(
    arguments: EnvArguments,
    experiments: Sequence[Experiment],
    bands: Sequence[Band | None],
    *,
    together: bool = True,
    worlds: Worlds | None = None,
) -> EpisodesOneByOne:
    """Build worlds and their episodes. They run at once if the engine and the experiment allow it.

    Args:
        arguments: Engine, settings and marker proxy; and the reference of worlds that start as a single-shot trial.
        experiments: The experiment of each world; they differ in starts and constants.
        bands: Band of each world, of its constants at their stated start. A single-shot trial has its own.
        together: Whether the engine may build the worlds as one simulation.
        worlds: Worlds at the starts of the experiments, which are built otherwise.
    """
    if worlds is None:
        for one in experiments:
            check_support(one, arguments.backend)
        engine = backend_for(arguments.backend, experiments[0].model_file)
        scenes = [one.scene for one in experiments]
        worlds = worlds_in_intervals(
            engine, scenes, arguments.settings, together=together
        )
    episodes = [
        Episode(
            one,
            world,
            band=band if one.trial is None else arguments.band(one),
            marker_proxy=arguments.proxy,
        )
        for one, band, world in zip(experiments, bands, worlds.worlds, strict=True)
    ]
    # Single-shot trials have a band each.
    if worlds.are_separate or experiments[0].trial is not None:
        return EpisodesOneByOne(episodes, worlds)
    return EpisodesAtOnce(episodes, worlds)
