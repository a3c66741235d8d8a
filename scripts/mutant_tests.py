"""Tests that run in forks: which test covers which line, and whether tests notice a fault."""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import coverage
import pytest

ROOT = Path(__file__).parents[1]
CONSOLE = os.dup(1)
PACKAGE = "gauge_envs"
PYTEST = ("-q", "-p", "no:cacheprovider", "-p", "no:xdist", "--no-header")


@dataclass
class Covered:
    """What the tests of one file cover: lines of the package by test, and the CPU seconds of each passing test."""

    file: str
    seconds: dict[str, float] = field(default_factory=dict)
    lines: dict[str, dict[str, list[str]]] = field(default_factory=dict)
    # Digests of the modules at that time.
    modules: dict[str, str] = field(default_factory=dict)

    def tests(self, path: str, lines: Iterable[int]) -> set[str]:
        """Return the tests that run a line."""
        by_line = self.lines.get(path, {})
        return {test for line in lines for test in by_line.get(str(line), ())} & set(
            self.seconds
        )

    def users(self, path: str) -> set[str]:
        """Return the tests that run any function of a module."""
        return self.tests(path, map(int, self.lines.get(path, ())))


@dataclass(eq=False)
class Recorder:
    """A plugin of pytest: a context of the coverage for each test, and for each fixture that several tests share."""

    coverage: Any
    # Tests by the fixtures that they use.
    users: dict[str, list[str]] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    failed: set[str] = field(default_factory=set)
    context: str = ""
    started_s: float = 0.0

    def pytest_collection_finish(self, session: Any) -> None:
        """Note the fixtures of each test."""
        for item in session.items:
            for name in item.fixturenames:
                self.users.setdefault(f"@{name}", []).append(item.nodeid)

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        """Begin the context of a test."""
        self.started_s = sum(os.times()[:4])
        self.context = nodeid
        self.coverage.switch_context(nodeid)

    def pytest_runtest_logfinish(self, nodeid: str) -> None:
        """End the context of a test, and note its CPU seconds and those of its children that have ended."""
        self.coverage.switch_context("")
        self.seconds[nodeid] = sum(os.times()[:4]) - self.started_s

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any) -> Iterator[None]:
        """Give a fixture that several tests share a context of its own."""
        if fixturedef.scope != "function":
            self.coverage.switch_context(f"@{fixturedef.argname}")
        value = yield
        self.coverage.switch_context(self.context)
        return value

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Note whether a test failed."""
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


def digest(path: str) -> str:
    """Return a digest of the text of a file."""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()[:16]


def place_of(file: str, state: Path) -> Path:
    """Return where it is kept what a file of tests covers."""
    return state / "coverage" / f"{file.replace('/', '-')}-{digest(file)}.json"


def covered(file: str, path: str, state: Path) -> Covered:
    """Return what a file of tests covers; it is run again if it or a module that it covers has changed since.

    Args:
        file: The file of tests.
        path: The module.
        state: Folder that keeps what was measured.
    """
    place = place_of(file, state)
    if place.exists():
        known = Covered(**json.loads(place.read_text()))
        if known.modules.get(path) in (None, digest(path)):
            return known
    place.parent.mkdir(exist_ok=True)
    started = time.monotonic()
    fork(lambda: measure(file, place), 1000)
    say(f"{time.monotonic() - started:6.1f} s  {file}")
    return Covered(**json.loads(place.read_text())) if place.exists() else Covered(file)


def measure(file: str, out: Path) -> int:
    """Run a file of tests, and write which of them that pass cover which lines; return 0."""
    tree = Path.cwd()
    measured = coverage.Coverage(
        data_file=None, config_file=False, source=[str(tree / PACKAGE)]
    )
    recorder = Recorder(measured)
    measured.start()
    pytest.main([file, *PYTEST], plugins=[recorder])
    measured.stop()
    data = measured.get_data()
    found = Covered(file)
    for path in data.measured_files():
        name = str(Path(path).relative_to(tree))
        for line, contexts in data.contexts_by_lineno(path).items():
            covering = {
                test
                for one in contexts
                if one
                for test in recorder.users.get(one, [one])
            }
            if covering:
                found.lines.setdefault(name, {})[str(line)] = sorted(covering)
    found.seconds = {
        test: round(seconds, 3)
        for test, seconds in recorder.seconds.items()
        if test not in recorder.failed
    }
    found.modules = {path: digest(path) for path in found.lines}
    out.write_text(json.dumps(asdict(found)))
    return 0


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


def say(text: str) -> None:
    """Write a line to the terminal, also where pytest has taken the output away."""
    os.write(CONSOLE, f"{text}\n".encode())


def enter(tree: Path, log: Path) -> None:
    """Work in the copy of the repository from now on, with one thread, and keep the output of tests in a file."""
    stream = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND)
    os.dup2(stream, 1)
    os.dup2(stream, 2)
    os.chdir(tree)
    sys.path[:] = [str(tree), *(entry for entry in sys.path if entry != str(ROOT))]
    os.environ["PYTHONPATH"] = str(tree)
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def fork(work: Callable[[], int], limit: float) -> int:
    """Return the exit code of work done in a fork, below zero if a limit of CPU seconds ended it."""
    child = os.fork()
    if not child:
        # It ends with its parent.
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)
        os.setpgid(0, 0)
        resource.setrlimit(resource.RLIMIT_CPU, (int(limit), int(limit) + 5))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
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
        time.sleep(0.02)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    return os.waitstatus_to_exitcode(status)


def notice(tests: list[str]) -> int:
    """Run tests up to the first failure, and return pytest's exit code."""
    files = {test.partition("::")[0] for test in tests}
    return int(pytest.main([*sorted(files), *PYTEST, "-x"], plugins=[Selection(tests)]))
