"""Fits of laws against closed forms, and the retained frames."""

import numpy as np
import pytest
from clips import driven, track_of

from gauge_envs.tools.video import video_task
from gauge_envs.tools.video.laws import (
    displacement_px,
    dynamic_error,
    fit_constant_acceleration,
    fit_damped_oscillation,
    retained,
)

TIMES_S = np.arange(40) / 30.0
SLIDE = video_task("SlopeSlider-2-wood")


def test_qfi_is_the_f_statistic_of_the_nested_models():
    rng = np.random.default_rng(0)
    noise_m = rng.normal(0.0, 0.01, TIMES_S.size)
    s = 0.5 * 1.3 * TIMES_S**2 + 0.2 * TIMES_S**4 + noise_m
    u = TIMES_S**2
    models = [np.polynomial.Polynomial.fit(u, s, degree) for degree in (1, 2)]
    linear, quadratic = (float(((s - model(u)) ** 2).sum()) for model in models)
    f_statistic = (linear - quadratic) / (quadratic / (TIMES_S.size - 3))
    fit = fit_constant_acceleration(TIMES_S, s)
    assert fit.qfi == pytest.approx(f_statistic, rel=1e-6)


def test_dynamic_error_of_a_circle_is_the_centripetal_force_beyond_friction():
    radius_m, rate = 0.1, 8.0
    times_s = np.arange(300) / 240.0
    angles = rate * times_s
    circle_m = radius_m * np.column_stack([np.cos(angles), np.sin(angles)])
    de_n = dynamic_error(times_s, circle_m, mass_kg=0.09, friction=0.38)
    # Three points on a circle give the acceleration 2 r (1 - cos(w dt)) / dt^2.
    a = 2.0 * radius_m * (1.0 - np.cos(rate / 240.0)) * 240.0**2
    assert de_n == pytest.approx(0.09 * (a - 0.38 * 9.80665), rel=1e-9)
    assert dynamic_error(times_s, circle_m, mass_kg=0.09, friction=0.7) == 0.0
    # Accelerations across a gap are exact for a parabola.
    times_s = np.array([0.0, 0.1, 0.4, 0.5, 0.9])
    parabola = np.column_stack([1.5 * times_s**2, 0.2 * times_s])
    force_n = dynamic_error(times_s, parabola, mass_kg=1.0, friction=0.0)
    assert force_n == pytest.approx(3.0)


@pytest.mark.parametrize(("period_s", "damping"), [(0.4, 0.0), (6.0, -0.2)])
def test_a_damped_oscillation_is_recovered_with_gaps(period_s, damping):
    times_s = np.delete(np.arange(150) / 25.0, np.arange(3, 150, 3))
    phase = 2.0 * np.pi / period_s * times_s
    angles = 0.1 + 0.3 * np.exp(-damping * times_s) * np.cos(phase + 0.7)
    fit = fit_damped_oscillation(times_s, angles)
    assert fit.period_s == pytest.approx(period_s, rel=1e-5)
    assert fit.damping_per_s == pytest.approx(damping, abs=1e-5)
    assert fit.r2 == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize(
    ("name", "a_m_s2", "fps"),
    [("BouncingBall-rubber", 7.87, 30.0), ("SlopeSlider-2-wood", 3.9, 18.0)],
)
@pytest.mark.parametrize("restitution", [0.05, 0.4])
def test_a_motion_ends_at_its_impact(restitution, name, a_m_s2, fps):
    """A rebound of some millimetres lasts a few frames, and only one of them may show a backward step."""
    task, fall_m = video_task(name), 0.3
    impact_s = (2.0 * fall_m / a_m_s2) ** 0.5
    since_s = np.arange(36) / fps - 0.25
    late_s = np.clip(since_s - impact_s, 0.0, 2.0 * restitution * impact_s)
    back_m = restitution * a_m_s2 * impact_s * late_s - 0.5 * a_m_s2 * late_s**2
    along_m = 0.5 * a_m_s2 * np.clip(since_s, 0.0, impact_s) ** 2 - back_m
    along_px = along_m[:, None] / task.scale_m_per_px
    track = track_of(task.centre_px + along_px * np.array(task.direction), fps)
    _, last = retained(track, task)
    assert since_s[last] < impact_s < since_s[last + 3]


def test_a_stop_of_two_frames_does_not_end_a_slide():
    frames = np.r_[0:21, 20, 20, 20:28]
    along_px = displacement_px(driven(SLIDE.id, 2.5), SLIDE)[frames, None]
    track = track_of(SLIDE.centre_px + along_px * np.array(SLIDE.direction), 30.0)
    assert retained(track, SLIDE)[1] == len(frames) - 1
