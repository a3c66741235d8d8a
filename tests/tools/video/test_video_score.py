"""Scores of clips and tracks whose motion is known, and what becomes of broken ones."""

import csv
import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

cv2 = pytest.importorskip("cv2")

from clips import clip, driven, track_of, written  # noqa: E402
from scipy import stats  # noqa: E402

from gauge_envs.errors import VideoError  # noqa: E402
from gauge_envs.experiments.resolve import load_experiment  # noqa: E402
from gauge_envs.tools.video import (  # noqa: E402
    read_track,
    save_track,
    score,
    score_track,
    video_task,
    video_tasks,
)
from gauge_envs.tools.video.agreement import DETAILS, agreement  # noqa: E402
from gauge_envs.tools.video.camera import SceneWatch  # noqa: E402
from gauge_envs.tools.video.frames import FileFrames  # noqa: E402
from gauge_envs.tools.video.scoring import findings_of, paper_metrics  # noqa: E402
from gauge_envs.tools.video.soundness import faults_of  # noqa: E402
from gauge_envs.tools.video.tasks import published_results  # noqa: E402
from gauge_envs.tools.video.tracker import _moving_part  # noqa: E402
from gauge_envs.tools.video.words import (  # noqa: E402
    find_videos,
    results_table,
    score_document,
    table_csv,
    table_latex,
)

SWINGS = ("NewtonsCradle-metal", "Pendulum-metal")
FIVE = ("SlopeSlider-2-wood", "BouncingBall-rubber", "Turntable-2-metal", *SWINGS)

TOLERANCE = {"acceleration_m_s2": 0.02, "pd": 0.01, "mte": 0.02, "de": 0.01, "r2": 0.01}
"""Largest error: relative for accelerations and periods, absolute for the others."""


def check_metrics(metrics, truth):
    """Check all metrics whose truth is known."""
    for name, value in truth.items():
        margin = TOLERANCE[name]
        is_relative = name in ("acceleration_m_s2", "pd")
        expected = pytest.approx(value, **{"rel" if is_relative else "abs": margin})
        assert metrics[name] == expected, name


@cache
def known(task, seed=7):
    """A clip that several tests read and none changes."""
    return clip(task, np.random.default_rng(seed))


def scored(one):
    return score(one.frames, one.fps, one.task)


@pytest.mark.slow
@pytest.mark.parametrize("task", FIVE)
def test_a_known_motion_is_recovered(task):
    one = known(task)
    result = scored(one)
    assert result.is_sound, result.reasons
    check_metrics(result.metrics, one.truth)


@pytest.mark.parametrize(
    ("task", "metric", "power", "seed"),
    [
        ("SlopeSlider-2-wood", "acceleration_m_s2", 2.0, 104),
        ("BouncingBall-rubber", "acceleration_m_s2", 2.0, 105),
        ("Pendulum-metal", "pd", -1.0, 104),
    ],
)
def test_the_interval_of_a_film_holds_the_truth_and_planted_faults_are_named(
    task, metric, power, seed
):
    one = clip(task, np.random.default_rng(seed), fps=20.0)
    result, truth = scored(one), one.truth[metric]
    low, high = result.uncertainty[metric]
    assert result.is_sound, result.reasons
    assert low <= truth <= high and high - low < 0.05 * truth
    # At twice the rate the motion needs four times gravity.
    hasty = score(one.frames, 2.0 * one.fps, task)
    assert hasty.metrics[metric] == pytest.approx(2.0**power * truth, rel=0.02)
    assert any("the stated rate may be wrong" in text for text in hasty.findings)
    grown = scored(clip(task, np.random.default_rng(seed), fps=20.0, growth=0.4))
    assert any("changes its shape" in reason for reason in grown.reasons)


