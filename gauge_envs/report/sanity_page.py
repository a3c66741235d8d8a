"""A sanity check as one HTML file: no script, no other file, no network."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from io import StringIO
from pathlib import Path
from typing import Any

from gauge_envs.checks.sanity.model import (
    Cause,
    Curve,
    GroupOutcome,
    PhenomenonResult,
    Report,
    TrainingConfiguration,
    Verdict,
)
from gauge_envs.errors import MissingExtraError, ResultFileError
from gauge_envs.report.sanity import (
    ADVISORY_NOTE,
    VERDICT_NOTES,
    measured_text,
    reality_text,
    responsible_text,
    setting_text,
    settings_by_origin,
    tally_text,
    top_line,
    verdict_text,
)

__all__ = ["check_can_draw", "sanity_page", "save_sanity_page"]

REALITY_COLOR, DEFAULT_COLOR, CONFIGURED_COLOR = "#303030", "#0072b2", "#d55e00"
"""Grey and two of Okabe and Ito's colours, which colour-blind readers distinguish; line styles differ too."""

MARKS = {Verdict.INSIDE: "&#10003;", Verdict.VISIBLE: "&#9651;", Verdict.WRONG: "&#10007;", Verdict.DECLINED: "&ndash;"}
"""Signs beside the words, so that a verdict is visible without its colour."""

FIGURE_SIZE_IN = (5.2, 2.5)

STYLE = """
:root { color-scheme: light; }
body { font: 15px/1.5 system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; color: #1c1c1c; background: #fff;
  max-width: 76rem; margin: 2rem auto; padding: 0 1.2rem; }
h1 { font-size: 1.6rem; margin: 0; } h2 { font-size: 1.15rem; margin: 2.2rem 0 .6rem; }
h3 { font-size: 1rem; margin: 0 0 .3rem; }
.lead { color: #555; margin: .2rem 0 1.2rem; }
table { border-collapse: collapse; width: 100%; }
th { text-align: left; font-weight: 600; color: #555; border-bottom: 2px solid #ccc; padding: .3rem .6rem; }
td { border-bottom: 1px solid #e4e4e4; padding: .35rem .6rem; vertical-align: top; }
.phenomena td:first-child { min-width: 13rem; } .phenomena td:last-child { min-width: 19rem; }
.scroll { overflow-x: auto; }
a { color: inherit; text-decoration-color: #aaa; }
td.n, th.n { text-align: right; white-space: nowrap; font-variant-numeric: tabular-nums; }
code { font: 13px/1.45 ui-monospace, Menlo, Consolas, "DejaVu Sans Mono", monospace; }
.badge { display: inline-block; border-radius: .25rem; padding: .05rem .5rem; white-space: nowrap; border: 1px solid; }
.inside { background: #e3f1fa; border-color: #0072b2; } .visible { background: #fdf3d4; border-color: #c78a00; }
.wrong { background: #fbe3d6; border-color: #d55e00; font-weight: 600; }
.declined { background: #f1f1f1; border-color: #999; color: #555; }
.cure { border-left: 3px solid #0072b2; padding: .3rem .7rem; background: #f2f8fc; font-weight: 600; }
.note { border-left: 3px solid #c78a00; padding: .1rem .7rem; margin: .4rem 0; background: #fffaf0; }
.cards { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(26rem, 100%), 1fr)); gap: 1.2rem; }
.card { border: 1px solid #ddd; border-radius: .4rem; padding: .8rem 1rem; break-inside: avoid; }
.card svg { width: 100%; max-width: 34rem; height: auto; } .small { color: #555; font-size: .87rem; margin: .3rem 0; }
details { font-size: .87rem; } summary { cursor: pointer; color: #555; }
details td, details th { padding: .12rem .5rem; } details { overflow-x: auto; }
"""


def check_can_draw() -> None:
    """Check that a page can be drawn, before a long run.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("the HTML page", "plot", error) from error


def save_sanity_page(report: Report, path: Path) -> Path:
    """Write the page of a sanity check.

    Raises:
        MissingExtraError: matplotlib is not installed.
        ResultFileError: The file cannot be written.
    """
    text = sanity_page(report)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ResultFileError(f"{path}: cannot be written: {error.strerror}") from error
    return path


def sanity_page(report: Report) -> str:
    """Return the self-contained page of a sanity check.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    checked = report.configuration
    title = f"Sanity check of {checked.name}"
    parts = [
        f"<h1>{escape(title)}</h1>",
        f'<p class="lead">What the numerical settings of this configuration do to the physics of measured objects: '
        f"{escape(tally_text(report))}.</p>",
        f'<p class="cure">{escape(top_line(report))}</p>',
        "<h2>Phenomena</h2>",
        _phenomena(report.rows),
        "".join(f'<p class="small">{_badge(verdict)} {escape(note)}</p>' for verdict, note in VERDICT_NOTES.items()),
        f'<p class="small">advisory: {escape(ADVISORY_NOTE)}</p>' if any(row.advisory for row in report.rows) else "",
        "<h2>What was read</h2>",
        _configuration(checked),
        "<h2>One by one</h2>",
        f'<div class="cards">{"".join(map(_card, report.rows))}</div>',
        "<h2>Versions</h2>",
        _table(("package", "version"), sorted(report.versions.items())),
    ]
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        f'<meta name="viewport" content="width=device-width"><style>{STYLE}</style></head>\n'
        f"<body>{chr(10).join(parts)}</body></html>\n"
    )


