"""Define the parts of a sanity check: configuration, verdicts, phenomena in reality and in simulation, and causes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from typing import Any

from gauge_envs.files import json_ready

__all__ = [
    "INSIDE_WITHIN",
    "VISIBLE_WITHIN",
    "Cause",
    "ContactGroup",
    "Curve",
    "PhenomenonResult",
    "Reality",
    "Report",
    "SettingTrial",
    "TrainingConfiguration",
    "Verdict",
]

INSIDE_WITHIN = 2.0
"""Largest deviation of the verdict `inside`, in standard deviations of real trials."""

VISIBLE_WITHIN = 5.0
"""Largest deviation of the verdict `visible`, in standard deviations of real trials."""


class Verdict(StrEnum):
    """Distance between a measured value and reality, in standard deviations of real trials."""

    INSIDE = "inside"
    """At most two standard deviations: a real trial could give this value."""
    VISIBLE = "visible"
    """More than two and at most five standard deviations: a careful observer sees the difference."""
    WRONG = "wrong"
    """More than five standard deviations, or a failure of another kind, such as divergence."""
    DECLINED = "declined"
    """Not measured: the backend cannot build the scene, or not with these settings."""


@dataclass(frozen=True, kw_only=True)
class ContactGroup:
    """Pairs of geoms of a model that collide with the same constants.

    Attributes:
        geoms: Description of the geoms, such as `floor with torso, bthigh and 6 more`.
        pair_count: Number of pairs of geoms.
        constants: Effective constants of a contact by MuJoCo's names: `condim`, `friction`, `solref`, ...
        is_used: Whether the experiments run with these constants.
    """

    geoms: str
    pair_count: int
    constants: Mapping[str, Any]
    is_used: bool = False


@dataclass(frozen=True, kw_only=True)
class TrainingConfiguration:
    """Numerical settings that a policy is trained with.

    Attributes:
        name: Name that the user gave, such as `HalfCheetah-v5`.
        source: Description of what it was read from.
        backend: Name of the physics engine.
        settings: Settings of that backend for every scene; other settings are the backend's default.
        origins: Origin of each setting by its name, such as `option` or `floor with torso, ...`.
        frame_skip: Steps of the engine for one action; None when unknown.
        contact_groups: Contact constants of a model: those on ground first, then by the number of pairs.
        notes: Properties that are not carried over, or that need attention.
    """

    name: str
    source: str
    backend: str
    settings: Mapping[str, Any]
    origins: Mapping[str, str] = field(default_factory=dict)
    frame_skip: int | None = None
    contact_groups: tuple[ContactGroup, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Reality:
    """Value of a phenomenon for real objects.

    Attributes:
        value: Mean of real trials, or value from a law, in the phenomenon's unit.
        scatter: Standard deviation of real trials, in the same unit.
        source: Source of both.
    """

    value: float
    scatter: float
    source: str


@dataclass(frozen=True, kw_only=True)
class Curve:
    """Curve of a quantity over time.

    Attributes:
        label: Name of the quantity with its unit.
        times_s: Times of `default` [s], shape [sample_count].
        default: Values with the backend's default, shape [sample_count]; empty when there are none.
        configured_times_s: Times of `configured` [s].
        configured: Values in this configuration; empty when there are none.
        reality: Mean of reality at `times_s`; empty when only one value is known.
        scatter: Standard deviation of reality at `times_s`; empty when only one value is known.
    """

    label: str
    times_s: tuple[float, ...] = ()
    default: tuple[float, ...] = ()
    configured_times_s: tuple[float, ...] = ()
    configured: tuple[float, ...] = ()
    reality: tuple[float, ...] = ()
    scatter: tuple[float, ...] = ()


@dataclass(frozen=True, kw_only=True)
class SettingTrial:
    """One change of settings in the search for a cause.

    Attributes:
        changes: Changed settings with their new values.
        value: Measured value of the phenomenon; None when the backend declined or the rollout diverged.
        on_default: Whether the backend's default was changed instead of the configuration.
    """

    changes: Mapping[str, Any]
    value: float | None
    on_default: bool = False


@dataclass(frozen=True, kw_only=True)
class Cause:
    """Settings that are responsible for a visible or wrong phenomenon.

    Attributes:
        settings: Names of the settings; empty when no change of a few settings explains the error.
        line: Explanation in one line.
        tried: All changes that were tried.
    """

    settings: tuple[str, ...]
    line: str
    tried: tuple[SettingTrial, ...] = ()


@dataclass(frozen=True, kw_only=True)
class PhenomenonResult:
    """Result of one phenomenon.

    Attributes:
        phenomenon: Id, such as `creep-wood`.
        title: Title, such as `static friction, wood: creep on 10 degrees`.
        experiment: Gymnasium id of the experiment.
        unit: Unit of the values; `1` for a pure number.
        reality: Value for real objects.
        default: Value with the backend's default; None when not measured.
        configured: Value in this configuration; None when not measured.
        verdict: Verdict of this configuration.
        default_verdict: Verdict of the backend's default.
        cause: Responsible settings; None when the configuration is inside reality's scatter or was declined.
        remark: Why it was not measured, or how it failed; empty otherwise.
        curve: Curve over time; None when there is none.
    """

    phenomenon: str
    title: str
    experiment: str
    unit: str
    reality: Reality
    default: float | None
    configured: float | None
    verdict: Verdict
    default_verdict: Verdict
    cause: Cause | None = None
    remark: str = ""
    curve: Curve | None = None

    @property
    def sigmas(self) -> float | None:
        """Distance of this configuration from reality in standard deviations; None when nothing was measured."""
        if self.configured is None or not self.reality.scatter:
            return None
        return abs(self.configured - self.reality.value) / self.reality.scatter

    def to_dict(self) -> dict[str, Any]:
        """Return all attributes, JSON-ready."""
        values: dict[str, Any] = json_ready(asdict(self))
        return values


@dataclass(frozen=True, kw_only=True)
class Report:
    """Result of a sanity check.

    Attributes:
        configuration: The checked configuration.
        rows: One result for each phenomenon, in a fixed order.
        versions: Versions of the engine's packages, of gauge-envs and of its dependencies.
        wall_s: Time that the check took [s].
    """

    configuration: TrainingConfiguration
    rows: tuple[PhenomenonResult, ...]
    versions: Mapping[str, str]
    wall_s: float

    @property
    def worst(self) -> Verdict:
        """The worst verdict of all rows; `declined` only when nothing was measured."""
        order = (Verdict.WRONG, Verdict.VISIBLE, Verdict.INSIDE)
        found = {row.verdict for row in self.rows}
        return next((verdict for verdict in order if verdict in found), Verdict.DECLINED)

    def to_dict(self) -> dict[str, Any]:
        """Return all attributes, JSON-ready."""
        values: dict[str, Any] = json_ready(asdict(self))
        return values | {"worst": self.worst.value}
