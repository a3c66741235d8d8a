"""Define a check, its tolerance, and its result on a backend; find checks by id."""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, fields, replace
from enum import StrEnum
from fnmatch import fnmatchcase
from functools import cache, wraps
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Literal, TypeVar

from gauge_envs.errors import ParameterError, UnknownNameError
from gauge_envs.files import json_ready, versions

if TYPE_CHECKING:
    from gauge_envs.scene import Scene
    from gauge_envs.tools.bench.recording import Recording
    from gauge_envs.tools.conformance.lab import Lab

T = TypeVar("T")

FAMILIES = (
    "contract",
    "rigid",
    "start",
    "forces",
    "contacts",
    "shapes",
    "driven",
    "grasp",
    "rich",
    "collisions",
    "copies",
    "cloth",
    "air",
    "soft",
    "touch",
    "worlds",
    "solver",
)
"""Modules of the checks, in the order of the table. They are imported at the first use of a check."""


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


@dataclass(frozen=True)
class Tolerance:
    """Largest difference between a measured and an expected value: `absolute + relative * |expected|`.

    It is the same for every engine.

    Attributes:
        rationale: Reason for the width, from physics or from the benchmark, never from an engine.
        absolute: Part in the unit of the measured value.
        relative: Part as a share of the expected value.
        again: What the check runs again: `simulation` after a reset, or `scene`, built anew. Runs may then
            part as `Backend.repeatability` declares. Empty where nothing runs again.
    """

    rationale: str
    _: KW_ONLY
    absolute: float = 0.0
    relative: float = 0.0
    again: Literal["", "simulation", "scene"] = ""

    def width(self, expected: float) -> float:
        """Return the largest admissible distance from an expected value, in its unit."""
        return self.absolute + self.relative * abs(expected)


EXACT = Tolerance("the contract requires equality bit for bit")
_DECLARED = "bit for bit, or as the engine declares in Backend.repeatability"
REPEATED = Tolerance(_DECLARED, again="simulation")
REBUILT = Tolerance(_DECLARED, again="scene")
COUNT = Tolerance("it is a count")


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """Measured and expected value of a check.

    Attributes:
        measured: The measured value.
        expected: The value that the law gives, in the same unit.
        hint: Likely cause of this particular value, for the diagnosis; may be empty.
        cause: What alone explains the record. It takes the place of the likely causes of the check; empty if unknown.
        parts: Differences whose largest is measured, by name, such as "velocity of the brick". Where an engine does
            not repeat bits, each is judged by its own scatter: that of velocities in impacts is large.
    """

    measured: float
    expected: float = 0.0
    hint: str = ""
    cause: str = ""
    parts: Mapping[str, float] | None = None


def _unknown(_: Lab) -> Measurement:
    """Stand for the measurement of a check that this version does not have."""
    raise NotImplementedError


@dataclass(frozen=True)
class Check:
    """One law that a backend must obey, measured by one number. It decorates the function that measures it.

    The texts and tolerances of this package's checks are in `checks.toml`, by id, where several do not share them.

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
    _: KW_ONLY
    title: str = ""
    scene: str = ""
    measures: str = ""
    law: str = ""
    source: str = ""
    unit: str = "1"
    tolerance: Tolerance = COUNT
    diagnosis: str = ""
    measure: Callable[[Lab], Measurement] = _unknown

    def __call__(
        self, measure: Callable[[Lab], Measurement]
    ) -> Callable[[Lab], Measurement]:
        """Register the check with the function that measures it.

        Raises:
            ParameterError: A check with this id exists already.
        """
        if self.id in _CHECKS:
            raise ParameterError(f"check {self.id!r} exists already; choose another id")
        _CHECKS[self.id] = replace(
            self, measure=measure, **texts_of_checks().get(self.id, {})
        )
        return measure

    @property
    def fingerprint(self) -> str:
        """Digest of what the number means: scene, measured quantity, law, unit and tolerance, and no code."""
        width = [self.tolerance.absolute, self.tolerance.relative]
        parts = json.dumps(
            [self.id, self.scene, self.measures, self.law, self.unit, width]
        )
        return hashlib.sha256(parts.encode()).hexdigest()[:12]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What one run of a check gave.

    Attributes:
        status: Pass, fail, declined or error.
        expected: The value that the law gives; None when nothing was measured.
        measured: The measured value; None when nothing was measured. Infinity and NaN fail.
        width: Largest admissible difference; None when nothing was measured.
        diagnosis: Likely causes of a failure, or the text of the exception; empty otherwise.
        missing: Features that the backend lacks, when it declined.
        reported_by: Id of the check that reports the same fault first; empty for a fault of its own.
        wall_s: Time that the check took [s]; checks that share a rollout count it once.
        cpu_s: CPU time of the process of the check, all its threads, over the same span [s]. None if it is not known,
            as for a process that died.
    """

    status: Status
    expected: float | None = None
    measured: float | None = None
    width: float | None = None
    diagnosis: str = ""
    missing: tuple[str, ...] = ()
    reported_by: str = ""
    wall_s: float = 0.0
    cpu_s: float | None = None


