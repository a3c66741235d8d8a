"""Bands of published recordings: what was measured and no more; laws under their conditions; the coverage page."""

import json
import math
import tomllib

import numpy as np
import pytest
from places import ROOT

from gauge_envs import load_experiment, reference_band, score_trajectory, variants
from gauge_envs.evaluation.reference import band_grade
from gauge_envs.files import data_folder
from gauge_envs.references.bands import SigmaSource, bundled_band
from gauge_envs.references.grades import BandGrade
from gauge_envs.references.published import Baseline, law_for, published_baselines
from scripts import build_coverage, build_engine_table, build_recordings
from scripts.generated import stale_files

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


def table(name):
    return build_recordings.read_table(facts_folder() / f"{name}.csv")


def test_the_table_of_coverage_names_every_id_and_its_check_finds_a_change(
    tmp_path, monkeypatch
):
    page = (ROOT / "docs" / "coverage.md").read_text()
    stale = tmp_path / "coverage.md"
    stale.write_text(
        page.replace("| SlopeSlider-2-wood | trials |", "| SlopeSlider-2-wood | law |"),
    )
    monkeypatch.setattr(build_coverage, "PAGE", stale)
    assert stale_files(build_coverage.contents()) == [stale]
    rows = page.partition("Why bands are withheld")[0].splitlines()
    assert (
        sum(
            line.startswith(f"| {variant.name} |")
            for variant in variants()
            for line in rows
        )
        == 75
    )


def test_no_default_preset_fails_a_check_of_what_is_ranked():
    data = json.loads(build_engine_table.DATA.read_text())
    defaults = {
        one["engine"]: one for one in data["configurations"] if not one["preset"]
    }
    assert set(defaults) == set(build_engine_table.ENGINES)
    assert {
        engine: build_engine_table.failed_checks(one)
        for engine, one in defaults.items()
    } == dict.fromkeys(defaults, 0)
    slides = [build_engine_table.law_ratio(one, "slide") for one in defaults.values()]
    assert slides == pytest.approx([1.0] * len(defaults), abs=0.01)


def test_ranks_need_every_graded_episode_of_every_configuration(tmp_path):
    with pytest.raises(
        SystemExit,
        match=r"no ranks: rapier lacks BouncingBall-rubber calibrated, .*Turntable-3-metal",
    ):
        build_engine_table.graded_results("rapier", "", tmp_path)


# From pictures to frames


def test_what_moves_evenly_is_met_at_every_frame_between_pictures():
    times = np.arange(10) / 25
    frames = np.arange(12) / 30
    value, rate = build_recordings.at_frames(
        times, 3 + 2 * times, frames, interval_s=1 / 25
    )
    inside = frames <= times[-1]
    assert value[inside] == pytest.approx(3 + 2 * frames[inside], abs=1e-12)
    assert rate[inside] == pytest.approx(2, abs=1e-9)
    assert np.isnan(value[~inside]).all() and np.isnan(rate[~inside]).all()


def test_nothing_is_invented_where_a_picture_is_missing():
    times = np.arange(10) / 25
    values = times.copy()
    values[4] = np.nan
    frames = np.arange(12) / 30
    value, _ = build_recordings.at_frames(times, values, frames, interval_s=1 / 25)
    within_gap = (frames > times[3]) & (frames < times[5])
    assert within_gap.any()
    assert np.isnan(value[within_gap]).all()
    assert np.isfinite(
        value[(frames <= times[3]) | ((frames >= times[5]) & (frames <= times[-1]))]
    ).all()


def test_the_mean_of_a_jump_does_not_overshoot():
    value, _ = build_recordings.at_frames(
        np.arange(8) / 25,
        np.repeat([0.0, 1.0], 4),
        np.linspace(0, 7 / 25, 50),
        interval_s=1 / 25,
    )
    assert (value.min(), value.max()) == (0.0, 1.0)


