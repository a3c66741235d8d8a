"""Define a phenomenon: a scenario, a measured number, and its value in reality."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gauge_envs.checks.rollout import Rollout
from gauge_envs.checks.sanity.model import Reality
from gauge_envs.checks.sanity.scenario import Scenario

__all__ = ["FloatArray", "Phenomenon", "PhenomenonValue", "Trace"]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class PhenomenonValue:
    """Value of a phenomenon in a rollout.

    Attributes:
        value: Value in the phenomenon's unit.
        failure: Failure that no real trial shows, independent of the value; empty when there is none.
    """

    value: float
    failure: str = ""


@dataclass(frozen=True, kw_only=True)
class Trace:
    """Quantity of a phenomenon that is drawn over time.

    Attributes:
        label: Name of the quantity with its unit.
        values: Function from a rollout to the quantity, shape [sample_count].
        reality: Function from times [s] to mean and standard deviation of reality; None when only one value is known.
        is_level: Whether reality has the phenomenon's value and scatter at all times.
        until_s: Last time that is drawn [s].
    """

    label: str
    values: Callable[[Rollout], FloatArray]
    reality: Callable[[FloatArray], tuple[FloatArray, FloatArray]] | None = None
    is_level: bool = False
    until_s: float = math.inf


@dataclass(frozen=True, kw_only=True)
class Phenomenon:
    """Behaviour of real objects, measured by one number.

    Attributes:
        id: Stable name.
        title: Title of a few words.
        quantity: Name of the number, in one or two words.
        scenario: Scenario that shows the phenomenon.
        unit: Unit of the number; `1` for a pure number.
        reality: Value and scatter for real objects.
        read: Function that measures the number in a rollout of the scenario.
        trace: Quantity that is drawn over time; None when there is none.
    """

    id: str
    title: str
    quantity: str
    scenario: Scenario
    unit: str
    reality: Reality
    read: Callable[[Rollout], PhenomenonValue]
    trace: Trace | None = None
