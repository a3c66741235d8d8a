"""Scores of clips and tracks whose motion is known, planted faults, and the commands."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

cv2 = pytest.importorskip("cv2")

from clips import clip, driven, track_of, written  # noqa: E402
from scipy import stats  # noqa: E402

from gauge_envs.errors import VideoError  # noqa: E402
from gauge_envs.tools.video import (  # noqa: E402
    law_share,
    read_track,
    save_track,
    score,
    score_track,
    video_task,
    video_tasks,
)
from gauge_envs.tools.video.frames import FileFrames  # noqa: E402
from gauge_envs.tools.video.report import (  # noqa: E402
    find_videos,
    results_table,
    summary_table,
    table_csv,
    table_latex,
)
from gauge_envs.tools.video.tasks import published_results  # noqa: E402

SLIDE, BALL = video_task("SlopeSlider-2-wood"), video_task("BouncingBall-rubber")
PLATE, CRADLE = video_task("Turntable-2-metal"), video_task("NewtonsCradle-metal")
PENDULUM = video_task("Pendulum-metal")

TOLERANCE = {
    "acceleration_m_s2": {"rel": 0.02},
    "pd": {"rel": 0.01},
    "mte": {"abs": 0.02},
    "de": {"abs": 0.01},
    "r2": {"abs": 0.01},
}


def check_metrics(metrics, truth):
    """Check all metrics whose truth is known."""
    for name, value in truth.items():
        assert metrics[name] == pytest.approx(value, **TOLERANCE[name]), name


# --- films -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("task", "metric", "power", "seed"),
    [
        (SLIDE.id, "acceleration_m_s2", 2.0, 104),
        (BALL.id, "acceleration_m_s2", 2.0, 105),
        (PENDULUM.id, "pd", -1.0, 104),
    ],
)
def test_the_interval_of_a_film_contains_the_truth_and_a_wrong_rate_is_named(
    task, metric, power, seed
):
    film = clip(task, np.random.default_rng(seed), fps=20.0)
    result, truth = score(film.frames, film.fps, task), film.truth[metric]
    low, high = result.uncertainty[metric]
    assert result.is_sound, result.reasons
    assert low <= truth <= high and high - low < 0.05 * truth
    # At twice the rate the motion needs four times gravity.
    fast = score(film.frames, 2.0 * film.fps, task)
    assert fast.metrics[metric] == pytest.approx(2.0**power * truth, rel=0.02)
    assert any("the frame rate may be wrong" in text for text in fast.findings)


@pytest.mark.slow
@pytest.mark.parametrize("task", [task.id for task in video_tasks()])
def test_intervals_contain_the_truth(task):
    contained = []
    for seed in range(20):
        # The standard uncertainty of the scale is 0.65 % for cubes and balls alike.
        film = clip(task, np.random.default_rng(seed), calibration_sigma=0.0065)
        result = score(film.frames, film.fps, task)
        assert result.is_sound, (seed, result.reasons)
        check_metrics(result.metrics, film.truth)
        # A fit of noisy places explains less than all of them, so R^2 has no true value of 1.
        for name in film.truth.keys() - {"r2"}:
            low, high = result.uncertainty[name]
            contained.append(low - 1e-12 <= film.truth[name] <= high + 1e-12)
    assert np.mean(contained) >= 0.9


# --- tracks ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("is_metric", [False, True])
def test_a_track_from_a_file_is_scored_like_a_video(is_metric, tmp_path):
    track = driven(SLIDE.id, 1.7)
    if is_metric:
        # In millimetres from any place, to the right and up.
        along_px = (track.points_px - SLIDE.centre_px) * [1.0, -1.0]
        places_mm = 1e3 * SLIDE.scale_m_per_px * along_px + 100.0
        track = replace(track, points_px=places_mm, is_metric=True)
    result = score_track(read_track(save_track(track, tmp_path / "a.csv")), SLIDE)
    assert result.metrics["acceleration_m_s2"] == pytest.approx(1.7, rel=2e-3)
    low, high = result.uncertainty["acceleration_m_s2"]
    assert low < 1.7 < high
    assert result.is_sound


@pytest.mark.parametrize(
    ("task", "along_mm"),
    [(SLIDE, (-400.0, 250.0)), (PENDULUM, (20.0, 300.0)), (PENDULUM, (0.02, -0.3))],
)
def test_a_track_in_other_axes_or_in_metres_is_an_error(task, along_mm):
    places_mm = np.linspace(0.7, 1.0, 40)[:, None] * along_mm
    track = replace(track_of(places_mm, 30.0), is_metric=True)
    with pytest.raises(VideoError, match="x_mm and y_mm are in millimetres"):
        score_track(track, task)


def test_the_paper_counts_whole_pixels_and_time_from_the_first_retained_frame(tmp_path):
    track = read_track(save_track(driven(SLIDE.id, 1.7), tmp_path / "a.csv"))
    result = score_track(track, SLIDE)
    first, last = result.interval_frames
    whole_px = np.floor(track.points_px[first : last + 1])
    along_m = whole_px @ np.array(SLIDE.direction) * SLIDE.scale_m_per_px
    since_s = (track.times_s - track.times_s[first])[first : last + 1]
    # The cube of 50 mm is 60 pixels wide.
    assert SLIDE.scale_m_per_px == 0.05 / 60.0
    slope = np.polyfit(since_s**2, along_m, 1)[0]
    assert result.metrics["a"] == pytest.approx(2.0 * slope, rel=1e-9)


@pytest.mark.parametrize("task", [SLIDE, BALL, PLATE, CRADLE, PENDULUM])
def test_an_object_that_rests_has_a_track_and_no_physics(task):
    noise_px = np.random.default_rng(0).normal(0.0, 0.3, (60, 2))
    rest = track_of((task.rest_px or task.centre_px) + noise_px, 24.0)
    result = score_track(rest, task)
    assert result.is_sound, result.reasons
    assert result.findings == ("no motion is found",)
    assert set(result.metrics.values()) == {None}
    assert law_share(result, task) == 0.0


@pytest.mark.parametrize(
    ("field", "later", "words"),
    [
        ("size_ratio", 1.4, "its size by up to +40% in frames 15 to"),
        ("other_likeness", 0.9, "a second object of the same shape and colour"),
    ],
)
def test_an_object_that_changes_has_no_sound_track(field, later, words):
    track = driven(SLIDE.id, 1.7)
    values = np.where(np.arange(40) < 15, getattr(track, field), later)
    result = score_track(replace(track, **{field: values}), SLIDE)
    assert not result.is_sound and words in result.reasons[0]
    assert result.metrics["acceleration_m_s2"] == pytest.approx(1.7, rel=2e-3)
    assert law_share(result, SLIDE) == 0.0


def test_a_cube_that_breaks_the_law_has_a_sound_track_until_it_may_be_another_cube():
    angles = 0.03 * np.arange(60)
    circle = np.column_stack([np.cos(angles), np.sin(angles)])
    lawful_px = np.array(PLATE.pivot_px) - 130.0 * circle
    slips = [np.where(np.arange(60) < 36, 0.0, px) for px in (0.0, 39.0, 130.0)]
    ride, slip, jump = (
        score_track(track_of(lawful_px + np.outer(px, [1.0, 0.0]), 24.0), PLATE)
        for px in slips
    )
    assert ride.is_sound and ride.metrics["de"] == 0.0 and law_share(ride, PLATE) == 1.0
    assert slip.is_sound and slip.metrics["de"] > 0.05
    assert not jump.is_sound and "jumps" in jump.reasons[0]
    still_px = lawful_px[0] + 0.3 * (lawful_px - lawful_px[0])
    still = score_track(track_of(still_px, 24.0), PLATE)
    assert "says little" in still.findings[-1] and law_share(still, PLATE) == 0.0


def test_momentum_transfer_follows_from_the_heights_of_the_swings():
    swing, rest = np.sin(np.pi * np.arange(1, 12) / 12.0), np.full(12, np.nan)
    angles_rad = np.r_[rest, swing, rest, 0.8 * swing, rest]
    arm_px = np.subtract(CRADLE.rest_px, CRADLE.pivot_px)[1]
    directions = np.column_stack([np.sin(angles_rad), np.cos(angles_rad)])
    track = track_of(CRADLE.pivot_px + arm_px * directions, 24.0)
    result = score_track(track, CRADLE)
    heights_m = arm_px * CRADLE.scale_m_per_px * (1.0 - np.cos([1.0, 0.8]))
    transfers = np.sqrt(heights_m / CRADLE.release_height_m)
    assert result.is_sound
    assert result.metrics["mte"] == pytest.approx(transfers.mean(), abs=0.02)


def test_the_law_share_of_a_fall_is_the_smaller_ratio():
    for a_m_s2, share in ((9.81, 1.0), (0.5 * 9.81, 0.5), (2.0 * 9.81, 0.5)):
        track = driven(BALL.id, a_m_s2, fps=60.0, release_s=0.0)
        # In whole pixels the release of the slow fall is a frame later, by 5 % of its acceleration.
        assert law_share(score_track(track, BALL), BALL) == pytest.approx(
            share, abs=0.03
        )


# --- published values ------------------------------------------------------------------------------------------------


def test_published_values_are_those_of_the_table():
    published = published_results()
    assert published["seedance2"]["Pendulum-metal"]["pd"] == 3.13
    assert published["wan22"]["NewtonsCradle-metal"] == {}
    assert SLIDE.law == {"a": 2.58, "qfi": 0.0}
    assert SLIDE.real["a"] == pytest.approx((2.719, 0.038), abs=5e-4)


# --- commands --------------------------------------------------------------------------------------------------------


def test_the_command_scores_a_file_and_draws_the_track(tmp_path, gauge):
    film = clip("SlopeSlider-2-metal", np.random.default_rng(11))
    written(film, tmp_path / "slide.mp4")
    command = f"video score slide.mp4 --id {film.task} --json --out drawn"
    outcome = gauge(*command.split())
    assert outcome.exit_code == 0, outcome.output
    line = json.loads(outcome.stdout)
    assert line["is_sound"] and line["registration"]["method"] == "stretch"
    check_metrics(line["metrics"], film.truth)
    drawn = FileFrames(tmp_path / "drawn" / "slide.overlay.mp4")
    assert sum(1 for _ in drawn.pictures()) == len(film.frames)
    # The written track, and a track in pixels of a smaller video of its name, are scored as the video.
    saved = tmp_path / "drawn" / "slide.track.csv"
    small = [cv2.resize(frame, (416, 240)) for frame in film.frames[:2]]
    written(replace(film, frames=small), tmp_path / "small.mp4")
    rows = [
        f"{row['time']},{0.5 * float(row['x_grid'])},{0.5 * float(row['y_grid'])}"
        for row in csv.DictReader(saved.open())
    ]
    (tmp_path / "small.csv").write_text("\n".join(["time,x,y", *rows]))
    for file in (saved, tmp_path / "small.csv"):
        again = gauge("video", "score", file, "--id", film.task, "--json")
        value = json.loads(again.stdout)["metrics"]["acceleration_m_s2"]
        assert value == pytest.approx(line["metrics"]["acceleration_m_s2"], rel=1e-3)
    # Another task begins at another place.
    other = gauge("video", "score", saved, "--id", BALL.id)
    assert other.exit_code == 1 and "the track is not sound" in other.stdout
    text = gauge("video", "score", "slide.mp4", "--id", film.task).stdout
    assert "the track is sound" in text and "about one in ten" in text


def test_the_report_shows_every_model_and_names_broken_files(tmp_path, gauge):
    film = clip("SlopeSlider-2-metal", np.random.default_rng(11))
    videos = tmp_path / "videos"
    for model in ("seedance2", "slow"):
        (videos / model).mkdir(parents=True)
    written(film, videos / "seedance2" / f"{film.task}.mp4")
    broken = videos / "slow" / f"{film.task}.mp4"
    for file in (broken, videos / "slow" / "other.mp4"):
        file.write_text("no video")
    outcome = gauge("video", "report", videos, "--out", "page")
    assert outcome.exit_code == 1
    assert "other.mp4: its name is not" in outcome.stderr
    assert str(broken) in outcome.stderr.replace("\n", "")
    page = (tmp_path / "page" / "index.html").read_text()
    (line,) = (tmp_path / "page" / "results.json").read_text().splitlines()
    assert json.loads(line)["model"] == "seedance2"
    assert page.count("data:image/jpeg") == 6 and "http" not in page
    assert page.count("data:image/svg+xml") == 1
    rows = list(csv.DictReader((tmp_path / "page" / "table.csv").open()))
    published = {
        row["model"]: row["published"] for row in rows if "QFI" in row["metric"]
    }
    assert published == {"seedance2": "730.22", "slow": ""}
    assert len(outcome.stdout.splitlines()) <= 25


def test_seeds_have_a_mean_with_its_interval_and_a_share_of_sound_tracks(tmp_path):
    for name in ("a/Pendulum-metal/seed_3", "a/b/seed_1"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / f"{name}.mp4").touch()
    videos, others = find_videos(tmp_path)
    assert [file.stem for *_, file in videos] == ["seed_3"]
    assert [file.stem for file in others] == ["seed_1"]
    result = score_track(driven(SLIDE.id, 1.7), SLIDE)
    values = np.array([1.0, 2.0, 3.0, 4.0])
    seeds = [
        replace(result, metrics=result.metrics | {"acceleration_m_s2": a, "a": 0.46})
        for a in (*values, 90.0)
    ]
    seeds[-1] = replace(seeds[-1], is_sound=False)
    clips = [("wan22", SLIDE.id, Path(), seed) for seed in (*seeds, None)]
    table = results_table(clips)
    rows = csv.DictReader(table_csv(table).splitlines())
    row = next(row for row in rows if row["metric"] == "acceleration [m/s^2]")
    spread = np.std(values, ddof=1)
    half = stats.t.ppf(0.975, df=3) * spread / 2.0
    assert [float(row[key]) for key in ("mean", "low", "high", "spread")] == (
        pytest.approx([2.5, 2.5 - half, 2.5 + half, spread], rel=1e-6)
    )
    assert float(row["sound"]) == pytest.approx(4 / 6) and row["clips"] == "6"
    first, first_row, line, *_, last = table_latex(table).splitlines()
    assert first.startswith(r"\begin{tabular}") and last == r"\end{tabular}"
    assert line.count(" & ") == len(table.columns) - 1 and line.endswith(r" \\")
    assert r"95 \% from" in first_row and "m/s$^2$" in line
    assert summary_table(table).rows[0]["wan22"] == pytest.approx(0.46)
    # The published values are 0.43 m/s^2 and a QFI of 393.
    agrees = {row["metric"]: row["agrees"] for row in table.rows}
    assert agrees["a [m/s^2]"] == "agrees" and agrees["QFI"] == "differs"
