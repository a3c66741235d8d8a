"""Commands of a checkout.

python -m scripts build               writes the generated pages, after a task or an engine has changed
python -m scripts build NAME ...      writes those of some builders, as `assets`, `pictures` and `cheat_sheet`
python -m scripts conformance FILE ... joins results of `gauge backend check --out` in `scoring/conformance.json`
python -m scripts matrix ENTRY ...    tests the wheel on several versions of Python
python -m scripts release             rehearses a release
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from gauge_envs.files import write_whole
from gauge_envs.tools.assets.build import assets_folder, build_assets
from scripts import (
    build_cheat_sheet,
    build_conformance,
    build_coverage,
    build_environments,
    build_hero,
    build_sanity,
    build_surface,
    release,
    test_matrix,
)
from scripts.generated import ROOT, same_text

PAGES: Mapping[str, Callable[[], Mapping[Path, str]]] = {
    "conformance": build_conformance.contents,
    "coverage": build_coverage.contents,
    "environments": build_environments.contents,
    "surface": build_surface.contents,
}
"""Builders that return their files with the text of each, in seconds."""

DRAWN: Mapping[str, Callable[[], object]] = {
    "assets": lambda: build_assets(assets_folder()),
    "pictures": build_environments.draw_missing,
    "cheat_sheet": build_cheat_sheet.draw,
    "engines": build_conformance.draw,
    "hero": build_hero.draw,
    "sanity": build_sanity.draw,
}
"""Builders of scenes in `assets/`, deleted pictures of families, the cheat sheet, the chart, and pictures of pages."""


def build(names: Sequence[str]) -> None:
    """Write the files of builders, and print the changed files."""
    for name in names:
        if name in DRAWN:
            DRAWN[name]()
            continue
        for file, text in PAGES[name]().items():
            if same_text(file.read_text("utf-8") if file.is_file() else "", text):
                continue
            write_whole(file, text.encode())
            print(file.relative_to(ROOT))


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    result = argparse.ArgumentParser(
        prog="python -m scripts",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = result.add_subparsers(dest="command", required=True)
    pages = commands.add_parser("build", help="write generated files")
    pages.add_argument("names", nargs="*", choices=[[], *PAGES, *DRAWN], metavar="NAME")
    results = commands.add_parser("conformance", help="join results of checks")
    results.add_argument("files", nargs="+", type=Path, metavar="FILE")
    matrix = commands.add_parser("matrix", help="test the wheel on versions of Python")
    matrix.add_argument("entries", nargs="+", metavar="VERSION:RESOLUTION")
    matrix.add_argument("--tests", nargs="+", required=True)
    matrix.add_argument(
        "--rigid-tests",
        nargs="+",
        required=True,
        help="those that pass with the lowest MuJoCo",
    )
    commands.add_parser("release", help="rehearse a release")
    return result


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; return its exit status."""
    options = parser().parse_args(arguments)
    if options.command == "matrix":
        return test_matrix.main(options.entries, options.tests, options.rigid_tests)
    if options.command == "conformance":
        build_conformance.join(options.files)
        return 0
    if options.command == "release":
        return release.main()
    build(options.names or list(PAGES))
    return 0


if __name__ == "__main__":
    sys.exit(main())
