"""Command line of scripts that generate data files: write them, or check that they are current."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

__all__ = ["write_or_check"]


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
    parser.add_argument(
        "--scoring", type=Path, default=Path(__file__).parents[1] / "scoring", help="folder of the data"
    )
    options = parser.parse_args(arguments)
    files = generate(options.scoring)
    if not options.check:
        for file, text in files.items():
            file.write_text(text, encoding="utf-8", newline="\n")
        return 0
    stale = [file for file, text in files.items() if not file.is_file() or file.read_text(encoding="utf-8") != text]
    for file in stale:
        print(f"{file} is not current: run python scripts/{script}", file=sys.stderr)
    return 1 if stale else 0
