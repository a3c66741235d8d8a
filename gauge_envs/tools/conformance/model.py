"""Define a check, its tolerance, and its result on a backend."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from typing import Any

from gauge_envs.files import json_ready
from gauge_envs.tools.conformance.lab import Lab


class Status(StrEnum):
    """Outcome of a check."""

    PASS = "pass"
    """The measured value is within the tolerance."""
    FAIL = "fail"
    """The measured value is outside the tolerance, or not finite."""
    DECLINED = "declined"
    """The backend reports that it cannot build the scene; this is not a failure."""
    ERROR = "error"
    """The backend raised an exception, its process died, or it exceeded a limit."""


@dataclass(frozen=True, kw_only=True)
class Tolerance:
    """Largest difference between a measured and an expected value: `absolute + relative * |expected|`.

    It is the same for every engine.

    Attributes:
        rationale: Reason for the width, from physics or from the benchmark, never from an engine.
        absolute: Part in the unit of the measured value.
        relative: Part as a share of the expected value.
    """

    rationale: str
    absolute: float = 0.0
    relative: float = 0.0

    def width(self, expected: float) -> float:
        """Return the largest admissible distance from an expected value, in its unit."""
        return self.absolute + self.relative * abs(expected)


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """Measured and expected value of a check.

    Attributes:
        measured: The measured value.
        expected: The value that the law gives, in the same unit.
        hint: Likely cause of this particular value, for the diagnosis; may be empty.
    """

    measured: float
    expected: float
    hint: str = ""


@dataclass(frozen=True, kw_only=True)
class Check:
    """One law that a backend must obey, measured by one number.

    Attributes:
        id: Stable name.
        title: Subject of the check, in a few words.
        scene: The scene that is built: bodies, supports, and what moves them.
        measures: The measured quantity and the method.
        law: Formula of the expected value.
        source: Origin of the law.
        unit: Unit of the measured value; "1" for a pure number.
        tolerance: Largest admissible difference.
        diagnosis: Likely causes of a failure.
        measure: Function that builds the scene in a `Lab` and measures.
    """

    id: str
    title: str
    scene: str
    measures: str
    law: str
    source: str
    unit: str
    tolerance: Tolerance
    diagnosis: str
    measure: Callable[[Lab], Measurement]

    @property
    def fingerprint(self) -> str:
        """Digest of what the number means: scene, measured quantity, law, unit and tolerance, and no code."""
        width = [self.tolerance.absolute, self.tolerance.relative]
        parts = json.dumps([self.id, self.scene, self.measures, self.law, self.unit, width])
        return hashlib.sha256(parts.encode()).hexdigest()[:12]


@dataclass(frozen=True, kw_only=True)
class CheckResult:
    """Result of one check on one backend.

    Attributes:
        check: Id of the check.
        backend: Name of the backend.
        status: Pass, fail, declined or error.
        title: As in the check.
        measures: As in the check.
        law: As in the check.
        source: As in the check.
        unit: As in the check.
        rationale: Reason for the width of the tolerance.
        expected: The value that the law gives; None when nothing was measured.
        measured: The measured value; None when nothing was measured. Infinity and NaN fail.
        width: Largest admissible difference; None when nothing was measured.
        diagnosis: Likely causes of a failure, or the text of the exception; empty otherwise.
        missing: Features that the backend lacks, when it declined.
        reported_by: Id of the check that reports the same fault first; empty for a fault of its own.
        wall_s: Time that the check took [s]; checks that share a rollout count it once.
        cpu_s: CPU time of the process of the check, all its threads, over the same span [s]. None if it is not known,
            as for a process that died.
        settings: Numerical settings in force in the last scene of the check.
        versions: Versions of the engine's packages.
    """

    check: str
    backend: str
    status: Status
    title: str
    measures: str
    law: str
    source: str
    unit: str
    rationale: str
    expected: float | None = None
    measured: float | None = None
    width: float | None = None
    diagnosis: str = ""
    missing: tuple[str, ...] = ()
    reported_by: str = ""
    wall_s: float = 0.0
    cpu_s: float | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)

    @property
    def is_bad(self) -> bool:
        """Whether it counts as a failure of the backend."""
        return self.status in (Status.FAIL, Status.ERROR)

    def to_dict(self) -> dict[str, Any]:
        """Return all attributes, JSON-ready; a number that is not finite becomes null."""
        values: dict[str, Any] = json_ready(asdict(self))
        return values | {"status": self.status.value}
