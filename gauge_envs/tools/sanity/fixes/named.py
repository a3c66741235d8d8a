"""Correct the attributes that findings name, and try the correction on a copy of the model."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np

from gauge_envs.backends.mujoco.contact_table import contact_pairs
from gauge_envs.tools.sanity.model_checks.check import ModelCheck
from gauge_envs.tools.sanity.robot.robot import Robot
from gauge_envs.tools.sanity.static_rules import STATIC_RULES
from gauge_envs.tools.sanity.verdict import SanityResult

SPEC_NAMES = {"joint": "target"}
"""Attributes of MJCF that have another name in a spec."""


def with_fix(result: SanityResult, robot: Robot) -> SanityResult:
    """Return a result with the change of the attributes that it names."""
    rule = next((rule for rule in STATIC_RULES if rule.id == result.id), None)
    if rule is None or not result.is_flag:
        return result
    return replace(result, fix=named_fix(robot, rule))


def named_fix(robot: Robot, check: ModelCheck) -> str:
    """Return the change of the attributes that a finding names; empty where it does not help, or causes a finding."""
    changes = check.finding(robot).changes
    corrected = _corrected(robot, check) if changes and robot.spec else None
    if corrected is None:
        return ""
    counts = [
        rule.finding(corrected).value - rule.finding(robot).value
        for rule in STATIC_RULES
    ]
    if check.finding(corrected).value or max(counts) > 0.0:
        return ""
    (place, (key, value)), *others = changes.items()
    more = f"; {len(others)} more" if others else ""
    return f'{robot.place_text(place)}: {key}="{_text(value)}"{more}'


def _corrected(robot: Robot, check: ModelCheck) -> Robot | None:
    """Return a robot with the changes of a finding; None where MuJoCo rejects them."""
    assert robot.spec is not None
    spec = robot.spec.copy()
    for (kind, number), (key, value) in check.finding(robot).changes.items():
        elements = spec.equalities if kind == "equality" else getattr(spec, f"{kind}s")
        element = next(element for element in elements if element.id == number)
        setattr(element, SPEC_NAMES.get(key, key), value)
    try:
        with warnings.catch_warnings(action="ignore"):
            model = spec.compile()
    except ValueError:
        return None
    return replace(robot, model=model, spec=spec, pairs=contact_pairs(model))


def _text(value: Any) -> str:
    """Return a value as MJCF writes it."""
    if isinstance(value, str):
        return value
    return " ".join(f"{number:.4g}" for number in np.atleast_1d(value))
