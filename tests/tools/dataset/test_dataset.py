"""Importing real trials: known statistics come back, whatever the folders spell, and bands and drivers are used."""

import json
import math
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from dataset_writer import (
    AMOUNTS,
    body_asset,
    scaled_markers,
    synthetic_trials,
    trial_content,
    trial_folder,
    write_synthetic,
    write_trial,
)
from hypothesis import given, settings, strategies as st
from imports import IMPORTED, band_of, import_contents, imported
from scipy.spatial.transform import Rotation

import gauge_envs
from gauge_envs import load_experiment
from gauge_envs.errors import (
    DatasetError,
    ParameterError,
    ReferenceFileError,
    UnknownNameError,
)
from gauge_envs.references.band import load_band
from gauge_envs.references.imported import load_imported, recorded_drivers
from gauge_envs.references.kind import Kind
from gauge_envs.references.published import published_baselines
from gauge_envs.references.user_data import DataSource, user_data_folder
from gauge_envs.runs.batch import run_many
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result_file import (
    load_result,
    recorded_experiment,
    result_file_name,
)
from gauge_envs.scene.drivers import DriverMotion
from gauge_envs.scene.profiles import SampledProfile
from gauge_envs.scoring.reference import reference_kind
from gauge_envs.tools.compare.comparison import compare
from gauge_envs.tools.dataset.layout import find_trials, write_revision
from gauge_envs.tools.dataset.observation import driver_tracks
from gauge_envs.tools.dataset.trial import parse_trial

AMOUNT = np.array(AMOUNTS)
SIGMA = AMOUNT.std(ddof=1)
GROWTH = (1.0 + 1e-3 * AMOUNT) ** 2
TOLERANCE = 1e-9
SLIDER, DRIVEN_SLIDER, STRETCH = (
    "SlopeSlider-1-wood",
    "SlopeSlider-3-wood",
    "FoamStretching-soft",
)

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


def start_mm(experiment, body):
    return 1e3 * np.asarray(experiment.scene.body(body).pose.position_m)


def assert_close(found, expected, tolerance=TOLERANCE):
    expected = np.broadcast_to(expected, np.shape(found))
    np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance)


# --- statistics ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", IRREGULAR)
def test_known_statistics_come_back(name, tmp_path):
    experiment = write_synthetic(tmp_path, name).experiment
    one = imported(tmp_path)[name]
    assert (one.used, one.left_out, one.findings) == (len(AMOUNTS), 0, ())
    if bodies := experiment.recorded:
        # Every body is off by the amount along y, a right angle to where it goes.
        starts = np.concatenate([start_mm(experiment, body) for body in bodies])
        steps = np.tile([2.0, 0.0, 0.0], len(bodies))
        mean = starts + np.arange(experiment.frame_count)[:, None] * steps
        sigma = np.tile([0.0, SIGMA, 0.0], len(bodies))
        distance = np.abs(AMOUNT) * math.sqrt(len(bodies))
    else:
        # Faces grow with the square of the scale.
        areas = face_areas(experiment)
        mean, sigma = GROWTH.mean() * areas, GROWTH.std(ddof=1) * areas
        distance = np.abs(GROWTH - GROWTH.mean()) * np.linalg.norm(areas)
    band = band_of(name)
    assert_close(band.mean, mean)
    assert_close(band.sigma, sigma)
    assert band.measured.all()
    lines = {line["metric"]: line for line in one.baselines}
    # All differences are constant, so that warping in time cannot reduce them.
    for metric in ("rmse", "dtw"):
        own = lines[metric]["own_mean"], lines[metric]["own_std"]
        assert_close(own, [distance.mean(), distance.std(ddof=1)])
        assert lines[metric]["own_trial_count"] == len(AMOUNT)


def face_areas(experiment):
    """Heron's formula, face by face."""
    markers = scaled_markers(experiment, 0.0)
    areas = []
    for face in experiment.scene.markers.faces:
        sides = [math.dist(markers[face[k]], markers[face[k - 1]]) for k in range(3)]
        s = 0.5 * sum(sides)
        areas.append(math.sqrt(s * math.prod(s - side for side in sides)))
    return np.array(areas)


