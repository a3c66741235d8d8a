"""Commands of a checkout.

python -m scripts build                  writes the generated files that follow from data
python -m scripts build NAME             writes those of a row of generated.toml; it says where that simulates for hours
python -m scripts build --check [NAME]   writes nothing; names each file that is not current, why, and what to do
python -m scripts build --list           what is generated, from what, and what that takes
python -m scripts versions               writes newest_versions.txt, after the tests have passed with what is installed
python -m scripts matrix ENTRY ...       tests the wheel on several versions of Python
python -m scripts size [FOLDER]          tokens of each room
"""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from gauge_envs.files import write_whole
from scripts import newest_versions, size, test_matrix
from scripts.generated import ROOT, Request, stale_files
from scripts.inputs import PACKAGES, Row, record, rows, staleness


def builder_of(row: Row) -> Any:
    """Return the module that writes the files of a row."""
    is_script = "." not in row.builder
    return importlib.import_module(
        f"scripts.{row.builder}" if is_script else row.builder
    )


def not_current(row: Row) -> Iterator[str]:
    """Yield what is wrong with the files of a row, and what to do."""
    for pattern in row.patterns():
        if not any(ROOT.glob(pattern)):
            yield f"{pattern}: no such file"
    if row.measured:
        if text := staleness(row):
            yield text
    else:
        try:
            contents = builder_of(row).contents()
        except ValueError as error:
            yield f"{row.name}: {error}"
            return
        for file in stale_files(contents):
            name = file.relative_to(ROOT) if file.is_relative_to(ROOT) else file
            yield f"{name} is not current: run python -m scripts build {row.name}"


def check(chosen: Sequence[Row]) -> int:
    """Print what is not current; return the exit status."""
    found = [fault for row in chosen for fault in not_current(row)]
    for fault in found:
        print(fault, file=sys.stderr)
    return int(bool(found))


def build(chosen: Sequence[Row], options: argparse.Namespace) -> int:
    """Write the files of rows; return the exit status."""
    for row in chosen:
        if row.measured and not options.accept:
            if not row.builder:
                print(f"{row.name}: {row.command}", file=sys.stderr)
                return 1
            request = Request(
                results=options.results or ROOT / "results" / row.name,
                engines=tuple(options.engine),
                ids=tuple(options.ids),
            )
            builder_of(row).measure(request)
            if options.engine or options.ids != ["*"]:
                print(
                    "Not recorded, as only a part was measured. After the rest: "
                    f"python -m scripts build {row.name} --accept"
                )
                continue
        if row.measured:
            record(row)
            continue
        contents = builder_of(row).contents()
        for file in stale_files(contents):
            write_whole(file, contents[file].encode())
            print(file.relative_to(ROOT))
    return 0


def listing(chosen: Sequence[Row]) -> Iterator[str]:
    """Yield what is generated, from what, and what that takes."""
    for row in chosen:
        parts = {
            "tasks": row.tasks,
            "references": row.references,
            "engines": row.engines,
            "scores": ("constants",) if row.scores else (),
            "packages": row.packages,
            "inputs": row.inputs,
        }
        yield f"{row.name}: {row.builder or row.command} ({row.cost})"
        yield f"    writes {', '.join(row.writes)}"
        for name, values in parts.items():
            if values:
                yield f"    {name} {', '.join(values)}"


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    found = argparse.ArgumentParser(
        prog="python -m scripts",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = found.add_subparsers(dest="command", required=True)
    one = commands.add_parser("build", help="write or check generated files")
    one.add_argument("names", nargs="*", metavar="NAME", help="rows of generated.toml")
    one.add_argument("--check", action="store_true", help="write nothing")
    one.add_argument("--list", action="store_true", help="print the rows")
    one.add_argument(
        "--accept",
        action="store_true",
        help="measure nothing; state that measured files are those of the inputs of today",
    )
    one.add_argument("--results", type=Path, help="folder that keeps results")
    one.add_argument(
        "--engine", action="append", default=[], choices=PACKAGES, help="only this one"
    )
    one.add_argument("--ids", nargs="+", default=["*"], help="patterns of variants")
    commands.add_parser("versions", help="write newest_versions.txt")
    matrix = commands.add_parser("matrix", help="test the wheel on versions of Python")
    matrix.add_argument(
        "entries", nargs="+", type=test_matrix.Entry.parse, metavar="VERSION:RESOLUTION"
    )
    matrix.add_argument("--tests", nargs="+", required=True)
    matrix.add_argument(
        "--rigid-tests",
        nargs="+",
        required=True,
        help="those that pass with the lowest MuJoCo",
    )
    sizes = commands.add_parser("size", help="print the tokens of each room")
    sizes.add_argument("folder", nargs="*", help="another checkout")
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; return its exit status."""
    options = parser().parse_args(arguments)
    if options.command == "versions":
        newest_versions.main()
        return 0
    if options.command == "matrix":
        return test_matrix.main(options.entries, options.tests, options.rigid_tests)
    if options.command == "size":
        size.main(options.folder)
        return 0
    table = rows()
    if unknown := set(options.names) - table.keys():
        print(f"no row {', '.join(unknown)} in generated.toml", file=sys.stderr)
        return 2
    named = [table[name] for name in options.names]
    if options.list:
        print("\n".join(listing(named or list(table.values()))))
        return 0
    if options.check:
        return check(named or list(table.values()))
    return build(named or [row for row in table.values() if not row.measured], options)


if __name__ == "__main__":
    sys.exit(main())
