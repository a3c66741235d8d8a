"""Scores of many worlds in one pass are those of each world."""

import numpy as np
import pytest

from gauge_envs.errors import ShapeError
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.scoring.reference import reference_band
from gauge_envs.scoring.trajectory import score_trajectory, score_worlds


@pytest.mark.parametrize(
    "name", ["SlopeSlider-2-wood", "SlopeSlider-1-wood", "SlopeSlider-3-metal"]
)
def test_each_world_has_the_score_of_its_trajectory(name):
    """The last world ends 7 samples after its last frame, so it is shifted less; one without a frame has no score."""
    experiment = load_experiment(name)
    band = reference_band(experiment)
    assert band is not None
    known = np.nan_to_num(band.mean)
    frames_s = np.arange(len(known)) / 30.0
    times_s = np.arange((experiment.frame_count + 9) * 6 + 1) / 180.0
    values = np.empty((5, len(times_s), 3))
    for number, world in enumerate(values):
        shown_s = (1.0 + 0.05 * number) * times_s - 0.07 * (number - 1)
        columns = [np.interp(shown_s, frames_s, column) for column in known.T]
        world[:] = number + np.column_stack(columns) @ np.linalg.pinv(band.projection).T
    count = (experiment.frame_count - 1) * 6 + 8
    values[3, count:] = np.nan
    values[4, 30:] = np.nan
    together = score_worlds(experiment, band, times_s=times_s, values=values)
    for number in range(4):
        end = count if number == 3 else None
        single = score_trajectory(
            experiment,
            band,
            times_s=times_s[:end],
            values=values[number, :end],
            is_checked=True,
        )
        # The scalar fit of the shift ends within 1e-7 s; here the minimum of each parabola is exact.
        for key, scores in together.items():
            tolerance = 2e-6 if key == "time_offset_s" else 1e-9
            expected = pytest.approx(getattr(single, key), rel=1e-6, abs=tolerance)
            assert scores[number] == expected, key
    assert all(np.isnan(scores[4]) for scores in together.values())
    # The distance from a law is not divided by the scatter of real trials.
    assert ("rmse_normalized" in together) == (not band.kind.is_solution)
    assert ("rmse_aligned" in together) == (name == "SlopeSlider-2-wood")
    for wrong in (values[:, :, :2], values[:, :-1]):
        with pytest.raises(ShapeError):
            score_worlds(experiment, band, times_s=times_s, values=wrong)