def test_missing_samples_are_left_out_of_mean_and_scatter(tmp_path):
    amounts = np.array([*AMOUNTS, 2.0])
    synthetic = synthetic_trials(SLIDER, amounts)
    contents = synthetic.contents
    contents[0]["cube"]["y"][3] = None  # one of five
    for content in contents[:3]:
        content["cube"]["z"][5] = float("nan")  # three of five
    for content in contents:
        for key in "xyz":
            content["cube"][key][7] = None  # all
    assert import_contents(tmp_path, SLIDER, contents).findings == ()
    band = band_of(SLIDER)
    start = start_mm(synthetic.experiment, "cube")
    assert_close(band.mean[3, 1], start[1] + amounts[1:].mean())
    assert_close(band.sigma[3, 1], amounts[1:].std(ddof=1))
    # Two of five trials are a mean and no scatter.
    assert_close(band.mean[5, 2], start[2])
    assert np.isnan(band.sigma[5, 2]) and np.isfinite(band.sigma[5, :2]).all()
    assert np.isnan(band.mean[7]).all() and np.isnan(band.sigma[7]).all()
    assert np.flatnonzero(~band.measured).tolist() == [7]
    score = run_episode(RunRequest(SLIDER, **IMPORTED)).score
    assert score.rmse is not None and score.mean_abs_z is not None


def test_a_marker_out_of_sight_hides_its_faces_alone(tmp_path):
    contents = synthetic_trials(STRETCH).contents
    hidden = min(contents[0]["foam"], key=int)  # the first marker of the metadata
    for key in "xyz":
        contents[0]["foam"][hidden][key][4] = None
    import_contents(tmp_path, STRETCH, contents)
    experiment = load_experiment(STRETCH)
    is_hidden = [0 in face for face in experiment.scene.markers.faces]
    growth = np.where(is_hidden, GROWTH[1:].mean(), GROWTH.mean())
    areas, band = face_areas(experiment), band_of(STRETCH)
    assert_close(band.mean[4], growth * areas)
    assert_close(band.mean[3], GROWTH.mean() * areas)


def test_short_trials_count_where_no_length_is_published(tmp_path):
    name = "TableclothPulling-wood"
    assert not published_baselines(name)
    contents = synthetic_trials(name, frames_after=0).contents
    for asset in ("cube", "rod"):
        whole = contents[0][asset]
        contents[0][asset] = {key: values[:50] for key, values in whole.items()}
    assert import_contents(tmp_path, name, contents).used == 4
    _, y, _ = start_mm(load_experiment(name), "cube")
    mean = band_of(name).mean[:, 1]
    assert mean[49:51] == pytest.approx([y, y + AMOUNT[1:].mean()])


def test_events_of_the_pendulum_have_baselines(tmp_path):
    """Undamped swings of known period, all the same: 300 frames hold 9 periods of 10/9 s."""
    name = "Pendulum-metal"
    experiment = load_experiment(name)
    pivot = 1e3 * np.asarray(experiment.scene.joints[0].anchor_m)
    length = np.linalg.norm(start_mm(experiment, "ball") - pivot)
    angle = math.pi / 6 * np.cos(2 * math.pi * 0.9 * np.arange(3000) / 30.0)
    contents = []
    for sign in (1.0, -1.0):
        way = [sign * np.sin(angle), 0.0 * angle, -np.cos(angle)]
        ball = body_asset(pivot + length * np.column_stack(way))
        contents.append(trial_content({"ball": ball}))
    one = import_contents(tmp_path, name, contents)
    lines = {line["metric"]: line for line in one.baselines}
    # The spectrum's peak is interpolated.
    assert lines["pd"]["own_mean"] == pytest.approx(10 / 9, abs=1e-4)
    assert lines["pd"]["published_mean"] == published_baselines(name)["pd"].mean
    assert not lines["pd"]["flagged"]
    assert lines["el"]["own_mean"] == pytest.approx(0.0, abs=1e-6)
    assert lines["el"]["difference"] is None  # the published mean is 0


@pytest.mark.slow
def test_all_75_experiments_are_found_in_their_folders(tmp_path):
    names = [variant.name for variant in gauge_envs.variants()]
    for number, name in enumerate(names):
        amount = 1.0 + 1e-3 * number
        write_synthetic(tmp_path, name, (amount, -amount))
    found = imported(tmp_path)
    assert list(found) == names
    assert all((one.used, one.left_out) == (2, 0) for one in found.values())
    kinds = {reference_kind(name, DataSource.IMPORTED) for name in found}
    assert kinds == {Kind.TRIALS}


