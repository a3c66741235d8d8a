"""What a sanity check is made of: a configuration, and what each phenomenon is in reality, by default and in it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from typing import Any

from gauge_envs.files import json_ready

__all__ = [
    "Cause",
    "TrainingConfiguration",
    "ContactGroup",
    "Curve",
    "Reality",
    "Report",
    "PhenomenonResult",
    "SettingTrial",
    "Verdict",
]


class Verdict(StrEnum):
    """How far a measured value is from reality, in units of the scatter of real trials."""

    INSIDE = "inside"
    """Within two standard deviations: a real trial could have done this."""
    VISIBLE = "visible"
    """Beyond two, within five: a careful observer sees the difference."""
    WRONG = "wrong"
    """Beyond five, or of another kind: what holds in reality slides, what stays intact diverges."""
    DECLINED = "declined"
    """Not measured: the backend cannot build the scene, or cannot with these settings."""


@dataclass(frozen=True, kw_only=True)
class ContactGroup:
    """Pairs of geoms of a model that collide with the same constants.

    Attributes:
        geoms: In words, as `floor with torso, bthigh and 6 more`.
        pair_count: How many pairs of geoms there are.
        constants: Effective constants of a contact, by MuJoCo's names: `condim`, `friction`, `solref`, ...
        is_used: Whether these are the constants that the experiments run with.
    """

    geoms: str
    pair_count: int
    constants: Mapping[str, Any]
    is_used: bool = False


@dataclass(frozen=True, kw_only=True)
class TrainingConfiguration:
    """Numerical settings that a policy is trained with.

    Attributes:
        name: What the user asked for, as `HalfCheetah-v5`.
        source: What it was read from, in words.
        backend: Name of the physics engine.
        settings: Settings of that backend, given to every scene; what they leave out is the backend's default.
        origins: Where each setting is from, as `option`, `floor with torso, ...`; by name of the setting.
        frame_skip: Steps of the engine for one action; None where nothing says.
        contact_groups: Contact constants of a model: those on ground first, then by the number of pairs.
        notes: What could not be carried over, or deserves a look.
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
    """What real objects do.

    Attributes:
        value: Mean, or what a law says, in the phenomenon's unit.
        scatter: Standard deviation of real trials, in the same unit.
        source: Where both are from.
    """

    value: float
    scatter: float
    source: str


@dataclass(frozen=True, kw_only=True)
class Curve:
    """A quantity over time, to be drawn.

    Attributes:
        label: Name of the quantity with its unit.
        times_s: Times [s], shape [sample_count].
        default: On the backend's default, shape [sample_count]; empty where there is none.
        configured: In this configuration, at its own times.
        configured_times_s: Times of those.
        reality: Mean at `times_s`; empty where only the value is known.
        scatter: Standard deviation at `times_s`; empty likewise.
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
    """One change that was tried to find out what is responsible.

    Attributes:
        changes: Settings that were changed, with the values that they were given.
        value: What the phenomenon measured then; None where the run was declined or diverged.
        on_default: Whether the backend's default was changed, instead of the configuration.
    """

    changes: Mapping[str, Any]
    value: float | None
    on_default: bool = False


@dataclass(frozen=True, kw_only=True)
class Cause:
    """Which settings are responsible, found by changing one at a time.

    Attributes:
        settings: Their names; empty where no change of a few settings explains it.
        line: The finding in one line.
        tried: Everything that was tried.
    """

    settings: tuple[str, ...]
    line: str
    tried: tuple[SettingTrial, ...] = ()


@dataclass(frozen=True, kw_only=True)
class PhenomenonResult:
    """One phenomenon.

    Attributes:
        phenomenon: Id, as `creep-wood`.
        title: In a few words, as `static friction, wood: creep on 10 degrees`.
        experiment: Gymnasium id of the experiment.
        unit: Unit of the values; `1` for a pure number.
        reality: What real objects do.
        default: On the backend's default; None where it was not measured.
        configured: In this configuration; None where it was not measured.
        verdict: How far this configuration is from reality.
        default_verdict: How far the backend's default is.
        cause: Which setting is responsible; None where nothing is wrong.
        remark: Why it was not measured, or how it failed; empty otherwise.
        curve: What to draw; None where there is nothing over time.
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
        """Distance of this configuration from reality in standard deviations; None where it has none."""
        if self.configured is None or not self.reality.scatter:
            return None
        return abs(self.configured - self.reality.value) / self.reality.scatter

    def to_dict(self) -> dict[str, Any]:
        """All attributes, JSON-ready."""
        values: dict[str, Any] = json_ready(asdict(self))
        return values


@dataclass(frozen=True, kw_only=True)
class Report:
    """Outcome of a sanity check.

    Attributes:
        configuration: What was checked.
        rows: One a phenomenon, in a fixed order.
        versions: Versions of the engine's packages, gauge-envs and what it stands on.
        wall_s: Time that it took [s].
    """

    configuration: TrainingConfiguration
    rows: tuple[PhenomenonResult, ...]
    versions: Mapping[str, str]
    wall_s: float

    @property
    def worst(self) -> Verdict:
        """The worst verdict of any row; `declined` only where nothing was measured."""
        order = (Verdict.WRONG, Verdict.VISIBLE, Verdict.INSIDE)
        found = {row.verdict for row in self.rows}
        return next((verdict for verdict in order if verdict in found), Verdict.DECLINED)

    def to_dict(self) -> dict[str, Any]:
        """All attributes, JSON-ready."""
        values: dict[str, Any] = json_ready(asdict(self))
        return values | {"worst": self.worst.value}
