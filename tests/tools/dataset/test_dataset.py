"""Importing real trials gives known statistics, for any spelling of folders; bands and prescribed motions are used."""

import json
import math

import gymnasium
import numpy as np
import pytest
from dataset_writer import (
    AMOUNTS,
    body_asset,
    scaled_markers,
    synthetic_trials,
    trial_content,
    write_synthetic,
    write_trial,
)
from imports import IMPORTED, band_of, import_contents, imported
from scipy.spatial.transform import Rotation

import gauge_envs
from gauge_envs import load_experiment
from gauge_envs.errors import (
    ParameterError,
)
from gauge_envs.references.band import load_band
from gauge_envs.references.published import published_baselines
from gauge_envs.tools.dataset.layout import find_trials, write_revision

AMOUNT = np.array(AMOUNTS)
SIGMA = AMOUNT.std(ddof=1)
GROWTH = (1.0 + 1e-3 * AMOUNT) ** 2
SLIDER, TILTED = "SlopeSlider-1-wood", "SlopeSlider-3-wood"

# Each irregularity occurs: subtask folders, no material folder, material names, sorted ids, several bodies.
IRREGULAR = (
    "BouncingBall-rubber",
    "FoamCompressing-soft",
    "TableclothPulling-metal",
)


def start_mm(experiment, body):
    return 1e3 * np.asarray(experiment.scene.body(body).pose.position_m)


def assert_close(values, expected, tolerance=1e-9):
    expected = np.broadcast_to(expected, np.shape(values))
    np.testing.assert_allclose(values, expected, rtol=0, atol=tolerance)


# --- statistics ------------------------------------------------------------------------------------------------------


def face_areas(experiment):
    corners = scaled_markers(experiment, 0.0)[np.array(experiment.scene.markers.faces)]
    sides = corners[:, 1:] - corners[:, :1]
    return 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)


@pytest.mark.parametrize("name", IRREGULAR)
def test_the_import_has_the_known_statistics(name, tmp_path):
    experiment = write_synthetic(tmp_path, name).experiment
    outcome = imported(tmp_path)[name]
    assert (outcome.used, outcome.left_out, outcome.findings) == (len(AMOUNTS), 0, [])
    if bodies := experiment.recorded:
        # Every body is shifted by the amount along y and moves along x.
        initial_mm = np.concatenate([start_mm(experiment, body) for body in bodies])
        steps = np.tile([2.0, 0.0, 0.0], len(bodies))
        mean = initial_mm + np.arange(experiment.frame_count)[:, None] * steps
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
    # All differences are constant, so time warping cannot reduce them.
    for line in outcome.baselines:
        if line["metric"] in ("rmse", "dtw"):
            baseline = line["own_mean"], line["own_std"]
            assert_close(baseline, [distance.mean(), distance.std(ddof=1)])


def test_missing_samples_are_left_out_of_mean_and_scatter(tmp_path):
    amounts = np.array([*AMOUNTS, 2.0, 3.0])
    synthetic = synthetic_trials(SLIDER, amounts)
    contents = synthetic.contents
    contents[3]["cube"]["y"][3] = None  # one of six
    for content in contents[:4]:
        content["cube"]["z"][5] = float("nan")  # four of six
    for key in "xyz":
        for content in contents[:3]:
            content["cube"][key][8] = None  # three of six
        for content in contents:
            content["cube"][key][7] = None  # all
    import_contents(tmp_path, SLIDER, contents)
    band = band_of(SLIDER)
    start = start_mm(synthetic.experiment, "cube")
    assert_close(band.mean[3, 1], start[1] + np.delete(amounts, 3).mean())
    assert_close(band.sigma[3, 1], np.delete(amounts, 3).std(ddof=1))
    # Half of the trials give mean and scatter; two of six do not.
    assert_close(band.sigma[8, 1], amounts[3:].std(ddof=1))
    for frame in (5, 7):
        assert np.isnan([band.mean[frame], band.sigma[frame]]).all()
    assert np.flatnonzero(~band.measured).tolist() == [5, 7]
    # A lost coordinate is no deviation of 0: all deviations along y are constant.
    others = (amounts.sum() - amounts) / (len(amounts) - 1)
    assert_close(band.trial_rmse[4:], np.abs(amounts - others)[4:], 0.3)


