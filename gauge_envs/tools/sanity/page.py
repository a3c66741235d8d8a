"""A sanity check as one HTML file: no script, no other file, no network."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from io import StringIO
from pathlib import Path
from typing import Any

from gauge_envs.errors import MissingExtraError, ResultFileError
from gauge_envs.pages.html import STYLE
from gauge_envs.tools.sanity.model import (
    Cause,
    Curve,
    GroupOutcome,
    PhenomenonResult,
    Report,
    TrainingConfiguration,
    Verdict,
)
from gauge_envs.tools.sanity.words import (
    ADVISORY_NOTE,
    VERDICT_NOTES,
    foot_text,
    measured_text,
    reality_text,
    responsible_text,
    setting_text,
    settings_by_origin,
    tally_text,
    top_line,
    verdict_text,
)

REALITY_COLOR, DEFAULT_COLOR, CONFIGURED_COLOR = "#303030", "#0072b2", "#d55e00"
"""Grey and two of Okabe and Ito's colours, which colour-blind readers distinguish; line styles differ too."""

MARKS = {Verdict.INSIDE: "&#10003;", Verdict.VISIBLE: "&#9651;", Verdict.WRONG: "&#10007;", Verdict.DECLINED: "&ndash;"}
"""Signs beside the words, so that a verdict is visible without its colour."""

FIGURE_SIZE_IN = (3.3, 2.6)
"""Size of a figure. At its own size it fits on a phone, where the text of `FONT_PT` is as large as the page's."""

FONT_PT = 10.5
"""Size of the text in figures: 14 pixels."""


def check_can_draw() -> None:
    """Check that a page can be drawn, before a long run."""
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("the HTML page", "plot", error) from error


def save_sanity_page(report: Report, path: Path) -> Path:
    """Write the page of a sanity check."""
    text = sanity_page(report)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ResultFileError(f"{path}: cannot be written: {error.strerror}") from error
    return path


def sanity_page(report: Report) -> str:
    """Return the self-contained page of a sanity check."""
    checked = report.configuration
    title = f"Sanity check of {checked.name}"
    parts = [
        f"<h1>{escape(title)}</h1>",
        f'<p class="cure">{escape(top_line(report))}</p>',
        f'<p class="lead">What the numerical settings of this configuration do to the physics of measured objects: '
        f"{escape(tally_text(report))}.</p>",
        _phenomena(report.rows),
        "".join(f'<p class="small">{_badge(verdict)} {escape(note)}</p>' for verdict, note in VERDICT_NOTES.items()),
        f'<p class="small">advisory: {escape(ADVISORY_NOTE)}</p>' if any(row.advisory for row in report.rows) else "",
        "<h2>One by one</h2>",
        f'<div class="cards">{"".join(map(_card, sorted(report.rows, key=lambda row: not row.is_flag)))}</div>',
        "<h2>What was read</h2>",
        _configuration(checked),
        "<h2>Versions</h2>",
        _table(("package", "version"), sorted(report.versions.items())),
    ]
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><style>{STYLE}</style></head>\n'
        f"<body>{chr(10).join(parts)}</body></html>\n"
    )


def _table(titles: Sequence[str], rows: Iterable[Sequence[str]], *, stacks: bool = False) -> str:
    """Return a plain table of text.

    Args:
        titles: Titles of the columns.
        rows: Texts of the cells.
        stacks: Whether the cells of a row stand below each other on a narrow screen, each with its title.
    """
    head = "".join(f"<th>{escape(title)}</th>" for title in titles)
    body = "".join(f"<tr>{''.join(map(_cell, titles, row))}</tr>" for row in rows)
    kind = ' class="stack wide"' if stacks else ""
    return f"<table{kind}><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _cell(title: str, text: str) -> str:
    label = f' data-label="{escape(title)}"' if title else ""
    return f"<td{label}>{escape(text)}</td>"


def _badge(verdict: Verdict, text: str | None = None) -> str:
    return f'<span class="badge {verdict.value}">{MARKS[verdict]} {escape(text or verdict.value)}</span>'


def _row_badge(row: PhenomenonResult) -> str:
    """Return the badge of a row; it is grey where the row is off and does not count."""
    counts = row.is_flag or row.verdict is Verdict.INSIDE
    return _badge(row.verdict if counts else Verdict.DECLINED, verdict_text(row))


def _phenomena(rows: Sequence[PhenomenonResult]) -> str:
    head = (
        '<tr><th>phenomenon</th><th class="n">reality</th><th class="n">preset</th>'
        '<th class="n">this configuration</th><th>verdict</th></tr>'
    )
    body = "".join(map(_phenomenon, rows))
    return f'<table class="stack phenomena"><thead>{head}</thead><tbody>{body}</tbody></table>'


def _phenomenon(row: PhenomenonResult) -> str:
    default = escape(measured_text(row.default))
    if row.default_verdict is not Verdict.INSIDE:
        default += f" ({row.default_verdict.value})"
    text = responsible_text(row)
    more = f'<tr class="more"><td colspan="5">{escape(text)}</td></tr>' if text else ""
    return (
        f'<tr><td><a href="#{escape(row.phenomenon)}">{escape(row.title)}</a></td>'
        f'<td class="n" data-label="reality">{escape(reality_text(row.reality, row.unit))}</td>'
        f'<td class="n" data-label="preset">{default}</td>'
        f'<td class="n" data-label="this configuration">{escape(measured_text(row.configured))}</td>'
        f"<td>{_row_badge(row)}</td></tr>{more}"
    )


