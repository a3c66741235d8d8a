"""Events of real recordings: functions find the event of a made motion; each entry has a function and an id."""

import math

import numpy as np
import pytest

from gauge_envs import load_experiment, variants
from gauge_envs.references.band import recorded_events
from gauge_envs.scoring.recorded_events import EVENTS, Motion


def motion_of(variant, samples=None, markers_m=None, markers=()):
    """Motion of a scene from made samples at 180 Hz or markers at 30 Hz; the other does not move."""
    samples = np.zeros((1, 3)) if samples is None else samples
    return Motion(
        scene=load_experiment(variant).scene,
        times_s=np.arange(len(samples)) / 180.0,
        samples=samples,
        markers_m=np.zeros((1, 0, 3)) if markers_m is None else markers_m,
        markers=markers,
    )


def line_at(angles_deg, length_m=0.1):
    """Two markers, the second at an angle from straight below the first, shape [T, 2, 3]."""
    angles = np.radians(angles_deg)
    end = length_m * np.stack([0.0 * angles, np.sin(angles), -np.cos(angles)], axis=1)
    return np.stack([np.zeros_like(end), end], axis=1)


@pytest.mark.parametrize(("hertz", "centre"), [(1.69, 27.6), (2.49, 72.0), (3.3, 75.0)])
def test_a_damped_swing(hertz, centre):
    t = np.arange(90) / 30.0
    angles = centre + 30.0 * np.exp(-0.9 * t) * np.cos(2 * np.pi * hertz * t + 0.3)
    motion = motion_of("CantileverBeam-soft", None, line_at(angles), (0, 1))
    assert EVENTS["swing_frequency_hz"](motion) == pytest.approx(hertz, rel=0.02)
    assert EVENTS["mean_angle_deg"](motion) == pytest.approx(angles[8:43].mean())


def test_a_body_behind_its_driver():
    t = np.arange(600) / 180.0
    foot, cube = 17.25 * t - 3.0 * (t > 0.5), 5.0 * (t > 0.5) - 37.037 * t
    along = np.array([1.0, 0.0, 0.0])
    motion = motion_of("StickStack-soft", 262.0 + foot[:, None] * along)
    assert EVENTS["foot_lag_mm"](motion) == pytest.approx(3.0, abs=1e-3)
    motion = motion_of("TableclothPulling-metal", 716.0 + cube[:, None] * along)
    assert EVENTS["cube_lag_mm"](motion) == pytest.approx(5.0, abs=1e-3)


def test_a_cradle():
    t = np.arange(400) / 180.0
    out = np.where((t > 0.3) & (t < 0.7) | (t > 1.0) & (t < 1.4), 20.0, 0.0)
    motion = motion_of("NewtonsCradle-metal", np.stack([0 * t, 0 * t, 100 + out], 1))
    found = {name: EVENTS[name](motion) for name in EVENTS if name[-4:-2] in "_1_2_3"}
    assert found["leaves_1_s"] == pytest.approx(0.3, abs=0.01)
    assert found["returns_2_s"] == pytest.approx(1.4, abs=0.01)
    assert found["rests_1_s"] == pytest.approx(0.3, abs=0.01)
    assert math.isnan(found["leaves_3_s"]) and math.isnan(found["rests_2_s"])


def test_a_slide_that_ends_in_an_impact():
    t = np.arange(60) / 180.0
    path = np.minimum(500.0 * 6.5 * np.maximum(t - 0.02, 0.0) ** 2, 110.0)
    samples = path[:, None] * np.array([0.6, 0.0, -0.8])
    motion = motion_of("SlopeContact-wood", samples)
    assert EVENTS["slide_acceleration_m_per_s2"](motion) == pytest.approx(6.5)
    at_rest = motion_of("SlopeContact-wood", np.zeros((60, 3)))
    assert math.isnan(EVENTS["slide_acceleration_m_per_s2"](at_rest))


def test_a_pendulum_that_loses_height():
    t = np.arange(540) / 180.0
    angles = -1.5 * np.exp(-0.05 * t) * np.cos(2 * np.pi * t)
    anchor_mm = 1e3 * np.array(
        load_experiment("Pendulum-metal").scene.joints[0].anchor_m
    )
    swing = np.stack([np.sin(angles), 0.0 * angles, -np.cos(angles)], axis=1)
    found = EVENTS["turning_ratio"](
        motion_of("Pendulum-metal", anchor_mm + 270.0 * swing)
    )
    assert found == pytest.approx(math.exp(-0.05 * 1.5), abs=1e-4)


def test_a_stretched_foam():
    rest_m = np.array(load_experiment("FoamStretching-soft").scene.markers.positions_m)
    grown = np.linspace(0.0, 1.0, 30)[:, None, None] * [-0.012, -0.012, 0.05]
    motion = motion_of("FoamStretching-soft", None, rest_m * (1.0 + grown))
    assert EVENTS["strain_zz"](motion) == pytest.approx(0.05)
    sheared = rest_m + 0.2 * rest_m[:, [2, 1, 0]] * [1.0, 0.0, 1.0]
    motion = motion_of("FoamStretching-soft", None, np.stack([rest_m, sheared]))
    assert EVENTS["strain_xz"](motion) == pytest.approx(0.2)
    face = tuple(range(14))
    motion = motion_of("FoamStretching-soft", None, rest_m * (1.0 + grown), face)
    assert EVENTS["area_ratio"](motion) == pytest.approx(0.988 * 1.05, abs=1e-6)


def test_a_cloth_on_a_rod():
    scene = load_experiment("TextileFlinging-satin").scene
    t = np.arange(90) / 30.0
    rod_m = scene.drivers[0].path(scene.body("rod").pose, t)[:, None, :3]
    angles = np.where(t < 0.9, 20.0 * t, np.where(t < 1.75, -30.0, 6.0))
    markers_m = rod_m + line_at(angles, 0.45)
    motion = motion_of("TextileFlinging-satin", None, markers_m)
    assert EVENTS["cloth_lag_deg"](motion) == pytest.approx(20.0 * 26 / 30)
    assert EVENTS["cloth_swing_deg"](motion) == pytest.approx(-30.0)
    assert EVENTS["cloth_rebound_deg"](motion) == pytest.approx(6.0)


def test_each_entry_has_a_function_and_one_source():
    entries = {one.name: recorded_events(one.name) for one in variants()}
    for events in entries.values():
        names = [event.name for event in events]
        assert len(names) == len(set(names))
        assert all(name in EVENTS for name in names)
        assert all(".mp4: " in event.source for event in events)
    used = {event.name for events in entries.values() for event in events}
    assert used == set(EVENTS)
