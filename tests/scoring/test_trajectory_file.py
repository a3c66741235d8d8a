"""Trajectory files of users: three formats give one score; each flaw is named with file, place and expectation."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from slide import FRAMES, NAME, RESOLVED, SLIDE, TIMES, coulomb_slide, write_csv

from gauge_envs import load_experiment, reference_band, score_trajectory
from gauge_envs.errors import TrajectoryFileError
from gauge_envs.runs.score_file import score_file
from gauge_envs.scoring.trajectory_file import read_trajectory


def test_a_closed_form_slide_in_a_csv_scores_as_in_the_library(tmp_path):
    file = write_csv(tmp_path / "slide.csv", SLIDE)
    result, interpolated = score_file(file, variant=NAME)
    expected = score_trajectory(
        RESOLVED, reference_band(RESOLVED), times_s=TIMES, values=SLIDE
    )
    # Nobody knows the constants of a CSV file, and so its exact solution.
    assert result.score == replace(expected, exact=None) != expected
    # scoring/README.md: an ideal Coulomb cube with the calibrated friction scores 0.41.
    assert result.score.rmse_normalized == pytest.approx(0.41, abs=0.005)
    assert (interpolated, result.backend, result.wall_s, result.seed) == (
        0,
        None,
        None,
        None,
    )
    assert (result.settings, result.frames, result.sim_s) == (
        {},
        FRAMES,
        pytest.approx(0.6),
    )


def test_csv_npz_and_json_score_the_same(tmp_path):
    csv = write_csv(
        tmp_path / "a.csv",
        SLIDE,
        header="time_s,cube.x [mm],cube.y [mm],cube.z [mm]",
        times=TIMES,
    )
    np.savez(tmp_path / "a.npz", g=SLIDE, time_s=TIMES)
    (tmp_path / "a.json").write_text(
        json.dumps({"id": NAME, "time_s": TIMES.tolist(), "g": SLIDE.tolist()})
    )
    scores = [
        score_file(tmp_path / f"a.{s}", variant=NAME)[0].score for s in ("npz", "json")
    ]
    scores += [
        score_file(csv, variant=NAME)[0].score,
        score_file(tmp_path / "a.json")[0].score,
    ]
    assert all(score == scores[0] for score in scores)


@pytest.mark.parametrize(
    "header", ["cube.z,cube.x,cube.y", "# made by hand\ncube.z,cube.x,cube.y"]
)
def test_named_columns_may_come_in_any_order(tmp_path, header):
    file = write_csv(tmp_path / "a.csv", SLIDE[:, [2, 0, 1]], header=header)
    np.testing.assert_array_equal(read_trajectory(file, RESOLVED).values, SLIDE)


def test_other_headers_and_no_header_go_by_position(tmp_path):
    for header in ("", "px,py,pz"):
        np.testing.assert_array_equal(
            read_trajectory(
                write_csv(tmp_path / "a.csv", SLIDE, header=header), RESOLVED
            ).values,
            SLIDE,
        )


def test_numpys_commented_header_names_the_time(tmp_path):
    np.savetxt(
        tmp_path / "a.csv",
        np.column_stack([TIMES, SLIDE]),
        delimiter=",",
        header="time_s,x,y,z",
    )
    np.testing.assert_allclose(
        read_trajectory(tmp_path / "a.csv", RESOLVED).values, SLIDE
    )


def test_times_with_three_digits_are_frames(tmp_path):
    file = write_csv(
        tmp_path / "a.csv", SLIDE, header="time_s,x,y,z", times=np.round(TIMES, 3)
    )
    read = read_trajectory(file, RESOLVED)
    np.testing.assert_allclose(read.times_s, TIMES)
    np.testing.assert_array_equal(read.values, SLIDE)
    assert read.interpolated_frames == 0


def test_frames_between_samples_are_interpolated_and_counted(tmp_path):
    times = np.arange(0.0, 0.61, 0.01)
    file = write_csv(
        tmp_path / "a.csv", coulomb_slide(times), header="time_s,x,y,z", times=times
    )
    read = read_trajectory(file, RESOLVED)
    assert read.interpolated_frames == 12  # every frame but those at multiples of 0.1 s
    at_frames = read.values[np.isin(read.times_s, TIMES)]
    np.testing.assert_allclose(at_frames, SLIDE, atol=0.04)  # a dt^2 / 8 = 0.032 mm


def test_ten_frames_after_the_last_one_serve_the_alignment_and_nothing_else_is_used(
    tmp_path,
):
    times = np.arange(2 * FRAMES) / 30.0
    longer = coulomb_slide(times)
    file = write_csv(tmp_path / "a.csv", longer, header="time_s,x,y,z", times=times)
    result, _ = score_file(file, variant=NAME)
    ten_more, _ = score_file(
        write_csv(tmp_path / "b.csv", longer[: FRAMES + 10]), variant=NAME
    )
    exact, _ = score_file(write_csv(tmp_path / "c.csv", SLIDE), variant=NAME)
    assert result.score == ten_more.score
    assert (result.score.rmse, result.score.dtw) == (exact.score.rmse, exact.score.dtw)
    assert result.frames == exact.frames == len(result.trajectory.times_s) == FRAMES
    assert len(result.trajectory.later_times_s) == 10


def test_later_frames_do_not_count_as_markers(tmp_path):
    experiment = load_experiment("CantileverBeam-soft")
    markers = 1e3 * np.asarray(experiment.scene.markers.positions_m).ravel()
    rows = np.tile(markers, (experiment.frame_count + 10, 1))
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",")
    read = read_trajectory(tmp_path / "a.csv", experiment)
    assert read.markers_m.shape == (
        experiment.frame_count,
        len(experiment.scene.markers.positions_m),
        3,
    )


def test_a_file_that_ends_with_the_last_frame_is_not_shifted_to_earlier_times(tmp_path):
    """Real cubes of SlopeSlider-2-plastic slide earlier than the calibrated one."""
    plastic = "SlopeSlider-2-plastic"
    longer = (
        1e3 * np.array(load_experiment(plastic).scene.body("cube").pose.position_m)
        + coulomb_slide(np.arange(27) / 30.0)
        - coulomb_slide(np.zeros(1))
    )
    cut, _ = score_file(write_csv(tmp_path / "a.csv", longer[:17]), variant=plastic)
    whole, _ = score_file(write_csv(tmp_path / "b.csv", longer), variant=plastic)
    assert cut.score.time_offset_s >= 0.0 > whole.score.time_offset_s
    assert whole.score.rmse_aligned < 0.5 * cut.score.rmse_aligned


def broken(row, column, text):
    rows = [[repr(float(v)) for v in r] for r in SLIDE]
    rows[row][column] = text
    return "cube.x,cube.y,cube.z\n" + "\n".join(map(",".join, rows))


def timed(times):
    return "time_s,x,y,z\n" + "\n".join(f"{t},1,2,3" for t in times)


FLAWED_CSV = {
    "empty": ("", ["file is empty"]),
    "header only": ("cube.x,cube.y,cube.z\n", ["0 rows", "19 frames are needed"]),
    "two columns": (
        "1,2\n3,4\n",
        ["line 1", "2 columns", "expected 3 columns [mm]: cube.x, cube.y, cube.z"],
    ),
    "time without header": (
        "0,1,2,3\n",
        ["line 1", "4 columns", "a header names a column of times time_s"],
    ),
    "tabs": ("1\t2\t3\n", ["header", "separated by commas"]),
    "ragged": ("1,2,3\n1,2\n", ["line 2", "2 columns"]),
    "nan": (broken(4, 1, "nan"), ["line 6", "cube.y", "'nan'", "finite number [mm]"]),
    "text": (broken(7, 0, "abc"), ["line 9", "cube.x", "'abc'"]),
    "blank field": (broken(7, 0, ""), ["line 9", "cube.x"]),
    "huge": (broken(7, 0, "1e300"), ["line 9", "cube.x", "at most"]),
    "too short": ("1,2,3\n" * 5, ["5 rows end at 0.1333 s", "19 frames are needed"]),
    "60 Hz": (
        "1,2,3\n" * 37,
        ["37 rows without time_s look like 60 Hz", "Add a column time_s"],
    ),
    "late start": (timed(1.0 + TIMES), ["row 0", "time_s is 1", "expected 0"]),
    "backwards": (
        timed([0.0, 0.2, 0.1, 0.6]),
        ["row 2", "time_s is 0.1 after 0.2", "increasing"],
    ),
    "gap": (
        timed([0.0, 1 / 30, 0.5, 0.6]),
        ["no sample at frame 2", "0.0333", "0.5000"],
    ),
    "milliseconds": (timed(1e3 * TIMES), ["no sample", "look like milliseconds"]),
    "frame numbers": (timed(range(19)), ["no sample", "look like frame numbers"]),
    "bad time": (timed([0.0, "x"]), ["line 3", "time_s is 'x'", "number [s]"]),
    "metres": (
        "cube.x [m],cube.y [m],cube.z [m]\n1,2,3\n",
        ["header", "cube.x is in [m]", "expected [mm]"],
    ),
    "wrong name": ("cube.x,cube.y,cube.w\n1,2,3\n", ["header", "cube.w", "cube.z"]),
    "time name": ("t,x,y,z\n0,1,2,3\n", ["header", "time_s for the times"]),
    "twice": ("cube.x,cube.x,cube.z\n1,2,3\n", ["header", "cube.x, cube.x"]),
    "header width": ("time_s,a,b\n0,1,2\n", ["header", "expected 3 columns"]),
}


NAN_ROW = SLIDE.copy()
NAN_ROW[3, 1] = np.nan

FLAWED_NPZ = {
    "no g": ({"x": SLIDE}, ["no list 'g'"]),
    "shape": ({"g": SLIDE[:, :2]}, ["g, row 0", "2 columns", "expected 3"]),
    "flat": ({"g": SLIDE[:, 0]}, ["g, row 0", "no list", "expected 3"]),
    "nan": ({"g": NAN_ROW}, ["g, row 3", "cube.y", "nan", "finite"]),
    "text": ({"g": SLIDE.astype(str)}, ["g: holds", "expected numbers"]),
    "objects": ({"g": SLIDE.astype(object)}, ["not an NPZ file"]),
    "time length": ({"g": SLIDE, "time_s": TIMES[:5]}, ["time_s", "list of 19 times"]),
    "markers": ({"g": SLIDE, "markers_m": SLIDE}, ["markers_m: shape is [19, 3]"]),
}


FLAWED_JSON = {
    "not json": ("{", ["not a JSON file"]),
    "a list": ("[1]", ["expected a JSON object", "list"]),
    "no g": ('{"x": 1}', ["no list 'g'", "expected 3 columns"]),
    "null": ('{"g": [[1, 2, null]]}', ["g, row 0", "cube.z is None"]),
    "nested": ('{"g": [[1, 2, [3]]]}', ["g, row 0", "cube.z is [3]"]),
    "huge": ('{"g": [[1, 2, 1' + "0" * 400 + "]]}", ["cube.z is 10000"]),
    "times": ('{"g": [[1, 2, 3]], "time_s": [0, 1]}', ["time_s", "list of 1 times"]),
    "id": ('{"id": 7, "g": []}', ["id is 7", "expected text"]),
}


FLAWED = {".csv": FLAWED_CSV, ".npz": FLAWED_NPZ, ".json": FLAWED_JSON}


@pytest.mark.parametrize(
    ("suffix", "flaw"),
    [(suffix, flaw) for suffix, flaws in FLAWED.items() for flaw in flaws],
)
def test_a_flawed_file_is_named_with_the_place_and_what_would_be_right(
    tmp_path, suffix, flaw
):
    content, expected = FLAWED[suffix][flaw]
    file = tmp_path / f"flawed{suffix}"
    if suffix == ".npz":
        np.savez(file, **content)
    else:
        file.write_text(content)
    with pytest.raises(TrajectoryFileError) as error:
        score_file(file, variant=NAME)
    for part in (str(file), *expected):
        assert part in str(error.value)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("no.csv", "No such file"),
        (".", "unknown suffix"),
        ("a.xlsx", "unknown suffix '.xlsx'"),
    ],
)
def test_unreadable_files(tmp_path, name, expected):
    with pytest.raises(TrajectoryFileError, match=expected):
        read_trajectory(tmp_path / name, RESOLVED)


def test_the_id_is_needed_and_must_not_contradict_the_file(tmp_path):
    file = write_csv(tmp_path / "a.csv", SLIDE)
    with pytest.raises(TrajectoryFileError, match="states no id"):
        score_file(file)
    (tmp_path / "a.json").write_text(json.dumps({"id": NAME, "g": SLIDE.tolist()}))
    with pytest.raises(TrajectoryFileError, match="SlopeSlider-2-metal was asked for"):
        score_file(tmp_path / "a.json", variant="SlopeSlider-2-metal")


@pytest.mark.parametrize(
    ("name", "first", "unit"),
    [
        (NAME, ("cube.x", "cube.y", "cube.z"), "mm"),
        ("TextileFlinging-satin", ("marker-0", "marker-1"), "rad"),
        ("FoamBending-soft", ("face-0", "face-1"), "mm^2"),
        ("CantileverBeam-soft", ("marker-0.x", "marker-0.y", "marker-0.z"), "mm"),
        ("TextileBending-satin", ("marker-2", "marker-3"), "rad"),
    ],
)
def test_coordinates_of_every_observable_have_names(name, first, unit):
    experiment = load_experiment(name)
    assert experiment.coordinates[: len(first)] == first
    assert experiment.spec.score.observable.unit == unit


def only_a_trajectory_file_error(folder, suffix, content):
    file = folder / f"random.{suffix}"
    file.write_bytes(content)
    try:
        read = read_trajectory(file, RESOLVED)
    except TrajectoryFileError:
        return
    assert np.isfinite(read.values).all()
    assert (np.diff(read.times_s) > 0).all()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("random")


CELL = st.sampled_from(
    [
        "",
        " ",
        "0",
        "1",
        "-1e9",
        "nan",
        "1e400",
        "x",
        "#",
        "time_s",
        "cube.x",
        '"',
        "[",
        "0.0333",
    ]
)


@settings(max_examples=150, deadline=None)
@given(rows=st.lists(st.lists(CELL, max_size=5), max_size=25))
def test_odd_tables_are_only_ever_a_trajectory_file_error(folder, rows):
    only_a_trajectory_file_error(folder, "csv", "\n".join(map(",".join, rows)).encode())


LEAF = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3)
VALUE = st.recursive(LEAF, st.lists, max_leaves=8)


@settings(max_examples=150, deadline=None)
@given(g=VALUE, time_s=VALUE)
def test_odd_json_is_only_ever_a_trajectory_file_error(folder, g, time_s):
    only_a_trajectory_file_error(
        folder, "json", json.dumps({"g": g, "time_s": time_s}).encode()
    )
