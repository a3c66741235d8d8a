"""Checks of the target itself: runs of its model, its mass, joints and contacts, and the numbers that it gives."""

from __future__ import annotations

from collections.abc import Mapping

from gauge_envs.tools.sanity.model_checks import (
    at_rest,
    free_motion,
    ground,
    joints,
    masses,
    numbers,
)
from gauge_envs.tools.sanity.model_checks.check import ModelCheck, TargetCheck

MODEL_CHECKS: tuple[ModelCheck, ...] = (
    at_rest.overlap,
    at_rest.constraints,
    at_rest.sleeping,
    at_rest.creep,
    at_rest.cloth,
    at_rest.cloth_sink,
    free_motion.spin,
    free_motion.holds,
    free_motion.energy,
    free_motion.solver,
    free_motion.without_effect,
    ground.feet,
    ground.friction,
    ground.torsion,
    ground.overlap,
    joints.joint_brakes,
    joints.servo_response,
    joints.coupling_yield,
    joints.free_joint_drag,
    masses.mass,
    ground.holding_force,
    ground.stands,
)
"""Checks of the target's own model, in their order."""

TARGET_CHECKS: Mapping[str, TargetCheck] = {
    check.id: check for check in (*MODEL_CHECKS, numbers.gravity, numbers.action_time)
}
"""Checks of the target itself, which run none of the suite's experiments, by their id."""
