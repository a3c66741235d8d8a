"""Error budgets: planted errors come back, parts sum to the whole, and no smaller error is missed."""

import itertools
import json
import math
from dataclasses import replace

import approval
import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings, strategies as st

from gauge_envs import load_experiment, reference_band
from gauge_envs.errors import ShapeError
from gauge_envs.evaluation.metrics.trajectory import trajectory_rmse
from gauge_envs.evaluation.motion_kinds import MotionKind, find_impact
from gauge_envs.references.bands import Band
from gauge_envs.references.grades import BandGrade
from gauge_envs.references.published import carried_band
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Outcome
from gauge_envs.runs.result_file import write_result
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S
from gauge_envs.tools.diagnose.error_budget import (
    DEFAULT_ORDER,
    DiagnosisError,
    diagnose,
    diagnose_trajectory,
    stage_order,
)
from gauge_envs.tools.diagnose.model import BudgetStage
from gauge_envs.tools.diagnose.words import draw_diagnoses, findings

SLIDE, BALL, SWING, DRIVEN, HELD = (
    "SlopeSlider-2-wood",
    "BouncingBall-rubber",
    "Pendulum-metal",
    "SlopeSlider-3-metal",
    "SlopeSlider-1-wood",
)
GRAVITY_MM_S2 = 9806.65
GRAVITY_M_PER_S2 = np.array([0.0, 0.0, -9.80665])
FLOOR_MM = 43.297  # Height of the ball's centre where it touches the ground of BouncingBall-rubber.
QUICK = settings(
    max_examples=5, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)


def band(mean, *, grade=BandGrade.TRIALS, measured=None, sigma=1.0, **changes):
    """A band over x, y, z, or over the first coordinates of g(t), from a mean of shape [T, C]."""
    mean = np.asarray(mean, dtype=float)
    values = {
        "grade": grade,
        "unit": "mm",
        "coordinates": tuple("xyz"[: mean.shape[1]]),
        "projection": np.eye(3)[: mean.shape[1]],
        "mean": mean,
        "sigma": np.full(mean.shape, sigma),
        "measured": np.ones(len(mean), bool) if measured is None else measured,
        "trial_count": 20,
        "source": "closed form",
    }
    return Band(**(values | changes))


