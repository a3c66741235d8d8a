"""Error budgets as tables and sentences."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import Any

from rich.console import Group
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from gauge_envs.analysis.budget_fit import BudgetStage
from gauge_envs.analysis.diagnosis import MARKERS, SEVERAL_BODIES, Diagnosis, PublishedScore, StagePart
from gauge_envs.analysis.motion_kinds import Change
from gauge_envs.files import json_ready
from gauge_envs.references.bands import BandGrade
from gauge_envs.report.results import result_label
from gauge_envs.report.text import ENGINE_TITLES, GRADE_NOTES, heading, quantity_text, score_text
from gauge_envs.runs.result import Result

__all__ = [
    "diagnosis_rows",
    "diagnosis_values",
    "diagnosis_view",
    "findings",
]


MOST_AXES = 6


DIAGNOSIS_LEGEND = (
    "Parts are added from the top down, each fitted together with those above it: what they take off the squared error "
    "(share) and off the normalized RMSE adds up to the whole. Alone: share taken off as the only change; last: after "
    "both others. Normalized: over the published mean RMSE of the real trials."
)


def diagnosis_rows(pairs: Iterable[tuple[Result, Diagnosis]]) -> list[dict[str, Any]]:
    """One JSON-ready object a result: what it is of, and its error budget."""
    keys = ("backend", "parameters", "settings_given", "seed", "jitter")
    return [
        json_ready({key: getattr(result, key) for key in keys} | {"label": result_label(result)})
        | diagnosis_values(diagnosis)
        for result, diagnosis in pairs
    ]


def diagnosis_view(pairs: Sequence[tuple[Result, Diagnosis]]) -> Group:
    """Error budgets for reading: a table and findings for each result, then what the columns mean."""
    parts: list[Any] = []
    for result, diagnosis in pairs:
        parts.append(heading(f"{diagnosis.id.removeprefix('GAUGE/')}  {result_label(result)}"))
        parts.append(_budget_table(diagnosis))
        axes = _axis_table(diagnosis)
        parts += [] if axes is None else [axes]
        parts += [Text(f"- {line}") for line in findings(diagnosis)]
        parts += [Text(line, style="dim") for line in _budget_notes(diagnosis)]
    if pairs:
        parts += [Text(""), Text(DIAGNOSIS_LEGEND, style="dim")]
        parts += [Text(f"Published engines: {pairs[0][1].published_note}", style="dim")]
    return Group(*parts)


def _budget_table(diagnosis: Diagnosis) -> Table:
    table = Table(box=None, header_style="dim", pad_edge=False)
    for title in ("part", f"RMSE left [{diagnosis.unit}]", "normalized", "taken off", "share", "alone", "last"):
        table.add_column(escape(title), justify="left" if title == "part" else "right", no_wrap=True)
    table.add_column("fitted together", overflow="fold")
    whole = diagnosis.rmse_normalized
    table.add_row("as it is", quantity_text(diagnosis.rmse), score_text(whole), "", "", "", "", "")
    for part in diagnosis.parts:
        before, after = part.rmse_before_normalized, part.rmse_after_normalized
        off = "-" if before is None or after is None else score_text(before - after)
        shares = (_share(part.share), _share(part.alone_share), _share(part.last_share))
        cells = (off, *shares, _changes(part)) if part.missing is None else ("-", "-", "-", "-", "does not apply")
        table.add_row(part.stage.value, quantity_text(part.rmse_after), score_text(after), *map(escape, cells))
    rest = diagnosis.rest
    left = "-" if rest.rmse_normalized is None else score_text(rest.rmse_normalized)
    table.add_row("rest", "", "", left, _share(rest.share), "", "", "")
    return table


def _axis_table(diagnosis: Diagnosis) -> Table | None:
    """Shares of the whole squared error by axis; None where there is one coordinate only, or too many to tell."""
    axes = diagnosis.axes()
    if len(diagnosis.coordinates) == 1 or len(axes) > MOST_AXES or diagnosis.mean_square == 0.0:
        return None
    columns = {"all": diagnosis.by_coordinate}
    columns |= {part.stage.value: part.by_coordinate for part in diagnosis.parts if part.missing is None}
    columns["rest"] = diagnosis.rest.by_coordinate
    table = Table(box=None, header_style="dim", pad_edge=False)
    table.add_column("share along")
    for title in columns:
        table.add_column(title, justify="right", no_wrap=True)
    for axis, indices in axes.items():
        sums = (sum(values[index] for index in indices) for values in columns.values())
        table.add_row(escape(axis), *(_share(value / diagnosis.mean_square) for value in sums))
    return table


def _changes(part: StagePart) -> str:
    """All changes in force after a part; offsets of many coordinates by their root mean square."""
    told = []
    offsets = [change for change in part.changes if change.quantity == "offset"]
    for change in part.changes:
        unit = "" if change.unit == "1" else f" {change.unit}"
        mark = " (limit)" if change.at_bound else ""
        if change.quantity == "release_time":
            told.append(f"release {change.fitted:+.3f}{unit}{mark}")
        elif change.quantity != "offset":
            told.append(f"{change.quantity} {change.simulated:.4g} -> {change.fitted:.4g}{unit}{mark}")
        elif len(offsets) <= 3:
            told.append(f"{change.coordinate} {change.fitted:+.3g}{unit}")
        elif change is offsets[0]:
            rms = (sum(one.fitted**2 for one in offsets) / len(offsets)) ** 0.5
            told.append(f"{len(offsets)} offsets, rms {quantity_text(rms)}{unit}")
    return ", ".join(told)


def _share(share: float) -> str:
    return f"{100.0 * share + 0.0:.1f} %"


def _budget_notes(diagnosis: Diagnosis) -> list[str]:
    grade = BandGrade(diagnosis.grade)
    lines = [f"Grade {grade.value}: {GRADE_NOTES[grade]}. Motion: {diagnosis.kind.value.replace('_', ' ')}."]
    if diagnosis.extrapolated_frames:
        lines.append(
            f"{diagnosis.extrapolated_frames} of {diagnosis.frames} frames are extrapolated, not measured; "
            f"{_share(diagnosis.extrapolated_share)} of the squared error lies in them."
        )
    lines += [f"Note: {note}." for note in diagnosis.notes]
    engines = [
        f"{ENGINE_TITLES[name]} {told}" for name, one in diagnosis.published.items() if (told := _published_text(one))
    ]
    if engines:
        own = "" if diagnosis.dtw_over_rmse is None else f" (here DTW/RMSE {diagnosis.dtw_over_rmse:.2f})"
        lines.append(f"Published{own}: {'; '.join(engines)}.")
    return lines


def _published_text(one: PublishedScore) -> str:
    told = {"RMSE": one.rmse_normalized, "DTW/RMSE": one.dtw_over_rmse, "period over the real one": one.period_ratio}
    return ", ".join(f"{title} {value:.2f}" for title, value in told.items() if value is not None)


NOTABLE_SHARE = 0.01
"""Share of the squared error by which another first part must be better to be told."""


MOST_OFFSETS_TOLD = 3


_TOLD_RATE = {
    "acceleration": "the acceleration is {fitted:.3f} instead of {simulated:.3f} m/s^2",
    "restitution": "the restitution is {fitted:.3f} instead of {simulated:.3f}",
    "period": "the period is {fitted:.3f} instead of {simulated:.3f} s",
    "amplitude": "the amplitude is {fitted:.3f} times as large",
    "speed": "the motion is {fitted:.3f} times as fast",
    "displacement": "it goes {fitted:.3f} times as far",
}


def _finding(diagnosis: Diagnosis, part: StagePart) -> str:
    """One stage in words."""
    if part.missing is not None:
        return f"{part.stage.value.capitalize()} does not apply: {part.missing}."
    first = all(other is part or other.missing for other in diagnosis.parts[: diagnosis.parts.index(part) + 1])
    own = _own_changes(part)
    course = _told_rmse(diagnosis, part.rmse_before, part.rmse_after)
    bound = " (the limit of what was tried: it may be more)" if any(change.at_bound for change in own) else ""
    also = "" if first else " as well"
    return (
        f"{_percent(part.share)} of the squared error is gone ({course}) if "
        f"{_told_change(diagnosis, part.stage, own)}{also}{bound}."
    )


def _own_changes(part: StagePart) -> tuple[Change, ...]:
    """Changes of the stage itself, among all that are in force after it."""
    quantities = {change.quantity for change in part.alone_changes}
    return tuple(change for change in part.changes if change.quantity in quantities)


def _told_change(diagnosis: Diagnosis, stage: BudgetStage, changes: Sequence[Change]) -> str:
    subject = diagnosis.subject
    verb = "are" if subject in (SEVERAL_BODIES, MARKERS) else "is"
    if stage is BudgetStage.RELEASE:
        late_s = changes[0].fitted
        when = f"{abs(late_s):.3f} s {'earlier' if late_s < 0.0 else 'later'}"
        if diagnosis.driven or subject == MARKERS:
            return f"the simulation starts {when}"
        return f"{subject} {verb} let go {when}"
    if stage is BudgetStage.OFFSET:
        most = max(changes, key=lambda change: abs(change.fitted))
        if len(changes) > MOST_OFFSETS_TOLD:
            rms = math.sqrt(sum(change.fitted**2 for change in changes) / len(changes))
            return (
                f"each of {len(changes)} coordinates has a constant added, {rms:.3g} {diagnosis.unit} root mean square "
                f"({most.fitted:+.3g} at most, {most.coordinate})"
            )
        told = ", ".join(f"{change.fitted:+.3g} {diagnosis.unit} along {change.coordinate}" for change in changes)
        return f"{subject} {verb} moved by {told}"
    return " and ".join(_TOLD_RATE[change.quantity].format(**asdict(change)) for change in changes)


def _percent(share: float) -> str:
    percent = 100.0 * share
    if 0.0 < percent < 0.01:
        return "<0.01 %"
    if 99.5 <= percent < 99.995:
        # Nearly all is not all.
        return f"{percent:.2f} %"
    return f"{percent:.2g} %" if 0.0 < percent < 9.95 else f"{percent:.0f} %"


def _told_rmse(diagnosis: Diagnosis, *rmses: float) -> str:
    """One RMSE, or its course from one to another, in the unit and in baselines."""
    told = f"RMSE {' to '.join(f'{rmse:.3g}' for rmse in rmses)} {diagnosis.unit}"
    if diagnosis.baseline is None:
        return told
    return f"{told}, {' to '.join(f'{rmse / diagnosis.baseline:.3g}' for rmse in rmses)} baselines"


def diagnosis_values(diagnosis: Diagnosis) -> dict[str, Any]:
    """JSON-ready dictionary of an error budget, every field present, with `findings` in words."""
    values: dict[str, Any] = json_ready(asdict(diagnosis) | {"findings": findings(diagnosis)})
    return values


def findings(diagnosis: Diagnosis) -> tuple[str, ...]:
    """An error budget in words, one line a finding."""
    if diagnosis.mean_square == 0.0:
        return ("The simulation is on the mean of the band: there is no error to explain.",)
    lines = [_finding(diagnosis, part) for part in diagnosis.parts]
    left = _told_rmse(diagnosis, diagnosis.rest.rmse)
    lines.append(f"{_percent(diagnosis.rest.share)} of the squared error is none of these: {left} is left.")
    applied = [part for part in diagnosis.parts if part.missing is None]
    most = max(applied, key=lambda part: part.alone_share, default=None)
    if most is not None and most.alone_share > applied[0].alone_share + NOTABLE_SHARE:
        told = _told_change(diagnosis, most.stage, most.alone_changes)
        lines.append(f"The order matters: {_percent(most.alone_share)} is gone already if {told}, and nothing else.")
    return tuple(lines)
