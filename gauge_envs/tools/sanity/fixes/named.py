"""Correct the attributes that findings name, and try the correction on a copy of the model."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from gauge_envs.backends.mujoco.contact_table import contact_pairs
from gauge_envs.tools.sanity.fixes.harm import motion_harm
from gauge_envs.tools.sanity.fixes.text_change import TextChange
from gauge_envs.tools.sanity.model_checks.check import Change
from gauge_envs.tools.sanity.model_checks.joints import joint_brakes
from gauge_envs.tools.sanity.robot.robot import Place, Robot, spec_element
from gauge_envs.tools.sanity.static_rules import STATIC_RULES
from gauge_envs.tools.sanity.target_checks import TARGET_CHECKS
from gauge_envs.tools.sanity.verdict import SanityResult

SPEC_NAMES = {"joint": "target", "actuatorfrcrange": "actfrcrange"}
"""Attributes of MJCF that have another name in a spec."""

POLYNOMIALS = ("damping", "stiffness")
"""Attributes whose higher coefficients a file may leave out."""


def with_fix(result: SanityResult, robot: Robot) -> SanityResult:
    """Return a result with the change of the attributes that it names; without one that does not help, or harms."""
    check = TARGET_CHECKS.get(result.id)
    if check is None or not result.is_flag or robot.spec is None:
        return result
    changes = check.finding(robot).changes
    corrected = _corrected(robot, changes) if changes else None
    if corrected is None:
        return result
    counts = [
        rule.finding(corrected).value - rule.finding(robot).value
        for rule in (*STATIC_RULES, joint_brakes)
    ]
    is_left = check.deviation(check.finding(corrected).value) > 1.0
    if is_left or max(counts) > 0.0 or motion_harm(robot, corrected):
        return result
    (place, change), *others = changes
    more = f"; {len(others)} more" if others else ""
    key, value = change
    if key == "exclude":
        text = f'contact: <exclude body1="{value[0]}" body2="{value[1]}"/>'
    else:
        text = f'{robot.place_text(place)}: {key}="{_text(*change)}"'
    return replace(result, fix=f"{text}{more}")


def _corrected(robot: Robot, changes: Sequence[tuple[Place, Change]]) -> Robot | None:
    """Return a robot with changes; None where MuJoCo rejects them."""
    assert robot.spec is not None
    spec = robot.spec.copy()
    for (kind, number), (key, value) in changes:
        if key == "exclude":
            spec.add_exclude(bodyname1=value[0], bodyname2=value[1])
            continue
        element = spec_element(spec, kind, number)
        setattr(element, SPEC_NAMES.get(key, key), value)
    try:
        with warnings.catch_warnings(action="ignore"):
            model = spec.compile()
    except ValueError:
        return None
    return replace(robot, model=model, spec=spec, pairs=contact_pairs(model))


def _text(key: str, value: Any) -> str:
    """Return a value as MJCF writes it."""
    if isinstance(value, str):
        return value
    numbers = np.atleast_1d(value)
    if key in POLYNOMIALS and not numbers[1:].any():
        numbers = numbers[:1]
    return " ".join(f"{number:.6g}" for number in numbers)


def write_named(
    results: Sequence[SanityResult], robot: Robot, text: TextChange
) -> set[str]:
    """Write the changes of results with a fix into a text, and return the ids of those that the text shows."""
    written = set()
    for result in results:
        changes = TARGET_CHECKS[result.id].finding(robot).changes if result.fix else ()
        for place, (key, value) in changes:
            element = text.model.element(robot.model, *place)
            if key == "exclude":
                bodies = {"body1": value[0], "body2": value[1]}
                text.insert(("contact", key), bodies, is_behind=True)
            elif element is not None:
                text.correct(element, key, _text(key, value))
            else:
                break
        else:
            written |= {result.id} if changes else set()
    return written
