"""The page of a matrix: every name is escaped, and nothing is loaded from outside."""

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

    def __init__(self):
        super().__init__()
        self.tags = []
        self.attributes = []
        self.texts = []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += attrs

    def handle_data(self, data):
        self.texts.append(data)


def parsed(*columns):
    page = Tags()
    page.feed(conformance_page(columns, [CHECK], command=f"gauge {EVIL}", when=WHEN))
    return page


def column(finding, **changes):
    findings = {} if finding is None else {finding.check: finding}
    return MatrixColumn(
        backend=EVIL, name=EVIL, settings={EVIL: EVIL}, findings=findings, **changes
    )


def test_hostile_names_stay_text():
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


def test_cells_state_outcome_value_and_error(approved):
    """One passes, others are off by 1, about zero and not finite, one did not run, and one is refused."""
    failed = replace(PASSED, status=Status.FAIL)
    mine = {"backend": "mine", "settings": {}}
    refused = MatrixColumn(
        **mine, name="PGS", findings={"other": PASSED}, refused={"slide": "no"}
    )
    page = parsed(
        column(PASSED),
        column(replace(failed, measured=3.0)),
        column(replace(failed, expected=0.0, measured=0.05)),
        column(replace(failed, measured=float("nan"))),
        MatrixColumn(**mine, name="default", reason="its licence ended"),
        refused,
    )
    assert ("title", "no") in page.attributes
    texts = [text.strip() for text in page.texts if "{" not in text]
    # What follows states versions.
    shown = filter(None, texts[: texts.index("Provenance")])
    approved("conformance/page", "\n".join(shown))
