"""Error budgets as tables and sentences."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from rich.console import Group
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from gauge_envs.diagnosis import Diagnosis, PublishedScore, StagePart
from gauge_envs.reference import BandGrade
from gauge_envs.report.results import result_label
from gauge_envs.report.text import ENGINE_TITLES, GRADE_NOTES, heading, quantity_text, score_text
from gauge_envs.result import Result, json_ready

__all__ = ["diagnosis_rows", "diagnosis_view"]


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
        json_ready({key: getattr(result, key) for key in keys} | {"label": result_label(result)}) | diagnosis.to_dict()
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
        parts += [Text(f"- {line}") for line in diagnosis.findings()]
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
