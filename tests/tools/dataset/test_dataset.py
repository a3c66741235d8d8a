"""Importing real trials: known statistics come back, whatever the folders spell, and bands and drivers are used."""

from __future__ import annotations

import json
import math
import tomllib
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from dataset_writer import (
    AMOUNTS,
    body_asset,
    marker_asset,
    scaled_markers,
    synthetic_trials,
    trial_content,
    trial_folder,
    write_synthetic,
    write_trial,
)
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation

import gauge_envs
from gauge_envs import load_experiment
from gauge_envs.errors import (
    DatasetError,
    ParameterError,
    ReferenceFileError,
    UnknownNameError,
)
from gauge_envs.evaluation.deformation import deformation_reference
from gauge_envs.evaluation.reference import band_grade, load_band
from gauge_envs.files import data_folder
from gauge_envs.references.bands import bundled_band
from gauge_envs.references.grades import BandGrade
from gauge_envs.references.imported import load_imported, recorded_drivers
from gauge_envs.references.published import published_baselines
from gauge_envs.references.user_data import DataSource, user_data_folder
from gauge_envs.runs.batch import run_many
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Result
from gauge_envs.runs.result_file import (
    load_result,
    recorded_experiment,
    result_file_name,
)
from gauge_envs.scene.drivers import DriverMotion
from gauge_envs.scene.profiles import SampledProfile
from gauge_envs.tools.compare.comparison import compare
from gauge_envs.tools.dataset.importer import ImportedTrials, import_trials
from gauge_envs.tools.dataset.layout import find_trials, write_revision
from gauge_envs.tools.dataset.observation import driver_tracks
from gauge_envs.tools.dataset.trial import parse_trial
from scripts import build_bands

AMOUNT = np.array(AMOUNTS)
TOLERANCE = 1e-9

# One of each irregularity: spelling, subtask folders, no material folder, material names, sorted ids, several bodies.
IRREGULAR = (
    "SlopeSlider-2-wood",
    "NonsmoothContact-1-wood",
    "NonsmoothContact-2-plastic",
    "NonsmoothContact-3-plastic",
    "BouncingBall-rubber",
    "FoamCompressing-soft",
    "RopeWinding-rubber",
    "TableclothPulling-metal",
)


IMPORTED = {"drivers": "imported", "reference": "imported"}


def imported(root: Path, *only: str) -> dict[str, ImportedTrials]:
    return {
        one.variant.name: one
        for one in import_trials(find_trials(root, only=only or ("*",)))
    }


def band_of(name: str):
    band = load_band(name, DataSource.IMPORTED)
    assert band is not None
    return band


def assert_spread(spread, values) -> None:
    assert spread.mean == pytest.approx(np.mean(values), abs=TOLERANCE)
    assert spread.std == pytest.approx(np.std(values, ddof=1), abs=TOLERANCE)
    assert spread.trial_count == len(values)


# --- statistics ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", IRREGULAR)
def test_known_statistics_come_back(name: str, tmp_path: Path) -> None:
    experiment = write_synthetic(tmp_path, name).experiment
    one = imported(tmp_path)[name]
    assert (one.used, one.left_out, one.findings) == (len(AMOUNTS), 0, ())
    band = band_of(name)
    frames = experiment.frame_count
    if (
        experiment.recorded
    ):  # every body is off by the amount along y, a right angle to where it goes
        starts = 1e3 * np.concatenate(
            [
                experiment.scene.body(body).pose.position_m
                for body in experiment.recorded
            ]
        )
        steps = np.tile([2.0, 0.0, 0.0], len(experiment.recorded))
        mean = starts + np.arange(frames)[:, None] * steps
        sigma = np.tile(
            [0.0, AMOUNT.std(ddof=1), 0.0], (frames, len(experiment.recorded))
        )
        distance = np.abs(AMOUNT) * math.sqrt(len(experiment.recorded))
    else:  # faces grow with the square of the scale
        areas = face_areas(
            scaled_markers(experiment, 0.0), experiment.scene.markers.faces
        )
        growth = (1.0 + 1e-3 * AMOUNT) ** 2
        mean = np.tile(growth.mean() * areas, (frames, 1))
        sigma = np.tile(growth.std(ddof=1) * areas, (frames, 1))
        distance = np.abs(growth - growth.mean()) * np.linalg.norm(areas)
    np.testing.assert_allclose(band.mean, mean, rtol=0, atol=TOLERANCE)
    np.testing.assert_allclose(band.sigma, sigma, rtol=0, atol=TOLERANCE)
    assert band.measured.all()
    own = {row.metric: row.own for row in one.rows}
    # All differences are constant, so that warping in time cannot reduce them.
    assert_spread(own["rmse"], distance)
    assert_spread(own["dtw"], distance)


def face_areas(markers_mm: np.ndarray, faces) -> np.ndarray:
    """Heron's formula, face by face."""
    areas = []
    for face in faces:
        a, b, c = (
            math.dist(markers_mm[face[k]], markers_mm[face[k - 1]]) for k in range(3)
        )
        s = 0.5 * (a + b + c)
        areas.append(math.sqrt(s * (s - a) * (s - b) * (s - c)))
    return np.array(areas)


