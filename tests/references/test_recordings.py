"""Bands of published recordings: what was measured and no more; laws under their conditions."""

import json
import math
import tomllib

import numpy as np
import pytest

from gauge_envs import load_experiment, reference_band, score_trajectory
from gauge_envs.files import data_folder
from gauge_envs.references.band import SigmaSource, bundled_band
from gauge_envs.references.kind import Kind
from gauge_envs.references.published import law_for, published_baselines
from gauge_envs.scoring.reference import band_grade

GRAVITY = 9.80665
SCORED = ("SlopeSlider-3-metal", "Turntable-3-metal")
UNTOLD = (
    "CantileverBeam",
    "FoamStretching",
    "FoamCompressing",
    "FoamShearing",
    "FoamTwisting",
    "FoamBending",
)
STRAINED = (
    "FoamStretching-soft",
    "FoamStretching-hard",
    "FoamCompressing-soft",
    "FoamCompressing-hard",
)
BESIDE_A_LAW = (
    *(
        "SlopeContact-wood",
        "NonsmoothContact-1-plastic",
        "Pendulum-metal",
        "TableclothPulling-metal",
    ),
    *STRAINED,
)
WITHHELD = tuple(
    name
    for family in UNTOLD
    for foam in ("soft", "hard")
    if (name := f"{family}-{foam}") not in STRAINED
)


def facts_folder():
    return data_folder("scoring") / "facts" / "recordings"


def recordings():
    return tomllib.loads((facts_folder() / "recordings.toml").read_text())


# What is known, and how well


@pytest.mark.parametrize(
    ("variant", "known"),
    [("SlopeSlider-3-metal", 58), ("Turntable-3-metal", 95), ("SlopeContact-wood", 7)],
)
def test_frames_after_the_last_picture_are_not_known(variant, known):
    band = bundled_band(variant)
    assert np.flatnonzero(np.isfinite(band.mean).all(axis=1)).tolist() == list(
        range(known)
    )
    assert np.flatnonzero(band.measured).tolist() == list(range(known))


@pytest.mark.parametrize("variant", [*SCORED, *WITHHELD])
def test_sigma_is_the_published_scatter_where_there_is_one(variant):
    """The variances of all coordinates of g(t), also of those that the band lacks, add up to mean^2 + std^2."""
    band, baseline = bundled_band(variant), published_baselines(variant).get("rmse")
    if baseline is None:
        assert band.sigma_source is SigmaSource.MEASUREMENT
        np.testing.assert_array_equal(band.sigma, band.uncertainty)
        return
    assert band.sigma_source is SigmaSource.BASELINE
    width = band.projection.shape[1]
    assert np.unique(band.sigma).size == 1
    assert width * band.sigma[0, 0] ** 2 == pytest.approx(
        baseline.mean**2 + baseline.std**2, rel=1e-5
    )


@pytest.mark.parametrize(
    "variant",
    [*SCORED, "SlopeContact-wood", "TableclothPulling-metal", "CantileverBeam-soft"],
)
def test_bands_start_where_the_experiment_does(variant):
    """In millimetres, in the world frame, on the right coordinate: within the 5 mm by which a real start is off."""
    band, experiment = bundled_band(variant), load_experiment(variant)
    if experiment.recorded:
        start = (
            1e3
            * np.array(
                [
                    experiment.scene.body(name).pose.position_m
                    for name in experiment.recorded
                ]
            ).ravel()
        )
    else:
        start = 1e3 * np.asarray(experiment.scene.markers.positions_m).ravel()
    np.testing.assert_allclose(band.mean[0], band.projection @ start, rtol=0, atol=5.0)


@pytest.mark.parametrize(
    "variant", [name for name in WITHHELD if name.startswith("Foam")]
)
def test_areas_start_near_the_published_places_of_the_markers(variant):
    band, experiment = bundled_band(variant), load_experiment(variant)
    corners = (
        1e3
        * np.asarray(experiment.scene.markers.positions_m)[
            np.asarray(experiment.scene.markers.faces)
        ]
    )
    areas = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    assert areas == pytest.approx(625 / 3, rel=1e-3)
    np.testing.assert_allclose(band.mean[0], areas, rtol=0.15)
    assert band.mean[0].mean() == pytest.approx(areas.mean(), rel=0.04)


def test_each_recording_says_what_it_is_and_what_was_assumed():
    described = recordings()
    described.pop("layouts")
    for name, recording in described.items():
        assert len(recording["sha256"]) == 64, name
        assert {
            "video",
            "identity",
            "method",
            "assumed",
            "not_measured",
            "facts",
        } <= set(recording), name
        assert recording["supports"] in ("band", "cross-check"), name


