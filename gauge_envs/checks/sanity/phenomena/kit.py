"""What a phenomenon is."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gauge_envs.checks.sanity.model import Reality
from gauge_envs.checks.sanity.scenario import Rollout, Scenario

__all__ = [
    "FloatArray",
    "Phenomenon",
    "PhenomenonValue",
    "Trace",
]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class PhenomenonValue:
    """What a rollout shows of a phenomenon.

    Attributes:
        value: In the phenomenon's unit.
        failure: What happened that no real trial does, however the value came out; empty where nothing did.
    """

    value: float
    failure: str = ""


@dataclass(frozen=True, kw_only=True)
class Trace:
    """What of a phenomenon is drawn over time.

    Attributes:
        label: Name of the quantity with its unit.
        values: Its values at the samples of a rollout, shape [sample_count].
        reality: What real objects do at times [s]: mean and standard deviation; None where only a value is known.
        is_level: Whether reality is the phenomenon's value, with its scatter, at all times.
        until_s: What comes later is not drawn [s].
    """

    label: str
    values: Callable[[Rollout], FloatArray]
    reality: Callable[[FloatArray], tuple[FloatArray, FloatArray]] | None = None
    is_level: bool = False
    until_s: float = math.inf


@dataclass(frozen=True, kw_only=True)
class Phenomenon:
    """Something that real objects do, measured by one number.

    Attributes:
        id: Stable name.
        title: In a few words.
        quantity: What the number is, in a word or two.
        stage: Scene that shows it.
        unit: Unit of the number; `1` for a pure one.
        reality: What real objects do, with its scatter.
        read: Measures it on a rollout of the stage.
        trace: What is drawn; None where there is nothing over time.
    """

    id: str
    title: str
    quantity: str
    stage: Scenario
    unit: str
    reality: Reality
    read: Callable[[Rollout], PhenomenonValue]
    trace: Trace | None = None
