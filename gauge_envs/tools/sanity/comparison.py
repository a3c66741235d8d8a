"""Compare the reports of two targets row by row, value beside value.

Example:
    >>> from gauge_envs.tools.sanity import check
    >>> reports = [check(target, only=["rebound"]) for target in ("mujoco", "mujoco")]
    >>> [row.is_changed for row in difference(*reports).rows]
    [False]
"""

from dataclasses import dataclass

from gauge_envs.pages.document import Document, Paragraph, Tone
from gauge_envs.pages.table import Column, Table
from gauge_envs.pages.text import counted, with_unit
from gauge_envs.tools.sanity.model import PhenomenonResult, Report, Verdict
from gauge_envs.tools.sanity.words import STYLES, measured_text


@dataclass(frozen=True, kw_only=True)
class DifferenceRow:
    """One row of two reports.

    Attributes:
        id: Id of the row.
        title: Title.
        unit: Unit of both values; `1` for a pure number.
        first: Value of the first target; None when not measured.
        second: Value of the second target.
        first_verdict: Verdict of the first target.
        second_verdict: Verdict of the second target.
        is_changed: Whether the verdicts differ, or the values by more than the half-width of the interval of reality.
    """

    id: str
    title: str
    unit: str
    first: float | None
    second: float | None
    first_verdict: Verdict
    second_verdict: Verdict
    is_changed: bool

    @property
    def is_measured(self) -> bool:
        """Whether both targets were measured."""
        return Verdict.DECLINED not in (self.first_verdict, self.second_verdict)

    @property
    def is_wrong(self) -> bool:
        """Whether one of the two is wrong."""
        return Verdict.WRONG in (self.first_verdict, self.second_verdict)


@dataclass(frozen=True, kw_only=True)
class Difference:
    """The rows of two reports that apply to at least one of their targets.

    Attributes:
        first: Name of the first target.
        second: Name of the second target.
        rows: The rows, in the order of the reports.
    """

    first: str
    second: str
    rows: tuple[DifferenceRow, ...]


def difference(first: Report, second: Report) -> Difference:
    """Return the rows of two reports beside each other."""
    others = {row.phenomenon: row for row in second.rows}
    pairs = [
        (row, others[row.phenomenon])
        for row in first.rows
        if row.phenomenon in others and (row.applies or others[row.phenomenon].applies)
    ]
    return Difference(
        first=first.configuration.name,
        second=second.configuration.name,
        rows=tuple(_row(*pair) for pair in pairs),
    )


def _row(first: PhenomenonResult, second: PhenomenonResult) -> DifferenceRow:
    is_changed = first.verdict is not second.verdict
    if first.configured is not None and second.configured is not None:
        apart = abs(first.configured - second.configured)
        is_changed |= apart > first.reality.tolerance
    return DifferenceRow(
        id=first.phenomenon,
        title=first.title,
        unit=first.unit,
        first=first.configured,
        second=second.configured,
        first_verdict=first.verdict,
        second_verdict=second.verdict,
        is_changed=is_changed,
    )


def difference_document(found: Difference) -> Document:
    """Return how many rows change, and the table; its rows are both names, then each row."""
    changed = [row.id for row in found.rows if row.is_changed]
    text = f"{len(changed)} of {counted(len(found.rows), 'row')} change"
    if changed:
        text += f": {', '.join(changed)}"
    names = {"first": found.first, "second": found.second}
    answer, table = Paragraph(text, Tone.ANSWER), _table(found)
    rows = [names, *map(vars, found.rows)]
    return Document(
        parts=(answer, Paragraph(""), table), rows=rows, markdown=(answer, table)
    )


def _table(found: Difference) -> Table:
    def apart(row: DifferenceRow) -> str:
        if row.first is None or row.second is None:
            return "-"
        return with_unit(f"{row.second - row.first:+.3g}", row.unit)

    return Table(
        columns=(
            Column("id", "id"),
            Column("title", "quantity", wide_only=True),
            Column("first", found.first, measured_text, is_number=True),
            Column("second", found.second, measured_text, is_number=True),
            Column("", "difference", apart, is_number=True),
            *(
                Column(
                    name,
                    "verdict",
                    lambda verdict: verdict.value,
                    style=STYLES.__getitem__,
                )
                for name in ("first_verdict", "second_verdict")
            ),
            Column("is_changed", "", lambda is_changed: "changed" * is_changed),
        ),
        rows=found.rows,
    )
