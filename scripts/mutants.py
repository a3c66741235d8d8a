"""Measure what the tests of the core notice: small faults drawn at random, each met by the tests that cover its line.

python -m scripts.mutants run --seed 1 --number 300     draw, run what has not run yet, and print the table
python -m scripts.mutants table --seed 1                print the table
python -m scripts.mutants again --seed 1                run the survivors once more, after tests were added

Own code, because mutmut changes functions alone and draws no sample, and cosmic-ray runs one command for all mutants.

All runs in a copy of the repository below `.venv/mutants`. A mutant is written into its file there, and tests run in a
fork that imports it. It meets the tests that cover its line, at most 20 CPU s of them as measured without it: those of
its own room, the fastest first, then those of the files nearest by imports. The first failure kills it, and so do four
times the time and 40 s. What no test covers has survived. What a file of tests covers is measured when it is first
needed, and anew after a change of that file or of the module with the mutant; `--tests FOLDERS` leaves other files out,
and `--only PATHS` mutants of other modules. The first 300 mutants take some two hours of an idle core, of which an
hour measures; each takes two seconds beside its tests. A call that was interrupted goes on.
"""

from __future__ import annotations

import argparse
import functools
import hashlib
import itertools
import json
import math
import os
import time
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

from scripts import mutant_tests
from scripts.changed_tests import importers, near_tests
from scripts.mutant_operators import Mutant, mutants
from scripts.mutant_tests import PACKAGE, ROOT, Covered, covered, fork, notice, say
from scripts.size import room_of

EQUIVALENT = Path(__file__).with_name("mutants_equivalent.toml")
ROOMS = (
    "scene",
    "references",
    "observables",
    "experiments",
    "evaluation",
    "backends/*.py",
    "backends/shared",
    "backends/mujoco",
    "envs",
    "runs",
    "pages",
    "cli",
    "rendering",
    "tools/run",
    "tools/catalog",
    "tools/sanity",
    "tools/conformance",
)
SECONDS = 20.0
# Files of tests of other rooms that a mutant meets, the nearest ones by imports.
OTHER_FILES = 10
OUTCOMES = ("killed", "equivalent", "survived", "uncovered")


def sources() -> Iterator[Path]:
    """Yield the files that mutants are drawn from."""
    for room in ROOMS:
        folder = ROOT / PACKAGE
        yield from sorted(
            folder.glob(room) if "*" in room else (folder / room).rglob("*.py")
        )


def drawn(seed: int, number: int) -> list[Mutant]:
    """Return a random sample; a mutant keeps its rank when other code changes."""
    every = [
        mutant
        for path in sources()
        for mutant in mutants(str(path.relative_to(ROOT)), path.read_text("utf-8"))
    ]
    every.sort(
        key=lambda mutant: hashlib.sha256(f"{seed} {mutant.name}".encode()).digest()
    )
    return list(itertools.islice(filter(_compiles, every), number))


def changed(mutant: Mutant) -> str:
    """Return the text of the file of the working directory with the fault."""
    raw = Path(mutant.path).read_bytes()
    return (raw[: mutant.start] + mutant.text.encode() + raw[mutant.end :]).decode()


def _compiles(mutant: Mutant) -> bool:
    try:
        compile(changed(mutant), mutant.path, "exec")
    except (SyntaxError, ValueError):
        return False
    return True


@functools.cache
def _edges() -> dict[str, set[str]]:
    return importers()


@functools.cache
def _near(path: str) -> list[str]:
    return [*near_tests([path], _edges())]


def plan(
    mutant: Mutant, files: set[str], covered: Callable[[str, str], Covered]
) -> Iterator[tuple[list[str], float]]:
    """Yield tests and their seconds up to the limit: all of the room at once, then those of each file nearby.

    Args:
        mutant: The mutant.
        files: Files of tests.
        covered: Returns what a file of tests covers, with the lines of a module as they are now.
    """
    room = "tests" + room_of(Path(mutant.path).parts).removeprefix(PACKAGE)
    # Each engine is a room of its own.
    inner = () if room == "tests/backends" else (f"{room}/",)
    folders = {file: f"{Path(file).parent}/" for file in files}
    nearest = [
        file
        for file, folder in sorted(folders.items())
        if folder == f"{room}/" or folder.startswith(inner)
    ]
    others = [
        file for file in _near(mutant.path) if file in files and file not in nearest
    ]
    left = SECONDS
    for group in (nearest, *([file] for file in others[:OTHER_FILES])):
        timed = sorted(
            (cover.seconds[test], test)
            for cover in (covered(file, mutant.path) for file in group)
            for test in _tests_of(mutant, cover)
        )
        chosen = []
        before = left
        for seconds, test in timed:
            if left > 0.0:
                chosen.append(test)
                left -= seconds
        if chosen:
            yield chosen, before - left


