"""The table model: what a terminal, Markdown and JSON show of the same rows."""

from __future__ import annotations

import json
from dataclasses import dataclass
from io import StringIO

import pytest
from hypothesis import example, given, settings, strategies as st
from rich.console import Console

from gauge_envs.pages.document import Terminal, as_markdown, as_rows
from gauge_envs.pages.table import Column, Facts, Place, Table
from gauge_envs.pages.text import score_text

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
    return stream.getvalue().splitlines()


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


def test_json_has_the_rows_themselves():
    assert json.loads(json.dumps(as_rows(TABLE), allow_nan=False)) == list(ROWS)


def test_rows_can_be_objects():
    @dataclass
    class Row:
        name: str
        size: float

    table = Table(
        columns=(Column("name", "name"), Column("size", "size", unit="m")),
        rows=[Row("cube", 0.05)],
    )
    assert printed(table) == ["name  size [m]", "cube  0.05"]
    assert as_rows(table) == [{"name": "cube", "size": 0.05}]


def test_a_table_without_rows_or_for_wide_terminals_alone():
    assert printed(Table(columns=TABLE.columns, rows=())) == ["none"]
    table = Table(columns=(Column("a", "a"),), rows=[{"a": 1}], wide_only=True)
    assert printed(table) == []
    assert printed(table, wide=True) == ["a", "1"]


NAMED = Table(
    columns=(
        Column("name", "phenomenon"),
        *(Column(key, key, is_number=True) for key in ("reality", "default", "this")),
    ),
    rows=[
        {
            "name": "friction of wood on a board of ten degrees",
            "reality": 1,
            "default": 2,
            "this": 3,
        },
        {"name": "rest", "reality": 10, "default": 20, "this": 30},
    ],
)


def test_a_long_first_cell_gets_lines_of_its_own():
    assert printed(NAMED, 45) == [
        "phenomenon             reality  default  this",
        "friction of wood on a board of ten degrees",
        "                             1        2     3",
        "rest                        10       20    30",
    ]


def test_columns_that_do_not_fit_are_written_below_the_row():
    assert printed(NAMED, 30) == [
        "phenomenon       reality",
        "friction of wood on a board of",
        "ten degrees",
        "                       1",
        "    default: 2; this: 3",
        "rest                  10",
        "    default: 20; this: 30",
    ]


def test_long_titles_are_wrapped_at_blanks():
    columns = (
        Column("a", "metric"),
        Column("b", "mujoco, contact_solimp=0.95", is_number=True),
        Column("c", "newton"),
    )
    assert printed(
        Table(columns=columns, rows=[{"a": "RMSE", "b": "1.23", "c": "4.56"}])
    ) == [
        "                    mujoco,",
        "metric  contact_solimp=0.95  newton",
        "RMSE                   1.23  4.56",
    ]


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


def test_facts_have_their_texts_beside_the_names_and_long_names_above():
    facts = Facts(
        {"episode": "19 frames at 30 Hz", "floor with torso, head and 5 more": "0.02 1"}
    )
    assert printed(facts, 24) == [
        "episode  19 frames at 30",
        "         Hz",
        "floor with torso, head",
        "and 5 more",
        "         0.02 1",
    ]


@pytest.mark.parametrize("text", ["[red]", "[/]", "a [b] c"])
def test_brackets_are_text(text):
    assert printed(Table(columns=(Column("a", text),), rows=[{"a": text}])) == [
        text,
        text,
    ]
