"""Say why worlds of a batch have other courses than their scenes alone: each cause is tried on the recorded states."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gauge_envs.scene import GRAVITY_M_PER_S2 as G
from gauge_envs.scene.geometry import BoolArray, FloatArray
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S

LEAST = 1e-4
"""Difference of a state from which on it counts."""
CLOSE = 1e-3
"""Share of the largest difference that a cause may leave unexplained.

A true cause leaves rounding, 1e-6 in single precision; another start of a ball may leave 4e-3 of a late reading.
"""
SHARE = 1e-2
"""Share of an acceleration by which a world may be off."""
FALL = np.array([0.0, 0.0, G * SAMPLE_INTERVAL_S])
"""What a free body has lost of its velocity after the first interval [m/s]."""
BALL, BRICK, PLATE = range(3)
"""Columns of the bodies."""


def cause_of(
    here: FloatArray,
    law: FloatArray,
    others: Mapping[int, FloatArray],
    mean: FloatArray,
) -> str:
    """Return what alone explains the course of a world; empty where nothing known does.

    Args:
        here: States of the world, shape [T, body_count, 13].
        law: States of its scene alone, likewise.
        others: States of the scenes of other worlds alone, by the number of the world.
        mean: Mean of the states of all worlds, likewise.
    """
    tolerance = CLOSE * float(np.abs(here - law).max())
    for number, course in others.items():
        if np.abs(here - course).max() < tolerance:
            return (
                f"it has the values of world {number}, of all bodies and in all intervals: that world is read, or its "
                "scene is built"
            )
    return (
        _reading(here, law, mean, tolerance)
        or _lost_intervals(here[:, BALL], law[:, BALL], tolerance)
        or _first_part(here, law, others)
    )


def _reading(
    here: FloatArray, law: FloatArray, mean: FloatArray, tolerance: float
) -> str:
    """Return how states that are right are read wrongly: late, scaled, or mixed with those of other worlds."""
    if np.abs(here[1:] - law[:-1]).max() < tolerance:
        return "the states that are read are those of an interval before, also of driven bodies: the reading is late"
    for name, others in (
        ("", np.zeros_like(law)),
        ("the mean of all worlds", mean),
    ):
        columns = np.column_stack([law.ravel(), others.ravel()])
        share, mixed = np.linalg.lstsq(columns, here.ravel(), rcond=None)[0]
        if np.abs(here - share * law - mixed * others).max() < tolerance:
            text = f"all states that are read are {share:.3g} times those of the world"
            return f"{text} and {mixed:.3g} times {name}" if name else text
    return ""


def _lost_intervals(ball: FloatArray, law: FloatArray, tolerance: float) -> str:
    """Return how many intervals a free ball falls behind."""
    behind: list[int] = []
    for sample, state in enumerate(ball):
        before = law[max(sample - 6, 0) : sample + 1][::-1]
        apart = np.abs(before - state).max(axis=1)
        if apart.min() > tolerance:
            return ""
        behind.append(int(apart.argmin()))
    if behind[-1] == 0 or np.any(np.diff(behind) < 0):
        return ""
    at = int(np.flatnonzero(behind)[0])
    return (
        f"from interval {at} on the ball is in the state of an interval before, {behind[-1]} before at the end, and no "
        "state is wrong before: calls of advance() leave the world out"
    )


def which(wrong: BoolArray) -> str:
    """Return which worlds are wrong in words, from a mark for each."""
    count, numbers = len(wrong), np.arange(len(wrong))
    for text, marks in (
        ("all worlds", numbers >= 0),
        ("the odd worlds", numbers % 2 == 1),
        ("the even worlds", numbers % 2 == 0),
        ("the second half of the worlds", numbers >= count // 2),
        ("the first half of the worlds", numbers < count // 2),
        ("the last world alone", numbers == count - 1),
    ):
        if np.array_equal(wrong, marks):
            return text
    return f"{wrong.sum()} of {count} worlds, the first of them world {wrong.argmax()}"


def cause_of_told(told: Mapping[str, FloatArray], shares: FloatArray) -> str:
    """Return what explains that worlds do not follow what they are told; empty where nothing known does.

    Args:
        told: What sets the acceleration of each world in proportion, the amount that is told first, by name, shape
            [world_count].
        shares: Acceleration in each interval over what it should be, shape [T, world_count].
    """
    ratios = shares.mean(axis=0)
    wrong = np.abs(ratios - 1.0) > SHARE
    if not wrong.any():
        return ""
    part, what = shares[:, wrong], next(iter(told))
    missing = np.abs(part - 1.0).max(axis=1) > 0.1
    count = int(missing.sum())
    start = f"in {which(wrong)} "
    if 0 < count < len(part):
        when = (
            f"in {count} of {len(part)} intervals, first in interval {missing.argmax()}"
        )
        if missing[:count].all():
            late = (
                "the first interval" if count == 1 else f"the first {count} intervals"
            )
            when = f"in {late}, and right after: it comes late, or is lost there"
        return f"{start}the {what} is wrong {when}"
    if np.ptp(ratios[wrong]) < SHARE:
        share = float(part.mean())
        if abs(share) < SHARE:
            return f"{start}no {what} acts: it is ignored, or they lose it when others are told"
        mass = (
            f", or {1.0 / share:.3g} times the mass"
            if share and told.keys() - {what}
            else ""
        )
        return f"{start}{share:.3g} times the {what} acts{mass}, at all times"
    numbers = np.arange(len(wrong))
    for name, amounts in told.items():
        acts = amounts * ratios
        others = {
            "of the world before": np.roll(amounts, 1),
            "of the world after": np.roll(amounts, -1),
            "of the neighbour in a pair": amounts[np.minimum(numbers ^ 1, numbers[-1])],
            "of the first world": np.full_like(acts, amounts[0]),
            "of the last world": np.full_like(acts, amounts[-1]),
            "in the mean of all worlds": np.full_like(acts, amounts.mean()),
        }
        for whose, other in others.items():
            for share in (1.0, 0.5):
                mixed = share * other + (1.0 - share) * amounts
                if np.abs(acts / mixed - 1.0)[wrong].max() < SHARE:
                    half = "" if share == 1.0 else "half of its own and half of "
                    return f"{start}{half}the {name} {whose} acts"
    return ""


def _first_part(
    here: FloatArray, law: FloatArray, others: Mapping[int, FloatArray]
) -> str:
    """Return the body that differs alone or first, and what its first difference is of."""
    apart = np.abs(here - law)
    if apart[:, PLATE].max() > LEAST:
        return "the driven plate is elsewhere: drive() gives the world the motion of another one, late, or in part"
    other = apart[:, BRICK].max()
    if apart[:, BALL].max() > LEAST and other > LEAST:
        return ""
    name, body = ("brick", BRICK) if other > LEAST else ("ball", BALL)
    alone = f"the {name} alone differs, "
    if body == BALL and apart[0, body, 7:10].max() > LEAST:
        start = (
            f"{alone}from the first interval on by its velocity: its start velocity is "
        )
        speeds = [one[0, body, 7:10] + FALL for one in (here, law)]
        for number, course in others.items():
            if np.abs(course[0, body, 7:10] + FALL - speeds[0]).max() < LEAST:
                return f"{start}that of world {number}"
        share = float(speeds[0] @ speeds[1] / (speeds[1] @ speeds[1]))
        is_scaled = np.abs(speeds[0] - share * speeds[1]).max() < LEAST
        return start + (f"{share:.3g} times its own" if is_scaled else "another one")
    if apart[0, body, :3].max() > LEAST:
        return f"{alone}from the first interval on by its place: its start position is that of another world"
    first = int(np.flatnonzero(apart[:, body].max(axis=1) > LEAST)[0])
    if body == BRICK:
        return (
            f"{alone}which slides on the plate: its friction is that of another world"
        )
    # The course before is free flight, in which contacts have no part.
    turns = apart[first, body, 10:].max() > apart[first, body, 7:10].max()
    what = "friction" if turns else "restitution"
    return f"{alone}from its rebound in interval {first} on: its {what} is that of another world, or a constant"
