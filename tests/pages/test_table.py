"""Tables: the same rows in a terminal, Markdown and JSON."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from io import StringIO

import pytest
from hypothesis import example, given, settings, strategies as st
from rich.console import Console

from gauge_envs.pages.document import as_rows
from gauge_envs.pages.markdown import as_markdown
from gauge_envs.pages.table import Column, Place, Table
from gauge_envs.pages.tabular import as_csv, as_latex
from gauge_envs.pages.terminal import Terminal
from gauge_envs.pages.text import (
    counted,
    quantity_text,
    score_text,
    shortened,
    value_text,
)

ROWS = (
    {
        "id": "GAUGE/A-1",
        "grade": "trials",
        "scores": {"first": 1.0, "second": None},
        "note": "one",
    },
    {
        "id": "GAUGE/A-1",
        "grade": "trials",
        "scores": {"first": 12.345, "second": 3.0},
        "note": "",
    },
    {"id": "GAUGE/B-2", "grade": "none", "scores": None, "note": "a | b"},
)
TABLE = Table(
    title="Scores",
    columns=(
        Column("id", "experiment", place=Place.HEADING),
        Column("grade", "grade", place=Place.HEADING),
        Column("scores.first", "first", score_text, is_number=True, unit="mm"),
        Column("scores.second", "second", score_text, is_number=True, wide_only=True),
        Column("note", "note", place=Place.BELOW),
    ),
    rows=ROWS,
    notes=("In millimetres.",),
)


def printed(shown, width=80, *, wide=False):
    stream = StringIO()
    Console(file=stream, width=width).print(Terminal(shown, wide))
    return [line.rstrip() for line in stream.getvalue().splitlines()]


def test_a_terminal_has_headings_cells_and_lines_below():
    assert printed(TABLE) == [
        "",
        "Scores",
        "  first [mm]",
        "GAUGE/A-1  grade trials",
        "        1.00",
        "    one",
        "       12.35",
        "GAUGE/B-2  grade none",
        "           -",
        "    a | b",
        "In millimetres.",
    ]
    assert printed(TABLE, wide=True)[2] == "  first [mm]  second"


def test_markdown_has_all_columns_in_all_rows():
    assert as_markdown(TABLE).splitlines() == [
        "**Scores**",
        "",
        "| experiment | grade | first [mm] | second | note |",
        "| --- | --- | ---: | ---: | --- |",
        "| GAUGE/A-1 | trials | 1.00 | - | one |",
        "| GAUGE/A-1 | trials | 12.35 | 3.00 |  |",
        r"| GAUGE/B-2 | none | - | - | a \| b |",
        "",
        "In millimetres.",
    ]


def test_a_paper_has_the_same_cells_in_csv_and_latex():
    cells = [
        ["experiment", "grade", "first [mm]", "second", "note"],
        ["GAUGE/A-1", "trials", "1.00", "-", "one"],
        ["GAUGE/A-1", "trials", "12.35", "3.00", ""],
        ["GAUGE/B-2", "none", "-", "-", "a | b"],
    ]
    assert list(csv.reader(StringIO(as_csv(TABLE)))) == cells
    marks = replace(
        TABLE, rows=[{"id": r"50 % & \x_{1}", "grade": "none", "note": "a~b^c"}]
    )
    assert as_latex(marks).splitlines() == [
        "% In millimetres.",
        r"\begin{tabular}{p{3cm}p{3cm}rrl}",
        r"\hline",
        r"experiment & grade & first [mm] & second & note \\",
        r"\hline",
        r"50 \% \& \textbackslash{}x\_\{1\} & none & - & - & a\textasciitilde{}b\textasciicircum{}c \\",
        r"\hline",
        r"\end{tabular}",
    ]


def test_json_has_the_rows():
    assert json.loads(json.dumps(as_rows(TABLE), allow_nan=False)) == list(ROWS)


WORDS = st.lists(
    st.text("abc123.-", min_size=1, max_size=14), min_size=1, max_size=8
).map(" ".join)


@settings(max_examples=80, deadline=None)
@example(
    titles=["1", "1", "1" * 13],
    cells=[["1", "1 1 1 1 1", "-", *["1"] * 5]],
    places=[Place.CELL] * 8,
    width=30,
)
@given(
    titles=st.lists(WORDS, min_size=1, max_size=8),
    cells=st.lists(st.lists(WORDS, min_size=8, max_size=8), min_size=1, max_size=4),
    places=st.lists(st.sampled_from(Place), min_size=8, max_size=8),
    width=st.integers(30, 120),
)
def test_no_line_is_too_long_and_no_word_is_lost(titles, cells, places, width):
    columns = (
        Column("0", "first"),
        *(
            Column(str(index), title, place=places[index])
            for index, title in enumerate(titles[1:], start=1)
        ),
    )
    rows = [{str(index): text for index, text in enumerate(line)} for line in cells]
    lines = printed(Table(columns=columns, rows=rows), width)
    assert max(map(len, lines)) <= width
    words = {word.strip(";") for line in lines for word in line.split()}
    assert words >= {
        word
        for row in rows
        for index in range(len(columns))
        for word in row[str(index)].split()
    }


@pytest.mark.parametrize(
    ("text", "values"),
    [
        (
            score_text,
            {
                None: "-",
                0.0: "0",
                0.0999: "0.1",
                0.1: "0.10",
                -0.1: "-0.10",
                0.0123: "0.012",
                -0.0123: "-0.012",
                99.994: "99.99",
                100.0: "100",
                123.4: "123",
                54321.0: "5.43e+04",
            },
        ),
        (
            quantity_text,
            {
                0.0: "0",
                1e-3: "0.001",
                0.000999: "1.0e-03",
                -0.1234: "-0.123",
                999.4: "999",
                1000.0: "1000",
                -1234.5: "-1234",
                99999.4: "99999",
                1e5: "1e+05",
            },
        ),
        (value_text, {1 / 3: "0.3333333333", 7: "7", (): "()"}),
        (
            lambda count: shortened([*map(str, range(count))]),
            {1: "0", 6: "0, 1, 2, 3, 4, 5", 7: "0, 1, 2, ... 6 (7)"},
        ),
        (
            lambda count: value_text([*range(count)]),
            {0: "[]", 4: "[0, 1, 2, 3]", 5: "[0, 1, 2, 3, ... 5 in all]"},
        ),
        (lambda count: counted(count, "trial"), {0: "0 trials", 1: "1 trial"}),
    ],
)
def test_a_number_has_its_text(text, values):
    assert {value: text(value) for value in values} == values
