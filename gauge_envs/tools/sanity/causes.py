"""Join findings to their causes, and accept findings with a reason: in `gauge.toml`, or in a comment of the model.

What follows from a wrong joint or body is part of that finding.

```toml
[sanity.accept]
"density:finger_l" = "fingers of tungsten"
```

```xml
<!-- gauge: accept density:finger_l: fingers of tungsten -->
```
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from pydantic import BaseModel, ConfigDict

from gauge_envs.errors import TargetError
from gauge_envs.names import first_names, nearest
from gauge_envs.reading import reading
from gauge_envs.text import toml_document
from gauge_envs.tools.sanity.target_checks import READ, selection
from gauge_envs.tools.sanity.verdict import (
    SanityResult,
    SanityVerdict,
    Severity,
    TrainingConfiguration,
)

COMMENT = re.compile(r"<!--\s*gauge:\s*(.*?)\s*-->", re.DOTALL | re.IGNORECASE)

ENTRY = re.compile(r"accept\s+([^\s:]+(?::[^\s:][^:]*?)?)(?::\s*(.*?))?", re.DOTALL)
"""Check, or check and element, and the reason of a comment."""

FILE = Path("gauge.toml")
"""File of the working directory with the findings that are accepted."""

FORM = 'write [sanity.accept], then lines as "density:finger_l" = "fingers of tungsten"'


class AcceptTable(BaseModel):
    """The table `sanity` of the file: the reason of each accepted finding."""

    model_config = ConfigDict(extra="forbid", strict=True)

    accept: dict[str, str] = {}


class GaugeFile(BaseModel):
    """The file `gauge.toml`."""

    model_config = ConfigDict(extra="forbid")

    sanity: AcceptTable = AcceptTable()


class Entry(NamedTuple):
    """An accepted finding: its file, its name as `density` or `density:finger_l`, and why it is right."""

    file: str
    name: str
    reason: str


def entries(configuration: TrainingConfiguration) -> list[Entry]:
    """Return the accepted findings of `gauge.toml` and of the comments of the model.

    Raises:
        TargetError: The file or a comment cannot be read, a check does not exist, or an entry has no reason.
    """
    found = [*_comments(configuration)]
    if FILE.is_file():
        with reading(FILE, TargetError, hint=FORM) as content:
            table = GaugeFile.model_validate(toml_document(content)).sanity.accept
        found += [Entry(str(FILE), *item) for item in table.items()]
    for file, name, reason in found:
        check = name.partition(":")[0]
        if check not in selection():
            raise TargetError(
                f"{file}: unknown check {check!r}; {nearest(check, selection())}"
            )
        if not reason.strip():
            raise TargetError(
                f"{file}: {name} is accepted without a reason: state why it is right"
            )
    return found


def _comments(configuration: TrainingConfiguration) -> Iterator[Entry]:
    """Yield the accepted findings of the comments of the model."""
    robot = configuration.robot
    if robot is None or robot.text is None:
        return
    for file, text in robot.text.texts.items():
        for comment in COMMENT.findall(text):
            match = ENTRY.fullmatch(comment)
            if match is None:
                words = " ".join(comment.split())
                raise TargetError(
                    f'{file.name}: the comment "gauge: {words:.60}" is not read; '
                    'write "gauge: accept CHECK: REASON"'
                )
            yield Entry(file.name, match[1], match[2] or "")


def accept(
    results: Sequence[SanityResult], accepted: Sequence[Entry]
) -> tuple[list[SanityResult], tuple[str, ...]]:
    """Return results in which findings with a reason are accepted, and sentences on entries that accept nothing.

    A finding has a reason if its check, or each of its elements, has one.
    """
    reasons = {name: reason for _, name, reason in accepted}
    flags = [result for result in results if result.verdict.is_off]
    findings = {name for flag in flags for name in (flag.id, *_elements(flag))}
    left_out = {*selection()} - {result.id for result in results}
    notes = [
        f"{file}: {name} accepts no finding; {_others(name, findings)}"
        for file, name, _ in accepted
        if name not in findings and name.partition(":")[0] not in left_out
    ]
    for flag in flags:
        left = [name for name in _elements(flag) if name not in reasons]
        if flag.id not in reasons and 0 < len(left) < len(_elements(flag)):
            notes.append(f"{flag.id} stays: no reason accepts {first_names(left)}")
    return [replace(r, accepted=_reason(r, reasons)) for r in results], tuple(notes)


def _others(name: str, findings: set[str]) -> str:
    """Return a sentence with the other elements of a check that have findings, or with the nearest findings."""
    check = name.partition(":")[0]
    same = sorted(other for other in findings if other.startswith(f"{check}:"))
    if same or not findings:
        return f"findings: {first_names(same)}"
    return nearest(name, findings)


def _elements(result: SanityResult) -> list[str]:
    """Return the names of a finding with each of its elements."""
    return [f"{result.id}:{part.name}" for part in result.parts if part.verdict.is_off]


def _reason(result: SanityResult, reasons: Mapping[str, str]) -> str:
    """Return why a finding is accepted; empty where one of its elements is not."""
    if not result.verdict.is_off:
        return ""
    found = [reasons.get(name, "") for name in _elements(result)]
    parts = "; ".join(dict.fromkeys(found)) if all(found) else ""
    return reasons.get(result.id, parts)


EFFECTS = {
    "robot-holds": "its state diverges",
    "robot-torque": "its motors do not hold it",
    "robot-stands": "it falls or jumps",
    "model-overlap": "bodies are crushed",
    "model-constraints": "joints leave their ranges",
    "model-slip": "it creeps where friction holds",
    "model-hop": "it hops",
    "model-creep": "it creeps at rest",
    "model-spin": "it turns by itself in flight",
    "robot-energy": "it gains energy",
}
"""What follows from a wrong joint or body, by the check that shows it."""

HARMLESS = (
    "gravity",
    "stated-rolling",
    "stated-friction",
    "stated-margin",
    "stated-solref",
    "command-range",
    "imu-frame",
)
"""Static rules whose warnings explain no motion at rest."""

READ_IDS = {check.id for check in READ}

CAUSES = READ_IDS | {"robot-torque"}
"""Checks that explain later ones."""


def absorb(results: Sequence[SanityResult]) -> list[SanityResult]:
    """Return results in which a finding has its effects, and each effect its cause.

    A finding of what is read explains later ones on the same elements, and all runs of the model. An effect that is an
    error makes its cause one. Advice explains nothing: what is unusual need not be the cause of what the run shows.
    """
    found: dict[str, SanityResult] = {}
    for result in results:
        cause = next(
            (cause for cause in found.values() if _explains(cause, result)), None
        )
        found[result.id] = result
        if cause is None:
            continue
        found[result.id] = replace(result, cause=cause.id)
        effects = [*cause.effects, EFFECTS.get(result.id, "")]
        is_error = SanityVerdict.FAILED in (cause.verdict, result.verdict)
        found[cause.id] = replace(
            cause,
            effects=tuple(filter(None, effects)),
            verdict=SanityVerdict.FAILED if is_error else cause.verdict,
        )
    return [*found.values()]


def causes_first(flags: Sequence[SanityResult]) -> list[SanityResult]:
    """Return findings by stage and severity; advice that may be the cause stands in front of what the run shows."""
    order = [*Severity]

    def rank(flag: SanityResult) -> tuple[int, int]:
        stage = 2 * (flag.id not in READ_IDS)
        if flag.severity is Severity.ADVICE:
            stage = 3 if stage or flag.id in HARMLESS else 1
        return stage, -order.index(flag.severity)

    return sorted(flags, key=rank)


def _explains(cause: SanityResult, effect: SanityResult) -> bool:
    """Return whether a finding explains a later one."""
    if not (cause.id in CAUSES and cause.is_flag and effect.is_flag):
        return False
    is_slight = cause.verdict is SanityVerdict.WARNING
    if cause.is_usual or (is_slight and cause.id in HARMLESS):
        return False
    if cause.id == "range-unit" and effect.id.startswith("start-"):
        return True
    if effect.id not in EFFECTS:
        names = {part.name for part in cause.parts if part.verdict.is_off}
        return any(part.name in names for part in effect.parts if part.verdict.is_off)
    return True
