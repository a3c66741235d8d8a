"""Findings that a user accepts with a reason: in `gauge.toml`, or in a comment of the model.

```toml
[sanity.accept]
"density:finger_l" = "fingers of tungsten"
```

```xml
<!-- gauge: accept density:finger_l: fingers of tungsten -->
```
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from gauge_envs.errors import TargetError
from gauge_envs.names import nearest
from gauge_envs.tools.sanity.selection import selection
from gauge_envs.tools.sanity.training import TrainingConfiguration
from gauge_envs.tools.sanity.verdict import SanityResult

COMMENT = re.compile(
    r"<!--\s*gauge: accept\s+([^\s:]+(?::[^\s:][^:]*?)?)(?::\s*(.*?))?\s*-->", re.DOTALL
)

FILE = Path("gauge.toml")
"""File of the working directory with the findings that are accepted."""


def accept(
    results: Sequence[SanityResult], configuration: TrainingConfiguration
) -> tuple[list[SanityResult], tuple[str, ...]]:
    """Return results in which findings with a reason are accepted, and sentences on entries that accept nothing.

    A finding has a reason if its check, or each of its elements, has one.

    Raises:
        TargetError: An entry has no reason, or the file cannot be read.
    """
    entries = [*_entries(configuration)]
    for file, name, reason in entries:
        if not reason:
            raise TargetError(
                f"{file}: {name} is accepted without a reason: state why it is right"
            )
    reasons = {name: reason for _, name, reason in entries}
    flags = [result for result in results if result.verdict.is_off]
    findings = {name for flag in flags for name in (flag.id, *_elements(flag))}
    left_out = {*selection()} - {result.id for result in results}
    notes = tuple(
        f"{file}: {name} accepts no finding: {nearest(name, findings)}"
        for file, name, _ in entries
        if name not in findings and name.partition(":")[0] not in left_out
    )
    return [replace(r, accepted=_reason(r, reasons)) for r in results], notes


def _entries(configuration: TrainingConfiguration) -> Iterator[tuple[str, str, str]]:
    """Yield file, name of a finding as `density` or `density:finger_l`, and the reason of each entry."""
    robot = configuration.robot
    if robot is not None and robot.text is not None:
        for file, text in robot.text.texts.items():
            yield from ((file.name, *entry) for entry in COMMENT.findall(text))
    if FILE.is_file():
        try:
            table = tomllib.loads(FILE.read_text(encoding="utf-8"))
            accepted = table.get("sanity", {}).get("accept", {}).items()
        except (ValueError, AttributeError) as error:
            raise TargetError(f"{FILE}: {error}") from None
        yield from ((str(FILE), *entry) for entry in accepted)


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
