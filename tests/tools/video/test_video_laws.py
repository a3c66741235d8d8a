"""Laws of the world-model track, against closed forms and other implementations."""

import numpy as np
import pytest
from clips import driven, track_of
from scipy import stats

from gauge_envs.errors import ParameterError
from gauge_envs.tools.video import video_task
from gauge_envs.tools.video.laws import (
    apices,
    displacement_px,
    dynamic_error,
    fit_constant_acceleration,
    fit_damped_oscillation,
    peak,
    retained,
)

TIMES_S = np.arange(40) / 30.0


def test_acceleration_from_rest_is_exact():
    fit = fit_constant_acceleration(TIMES_S, 0.01 + 0.5 * 2.58 * TIMES_S**2)
    assert fit.a_m_per_s2 == pytest.approx(2.58, rel=1e-12)
    assert fit.qfi == 0.0


@pytest.mark.parametrize(
    ("release_s", "window"),
    [(one, {"release_within_s": 1 / 30}) for one in (-0.02, 0.0, 0.013, 0.03)]
    + [
        (one, {"release_within_s": 0.13, "release_s": 0.36})
        for one in (0.31, 0.35, 0.42)
    ],
)
def test_a_release_between_two_frames_is_found(release_s, window):
    moving = np.maximum(TIMES_S - release_s, 0.0)
    fit = fit_constant_acceleration(TIMES_S, 0.5 * 2.58 * moving**2, **window)
    assert fit.a_m_per_s2 == pytest.approx(2.58, rel=1e-4)
    assert fit.release_s == pytest.approx(release_s, abs=1e-4)


def test_qfi_is_the_f_statistic_of_the_nested_models():
    rng = np.random.default_rng(0)
    s = 0.5 * 1.3 * TIMES_S**2 + 0.2 * TIMES_S**4 + rng.normal(0.0, 0.01, TIMES_S.size)
    u = TIMES_S**2
    linear = np.polynomial.Polynomial.fit(u, s, 1)
    quadratic = np.polynomial.Polynomial.fit(u, s, 2)
    sse = [float(((s - model(u)) ** 2).sum()) for model in (linear, quadratic)]
    expected = (sse[0] - sse[1]) / (sse[1] / (TIMES_S.size - 3))
    assert fit_constant_acceleration(TIMES_S, s).qfi == pytest.approx(
        expected, rel=1e-6
    )


def test_qfi_of_noise_follows_the_f_distribution():
    rng = np.random.default_rng(1)
    values = [
        fit_constant_acceleration(
            TIMES_S, TIMES_S**2 + rng.normal(0.0, 0.01, TIMES_S.size)
        ).qfi
        for _ in range(400)
    ]
    assert stats.kstest(values, stats.f(1, TIMES_S.size - 3).cdf).pvalue > 0.01


def test_dynamic_error_of_a_circle_is_the_centripetal_force_beyond_friction():
    radius_m, rate = 0.1, 8.0
    times_s = np.arange(300) / 240.0
    circle = radius_m * np.column_stack(
        [np.cos(rate * times_s), np.sin(rate * times_s)]
    )
    de_n, sizes = dynamic_error(times_s, circle, mass_kg=0.09, friction=0.38)
    # Three points of a circle give the acceleration 2 r (1 - cos(w dt)) / dt^2.
    a = 2.0 * radius_m * (1.0 - np.cos(rate / 240.0)) * 240.0**2
    assert sizes == pytest.approx(np.full(298, a), rel=1e-9)
    assert de_n == pytest.approx(0.09 * (a - 0.38 * 9.80665), rel=1e-9)
    assert dynamic_error(times_s, circle, mass_kg=0.09, friction=0.7)[0] == 0.0


def test_accelerations_over_a_gap_are_exact_for_a_parabola():
    times_s = np.array([0.0, 0.1, 0.4, 0.5, 0.9])
    parabola = np.column_stack([1.5 * times_s**2, 0.2 * times_s])
    _, sizes = dynamic_error(times_s, parabola, mass_kg=1.0, friction=0.0)
    assert sizes == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("period_s", "damping"), [(1.06, 0.05), (0.4, 0.0), (6.0, -0.2), (2.3, 1.0)]
)
def test_damped_oscillation_is_found(period_s, damping):
    times_s = np.arange(150) / 25.0
    omega = 2.0 * np.pi / period_s
    angles = 0.1 + 0.3 * np.exp(-damping * times_s) * np.cos(omega * times_s + 0.7)
    fit = fit_damped_oscillation(times_s, angles)
    assert fit.period_s == pytest.approx(period_s, rel=1e-5)
    assert fit.damping_per_s == pytest.approx(damping, abs=1e-5)
    assert fit.r2 == pytest.approx(1.0, abs=1e-9)


