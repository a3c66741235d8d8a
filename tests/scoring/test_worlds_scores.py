"""Scores of many worlds in one pass are those of each world."""

from __future__ import annotations

import numpy as np
import pytest

from gauge_envs.errors import ShapeError
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S, SAMPLES_PER_FRAME
from gauge_envs.scoring.reference import reference_band
from gauge_envs.scoring.score import score_trajectory
from gauge_envs.scoring.worlds import score_worlds

COUNT = 8


def worlds_of(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Smooth trajectories near the mean, with own releases, rates and offsets; shape [COUNT, sample_count, width]."""
    experiment = load_experiment(name)
    band = reference_band(experiment)
    assert band is not None
    random = np.random.default_rng(3)
    frames = SAMPLES_PER_FRAME * np.arange(len(band.mean))
    numbers = np.arange((experiment.frame_count - 1 + 10) * SAMPLES_PER_FRAME + 1)
    worlds = []
    for _ in range(COUNT):
        release, rate = random.normal(0.0, 12.0), random.normal(1.0, 0.05)
        columns = [
            np.interp(rate * (numbers - release), frames, np.nan_to_num(column))
            + random.normal(0.0, 3.0)
            for column in band.mean.T
        ]
        worlds.append(np.column_stack(columns) @ np.linalg.pinv(band.projection).T)
    return SAMPLE_INTERVAL_S * numbers, np.array(worlds)


@pytest.mark.parametrize(
    "name", ["SlopeSlider-2-wood", "BouncingBall-rubber", "SlopeSlider-1-wood"]
)
def test_each_world_has_the_score_of_its_trajectory(name: str) -> None:
    experiment = load_experiment(name)
    band = reference_band(experiment)
    times_s, values = worlds_of(name)
    together = score_worlds(experiment, band, times_s=times_s, values=values)
    for number in range(COUNT):
        single = score_trajectory(
            experiment, band, times_s=times_s, values=values[number], is_checked=True
        )
        # The scalar fit of the shift ends within 1e-7 s; here the minimum of each parabola is exact.
        for key, scores in together.items():
            tolerance = 2e-6 if key == "time_offset_s" else 1e-9
            assert scores[number] == pytest.approx(
                getattr(single, key), rel=1e-6, abs=tolerance
            ), key
    assert ("rmse_aligned" in together) == (single.rmse_aligned is not None)
    # The distance from a law is not divided by the scatter of real trials.
    assert ("rmse_normalized" in together) == band.kind.is_real


def test_a_world_that_ends_early_is_shifted_less() -> None:
    experiment = load_experiment("SlopeSlider-2-wood")
    band = reference_band(experiment)
    times_s, values = worlds_of(experiment.name)
    count = (experiment.frame_count - 1) * SAMPLES_PER_FRAME + 1 + 7
    values[1, count:] = np.nan
    together = score_worlds(experiment, band, times_s=times_s, values=values)
    single = score_trajectory(
        experiment,
        band,
        times_s=times_s[:count],
        values=values[1, :count],
        is_checked=True,
    )
    assert together["time_offset_s"][1] == pytest.approx(single.time_offset_s, abs=2e-6)
    assert together["rmse_aligned"][1] == pytest.approx(single.rmse_aligned, rel=1e-6)


def test_a_world_without_a_frame_has_no_score() -> None:
    experiment = load_experiment("SlopeSlider-2-wood")
    times_s, values = worlds_of(experiment.name)
    values[2, 30:] = np.nan
    together = score_worlds(
        experiment, reference_band(experiment), times_s=times_s, values=values
    )
    for scores in together.values():
        assert np.flatnonzero(np.isnan(scores)).tolist() == [2]


@pytest.mark.parametrize("change", ["width", "length"])
def test_arrays_that_do_not_agree_are_refused(change: str) -> None:
    experiment = load_experiment("SlopeSlider-2-wood")
    times_s, values = worlds_of(experiment.name)
    values = (
        values[:, :, :2]
        if change == "width"
        else values[:, :40]
        if change == "length"
        else values
    )
    times_s = times_s[: values.shape[1]]
    with pytest.raises(ShapeError):
        score_worlds(
            experiment, reference_band(experiment), times_s=times_s, values=values
        )