def _table(titles: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a plain table of text."""
    head = "".join(f"<th>{escape(title)}</th>" for title in titles)
    body = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
    return f'<div class="scroll"><table><tr>{head}</tr>{body}</table></div>'


def _badge(verdict: Verdict, text: str | None = None) -> str:
    return f'<span class="badge {verdict.value}">{MARKS[verdict]} {escape(text or verdict.value)}</span>'


def _row_badge(row: PhenomenonResult) -> str:
    """Return the badge of a row; an advisory one is grey."""
    return _badge(Verdict.DECLINED if row.advisory else row.verdict, verdict_text(row))


def _phenomena(rows: Sequence[PhenomenonResult]) -> str:
    head = (
        '<tr><th>phenomenon</th><th class="n">reality</th><th class="n">this package\'s preset</th>'
        '<th class="n">this configuration</th><th>verdict</th><th>responsible</th></tr>'
    )
    return f'<div class="scroll"><table class="phenomena">{head}{"".join(map(_phenomenon, rows))}</table></div>'


def _phenomenon(row: PhenomenonResult) -> str:
    default = escape(measured_text(row.default))
    if row.default_verdict is not Verdict.INSIDE:
        default += f" <small>({row.default_verdict.value})</small>"
    return (
        f'<tr><td><a href="#{escape(row.phenomenon)}">{escape(row.title)}</a></td>'
        f'<td class="n">{escape(reality_text(row.reality, row.unit))}</td><td class="n">{default}</td>'
        f'<td class="n">{escape(measured_text(row.configured))}</td><td>{_row_badge(row)}</td>'
        f"<td>{escape(responsible_text(row))}</td></tr>"
    )


# --- configuration ---------------------------------------------------------------------------------------------------


def _configuration(checked: TrainingConfiguration) -> str:
    facts = [("read from", checked.source), ("backend", checked.backend)]
    if checked.frame_skip is not None:
        facts.append(("one action", f"{checked.frame_skip} steps"))
    if checked.foot is not None:
        facts.append(("foot on ground", checked.foot.text))
    parts = [_table(("what", "value"), facts)]
    parts += [f'<p class="note">{escape(note)}</p>' for note in checked.notes]
    rows = [
        (name, setting_text(value), origin)
        for origin, settings in settings_by_origin(checked).items()
        for name, value in settings.items()
    ]
    settings = _table(("setting", "value", "from"), rows) if rows else "<p>No settings: this package's presets.</p>"
    parts.append(f"<details open><summary>{len(rows)} settings</summary>{settings}</details>")
    if checked.contact_groups:
        names = list(checked.contact_groups[0].constants)
        groups = [
            (
                "used" if group.is_used else "",
                group.geoms,
                str(group.pair_count),
                *(setting_text(group.constants[name]) for name in names),
            )
            for group in checked.contact_groups
        ]
        table = _table(("", "geoms", "pairs", *names), groups)
        parts.append(f"<details open><summary>contacts of the model</summary>{table}</details>")
    return "".join(parts)


# --- one phenomenon --------------------------------------------------------------------------------------------------


def _card(row: PhenomenonResult) -> str:
    text = responsible_text(row)
    figure = "" if row.curve is None else _figure(row.curve)
    return (
        f'<div class="card" id="{escape(row.phenomenon)}"><h3>{escape(row.title)}</h3>'
        f"<p>{_row_badge(row)} {escape(_sentence(row))}</p>{figure}"
        f"{f'<p>{escape(text)}</p>' if text else ''}"
        f"{_tried(row.cause, row.unit) if row.cause is not None and row.cause.tried else ''}"
        f"{_groups(row.groups)}"
        f'<p class="small">Reality ({row.reality.kind.value}): {escape(row.reality.source)}. Interval: '
        f"{escape(row.reality.rationale)}.{f' Scene: {escape(row.experiment)}.' if row.experiment else ''}</p></div>"
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
    with mpl.rc_context({"svg.fonttype": "none", "font.family": "sans-serif", "font.size": 9.0}):
        figure = Figure(figsize=FIGURE_SIZE_IN, layout="constrained")
        axes = figure.add_subplot()
        _draw(axes, curve)
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
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize=8, loc="best")