def _tests_of(mutant: Mutant, cover: Covered) -> set[str]:
    """Return the tests that run a mutant, or any of its module where only a child process of a test may run it."""
    found: set[str] = set()
    if not mutant.at_import:
        found = cover.tests(mutant.path, mutant.lines) or cover.tests(
            mutant.path, mutant.statement
        )
    return found or cover.users(mutant.path)


def meet(mutant: Mutant, parts: Iterator[tuple[list[str], float]]) -> str:
    """Return what becomes of a mutant that is in its file while tests run."""
    file = Path(mutant.path)
    sound = file.read_bytes()
    faulty = changed(mutant)
    outcome = "uncovered"
    for tests, seconds in parts:
        file.write_text(faulty, "utf-8")
        try:
            code = fork(lambda tests=tests: notice(tests), 40 + 4 * seconds)
        finally:
            # A later mutant of the same length must not meet the bytecode of this one.
            file.write_bytes(sound)
            os.utime(file, (0, 0))
        if code not in (0, 5):
            return "killed"
        outcome = "survived"
    return outcome


def equivalents() -> dict[str, str]:
    """Return the reasons of the mutants that were judged to change nothing, by name."""
    entries = tomllib.loads(EQUIVALENT.read_text("utf-8")).get("equivalent", [])
    return {entry["mutant"]: entry["reason"] for entry in entries}


def interval(killed: int, number: int) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a share."""
    z = 1.96
    share = killed / number
    middle = share + z**2 / (2 * number)
    half = z * math.sqrt(share * (1 - share) / number + z**2 / (4 * number**2))
    low, high = (end / (1 + z**2 / number) for end in (middle - half, middle + half))
    return max(low, 0.0), min(high, 1.0)


def table(sample: list[Mutant], results: dict[str, str]) -> None:
    """Print the outcomes by room, and what survived."""
    same = equivalents()
    counts: dict[str, Counter[str]] = {}
    alive = []
    for mutant in sample:
        outcome = results.get(mutant.name)
        if outcome is None:
            continue
        if outcome != "killed" and mutant.name in same:
            outcome = "equivalent"
        for room in (room_of(Path(mutant.path).parts), "all"):
            counts.setdefault(room, Counter())[outcome] += 1
        if outcome in ("survived", "uncovered"):
            alive.append((mutant, outcome))
    say(f"{'room':36}" + "".join(f"{name:>11}" for name in OUTCOMES) + "   killed, %")
    for room, count in sorted(counts.items(), key=lambda entry: entry[0] == "all"):
        number = count.total() - count["equivalent"]
        share = "-"
        if number:
            low, high = interval(count["killed"], number)
            share = f"{100 * count['killed'] / number:.0f} ({100 * low:.0f} to {100 * high:.0f})"
        columns = "".join(f"{count[name]:11}" for name in OUTCOMES)
        say(f"{room:36}{columns}   {share}")
    for mutant, outcome in sorted(alive, key=lambda entry: entry[0].name):
        say(f"\n{outcome}: {mutant.path}:{mutant.line} in {mutant.function}")
        say(f"    {mutant.written}\n    {mutant.text}")
        say(f"    mutant = {json.dumps(mutant.name)}")


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("work", choices=("run", "table", "again"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--number", type=int, default=300)
    parser.add_argument("--state", type=Path, default=ROOT / ".venv" / "mutants")
    parser.add_argument("--tests", nargs="+", default=["tests"])
    parser.add_argument("--only", nargs="+", default=[""], help="starts of paths")
    options = parser.parse_args()
    state = options.state.resolve()
    state.mkdir(parents=True, exist_ok=True)
    results_file = state / f"results-{options.seed}.jsonl"

    def results() -> dict[str, str]:
        lines = results_file.read_text().splitlines() if results_file.exists() else []
        return dict(map(json.loads, lines))

    def done(mutant: Mutant, outcome: str) -> None:
        with results_file.open("a") as stream:
            stream.write(json.dumps([mutant.name, outcome]) + "\n")
        minutes = (time.monotonic() - started) / 60.0
        say(f"{minutes:5.1f} min  {outcome:9}  {mutant.path}:{mutant.line}")

    started = time.monotonic()
    os.chdir(ROOT)
    drawn_all = drawn(options.seed, options.number)
    sample = [one for one in drawn_all if one.path.startswith(tuple(options.only))]
    if options.work != "table":
        wanted = {None} if options.work == "run" else {None, "survived", "uncovered"}
        known = results()
        left = [mutant for mutant in sample if known.get(mutant.name) in wanted]
        tree = state / "tree"
        mutant_tests.copy_tree(tree)
        mutant_tests.enter(tree, state / "tests.log")
        files = {
            str(path.relative_to(tree))
            for folder in options.tests
            for path in (tree / folder).rglob("test_*.py")
        }
        for mutant in left:
            parts = plan(mutant, files, lambda file, path: covered(file, path, state))
            done(mutant, meet(mutant, parts))
    table(sample, results())


if __name__ == "__main__":
    main()
