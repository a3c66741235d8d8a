"""Define a phenomenon: a scenario, a measured number, and its value in reality."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gauge_envs.runs.rollout import Rollout
from gauge_envs.tools.sanity.model import Need, Reality
from gauge_envs.tools.sanity.scenario import Scenario

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
        reality: Function from times [s] to centre and half-width of the interval of reality; None when only one value
            is known.
        is_level: Whether reality has the phenomenon's interval at all times.
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
        id: Stable name, which the list of phenomena gives.
        title: Title of a few words.
        quantity: Name of the number, in one or two words.
        scenario: Scenario that shows the phenomenon.
        unit: Unit of the number; `1` for a pure number.
        reality: Value and scatter for real objects.
        value: Function that measures the number in a rollout of the scenario.
        failure: Function that returns a failure that no real trial shows, independent of the number; None for none.
        trace: Quantity that is drawn over time; None when there is none.
        needs_friction: Whether the phenomenon means nothing without friction.
        needs_foot: Whether the scene is built from the foot of the target.
        needs_space: Whether the phenomenon means nothing to a robot that moves in a plane along an axis of the world.
        is_impact: Whether the number depends on a restitution that the target may not state.
        advisory: Why the row never counts for the whole configuration; empty when it counts.
    """

    id: str = ""
    title: str
    quantity: str
    scenario: Scenario
    unit: str
    reality: Reality
    value: Callable[[Rollout], float]
    failure: Callable[[Rollout], str] | None = None
    trace: Trace | None = None
    needs_friction: bool = False
    needs_foot: bool = False
    needs_space: bool = False
    is_impact: bool = False
    advisory: str = ""

    @property
    def needs(self) -> tuple[Need, ...]:
        """What a target must have for the phenomenon to apply."""
        contact = (Need.CONTACT,) if self.scenario.scene.contacts else ()
        friction = (Need.FRICTION,) if self.needs_friction else ()
        return (
            Need.GRAVITY,
            *contact,
            *friction,
            *((Need.FOOT,) * self.needs_foot),
            *((Need.SPACE,) * self.needs_space),
        )

    def read(self, rollout: Rollout) -> PhenomenonValue:
        """Return what is measured in a rollout of the scenario."""
        failure = "" if self.failure is None else self.failure(rollout)
        return PhenomenonValue(value=float(self.value(rollout)), failure=failure)
