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
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity.selection import selection
from gauge_envs.tools.sanity.training import TrainingConfiguration
from gauge_envs.tools.sanity.verdict import SanityResult

COMMENT = re.compile(
    r"<!--\s*gauge: accept ([^\s:]+(?::[^\s:]+)?):\s*(.*?)\s*-->", re.DOTALL
)

FILE = Path("gauge.toml")
"""File of the working directory with the findings that are accepted."""


def accept(
    results: Iterable[SanityResult], configuration: TrainingConfiguration
) -> list[SanityResult]:
    """Return results in which findings are accepted whose check, or each of whose elements, has a reason.

    Raises:
        TargetError: An entry has no reason, or the file cannot be read.
        UnknownNameError: An entry names no check.
    """
    reasons = dict(_reasons(configuration))
    empty = next((name for name, reason in reasons.items() if not reason), None)
    if empty is not None:
        raise TargetError(
            f"{empty} is accepted without a reason: state why it is right"
        )
    selection([name.partition(":")[0] for name in reasons])
    return [replace(result, accepted=_reason(result, reasons)) for result in results]


def _reasons(configuration: TrainingConfiguration) -> Iterator[tuple[str, str]]:
    """Yield names of findings, as `density` or `density:finger_l`, with the reason of each."""
    robot = configuration.robot
    if robot is not None and robot.text is not None:
        for text in robot.text.texts.values():
            yield from COMMENT.findall(text)
    if FILE.is_file():
        try:
            table = tomllib.loads(FILE.read_text(encoding="utf-8"))
            yield from table.get("sanity", {}).get("accept", {}).items()
        except (ValueError, AttributeError) as error:
            raise TargetError(f"{FILE}: {error}") from None


def _reason(result: SanityResult, reasons: Mapping[str, str]) -> str:
    """Return why a finding is accepted; empty where one of its elements is not."""
    if not result.verdict.is_off:
        return ""
    names = [f"{result.id}:{part.name}" for part in result.parts if part.verdict.is_off]
    found = [reasons.get(name, "") for name in names]
    parts = "; ".join(dict.fromkeys(found)) if all(found) else ""
    return reasons.get(result.id, parts)
