"""Common code of the builders: tables, parts of pages between marks, and the comparison of texts."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

ROOT = Path(__file__).parents[1]
SCORING = ROOT / "scoring"

NUMBER = re.compile(r"(?<![\w.])([-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?)(?!\w|\.\d)")
"""A number that stands alone: no part of a name, of a version or of a hash."""

LARGEST_UNIT = 1e-3
"""Largest last place, as a share of a number or of one, that may differ. Numbers with fewer digits must be equal."""

ROUND_OFF = 1e-9
"""Relative difference between processors of numbers that are printed with all their digits."""


def with_part(page: str, name: str, script: str, part: str) -> str:
    """Return a page with the generated part of a name replaced.

    The part is between the lines `<!-- NAME, written by SCRIPT -->` and `<!-- end of NAME -->`.

    Raises:
        ValueError: The page does not have both lines, once each and in order.
    """
    begin, end = f"<!-- {name}, written by {script} -->", f"<!-- end of {name} -->"
    before, first, rest = page.partition(begin)
    _, last, after = rest.partition(end)
    if not (first and last) or begin in after:
        raise ValueError(f"the page needs the lines {begin!r} and {end!r} once each")
    return f"{before}{begin}\n\n{part.strip()}\n\n{end}{after}"


def page_part(file: Path, name: str, script: str, part: str) -> dict[Path, str]:
    """Return a page by its file, with the generated part of a name replaced as `with_part` does it."""
    return {file: with_part(file.read_text(encoding="utf-8"), name, script, part)}


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    """Yield the lines of a table in Markdown, with cells as they are."""
    for cells in (head, ["---"] * len(head), *rows):
        yield f"| {' | '.join(cells)} |"


def same_text(stored: str, generated: str) -> bool:
    """Return whether two texts are equal, but for the last printed place of numbers.

    Processors and libraries round sums differently, which may turn over the last place that is printed. Words, spaces
    and whole numbers must be equal.
    """
    # `split` yields the text between numbers at even places and the numbers at odd ones.
    old, new = NUMBER.split(stored), NUMBER.split(generated)
    return (
        len(old) == len(new)
        and old[::2] == new[::2]
        and all(map(_same_number, old[1::2], new[1::2]))
    )


def _same_number(stored: str, generated: str) -> bool:
    if stored == generated:
        return True
    old, new = float(stored), float(generated)
    difference, size = abs(old - new), max(abs(old), abs(new))
    # A number whose last digits are zeros may be printed without them: the longer one tells where digits end.
    unit = min(_last_place(stored), _last_place(generated))
    if unit > LARGEST_UNIT * max(size, 1.0) or unit >= 1.0:
        return False
    # Both are multiples of the unit, but for the rounding of binary numbers.
    return difference < 1.5 * unit or difference <= ROUND_OFF * size


def _last_place(number: str) -> float:
    """Return the value of one unit in the last printed place."""
    digits, _, exponent = number.lower().partition("e")
    decimals = len(digits.partition(".")[2])
    return float(10.0 ** (int(exponent or 0) - decimals))
