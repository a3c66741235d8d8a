"""Panels of a film: episodes of engines with references, tracked points and their paths so far."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gauge_envs.envs.pictures import Pictures
from gauge_envs.evaluation.reference import reference_band
from gauge_envs.evaluation.reference_path import ReferencePath, reference_path
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.pages.results import (
    SCORE_METRICS,
    normalized_score,
    raw_score,
    scale_unit,
    score_interval,
)
from gauge_envs.pages.text import interval_text, score_text, with_unit
from gauge_envs.references.bands import Band
from gauge_envs.rendering.overlay import Overlay, between, tracked_overlay
from gauge_envs.runs.replay import (
    Replay,
    default_views_per_frame,
    load_or_replay,
    replayed_experiment,
)
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.film.layout import PanelText

PATH_STEP = 3
"""Samples between the points of a path, which are 60 a second."""

PATH_POINTS = 239
"""Points of a path; it shows the last four seconds."""

SHOWN_SCORES = 2
"""Number of scores below a panel."""


@dataclass(frozen=True, kw_only=True)
class Take:
    """An episode that can be drawn.

    Attributes:
        result: Its result.
        experiment: Its experiment, with the start that it had.
        replay: Where its bodies are.
        band: The band that it is compared with, or None.
        reference: Places of the band's mean in space; None where it has none.
    """

    result: Result
    experiment: Experiment
    replay: Replay
    band: Band | None
    reference: ReferencePath | None

    @property
    def last_s(self) -> float:
        """Time of the last view in which all bodies have a place [s]; an episode that diverged may have others."""
        replay = self.replay
        known = [
            np.isfinite(points).all(axis=(1, 2))
            for points in (replay.poses, *replay.nodes_m.values())
        ]
        is_known = np.logical_and.reduce(known)
        count = len(is_known) if is_known.all() else int(np.argmin(is_known))
        return max(count - 1, 0) / replay.rate_hz


def take_of(
    result: Result, file: Path, *, views_per_frame: int = 1, use_withheld: bool = False
) -> Take:
    """Run the episode of a result again and return what can be drawn of it.

    Args:
        result: Content of the result file.
        file: The result file.
        views_per_frame: Least number of views of rigid bodies in each frame: 1, 2, 3 or 6; deformable bodies have one.
        use_withheld: Whether to use also a band of low quality.
    """
    experiment = replayed_experiment(result)
    # The default is stored beside the result, so that it is run once.
    needs_more = (
        not experiment.scene.deformables
        and views_per_frame > default_views_per_frame(experiment.scene)
    )
    replay = load_or_replay(
        result, file, views_per_frame=views_per_frame if needs_more else None
    )
    band = reference_band(experiment, use_withheld=use_withheld)
    reference = reference_path(experiment, band)
    return Take(
        result=result,
        experiment=experiment,
        replay=replay,
        band=band,
        reference=reference,
    )


class SimulatedPanel:
    """Pictures of an episode.

    Args:
        take: The episode.
        title: Name of the engine and what distinguishes its configuration.
        detail: Versions.
        width: Width of the pictures [pixels].
        height: Height of the pictures [pixels].

    Attributes:
        text: What the panel shows.
        last_s: Time of its last picture [s].
    """

    def __init__(
        self, take: Take, *, title: str, detail: str, width: int, height: int
    ) -> None:
        self.text = PanelText(
            title=title, detail=detail, note=score_line(take.result, take.band)
        )
        self.last_s = take.last_s
        self._take = take
        self._rest_nodes_m = {
            name: points[0].astype(np.float64)
            for name, points in take.replay.nodes_m.items()
        }
        self._canvas = Pictures("rgb_array", width=width, height=height)

    def picture(self, time_s: float) -> NDArray[np.uint8]:
        """Return the picture at a time [s], shape [height, width, 3]; after its last view the episode stands still."""
        replay = self._take.replay
        at = min(time_s, self.last_s) * replay.rate_hz
        poses = dict(zip(replay.bodies, _poses_at(replay.poses, at), strict=True))
        nodes_m = {name: between(points, at) for name, points in replay.nodes_m.items()}
        picture = self._canvas.draw(
            self._take.experiment,
            self._rest_nodes_m,
            band=self._take.band,
            poses=poses,
            nodes_m=nodes_m,
            overlay=self.overlay(time_s, poses),
        )
        assert isinstance(picture, np.ndarray)
        return picture.astype(np.uint8, copy=False)

    def overlay(self, time_s: float, poses: dict[str, FloatArray]) -> Overlay:
        """Return what is drawn on top of the scene at a time.

        Args:
            time_s: The time [s].
            poses: Poses of the moving bodies at that time, shape [7] each.
        """
        replay = self._take.replay
        assert self._take.result.trajectory is not None
        times_s, samples = self._take.result.trajectory.arrays()
        shown_s = min(time_s, self.last_s)
        now = np.array([np.interp(shown_s, times_s, values) for values in samples.T])
        # Steps from the start, and not from the present, keep the points of a path where they are.
        past = samples[: np.searchsorted(times_s, shown_s)][::PATH_STEP][-PATH_POINTS:]
        return tracked_overlay(
            self._take.experiment,
            self._take.reference,
            time_s=time_s,
            samples=np.vstack([past, now]),
            markers_m=between(replay.markers_m, shown_s * FRAME_RATE_HZ),
            poses=poses,
        )

    def close(self) -> None:
        """Free the OpenGL context."""
        self._canvas.close()


def score_line(result: Result, band: Band | None) -> str:
    """Return the scores of a result in a line, the primary one first."""
    if result.outcome is Outcome.DIVERGED:
        return (
            f"diverged: {result.diverged_reason}"
            if result.diverged_reason
            else "diverged"
        )
    score = result.score
    texts = []
    for key in sorted(SCORE_METRICS, key=lambda key: key != score.primary):
        metric, raw, normalized = (
            SCORE_METRICS[key],
            raw_score(score, key),
            normalized_score(score, key),
        )
        if normalized is not None:
            text = interval_text(normalized, score_interval(score, key))
            texts.append(f"{metric.title} {with_unit(text, scale_unit(score, key))}")
        elif raw is not None:
            texts.append(
                f"{metric.title} {with_unit(score_text(raw), metric.unit_of(score.unit))}"
            )
    if texts:
        return ", ".join(texts[:SHOWN_SCORES])
    return "not scored" if band is None else "not scored: the reference is withheld"


# --- between views ---


def _poses_at(poses: NDArray[np.floating], at: float) -> FloatArray:
    """Return poses between two views, shape [body_count, 7]."""
    first = min(int(at), len(poses) - 1)
    pair = poses[first : first + 2].astype(np.float64)
    # A quaternion and its negative are the same orientation.
    opposite = (pair[0, :, 3:] * pair[-1, :, 3:]).sum(axis=1) < 0.0
    pair[-1, opposite, 3:] *= -1.0
    mixed = between(pair, at - first)
    mixed[:, 3:] /= np.linalg.norm(mixed[:, 3:], axis=1, keepdims=True)
    return mixed
