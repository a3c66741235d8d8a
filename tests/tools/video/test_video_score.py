"""Scores of clips and tracks with known motion, intervals, and the commands."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

cv2 = pytest.importorskip("cv2")

from clips import clip, driven, scored, track_of, written  # noqa: E402

from gauge_envs.errors import VideoError  # noqa: E402
from gauge_envs.references.published import published_baselines  # noqa: E402
from gauge_envs.tools.video import (  # noqa: E402
    read_track,
    save_track,
    score_track,
    video_task,
    video_tasks,
)
from gauge_envs.tools.video.report import find_videos, model_table  # noqa: E402

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
    """Check all metrics with known true values."""
    for name, value in truth.items():
        assert metrics[name] == pytest.approx(value, **TOLERANCE[name]), name


# --- films -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("task", "metric", "power", "seed"),
    [
        (SLIDE.id, "acceleration_m_s2", 2.0, 104),
        pytest.param(PENDULUM.id, "pd", -1.0, 104, marks=pytest.mark.slow),
    ],
)
def test_the_interval_of_a_film_contains_the_truth(task, metric, power, seed):
    film = clip(task, np.random.default_rng(seed), fps=20.0)
    result, truth = scored(film.frames, film.fps, task), film.truth[metric]
    low, high = result.uncertainty[metric]
    assert result.is_sound, result.reasons
    assert low <= truth <= high and high - low < 0.05 * truth
    # At twice the frame rate, the motion is twice as fast.
    track = result.track
    fast = replace(track, fps=2.0 * track.fps, times_s=0.5 * track.times_s)
    again = score_track(fast, video_task(task))
    assert again.metrics[metric] == pytest.approx(2.0**power * truth, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("task", [SLIDE.id, BALL.id, PLATE.id, CRADLE.id, PENDULUM.id])
def test_intervals_contain_the_truth(task):
    contained = []
    for seed in range(10):
        # The standard uncertainty of the scale is 0.65 % for cubes and balls.
        film = clip(task, np.random.default_rng(seed), calibration_sigma=0.0065)
        result = scored(film.frames, film.fps, task)
        assert result.is_sound, (seed, result.reasons)
        check_metrics(result.metrics, film.truth)
        # The noise of places reduces R^2, so its true value is not 1.
        for name in film.truth.keys() - {"r2"}:
            low, high = result.uncertainty[name]
            contained.append(low - 1e-12 <= film.truth[name] <= high + 1e-12)
    assert np.mean(contained) >= 0.9


# --- tracks ----------------------------------------------------------------------------------------------------------


def test_a_track_from_a_file_is_scored_like_a_video(tmp_path):
    track = driven(SLIDE.id, 1.7)
    result = score_track(read_track(save_track(track, tmp_path / "a.csv")), SLIDE)
    assert result.metrics["acceleration_m_s2"] == pytest.approx(1.7, rel=2e-3)
    low, high = result.uncertainty["acceleration_m_s2"]
    assert low < 1.7 < high
    assert result.is_sound


@pytest.mark.parametrize(
    ("text", "fps", "words"),
    [
        ("frame,x\n0,1\n", 30.0, "must have the columns time or frame, and x"),
        ("frame,x,y\n0,1,abc\n", 30.0, "not a CSV file of numbers.*'abc'"),
        ("time,x,y\n0.1,1,1\n0,1,1\n", None, "must increase"),
        ("frame,x,y\n0,1,1\n1,1,1\n", None, "give a column time"),
        ("frame,x,y\n0,1,481\n", 30.0, "outside of the picture of 832 x 480 pixels"),
    ],
)
def test_an_unreadable_track_is_an_error_with_the_reason(text, fps, words, tmp_path):
    file = tmp_path / "track.csv"
    file.write_text(text)
    with pytest.raises(VideoError, match=words) as caught:
        read_track(file, fps=fps)
    assert str(file) in str(caught.value)


def test_a_json_file_has_the_centre_of_each_frame_by_its_number(tmp_path):
    file = tmp_path / "track.json"
    file.write_text('{"10": [430, 260.5], "2": [412, 230], "4": null}')
    track = read_track(file, fps=20.0)
    assert track.frames.tolist() == [2, 4, 10]
    assert track.times_s == pytest.approx([0.1, 0.2, 0.5])
    assert track.is_found.tolist() == [True, False, True]
    assert track.points_px[-1] == pytest.approx([430.0, 260.5])
    file.write_text('{"0": [412, 230], "1": 3}')
    with pytest.raises(VideoError, match="not a JSON object with a centre for each"):
        read_track(file, fps=20.0)


@pytest.mark.parametrize(
    ("count", "fps", "words"), [(5, 30.0, "5 frames"), (12, 1.0, "1 frames per")]
)
def test_an_unsuitable_film_is_an_error(count, fps, words):
    with pytest.raises(VideoError, match=words):
        scored(np.zeros((count, 480, 832, 3), np.uint8), fps, SLIDE.id)


def test_metrics_of_the_paper_use_whole_pixels_and_start_at_the_first_retained_frame(
    tmp_path,
):
    track = read_track(save_track(driven(SLIDE.id, 1.7), tmp_path / "a.csv"))
    result = score_track(track, SLIDE)
    first, last = result.interval_frames
    whole_px = np.floor(track.points_px[first : last + 1])
    along_m = whole_px @ np.array(SLIDE.direction) * SLIDE.scale_m_per_px
    since_s = (track.times_s - track.times_s[first])[first : last + 1]
    # The cube of 50 mm has a width of 60 pixels.
    assert SLIDE.scale_m_per_px == 0.05 / 60.0
    slope = np.polyfit(since_s**2, along_m, 1)[0]
    assert result.metrics["a"] == pytest.approx(2.0 * slope, rel=1e-9)


@pytest.mark.parametrize("task", [SLIDE, PLATE, CRADLE])
def test_an_object_at_rest_has_a_track_and_no_metrics(task):
    noise_px = np.random.default_rng(0).normal(0.0, 0.3, (60, 2))
    rest = track_of((task.rest_px or task.centre_px) + noise_px, 24.0)
    result = score_track(rest, task)
    assert result.is_sound, result.reasons
    assert result.findings == ("no motion is detected",)
    assert set(result.metrics.values()) == {None}


def test_the_track_of_an_object_of_another_size_is_not_sound():
    track = driven(SLIDE.id, 1.7)
    misfit = np.where(np.arange(40) < 15, 0.0, 0.4)
    result = score_track(replace(track, misfit=misfit), SLIDE)
    assert not result.is_sound and "size or shape by up to 40%" in result.reasons[0]


def test_a_cube_that_breaks_the_law_has_a_sound_track_until_it_may_be_another_cube():
    angles = 0.03 * np.arange(60)
    circle = np.column_stack([np.cos(angles), np.sin(angles)])
    lawful_px = np.array(PLATE.pivot_px) - 130.0 * circle
    slips = [np.where(np.arange(60) < 36, 0.0, px) for px in (0.0, 39.0, 130.0)]
    ride, slip, jump = (
        score_track(track_of(lawful_px + np.outer(px, [1.0, 0.0]), 24.0), PLATE)
        for px in slips
    )
    assert ride.is_sound and ride.metrics["de"] == 0.0
    assert slip.is_sound and slip.metrics["de"] > 0.05
    assert not jump.is_sound and "jumps" in jump.reasons[0]
    still_px = lawful_px[0] + 0.3 * (lawful_px - lawful_px[0])
    still = score_track(track_of(still_px, 24.0), PLATE)
    assert "not significant" in still.findings[-1]


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


# --- published values ------------------------------------------------------------------------------------------------


def test_laws_and_real_trials_agree_with_the_published_tables():
    assert SLIDE.law == {"a": 2.58, "qfi": 0.0}
    assert CRADLE.law == {"mte": 1.0}
    for task in video_tasks():
        for metric, baseline in published_baselines(task.id).items():
            if metric in task.law and baseline.std is not None:
                assert task.real[metric] == pytest.approx((baseline.mean, baseline.std))


# --- commands --------------------------------------------------------------------------------------------------------


def test_the_command_scores_a_file_and_draws_the_track(tmp_path, gauge):
    film = clip("SlopeSlider-2-metal", np.random.default_rng(11))
    written(film.frames, tmp_path / "slide.mp4")
    command = f"video score slide.mp4 --id {film.task} --json --out drawn"
    outcome = gauge(*command.split())
    assert outcome.exit_code == 0, outcome.output
    line = json.loads(outcome.stdout)
    assert line["is_sound"] and line["registration"]["method"] == "stretch"
    check_metrics(line["metrics"], film.truth)
    drawn = cv2.imread(str(tmp_path / "drawn" / "slide.track.jpg"))
    assert drawn.shape == (480, 832, 3)
    # The written track, and a track in pixels of a smaller video, have the score of the video.
    saved = tmp_path / "drawn" / "slide.track.csv"
    small = [cv2.resize(frame, (416, 240)) for frame in film.frames[:2]]
    written(small, tmp_path / "small.mp4")
    rows = [
        f"{row['time']},{0.5 * float(row['x_grid'])},{0.5 * float(row['y_grid'])}"
        for row in csv.DictReader(saved.open())
    ]
    (tmp_path / "small.csv").write_text("\n".join(["time,x,y", *rows]))
    for file in (saved, tmp_path / "small.csv"):
        again = gauge("video", "score", file, "--id", film.task, "--json")
        value = json.loads(again.stdout)["metrics"]["acceleration_m_s2"]
        assert value == pytest.approx(line["metrics"]["acceleration_m_s2"], rel=1e-3)
    # The object of another task starts at another place.
    rejected = gauge("video", "score", saved, "--id", BALL.id)
    assert rejected.exit_code == 1 and "the track is rejected" in rejected.stdout
    text = gauge("video", "score", saved, "--id", film.task).stdout
    assert "the track is accepted" in text and "accepted tracks were wrong" in text


def test_the_report_shows_every_model_and_names_broken_files(tmp_path, gauge):
    film = clip("SlopeSlider-2-metal", np.random.default_rng(11))
    videos = tmp_path / "videos"
    for model in ("seedance2", "slow"):
        (videos / model).mkdir(parents=True)
    written(film.frames, videos / "seedance2" / f"{film.task}.mp4")
    broken = videos / "slow" / f"{film.task}.mp4"
    for file in (broken, videos / "slow" / "other.mp4"):
        file.write_text("no video")
    outcome = gauge("video", "report", videos, "--out", "page")
    assert outcome.exit_code == 1
    assert "other.mp4: expected the name" in outcome.stderr
    assert str(broken) in outcome.stderr.replace("\n", "")
    page = (tmp_path / "page" / "index.html").read_text()
    (line,) = (tmp_path / "page" / "results.json").read_text().splitlines()
    assert json.loads(line)["model"] == "seedance2"
    assert page.count("data:image/jpeg") == 1 and "http" not in page
    assert "(1 of 1)" in outcome.stdout and "(0 of 1)" in outcome.stdout
    assert len(outcome.stdout.splitlines()) <= 25


def test_seeds_have_the_mean_of_sound_tracks(tmp_path):
    for name in ("a/Pendulum-metal/seed_3", "a/b/seed_1"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / f"{name}.mp4").touch()
    videos, misnamed = find_videos(tmp_path)
    assert [file.stem for *_, file in videos] == ["seed_3"]
    assert [file.stem for file in misnamed] == ["seed_1"]
    result = score_track(driven(SLIDE.id, 1.7), SLIDE)
    seeds = [
        replace(result, metrics=result.metrics | {"a": a})
        for a in (1.0, 2.0, 3.0, 4.0, 90.0)
    ]
    seeds[-1] = replace(seeds[-1], is_sound=False)
    clips = [("wan22", SLIDE.id, Path(), seed) for seed in (*seeds, None)]
    table = model_table(clips)
    row = next(row for row in table.rows if row["metric"] == "a [m/s^2]")
    assert (row["law"], row["wan22"], row["wan22, paper"]) == (
        2.58,
        "2.5 (4 of 6)",
        0.43,
    )
    assert "2 of 2 values differ from those of the paper" in table.notes[1]
