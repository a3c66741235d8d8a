"""What scripts that generate files share: tables, parts of pages between marks, and writing or checking files."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from gauge_envs.files import write_whole

ROOT = Path(__file__).parents[1]
SCORING = ROOT / "scoring"


def with_part(page: str, name: str, script: str, part: str) -> str:
    """Return a page whose generated part of a name is replaced.

    The part stands between the lines `<!-- NAME, written by scripts/SCRIPT -->` and `<!-- end of NAME -->`.

    Raises:
        ValueError: The page does not have both lines, once each and in order.
    """
    begin, end = f"<!-- {name}, written by scripts/{script} -->", f"<!-- end of {name} -->"
    before, first, rest = page.partition(begin)
    _, last, after = rest.partition(end)
    if not (first and last) or begin in after:
        raise ValueError(f"the page needs the lines {begin!r} and {end!r} once each")
    return f"{before}{begin}\n\n{part.strip()}\n\n{end}{after}"


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    """Yield the lines of a table in Markdown, with cells as they are."""
    for cells in (head, ["---"] * len(head), *rows):
        yield f"| {' | '.join(cells)} |"


def settle(files: Mapping[Path, str], script: str, *, check: bool) -> int:
    """Write files, or check that they are current.

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
    stale = [file for file, text in files.items() if not file.is_file() or file.read_text(encoding="utf-8") != text]
    for file in stale:
        print(f"{file} is not current: run python scripts/{script}", file=sys.stderr)
    return 1 if stale else 0


def write_or_check(
    generate: Callable[[Path], Mapping[Path, str]], *, script: str, what: str, arguments: Sequence[str] | None
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
    parser.add_argument("--check", action="store_true", help="write nothing; fail if a file is not current")
    parser.add_argument("--scoring", type=Path, default=SCORING, help="folder of the data")
    options = parser.parse_args(arguments)
    return settle(generate(options.scoring), script, check=options.check)