def test_pictures_before_a_marker_is_hidden_are_left_out_but_not_those_before_the_end():
    values = np.array([0.0, 1.0, 2.0, 3.0, np.nan, 5.0, 6.0])
    seen = build_recordings.seen_well(values, 2)
    assert np.isnan(seen).tolist() == [False, False, True, True, True, False, False]
    assert np.isnan(build_recordings.seen_well(values, 0)).sum() == 1


def test_an_uncertain_time_counts_with_the_speed():
    """A cube at 1.2 m/s whose pictures are good to 1 ms: 1.2 mm beside the 1.5 mm of the frame and the fit's."""
    band, sigma_mm = bundled_band("SlopeSlider-3-metal"), table("slope_slider")
    last = int(np.flatnonzero(band.measured)[-1])
    speed = 30 * np.linalg.norm(band.mean[last] - band.mean[last - 1])
    fitted = np.interp(0.96 + last / 30, sigma_mm["time_s"], sigma_mm["fit_sigma_mm"])
    squares = np.square(band.uncertainty[last]) - fitted**2 - 1.5**2
    assert squares.sum() == pytest.approx((1e-3 * speed) ** 2, rel=0.15)


# What is known, and how well


@pytest.mark.parametrize("variant", [*SCORED, *WITHHELD])
def test_a_band_reads_as_it_was_built(variant):
    band = bundled_band(variant)
    experiment = load_experiment(variant)
    name, recording, layout = next(
        found
        for found in build_recordings.supported(facts_folder())
        if variant in found[1]["variants"]
    )
    built = build_recordings.recorded_band(variant, recording, layout, table(name))
    assert band.grade is BandGrade.RECORDING
    assert band.unit == experiment.spec.score.observable.unit
    assert band.mean.shape == (experiment.frame_count, len(band.coordinates))
    assert band.projection.shape == (len(band.coordinates), len(experiment.coordinates))
    # The tables have two digits.
    np.testing.assert_allclose(band.mean, built.mean, rtol=0, atol=0.0051)
    np.testing.assert_allclose(band.uncertainty, built.uncertainty, rtol=0, atol=0.0051)
    known = np.isfinite(built.mean).any(axis=1)
    assert band.measured.tolist() == known.tolist()
    assert band.withheld == recording.get("withheld")


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