def with_markers(name: str, shapes: list[np.ndarray]) -> list[dict]:
    """Trials of a variant whose markers keep one shape each [mm], shape [marker_count, 3]."""
    synthetic = synthetic_trials(name, [0.0] * len(shapes))
    key = synthetic.experiment.scene.markers.bodies[0]
    for content, shape in zip(synthetic.contents, shapes, strict=True):
        count = synthetic.experiment.frame_count
        driver = synthetic.experiment.scene.drivers[0].body
        content[driver] = {
            axis: values[:count] for axis, values in content[driver].items()
        }
        content[key] = marker_asset(
            np.repeat(shape[None], count, axis=0), [7 * k for k in range(len(shape))]
        )
    return synthetic.contents


def test_curvature_of_a_raised_marker(tmp_path: Path) -> None:
    name = "TextileStretching-leather"
    experiment = load_experiment(name)
    rest = 1e3 * np.asarray(experiment.scene.markers.positions_m)
    markers = experiment.scene.markers
    raised = next(
        k for k in range(len(rest)) if k not in (*markers.edge, *markers.corner)
    )
    normal = np.linalg.svd(rest - rest.mean(axis=0))[2][2]
    shapes, expected = [], []
    for number, height in enumerate((10.0, 20.0, 25.0)):
        shape = rest.copy()
        shape[raised] += height * normal
        shapes.append(shape)
        around = 0.0
        for face in experiment.scene.markers.faces:
            if raised in face:
                one, two = (shape[k] - shape[raised] for k in face if k != raised)
                around += math.acos(
                    one @ two / np.linalg.norm(one) / np.linalg.norm(two)
                )
        expected.append(2 * math.pi - around)
        write_trial(tmp_path, name, number, with_markers(name, shapes)[number])
    assert imported(tmp_path)[name].used == 3
    band = band_of(name)
    assert band.unit == "rad"
    np.testing.assert_allclose(band.mean[:, raised], np.mean(expected), atol=TOLERANCE)
    np.testing.assert_allclose(
        band.sigma[:, raised], np.std(expected, ddof=1), atol=TOLERANCE
    )


def test_curvature_of_a_folded_strip(tmp_path: Path) -> None:
    name = "TextileBending-rayon"
    experiment = load_experiment(name)
    rest = 1e3 * np.asarray(experiment.scene.markers.positions_m)
    angles = np.array([0.3, 0.4, 0.6])
    fold = rest[6, 0]
    shapes = []
    for angle in angles:
        over = rest[:, 0] > fold
        shape = rest.copy()
        shape[over, 0] = fold + (rest[over, 0] - fold) * math.cos(angle)
        shape[over, 2] += (rest[over, 0] - fold) * math.sin(angle)
        shapes.append(shape)
    for number, content in enumerate(with_markers(name, shapes)):
        write_trial(tmp_path, name, number, content)
    imported(tmp_path)
    band = band_of(name)
    columns = [band.coordinates.index(f"marker-{k}") for k in (6, 7)]
    np.testing.assert_allclose(band.mean[:, columns], angles.mean(), atol=TOLERANCE)
    np.testing.assert_allclose(
        band.sigma[:, columns], angles.std(ddof=1), atol=TOLERANCE
    )
    assert np.delete(band.sigma, columns, axis=1).max() < TOLERANCE


def test_missing_samples_are_left_out_of_mean_and_scatter(tmp_path: Path) -> None:
    name = "SlopeSlider-1-wood"
    synthetic = synthetic_trials(name)
    contents = synthetic.contents
    contents[0]["cube"]["y"][3] = None  # one of four
    for content in contents[:3]:
        content["cube"]["z"][5] = float("nan")  # three of four
    for content in contents:
        for key in "xyz":
            content["cube"][key][7] = None  # all
    for number, content in enumerate(contents):
        write_trial(tmp_path, name, number, content)
    assert imported(tmp_path)[name].findings == ()
    band = band_of(name)
    start = 1e3 * np.asarray(synthetic.experiment.scene.body("cube").pose.position_m)
    assert band.mean[3, 1] == pytest.approx(start[1] + AMOUNT[1:].mean(), abs=TOLERANCE)
    assert band.sigma[3, 1] == pytest.approx(AMOUNT[1:].std(ddof=1), abs=TOLERANCE)
    assert band.mean[5, 2] == pytest.approx(start[2], abs=TOLERANCE)
    assert np.isnan(band.sigma[5, 2]) and np.isfinite(band.sigma[5, :2]).all()
    assert np.isnan(band.mean[7]).all() and np.isnan(band.sigma[7]).all()
    assert band.measured.tolist() == [
        frame != 7 for frame in range(synthetic.experiment.frame_count)
    ]
    score = run_episode(RunRequest(name, **IMPORTED)).score
    assert score.rmse is not None and score.mean_abs_z is not None


