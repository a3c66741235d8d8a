"""What scripts that generate files share: tables, parts of pages between marks, and writing or checking files."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gauge_envs.files import write_whole

ROOT = Path(__file__).parents[1]
SCORING = ROOT / "scoring"

NUMBER = re.compile(r"(?<![\w.])([-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?)(?!\w|\.\d)")
"""A number that stands alone: no part of a name, of a version or of a hash."""

LARGEST_UNIT = 1e-3
"""Largest last place, as a share of a number or of one, that may differ. Numbers with fewer digits must be equal."""

ROUND_OFF = 1e-9
"""Relative difference between processors of numbers that are printed with all their digits."""

INDICES = ("first", "source_number")
"""Arrays of an archive that say which rows belong to which trial."""


def with_part(page: str, name: str, script: str, part: str) -> str:
    """Return a page whose generated part of a name is replaced.

    The part stands between the lines `<!-- NAME, written by scripts/SCRIPT -->` and `<!-- end of NAME -->`.

    Raises:
        ValueError: The page does not have both lines, once each and in order.
    """
    begin, end = (
        f"<!-- {name}, written by scripts/{script} -->",
        f"<!-- end of {name} -->",
    )
    before, first, rest = page.partition(begin)
    _, last, after = rest.partition(end)
    if not (first and last) or begin in after:
        raise ValueError(f"the page needs the lines {begin!r} and {end!r} once each")
    return f"{before}{begin}\n\n{part.strip()}\n\n{end}{after}"


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


def same_arrays(
    stored: Mapping[str, NDArray[np.generic]],
    generated: Mapping[str, NDArray[np.generic]],
    *,
    fitted: float = 1e-6,
) -> bool:
    """Return whether two archives have the same arrays.

    Args:
        stored: Arrays of the file.
        generated: Arrays that the script computes.
        fitted: Absolute and relative tolerance of floats, which are fitted. Counts, which were rounded, may differ by
            one, and indices must be equal.
    """

    def same(name: str) -> bool:
        old, new = stored[name], generated[name]
        if old.shape != new.shape or old.dtype != new.dtype:
            return False
        if not np.issubdtype(old.dtype, np.integer):
            return np.allclose(old, new, rtol=fitted, atol=fitted)
        step = 0 if name in INDICES else 1
        return bool(np.all(np.abs(old.astype(np.int64) - new.astype(np.int64)) <= step))

    return set(stored) == set(generated) and all(map(same, generated))


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


def settle(files: Mapping[Path, str], script: str, *, check: bool) -> int:
    """Write files, or check that they are current by `same_text`.

    Args:
        files: Each file with its text.
        script: File name of the script with the options that write the files.
        check: Write nothing.

    Returns:
        Exit status: 1 if a check found a file that is missing or not current.
    """
    if not check:
        for file, text in files.items():
            write_whole(file, text.encode())
        return 0
    stale = [
        file
        for file, text in files.items()
        if not file.is_file() or not same_text(file.read_text(encoding="utf-8"), text)
    ]
    for file in stale:
        print(f"{file} is not current: run python scripts/{script}", file=sys.stderr)
    return 1 if stale else 0


def write_or_check(
    generate: Callable[[Path], Mapping[Path, str]],
    *,
    script: str,
    what: str,
    arguments: Sequence[str] | None,
) -> int:
    """Run the command line of a script that generates files from the data in `scoring/`.

    Args:
        generate: Function that returns every generated file with its text, for a folder of data.
        script: File name of the script.
        what: Description of the script for its help.
        arguments: Command line arguments; None takes those of the process.

    Returns:
        Exit status: 1 if a check found a file that is missing or not current.
    """
    parser = argparse.ArgumentParser(description=what)
    parser.add_argument(
        "--check",
        action="store_true",
        help="write nothing; fail if a file is not current",
    )
    parser.add_argument(
        "--scoring", type=Path, default=SCORING, help="folder of the data"
    )
    options = parser.parse_args(arguments)
    return settle(generate(options.scoring), script, check=options.check)
