"""Error budgets as tables, sentences and a figure."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from gauge_envs.errors import ShapeError
from gauge_envs.evaluation.motion_kinds import Change
from gauge_envs.pages.document import Document, Paragraph, Part, Tone
from gauge_envs.pages.figures import ENGINES, OURS, new_figure, tidy_axis
from gauge_envs.pages.results import result_label
from gauge_envs.pages.table import Column, Place, Table
from gauge_envs.pages.text import (
    GRADE_NOTES,
    quantity_text,
    score_text,
    short_id,
    with_unit,
)
from gauge_envs.references.grades import BandGrade
from gauge_envs.references.published import PUBLISHED_ENGINES
from gauge_envs.runs.result import Result
from gauge_envs.tools.diagnose.model import (
    MARKERS,
    SEVERAL_BODIES,
    BudgetStage,
    Diagnosis,
    StagePart,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_AXES = 6

LEGEND = (
    "Parts are added from the top down, each fitted together with those above it: what they take off the squared error "
    "(share) and off the RMSE adds up to the whole. Alone: share taken off as the only change; last: after both others."
)


def diagnosis_document(pairs: Sequence[tuple[Result, Diagnosis]]) -> Document:
    """Return error budgets: tables and findings of each result, then the meaning of the columns.

    A row states how a result was run, and its error budget with the findings.
    """
    keys = ("backend", "parameters", "settings_given", "seed", "jitter")
    rows = [
        {key: getattr(result, key) for key in keys}
        | {"label": result_label(result)}
        | asdict(diagnosis)
        | {"findings": findings(diagnosis)}
        for result, diagnosis in pairs
    ]
    parts: list[Part] = []
    for result, diagnosis in pairs:
        parts += [
            _budget_table(diagnosis, result_label(result)),
            *_axis_tables(diagnosis),
        ]
        parts += [Paragraph(f"- {line}") for line in findings(diagnosis)]
        parts += [Paragraph(line, Tone.NOTE) for line in _budget_notes(diagnosis)]
    if pairs:
        published = f"Published engines: {pairs[0][1].published_note}"
        parts += [
            Paragraph(""),
            Paragraph(LEGEND, Tone.NOTE),
            Paragraph(published, Tone.NOTE),
        ]
    return Document(parts=parts, rows=rows)


def _budget_table(diagnosis: Diagnosis, label: str) -> Table:
    rest = diagnosis.rest
    rows: list[dict[str, Any]] = [
        {"part": "as it is", "rmse_after": diagnosis.rmse},
        *map(_part_row, diagnosis.parts),
    ]
    rows.append({"part": "rest", "off": rest.rmse, "share": rest.share})
    return Table(
        title=f"{short_id(diagnosis.id)}  {label}",
        columns=(
            Column("part", "part"),
            Column(
                "rmse_after",
                "RMSE left",
                quantity_text,
                unit=diagnosis.unit,
                is_number=True,
            ),
            Column(
                "off", "taken off", quantity_text, unit=diagnosis.unit, is_number=True
            ),
            Column("share", "share", _share, is_number=True),
            Column("alone_share", "alone", _share, is_number=True),
            Column("last_share", "last", _share, is_number=True),
            Column("changes", "fitted together", place=Place.BELOW),
        ),
        rows=rows,
    )


def _part_row(part: StagePart) -> dict[str, Any]:
    row: dict[str, Any] = {"part": part.stage.value, "rmse_after": part.rmse_after}
    if part.missing is not None:
        return row | {"changes": "does not apply"}
    row |= {
        "off": part.rmse_before - part.rmse_after,
        "changes": f"fitted: {_changes(part)}",
    }
    return row | {
        key: getattr(part, key) for key in ("share", "alone_share", "last_share")
    }


def _axis_tables(diagnosis: Diagnosis) -> list[Table]:
    """Return the shares of the squared error by axis; no table for one coordinate or for many axes."""
    axes = diagnosis.axes()
    if (
        len(diagnosis.coordinates) == 1
        or len(axes) > MOST_AXES
        or diagnosis.mean_square == 0.0
    ):
        return []
    squares = {"all": diagnosis.by_coordinate}
    squares |= {
        part.stage.value: part.by_coordinate
        for part in diagnosis.parts
        if part.missing is None
    }
    squares["rest"] = diagnosis.rest.by_coordinate
    rows = [
        {"axis": axis}
        | {
            key: sum(values[index] for index in indices) / diagnosis.mean_square
            for key, values in squares.items()
        }
        for axis, indices in axes.items()
    ]
    shares = (Column(key, key, _share, is_number=True) for key in squares)
    return [Table(columns=(Column("axis", "share along"), *shares), rows=rows)]


def _changes(part: StagePart) -> str:
    """Return all changes in force after a part; offsets of many coordinates by their root mean square."""
    texts = []
    offsets = [change for change in part.changes if change.quantity == "offset"]
    for change in part.changes:
        mark = " (limit)" if change.at_bound else ""
        if change.quantity == "release_time":
            texts.append(with_unit(f"release {change.fitted:+.3f}", change.unit) + mark)
        elif change.quantity != "offset":
            values = f"{change.quantity} {change.simulated:.4g} -> {change.fitted:.4g}"
            texts.append(with_unit(values, change.unit) + mark)
        elif len(offsets) <= MOST_OFFSETS:
            texts.append(
                with_unit(f"{change.coordinate} {change.fitted:+.3g}", change.unit)
            )
        elif change is offsets[0]:
            texts.append(
                with_unit(
                    f"{len(offsets)} offsets, rms {quantity_text(_rms(offsets))}",
                    change.unit,
                )
            )
    return ", ".join(texts)


def _share(share: float) -> str:
    return f"{100.0 * share + 0.0:.1f} %"


def _rms(changes: Sequence[Change]) -> float:
    return math.sqrt(sum(change.fitted**2 for change in changes) / len(changes))


def _budget_notes(diagnosis: Diagnosis) -> Iterator[str]:
    grade = BandGrade(diagnosis.grade)
    yield f"Grade {grade.value}: {GRADE_NOTES[grade]}. Motion: {diagnosis.kind.value.replace('_', ' ')}."
    if diagnosis.extrapolated_frames:
        yield (
            f"{diagnosis.extrapolated_frames} of {diagnosis.frames} frames are extrapolated, not measured; "
            f"{_share(diagnosis.extrapolated_share)} of the squared error lies in them."
        )
    yield from (f"Note: {note}." for note in diagnosis.notes)
    engines = []
    for name, one in diagnosis.published.items():
        values = {
            "RMSE": one.rmse_normalized,
            "DTW/RMSE": one.dtw_over_rmse,
            "period over the real one": one.period_ratio,
        }
        texts = [
            f"{title} {value:.2f}"
            for title, value in values.items()
            if value is not None
        ]
        engines += [f"{PUBLISHED_ENGINES[name]} {', '.join(texts)}"] if texts else []
    if engines:
        here = (
            ""
            if diagnosis.dtw_over_rmse is None
            else f" (here DTW/RMSE {diagnosis.dtw_over_rmse:.2f})"
        )
        yield f"Published{here}: {'; '.join(engines)}."


NOTABLE_SHARE = 0.01
"""Share of the squared error by which another first part must be better to be reported."""

MOST_OFFSETS = 3

RATE_TEXTS = {
    "acceleration": "the acceleration is {fitted:.3f} instead of {simulated:.3f} m/s^2",
    "restitution": "the restitution is {fitted:.3f} instead of {simulated:.3f}",
    "period": "the period is {fitted:.3f} instead of {simulated:.3f} s",
    "amplitude": "the amplitude is {fitted:.3f} times as large",
    "speed": "the motion is {fitted:.3f} times as fast",
    "displacement": "it goes {fitted:.3f} times as far",
}


def _finding(diagnosis: Diagnosis, part: StagePart) -> str:
    """Return one stage in words."""
    if part.missing is not None:
        return f"{part.stage.value.capitalize()} does not apply: {part.missing}."
    first = all(
        other is part or other.missing
        for other in diagnosis.parts[: diagnosis.parts.index(part) + 1]
    )
    # Those of the stage itself, among all that are in force after it.
    quantities = {change.quantity for change in part.alone_changes}
    of_stage = [change for change in part.changes if change.quantity in quantities]
    rmses = _rmse_text(diagnosis, part.rmse_before, part.rmse_after)
    bound = (
        " (the limit of what was tried: it may be more)"
        if any(change.at_bound for change in of_stage)
        else ""
    )
    also = "" if first else " as well"
    return (
        f"{_percent(part.share)} of the squared error is gone ({rmses}) if "
        f"{_change_text(diagnosis, part.stage, of_stage)}{also}{bound}."
    )


def _change_text(
    diagnosis: Diagnosis, stage: BudgetStage, changes: Sequence[Change]
) -> str:
    subject = diagnosis.subject
    verb = "are" if subject in (SEVERAL_BODIES, MARKERS) else "is"
    if stage is BudgetStage.RELEASE:
        late_s = changes[0].fitted
        when = f"{abs(late_s):.3f} s {'earlier' if late_s < 0.0 else 'later'}"
        if diagnosis.driven or subject == MARKERS:
            return f"the simulation starts {when}"
        return f"{subject} {verb} let go {when}"
    if stage is BudgetStage.OFFSET:
        largest = max(changes, key=lambda change: abs(change.fitted))
        if len(changes) > MOST_OFFSETS:
            return (
                f"each of {len(changes)} coordinates has a constant added, {_rms(changes):.3g} {diagnosis.unit} root "
                f"mean square ({largest.fitted:+.3g} at most, {largest.coordinate})"
            )
        offsets = ", ".join(
            f"{change.fitted:+.3g} {diagnosis.unit} along {change.coordinate}"
            for change in changes
        )
        return f"{subject} {verb} moved by {offsets}"
    return " and ".join(
        RATE_TEXTS[change.quantity].format(**asdict(change)) for change in changes
    )


def _percent(share: float) -> str:
    percent = 100.0 * share
    if 0.0 < percent < 0.01:
        return "<0.01 %"
    if 99.5 <= percent < 99.995:
        # Nearly all is not all.
        return f"{percent:.2f} %"
    return f"{percent:.2g} %" if 0.0 < percent < 9.95 else f"{percent:.0f} %"


def _rmse_text(diagnosis: Diagnosis, *rmses: float) -> str:
    """Return one RMSE, or its change from one to another, with the unit."""
    return f"RMSE {' to '.join(f'{rmse:.3g}' for rmse in rmses)} {diagnosis.unit}"


def findings(diagnosis: Diagnosis) -> tuple[str, ...]:
    """Return an error budget in words, one line per finding."""
    if diagnosis.mean_square == 0.0:
        return (
            "The simulation is on the mean of the band: there is no error to explain.",
        )
    lines = [_finding(diagnosis, part) for part in diagnosis.parts]
    left = _rmse_text(diagnosis, diagnosis.rest.rmse)
    lines.append(
        f"{_percent(diagnosis.rest.share)} of the squared error is none of these: {left} is left."
    )
    applied = [part for part in diagnosis.parts if part.missing is None]
    best = max(applied, key=lambda part: part.alone_share, default=None)
    if best is not None and best.alone_share > applied[0].alone_share + NOTABLE_SHARE:
        text = _change_text(diagnosis, best.stage, best.alone_changes)
        lines.append(
            f"The order matters: {_percent(best.alone_share)} is gone already if {text}, and nothing else."
        )
    return tuple(lines)


# --- figure ----------------------------------------------------------------------------------------------------------

STAGE_COLORS = {
    BudgetStage.RELEASE: OURS[5],
    BudgetStage.OFFSET: OURS[2],
    BudgetStage.RATE: OURS[4],
}
"""Colours of the parts, as on the pages of `gauge report`."""


def draw_diagnoses(pairs: Sequence[tuple[Result, Diagnosis]]) -> Figure:
    """Return the picture of error budgets: a bar for each result, with the shares of its squared error.

    Args:
        pairs: Results with their budgets, one or more, all with the parts in the same order.
    """
    if not pairs:
        raise ShapeError("error budgets of one result or more are needed, got none")
    figure = new_figure(10.0, 0.42 * len(pairs) + 1.9)
    axis = figure.add_subplot()
    for place, (_, diagnosis) in enumerate(pairs):
        left = 0.0
        for part in diagnosis.parts:
            label = part.stage.value if place == 0 else None
            axis.barh(
                place,
                100.0 * part.share,
                left=left,
                color=STAGE_COLORS[part.stage],
                height=0.72,
                label=label,
            )
            left += 100.0 * part.share
        rest = "rest" if place == 0 else None
        axis.barh(
            place,
            100.0 * diagnosis.rest.share,
            left=left,
            color=ENGINES[0],
            height=0.72,
            label=rest,
        )
        text = f"{score_text(diagnosis.rmse)} to {score_text(diagnosis.rest.rmse)} {diagnosis.unit}"
        axis.text(101.0, place, text, va="center", fontsize=8, color="#404040")
    names = [
        f"{short_id(diagnosis.id)}\n{result_label(result)}"
        for result, diagnosis in pairs
    ]
    axis.set_yticks(range(len(pairs)), names, fontsize=8)
    axis.set_ylim(len(pairs) - 0.5, -0.5)
    axis.set_xlim(0.0, 128.0)
    axis.set_xticks(range(0, 101, 20))
    order = ", then ".join(part.stage.value for part in pairs[0][1].parts)
    shares = f"share of the squared error that is gone with {order} [%]"
    ends = "at the right: RMSE before and after"
    axis.set_xlabel(f"{shares}\n{ends}", loc="left", fontsize=9)
    tidy_axis(axis)
    axis.grid(visible=False, axis="y")
    axis.tick_params(axis="y", length=0)
    axis.legend(
        loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, fontsize=8, frameon=False
    )
    return figure