@dataclass(frozen=True, kw_only=True)
class CheckResult(Outcome):
    """Result of one check on one backend.

    Attributes:
        of: The check.
        backend: Name of the backend.
        settings: Numerical settings in force in the last scene of the check.
        versions: Versions of the engine's packages.
    """

    of: Check
    backend: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)

    @property
    def check(self) -> str:
        """Id of the check."""
        return self.of.id

    @property
    def is_bad(self) -> bool:
        """Whether it counts as a failure of the backend."""
        return self.status in (Status.FAIL, Status.ERROR)

    def to_dict(self) -> dict[str, Any]:
        """Return the result and the texts of its check, JSON-ready; a number that is not finite becomes null."""
        values = {
            "check": self.check,
            "fingerprint": self.of.fingerprint,
            "gauge_envs": versions()["gauge-envs"],
            "backend": self.backend,
            "status": self.status.value,
        }
        values |= {
            text: getattr(self.of, text)
            for text in ("title", "measures", "law", "source", "unit")
        }
        values["rationale"] = self.of.tolerance.rationale
        outcome = {
            one.name: getattr(self, one.name)
            for one in fields(Outcome)
            if one.name != "status"
        }
        ready: dict[str, Any] = json_ready(
            values | outcome | {"settings": self.settings, "versions": self.versions}
        )
        return ready


@cache
def texts_of_checks() -> dict[str, Any]:
    """Return texts and tolerances of the checks of this package by id.

    `canonical` has one id for each phenomenon, `elementary` those that are tried after a failure, and
    `left` which cause is left where some checks fail and others pass. A check is `like`
    another one: what it does not state itself is that of the other.
    """
    texts = tomllib.loads(
        (Path(__file__).parent / "checks.toml").read_text(encoding="utf-8")
    )
    found: dict[str, Any] = {
        name: texts.pop(name) for name in ("canonical", "elementary", "left")
    }
    for id, one in texts.items():
        # One that is `like` another one may be a model, too.
        stated = {**texts[one.pop("like")], **one} if "like" in one else dict(one)
        texts[id] = dict(stated)
        if "tolerance" in stated:
            stated["tolerance"] = Tolerance(**stated["tolerance"])
        found[id] = stated
    return found


check = Check
"""The same, under a name that reads as a decorator."""

_CHECKS: dict[str, Check] = {}


@dataclass(frozen=True)
class Recorded(Generic[T]):
    """What several checks measure: a scene that a lab builds and records once for all of them.

    Attributes:
        scene: The scene in words, as in `Check.scene`.
        record: Function that builds the scene in a lab and returns what it records.
    """

    scene: str
    record: Callable[[Lab], T]

    def __call__(self, lab: Lab) -> T:
        """Return the record of a lab."""
        return lab.once(self.record)

    def check(
        self, id: str, **texts: Any
    ) -> Callable[[Callable[[T], Measurement]], Callable[[T], Measurement]]:
        """Return a decorator that registers a measurement of the record as a check; see `Check` for the texts."""

        def register(measure: Callable[[T], Measurement]) -> Callable[[T], Measurement]:
            Check(id, scene=self.scene, **texts)(
                wraps(measure)(lambda lab: measure(self(lab)))
            )
            return measure

        return register


def recorded(scene: str) -> Callable[[Callable[[Lab], T]], Recorded[T]]:
    """Return a decorator that makes a function of a lab the record of a scene, which is stated in words."""
    return lambda record: Recorded(scene, record)


def rollout_of(scene: str, built: Scene) -> Recorded[Recording]:
    """Return the rollout of a scene, which is stated in words too, over its duration."""
    return Recorded(scene, lambda lab: lab.rollout(built))


def checks(only: Sequence[str] = ()) -> tuple[Check, ...]:
    """Return all checks in a fixed order, or those whose id matches one of the patterns.

    Raises:
        UnknownNameError: A pattern matches no check.
    """
    places = {
        f"gauge_envs.tools.conformance.{family}": place
        for place, family in enumerate(FAMILIES)
    }
    is_imported = bool(only) and {*only} <= {*_CHECKS}
    if not is_imported:
        for module in places:
            import_module(module)
    # A module may have been imported before another one that precedes it in the table.
    known = sorted(
        _CHECKS.values(),
        key=lambda one: places.get(one.measure.__module__, len(places)),
    )
    for pattern in only:
        if not any(fnmatchcase(name, pattern) for name in _CHECKS):
            raise UnknownNameError("check", pattern, [one.id for one in known])
    return tuple(
        one
        for one in known
        if not only or any(fnmatchcase(one.id, pattern) for pattern in only)
    )
