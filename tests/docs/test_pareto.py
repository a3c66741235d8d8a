"""Error over cost: each planted fault is reported as the kind of error that it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from cost_results import (
    PLASTIC,
    STEPS_S,
    WOOD,
    euler,
    made,
    rounding,
    sticking,
    sweep,
    wrong_step,
)

from gauge_envs import load_experiment
from gauge_envs.errors import ShapeError
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.tools.compare.cost import ErrorMeasure
from scripts.pareto import closed_form, parametric_floor, tradeoff, with_floor
from scripts.pareto_model import Family, Phenomenon


def only(results: Sequence[Result]) -> tuple[Phenomenon, Family]:
    (phenomenon,) = tradeoff(results).phenomena
    (family,) = phenomenon.families
    return phenomenon, family


def by_step(family: Family, error: str) -> list[float]:
    """Errors from the coarsest step on."""
    return [
        getattr(point, error)
        for point in sorted(family.points, key=lambda point: -(point.step_s or 0.0))
    ]


def test_the_closed_form_is_the_law_of_the_slide() -> None:
    experiment = load_experiment(WOOD)
    exact = closed_form(experiment)
    assert exact is not None
    way_m = np.linalg.norm(exact - exact[0], axis=1) / 1e3
    expected = 9.80665 * (np.sin(np.radians(30)) - 0.273673 * np.cos(np.radians(30)))
    assert 2.0 * way_m[9] / (9 / 30) ** 2 == pytest.approx(expected, rel=1e-4)


def test_the_closed_form_of_a_ball_has_its_restitution() -> None:
    experiment = load_experiment("BouncingBall-rubber")
    exact = closed_form(experiment)
    assert exact is not None
    drop_m = 0.451023 - 0.013297 - 0.03
    fall_s = np.sqrt(2 * drop_m / 9.80665)
    since_s = 14 / 30 - fall_s
    speed = 0.576733 * 9.80665 * fall_s
    assert (exact[14, 2] - (13.297 + 30)) / 1e3 == pytest.approx(
        speed * since_s - 0.5 * 9.80665 * since_s**2, abs=1e-9
    )


@pytest.mark.slow
def test_the_closed_form_of_a_pendulum_keeps_its_length_and_period() -> None:
    experiment = load_experiment("Pendulum-metal")
    exact = closed_form(experiment)
    assert exact is not None
    anchor_mm = 1e3 * np.array([0.373960, 0.490590, 0.445133])
    length_mm = np.linalg.norm(
        exact - exact.mean(axis=0) * [0, 1, 0] - anchor_mm * [1, 0, 1], axis=1
    )
    assert np.ptp(length_mm) < 1e-6
    # 4 sqrt(l_eff / g) K(sin^2 45 degrees), l_eff of the task file, K(1/2) = 1.8540746773
    period_s = 4.0 * np.sqrt(0.269881 / 9.80665) * 1.8540746773
    times_s = np.arange(len(exact)) / 30
    crossings = np.flatnonzero(np.diff(np.sign(exact[:, 0] - anchor_mm[0])))
    share = (exact[crossings, 0] - anchor_mm[0]) / (
        exact[crossings, 0] - exact[crossings + 1, 0]
    )
    found = times_s[crossings] + share / 30
    assert 2.0 * np.diff(found).mean() == pytest.approx(period_s, rel=1e-5)


def test_a_first_order_error_is_numerical() -> None:
    _, family = only(sweep())
    numerical = by_step(family, "numerical")
    assert numerical[-1] == 0.0
    # x is off by a t h / 2, so the distance to the finest step is in proportion to h - h_finest: 15, 7, 3, 1.
    assert np.array(numerical[:-1]) / numerical[3] == pytest.approx(
        [15.0, 7.0, 3.0, 1.0], rel=1e-6
    )
    assert family.model == pytest.approx(family.resolution, rel=1e-6)


def test_a_wrong_step_in_the_engine_is_model_error() -> None:
    phenomenon, family = only(sweep(wrong_step))
    sound = only(sweep())[1]
    assert family.model is not None
    assert family.resolution is not None
    assert family.model > 50.0 * family.resolution
    assert family.model > 50.0 * (sound.model or 0.0)
    # The split does not blame the step for it.
    assert by_step(family, "numerical")[0] == pytest.approx(
        1.2 * by_step(sound, "numerical")[0], rel=1e-6
    )
    assert min(by_step(family, "to_closed_form")) > 0.9 * family.model
    assert phenomenon.unit == "scatter"


def test_equal_wrong_motions_at_coarse_steps_are_not_the_converged_one() -> None:
    _, family = only(sweep(sticking))
    assert family.converged is not None
    assert family.converged.step_s == pytest.approx(STEPS_S[-1])
    numerical = by_step(family, "numerical")
    assert numerical[0] == numerical[1] > 0.5


def test_a_finest_step_that_rounds_is_not_the_converged_motion() -> None:
    _, family = only(sweep(rounding))
    assert family.converged is not None
    assert family.converged.step_s is not None
    assert STEPS_S[-1] * 1.01 < family.converged.step_s < STEPS_S[0]
    assert by_step(family, "numerical")[-1] == family.resolution


def test_a_motion_that_finer_steps_leave_is_not_resolved() -> None:
    def leaving(acceleration: float, time_s: float, step_s: float) -> float:
        """Two steps agree, and all finer ones converge to another motion."""
        return euler(
            acceleration
            * (0.5 if step_s > STEPS_S[2] + 1e-9 else 1.0 + STEPS_S[2] / step_s),
            time_s,
            1 / 2880,
        )

    phenomenon, family = only(sweep(leaving))
    assert family.resolution is not None
    assert family.sufficient_step_s is None
    assert phenomenon.families[0].resolution == family.resolution > 1.0


def test_the_cost_is_the_least_of_the_repeats_and_relative_to_mujoco() -> None:
    repeats = [
        made(step_s=STEPS_S[1], given={}, cpu_s=cpu_s, seed=seed)
        for seed, cpu_s in enumerate((0.3, 0.1, 0.2))
    ]
    slower = sweep(backend="rapier", steps_s=STEPS_S[1:2], cpu_s=0.4)
    (phenomenon,) = tradeoff([*repeats, *slower]).phenomena
    costs = {family.name: family.points[0] for family in phenomenon.families}
    assert costs["mujoco"].cost == pytest.approx(0.1 / 0.6, rel=1e-6)
    assert costs["mujoco"].cost_most == pytest.approx(0.3 / 0.6, rel=1e-6)
    assert (costs["mujoco"].repeats, costs["mujoco"].cost_ratio) == (3, 1.0)
    assert costs["rapier"].cost_ratio == pytest.approx(4.0)


def test_results_without_cpu_time_are_compared_by_wall_time() -> None:
    found = tradeoff(sweep(cpu_s=None))
    assert found.cost == "wall"
    assert found.phenomena[0].families[0].points[0].cost == pytest.approx(
        1e-3 / STEPS_S[0] / 0.6, rel=1e-6
    )


def test_a_phenomenon_has_the_error_of_its_worst_material() -> None:
    both = [*sweep(), *sweep(wrong_step, name=PLASTIC)]
    (phenomenon,) = tradeoff(both).phenomena
    (family,) = phenomenon.families
    assert phenomenon.ids == (f"GAUGE/{PLASTIC}", f"GAUGE/{WOOD}")
    assert family.model == only(sweep(wrong_step, name=PLASTIC))[1].model


def test_an_engine_that_lacks_a_material_is_left_out_with_a_note() -> None:
    found = tradeoff([*sweep(), *sweep(name=PLASTIC), *sweep(backend="rapier")])
    assert [family.backend for family in found.phenomena[0].families] == ["mujoco"]
    assert any("rapier" in note and PLASTIC in note for note in found.notes)


def test_other_iterations_are_compared_with_the_same_converged_motion() -> None:
    few = made(
        wrong_step, STEPS_S[-1], given={"timestep_s": STEPS_S[-1], "iterations": 1}
    )
    _, family = only([*sweep(), few])
    (point,) = [point for point in family.points if not point.is_on_main_line]
    assert (point.effort["iterations"], point.is_reference) == (1.0, False)
    assert point.numerical is not None
    assert point.numerical > 0.1


def test_a_diverged_setting_has_a_cost_and_no_error() -> None:
    broken = replace(made(step_s=STEPS_S[0]), outcome=Outcome.DIVERGED, diverged=True)
    _, family = only([broken, *sweep(steps_s=STEPS_S[1:])])
    (point,) = [point for point in family.points if point.diverged]
    assert (point.numerical, point.to_closed_form, point.fronts) == (None, None, ())


def test_the_front_has_no_setting_that_is_dearer_and_not_better() -> None:
    (phenomenon,) = tradeoff([*sweep(), *sweep(wrong_step, backend="rapier")]).phenomena
    rapier = next(
        family for family in phenomenon.families if family.backend == "rapier"
    )
    mujoco = next(
        family for family in phenomenon.families if family.backend == "mujoco"
    )
    assert all("to_closed_form" in point.fronts for point in mujoco.points)
    assert not any("to_closed_form" in point.fronts for point in rapier.points)


def test_the_last_step_of_a_short_series_is_not_taken_for_exact() -> None:
    """Its numerical error is 0 by definition; what is known of it is the distance to its neighbour."""
    (phenomenon,) = tradeoff(
        [*sweep(), *sweep(steps_s=STEPS_S[:2], backend="rapier")]
    ).phenomena
    mujoco = next(
        family for family in phenomenon.families if family.backend == "mujoco"
    )
    finer = [point for point in mujoco.points if (point.step_s or 0.0) < STEPS_S[1]]
    assert len(finer) > 1
    assert any("numerical" in point.fronts for point in finer)


def test_jittered_results_are_left_out() -> None:
    jittered = sweep(jitter={"position_m": 1e-3})
    with pytest.raises(ShapeError, match="no result"):
        tradeoff(jittered)
    assert any("jittered" in note for note in tradeoff([*sweep(), *jittered]).notes)


def test_the_floor_of_a_slide_is_that_of_its_closed_form() -> None:
    measure = ErrorMeasure.of(load_experiment(WOOD))
    found = parametric_floor(measure, "rapier")
    assert found is not None
    times_s, slope = np.arange(measure.experiment.frame_count) / 30, np.radians(30)
    # mm for one standard uncertainty: 6.249 % of the friction, 0.3 degrees of the board about its axis, which turns the
    # path too; the start moves by 1 mm along and across, and a tilt across turns the path by the board's sine.
    fall_mm = 1e3 * 0.5 * 9.80665 * times_s**2
    friction = fall_mm * np.cos(slope) * 0.06249 * 0.273673
    steeper = fall_mm * np.radians(0.3) * np.hypot(
        np.cos(slope) + 0.273673 * np.sin(slope), np.sin(slope) - 0.273673 * np.cos(slope)
    )  # fmt: skip
    squares = np.mean(friction**2) + np.mean(steeper**2) + 1.0 + 1.0
    assert found[0] == pytest.approx(np.sqrt(squares), rel=0.02)


def test_the_floor_of_the_ball_counts_a_higher_and_a_lower_restitution() -> None:
    measure = ErrorMeasure.of(load_experiment("BouncingBall-rubber"))
    found = parametric_floor(measure, "rapier")
    assert found is not None
    times_s = np.arange(measure.experiment.frame_count) / 30

    def height_m(restitution: float) -> np.ndarray:
        """Height of a ball over the ground, by its bounces."""
        drop_m = 0.451023 - 0.013297 - 0.03
        start_s, speed, height = 0.0, 0.0, np.full_like(times_s, drop_m)
        fall_s = np.sqrt(2 * drop_m / 9.80665)
        now = times_s <= fall_s
        height[now] = drop_m - 0.5 * 9.80665 * times_s[now] ** 2
        start_s, speed = fall_s, restitution * 9.80665 * fall_s
        while start_s < times_s[-1]:
            now = times_s > start_s
            height[now] = (
                speed * (times_s[now] - start_s)
                - 0.5 * 9.80665 * (times_s[now] - start_s) ** 2
            )
            start_s, speed = start_s + 2 * speed / 9.80665, restitution * speed
        return 1e3 * height

    usual, std = height_m(0.576733), 0.2778 * 0.576733
    compared = (
        np.isfinite(measure.band.mean).any(axis=1)
        if measure.band is not None
        else slice(None)
    )
    sides = [
        np.mean((height_m(0.576733 + sign * std) - usual)[compared] ** 2)
        for sign in (1.0, -1.0)
    ]
    assert abs(sides[0] / sides[1] - 1.0) > 0.1
    # Tilt and start add 5 mm in squares.
    assert found[0] == pytest.approx(np.sqrt(np.mean(sides)), rel=0.02)


def test_other_constants_have_no_published_uncertainty() -> None:
    measure = ErrorMeasure.of(
        load_experiment("BouncingBall-rubber", parameters="recorded")
    )
    assert parametric_floor(measure, "mujoco") is None


def test_a_step_is_sufficient_below_both_the_floor_and_the_real_scatter() -> None:
    """A restitution that is unknown by 28 % hides no numerical error that the trials would show."""
    _, family = only(sweep())
    # In real scatters, from the finest step on; the floors are 9.5 (ball) and 0.72 (slide).
    errors = dict(zip(sorted(STEPS_S), (0.0, 0.13, 0.4, 0.93, 2.0), strict=True))
    points = tuple(
        replace(
            one, numerical=errors[min(errors, key=lambda s: abs(s - (one.step_s or 0)))]
        )
        for one in family.points
    )
    for name, enough in (("BouncingBall-rubber", STEPS_S[1]), (WOOD, STEPS_S[2])):
        measure = ErrorMeasure.of(load_experiment(name))
        found = with_floor(replace(family, points=points), [measure], over_scatter=True)
        assert found.sufficient_step_s == pytest.approx(enough)