def test_a_marker_out_of_sight_hides_its_faces_alone(tmp_path: Path) -> None:
    name = "FoamStretching-soft"
    contents = synthetic_trials(name).contents
    markers = contents[0]["foam"]
    hidden = min(markers, key=int)  # the first marker of the metadata
    for key in "xyz":
        markers[hidden][key][4] = None
    for number, content in enumerate(contents):
        write_trial(tmp_path, name, number, content)
    imported(tmp_path)
    band = band_of(name)
    faces = load_experiment(name).scene.markers.faces
    growth = (1.0 + 1e-3 * AMOUNT) ** 2
    areas = face_areas(scaled_markers(load_experiment(name), 0.0), faces)
    mean = (
        np.where([0 in face for face in faces], growth[1:].mean(), growth.mean())
        * areas
    )
    np.testing.assert_allclose(band.mean[4], mean, rtol=0, atol=TOLERANCE)
    np.testing.assert_allclose(
        band.mean[3], growth.mean() * areas, rtol=0, atol=TOLERANCE
    )


def test_short_trials_count_where_no_length_is_published(tmp_path: Path) -> None:
    name = "TableclothPulling-wood"
    assert not published_baselines(name)
    contents = synthetic_trials(name, frames_after=0).contents
    for asset in ("cube", "rod"):
        contents[0][asset] = {
            key: values[:50] for key, values in contents[0][asset].items()
        }
    for number, content in enumerate(contents):
        write_trial(tmp_path, name, number, content)
    assert imported(tmp_path)[name].used == 4
    start = (
        1e3 * np.asarray(load_experiment(name).scene.body("cube").pose.position_m)[1]
    )
    mean = band_of(name).mean[:, 1]
    assert mean[49] == pytest.approx(start) and mean[50] == pytest.approx(
        start + AMOUNT[1:].mean()
    )


def test_events_of_the_pendulum_have_baselines(tmp_path: Path) -> None:
    """Undamped swings of known period, all the same: 300 frames hold 9 periods of 10/9 s."""
    name = "Pendulum-metal"
    hinge = load_experiment(name).scene.joints[0]
    times = np.arange(3000) / 30.0
    start = np.asarray(load_experiment(name).scene.body("ball").pose.position_m)
    length = np.linalg.norm(start - hinge.anchor_m)
    for number, sign in enumerate((1.0, -1.0)):
        angle = math.pi / 6 * np.cos(2 * math.pi * 0.9 * times)
        x, z = sign * length * np.sin(angle), -length * np.cos(angle)
        positions = 1e3 * (np.column_stack([x, 0 * x, z]) + hinge.anchor_m)
        write_trial(
            tmp_path, name, number, trial_content({"ball": body_asset(positions)})
        )
    rows = {row.metric: row for row in imported(tmp_path)[name].rows}
    assert rows["pd"].own.mean == pytest.approx(
        10 / 9, abs=1e-4
    )  # the spectrum's peak is interpolated
    assert rows["pd"].published.mean == 1.14 and not rows["pd"].is_flagged
    assert rows["el"].own.mean == pytest.approx(0.0, abs=1e-6)
    assert rows["el"].difference is None  # the published mean is 0


@pytest.mark.slow
def test_all_75_experiments_are_found_in_their_folders(tmp_path: Path) -> None:
    for number, variant in enumerate(gauge_envs.variants()):
        write_synthetic(
            tmp_path, variant.name, (1.0 + 1e-3 * number, -1.0 - 1e-3 * number)
        )
    found = imported(tmp_path)
    assert list(found) == [variant.name for variant in gauge_envs.variants()]
    assert all(one.used == 2 and not one.left_out for one in found.values())
    assert {band_grade(name, DataSource.IMPORTED) for name in found} == {
        BandGrade.TRIALS
    }


# --- the published baselines, again ----------------------------------------------------------------------------------


def write_reconstruction(root: Path) -> None:
    """The bundled facts' trials in the dataset's layout: one coordinate was measured, the others are at the start."""
    for name, trials in build_bands.reconstruct(data_folder("scoring")).items():
        experiment = load_experiment(name)
        (body,) = experiment.recorded
        direction, start = (
            np.array(trials.direction),
            1e3 * np.asarray(experiment.scene.body(body).pose.position_m),
        )
        across = start - (start @ direction) * direction
        for number, along in enumerate(trials.positions_mm):
            content = trial_content(
                {body: body_asset(across + along[:, None] * direction)}
            )
            write_trial(root, name, number, content)


def test_published_baselines_come_out_of_the_importer(tmp_path: Path) -> None:
    bundled = {
        name: bundled_band(name)
        for name in build_bands.reconstruct(data_folder("scoring"))
    }
    write_reconstruction(tmp_path)
    found = imported(tmp_path)
    assert set(found) == set(bundled)
    for name, one in found.items():
        facts = tomllib.loads(
            (data_folder("scoring") / "bands" / f"{name}.toml").read_text(
                encoding="utf-8"
            )
        )
        for row in one.rows:
            assert row.own.mean == pytest.approx(facts[row.metric]["mean"], abs=1e-6)
            assert row.own.std == pytest.approx(facts[row.metric]["std"], abs=1e-6)
            assert row.published == published_baselines(name)[row.metric]
            assert row.is_flagged == (abs(row.own.mean / row.published.mean - 1) > 0.05)
        mine, theirs = band_of(name), bundled[name]
        assert mine.trial_count == theirs.trial_count
        np.testing.assert_allclose(
            mine.mean @ theirs.projection.T, theirs.mean, atol=1e-6
        )
        # One direction has all the scatter, so that its share along x, y and z adds up to the bundled sigma.
        np.testing.assert_allclose(
            np.linalg.norm(mine.sigma, axis=1), theirs.sigma[:, 0], atol=1e-6
        )
    flagged = {
        (name, row.metric)
        for name, one in found.items()
        for row in one.rows
        if row.is_flagged
    }
    assert flagged == {("SlopeSlider-2-plastic", "dtw"), ("SlopeSlider-2-metal", "dtw")}


