"""Correct the attributes that findings name, and try the correction on a copy of the model."""

import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from gauge_envs.backends.mujoco.contact_table import contact_pairs
from gauge_envs.tools.sanity.causes import EFFECTS, absorb
from gauge_envs.tools.sanity.fixes.harm import motion_harm
from gauge_envs.tools.sanity.fixes.text_change import TextChange, attribute_text
from gauge_envs.tools.sanity.model_checks.check import Change
from gauge_envs.tools.sanity.model_checks.joints import joint_brakes
from gauge_envs.tools.sanity.robot.robot import (
    Place,
    Robot,
    find_standing,
    spec_element,
)
from gauge_envs.tools.sanity.static_rules import STATIC_RULES
from gauge_envs.tools.sanity.target_checks import TARGET_CHECKS
from gauge_envs.tools.sanity.verdict import (
    SanityResult,
    SanityVerdict,
    TrainingConfiguration,
)

SPEC_NAMES = {"joint": "target", "actuatorfrcrange": "actfrcrange"}
"""Attributes of MJCF that have another name in a spec."""

POLYNOMIALS = ("damping", "stiffness")
"""Attributes whose higher coefficients a file may leave out."""


def with_fixes(
    results: Sequence[SanityResult], configuration: TrainingConfiguration
) -> list[SanityResult]:
    """Return results with the changes of the attributes that they name; without those that do not help, or harm.

    Advice whose change makes all runs pass is the cause of what they show.
    """
    found, robot = list(results), configuration.robot
    assert robot is not None, "only a model has fixes"
    runs = [r.id for r in results if r.id in EFFECTS and r.is_flag and not r.is_usual]
    for number, result in enumerate(results):
        if (corrected := _tried(result, robot)) is None:
            continue
        changes = TARGET_CHECKS[result.id].finding(robot).changes
        after = replace(configuration, robot=corrected)
        is_cause = runs and all(
            TARGET_CHECKS[run].result(after).verdict is SanityVerdict.PASSED
            for run in runs
        )
        found[number] = replace(
            result,
            fix=_fix_text(changes, robot),
            is_usual=result.is_usual and not is_cause,
        )
    return absorb(found)


def _tried(result: SanityResult, robot: Robot) -> Robot | None:
    """Return the robot with the changes that a result names; None where they do not help, or harm."""
    check = TARGET_CHECKS.get(result.id)
    if check is None or not result.is_flag or robot.spec is None:
        return None
    changes = check.finding(robot).changes
    corrected = _corrected(robot, changes) if changes else None
    if corrected is None:
        return None
    counts = [
        rule.finding(corrected).value - rule.finding(robot).value
        for rule in (*STATIC_RULES, joint_brakes)
    ]
    is_left = check.deviation(check.finding(corrected).value) > 1.0
    if is_left or max(counts) > 0.0 or motion_harm(robot, corrected):
        return None
    return corrected


def _fix_text(changes: Sequence[tuple[Place, Change]], robot: Robot) -> str:
    """Return the first change, and the number of others."""
    (place, change), *others = changes
    more = f"; {len(others)} more" if others else ""
    key, value = change
    if key == "exclude":
        return f'contact: <exclude body1="{value[0]}" body2="{value[1]}"/>{more}'
    return f'{robot.place_text(place)}: {key}="{_text(*change)}"{more}'


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
    robot = replace(robot, model=model, spec=spec, pairs=contact_pairs(model))
    return replace(robot, standing=find_standing(robot))


def _text(key: str, value: Any) -> str:
    """Return a value as MJCF writes it."""
    if key in POLYNOMIALS and not np.atleast_1d(value)[1:].any():
        value = np.atleast_1d(value)[0]
    return attribute_text(value)


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