@pytest.mark.slow
@pytest.mark.parametrize("task", [task.id for task in video_tasks()])
def test_intervals_hold_the_truth(task):
    inside, count = 0, 0
    for seed in range(20):
        # The stated uncertainty of the scale is 0.65 % for cubes and balls alike.
        one = clip(task, np.random.default_rng(seed), calibration_sigma=0.0065)
        result = scored(one)
        assert result.is_sound, (seed, result.reasons)
        check_metrics(result.metrics, one.truth)
        for name, truth in one.truth.items():
            # A fit of noisy places explains less than all of them, so R^2 has no true value of 1.
            interval = result.uncertainty[name]
            if name != "r2" and interval is not None:
                inside += interval[0] - 1e-12 <= truth <= interval[1] + 1e-12
                count += 1
    assert inside >= 0.9 * count


@pytest.mark.slow
def test_an_object_that_vanishes_is_named():
    one = known("Pendulum-metal")
    empty = one.frames[0].copy()
    empty[220:310, 420:510] = empty[220:310, 520:610]
    frames = [*one.frames[:20], *[empty] * 40]
    result = score(frames, one.fps, one.task)
    assert not result.is_sound
    assert any("is lost in" in reason for reason in result.reasons), result.reasons


@pytest.mark.parametrize(
    "move", [pytest.param("zoom", marks=pytest.mark.slow), "shake"]
)
def test_the_motion_of_a_camera_is_subtracted(move):
    one, rng = known("SlopeSlider-2-wood"), np.random.default_rng(2)
    height, width = one.frames[0].shape[:2]
    frames = [one.frames[0]]
    for number, frame in enumerate(one.frames[1:]):
        matrix = cv2.getRotationMatrix2D(
            (width / 2, height / 2), 0.0, 1.0 + (move == "zoom") * 0.0005 * number
        )
        matrix[:, 2] += (move == "shake") * rng.normal(0.0, 3.0, 2)
        frames.append(
            cv2.warpAffine(
                frame, matrix, (width, height), borderMode=cv2.BORDER_REPLICATE
            )
        )
    result = score(frames, one.fps, one.task)
    assert result.is_sound, result.reasons
    assert "camera" in result.findings[0] and "is subtracted" in result.findings[0]
    # What is drawn lies where the picture shows it: the last motion of the camera is known.
    place = result.track.points_px[-1]
    assert result.track.shown_px(-1)[-1] == pytest.approx(
        matrix[:, :2] @ place + matrix[:, 2], abs=1.0
    )
    check_metrics(result.metrics, one.truth)


def test_a_frame_with_the_object_elsewhere_is_no_motion():
    one = known("SlopeSlider-2-wood")
    frames = [*one.frames]
    frames[2] = np.roll(frames[2], (12, -20), axis=(0, 1))
    result = score(frames, one.fps, one.task)
    check_metrics(result.metrics, one.truth)


def test_a_second_object_is_named():
    one = known("SlopeSlider-2-wood")
    task = video_task(one.task)
    x, y = (round(value) for value in task.centre_px)
    copy = one.frames[0][y - 50 : y + 50, x - 50 : x + 50].copy()
    frames = [frame.copy() for frame in one.frames]
    for frame in frames[12:]:
        frame[100:200, 100:200] = copy
    result = score(frames, one.fps, one.task)
    assert not result.is_sound
    assert any("a second object" in reason for reason in result.reasons), result.reasons


def test_a_picture_of_another_scene_is_refused():
    one = known("SlopeSlider-2-wood")
    frames = [np.ascontiguousarray(frame[::-1, ::-1]) for frame in one.frames]
    result = score(frames, one.fps, one.task)
    assert not result.is_sound
    assert any(
        "does not show the object of the task" in reason for reason in result.reasons
    ), result.reasons


def test_bars_that_a_model_fills_are_no_other_scene():
    one = known("BouncingBall-rubber", 5)
    inner, grain = (
        np.s_[:, 110:722],
        np.random.default_rng(1).integers(
            100, 200, one.frames[0].shape, dtype=np.uint8
        ),
    )
    watched = {}
    for name, bars in (("bars", np.zeros_like(grain)), ("scene", 255 - grain)):
        frames = [(bars if number == 0 else grain).copy() for number in range(9)]
        for frame, seen in zip(frames, one.frames, strict=False):
            frame[inner] = seen[inner]
        watch = SceneWatch(frames[0], np.zeros(frames[0].shape[:2], dtype=bool))
        for number, frame in enumerate(frames):
            watch.look(frame)
            watch.compare(frame, number)
        watched[name] = any(event.kind == "scene" for event in watch.events())
    assert watched == {"bars": False, "scene": True}


