"""The picture of one experiment fits on a screen, and its curves agree with the scores."""

import numpy as np
import pytest
from matplotlib.colors import to_hex

from gauge_envs import load_experiment, reference_band
from gauge_envs.pages.figures import OURS
from gauge_envs.references.kind import Kind
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Outcome, RecordedTrajectory, Result
from gauge_envs.scoring.score import Score
from gauge_envs.tools.compare.experiment_figure import (
    VALIDATION,
    VERIFICATION,
    draw_experiment,
    save_figures,
)


def drifting(name, *, speed=1.0, refused=None, **changes):
    """Return a result without a score; its coordinates grow and one marker is 30 mm too high."""
    experiment = load_experiment(name)
    band = reference_band(experiment)
    times_s = np.arange((experiment.frame_count - 1) * 6 + 1) / 180
    values = np.zeros((len(times_s), len(experiment.coordinates)))
    values[:, 0] = speed * times_s
    markers_m = None
    if experiment.scene.markers is not None:
        start_m = np.array(experiment.scene.markers.positions_m)
        markers_m = np.repeat(start_m[None], experiment.frame_count, axis=0)
        if band is not None and band.points is not None:
            mean_m = 1e-3 * band.points.mean.reshape(markers_m.shape)
            markers_m = np.where(np.isfinite(mean_m), mean_m, markers_m)
        markers_m[1:, 0, 2] += 0.03
    kind = Kind.NONE if band is None else band.kind
    values = {
        "id": experiment.id,
        "outcome": Outcome.FINISHED,
        "parameters": "published",
        "score": Score(kind=kind.value, unit="mm", refused=refused),
        "task_sha256": "",
        "revision": experiment.revision,
        "backend": "mujoco",
        "trajectory": RecordedTrajectory.of(experiment, times_s, values, markers_m),
    }
    return Result(**(values | changes))


def curves_of(figure):
    """Return the curves of results in the panel of distances."""
    return [
        np.asarray(line.get_ydata(), dtype=float)
        for line in figure.axes[0].get_lines()
        if to_hex(line.get_color()) in OURS
    ]


def legend_of(figure):
    return [text.get_text() for text in figure.axes[0].get_legend().get_texts()]


@pytest.mark.parametrize("name", ["SlopeSlider-2-wood", "Turntable-1-wood"])
def test_the_curve_of_a_result_is_its_distance(name, tmp_path):
    result = run_episode(RunRequest(name))
    figure = draw_experiment([result])
    assert figure.get_figheight() * 120 <= 1600
    is_solution = name == "Turntable-1-wood"
    question = VERIFICATION if is_solution else VALIDATION
    assert question in figure.get_suptitle()
    (curve,) = curves_of(figure)
    root_mean_square = np.sqrt(np.nanmean(np.square(curve)))
    # Aligned after a release.
    assert root_mean_square == pytest.approx(result.score.distance, rel=1e-3)
    if result.score.primary == "rmse_aligned":
        assert any("shifted by +0.00" in text for text in legend_of(figure))
        # The shaded area ends at a score of 1.
        height_mm = reference_band(load_experiment(name)).trial_rmse_aligned.mean()
        shade = figure.axes[0].collections[0].get_paths()[0].vertices[:, 1].max()
        assert shade == pytest.approx(height_mm)
    (file,) = save_figures([result], tmp_path)
    assert file.name == f"{name}.png"


def test_the_distance_of_markers_is_their_root_mean_square():
    figure = draw_experiment([drifting("TextileFlinging-nylon")])
    (curve_mm,) = curves_of(figure)
    # One of 63 markers is 30 mm off; positions in files have four digits.
    assert np.nanmax(curve_mm) == pytest.approx(30.0 / np.sqrt(63), rel=1e-3)
    titles = [axis.get_title(loc="left") for axis in figure.axes]
    assert "marker 0, z [mm]: 100% of the squared distance" in titles


def test_engines_without_a_reference_are_drawn_by_their_distance():
    name, refused = "SlopeSlider-3-wood", "no score: it differs"
    still = drifting(name, speed=0.0, refused=refused)
    repeats = [
        drifting(name, speed=60.0, refused=refused, backend="newton", seed=seed)
        for seed in range(3)
    ]
    figure = draw_experiment([still, *repeats])
    curves_mm = curves_of(figure)
    assert len(curves_mm) == 3
    frames_s = np.arange(len(curves_mm[0])) / 30
    assert curves_mm[0] == pytest.approx(60.0 * frames_s, abs=1e-9)
    assert "newton, 3 repeats" in legend_of(figure)
