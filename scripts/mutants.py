"""Measure what the tests of the core notice: small faults drawn at random, each met by the tests that cover its line.

python -m scripts.mutants run --seed 1 --number 300     draw, run what has not run yet, and print the table
python -m scripts.mutants table --seed 1                print the table
python -m scripts.mutants again --seed 1                run the survivors once more, after tests were added

Own code, because mutmut changes functions alone and draws no sample, and cosmic-ray runs one command for all mutants.

All runs in a copy of the repository below `.venv/mutants`. The first call runs every test once under coverage.py, which
takes half an hour; later ones repeat the files of tests that changed, or all after the folder `coverage` there is
removed, which a change of the package needs. A mutant meets the tests that cover its line, at most 20 s of them as
measured without it, those of its own room first and the fastest first. The first failure kills it, and so do four times
the time and 40 s. What no test covers has survived. A call that was interrupted goes on.
"""

from __future__ import annotations

import argparse
import gc
import hashlib
import itertools
import json
import math
import os
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from scripts import mutant_tests
from scripts.mutant_operators import Mutant, mutants
from scripts.mutant_tests import PACKAGE, PYTEST, ROOT, Covered, Selection, fork
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
# Part of the time of a collection that another file of tests adds; the rest are imports that all files share.
OF_COLLECTION = 0.25
# Files of tests in one process; all of a line's tests at once would collect half of the tests.
CHUNK = 6
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
    """Return the text of the file with the fault."""
    raw = (ROOT / mutant.path).read_bytes()
    return (raw[: mutant.start] + mutant.text.encode() + raw[mutant.end :]).decode()


def _compiles(mutant: Mutant) -> bool:
    try:
        compile(changed(mutant), mutant.path, "exec")
    except (SyntaxError, ValueError):
        return False
    return True


def plan(mutant: Mutant, covers: list[Covered]) -> list[tuple[Covered, list[str]]]:
    """Return the tests of a mutant by file: those of its room first, the fastest first, up to the limit of time."""
    room = room_of(Path(mutant.path).parts).removeprefix(PACKAGE)
    found = []
    for cover in covers:
        is_far = not cover.file.startswith(f"tests{room}")
        for test in _tests_of(mutant, cover):
            found.append((is_far, cover.seconds[test], test, cover))
    found.sort(key=lambda entry: entry[:3])
    left = SECONDS
    chosen: dict[str, tuple[Covered, list[str]]] = {}
    for _, seconds, test, cover in found:
        if left > 0.0:
            if cover.file not in chosen:
                left -= OF_COLLECTION * cover.collection
            chosen.setdefault(cover.file, (cover, []))[1].append(test)
            left -= seconds
    return list(chosen.values())


def _tests_of(mutant: Mutant, cover: Covered) -> set[str]:
    if mutant.at_import:
        return cover.users(mutant.path)
    return cover.tests(mutant.path, mutant.lines) or cover.tests(
        mutant.path, mutant.statement
    )


def meet(mutant: Mutant, covers: list[Covered], state: Path) -> str:
    """Return what becomes of a mutant, and in which chunk of files."""
    chosen = plan(mutant, covers)
    if not chosen:
        return "uncovered"
    tree = state / "mutated"
    file = tree / mutant.path
    file.write_text(changed(mutant), "utf-8")
    try:
        for first in range(0, len(chosen), CHUNK):
            part = chosen[first : first + CHUNK]
            files = [cover.file for cover, _ in part]
            tests = [test for _, tests in part for test in tests]
            expected = sum(
                cover.collection + sum(cover.seconds[test] for test in tests)
                for cover, tests in part
            )
            code = fork(
                lambda files=files, tests=tests: _run(files, tests),
                tree,
                40 + 4 * expected,
                state / "mutant.log",
            )
            if code not in (0, 5):
                return "killed"
    finally:
        # A later mutant of the same length must not meet the bytecode of this one.
        file.write_bytes((ROOT / mutant.path).read_bytes())
        os.utime(file, (0, 0))
    return "survived"


def _run(files: list[str], tests: list[str]) -> int:
    return pytest.main([*files, *PYTEST, "-x"], plugins=[Selection(tests)])


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
    print(f"{'room':36}" + "".join(f"{name:>11}" for name in OUTCOMES) + "   killed, %")
    for room, count in sorted(counts.items(), key=lambda entry: entry[0] == "all"):
        number = count.total() - count["equivalent"]
        share = "-"
        if number:
            low, high = interval(count["killed"], number)
            share = f"{100 * count['killed'] / number:.0f} ({100 * low:.0f} to {100 * high:.0f})"
        columns = "".join(f"{count[name]:11}" for name in OUTCOMES)
        print(f"{room:36}{columns}   {share}")
    for mutant, outcome in sorted(alive, key=lambda entry: entry[0].name):
        print(f"\n{outcome}: {mutant.path}:{mutant.line} in {mutant.function}")
        print(f"    {mutant.written}\n    {mutant.text}")
        print(f"    mutant = {json.dumps(mutant.name)}")


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("work", choices=("run", "table", "again"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--number", type=int, default=300)
    parser.add_argument("--state", type=Path, default=ROOT / ".venv" / "mutants")
    options = parser.parse_args()
    state = options.state.resolve()
    state.mkdir(parents=True, exist_ok=True)
    file = state / f"results-{options.seed}.jsonl"
    lines = file.read_text().splitlines() if file.exists() else []
    results = dict(map(json.loads, lines))
    sample = drawn(options.seed, options.number)
    if options.work != "table":
        for tree in ("tree", "mutated"):
            mutant_tests.copy_tree(state / tree)
        mutant_tests.warm()
        gc.freeze()
        covers = mutant_tests.covered(state)
        wanted = {None} if options.work == "run" else {None, "survived", "uncovered"}
        for number, mutant in enumerate(sample):
            if results.get(mutant.name) not in wanted:
                continue
            results[mutant.name] = outcome = meet(mutant, covers, state)
            with file.open("a") as stream:
                stream.write(json.dumps([mutant.name, outcome]) + "\n")
            print(
                f"{number + 1:4}  {outcome:9}  {mutant.path}:{mutant.line}", flush=True
            )
    table(sample, results)


if __name__ == "__main__":
    main()