def plain_table(shift_px, *, is_even=False):
    """What a watch says of a plate that turns on a faint table; its only clear points are on the plate."""
    rng, task = np.random.default_rng(0), video_task("Turntable-2-plastic")
    pivot = task.pivot_px

    def grain(sigma_px):
        texture = cv2.GaussianBlur(rng.normal(0.0, 1.0, (480, 832)), (0, 0), sigma_px)
        return texture / texture.std()

    def warped(picture, matrix):
        flags = {"borderMode": cv2.BORDER_REPLICATE}
        return cv2.warpAffine(picture, matrix, (832, 480), **flags)

    table, plate = 40.0 + 2.0 * grain(5.0), 200.0 + 20.0 * grain(4.0)
    disk = np.zeros((480, 832))
    cv2.circle(disk, [round(value) for value in pivot], 225, 1.0, -1)
    watch = None
    for number in range(8):
        turn = cv2.getRotationMatrix2D(pivot, 4.0 * number, 1.0)
        shown = np.where(disk > 0.0, warped(plate, turn), table)
        if is_even:
            shown = np.full_like(shown, 120.0)
        shift = np.eye(2, 3)
        shift[0, 2] = shift_px * (number > 0)
        noisy = warped(shown, shift) + rng.normal(0.0, 3.0, shown.shape)
        grey = np.clip(noisy, 0.0, 255.0).astype(np.uint8)
        picture = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
        watch = watch or SceneWatch(picture, _moving_part(task))
        watch.look(picture)
    return [event.text for event in watch.events() if not event.is_note]


def test_the_edge_of_a_plate_tells_that_the_camera_stands():
    assert plain_table(0.0) == []


@pytest.mark.parametrize(
    "scene", [{"shift_px": 0.9}, {"shift_px": 20.0}, {"shift_px": 0.0, "is_even": True}]
)
def test_a_camera_whose_motion_is_not_seen_is_not_taken_for_still(scene):
    (fault,) = plain_table(**scene)
    assert "too little to tell that it stands (frames " in fault


def test_a_still_picture_has_a_track_and_no_physics():
    one = known("SlopeSlider-2-wood")
    result = score([one.frames[0]] * 12, 30.0, one.task)
    assert result.is_sound, result.reasons
    assert result.findings[0].startswith("the object does not move")
    assert result.interval_frames is None
    assert set(result.metrics.values()) == {None}


def test_an_object_that_stops_after_two_steps_is_not_called_at_rest():
    """Another one may go on from there."""
    away_px = np.interp(np.arange(40), [10, 12], [0.0, SLIDE.size_px])
    places = SLIDE.centre_px + away_px[:, None] * np.array(SLIDE.direction)
    result = score_track(track_of(places, 24.0), SLIDE)
    assert result.reasons[0].startswith("the object moves by 1.0 of its size, in too")
    assert not result.findings and result.interval_frames is None


@pytest.mark.parametrize("task", FIVE)
def test_an_object_that_rests_does_not_move(task):
    one = video_task(task)
    noise_px = np.random.default_rng(0).normal(0.0, 0.3, (60, 2))
    rest = track_of((one.rest_px or one.centre_px) + noise_px, 24.0)
    result = score_track(rest, one)
    assert result.is_sound, result.reasons
    assert result.findings == ("the object does not move",)
    assert set(result.metrics.values()) == {None}


# --- tracks ----------------------------------------------------------------------------------------------------------


SLIDE = video_task("SlopeSlider-2-wood")


@pytest.mark.parametrize("is_metric", [False, True])
def test_a_track_is_scored_like_a_video(is_metric, tmp_path):
    track = driven(SLIDE.id, 1.7)
    if is_metric:
        # In millimetres from any place, to the right and up.
        along_px = (track.points_px - SLIDE.centre_px) * [1.0, -1.0]
        places_mm = 1e3 * SLIDE.scale_m_per_px * along_px + 100.0
        track = replace(track, points_px=places_mm, is_metric=True)
    path = save_track(track, tmp_path / "track.csv")
    result = score_track(read_track(path), SLIDE)
    assert result.metrics["acceleration_m_s2"] == pytest.approx(1.7, rel=2e-3)
    interval = result.uncertainty["acceleration_m_s2"]
    assert interval[0] < 1.7 < interval[1]
    assert result.is_sound


