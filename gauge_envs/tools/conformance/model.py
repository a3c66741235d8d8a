"""A check, its tolerance, and its result on an engine."""

import hashlib
import inspect
import json
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, field
from enum import StrEnum
from typing import Any

from gauge_envs.files import json_ready
from gauge_envs.registry import package_versions
from gauge_envs.tools.conformance.lab import Lab, Measurement


class Level(StrEnum):
    """Group of checks that an engine passes as a whole, from simple to compound."""

    RIGID = "rigid"
    CONTACT = "contact"
    CLOTH = "cloth"
    FOAM = "foam"
    ROPE = "rope"


class Status(StrEnum):
    """Outcome of a check."""

    PASS = "pass"
    """The measured value is within the tolerance."""
    FAIL = "fail"
    """The measured value is outside the tolerance, or not finite."""
    ERROR = "error"
    """The engine raised an exception, its process died, or it exceeded a limit."""
    UNSUPPORTED = "unsupported"
    """The engine reports that it cannot build the scene. This is not a failure."""


@dataclass(frozen=True)
class Tolerance:
    """Largest difference between a measured and an expected value: `absolute + relative * |expected|`.

    Attributes:
        rationale: Reason for the width, from physics or from the benchmark, never from an engine.
        absolute: Part in the unit of the measured value.
        relative: Part as a share of the expected value.
    """

    rationale: str
    _: KW_ONLY
    absolute: float = 0.0
    relative: float = 0.0

    def width(self, expected: float) -> float:
        """Return the largest admissible difference from an expected value, in its unit."""
        return self.absolute + self.relative * abs(expected)


EXACT = Tolerance("the contract requires equality bit for bit")
COUNT = Tolerance("it is a count of faults")


@dataclass(frozen=True, kw_only=True)
class Check:
    """One law that an engine must obey, measured by one number.

    Attributes:
        id: Stable name.
        level: Level that the check belongs to.
        title: Subject, in a few words.
        description: The scene, the measured quantity, the method, and the source of the law.
        law: Formula of the expected value.
        unit: Unit of the measured value; "1" for a pure number.
        tolerance: Largest admissible difference.
        cause: Most likely cause of a failure, one sentence.
        is_optional: Whether a level does not need it.
        revision: Number that an author raises when the scene, the law or the measurement changes.
        measure: Function that builds the scene in a `Lab` and measures.
    """

    id: str
    level: Level
    title: str
    description: str
    law: str
    unit: str
    tolerance: Tolerance
    cause: str
    is_optional: bool
    revision: int
    measure: Callable[[Lab], Measurement]

    @property
    def fingerprint(self) -> str:
        """Digest of what decides the result: id, revision, unit and tolerance, without any text."""
        width = [self.tolerance.absolute, self.tolerance.relative]
        parts = [self.id, self.revision, self.unit, width]
        return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:12]


Measure = Callable[[Lab], Measurement]


class Checks:
    """Decorator that registers the checks of one module, in their order in the file.

    Args:
        level: Level of the checks.

    Attributes:
        registered: The checks.
    """

    def __init__(self, level: Level) -> None:
        self._level = level
        self.registered: list[Check] = []

    def __call__(
        self,
        id: str,
        *,
        title: str,
        law: str,
        tolerance: Tolerance,
        cause: str,
        unit: str = "1",
        optional: bool = False,
        revision: int = 1,
    ) -> Callable[[Measure], Measure]:
        """Return a decorator that registers a function of a lab as a check; see `Check` for the arguments.

        The docstring of the function is the description: the scene, the measured quantity with its method, the source.
        """

        def register(measure: Measure) -> Measure:
            entry = Check(
                id=id,
                level=self._level,
                title=title,
                description=" ".join((inspect.getdoc(measure) or "").split()),
                law=law,
                unit=unit,
                tolerance=tolerance,
                cause=cause,
                is_optional=optional,
                revision=revision,
                measure=measure,
            )
            self.registered.append(entry)
            return measure

        return register


@dataclass(frozen=True, kw_only=True)
class CheckResult:
    """Result of one check on one engine.

    Attributes:
        of: The check.
        backend: Name of the engine.
        configuration: Solver or preset of the engine; `default` for its own choice.
        status: Pass, fail, error or unsupported.
        expected: Value of the closed form; None when nothing was measured.
        measured: The measured value; None when nothing was measured. Infinity and NaN fail.
        width: Largest admissible difference; None when nothing was measured.
        diagnosis: Meaning of a failure and its most likely cause, the text of the exception, or the hint of a narrow
            pass; empty otherwise.
        missing: Features that the engine lacks, if the check is unsupported.
        is_unfinished: Whether the time limit ended the check, so that it shows nothing of the physics.
        rejects_settings: Whether the check is unsupported since the engine rejects the settings.
        settings: Effective numerical settings in the last scene of the check.
        versions: Versions of the engine's packages.
    """

    of: Check
    backend: str
    status: Status
    configuration: str = "default"
    expected: float | None = None
    measured: float | None = None
    width: float | None = None
    diagnosis: str = ""
    missing: tuple[str, ...] = ()
    is_unfinished: bool = False
    rejects_settings: bool = False
    settings: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)

    @property
    def check(self) -> str:
        """Id of the check."""
        return self.of.id

    @property
    def is_bad(self) -> bool:
        """Whether it counts as a failure of the engine."""
        return self.status in (Status.FAIL, Status.ERROR)

    @property
    def is_narrow(self) -> bool:
        """Whether it passes with more than nine tenths of the tolerance."""
        if self.status is not Status.PASS or not self.width:
            return False
        return abs((self.measured or 0.0) - (self.expected or 0.0)) > 0.9 * self.width

    def to_dict(self) -> dict[str, Any]:
        """Return the result and the texts of its check, JSON-ready; a number that is not finite becomes null."""
        texts = ("title", "description", "law", "unit")
        values = {
            "check": self.check,
            "fingerprint": self.of.fingerprint,
            "gauge_envs": package_versions()["gauge-envs"],
            **{text: getattr(self.of, text) for text in texts},
            "rationale": self.of.tolerance.rationale,
        }
        outcome = {key: value for key, value in vars(self).items() if key != "of"}
        ready: dict[str, Any] = json_ready(values | outcome)
        return ready