def samples(frame_count, motion_at, *, rate_hz=180):
    """Times and values of a motion_at over the frames: motion_at(times) of shape [S, 3]."""
    times = np.arange((frame_count - 1) * (rate_hz // 30) + 1) / rate_hz
    return times, np.asarray(motion_at(times), dtype=float)


def frames_s(frame_count):
    return np.arange(frame_count) / 30.0


def part(diagnosis, stage):
    """The part of one stage."""
    return next(one for one in diagnosis.parts if one.stage is stage)


def change(part, quantity, coordinate=None):
    return next(
        c
        for c in part.changes
        if c.quantity == quantity and coordinate in (c.coordinate, None)
    )


def assert_consistent(diagnosis):
    """Parts and rest are the whole, in squares, in falls of the RMSE, and along each coordinate."""
    whole, rest, parts = diagnosis.mean_square, diagnosis.rest, diagnosis.parts
    tiny = 1e-12 * whole
    assert math.isclose(
        sum(p.explained for p in parts) + rest.mean_square, whole, rel_tol=1e-12
    )
    assert math.isclose(
        sum(p.rmse_before - p.rmse_after for p in parts) + rest.rmse,
        diagnosis.rmse,
        rel_tol=1e-9,
    )
    if whole:
        assert math.isclose(sum(p.share for p in parts) + rest.share, 1.0, rel_tol=1e-9)
    by_coordinate = (
        np.sum([p.by_coordinate for p in parts], axis=0) + rest.by_coordinate
    )
    np.testing.assert_allclose(
        by_coordinate, diagnosis.by_coordinate, rtol=1e-9, atol=tiny
    )
    assert math.isclose(sum(diagnosis.by_coordinate), whole, rel_tol=1e-12)
    assert parts[0].alone_share == parts[0].share
    assert math.isclose(parts[-1].last_share, parts[-1].share, abs_tol=1e-12)
    for part in parts:
        assert part.explained >= 0.0
        assert part.last_share >= 0.0
        assert 0.0 <= part.alone_share <= 1.0
        assert math.isclose(
            sum(part.by_coordinate),
            part.explained,
            rel_tol=1e-9,
            abs_tol=1e-12 * max(whole, 1.0),
        )


def diagnosed(experiment, mean, run, **options):
    """The budget of a simulated run, its times and values, against a mean."""
    times, values = run
    diagnosis = diagnose_trajectory(
        experiment, band(mean), times_s=times, values=values, **options
    )
    assert_consistent(diagnosis)
    return diagnosis


# --- planted errors --------------------------------------------------------------------------------------------------


def slide(acceleration_mm_s2, *, start_mm=0.0, late_s=0.0):
    def motion_at(times):
        displacement_mm = (
            start_mm + 0.5 * acceleration_mm_s2 * np.maximum(times - late_s, 0.0) ** 2
        )
        return displacement_mm[:, None] * [0.8, 0.0, -0.6] + [97.0, 407.0, 359.0]

    return motion_at


@QUICK
@given(
    late_s=st.floats(-0.05, 0.15),
    offset_mm=st.floats(-8.0, 8.0),
    ratio=st.floats(0.85, 1.2),
    start_mm=st.floats(-5.0, 5.0),
)
@example(late_s=0.03, offset_mm=4.0, ratio=1.05, start_mm=0.0)
def test_a_slide_gives_back_release_offset_and_acceleration(
    late_s, offset_mm, ratio, start_mm
):
    experiment = load_experiment(SLIDE)
    count = experiment.frame_count
    # The simulation runs longer, so that nothing is held at its end where reality is let go earlier.
    run = samples(count + 6, slide(2600.0, start_mm=start_mm))
    real = slide(2600.0 * ratio, start_mm=start_mm + offset_mm, late_s=late_s)(
        frames_s(count)
    )
    diagnosis = diagnosed(experiment, real, run)
    assert diagnosis.kind is MotionKind.UNIFORM_ACCELERATION
    found = part(diagnosis, BudgetStage.RATE)
    if late_s >= 0.0:
        assert diagnosis.rest.rmse < 0.02
        assert change(found, "release_time").fitted == pytest.approx(late_s, abs=5e-4)
        assert change(found, "offset", "x").fitted == pytest.approx(
            0.8 * offset_mm, abs=0.05
        )
        assert change(found, "offset", "z").fitted == pytest.approx(
            -0.6 * offset_mm, abs=0.05
        )
        assert change(found, "acceleration").fitted == pytest.approx(
            2.6 * ratio, rel=3e-3
        )
    assert change(found, "acceleration").simulated == pytest.approx(2.6, rel=1e-3)


def bounce(restitution, *, late_s=0.0, raised_mm=0.0, drop_mm=400.0, floor_mm=FLOOR_MM):
    """Height of a ball that falls from rest and rebounds once; exact."""
    fall_s = math.sqrt(2.0 * drop_mm / GRAVITY_MM_S2)
    speed = GRAVITY_MM_S2 * fall_s

    def motion_at(times):
        since = np.maximum(times - late_s, 0.0)
        flight = since - fall_s
        falling = floor_mm + drop_mm - 0.5 * GRAVITY_MM_S2 * since**2
        rising = (
            floor_mm + restitution * speed * flight - 0.5 * GRAVITY_MM_S2 * flight**2
        )
        height = np.where(flight < 0.0, falling, rising) + raised_mm
        return np.column_stack([0.0 * times, 0.0 * times, height])

    return motion_at


@QUICK
@given(
    real=st.floats(0.5, 0.95),
    simulated=st.floats(0.5, 0.95),
    late_s=st.floats(0.0, 0.1),
    raised_mm=st.floats(-9, 9),
)
@example(real=0.737, simulated=0.577, late_s=0.06, raised_mm=-7.0)
@example(real=0.5, simulated=0.5625, late_s=0.001953125, raised_mm=0.0)
def test_a_ball_gives_back_its_restitution(real, simulated, late_s, raised_mm):
    experiment = load_experiment(BALL)
    count = experiment.frame_count
    run = samples(count, bounce(simulated))
    mean = bounce(real, late_s=late_s, raised_mm=raised_mm)(frames_s(count))
    diagnosis = diagnosed(experiment, mean, run)
    assert diagnosis.kind is MotionKind.REBOUND
    # Between the samples on either side of the impact, w apart, the height is taken as linear: this cuts the corner, a
    # change of speed by (1 + e) v, off by (1 + e) v w / 4 at most, and one frame can lie there.
    speed = math.sqrt(2.0 * GRAVITY_MM_S2 * 400.0)
    corner_mm = (1.0 + max(real, simulated)) * speed * SAMPLE_INTERVAL_S / 4.0
    assert diagnosis.rest.rmse < corner_mm / math.sqrt(count)
    found = part(diagnosis, BudgetStage.RATE)
    assert change(found, "restitution").simulated == pytest.approx(simulated, abs=1e-6)
    assert change(found, "restitution").fitted == pytest.approx(real, abs=0.01)
    assert change(found, "release_time").fitted == pytest.approx(late_s, abs=1e-3)
    assert change(found, "offset", "z").fitted == pytest.approx(raised_mm, abs=1.0)


def swing(period_s, *, amplitude_mm=150.0, late_s=0.0, centre):
    def motion_at(times):
        angle = 2.0 * np.pi / period_s * np.maximum(times - late_s, 0.0)
        return centre + (amplitude_mm * np.cos(angle))[:, None] * [1.0, 0.0, 0.0]

    return motion_at


@pytest.mark.slow
@QUICK
@given(
    period=st.floats(0.8, 1.25),
    amplitude=st.floats(0.7, 1.4),
    late_s=st.floats(0.0, 0.1),
)
@example(period=1.0 / 1.08, amplitude=1.0, late_s=0.0)
@example(period=1.08, amplitude=1.0, late_s=0.0)
def test_a_pendulum_gives_back_period_and_amplitude(period, amplitude, late_s):
    experiment = load_experiment(SWING)
    joint = experiment.scene.joints[0]
    arm_m = math.dist(joint.anchor_m, experiment.scene.body(joint.body).pose.position_m)
    centre = 1e3 * (np.array(joint.anchor_m) - [0.0, 0.0, arm_m])
    count = 150
    run = samples(count, swing(1.2, centre=centre))
    real = swing(
        1.2 * period, amplitude_mm=150.0 * amplitude, late_s=late_s, centre=centre
    )(frames_s(count))
    diagnosis = diagnosed(experiment, real, run)
    assert diagnosis.kind is MotionKind.OSCILLATION
    found = part(diagnosis, BudgetStage.RATE)
    assert change(found, "period").simulated == pytest.approx(1.2, rel=1e-3)
    assert change(found, "period").fitted == pytest.approx(1.2 * period, rel=2e-3)
    assert change(found, "amplitude").fitted == pytest.approx(amplitude, rel=0.01)
    assert diagnosis.rest.share < 1e-3


def winding(times):
    """A motion along three axes that is neither uniform nor periodic and comes to rest at its end."""
    phase = np.clip(times / 1.5, 0.0, 1.0)
    eased = phase**3 * (10.0 - 15.0 * phase + 6.0 * phase**2)
    return np.column_stack(
        [200.0 * eased, 60.0 * np.sin(3.0 * np.pi * eased), 300.0 - 80.0 * eased**2]
    )


@QUICK
@given(
    speed=st.floats(0.9, 1.12),
    larger=st.floats(0.9, 1.1),
    late_s=st.floats(0.0, 0.1),
    offset_mm=st.floats(-5, 5),
)
def test_any_motion_gives_back_speed_and_displacement(speed, larger, late_s, offset_mm):
    experiment = load_experiment(DRIVEN)
    count = experiment.frame_count
    run = samples(count, winding)
    played = winding(speed * np.maximum(frames_s(count) - late_s, 0.0))
    start = winding(np.zeros(1))
    real = start + larger * (played - start) + [offset_mm, 0.0, -offset_mm]
    diagnosis = diagnosed(experiment, real, run)
    assert diagnosis.kind is MotionKind.GENERAL
    assert diagnosis.rest.rmse < 0.1
    found = part(diagnosis, BudgetStage.RATE)
    assert change(found, "speed").fitted == pytest.approx(speed, rel=3e-3)
    assert change(found, "displacement").fitted == pytest.approx(larger, rel=3e-3)
    assert change(found, "release_time").fitted == pytest.approx(late_s, abs=3e-3)
    assert change(found, "offset", "x").fitted == pytest.approx(offset_mm, abs=0.3)
    assert not any(c.at_bound for c in found.changes)


# --- properties ------------------------------------------------------------------------------------------------------


@st.composite
def wild(draw):
    """Real mean and simulation that have nothing to do with each other, some of the mean not measured."""
    seed, waves = draw(st.integers(0, 2**32 - 1)), draw(st.integers(1, 8))
    generator = np.random.default_rng(seed)
    count = load_experiment(DRIVEN).frame_count

    def motion_at(times):
        angles = generator.uniform(0.0, 12.0, (waves, 3)) * times[
            :, None, None
        ] + generator.uniform(0.0, 6.0, (waves, 3))
        return (generator.normal(0.0, 30.0, (waves, 3)) * np.sin(angles)).sum(axis=1)

    mean = motion_at(frames_s(count))
    mean[generator.random(mean.shape) < draw(st.sampled_from([0.0, 0.2]))] = np.nan
    return mean, *samples(count, motion_at)


@QUICK
@given(wild())
def test_parts_sum_to_the_score_whatever_the_trajectory(drawn):
    mean, times, values = drawn
    experiment = load_experiment(DRIVEN)
    diagnosis = diagnose_trajectory(
        experiment, band(mean), times_s=times, values=values
    )
    assert_consistent(diagnosis)
    assert diagnosis.rmse == pytest.approx(
        trajectory_rmse(values[::6], mean), rel=1e-12
    )


@pytest.mark.slow
@settings(max_examples=2, deadline=None)
@given(wild())
def test_order_changes_the_parts_but_neither_whole_nor_rest(drawn):
    mean, times, values = drawn
    experiment = load_experiment(DRIVEN)
    rests = []
    for order in itertools.permutations(DEFAULT_ORDER):
        diagnosis = diagnose_trajectory(
            experiment, band(mean), times_s=times, values=values, order=order
        )
        assert_consistent(diagnosis)
        assert tuple(part.stage for part in diagnosis.parts) == order
        rests.append((diagnosis.mean_square, diagnosis.rest.mean_square))
    assert len(set(rests)) == 1


@pytest.mark.slow
def test_the_search_finds_what_a_dense_grid_finds():
    """Of a motion with many local minima, by an independent brute force over shift and speed with NumPy alone."""
    experiment = load_experiment(DRIVEN)
    count = experiment.frame_count

    def motion_at(times):
        return np.column_stack(
            [50.0 * np.sin(14.0 * times), 30.0 * np.cos(23.0 * times), 5.0 * times]
        )

    times, values = samples(2 * count, motion_at)
    mean = motion_at(1.3 * np.maximum(frames_s(count) - 0.11, 0.0))
    diagnosis = diagnose_trajectory(
        experiment,
        band(mean),
        times_s=times,
        values=values,
        order=("rate", "release", "offset"),
    )
    start = values[0]
    least = math.inf
    for shift, rate in itertools.product(
        np.linspace(-1 / 3, 1 / 3, 161), np.linspace(0.6, 1.6, 201)
    ):
        own = rate * np.clip(frames_s(count) - shift, 0.0, times[-1])
        moved = (
            np.column_stack([np.interp(own, times, column) for column in values.T])
            - start
        )
        scale = np.clip(np.sum(moved * (mean - start)) / np.sum(moved**2), 0.5, 2.0)
        least = min(least, np.mean(np.sum((mean - start - scale * moved) ** 2, axis=1)))
    together = diagnosis.mean_square - sum(
        part.explained for part in diagnosis.parts[:2]
    )
    assert together <= least * (1.0 + 1e-9)
    assert change(diagnosis.parts[1], "speed").fitted == pytest.approx(1.3, abs=5e-3)


# --- real bands ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def ball():
    return run_episode(RunRequest(BALL))


def test_the_ball_is_let_go_late_and_rebounds_higher_than_calibrated(ball):
    """Against means over the real trials (scoring/facts/bouncing_ball_summary.toml) and nested changes of parameters.

    MuJoCo is 74.6 mm away; changing release, restitution, and start and contact height in turn takes off 39.6, 28.1 and
    6.8 mm. One offset cannot be start height (8.6 mm) and contact height (5.5 mm) at once, so 1 mm is left here.
    """
    diagnosis = diagnose(ball, order=stage_order(["release", "rate", "offset"]))
    assert_consistent(diagnosis)
    assert diagnosis.rmse == pytest.approx(ball.score.rmse, rel=1e-12)
    off = [part.rmse_before - part.rmse_after for part in diagnosis.parts]
    assert off == pytest.approx([39.6, 28.1, 5.8], abs=1.59)
    assert diagnosis.rest.rmse < 1.3
    found = diagnosis.parts[-1]
    assert change(found, "restitution").simulated == pytest.approx(0.577, abs=2.5e-3)
    assert change(found, "restitution").fitted == pytest.approx(0.737, abs=5e-3)
    assert change(found, "release_time").fitted == pytest.approx(0.0602, abs=2e-3)
    assert -8.6 < change(found, "offset", "z").fitted < -5.5


def test_release_is_the_alignment_of_the_score(ball):
    release = part(diagnose(ball), BudgetStage.RELEASE)
    assert release.rmse_after == pytest.approx(ball.score.rmse_aligned, rel=1e-9)
    assert change(release, "release_time").fitted == ball.score.release_offset_s


@pytest.mark.parametrize(
    ("material", "real_m_s2"), [("wood", 2.719), ("plastic", 2.898), ("metal", 2.603)]
)
def test_slides_accelerate_as_the_trials_do(material, real_m_s2):
    """Against the mean acceleration of the trials, fitted to each (scoring/facts/slope_slider_30deg_summary.toml)."""
    diagnosis = diagnose(run_episode(RunRequest(f"SlopeSlider-2-{material}")))
    assert diagnosis.rest.rmse < 0.6
    assert change(
        part(diagnosis, BudgetStage.RATE), "acceleration"
    ).fitted == pytest.approx(real_m_s2, rel=0.01)


def test_measured_frames_alone_are_another_whole(ball):
    diagnosis = diagnose(ball, measured_only=True)
    assert_consistent(diagnosis)
    assert (diagnosis.frames, diagnosis.extrapolated_frames) == (14, 0)
    assert diagnosis.rmse > ball.score.rmse
    assert "left out" in diagnosis.notes[0]
    whole = diagnose(ball)
    assert (whole.frames, whole.extrapolated_frames) == (18, 4)
    assert 0.0 < whole.extrapolated_share < 0.05


# --- what does not apply ---------------------------------------------------------------------------------------------


def test_a_law_has_no_release_and_what_rests_has_no_rate():
    experiment = load_experiment(HELD)
    count = experiment.frame_count
    place = np.tile([17.0, 397.0, 211.0], (count, 1))
    times, values = samples(
        count, lambda times: np.tile([18.0, 397.0, 209.0], (len(times), 1))
    )
    law = carried_band(variant=HELD, positions_mm=place)
    diagnosis = diagnose_trajectory(experiment, law, times_s=times, values=values)
    assert_consistent(diagnosis)
    assert "law" in part(diagnosis, BudgetStage.RELEASE).missing
    assert "does not move" in part(diagnosis, BudgetStage.RATE).missing
    assert part(diagnosis, BudgetStage.OFFSET).share == pytest.approx(1.0)
    assert [
        c.fitted for c in part(diagnosis, BudgetStage.OFFSET).changes
    ] == pytest.approx([-1.0, 0.0, 2.0])
    assert findings(diagnosis)[0].startswith("Release does not apply")


def test_a_simulation_at_rest_has_no_rate_and_is_not_shifted():
    experiment = load_experiment(SLIDE)
    count = experiment.frame_count
    run = samples(count, lambda times: np.tile([97.0, 407.0, 359.0], (len(times), 1)))
    mean = slide(2600.0)(frames_s(count))
    diagnosis = diagnosed(experiment, mean, run)
    assert (
        part(diagnosis, BudgetStage.RATE).missing
        == "the simulation does not move, so it has no rate"
    )
    assert change(part(diagnosis, BudgetStage.RELEASE), "release_time").fitted == 0.0
    assert part(diagnosis, BudgetStage.RELEASE).share == 0.0


def test_no_error_is_no_budget():
    experiment = load_experiment(SLIDE)
    count = experiment.frame_count
    times, values = samples(count, slide(2600.0))
    diagnosis = diagnose_trajectory(
        experiment, band(values[::6]), times_s=times, values=values
    )
    assert (diagnosis.rmse, diagnosis.rest.share) == (0.0, 0.0)
    assert findings(diagnosis) == (
        "The simulation is on the mean of the band: there is no error to explain.",
    )


def test_limits_are_reported():
    experiment = load_experiment(SLIDE)
    count = experiment.frame_count
    run = samples(count, slide(800.0))
    mean = slide(2600.0)(frames_s(count))
    diagnosis = diagnosed(experiment, mean, run)
    rate = change(part(diagnosis, BudgetStage.RATE), "acceleration")
    assert rate.at_bound
    assert rate.fitted == pytest.approx(2.0 * rate.simulated, rel=0.01)
    assert any("limit of what was tried" in line for line in findings(diagnosis))


def test_a_part_that_another_can_replace_is_reported():
    """Let go at the right time and too slow: a shift hides most of it, the acceleration is all of it."""
    experiment = load_experiment(SLIDE)
    count = experiment.frame_count
    run = samples(count + 10, slide(2600.0))
    mean = slide(2900.0)(frames_s(count))
    diagnosis = diagnosed(experiment, mean, run)
    assert part(diagnosis, BudgetStage.RELEASE).share > 0.5
    assert part(diagnosis, BudgetStage.RELEASE).last_share < 1e-3
    assert part(diagnosis, BudgetStage.RATE).alone_share > 0.999
    assert (
        "The order matters: 100 % is gone already if the acceleration is 2.900 instead of 2.6"
        in findings(diagnosis)[-1]
    )


def test_speed_and_displacement_that_cannot_be_separated_are_noted():
    experiment = load_experiment(DRIVEN)
    count = experiment.frame_count
    run = samples(count, slide(100.0))
    mean = slide(140.0)(frames_s(count))
    diagnosis = diagnosed(experiment, mean, run)
    assert diagnosis.rest.share < 1e-4
    assert any("its split between them is not" in note for note in diagnosis.notes)


# --- impacts ---------------------------------------------------------------------------------------------------------


def test_a_second_impact_ends_the_first_flight():
    fall_s = math.sqrt(2.0 * 400.0 / GRAVITY_MM_S2)
    until_s = fall_s * (1.0 + 2.0 * 0.3)
    times = np.arange(180) / 180.0
    height = bounce(0.3)(times)[:, 2:]
    later = times > until_s
    flight = times[later] - until_s
    height[later, 0] = (
        FLOOR_MM
        + 0.09 * GRAVITY_MM_S2 * fall_s * flight
        - 0.5 * GRAVITY_MM_S2 * flight**2
    )
    impact = find_impact(
        times,
        height,
        gravity_m_per_s2=GRAVITY_M_PER_S2[2:],
        contact_mm=np.array([FLOOR_MM]),
    )
    assert impact.restitution == pytest.approx(0.3, abs=1e-3)
    assert impact.time_s == pytest.approx(fall_s, abs=1e-5)
    assert impact.until_s == pytest.approx(until_s, abs=2.0 / 180.0)


@pytest.mark.parametrize(
    "motion_at", [slide(2600.0), lambda times: np.zeros((len(times), 3)), winding]
)
def test_there_is_no_impact_where_nothing_rebounds(motion_at):
    assert (
        find_impact(*samples(30, motion_at), gravity_m_per_s2=GRAVITY_M_PER_S2) is None
    )


# --- requests --------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def unscored():
    return run_episode(RunRequest("Turntable-3-plastic"))


def test_what_is_missing_is_reported(ball, unscored):
    with pytest.raises(DiagnosisError, match="no reference band"):
        diagnose(unscored)
    with pytest.raises(DiagnosisError, match="diverged, so there is no score"):
        diagnose(
            replace(
                ball, outcome=Outcome.DIVERGED, diverged=True, diverged_reason="it left"
            )
        )
    with pytest.raises(DiagnosisError, match="withheld"):
        experiment = load_experiment("CantileverBeam-soft")
        diagnose_trajectory(
            experiment,
            reference_band(experiment),
            times_s=np.zeros(1),
            values=np.zeros((1, 3)),
        )
    other = replace(
        ball,
        trajectory=replace(
            ball.trajectory,
            coordinates=["z"],
            samples=[[0.0]] * len(ball.trajectory.samples),
            later_samples=[[0.0]] * len(ball.trajectory.later_samples),
        ),
    )
    with pytest.raises(DiagnosisError, match="another version of the task file"):
        diagnose(other)


def test_trajectories_that_do_not_fit_are_refused():
    experiment = load_experiment(SLIDE)
    times, values = samples(experiment.frame_count, slide(2600.0))
    mean = band(values[::6])
    for wrong in (
        {"times_s": times[:-1]},
        {"times_s": times[:-1], "values": values[:-1]},
        {"times_s": times + 0.1},
        {"times_s": times[::-1]},
        {"values": np.where(values > 400.0, np.nan, values)},
        {"values": values[:, :2]},
    ):
        with pytest.raises(ShapeError):
            diagnose_trajectory(
                experiment, mean, **({"times_s": times, "values": values} | wrong)
            )
    with pytest.raises(DiagnosisError, match="no measured frame"):
        diagnose_trajectory(
            experiment,
            band(mean.mean, measured=np.zeros(len(mean.mean), bool)),
            times_s=times,
            values=values,
            measured_only=True,
        )


def test_another_reference_than_that_of_the_score_is_noted(ball):
    own = reference_band(load_experiment(BALL))
    moved = replace(own, mean=own.mean + 1.0)
    assert "was not made against this band" in diagnose(ball, band=moved).notes[-1]
    assert not any("was not made" in note for note in diagnose(ball).notes)


def test_command_takes_trajectories_of_any_simulator(gauge, tmp_path):
    times, values = samples(load_experiment(SLIDE).frame_count, slide(2600.0))
    rows = [
        "time_s,cube.x,cube.y,cube.z",
        *(
            ",".join(f"{v:.6f}" for v in (t, *g))
            for t, g in zip(times, values, strict=True)
        ),
    ]
    (tmp_path / "mine.csv").write_text("\n".join(rows))
    result = gauge("diagnose", "mine.csv", "--id", SLIDE, "--json")
    assert result.exit_code == 0
    assert json.loads(result.stdout)["kind"] == "uniform_acceleration"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("text", "--order=rate,release,offset"),
        ("wide", "--format wide"),
        ("markdown", "--format markdown"),
        ("json", "--json"),
        ("measured", "--measured-only"),
    ],
)
def test_the_output_is_the_approved_one(
    gauge, approved, tmp_path, ball, unscored, name, words
):
    # The worst comes first, whatever the order of the files.
    write_result(ball, tmp_path / "worst.json")
    write_result(unscored, tmp_path / "cradle.json")
    write_result(run_episode(RunRequest(SLIDE)), tmp_path / "near.json")
    result = gauge("diagnose", ".", *words.split())
    approved(f"diagnose/{name}", approval.readable(result))


def test_wrong_requests_are_refused(gauge, approved, tmp_path, ball, unscored):
    write_result(ball, tmp_path / "ball.json")
    write_result(unscored, tmp_path / "cradle.json")
    commands = (
        "diagnose cradle.json",
        "diagnose ball.json --order=rate",
        "diagnose ball.json --order=release,offset,offset",
        "diagnose ball.json --order=release,offset,speed",
        "diagnose missing",
        f"diagnose --id {SLIDE}",
    )
    approved("diagnose/refused", approval.refused_commands(gauge, *commands))


def test_pictures_are_drawn(gauge, tmp_path, ball):
    write_result(ball, tmp_path / "ball.json")
    drawn = gauge("plot", "--kind", "diagnose", "ball.json")
    assert (drawn.exit_code, drawn.stdout) == (0, "plots/diagnosis.png\n")
    axis = draw_diagnoses([(ball, diagnose(ball))]).axes[0]
    assert sum(bar.get_width() for bar in axis.patches) == pytest.approx(100.0)
    (tmp_path / "damaged.json").write_text("{")
    assert gauge("diagnose", ".").exit_code == 1