def test_a_track_that_starts_elsewhere_is_not_sound(tmp_path):
    """As one of a mirrored or cropped video, whose scale and direction are others."""
    track = driven(SLIDE.id, 1.7)
    away_px = np.array([-2.0 * SLIDE.size_px, 0.0])
    other = replace(track, points_px=track.points_px + away_px)
    result = score_track(read_track(save_track(other, tmp_path / "track.csv")), SLIDE)
    assert "first seen 2.0 of its size from its place" in result.reasons[0]


@pytest.mark.parametrize(
    ("name", "along_mm"),
    [
        (SLIDE.id, (-400.0, 250.0)),
        ("Pendulum-metal", (20.0, 300.0)),
        ("Pendulum-metal", (0.02, -0.3)),
    ],
)
def test_a_track_in_other_axes_or_in_metres_is_refused(name, along_mm):
    places_mm = np.linspace(0.7, 1.0, 40)[:, None] * along_mm
    track = replace(track_of(places_mm, 30.0), is_metric=True)
    with pytest.raises(VideoError, match="x_mm and y_mm are in millimetres"):
        score_track(track, video_task(name))


def swung(task, angles):
    """A track of a swing at 24 frames per second; angles from the vertical [rad], NaN where the ball is not seen."""
    known = video_task(task)
    length = np.hypot(*np.subtract(known.rest_px or known.centre_px, known.pivot_px))
    places = np.array(known.pivot_px) + length * np.column_stack(
        [np.sin(angles), np.cos(angles)]
    )
    return track_of(places, 24.0)


def test_a_swing_whose_apex_is_hidden_is_named():
    swing = np.sin(np.pi * np.arange(1, 12) / 12.0)
    hidden = np.where((np.arange(11) < 3) | (np.arange(11) > 8), swing, np.nan)
    rest = np.full(12, np.nan)
    task = video_task("NewtonsCradle-metal")
    whole, half = (
        score_track(swung(task.id, np.r_[rest, one, rest, 0.8 * swing, rest]), task)
        for one in (swing, hidden)
    )
    assert whole.is_sound, whole.reasons
    assert "its apex is not seen" in half.findings[0]
    # A ball that fades away on its arc is first or last seen there.
    assert "from its row in frame 14" in half.reasons[0]
    # What another ball looks like counts among the frames that show one.
    grown = swung(task.id, np.r_[rest, swing, rest, 0.8 * swing, rest])
    grown.size_ratio[37:42] = 1.5
    assert "+50% in frames 37 to 41" in score_track(grown, task).reasons[0]


def test_less_than_half_a_swing_says_little():
    task, times_s = video_task("Pendulum-metal"), np.arange(13) / 24.0
    track = swung(task.id, 0.25 * np.cos(2.0 * np.pi * times_s))
    for last, is_short in ((11, True), (12, False)):
        findings = " ".join(findings_of(track, task, (0, last), {"pd": 1.0}))
        assert ("less than half a period" in findings) is is_short


@pytest.mark.slow
def test_the_interval_of_a_period_holds_what_the_law_does_not_explain():
    task, times_s = video_task("Pendulum-metal"), np.arange(48) / 24.0
    swing = 0.25 * np.cos(2.0 * np.pi * times_s)
    widths = []
    for drift_rad in (0.0, 0.02):
        result = score_track(
            swung(task.id, swing + drift_rad * np.sin(3.0 * times_s)), task
        )
        interval = result.uncertainty["pd"]
        assert (
            result.is_sound and interval is not None and interval[0] < 1.0 < interval[1]
        )
        widths.append(interval[1] - interval[0])
    assert widths[1] > 3.0 * widths[0]


