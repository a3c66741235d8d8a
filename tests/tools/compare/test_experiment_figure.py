"""The page of one experiment: it fits on a screen, its curves are those of the scores, and no question is mixed."""

from __future__ import annotations

import struct
from dataclasses import replace

import numpy as np
import pytest
from places import one_of_a_kind

from gauge_envs import load_experiment, reference_band
from gauge_envs.experiments.task_files import task_sha256
from gauge_envs.experiments.variants import find_variant, variants
from gauge_envs.pages.text import QUESTIONS
from gauge_envs.references.kind import Kind
from gauge_envs.runs.result import Outcome, RecordedTrajectory, Result
from gauge_envs.scoring.score import Score, score_trajectory
from gauge_envs.tools.compare.experiment_figure import draw_experiment, save_figures

MOST_PIXELS = 1600
IDS = [variant.id.removeprefix("GAUGE/") for variant in variants()]
FLING, BALL, WALL = (
    "TextileFlinging-nylon",
    "BouncingBall-rubber",
    "WallBreaking-wood",
)


def motion_of(experiment, band):
    """The mean of the reference at 180 Hz, held where it is not known, or no motion at all."""
    count = (experiment.frame_count - 1) * 6 + 1
    times_s = np.arange(count) / 180
    values = np.zeros((count, len(experiment.coordinates)))
    if band is not None:
        known = np.isfinite(band.mean).all(axis=1)
        frames_s = np.arange(len(band.mean)) / 30
        means = [
            np.interp(times_s, frames_s[known], column[known]) for column in band.mean.T
        ]
        values = np.column_stack(means) @ np.linalg.pinv(band.projection).T
    return times_s, values


def markers_of(experiment, band):
    """Markers at the frames [m]: on the reference, held where it is not known, or at rest."""
    markers = experiment.scene.markers
    if markers is None:
        return None
    start = np.array(markers.positions_m)
    places = np.repeat(start[None], experiment.frame_count, axis=0)
    if band is not None and band.points is not None:
        mean = 1e-3 * band.points.mean.reshape(places.shape)
        places = np.where(np.isfinite(mean), mean, places)
    return places


def made(name, *, backend="mujoco", change=None, markers_change=None):
    """A result that follows the reference but for changes, as an engine would leave it, with its score."""
    experiment = load_experiment(name)
    band = reference_band(experiment)
    times_s, values = motion_of(experiment, band)
    values = values if change is None else values + change(times_s, values)
    markers = markers_of(experiment, band)
    if markers is not None and markers_change is not None:
        markers = markers + markers_change(markers)
    score = score_trajectory(
        experiment,
        band,
        times_s=times_s,
        values=values,
        markers_m=markers,
        is_checked=True,
    )
    return result_of(experiment, score, times_s, values, markers, backend=backend)


def result_of(experiment, score, times_s, values, markers, *, backend):
    return Result(
        id=experiment.id,
        outcome=Outcome.FINISHED,
        parameters="calibrated",
        score=score,
        task_sha256=task_sha256(find_variant(experiment.id).family),
        revision=experiment.revision,
        backend=backend,
        frames=experiment.frame_count,
        trajectory=RecordedTrajectory.of(experiment, times_s, values, markers),
    )


def quick(name, *backends):
    """Results of one motion with a score of its kind alone."""
    experiment = load_experiment(name)
    band = reference_band(experiment)
    times_s, values = motion_of(experiment, band)
    values = values + times_s[:, None] * np.linspace(0.1, 1.0, values.shape[1])
    kind = (Kind.NONE if band is None else band.kind).value
    score = Score(kind=kind, unit=experiment.score.observable.unit)
    markers = markers_of(experiment, band)
    one = result_of(experiment, score, times_s, values, markers, backend=backends[0])
    return [replace(one, backend=backend) for backend in backends]