def test_bundled_trials_come_out_of_the_importer(tmp_path):
    """The bundled trials in the dataset's layout: one coordinate was measured, the others are at the start."""
    names = [f"SlopeSlider-2-{material}" for material in ("wood", "plastic", "metal")]
    bundled = {name: load_band(name) for name in (*names, "BouncingBall-rubber")}
    for name, band in bundled.items():
        experiment = load_experiment(name)
        (body,) = experiment.recorded
        (direction,) = band.projection
        start = start_mm(experiment, body)
        across = start - (start @ direction) * direction
        for number, along in enumerate(band.trials[:, :, 0]):
            asset = body_asset(across + along[:, None] * direction)
            write_trial(tmp_path, name, number, trial_content({body: asset}))
    found = imported(tmp_path)
    assert set(found) == set(bundled)
    for name, one in found.items():
        published = published_baselines(name)
        for line in one.baselines:
            mean = published[line["metric"]].mean
            assert line["published_mean"] == mean
            assert line["flagged"] == (abs(line["own_mean"] / mean - 1) > 0.05)
        mine, theirs = band_of(name), bundled[name]
        assert mine.trial_count == theirs.trial_count
        assert_close(mine.mean @ theirs.projection.T, theirs.mean, 1e-6)
        # One direction has all the scatter, so that its share along x, y and z adds up to the bundled sigma.
        assert_close(np.linalg.norm(mine.sigma, axis=1), theirs.sigma[:, 0], 1e-6)
        assert mine.standard_uncertainty == pytest.approx(theirs.standard_uncertainty)
        for field in ("trial_rmse", "trial_rmse_aligned"):
            assert_close(getattr(mine, field), getattr(theirs, field), 1e-6)
    assert any(line["flagged"] for one in found.values() for line in one.baselines)


def test_distances_of_trials_are_those_to_the_mean_of_the_others(tmp_path):
    """Trials that start some frames late, with noise; one ends early and has a gap.

    The aligned distance is compared with the least of a fine grid of shifts, by an interpolation of its own.
    """
    random = np.random.default_rng(0)
    synthetic = synthetic_trials("SlopeSlider-2-wood", range(5), frames_after=0)
    frames = synthetic.experiment.frame_count
    start = start_mm(synthetic.experiment, "cube")
    contents, trials = [], []
    for number, late in enumerate((0.0, 1.3, 2.6, 0.4, 3.1)):
        moved_s = np.maximum(np.arange(frames) - late, 0.0) / 30.0
        places = start + np.outer(800.0 * moved_s**2, [1.0, 0.0, -0.5])
        places += random.normal(0.0, 0.3, places.shape)
        asset = body_asset(places)
        if number == 4:
            places[[4, *range(frames - 3, frames)]] = np.nan
            for key, column in zip("xyz", places.T, strict=True):
                asset[key] = [None if np.isnan(one) else one for one in column]
        contents.append(trial_content({"cube": asset}))
        trials.append(places)
    import_contents(tmp_path, "SlopeSlider-2-wood", contents)
    band = band_of("SlopeSlider-2-wood")
    for number, trial in enumerate(trials):
        others = np.nanmean([*trials[:number], *trials[number + 1 :]], axis=0)
        (seen,) = np.nonzero(np.isfinite(trial[:, 0]))

        def distance(shift, trial=trial, others=others, seen=seen):
            times = np.arange(frames) - 30.0 * shift
            (used,) = np.nonzero(times <= seen[-1])
            squares = 0.0
            for axis in range(3):
                course = np.interp(times[used], seen, trial[seen, axis])
                squares += np.sum((course - others[used, axis]) ** 2)
            return math.sqrt(squares / len(used))

        least = min(map(distance, np.linspace(-1 / 3, 1 / 3, 4001)))
        assert band.trial_rmse[number] == pytest.approx(distance(0.0), rel=1e-12)
        assert band.trial_rmse_aligned[number] == pytest.approx(least, rel=1e-4)
    assert band.trial_rmse_aligned.mean() < 0.5 * band.trial_rmse.mean()


# --- what uses an import ---------------------------------------------------------------------------------------------