def test_a_cube_that_breaks_the_law_has_a_sound_track_until_it_may_be_another_one():
    task = video_task("Turntable-2-metal")
    assert task.pivot_px is not None
    angles = 0.03 * np.arange(60)
    lawful = np.array(task.pivot_px) - 130.0 * np.column_stack(
        [np.cos(angles), np.sin(angles)]
    )
    found = {}
    for jump_px in (0.0, 39.0, 130.0):
        places = lawful.copy()
        places[36:] += [jump_px, 0.0]
        found[jump_px] = score_track(track_of(places, 24.0), task)
    assert [one.is_sound for one in found.values()] == [True, True, False]
    still = score_track(track_of(lawful[:1] + 0.3 * (lawful - lawful[0]), 24.0), task)
    assert still.metrics["de"] == 0.0 and "says little" in still.findings[-1]
    assert found[0.0].metrics["de"] == 0.0 and found[39.0].metrics["de"] > 0.05
    assert "jumps" in found[130.0].reasons[0]
    # A cube that stops at once at the end of its board is no other one; one that goes back and on is.
    for end_px, is_sound in (((405.0, 405.0), True), ((325.0, 415.0), False)):
        way = np.r_[np.zeros(8), 5.0 * np.arange(10.0) ** 2, end_px]
        places = SLIDE.centre_px + way[:, None] * np.array(SLIDE.direction)
        assert score_track(track_of(places, 24.0), SLIDE).is_sound is is_sound


@pytest.mark.parametrize(("speed_px", "count"), [(0.0, 1), (0.0, 3), (12.0, 3)])
@pytest.mark.parametrize("away", [0.0, 2.0])
def test_a_jump_while_the_object_is_lost_is_named(speed_px, count, away):
    way_px = speed_px * np.arange(30.0)[:, None]
    places = SLIDE.centre_px + way_px * np.array(SLIDE.direction)
    right, down = SLIDE.direction
    places[16:] += away * SLIDE.size_px * np.array([-down, right])
    places[16 - count : 16] = np.nan
    faults = faults_of(track_of(places, 24.0), SLIDE, (0, 29))
    words = f"jumps by {away:.1f} of its size between frames {15 - count} and 16"
    assert [words in one for one in faults] == [True] * bool(away)


@pytest.mark.parametrize(("away", "is_named"), [(0.0, False), (1.3, True)])
def test_a_jump_that_a_blend_of_two_pictures_spreads_is_named(away, is_named):
    """Between them the track finds a place half way."""
    track = driven(SLIDE.id, 1.7)
    shares = np.clip(np.arange(40) - 25, 0.0, 2.0)[:, None] / 2.0
    ahead_px = away * SLIDE.size_px * shares * np.array(SLIDE.direction)
    jumped = replace(track, points_px=track.points_px + ahead_px)
    faults = faults_of(jumped, SLIDE, (10, 39))
    words = "of its size between frames 25 and 27"
    assert [words in one for one in faults] == [True] * is_named


@pytest.mark.parametrize(
    ("last", "shown", "is_named"), [(22, 40, True), (22, 25, False), (35, 40, False)]
)
def test_a_cube_that_is_lost_on_the_board_has_vanished(last, shown, is_named):
    """It may leave the picture at the end of the board, and a clip may end in the last frames that show it."""
    track = driven(SLIDE.id, 2.7)
    places = track.points_px[:shown].copy()
    places[last + 1 :] = np.nan
    reasons = score_track(track_of(places, 30.0), SLIDE).reasons
    assert any(f"vanishes on its way: frame {last}" in one for one in reasons) is (
        is_named
    )


@pytest.mark.parametrize(
    ("field", "later", "words"),
    [
        ("size_ratio", 1.4, "its size by up to +40% in frames 15 to"),
        ("size_ratio", 0.6, "its size by up to -40% in frames 15 to"),
        ("misfit", 0.5, "its shape by up to 50% in frames 15 to"),
        ("tint", 14.0, "its colour by up to 14 levels of 255 in frames 15 to"),
        ("confidence", 0.25, "another look in frames 15 to"),
        ("other_likeness", 0.9, "a second object of the same shape and colour"),
    ],
)
def test_an_object_that_changes_is_no_sound_track(field, later, words):
    """A model may let a cube grow or melt; the law that the track follows does not matter."""
    track = driven(SLIDE.id, 1.7)
    first = getattr(track, field)

    def judged(share):
        changed = first + share * (later - first) * (np.arange(40) >= 15)
        return score_track(replace(track, **{field: changed}), SLIDE)

    result = judged(1.0)
    assert not result.is_sound
    assert words in result.reasons[0]
    assert result.metrics["acceleration_m_s2"] == pytest.approx(1.7, rel=2e-3)
    assert judged(0.4).is_sound


