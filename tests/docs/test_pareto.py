"""Error over cost: each planted fault is reported as the kind of error that it is."""

from dataclasses import replace

import numpy as np
import pytest
from cost_results import STEPS_S, WOOD, made, rounding, sticking, sweep, wrong_step

from gauge_envs import load_experiment
from gauge_envs.runs.result import Outcome
from gauge_envs.tools.compare.cost import ErrorMeasure
from scripts.build_pareto import gathered
from scripts.pareto import closed_form, parametric_floor, tradeoff


def only(results):
    (phenomenon,) = tradeoff(results).phenomena
    (family,) = phenomenon.families
    return phenomenon, family


def by_step(family, error):
    """Errors from the coarsest step on."""
    return [
        getattr(point, error)
        for point in sorted(family.points, key=lambda point: -(point.step_s or 0.0))
    ]


def converged_step_s(family):
    (point,) = (point for point in family.points if point.is_reference)
    return point.step_s


def test_the_closed_form_of_a_ball_has_its_restitution():
    experiment = load_experiment("BouncingBall-rubber")
    exact = closed_form(experiment)
    drop_m = 0.451023 - 0.013297 - 0.03
    fall_s = np.sqrt(2 * drop_m / 9.80665)
    since_s = 14 / 30 - fall_s
    speed = 0.576733 * 9.80665 * fall_s
    assert (exact[14, 2] - (13.297 + 30)) / 1e3 == pytest.approx(
        speed * since_s - 0.5 * 9.80665 * since_s**2, abs=1e-9
    )


def test_a_first_order_error_is_numerical():
    _, family = only(sweep())
    numerical = by_step(family, "numerical")
    assert numerical[-1] == 0.0
    # x is off by a t h / 2, so the distance to the finest step is in proportion to h - h_finest: 15, 7, 3, 1.
    assert np.array(numerical[:-1]) / numerical[3] == pytest.approx(
        [15.0, 7.0, 3.0, 1.0], rel=1e-6
    )
    assert family.model == pytest.approx(family.resolution, rel=1e-6)


def test_a_wrong_step_in_the_engine_is_model_error():
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


def test_equal_wrong_motions_at_coarse_steps_are_not_the_converged_one():
    _, family = only(sweep(sticking))
    assert converged_step_s(family) == pytest.approx(STEPS_S[-1])
    numerical = by_step(family, "numerical")
    assert numerical[0] == numerical[1] > 0.5


def test_a_finest_step_that_rounds_is_not_the_converged_motion():
    _, family = only(sweep(rounding))
    assert STEPS_S[-1] * 1.01 < converged_step_s(family) < STEPS_S[0]
    assert by_step(family, "numerical")[-1] == family.resolution


def test_the_cost_is_the_least_of_the_repeats_and_relative_to_mujoco():
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


def test_other_iterations_are_compared_with_the_same_converged_motion():
    few = made(
        wrong_step, STEPS_S[-1], given={"timestep_s": STEPS_S[-1], "iterations": 1}
    )
    _, family = only([*sweep(), few])
    (point,) = [point for point in family.points if not point.is_on_main_line]
    assert (point.effort["iterations"], point.is_reference) == (1.0, False)
    assert point.numerical is not None
    assert point.numerical > 0.1


def test_a_diverged_setting_has_a_cost_and_no_error():
    broken = replace(made(step_s=STEPS_S[0]), outcome=Outcome.DIVERGED, diverged=True)
    _, family = only([broken, *sweep(steps_s=STEPS_S[1:])])
    (point,) = [point for point in family.points if point.diverged]
    assert (point.numerical, point.to_closed_form) == (None, None)


def test_the_floor_of_a_slide_is_that_of_its_closed_form():
    measure = ErrorMeasure.of(load_experiment(WOOD))
    found = parametric_floor(measure, "rapier")
    times_s, slope = np.arange(measure.experiment.frame_count) / 30, np.radians(30)
    # mm for one standard uncertainty: 6.249 % of the friction, 0.3 degrees of the board about its axis, which turns the
    # path too; the start moves by 1 mm along and across, and a tilt across turns the path by the board's sine.
    fall_mm = 1e3 * 0.5 * 9.80665 * times_s**2
    friction = fall_mm * np.cos(slope) * 0.06249 * 0.273673
    steeper = fall_mm * np.radians(0.3) * np.hypot(
        np.cos(slope) + 0.273673 * np.sin(slope), np.sin(slope) - 0.273673 * np.cos(slope)
    )  # fmt: skip
    squares = np.mean(friction**2) + np.mean(steeper**2) + 1.0 + 1.0
    assert found == pytest.approx(np.sqrt(squares), rel=0.02)


def test_engines_that_were_not_run_keep_their_data_and_date():
    stored = {"provenance": {"dates": {}}, "tradeoff": {"phenomena": []}}
    before = gathered([made(backend="rapier")], stored)
    before["provenance"]["dates"]["rapier"] = "2020-01-01"
    after = gathered([made()], before)
    old, now = (one["tradeoff"]["phenomena"][0]["families"] for one in (before, after))
    assert old == now[1:]
    assert after["provenance"]["dates"]["rapier"] == "2020-01-01"
