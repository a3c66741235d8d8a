"""How closely an engine repeats the published scores of an engine, where the package has a reference of its own.

    python -m studies.published_scores.published_scores --backend newton --preset paper --engine newton
    python -m studies.published_scores.published_scores --backend mujoco --engine isaacsim --only "SlopeSlider-*"
    python -m studies.published_scores.published_scores --backend physx --preset paper --engine isaacsim --steps-late 1

Each row is a metric of a variant that has a published score of the engine and a score in this package. RMSE and DTW
need a band, and scores of a swing need none. A score within 3 % of the published one counts as repeated.
With `--steps-late`, each frame is read some steps of 1/180 s after its time, as by a loop that steps before it records
its first frame.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np

from gauge_envs import load_experiment, reference_band
from gauge_envs.errors import UnsupportedSceneError
from gauge_envs.evaluation.score import Score, score_trajectory
from gauge_envs.pages.results import normalized_score, raw_score
from gauge_envs.pages.text import markdown_row
from gauge_envs.references.grades import BandGrade
from gauge_envs.references.metrics import METRICS
from gauge_envs.references.published import (
    PUBLISHED_ENGINES,
    published_baselines,
    published_variants,
)
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest

TOLERANCE = 0.03
"""Largest difference from a published score, as a share of it, with which a score counts as repeated."""

COLUMNS = (
    "variant",
    "metric",
    "grade",
    "driver",
    "published",
    "reached",
    "reached / published",
    "within 3 %",
)


@dataclass(frozen=True, kw_only=True)
class Repeated:
    """A published score beside the score of the same variant here.

    Attributes:
        variant: Name of the variant.
        metric: Key of the metric.
        grade: Grade of the reference in this package.
        driver: Origin of the driven motion; None without driven bodies.
        published: Published normalized score of the engine; the raw score of a metric without normalization.
        reached: Score here; None if the episode has none.
    """

    variant: str
    metric: str
    grade: str
    driver: str | None
    published: float
    reached: float | None

    @property
    def ratio(self) -> float | None:
        """The reached over the published score; None without a score, or where the published one is 0."""
        return (
            None
            if self.reached is None or not self.published
            else self.reached / self.published
        )

    @property
    def is_repeated(self) -> bool:
        """Whether the score is within `TOLERANCE` of the published one."""
        return self.reached is not None and abs(
            self.reached - self.published
        ) <= TOLERANCE * abs(self.published)

    def cells(self) -> list[str]:
        """Return the cells of a row under `COLUMNS`."""
        return [
            self.variant,
            METRICS[self.metric].title,
            self.grade,
            self.driver or "-",
            f"{self.published:.4g}",
            "-" if self.reached is None else f"{self.reached:.4g}",
            "-" if self.ratio is None else f"{self.ratio:.3f}",
            "yes" if self.is_repeated else "no",
        ]


def comparable(
    engine: str, pattern: str = "*"
) -> Iterator[tuple[str, dict[str, float]]]:
    """Yield each variant with published scores that this package can measure too, and these scores by metric.

    Args:
        engine: Published engine, one of `PUBLISHED_ENGINES`.
        pattern: Shell-style pattern of variants.
    """
    for variant in published_variants():
        if not fnmatchcase(variant, pattern):
            continue
        experiment = load_experiment(variant)
        band = reference_band(experiment)
        # Published scores are distances from reality, and not from a solved model.
        has_distance = (
            band is not None
            and band.grade is not BandGrade.MODEL
            and band.normalized_by_baseline
        )
        scores = {
            metric: score
            for metric, line in published_baselines(variant).items()
            if (score := line.engines[engine]) is not None
            and (METRICS[metric].is_event or has_distance)
        }
        if scores:
            yield variant, scores


def late_score(request: RunRequest, steps_late: int) -> Score:
    """Run an undriven experiment and return its score with every frame read late.

    Args:
        request: The run.
        steps_late: Number of samples of 1/180 s by which each frame is late.
    """
    trajectory, experiment = run_episode(request).trajectory, request.experiment()
    assert trajectory is not None, "an episode that ran has a trajectory"
    times_s = np.array([*trajectory.times_s, *trajectory.later_times_s])
    values = np.array([*trajectory.samples, *trajectory.later_samples])
    band = reference_band(experiment)
    end = len(times_s) - steps_late
    return score_trajectory(
        experiment,
        band,
        times_s=times_s[:end],
        values=values[steps_late:],
        is_checked=True,
    )


def compare(
    backend: str,
    preset: str | None,
    engine: str,
    pattern: str = "*",
    *,
    steps_late: int = 0,
) -> Iterator[Repeated]:
    """Run each comparable variant and yield its scores beside the published ones.

    Args:
        backend: Engine of this package.
        preset: Its preset; None for the default of each scene.
        engine: Published engine, one of `PUBLISHED_ENGINES`.
        pattern: Shell-style pattern of variants.
        steps_late: As in `late_score`; if it is not 0, driven variants are left out.
    """
    for variant, published in comparable(engine, pattern):
        if steps_late and load_experiment(variant).scene.drivers:
            continue
        request = RunRequest(
            variant,
            backend=backend,
            settings=None if preset is None else {"preset": preset},
        )
        try:
            score = (
                late_score(request, steps_late)
                if steps_late
                else run_episode(request).score
            )
        except UnsupportedSceneError:
            score = None
        for metric, value in published.items():
            reached = None
            if score is not None:
                is_over = METRICS[metric].is_normalized
                read = normalized_score if is_over else raw_score
                reached = read(score, metric)
            yield Repeated(
                variant=variant,
                metric=metric,
                grade="-" if score is None else score.grade,
                driver=load_experiment(variant).driver_provenance,
                published=value,
                reached=reached,
            )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--backend", required=True, help="engine of this package")
    parser.add_argument(
        "--preset", help="preset of the engine; without it, the default of each scene"
    )
    parser.add_argument(
        "--engine",
        required=True,
        choices=tuple(PUBLISHED_ENGINES),
        help="published engine",
    )
    parser.add_argument(
        "--only", default="*", help="pattern of variants, as SlopeSlider-*"
    )
    parser.add_argument(
        "--steps-late",
        type=int,
        default=0,
        help="steps of 1/180 s by which frames are late",
    )
    given = parser.parse_args()
    print(markdown_row(COLUMNS))
    print(markdown_row(["---"] * len(COLUMNS)))
    for row in compare(
        given.backend,
        given.preset,
        given.engine,
        given.only,
        steps_late=given.steps_late,
    ):
        print(markdown_row(row.cells()), flush=True)


if __name__ == "__main__":
    main()