# Which bands are scored on


@pytest.mark.parametrize("variant", WITHHELD)
def test_a_withheld_band_is_used_only_when_asked_for(variant):
    experiment = load_experiment(variant)
    used = reference_band(experiment)
    assert not band_grade(variant).is_real
    assert used is None or not used.grade.is_real
    band = reference_band(experiment, use_withheld=True)
    assert band is not None and band.withheld and band.kind.is_real


@pytest.mark.parametrize("variant", BESIDE_A_LAW)
def test_a_law_is_used_while_the_recording_is_withheld(variant):
    experiment = load_experiment(variant)
    assert band_grade(variant) is Kind.ANALYTIC
    used, asked = (
        reference_band(experiment),
        reference_band(experiment, use_withheld=True),
    )
    assert used is not None and asked is not None
    assert (used.grade, used.withheld) == (Kind.ANALYTIC, None)
    assert (asked.grade, bool(asked.withheld)) == (Kind.RECORDING, True)


def test_the_pendulums_recording_is_withheld_as_circular():
    """The length of the simulated pendulum follows from the period of the recording that the band shows."""
    assert bundled_band("Pendulum-metal").withheld.startswith(
        "circular: the length of the"
    )
    period_s = recordings()["pendulum"]["facts"]["period_s"]["value"]
    scene = load_experiment("Pendulum-metal").scene
    arm_m = np.linalg.norm(
        np.subtract(scene.body("ball").pose.position_m, scene.joints[0].anchor_m)
    )
    effective_m = arm_m + 0.4 * 0.03**2 / arm_m
    # Period of the first swings at 85 degrees, where the complete elliptic integral gives 1.1596 of the small one.
    expected_s = 2 * math.pi * math.sqrt(effective_m / GRAVITY) * 1.1596
    assert expected_s == pytest.approx(period_s, abs=0.015)


@pytest.mark.parametrize("variant", SCORED)
def test_a_certain_band_is_used(variant):
    assert band_grade(variant) is Kind.RECORDING
    band = reference_band(load_experiment(variant))
    assert band is not None and band.withheld is None


def test_a_score_on_a_withheld_band_says_so(rollout):
    plain = rollout("SlopeContact-wood")[2]["score"]
    assert (plain.grade, plain.coordinates, plain.withheld) == (
        "law",
        ("x", "y", "z"),
        None,
    )
    assert plain.validation is None
    asked = rollout("SlopeContact-wood", use_withheld=True)[2]["score"]
    assert (asked.grade, asked.coordinates) == ("recording", ("slide",))
    assert "frames 0 to 6" in asked.withheld
    assert asked.rmse < 10
    assert json.loads(json.dumps(asked.to_dict()))["withheld"] == asked.withheld


def test_a_score_uses_what_is_withheld_when_asked_to(tmp_path, gauge):
    file = tmp_path / "still.csv"
    file.write_text("\n".join(["504.278,408.961,180.622"] * 10))
    words = ("score", file, "--id", "SlopeContact-wood", "--json")
    plain, asked = (
        json.loads(gauge(*words, *more).stdout)["score"]
        for more in ((), ("--use", "withheld"))
    )
    assert (plain["grade"], plain["withheld"]) == ("law", None)
    slide = bundled_band("SlopeContact-wood").mean[:7, 0]
    still_mm = math.sqrt(np.square(slide - slide[0]).mean())
    assert asked["rmse"] == pytest.approx(still_mm, rel=1e-3)


def test_what_lies_on_a_recording_scores_zero_however_it_goes_on():
    """Frames that the recording does not show take part in neither RMSE nor DTW."""
    experiment = load_experiment("SlopeSlider-3-metal")
    band = bundled_band("SlopeSlider-3-metal")
    g = np.where(np.isfinite(band.mean), band.mean, 1e4)
    score = score_trajectory(experiment, band, times_s=np.arange(60) / 30, values=g)
    assert (
        score.rmse,
        score.dtw,
        score.validation.mean_abs_z,
        score.validation.inside_1sigma,
    ) == (
        0.0,
        0.0,
        0.0,
        1.0,
    )


# Against simulations


@pytest.fixture(scope="module")
def turntable():
    return load_experiment("Turntable-3-metal")