# --- what uses an import ---------------------------------------------------------------------------------------------


def test_an_import_is_used_when_asked_for_and_shown(tmp_path: Path, gauge) -> None:
    name = "SlopeSlider-3-wood"
    assert not band_grade(name).is_real
    synthetic = write_synthetic(tmp_path, name)
    write_revision(tmp_path, "9e0acb7" + 33 * "0")
    result = gauge("data", "import", tmp_path)
    assert result.exit_code == 0
    assert "1.00" in result.stdout or "1 (0.456) mm" in result.stdout
    assert "gauge run ID --use imported" in result.stderr.replace("\n", " ")
    assert (band_grade(name), band_grade(name, DataSource.IMPORTED)) == (
        BandGrade.MODEL,
        BandGrade.TRIALS,
    )
    row = json.loads(gauge("list", name, "--json").stdout)
    assert (row["grade"], row["imported"]) == ("model", True)
    assert "trials imported" in gauge("list", name).stdout
    bundled = json.loads(gauge("show", name, "--json").stdout)["reference"]
    assert (bundled["grade"], bundled["imported"], bundled["is_import_available"]) == (
        "model",
        False,
        True,
    )
    options = ("--use", "imported")
    shown = json.loads(gauge("show", name, "--json", *options).stdout)
    assert shown["reference"]["imported"] and shown["reference"]["trial_count"] == 4
    assert "imported dataset revision 9e0acb7" in shown["reference"]["source"]
    (driver,) = shown["drivers"]
    assert (driver["provenance"], driver["imported"]) == ("mocap", True)
    values = driver["motions"][0]["profile"][0]["values_deg"]
    np.testing.assert_allclose(
        np.radians(values), synthetic.coordinates["board"][:, 0], atol=TOLERANCE
    )
    assert "Driver of board (mocap)" in gauge("show", name, *options).stdout
    status = json.loads(gauge("list", "references", name, "--json").stdout)
    assert (
        status["grade"],
        status["imported"],
        status["trials"],
        status["is_current"],
    ) == ("trials", True, 4, True)
    assert status["drivers"][0]["provenance"] == "mocap"
    assert {line["metric"]: line["published_mean"] for line in status["baselines"]} == {
        "rmse": 24.27,
        "dtw": 6.73,
    }
    assert "board: mocap" in gauge("list", "references", name).stdout


def test_results_are_scored_on_the_import_and_say_so(tmp_path: Path) -> None:
    name = "SlopeSlider-1-wood"
    before = run_episode(RunRequest(name))
    write_synthetic(tmp_path, name)
    imported(tmp_path)
    assert run_episode(RunRequest(name)).score == before.score
    after = run_episode(RunRequest(name, **IMPORTED))
    assert (before.score.grade, after.score.grade) == ("law", "trials")
    assert before.dataset == {"drivers": "bundled", "reference": "bundled"}
    assert after.dataset["revision"] == "unknown" and len(after.dataset["sha256"]) == 64
    simulated, mean = np.array(after.trajectory.samples)[::6], band_of(name).mean
    assert after.score.rmse == pytest.approx(
        math.sqrt(((simulated - mean) ** 2).sum(axis=1).mean()), rel=1e-12
    )


def test_resume_runs_again_what_was_scored_on_other_trials(tmp_path: Path) -> None:
    name, notes = "SlopeSlider-1-wood", []

    def run(**options) -> Result:
        requests = [RunRequest(name, **options)]
        return next(
            run_many(
                requests, out=tmp_path / "results", resume=True, notify=notes.append
            )
        )

    first = run()
    write_synthetic(tmp_path / "a", name)
    imported(tmp_path / "a")
    second = run(**IMPORTED)
    assert (first.score.grade, second.score.grade) == ("law", "trials")
    assert (
        load_result(tmp_path / "results" / result_file_name(second)).dataset
        == second.dataset
    )
    assert any(
        "of different imports, or bundled" in note
        for note in compare([first, second]).notes
    )
    assert not any("imports" in note for note in compare([second]).notes)
    assert (run().created, run(**IMPORTED).created, notes) == (
        first.created,
        second.created,
        [],
    )
    write_synthetic(tmp_path / "b", name, AMOUNTS[:2])
    imported(tmp_path / "b")
    third = run(**IMPORTED)
    assert third.dataset["sha256"] != second.dataset["sha256"]
    assert len(notes) == 1 and "dataset differs" in notes[0]


# --- drivers ---------------------------------------------------------------------------------------------------------

DRIVEN = (
    "SlopeSlider-3-plastic",
    "Turntable-2-wood",
    "FoamShearing-hard",
    "FoamTwisting-soft",
    "TextileStretching-nylon",
)


