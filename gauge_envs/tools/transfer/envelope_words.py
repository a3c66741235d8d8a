"""Tables and words about the envelope of a reward or a score."""

from __future__ import annotations

import dataclasses
from typing import Any

from gauge_envs.files import json_ready
from gauge_envs.pages.table import Column, Place, Table
from gauge_envs.pages.text import value_text
from gauge_envs.tools.transfer.envelope_statistics import EnvelopeReport, ParameterEffect


def envelope_verdict(report: EnvelopeReport) -> str:
    """Return the result in a few sentences."""
    unit = "" if report.unit == "1" else f" {report.unit}"
    endings = ", ".join(f"{number} {ending}" for ending, number in report.endings.items())
    sentences = [
        f"{report.quantity} {report.calibrated:.4g}{unit} at the calibrated values; over the measured uncertainty the "
        f"median is {report.median:.4g}, and 95 % of {report.samples} samples are from {report.low:.4g} to "
        f"{report.high:.4g}.",
        f"Episodes: {endings}; {100 * report.as_calibrated:.1f} % end as the calibrated one does.",
    ]
    if report.largest_ratio is not None:
        sentences.append(f"The largest ratio to the law's limit is {report.largest_ratio:.3f}.")
    return " ".join(sentences)


def envelope_table(report: EnvelopeReport) -> Table:
    """Return a table with one row for each parameter, the most important first."""
    return Table(
        columns=(
            Column("parameter.name", "parameter"),
            Column("", "calibrated", _calibrated, is_number=True),
            Column("parameter.std", "sigma", lambda value: f"{value:.3g}", is_number=True),
            Column("parameter.unit", "unit"),
            Column("rank_correlation", "rank correlation", lambda value: f"{value:+.2f}", is_number=True),
            Column("per_sigma", f"{report.quantity} per sigma", lambda value: f"{value:+.3g}", is_number=True),
            Column("parameter.source", "source of sigma", place=Place.BELOW),
        ),
        rows=list(report.effects),
    )


def _calibrated(effect: ParameterEffect) -> str:
    value = effect.parameter.value
    return "its start" if isinstance(value, tuple) else value_text(value)


def envelope_json(report: EnvelopeReport) -> dict[str, Any]:
    """Return the report, JSON-ready."""
    values: dict[str, Any] = json_ready(dataclasses.asdict(report))
    for effect in values["effects"]:
        # An infinite bound means none.
        effect["parameter"]["high"] = (
            None if effect["parameter"]["high"] == float("inf") else effect["parameter"]["high"]
        )
    return values | {"verdict": envelope_verdict(report)}