def test_an_import_is_used_when_asked_for_and_shown(tmp_path, gauge):
    name = DRIVEN_SLIDER
    synthetic = write_synthetic(tmp_path, name)
    write_revision(tmp_path, "9e0acb7" + 33 * "0")
    assert gauge("data", "import", tmp_path).exit_code == 0
    kinds = reference_kind(name), reference_kind(name, DataSource.IMPORTED)
    assert kinds == (Kind.NUMERICAL, Kind.TRIALS)

    def shown(*words):
        return json.loads(gauge(*words, "--json").stdout)

    row = shown("list", name)
    assert (row["kind"], row["imported"]) == ("numerical", True)
    bundled = shown("show", name)["reference"]
    assert (bundled["kind"], bundled["imported"]) == ("numerical", False)
    used = shown("show", name, "--use", "imported")
    assert used["reference"]["imported"] and used["reference"]["trial_count"] == 4
    assert "imported dataset revision 9e0acb7" in used["reference"]["source"]
    (driver,) = used["drivers"]
    assert (driver["provenance"], driver["imported"]) == ("mocap", True)
    values = driver["motions"][0]["profiles"][0]["values"]
    assert_close(values, synthetic.coordinates["board"][:, 0])
    status = shown("list", "references", name)
    assert (status["kind"], status["imported"]) == ("trials", True)
    assert (status["trials"], status["is_current"]) == (4, True)
    assert status["drivers"][0]["provenance"] == "mocap"
    means = {line["metric"]: line["published_mean"] for line in status["baselines"]}
    published = published_baselines(name)
    assert means == {metric: one.mean for metric, one in published.items()}
    for words in (
        ("list", name),
        ("show", name, "--use", "imported"),
        ("list", "references", name),
    ):
        assert any(word in gauge(*words).stdout for word in ("imported", "mocap"))


def test_results_are_scored_on_the_import_and_say_so(tmp_path):
    before = run_episode(RunRequest(SLIDER))
    write_synthetic(tmp_path, SLIDER)
    imported(tmp_path)
    assert run_episode(RunRequest(SLIDER)).score == before.score
    after = run_episode(RunRequest(SLIDER, **IMPORTED))
    assert (before.score.kind, after.score.kind) == ("trials", "trials")
    assert before.dataset == {"drivers": "bundled", "reference": "bundled"}
    assert after.dataset["revision"] == "unknown" and len(after.dataset["sha256"]) == 64
    away = np.array(after.trajectory.samples)[::6] - band_of(SLIDER).mean
    rmse = math.sqrt((away**2).sum(axis=1).mean())
    assert after.score.rmse == pytest.approx(rmse, rel=1e-12)


def test_resume_runs_again_what_was_scored_on_other_trials(tmp_path):
    out, notes = tmp_path / "results", []

    def run(**options):
        requests = [RunRequest(SLIDER, **options)]
        return next(run_many(requests, out=out, resume=True, notify=notes.append))

    first = run()
    write_synthetic(tmp_path / "a", SLIDER)
    imported(tmp_path / "a")
    second = run(**IMPORTED)
    assert (first.score.kind, second.score.kind) == ("trials", "trials")
    assert load_result(out / result_file_name(second)).dataset == second.dataset
    assert any("different imports" in note for note in compare([first, second]).notes)
    assert not any("imports" in note for note in compare([second]).notes)
    again = run().created, run(**IMPORTED).created
    assert (again, notes) == ((first.created, second.created), [])
    write_synthetic(tmp_path / "b", SLIDER, AMOUNTS[:2])
    imported(tmp_path / "b")
    assert run(**IMPORTED).dataset["sha256"] != second.dataset["sha256"]
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
def test_recorded_motion_becomes_the_driver(name, tmp_path):
    synthetic = write_synthetic(tmp_path, name)
    bundled = synthetic.experiment.scene.drivers
    records = imported(tmp_path)[name].facts.drivers
    experiment = load_experiment(name, **IMPORTED)
    assert experiment.drivers is DataSource.IMPORTED
    assert experiment.driver_provenance == "mocap"
    for driver, stated, record in zip(
        experiment.scene.drivers, bundled, records, strict=True
    ):
        wanted = synthetic.coordinates[driver.body]
        for number, motion in enumerate(driver.motions):
            (profile,) = motion.profiles
            assert isinstance(profile, SampledProfile)
            assert_close(profile.values, wanted[:, number])
            assert replace(stated.motions[number], profiles=(profile,)) == motion
        assert record.trial_count == len(AMOUNTS)
        misses = record.residual_mm, record.residual_deg, record.start_offset_mm
        assert max(misses) < 1e-6
    plain = load_experiment(name)
    assert plain.scene.drivers == bundled
    assert (plain.parameters, plain.overrides) == ("calibrated", {})