def test_a_second_object_counts_when_it_has_parted():
    """One that goes on from where the object stops is seen after the motion, and in no frame that is retained."""
    track = driven(SLIDE.id, 1.7)
    stopped = np.minimum(np.arange(40), 24)
    places = track.points_px[stopped]
    for count, is_sound in ((2, True), (3, False)):
        likeness = np.where(np.arange(40) >= 40 - count, 0.9, 0.0)
        parted = replace(track, points_px=places, other_likeness=likeness)
        result = score_track(parted, SLIDE)
        assert result.interval_frames[1] < 30
        assert result.is_sound is is_sound


@pytest.mark.parametrize(("light", "dye"), [(1.0, 0.0), (1.6, 0.0), (1.0, 15.0)])
def test_a_black_ball_that_gets_another_colour_is_no_sound_track(light, dye):
    """It may get brighter by as much, as it comes nearer to a lamp."""
    one = clip("BouncingBall-rubber", np.random.default_rng(104))
    frames = [frame.copy() for frame in one.frames]
    for frame in frames[20:]:
        is_ball = frame.max(axis=2) < 60
        frame[is_ball] = light * frame[is_ball] + [0.0, dye, 0.0]
    result = score(frames, one.fps, one.task)
    is_named = any("changes its colour" in reason for reason in result.reasons)
    assert (is_named, result.is_sound) == (dye > 0.0, dye == 0.0), result.reasons


# --- files and the command -------------------------------------------------------------------------------------------


def test_the_command_scores_a_file_and_draws_the_track(tmp_path, gauge):
    one = known("SlopeSlider-2-metal", 11)
    written(one, tmp_path / "slide.mp4")
    words = f"video score slide.mp4 --id {one.task} --json --out drawn"
    outcome = gauge(*words.split())
    assert outcome.exit_code == 0, outcome.output
    line = json.loads(outcome.stdout)
    assert set(line) == {
        *("video", "task", "is_sound", "reasons", "findings"),
        *("metrics", "uncertainty"),
        *("interval_frames", "scale_m_per_px", "details", "registration"),
    }
    assert line["is_sound"]
    check_metrics(line["metrics"], one.truth)
    assert line["metrics"]["mte"] is None
    drawn = FileFrames(tmp_path / "drawn" / "slide.overlay.mp4")
    assert sum(1 for _ in drawn.pictures()) == len(one.frames)
    # The track that it writes is scored as the video.
    saved = tmp_path / "drawn" / "slide.track.csv"
    # A track counts the pixels of the video beside it.
    small = [cv2.resize(frame, (416, 240)) for frame in one.frames[:2]]
    written(replace(one, frames=small), tmp_path / "small.mp4")
    rows = [
        f"{row['time']},{0.5 * float(row['x_grid'])},{0.5 * float(row['y_grid'])}"
        for row in csv.DictReader(saved.open())
    ]
    (tmp_path / "small.csv").write_text("\n".join(["time,x,y", *rows]))
    for file in (saved, tmp_path / "small.csv"):
        again = gauge("video", "score", file, "--id", one.task, "--json")
        value = json.loads(again.stdout)["metrics"]["acceleration_m_s2"]
        assert value == pytest.approx(line["metrics"]["acceleration_m_s2"], rel=1e-3)