def test_damped_oscillation_with_gaps_and_noise():
    rng = np.random.default_rng(2)
    times_s = np.arange(200) / 30.0
    kept = rng.random(times_s.size) > 0.4
    angles = 0.2 * np.cos(2.0 * np.pi * times_s / 1.06) + rng.normal(
        0.0, 0.01, times_s.size
    )
    fit = fit_damped_oscillation(times_s[kept], angles[kept])
    assert fit.period_s == pytest.approx(1.06, rel=2e-3)
    guess = (fit.damping_per_s, 2.0 * np.pi / fit.period_s)
    assert fit_damped_oscillation(
        times_s[kept], angles[kept], guess=guess
    ).period_s == pytest.approx(fit.period_s)


def test_too_few_samples_are_an_error():
    with pytest.raises(ParameterError, match="too few"):
        fit_constant_acceleration([0.0, 0.1, 0.2], [0.0, 0.1, 0.2])


def test_form_is_the_same_for_any_scale():
    steady = 0.3 * TIMES_S
    fits = [
        fit_constant_acceleration(TIMES_S, scale * steady)
        for scale in (0.01, 1.0, 50.0)
    ]
    assert [fit.form for fit in fits] == pytest.approx([fits[0].form] * 3)
    # The best a + b t^2 of t on 0..1 leaves 1/sqrt(5) - ... of its spread: sqrt(1/12 - 15/256) of the distance.
    assert fits[0].form == pytest.approx((1 / 12 - 5 / 64) ** 0.5, abs=4e-3)


STEP_S = 1.0 / 30.0

SLIDE = video_task("SlopeSlider-2-wood")


def test_an_apex_is_a_swing_that_is_seen_on_both_sides():
    times_s = np.arange(60) / 30.0
    swing = np.maximum(0.4 * np.sin(2.0 * np.pi * times_s), 0.0)
    assert list(apices(times_s, swing, STEP_S)) in ([7, 37], [8, 38])
    trembling = 0.1 + 0.005 * np.sin(2.0 * np.pi * times_s * 1.3)
    assert not len(apices(times_s, trembling, STEP_S))
    # The first frame after a gap is the highest that is left of this swing, and no apex.
    seen = (times_s < 0.05) | (times_s > 0.3)
    assert len(apices(times_s[seen], swing[seen], STEP_S)) == 1
    # Of a ball that is seen now and then, nobody knows how high it swung between.
    alone = [0, 7, 17, 27, 37, 47]
    assert not len(apices(times_s[alone], swing[alone], STEP_S))


def test_an_apex_lies_between_two_frames():
    times_s = np.array([0.1, 0.2, 0.35])
    assert peak(times_s, 0.05 - 3.0 * (times_s - 0.22) ** 2) == pytest.approx(0.05)
    # Three places that are nearly a line have their other vertex far away.
    assert peak(times_s, 0.05 - 0.1 * times_s - 1e-9 * times_s**2) < 0.05


@pytest.mark.parametrize("phase_s", [0.0, 0.02, 0.04])
@pytest.mark.parametrize(
    ("name", "a_m_s2", "fps"),
    [("BouncingBall-rubber", 7.87, 30.0), ("SlopeSlider-2-wood", 3.9, 18.0)],
)
@pytest.mark.parametrize("restitution", [0.05, 0.2, 0.4])
def test_a_motion_ends_at_its_impact(restitution, name, a_m_s2, fps, phase_s):
    """A body that rebounds by some millimetres is back in a few frames: one of them alone may show a step back."""
    task, way_m = video_task(name), 0.3
    impact_s = (2.0 * way_m / a_m_s2) ** 0.5
    since_s = np.arange(36) / fps - 0.25 - phase_s
    late_s = np.clip(since_s - impact_s, 0.0, 2.0 * restitution * impact_s)
    back_m = restitution * a_m_s2 * impact_s * late_s - 0.5 * a_m_s2 * late_s**2
    gone_m = 0.5 * a_m_s2 * np.clip(since_s, 0.0, impact_s) ** 2 - back_m
    gone_px = gone_m[:, None] / task.scale_m_per_px
    track = track_of(task.centre_px + gone_px * np.array(task.direction), fps)
    _, last = retained(track, task)
    assert since_s[last] < impact_s < since_s[last + 3]


def test_a_cube_that_halts_for_two_frames_goes_on():
    """A model that lets a cube falter is judged with that."""
    ways_px = displacement_px(driven("SlopeSlider-2-wood", 2.0), SLIDE)
    shown = np.r_[np.arange(20), 20, 20, np.arange(20, 28)]
    places = SLIDE.centre_px + ways_px[shown, None] * np.array(SLIDE.direction)
    _, last = retained(track_of(places, 30.0), SLIDE)
    assert last == len(shown) - 1


@pytest.mark.parametrize("rest", [2, 3, 6])
def test_the_stop_before_the_end_of_a_clip_is_no_part_of_a_slide(rest):
    """The cube stops between the frames 25 and 26, and the clip shows it at rest in a few frames."""
    task = video_task("SlopeSlider-2-wood")
    ways_px = displacement_px(driven(task.id, 2.5), task)
    stopped_px = np.minimum(ways_px[: 26 + rest], 0.5 * (ways_px[25] + ways_px[26]))
    places = task.centre_px + stopped_px[:, None] * np.array(task.direction)
    _, last = retained(track_of(places, 30.0), task)
    assert last == 24
