"""The page of a sanity check: one HTML file, no script, no other file, no network."""

from dataclasses import replace
from io import StringIO
from typing import Any

import numpy as np

from gauge_envs.errors import needs_extra
from gauge_envs.pages.document import (
    Heading,
    Paragraph,
    Part,
    Tone,
    as_html,
    page,
)
from gauge_envs.pages.html import Html, element, folded
from gauge_envs.pages.table import Column, Facts, Place, Table, grid
from gauge_envs.tools.sanity.model import (
    Cause,
    Curve,
    PhenomenonResult,
    Report,
    TrainingConfiguration,
    Verdict,
)
from gauge_envs.tools.sanity.words import (
    REALITY,
    VERDICT_NOTES,
    advisory_note,
    applicable,
    contact_table,
    inapplicable,
    measured_text,
    reality_text,
    responsible_text,
    setting_text,
    settings_by_origin,
    source_facts,
    tally_text,
    top_line,
    verdict_text,
)

REALITY_COLOR, DEFAULT_COLOR, CONFIGURED_COLOR = "#303030", "#0072b2", "#d55e00"
"""Grey and two of Okabe and Ito's colours, which colour-blind readers distinguish; line styles differ too."""

MARKS = {
    Verdict.INSIDE: "\u2713",
    Verdict.VISIBLE: "\u25b3",
    Verdict.WRONG: "\u2717",
    Verdict.DECLINED: "\u2013",
}
"""Signs beside the words, so that a verdict is visible without its colour."""

FIGURE_SIZE_IN = (3.3, 2.6)
"""Size of a figure. At its own size it fits on a phone, where the text of `FONT_PT` is as large as the page's."""

FONT_PT = 10.5
"""Size of the text in figures: 14 pixels."""

LOOK = "stack dense anywhere"
"""Tables whose names may be longer than a phone is wide."""


def check_can_draw() -> None:
    """Check that a page can be drawn, before a long run."""
    with needs_extra("the HTML page", "plot"):
        import matplotlib  # noqa: F401


def sanity_page(report: Report) -> str:
    """Return the self-contained page of a sanity check."""
    checked = report.configuration
    lead = "What the numerical settings of this configuration do to the physics of measured objects: "
    rows = applicable(report)
    cards = (_card(row) for row in sorted(rows, key=lambda row: not row.is_flag))
    parts: list[Part] = [
        Paragraph(top_line(report), Tone.ANSWER),
        element("p", f"{lead}{tally_text(report)}.", class_="lead"),
        _phenomena(report),
        *inapplicable(report),
        *(
            element("p", _badge(verdict), f" {note}", class_="small")
            for verdict, note in VERDICT_NOTES.items()
        ),
        *advisory_note(report),
        Heading("One by one"),
        element("div", *cards, class_="cards"),
        Heading("What was read"),
        *_configuration(checked),
        Heading("Versions"),
        grid(("package", "version"), sorted(report.versions.items()), look="anywhere"),
    ]
    return page(f"Sanity check of {checked.name}", parts)


def _badge(verdict: Verdict, text: str | None = None) -> Html:
    return element(
        "span",
        f"{MARKS[verdict]} {text or verdict.value}",
        class_=f"badge {verdict.value}",
    )


def _row_badge(row: PhenomenonResult) -> Html:
    """Return the badge of a row; it is grey where the row is off and does not count."""
    counts = row.is_flag or row.verdict is Verdict.INSIDE
    return _badge(row.verdict if counts else Verdict.DECLINED, verdict_text(row))


def _phenomena(report: Report) -> Table:
    def preset(row: PhenomenonResult) -> str:
        verdict = (
            ""
            if row.default_verdict is Verdict.INSIDE
            else f" ({row.default_verdict.value})"
        )
        return measured_text(row.default) + verdict

    return Table(
        columns=(
            Column(
                "",
                "phenomenon",
                html=lambda row: element("a", row.title, href=f"#{row.phenomenon}"),
            ),
            REALITY,
            Column("", "preset", preset, is_number=True),
            Column("configured", "this configuration", measured_text, is_number=True),
            Column("", "verdict", html=_row_badge),
            Column("", "", responsible_text, place=Place.BELOW),
        ),
        rows=applicable(report),
        look="stack phenomena anywhere",
    )