@pytest.mark.parametrize("name", DRIVEN)
def test_recorded_motion_becomes_the_driver(name: str, tmp_path: Path) -> None:
    synthetic = write_synthetic(tmp_path, name)
    bundled = synthetic.experiment
    one = imported(tmp_path)[name]
    experiment = load_experiment(name, **IMPORTED)
    assert (experiment.drivers, experiment.driver_provenance) == (
        DataSource.IMPORTED,
        "mocap",
    )
    for driver, stated, record in zip(
        experiment.scene.drivers, bundled.scene.drivers, one.record.drivers, strict=True
    ):
        wanted = synthetic.coordinates[driver.body]
        for number, motion in enumerate(driver.motions):
            (profile,) = motion.profiles
            assert isinstance(profile, SampledProfile)
            np.testing.assert_allclose(
                profile.values, wanted[:, number], rtol=0, atol=TOLERANCE
            )
            assert (motion.axis, motion.point_m) == (
                stated.motions[number].axis,
                stated.motions[number].point_m,
            )
            assert motion.residual_rate == stated.motions[number].residual_rate
        assert record.trial_count == len(AMOUNTS)
        assert (
            max(record.residual_mm, record.residual_deg, record.start_offset_mm) < 1e-6
        )
    assert load_experiment(name).scene.drivers == bundled.scene.drivers
    assert (
        load_experiment(name).parameters == "calibrated"
        and load_experiment(name).overrides == {}
    )


@given(
    kinds=st.sampled_from(
        [
            ("translate", "rotate", "translate"),
            ("rotate", "translate"),
            ("translate", "rotate"),
        ]
    ),
    seed=st.integers(0, 2**32 - 1),
)
@settings(max_examples=40, deadline=None)
def test_any_driver_with_one_turn_is_inverted(
    kinds: tuple[str, ...], seed: int
) -> None:
    random = np.random.default_rng(seed)
    frames = 20
    times = tuple((np.arange(frames) / 30.0).tolist())
    axes = np.linalg.qr(random.normal(size=(3, 3)))[0].T
    wanted = np.cumsum(random.normal(0.0, 0.02, (frames, len(kinds))), axis=0)
    wanted -= wanted[0]
    motions = tuple(
        DriverMotion(
            kind=kind,
            axis=tuple(axis.tolist()),
            point_m=tuple(random.normal(0.4, 0.1, 3).tolist()),
            profiles=(SampledProfile(times_s=times, values=tuple(values.tolist())),),
        )
        for kind, axis, values in zip(kinds, axes, wanted.T, strict=False)
    )
    experiment = load_experiment("Turntable-2-wood")
    driver = replace(experiment.scene.drivers[0], motions=motions)
    experiment = replace(
        experiment,
        scene=replace(experiment.scene, drivers=(driver,)),
        frame_count=frames,
    )
    poses = [
        driver.pose(experiment.scene.body("plate").pose, time_s) for time_s in times
    ]
    positions = 1e3 * np.array([pose.position_m for pose in poses])
    plate = body_asset(
        positions, Rotation.concatenate([pose.rotation for pose in poses])
    )
    trial = parse_trial(json.dumps(trial_content({"plate": plate})).encode())
    (track,) = driver_tracks(trial, experiment)
    np.testing.assert_allclose(track.coordinates, wanted, atol=1e-9)
    assert track.residual_mm.max() < 1e-9 and track.residual_rad.max() < 1e-7


def test_turns_are_counted_past_half_a_turn_and_noise_is_stated(tmp_path: Path) -> None:
    """A plate at 12 rad/s, in trials that start 1 mm apart, wobble by 0.5 mm and tilt by 1 degree."""
    name = "Turntable-3-metal"
    experiment = load_experiment(name)
    count = experiment.frame_count
    angles = 12.0 * np.arange(count) / 30.0
    later = (np.arange(count) > 0)[:, None]
    tilt = Rotation.from_rotvec(later * [1.0, 0.0, 0.0], degrees=True)
    for number, offset in enumerate((-1.0, 1.0)):
        content = synthetic_trials(name, AMOUNTS[:2], frames_after=0).contents[number]
        start = 1e3 * np.asarray(experiment.scene.body("plate").pose.position_m) + [
            offset,
            0.0,
            0.0,
        ]
        turn = Rotation.from_rotvec(angles[:, None] * [0.0, 0.0, 1.0])
        content["plate"] = body_asset(start + later * [0.0, 0.0, 0.5], tilt * turn)
        write_trial(tmp_path, name, number, content)
    (record,) = imported(tmp_path)[name].record.drivers
    share = math.sqrt((count - 1) / count)
    assert record.residual_mm == pytest.approx(0.5 * share, rel=1e-6)
    assert record.residual_deg == pytest.approx(1.0 * share, rel=1e-6)
    assert record.start_offset_mm == pytest.approx(1.0, rel=1e-6)
    assert (record.scatter_mm, record.scatter_deg) == (
        None,
        pytest.approx(0.0, abs=1e-5),
    )
    (profile,) = (
        load_experiment(name, drivers="imported").scene.drivers[0].motions[0].profiles
    )
    np.testing.assert_allclose(profile.values, angles, atol=1e-3)


