"""Report a comparison: the answer, and the details for a maintainer."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from gauge_envs.pages.document import Document, Paragraph, Part, Tone
from gauge_envs.pages.table import Column, Table
from gauge_envs.pages.text import counted, quantity_text, value_text
from gauge_envs.tools.compare import ScoreComparison, short_tables
from gauge_envs.tools.versions.schema import (
    MotionComparison,
    ReturnComparison,
    StepComparison,
    VersionsVerdict,
)

DIFFER = {
    VersionsVerdict.SAME: "do not differ by more than the noise",
    VersionsVerdict.DIFFERENT: "differ",
}


def comparison_document(comparison: StepComparison) -> Document:
    """Return the answer, the first and largest difference, the tables of differences, and which side is right."""
    answer = (
        f"{comparison.before} and {comparison.after} {DIFFER[comparison.verdict]} on {comparison.subject}: in "
        f"{comparison.differing} of {counted(comparison.states, 'state')} one step from the same state gives "
        f"different accelerations, by up to {100.0 * comparison.largest:.3g} %."
    )
    differences = [*filter(None, (comparison.first, comparison.worst))]
    tables = [
        _table(
            "First and largest difference of one step [m, m/s^2 or rad/s^2]",
            differences,
            "segment step quantity where before after",
        ),
        _table("Compiled fields", comparison.fields, "field row count before after"),
        _table(
            "Laws: largest relative error of each side",
            comparison.rulings,
            "law before after states right",
        ),
        _table("Tested releases", comparison.tried, "release like"),
    ]
    parts: list[Part] = [Paragraph(answer, Tone.ANSWER)]
    parts += [table for table in tables if table.rows]
    if comparison.unknown_fields:
        names = ", ".join(comparison.unknown_fields)
        text = f"Fields that are new to this package are compared as physical ones: {names}."
        parts.append(Paragraph(text, Tone.WARNING))
    if differences:
        right = "No checked law shows which side is right."
        if comparison.right:
            right = f"{comparison.right} is right, by the laws above."
        parts.append(Paragraph(right, Tone.ANSWER))
    return Document(parts=parts, rows=[asdict(comparison)])


def motions_document(comparison: MotionComparison, scores: ScoreComparison) -> Document:
    """Return the first and the largest difference of two motions, and the scores of both."""
    unit = comparison.unit
    answer = (
        f"{comparison.before} and {comparison.after} {DIFFER[comparison.verdict]} in the motion of "
        f"{comparison.subject}: the largest difference is {quantity_text(comparison.largest)} {unit} after "
        f"{comparison.largest_s:.3g} s (noise: {quantity_text(comparison.noise)} {unit}, from an initial position "
        "shifted by 1e-9 m)."
    )
    if comparison.first_s is not None:
        answer += (
            f" The motions differ from {comparison.first_s:.3g} s on. {comparison.right or 'Neither side'} is closer "
            "to the reference beyond its uncertainty."
        )
    return Document(
        parts=[Paragraph(answer, Tone.ANSWER), *short_tables(scores)],
        rows=[asdict(comparison)],
    )


def returns_document(comparison: ReturnComparison) -> Document:
    """Return the returns of a policy on both sides."""
    before, after = map(quantity_text, comparison.returns)
    change = "{value:.4g} [{low:.4g}, {high:.4g}]".format(**vars(comparison.change))
    answer = (
        f"{comparison.before} and {comparison.after} {DIFFER[comparison.verdict]} in returns of {comparison.subject} "
        f"over {counted(comparison.seeds, 'seed')}: {before} and {after}. The change is {change} (95 % interval, "
        "paired by seed)."
    )
    return Document(parts=[Paragraph(answer, Tone.ANSWER)], rows=[asdict(comparison)])


def _table(title: str, rows: Sequence[Any], names: str) -> Table:
    """Return a table with a column for each name."""
    columns = [Column(name, name.replace("_", " "), _text) for name in names.split()]
    return Table(title=title, columns=tuple(columns), rows=rows)


def _text(value: Any) -> str:
    """Return the text of a number or a list."""
    if isinstance(value, float):
        return quantity_text(value)
    if isinstance(value, list):
        return ", ".join(map(_text, value))
    return value_text(value)
