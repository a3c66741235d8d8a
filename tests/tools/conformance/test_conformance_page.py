"""The page of a matrix: every name is escaped, and nothing is loaded from outside."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from html.parser import HTMLParser

from gauge_envs.tools.conformance import (
    Check,
    CheckResult,
    Measurement,
    Status,
    Tolerance,
)
from gauge_envs.tools.conformance.matrix import MatrixColumn
from gauge_envs.tools.conformance.words import conformance_page

EVIL = "<script>alert('x')</script>\"&"
WHEN = datetime(2026, 1, 2, 3, 4, tzinfo=UTC)

CHECK = Check(
    id="slide",
    title=EVIL,
    scene=EVIL,
    measures=EVIL,
    law=EVIL,
    source=EVIL,
    unit="m/s^2",
    tolerance=Tolerance(relative=0.01, rationale=EVIL),
    diagnosis=EVIL,
    measure=lambda lab: Measurement(measured=0.0, expected=0.0),
)
PASSED = CheckResult(
    of=CHECK,
    backend=EVIL,
    status=Status.PASS,
    expected=2.0,
    measured=2.01,
    width=0.02,
    versions={EVIL: EVIL},
)


class Tags(HTMLParser):
    """Names of all tags, attributes and texts of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str | None]] = []
        self.texts: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += attrs

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


def parsed(*columns: MatrixColumn) -> Tags:
    page = Tags()
    page.feed(conformance_page(columns, [CHECK], command=f"gauge {EVIL}", when=WHEN))
    return page


def column(finding: CheckResult | None, **changes: object) -> MatrixColumn:
    findings = {} if finding is None else {finding.check: finding}
    return MatrixColumn(
        backend=EVIL, name=EVIL, settings={EVIL: EVIL}, findings=findings, **changes
    )


def test_hostile_names_stay_text() -> None:
    failed = replace(PASSED, status=Status.FAIL, diagnosis=EVIL)
    declined = replace(PASSED, status=Status.DECLINED, measured=None, missing=(EVIL,))
    page = parsed(
        column(PASSED),
        column(failed),
        column(declined),
        column(None, reason=EVIL),
        column(None),
    )
    assert "script" not in page.tags
    assert not [
        name for name, _ in page.attributes if name in ("src", "onclick", "onerror")
    ]
    assert all(
        value is not None and value.startswith("#")
        for name, value in page.attributes
        if name == "href"
    )
    assert EVIL in "".join(page.texts)


def test_cells_state_outcome_value_and_relative_error() -> None:
    page = parsed(
        column(PASSED), column(replace(PASSED, status=Status.FAIL, measured=3.0))
    )
    text = " ".join(page.texts)
    assert "2 +- 0.02 m/s^2" in text
    assert "+0.5 %" in text
    assert "+50 %" in text
    assert "FAIL" in text


def test_an_error_about_zero_is_in_tolerances() -> None:
    assert (
        "2.5 tol."
        in parsed(
            column(replace(PASSED, status=Status.FAIL, expected=0.0, measured=0.05))
        ).texts
    )
    assert (
        "not finite"
        in parsed(
            column(replace(PASSED, status=Status.FAIL, measured=float("nan")))
        ).texts
    )


def test_a_column_that_did_not_run_is_listed_with_its_reason() -> None:
    page = parsed(
        MatrixColumn(
            backend="mine", name="default", settings={}, reason="its licence ended"
        )
    )
    assert "mine: its licence ended" in page.texts


def test_a_refused_scene_is_shown_beside_the_others() -> None:
    found = MatrixColumn(
        backend="mine",
        name="PGS",
        settings={},
        findings={"other": PASSED},
        refused={"slide": "no"},
    )
    page = parsed(found)
    assert ("title", "no") in page.attributes
    assert "refused" in " ".join(page.texts)