def test_the_report_shows_every_model_and_names_broken_files(tmp_path, gauge):
    one = known("SlopeSlider-2-metal", 11)
    videos = tmp_path / "videos"
    for model in ("seedance2", "slow"):
        (videos / model).mkdir(parents=True)
    written(one, videos / "seedance2" / "SlopeSlider-2-metal.mp4")
    (videos / "slow" / "SlopeSlider-2-metal.mp4").write_text("no video")
    ignored = (
        "slow/SlopeSlider-2-metal_v2.mp4",
        "seed/a/SlopeSlider-2-metal.mp4",
        "top.webm",
        "slow/notes.txt",
    )
    for other in ignored:
        (videos / other).parent.mkdir(parents=True, exist_ok=True)
        (videos / other).write_text("no video")
    outcome = gauge("video", "report", videos, "--out", "page")
    assert outcome.exit_code == 1
    for other in ignored:
        assert f"{other}: it is named otherwise" in outcome.stderr
    assert " 730.2 " in outcome.stdout
    page = (tmp_path / "page" / "index.html").read_text()
    (line,) = (tmp_path / "page" / "results.json").read_text().splitlines()
    assert json.loads(line)["model"] == "seedance2"
    assert page.count("data:image/jpeg") == 6
    # The way of the object.
    assert page.count("data:image/svg+xml") == 1
    # A published value stands beside that of the model, and other published models have rows of their own.
    rows = list(csv.DictReader((tmp_path / "page" / "table.csv").open()))
    printed = {row["model"]: row["published"] for row in rows if row["metric"] == "QFI"}
    assert float(printed["seedance2"]) == 730.22 and float(printed["genie3"]) == 70.37
    assert printed["slow"] == "" and ">0%</td>" in page
    assert "http" not in page
    assert gauge("video", "report", "page").exit_code == 2


