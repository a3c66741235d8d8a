"""Define the report of a sanity check: the result of each check, and the best fix."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from gauge_envs.files import json_ready
from gauge_envs.tools.sanity.robot.robot import Settings
from gauge_envs.tools.sanity.training import TrainingConfiguration
from gauge_envs.tools.sanity.verdict import SanityResult, SanityVerdict


@dataclass(frozen=True, kw_only=True)
class ChangePart:
    """A part of a fix, such as an attribute.

    Attributes:
        text: The part in the target's language, such as `<option cone="elliptic"/>`.
        corrects: Ids of the failed checks and warnings that pass after this part alone.
    """

    text: str
    corrects: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Fix:
    """The change of a few settings that resolves most failed checks and warnings, as measured.

    Attributes:
        changes: Changed settings with their new values.
        line: The change in the target's language, and what it resolves.
        flag_count: Number of failed checks and warnings before the change.
        fixed: Value of each of these checks that passes after the change; None where it was not measured.
        lines: The change as lines of a diff, which start with `- ` or `+ `.
        parts: The parts of the change, each with what it resolves alone.
        speed_ratio: Simulated time of the target in a second after the change, over that before; None if not measured.
    """

    changes: Settings
    line: str
    flag_count: int
    fixed: Mapping[str, float | None] = field(default_factory=dict)
    lines: tuple[str, ...] = ()
    parts: tuple[ChangePart, ...] = ()
    speed_ratio: float | None = None


@dataclass(frozen=True, kw_only=True)
class Report:
    """Result of a sanity check.

    Attributes:
        configuration: The checked configuration.
        checks: Result of each check, in a fixed order.
        versions: Versions of the engine's packages, of gauge-envs and of its dependencies.
        wall_s: Time that the check took [s].
        fix: The change that resolves most failed checks and warnings; None when no change resolves one.
        tried: Changes that were tried and not chosen, and how far each came.
        trade: The best of these with its price, when no change resolves a check without harm; empty otherwise.
        unstated: Properties that the target's model leaves open, in one sentence; empty for none.
        notes: What limits the check, such as an expired time limit.
        asked: Ids of checks that were requested by their full id.
    """

    configuration: TrainingConfiguration
    checks: tuple[SanityResult, ...]
    versions: Mapping[str, str]
    wall_s: float = 0.0
    fix: Fix | None = None
    tried: tuple[str, ...] = ()
    trade: str = ""
    unstated: str = ""
    notes: tuple[str, ...] = ()
    asked: tuple[str, ...] = ()

    @property
    def flags(self) -> dict[str, SanityResult]:
        """Failed checks and warnings that count, by id."""
        return {result.id: result for result in self.checks if result.is_flag}

    @property
    def unmeasured(self) -> tuple[str, ...]:
        """Ids of checks that apply, or were requested by id, and were not measured; all ids when none was measured."""
        missing = [
            result
            for result in self.checks
            if result.verdict is SanityVerdict.NOT_MEASURED
        ]
        is_all = len(missing) == len(self.checks)
        return tuple(
            result.id
            for result in missing
            if is_all or result.applies or result.id in self.asked
        )

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of checks that were measured, that apply and were not measured, and that do not apply."""
        missing = [
            result
            for result in self.checks
            if result.verdict is SanityVerdict.NOT_MEASURED
        ]
        inapplicable = sum(not result.applies for result in missing)
        return {
            "measured": len(self.checks) - len(missing),
            "not_measured": len(missing) - inapplicable,
            "not_applicable": inapplicable,
        }

    @property
    def worst(self) -> SanityVerdict:
        """The worst verdict of all checks that count; `not measured` only when nothing was measured."""
        order = (SanityVerdict.FAILED, SanityVerdict.WARNING, SanityVerdict.PASSED)
        verdicts = {
            SanityVerdict.PASSED if result.advisory else result.verdict
            for result in self.checks
        }
        return next(filter(verdicts.__contains__, order), SanityVerdict.NOT_MEASURED)

    def to_dict(self) -> dict[str, Any]:
        """Return all attributes, JSON-ready, without the target's own model."""
        bare = replace(self, configuration=replace(self.configuration, robot=None))
        values: dict[str, Any] = json_ready(asdict(bare))
        del values["configuration"]["robot"]
        return values | {
            "worst": self.worst.value,
            "unmeasured": list(self.unmeasured),
            "counts": self.counts,
        }


def flags_text(results: Sequence[SanityResult]) -> str:
    """Return what failed checks and warnings are called together, such as `failed checks`."""
    verdicts = {result.verdict for result in results}
    nouns = {SanityVerdict.FAILED: "failed checks", SanityVerdict.WARNING: "warnings"}
    return " and ".join(noun for verdict, noun in nouns.items() if verdict in verdicts)