def test_events_of_the_pendulum_have_baselines(tmp_path):
    """Both trials are equal undamped swings: 300 frames contain 9 periods of 10/9 s."""
    name = "Pendulum-metal"
    experiment = load_experiment(name)
    pivot = 1e3 * np.asarray(experiment.scene.joints[0].anchor_m)
    length = np.linalg.norm(start_mm(experiment, "ball") - pivot)
    angle = math.pi / 6 * np.cos(2 * math.pi * 0.9 * np.arange(3000) / 30.0)
    contents = []
    for sign in (1.0, -1.0):
        direction = [sign * np.sin(angle), 0.0 * angle, -np.cos(angle)]
        ball = body_asset(pivot + length * np.column_stack(direction))
        contents.append(trial_content({"ball": ball}))
    outcome = import_contents(tmp_path, name, contents)
    lines = {line["metric"]: line for line in outcome.baselines}
    # The peak of the spectrum is interpolated.
    assert lines["pd"]["own_mean"] == pytest.approx(10 / 9, abs=1e-4)
    assert lines["el"]["own_mean"] == pytest.approx(0.0, abs=1e-6)
    assert lines["el"]["difference"] is None  # the published mean is 0


def test_the_importer_reproduces_bundled_trials(tmp_path):
    """One coordinate of bundled trials is measured; the remaining coordinates keep their initial values."""
    names = ("SlopeSlider-2-metal", "BouncingBall-rubber")
    bundled = {name: load_band(name) for name in names}
    for name, band in bundled.items():
        experiment = load_experiment(name)
        (body,) = experiment.recorded
        (direction,) = band.projection
        start = start_mm(experiment, body)
        across = start - (start @ direction) * direction
        for number, along in enumerate(band.trials[:, :, 0]):
            asset = body_asset(across + along[:, None] * direction)
            write_trial(tmp_path, name, number, trial_content({body: asset}))
    outcomes = imported(tmp_path)
    assert set(outcomes) == set(bundled)
    for name, outcome in outcomes.items():
        published = published_baselines(name)
        for line in outcome.baselines:
            mean = published[line["metric"]].mean
            assert line["own_mean"] == pytest.approx(mean, rel=0.07)
            assert not line["flagged"]
        imported_band, band = band_of(name), bundled[name]
        assert imported_band.trial_count == band.trial_count
        assert_close(imported_band.mean @ band.projection.T, band.mean, 1e-6)
        # Only one direction scatters, so its components along x, y and z add up to the bundled sigma.
        assert_close(
            np.linalg.norm(imported_band.sigma, axis=1), band.sigma[:, 0], 1e-6
        )
        assert imported_band.standard_uncertainty == pytest.approx(
            band.standard_uncertainty
        )
        for field in ("trial_rmse", "trial_rmse_aligned"):
            assert_close(getattr(imported_band, field), getattr(band, field), 1e-6)


# --- what uses an import ---------------------------------------------------------------------------------------------


def test_an_import_is_shown_and_used_on_request(tmp_path, gauge):
    write_synthetic(tmp_path, TILTED)
    write_revision(tmp_path, "9e0acb7" + 33 * "0")
    assert gauge("data", "import", tmp_path).exit_code == 0
    status = json.loads(gauge("list", "references", TILTED, "--json").stdout)
    assert (status["kind"], status["imported"]) == ("trials", True)
    assert (status["trials"], status["is_current"]) == (len(AMOUNTS), True)
    assert status["drivers"][0]["provenance"] == "mocap"
    assert "mocap" in gauge("list", "references", TILTED).stdout
    env = gymnasium.make(f"GAUGE/{TILTED}", **IMPORTED)
    env.reset(seed=0)
    for _ in range(10):
        observation, *_ = env.step(np.zeros(env.action_space.shape))
    w, _, y, _ = observation["driver"][0, 3:7]
    assert 2 * math.atan2(y, w) == pytest.approx(0.010, abs=1e-6)


# --- drivers ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["SlopeSlider-3-plastic", "FoamShearing-hard"])
def test_recorded_motion_becomes_the_prescribed_motion(name, tmp_path):
    synthetic = write_synthetic(tmp_path, name)
    (record,) = imported(tmp_path)[name].facts.drivers
    (driver,) = load_experiment(name, **IMPORTED).scene.drivers
    for number, motion in enumerate(driver.motions):
        (profile,) = motion.profiles
        assert_close(profile.values, synthetic.coordinates[driver.body][:, number])
    assert record.trial_count == len(AMOUNTS)
    errors = record.residual_mm, record.residual_deg, record.start_offset_mm
    assert max(errors) < 1e-6


