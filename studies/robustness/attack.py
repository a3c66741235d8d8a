"""Attack every parser with damaged files: each must end in an error for people, in little time and memory.

File number n of a parser follows from the seed alone. Files are read in workers that this program forks. An error that
is none of gauge-envs, the death of a worker, more than 10 s of processor time or 120 s, and a growth of memory above
1 GB are failures, whose files are kept. A run goes on where the last one with the same folder ended. Examples:

    python studies/robustness/attack.py --state attack --minutes 20
    python studies/robustness/attack.py --state attack --count 100000 --only usda --seed 3
"""

from __future__ import annotations

import argparse
import json
import mmap
import os
import random
import resource
import signal
import sys
import tempfile
import traceback
import warnings
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from parsers import EXPECTED, Parser, parsers

from gauge_envs.errors import MissingExtraError
from gauge_envs.files import write_whole

MOST_S = 10
"""Most processor time of a file [s]."""
MOST_WALL_S = 120
"""Most time of a file, which children that the package limits to 60 s may take [s]."""
MOST_MEMORY = 10**9
"""Most memory that a worker takes beyond what it starts with [bytes]."""
CHUNK_S = 5.0
"""Processor time of a worker [s]."""


@dataclass
class Standing:
    """What is known of a parser.

    Attributes:
        tried: Files that were read.
        refused: Files that ended in an error of gauge-envs.
        failures: Reason for each file that failed, by its number.
        slowest_s: Longest processor time of a file, children included [s].
        slowest: Its number.
        memory_mb: Largest growth of a worker while it read its files [MB].
        child_memory_mb: Largest memory of a child process that a parser started [MB].
        cpu_s: Processor time, children included [s].
    """

    tried: int = 0
    refused: int = 0
    failures: dict[str, str] = field(default_factory=dict)
    slowest_s: float = 0.0
    slowest: int = 0
    memory_mb: float = 0.0
    child_memory_mb: float = 0.0
    cpu_s: float = 0.0


NEXT, REFUSED, SLOWEST_S, SLOWEST, MEMORY, CHILD_MEMORY = range(6)
"""Numbers that a worker shares with its parent."""


def damaged(name: str, parser: Parser, seed: int, number: int) -> bytes:
    """Return the content of a file."""
    chance = random.Random(f"{name} {seed} {number}")
    return parser.damage(chance.choice(parser.seeds), chance)


def work(
    name: str,
    parser: Parser,
    seed: int,
    last: int,
    shared: Any,
    kept: Path,
    folder: Path,
) -> None:
    """Read files up to a number in a worker, which never returns."""
    quiet = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(quiet, stream)
    warnings.simplefilter("ignore")
    start_memory = _data_bytes()
    resource.setrlimit(
        resource.RLIMIT_DATA, (start_memory + MOST_MEMORY, resource.RLIM_INFINITY)
    )
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    start_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    while shared[NEXT] < last:
        number = int(shared[NEXT])
        # A new name for each file, as readers cache files by their path.
        file = folder / f"{name}-{number}{parser.suffix}"
        file.write_bytes(damaged(name, parser, seed, number))
        signal.setitimer(signal.ITIMER_PROF, MOST_S)
        signal.alarm(MOST_WALL_S)
        start_s = _cpu_s()
        try:
            parser.read(file)
        except EXPECTED:
            shared[REFUSED] += 1
        except BaseException:
            (kept / f"{name}-{seed}-{number}.reason").write_text(
                traceback.format_exc(limit=-6), errors="replace"
            )
        taken_s = _cpu_s() - start_s
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        if taken_s > shared[SLOWEST_S]:
            shared[SLOWEST_S], shared[SLOWEST] = taken_s, number
        file.unlink(missing_ok=True)
        shared[MEMORY] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - start_kb
        shared[CHILD_MEMORY] = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
        shared[NEXT] = number + 1
    os._exit(0)


def warm_up(known: Mapping[str, Parser], folder: Path) -> None:
    """Read the valid files in this process, so that each of its workers has the modules; none may be refused."""
    for name, parser in known.items():
        for number, content in enumerate(parser.seeds):
            file = folder / f"{name}-valid-{number}{parser.suffix}"
            file.write_bytes(content)
            with suppress(MissingExtraError):
                parser.read(file)


def _cpu_s() -> float:
    """Return the processor time of this process and its children [s]."""
    used = map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(one.ru_utime + one.ru_stime for one in used)


def _data_bytes() -> int:
    """Return the size of this process's data, which `RLIMIT_DATA` limits."""
    pages = int(Path("/proc/self/statm").read_text().split()[5])
    return pages * resource.getpagesize()


