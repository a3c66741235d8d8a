"""Events of real recordings: each function finds the event of a made motion; each entry has a function."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gauge_envs import load_experiment, variants
from gauge_envs.experiments.resolve import with_trial
from gauge_envs.references.band import recorded_events
from gauge_envs.references.single_shot import single_shots
from gauge_envs.scoring.recorded_events import EVENTS, SampledMotion

TIMES_S = np.arange(600) / 180.0
FRAMES_S = np.arange(90) / 30.0


def events_of(variant, *names, samples=None, markers_m=None, markers=()):
    """Return events of a scene from made samples at 180 Hz or markers at 30 Hz; the other does not move."""
    samples = np.zeros((1, 3)) if samples is None else samples
    motion = SampledMotion(
        scene=load_experiment(variant).scene,
        times_s=np.arange(len(samples)) / 180.0,
        samples=samples,
        markers_m=np.zeros((1, 0, 3)) if markers_m is None else markers_m,
        markers=markers,
    )
    return [EVENTS[name](motion) for name in names]


def line_at(angles_deg, length_m=0.1):
    """Two markers, the second at an angle from straight below the first, shape [T, 2, 3]."""
    angles = np.radians(angles_deg)
    end = length_m * np.stack([0.0 * angles, np.sin(angles), -np.cos(angles)], axis=1)
    return np.stack([np.zeros_like(end), end], axis=1)


@pytest.mark.parametrize(("hertz", "centre"), [(1.69, 27.6), (3.3, 75.0)])
def test_a_damped_swing_has_a_frequency_and_a_mean_from_frame_8_to_42(hertz, centre):
    swing = np.exp(-0.9 * FRAMES_S) * np.cos(2 * np.pi * hertz * FRAMES_S + 0.3)
    angles = centre + 30.0 * swing
    frequency_hz, mean_deg = events_of(
        "CantileverBeam-soft",
        "swing_frequency_hz",
        "mean_angle_deg",
        markers_m=line_at(angles),
        markers=(0, 1),
    )
    assert frequency_hz == pytest.approx(hertz, rel=0.02)
    assert mean_deg == pytest.approx(angles[8:43].mean())


def test_a_body_lags_behind_its_driver():
    """The lag counts only within the span of time of the event; outside it, the body is elsewhere."""
    along = np.array([1.0, 0.0, 0.0])
    for variant, name, rate, ends_s, lag_mm in (
        ("StickStack-soft", "foot_lag_mm", 17.25, (1.0, 3.0), 3.0),
        ("TableclothPulling-metal", "cube_lag_mm", -37.037, (1.5, 2.0), 5.0),
    ):
        inside = abs(TIMES_S - np.mean(ends_s)) < 0.5 * np.ptp(ends_s) + 1e-3
        lag = np.where(inside, lag_mm, 9.0 * np.sign(TIMES_S)) * np.sign(rate)
        samples = 262.0 + (rate * TIMES_S - lag)[:, None] * along
        assert events_of(variant, name, samples=samples) == [
            pytest.approx(lag_mm, abs=1e-3)
        ]


def test_the_last_ball_of_a_cradle_leaves_rests_and_returns():
    out = (TIMES_S > 0.3) & (TIMES_S < 0.7) | (TIMES_S > 1.0) & (TIMES_S < 1.4)
    samples = np.stack([0 * TIMES_S, 0 * TIMES_S, 100 + 20.0 * out], axis=1)
    names = "leaves_1_s", "returns_2_s", "rests_1_s", "leaves_3_s", "rests_2_s"
    events = events_of("NewtonsCradle-metal", *names, samples=samples)
    assert events[:3] == pytest.approx([0.3, 1.4, 0.3], abs=0.01)
    assert all(map(math.isnan, events[3:]))


def test_a_slide_has_an_acceleration_between_2_and_90_mm_of_its_path():
    path = 500.0 * 6.5 * np.maximum(TIMES_S - 0.02, 0.0) ** 2
    path += np.where(path < 2.0, -0.3 * path, 0.0)
    path[path > 90.0] = 110.0
    samples = path[:, None] * np.array([0.6, 0.0, -0.8])
    name = "slide_acceleration_m_per_s2"
    (acceleration,) = events_of("SlopeContact-wood", name, samples=samples)
    assert acceleration == pytest.approx(6.5)
    (at_rest,) = events_of("SlopeContact-wood", name, samples=0.0 * samples)
    assert math.isnan(at_rest)


def test_the_turning_ratio_is_that_of_the_third_turn():
    angles = -1.5 * np.exp(-0.05 * TIMES_S) * np.cos(2 * np.pi * TIMES_S)
    scene = load_experiment("Pendulum-metal").scene
    swing = np.stack([np.sin(angles), 0.0 * angles, -np.cos(angles)], axis=1)
    samples = 1e3 * np.array(scene.joints[0].anchor_m) + 270.0 * swing
    (ratio,) = events_of("Pendulum-metal", "turning_ratio", samples=samples)
    assert ratio == pytest.approx(math.exp(-0.05 * 1.5), abs=1e-4)
    (early,) = events_of("Pendulum-metal", "turning_ratio", samples=samples[:200])
    assert math.isnan(early)


def test_a_foam_is_stretched_and_sheared():
    name = "FoamStretching-soft"
    rest_m = np.array(load_experiment(name).scene.markers.positions_m)
    grown = np.stack([rest_m, rest_m * [0.988, 0.988, 1.05]])
    assert events_of(name, "strain_zz", markers_m=grown) == [pytest.approx(0.05)]
    face = tuple(range(14))
    (ratio,) = events_of(name, "area_ratio", markers_m=grown, markers=face)
    assert ratio == pytest.approx(0.988 * 1.05, abs=1e-6)
    sheared = rest_m + 0.2 * rest_m[:, [2, 1, 0]] * [1.0, 0.0, 1.0]
    (strain,) = events_of(name, "strain_xz", markers_m=np.stack([rest_m, sheared]))
    assert strain == pytest.approx(0.2)


def test_a_cloth_swings_under_its_rod():
    scene = load_experiment("TextileFlinging-satin").scene
    rod_m = scene.drivers[0].path(scene.body("rod").pose, FRAMES_S)[:, None, :3]
    angles = np.where(
        FRAMES_S < 0.91, 20.0 * FRAMES_S, np.where(FRAMES_S < 1.74, -30.0, 6.0)
    )
    angles[FRAMES_S > 2.81] = 50.0
    names = "cloth_lag_deg", "cloth_swing_deg", "cloth_rebound_deg"
    markers_m = rod_m + line_at(angles, 0.45)
    events = events_of("TextileFlinging-satin", *names, markers_m=markers_m)
    assert events == pytest.approx([18.0, -30.0, 6.0])


@pytest.mark.parametrize("rate_hz", [30.0, 180.0])
def test_an_oblique_bounce_has_the_restitution_and_the_impulse_of_its_velocities(
    rate_hz,
):
    """Each start of a real trial, with drawn velocities after the bounce."""
    draw = np.random.default_rng(0)
    for trial in range(20):
        name = "ObliqueBounce-robot"
        scene = with_trial(load_experiment(name), trial).scene
        ball = scene.body("ball")
        fall = np.array(ball.linear_velocity_m_per_s)
        drop_m = ball.pose.position_m[2] - 0.02
        gravity = scene.gravity_m_per_s2
        fall[2] = -np.sqrt(fall[2] ** 2 + 2.0 * gravity * drop_m)
        bounce_s = (ball.linear_velocity_m_per_s[2] - fall[2]) / gravity

        restitution, ratio = draw.uniform(0.3, 1.2), draw.uniform(-0.2, 0.6)
        along = fall[:2] / np.linalg.norm(fall[:2])
        rise = np.array([0.0, 0.0, -restitution * fall[2]])
        rise[:2] = fall[:2] - ratio * (rise - fall)[2] * along
        since_s = np.arange(0.0, 0.24, 1.0 / rate_hz) - bounce_s
        path_m = np.outer(since_s, rise)
        path_m[:, 2] += 0.02 - 0.5 * gravity * since_s**2
        path_m[since_s < 0.0] = 0.5
        motion = SampledMotion(
            scene=scene,
            times_s=since_s + bounce_s,
            samples=1e3 * path_m,
            markers_m=np.zeros((1, 0, 3)),
        )
        values = [EVENTS[key](motion) for key in ("restitution", "impulse_ratio")]
        assert values == pytest.approx([restitution, ratio])
        rests = replace(motion, samples=1e3 * np.full_like(path_m, 0.02))
        assert np.isnan(EVENTS["restitution"](rests))


def test_each_entry_has_a_function_and_one_source():
    entries = [recorded_events(variant.name) for variant in variants()]
    used = {
        event.name for event in single_shots("ObliqueBounce-nospin").band(0, 8).events
    }
    for events in entries:
        names = [event.name for event in events]
        assert len(names) == len(set(names))
        assert all(".mp4: " in event.source for event in events)
        used |= set(names)
    assert used == set(EVENTS)