def test_seeds_are_found_beside_single_clips(tmp_path):
    for name in (
        "a/Pendulum-metal/seed_3.mp4",
        "a/Pendulum-metal.mp4",
        "a/Pendulum-metal/other.mp4",
        "a/b/seed_1.mp4",
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    videos, others = find_videos(tmp_path)
    assert [file.stem for *_, file in videos] == ["seed_3", "Pendulum-metal"]
    assert {one[:2] for one in videos} == {("a", "Pendulum-metal")}
    assert [file.name for file in others] == ["other.mp4", "seed_1.mp4"]


def test_seeds_have_a_mean_with_its_interval_and_a_usable_share():
    one = score_track(driven(SLIDE.id, 1.7), SLIDE)
    values = (1.0, 2.0, 3.0, 4.0, 90.0)
    seeds = [
        replace(one, is_sound=True, metrics=one.metrics | {"acceleration_m_s2": a})
        for a in values
    ]
    seeds[-1] = replace(seeds[-1], is_sound=False)
    names = [Path(f"seed_{number}.mp4") for number in range(6)]
    clips = dict(zip(names, [*seeds, None], strict=True))
    single = {Path("one.mp4"): one}
    table = results_table({("mine", one.task): clips, ("single", one.task): single})
    rows = list(csv.DictReader(table_csv(table).splitlines()))
    row, alone, *_ = [row for row in rows if row["metric"] == "acceleration [m/s^2]"]
    spread = np.std(values[:4], ddof=1)
    half = stats.t.ppf(0.975, df=3) * spread / 2.0
    expected = {
        "mean": 2.5,
        "low": 2.5 - half,
        "high": 2.5 + half,
        "spread": spread,
        "clips": 6,
        "sound": 4 / 6,
    }
    found = {key: float(row[key]) for key in expected}
    assert found == pytest.approx(expected, rel=1e-6)
    assert alone["spread"] == ""
    assert (float(alone["low"]), float(alone["high"])) == one.uncertainty[
        "acceleration_m_s2"
    ]
    first, _, line, *_, last = table_latex(table).splitlines()
    columns = len(first.rpartition("{")[2]) - 1
    assert first.startswith(r"\begin{tabular}") and last == r"\end{tabular}"
    assert line.count(" & ") == columns - 1 and line.endswith(r" \\")
    assert r"67\%" in line


def test_published_values_of_other_frames_are_found_and_a_wrong_track_has_no_say():
    """The paper counts time from a first frame that it does not publish, and whole pixels."""
    task = SLIDE
    result = score_track(driven(task.id, 1.7), task)
    first, last = result.interval_frames
    assert agreement(result, task, {"a": result.metrics["a"]}) == "agrees"
    later = [
        paper_metrics(result.track, task, (first + more, last), task.scale_m_per_px)[0]
        for more in (5, 12)
    ]
    text = agreement(result, task, later[0], [later[1], {"a": 90.0}])
    # A release within the window of six frames may be the paper's, and a later one is not.
    assert text.startswith(f"in frames {first + 4} to {last}, +4 and +0")
    assert text.endswith("0 of 2 values of other clips")
    assert agreement(result, task, later[1]).startswith("in none of")
    assert agreement(result, task, {"a": 90.0}).startswith("in none of")
    wrong = replace(result, is_sound=False, reasons=("it melts",))
    agreed = agreement(wrong, task, {"a": result.metrics["a"]})
    assert agreed == "track not sound: it melts"


def test_a_published_force_that_the_track_has_not_differs_in_numbers():
    task = video_task("Turntable-2-metal")
    angles = 0.03 * np.arange(60)[:, None]
    circle = np.concatenate([np.cos(angles), np.sin(angles)], axis=1)
    places = np.floor(np.array(task.pivot_px) - 130.0 * circle)
    result = score_track(track_of(places, 16.0), task)
    assert result.metrics["de"] == 0.0
    text = agreement(result, task, {"de": 0.01})
    assert text.startswith("differs: the track shows an acceleration of at most 0.")
    assert text.endswith("more than friction holds in 0.0% of the frames")


@pytest.mark.parametrize("task", SWINGS)
def test_each_detail_of_a_swing_has_words(task):
    result = scored(known(task))
    assert result.details and {*result.details} <= {*DETAILS}


def test_places_count_in_whole_pixels_of_the_video(tmp_path):
    (tmp_path / "track.csv").write_text("time,x,y\n0,100.7,50.2\n0.1,101.2,50.9\n")
    track = read_track(tmp_path / "track.csv", size_px=(1664, 960)).in_whole_px()
    assert track.points_px == pytest.approx(np.array([[50.0, 25.0], [50.5, 25.0]]))


def test_published_values_are_those_of_the_table():
    published = published_results()
    assert len(published) == 10
    assert published["seedance2"]["Pendulum-metal"]["pd"] == 3.13
    assert "NewtonsCradle-metal" not in published["wan22"]
    for task in video_tasks():
        named = {key for one in published.values() for key in one.get(task.id, {})}
        assert named == set(task.law)


@pytest.mark.parametrize("material", ["wood", "plastic", "metal"])
def test_the_law_of_a_slide_is_no_measurement_and_its_trials_are(material):
    """Real cubes have another friction than the calibrated one: plastic slides with 2.90 in place of 2.57 m/s^2."""
    task = video_task(f"SlopeSlider-2-{material}")
    scene = load_experiment(task.id).scene
    friction = next(one.friction for one in scene.contacts if "cube" in one.first)
    slope = np.radians(30.0)
    lawful = scene.gravity_m_per_s2 * (np.sin(slope) - friction * np.cos(slope))
    # The table states two decimals.
    assert task.law["a"] == pytest.approx(lawful, abs=0.006)
    found = task.real["a"]
    # Each material has 19 trials or more.
    assert abs(found.mean - lawful) > 3.0 * found.std / np.sqrt(19)


def test_a_result_names_the_law_and_the_real_trials():
    task = video_task("SlopeSlider-2-plastic")
    result = score_track(driven(task.id, 2.9), task)
    first, note, *_, table = score_document(result, task).parts
    assert "the track is sound" in first.text and "16 of 100" in note.text
    law, real = [column.title for column in table.columns][-2:]
    assert (law, real) == ("law", "real trials")
    values = [column.text(table.rows[0]) for column in table.columns][-2:]
    assert values == ["2.57", "2.898 +- 0.075"]
    assert not video_task("BouncingBall-rubber").real
    # The pendulum and the cradle have the published means of their trials.
    swings = {
        name: value for one in SWINGS for name, value in video_task(one).real.items()
    }
    assert {name: one.mean for name, one in swings.items()} == pytest.approx(
        {"mte": 0.9302, "pd": 1.14}
    )