@given(
    kinds=st.sampled_from(
        ["translate rotate translate", "rotate translate", "translate rotate"]
    ),
    seed=st.integers(0, 2**32 - 1),
)
@settings(max_examples=40, deadline=None)
def test_any_driver_with_one_turn_is_inverted(kinds, seed):
    random = np.random.default_rng(seed)
    frames = 20
    times = tuple((np.arange(frames) / 30.0).tolist())
    axes = np.linalg.qr(random.normal(size=(3, 3)))[0].T
    count = len(kinds.split())
    wanted = np.cumsum(random.normal(0.0, 0.02, (frames, count)), axis=0)
    wanted -= wanted[0]
    motions = tuple(
        DriverMotion(
            kind=kind,
            axis=tuple(axis.tolist()),
            point_m=tuple(random.normal(0.4, 0.1, 3).tolist()),
            profiles=(SampledProfile(times_s=times, values=tuple(values.tolist())),),
        )
        for kind, axis, values in zip(kinds.split(), axes, wanted.T, strict=False)
    )
    experiment = load_experiment("Turntable-2-wood")
    driver = replace(experiment.scene.drivers[0], motions=motions)
    scene = replace(experiment.scene, drivers=(driver,))
    experiment = replace(experiment, scene=scene, frame_count=frames)
    start = scene.body("plate").pose
    poses = [driver.pose(start, time_s) for time_s in times]
    positions = 1e3 * np.array([pose.position_m for pose in poses])
    turns = Rotation.concatenate([pose.rotation for pose in poses])
    content = trial_content({"plate": body_asset(positions, turns)})
    (track,) = driver_tracks(parse_trial(json.dumps(content).encode()), experiment)
    assert_close(track.coordinates, wanted)
    assert track.residual_mm.max() < 1e-9 and track.residual_rad.max() < 1e-7


def test_turns_are_counted_past_half_a_turn_and_noise_is_stated(tmp_path):
    """A plate at 12 rad/s, in trials that start 1 mm apart, wobble by 0.5 mm and tilt by 1 degree."""
    name = "Turntable-3-metal"
    synthetic = synthetic_trials(name, AMOUNTS[:2], frames_after=0)
    count = synthetic.experiment.frame_count
    angles = 12.0 * np.arange(count) / 30.0
    later = (np.arange(count) > 0)[:, None]
    tilt = Rotation.from_rotvec(later * [1.0, 0.0, 0.0], degrees=True)
    turn = tilt * Rotation.from_rotvec(angles[:, None] * [0.0, 0.0, 1.0])
    start = start_mm(synthetic.experiment, "plate")
    for content, offset in zip(synthetic.contents, (-1.0, 1.0), strict=True):
        places = start + [offset, 0.0, 0.0] + later * [0.0, 0.0, 0.5]
        content["plate"] = body_asset(places, turn)
    (record,) = import_contents(tmp_path, name, synthetic.contents).facts.drivers
    share = math.sqrt((count - 1) / count)
    misses = record.residual_mm, record.residual_deg, record.start_offset_mm
    assert misses == pytest.approx((0.5 * share, share, 1.0), rel=1e-6)
    assert record.scatter_mm is None
    assert record.scatter_deg == pytest.approx(0.0, abs=1e-5)
    (driver,) = load_experiment(name, drivers="imported").scene.drivers
    assert_close(driver.motions[0].profiles[0].values, angles, 1e-3)