def _configuration(checked: TrainingConfiguration) -> list[Part]:
    parts: list[Part] = [Facts(source_facts(checked))]
    parts += [Paragraph(note, Tone.WARNING) for note in checked.notes]
    rows = [
        (name, setting_text(value), origin)
        for origin, settings in settings_by_origin(checked).items()
        for name, value in settings.items()
    ]
    settings = grid(("setting", "value", "from"), rows, look=LOOK) if rows else None
    shown = (
        element("p", "No settings: this package's presets.")
        if settings is None
        else settings.html()
    )
    parts.append(folded(f"{len(rows)} settings", shown, open=True))
    if checked.contact_groups:
        table = replace(contact_table(checked), title="", look=LOOK)
        parts.append(folded("contacts of the model", table.html(), open=True))
    return parts


# --- one phenomenon --------------------------------------------------------------------------------------------------


def _card(row: PhenomenonResult) -> Html:
    """Return the details of a row, which are open where it is visible or wrong."""
    values = f"reality {reality_text(row.reality, row.unit)}, preset {measured_text(row.default)}, this configuration "
    source = f"Reality ({row.reality.kind.value}): {row.reality.source}. Interval: {row.reality.rationale}."
    scene = f" Scene: {row.experiment}." if row.experiment else ""
    parts: list[Part] = [
        element("p", _row_badge(row), f" {values}{measured_text(row.configured)}")
    ]
    if row.curve is not None:
        parts.append(_figure(row.curve))
    if text := responsible_text(row):
        parts.append(Paragraph(text))
    if row.cause is not None and row.cause.tried:
        parts.append(_tried(row.cause, row.unit))
    if row.parts:
        rows = [
            (one.name, measured_text(one.value), one.verdict.value, one.remark)
            for one in row.parts
        ]
        parts.append(grid(("part", "measured", "verdict", ""), rows, look="anywhere"))
    parts.append(Paragraph(source + scene, Tone.NOTE))
    return folded(
        row.title, as_html(parts), class_="card", id=row.phenomenon, open=row.is_flag
    )


def _tried(cause: Cause, unit: str) -> Html:
    rows = [
        (
            ", ".join(
                f"{name} = {setting_text(value)}"
                for name, value in trial.changes.items()
            ),
            "the preset" if trial.on_default else "this configuration",
            "diverged or declined"
            if trial.value is None
            else measured_text(trial.value),
        )
        for trial in cause.tried
    ]
    titles = ("change", "of", "measured" if unit == "1" else f"measured [{unit}]")
    return folded(
        f"{len(rows)} changes were tried", grid(titles, rows, look="anywhere").html()
    )


def _figure(curve: Curve) -> Html:
    """Return the curves of a phenomenon as inline SVG."""
    check_can_draw()
    import matplotlib as mpl
    from matplotlib.figure import Figure

    # Text stays text: a page of many figures is five times smaller than with glyphs as paths.
    with mpl.rc_context(
        {"svg.fonttype": "none", "font.family": "sans-serif", "font.size": FONT_PT}
    ):
        figure = Figure(figsize=FIGURE_SIZE_IN, layout="constrained")
        _draw(figure.add_subplot(), curve)
        figure.legend(
            loc="outside upper center",
            ncols=2,
            frameon=False,
            handlelength=1.4,
            columnspacing=1.0,
            borderpad=0.0,
        )
        stream = StringIO()
        figure.savefig(stream, format="svg", metadata={"Date": None})
    text = stream.getvalue()
    return Html(text[text.index("<svg") :])


def _draw(axes: Any, curve: Curve) -> None:
    if curve.reality:
        centre, half = np.asarray(curve.reality), np.asarray(curve.tolerance)
        band = (curve.times_s, centre - half, centre + half)
        axes.fill_between(*band, color="#cfcfcf", lw=0.0, label="reality")
        axes.plot(curve.times_s, curve.reality, color=REALITY_COLOR, lw=1.0)
    if curve.default:
        axes.plot(
            curve.times_s,
            curve.default,
            color=DEFAULT_COLOR,
            lw=1.4,
            ls="--",
            label="preset",
        )
    if curve.configured:
        axes.plot(
            curve.configured_times_s,
            curve.configured,
            color=CONFIGURED_COLOR,
            lw=1.6,
            label="this configuration",
        )
    axes.set_xlabel("time [s]")
    axes.set_ylabel(curve.label)
    axes.locator_params(nbins=5)
    axes.spines[["top", "right"]].set_visible(False)
