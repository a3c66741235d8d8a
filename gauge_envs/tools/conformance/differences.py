"""Say why worlds of a batch have other courses than their scenes alone: each cause is tried on the recorded states."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LEAST = 1e-4
"""Difference of a state from which on it counts."""
CLOSE = 1e-3
"""Share of the largest difference that a cause may leave unexplained.

A true cause leaves rounding, 1e-6 in single precision; another start of a ball may leave 4e-3 of a late reading.
"""
BALL, BRICK, PLATE = range(3)
"""Columns of the bodies."""


def cause_of(here: Array, law: Array, others: Mapping[int, Array], mean: Array) -> str:
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
        or _first_part(here, law)
    )


def _reading(here: Array, law: Array, mean: Array, tolerance: float) -> str:
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


def _lost_intervals(ball: Array, law: Array, tolerance: float) -> str:
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


def _first_part(here: Array, law: Array) -> str:
    """Return the body that differs alone or first, and what its first difference is of."""
    apart = np.abs(here - law)
    if apart[:, PLATE].max() > LEAST:
        return "the driven plate is elsewhere: drive() gives the world the motion of another one, late, or in part"
    other = apart[:, BRICK].max()
    if apart[:, BALL].max() > LEAST and other > LEAST:
        return ""
    name, body = ("brick", BRICK) if other > LEAST else ("ball", BALL)
    alone = f"the {name} alone differs, "
    if apart[0, body, :3].max() > LEAST:
        return f"{alone}from the first interval on by its place: its start position is that of another world"
    first = int(np.flatnonzero(apart[:, body].max(axis=1) > LEAST)[0])
    if body == BRICK:
        return (
            f"{alone}which slides on the plate: its friction is that of another world"
        )
    if first == 0:
        return f"{alone}from the first interval on by its velocity: its start velocity is that of another world"
    # The course before is free flight, in which contacts have no part.
    turns = apart[first, body, 10:].max() > apart[first, body, 7:10].max()
    what = "friction" if turns else "restitution"
    return f"{alone}from its rebound in interval {first} on: its {what} is that of another world, or a constant"
