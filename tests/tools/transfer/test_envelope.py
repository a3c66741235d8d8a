"""Envelopes against closed forms, and the ranges that are written for other packages."""

import math
from dataclasses import replace

import approval
import numpy as np
import pytest

from gauge_envs import load_experiment, variants
from gauge_envs.errors import ParameterError
from gauge_envs.experiments.uncertain import overrides_at, uncertain_parameters
from gauge_envs.references.sensitivities import input_uncertainties
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.tools.transfer.envelope import (
    Envelope,
    envelope_report,
    experiment_envelope,
    sobol_sigmas,
)
from gauge_envs.tools.transfer.policy_replays import (
    make_control_env,
    task_uncertainties,
)

SLIDE = "SlopeSlider-2-wood"
TASK = "SlopeSlider-Limit-wood"


# --- parameters ---


def test_parameters_have_the_uncertainties_of_their_files():
    found = {one.name: one for one in uncertain_parameters(load_experiment(SLIDE))}
    assert list(found) == [
        "cube.friction",
        "cube.restitution",
        "cube.mass_kg",
        "cube.position_m along its x axis",
        "cube.position_m along its y axis",
    ]
    assert (found["cube.friction"].value, found["cube.friction"].std) == (
        0.273673,
        pytest.approx(0.0171, abs=5e-5),
    )
    assert found["cube.mass_kg"].std == pytest.approx(1e-4 / math.sqrt(12))
    assert all(one.source for one in found.values())
    # The face of a board at 30 degrees.
    assert abs(found["cube.position_m along its x axis"].direction[2]) == pytest.approx(
        0.5
    )


JOINTED = (
    "JointPendulum-dry",
    "JointPendulum-viscous",
    "DoublePendulum-bars",
    "TorquePendulum-ak80",
    "ServoArm-so101",
)


@pytest.mark.parametrize("name", JOINTED)
def test_constants_of_joints_are_parameters(name):
    experiment = load_experiment(name)
    found = {one.name: one for one in uncertain_parameters(experiment)}
    hinges = (*experiment.scene.joints, *experiment.scene.body_hinges)
    stated = [
        value
        for hinge in hinges
        for part in (hinge.dynamics, hinge.motor)
        for key, value in vars(part or hinge.dynamics).items()
        if value and key in input_uncertainties().joint and part is not None
    ]
    assert sorted(
        one.value for key, one in found.items() if not key.endswith("mass_kg")
    ) == sorted(stated)
    assert all(one.std > 0.0 and one.unit != "1" for one in found.values())
    moved = load_experiment(
        name, overrides_at(list(found.values()), [1.0] * len(found))
    ).scene
    assert [body.pose for body in moved.bodies] == [
        body.pose for body in experiment.scene.bodies
    ]
    assert moved.body(experiment.recorded[0]).angular_velocity_rad_per_s == (
        experiment.scene.body(experiment.recorded[0]).angular_velocity_rad_per_s
    )


def test_an_envelope_of_trials_with_own_starts_is_that_of_the_first_trial():
    found = experiment_envelope("DoublePendulum-bars", samples=4)
    first = run_episode(RunRequest("DoublePendulum-bars")).score
    assert (found.quantity, found.unit, found.calibrated) == (
        "RMSE",
        "mm",
        pytest.approx(first.rmse),
    )
    # Friction that is two and more times uncertain moves the score, and no world starts as another trial.
    changes = overrides_at(found.parameters, found.sigmas[2].tolist())
    again = run_episode(RunRequest("DoublePendulum-bars", parameters=changes)).score
    assert found.values[2] == pytest.approx(again.rmse)


def test_every_experiment_can_be_moved_along_its_parameters():
    for variant in variants():
        experiment = load_experiment(variant)
        parameters = uncertain_parameters(experiment)
        moved = load_experiment(
            variant, overrides_at(parameters, [1.0] * len(parameters))
        ).scene
        assert (moved == experiment.scene) is (not parameters), variant.name


def test_a_control_task_takes_the_sigma_of_its_limit():
    env = make_control_env(TASK)
    friction = next(
        one for one in task_uncertainties(env) if one.key == "cube.friction"
    )
    assert (friction.value, friction.std) == (env.limit.value, env.limit.sigma)