def test_sigma_from_scores_is_exact_for_an_ensemble():
    """Trials of any shape: mean^2 + std^2 of their RMSE to the mean is the summed variance, averaged over frames."""
    trials = np.random.default_rng(3).normal(size=(20, 40, 24)).cumsum(axis=1)
    deviation = trials - trials.mean(axis=0)
    rmse = np.sqrt(np.square(deviation).sum(axis=2).mean(axis=1))
    baseline = Baseline("made up", "rmse", 40, "mm^2", rmse.mean(), rmse.std(), {})
    assert build_recordings.sigma_of(baseline, 24) == pytest.approx(
        math.sqrt(np.square(deviation).mean()), rel=1e-12
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


def test_a_band_is_withheld_unless_material_and_scatter_are_known():
    """One recorded trial is of one material; and without a published scatter no score can be normalized."""
    for _, recording, _ in build_recordings.supported(facts_folder()):
        ambiguous = len(recording["variants"]) > 1
        unscaled = any(
            "rmse" not in published_baselines(variant)
            for variant in recording["variants"]
        )
        if ambiguous or unscaled:
            assert recording.get("withheld"), recording["video"]


@pytest.mark.parametrize("variant", WITHHELD)
def test_a_withheld_band_is_used_only_when_asked_for(variant):
    experiment = load_experiment(variant)
    used = reference_band(experiment)
    assert not band_grade(variant).is_real
    assert used is None or not used.grade.is_real
    band = reference_band(experiment, use_withheld=True)
    assert band is not None and band.withheld and band.grade.is_real


@pytest.mark.parametrize("variant", BESIDE_A_LAW)
def test_a_law_is_used_while_the_recording_is_withheld(variant):
    experiment = load_experiment(variant)
    assert band_grade(variant) is BandGrade.LAW
    used, asked = (
        reference_band(experiment),
        reference_band(experiment, use_withheld=True),
    )
    assert used is not None and asked is not None
    assert (used.grade, used.withheld) == (BandGrade.LAW, None)
    assert (asked.grade, bool(asked.withheld)) == (BandGrade.RECORDING, True)


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


def test_the_recorded_pyramid_falls_with_gravity_before_the_contact():
    """The last three pictures before the contact, 1.2, 1.2 and 3 mm uncertain, give 8.2 +- 2.5 m/s^2."""
    seen = table("nonsmooth_contact")
    before, middle, last = seen["z_mm"][2:5]
    assert seen["time_s"][2:5].tolist() == [1.92, 1.96, 2.0]
    acceleration = -1e-3 * (before - 2 * middle + last) / 0.04**2
    sigma = 1e-3 * math.sqrt(1.2**2 + (2 * 1.2) ** 2 + 3.0**2) / 0.04**2
    assert acceleration == pytest.approx(8.2, abs=0.05)
    assert sigma == pytest.approx(2.5, abs=0.05)
    assert abs(acceleration - GRAVITY) < sigma


@pytest.mark.parametrize("variant", SCORED)
def test_a_certain_band_is_used(variant):
    assert band_grade(variant) is BandGrade.RECORDING
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


def test_slips_of_the_recorded_cube_are_the_means_of_the_table():
    facts, seen = recordings()["turntable"]["facts"], table("turntable")
    for event, start, end in (
        ("start", 1.0, 2.28),
        ("first_stop", 2.6, 4.28),
        ("second_stop", 4.64, 5.52),
    ):
        window = (seen["time_s"] >= start - 1e-6) & (seen["time_s"] <= end + 1e-6)
        slip, radius = (
            facts[f"slip_after_{event}_deg"],
            facts[f"radius_after_{event}_mm"] if "stop" in event else None,
        )
        assert seen["slip_deg"][window].mean() == pytest.approx(slip["value"], abs=0.06)
        assert seen["slip_deg"][window].std() == pytest.approx(slip["sigma"], abs=0.25)
        if radius is not None:
            assert seen["radius_mm"][window].mean() == pytest.approx(
                radius["value"], abs=0.06
            )


def test_speeds_and_accelerations_follow_from_the_tables():
    described = recordings()
    pulled, slid = table("tablecloth_pulling"), table("slope_contact")
    moving = pulled["time_s"] > 2.1
    for body in ("cube", "cloth"):
        speed = np.polyfit(pulled["time_s"][moving], pulled[f"{body}_mm"][moving], 1)[0]
        stated = described["tablecloth_pulling"]["facts"][f"{body}_speed_mm_per_s"]
        assert speed == pytest.approx(stated["value"], abs=0.5)
    times = slid["time_s"] - described["slope_contact"]["frame_zero_s"]
    sliding = (times > 0) & (times < 0.17)
    weight = 1 / slid["fit_sigma_mm"][sliding] ** 2
    half_square = 0.5 * times[sliding] ** 2
    acceleration = (
        1e-3
        * (weight * half_square)
        @ slid["slide_mm"][sliding]
        / (weight * half_square @ half_square)
    )
    stated = described["slope_contact"]["facts"]["slide_acceleration_m_per_s2"]
    assert acceleration == pytest.approx(stated["value"], abs=stated["sigma"])


def test_the_recorded_period_is_that_of_the_angles():
    """Crossings of the vertical, half a period apart."""
    swing = table("pendulum")
    times, angle = swing["time_s"], swing["angle_deg"]
    before = np.flatnonzero(angle[:-1] * angle[1:] < 0)
    crossings = (
        times[before] - angle[before] * np.diff(times)[before] / np.diff(angle)[before]
    )
    stated = recordings()["pendulum"]["facts"]["period_s"]
    assert len(crossings) == 4
    assert 2 * np.diff(crossings).mean() == pytest.approx(
        stated["value"], abs=2 * stated["sigma"]
    )


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