# --- configuration ---------------------------------------------------------------------------------------------------


def _configuration(checked: TrainingConfiguration) -> str:
    facts = [("read from", checked.source), ("backend", checked.backend)]
    if checked.frame_skip is not None:
        facts.append(("one action", f"{checked.frame_skip} steps"))
    if checked.foot_contact is not None:
        facts.append(("foot on ground", checked.foot_contact.text))
    if checked.foot_geometry is not None:
        facts.append(("foot", foot_text(checked.foot_geometry)))
    parts = [_table(("what", "value"), facts)]
    parts += [f'<p class="note">{escape(note)}</p>' for note in checked.notes]
    rows = [
        (name, setting_text(value), origin)
        for origin, settings in settings_by_origin(checked).items()
        for name, value in settings.items()
    ]
    titles = ("setting", "value", "from")
    settings = _table(titles, rows, stacks=True) if rows else "<p>No settings: this package's presets.</p>"
    parts.append(f"<details open><summary>{len(rows)} settings</summary>{settings}</details>")
    if checked.contact_groups:
        names = list(checked.contact_groups[0].constants)
        groups = [
            (
                group.geoms,
                "used" if group.is_used else "",
                str(group.pair_count),
                *(setting_text(group.constants[name]) for name in names),
            )
            for group in checked.contact_groups
        ]
        table = _table(("geoms", "", "pairs", *names), groups, stacks=True)
        parts.append(f"<details open><summary>contacts of the model</summary>{table}</details>")
    return "".join(parts)


# --- one phenomenon --------------------------------------------------------------------------------------------------


def _card(row: PhenomenonResult) -> str:
    """Return the details of a row, which are open where it is visible or wrong."""
    text = responsible_text(row)
    figure = "" if row.curve is None else _figure(row.curve)
    return (
        f'<details class="card" id="{escape(row.phenomenon)}"{" open" if row.is_flag else ""}>'
        f"<summary>{escape(row.title)}</summary>"
        f"<p>{_row_badge(row)} {escape(_sentence(row))}</p>{figure}"
        f"{f'<p>{escape(text)}</p>' if text else ''}"
        f"{_tried(row.cause, row.unit) if row.cause is not None and row.cause.tried else ''}"
        f"{_groups(row.groups)}"
        f'<p class="small">Reality ({row.reality.kind.value}): {escape(row.reality.source)}. Interval: '
        f"{escape(row.reality.rationale)}.{f' Scene: {escape(row.experiment)}.' if row.experiment else ''}</p>"
        "</details>"
    )


def _groups(groups: Sequence[GroupOutcome]) -> str:
    """Return the outcome for each set of contact constants; nothing when there is one set."""
    if not groups:
        return ""
    rows = [(one.geoms, measured_text(one.value), one.verdict.value, one.remark) for one in groups]
    return _table(("geoms", "measured", "verdict", ""), rows)


def _sentence(row: PhenomenonResult) -> str:
    return (
        f"reality {reality_text(row.reality, row.unit)}, preset {measured_text(row.default)}, "
        f"this configuration {measured_text(row.configured)}"
    )


def _tried(cause: Cause, unit: str) -> str:
    rows = [
        (
            ", ".join(f"{name} = {setting_text(value)}" for name, value in trial.changes.items()),
            "the preset" if trial.on_default else "this configuration",
            "diverged or declined" if trial.value is None else measured_text(trial.value),
        )
        for trial in cause.tried
    ]
    table = _table(("change", "of", "measured" if unit == "1" else f"measured [{unit}]"), rows)
    return f"<details><summary>{len(rows)} changes were tried</summary>{table}</details>"


def _figure(curve: Curve) -> str:
    """Return the curves of a phenomenon as inline SVG."""
    check_can_draw()
    import matplotlib as mpl
    from matplotlib.figure import Figure

    # Text stays text: a page of many figures is five times smaller than with glyphs as paths.
    with mpl.rc_context({"svg.fonttype": "none", "font.family": "sans-serif", "font.size": FONT_PT}):
        figure = Figure(figsize=FIGURE_SIZE_IN, layout="constrained")
        axes = figure.add_subplot()
        _draw(axes, curve)
        figure.legend(
            loc="outside upper center", ncols=2, frameon=False, handlelength=1.4, columnspacing=1.0, borderpad=0.0
        )
        stream = StringIO()
        figure.savefig(stream, format="svg", metadata={"Date": None})
    text = stream.getvalue()
    return text[text.index("<svg") :]


def _draw(axes: Any, curve: Curve) -> None:
    if curve.reality:
        low = [centre - half for centre, half in zip(curve.reality, curve.tolerance, strict=True)]
        high = [centre + half for centre, half in zip(curve.reality, curve.tolerance, strict=True)]
        axes.fill_between(curve.times_s, low, high, color="#cfcfcf", lw=0.0, label="reality")
        axes.plot(curve.times_s, curve.reality, color=REALITY_COLOR, lw=1.0)
    if curve.default:
        axes.plot(curve.times_s, curve.default, color=DEFAULT_COLOR, lw=1.4, ls="--", label="preset")
    if curve.configured:
        axes.plot(
            curve.configured_times_s, curve.configured, color=CONFIGURED_COLOR, lw=1.6, label="this configuration"
        )
    axes.set_xlabel("time [s]")
    axes.set_ylabel(curve.label)
    axes.locator_params(nbins=5)
    axes.spines[["top", "right"]].set_visible(False)