def test_rotations_exceed_180_degrees_and_noise_is_reported(tmp_path):
    """The plate rotates at 12 rad/s; trials are offset by 1 mm, wobble by 0.5 mm and tilt by 1 degree."""
    name = "Turntable-3-metal"
    synthetic = synthetic_trials(name, AMOUNTS[:2], frames_after=0)
    count = synthetic.experiment.frame_count
    angles = 12.0 * np.arange(count) / 30.0
    later = (np.arange(count) > 0)[:, None]
    tilt = Rotation.from_rotvec(later * [1.0, 0.0, 0.0], degrees=True)
    rotation = tilt * Rotation.from_rotvec(angles[:, None] * [0.0, 0.0, 1.0])
    start = start_mm(synthetic.experiment, "plate")
    for content, offset in zip(synthetic.contents, (-1.0, 1.0), strict=True):
        places = start + [offset, 0.0, 0.0] + later * [0.0, 0.0, 0.5]
        content["plate"] = body_asset(places, rotation)
    (record,) = import_contents(tmp_path, name, synthetic.contents).facts.drivers
    share = math.sqrt((count - 1) / count)
    errors = record.residual_mm, record.residual_deg, record.start_offset_mm
    assert errors == pytest.approx((0.5 * share, share, 1.0), rel=1e-6)
    assert record.scatter_mm is None
    assert record.scatter_deg == pytest.approx(0.0, abs=1e-5)
    (driver,) = load_experiment(name, drivers="imported").scene.drivers
    assert_close(driver.motions[0].profiles[0].values, angles, 1e-3)


# --- layout ----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_folders_of_all_75_experiments_are_read(tmp_path):
    names = [variant.name for variant in gauge_envs.variants()]
    for number, name in enumerate(names):
        amount = 1.0 + 1e-3 * number  # Copies count once, so trials must differ.
        write_synthetic(tmp_path, name, (amount, -amount))
    # Synthetic motions of two trials are far from the reference of some ids.
    outcomes = imported(tmp_path, keep=True)
    assert list(outcomes) == names
    assert {(item.used, item.left_out) for item in outcomes.values()} == {(2, 0)}


def test_folders_are_read_in_any_spelling(tmp_path):
    for name in ("FoamCompressing-hard", "SlopeSlider-2-metal"):
        write_synthetic(tmp_path, name, range(12))
    data = tmp_path / "data"
    foam, slider = data / "deformable", data / "rigid/slope slider/json"
    (foam / "foam compression").rename(foam / "Foam_Compressing")
    (slider / "task-2").mkdir()
    (slider / "metal/task-2").rename(slider / "task-2/metal")
    (slider / "task-2/metal/.trial-9.json").write_text("hidden")
    layout = find_trials(data)
    assert layout.findings == []
    files = {variant.name: paths for variant, paths in layout.files.items()}
    assert len(files["FoamCompressing-hard"]) == 12
    numbers = [path.stem for path in files["SlopeSlider-2-metal"]]
    assert numbers == [f"trial-{number}" for number in range(1, 13)]


@pytest.mark.parametrize(
    ("folder", "left_out"),
    [
        ("data/rigid/slope slider/json/wood/task-4", True),
        # Files outside of a folder `json` are not published trials.
        ("data/rigid/slope slider/full trajectories/wood/task-3", False),
    ],
)
def test_unknown_folders_are_reported(folder, left_out, tmp_path):
    write_synthetic(tmp_path, "SlopeContact-wood")
    (tmp_path / folder).mkdir(parents=True)
    (tmp_path / folder / "trial-1.json").write_text("{}")
    layout = find_trials(tmp_path)
    assert [variant.name for variant in layout.files] == ["SlopeContact-wood"]
    (finding,) = layout.findings
    assert (finding.file, finding.left_out) == (folder, left_out)


def test_a_missing_dataset_is_an_error(tmp_path, gauge):
    for wrong in (tmp_path / "missing", tmp_path):
        result = gauge("data", "import", wrong)
        assert result.exit_code == 2 and str(wrong) in result.stderr.replace("\n", "")
    with pytest.raises(ParameterError, match="gauge data import DIR"):
        load_experiment(TILTED, drivers="imported")
