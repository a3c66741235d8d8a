"""Tables and words about the envelope of a reward or a score."""

from __future__ import annotations

import dataclasses

from gauge_envs.pages.document import Document, Paragraph
from gauge_envs.pages.table import Column, Place, Table
from gauge_envs.pages.text import value_text, with_unit
from gauge_envs.tools.transfer.envelope_statistics import EnvelopeReport, ParameterEffect


def envelope_verdict(report: EnvelopeReport) -> str:
    """Return the result in a few sentences."""
    endings = ", ".join(f"{number} {ending}" for ending, number in report.endings.items())
    sentences = [
        f"{report.quantity} {with_unit(f'{report.calibrated:.4g}', report.unit)} at the calibrated values; over the "
        f"measured uncertainty the median is {report.median:.4g}, and 95 % of {report.samples} samples are from "
        f"{report.low:.4g} to {report.high:.4g}.",
        f"Episodes: {endings}; {100 * report.as_calibrated:.1f} % end as the calibrated one does.",
    ]
    if report.largest_ratio is not None:
        sentences.append(f"The largest ratio to the law's limit is {report.largest_ratio:.3f}.")
    return " ".join(sentences)


def envelope_document(report: EnvelopeReport) -> Document:
    """Return one row for each parameter, the most important first, and the result; the JSON row is the report."""
    verdict = envelope_verdict(report)
    table = Table(
        columns=(
            Column("parameter.name", "parameter"),
            Column("", "calibrated", _calibrated, is_number=True),
            Column("parameter.std", "sigma", lambda value: f"{value:.3g}", is_number=True),
            Column("parameter.unit", "unit"),
            Column("rank_correlation", "rank correlation", lambda value: f"{value:+.2f}", is_number=True),
            Column("per_sigma", f"{report.quantity} per sigma", lambda value: f"{value:+.3g}", is_number=True),
            Column("parameter.source", "source of sigma", place=Place.BELOW),
        ),
        rows=report.effects,
    )
    # An infinite bound, which means none, becomes null.
    rows = [dataclasses.asdict(report) | {"verdict": verdict}]
    return Document(parts=(table, Paragraph(""), Paragraph(verdict)), rows=rows)


def _calibrated(effect: ParameterEffect) -> str:
    value = effect.parameter.value
    return "its start" if isinstance(value, tuple) else value_text(value)