def test_mujoco_is_scored_on_the_turntable(rollout, turntable):
    """And slips at the first stop as the recorded cube did, within three times the uncertainty of that."""
    _, trajectory, info = rollout("Turntable-3-metal")
    score = info["score"]
    assert (info["reference"], score.grade, score.coordinates) == (
        "recording",
        "recording",
        ("x", "y"),
    )
    assert score.validation.rmse_normalized == pytest.approx(score.rmse / 13.26)
    assert score.validation.rmse_normalized < 1
    assert score.withheld is None
    axis = 1e3 * np.asarray(turntable.scene.body("plate").pose.position_m[:2])
    arm = trajectory.samples[:, :2] - axis
    azimuth = np.degrees(np.unwrap(np.arctan2(arm[:, 1], arm[:, 0])))
    # From 2.60 s of the clip on, the cube is carried again until the plate stops once more.
    carried = (trajectory.times_s > 2.60 - 0.638) & (trajectory.times_s < 3.1)
    plate = turntable.scene.body("plate").pose
    poses = [
        turntable.scene.drivers[0].pose(plate, time) for time in trajectory.times_s
    ]
    turned = np.degrees(
        np.unwrap(
            [2 * math.atan2(pose.quaternion[3], pose.quaternion[0]) for pose in poses]
        )
    )
    slip = (azimuth - azimuth[0] - turned + turned[0])[carried].mean()
    recorded = recordings()["turntable"]["facts"]["slip_after_first_stop_deg"]
    assert slip == pytest.approx(recorded["value"], abs=3 * recorded["sigma"])


# What the facts say


def test_the_recorded_bounce_agrees_with_the_trials():
    text = (data_folder("scoring") / "facts" / "bouncing_ball_summary.toml").read_text()
    trials, seen = tomllib.loads(text), recordings()["bouncing_ball"]["facts"]
    assert seen["rebound_ratio"]["value"] == pytest.approx(
        trials["rebound_ratio"]["mean"], rel=0.01
    )
    assert seen["second_rebound_ratio"]["value"] == pytest.approx(
        trials["rebound_ratio"]["mean"], rel=0.03
    )
    start = seen["start_height_m"]
    assert start["value"] == pytest.approx(
        trials["start_height_m"]["mean"], abs=3 * start["sigma"]
    )
    fall = math.sqrt(
        2
        / GRAVITY
        * (trials["start_height_m"]["mean"] - trials["contact_height_m"]["mean"])
    )
    assert seen["fall_s"]["value"] == pytest.approx(fall, abs=0.008)
    assert seen["gravity_from_first_flight_m_per_s2"]["value"] == pytest.approx(
        GRAVITY, abs=0.27
    )


def test_the_recorded_cradle_rests_as_long_as_the_published_one():
    resting = recordings()["newtons_cradle"]["facts"]["last_ball_at_rest_s"]
    published = published_baselines("NewtonsCradle-metal")["lsd"].mean
    assert max(resting["value"]) == pytest.approx(published, abs=resting["sigma"])


def test_frame_zero_is_that_of_the_driver():
    driver = load_experiment("Turntable-3-metal").spec.subtasks["3"].drivers
    assert (
        f"its time {recordings()['turntable']['frame_zero_s']} s being frame 0"
        in driver[0].note
    )


# Laws


def friction(variant):
    return next(
        c.friction
        for c in load_experiment(variant).scene.contacts
        if c.second[0] in ("board", "plate")
    )


@pytest.mark.parametrize("material", ["wood", "plastic", "metal"])
def test_the_slope_holds_every_cube(material):
    assert math.tan(math.radians(10)) < friction(f"SlopeSlider-1-{material}")


@pytest.mark.parametrize("material", ["wood", "plastic", "metal"])
def test_the_slow_plate_carries_every_cube(material):
    """The largest force that carrying takes, from the driver's own motion, is less than friction gives."""
    experiment = load_experiment(f"Turntable-1-{material}", drivers="bundled")
    scene, driver = experiment.scene, experiment.scene.drivers[0]
    start = scene.body("plate").pose
    arm = np.subtract(scene.body("cube").pose.position_m, start.position_m)[:2]
    times = np.arange(0, scene.duration_s, 5e-3)
    needed = float(np.linalg.norm(arm)) * max(_turning(driver, start, times))
    held = friction(experiment.variant.name) * GRAVITY
    assert needed < held / 15
    # The condition of the law, in the numbers that its text gives.
    law = law_for(experiment.variant.name)
    assert law is not None and f"{np.linalg.norm(arm):.4f} m" in law.condition


def _turning(driver, start, times):
    """hypot(omega^2, alpha) of a driver that turns about z [rad/s^2]."""
    omega = np.array([driver.state(start, time)[1][5] for time in times])
    return np.hypot(omega**2, np.gradient(omega, times))


# Damage