def test_values_stay_physical():
    friction = next(
        one
        for one in uncertain_parameters(load_experiment(SLIDE))
        if one.key == "cube.friction"
    )
    assert overrides_at([friction], [-100.0]) == {"cube.friction": 0.0}
    assert overrides_at([replace(friction, high=0.3)], [100.0]) == {
        "cube.friction": 0.3
    }


def test_points_are_normally_distributed():
    points = sobol_sigmas(4096, 3, seed=1)
    # A Sobol sequence of 4096 points is far closer than the 0.016 of random numbers.
    assert np.abs(points.mean(axis=0)).max() < 0.002
    assert np.abs(points.std(axis=0) - 1.0).max() < 0.005
    assert np.array_equal(points, sobol_sigmas(4096, 3, seed=1))
    with pytest.raises(
        ParameterError, match="100 samples: a Sobol sequence needs a power of 2"
    ):
        sobol_sigmas(100, 3)


# --- envelopes ---


def test_the_size_of_a_batch_changes_nothing():
    found = experiment_envelope(SLIDE, samples=4, batch=3)
    assert found.quantity == "normalized RMSE"
    assert np.array_equal(
        found.values, experiment_envelope(SLIDE, samples=4, batch=4).values
    )
    # README: the score of this experiment.
    assert found.calibrated == pytest.approx(0.41, abs=0.005)


def test_experiments_without_a_band_have_a_deviation():
    found = experiment_envelope(
        "SlopeSlider-3-wood", samples=2, settings={"timestep_s": 1 / 1080}
    )
    assert (found.quantity, found.calibrated) == ("deviation", 0.0)
    assert np.all(found.values > 0.0)


def test_effects_are_those_of_a_known_function():
    parameters = uncertain_parameters(load_experiment(SLIDE))
    sigmas = sobol_sigmas(256, len(parameters))
    values = 3.0 + 0.5 * sigmas[:, 0] - 2.0 * sigmas[:, 2]
    found = Envelope(
        id="GAUGE/X",
        backend="mujoco",
        quantity="RMSE",
        unit="1",
        parameters=parameters,
        sigmas=sigmas,
        values=values,
        calibrated=3.0,
    )
    report = envelope_report(found)
    assert [one.parameter.key for one in report.effects[:2]] == [
        "cube.mass_kg",
        "cube.friction",
    ]
    assert [one.per_sigma for one in report.effects[:2]] == pytest.approx([-2.0, 0.5])
    assert (report.low, report.high) == pytest.approx(
        (3 - 1.96 * 2.06, 3 + 1.96 * 2.06), abs=0.15
    )


# --- command ---


@pytest.mark.parametrize(
    ("name", "words"), [("envelope", ""), ("envelope-json", "--json")]
)
def test_the_output_is_the_approved_one(gauge, approved, name, words):
    command = "transfer envelope SlopeSlider-2-wood --samples=4"
    result = gauge(*command.split(), *words.split())
    approved(f"transfer/{name}", approval.readable(result))


def test_a_picture_is_drawn(gauge, tmp_path):
    command = "transfer envelope Pendulum-metal --samples=4 --out a.png"
    assert gauge(*command.split()).exit_code == 0
    assert (tmp_path / "a.png").stat().st_size > 5_000


def test_wrong_requests_are_refused(gauge, approved):
    commands = (
        "transfer envelope Turntable-9",
        "transfer envelope Turntable-Limit-wood",
        "transfer envelope Turntable-1-wood --samples=5",
        "transfer a.pt --id Pendulum-Limit-metal",
        "transfer a.zip --id Turntable-1-wood",
        "transfer numpy:mean --trust --id Pendulum-Limit-metal --to bullet3",
        "transfer numpy:mean --trust --id Pendulum-Limit-metal --sigmas=one",
        "transfer numpy:mean --trust --id Pendulum-Limit-metal --sigmas=inf",
        "transfer numpy:mean --trust --id Pendulum-Limit-metal --sigmas=1e300",
        "transfer numpy:mean --trust --id Pendulum-Limit-metal --sigmas=nan",
        "transfer numpy:mean --trust --id Pendulum-Limit-metal --to mujoco --starts=1 --sigmas=1,1",
        "transfer numpy:mean --trust --id Pendulum-Limit-metal --to mujoco --to mujoco: --starts=1",
    )
    approved("transfer/refused", approval.refused_commands(gauge, *commands))
