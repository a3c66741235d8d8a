"""Results that a user expects of an engine: known failures, or the results of an earlier version."""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, StringConstraints, TypeAdapter

from gauge_envs.errors import ParameterError, UnknownNameError
from gauge_envs.reading import reading
from gauge_envs.text import toml_document
from gauge_envs.tools.conformance.catalog import checks
from gauge_envs.tools.conformance.model import CheckResult, Status
from gauge_envs.tools.conformance.results import read_columns


def has_moved(earlier: float | None, result: CheckResult) -> bool:
    """Return whether the value of a result differs from an earlier value by more than the tolerance of its check."""
    value = result.measured
    if earlier is None or value is None:
        return earlier is not value
    if not (math.isfinite(earlier) and math.isfinite(value)):
        return math.isfinite(earlier) or math.isfinite(value)
    return abs(value - earlier) > (result.width or 0.0)


# --- known failures --------------------------------------------------------------------------------------------------


FORM = 'write slide = { measured = 0.513, reason = "no model of it" }, and "cloth-*" = "no cloth" in [unsupported]'

Reason = Annotated[str, StringConstraints(strip_whitespace=True, min_length=1)]


class KnownFailure(BaseModel):
    """A failure that the repository of an engine expects.

    Attributes:
        reason: Reason in words.
        measured: The measured value; None if the check raises an error.
    """

    model_config = ConfigDict(extra="forbid", strict=True)

    reason: Reason
    measured: float | None = None


@dataclass(frozen=True, kw_only=True)
class KnownFailures:
    """Failures that the repository of an engine expects.

    Attributes:
        failures: Failures by the id of the check.
        unsupported: Reasons by patterns of the ids of checks that may be unsupported.
    """

    failures: Mapping[str, KnownFailure] = field(default_factory=dict)
    unsupported: Mapping[str, str] = field(default_factory=dict)

    def difference(self, result: CheckResult) -> str | None:
        """Return how a result differs from the list, in words; None if it does not."""
        known = self.failures.get(result.check)
        if known is not None and not result.is_bad:
            outcome = {Status.PASS: "passes", Status.UNSUPPORTED: "is unsupported"}
            return f"{outcome[result.status]}, but is listed as failing ({known.reason}): delete its line"
        if result.status is Status.UNSUPPORTED:
            return self._new_unsupported(result)
        if not result.is_bad:
            return None
        if known is None:
            return f"{_failed_text(result)}; if that is known, add {_line(result)}"
        if not has_moved(known.measured, result):
            return None
        listed = "an error" if known.measured is None else f"{known.measured:.4g}"
        return f"{_failed_text(result)}; the list has {listed}"

    def _new_unsupported(self, result: CheckResult) -> str | None:
        if any(fnmatchcase(result.check, pattern) for pattern in self.unsupported):
            return None
        reasons = "; ".join(result.missing)
        return f'is unsupported ({reasons}); if that is right, add "{result.check}" to [unsupported]'


def _failed_text(result: CheckResult) -> str:
    if result.measured is None:
        return f"raises an error: {result.diagnosis}"
    return f"fails, {result.measured:.4g} instead of {result.expected:.4g}: {result.diagnosis}"


def _line(result: CheckResult) -> str:
    value = "" if result.measured is None else f"measured = {result.measured:.6g}, "
    return f'{result.check} = {{ {value}reason = "..." }}'


def read_known_failures(file: Path) -> KnownFailures:
    """Return the known failures of a TOML file.

        rebound-flat = { measured = 0.513, reason = "each point rebounds" }
        [unsupported]
        "cloth-*" = "rigid bodies only"

    Raises:
        ParameterError: The file cannot be read, an entry has no reason or no value, or a check does not exist.
    """
    with reading(file, ParameterError, hint=FORM) as content:
        document = toml_document(content)
        reasons = document.pop("unsupported", {})
        ids = [check.id for check in checks()]
        for name in document:
            if name not in ids:
                raise UnknownNameError("check", name, [*ids, "unsupported"])
        unsupported = TypeAdapter(dict[str, Reason]).validate_python(reasons)
        for pattern in unsupported:
            if not any(fnmatchcase(name, pattern) for name in ids):
                raise UnknownNameError("check", pattern, ids)
        failures = TypeAdapter(dict[str, KnownFailure]).validate_python(document)
        return KnownFailures(failures=failures, unsupported=unsupported)


# --- an earlier version of an engine ---------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class StoredBaseline:
    """Results of an earlier version of the engine.

    Attributes:
        results: Results by configuration and id of the check.
    """

    results: Mapping[tuple[str, str], CheckResult]

    def difference(self, result: CheckResult) -> str | None:
        """Return how a result became worse or moved, in words; None if it did not, or its check is new or changed."""
        earlier = self.results.get((result.configuration, result.check))
        if earlier is None:
            return None
        if earlier.status is not result.status:
            kind = "worse" if earlier.status is Status.PASS else "moved"
            is_different = result.status is not Status.PASS
        else:
            kind, is_different = "moved", has_moved(earlier.measured, result)
        if not is_different:
            return None
        before, now = (f"{each.status}, {each.measured}" for each in (earlier, result))
        return f"{kind}: {before} before, {now} now"


def read_baseline(
    file: Path, backend: str, configurations: Collection[str]
) -> StoredBaseline:
    """Return the earlier results of an engine from a file of `gauge backend check --out`.

    Raises:
        ResultFileError: The file cannot be read or has no results.
        ParameterError: It lacks the engine or a configuration.
    """
    columns = {
        column.name: column
        for column in read_columns(file)
        if column.backend == backend
    }
    for name in configurations:
        if name not in columns:
            raise ParameterError(
                f"{file}: has no results of {backend}:{name}; it has {', '.join(columns) or 'none'} of {backend}"
            )
    results = {
        (name, check): result
        for name, column in columns.items()
        for check, result in column.results.items()
    }
    return StoredBaseline(results=results)


Expectation = KnownFailures | StoredBaseline
"""Results that are expected."""


def expectation_of(
    backend: str,
    expected: Path | None,
    baseline: Path | None,
    configurations: Collection[str] = ("default",),
) -> Expectation | None:
    """Return what a file of known failures or of an earlier release expects of an engine; None without a file.

    Raises:
        ParameterError: Both files are given, or one is not valid.
    """
    if expected is not None and baseline is not None:
        raise ParameterError(
            "known failures and a baseline exclude each other: give one of them"
        )
    if expected is not None:
        return read_known_failures(expected)
    if baseline is not None:
        return read_baseline(baseline, backend, configurations)
    return None