def attack(
    name: str,
    parser: Parser,
    seed: int,
    last: int,
    one: Standing,
    state: Path,
    folder: Path,
) -> None:
    """Read files of a parser from where it stands up to a number, or until a worker dies."""
    shared = np.frombuffer(mmap.mmap(-1, 64), dtype=np.float64)
    shared[NEXT] = one.tried
    kept = state / "failures"
    child = os.fork()
    if child == 0:
        try:
            work(name, parser, seed, last, shared, kept, folder)
        finally:
            os._exit(1)
    _, status, usage = os.wait4(child, 0)
    end = int(shared[NEXT])
    if status:
        code = os.waitstatus_to_exitcode(status)
        reason = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        (kept / f"{name}-{seed}-{end}.reason").write_text(
            f"the worker ended: {reason}\n"
        )
        end += 1
    for number in range(one.tried, end):
        reason_file = kept / f"{name}-{seed}-{number}.reason"
        if reason_file.exists():
            one.failures[str(number)] = (
                reason_file.read_text().strip().rpartition("\n")[2][:200]
            )
            reason_file.rename(reason_file.with_suffix(".txt"))
            (kept / f"{name}-{seed}-{number}{parser.suffix}").write_bytes(
                damaged(name, parser, seed, number)
            )
    one.tried = end
    one.refused += int(shared[REFUSED])
    if shared[SLOWEST_S] > one.slowest_s:
        one.slowest_s, one.slowest = float(shared[SLOWEST_S]), int(shared[SLOWEST])
    one.memory_mb = max(one.memory_mb, float(shared[MEMORY]) / 1e3)
    one.child_memory_mb = max(one.child_memory_mb, float(shared[CHILD_MEMORY]) / 1e3)
    one.cpu_s += usage.ru_utime + usage.ru_stime


def main() -> None:
    """Attack the parsers in turn, print a line for each, and exit with 1 after a failure."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=1_000_000, help="files in all")
    parser.add_argument(
        "--minutes", type=float, default=20.0, help="most processor time of this run"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--only", action="append", help="parser to attack; repeatable; all by default"
    )
    parser.add_argument(
        "--state",
        type=Path,
        default=Path(tempfile.gettempdir()) / "gauge-attack",
        help="folder",
    )
    given = parser.parse_args()
    (given.state / "failures").mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as place:
        known = {
            name: one
            for name, one in parsers(Path(place)).items()
            if name in (given.only or [name])
        }
        state_file = given.state / f"seed-{given.seed}.json"
        stored = json.loads(state_file.read_text()) if state_file.exists() else {}
        standings = {name: Standing(**stored.get(name, {})) for name in known}
        warm_up(known, Path(place))
        missing = [name for name, one in known.items() if not one.seeds]
        run(
            known,
            standings,
            given,
            Path(place),
            lambda: _save(state_file, stored, standings),
        )
    report(standings, missing)
    raise SystemExit(any(one.failures for one in standings.values()))


def run(
    known: Mapping[str, Parser],
    standings: Mapping[str, Standing],
    given: argparse.Namespace,
    folder: Path,
    save: Any,
) -> None:
    """Read failures again, then chunks of the parser that is farthest behind, as long as there are files and time."""
    shares = {name: one.share for name, one in known.items() if one.seeds}
    goals = {
        name: max(1, round(given.count * share / sum(shares.values())))
        for name, share in shares.items()
    }
    for name, one in standings.items():
        for number in [int(key) for key in one.failures]:
            again = Standing(tried=number)
            attack(
                name, known[name], given.seed, number + 1, again, given.state, folder
            )
            if not again.failures:
                del one.failures[str(number)]
                one.refused += again.refused
        save()
    start_s = sum(one.cpu_s for one in standings.values())
    while sum(one.cpu_s for one in standings.values()) - start_s < 60.0 * given.minutes:
        name = min(goals, key=lambda name: standings[name].tried / goals[name])
        one = standings[name]
        if one.tried >= goals[name]:
            break
        each_s = one.cpu_s / one.tried if one.tried else CHUNK_S / 20
        last = min(goals[name], one.tried + max(1, round(CHUNK_S / each_s)))
        attack(name, known[name], given.seed, last, one, given.state, folder)
        save()


def _save(
    file: Path, stored: dict[str, Any], standings: Mapping[str, Standing]
) -> None:
    write_whole(
        file,
        json.dumps(
            stored | {name: asdict(one) for name, one in standings.items()}, indent=1
        ).encode(),
    )


def report(standings: Mapping[str, Standing], missing: list[str]) -> None:
    """Print what was found."""
    print(
        "parser          files   refused  read  failed  slowest s  MB more  MB child   CPU s"
    )
    for name, one in standings.items():
        read = one.tried - one.refused - len(one.failures)
        print(
            f"{name:12} {one.tried:8} {one.refused:9} {read:5} {len(one.failures):7} {one.slowest_s:10.2f} "
            f"{one.memory_mb:8.0f} {one.child_memory_mb:9.0f} {one.cpu_s:7.0f}"
        )
    for name in missing:
        print(f"{name}: left out, as what writes its files is not installed")
    for name, one in standings.items():
        for number, reason in list(one.failures.items())[:5]:
            print(f"{name} {number}: {reason}", file=sys.stderr)
    print(
        f"{sum(one.tried for one in standings.values())} files, {sum(one.cpu_s for one in standings.values()):.0f} s"
    )


if __name__ == "__main__":
    main()
