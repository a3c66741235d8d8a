"""Which test covers which line, and tests run in forks of a process that has the imports of others behind it."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import coverage
import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = "gauge_envs"
# What a fork need not import again.
IMPORTS = (
    "coverage gymnasium hypothesis mujoco numpy PIL.Image pydantic pytest rich.table scipy.interpolate scipy.optimize "
    "scipy.spatial.transform scipy.stats trimesh typer"
)
PYTEST = ("-q", "-p", "no:cacheprovider", "-p", "no:xdist", "--no-header")


@dataclass
class Covered:
    """What the tests of one file cover: lines of the package by test, and the seconds of each passing test."""

    file: str
    collection: float
    seconds: dict[str, float]
    lines: dict[str, dict[int, list[str]]]
    imported: dict[str, list[int]]

    def tests(self, path: str, lines: range) -> set[str]:
        """Return the tests that run a line, or that use the module if the lines run at its import."""
        by_line = self.lines.get(path, {})
        found = {test for line in lines for test in by_line.get(line, ())}
        if not found and not set(lines).isdisjoint(self.imported.get(path, ())):
            found = {test for tests in by_line.values() for test in tests}
            found = found or set(self.seconds)
        return found & set(self.seconds)


@dataclass(eq=False)
class Recorder:
    """A plugin of pytest: a context of the coverage for each test, and for each fixture that several tests share."""

    coverage: Any
    seconds: dict[str, float] = field(default_factory=dict)
    failed: set[str] = field(default_factory=set)
    users: dict[str, list[str]] = field(default_factory=dict)
    context: str = ""
    collection: float = 0.0

    def pytest_collection_finish(self, session: Any) -> None:
        """Note which tests use a fixture."""
        self.collection = time.process_time()
        for item in session.items:
            for name in item.fixturenames:
                self.users.setdefault(f"@{name}", []).append(item.nodeid)

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        """Begin the context of a test."""
        self.context = nodeid
        self.coverage.switch_context(nodeid)

    def pytest_runtest_logfinish(self) -> None:
        """End the context of a test."""
        self.coverage.switch_context("")

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any) -> Iterator[None]:
        """Give a fixture that several tests share a context of its own."""
        if fixturedef.scope != "function":
            self.coverage.switch_context(f"@{fixturedef.argname}")
        value = yield
        self.coverage.switch_context(self.context)
        return value

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Add up the seconds of a test and note whether it failed."""
        before = self.seconds.get(report.nodeid, 0.0)
        self.seconds[report.nodeid] = before + report.duration
        if report.outcome != "passed":
            self.failed.add(report.nodeid)


@dataclass(eq=False)
class Selection:
    """A plugin of pytest that leaves the named tests, in their order."""

    tests: list[str]

    def pytest_collection_modifyitems(self, items: list[Any]) -> None:
        """Leave the named tests."""
        order = {test: number for number, test in enumerate(self.tests)}
        items[:] = [item for item in items if item.nodeid in order]
        items.sort(key=lambda item: order[item.nodeid])


def copy_tree(target: Path) -> None:
    """Bring the copy of the repository up to date: what git knows or does not ignore."""
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard", "-z"],
        cwd=ROOT,
        check=True,
        capture_output=True,
    )
    names = [name for name in listed.stdout.decode().split("\0") if name]
    present = {name for name in names if (ROOT / name).is_file()}
    for file in [*target.rglob("*")]:
        if file.is_file() and str(file.relative_to(target)) not in present:
            file.unlink()
    for name in present:
        source, copy = ROOT / name, target / name
        copy.parent.mkdir(parents=True, exist_ok=True)
        if not copy.exists() or copy.read_bytes() != source.read_bytes():
            shutil.copy2(source, copy)


def fork(work: Callable[[], int], tree: Path, limit: float, log: Path) -> int:
    """Return the exit code of work done in a fork, below zero if a limit of seconds ended it."""
    child = os.fork()
    if not child:
        os.setpgid(0, 0)
        os.chdir(tree)
        sys.path[:] = [str(tree), *(entry for entry in sys.path if entry != str(ROOT))]
        os.environ["PYTHONPATH"] = str(tree)
        resource.setrlimit(resource.RLIMIT_CPU, (int(limit), int(limit) + 5))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        stream = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(stream, 1)
        os.dup2(stream, 2)
        code = 3
        try:
            code = work()
        finally:
            sys.stdout.flush()
            os._exit(code)
    end = time.monotonic() + 5 * limit
    while True:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            break
        if time.monotonic() > end:
            os.killpg(child, signal.SIGKILL)
        time.sleep(0.05)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    return os.waitstatus_to_exitcode(status)


def warm() -> None:
    """Import what each fork needs."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    for module in IMPORTS.split():
        __import__(module)


def _record(file: str, out: Path, tree: Path) -> int:
    measured = coverage.Coverage(
        data_file=None, config_file=False, source=[str(tree / PACKAGE)]
    )
    measured.start()
    recorder = Recorder(measured)
    started = time.process_time()
    pytest.main([file, *PYTEST], plugins=[recorder])
    measured.stop()
    data = measured.get_data()
    lines: dict[str, dict[int, list[str]]] = {}
    imported: dict[str, list[int]] = {}
    for path in data.measured_files():
        name = str(Path(path).relative_to(tree))
        for line, contexts in data.contexts_by_lineno(path).items():
            if "" in contexts:
                imported.setdefault(name, []).append(line)
            tests = {
                test
                for context in contexts
                if context
                for test in recorder.users.get(context, [context])
            }
            if tests:
                lines.setdefault(name, {})[line] = sorted(tests)
    seconds = {
        test: round(time, 3)
        for test, time in recorder.seconds.items()
        if test not in recorder.failed
    }
    out.write_text(
        json.dumps(
            {
                "file": file,
                "collection": round(recorder.collection - started, 2),
                "seconds": seconds,
                "lines": lines,
                "imported": imported,
            }
        )
    )
    return 0


def covered(state: Path) -> list[Covered]:
    """Return what each file of tests covers; a file that did not change since is not run again."""
    tree = state / "tree"
    (state / "coverage").mkdir(parents=True, exist_ok=True)
    return [
        _covered(state, tree, str(path.relative_to(tree)))
        for path in sorted((tree / "tests").rglob("test_*.py"))
    ]


def _covered(state: Path, tree: Path, file: str) -> Covered:
    mark = hashlib.sha256(file.encode() + (tree / file).read_bytes()).hexdigest()[:16]
    out = state / "coverage" / f"{mark}.json"
    if not out.exists():
        started = time.monotonic()
        log = state / "coverage.log"
        code = fork(lambda: _record(file, out, tree), tree, 1000, log)
        print(f"{time.monotonic() - started:6.1f} s  {file}  {code}", flush=True)
    if not out.exists():
        return Covered(file, 0, {}, {}, {})
    read = json.loads(out.read_text())
    for path, by_line in read["lines"].items():
        read["lines"][path] = {int(line): tests for line, tests in by_line.items()}
    return Covered(**read)
