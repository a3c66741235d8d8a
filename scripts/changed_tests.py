"""Run the tests nearest to what has changed since the last commit or, where nothing has, since main.

    python -m scripts.changed_tests                   the nearest tests, for 40 s
    python -m scripts.changed_tests --since HEAD~3    what has changed since another commit
    python -m scripts.changed_tests --list            print the test files and their distances

A test file is near where it has changed itself, lies in the folder of `tests/` that mirrors the one that changed, or
imports what changed, directly or through others. A file that is no module is near to the tests that name it.
"""

from __future__ import annotations

import argparse
import ast
import os
import subprocess
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
ROOTS = {"gauge_envs": ROOT, "scripts": ROOT, "tests": ROOT / "tests"}
"""Folders with Python files, and the folder that names of their modules start from."""

TESTS = "tests/**/test_*.py"

SHARED = ("tests/conftest.py",)
"""Files that every test uses; what imports them is as far away as can be."""

FAR = 9
"""Largest count of imports between a change and a test."""

MOST_FILES = 40
"""Largest number of test files that are collected."""

END_VARIABLE = "GAUGE_CHECK_END"
"""Environment variable with the time at which no further test begins, of a clock that all processes share [s]."""

TOO_LATE = "the time is over"


def git(*words: str) -> list[str]:
    """Return the lines that git prints."""
    done = subprocess.run(
        ["git", *words], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return done.stdout.splitlines()


def changed_files(since: str | None) -> list[str]:
    """Return the paths of files that differ from a commit, new ones included."""
    new = git("ls-files", "--others", "--exclude-standard")
    if since is None:
        edited = git("diff", "--name-only", "HEAD")
        if edited or new:
            return [*edited, *new]
        since = git("merge-base", "main", "HEAD")[0]
    return [*git("diff", "--name-only", since), *new]


def module_files() -> dict[str, str]:
    """Return the path of each module of the package, the scripts and the tests."""
    found = {}
    for folder, root in ROOTS.items():
        for file in sorted((ROOT / folder).rglob("*.py")):
            parts = file.relative_to(root).with_suffix("").parts
            name = ".".join(part for part in parts if part != "__init__")
            found[name] = file.relative_to(ROOT).as_posix()
    return found


def imported_names(text: str) -> Iterator[str]:
    """Yield the names of modules that a file may import, those inside functions included."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            yield from (one.name for one in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{one.name}" for one in node.names)


def importers() -> dict[str, set[str]]:
    """Return the files that import each file directly."""
    files = module_files()
    found: dict[str, set[str]] = defaultdict(set)
    for path in files.values():
        for name in imported_names((ROOT / path).read_text(encoding="utf-8")):
            if name in files and path not in SHARED:
                found[files[name]].add(path)
    return found


def by_imports(path: str, edges: Mapping[str, set[str]]) -> dict[str, int]:
    """Return the files that import a file, itself included, and how many imports they are away."""
    found = {path: 0}
    layer = {path}
    for distance in range(1, FAR):
        layer = {far for one in layer for far in edges.get(one, ())} - found.keys()
        found |= dict.fromkeys(layer, distance)
    return found


def by_names(path: str, test: str, text: str) -> int:
    """Return the distance of a test by its folder and by the names in its text."""
    folder, *inner = Path(path).parent.parts or ("",)
    mirror = "/".join(["tests", *inner, ""])
    if folder == "gauge_envs" and inner and test.startswith(mirror):
        return 2
    if not path.endswith(".py") and Path(path).name in text:
        return 1
    if path.endswith(".md") and test.startswith("tests/docs/"):
        return 1
    if folder == "tasks" and test.startswith("tests/experiments/"):
        return 2
    return FAR if path in SHARED else FAR + 1


def near_tests(changed: Iterable[str], edges: Mapping[str, set[str]]) -> dict[str, int]:
    """Return the distance of each test file from what changed, nearest first."""
    tests = [path.relative_to(ROOT).as_posix() for path in ROOT.glob(TESTS)]
    texts = {path: (ROOT / path).read_text(encoding="utf-8") for path in tests}
    found: dict[str, int] = {}
    for path in changed:
        imports = by_imports(path, edges)
        for test, text in texts.items():
            near = min(imports.get(test, FAR + 1), by_names(path, test, text))
            if near <= FAR:
                found[test] = min(near, found.get(test, near))
    return dict(sorted(found.items(), key=lambda entry: (entry[1], entry[0])))


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip a test that would begin after the end, in each worker."""
    if time.monotonic() > float(os.environ[END_VARIABLE]):
        pytest.skip(TOO_LATE)


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Name the files whose tests did not all run."""
    late = [
        report.nodeid.partition("::")[0]
        for report in terminalreporter.stats.get("skipped", ())
        if TOO_LATE in str(report.longrepr)
    ]
    if late:
        terminalreporter.write_line(f"{TOO_LATE}; not run:")
    for path, count in Counter(late).items():
        terminalreporter.write_line(f"  {count} of {path}")


def run(tests: Sequence[str], seconds: float) -> int:
    """Run test files in their order until the time is over; return the exit status of pytest."""
    os.environ[END_VARIABLE] = str(time.monotonic() + seconds)
    for path in tests[MOST_FILES:]:
        print(f"too far away: {path}")
    options = ["-n", "2", "--dist", "loadfile", "--no-loadscope-reorder"]
    words = [*options, "-p", "scripts.changed_tests", *tests[:MOST_FILES]]
    return subprocess.run(
        [sys.executable, "-m", "pytest", *words], cwd=ROOT, check=False
    ).returncode


def main(arguments: Iterable[str] | None = None) -> int:
    """Run the tests; return their exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--since", help="commit; that of HEAD, or where main branches")
    parser.add_argument("--seconds", type=float, default=40.0, help="time for tests")
    parser.add_argument("--list", action="store_true", help="run nothing")
    options = parser.parse_args(arguments)
    found = near_tests(changed_files(options.since), importers())
    if options.list or not found:
        print("\n".join(f"{far} {path}" for path, far in found.items()) or "no tests")
        return 0
    return run(list(found), options.seconds)


if __name__ == "__main__":
    sys.exit(main())