def test_an_environment_drives_as_recorded_or_as_bundled(tmp_path: Path, gauge) -> None:
    name = "SlopeSlider-3-wood"
    write_synthetic(tmp_path, name)
    imported(tmp_path)

    def tilt(**options) -> float:
        env = gymnasium.make(f"GAUGE/{name}", **options)
        env.reset(seed=0)
        for _ in range(10):
            observation, *_ = env.step(np.zeros(env.action_space.shape))
        w, _, y, _ = observation["driver"][0, 3:7]
        return 2 * math.atan2(y, w)

    bundled = tilt()
    assert abs(bundled) > 0.02 and tilt(drivers="bundled") == bundled
    assert tilt(drivers="imported") == pytest.approx(0.010, abs=1e-6)
    result = run_episode(RunRequest(name))
    assert (result.driver_provenance, result.dataset) == (
        "nominal",
        {"drivers": "bundled", "reference": "bundled"},
    )
    assert "imported trials exist" in gauge("show", name).stdout.replace("\n", " ")
    result = run_episode(RunRequest(name, drivers="imported"))
    assert (result.driver_provenance, result.dataset["drivers"]) == (
        "mocap",
        "imported",
    )
    assert (result.dataset["reference"], result.score.grade) == ("bundled", "none")
    assert (
        recorded_experiment(result).scene.drivers
        == load_experiment(name, drivers="imported").scene.drivers
    )
    with pytest.raises(ParameterError, match="'bundled' or 'imported'"):
        gymnasium.make(f"GAUGE/{name}", drivers="recorded")


@pytest.mark.parametrize("name", ["SlopeSlider-3-wood", "SlopeSlider-2-wood"])
@pytest.mark.parametrize("argument", ["drivers", "reference"])
def test_what_was_not_imported_is_an_error_that_names_the_command(
    name: str, argument: str
) -> None:
    with pytest.raises(
        ParameterError, match=f"{name}: {argument}='imported'.*gauge data import DIR"
    ):
        load_experiment(name, **{argument: "imported"})


def test_info_states_where_drivers_and_reference_are_from(tmp_path: Path) -> None:
    name = "SlopeSlider-3-wood"
    write_synthetic(tmp_path, name)
    imported(tmp_path)
    for options, expected in (
        ({}, ("bundled", "bundled", "model")),
        (IMPORTED, ("imported", "imported", "trials")),
    ):
        _, info = gymnasium.make(f"GAUGE/{name}", **options).reset(seed=0)
        assert (
            info["drivers"],
            info["reference_source"],
            info["reference"],
        ) == expected


def test_trials_without_a_driver_still_make_a_band(tmp_path: Path) -> None:
    name = "Turntable-1-wood"
    contents = synthetic_trials(name).contents
    del contents[0]["plate"]
    for key in ("qx", "qy", "qz", "qw"):
        del contents[1]["plate"][key]
    contents[2]["plate"]["x"][0] = None
    for number, content in enumerate(contents):
        write_trial(tmp_path, name, number, content)
    one = imported(tmp_path)[name]
    assert (one.used, one.left_out) == (4, 0)
    assert [(finding.key, finding.left_out) for finding in one.findings] == [
        ("plate", False),
        ("plate.qx", False),
        ("plate[0]", False),
    ]
    assert one.record.drivers[0].trial_count == 1


# --- layout ----------------------------------------------------------------------------------------------------------


def test_folders_are_read_whatever_they_spell(tmp_path: Path) -> None:
    for name in (
        "FoamCompressing-hard",
        "BouncingBall-rubber",
        "TextileFlinging-uniform",
        "SlopeSlider-2-metal",
    ):
        write_synthetic(tmp_path, name, AMOUNTS[:2])
    data = tmp_path / "data"
    (data / "deformable" / "foam compression").rename(
        data / "deformable" / "Foam_Compressing"
    )
    ball = data / "rigid" / "bouncing ball" / "json"
    (ball / "soft").mkdir()
    (ball / "trial-1.json").rename(ball / "soft" / "trial-1.json")
    slider = data / "rigid" / "slope slider" / "json"
    (slider / "task-2").mkdir()
    (slider / "metal" / "task-2").rename(slider / "task-2" / "metal")
    (slider / "task-2" / "metal" / ".trial-9.json").write_text("hidden")
    (slider / "task-2" / "metal" / "notes.txt").write_text("not a trial")
    (data / "rigid" / "slope slider" / "video").mkdir()
    layout = find_trials(data)
    assert layout.findings == ()
    assert {variant.name: len(files) for variant, files in layout.files.items()} == {
        "BouncingBall-rubber": 2,
        "FoamCompressing-hard": 2,
        "SlopeSlider-2-metal": 2,
        "TextileFlinging-uniform": 2,
    }


def test_trials_are_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    contents = synthetic_trials("SlopeSlider-1-wood", range(12)).contents
    for number, content in enumerate(contents):
        write_trial(tmp_path, "SlopeSlider-1-wood", number, content)
    imported(tmp_path)
    record = load_imported("SlopeSlider-1-wood").record
    folder = trial_folder("SlopeSlider-1-wood")
    assert record.files == tuple(
        f"{folder}/trial-{number}.json" for number in range(12)
    )


