"""What `gauge diagnose` prints with `--json`, a line each."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gauge_envs.tools.diagnose.model import Diagnosis


@dataclass(frozen=True, kw_only=True)
class DiagnosisLine(Diagnosis):
    """The error budget of a result, and how it was run.

    Attributes:
        backend: Name of the engine; None for a trajectory file.
        parameters: Name of the parameter set, or the overrides.
        settings_given: Settings that the caller gave.
        seed: Seed.
        jitter: Standard deviations of the start; empty for the calibrated start.
        label: Name of the configuration in tables.
        findings: The budget in words, a sentence each.
    """

    backend: str | None
    parameters: str | Mapping[str, Any]
    settings_given: Mapping[str, Any]
    seed: int | None
    jitter: Mapping[str, int | float]
    label: str
    findings: tuple[str, ...]
