"""Configurations in the style of IsaacGym. Keys and values are those of the files named at each."""

import pytest
import yaml
from sanity_cases import read_text

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity import configuration
from gauge_envs.tools.sanity.stacks.isaac_gym import isaac_gym_configuration

pytest.importorskip("sapien")

# humanoidverse/config/simulator/isaacgym.yaml of ASAP, with the range of friction of legged_gym.
HUMANOIDVERSE = """
simulator:
  _target_: humanoidverse.simulator.isaacgym.isaacgym.IsaacGym
  config:
    name: "isaacgym"
    terrain: ${terrain}
    plane: {static_friction: 1.0, dynamic_friction: 1.0, restitution: 0.0}
    sim:
      fps: 200
      control_decimation: 4
      substeps: 1
      gravity: [0.0, 0.0, -9.81]
      physx:
        num_threads: 4
        solver_type: 1 # 0: pgs, 1: tgs
        num_position_iterations: 4
        num_velocity_iterations: 0
        contact_offset: 0.01
        rest_offset: 0.0
        bounce_threshold_velocity: 0.5
        max_depenetration_velocity: 1.0
        default_buffer_size_multiplier: 5
        contact_collection: 2
domain_rand: {randomize_friction: True, friction_range: [0.5, 1.25]}
"""

# protomotions/config/simulator/{base,isaacgym,physx}.yaml of ProtoMotions, joined, with values for the robot's keys.
PROTOMOTIONS = """
robot: {sim: {isaacgym: {fps: 60, decimation: 2, substeps: 2}}}
simulator:
  config:
    plane: {static_friction: 1.0, dynamic_friction: 1.0, restitution: 0.0}
    sim:
      fps: ${robot.sim.isaacgym.fps}
      decimation: ${robot.sim.isaacgym.decimation}
      substeps: ${robot.sim.isaacgym.substeps}
      physx:
        num_threads: 4
        solver_type: 1
        num_position_iterations: 4
        num_velocity_iterations: 0
        contact_offset: 0.02
        rest_offset: 0.0
        bounce_threshold_velocity: 0.2
        max_depenetration_velocity: 10.0
"""


class LeggedRobotCfg:
    """Values of legged_gym/envs/base/legged_robot_config.py."""

    class terrain:  # noqa: N801
        static_friction = 1.0
        dynamic_friction = 1.0
        restitution = 0.0

    class control:  # noqa: N801
        decimation = 4

    class asset:  # noqa: N801
        angular_damping = 0.0
        linear_damping = 0.0
        max_angular_velocity = 1000.0
        max_linear_velocity = 1000.0

    class domain_rand:  # noqa: N801
        randomize_friction = True
        friction_range = (0.5, 1.25)

    class sim:  # noqa: N801
        dt = 0.005
        substeps = 1
        gravity = (0.0, 0.0, -9.81)
        up_axis = 1

        class physx:  # noqa: N801
            num_threads = 10
            solver_type = 1
            num_position_iterations = 4
            num_velocity_iterations = 0
            contact_offset = 0.01
            rest_offset = 0.0
            bounce_threshold_velocity = 0.5
            max_depenetration_velocity = 1.0


def read(text, **sim):
    cfg = yaml.safe_load(text)
    cfg["simulator"]["config"]["sim"] |= sim
    return isaac_gym_configuration(cfg, name="config.yaml", source="test")


def test_references_of_hydra_are_followed(tmp_path):
    (tmp_path / "resolved.yml").write_text(PROTOMOTIONS)
    found = configuration(tmp_path / "resolved.yml")
    assert found.settings["timestep_s"] == pytest.approx(1 / 120)
    assert (found.frame_skip, found.settings["bounce_threshold_m_per_s"]) == (4, 0.2)
    assert found.foot_contact.mean_friction == 1.0
    with pytest.raises(TargetError, match="which Hydra fills in: give the file"):
        read(PROTOMOTIONS, fps="${oc.env:FPS}")
    with pytest.raises(TargetError, match=r"neither .*sim\.dt nor a positive"):
        read(PROTOMOTIONS, fps="${nowhere.else}")
    with pytest.raises(TargetError, match="which Hydra fills in"):
        read(PROTOMOTIONS, fps="${simulator.config.sim.fps}")


TASK = """
env:
  plane: {staticFriction: 0.8, dynamicFriction: 0.6, restitution: 0.2}
  controlFrequencyInv: 2
sim:
  dt: 0.0166
  substeps: 2
  up_axis: "y"
  gravity: [0.0, -9.81, 0.0]
  physx: {num_position_iterations: 8, solver_type: 0}
"""
"""A task of IsaacGymEnvs."""


def test_a_file_classes_and_a_task_are_read(tmp_path, approved):
    """The number of the vertical axis of classes is 0 for y and 1 for z; frictions are averaged."""
    (tmp_path / "config.yaml").write_text(HUMANOIDVERSE)
    targets = tmp_path / "config.yaml", LeggedRobotCfg(), yaml.safe_load(TASK)
    approved("sanity/read_isaac_gym", read_text(*map(configuration, targets)))


@pytest.mark.parametrize(
    ("sim", "message"),
    [
        ({"substeps": -1}, "substeps is -1: give 1 or more"),
        ({"fps": 0}, "neither"),
        (
            {"physx": {"num_position_iterations": "many"}},
            "num_position_iterations is 'many'",
        ),
        ({"physx": {"num_position_iterations": 0}}, "position_iterations"),
        (
            {"physx": None},
            "there is no table sim.physx; looked for sim, simulator.config.sim",
        ),
    ],
)
def test_a_wrong_value_is_named(sim, message):
    with pytest.raises(TargetError, match=message):
        read(HUMANOIDVERSE, **sim)
