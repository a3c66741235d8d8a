"""What policies keep of the reward that their training promised, and envelopes of a reward or a score, in words."""

from __future__ import annotations

import dataclasses
from typing import Any

from gauge_envs.pages.document import Document, Paragraph
from gauge_envs.pages.table import Column, Place, Table
from gauge_envs.pages.text import counted, value_text, with_unit
from gauge_envs.tools.transfer.envelope_statistics import EnvelopeReport, ParameterEffect
from gauge_envs.tools.transfer.transfer import FALL_SHARE, Estimate, TransferReport, WorldTransfer


def transfer_verdict(report: TransferReport) -> str:
    """Return the result in a few sentences."""
    sentences = [f"Keeps {_percent(report.kept)} of the promised reward"]
    fall = report.first_fall
    if fall is None:
        sentences[0] += f"; falls below {100 * FALL_SHARE:.0f} % of it in none of {len(report.others)} worlds."
    else:
        number = sum(row.falls for row in report.others)
        sentences[0] += f"; first falls with {fall.world.name}, where it keeps {_percent(fall.kept)}."
        sentences.append(f"It falls in {number} of {len(report.others)} worlds.")
    trained = report.training
    sentences.append(f"In training it reached {trained.ratio:.2f} of what the law allows.")
    above = max((trained, *report.others), key=lambda row: row.largest_ratio)
    if above.largest_ratio > 1.0:
        sentences.append(
            f"The largest ratio is {above.largest_ratio:.3f}, in {above.world.name}: above 1 the engine pays more than "
            "the law, or the task's stated tolerance is used."
        )
    sentences.append(_interval_note(report))
    if report.left_out:
        sentences.append(f"Worlds left out: {len(report.left_out)}.")
    return " ".join(sentences)


def _interval_note(report: TransferReport) -> str:
    policies, starts = len(report.policies), report.starts
    if policies * starts == 1:
        return "One policy from one start has no interval."
    if policies == 1:
        return f"The interval is over {starts} starts of one policy; other training seeds can differ by more."
    return f"The interval is over {policies} policies and {counted(starts, 'start')}."


def _percent(value: Estimate) -> str:
    text = f"{100 * value.value:.0f} %"
    if value.low is None or value.high is None:
        return text
    return f"{text} [{100 * value.low:.0f}, {100 * value.high:.0f}]"


def transfer_document(report: TransferReport) -> Document:
    """Return one row for each world, the training first, and the result; the last JSON row is of the whole."""
    worlds, verdict = [report.training, *report.others], transfer_verdict(report)
    table = Table(
        columns=(
            Column("world.name", "world"),
            Column("reward.value", "reward", lambda value: f"{value:.2f}", is_number=True),
            Column("kept", "kept", _percent, is_number=True),
            Column("allowed", "law allows", lambda value: f"{value:.3f}", is_number=True),
            Column("ratio", "of the law", lambda value: f"{value:.3f}", is_number=True),
            Column("z", "z", lambda value: f"{value:+.1f}", is_number=True, wide_only=True),
            Column("endings", "episodes", lambda value: ", ".join(f"{n} {e}" for e, n in value.items())),
            Column("falls", "", lambda value: "falls" if value else "", style=lambda value: "red" if value else ""),
            Column("world.source", "source of sigma", place=Place.BELOW, wide_only=True),
        ),
        rows=worlds,
    )
    whole = {
        "kind": "verdict",
        "task": report.task,
        "policies": report.policies,
        "starts": report.starts,
        "kept": dataclasses.asdict(report.kept),
        "first_fall": None if report.first_fall is None else report.first_fall.world.name,
        "left_out": report.left_out,
        "verdict": verdict,
    }
    parts = (table, Paragraph(""), Paragraph(verdict))
    return Document(parts=parts, rows=[*map(_world_row, worlds), whole])


def _world_row(row: WorldTransfer) -> dict[str, Any]:
    values = dataclasses.asdict(row)
    world = values.pop("world")
    return {"kind": world.pop("kind"), "world": world.pop("name"), **world, **values}


# --- envelopes ---


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