def test_an_environment_drives_as_recorded_or_as_bundled(tmp_path):
    name = DRIVEN_SLIDER
    write_synthetic(tmp_path, name)
    imported(tmp_path)

    sources = []

    def tilt(**options):
        env = gymnasium.make(f"GAUGE/{name}", **options)
        _, info = env.reset(seed=0)
        sources.append((info["drivers"], info["reference_source"], info["reference"]))
        for _ in range(10):
            observation, *_ = env.step(np.zeros(env.action_space.shape))
        w, _, y, _ = observation["driver"][0, 3:7]
        return 2 * math.atan2(y, w)

    bundled = tilt()
    assert abs(bundled) > 0.02 and tilt(drivers="bundled") == bundled
    assert tilt(drivers="imported") == pytest.approx(0.010, abs=1e-6)
    assert tilt(**IMPORTED) == pytest.approx(0.010, abs=1e-6)
    assert sources[0] == ("bundled", "bundled", "numerical")
    assert sources[-1] == ("imported", "imported", "trials")
    plain, driven = (
        run_episode(RunRequest(name, drivers=one)) for one in ("bundled", "imported")
    )
    assert (plain.driver_provenance, driven.driver_provenance) == ("nominal", "mocap")
    assert plain.dataset == {"drivers": "bundled", "reference": "bundled"}
    assert (driven.dataset["drivers"], driven.dataset["reference"]) == (
        "imported",
        "bundled",
    )
    assert driven.score.refused is not None
    drivers = load_experiment(name, drivers="imported").scene.drivers
    assert recorded_experiment(driven).scene.drivers == drivers
    with pytest.raises(ParameterError, match="'bundled' or 'imported'"):
        gymnasium.make(f"GAUGE/{name}", drivers="recorded")


@pytest.mark.parametrize("name", [DRIVEN_SLIDER, "SlopeSlider-2-wood"])
@pytest.mark.parametrize("argument", ["drivers", "reference"])
def test_what_was_not_imported_is_an_error_that_names_the_command(name, argument):
    words = f"{name}: {argument}='imported'.*gauge data import DIR"
    with pytest.raises(ParameterError, match=words):
        load_experiment(name, **{argument: "imported"})


def test_trials_without_a_driver_still_make_a_band(tmp_path):
    name = "Turntable-1-wood"
    contents = synthetic_trials(name).contents
    del contents[0]["plate"]
    for key in ("qx", "qy", "qz", "qw"):
        del contents[1]["plate"][key]
    contents[2]["plate"]["x"][0] = None
    one = import_contents(tmp_path, name, contents)
    assert (one.used, one.left_out) == (4, 0)
    keys = [finding.key for finding in one.findings if not finding.left_out]
    assert keys == ["plate", "plate.qx", "plate[0]"]
    assert one.facts.drivers[0].trial_count == 1


# --- layout ----------------------------------------------------------------------------------------------------------


def test_folders_are_read_whatever_they_spell(tmp_path):
    names = [
        "BouncingBall-rubber",
        "FoamCompressing-hard",
        "SlopeSlider-2-metal",
        "TextileFlinging-uniform",
    ]
    for name in names:
        write_synthetic(tmp_path, name, AMOUNTS[:2])
    data = tmp_path / "data"
    foam, ball = data / "deformable", data / "rigid/bouncing ball/json"
    slider = data / "rigid/slope slider"
    (foam / "foam compression").rename(foam / "Foam_Compressing")
    (ball / "soft").mkdir()
    (ball / "trial-1.json").rename(ball / "soft/trial-1.json")
    (slider / "json/task-2").mkdir()
    (slider / "json/metal/task-2").rename(slider / "json/task-2/metal")
    (slider / "json/task-2/metal/.trial-9.json").write_text("hidden")
    (slider / "json/task-2/metal/notes.txt").write_text("not a trial")
    (slider / "video").mkdir()
    layout = find_trials(data)
    assert layout.findings == ()
    found = {variant.name: len(files) for variant, files in layout.files.items()}
    assert found == dict.fromkeys(names, 2)


def test_trials_are_in_the_order_of_their_numbers(tmp_path):
    contents = synthetic_trials(SLIDER, range(12)).contents
    facts = import_contents(tmp_path, SLIDER, contents).facts
    files = [f"{trial_folder(SLIDER)}/trial-{number}.json" for number in range(1, 13)]
    assert list(facts.files) == files


RIGID = "data/rigid/slope slider/json"


@pytest.mark.parametrize(
    ("folder", "right"),
    [
        ("data/plasma/arc/json", "rigid, rope, textile, deformable"),
        ("data/rigid/slope sliders/json", "rigid, rope, textile, deformable"),
        (RIGID, "wood, plastic, metal"),
        (f"{RIGID}/glass/task-1", "wood, plastic, metal"),
        (f"{RIGID}/task-1", "wood, plastic, metal"),
        (f"{RIGID}/wood", "task-1, task-2, task-3"),
        ("data/rigid/nonsmooth contact/json/wood/task-5", "task-1, task-2, task-3"),
        ("data/rigid/pendulum/json/metal/task-2", "no task folder"),
        (f"{RIGID}/wood/task-1/task-2", "task-1, task-2, task-3"),
    ],
)
def test_folders_of_nothing_known_are_named(folder, right, tmp_path):
    write_synthetic(tmp_path, "SlopeContact-wood")
    (tmp_path / folder).mkdir(parents=True)
    (tmp_path / folder / "trial-1.json").write_text("{}")
    layout = find_trials(tmp_path)
    (finding,) = layout.findings
    assert finding.file in folder or finding.file.startswith(folder)
    assert finding.left_out and right in finding.expected
    assert layout.count == 4


