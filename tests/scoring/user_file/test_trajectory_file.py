"""Trajectory files of users: each format is read as it was written, and a likely mistake is named with its place."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from hypothesis.extra.numpy import arrays
from slide import FRAMES, NAME, RESOLVED, SLIDE, TIMES, coulomb_slide, write_csv

from gauge_envs import load_experiment, reference_band, score_trajectory
from gauge_envs.errors import TrajectoryFileError
from gauge_envs.experiments.resolve import with_trial
from gauge_envs.runs.score_file import score_file
from gauge_envs.scoring.user_file.likely_mistakes import start_values
from gauge_envs.scoring.user_file.trajectory_file import read_trajectory


def test_a_closed_form_slide_in_a_csv_scores_as_in_the_library(tmp_path):
    file = write_csv(tmp_path / "slide.csv", SLIDE)
    result, notes = score_file(file, variant=NAME)
    expected = score_trajectory(
        RESOLVED, reference_band(RESOLVED), times_s=TIMES, values=SLIDE
    )
    # A CSV file does not give its constants, so its exact motion is unknown.
    unknown = replace(expected, exact=None, cause=None)
    assert result.score == unknown != expected
    # scoring/README.md: an ideal Coulomb cube with the published friction scores 0.41.
    assert result.score.rmse_normalized == pytest.approx(0.41, abs=0.005)
    assert (notes, result.frames, result.sim_s) == ((), FRAMES, 0.6)


@settings(max_examples=40)
@given(
    values=arrays(float, (FRAMES, 3), elements=st.floats(-0.5, 0.5)),
    order=st.permutations(range(3)),
    has_times=st.booleans(),
)
def test_what_is_written_is_read(tmp_path_factory, values, order, has_times):
    """CSV with the columns in any order, NPZ and JSON; times printed with three digits count as the frames."""
    folder = tmp_path_factory.mktemp("files")
    times_s = np.arange(len(values)) / 30.0
    printed = {"time_s": np.round(times_s, 3)} if has_times else {}
    names = ["cube." + "xyz"[axis] for axis in order]
    header = ",".join([*printed, *(f"{name} [mm]" for name in names)])
    write_csv(
        folder / "a.csv",
        values[:, order],
        header=header,
        times=printed.get("time_s"),
    )
    np.savez(folder / "a.npz", g=values, **printed)
    lists = {name: column.tolist() for name, column in printed.items()}
    (folder / "a.json").write_text(json.dumps({"g": values.tolist()} | lists))
    for suffix in ("csv", "npz", "json"):
        read = read_trajectory(folder / f"a.{suffix}", RESOLVED)
        np.testing.assert_array_equal(read.values, values)
        assert read.times_s == pytest.approx(TIMES, abs=1e-12)
        assert read.interpolated_frames == 0


def test_headers_of_other_tools_go_by_position(tmp_path):
    for header in ("", "px,py,pz"):
        file = write_csv(tmp_path / "a.csv", SLIDE, header=header)
        np.testing.assert_array_equal(read_trajectory(file, RESOLVED).values, SLIDE)
    table = np.column_stack([TIMES, SLIDE])
    np.savetxt(tmp_path / "b.csv", table, delimiter=",", header="time_s,x,y,z")
    read = read_trajectory(tmp_path / "b.csv", RESOLVED)
    np.testing.assert_allclose(read.values, SLIDE)


@pytest.mark.parametrize(
    ("separator", "end", "encoding"),
    [(",", ",,", "utf-8-sig"), ("\t", "\t", "utf-16"), (" ", "", "utf-8")],
)
def test_files_of_other_programs(tmp_path, separator, end, encoding):
    file = write_csv(tmp_path / "a.csv", SLIDE, header="time_s,x,y,z", times=TIMES)
    text = file.read_text().replace(",", separator)
    if separator == "\t":
        text = text.replace(".", ",")
    lines = text.splitlines()
    file.write_text("".join(f"{line}{end}\n" for line in lines), encoding=encoding)
    np.testing.assert_array_equal(read_trajectory(file, RESOLVED).values, SLIDE)


def test_a_clock_may_jitter_by_5_ms(tmp_path):
    times = TIMES + np.random.default_rng(0).uniform(-0.0049, 0.0049, FRAMES)
    times[[0, -1]] = 0.004, 0.596
    places = coulomb_slide(times)
    file = write_csv(tmp_path / "a.csv", places, header="time_s,x,y,z", times=times)
    read = read_trajectory(file, RESOLVED)
    at_frames = read.values[np.isin(read.times_s, TIMES)]
    np.testing.assert_allclose(at_frames, SLIDE, atol=0.6)  # a dt^2 / 8 = 0.6 mm
    _, notes = score_file(file, variant=NAME)
    assert "of 19 frames have no sample: interpolated" in notes[0]


def test_frames_between_samples_are_interpolated_and_counted(tmp_path):
    times = np.arange(0.0, 0.61, 0.01)
    places = coulomb_slide(times)
    file = write_csv(tmp_path / "a.csv", places, header="time_s,x,y,z", times=times)
    read = read_trajectory(file, RESOLVED)
    # Every frame but those at multiples of 0.1 s.
    assert read.interpolated_frames == 12
    at_frames = read.values[np.isin(read.times_s, TIMES)]
    np.testing.assert_allclose(at_frames, SLIDE, atol=0.04)  # a dt^2 / 8 = 0.032 mm


def test_rows_after_the_last_frame_are_ignored(tmp_path):
    experiment = load_experiment("CantileverBeam-soft")
    markers_m = np.asarray(experiment.scene.markers.positions_m)
    times = np.arange(4 * experiment.frame_count) / 60.0
    rows = np.tile(1e3 * markers_m.ravel(), (len(times), 1))
    header = ",".join(["time_s", *experiment.coordinates])
    file = write_csv(tmp_path / "a.csv", rows, header=header, times=times)
    read = read_trajectory(file, experiment)
    assert read.times_s[-1] == pytest.approx((experiment.frame_count - 1) / 30.0)
    at_frames_m = np.tile(markers_m, (experiment.frame_count, 1, 1))
    np.testing.assert_allclose(read.markers_m, at_frames_m)


def test_a_stored_result_is_scored_again(tmp_path):
    """A slide is aligned again; foam is scored by its markers."""
    file = write_csv(tmp_path / "a.csv", SLIDE)
    experiment = load_experiment("FoamShearing-hard")
    foam = np.tile(start_values(experiment), (experiment.frame_count, 1))
    markers_m = np.tile(experiment.scene.markers.positions_m, (len(foam), 1, 1))
    np.savez(tmp_path / "b.npz", g=foam, markers_m=markers_m)
    for first, name in ((file, NAME), (tmp_path / "b.npz", experiment.name)):
        result, _ = score_file(first, variant=name)
        stored = tmp_path / "result.json"
        stored.write_text(json.dumps(result.to_dict()))
        again = score_file(stored)[0].score
        for field in ("rmse", "rmse_aligned", "time_offset_s", "solution_distance"):
            expected = getattr(result.score, field)
            assert getattr(again, field) == pytest.approx(expected, abs=1e-4)
    np.savez(tmp_path / "b.npz", g=foam, markers_m=1e3 * markers_m)
    with pytest.raises(TrajectoryFileError, match=r"markers_m: .* like millimetres"):
        score_file(tmp_path / "b.npz", variant=experiment.name)


def test_a_file_is_scored_by_the_trial_or_the_scatter_that_it_starts_with(tmp_path):
    toss = "CubeToss-acrylic"
    trial = reference_band(with_trial(load_experiment(toss), 3)).mean
    file = write_csv(tmp_path / "toss.csv", trial, header="x,y,z")
    result, _ = score_file(file, variant=toss)
    assert (result.jitter, result.score.rmse) == ({"trial": 3}, pytest.approx(0.0))
    # A start may be six standard deviations of the given noise away.
    for position_m, is_accepted in ((0.014, False), (0.015, True)):
        content = {"id": NAME, "g": np.subtract(SLIDE, [0.0, 0.0, 118.0]).tolist()}
        content["jitter"] = {"position_m": position_m}
        file = tmp_path / "a.json"
        file.write_text(json.dumps(content))
        if is_accepted:
            assert score_file(file)[0].score.rmse > 0.0
            continue
        with pytest.raises(TrajectoryFileError, match="apart; real starts are within"):
            score_file(file)


@pytest.mark.parametrize(
    ("motion", "text"),
    [
        (lambda t: coulomb_slide(0.5 * t), "follows the reference at 60 Hz"),
        (
            lambda t: 2 * SLIDE[0] - coulomb_slide(t),
            "frame .* moves .* against the reference",
        ),
        (
            lambda t: coulomb_slide(np.minimum(t, 0.3)),
            "frame 9 .* to the end: cube keeps",
        ),
        (lambda t: 2 * SLIDE[0] - coulomb_slide(t), "offset .* a limit of its search"),
        (
            lambda t: coulomb_slide(t) + np.outer(t, [0.0, 600.0, 0.0]),
            r"frame 18 .*: 360 mm of motion across is not scored, mainly cube\.y",
        ),
    ],
)
def test_unusual_motion_is_noted_and_gives_no_estimate(tmp_path, motion, text):
    usual, notes = score_file(write_csv(tmp_path / "a.csv", SLIDE), variant=NAME)
    assert notes == ()
    assert usual.score.estimates["friction"].value == pytest.approx(0.2737, abs=1e-3)
    unusual, notes = score_file(
        write_csv(tmp_path / "a.csv", motion(TIMES)), variant=NAME
    )
    assert re.search(text, "\n".join(notes))
    assert not unusual.score.estimates


def lost(rows, value):
    places = SLIDE.copy()
    places[rows] = value
    return {"g": places}


def broken(row, column, text):
    rows = [[repr(float(v)) for v in r] for r in SLIDE]
    rows[row][column] = text
    return "cube.x,cube.y,cube.z\n" + "\n".join(map(",".join, rows))


def timed(times):
    return "time_s,x,y,z\n" + "\n".join(f"{t},1,2,3" for t in times)


NAN_ROW = SLIDE.copy()
NAN_ROW[3, 1] = np.nan


@pytest.mark.parametrize(
    ("suffix", "content", "text"),
    [
        (".csv", "1,2\n3,4\n", r"line 1: 2 columns, expected 3 columns \[mm\]: cube.x"),
        (".csv", broken(4, 1, "nan"), r"line 6: cube.y is 'nan', .* number \[mm\]"),
        (".csv", "cube.x [m],cube.y,cube.z\n1,2,3\n", r"in \[m\], expected \[mm\]"),
        (".csv", "1,2,3\n" * 18, r"18 rows end at 0\.5667 s; 19 frames are needed"),
        (".csv", "1,2,3\n" * 20, "20 rows without time_s look like another rate"),
        (".npz", {"g": coulomb_slide(np.arange(58) / 60.0)}, "58 rows .* like 60 Hz"),
        (
            ".npz",
            lost(slice(8, 11), 0.0),
            r"rows 8 to 10 \(t = 0.2667 s\): cube.x is 0",
        ),
        (".npz", lost(slice(8, 11), SLIDE[8]), r"rows 8 to 10 .* the marker was lost"),
        (".npz", lost(slice(16, 19), 0.0), "rows 16 to 18 .* the marker was lost"),
        (
            ".npz",
            {"g": SLIDE[np.arange(19) // 3 * 3]},
            "rows 9 to 11 .* marker was lost",
        ),
        (".csv", broken(0, 1, "0"), r"row 0 .* cube\.y is 0"),
        (".csv", broken(4, 1, "-9999"), r"row 4 .*: cube\.y is -9999"),
        (".csv", broken(12, 2, "150"), r"row 12 .*: cube\.z is 150"),
        (".csv", timed(1e3 * TIMES), "no sample at frame 1 .* look like milliseconds"),
        (".csv", timed([0.0, 0.2, 0.1, 0.6]), r"row 2: time_s is 0\.1 after 0\.2"),
        (".csv", timed([0.0, 1 / 30, 0.5, 0.6]), r"frame 2 .* nearest is at 0\.0333 s"),
        (".npz", {"g": NAN_ROW}, "g, row 3: cube.y is nan"),
        (".json", '{"g": [[1, 2, 3]], "time_s": [0, 1]}', "time_s: .* list of 1 times"),
        (".xlsx", "", "unknown suffix '.xlsx'"),
    ],
)
def test_a_likely_mistake_is_named_with_its_place(tmp_path, suffix, content, text):
    file = tmp_path / f"flawed{suffix}"
    if suffix == ".npz":
        np.savez(file, **content)
    else:
        file.write_text(content)
    with pytest.raises(TrajectoryFileError, match=text):
        score_file(file, variant=NAME)


def test_the_id_is_needed_and_must_not_contradict_the_file(tmp_path):
    file = write_csv(tmp_path / "a.csv", SLIDE)
    with pytest.raises(TrajectoryFileError, match="has no id"):
        score_file(file)
    with pytest.raises(TrajectoryFileError, match="No such file"):
        score_file(tmp_path / "b.csv", variant=NAME)
    (tmp_path / "a.json").write_text(json.dumps({"id": NAME, "g": SLIDE.tolist()}))
    with pytest.raises(TrajectoryFileError, match="not GAUGE/SlopeSlider-2-metal"):
        score_file(tmp_path / "a.json", variant="SlopeSlider-2-metal")


def with_rest(rest_s, rate_hz, *, noise_mm=0.0):
    """Return times and values of a slide after a rest, with noise of a normal distribution."""
    times_s = np.arange(round((rest_s + 0.6) * rate_hz) + 1) / rate_hz
    values = coulomb_slide(np.maximum(times_s - rest_s, 0.0))
    noise = np.random.default_rng(0).normal(0.0, noise_mm, values.shape)
    return times_s, values + noise


@pytest.mark.parametrize("rate_hz", [30, 60, 180])
@pytest.mark.parametrize("rest_s", [0.5, 1.0, 2.0, 5.0])
def test_a_long_rest_before_the_release_is_cropped_and_said(tmp_path, rest_s, rate_hz):
    times_s, values = with_rest(rest_s, rate_hz)
    file = write_csv(
        tmp_path / "a.csv",
        values,
        header="time_s,cube.x,cube.y,cube.z",
        times=times_s,
    )
    result, (note,) = score_file(file, variant=NAME, parameters="published")
    assert (
        note == f"the first {rest_s:g} s are at rest: cropped, so time 0 is the release"
    )
    after_s, after = with_rest(0.0, rate_hz)
    expected = score_trajectory(
        RESOLVED, reference_band(RESOLVED), times_s=after_s, values=after
    )
    assert result.score.rmse_aligned == pytest.approx(expected.rmse_aligned, rel=1e-6)
    assert result.score.cause is expected.cause


def test_a_rest_with_noise_and_without_times_is_cropped(tmp_path):
    _, values = with_rest(2.0, 30, noise_mm=0.1)
    read = read_trajectory(write_csv(tmp_path / "a.csv", values), RESOLVED)
    assert read.rest_s == pytest.approx(2.0, abs=1e-9)
    assert len(read.times_s) == FRAMES


def test_what_is_no_rest_before_a_release_is_kept(tmp_path):
    """A rest that the alignment finds, a body that never moves, a slide with a lost end, and a driven scene."""
    header = "time_s,cube.x,cube.y,cube.z"
    times_s, values = with_rest(0.3, 30)
    long_s, long = with_rest(2.0, 30)
    kept = {"short": (times_s, values), "still": (long_s, 0 * long + long[0])}
    kept["lost"] = (long_s[:-6], long[:-6])
    for name, (kept_s, rows) in kept.items():
        file = write_csv(tmp_path / f"{name}.csv", rows, header=header, times=kept_s)
        assert read_trajectory(file, RESOLVED).rest_s == 0.0
    driven = load_experiment("SlopeSlider-3-metal")
    file = write_csv(tmp_path / "driven.csv", long, header=header, times=long_s)
    assert read_trajectory(file, driven).rest_s == 0.0


@pytest.mark.parametrize(("across_mm", "count"), [(0.0, 0), (4.0, 0), (19.0, 1)])
def test_a_start_beside_the_board_is_said_beside_the_score(tmp_path, across_mm, count):
    normal = np.array([np.sin(np.radians(30.0)), 0.0, np.cos(np.radians(30.0))])
    file = write_csv(tmp_path / "a.csv", SLIDE + across_mm * normal)
    result, notes = score_file(file, variant=NAME)
    assert len(notes) == count
    assert all(f"{across_mm:g} mm off across" in note for note in notes)
    exact, _ = score_file(write_csv(tmp_path / "b.csv", SLIDE), variant=NAME)
    assert result.score.rmse == pytest.approx(exact.score.rmse, rel=1e-9)
    assert "friction" in result.score.estimates
