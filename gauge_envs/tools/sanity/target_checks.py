"""All checks of the target itself, causes before effects: what is read, then what its own run shows."""

from __future__ import annotations

from collections.abc import Mapping

from gauge_envs.tools.sanity.model_checks import (
    at_rest,
    free_motion,
    ground,
    joints,
    own_contacts,
)
from gauge_envs.tools.sanity.model_checks.check import ModelCheck
from gauge_envs.tools.sanity.static_rules import STATIC_RULES

READ: tuple[ModelCheck, ...] = (
    ground.gravity,
    *STATIC_RULES,
    ground.feet,
    joints.joint_brakes,
    joints.servo_response,
)
"""Checks that simulate nothing."""

RUN: tuple[ModelCheck, ...] = (
    free_motion.holds,
    ground.holding_force,
    ground.stands,
    at_rest.overlap,
    at_rest.constraints,
    at_rest.slip,
    at_rest.hop,
    own_contacts.foot_creep,
    own_contacts.grasp_creep,
    at_rest.creep,
    free_motion.spin,
    free_motion.energy,
    free_motion.solver,
)
"""Checks of runs of the target's own model."""

TARGET_CHECKS: Mapping[str, ModelCheck] = {check.id: check for check in (*READ, *RUN)}
"""Checks of the target's own model, which run none of the suite's experiments, by their id."""
