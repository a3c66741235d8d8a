"""Draw `docs/cheat_sheet.md` on one page of A4, `docs/images/cheat_sheet.pdf`."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from scripts.generated import ROOT

PAGE = ROOT / "docs" / "cheat_sheet.md"
FILE = ROOT / "docs" / "images" / "cheat_sheet.pdf"

WIDTH_IN, HEIGHT_IN = 8.27, 11.69
"""A4, upright."""
MARGIN_IN = 0.4
LINE_IN = 0.2
FONT_PT = 9.5
CODE_PT = 8.6
TITLE_PT = 18.0

NAME_CHARACTERS = 34
"""Characters in a line of the first column of a table."""
TEXT_CHARACTERS = 64
"""Characters in a line of the other column."""
NAME_IN = 2.6
"""Width of the first column of a table."""


@dataclass(frozen=True)
class Block:
    """A table or a program of the page.

    Attributes:
        rows: Cells of the rows; a line of a program is a row with one cell.
        is_code: Whether it is a program.
    """

    rows: tuple[tuple[str, ...], ...]
    is_code: bool


def blocks(text: str) -> Iterator[Block]:
    """Yield the tables and programs of a page in Markdown."""
    for part in re.split(r"\n{2,}(?=[|`])|(?<=```)\n", text):
        if part.startswith("```python\n"):
            lines = part.removeprefix("```python\n").removesuffix("```").splitlines()
            yield Block(tuple((line,) for line in lines), is_code=True)
        elif part.startswith("|"):
            rows = [line.strip("| ").split(" | ") for line in part.splitlines()]
            yield Block(tuple(map(tuple, [rows[0], *rows[2:]])), is_code=False)


class Sheet:
    """Lines from the top of a page downwards."""

    def __init__(self) -> None:
        self.figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN))
        self._y_in = HEIGHT_IN - MARGIN_IN

    def down(self, lines: float) -> None:
        """Go down by some lines."""
        self._y_in -= lines * LINE_IN

    def text(
        self, lines: Sequence[str], *, indent_in: float = 0.0, **font: Any
    ) -> None:
        """Draw lines from the current height downwards."""
        for number, line in enumerate(lines):
            x = (MARGIN_IN + indent_in) / WIDTH_IN
            y = (self._y_in - number * LINE_IN) / HEIGHT_IN
            # A dollar starts a formula in matplotlib.
            escaped = line.replace("$", r"\$")
            self.figure.text(x, y, escaped, va="top", **{"fontsize": FONT_PT, **font})

    def draw(self, block: Block) -> None:
        """Draw a table or a program, and go below it."""
        for index, row in enumerate(block.rows):
            if block.is_code:
                self.text(row, family="monospace", fontsize=CODE_PT)
                self.down(1.0)
                continue
            is_code = row[1].startswith("`")
            font = {"family": "monospace", "fontsize": CODE_PT} if is_code else {}
            weight = "normal" if index else "bold"
            name = textwrap.wrap(row[0].replace("`", ""), NAME_CHARACTERS)
            text = textwrap.wrap(row[1].replace("`", ""), TEXT_CHARACTERS)
            self.text(name, weight=weight)
            self.text(text, indent_in=NAME_IN, weight=weight, **font)
            self.down(max(len(name), len(text)) + 0.25)
        self.down(1.0)


def draw() -> Path:
    """Draw the page, and return its file."""
    sheet = Sheet()
    sheet.text(["gauge-envs cheat sheet"], fontsize=TITLE_PT, weight="bold")
    sheet.down(2.5)
    for block in blocks(PAGE.read_text(encoding="utf-8")):
        sheet.draw(block)
    # Without its date the file depends on the text alone.
    sheet.figure.savefig(FILE, metadata={"CreationDate": None})
    return FILE
