"""JSON lines of `gauge backend check`, `gauge list backends` and `gauge list checks`."""

from collections.abc import Mapping
from typing import Annotated, TypedDict

from gauge_envs.cli.schemas import Form
from gauge_envs.tools.conformance.model import CheckResult


class BackendLine(TypedDict):
    """An installed engine.

    Attributes:
        name: Its name.
        versions: Versions of its packages; empty if it cannot be used.
        error: Why it cannot be used.
    """

    name: str
    versions: Mapping[str, str]
    error: str | None


class CheckTexts(TypedDict):
    """Texts of a check.

    Attributes:
        title: Subject of the check.
        description: The scene, the measured quantity, the method, and the source of the law.
        law: Formula of the expected value.
        unit: Unit of the measured value; 1 for a pure number.
    """

    title: str
    description: str
    law: str
    unit: str


class CheckLine(CheckTexts):
    """A check.

    Attributes:
        id: Its name.
    """

    id: str


class ResultTexts(CheckTexts):
    """Texts of the check of a result.

    Attributes:
        rationale: Reason for the width.
        fingerprint: Digest of the revision, unit and tolerance of the check.
        gauge_envs: Version of gauge-envs.
    """

    rationale: str
    fingerprint: str
    gauge_envs: str


CheckResultLine = Annotated[
    CheckResult, Form(without=("of",), properties=("check",), more=ResultTexts)
]
"""Result of one check on one engine."""
