"""Uncertain parameters of experiments and control tasks."""

import math
from dataclasses import replace

import pytest

from gauge_envs import load_experiment, variants
from gauge_envs.experiments.uncertain import overrides_at, uncertain_parameters
from gauge_envs.references.sensitivities import input_uncertainties
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
