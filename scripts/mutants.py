"""Draw mutants of the package at random, and run the tests of each mutant's room.

    python -m scripts.mutants --count 20 --seed 1

A mutant is the package with one changed comparison, sum, product, number or condition. Tests that pass with it miss the
change. Mutants are made by cosmic-ray in a copy of the checkout.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from random import Random

from cosmic_ray.ast import ast_nodes, get_ast_from_path
from cosmic_ray.mutating import mutate_and_test
from cosmic_ray.plugins import get_operator
from cosmic_ray.testing import run_tests
from cosmic_ray.work_item import MutationSpec, TestOutcome

from scripts.generated import ROOT

MAX_SURVIVING_SHARE = 0.3
"""Largest share of survivors. Of 30 mutants 5 survived; then 7 or more of 20 survive by chance once in 40 draws."""

LIMIT_S = 900.0
"""Time limit of the tests of a mutant [s]; mutants that exceed it have no result."""

OPERATORS = (
    "NumberReplacer",
    "AddNot",
    "ReplaceTrueWithFalse",
    "ReplaceFalseWithTrue",
    "ReplaceAndWithOr",
    "ReplaceOrWithAnd",
    "ReplaceComparisonOperator_Lt_GtE",
    "ReplaceComparisonOperator_Gt_LtE",
    "ReplaceComparisonOperator_LtE_Gt",
    "ReplaceComparisonOperator_GtE_Lt",
    "ReplaceComparisonOperator_Eq_NotEq",
    "ReplaceComparisonOperator_NotEq_Eq",
    "ReplaceBinaryOperator_Add_Sub",
    "ReplaceBinaryOperator_Sub_Add",
    "ReplaceBinaryOperator_Mul_Div",
    "ReplaceBinaryOperator_Div_Mul",
)
"""Operators of cosmic-ray."""

NOT_INSTALLED = ("drake", "genesis")
"""Engines that the tests of `make test` do without."""

ELSEWHERE = {
    "tests/backends/mujoco/mjcf": "tests/experiments/test_scene_source_mjcf.py",
    "tests/tools/conformance": "tests/backends/test_engines_conform.py",
}
"""More tests of a room."""

LEFT_OUT = shutil.ignore_patterns(".git", ".venv*", ".*_cache", "__pycache__", "_build")


def mutations_of(file: Path) -> Iterator[MutationSpec]:
    """Yield the mutations of a file."""
    nodes = list(ast_nodes(get_ast_from_path(file)))
    for name in OPERATORS:
        operator = get_operator(f"core/{name}")()
        occurrence = 0
        for node in nodes:
            for start, end in operator.mutation_positions(node):
                yield MutationSpec(file, f"core/{name}", occurrence, start, end)
                occurrence += 1


def drawn(random: Random, files: Sequence[Path]) -> MutationSpec:
    """Return a mutation of a file that is drawn by its size."""
    sizes = [file.stat().st_size for file in files]
    while True:
        (file,) = random.choices(files, sizes)
        mutations = list(mutations_of(file))
        if mutations:
            return random.choice(mutations)


def tests_of(file: Path) -> list[Path]:
    """Return the tests of a file's room; `tests` mirrors the package, and engines share a folder."""
    room = Path("tests", *file.parts[1:-1])
    more = [Path(ELSEWHERE[str(room)])] if str(room) in ELSEWHERE else []
    if room.parts[1:2] == ("backends",) and len(room.parts) > 2:
        of_engine = sorted(Path("tests/backends").glob(f"test_{room.parts[2]}*.py"))
        if of_engine:
            return of_engine + more
    while not room.is_dir():
        room = room.parent
    if room == Path("tests"):
        return sorted(room.glob("test_*.py"))
    return [room, *more]


@cache
def passes(command: str) -> bool:
    """Return whether tests pass without a mutant."""
    return run_tests(command, LIMIT_S)[0] is TestOutcome.SURVIVED


def outcome(mutation: MutationSpec) -> str:
    """Return `killed`, `survived`, or why there is no result."""
    places = " ".join(map(str, tests_of(mutation.module_path)))
    command = f"{sys.executable} -m pytest -x -n 2 --dist loadfile {places}"
    if not passes(command):
        return "the tests fail without the mutant"
    result = mutate_and_test([mutation], command, LIMIT_S)
    if result.output == "timeout" or result.test_outcome is TestOutcome.INCOMPETENT:
        return result.output.splitlines()[-1]
    return str(result.test_outcome.value)


def main() -> int:
    """Print the outcome of each mutant; return 1 if too many survive."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, required=True)
    options = parser.parse_args()
    random = Random(options.seed)
    outcomes = []
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / ROOT.name
        shutil.copytree(ROOT, copy, ignore=LEFT_OUT)
        os.chdir(copy)
        os.environ["PYTHONPATH"] = str(copy)
        files = [
            file
            for file in sorted(Path("gauge_envs").rglob("*.py"))
            if file.parent.name not in NOT_INSTALLED
        ]
        for _ in range(options.count):
            mutation = drawn(random, files)
            outcomes.append(outcome(mutation))
            place = f"{mutation.module_path}:{mutation.start_pos[0]}"
            name = mutation.operator_name.removeprefix("core/")
            print(f"{outcomes[-1]}: {place} {name}", flush=True)
        os.chdir(ROOT)
    survivors = outcomes.count("survived")
    tested = survivors + outcomes.count("killed")
    print(f"{survivors} of {tested} survived")
    return int(survivors > MAX_SURVIVING_SHARE * tested)


if __name__ == "__main__":
    sys.exit(main())