@pytest.mark.parametrize(
    ("folder", "right"),
    [
        ("data/plasma/arc/json", "rigid, rope, textile, deformable"),
        ("data/rigid/slope sliders/json", "that of SlopeSlider"),
        ("data/rigid/slope slider/trials", "wood, plastic, metal"),
        ("data/rigid/slope slider/json/glass/task-1", "wood, plastic, metal"),
        ("data/rigid/slope slider/json/task-1", "wood, plastic, metal"),
        ("data/rigid/slope slider/json/wood", "task-1, task-2, task-3"),
        ("data/rigid/nonsmooth contact/json/wood/task-5", "task-1, task-2, task-3"),
        ("data/rigid/pendulum/json/metal/task-2", "no task folder"),
        ("data/rigid/slope slider/json/wood/task-1/task-2", "task-1, task-2, task-3"),
    ],
)
def test_folders_of_nothing_known_are_named(
    folder: str, right: str, tmp_path: Path, gauge
) -> None:
    write_synthetic(tmp_path, "SlopeContact-wood")
    (tmp_path / folder).mkdir(parents=True)
    (tmp_path / folder / "trial-1.json").write_text("{}")
    (finding,) = find_trials(tmp_path).findings
    assert finding.file in folder or finding.file.startswith(folder)
    assert right in finding.expected
    result = gauge("data", "import", tmp_path)
    assert result.exit_code == 1
    assert (
        finding.problem in result.stderr
        and "4 trials of 1 experiment imported" in result.stderr
    )


def test_no_dataset_is_an_error(tmp_path: Path, gauge) -> None:
    for wrong in (tmp_path / "missing", tmp_path):
        result = gauge("data", "import", wrong)
        assert result.exit_code == 2 and str(wrong) in result.stderr.replace("\n", "")
    (tmp_path / "data" / "rigid").mkdir(parents=True)
    with pytest.raises(DatasetError, match="contains no trial"):
        find_trials(tmp_path)
    with pytest.raises(UnknownNameError, match="SlopeSlider"):
        find_trials(tmp_path, only=["SlopeSlidr-2-wood"])


def test_only_imports_what_was_asked_for(tmp_path: Path) -> None:
    for name in ("SlopeSlider-1-wood", "SlopeSlider-1-metal", "SlopeContact-wood"):
        write_synthetic(tmp_path, name)
    assert set(imported(tmp_path, "GAUGE/SlopeSlider-*")) == {
        "SlopeSlider-1-wood",
        "SlopeSlider-1-metal",
    }
    assert load_imported("SlopeContact-wood") is None


# --- store -----------------------------------------------------------------------------------------------------------


def test_a_second_import_replaces_the_first(tmp_path: Path) -> None:
    name = "SlopeSlider-1-wood"
    write_synthetic(tmp_path, name)
    imported(tmp_path)
    first = load_imported(name)
    write_synthetic(tmp_path, name, [0.0, 4.0, 5.0, 6.0])
    imported(tmp_path)
    second = load_imported(name)
    assert second.band.sigma[0, 1] == pytest.approx(
        np.std([0.0, 4.0, 5.0, 6.0], ddof=1)
    )
    assert first.record.files_sha256 != second.record.files_sha256
    assert sorted(
        file.suffix for file in (user_data_folder() / "trials").glob("[!.]*")
    ) == [".json", ".npz"]


@pytest.mark.parametrize("suffix", [".json", ".npz"])
@pytest.mark.parametrize("content", [b"", b"{}", b"PK\x03\x04", None])
def test_a_damaged_store_is_named(
    suffix: str, content: bytes | None, tmp_path: Path, gauge
) -> None:
    name = "SlopeSlider-1-wood"
    write_synthetic(tmp_path, name)
    imported(tmp_path)
    (file,) = (user_data_folder() / "trials").glob(f"*{suffix}")
    if content is not None:
        file.write_bytes(content)
    elif suffix == ".json":
        file.write_text(
            file.read_text()
            .replace('"format": 1', '"format": 2')
            .replace('"format":1', '"format":2')
        )
    else:
        file.unlink()
    with pytest.raises(ReferenceFileError) as caught:
        load_band(name, DataSource.IMPORTED)
    assert str(file) in str(caught.value)
    assert "gauge data import renews it" in str(caught.value)
    assert gauge("show", name, "--use", "imported-reference").exit_code == 2
    assert gauge("show", name).exit_code == 0
    imported(tmp_path)
    assert band_grade(name, DataSource.IMPORTED) is BandGrade.TRIALS


@pytest.mark.parametrize("arrays", ["", "..", "../a.npz", "a\0.npz"])
def test_a_damaged_name_of_arrays_is_named(arrays: str, tmp_path: Path) -> None:
    name = "SlopeSlider-1-wood"
    write_synthetic(tmp_path, name)
    imported(tmp_path)
    (file,) = (user_data_folder() / "trials").glob("*.json")
    file.write_text(json.dumps(json.loads(file.read_text()) | {"arrays": arrays}))
    with pytest.raises(
        ReferenceFileError, match="is no import of this version: arrays"
    ):
        load_imported(name)