def texts_of(artist):
    """Texts of a figure without those of its ticks, which are slow to make."""
    from matplotlib.axis import Axis
    from matplotlib.text import Text

    if isinstance(artist, Text):
        return [artist.get_text()] if artist.get_text() else []
    parts = [artist.label] if isinstance(artist, Axis) else artist.get_children()
    return [text for part in parts for text in texts_of(part)]


def curve_of(figure, label):
    (line,) = [line for line in figure.axes[0].get_lines() if line.get_label() == label]
    return np.asarray(line.get_ydata(), dtype=float)


def png_size(file):
    return struct.unpack(">II", file.read_bytes()[16:24])


def kind_of(name):
    """What a page depends on: what is observed, how many coordinates it has, and its reference."""
    experiment = load_experiment(name)
    band = reference_band(experiment)
    kind = None if band is None else band.kind
    return experiment.score.observable, len(experiment.coordinates), kind


@pytest.mark.parametrize("name", one_of_a_kind(IDS, kind_of))
def test_a_page_fits_on_a_screen_and_answers_one_question(name):
    results = quick(name, "mujoco", "newton")
    figure = draw_experiment(results)
    assert round(figure.get_figheight() * 120) <= MOST_PIXELS
    kind = Kind(results[0].score.kind)
    texts = texts_of(figure)
    asked = [text for text in texts for one in QUESTIONS.values() if one in text]
    assert any("Distance from" in text for text in texts)
    if kind is Kind.NONE:
        assert asked == []
        return
    question = "verification" if kind.is_solution else "validation"
    assert QUESTIONS[question] in asked[0]
    # Curves, shades and their legends are of that question; events have bars of their own.
    curves = [
        label for axis in figure.axes for label in axis.get_legend_handles_labels()[1]
    ]
    mixed = "real" if kind.is_solution else " u "
    assert not any(mixed in label for label in curves)


@pytest.mark.parametrize("name", [FLING, WALL])
def test_the_file_is_as_high_as_the_page(name, tmp_path):
    results = quick(name, "mujoco", "newton", "physx")
    (file,) = save_figures(results, tmp_path)
    width, height = png_size(file)
    assert width == 1440
    assert height <= MOST_PIXELS


def test_the_first_curve_of_a_solution_is_its_distance_and_its_parts_are_named():
    def lift(markers):
        change = np.zeros_like(markers)
        change[1:, 5, 2] = 0.03
        return change

    result = made(FLING, markers_change=lift)
    figure = draw_experiment([result])
    curve = curve_of(figure, "mujoco, calibrated")
    found = result.score.distance
    assert np.sqrt(np.nanmean(curve**2)) == pytest.approx(found, rel=1e-3)
    # 30 mm of one marker of 63, root mean square over them; positions in files have four digits.
    assert np.nanmax(curve) == pytest.approx(30.0 / np.sqrt(63), rel=1e-3)
    assert "marker 5, z [mm]: 100 %" in [
        axis.get_title(loc="left") for axis in figure.axes
    ]


def test_the_first_curve_of_a_release_is_aligned_and_so_are_the_trials_below_it():
    early_s = 0.05

    def hasten(times_s, values):
        columns = [np.interp(times_s + early_s, times_s, one) for one in values.T]
        return np.column_stack(columns) - values + 4.0

    result = made(BALL, change=hasten)
    figure = draw_experiment([result])
    score = result.score
    assert score.time_offset_s == pytest.approx(early_s, abs=0.005)
    label = f"mujoco, calibrated, moved by {score.time_offset_s:+.3f} s to align the release"
    curve = curve_of(figure, label)
    assert np.sqrt(np.mean(curve**2)) == pytest.approx(score.rmse_aligned, rel=0.02)
    # Below it, up to where a score is 1.
    reach = reference_band(load_experiment(BALL)).trial_rmse_aligned.mean()
    shade = figure.axes[0].collections[0].get_paths()[0].vertices[:, 1].max()
    assert shade == pytest.approx(reach)


def test_a_picture_needs_one_experiment():
    with pytest.raises(ValueError, match="one experiment"):
        draw_experiment([])