def test_no_dataset_is_an_error(tmp_path, gauge):
    for wrong in (tmp_path / "missing", tmp_path):
        result = gauge("data", "import", wrong)
        assert result.exit_code == 2 and str(wrong) in result.stderr.replace("\n", "")
    (tmp_path / "data" / "rigid").mkdir(parents=True)
    with pytest.raises(DatasetError, match="contains no trial"):
        find_trials(tmp_path)
    with pytest.raises(UnknownNameError, match="SlopeSlider"):
        find_trials(tmp_path, only=["SlopeSlidr-2-wood"])


def test_only_imports_what_was_asked_for(tmp_path):
    sliders = {SLIDER, "SlopeSlider-1-metal"}
    for name in (*sliders, "SlopeContact-wood"):
        write_synthetic(tmp_path, name)
    assert set(imported(tmp_path, "GAUGE/SlopeSlider-*")) == sliders
    assert load_imported("SlopeContact-wood") is None


# --- store -----------------------------------------------------------------------------------------------------------


@pytest.fixture
def store(tmp_path):
    """The folder of an import."""
    write_synthetic(tmp_path, SLIDER)
    imported(tmp_path)
    return user_data_folder() / "trials"


def test_a_second_import_replaces_the_first(store, tmp_path):
    first = load_imported(SLIDER)
    amounts = [0.0, 4.0, 5.0, 6.0]
    write_synthetic(tmp_path, SLIDER, amounts)
    imported(tmp_path)
    second = load_imported(SLIDER)
    assert_close(second.band.sigma[0, 1], np.std(amounts, ddof=1))
    assert first.facts.files_sha256 != second.facts.files_sha256
    suffixes = sorted(file.suffix for file in store.glob("[!.]*"))
    assert suffixes == [".npz", ".toml"]


@pytest.mark.parametrize("suffix", [".toml", ".npz"])
@pytest.mark.parametrize("content", [b"", b"{}", b"PK\x03\x04", None])
def test_a_damaged_store_is_named(suffix, content, store, tmp_path, gauge):
    (file,) = store.glob(f"*{suffix}")
    if content is not None:
        file.write_bytes(content)
    elif suffix == ".toml":
        file.write_text(file.read_text().replace("facts", "fakts"))
    else:
        file.unlink()
    with pytest.raises(ReferenceFileError) as caught:
        load_imported(SLIDER)
    assert str(file) in str(caught.value)
    assert gauge("list", "references", SLIDER).exit_code == 2
    assert gauge("list", "references", STRETCH).exit_code == 0
    imported(tmp_path)
    assert reference_kind(SLIDER, DataSource.IMPORTED) is Kind.TRIALS


def test_an_import_for_other_motions_is_named(tmp_path):
    name = "FoamShearing-soft"
    (driver,) = write_synthetic(tmp_path, name).experiment.scene.drivers
    imported(tmp_path)
    shorter = replace(driver, motions=driver.motions[:1])
    with pytest.raises(ReferenceFileError, match="has 1 motions, imported were 2"):
        recorded_drivers(name, (shorter,))


def test_the_folder_follows_the_environment(
    monkeypatch, tmp_path, gauge_data_dir, gauge
):
    assert user_data_folder() == gauge_data_dir
    write_synthetic(tmp_path, SLIDER)
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("GAUGE_DATA_DIR", str(tmp_path / "file"))
    result = gauge("data", "import", tmp_path)
    assert result.exit_code == 2 and "cannot be" in result.stderr
    monkeypatch.delenv("GAUGE_DATA_DIR")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    monkeypatch.setattr("sys.platform", "linux")
    assert user_data_folder() == tmp_path / "gauge-envs"
    monkeypatch.delenv("XDG_DATA_HOME")
    assert user_data_folder() == Path.home() / ".local" / "share" / "gauge-envs"