def test_an_import_for_other_motions_is_named(tmp_path: Path) -> None:
    name = "FoamShearing-soft"
    (driver,) = write_synthetic(tmp_path, name).experiment.scene.drivers
    imported(tmp_path)
    shorter = replace(driver, motions=driver.motions[:1])
    with pytest.raises(ReferenceFileError, match="has 1 motions, imported were 2"):
        recorded_drivers(name, (shorter,))


def test_the_folder_follows_the_environment(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, gauge_data_dir: Path
) -> None:
    assert user_data_folder() == gauge_data_dir
    monkeypatch.delenv("GAUGE_DATA_DIR")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    monkeypatch.setattr("sys.platform", "linux")
    assert user_data_folder() == tmp_path / "gauge-envs"
    monkeypatch.delenv("XDG_DATA_HOME")
    assert user_data_folder() == Path.home() / ".local" / "share" / "gauge-envs"


def test_a_folder_that_cannot_be_written_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, gauge
) -> None:
    write_synthetic(tmp_path, "SlopeSlider-1-wood")
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("GAUGE_DATA_DIR", str(tmp_path / "file"))
    result = gauge("data", "import", tmp_path)
    assert result.exit_code == 2 and "cannot be" in result.stderr


# --- statistics of deformation ----------------------------------------------------------------------------------------


def stretching_trials(
    name: str, amounts: np.ndarray, *, placed_m: float = 0.0
) -> list[dict]:
    """Trials whose markers stretch along z by 1e-3 (frame + amount); amounts take effect after frame 0."""
    experiment = load_experiment(name)
    rest = 1e3 * np.asarray(experiment.scene.markers.positions_m)
    frames = np.arange(experiment.frame_count)[:, None, None]
    contents = []
    for number, amount in enumerate(amounts):
        placed = rest + 1e3 * placed_m * np.random.default_rng(number).normal(
            size=rest.shape
        )
        elongation = 1e-3 * (frames + np.where(frames > 0, amount, 0.0))
        moved = placed + elongation * (placed - placed[0]) * np.array([0.0, 0.0, 1.0])
        assets = {"foam": marker_asset(moved, range(len(rest)))}
        assets |= {
            driver.body: driven(experiment, driver.body)
            for driver in experiment.scene.drivers
        }
        contents.append(trial_content(assets))
    return contents


def driven(experiment, body: str) -> dict:
    start = 1e3 * np.asarray(experiment.scene.body(body).pose.position_m)
    return body_asset(
        start + np.arange(experiment.frame_count)[:, None] * [0.0, 0.0, 0.3]
    )


@pytest.mark.parametrize("placed_m", [0.0, 0.0008])
def test_statistics_of_deformation_come_back(placed_m: float, tmp_path: Path) -> None:
    """Whatever the places of the dots, and a trial without some of its markers counts."""
    name = "FoamStretching-soft"
    for number, content in enumerate(
        stretching_trials(name, AMOUNT, placed_m=placed_m)
    ):
        if number == 0:
            for axis in "xyz":
                content["foam"]["4"][axis] = [None, *content["foam"]["4"][axis][1:]]
        write_trial(tmp_path, name, number, content)
    one = imported(tmp_path)[name]
    assert (one.used, one.left_out) == (len(AMOUNT), 0)
    found = load_imported(name).deformation
    assert (
        found.trial_count == len(AMOUNT)
        and found.markers is None
        and found.note is None
    )
    assert "area_ratio" not in found.statistics
    frames = np.arange(len(found.mean))
    elongation = 1e-3 * (frames[:, None] + np.where(frames[:, None] > 0, AMOUNT, 0.0))
    for statistic, values in (
        ("strain.zz", elongation),
        ("volume_ratio", 1 + elongation),
    ):
        column = found.statistics.index(statistic)
        np.testing.assert_allclose(
            found.mean[:, column], values.mean(axis=1), rtol=0, atol=1e-6
        )
        np.testing.assert_allclose(
            found.sigma[:, column], values.std(axis=1, ddof=1), rtol=0, atol=1e-6
        )
    lateral = found.statistics.index("strain.lateral")
    np.testing.assert_allclose(found.mean[:, lateral], 0.0, atol=1e-6)


def test_imported_statistics_are_used_when_asked_for(tmp_path: Path) -> None:
    name = "FoamStretching-soft"
    for number, content in enumerate(stretching_trials(name, AMOUNT)):
        write_trial(tmp_path, name, number, content)
    imported(tmp_path)
    bundled = deformation_reference(load_experiment(name))
    own = run_episode(
        RunRequest(name, marker_proxy="material", reference="imported")
    ).deformation
    assert (bundled.trial_count, own.trial_count) == (1, len(AMOUNT))
    assert own["strain.zz"].real == pytest.approx(1e-3 * (29 + AMOUNT.mean()), abs=1e-6)
    assert own["strain.zz"].uncertainty == pytest.approx(
        1e-3 * AMOUNT.std(ddof=1), abs=1e-6
    )
    assert own["strain.zz"].simulated == pytest.approx(0.052, abs=0.002)
    assert own.source.startswith("imported dataset")


def test_rigid_imports_have_no_statistics(tmp_path: Path) -> None:
    write_synthetic(tmp_path, "SlopeSlider-2-wood")
    imported(tmp_path)
    assert load_imported("SlopeSlider-2-wood").deformation is None
