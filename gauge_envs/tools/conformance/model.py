"""A check, its tolerance, and its result on an engine."""

from __future__ import annotations

import hashlib
import inspect
import json
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from enum import StrEnum
from fnmatch import fnmatchcase
from importlib import import_module
from typing import Any

from gauge_envs.errors import ParameterError, UnknownNameError
from gauge_envs.files import json_ready
from gauge_envs.registry import package_versions
from gauge_envs.tools.conformance.lab import Lab, Measurement

PHENOMENA = {
    "contract": "rigid",
    "free_motion": "rigid",
    "forces": "rigid",
    "hinge": "rigid",
    "restart": "rigid",
    "batches": "rigid",
    "slide": "contact",
    "drive": "contact",
    "rest": "contact",
    "impact": "contact",
    "cloth": "cloth",
    "foam": "foam",
    "rope": "rope",
}
"""Modules of the checks, from simple to compound, and the level of each."""

LEVELS = tuple(dict.fromkeys(PHENOMENA.values()))


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

    @classmethod
    def _missing_(cls, value: object) -> Status | None:
        # Files of gauge-envs before 1.0; accepted until 1.2.
        return cls.UNSUPPORTED if value == "declined" else None


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
        title: Subject, in a few words.
        scene: The scene that is built.
        measures: The measured quantity and the method.
        law: Formula of the expected value.
        source: Origin of the law.
        unit: Unit of the measured value; "1" for a pure number.
        tolerance: Largest admissible difference.
        cause: Most likely cause of a failure, one sentence.
        phenomenon: Key of `PHENOMENA`.
        is_optional: Whether a level does not need it.
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
    cause: str
    phenomenon: str
    is_optional: bool
    measure: Callable[[Lab], Measurement]

    @property
    def level(self) -> str:
        """Level that the check belongs to."""
        return PHENOMENA.get(self.phenomenon, self.phenomenon)

    @property
    def fingerprint(self) -> str:
        """Digest of the meaning of the number: scene, measured quantity, law, unit and tolerance, without code."""
        width = [self.tolerance.absolute, self.tolerance.relative]
        parts = [self.id, self.scene, self.measures, self.law, self.unit, width]
        return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:12]


_CHECKS: dict[str, Check] = {}


def check(
    id: str,
    *,
    title: str,
    law: str,
    source: str,
    tolerance: Tolerance,
    cause: str,
    unit: str = "1",
    optional: bool = False,
) -> Callable[[Callable[[Lab], Measurement]], Callable[[Lab], Measurement]]:
    """Return a decorator that registers a function of a lab as a check; see `Check` for the arguments.

    The last paragraph of the docstring of the function is the measured quantity with its method, the rest the scene.

    Raises:
        ParameterError: A check with this id exists already.
    """

    def register(
        measure: Callable[[Lab], Measurement],
    ) -> Callable[[Lab], Measurement]:
        if id in _CHECKS:
            raise ParameterError(f"check {id!r} exists already; choose another id")
        text = textwrap.dedent(inspect.getdoc(measure) or "")
        scene, _, measures = text.rpartition("\n\n")
        _CHECKS[id] = Check(
            id=id,
            title=title,
            scene=" ".join(scene.split()),
            measures=" ".join(measures.split()),
            law=law,
            source=source,
            unit=unit,
            tolerance=tolerance,
            cause=cause,
            phenomenon=measure.__module__.rpartition(".")[2],
            is_optional=optional,
            measure=measure,
        )
        return measure

    return register


def checks(only: Sequence[str] = ()) -> tuple[Check, ...]:
    """Return all checks from simple to compound, or those whose id matches one of the patterns.

    Raises:
        UnknownNameError: A pattern matches no check.
    """
    for phenomenon in PHENOMENA:
        import_module(f"gauge_envs.tools.conformance.{phenomenon}")
    order = [*PHENOMENA]
    # Modules may have been imported in another order.
    known = sorted(
        _CHECKS.values(),
        key=lambda check: (
            order.index(check.phenomenon)
            if check.phenomenon in PHENOMENA
            else len(order)
        ),
    )
    for pattern in only:
        if not any(fnmatchcase(name, pattern) for name in _CHECKS):
            raise UnknownNameError("check", pattern, [check.id for check in known])
    return tuple(
        check
        for check in known
        if not only or any(fnmatchcase(check.id, pattern) for pattern in only)
    )


@dataclass(frozen=True, kw_only=True)
class CheckResult:
    """Result of one check on one engine.

    Attributes:
        of: The check.
        backend: Name of the engine.
        status: Pass, fail, error or unsupported.
        expected: Value of the closed form; None when nothing was measured.
        measured: The measured value; None when nothing was measured. Infinity and NaN fail.
        width: Largest admissible difference; None when nothing was measured.
        diagnosis: Meaning of a failure and its most likely cause, or the text of the exception; empty otherwise.
        missing: Features that the engine lacks, if the check is unsupported.
        wall_s: Time that the check took [s]; checks that share a recording count it once.
        cpu_s: CPU time over the same span [s]; None if it is not known, as for a process that died.
        settings: Effective numerical settings in the last scene of the check.
        versions: Versions of the engine's packages.
    """

    of: Check
    backend: str
    status: Status
    expected: float | None = None
    measured: float | None = None
    width: float | None = None
    diagnosis: str = ""
    missing: tuple[str, ...] = ()
    wall_s: float = 0.0
    cpu_s: float | None = None
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

    def to_dict(self) -> dict[str, Any]:
        """Return the result and the texts of its check, JSON-ready; a number that is not finite becomes null."""
        texts = ("title", "measures", "law", "source", "unit")
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
